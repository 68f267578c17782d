//! Shading a G-buffer with the split sum.

use super::{IblTables, dielectric, environment_brdf, f0};
use crate::environment::Environment;
use crate::image::{Image, Rgb};
use crate::{Camera, Frame};
use glam::{Vec2, Vec3A};
use rayon::prelude::*;
use std::sync::OnceLock;

/// Furthest pixel, along either axis, that a covered pixel whose centre missed borrows from.
const BORROW_RADIUS: i32 = 4;
/// Least cosine between normal and view: a filtered or mapped normal may face away.
const MIN_N_DOT_V: f32 = 1e-3;
/// (roughness, metallic, specular) where no neighbour has any: a rough dielectric.
const UNKNOWN_MATERIAL: [f32; 3] = [1.0, 0.0, 0.5];

/// The factors of the split-sum image, per pixel; radiance is scene-linear. All but `image`, `background`, `alpha` and `depth` are
/// 0 where nothing is covered.
#[derive(Clone, Debug)]
pub struct Shading {
    /// `alpha * (diffuse * irradiance + specular) + (1 - alpha) * background`: the IBL picture.
    pub image: Rgb,
    /// Diffuse albedo: `albedo * (1 - metallic)`, divided by coverage.
    pub diffuse: Rgb,
    /// E(n)/pi at the shading normal.
    pub irradiance: Rgb,
    /// Prefiltered environment along the mirror direction.
    pub prefiltered: Rgb,
    /// `prefiltered * (f0 * a + b)`.
    pub specular: Rgb,
    /// Environment-BRDF scale and bias (a, b) of the pixel's mixture of conductor and dielectric ([`super::EnvironmentBrdf::mixture`]).
    pub brdf: Image<[f32; 2]>,
    /// Albedo used (anti-aliased where guides exist), divided by coverage.
    pub albedo: Rgb,
    /// Camera-space unit normal used (anti-aliased where guides exist), 0 where nothing is covered.
    pub normal: Rgb,
    /// (roughness, metallic, specular) used; pixels with coverage whose centre missed borrow their nearest neighbour's.
    pub material: Rgb,
    /// Planar depth used, borrowed like `material`; +inf where nothing is covered, and where no pixel nearby was hit.
    pub depth: Image<f32>,
    /// The environment seen through the pixel's centre; 0 where the pixel is fully covered, since nothing can ask for it there.
    pub background: Rgb,
    /// Coverage.
    pub alpha: Image<f32>,
}

/// Values of one pixel, in the order of [`Shading`].
struct Pixel {
    image: Vec3A,
    diffuse: Vec3A,
    irradiance: Vec3A,
    prefiltered: Vec3A,
    specular: Vec3A,
    brdf: [f32; 2],
    albedo: Vec3A,
    normal: Vec3A,
    material: [f32; 3],
    depth: f32,
    background: Vec3A,
}

/// Shades the G-buffer of `frame` with the split sum. The same bits for any number of threads; pixels without coverage cost one
/// look-up, fully covered ones none for the background.
///
/// # Panics
/// When a channel of `frame` has not `frame.width * frame.height` pixels.
pub fn shade(frame: &Frame, camera: &Camera, environment: &Environment, tables: &IblTables) -> Shading {
    let (width, height) = (frame.width, frame.height);
    let rgb = || Rgb::filled(width, height, [0.0; 3]);
    let mut out = Shading {
        image: rgb(),
        diffuse: rgb(),
        irradiance: rgb(),
        prefiltered: rgb(),
        specular: rgb(),
        brdf: Image::filled(width, height, [0.0; 2]),
        albedo: rgb(),
        normal: rgb(),
        material: rgb(),
        depth: Image::filled(width, height, f32::INFINITY),
        background: rgb(),
        alpha: frame.alpha.clone(),
    };
    let row = width.max(1);
    (
        out.image.pixels.par_chunks_mut(row),
        out.diffuse.pixels.par_chunks_mut(row),
        out.irradiance.pixels.par_chunks_mut(row),
        out.prefiltered.pixels.par_chunks_mut(row),
        out.specular.pixels.par_chunks_mut(row),
        out.brdf.pixels.par_chunks_mut(row),
        out.albedo.pixels.par_chunks_mut(row),
        out.normal.pixels.par_chunks_mut(row),
        out.material.pixels.par_chunks_mut(row),
        out.depth.pixels.par_chunks_mut(row),
        out.background.pixels.par_chunks_mut(row),
    )
        .into_par_iter()
        .enumerate()
        .for_each(
            |(y, (image, diffuse, irradiance, prefiltered, specular, brdf, albedo, normal, material, depth, background))| {
                for x in 0..width {
                    let pixel = shade_pixel(frame, camera, environment, tables, x, y);
                    image[x] = pixel.image.to_array();
                    diffuse[x] = pixel.diffuse.to_array();
                    irradiance[x] = pixel.irradiance.to_array();
                    prefiltered[x] = pixel.prefiltered.to_array();
                    specular[x] = pixel.specular.to_array();
                    brdf[x] = pixel.brdf;
                    albedo[x] = pixel.albedo.to_array();
                    normal[x] = pixel.normal.to_array();
                    material[x] = pixel.material;
                    depth[x] = pixel.depth;
                    background[x] = pixel.background.to_array();
                }
            },
        );
    out
}

