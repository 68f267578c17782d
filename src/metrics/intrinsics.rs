//! How far recovered buffers are from the true ones. Everything is over the pixels that see a surface, one picture at a time.
//!
//! Sources: thresholds of angles, Fouhey et al. 2013; relative error and threshold of depth, Eigen et al. 2014, here after scale
//! and shift of its logarithm, as the loss it is trained with leaves the shift open; PSNR, LPIPS, angle and root of the mean
//! square are the columns of RenderFlow's table of inverse rendering.

use super::psnr::{capped, psnr_masked};
use super::{Networks, masked_mean};
use anyhow::{Result, ensure};
use renderflow_frame::image::Rgb;
use renderflow_frame::{Image, color};
use serde::Serialize;
use std::collections::BTreeMap;

/// A normal counts as found below this angle, in degrees: the smallest of the usual three.
const NEAR: f64 = 11.25;
/// A depth counts as found below this quotient.
const CLOSE: f64 = 1.25;

/// Something that is measured.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Column {
    /// Its key in the result of [`measure`].
    pub id: &'static str,
    /// What it is, with its unit.
    pub name: &'static str,
    /// Digits that a table shows.
    #[serde(skip)]
    pub digits: usize,
}

const fn column(id: &'static str, name: &'static str, digits: usize) -> Column {
    Column { id, name, digits }
}

/// Everything that [`measure`] computes.
pub const COLUMNS: [Column; 10] = [
    column("albedo_psnr", "albedo, PSNR of sRGB values (dB)", 2),
    column("albedo_psnr_scaled", "albedo, PSNR after the least-squares factor of each linear channel (dB)", 2),
    column("albedo_lpips", "albedo, LPIPS (AlexNet) with the true picture where nothing is seen", 3),
    column("normal_mean", "normals, mean angle (degrees)", 1),
    column("normal_median", "normals, median angle (degrees)", 1),
    column("normal_near", "normals, share within 11.25 degrees", 3),
    column("depth_relative", "depth, mean of |z' - z| / z after scale and shift of its logarithm", 3),
    column("depth_close", "depth, share with max(z'/z, z/z') < 1.25, likewise", 3),
    column("roughness_rms", "roughness, root of the mean square", 3),
    column("metallic_rms", "metallic, root of the mean square", 3),
];

/// Buffers of one picture, all of equal size; `None` for buffers that were not recovered.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Buffers {
    /// Base colour in sRGB, 0..=1.
    pub albedo: Option<Rgb>,
    /// Normals, of any length but 0.
    pub normal: Option<Rgb>,
    /// Logarithm of planar depth; a recovered one is known up to scale and shift.
    pub depth: Option<Image<f32>>,
    /// Roughness, metallic, and whatever the third channel holds, 0..=1.
    pub material: Option<Rgb>,
}

