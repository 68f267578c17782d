//! The references of a run's validation: the inputs of the network, and OIDN on the same samples.

use anyhow::Result;
use half::f16;
use renderflow_model::fusion::batch::Tier;
use renderflow_model::fusion::record::{PixelInputs, Stored, at};
use renderflow_model::fusion::training::{psnr, validate, variants};
use renderflow_model::fusion::{Fusion, FusionConfig, Record};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// PSNR in dB over covered pixels, by kind of input. Each is a mean over the validation frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct References {
    /// PSNR of the best input, which is the picture that an untrained network returns.
    pub(super) inputs: BTreeMap<String, f32>,
    /// PSNR of OIDN on the same samples, guided by albedo and normals; empty without a denoiser.
    pub(super) oidn: BTreeMap<String, f32>,
}

impl References {
    /// Measures both for the inputs of `tiers`.
    pub(super) fn measure(network: &FusionConfig, validation: &[Record<f16>], tiers: &[Tier]) -> Result<Self> {
        let inputs = validate(&Fusion::untrained(network, 0)?, validation, tiers)?;
        let mut oidn: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        for record in validation {
            for (name, selection) in
                variants(record, tiers).into_iter().filter(|(_, selection)| selection.groups.denoised && !selection.groups.keys)
            {
                let mut stored = [0.0; at::COUNT];
                let picture: Vec<[f32; 3]> = record
                    .pixels
                    .chunks_exact(at::COUNT)
                    .map(|pixel| {
                        f16::read(pixel, &mut stored);
                        let pixel = PixelInputs::new(&stored, &selection, 1.0);
                        let surface = pixel.denoised.unwrap_or_default();
                        [0, 1, 2].map(|c| pixel.alpha * surface[c] + (1.0 - pixel.alpha) * pixel.background[c])
                    })
                    .collect();
                let psnr = psnr(record, &picture);
                // The network reads the same samples with and without the denoised picture.
                for name in [name.replace("denoised", "rays"), name] {
                    oidn.entry(name).or_default().push(psnr);
                }
            }
        }
        let mean = |values: Vec<f64>| (values.iter().sum::<f64>() / values.len() as f64) as f32;
        Ok(Self { inputs, oidn: oidn.into_iter().map(|(name, values)| (name, mean(values))).collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use renderflow_frame::image::Rgb;
    use renderflow_model::fusion::batch::TIERS;

    /// Half of each pixel shows the environment. Surface and environment are separated, and joined again.
    #[test]
    fn a_denoised_picture_that_is_the_truth_has_no_error() {
        let mut record = Record::<f32>::new(16, 16);
        record.parts = [2, 0, 0, 0];
        for stored in record.pixels.chunks_exact_mut(at::COUNT) {
            stored[at::ALPHA] = 0.5;
            stored[at::BACKGROUND..][..3].copy_from_slice(&[0.25; 3]);
            stored[at::SAMPLES..][..4].copy_from_slice(&[0.5, 0.5, 0.5, 0.5]);
            for truth in [at::TRUTH, at::RAW_TRUTH] {
                stored[truth..][..3].copy_from_slice(&[0.5; 3]);
            }
        }
        record.add_denoised(0, &Rgb::filled(16, 16, [0.25; 3]), 2.0);
        let record = record.to_half();
        let references = References::measure(&FusionConfig::default(), &[record], &TIERS).expect("both are measured");
        assert_eq!(references.inputs.keys().collect::<Vec<_>>(), ["denoised 2", "rays 2"]);
        assert_eq!(
            references.oidn.into_iter().collect::<Vec<_>>(),
            [("denoised 2".to_owned(), 100.0), ("rays 2".to_owned(), 100.0)]
        );
    }
}
