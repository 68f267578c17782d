//! Fills records with the results of the path tracer, of deferred shading and of the warp.

use super::record::{
    KEYS, NEIGHBOURS, PARTS, PATHS, PICTURES, PixelInputs, Record, Selection, Traced, at, difference, radiance, tint,
};
use rayon::prelude::*;
use renderflow_frame::ibl::{Shading, Surfaces};
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::terms::ShadingTerms;
use renderflow_frame::warp::{self, Neighbour};
use renderflow_frame::{Camera, Environment, Frame};

/// The traced samples of a frame.
#[derive(Clone, Copy, Debug)]
pub struct Samples<'a> {
    /// Mean radiance, including the background.
    pub raw: &'a Rgb,
    /// Coverage, from the same camera rays.
    pub alpha: &'a Image<f32>,
    /// Albedo times coverage, from the same camera rays.
    pub albedo: &'a Rgb,
    /// Environment behind each pixel.
    pub background: &'a Rgb,
    /// Samples per pixel; their average where pixels have different numbers.
    pub spp: u32,
    /// Samples of each pixel; all have `spp` if there is none.
    pub counts: Option<&'a Image<u32>>,
    /// What they are made of, if it is known.
    pub paths: Option<Paths<'a>>,
}

/// What samples are made of.
#[derive(Clone, Copy, Debug)]
pub struct Paths<'a> {
    /// [`Frame::indirect`].
    pub indirect: &'a Rgb,
    /// [`Frame::hidden`].
    pub hidden: &'a Rgb,
    /// [`Frame::variance`].
    pub variance: &'a Rgb,
}

impl<'a> Paths<'a> {
    /// Those of the samples of a path-traced frame, or `None` if it does not have all of them.
    pub fn of(frame: &'a Frame) -> Option<Self> {
        let (indirect, hidden, variance) = (frame.indirect.as_ref()?, frame.hidden.as_ref()?, frame.variance.as_ref()?);
        Some(Self { indirect, hidden, variance })
    }
}

/// Samples of another frame, for [`Record::add_neighbours`].
#[derive(Clone, Copy, Debug)]
pub struct Nearby<'a> {
    /// The samples.
    pub samples: Samples<'a>,
    /// For each pixel of the record, the index of its pixel in that frame.
    pub source: &'a Image<Option<u32>>,
    /// For each pixel of the record, how far the samples hold, 0..=1; all of them do if there is none.
    pub share: Option<&'a Image<f32>>,
}

impl<'a> Samples<'a> {
    /// The samples of a path-traced frame, or `None` if it has no samples or no guides.
    pub fn of(frame: &'a Frame, background: &'a Rgb) -> Option<Self> {
        let (raw, albedo) = (frame.raw.as_ref()?, frame.guide_albedo.as_ref()?);
        let counts = frame.samples.as_ref();
        // The spread of a record is of parts of more than one sample.
        let spp = frame.info.spp.max(if counts.is_some() { 2 } else { 0 });
        Some(Self { raw, alpha: &frame.alpha, albedo, background, spp, counts, paths: Paths::of(frame) })
    }

    /// Coverage of pixel `i`, and the reflectance of its samples.
    fn surface(&self, i: usize, stored: &[f32]) -> Option<(f32, [f32; 3])> {
        let alpha = finite(self.alpha.pixels[i]).clamp(0.0, 1.0);
        (alpha > 0.0).then(|| (alpha, tint(self.albedo.pixels[i].map(|v| finite(v / alpha).clamp(0.0, 1.0)), stored)))
    }

    /// Radiance of the surface divided by its reflectance, times coverage, and coverage. Radiance is negative where the samples
    /// are darker than the share of the background, which they may not have met. `stored` holds the numbers of the pixel.
    fn at(&self, i: usize, stored: &[f32], exposure: f32) -> [f32; 4] {
        self.surface(i, stored).map_or([0.0; 4], |surface| self.over(i, surface, stored, exposure))
    }

