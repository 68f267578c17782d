//! The surfaces that a frame shows, as a scene: what is behind them is open. Path tracing then gives recovered buffers shadows
//! and bounced light, which shading pixel by pixel cannot.
//!
//! Pixels are vertices at their depth. Four neighbours are joined by two triangles, unless they belong to surfaces at different
//! depths. There, and at the edge of the picture, each pixel ends in a patch of its own that faces the camera, so that the camera
//! sees no gap between them. The scale of the depth does not matter, because the light of an environment has no distance.

use anyhow::{Context, Result};
use glam::{Affine3A, Vec2, Vec3, Vec3A, Vec4};
use renderflow_frame::image::Rgb;
use renderflow_frame::{Environment, Frame, Image};
use renderflow_renderer::denoise::Denoiser;
use renderflow_renderer::{Channels, RenderScene, Settings, render};
use renderflow_scenes::loaded::{Encoding, Instance, LoadReport, Material, Mesh, Texture, TextureSlot, Wrap};
use renderflow_scenes::{LoadedScene, Principled};
use std::sync::atomic::AtomicBool;

/// Neighbours whose depths differ by a smaller share are always joined.
const JOINED: f32 = 0.02;
/// Of a larger share, this much must be explained by the slant of one of both surfaces.
const EXPLAINED: f32 = 0.5;

/// How much the depths that are given count in a fit, relative to the slopes that normals give: slopes decide over less than some
/// thirty pixels.
const GIVEN: f64 = 1e-3;
/// Difference between the steps of the given depth and those by normals, in the logarithm, from which on they stand for an edge.
const EDGE: f64 = 0.02;
/// Iterations of a fit.
const ITERATIONS: usize = 300;

/// The picture of the surfaces of `frame` under `environment`, radiance, with `spp` samples for each pixel. `denoiser` denoises
/// it.
///
/// # Errors
/// When nothing is shown, or `cancel` was set.
pub fn traced(
    frame: &Frame,
    environment: &Environment,
    spp: u32,
    denoiser: Option<&mut Denoiser>,
    cancel: &AtomicBool,
) -> Result<Rgb> {
    let scene = RenderScene::compile(&shell(frame, environment))?;
    let channels = Channels { guides: true, ..Channels::BEAUTY };
    let picture = render(&scene, &Settings { spp, channels, ..Settings::default() }, &|_, _| (), cancel)?;
    let raw = picture.raw.context("the path tracer made no picture")?;
    match denoiser {
        Some(denoiser) => Ok(denoiser.denoise(&raw, picture.guide_albedo.as_ref(), picture.guide_normal.as_ref())?),
        None => Ok(raw),
    }
}

/// The scene. Albedo is the colour of vertices; roughness and metallic are a texture of the size of the picture. Specular and the
/// other parameters have their usual values.
fn shell(frame: &Frame, environment: &Environment) -> LoadedScene {
    let texel = |p: &[f32; 3]| [255, byte(p[0]), byte(p[1]), 255];
    let texels = frame.material.pixels.iter().map(texel).collect();
    let (size, wrap) = ([frame.width, frame.height], [Wrap::Clamp; 2]);
    let material = Material {
        surface: Principled { base_color: Vec3A::ONE, roughness: 1.0, metallic: 1.0, ..Principled::default() },
        metallic_roughness_texture: Some(TextureSlot::default()),
        ..Material::default()
    };
    let object = Instance { name: "shell".into(), mesh: 0, material: 0, object_id: 1, transforms: vec![Affine3A::IDENTITY] };
    LoadedScene {
        name: "shell".into(),
        seed: frame.info.seed,
        hash: String::new(),
        files: String::new(),
        meshes: vec![mesh(frame)],
        instances: vec![object],
        materials: vec![material],
        textures: vec![Texture::from_rgba8("material", size, texels, Encoding::Linear, wrap)],
        origin: frame.info.camera.origin,
        environment: environment.clone(),
        lights: Vec::new(),
        cameras: vec![frame.info.camera],
        report: LoadReport::default(),
    }
}

fn byte(share: f32) -> u8 {
    // A NaN becomes 0.
    (255.0 * share.clamp(0.0, 1.0)).round() as u8
}

