//! Deferred shading as a good game engine does it from data that a rasteriser has: the dominant lights are analytic and shadowed
//! by shadow maps, and the rest of the environment is lit by the split sum with ambient occlusion, screen-space reflections, and
//! one bounce of indirect light. Points, spots and directional lights of the scene are shadowed by a ray from each pixel.
//! Surfaces that glow light nothing.
//!
//! [`Lighting::new`] runs once per sequence. [`ShadowTiles::maps`] and [`shade`] run once per frame.

mod lamps;
mod lighting;
mod material;
mod pass;
mod screen_space;
mod shadow_map;
mod shadow_tiles;
mod sky;

pub use lamps::{LAMPS, LampView};
pub use lighting::{LIGHTS, Lighting, Shadows};
pub use material::{Material, Response};
pub use shadow_map::{ShadowMap, axes};
pub use shadow_tiles::{SHADOW_MAP_SIZE, ShadowTiles, shadow_maps};
pub use sky::SkyCell;

use glam::{Vec3A, Vec4};
use pass::{Pass, Pixel};
use rayon::prelude::*;
use renderflow_frame::Frame;
use renderflow_frame::ibl::{Shading, Surfaces, blend, blend_picture};
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::terms::ShadingTerms;
use screen_space::{Surface, filter, gather, horizon, march, reflect};
use sky::{Receiver, sky_share};

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

/// Which features run. A feature that is off costs nothing, and its term of [`Deferred`] is absent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Shadows of the lights.
    pub shadows: ShadowMode,
    /// Shadows of the rest of the environment by [`Shadows::sky`], where there are such maps.
    pub sky: bool,
    /// Ambient occlusion.
    pub occlusion: bool,
    /// Whether the rest of the environment is looked up along the bent normal instead of the normal. This needs `occlusion`, and
    /// has no effect where the sky has shadow maps, which answer the same question better.
    pub bent: bool,
    /// Screen-space reflections.
    pub reflections: bool,
    /// One bounce of indirect light: from what surrounds a pixel in the picture, and from the picture's mean colour where the
    /// sky's maps show that something outside the picture is in the way.
    pub indirect: bool,
}

impl Options {
    /// Every feature is off: the lights have no shadows, and the rest is the split sum.
    pub const NONE: Self =
        Self { shadows: ShadowMode::None, sky: false, occlusion: false, bent: false, reflections: false, indirect: false };
}

impl Default for Options {
    fn default() -> Self {
        Self { shadows: ShadowMode::Map, sky: true, occlusion: true, bent: true, reflections: true, indirect: true }
    }
}

/// The picture and its terms.
#[derive(Clone, Debug)]
pub struct Deferred {
    /// The picture, scene-linear radiance, background included.
    pub image: Rgb,
    /// Mean unoccluded direction (camera space, unit); `None` where occlusion is off.
    pub bent_normal: Option<Rgb>,
    /// What the picture is the sum of.
    pub terms: ShadingTerms,
    /// What the pixels show.
    pub surfaces: Surfaces,
}

/// A shadow map serves pixels that lie at least this many texels inside its border.
const MARGIN: f32 = 8.0;
/// Reach of ambient occlusion. The sky's maps account for larger occluders: on 30 sequences 0.1 was 1.3 dB better than 0.7, which
/// reaches large occluders too, and 0.05 was as good.
const CONTACT: horizon::Reach = horizon::Reach { radius: 0.1, thin: 0.03 };
/// Texels over which the taps of a sky map are spread.
const SKY_JITTER: f32 = 2.0;
/// Largest share of the light that may go on bouncing between surfaces.
const MOST_BOUNCED: f32 = 0.8;

