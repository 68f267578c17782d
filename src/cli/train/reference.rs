//! What a run is measured against: the pictures that the network is handed, and OIDN on the same samples.

use anyhow::Result;
use half::f16;
use renderflow_model::fusion::record::{Known, Stored, at};
use renderflow_model::fusion::training::{psnr, validate, variants};
use renderflow_model::fusion::{Fusion, FusionConfig, Record};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// PSNR in dB over covered pixels, by tier: means over the frames that a run is validated on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct References {
    /// Of what an untrained network gives.
    pub(super) handed: BTreeMap<String, f32>,
    /// Of OIDN on the same samples, guided by albedo and normals of the G-buffer; empty without a denoiser.
    pub(super) oidn: BTreeMap<String, f32>,
}

impl References {
    /// Measures both.
    pub(super) fn measure(network: &FusionConfig, validation: &[Record<f16>]) -> Result<Self> {
        let handed = validate(&Fusion::untrained(network, 0)?, validation)?;
        let mut oidn: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        for record in validation {
            for (name, chosen) in variants(record).into_iter().filter(|(_, chosen)| chosen.groups.denoised && !chosen.groups.keys)
            {
                let mut stored = [0.0; at::COUNT];
                let picture: Vec<[f32; 3]> = record
                    .pixels
                    .chunks_exact(at::COUNT)
                    .map(|pixel| {
                        f16::read(pixel, &mut stored);
                        let known = Known::new(&stored, &chosen);
                        let surface = known.denoised.unwrap_or_default();
                        [0, 1, 2].map(|c| known.alpha * surface[c] + (1.0 - known.alpha) * known.background[c])
                    })
                    .collect();
                let psnr = psnr(record, &picture);
                // The same samples are read with and without the denoised picture.
                for name in [name.replace("denoised", "rays"), name] {
                    oidn.entry(name).or_default().push(psnr);
                }
            }
        }
        let mean = |values: Vec<f64>| (values.iter().sum::<f64>() / values.len() as f64) as f32;
        Ok(Self { handed, oidn: oidn.into_iter().map(|(name, values)| (name, mean(values))).collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use renderflow_frame::image::Rgb;

    /// Half of a pixel shows the environment: what was taken apart is put together.
    #[test]
    fn a_denoised_picture_that_is_the_truth_has_no_error() {
        let mut record = Record::<f32>::new(16, 16);
        record.parts = [2, 0, 0, 0];
        for stored in record.pixels.chunks_exact_mut(at::COUNT) {
            stored[at::ALPHA] = 0.5;
            stored[at::BACKGROUND..][..3].copy_from_slice(&[0.25; 3]);
            stored[at::SAMPLES..][..4].copy_from_slice(&[0.5, 0.5, 0.5, 0.5]);
            stored[at::TRUTH..][..3].copy_from_slice(&[0.5; 3]);
        }
        record.add_denoised(0, &Rgb::filled(16, 16, [0.25; 3]), 2.0);
        let record = record.to_half();
        let references = References::measure(&FusionConfig::default(), &[record]).expect("both are measured");
        assert_eq!(references.handed.keys().collect::<Vec<_>>(), ["denoised 2", "rays 2"]);
        assert_eq!(
            references.oidn.into_iter().collect::<Vec<_>>(),
            [("denoised 2".to_owned(), 100.0), ("rays 2".to_owned(), 100.0)]
        );
    }
}