    /// [`Self::at`] of a pixel that shows this [`Self::surface`].
    #[inline(always)]
    fn over(&self, i: usize, (alpha, own): (f32, [f32; 3]), stored: &[f32], exposure: f32) -> [f32; 4] {
        let there = tint([0, 1, 2].map(|c| stored[at::ALBEDO + c]), stored);
        let over = |c: usize| {
            let surface = self.raw.pixels[i][c] - (1.0 - alpha) * self.background.pixels[i][c];
            // What is missing of the background does not depend on the surface; the reader multiplies by the pixel's reflectance.
            difference(exposure * surface / if surface < 0.0 { there[c] } else { own[c] })
        };
        [over(0), over(1), over(2), alpha]
    }

    /// The numbers at [`at::PATHS`] of pixel `i`; 0 where they are not known.
    fn paths_at(&self, i: usize, stored: &[f32], exposure: f32) -> [f32; PATHS] {
        let Some((paths, (_, own))) = self.paths.zip(self.surface(i, stored)) else { return [0.0; PATHS] };
        std::array::from_fn(|k| {
            let c = k % 3;
            let value = match k / 3 {
                0 => paths.indirect.pixels[i][c],
                1 => paths.hidden.pixels[i][c],
                _ => (paths.variance.pixels[i][c] * self.count(i)).sqrt(),
            };
            radiance(exposure * value / own[c])
        })
    }

    /// Samples of pixel `i`.
    fn count(&self, i: usize) -> f32 {
        self.counts.map_or(self.spp, |counts| counts.pixels[i]) as f32
    }
}

impl Record<f32> {
    /// The record of a frame's G-buffer. `surfaces` holds what its pixels show.
    pub fn of(frame: &Frame, surfaces: &Surfaces, exposure: f32) -> Self {
        let mut record = Self::new(frame.width, frame.height);
        let median = median(&surfaces.depth.pixels);
        record.each(|i, out| {
            let alpha = finite(surfaces.alpha.pixels[i]).clamp(0.0, 1.0);
            put(out, at::BACKGROUND, surfaces.background.pixels[i].map(|v| radiance(exposure * v)));
            if alpha <= 0.0 {
                return;
            }
            out[at::ALPHA] = alpha;
            let guide = |guide: &Option<Rgb>| guide.as_ref().map(|guide| guide.pixels[i]);
            let albedo = guide(&frame.guide_albedo).map(|rgb| rgb.map(|v| v / alpha));
            put(out, at::ALBEDO, albedo.unwrap_or(surfaces.albedo.pixels[i]).map(|v| finite(v).clamp(0.0, 1.0)));
            let normal = guide(&frame.guide_normal).unwrap_or(surfaces.normal.pixels[i]);
            put(out, at::NORMAL, normal.map(|v| finite(v).clamp(-1.0, 1.0)));
            let depth = surfaces.depth.pixels[i];
            let known = depth.is_finite() && depth > 0.0;
            out[at::DEPTH] = if known { (0.5 * (depth / median).ln()).clamp(-2.0, 2.0) } else { 0.0 };
            put(out, at::MATERIAL, surfaces.material.pixels[i].map(|v| finite(v).clamp(0.0, 1.0)));
            for (out, v) in out[at::BRDF..].iter_mut().zip(surfaces.brdf.pixels[i]) {
                *out = finite(v).clamp(0.0, 1.0);
            }
        });
        record
    }

    /// Adds the unoccluded light of the environment, which the network reads with samples.
    pub fn add_environment(&mut self, shading: &Shading, exposure: f32) {
        self.each(|i, out| {
            if out[at::ALPHA] > 0.0 {
                put(out, at::LIT, shading.irradiance.pixels[i].map(|v| radiance(exposure * v)));
                put(out, at::REFLECTED, shading.specular.pixels[i].map(|v| radiance(exposure * v)));
            }
        });
    }