/// The planar depth of `frame`, which a network has found, brought in accord with the normals that it has found: they have more
/// detail, and path tracing shows every step between neighbours as a shadow. Infinite where no surface is seen.
///
/// The logarithm `z` of the depth minimises `sum of w (z_j - z_i - s)^2 + GIVEN sum of (z - given)^2` over neighbours, where `s`
/// is the step that both normals give, and `w = (1 + (d / EDGE)^2)^-2` for the difference `d` between the given step and `s`.
/// This is the idea of bilateral normal integration (Cao et al. 2022) with other weights. The conjugate gradient method solves
/// it.
pub fn fitted(frame: &Frame) -> Image<f32> {
    let points = points(frame);
    let given: Vec<f64> = points.iter().map(|point| point.map_or(0.0, |point| f64::from(point.depth.ln()))).collect();
    let width = frame.width;
    // Neighbours, with the weight of their step and the step.
    let mut links = Vec::new();
    for (i, a) in points.iter().enumerate() {
        let right = (i % width + 1 < width).then_some(i + 1);
        for j in [right, Some(i + width)].into_iter().flatten() {
            if let (Some(a), Some(b)) = (a, points.get(j).copied().flatten()) {
                let step = f64::from(0.5 * (slant(frame, a.normal, i, j) - slant(frame, b.normal, j, i))).clamp(-0.5, 0.5);
                let off: f64 = (given[j] - given[i] - step) / EDGE;
                links.push((i, j, (1.0 + off * off).powi(-2), step));
            }
        }
    }
    let apply = |z: &[f64]| -> Vec<f64> {
        let mut out: Vec<f64> = z.iter().map(|z| GIVEN * z).collect();
        for &(i, j, weight, _) in &links {
            let pull = weight * (z[j] - z[i]);
            out[i] -= pull;
            out[j] += pull;
        }
        out
    };
    let mut target: Vec<f64> = given.iter().map(|z| GIVEN * z).collect();
    for &(i, j, weight, step) in &links {
        target[i] -= weight * step;
        target[j] += weight * step;
    }
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut z = given;
    let mut left: Vec<f64> = target.iter().zip(apply(&z)).map(|(target, now)| target - now).collect();
    let mut along = left.clone();
    let mut square = dot(&left, &left);
    let enough = 1e-12 * dot(&target, &target);
    for _ in 0..ITERATIONS {
        if square <= enough {
            break;
        }
        let curved = apply(&along);
        let length = square / dot(&along, &curved);
        z.iter_mut().zip(&along).for_each(|(z, along)| *z += length * along);
        left.iter_mut().zip(&curved).for_each(|(left, curved)| *left -= length * curved);
        let next = dot(&left, &left);
        along.iter_mut().zip(&left).for_each(|(along, left)| *along = left + next / square * *along);
        square = next;
    }
    let depth = |(point, z): (&Option<Point>, &f64)| if point.is_some() { z.exp() as f32 } else { f32::INFINITY };
    Image { width, height: frame.height, pixels: points.iter().zip(&z).map(depth).collect() }
}

/// Image point of the centre of a pixel.
fn place(frame: &Frame, index: usize) -> Vec2 {
    Vec2::new((index % frame.width) as f32 + 0.5, (index / frame.width) as f32 + 0.5)
}

/// The step from pixel `from` to pixel `to` of the logarithm of depth on a plane of a normal; 0 where the plane is not seen from
/// its front in both.
fn slant(frame: &Frame, normal: Vec3A, from: usize, to: usize) -> f32 {
    let [here, there] = [from, to].map(|index| normal.dot(frame.info.camera.direction_cam(place(frame, index))));
    if here < 0.0 && there < 0.0 { (here / there).ln() } else { 0.0 }
}

/// A pixel of the frame that shows a surface.
#[derive(Clone, Copy)]
struct Point {
    /// Planar depth.
    depth: f32,
    /// Unit normal in camera space.
    normal: Vec3A,
}

/// What builds the mesh.
struct Builder<'a> {
    frame: &'a Frame,
    points: Vec<Option<Point>>,
    /// Index of the vertex at the centre of each pixel.
    centres: Vec<Option<u32>>,
    mesh: Mesh,
}

/// The pixels that show a surface.
fn points(frame: &Frame) -> Vec<Option<Point>> {
    let point = |i: usize| {
        let (depth, normal) = (frame.depth.pixels[i], Vec3A::from(frame.normal.pixels[i]));
        let seen = frame.alpha.pixels[i] > 0.5 && depth.is_finite() && depth > 0.0;
        seen.then(|| Point { depth, normal: normal.normalize_or(Vec3A::Z) })
    };
    (0..frame.width * frame.height).map(point).collect()
}

fn mesh(frame: &Frame) -> Mesh {
    let points = points(frame);
    let centres = vec![None; points.len()];
    let mut builder = Builder { frame, points, centres, mesh: Mesh { name: "shell".into(), ..Mesh::default() } };
    // Blocks of four pixels, and of what is there of them at the edge of the picture.
    for y in 0..=frame.height {
        for x in 0..=frame.width {
            builder.block(x, y);
        }
    }
    builder.mesh
}

