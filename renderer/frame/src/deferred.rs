//! Deferred shading as a good game engine does it from rasterisable data: the dominant lights analytic and shadowed by shadow maps,
//! the rest of the environment by the split sum with ambient occlusion, screen-space reflections, and one bounce of indirect light.
//!
//! A baseline that works: [`Lighting::new`] once a sequence, shadow maps once a frame (the renderer fills them), [`shade`] per frame.

mod lighting;
mod material;
mod shadow;
mod sky;

pub use lighting::{LIGHTS, Lighting, Shadows};
pub use material::{Material, Response};
pub use shadow::{ShadowMap, axes, receivers};
pub use sky::{SKY_CELLS, SkyCell, SkyShare, sky_cells, sky_share};

use crate::camera::Camera;
use crate::color::luminance;
use crate::frame::Frame;
use crate::ibl::{self, Shading};
use crate::image::{Image, Rgb};
use crate::screen_space::{Surface, filter, gather, horizon, march, reflect};
use glam::{Vec2, Vec3A, Vec4};
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
    /// The rest of the environment is looked up along the bent normal instead of the normal; needs `occlusion`.
    pub bent: bool,
    /// Screen-space reflections.
    pub reflections: bool,
    /// One bounce of screen-space indirect light.
    pub indirect: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { shadows: ShadowMode::Map, sky: true, occlusion: true, bent: true, reflections: true, indirect: true }
    }
}