    /// Adds the terms of deferred shading.
    pub fn add_deferred(&mut self, deferred: &ShadingTerms, exposure: f32) {
        self.deferred = true;
        let pixel = |picture: Option<&Rgb>, i: usize| picture.map_or([0.0; 3], |picture| picture.pixels[i]);
        let share =
            |picture: Option<&Image<f32>>, i: usize| picture.map_or(1.0, |picture| finite(picture.pixels[i]).clamp(0.0, 1.0));
        self.each(|i, out| {
            if out[at::ALPHA] <= 0.0 {
                return;
            }
            let lights = deferred.direct.iter().fold([0.0; 3], |sum, light| add(sum, light.pixels[i]));
            let reflected = add(pixel(Some(&deferred.ambient_specular), i), pixel(deferred.reflections.as_ref(), i));
            let terms = [lights, deferred.ambient_diffuse.pixels[i], reflected, pixel(deferred.indirect.as_ref(), i)];
            for (term, rgb) in terms.into_iter().chain([deferred.irradiance.pixels[i]]).enumerate() {
                put(out, at::TERMS + 3 * term, rgb.map(|v| radiance(exposure * v)));
            }
            let open = [deferred.sky.as_ref(), deferred.occlusion.as_ref(), deferred.visibility.first()];
            put(out, at::OPEN, open.map(|picture| share(picture, i)));
        });
    }

    /// Adds the keyframes before and after the frame. `frame` is the frame of this record, and `start` its picture by the split
    /// sum, as keyframes have theirs.
    pub fn add_keys(&mut self, seen: [Option<Neighbour>; KEYS], frame: &Frame, start: &Rgb, exposure: f32) {
        let carried = warp::carry(frame, Some(start), seen.each_ref().map(Option::as_ref), exposure);
        for (k, (seen, carried)) in seen.iter().zip(carried).enumerate() {
            let Some((seen, carried)) = seen.as_ref().zip(carried) else { continue };
            self.distances[k] = Some(seen.distance);
            self.each(|i, out| {
                if out[at::ALPHA] <= 0.0 {
                    return;
                }
                let Some((picture, trust)) = &carried.shaded else { return };
                let (rgb, trust) = (picture.pixels[i], trust.pixels[i]);
                if trust > 0.0 {
                    put(out, at::KEYS + 4 * k, rgb.map(|v| radiance(exposure * v)));
                    out[at::KEYS + 4 * k + 3] = trust.min(1.0);
                }
            });
        }
    }

    /// Adds samples of this frame as part `part`.
    ///
    /// Parts in which pixels have different numbers of samples must have them in the same proportions.
    ///
    /// # Panics
    /// When `part` is not below [`PARTS`].
    pub fn add_part(&mut self, part: usize, samples: &Samples, exposure: f32) {
        assert!(part < PARTS, "part {part} of {PARTS}");
        let known = self.parts.iter().all(|spp| *spp == 0) || self.paths;
        self.paths = known && samples.paths.is_some();
        self.parts[part] = samples.spp;
        if let Some(counts) = samples.counts.filter(|_| samples.spp > 1) {
            self.spread = counts.pixels.iter().map(|&count| count as f32 / samples.spp as f32).collect();
        }
        self.each(|i, out| {
            let own = samples.at(i, out, exposure);
            out[at::SAMPLES + 4 * part..][..4].copy_from_slice(&own);
            if samples.paths.is_some() {
                let paths = samples.paths_at(i, out, exposure);
                out[at::PATHS + PATHS * part..][..PATHS].copy_from_slice(&paths);
            }
        });
    }

    /// Adds the samples of other frames as sum `n` of [`NEIGHBOURS`]. Every sample counts as far as it holds. Where it is not
    /// known what they are made of, the record does not know it of its own samples either.
    ///
    /// # Panics
    /// When `n` is not below [`NEIGHBOURS`].
    pub fn add_neighbours(&mut self, n: usize, frames: &[Nearby], exposure: f32) {
        assert!(n < NEIGHBOURS, "sum {n} of {NEIGHBOURS}");
        let spp = frames.iter().map(|frame| frame.samples.spp).sum::<u32>();
        self.neighbours[n] = spp;
        self.paths &= frames.iter().all(|frame| frame.samples.paths.is_some());
        let known = self.paths;
        self.each(|i, out| {
            let (mut sum, mut indirect) = ([0.0; 4], [0.0; 3]);
            for Nearby { samples, source, share } in frames {
                let share = share.map_or(1.0, |share| share.pixels[i]);
                if let Some(there) = source.pixels[i].filter(|_| share > 0.0) {
                    let weight = share * samples.count(there as usize) / spp.max(1) as f32;
                    let Some(surface) = samples.surface(there as usize, out) else { continue };
                    let carried = samples.over(there as usize, surface, out, exposure);
                    sum.iter_mut().zip(carried).for_each(|(sum, carried)| *sum += weight * carried);
                    if let Some(paths) = samples.paths.filter(|_| known) {
                        let over = |c: usize| radiance(exposure * paths.indirect.pixels[there as usize][c] / surface.1[c]);
                        (0..3).for_each(|c| indirect[c] += weight * over(c));
                    }
                }
            }
            out[at::NEARBY + 4 * n..][..4].copy_from_slice(&sum);
            put(out, at::NEARBY_INDIRECT + 3 * n, indirect);
        });
    }

