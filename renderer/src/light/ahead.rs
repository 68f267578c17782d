//! Light samples drawn ahead: those of the environment do not depend on the point they light, so sixteen samples' are drawn at once.

use super::{EnvironmentLight, EnvironmentSample};
use crate::sampler::{LANES, PixelSampler, Points};

/// Sets that are drawn ahead, every other one from 2 on: the first vertex alone. Fewer samples have a second one, and drawing sixteen
/// lights for them, and for the two after, took 4 % more instructions in all.
const SETS: usize = 1;

#[derive(Clone, Copy)]
struct Batch {
    /// The pixel's stream, and number of the batch in it.
    base: u64,
    number: u32,
    drawn: [Option<EnvironmentSample>; LANES],
}

/// Keeps the light samples that were drawn ahead, of one environment. What it returns depends on the arguments alone.
pub(crate) struct Ahead {
    batches: [Batch; SETS],
}

impl Default for Ahead {
    fn default() -> Self {
        Self { batches: [Batch { base: 0, number: u32::MAX, drawn: [None; LANES] }; SETS] }
    }
}

impl Ahead {
    /// [`EnvironmentLight::sample`] of `light` with the first two numbers of set `set`, an even one, of sample `index`.
    #[inline(always)]
    pub fn sample(
        &mut self,
        light: &EnvironmentLight,
        (sampler, points): (&PixelSampler, &mut Points),
        index: u32,
        set: u32,
    ) -> Option<EnvironmentSample> {
        let number = index / LANES as u32;
        let Some(batch) = self.batches.get_mut((set / 2).wrapping_sub(1) as usize).filter(|_| sampler.is_sobol()) else {
            let [u, v, ..] = points.point(sampler, index, set);
            return light.sample([u, v]);
        };
        if batch.number != number || batch.base != sampler.base() {
            (batch.number, batch.base) = (number, sampler.base());
            if let Some([u, v, ..]) = points.batch(sampler, index, set) {
                light.sample_all([u, v], &mut batch.drawn);
            }
        }
        batch.drawn[index as usize % LANES]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::Sampler;
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
        for environment in maps {
            let light = EnvironmentLight::new(&environment).unwrap();
            let (mut ahead, mut points) = (Ahead::default(), Points::default());
            for kind in [Sampler::Sobol, Sampler::Independent] {
                for (pixel, index) in
                    (0..12).flat_map(|pixel| [0, 1, 5, 16, 40, 70_000].map(|start| (pixel, start + pixel as u32)))
                {
                    let sampler = PixelSampler::of_kind(kind, 3, 0, pixel);
                    for set in [2, 4, 8, 10, 40] {
                        let [u, v, ..] = sampler.point(index, set);
                        assert_eq!(
                            ahead.sample(&light, (&sampler, &mut points), index, set),
                            light.sample([u, v]),
                            "{index} {set}"
                        );
                    }
                }
            }
        }
    }
}