/// Shades `frame`. Where two surfaces meet in a pixel, both are shaded and blended. The result has the same bits for any number
/// of threads, and pixels without coverage cost one look-up. The lists of `shadows` may be shorter than the lights and cells:
/// lights without a map are marched through the depth buffer, and cells of the sky without a map are open.
///
/// # Panics
/// When a channel of `frame` does not have `frame.width * frame.height` pixels.
pub fn shade(frame: &Frame, lighting: &Lighting, shadows: &Shadows, options: &Options) -> Deferred {
    let mut shading = lighting.shade(frame);
    let inputs = Inputs::new(frame, &shading, lighting, shadows, options);
    let pass = inputs.pass(frame, &shading, lighting, options);
    let lights = pass.parts();
    let (width, height) = (shading.surfaces.depth.width, shading.surfaces.depth.height);
    let mut direct = vec![Vec3A::ZERO; width * height * lights];
    let pixels = if lights == 0 {
        shade_pixels(&pass)
    } else {
        let chunks = direct.par_chunks_mut(lights).with_min_len(256).enumerate();
        chunks.map(|(i, direct)| pass.shade(i, direct)).collect()
    };
    let light = Gathered::new(&inputs, &pass, pixels);
    let rgb = |f: &(dyn Fn(usize) -> Vec3A + Sync)| picture_of(&shading, f);
    let share = |f: &(dyn Fn(usize) -> f32 + Sync)| {
        let pixels = (0..width * height).into_par_iter().with_min_len(1024).map(f).collect();
        Image { width, height, pixels }
    };
    let seen = |light: usize| share(&|i| pass.seen(i, light));
    let mut terms = ShadingTerms {
        direct: (0..lights).map(|light| rgb(&|i| direct[i * lights + light])).collect(),
        visibility: if options.shadows == ShadowMode::None { Vec::new() } else { (0..lighting.lights.len()).map(seen).collect() },
        occlusion: inputs.occlusion.as_ref().map(|o| share(&|i| o[i].w.clamp(0.0, 1.0))),
        sky: inputs.sky.as_ref().map(|s| share(&|i| s[i].x.clamp(0.0, 1.0))),
        ambient_diffuse: rgb(&|i| light.pixels[i].ambient_diffuse),
        ambient_specular: rgb(&|i| light.pixels[i].specular() * light.kept(i) + light.pixels[i].through),
        reflections: light.reflections.as_ref().map(|_| rgb(&|i| light.reflected(i))),
        indirect: light.indirect.as_ref().map(|_| rgb(&|i| light.bounced(i))),
        irradiance: shading.irradiance.clone(),
    };
    let mut bent_normal = inputs.occlusion.as_ref().map(|_| rgb(&|i| pass.bent(i)));
    let mut image = light.image(&shading);
    let edges = &shading.surfaces.edges;
    let pictures = [&mut image, &mut terms.ambient_diffuse, &mut terms.ambient_specular, &mut terms.irradiance];
    let optional = [&mut bent_normal, &mut terms.reflections, &mut terms.indirect];
    let pictures = pictures.into_iter().chain(optional.into_iter().flatten()).chain(&mut terms.direct);
    pictures.for_each(|picture| blend_picture(edges, picture));
    let shares = terms.visibility.iter_mut().chain(&mut terms.occlusion).chain(&mut terms.sky);
    shares.for_each(|share| blend(edges, &mut share.pixels, |a, b, share| (1.0 - share) * a + share * b));
    shading.surfaces.join();
    Deferred { image, bent_normal, terms, surfaces: shading.surfaces }
}

/// [`Deferred::image`] of [`shade`] alone, in less time.
///
/// # Panics
/// As [`shade`].
pub fn picture(frame: &Frame, lighting: &Lighting, shadows: &Shadows, options: &Options) -> Rgb {
    let shading = lighting.shade(frame);
    let inputs = Inputs::new(frame, &shading, lighting, shadows, options);
    let pass = inputs.pass(frame, &shading, lighting, options);
    let mut image = Gathered::new(&inputs, &pass, shade_pixels(&pass)).image(&shading);
    blend_picture(&shading.surfaces.edges, &mut image);
    image
}

/// Light of every pixel before reflections and bounces.
fn shade_pixels(pass: &Pass) -> Vec<Pixel> {
    let (pixels, lights) = (pass.shading.surfaces.depth.pixels.len(), pass.parts());
    let pixels = (0..pixels).into_par_iter().with_min_len(256);
    pixels.map_init(|| vec![Vec3A::ZERO; lights], |direct, i| pass.shade(i, direct)).collect()
}

/// A picture of `f(index)`, as large as `shading`.
fn picture_of(shading: &Shading, f: impl Fn(usize) -> Vec3A + Sync) -> Rgb {
    let Image { width, height, .. } = shading.surfaces.depth;
    let pixels = (0..width * height).into_par_iter().with_min_len(1024).map(|i| f(i).to_array()).collect();
    Rgb { width, height, pixels }
}

/// What stands in the way of light at each pixel.
struct Inputs<'a> {
    surface: Surface<'a>,
    /// Shares of the lights, four to a vector.
    visibility: Vec<Vec<Vec4>>,
    /// Bent normal and open share.
    occlusion: Option<Vec<Vec4>>,
    /// See [`sky`].
    sky: Option<Vec<Vec4>>,
    lamps: &'a [LampView],
}

impl<'a> Inputs<'a> {
    fn new(frame: &'a Frame, shading: &'a Shading, lighting: &Lighting, shadows: &'a Shadows, options: &Options) -> Self {
        let surface = Surface::new(shading, &frame.info.camera);
        let visibility = visibility(&surface, lighting, &shadows.lights, options.shadows);
        let occlusion = options.occlusion.then(|| {
            filter::smooth(&surface, Vec4::W, |i, phase| {
                let (open, bent) = horizon::occlusion(&surface, i, phase, CONTACT);
                bent.extend(open)
            })
        });
        let sky = (options.sky && !shadows.sky.is_empty()).then(|| sky(&surface, shading, lighting, shadows));
        Self { surface, visibility, occlusion, sky, lamps: &shadows.lamps }
    }