/// The picture and its parts, scene-linear radiance; parts are 0 where nothing is covered, and not multiplied by coverage:
/// `image = alpha * (sum of direct + ambient_diffuse + ambient_specular + reflections + indirect) + (1 - alpha) * background`.
#[derive(Clone, Debug)]
pub struct Deferred {
    /// The picture, background included.
    pub image: Rgb,
    /// Light that each of [`Lighting::lights`] sends to the camera, shadows applied.
    pub direct: Vec<Rgb>,
    /// Share of each light that a pixel sees, 0..=1; empty without shadows.
    pub visibility: Vec<Image<f32>>,
    /// Visible share of the cosine-weighted hemisphere, `None` without occlusion.
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

/// Roughness up to which surfaces mirror the lights in their own shape, and from which on they are discs.
const MIRROR: [f32; 2] = [0.1, 0.3];
/// Roughness up to which screen-space reflections count fully, and from which on they do not.
const REFLECTIVE: [f32; 2] = [0.6, 0.9];
/// Half-angle's tangent of the cone of a reflection, in units of the GGX width.
const CONE: f32 = 1.0;
/// Texels from a shadow map's border on which a pixel is shadowed by it.
const MARGIN: f32 = 8.0;

/// Shades `frame` as seen by `camera`. `shadow_maps` are one list a light, the finest map first: a pixel takes the first that covers it.
/// The same bits for any number of threads; pixels without coverage cost one look-up. `shadow_maps` may be empty or shorter than the
/// lights.
///
/// # Panics
/// When a channel of `frame` has not `frame.width * frame.height` pixels.
pub fn shade(frame: &Frame, camera: &Camera, lighting: &Lighting, shadows: &Shadows, options: &Options) -> Deferred {
    let shading = ibl::shade(frame, camera, &lighting.environment, &lighting.tables);
    let surface = Surface::new(&shading, camera);
    let visibility = visibility(&surface, camera, lighting, &shadows.lights, options.shadows);
    let occlusion = options.occlusion.then(|| {
        let reach = horizon::Reach { radius: 0.1, thin: 0.03 };
        filter::smooth(&surface, Vec4::W, |i, phase| {
            let (open, bent) = horizon::occlusion(&surface, i, phase, reach);
            bent.extend(open)
        })
    });
    let jitter = 2.0;
    let sky = (options.sky && !shadows.sky.is_empty()).then(|| {
        filter::smooth(&surface, Vec4::ONE, |i, phase| {
            let p = camera.camera_to_world.transform_point3a(surface.points[i]);
            let n = camera.camera_to_world.matrix3 * surface.normal(i);
            let v = (camera.position() - p).normalize_or(n);
            let mirror = n * (2.0 * n.dot(v)) - v;
            let roughness = shading.material.pixels[i][0];
            let moved = [phase.0, phase.1].map(|at| (at - 0.5) * jitter);
            let share = sky_share(&lighting.sky, &shadows.sky, p, n, mirror, roughness, moved);
            Vec4::new(luminance(share.diffuse.to_array()), share.specular, share.open, 0.0)
        })
    });
    let pass = Pass {
        sky: sky.as_deref(),
        camera,
        lighting,
        options,
        shading: &shading,
        visibility: &visibility,
        occlusion: occlusion.as_deref(),
    };
    let (width, height) = (shading.depth.width, shading.depth.height);
    let mut pixels: Vec<Pixel> = Vec::new();
    (0..width * height).into_par_iter().with_min_len(256).map(|i| pass.shade(i)).collect_into_vec(&mut pixels);
    let covered = |i: usize| surface.known(i) && shading.alpha.pixels[i] > 0.0;

    let mut lit: Vec<Vec3A> = pixels.iter().map(|pixel| pixel.direct + pixel.ambient_diffuse + pixel.specular()).collect();
    let indirect = options.indirect.then(|| {
        let gathered = filter::smooth(&surface, Vec4::ZERO, |i, phase| {
            if pixels[i].white == Vec3A::ZERO { Vec4::ZERO } else { gather::gather(&surface, &lit, i, phase).extend(0.0) }
        });
        let bounced: Vec<Vec3A> = pixels.iter().zip(&gathered).map(|(pixel, g)| pixel.white * Vec3A::from_vec4(*g)).collect();
        lit.iter_mut().zip(&bounced).for_each(|(lit, bounced)| *lit += *bounced);
        bounced
    });
    let reflections = options.reflections.then(|| {
        let pyramid = reflect::Pyramid::new(width, height, &lit, covered);
        let reflect = |i: usize| if covered(i) { pass.reflect(&surface, &pyramid, i, &pixels[i]) } else { Vec4::ZERO };
        (0..width * height).into_par_iter().with_min_len(256).map(reflect).collect::<Vec<Vec4>>()
    });
    let rgb = |f: &(dyn Fn(usize) -> Vec3A + Sync)| {
        let pixels = (0..width * height).into_par_iter().with_min_len(1024).map(|i| f(i).to_array()).collect();
        Rgb { width, height, pixels }
    };
    let kept = |i: usize| reflections.as_ref().map_or(1.0, |r| 1.0 - r[i].w);
    let reflected = |i: usize| reflections.as_ref().map_or(Vec3A::ZERO, |r| Vec3A::from_vec4(r[i]));
    let bounced = |i: usize| indirect.as_ref().map_or(Vec3A::ZERO, |b| b[i]);
    let image = rgb(&|i| {
        let (pixel, alpha) = (&pixels[i], shading.alpha.pixels[i]);
        let surface = pixel.direct + pixel.ambient_diffuse + pixel.specular() * kept(i) + reflected(i) + bounced(i);
        surface * alpha + Vec3A::from_array(shading.background.pixels[i]) * (1.0 - alpha).max(0.0)
    });
    let lights = lighting.lights.len();
    Deferred {
        image,
        direct: (0..lights).map(|light| rgb(&|i| pass.direct(i, light).0)).collect(),
        visibility: visibility
            .iter()
            .flat_map(|four| (0..4).map(|k| four.iter().map(|v| v[k].clamp(0.0, 1.0)).collect()))
            .take(if options.shadows == ShadowMode::None { 0 } else { lights })
            .map(|pixels| Image { width, height, pixels })
            .collect(),
        occlusion: occlusion.as_ref().map(|o| Image { width, height, pixels: o.iter().map(|o| o.w.clamp(0.0, 1.0)).collect() }),
        bent_normal: occlusion.as_ref().map(|_| rgb(&|i| pass.bent(i))),
        ambient_diffuse: rgb(&|i| pixels[i].ambient_diffuse),
        ambient_specular: rgb(&|i| pixels[i].specular() * kept(i)),
        reflections: reflections.as_ref().map(|_| rgb(&reflected)),
        indirect: indirect.as_ref().map(|_| rgb(&bounced)),
        shading,
    }
}

/// Share of each light that each pixel sees: four lights a vector, one list for each four lights.
fn visibility(
    surface: &Surface,
    camera: &Camera,
    lighting: &Lighting,
    maps: &[Vec<ShadowMap>],
    mode: ShadowMode,
) -> Vec<Vec<Vec4>> {
    if mode == ShadowMode::None {
        return Vec::new();
    }
    let to_camera = camera.world_to_camera().matrix3;
    let four = |first: usize| {
        let lights = &lighting.lights[first..(first + 4).min(lighting.lights.len())];
        filter::smooth(surface, Vec4::ONE, |i, phase| {
            let mut seen = Vec4::ZERO;
            let n_cam = surface.normal(i);
            for (k, light) in lights.iter().enumerate() {
                let towards = to_camera * light.direction;
                if n_cam.dot(towards) <= -light.angular_radius.sin() {
                    continue;
                }
                let maps = if mode == ShadowMode::Map { maps.get(first + k).map_or(&[][..], Vec::as_slice) } else { &[] };
                seen[k] = if maps.is_empty() {
                    march::visibility(surface, i, towards, phase)
                } else {
                    let p_world = camera.camera_to_world.transform_point3a(surface.points[i]);
                    let n_world = camera.camera_to_world.matrix3 * n_cam;
                    let map = maps.iter().find(|map| map.covers(p_world, MARGIN)).or(maps.last());
                    map.map_or(1.0, |map| map.visibility(p_world, n_world, light.angular_radius, phase.0))
                };
            }
            seen
        })
    };
    (0..lighting.lights.len()).step_by(4).map(four).collect()
}

/// What all pixels share.
struct Pass<'a> {
    camera: &'a Camera,
    lighting: &'a Lighting,
    options: &'a Options,
    shading: &'a Shading,
    visibility: &'a [Vec<Vec4>],
    /// Shares of the sky's diffuse and specular light, and of its directions.
    sky: Option<&'a [Vec4]>,
    /// Bent normal, and the open share.
    occlusion: Option<&'a [Vec4]>,
}