    /// The noisy picture, the albedo and the normals that another denoiser reads, scene-linear. The picture holds the selected
    /// samples, including those of neighbours. Samples are multiplied by the reflectance of this frame's pixel, so edges are a
    /// little cleaner than they were.
    pub fn noisy(&self, selection: &Selection, exposure: f32) -> [Rgb; 3] {
        let mut pictures = [(); 3].map(|()| Rgb::filled(self.width, self.height, [0.0; 3]));
        let [colors, albedos, normals] = &mut pictures;
        let row = self.width.max(1);
        let guides = albedos.pixels.par_iter_mut().zip(&mut normals.pixels);
        let stored = self.pixels.par_chunks_exact(at::COUNT).with_min_len(row);
        stored.enumerate().zip(&mut colors.pixels).zip(guides).for_each(|(((i, stored), color), (albedo, normal))| {
            let pixel = PixelInputs::new(stored, selection, self.spread_at(i));
            let traced = Traced::of(stored, selection, self.spread_at(i));
            let sum: [f32; 4] = std::array::from_fn(|c| traced.own[c] + traced.others.iter().map(|other| other[c]).sum::<f32>());
            // The coverage of the pixel in its own samples.
            let covered = (traced.own[3] / traced.spp.max(1.0)).clamp(0.0, 1.0);
            let scale = if sum[3] > 0.0 { covered / sum[3] } else { 0.0 };
            let of = |c: usize| sum[c] * scale * pixel.tint[c] + (1.0 - covered) * stored[at::BACKGROUND + c];
            *color = [of(0), of(1), of(2)].map(|v| v.max(0.0) / exposure);
            *albedo = [0, 1, 2].map(|c| pixel.alpha * stored[at::ALBEDO + c]);
            *normal = [0, 1, 2].map(|c| stored[at::NORMAL + c]);
        });
        pictures
    }

    /// Adds the picture `place` that another denoiser made from samples, scene-linear and with the background.
    ///
    /// # Panics
    /// When `place` is not below [`PICTURES`].
    pub fn add_denoised(&mut self, place: usize, picture: &Rgb, exposure: f32) {
        assert!(place < PICTURES, "picture {place} of {PICTURES}");
        self.denoised[place] = true;
        self.each(|i, out| {
            let alpha = out[at::ALPHA];
            if alpha <= 0.0 {
                return;
            }
            let behind = |c: usize| (1.0 - alpha) * out[at::BACKGROUND + c];
            let surface: [f32; 3] = std::array::from_fn(|c| (exposure * finite(picture.pixels[i][c]) - behind(c)) / alpha);
            put(out, at::DENOISED + 3 * place, surface.map(difference));
        });
    }

    /// Adds the path-traced radiance, scene-linear, and the `raw` one before it was denoised, if it was.
    pub fn add_truth(&mut self, truth: &Rgb, raw: Option<&Rgb>, exposure: f32) {
        let raw = raw.unwrap_or(truth);
        self.each(|i, out| {
            for (at, picture) in [(at::TRUTH, truth), (at::RAW_TRUTH, raw)] {
                put(out, at, picture.pixels[i].map(|v| radiance(exposure * v)));
            }
        });
    }

    fn each(&mut self, f: impl Fn(usize, &mut [f32]) + Sync) {
        let row = self.width.max(1);
        self.pixels.par_chunks_exact_mut(at::COUNT).with_min_len(row).enumerate().for_each(|(i, out)| f(i, out));
    }
}