impl Builder<'_> {
    /// The pixel at a place that may lie outside, which is counted from one column and one row before the picture.
    fn at(&self, x: usize, y: usize) -> Option<(usize, Point)> {
        let (x, y) = (x.checked_sub(1)?, y.checked_sub(1)?);
        let inside = x < self.frame.width && y < self.frame.height;
        let index = inside.then_some(y * self.frame.width + x)?;
        Some((index, self.points[index]?))
    }

    /// Joins the pixels around the corner (`x`, `y`) of pixels.
    fn block(&mut self, x: usize, y: usize) {
        let corners = [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)].map(|(x, y)| self.at(x, y));
        if let [Some(a), Some(b), Some(c), Some(d)] = corners
            && [(a, b), (b, c), (c, d), (d, a)].into_iter().all(|(p, q)| self.joined(p, q))
        {
            let [a, b, c, d] = [a, b, c, d].map(|(index, _)| self.centre(index));
            // Rows run downwards, so that this is counter-clockwise for the camera.
            self.mesh.triangles.extend([[a, c, b], [a, d, c]]);
            return;
        }
        for (index, point) in corners.into_iter().flatten() {
            self.patch(index, point, Vec2::new(x as f32, y as f32));
        }
    }

    /// Whether two neighbours belong to one surface.
    fn joined(&self, (i, a): (usize, Point), (j, b): (usize, Point)) -> bool {
        let apart = (b.depth / a.depth).ln();
        if apart.abs() < JOINED {
            return true;
        }
        let left = |expected: f32| (apart - expected).abs();
        let expected = [slant(self.frame, a.normal, i, j), -slant(self.frame, b.normal, j, i)];
        left(expected[0]).min(left(expected[1])) < (1.0 - EXPLAINED) * apart.abs()
    }

    fn centre(&mut self, index: usize) -> u32 {
        if let Some(vertex) = self.centres[index] {
            return vertex;
        }
        let place = place(self.frame, index);
        let depth = self.points[index].map_or(1.0, |point| point.depth);
        let vertex = self.vertex(index, place, depth);
        self.centres[index] = Some(vertex);
        vertex
    }

    /// The quarter of a pixel towards `corner`, at the pixel's depth.
    fn patch(&mut self, index: usize, point: Point, corner: Vec2) {
        let centre = place(self.frame, index);
        let places = [centre, Vec2::new(corner.x, centre.y), corner, Vec2::new(centre.x, corner.y)];
        let [a, b, c, d] = places.map(|place| self.vertex(index, place, point.depth));
        let clockwise = (corner.x > centre.x) == (corner.y > centre.y);
        self.mesh.triangles.extend(if clockwise { [[a, c, b], [a, d, c]] } else { [[a, b, c], [a, c, d]] });
    }

    fn vertex(&mut self, index: usize, place: Vec2, depth: f32) -> u32 {
        let (frame, camera) = (self.frame, &self.frame.info.camera);
        let normal = self.points[index].map_or(Vec3A::Z, |point| point.normal);
        let [r, g, b] = frame.albedo.pixels[index];
        self.mesh.positions.push(Vec3::from(camera.unproject(place, depth)));
        self.mesh.normals.push(Vec3::from((camera.camera_to_world.matrix3 * normal).normalize()));
        self.mesh.uvs.push(place / Vec2::new(frame.width as f32, frame.height as f32));
        self.mesh.colors.push(Vec4::new(r, g, b, 1.0).clamp(Vec4::ZERO, Vec4::ONE));
        self.mesh.positions.len() as u32 - 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use renderflow_frame::{Camera, FrameInfo};

    /// A frame that sees, in every pixel, the depth and the normal of `surface`.
    fn frame(size: usize, surface: impl Fn(usize, usize) -> Option<(f32, Vec3A)>) -> Frame {
        let camera = Camera::look_at(Vec3A::new(0.0, 2.0, 5.0), Vec3A::ZERO, Vec3A::Y, 0.8, size, size);
        let seen = |x: usize, y: usize| surface(x, y);
        Frame {
            width: size,
            height: size,
            alpha: Image::from_fn(size, size, |x, y| if seen(x, y).is_some() { 1.0 } else { 0.0 }),
            albedo: Rgb::filled(size, size, [0.5, 0.25, 0.75]),
            normal: Rgb::from_fn(size, size, |x, y| seen(x, y).map_or([0.0; 3], |(_, n)| n.to_array())),
            depth: Image::from_fn(size, size, |x, y| seen(x, y).map_or(f32::INFINITY, |(depth, _)| depth)),
            material: Rgb::filled(size, size, [1.0, 0.0, 0.5]),
            info: FrameInfo { camera, ..FrameInfo::default() },
            ..Frame::default()
        }
    }

    /// The ground, y = 0, as that camera sees it.
    fn ground(size: usize) -> Frame {
        let camera = frame(size, |_, _| None).info.camera;
        let up = camera.world_to_camera().matrix3 * Vec3A::Y;
        frame(size, |x, y| {
            let direction = camera.direction_cam(Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
            let down = (camera.camera_to_world.matrix3 * direction).y;
            (down < 0.0).then(|| (camera.position().y / -down, up))
        })
    }

    #[test]
    fn a_slanted_surface_is_one_sheet_that_faces_the_camera() {
        let frame = ground(24);
        let mesh = mesh(&frame);
        assert!(mesh.normals.iter().all(|n| n.y > 0.999));
        let quads = mesh.triangles.iter().filter(|t| t.iter().all(|v| mesh.positions[*v as usize].y.abs() < 1e-4)).count() / 2;
        assert!(quads > 23 * 16, "{quads} blocks are joined");
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|v| mesh.positions[v as usize]);
            let (n, towards) = ((b - a).cross(c - a), Vec3::from(frame.info.camera.position()) - a);
            assert!(n.dot(towards) > 0.0, "{triangle:?}");
        }
    }

    /// White surfaces under white light show their albedo, without a gap where one stands in front of the other. Light that
    /// comes from the side is blocked.
    #[test]
    fn what_is_seen_is_lit_and_casts_shadows() {
        let facing = |depth: f32| Some((depth, Vec3A::Z));
        let steps = frame(32, |x, _| facing(if x < 16 { 3.0 } else { 6.0 }));
        let white = Environment::constant([1.0; 3]);
        let cancel = AtomicBool::new(false);
        let picture = traced(&steps, &white, 64, None, &cancel).unwrap();
        for (x, y) in [(3, 3), (14, 16), (15, 16), (16, 16), (17, 16), (28, 9)] {
            let [r, g, b] = *picture.at(x, y);
            // Bounces between both steps make some light more.
            assert!(r > 0.4 && r < 0.75 && g > 0.2 && b > 0.6, "{x} {y}: {r} {g} {b}");
        }
        // A bowl is darker inside than a plate.
        let hollow = |x: usize, y: usize| {
            let away = Vec2::new(x as f32 - 15.5, y as f32 - 15.5).length();
            facing(if away < 4.0 { 3.6 } else { 3.0 })
        };
        let bowl = traced(&frame(32, hollow), &white, 64, None, &cancel).unwrap();
        let plate = traced(&frame(32, |_, _| facing(3.6)), &white, 64, None, &cancel).unwrap();
        assert!(bowl.at(16, 16)[1] < 0.8 * plate.at(16, 16)[1], "{:?} {:?}", bowl.at(16, 16), plate.at(16, 16));
    }

    /// Depth with noise on a plane, and a step that normals do not explain.
    #[test]
    fn depth_follows_normals_and_keeps_steps() {
        let noise = |x: usize, y: usize| 0.01 * ((x * 7919 + y * 104_729) as f32).sin();
        let plane = ground(24);
        let mut noisy = plane.clone();
        noisy.depth = Image::from_fn(24, 24, |x, y| plane.depth.at(x, y) * noise(x, y).exp());
        let fitted = fitted(&noisy);
        let far = |depth: &Image<f32>| {
            let seen = depth.pixels.iter().zip(&plane.depth.pixels).filter(|(_, truth)| truth.is_finite());
            seen.map(|(found, truth)| (found / truth).ln().powi(2)).sum::<f32>().sqrt()
        };
        assert!(far(&fitted) < 0.25 * far(&noisy.depth), "{} of {}", far(&fitted), far(&noisy.depth));
        assert!(fitted.pixels.iter().zip(&plane.depth.pixels).all(|(found, truth)| found.is_finite() == truth.is_finite()));
        let steps = frame(24, |x, _| Some((if x < 12 { 3.0 } else { 6.0 }, Vec3A::Z)));
        let kept = super::fitted(&steps);
        assert!(
            (kept.at(3, 3) - 3.0).abs() < 0.02 && (kept.at(20, 20) - 6.0).abs() < 0.02,
            "{} {}",
            kept.at(3, 3),
            kept.at(20, 20)
        );
    }

    #[test]
    fn numbers_that_mean_nothing_are_no_surface() {
        let odd = frame(4, |x, y| match (x, y) {
            (0, 0) => Some((f32::NAN, Vec3A::Z)),
            (1, 0) => Some((-1.0, Vec3A::Z)),
            (2, 0) => Some((f32::INFINITY, Vec3A::Z)),
            (3, 3) => Some((2.0, Vec3A::ZERO)),
            _ => None,
        });
        assert_eq!(mesh(&odd).triangles.len(), 8);
        let nothing = frame(4, |_, _| None);
        let cancel = AtomicBool::new(false);
        let picture = traced(&nothing, &Environment::constant([0.5; 3]), 1, None, &cancel);
        assert!(picture.is_err() || picture.is_ok_and(|picture| *picture.at(2, 2) == [0.5; 3]));
    }
}