/// One pixel's light, before reflections and bounces.
#[derive(Clone, Copy, Debug, Default)]
struct Pixel {
    direct: Vec3A,
    ambient_diffuse: Vec3A,
    /// Rest of the environment from the mirror direction, specular occlusion applied, reflected.
    ambient_specular: Vec3A,
    /// Lights mirrored by a smooth surface.
    mirrored: Vec3A,
    /// What the base sends out for an irradiance of pi, and the lobe under even light of 1.
    white: Vec3A,
    reflected: Vec3A,
}

impl Pixel {
    fn specular(&self) -> Vec3A {
        self.ambient_specular + self.mirrored
    }
}

/// World-space unit normal (turned to the camera) and view direction of a pixel, and their cosine.
struct View {
    n: Vec3A,
    v: Vec3A,
    n_dot_v: f32,
}

impl Pass<'_> {
    fn view(&self, i: usize) -> View {
        let width = self.shading.depth.width;
        let at = Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
        let v = -self.camera.ray_direction(at);
        let n = (self.camera.camera_to_world.matrix3 * Vec3A::from_array(self.shading.normal.pixels[i])).normalize_or(v);
        View { n, v, n_dot_v: n.dot(v).max(1e-3) }
    }

    fn material(&self, i: usize, view: &View) -> Material {
        Material::new(Vec3A::from_array(self.shading.albedo.pixels[i]), self.shading.material.pixels[i], view.n_dot_v)
    }

    fn seen(&self, i: usize, light: usize) -> f32 {
        self.visibility.get(light / 4).map_or(1.0, |four| four[i][light % 4].clamp(0.0, 1.0))
    }

    fn bent(&self, i: usize) -> Vec3A {
        let n = Vec3A::from_array(self.shading.normal.pixels[i]);
        self.occlusion.map_or(n, |o| Vec3A::from_vec4(o[i]).normalize_or(n))
    }

    /// How much of the light is that of discs: smooth surfaces mirror the lights themselves.
    fn discs(&self, i: usize) -> f32 {
        if self.lighting.whole.is_none() { 1.0 } else { smoothstep(MIRROR, self.shading.material.pixels[i][0]) }
    }

    /// Light of one of the lights at pixel `i`, shadowed; and its specular part without shadow and however smooth.
    fn direct(&self, i: usize, light: usize) -> (Vec3A, f32) {
        if self.shading.alpha.pixels[i] <= 0.0 {
            return (Vec3A::ZERO, 0.0);
        }
        let view = self.view(i);
        self.direct_of(i, light, &view, &self.material(i, &view))
    }

    fn direct_of(&self, i: usize, number: usize, view: &View, material: &Material) -> (Vec3A, f32) {
        let light = &self.lighting.lights[number];
        let cosine = disc_cosine(view.n.dot(light.direction), light.angular_radius);
        let response = material.respond(view.n, view.v, light.direction, cosine, light.angular_radius);
        let irradiance = Vec3A::from_array(light.irradiance) * self.seen(i, number);
        ((response.diffuse + response.specular * self.discs(i)) * irradiance, response.specular.element_sum())
    }

    fn shade(&self, i: usize) -> Pixel {
        let shading = self.shading;
        if shading.alpha.pixels[i] <= 0.0 {
            return Pixel::default();
        }
        let view = self.view(i);
        let material = self.material(i, &view);
        let mut pixel = Pixel { white: material.base * material.transmitted, reflected: material.reflected, ..Pixel::default() };
        let (mut seen, mut weight) = (0.0, 0.0);
        for light in 0..self.lighting.lights.len() {
            let (direct, specular) = self.direct_of(i, light, &view, &material);
            pixel.direct += direct;
            let specular = specular * luminance(self.lighting.lights[light].irradiance) + 1e-20;
            seen += self.seen(i, light) * specular;
            weight += specular;
        }
        let roughness = shading.material.pixels[i][0];
        let mirror = view.n * (2.0 * view.n.dot(view.v)) - view.v;
        let prefiltered = Vec3A::from_array(shading.prefiltered.pixels[i]);
        let (mut open, mut specular_open) = (Vec3A::ONE, 1.0);
        let mut irradiance = Vec3A::from_array(shading.irradiance.pixels[i]);
        if let Some(occlusion) = self.occlusion {
            let visible = occlusion[i].w.clamp(0.0, 1.0);
            let bent = self.camera.camera_to_world.matrix3 * self.bent(i);
            open = if self.options.indirect { Vec3A::splat(visible) } else { multi_bounce(visible, pixel.white) };
            if self.options.bent {
                irradiance = Vec3A::from_array(self.lighting.tables.irradiance(bent));
            }
        }
        if let Some(sky) = self.sky {
            open *= 1.0 + (sky[i].x - 1.0) * 0.7;
            specular_open *= 1.0 + (sky[i].y - 1.0) * 0.7;
        }
        pixel.ambient_diffuse = pixel.white * irradiance * open;
        pixel.ambient_specular = material.reflected * prefiltered * specular_open;
        if let Some(whole) = &self.lighting.whole
            && weight > 0.0
        {
            let discs = self.discs(i);
            if discs < 1.0 {
                let lights = (Vec3A::from_array(whole.prefiltered(mirror, roughness)) - prefiltered).max(Vec3A::ZERO);
                pixel.mirrored = material.reflected * lights * ((1.0 - discs) * seen / weight);
            }
        }
        pixel
    }

    /// Light of the picture that pixel `i` reflects, and the share of the lobe that meets it.
    fn reflect(&self, surface: &Surface, pyramid: &reflect::Pyramid, i: usize, pixel: &Pixel) -> Vec4 {
        let width = self.shading.depth.width;
        let roughness = self.shading.material.pixels[i][0];
        let strength = 1.0 - smoothstep(REFLECTIVE, roughness);
        if strength <= 0.0 || pixel.reflected.max_element() < 1e-4 {
            return Vec4::ZERO;
        }
        let n = surface.normal(i);
        let towards = surface.points[i].normalize();
        let direction = towards - n * (2.0 * n.dot(towards));
        if n.dot(direction) <= 0.0 {
            return Vec4::ZERO;
        }
        let (_, step) = crate::screen_space::phase(i % width, i / width);
        let Some(meeting) = reflect::march(surface, i, direction, step) else { return Vec4::ZERO };
        let there = surface.pixel(meeting.at[0], meeting.at[1]).map_or(-surface.points[i].z, |j| -surface.points[j].z);
        let radius = meeting.distance * roughness * roughness * CONE * self.camera.fl_x / there.max(1e-6);
        let (colour, covered) = pyramid.sample(meeting.at, radius);
        let share = strength * meeting.confidence * covered;
        (pixel.reflected * colour * share).extend(share)
    }
}

fn smoothstep([low, high]: [f32; 2], x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Mean cosine over a disc of `radius` radians, the part below the horizon counted as 0 (for small discs).
fn disc_cosine(cosine: f32, radius: f32) -> f32 {
    let edge = radius.sin();
    if cosine >= edge {
        cosine
    } else if cosine <= -edge || edge <= 0.0 {
        0.0
    } else {
        (cosine + edge) * (cosine + edge) / (4.0 * edge)
    }
}

/// Occlusion brightened by light that bounces between surfaces of the same colour (Jimenez et al. 2016).
fn multi_bounce(open: f32, colour: Vec3A) -> Vec3A {
    let (a, b, c) = (colour * 2.0404 - 0.3324, colour * -4.7951 + 0.6417, colour * 2.7552 + 0.6903);
    (((a * open + b) * open + c) * open).max(Vec3A::splat(open)).min(Vec3A::ONE)
}
