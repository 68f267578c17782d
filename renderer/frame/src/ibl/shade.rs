//! Shading a G-buffer with the split sum.

use super::edges::{self, Edge, blend_picture};
use super::{IblTables, dielectric, environment_brdf, f0};
use crate::environment::Environment;
use crate::image::{Image, Rgb};
use crate::{Camera, Frame, Light};
use glam::{Vec2, Vec3A};
use rayon::prelude::*;
use std::sync::OnceLock;

/// Largest distance, along either axis, to the pixel that a covered pixel whose centre missed borrows from.
const BORROW_RADIUS: i32 = 4;
/// Least cosine between normal and view: a filtered or mapped normal may face away.
const MIN_N_DOT_V: f32 = 1e-3;
/// Roughness from which no curvature of one surface makes parts of a pixel ([`Surfaces::over_parts`]): two pixels of one surface
/// have normals with a cosine of at least .9.
const ROUGHEST: f32 = 0.86;
/// (roughness, metallic, specular) where no neighbour has any: a rough dielectric.
const UNKNOWN_MATERIAL: [f32; 3] = [1.0, 0.0, 0.5];

/// What the pixels of a G-buffer show. Values that a pixel lacks come from its guides and its neighbours. All but `background`,
/// `alpha` and `depth` are 0 where nothing is covered.
#[derive(Clone, Debug)]
pub struct Surfaces {
    /// Environment-BRDF scale and bias (a, b) of the pixel's mixture of conductor and dielectric
    /// ([`super::EnvironmentBrdf::mixture`]).
    pub brdf: Image<[f32; 2]>,
    /// Albedo (anti-aliased where guides exist), divided by coverage.
    pub albedo: Rgb,
    /// Camera-space unit normal (anti-aliased where guides exist).
    pub normal: Rgb,
    /// Camera-space unit normal of the surface in the middle of a pixel, where something is seen through it: it is what mirrors,
    /// while `normal` and `albedo` are of what lies behind. 0 elsewhere; `None` where nothing is seen through any surface.
    pub front: Option<Rgb>,
    /// (roughness, metallic, specular); pixels with coverage whose centre missed borrow their nearest neighbour's.
    pub material: Rgb,
    /// How much the camera-space unit normal changes across the pixel, along x and along y; 0 where it is not known, and on rough
    /// surfaces.
    pub bend: Image<[[f32; 3]; 2]>,
    /// Planar depth, borrowed like `material`; +inf where nothing is covered, and where no pixel nearby was hit.
    pub depth: Image<f32>,
    /// Radiance of the environment that clear surfaces let through, 0 elsewhere; `None` where the frame has no such surfaces.
    /// There the albedo is 0: what reflects is the surface alone.
    pub through: Option<Rgb>,
    /// The environment seen through the pixel ([`Environment::over_pixel`]); 0 where the pixel is fully covered and the
    /// background is invisible.
    pub background: Rgb,
    /// Coverage.
    pub alpha: Image<f32>,
    /// Pixels in which two surfaces meet. Until [`Self::join`], they hold the surface in their middle.
    pub edges: Vec<Edge>,
}

impl Surfaces {
    /// Camera-space unit normal of what mirrors in pixel `i`: [`Self::front`] where there is one, and [`Self::normal`] elsewhere.
    pub fn front_normal(&self, i: usize) -> Vec3A {
        let front = self.front.as_ref().map_or([0.0; 3], |front| front.pixels[i]);
        Vec3A::from_array(if front == [0.0; 3] { self.normal.pixels[i] } else { front })
    }

    /// The mean of what the parts of the surface in pixel `i` reflect. `reflect` gets the camera-space unit normal of a part.
    ///
    /// Flat surfaces have one part, and curved ones 4 or 16, where that is much beside the width of their lobes. One wider lobe
    /// instead (Tokuyoshi and Kaplanyan, Improved Geometric Specular Antialiasing, 2019) has long tails, which show lamps where
    /// none is reflected.
    pub fn over_parts(&self, i: usize, mut reflect: impl FnMut(Vec3A) -> Vec3A) -> Vec3A {
        let normal = self.front_normal(i);
        let [across, down] = self.bend.pixels[i].map(Vec3A::from_array);
        // Twice the variance of the normal's slope over the pixel, a box filter, against the square of GGX's width.
        let spread = (across.length_squared() + down.length_squared()) / 12.0;
        let width = self.material.pixels[i][0].powi(4);
        let side = match spread / width.max(f32::MIN_POSITIVE) {
            ..0.0625 => return reflect(normal),
            0.0625..0.25 => 2,
            _ => 4,
        };
        let step = |k: usize| (k as f32 + 0.5) / side as f32 - 0.5;
        let places = (0..side * side).map(|k| [step(k % side), step(k / side)]);
        let parts = places.map(|[x, y]| (normal + across * x + down * y).normalize_or(normal));
        parts.map(reflect).sum::<Vec3A>() / (side * side) as f32
    }

