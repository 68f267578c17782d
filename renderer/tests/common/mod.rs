//! Scenes made in memory, shared by the tests.
#![allow(dead_code)] // Every test file uses its own part of this.

use glam::{Affine3A, Vec2, Vec3, Vec3A};
use renderflow_frame::{Camera, Environment, Frame};
use renderflow_renderer::verify::scenes::{self, Part};
#[allow(unused_imports)]
pub use renderflow_renderer::verify::scenes::{camera, diffuse, instance};
use renderflow_renderer::{RenderScene, Settings, Stats, render_with_stats};
use renderflow_scenes::{LoadedScene, Material, Mesh};
use std::sync::atomic::AtomicBool;

/// A sphere of radius 1 about the origin with `2 * rings` segments.
pub fn sphere(rings: u32, smooth: bool) -> Mesh {
    let segments = 2 * rings;
    let mut mesh = Mesh { name: "sphere".into(), ..Mesh::default() };
    for i in 0..=rings {
        let theta = std::f64::consts::PI * f64::from(i) / f64::from(rings);
        for j in 0..=segments {
            let phi = std::f64::consts::TAU * f64::from(j % segments) / f64::from(segments);
            let p = Vec3::new((theta.sin() * phi.cos()) as f32, theta.cos() as f32, (theta.sin() * phi.sin()) as f32);
            // The poles are one point each: sin(pi) is not exactly 0.
            let p = if i == 0 || i == rings { Vec3::new(0.0, if i == 0 { 1.0 } else { -1.0 }, 0.0) } else { p };
            mesh.positions.push(p);
            mesh.uvs.push(Vec2::new(j as f32 / segments as f32, i as f32 / rings as f32));
            if smooth {
                mesh.normals.push(p.normalize());
            }
        }
    }
    let row = segments + 1;
    for i in 0..rings {
        for j in 0..segments {
            let (a, b, c, d) = (i * row + j, i * row + j + 1, (i + 1) * row + j, (i + 1) * row + j + 1);
            if i > 0 {
                mesh.triangles.push([a, b, c]);
            }
            if i + 1 < rings {
                mesh.triangles.push([b, d, c]);
            }
        }
    }
    mesh
}

/// A square of edge `size` in the plane y = 0, facing +y.
pub fn plane(size: f32) -> Mesh {
    let h = 0.5 * size;
    Mesh {
        name: "plane".into(),
        positions: vec![Vec3::new(-h, 0.0, -h), Vec3::new(h, 0.0, -h), Vec3::new(h, 0.0, h), Vec3::new(-h, 0.0, h)],
        normals: vec![Vec3::Y; 4],
        uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
        triangles: vec![[0, 2, 1], [0, 3, 2]],
        ..Mesh::default()
    }
}

/// A scene of `parts`, each with its own mesh and material, seen by `camera` under `environment`.
pub fn scene(parts: Vec<(Mesh, Material, Affine3A)>, environment: Environment, camera: Camera) -> LoadedScene {
    let part = |(mesh, material, transform)| Part { mesh, material, transform };
    scenes::scene(parts.into_iter().map(part).collect(), Vec::new(), environment, camera)
}

pub fn compile(scene: &LoadedScene) -> RenderScene {
    RenderScene::compile(scene).expect("the scene is consistent")
}

/// The scene at a frame, compiled for it alone.
pub fn compile_at(scene: &LoadedScene, frame: usize) -> RenderScene {
    let mut compiled = compile(scene);
    compiled.set_frame(frame);
    compiled
}

pub fn render(scene: &RenderScene, spp: u32) -> (Frame, Stats) {
    render_with(scene, &Settings { spp, ..Settings::default() })
}

pub fn render_with(scene: &RenderScene, settings: &Settings) -> (Frame, Stats) {
    render_with_stats(scene, settings, &|_, _| (), &AtomicBool::new(false)).expect("settings in range")
}

