//! Deferred shading as a good game engine does it from rasterisable data: the dominant lights analytic and shadowed by shadow maps,
//! the rest of the environment by the split sum with ambient occlusion, screen-space reflections, and one bounce of indirect light.
//!
//! A baseline that works: [`Lighting::new`] once a sequence, shadow maps once a frame (the renderer fills them), [`shade`] per frame.

mod keyframes;
mod lighting;
mod material;
mod pass;
mod shadow;
mod sky;

pub use keyframes::{Carry, Keyframe, warp_fill};
pub use lighting::{LIGHTS, Lighting, Shadows};
pub use material::{Material, Response};
pub use shadow::{ShadowMap, axes, receivers};
pub use sky::{SKY_CELLS, SkyCell, SkyShare, sky_cells, sky_share};

use crate::Frame;
use crate::ibl::{self, Shading};
use crate::image::{Image, Rgb};
use crate::screen_space::{Surface, filter, gather, horizon, march, reflect};
use glam::{Vec3A, Vec4};
use pass::{Pass, Pixel};
use rayon::prelude::*;

/// How lights are shadowed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ShadowMode {
    /// Not at all.
    None,
    /// By marching through the depth buffer.
    ScreenSpace,
    /// By shadow maps; lights without a map as in `ScreenSpace`.
    #[default]
    Map,
}

/// Which features run. What is off costs nothing, and its part of [`Deferred`] is absent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Shadows of the lights.
    pub shadows: ShadowMode,
    /// Shadows of the rest of the environment, by [`Shadows::sky`] where there are such maps.
    pub sky: bool,
    /// Ambient occlusion.
    pub occlusion: bool,
    /// The rest of the environment is looked up along the bent normal instead of the normal; needs `occlusion`, and gives way to the
    /// sky's maps, which say the same with more to go by.
    pub bent: bool,
    /// Screen-space reflections.
    pub reflections: bool,
    /// One bounce of indirect light: of what surrounds a pixel in the picture, and where the sky's maps say that something else is in the way,
    /// of the picture's mean.
    pub indirect: bool,
    /// Whether [`Deferred`] holds the parts of the picture besides the picture itself.
    pub parts: bool,
}

impl Options {
    /// Every feature off: lights without shadows and the split sum of the rest, with the parts of the picture.
    pub const NONE: Self = Self {
        shadows: ShadowMode::None,
        sky: false,
        occlusion: false,
        bent: false,
        reflections: false,
        indirect: false,
        parts: true,
    };
}

impl Default for Options {
    fn default() -> Self {
        Self { shadows: ShadowMode::Map, sky: true, occlusion: true, bent: true, reflections: true, indirect: true, parts: true }
    }
}

/// The picture and its parts, scene-linear radiance; parts are empty unless [`Options::parts`] asks for them, 0 where nothing is covered,
/// and not multiplied by coverage:
/// `image = alpha * (sum of direct + ambient_diffuse + ambient_specular + reflections + indirect) + (1 - alpha) * background`.
#[derive(Clone, Debug)]
pub struct Deferred {
    /// The picture, background included.
    pub image: Rgb,
    /// Light that each of [`Lighting::lights`] sends to the camera, shadows applied.
    pub direct: Vec<Rgb>,
    /// Share of each light that a pixel sees, 0..=1; empty without shadows.
    pub visibility: Vec<Image<f32>>,
    /// Share of the sky's diffuse light that no shadow map of it holds back, `None` without such maps.
    pub sky: Option<Image<f32>>,
    /// Share of the cosine-weighted hemisphere that nothing near covers, `None` without occlusion.
    pub occlusion: Option<Image<f32>>,
    /// Mean unoccluded direction (camera space, unit), `None` without occlusion.
    pub bent_normal: Option<Rgb>,
    /// Rest of the environment, reflected by the diffuse base.
    pub ambient_diffuse: Rgb,
    /// Rest of the environment (and lights in smooth surfaces' mirrors), reflected by the GGX lobe; what `reflections` replaces is left out.
    pub ambient_specular: Rgb,
    /// What the GGX lobe reflects of the picture itself.
    pub reflections: Option<Rgb>,
    /// Light bounced once off what the picture shows.
    pub indirect: Option<Rgb>,
    /// The split-sum picture of the rest of the environment, with the G-buffer values used.
    pub shading: Shading,
}

/// Texels from a shadow map's border on which a pixel is shadowed by it.
const MARGIN: f32 = 8.0;
/// Reach of ambient occlusion. The sky's maps know of what is larger; on 30 sequences 0.1 was 1.3 dB better than the 0.7 that
/// stands for large occluders too, and 0.05 the same.
const CONTACT: horizon::Reach = horizon::Reach { radius: 0.1, thin: 0.03 };
/// Texels over which a sky map's taps are spread.
const SKY_JITTER: f32 = 2.0;
/// Most of the light that may go on bouncing between surfaces.
const MOST_BOUNCED: f32 = 0.8;

