//! The metrics as tables name them.

use super::Metrics;
use anyhow::Result;
use std::collections::BTreeMap;

/// A metric as tables name it.
#[derive(Clone, Copy, Debug)]
pub struct Metric {
    /// Key in scores: the name of its field in [`Metrics`].
    pub id: &'static str,
    /// Head of a column.
    pub label: &'static str,
    /// What it is, in a sentence.
    pub meaning: &'static str,
    /// Digits after the point.
    pub digits: usize,
    /// Whether more is better.
    pub rising: bool,
}

/// Every metric, in the order of columns.
pub const METRICS: &[Metric] = &[
    Metric { id: "psnr", label: "PSNR", meaning: "dB over pixels that an object covers; 100 at most", digits: 2, rising: true },
    Metric {
        id: "psnr_full",
        label: "PSNR full",
        meaning: "dB over the full frame with the environment behind",
        digits: 2,
        rising: true,
    },
    Metric { id: "ssim", label: "SSIM", meaning: "structural similarity, full frame", digits: 4, rising: true },
    Metric {
        id: "ssim_object",
        label: "SSIM object",
        meaning: "structural similarity at covered pixels",
        digits: 4,
        rising: true,
    },
    Metric {
        id: "lpips_alex",
        label: "LPIPS",
        meaning: "learned perceptual distance (AlexNet), full frame",
        digits: 4,
        rising: false,
    },
    Metric {
        id: "lpips_squeeze",
        label: "LPIPS squeeze",
        meaning: "learned perceptual distance (SqueezeNet), full frame",
        digits: 4,
        rising: false,
    },
    Metric {
        id: "flip",
        label: "FLIP",
        meaning: "difference seen when two pictures are flipped, full frame",
        digits: 4,
        rising: false,
    },
    Metric {
        id: "flip_object",
        label: "FLIP object",
        meaning: "difference seen when two pictures are flipped, covered pixels",
        digits: 4,
        rising: false,
    },
    Metric {
        id: "rel_mse",
        label: "relMSE",
        meaning: "mean of squared error over squared truth + 0.01, exposed linear radiance, full frame",
        digits: 4,
        rising: false,
    },
    Metric { id: "rel_mse_object", label: "relMSE object", meaning: "relMSE over covered pixels", digits: 4, rising: false },
    Metric {
        id: "rel_mse_robust",
        label: "relMSE robust",
        meaning: "relMSE without the 0.1 % of pixels with the largest error, full frame",
        digits: 4,
        rising: false,
    },
    Metric {
        id: "temporal",
        label: "temporal",
        meaning: "mean difference of what changes from the frame before, both carried by the truth's motion; 1000 = white",
        digits: 2,
        rising: false,
    },
];

/// Metrics that could be computed, by the name they have in [`METRICS`].
///
/// # Errors
/// Never, as long as [`Metrics`] can be written as JSON.
pub fn values(metrics: &Metrics) -> Result<BTreeMap<String, f64>> {
    let serde_json::Value::Object(fields) = serde_json::to_value(metrics)? else { return Ok(BTreeMap::new()) };
    let known = |id: &str| METRICS.iter().any(|metric| metric.id == id);
    Ok(fields.into_iter().filter_map(|(id, value)| Some((id, value.as_f64()?))).filter(|(id, _)| known(id)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_metric_has_a_column() {
        let one = serde_json::to_value(Metrics::default()).unwrap();
        let fields: Vec<&String> = one.as_object().unwrap().keys().collect();
        for metric in METRICS {
            assert!(fields.contains(&&metric.id.to_owned()), "{}", metric.id);
        }
        assert_eq!(fields.len(), METRICS.len());
    }
}
