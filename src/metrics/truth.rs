//! The truth of one frame, and pictures compared with it.

use super::flip::{Seen, Viewing};
use super::psnr::{capped, psnr, psnr_masked};
use super::relmse::{relative_errors, same_size, trimmed_mean};
use super::{Metrics, masked_mean, ssim::ssim_map};
use anyhow::{Context, Result, bail};
use renderflow_frame::Image;
use renderflow_frame::image::Rgb;
use renderflow_model::lpips::{Backbone, Lpips, Reference, weights_folder};
use std::path::Path;

/// Largest share of pixels that the robust relative error leaves out.
const ROBUST_SHARE: f64 = 0.001;

/// The LPIPS networks whose weights are there.
#[derive(Debug, Default)]
pub struct Networks {
    /// AlexNet.
    pub alex: Option<Lpips>,
    /// SqueezeNet.
    pub squeeze: Option<Lpips>,
}

impl Networks {
    /// Loads both from the folder that the user names in the environment; without a name, there are none.
    ///
    /// # Errors
    /// When a file is broken or missing.
    pub fn find() -> Result<Self> {
        weights_folder().map_or_else(|| Ok(Self::default()), |folder| Self::read(&folder))
    }

    /// Loads both from a folder.
    ///
    /// # Errors
    /// When a file is broken or missing.
    pub fn read(folder: &Path) -> Result<Self> {
        let load = |backbone: Backbone| Lpips::load(folder, backbone).map(Some);
        Ok(Self { alex: load(Backbone::Alex)?, squeeze: load(Backbone::Squeeze)? })
    }

    fn all(&self) -> [Option<&Lpips>; 2] {
        [self.alex.as_ref(), self.squeeze.as_ref()]
    }
}

/// Radiance of a picture, for the relative error.
#[derive(Clone, Copy, Debug)]
pub struct Hdr<'a> {
    /// Scene-linear radiance.
    pub linear: &'a Rgb,
    /// Factor of the sequence from scene-linear to display-linear.
    pub exposure: f32,
}

impl Hdr<'_> {
    fn exposed(&self) -> Rgb {
        self.linear.map(|p| p.map(|v| v * self.exposure))
    }
}

/// The truth of one frame with what every comparison with it needs: the features of LPIPS and FLIP are half of their cost.
pub struct Truth<'a> {
    picture: &'a Rgb,
    mask: Option<&'a Image<f32>>,
    exposed: Option<Rgb>,
    seen: Seen,
    networks: [Option<(&'a Lpips, Reference)>; 2],
}

impl<'a> Truth<'a> {
    /// `picture`: display values in 0..=1. `mask`: coverage, the object is where it is above 0; without it the values over the
    /// object are absent. `hdr`: the radiance; without it the relative errors are absent. All of one size.
    ///
    /// # Errors
    /// When sizes differ, there are no pixels, or a value is not finite.
    pub fn new(picture: &'a Rgb, mask: Option<&'a Image<f32>>, hdr: Option<Hdr<'_>>, networks: &'a Networks) -> Result<Self> {
        check(picture, picture).context("display values of the truth")?;
        if let Some(mask) = mask
            && ((mask.width, mask.height) != (picture.width, picture.height) || mask.pixels.len() != picture.pixels.len())
        {
            let (w, h) = (picture.width, picture.height);
            bail!("the mask has {} x {} pixels, the truth {w} x {h}", mask.width, mask.height);
        }
        let exposed = hdr.map(|hdr| hdr.exposed());
        if let Some(exposed) = &exposed {
            check(exposed, picture).context("radiance of the truth")?;
        }
        let side = picture.width.min(picture.height);
        let reference = |network: Option<&'a Lpips>| -> Result<_> {
            let Some(network) = network.filter(|n| n.backbone().smallest_side() <= side) else { return Ok(None) };
            Ok(Some((network, network.reference(picture)?)))
        };
        let [alex, squeeze] = networks.all();
        Ok(Self {
            picture,
            mask,
            exposed,
            seen: Seen::new(picture, Viewing::default()).context("FLIP of the truth")?,
            networks: [reference(alex)?, reference(squeeze)?],
        })
    }

    /// Compares a picture of display values with the truth; `hdr` is its radiance, where its method makes any.
    /// [`Metrics::temporal`] is left absent.
    ///
    /// # Errors
    /// When sizes differ or a value is not finite.
    pub fn measure(&self, picture: &Rgb, hdr: Option<Hdr<'_>>) -> Result<Metrics> {
        check(picture, self.picture).context("display values")?;
        let ssim = ssim_map(picture, self.picture);
        let flip = Seen::new(picture, Viewing::default()).and_then(|seen| seen.compare(&self.seen));
        let lpips = |i: usize| -> Result<Option<f64>> {
            let Some((network, reference)) = &self.networks[i] else { return Ok(None) };
            Ok(Some(f64::from(network.distance_to(picture, reference)?)))
        };
        let mut metrics = Metrics {
            psnr: self.mask.and_then(|mask| psnr_masked(picture, self.picture, mask)).map(capped),
            psnr_full: Some(capped(psnr(picture, self.picture))),
            ssim: ssim.as_ref().map(|s| s.mean),
            ssim_object: ssim.as_ref().zip(self.mask).and_then(|(s, mask)| s.masked(mask)),
            lpips_alex: lpips(0)?,
            lpips_squeeze: lpips(1)?,
            flip: flip.as_ref().map(|f| f.mean),
            flip_object: flip.as_ref().zip(self.mask).and_then(|(f, mask)| f.masked(mask)),
            ..Metrics::default()
        };
        if let (Some(hdr), Some(truth)) = (hdr, &self.exposed) {
            let exposed = hdr.exposed();
            check(&exposed, truth).context("radiance")?;
            let errors = relative_errors(&exposed, truth)?;
            metrics.rel_mse = Some(errors.iter().sum::<f64>() / errors.len() as f64);
            metrics.rel_mse_object = self.mask.and_then(|mask| masked_mean(errors.iter().copied(), mask));
            metrics.rel_mse_robust = Some(trimmed_mean(&errors, ROBUST_SHARE));
        }
        Ok(metrics)
    }
}