/// Shades `frame`. The same bits for any number of threads; pixels without coverage cost one look-up. Of `shadows` any list
/// may be shorter than its lights: those without a map are marched through the depth buffer, cells of the sky without are open.
///
/// # Panics
/// When a channel of `frame` has not `frame.width * frame.height` pixels.
pub fn shade(frame: &Frame, lighting: &Lighting, shadows: &Shadows, options: &Options) -> Deferred {
    let camera = &frame.info.camera;
    let shading = ibl::shade(frame, &lighting.environment, &lighting.tables);
    let surface = Surface::new(&shading, camera);
    let visibility = visibility(&surface, lighting, &shadows.lights, options.shadows);
    let occlusion = options.occlusion.then(|| {
        filter::smooth(&surface, Vec4::W, |i, phase| {
            let (open, bent) = horizon::occlusion(&surface, i, phase, CONTACT);
            bent.extend(open)
        })
    });
    let sky = (options.sky && !shadows.sky.is_empty()).then(|| sky(&surface, &shading, lighting, shadows));
    let pass = Pass {
        camera,
        lighting,
        options,
        shading: &shading,
        visibility: &visibility,
        sky: sky.as_deref(),
        occlusion: occlusion.as_deref(),
    };
    let (width, height) = (shading.surfaces.depth.width, shading.surfaces.depth.height);
    let all = || (0..width * height).into_par_iter().with_min_len(256);
    let lights = lighting.lights.len();
    let mut direct = vec![Vec3A::ZERO; if options.parts { width * height * lights } else { 0 }];
    let mut pixels: Vec<Pixel> = if direct.is_empty() {
        all().map_init(|| vec![Vec3A::ZERO; lights], |direct, i| pass.shade(i, direct)).collect()
    } else {
        let chunks = direct.par_chunks_mut(lights).with_min_len(256).enumerate();
        chunks.map(|(i, direct)| pass.shade(i, direct)).collect()
    };
    let covered = |i: usize| surface.known(i) && shading.surfaces.alpha.pixels[i] > 0.0;

    let mut lit: Vec<Vec3A> = pixels.iter().map(Pixel::sum).collect();
    let indirect = options.indirect.then(|| {
        if let Some(sky) = &sky {
            let around = surroundings(&pixels, &lit, sky, covered);
            for ((pixel, lit), sky) in pixels.iter_mut().zip(&mut lit).zip(sky) {
                let mirrored = pixel.reflected * around * (1.0 - sky.y).max(0.0);
                pixel.ambient_specular += mirrored;
                *lit += mirrored;
                pixel.around = around;
            }
        }
        let gathered = filter::smooth(&surface, Vec4::ZERO, |i, phase| {
            if pixels[i].white == Vec3A::ZERO { Vec4::ZERO } else { gather::gather(&surface, &lit, i, phase) }
        });
        let bounce = |i: usize| {
            let near = gathered[i];
            let far = sky.as_ref().map_or(0.0, |sky| (1.0 - sky[i].z - near.w).max(0.0));
            pixels[i].white * (Vec3A::from_vec4(near) + pixels[i].around * far)
        };
        let bounced: Vec<Vec3A> = all().map(bounce).collect();
        lit.iter_mut().zip(&bounced).for_each(|(lit, bounced)| *lit += *bounced);
        bounced
    });
    let reflections = options.reflections.then(|| {
        let pyramid = reflect::Pyramid::new(width, height, &lit, covered);
        let reflect = |i: usize| if covered(i) { pass.reflect(&surface, &pyramid, i, &pixels[i]) } else { Vec4::ZERO };
        all().map(reflect).collect::<Vec<Vec4>>()
    });

    let rgb = |f: &(dyn Fn(usize) -> Vec3A + Sync)| {
        let pixels = (0..width * height).into_par_iter().with_min_len(1024).map(|i| f(i).to_array()).collect();
        Rgb { width, height, pixels }
    };
    let kept = |i: usize| reflections.as_ref().map_or(1.0, |r| 1.0 - r[i].w);
    let reflected = |i: usize| reflections.as_ref().map_or(Vec3A::ZERO, |r| Vec3A::from_vec4(r[i]));
    let bounced = |i: usize| indirect.as_ref().map_or(Vec3A::ZERO, |b| b[i]);
    let image = rgb(&|i| {
        let (pixel, alpha) = (&pixels[i], shading.surfaces.alpha.pixels[i]);
        let surface = pixel.direct + pixel.ambient_diffuse + pixel.specular() * kept(i) + reflected(i) + bounced(i);
        surface * alpha + Vec3A::from_array(shading.surfaces.background.pixels[i]) * (1.0 - alpha).max(0.0)
    });
    if !options.parts {
        return Deferred {
            image,
            direct: Vec::new(),
            visibility: Vec::new(),
            sky: None,
            occlusion: None,
            bent_normal: None,
            ambient_diffuse: Rgb::default(),
            ambient_specular: Rgb::default(),
            reflections: None,
            indirect: None,
            shading,
        };
    }
    let seen = |light: usize| Image { width, height, pixels: all().map(|i| pass.seen(i, light)).collect() };
    Deferred {
        image,
        direct: (0..lights).map(|light| rgb(&|i| direct[i * lights + light])).collect(),
        visibility: if options.shadows == ShadowMode::None { Vec::new() } else { (0..lights).map(seen).collect() },
        occlusion: occlusion.as_ref().map(|o| Image { width, height, pixels: o.iter().map(|o| o.w.clamp(0.0, 1.0)).collect() }),
        sky: sky.as_ref().map(|s| Image { width, height, pixels: s.iter().map(|s| s.x.clamp(0.0, 1.0)).collect() }),
        bent_normal: occlusion.as_ref().map(|_| rgb(&|i| pass.bent(i))),
        ambient_diffuse: rgb(&|i| pixels[i].ambient_diffuse),
        ambient_specular: rgb(&|i| pixels[i].specular() * kept(i)),
        reflections: reflections.as_ref().map(|_| rgb(&reflected)),
        indirect: indirect.as_ref().map(|_| rgb(&bounced)),
        shading,
    }
}

