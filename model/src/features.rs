//! From a frame to what the network reads: per-pixel channels, environment tokens, and the base its heads act on.

use crate::bridge::{MAX_RADIANCE, log_curve, log_curve_inverse};
use crate::config::{Input, NetworkConfig, Start};
use crate::network::heads::BasePixel;
use crate::tokens::EnvironmentSummary;
use glam::Vec3A;
use half::f16;
use renderflow_frame::color::luminance;
use renderflow_frame::ibl::{IblTables, Shading};
use renderflow_frame::screen_space::ScreenSpace;
use renderflow_frame::{Camera, Environment, Frame, ibl, screen_space};

/// Channels of [`Input::ALL`].
pub const INPUT_CHANNELS: usize = 23;
/// First of three channels: the environment behind the pixel, exposed, in the log curve.
pub const BACKGROUND: usize = INPUT_CHANNELS;
/// First of three channels: the true radiance, exposed, in the log curve (0 where a frame has no beauty).
pub const TARGET: usize = INPUT_CHANNELS + 3;
/// Channels stored for each pixel.
pub const STORED: usize = INPUT_CHANNELS + 6;

/// Everything the network needs of one frame.
#[derive(Clone, Debug)]
pub struct Features {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height][width][STORED]`, values as the documentation of [`Input`] says; 0 where nothing is covered except background and target.
    pub pixels: Vec<f32>,
    /// `[TOKENS][TOKEN_FEATURES]`.
    pub tokens: Vec<f32>,
    /// What the heads act on, a pixel each, at full precision.
    pub physical: Vec<Physical>,
}

/// The quantities of one pixel from which every start point follows; radiance is exposed and linear.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Physical {
    /// Base colour.
    pub albedo: [f32; 3],
    /// 0..=1.
    pub metallic: f32,
    /// 0..=1.
    pub specular: f32,
    /// Irradiance / pi.
    pub irradiance: [f32; 3],
    /// Prefiltered environment along the mirror direction.
    pub prefiltered: [f32; 3],
    /// Split-sum scale and bias.
    pub brdf: [f32; 2],
    /// Environment behind the pixel.
    pub background: [f32; 3],
    /// Coverage.
    pub alpha: f32,
}

impl Physical {
    /// Reads one stored pixel back (`STORED` values).
    pub fn from_stored(stored: &[f32]) -> Self {
        let three = |from: usize| [stored[from], stored[from + 1], stored[from + 2]];
        let material = Input::Material.offset();
        let brdf = Input::Brdf.offset();
        Self {
            albedo: three(Input::Albedo.offset()),
            metallic: stored[material + 1],
            specular: stored[material + 2],
            irradiance: three(Input::Irradiance.offset()).map(log_curve_inverse),
            prefiltered: three(Input::Prefiltered.offset()).map(log_curve_inverse),
            brdf: [stored[brdf], stored[brdf + 1]],
            background: three(BACKGROUND).map(log_curve_inverse),
            alpha: stored[Input::Coverage.offset()],
        }
    }

    /// What the heads of a network with this start act on.
    pub fn base(&self, start: Start) -> BasePixel {
        let f0 = ibl::f0(self.albedo, self.metallic, self.specular);
        let mut base = BasePixel { alpha: self.alpha, ..BasePixel::default() };
        for (c, f0) in f0.into_iter().enumerate() {
            let diffuse = self.albedo[c] * (1.0 - self.metallic);
            base.lit[c] = self.alpha * (diffuse * self.irradiance[c]);
            base.specular[c] = self.alpha * (self.prefiltered[c] * (f0 * self.brdf[0] + self.brdf[1]));
            base.tint[c] = self.alpha * (self.albedo[c] + f0);
            base.rest[c] = (1.0 - self.alpha) * self.background[c];
            base.start[c] = base.rest[c]
                + match start {
                    Start::Ibl => base.lit[c] + base.specular[c],
                    Start::Albedo => self.alpha * self.albedo[c],
                    Start::AlbedoIrradiance => self.alpha * (self.albedo[c] * self.irradiance[c]),
                };
        }
        base
    }
}

impl Features {
    /// Computes everything from the G-buffer of `frame`. `summary` is that of `environment`; `exposure` > 0 maps radiance to display-linear.
    pub fn new(
        frame: &Frame,
        camera: &Camera,
        environment: &Environment,
        summary: &EnvironmentSummary,
        tables: &IblTables,
        exposure: f32,
    ) -> Self {
        let shading = ibl::shade(frame, camera, environment, tables);
        let occlusion = screen_space::features(&shading, camera, environment);
        Self::from_parts(frame, camera, &shading, &occlusion, summary, exposure)
    }

    /// [`Features::new`] from shading and screen-space features that are already there.
    pub fn from_parts(
        frame: &Frame,
        camera: &Camera,
        shading: &Shading,
        occlusion: &ScreenSpace,
        summary: &EnvironmentSummary,
        exposure: f32,
    ) -> Self {
        let count = frame.width * frame.height;
        let median = median_depth(shading);
        let light = camera.camera_to_world.matrix3.transpose() * summary.light_direction;
        let exposed = |rgb: [f32; 3]| rgb.map(|v| finite(v * exposure).clamp(0.0, MAX_RADIANCE));

        let mut pixels = vec![0.0; count * STORED];
        let mut physical = vec![Physical::default(); count];
        for (i, stored) in pixels.chunks_exact_mut(STORED).enumerate() {
            let alpha = finite(shading.surfaces.alpha.pixels[i]).clamp(0.0, 1.0);
            let background = exposed(shading.surfaces.background.pixels[i]);
            stored[BACKGROUND..BACKGROUND + 3].copy_from_slice(&background.map(log_curve));
            if let Some(beauty) = &frame.beauty {
                stored[TARGET..TARGET + 3].copy_from_slice(&exposed(beauty.pixels[i]).map(log_curve));
            }
            physical[i] = Physical { background, alpha, ..Physical::default() };
            if alpha == 0.0 {
                continue;
            }
            let n = shading.surfaces.normal.pixels[i].map(finite);
            let bent = occlusion.bent_normal.pixels[i].map(finite);
            let [roughness, metallic, specular] = shading.surfaces.material.pixels[i].map(unit);
            let p = Physical {
                albedo: shading.surfaces.albedo.pixels[i].map(unit),
                metallic,
                specular,
                irradiance: exposed(shading.irradiance.pixels[i]),
                prefiltered: exposed(shading.prefiltered.pixels[i]),
                brdf: shading.surfaces.brdf.pixels[i].map(unit),
                background,
                alpha,
            };
            let depth = shading.surfaces.depth.pixels[i];
            let relative = if depth.is_finite() && depth > 0.0 { (0.5 * (depth / median).ln()).clamp(-2.0, 2.0) } else { 0.0 };
            let received = summary.light_irradiance * Vec3A::from_array(n).dot(light).max(0.0) * std::f32::consts::FRAC_1_PI;
            let total = luminance(shading.irradiance.pixels[i]);
            let share = if total > 0.0 { unit(received / total) } else { 0.0 };

            let mut at = 0;
            let mut push = |values: &[f32]| {
                stored[at..at + values.len()].copy_from_slice(values);
                at += values.len();
            };
            // In the order of `Input::ALL`.
            push(&p.albedo);
            push(&n);
            push(&[relative]);
            push(&[roughness, metallic, specular]);
            push(&p.irradiance.map(log_curve));
            push(&p.prefiltered.map(log_curve));
            push(&p.brdf);
            push(&[unit(occlusion.occlusion.pixels[i])]);
            push(&[(n[0] * bent[0] + n[1] * bent[1] + n[2] * bent[2]).clamp(-1.0, 1.0)]);
            push(&[unit(occlusion.light_visibility.pixels[i])]);
            push(&[share, alpha]);
            physical[i] = p;
        }
        Self { width: frame.width, height: frame.height, pixels, tokens: summary.tokens(camera, exposure), physical }
    }

    /// Half-precision copy for the training cache.
    pub fn to_half(&self) -> Vec<f16> {
        self.pixels.iter().map(|&v| f16::from_f32(v)).collect()
    }
}

/// Writes one pixel of the network's input: `z_t`, then the chosen inputs, brought to about -1..=1; inputs are 0 where nothing is covered.
pub fn write_input(config: &NetworkConfig, z: [f32; 3], stored: &[f32], out: &mut [f32]) {
    out[..3].copy_from_slice(&z);
    let covered = stored[Input::Coverage.offset()] > 0.0;
    let mut at = 3;
    for &input in &config.inputs {
        let (scale, shift) = input.normalisation();
        let from = input.offset();
        for &value in &stored[from..from + input.channels()] {
            out[at] = if covered { scale * value + shift } else { 0.0 };
            at += 1;
        }
    }
}

fn finite(v: f32) -> f32 {
    if v.is_finite() { v } else { 0.0 }
}

fn unit(v: f32) -> f32 {
    finite(v).clamp(0.0, 1.0)
}

/// Median depth of the covered pixels; 1 when there are none.
fn median_depth(shading: &Shading) -> f32 {
    let mut depths: Vec<f32> = shading.surfaces.depth.pixels.iter().copied().filter(|d| d.is_finite() && *d > 0.0).collect();
    if depths.is_empty() {
        return 1.0;
    }
    let middle = depths.len() / 2;
    *depths.select_nth_unstable_by(middle, f32::total_cmp).1
}