/// Fails for sizes that differ, no pixels, and values that are not finite.
fn check(picture: &Rgb, truth: &Rgb) -> Result<()> {
    same_size(picture, truth)?;
    let (width, height, count) = (picture.width, picture.height, picture.pixels.len());
    if count != width * height {
        bail!("{count} pixels in a picture of {width} x {height}");
    }
    if let Some(i) = picture.pixels.iter().position(|p| p.iter().any(|v| !v.is_finite())) {
        bail!("pixel ({}, {}) is not finite", i % width, i / width);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::flip::{Seen, Viewing};
    use crate::metrics::psnr::CAP;
    use crate::metrics::ssim::ssim;
    use crate::metrics::{METRICS, values};
    use rayon::prelude::*;

    /// One comparison.
    fn measure(
        picture: &Rgb,
        truth: &Rgb,
        mask: Option<&Image<f32>>,
        hdr: Option<[Hdr<'_>; 2]>,
        networks: &Networks,
    ) -> Result<Metrics> {
        let [picture_hdr, truth_hdr] = hdr.map_or([None; 2], |both| both.map(Some));
        Truth::new(truth, mask, truth_hdr, networks)?.measure(picture, picture_hdr)
    }

    fn picture(width: usize, height: usize, phase: f32) -> Rgb {
        Rgb::from_fn(width, height, |x, y| {
            [0, 1, 2].map(|c| 0.5 + 0.4 * (0.2 * x as f32 + (0.1 + 0.1 * c as f32) * y as f32 + phase).sin())
        })
    }

    fn half(width: usize, height: usize) -> Image<f32> {
        Image::from_fn(width, height, |x, _| if x >= width / 2 { 0.25 } else { 0.0 })
    }

    #[test]
    fn every_value_is_that_of_its_own_function() {
        let (a, b, mask) = (picture(45, 38, 0.0), picture(45, 38, 0.4), half(45, 38));
        let networks = Networks::find().unwrap();
        let hdr = [&a, &b].map(|linear| Hdr { linear, exposure: 2.0 });
        let metrics = measure(&a, &b, Some(&mask), Some(hdr), &networks).unwrap();
        assert_eq!(metrics.psnr, psnr_masked(&a, &b, &mask));
        assert_eq!(metrics.psnr_full, Some(psnr(&a, &b)));
        assert_eq!(metrics.ssim, ssim(&a, &b));
        assert_eq!(metrics.ssim_object, ssim_map(&a, &b).unwrap().masked(&mask));
        let seen = |picture| Seen::new(picture, Viewing::default()).unwrap();
        let map = seen(&a).compare(&seen(&b)).unwrap();
        assert_eq!((metrics.flip, metrics.flip_object), (Some(map.mean), map.masked(&mask)));
        assert_eq!(metrics.temporal, None);
        for (value, network) in [(metrics.lpips_alex, &networks.alex), (metrics.lpips_squeeze, &networks.squeeze)] {
            assert_eq!(value, network.as_ref().map(|n| f64::from(n.distance(&a, &b).unwrap())));
        }
        let double = |p: &Rgb| p.map(|p| p.map(|v| 2.0 * v));
        let errors = relative_errors(&double(&a), &double(&b)).unwrap();
        assert_eq!(metrics.rel_mse, Some(errors.iter().sum::<f64>() / errors.len() as f64));
        // 1710 pixels: one is left out.
        let largest = errors.iter().copied().fold(0.0, f64::max);
        let robust = (errors.iter().sum::<f64>() - largest) / 1709.0;
        assert!((metrics.rel_mse_robust.unwrap() - robust).abs() < 1e-12);
        assert!(metrics.rel_mse_object.is_some() && metrics.rel_mse_object != metrics.rel_mse);
        let text = serde_json::to_string(&metrics).unwrap();
        assert_eq!(serde_json::from_str::<Metrics>(&text).unwrap(), metrics, "{text}");
        for metric in METRICS {
            assert!(text.contains(&format!("{:?}:", metric.id)), "{text}");
        }
    }

    #[test]
    fn equal_pictures_have_the_cap() {
        let (a, mask) = (picture(45, 38, 0.0), half(45, 38));
        let none = Networks::default();
        let hdr = Hdr { linear: &a, exposure: 1.0 };
        let same = measure(&a, &a, Some(&mask), Some([hdr; 2]), &none).unwrap();
        assert_eq!((same.psnr, same.psnr_full), (Some(CAP), Some(CAP)));
        assert_eq!((same.ssim, same.ssim_object, same.flip, same.flip_object), (Some(1.0), Some(1.0), Some(0.0), Some(0.0)));
        assert_eq!((same.rel_mse, same.rel_mse_object, same.rel_mse_robust), (Some(0.0), Some(0.0), Some(0.0)));
    }

    #[test]
    fn what_cannot_be_measured_is_absent() {
        let networks = Networks::find().unwrap();
        let (a, b) = (picture(7, 1, 0.0), picture(7, 1, 1.0));
        let tiny = measure(&a, &b, None, None, &networks).unwrap();
        assert_eq!(values(&tiny).unwrap().into_keys().collect::<Vec<_>>(), ["flip", "psnr_full"]);
        let empty = Image::filled(20, 20, 0.0);
        let (a, b) = (picture(20, 20, 0.0), picture(20, 20, 1.0));
        let metrics = measure(&a, &b, Some(&empty), None, &networks).unwrap();
        assert_eq!((metrics.psnr, metrics.ssim_object, metrics.flip_object, metrics.lpips_alex), (None, None, None, None));
        assert_eq!(metrics.lpips_squeeze.is_some(), networks.squeeze.is_some());
        // Radiance of one of the two is no use.
        let truth = Truth::new(&b, None, None, &networks).unwrap();
        assert_eq!(truth.measure(&a, Some(Hdr { linear: &a, exposure: 1.0 })).unwrap().rel_mse, None);
    }

    #[test]
    fn bad_pictures_are_named() {
        let none = Networks::default();
        let a = picture(12, 12, 0.0);
        let mut broken = a.clone();
        broken.pixels[15][2] = f32::NAN;
        let words = |result: Result<Metrics>| format!("{:#}", result.unwrap_err());
        assert!(words(measure(&broken, &a, None, None, &none)).contains("pixel (3, 1)"));
        assert!(words(measure(&a, &broken, None, None, &none)).contains("of the truth"));
        let hdr = [&broken, &a].map(|linear| Hdr { linear, exposure: 1.0 });
        assert!(words(measure(&a, &a, None, Some(hdr), &none)).contains("radiance: pixel (3, 1)"));
        assert!(words(measure(&a, &picture(12, 13, 0.0), None, None, &none)).contains("12 x 13"));
        assert!(words(measure(&a, &a, Some(&half(12, 11)), None, &none)).contains("12 x 11"));
        assert!(measure(&Rgb::default(), &Rgb::default(), None, None, &none).is_err());
        let cut = Rgb { width: 12, height: 12, pixels: vec![[0.0; 3]; 100] };
        assert!(measure(&cut, &a, None, None, &none).is_err());
    }

    #[test]
    fn many_at_once_are_the_same_as_one_by_one() {
        let networks = Networks::find().unwrap();
        let (truth_picture, mask) = (picture(45, 38, 0.0), half(45, 38));
        let truth = Truth::new(&truth_picture, Some(&mask), None, &networks).unwrap();
        let pictures: Vec<Rgb> = (0..12).map(|i| picture(45, 38, 0.1 * i as f32)).collect();
        let measured = |threads: usize| -> Vec<Metrics> {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| pictures.par_iter().map(|p| truth.measure(p, None).unwrap()).collect())
        };
        let alone = measured(1);
        assert_eq!(alone, measured(4));
        assert_eq!(alone, pictures.iter().map(|p| truth.measure(p, None).unwrap()).collect::<Vec<_>>());
    }
}