/// Share of each light that each pixel sees: four lights a vector, one list for each four lights.
fn visibility(surface: &Surface, lighting: &Lighting, maps: &[Vec<ShadowMap>], mode: ShadowMode) -> Vec<Vec<Vec4>> {
    if mode == ShadowMode::None {
        return Vec::new();
    }
    let to_world = surface.camera.camera_to_world;
    let to_camera = surface.camera.world_to_camera().matrix3;
    let four = |first: usize| {
        let lights = &lighting.lights[first..(first + 4).min(lighting.lights.len())];
        filter::smooth(surface, Vec4::ONE, |i, phase| {
            let mut seen = Vec4::ZERO;
            let n_cam = surface.normal(i);
            let (p, n) = (to_world.transform_point3a(surface.points[i]), to_world.matrix3 * n_cam);
            for (k, light) in lights.iter().enumerate() {
                let towards = to_camera * light.direction;
                if n_cam.dot(towards) <= -light.angular_radius.sin() {
                    continue;
                }
                let maps = if mode == ShadowMode::Map { maps.get(first + k).map_or(&[][..], Vec::as_slice) } else { &[] };
                let map = maps.iter().find(|map| map.covers(p, MARGIN)).or(maps.last());
                seen[k] = match map {
                    Some(map) => map.visibility(p, n, light.angular_radius, phase.0),
                    None => march::visibility(surface, i, towards, phase),
                };
            }
            seen
        })
    };
    (0..lighting.lights.len()).step_by(4).map(four).collect()
}

/// Of each pixel (share of the sky's diffuse light, of its reflected light, of its directions; 0) that is open, by the sky's maps.
fn sky(surface: &Surface, shading: &Shading, lighting: &Lighting, shadows: &Shadows) -> Vec<Vec4> {
    let to_world = surface.camera.camera_to_world;
    filter::smooth(surface, Vec4::ONE, |i, phase| {
        let (p, n) = (to_world.transform_point3a(surface.points[i]), to_world.matrix3 * surface.normal(i));
        let v = (to_world.translation - p).normalize_or(n);
        let mirror = n * (2.0 * n.dot(v)) - v;
        let jitter = [phase.0, phase.1].map(|at| (at - 0.5) * SKY_JITTER);
        let share = sky_share(&lighting.sky, &shadows.sky, p, n, mirror, shading.surfaces.material.pixels[i][0], jitter);
        Vec4::new(share.diffuse, share.specular, share.open, 0.0)
    })
}

/// Radiance of what surrounds the scene's surfaces where it is no sky: the mean of the lit picture, and what of it goes on bouncing between
/// surfaces that see each other. One light probe for the whole picture: it knows no place, but that a room is not black behind the camera.
fn surroundings(pixels: &[Pixel], lit: &[Vec3A], sky: &[Vec4], covered: impl Fn(usize) -> bool) -> Vec3A {
    let (mut light, mut bounced, mut count) = (Vec3A::ZERO, Vec3A::ZERO, 0.0);
    for i in (0..lit.len()).filter(|i| covered(*i)) {
        light += lit[i];
        bounced += pixels[i].white * (1.0 - sky[i].z).clamp(0.0, 1.0);
        count += 1.0;
    }
    let count = f32::max(count, 1.0);
    (light / count) / (Vec3A::ONE - (bounced / count).min(Vec3A::splat(MOST_BOUNCED)))
}