    /// The prefiltered environment that the surface in pixel `i` mirrors. `v` points from it to `camera`, in world space.
    pub fn mirrored(&self, i: usize, camera: &Camera, v: Vec3A, tables: &IblTables) -> Vec3A {
        let roughness = self.material.pixels[i][0];
        self.over_parts(i, |normal| {
            let n = camera.camera_to_world.matrix3 * normal;
            Vec3A::from_array(tables.prefiltered(n * (2.0 * n.dot(v)) - v, roughness))
        })
    }

    /// Gives edges the mean albedo and normal of the surfaces that meet in them.
    pub fn join(&mut self) {
        for edge in &self.edges {
            edge.restore([&mut self.albedo, &mut self.normal], &mut self.brdf);
        }
    }
}

/// The factors of the split-sum image, per pixel; radiance is scene-linear. All but `image` are 0 where nothing is covered.
#[derive(Clone, Debug)]
pub struct Shading {
    /// `alpha * (diffuse * irradiance + specular + through) + (1 - alpha) * background`: the IBL picture.
    pub image: Rgb,
    /// Diffuse albedo: `albedo * (1 - metallic)`, divided by coverage.
    pub diffuse: Rgb,
    /// E(n)/pi at the shading normal.
    pub irradiance: Rgb,
    /// Prefiltered environment along the mirror direction.
    pub prefiltered: Rgb,
    /// `prefiltered * (f0 * a + b)`, and what clear surfaces let through.
    pub specular: Rgb,
    /// The surfaces that were shaded.
    pub surfaces: Surfaces,
}

/// What the pixels of `frame` show. The result has the same bits for any number of threads. Pixels without coverage cost
/// four look-ups where the background is even, and fully covered pixels need no background.
///
/// # Panics
/// When a channel of `frame` does not have `frame.width * frame.height` pixels.
pub fn surfaces(frame: &Frame, environment: &Environment) -> Surfaces {
    let (width, height, camera) = (frame.width, frame.height, &frame.info.camera);
    let rgb = || Rgb::filled(width, height, [0.0; 3]);
    let mut out = Surfaces {
        brdf: Image::filled(width, height, [0.0; 2]),
        albedo: rgb(),
        normal: rgb(),
        front: frame.transmittance.is_some().then(rgb),
        material: rgb(),
        bend: Image::filled(width, height, [[0.0; 3]; 2]),
        depth: Image::filled(width, height, f32::INFINITY),
        through: frame.through.is_some().then(rgb),
        background: rgb(),
        alpha: frame.alpha.clone(),
        edges: Vec::new(),
    };
    let row = width.max(1);
    let rows = (
        out.brdf.pixels.par_chunks_mut(row),
        out.albedo.pixels.par_chunks_mut(row),
        out.normal.pixels.par_chunks_mut(row),
        out.material.pixels.par_chunks_mut(row).zip(out.bend.pixels.par_chunks_mut(row)),
        out.depth.pixels.par_chunks_mut(row),
        out.background.pixels.par_chunks_mut(row),
    );
    rows.into_par_iter().enumerate().for_each(|(y, (brdf, albedo, normal, (material, bend), depth, background))| {
        for x in 0..width {
            let through = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
            let alpha = *frame.alpha.at(x, y);
            if alpha < 1.0 {
                background[x] = environment.over_pixel(camera, (x, y));
            }
            if alpha <= 0.0 {
                continue;
            }
            // Point values come from the pixel's centre or the nearest one that hit; filtered guides take precedence where they
            // exist.
            let hit = nearest_hit(frame, x, y);
            material[x] = hit.map_or(UNKNOWN_MATERIAL, |i| frame.material.pixels[i]);
            depth[x] = hit.map_or(f32::INFINITY, |i| frame.depth.pixels[i]);
            if material[x][0] < ROUGHEST {
                bend[x] = edges::bend(frame, x, y);
            }
            albedo[x] = match &frame.guide_albedo {
                Some(guide) => (Vec3A::from_array(*guide.at(x, y)) / alpha).clamp(Vec3A::ZERO, Vec3A::ONE).to_array(),
                None => hit.map_or([0.0; 3], |i| frame.albedo.pixels[i]),
            };
            let n_cam = frame
                .guide_normal
                .as_ref()
                .and_then(|guide| Vec3A::from_array(*guide.at(x, y)).try_normalize())
                .or_else(|| hit.and_then(|i| Vec3A::from_array(frame.normal.pixels[i]).try_normalize()))
                .unwrap_or_else(|| -camera.direction_cam(through).normalize());
            normal[x] = n_cam.to_array();
            brdf[x] = brdf_at(camera, (x, y), n_cam, material[x]);
        }
    });
    if let (Some(front), Some(share)) = (&mut out.front, &frame.transmittance) {
        let pixels = front.pixels.par_iter_mut().zip(&mut out.brdf.pixels).with_min_len(row).enumerate();
        pixels.for_each(|(i, (front, brdf))| {
            let normal = Vec3A::from_array(frame.normal.pixels[i]).try_normalize();
            if let Some(normal) = normal.filter(|_| share.pixels[i] != [0.0; 3] && frame.alpha.pixels[i] > 0.0) {
                *front = normal.to_array();
                *brdf = brdf_at(camera, (i % row, i / row), normal, out.material.pixels[i]);
            }
        });
    }
    let parts = [&mut out.albedo, &mut out.normal];
    out.edges = edges::part(frame, edges::find(frame), parts, &mut out.brdf);
    if let (Some(through), Some(direction), Some(share)) = (&mut out.through, &frame.through, &frame.transmittance) {
        let light = through.pixels.par_iter_mut().zip(&mut out.albedo.pixels).with_min_len(row).enumerate();
        light.for_each(|(i, (light, albedo))| {
            let direction = Vec3A::from_array(direction.pixels[i]);
            if direction != Vec3A::ZERO {
                let seen = environment.radiance((camera.camera_to_world.matrix3 * direction).normalize());
                *light = (Vec3A::from_array(seen) * Vec3A::from_array(share.pixels[i])).to_array();
                *albedo = [0.0; 3];
            }
        });
    }
    out
}