/// Compares `found` with `truth` where `mask` is above 0; values by [`Column::id`]. Buffers that one of them lacks are left out;
/// empty where no surface is seen.
///
/// # Errors
/// When sizes differ or a value is not finite.
pub fn measure(found: &Buffers, truth: &Buffers, mask: &Image<f32>, networks: &Networks) -> Result<BTreeMap<&'static str, f64>> {
    let mut errors = BTreeMap::new();
    if !mask.pixels.iter().any(|m| *m > 0.0) {
        return Ok(errors);
    }
    let mut add = |id: &'static str, value: Option<f64>| errors.extend(value.map(|v| (id, v)));
    if let Some((found, truth)) = pair(&found.albedo, &truth.albedo, mask, "albedo")? {
        add("albedo_psnr", psnr_masked(found, truth, mask).map(capped));
        add("albedo_psnr_scaled", psnr_masked(&scaled(found, truth, mask), truth, mask).map(capped));
        if let Some(lpips) = networks.alex.as_ref().filter(|n| n.backbone().smallest_side() <= mask.width.min(mask.height)) {
            let pixels = found.pixels.iter().zip(&truth.pixels).zip(&mask.pixels);
            let pixels = pixels.map(|((found, truth), m)| if *m > 0.0 { *found } else { *truth }).collect();
            let shown = Rgb { width: mask.width, height: mask.height, pixels };
            add("albedo_lpips", Some(f64::from(lpips.distance_to(&shown, &lpips.reference(truth)?)?)));
        }
    }
    if let Some((found, truth)) = pair(&found.normal, &truth.normal, mask, "normals")? {
        let mut angles = angles(found, truth, mask);
        angles.sort_by(f64::total_cmp);
        let share = |count: usize| count as f64 / angles.len() as f64;
        if !angles.is_empty() {
            add("normal_mean", Some(angles.iter().sum::<f64>() / angles.len() as f64));
            add("normal_median", Some(0.5 * (angles[(angles.len() - 1) / 2] + angles[angles.len() / 2])));
            add("normal_near", Some(share(angles.partition_point(|a| *a < NEAR))));
        }
    }
    if let Some((found, truth)) = pair(&found.depth, &truth.depth, mask, "depth")? {
        let quotients = quotients(found, truth, mask);
        let mean = |f: &dyn Fn(f64) -> f64| quotients.iter().map(|q| f(*q)).sum::<f64>() / quotients.len() as f64;
        add("depth_relative", Some(mean(&|q| (q - 1.0).abs())));
        add("depth_close", Some(mean(&|q| f64::from(q.max(1.0 / q) < CLOSE))));
    }
    if let Some((found, truth)) = pair(&found.material, &truth.material, mask, "material")? {
        let rms = |channel: usize| {
            let squares = found.pixels.iter().zip(&truth.pixels).map(|(a, b)| f64::from(a[channel] - b[channel]).powi(2));
            masked_mean(squares, mask).map(f64::sqrt)
        };
        add("roughness_rms", rms(0));
        add("metallic_rms", rms(1));
    }
    Ok(errors)
}

/// Both images, if both are there and fit.
fn pair<'a, T: Finite>(
    found: &'a Option<Image<T>>,
    truth: &'a Option<Image<T>>,
    mask: &Image<f32>,
    name: &str,
) -> Result<Option<(&'a Image<T>, &'a Image<T>)>> {
    let (Some(found), Some(truth)) = (found, truth) else { return Ok(None) };
    for (image, whose) in [(found, "recovered"), (truth, "true")] {
        let fits = (image.width, image.height) == (mask.width, mask.height) && image.pixels.len() == mask.pixels.len();
        let [w, h] = [image.width, image.height];
        ensure!(fits, "{whose} {name}: {w} x {h} pixels where the frame has {} x {}", mask.width, mask.height);
        let seen = image.pixels.iter().zip(&mask.pixels).filter(|(_, m)| **m > 0.0);
        ensure!(seen.into_iter().all(|(p, _)| p.finite()), "{whose} {name}: a value is not finite");
    }
    Ok(Some((found, truth)))
}

trait Finite {
    fn finite(&self) -> bool;
}

impl Finite for f32 {
    fn finite(&self) -> bool {
        self.is_finite()
    }
}

impl Finite for [f32; 3] {
    fn finite(&self) -> bool {
        self.iter().all(|v| v.is_finite())
    }
}

/// The albedo after scaling each linear channel to come as near to the truth as possible (least squares of linear values): a
/// picture alone cannot separate base colour from the colour of the light. As PSNR is of sRGB values, it may fall a little.
fn scaled(found: &Rgb, truth: &Rgb, mask: &Image<f32>) -> Rgb {
    let linear = |p: &[f32; 3], c: usize| f64::from(color::srgb_to_linear(p[c].clamp(0.0, 1.0)));
    let factors = [0, 1, 2].map(|c| {
        let seen = found.pixels.iter().zip(&truth.pixels).zip(&mask.pixels).filter(|(_, m)| **m > 0.0);
        let (cross, square) = seen.fold((0.0, 0.0), |(cross, square), ((a, b), _)| {
            let a = linear(a, c);
            (cross + a * linear(b, c), square + a * a)
        });
        if square > 0.0 { cross / square } else { 1.0 }
    });
    let pixel = |p: [f32; 3]| [0, 1, 2].map(|c| color::linear_to_srgb((factors[c] * linear(&p, c)).clamp(0.0, 1.0) as f32));
    found.map(|p| pixel(*p))
}

