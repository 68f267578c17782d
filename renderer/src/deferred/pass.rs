//! Shades one pixel.

use super::screen_space::{Surface, phase, reflect};
use super::{LampView, Lighting, Material, Options};
use crate::material::Principled;
use glam::{Vec2, Vec3A, Vec4};
use renderflow_frame::Camera;
use renderflow_frame::color::luminance;
use renderflow_frame::ibl::{Shading, Surfaces};

/// Up to the first roughness surfaces mirror the lights in their true shape; from the second one on lights are discs.
const MIRROR: [f32; 2] = [0.1, 0.3];
/// Up to the first roughness screen-space reflections count fully; from the second one on they do not count.
const REFLECTIVE: [f32; 2] = [0.6, 0.9];
/// Tangent of the half-angle of a reflection's cone, in units of the GGX width.
const CONE: f32 = 1.0;
/// Share of the blocked sky's light that the occluders send instead, where indirect light is off.
const BOUNCED: f32 = 0.3;

/// Whether a surface is so smooth that it mirrors the lights in their true shape.
pub fn mirrors(surfaces: &Surfaces) -> bool {
    let mut seen = surfaces.material.pixels.iter().zip(&surfaces.alpha.pixels).filter(|(_, alpha)| **alpha > 0.0);
    seen.any(|([roughness, ..], _)| *roughness < MIRROR[1])
}

/// Inputs that all pixels share.
pub struct Pass<'a> {
    pub camera: &'a Camera,
    pub lighting: &'a Lighting,
    pub options: &'a Options,
    pub shading: &'a Shading,
    pub visibility: &'a [Vec<Vec4>],
    /// Shares of the sky's diffuse and specular light, and of its directions.
    pub sky: Option<&'a [Vec4]>,
    /// Bent normal, and the open share.
    pub occlusion: Option<&'a [Vec4]>,
    /// Lights of the scene itself.
    pub lamps: &'a [LampView],
}

/// One pixel's light, before reflections and bounces.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pixel {
    pub direct: Vec3A,
    pub ambient_diffuse: Vec3A,
    /// Rest of the environment from the mirror direction, specular occlusion applied, reflected.
    pub ambient_specular: Vec3A,
    /// Lights mirrored by a smooth surface.
    pub mirrored: Vec3A,
    /// The environment behind clear surfaces.
    pub through: Vec3A,
    /// Radiance of the base for an irradiance of pi, and radiance of the lobe under even light of 1.
    pub white: Vec3A,
    pub reflected: Vec3A,
    /// Radiance of the surroundings that are not sky.
    pub around: Vec3A,
}

impl Pixel {
    /// Reflection of environment and surroundings in the GGX lobe.
    pub fn specular(&self) -> Vec3A {
        self.ambient_specular + self.mirrored
    }

    /// All light except reflections and bounces.
    pub fn sum(&self) -> Vec3A {
        self.direct + self.ambient_diffuse + self.specular() + self.through
    }
}

/// World-space unit normal (turned to the camera) and view direction of a pixel, and the cosine of the latter with the normal of
/// what mirrors.
struct View {
    n: Vec3A,
    v: Vec3A,
    n_dot_v: f32,
}