fn shade_pixel(frame: &Frame, camera: &Camera, environment: &Environment, tables: &IblTables, x: usize, y: usize) -> Pixel {
    let alpha = *frame.alpha.at(x, y);
    let through = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
    let ray = camera.ray_direction(through);
    let background = if alpha < 1.0 { Vec3A::from_array(environment.radiance(ray)) } else { Vec3A::ZERO };
    if alpha <= 0.0 {
        return Pixel {
            image: background,
            diffuse: Vec3A::ZERO,
            irradiance: Vec3A::ZERO,
            prefiltered: Vec3A::ZERO,
            specular: Vec3A::ZERO,
            brdf: [0.0; 2],
            albedo: Vec3A::ZERO,
            normal: Vec3A::ZERO,
            material: [0.0; 3],
            depth: f32::INFINITY,
            background,
        };
    }

    // Point values come from the pixel's centre or the nearest one that hit; filtered guides take precedence where they exist.
    let hit = nearest_hit(frame, x, y);
    let material = hit.map_or(UNKNOWN_MATERIAL, |i| frame.material.pixels[i]);
    let depth = hit.map_or(f32::INFINITY, |i| frame.depth.pixels[i]);
    let albedo = match &frame.guide_albedo {
        Some(guide) => (Vec3A::from_array(*guide.at(x, y)) / alpha).clamp(Vec3A::ZERO, Vec3A::ONE),
        None => hit.map_or(Vec3A::ZERO, |i| Vec3A::from_array(frame.albedo.pixels[i])),
    };
    let towards_camera = -camera.direction_cam(through).normalize();
    let n_cam = frame
        .guide_normal
        .as_ref()
        .and_then(|guide| Vec3A::from_array(*guide.at(x, y)).try_normalize())
        .or_else(|| hit.and_then(|i| Vec3A::from_array(frame.normal.pixels[i]).try_normalize()))
        .unwrap_or(towards_camera);

    let n = camera.camera_to_world.matrix3 * n_cam;
    let v = -ray;
    let n_dot_v = n.dot(v);
    let mirror = n * (2.0 * n_dot_v) - v;
    let [roughness, metallic, specular_level] = material;
    let diffuse = albedo * (1.0 - metallic);
    let irradiance = Vec3A::from_array(tables.irradiance(n));
    let prefiltered = Vec3A::from_array(tables.prefiltered(mirror, roughness));
    let brdf = environment_brdf(n_dot_v.max(MIN_N_DOT_V), roughness).mixture(&dielectric(specular_level), metallic);
    let reflectance = Vec3A::from_array(f0(albedo.to_array(), metallic, specular_level));
    let specular = prefiltered * (reflectance * brdf[0] + brdf[1]);
    let image = (diffuse * irradiance + specular) * alpha + background * (1.0 - alpha).max(0.0);
    Pixel { image, diffuse, irradiance, prefiltered, specular, brdf, albedo, normal: n_cam, material, depth, background }
}

/// Index of the pixel nearest to (x, y), itself first, whose centre hit something.
fn nearest_hit(frame: &Frame, x: usize, y: usize) -> Option<usize> {
    let here = y * frame.width + x;
    if frame.depth.pixels[here].is_finite() {
        return Some(here);
    }
    static OFFSETS: OnceLock<Vec<(i32, i32)>> = OnceLock::new();
    let offsets = OFFSETS.get_or_init(|| {
        let range = -BORROW_RADIUS..=BORROW_RADIUS;
        let mut list: Vec<(i32, i32)> = range.clone().flat_map(|dy| range.clone().map(move |dx| (dx, dy))).collect();
        // Ties go to the upper, then the left pixel.
        list.sort_by_key(|&(dx, dy)| (dx * dx + dy * dy, dy, dx));
        list
    });
    offsets.iter().find_map(|&(dx, dy)| {
        let (column, line) = (x.checked_add_signed(dx as isize)?, y.checked_add_signed(dy as isize)?);
        let inside = column < frame.width && line < frame.height;
        let index = line * frame.width + column;
        (inside && frame.depth.pixels[index].is_finite()).then_some(index)
    })
}