/// Angles between normals in degrees. A recovered normal of length 0 counts as 90 degrees off; a true one is left out.
fn angles(found: &Rgb, truth: &Rgb, mask: &Image<f32>) -> Vec<f64> {
    let vector = |p: &[f32; 3]| glam::DVec3::from(p.map(f64::from));
    let seen = found.pixels.iter().zip(&truth.pixels).zip(&mask.pixels).filter(|(_, m)| **m > 0.0);
    seen.map(|((a, b), _)| (vector(a), vector(b)))
        .filter(|(_, b)| b.length() > 0.0)
        // Computed by the tangent, since the cosine of a small angle has no digits left.
        .map(|(a, b)| if a.length() > 0.0 { a.cross(b).length().atan2(a.dot(b)).to_degrees() } else { 90.0 })
        .collect()
}

/// Quotients of recovered and true depths, after the scale and shift of the logarithm that fit best (least squares). The scale is
/// never below 0: what is farther must not count as nearer.
fn quotients(found: &Image<f32>, truth: &Image<f32>, mask: &Image<f32>) -> Vec<f64> {
    let seen = found.pixels.iter().zip(&truth.pixels).zip(&mask.pixels).filter(|(_, m)| **m > 0.0);
    let pairs: Vec<[f64; 2]> = seen.map(|((a, b), _)| [f64::from(*a), f64::from(*b)]).collect();
    let count = pairs.len() as f64;
    let [a, b] = [0, 1].map(|i| pairs.iter().map(|p| p[i]).sum::<f64>() / count);
    let (cross, square) = pairs.iter().fold((0.0, 0.0), |(cross, square), p| {
        let d = p[0] - a;
        (cross + d * (p[1] - b), square + d * d)
    });
    // A constant says nothing about the scale; the mean is left.
    let scale = if square > 1e-12 * count { (cross / square).max(0.0) } else { 0.0 };
    // Clamped to the range of single precision, whatever the outliers.
    pairs.iter().map(|p| (scale * (p[0] - a) + b - p[1]).clamp(-80.0, 80.0).exp()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Quat, Vec3};

    fn mask() -> Image<f32> {
        // The last row sees nothing.
        Image { width: 4, height: 4, pixels: (0..16).map(|i| if i < 12 { 1.0 } else { 0.0 }).collect() }
    }

    fn truth() -> Buffers {
        let unit = |x: usize, y: usize, k: usize| ((7 * x + 5 * y + 3 * k) % 11) as f32 / 11.0;
        let normal = |x: usize, y: usize| Vec3::new(x as f32 - 1.5, y as f32 - 1.5, 2.0).normalize().to_array();
        Buffers {
            albedo: Some(Rgb::from_fn(4, 4, |x, y| [0, 1, 2].map(|k| 0.2 + 0.5 * unit(x, y, k)))),
            normal: Some(Rgb::from_fn(4, 4, normal)),
            depth: Some(Image { width: 4, height: 4, pixels: (0..16).map(|i| (1.0 + i as f32).ln()).collect() }),
            material: Some(Rgb::from_fn(4, 4, |x, y| [0, 1, 2].map(|k| unit(x, y, k)))),
        }
    }

    fn measured(found: &Buffers) -> BTreeMap<&'static str, f64> {
        measure(found, &truth(), &mask(), &Networks::default()).unwrap()
    }

    fn near(a: f64, b: f64, within: f64) {
        assert!((a - b).abs() < within, "{a} instead of {b}");
    }

    #[test]
    fn the_truth_has_no_error() {
        let errors = measured(&truth());
        for column in COLUMNS.iter().filter(|column| column.id != "albedo_lpips") {
            let best = match column.id {
                "albedo_psnr" | "albedo_psnr_scaled" => 100.0,
                "normal_near" | "depth_close" => 1.0,
                _ => 0.0,
            };
            near(errors[column.id], best, 1e-4);
        }
        assert_eq!(errors.len(), COLUMNS.len() - 1, "{errors:?}");
    }

    #[test]
    fn errors_are_those_of_their_definitions() {
        let mut found = truth();
        // Normals turned by 20 degrees about an axis at a right angle to each, of other lengths.
        let turn = |n: &[f32; 3]| {
            let n = Vec3::from(*n);
            (Quat::from_axis_angle(n.any_orthonormal_vector(), 20f32.to_radians()) * n * 0.3).to_array()
        };
        found.normal = truth().normal.map(|normal| normal.map(turn));
        found.material = truth().material.map(|material| material.map(|p| [p[0] + 0.1, p[1] - 0.2, 0.0]));
        // sRGB values 0.1 lower: 20 dB.
        found.albedo = truth().albedo.map(|albedo| albedo.map(|p| p.map(|v| v - 0.1)));
        // Another scale and shift.
        found.depth = truth().depth.map(|depth| depth.map(|d| 0.25 * d - 3.0));
        // Nothing beyond the mask counts.
        for pixels in [&mut found.albedo, &mut found.normal, &mut found.material] {
            pixels.as_mut().unwrap().pixels[14] = [f32::NAN; 3];
        }
        let errors = measured(&found);
        near(errors["normal_mean"], 20.0, 1e-3);
        near(errors["normal_median"], 20.0, 1e-3);
        near(errors["normal_near"], 0.0, 1e-9);
        near(errors["roughness_rms"], 0.1, 1e-6);
        near(errors["metallic_rms"], 0.2, 1e-6);
        near(errors["albedo_psnr"], 20.0, 1e-4);
        near(errors["depth_relative"], 0.0, 1e-5);

        // Light of another colour: a factor for each channel.
        let tint = |p: &[f32; 3]| {
            let tint = [0.5, 0.8, 0.3];
            [0, 1, 2].map(|c| color::linear_to_srgb(tint[c] * color::srgb_to_linear(p[c])))
        };
        found.albedo = truth().albedo.map(|albedo| albedo.map(tint));
        let errors = measured(&found);
        assert!(errors["albedo_psnr"] < 20.0 && errors["albedo_psnr_scaled"] > 90.0, "{errors:?}");

        // A constant depth: what is left is the geometric mean of 1, 2, .. 12, within a quarter of which are 5 and 6.
        found.depth = truth().depth.map(|depth| depth.map(|_| 0.5));
        let mean = (1..=12).map(|z| f64::from(z).ln()).sum::<f64>() / 12.0;
        let relative = (1..=12).map(|z| (mean.exp() / f64::from(z) - 1.0).abs()).sum::<f64>() / 12.0;
        let errors = measured(&found);
        near(errors["depth_relative"], relative, 1e-5);
        near(errors["depth_close"], 2.0 / 12.0, 1e-9);
        // Depth that is inside out says no more than a constant one.
        found.depth = truth().depth.map(|depth| depth.map(|d| -d));
        near(measured(&found)["depth_relative"], relative, 1e-5);
        // A normal of length 0 is a right angle off.
        found.normal.as_mut().unwrap().pixels[0] = [0.0; 3];
        near(measured(&found)["normal_mean"], (11.0 * 20.0 + 90.0) / 12.0, 1e-3);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let mut found = Buffers { normal: truth().normal, ..Buffers::default() };
        assert_eq!(measured(&found).len(), 3, "normals alone");
        found.normal.as_mut().unwrap().pixels[3][1] = f32::NAN;
        let said = |found: &Buffers| measure(found, &truth(), &mask(), &Networks::default()).unwrap_err().to_string();
        assert!(said(&found).contains("recovered normals: a value is not finite"));
        let found = Buffers { depth: Some(Image { width: 2, height: 8, pixels: vec![0.0; 16] }), ..Buffers::default() };
        assert!(said(&found).contains("depth: 2 x 8 pixels where the frame has 4 x 4"), "{}", said(&found));
        let nothing = Image { width: 4, height: 4, pixels: vec![0.0; 16] };
        assert!(measure(&truth(), &truth(), &nothing, &Networks::default()).unwrap().is_empty());
    }
}