/// A sky with a gradient and a small bright sun, 64 x 32.
pub fn sunny() -> Environment {
    let mut environment = Environment::constant([0.0; 3]);
    environment.map = renderflow_frame::Image::from_fn(64, 32, |x, y| {
        let sky = 0.2 + 0.8 * (1.0 - y as f32 / 32.0);
        let sun = if (20..22).contains(&x) && (6..8).contains(&y) { 200.0 } else { 0.0 };
        [0.6 * sky + sun, 0.8 * sky + sun, sky + 0.8 * sun]
    });
    environment
}

/// Largest difference between two pictures.
pub fn furthest(a: &Frame, b: &Frame) -> f32 {
    let [a, b] = [a, b].map(|frame| &frame.beauty.as_ref().expect("asked for").pixels);
    a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

/// Every channel is finite (depth may be +inf) and within its range.
pub fn check_frame(frame: &Frame) {
    let n = frame.width * frame.height;
    for (name, image) in [
        ("beauty", &frame.beauty),
        ("raw", &frame.raw),
        ("variance", &frame.variance),
        ("indirect", &frame.indirect),
        ("hidden", &frame.hidden),
        ("guide_albedo", &frame.guide_albedo),
        ("guide_normal", &frame.guide_normal),
        ("irradiance", &frame.irradiance),
    ] {
        if let Some(image) = image {
            assert_eq!(image.pixels.len(), n, "{name}");
            assert!(image.pixels.iter().flatten().all(|v| v.is_finite() && (*v >= 0.0 || name == "guide_normal")), "{name}");
        }
    }
    for i in 0..n {
        let hit = frame.depth.pixels[i].is_finite();
        assert!(frame.depth.pixels[i] > 0.0, "depth {}", frame.depth.pixels[i]);
        let normal = Vec3A::from_array(frame.normal.pixels[i]);
        assert!((normal.length() - if hit { 1.0 } else { 0.0 }).abs() < 1e-4, "normal {normal}");
        assert!(frame.albedo.pixels[i].iter().chain(&frame.material.pixels[i]).all(|v| (0.0..=1.0).contains(v)));
        assert!((0.0..=1.0).contains(&frame.alpha.pixels[i]));
        assert_eq!(frame.object_id.pixels[i] != 0, hit);
        assert_eq!(frame.material_id.pixels[i] != 0, hit);
    }
    for image in [&frame.motion, &frame.motion_prev].into_iter().flatten() {
        assert!(image.pixels.iter().flatten().all(|v| v.is_finite()));
    }
}

/// Walls of a room of 4 x 3 x 6 m whose only opening is a window of 1.6 x 1.2 m towards the sun.
pub fn walls() -> Mesh {
    let mut mesh = Mesh { name: "room".into(), ..Mesh::default() };
    let mut quad = |corners: [[f32; 3]; 4]| {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(corners.map(Vec3::from_array));
        mesh.uvs.extend([Vec2::ZERO; 4]);
        mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    };
    let (x, y, z) = (2.0, 3.0, 3.0);
    quad([[-x, 0.0, -z], [-x, 0.0, z], [x, 0.0, z], [x, 0.0, -z]]);
    quad([[-x, y, -z], [x, y, -z], [x, y, z], [-x, y, z]]);
    quad([[-x, 0.0, -z], [-x, y, -z], [x, y, -z], [x, 0.0, -z]]);
    quad([[-x, 0.0, z], [x, 0.0, z], [x, y, z], [-x, y, z]]);
    quad([[-x, 0.0, -z], [-x, 0.0, z], [-x, y, z], [-x, y, -z]]);
    let (bottom, top, near, far) = (1.0, 2.2, -0.8, 0.8);
    for (y0, y1, z0, z1) in [(0.0, bottom, -z, z), (top, y, -z, z), (bottom, top, -z, near), (bottom, top, far, z)] {
        quad([[x, y0, z0], [x, y0, z1], [x, y1, z1], [x, y1, z0]]);
    }
    mesh
}