/// The environment behind each pixel that a surface covers in part, for [`Samples`]; 0 in all others.
pub fn background(camera: &Camera, alpha: &Image<f32>, environment: &Environment) -> Rgb {
    let mut out = Rgb::filled(alpha.width, alpha.height, [0.0; 3]);
    out.pixels.par_iter_mut().zip(&alpha.pixels).with_min_len(alpha.width.max(1)).enumerate().for_each(|(i, (out, alpha))| {
        if *alpha > 0.0 && *alpha < 1.0 {
            *out = environment.over_pixel(camera, (i % camera.width, i / camera.width));
        }
    });
    out
}

fn put(out: &mut [f32], from: usize, rgb: [f32; 3]) {
    out[from..from + 3].copy_from_slice(&rgb);
}

fn add(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|c| a[c] + b[c])
}

fn finite(v: f32) -> f32 {
    if v.is_finite() { v } else { 0.0 }
}

/// Median depth of the pixels that see a surface; 1 if none does.
fn median(depths: &[f32]) -> f32 {
    let mut known: Vec<f32> = depths.iter().copied().filter(|d| d.is_finite() && *d > 0.0).collect();
    if known.is_empty() {
        return 1.0;
    }
    let middle = known.len() / 2;
    *known.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::record::{Groups, MOST_CHANNELS, channels_of};

    /// Samples are joined as they were divided. A neighbour counts by its number of samples, and the frame's own samples decide
    /// how much of a pixel is covered.
    #[test]
    fn samples_are_put_together_as_they_were_taken_apart() {
        let mut record = Record::<f32>::new(4, 2);
        (record.parts[0], record.neighbours[0]) = (2, 6);
        for stored in record.pixels.chunks_exact_mut(at::COUNT) {
            stored[at::ALPHA] = 0.5;
            stored[at::ALBEDO..][..3].copy_from_slice(&[0.5, 0.25, 0.125]);
            stored[at::BACKGROUND..][..3].copy_from_slice(&[1.0; 3]);
            // Half covered, with a quotient of 2; the neighbour covers the whole pixel, with a quotient of 6.
            stored[at::SAMPLES..][..4].copy_from_slice(&[1.0, 1.0, 1.0, 0.5]);
            stored[at::NEARBY..][..4].copy_from_slice(&[6.0, 6.0, 6.0, 1.0]);
        }
        let all = Selection::all(&record);
        let alone = Selection { groups: Groups { neighbours: false, ..all.groups }, ..all };
        // No split sum is stored, so the reflectance is the albedo plus 0.02. The mean is over the covered samples, one of the
        // frame and six of the neighbour.
        for (chosen, mean) in [(alone, 2.0), (all, (2.0 + 6.0 * 6.0) / 7.0)] {
            let [color, albedo, normal] = record.noisy(&chosen, 4.0);
            for (c, tint) in [0.52, 0.27, 0.145].into_iter().enumerate() {
                let expected = (0.5 * mean * tint + 0.5) / 4.0;
                assert!((color.pixels[5][c] - expected).abs() < 1e-5, "{} and {expected}", color.pixels[5][c]);
            }
            assert_eq!((albedo.pixels[5], normal.pixels[5]), ([0.25, 0.125, 0.0625], [0.0; 3]));
        }
        // The same from the samples themselves, in another pixel, and with a third of them where only as many hold.
        let flat = |value: f32| Rgb::filled(2, 1, [value; 3]);
        let (mut raw, albedo, behind) = (flat(0.0), Rgb::filled(2, 1, [0.5, 0.25, 0.125]), flat(0.0));
        raw.pixels[1] = [0.52, 0.27, 0.145].map(|tint| 6.0 * tint / 4.0);
        let alpha = Image::filled(2, 1, 1.0);
        let samples =
            Samples { raw: &raw, alpha: &alpha, albedo: &albedo, background: &behind, spp: 6, counts: None, paths: None };
        let source = Image::filled(4, 2, Some(1));
        let shares = [1.0, 1.0 / 3.0, 0.0].map(|share| Image::filled(4, 2, share));
        let given = [None, Some(&shares[0]), Some(&shares[1]), Some(&shares[2])];
        for (share, held) in given.into_iter().zip([6.0, 6.0, 2.0, 0.0]) {
            record.add_neighbours(0, &[Nearby { samples, source: &source, share }], 4.0);
            let [color, ..] = record.noisy(&Selection::all(&record), 4.0);
            let expected = (0.5 * (2.0 + 6.0 * held) / (1.0 + held) * 0.52 + 0.5) / 4.0;
            assert!((color.pixels[5][0] - expected).abs() < 1e-5, "{held}: {} and {expected}", color.pixels[5][0]);
        }
        // Two frames in one sum: each of their samples counts as much.
        let near = |share| Nearby { samples, source: &source, share };
        record.add_neighbours(0, &[near(None), near(Some(&shares[1]))], 4.0);
        assert_eq!(record.neighbours[0], 12);
        let [color, ..] = record.noisy(&Selection::all(&record), 4.0);
        let expected = (0.5 * (2.0 + 6.0 * 8.0) / 9.0 * 0.52 + 0.5) / 4.0;
        assert!((color.pixels[5][0] - expected).abs() < 1e-5, "{} and {expected}", color.pixels[5][0]);
        // Where pixels have different numbers, each of their samples counts as much.
        let counts = Image { width: 2, height: 1, pixels: vec![9, 3] };
        let few = Samples { counts: Some(&counts), ..samples };
        record.add_neighbours(0, &[Nearby { samples: few, source: &source, share: None }], 4.0);
        let [color, ..] = record.noisy(&Selection::all(&record), 4.0);
        let expected = (0.5 * (2.0 + 3.0 * 6.0) / 4.0 * 0.52 + 0.5) / 4.0;
        assert!((color.pixels[5][0] - expected).abs() < 1e-5, "{} and {expected}", color.pixels[5][0]);
    }

    /// The share of the background and the surface of a denoised picture, or of samples, add up to the picture, also where the
    /// share alone is brighter: the background gives way.
    #[test]
    fn surface_and_background_add_up_to_the_picture() {
        let mut record = Record::<f32>::new(2, 1);
        for stored in record.pixels.chunks_exact_mut(at::COUNT) {
            stored[at::ALPHA] = 0.75;
            stored[at::ALBEDO..][..3].copy_from_slice(&[0.5; 3]);
            stored[at::BACKGROUND..][..3].copy_from_slice(&[40.0; 3]);
        }
        let behind = Rgb::filled(2, 1, [20.0; 3]);
        let picture = Rgb { width: 2, height: 1, pixels: vec![[1.0, 2.0, 3.0], [20.0, 30.0, 40.0]] };
        let (alpha, albedo) = (Image::filled(2, 1, 0.5), Rgb::filled(2, 1, [0.25; 3]));
        let samples =
            Samples { raw: &picture, alpha: &alpha, albedo: &albedo, background: &behind, spp: 4, counts: None, paths: None };
        record.add_part(0, &samples, 2.0);
        record.add_denoised(0, &picture, 2.0);
        let all = Selection::all(&record);
        let [noisy, ..] = record.noisy(&all, 2.0);
        let alone = Selection { groups: Groups { denoised: false, ..all.groups }, ..all };
        for (i, (stored, shown)) in record.pixels.chunks_exact(at::COUNT).zip(&picture.pixels).enumerate() {
            let [denoised, traced] = [all, alone].map(|selection| PixelInputs::new(stored, &selection, 1.0));
            let surfaces = [denoised.denoised.unwrap(), [0, 1, 2].map(|c| traced.own[c] / traced.own[3] * traced.tint[c])];
            for c in 0..3 {
                assert!(surfaces.iter().all(|surface| surface[c] >= 0.0));
                for (alpha, pixel, surface) in [(0.75, &denoised, surfaces[0]), (0.5, &traced, surfaces[1])] {
                    let sum = alpha * surface[c] + (1.0 - alpha) * pixel.background[c];
                    assert!((sum - 2.0 * shown[c]).abs() < 1e-4, "{sum} and {shown:?}");
                }
                assert!((noisy.pixels[i][c] - shown[c]).abs() < 1e-4, "{:?} and {shown:?}", noisy.pixels[i]);
            }
        }
    }

    /// What samples are made of is divided as they are. Parts count by their samples, and one sample does not vary.
    #[test]
    fn parts_join_what_their_samples_are_made_of() {
        let mut record = Record::<f32>::new(2, 1);
        for stored in record.pixels.chunks_exact_mut(at::COUNT) {
            stored[at::ALPHA] = 0.5;
        }
        let flat = |value: f32| Rgb::filled(2, 1, [value; 3]);
        let (raw, alpha, albedo, behind) = (flat(1.0), Image::filled(2, 1, 0.5), flat(0.24), flat(0.0));
        let samples =
            Samples { raw: &raw, alpha: &alpha, albedo: &albedo, background: &behind, spp: 1, counts: None, paths: None };
        // The reflectance is .48 + .02. Four samples with a variance of their mean of .25 have one of 1 each.
        let given = [[0.5, 2.0, 9.0], [0.25, 0.5, 0.25]].map(|given| given.map(flat));
        for (part, ([indirect, hidden, variance], spp)) in given.iter().zip([1, 4]).enumerate() {
            let paths = Some(Paths { indirect, hidden, variance });
            record.add_part(part, &Samples { spp, paths, ..samples }, 2.0);
        }
        assert!(record.paths && record.groups().paths);
        let selection = Selection::all(&record);
        let pixel = PixelInputs::new(&record.pixels[..at::COUNT], &selection, 1.0);
        let expected = [(0.5 + 4.0 * 0.25) * 4.0, (2.0 + 4.0 * 0.5) * 4.0, 4.0];
        for (k, value) in pixel.paths.iter().enumerate() {
            assert!((value - expected[k / 3]).abs() < 1e-5, "{k}: {value}");
        }
        // As samples, they are shown over their coverage: five samples that cover half a pixel.
        let mut channels = [0.0; MOST_CHANNELS];
        channels_of(&record.pixels[..at::COUNT], &pixel, &selection, &selection.amounts(), &mut channels);
        let from = selection.groups.channels() - PATHS;
        let log = |v: f32| {
            let mut curved = [v];
            crate::bridge::log_curves(&mut curved);
            curved[0]
        };
        for (k, channel) in channels[from..from + PATHS].iter().enumerate() {
            let value = if k < 6 { expected[k / 3] / 2.5 } else { expected[2] };
            assert!((channel - log(value)).abs() < 1e-4, "{k}: {channel}");
        }
        // A part of which nothing is known leaves them out.
        record.add_part(2, &samples, 2.0);
        assert!(!record.paths && !Selection::all(&record).groups.paths);
    }

    /// The network is told the number of samples of each pixel, in the frame's own part, and coverage stays what it was.
    #[test]
    fn pixels_say_how_many_samples_they_have() {
        let [raw, albedo, behind] = [(); 3].map(|()| Rgb::filled(4, 2, [0.5; 3]));
        let alpha = Image::filled(4, 2, 0.5);
        let mut counts = Image::filled(4, 2, 4);
        counts.pixels[5] = 16;
        let even = Samples { raw: &raw, alpha: &alpha, albedo: &albedo, background: &behind, spp: 4, counts: None, paths: None };
        let read = |samples: Samples| {
            let mut record = Record::<f32>::new(4, 2);
            record.pixels.chunks_exact_mut(at::COUNT).for_each(|stored| stored[at::ALPHA] = 0.5);
            record.add_part(0, &samples, 1.0);
            let selection = Selection::all(&record);
            [4, 5].map(|i| {
                let stored = &record.pixels[i * at::COUNT..][..at::COUNT];
                let pixel = PixelInputs::new(stored, &selection, record.spread_at(i));
                let mut channels = [0.0; MOST_CHANNELS];
                channels_of(stored, &pixel, &selection, &selection.amounts(), &mut channels);
                (pixel.spp, pixel.own[3], channels[at::BACKGROUND + 3..at::BACKGROUND + 5].to_vec())
            })
        };
        let [usual, same] = read(even);
        assert_eq!(usual, same);
        let [other, more] = read(Samples { counts: Some(&counts), ..even });
        assert_eq!(other, usual);
        assert_eq!((more.0, more.1, more.2[0]), (16.0, 8.0, usual.2[0]));
        assert!((more.2[1] - 0.3 * 17.0_f32.ln()).abs() < 1e-6 && (usual.2[1] - 0.3 * 5.0_f32.ln()).abs() < 1e-6);
    }
}