    fn pass(&'a self, frame: &'a Frame, shading: &'a Shading, lighting: &'a Lighting, options: &'a Options) -> Pass<'a> {
        Pass {
            camera: &frame.info.camera,
            lighting,
            options,
            shading,
            visibility: &self.visibility,
            sky: self.sky.as_deref(),
            occlusion: self.occlusion.as_deref(),
            lamps: self.lamps,
        }
    }
}

/// Light of every pixel, with reflections and bounces.
struct Gathered {
    pixels: Vec<Pixel>,
    indirect: Option<Vec<Vec3A>>,
    /// Reflected light, and the share of the lobe that meets the picture.
    reflections: Option<Vec<Vec4>>,
}

impl Gathered {
    fn new(inputs: &Inputs, pass: &Pass, mut pixels: Vec<Pixel>) -> Self {
        let (surface, surfaces, options) = (&inputs.surface, &pass.shading.surfaces, pass.options);
        let all = |pixels: &[Pixel]| (0..pixels.len()).into_par_iter().with_min_len(256);
        let covered = |i: usize| surface.known(i) && surfaces.alpha.pixels[i] > 0.0;
        let mut lit: Vec<Vec3A> = pixels.iter().map(Pixel::sum).collect();
        let indirect = options.indirect.then(|| {
            if let Some(sky) = &inputs.sky {
                let around = surroundings(&pixels, &lit, sky, covered);
                for ((pixel, lit), sky) in pixels.iter_mut().zip(&mut lit).zip(sky) {
                    let mirrored = pixel.reflected * around * (1.0 - sky.y).max(0.0);
                    pixel.ambient_specular += mirrored;
                    *lit += mirrored;
                    pixel.around = around;
                }
            }
            let gathered = filter::smooth(surface, Vec4::ZERO, |i, phase| {
                if pixels[i].white == Vec3A::ZERO { Vec4::ZERO } else { gather::gather(surface, &lit, i, phase) }
            });
            let bounce = |i: usize| {
                let near = gathered[i];
                let far = inputs.sky.as_ref().map_or(0.0, |sky| (1.0 - sky[i].z - near.w).max(0.0));
                pixels[i].white * (Vec3A::from_vec4(near) + pixels[i].around * far)
            };
            let bounced: Vec<Vec3A> = all(&pixels).map(bounce).collect();
            lit.iter_mut().zip(&bounced).for_each(|(lit, bounced)| *lit += *bounced);
            bounced
        });
        let reflections = options.reflections.then(|| {
            let Image { width, height, .. } = surfaces.depth;
            let pyramid = reflect::Pyramid::new(width, height, &lit, covered);
            let reflect = |i: usize| if covered(i) { pass.reflect(surface, &pyramid, i, &pixels[i]) } else { Vec4::ZERO };
            all(&pixels).map(reflect).collect::<Vec<Vec4>>()
        });
        Self { pixels, indirect, reflections }
    }

    /// Share of the specular light of the environment that reflections leave.
    fn kept(&self, i: usize) -> f32 {
        self.reflections.as_ref().map_or(1.0, |r| 1.0 - r[i].w)
    }

    fn reflected(&self, i: usize) -> Vec3A {
        self.reflections.as_ref().map_or(Vec3A::ZERO, |r| Vec3A::from_vec4(r[i]))
    }

    fn bounced(&self, i: usize) -> Vec3A {
        self.indirect.as_ref().map_or(Vec3A::ZERO, |b| b[i])
    }

    fn image(&self, shading: &Shading) -> Rgb {
        picture_of(shading, |i| {
            let (pixel, alpha) = (&self.pixels[i], shading.surfaces.alpha.pixels[i]);
            let specular = pixel.specular() * self.kept(i) + self.reflected(i);
            let surface = pixel.direct + pixel.ambient_diffuse + specular + self.bounced(i) + pixel.through;
            surface * alpha + Vec3A::from_array(shading.surfaces.background.pixels[i]) * (1.0 - alpha).max(0.0)
        })
    }
}

/// Share of each light that each pixel sees: one list for every four lights, with four lights to a vector.
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

/// What the sky's maps leave open at each pixel: shares of the sky's diffuse light, of its reflected light, and of its
/// directions; then 0.
fn sky(surface: &Surface, shading: &Shading, lighting: &Lighting, shadows: &Shadows) -> Vec<Vec4> {
    let to_world = surface.camera.camera_to_world;
    filter::smooth(surface, Vec4::ONE, |i, phase| {
        let (p, n) = (to_world.transform_point3a(surface.points[i]), to_world.matrix3 * surface.normal(i));
        let v = (to_world.translation - p).normalize_or(n);
        let mirror = n * (2.0 * n.dot(v)) - v;
        let jitter = [phase.0, phase.1].map(|at| (at - 0.5) * SKY_JITTER);
        let receiver = Receiver { p, n, mirror, roughness: shading.surfaces.material.pixels[i][0] };
        let share = sky_share(&lighting.sky, &shadows.sky, &receiver, jitter);
        Vec4::new(share.diffuse, share.specular, share.open, 0.0)
    })
}

/// Radiance of the scene's surroundings where they are not sky: the mean of the lit picture, brightened by the light that goes on
/// bouncing between surfaces that see each other. It is one light probe for the whole picture, so it does not vary from place to
/// place; it keeps a room from being black behind the camera.
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