impl Pass<'_> {
    fn view(&self, i: usize) -> View {
        let width = self.shading.surfaces.depth.width;
        let at = Vec2::new((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
        let v = -self.camera.ray_direction(at);
        let (surfaces, turn) = (&self.shading.surfaces, self.camera.camera_to_world.matrix3);
        let n = (turn * Vec3A::from_array(surfaces.normal.pixels[i])).normalize_or(v);
        View { n, v, n_dot_v: (turn * surfaces.front_normal(i)).normalize_or(v).dot(v).max(1e-3) }
    }

    fn material(&self, i: usize, view: &View) -> Material {
        Material::new(&surface(&self.shading.surfaces, i), view.n_dot_v)
    }

    /// Share of a light that pixel `i` sees.
    pub fn seen(&self, i: usize, light: usize) -> f32 {
        self.visibility.get(light / 4).map_or(1.0, |four| four[i][light % 4].clamp(0.0, 1.0))
    }

    /// Bent normal of pixel `i`, camera space.
    pub fn bent(&self, i: usize) -> Vec3A {
        let n = Vec3A::from_array(self.shading.surfaces.normal.pixels[i]);
        self.occlusion.map_or(n, |o| Vec3A::from_vec4(o[i]).normalize_or(n))
    }

    /// Share of the specular light that treats lights as discs; smooth surfaces mirror the lights in their true shape.
    fn discs(&self, i: usize) -> f32 {
        if self.lighting.lights.is_empty() { 1.0 } else { smoothstep(MIRROR, self.shading.surfaces.material.pixels[i][0]) }
    }

    /// Light of one of the lights with its shadow; and its specular part without shadow, for any roughness.
    fn direct_of(&self, i: usize, number: usize, view: &View, material: &Material) -> (Vec3A, f32) {
        let light = &self.lighting.lights[number];
        let toward = |n: Vec3A| {
            let cosine = disc_cosine(n.dot(light.direction), light.angular_radius);
            material.respond(n, view.v, light.direction, cosine, light.angular_radius)
        };
        let mut response = toward(view.n);
        let turn = self.camera.camera_to_world.matrix3;
        response.specular = self.shading.surfaces.over_parts(i, |normal| toward(turn * normal).specular);
        let irradiance = Vec3A::from_array(light.irradiance) * self.seen(i, number);
        ((response.diffuse + response.specular * self.discs(i)) * irradiance, response.specular.element_sum())
    }

    /// Number of parts of the direct light: each dominant light of the environment, then all lights of the scene itself together,
    /// if there are any.
    pub fn parts(&self) -> usize {
        self.lighting.lights.len() + usize::from(!self.lamps.is_empty())
    }

    /// Light of the scene's own lights at pixel `i`.
    fn lamps_at(&self, i: usize, view: &View, material: &Material) -> Vec3A {
        let depth = &self.shading.surfaces.depth;
        let at = Vec2::new((i % depth.width) as f32 + 0.5, (i / depth.width) as f32 + 0.5);
        let p = self.camera.unproject(at, depth.pixels[i]);
        let of = |(wi, irradiance): (Vec3A, Vec3A)| {
            let response = material.respond(view.n, view.v, wi, view.n.dot(wi), 0.0);
            (response.diffuse + response.specular) * irradiance
        };
        self.lamps.iter().filter_map(|lamp| lamp.at(i, p)).map(of).sum()
    }

    /// Light of pixel `i`; its [parts](Self::parts) of direct light go into `parts`.
    pub fn shade(&self, i: usize, parts: &mut [Vec3A]) -> Pixel {
        let shading = self.shading;
        if shading.surfaces.alpha.pixels[i] <= 0.0 {
            return Pixel::default();
        }
        let view = self.view(i);
        let material = self.material(i, &view);
        let mut pixel = Pixel { white: material.base * material.transmitted, reflected: material.reflected, ..Pixel::default() };
        let (mut seen, mut weight) = (0.0, 0.0);
        let (distant, own) = parts.split_at_mut(self.lighting.lights.len());
        for part in own {
            *part = self.lamps_at(i, &view, &material);
            pixel.direct += *part;
        }
        for (light, part) in distant.iter_mut().enumerate() {
            let (direct, specular) = self.direct_of(i, light, &view, &material);
            *part = direct;
            pixel.direct += direct;
            let specular = specular * luminance(self.lighting.lights[light].irradiance) + 1e-20;
            seen += self.seen(i, light) * specular;
            weight += specular;
        }
        let prefiltered = Vec3A::from_array(shading.prefiltered.pixels[i]);
        let (mut open, mut specular_open) = (Vec3A::ONE, 1.0);
        let mut irradiance = Vec3A::from_array(shading.irradiance.pixels[i]);
        if let Some(occlusion) = self.occlusion {
            let visible = occlusion[i].w.clamp(0.0, 1.0);
            let bent = self.camera.camera_to_world.matrix3 * self.bent(i);
            open = if self.options.indirect { Vec3A::splat(visible) } else { multi_bounce(visible, pixel.white) };
            // The sky's maps already tell which part of it is open: bending the normal as well was 0.06 dB worse on 42 sequences.
            if self.options.bent && self.sky.is_none() {
                irradiance = Vec3A::from_array(self.lighting.rest().irradiance(bent));
            }
        }
        if let Some(sky) = self.sky {
            let least = if self.options.indirect { 0.0 } else { BOUNCED };
            // The smaller of both, as both see the same occluders: their product was 0.2 dB worse than no ambient occlusion at
            // all.
            open = open.min(Vec3A::splat(least + (1.0 - least) * sky[i].x.clamp(0.0, 1.0)));
            specular_open = least + (1.0 - least) * sky[i].y.clamp(0.0, 1.0);
        }
        pixel.ambient_diffuse = pixel.white * irradiance * open;
        pixel.through = shading.surfaces.through.as_ref().map_or(Vec3A::ZERO, |through| Vec3A::from_array(through.pixels[i]));
        pixel.ambient_specular = material.reflected * prefiltered * specular_open;
        if weight > 0.0 {
            let discs = self.discs(i);
            if discs < 1.0 {
                let whole = shading.surfaces.mirrored(i, self.camera, view.v, self.lighting.whole.tables());
                let lights = (whole - prefiltered).max(Vec3A::ZERO);
                pixel.mirrored = material.reflected * lights * ((1.0 - discs) * seen / weight);
            }
        }
        pixel
    }

    /// Light of the picture that pixel `i` reflects, and the share of its lobe that meets the picture.
    pub fn reflect(&self, surface: &Surface, pyramid: &reflect::Pyramid, i: usize, pixel: &Pixel) -> Vec4 {
        let width = self.shading.surfaces.depth.width;
        let roughness = self.shading.surfaces.material.pixels[i][0];
        let strength = 1.0 - smoothstep(REFLECTIVE, roughness);
        if strength <= 0.0 || pixel.reflected.max_element() < 1e-4 {
            return Vec4::ZERO;
        }
        let n = self.shading.surfaces.front_normal(i);
        let towards = surface.points[i].normalize();
        let direction = towards - n * (2.0 * n.dot(towards));
        if n.dot(direction) <= 0.0 {
            return Vec4::ZERO;
        }
        let (_, step) = phase(i % width, i / width);
        let Some(meeting) = reflect::march(surface, i, direction, step) else { return Vec4::ZERO };
        let there = surface.pixel(meeting.at[0], meeting.at[1]).map_or(-surface.points[i].z, |j| -surface.points[j].z);
        let radius = meeting.distance * roughness * roughness * CONE * self.camera.fl_x / there.max(1e-6);
        let (colour, covered) = pyramid.sample(meeting.at, radius);
        let share = strength * meeting.confidence * covered;
        (pixel.reflected * colour * share).extend(share)
    }
}

/// The parameters that a G-buffer stores of pixel `i`; the others have their defaults.
fn surface(surfaces: &Surfaces, i: usize) -> Principled {
    let [roughness, metallic, specular] = surfaces.material.pixels[i];
    Principled {
        base_color: Vec3A::from_array(surfaces.albedo.pixels[i]),
        metallic,
        roughness,
        specular,
        ..Principled::default()
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

/// Occlusion, brightened by light that bounces between surfaces of the same colour (Jimenez et al. 2016).
fn multi_bounce(open: f32, colour: Vec3A) -> Vec3A {
    let (a, b, c) = (colour * 2.0404 - 0.3324, colour * -4.7951 + 0.6417, colour * 2.7552 + 0.6903);
    (((a * open + b) * open + c) * open).max(Vec3A::splat(open)).min(Vec3A::ONE)
}
