//! What a run is measured against: the pictures that the network is handed, and OIDN on the same samples.

use anyhow::Result;
use half::f16;
use renderflow_frame::image::Rgb;
use renderflow_model::fusion::record::{Chosen, Known, at};
use renderflow_model::fusion::training::{psnr, validate, variants};
use renderflow_model::fusion::{Fusion, FusionConfig, Record};
use renderflow_renderer::denoise::Denoiser;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// PSNR in dB over covered pixels, by tier: means over the frames that a run is validated on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct References {
    /// Of what an untrained network gives.
    pub(super) handed: BTreeMap<String, f32>,
    /// Of OIDN on the frame's own samples, guided by albedo and normals of the G-buffer; empty without a denoiser.
    pub(super) oidn: BTreeMap<String, f32>,
}

impl References {
    /// Measures both.
    pub(super) fn measure(network: &FusionConfig, validation: &[Record<f16>]) -> Result<Self> {
        let handed = validate(&Fusion::untrained(network, 0)?, validation)?;
        let mut oidn: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        if let Ok(mut denoiser) = Denoiser::new() {
            for record in validation {
                let own = |chosen: &Chosen| chosen.groups.samples && !chosen.groups.keys && !chosen.groups.neighbours;
                for (name, chosen) in variants(record).into_iter().filter(|(_, chosen)| own(chosen)) {
                    let [color, albedo, normal] = samples(record, &chosen);
                    let denoised = denoiser.denoise(&color, Some(&albedo), Some(&normal))?;
                    oidn.entry(name).or_default().push(psnr(record, &denoised.pixels));
                }
            }
        }
        let mean = |values: Vec<f64>| (values.iter().sum::<f64>() / values.len() as f64) as f32;
        Ok(Self { handed, oidn: oidn.into_iter().map(|(name, values)| (name, mean(values))).collect() })
    }
}

/// Mean radiance of the chosen samples, and the guides of the frame. The tint that samples were divided by is that of the pixel, so that edges
/// come out a little cleaner than they were.
fn samples(record: &Record<f16>, chosen: &Chosen) -> [Rgb; 3] {
    let mut pictures = [(); 3].map(|()| Rgb { width: record.width, height: record.height, pixels: Vec::new() });
    let mut stored = [0.0; at::COUNT];
    for pixel in record.pixels.chunks_exact(at::COUNT) {
        for (to, from) in stored.iter_mut().zip(pixel) {
            *to = from.to_f32();
        }
        let known = Known::new(&stored, chosen);
        let own = known.own.map(|v| v / chosen.spp);
        let color = |c: usize| own[c] * known.tint[c] + (1.0 - own[3]) * known.background[c];
        let albedo = |c: usize| known.alpha * stored[at::ALBEDO + c];
        let normal = |c: usize| stored[at::NORMAL + c];
        let all = [[color(0), color(1), color(2)], [albedo(0), albedo(1), albedo(2)], [normal(0), normal(1), normal(2)]];
        pictures.iter_mut().zip(all).for_each(|(picture, rgb)| picture.pixels.push(rgb));
    }
    pictures
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is put together is what was taken apart: full coverage, one sample over its tint.
    #[test]
    fn samples_are_put_together_as_they_were_taken_apart() {
        let mut record = Record::<f32>::new(16, 16);
        record.parts = [2, 0, 0, 0];
        for stored in record.pixels.chunks_exact_mut(at::COUNT) {
            stored[at::ALPHA] = 1.0;
            stored[at::ALBEDO..][..3].copy_from_slice(&[0.5, 0.25, 0.125]);
            stored[at::SAMPLES..][..4].copy_from_slice(&[2.0, 4.0, 8.0, 1.0]);
            stored[at::TRUTH..][..3].copy_from_slice(&[0.3; 3]);
        }
        let record = record.to_half();
        let [color, albedo, normal] = samples(&record, &Chosen::all(&record));
        // Diffuse albedo and the least that samples are divided by; no split sum is stored.
        let expected = [2.0 * 0.52, 4.0 * 0.27, 8.0 * 0.145];
        for (found, expected) in color.pixels[5].into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-3, "{found} and {expected}");
        }
        assert_eq!((albedo.pixels[5], normal.pixels[5]), ([0.5, 0.25, 0.125], [0.0; 3]));
        let references = References::measure(&FusionConfig::default(), &[record]).expect("both are measured");
        assert_eq!(references.handed.keys().collect::<Vec<_>>(), ["rays 2"]);
    }
}
