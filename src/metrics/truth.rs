//! The truth of one frame, and pictures compared with it.

use super::flip::{Seen, Viewing};
use super::psnr::{capped, psnr, psnr_masked};
use super::relmse::{relative_errors, same_size, trimmed_mean};
use super::{Metrics, masked_mean, ssim::ssim_map};
use anyhow::{Context, Result, bail};
use renderflow_frame::Image;
use renderflow_frame::image::Rgb;
use renderflow_model::lpips::{Backbone, Lpips, Reference, weights_folder};

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
    /// Loads both from [`weights_folder`]. Weights that are missing there are no failure, unless somebody named the folder.
    ///
    /// # Errors
    /// When a file is there but broken, or missing from a folder that was named.
    pub fn find() -> Result<Self> {
        let location = weights_folder();
        let load = |backbone: Backbone| {
            if !location.named && !location.folder.join(backbone.file_name()).exists() {
                return Ok(None);
            }
            Lpips::load(&location.folder, backbone).map(Some)
        };
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

/// One comparison; where several pictures have the same truth, [`Truth`] is cheaper.
///
/// # Errors
/// As [`Truth::new`] and [`Truth::measure`].
pub fn measure(
    picture: &Rgb,
    truth: &Rgb,
    mask: Option<&Image<f32>>,
    hdr: Option<[Hdr<'_>; 2]>,
    networks: &Networks,
) -> Result<Metrics> {
    let [picture_hdr, truth_hdr] = hdr.map_or([None; 2], |both| both.map(Some));
    Truth::new(truth, mask, truth_hdr, networks)?.measure(picture, picture_hdr)
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
