//! Which pixels can see geometry at all.

use crate::camera::Projector;
use crate::compile::RenderScene;
use crate::settings::Settings;
use glam::{DVec2, Vec3A};

/// A box smaller than this number of pixels stands for its content: dense meshes have many triangles per pixel.
const SMALL: f64 = 1.5;
/// Bounds to project for a camera ray of the picture, at most: they are projected on one thread while all others wait. Beyond
/// that rays cost less than finding out which are in vain (docs/measurements/renderer-notes.md, gbuffer).
const BOUNDS_A_RAY: f64 = 0.125;
/// Number of bounds that are always worth projecting, which takes a fifth of a millisecond.
const FEW_BOUNDS: f64 = 4096.0;

/// Which pixels may see geometry: a superset, found by projecting bounds of triangles or of boxes around them. All others see the
/// environment alone.
pub(super) struct Visible {
    width: usize,
    seen: Vec<bool>,
}

impl Visible {
    /// Projects triangles, or small boxes around them, onto the image, each widened by the pixel filter and a hundredth of a
    /// pixel for rounding. Where they are too many for that to pay, any pixel may see geometry.
    pub fn new(scene: &RenderScene, settings: &Settings) -> Self {
        let (width, height) = (scene.camera().width, scene.camera().height);
        let anywhere = || Self { width, seen: vec![true; width * height] };
        // Bounds of what a lens distorts or blurs are not known.
        if !settings.skips.environment_pixels || scene.camera().distortion.is_some() || settings.lens.is_some() {
            return anywhere();
        }
        let rays = (width * height) as f64 * f64::from(settings.camera_samples());
        let left = std::cell::Cell::new((BOUNDS_A_RAY * rays).max(FEW_BOUNDS) as u64);
        let spend = || left.replace(left.get().saturating_sub(1)) > 0;
        let projector = Projector::new(scene.camera());
        let reach = f64::from(settings.filter.radius()) + 0.01;
        // The pixels whose centre is within reach of an interval.
        let pixels = |low: f64, high: f64, n: usize| {
            let first = (low - reach - 0.5).ceil().clamp(0.0, n as f64) as usize;
            let end = ((high + reach - 0.5).floor() + 1.0).clamp(0.0, n as f64) as usize;
            first..end
        };
        // Differences along each row: +1 where a bound begins, -1 where it ends.
        let edges = vec![0i32; (width + 1) * height];
        let edges = std::cell::RefCell::new(edges);
        let mark = |(low, high): (DVec2, DVec2)| {
            let columns = pixels(low.x, high.x, width);
            if columns.is_empty() {
                return;
            }
            let mut edges = edges.borrow_mut();
            for y in pixels(low.y, high.y, height) {
                edges[y * (width + 1) + columns.start] += 1;
                edges[y * (width + 1) + columns.end] -= 1;
            }
        };
        let open = |corners: [Vec3A; 2]| {
            if !spend() {
                return false;
            }
            let Some((low, high)) = projector.box_bounds(corners) else { return true };
            if pixels(low.x, high.x, width).is_empty() || pixels(low.y, high.y, height).is_empty() {
                return false;
            }
            let small = (high - low).max_element() < SMALL;
            if small {
                mark((low, high));
            }
            !small
        };
        scene.geometry.cover(open, |corners| {
            if spend()
                && let Some(bounds) = projector.bounds(corners)
            {
                mark(bounds);
            }
        });
        if left.get() == 0 {
            return anywhere();
        }
        let edges = edges.into_inner();
        let mut seen = Vec::with_capacity(width * height);
        for row in edges.chunks_exact(width + 1) {
            let mut open = 0;
            seen.extend(row[..width].iter().map(|edge| {
                open += edge;
                open > 0
            }));
        }
        Self { width, seen }
    }

    pub fn at(&self, x: usize, y: usize) -> bool {
        self.seen[y * self.width + x]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::Scratch;
    use crate::camera::Filter;
    use glam::{Affine3A, Vec2, Vec3};
    use renderflow_frame::{Camera, Environment};
    use renderflow_scenes::{Instance, LoadReport, LoadedScene, Material, Mesh};

    /// Pixels said to see only the environment must not see a triangle anywhere within the filter, and most that do see only
    /// the environment should be said to.
    #[test]
    fn unseen_pixels_see_nothing() {
        let (mut skipped, mut empty) = (0, 0);
        for seed in 0..24u32 {
            let mut state = seed;
            let mut random = || {
                state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
                (state >> 8) as f32 / (1 << 24) as f32 * 2.0 - 1.0
            };
            // Triangles in front of, behind, and through the camera's plane; some very long.
            let size = if seed % 3 == 0 { 8.0 } else { 0.5 };
            let positions = (0..9)
                .map(|i| if i % 3 == 0 { Vec3::ZERO } else { size * Vec3::new(random(), random(), random()) })
                .collect::<Vec<_>>();
            let place = |i: usize, r: Vec3| positions[i] + 3.0 * r;
            let centres = [0, 1, 2].map(|_| Vec3::new(random(), random(), random()));
            let positions: Vec<Vec3> = (0..9).map(|i| place(i, centres[i / 3])).collect();
            let mesh = Mesh { positions, triangles: vec![[0, 1, 2], [3, 4, 5], [6, 7, 8]], ..Mesh::default() };
            let instance =
                Instance { name: String::new(), mesh: 0, material: 0, object_id: 1, transforms: vec![Affine3A::IDENTITY] };
            let eye = Vec3A::new(random(), random(), random());
            let scene = RenderScene::compile(&LoadedScene {
                name: String::new(),
                seed: 0,
                hash: String::new(),
                files: String::new(),
                meshes: vec![mesh],
                instances: vec![instance],
                materials: vec![Material::default()],
                textures: vec![],
                origin: glam::DVec3::ZERO,
                lights: vec![],
                environment: Environment::constant([1.0; 3]),
                cameras: vec![Camera::look_at(eye, Vec3A::ZERO, Vec3A::Y, 1.0, 24, 16)],
                report: LoadReport::default(),
            })
            .expect("consistent");
            for filter in [Filter::Box, Filter::BlackmanHarris] {
                let visible = Visible::new(&scene, &Settings { filter, ..Settings::default() });
                let mut scratch = Scratch::default();
                for (x, y) in (0..24 * 16).map(|i| (i % 24, i / 24)) {
                    let mut hit = false;
                    for i in 0..81u8 {
                        let u = [f32::from(i % 9) / 8.0, f32::from(i / 9) / 8.0];
                        let point = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) + filter.sample(u);
                        hit |= scene.geometry.occluded(&crate::camera::ray(scene.camera(), point), &mut scratch);
                    }
                    empty += usize::from(!hit);
                    skipped += usize::from(!visible.at(x, y));
                    assert!(visible.at(x, y) || !hit, "seed {seed}: pixel {x} {y} sees a triangle");
                }
            }
        }
        println!("{skipped} of {empty} pixels without geometry need no rays");
        assert!(10 * skipped > 5 * empty);
    }
}