/// Scale and bias of the split sum for a surface with the camera-space normal `n_cam` in pixel (x, y).
pub(super) fn brdf_at(camera: &Camera, (x, y): (usize, usize), n_cam: Vec3A, material: [f32; 3]) -> [f32; 2] {
    let ray = camera.ray_direction(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
    let n_dot_v = (camera.camera_to_world.matrix3 * n_cam).dot(-ray);
    let [roughness, metallic, specular] = material;
    environment_brdf(n_dot_v.max(MIN_N_DOT_V), roughness).mixture(&dielectric(specular), metallic)
}

/// Shades the G-buffer of `frame` with the split sum. Where two surfaces meet in a pixel, both are shaded and blended. The result
/// has the same bits for any number of threads.
///
/// # Panics
/// When a channel of `frame` does not have `frame.width * frame.height` pixels.
pub fn shade(frame: &Frame, light: &Light) -> Shading {
    let mut shading = shade_surfaces(&frame.info.camera, surfaces(frame, &light.environment), light.tables());
    let Shading { image, diffuse, irradiance, prefiltered, specular, surfaces } = &mut shading;
    [image, diffuse, irradiance, prefiltered, specular].into_iter().for_each(|picture| blend_picture(&surfaces.edges, picture));
    surfaces.join();
    shading
}

/// Shades `surfaces`, which `camera` sees, with the tables of an environment that may differ from the one in their background.
/// Edges show the surface in their middle.
pub fn shade_surfaces(camera: &Camera, surfaces: Surfaces, tables: &IblTables) -> Shading {
    let (width, height) = (surfaces.depth.width, surfaces.depth.height);
    let rgb = || Rgb::filled(width, height, [0.0; 3]);
    let mut out = Shading {
        image: surfaces.background.clone(),
        diffuse: rgb(),
        irradiance: rgb(),
        prefiltered: rgb(),
        specular: rgb(),
        surfaces,
    };
    let row = width.max(1);
    let rows = (
        out.image.pixels.par_chunks_mut(row),
        out.diffuse.pixels.par_chunks_mut(row),
        out.irradiance.pixels.par_chunks_mut(row),
        out.prefiltered.pixels.par_chunks_mut(row),
        out.specular.pixels.par_chunks_mut(row),
    );
    let surfaces = &out.surfaces;
    rows.into_par_iter().enumerate().for_each(|(y, (image, diffuse, irradiance, prefiltered, specular))| {
        for x in 0..width {
            let alpha = *surfaces.alpha.at(x, y);
            if alpha <= 0.0 {
                continue;
            }
            let v = -camera.ray_direction(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
            let n = camera.camera_to_world.matrix3 * Vec3A::from_array(*surfaces.normal.at(x, y));
            let [_, metallic, specular_level] = *surfaces.material.at(x, y);
            let albedo = *surfaces.albedo.at(x, y);
            let base = Vec3A::from_array(albedo) * (1.0 - metallic);
            let light = Vec3A::from_array(tables.irradiance(n));
            let reflected = surfaces.mirrored(y * width + x, camera, v, tables);
            let [scale, bias] = *surfaces.brdf.at(x, y);
            let shiny = reflected * (Vec3A::from_array(f0(albedo, metallic, specular_level)) * scale + bias);
            let behind = Vec3A::from_array(*surfaces.background.at(x, y));
            let through = surfaces.through.as_ref().map_or(Vec3A::ZERO, |through| Vec3A::from_array(*through.at(x, y)));
            image[x] = ((base * light + shiny + through) * alpha + behind * (1.0 - alpha).max(0.0)).to_array();
            diffuse[x] = base.to_array();
            irradiance[x] = light.to_array();
            prefiltered[x] = reflected.to_array();
            specular[x] = (shiny + through).to_array();
        }
    });
    out
}

/// Index of the pixel nearest to (x, y), itself first, whose centre hit something. `None` where there is none within 4 pixels
/// along each axis. Ties go to the upper, then the left pixel.
///
/// # Panics
/// When (x, y) lies outside of the frame, or the frame has no depth.
pub fn nearest_hit(frame: &Frame, x: usize, y: usize) -> Option<usize> {
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
