//! A cache of light samples. Samples of the environment do not depend on the point that they light, so they are drawn sixteen at
//! a time.

use super::{EnvironmentLight, EnvironmentSample};
use crate::sampler::{LANES, PixelSampler, Points};

/// Number of sets that may be drawn in advance: the sets of the first vertices, every other one from 2 on.
const SETS: usize = 4;
/// The next sixteen samples of a set are drawn in advance if at least this number of the last sixteen used the set. All samples
/// use the set of the first vertex. Outdoors fewer reach the second vertex, where always drawing in advance costs more than it
/// saves; in a room nearly all do.
const WORTH: u32 = 8;

#[derive(Clone, Copy)]
struct Batch {
    /// What tells the sequence from others, and number of the batch in it.
    base: u64,
    number: u64,
    /// Number of samples of the batch that were requested, and whether the batch was drawn.
    asked: u32,
    ahead: bool,
    drawn: [Option<EnvironmentSample>; LANES],
}

/// Caches light samples of one environment that were drawn in advance. Its results depend on the arguments alone, because drawing
/// sixteen samples at once gives the same bits as drawing each.
pub(crate) struct LightSampleCache {
    batches: [Batch; SETS],
    /// Whether enough samples of the first vertex are expected for sixteen to be drawn.
    first: bool,
}

impl Default for LightSampleCache {
    fn default() -> Self {
        Self { batches: [Batch { base: 0, number: u64::MAX, asked: 0, ahead: false, drawn: [None; LANES] }; SETS], first: true }
    }
}

impl LightSampleCache {
    /// Announces how many consecutive samples of a pixel will be requested at the first vertex. It affects what is drawn in
    /// advance, never the results.
    #[inline(always)]
    pub fn expect(&mut self, samples: u32) {
        self.first = samples >= WORTH;
    }

    /// [`EnvironmentLight::sample`] of `light` with the first two numbers of set `set`, an even one, of sample `index`.
    #[inline(always)]
    pub fn sample(
        &mut self,
        light: &EnvironmentLight,
        (sampler, points): (&PixelSampler, &mut Points),
        index: u32,
        set: u32,
    ) -> Option<EnvironmentSample> {
        let place = sampler.number(index, set);
        let number = place / LANES as u64;
        if let Some(batch) = self.batches.get_mut((set / 2).wrapping_sub(1) as usize).filter(|_| sampler.is_sobol()) {
            let base = sampler.base(set);
            if batch.number != number || batch.base != base {
                let wanted = (set == 2 && self.first) || batch.asked >= WORTH;
                (batch.number, batch.base, batch.asked, batch.ahead) = (number, base, 0, false);
                // Sixteen points are needed here, even if few are expected elsewhere.
                if wanted && let Some([u, v, ..]) = points.sixteen(sampler, index, set) {
                    light.sample_all([u, v], &mut batch.drawn);
                    batch.ahead = true;
                }
            }
            batch.asked += 1;
            if batch.ahead {
                return batch.drawn[place as usize % LANES];
            }
        }
        let [u, v, ..] = points.point(sampler, index, set);
        light.sample([u, v])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::{Sampler, Sharing};
    use renderflow_frame::{Environment, Image};

    #[test]
    fn samples_are_those_of_the_light() {
        let (width, height) = (37, 12);
        let texel = |i: usize| [(i * 7919 % 101) as f32, (i % 5) as f32, if i == 200 { 3e4 } else { 0.1 }];
        let map = Image { width, height, pixels: (0..width * height).map(texel).collect() };
        let maps = [
            Environment { map, rotation: 2.3, intensity: 0.7 },
            Environment::constant([0.5; 3]),
            Environment::constant([0.0; 3]),
        ];
        let sampler = |kind, pixel: u64| match pixel % 2 {
            0 => PixelSampler::of_kind(kind, 3, 0, pixel),
            _ => PixelSampler::shared(kind, 3, 0, (pixel as u32, 2), 12, Sharing::new(16, 1 + pixel as u32 % 3, 1)),
        };
        for environment in maps {
            let light = EnvironmentLight::new(&environment).unwrap();
            let (mut ahead, mut points) = (LightSampleCache::default(), Points::default());
            for kind in [Sampler::Sobol, Sampler::Independent] {
                let mut later = 0;
                for (pixel, index) in
                    (0..12).flat_map(|pixel| [0, 1, 5, 16, 40, 70_000].map(|start| (pixel, start + pixel as u32)))
                {
                    let sampler = sampler(kind, pixel);
                    ahead.expect(if pixel % 2 == 0 { 1 } else { 16 });
                    points.expect(if pixel % 3 == 0 { 1 } else { 16 });
                    for set in [2, 4, 8, 10, 40] {
                        let [u, v, ..] = sampler.point(index, set);
                        assert_eq!(
                            ahead.sample(&light, (&sampler, &mut points), index, set),
                            light.sample([u, v]),
                            "{index} {set}"
                        );
                    }
                }
                // All samples of a pixel in order, of which only some have later vertices: drawn ahead and then not, and again.
                ahead.expect(16);
                for pixel in 0..3 {
                    let sampler = sampler(kind, pixel);
                    for index in 0..96 {
                        for set in [2, 4, 6, 8, 10] {
                            if index % 48 >= 24 && set > 2 && index % 5 > 0 {
                                continue;
                            }
                            let [u, v, ..] = sampler.point(index, set);
                            let drawn = ahead.sample(&light, (&sampler, &mut points), index, set);
                            assert_eq!(drawn, light.sample([u, v]), "{index} {set}");
                        }
                        later += u32::from(ahead.batches[1].ahead && index % 16 == 15);
                    }
                }
                assert!(kind != Sampler::Sobol || (later > 3 && later < 15), "{later} of 18 batches");
            }
        }
    }
}
