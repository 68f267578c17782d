//! Things that nobody sees but by their shadows: beside, behind and above the camera's view.

use super::body::{Body, GAP, Part, Role};
use super::camera::{CLEARANCE, Lens, samples};
use super::layout::{Layout, Space};
use crate::description::CameraPath;
use crate::draw::Draw;
use crate::shapes::Shape;
use glam::{DVec3, Vec2, Vec3};
use rand_pcg::Pcg64;

/// Puts one to three of them where the camera sees none at any frame; returns how many found a place.
pub(super) fn place(layout: &mut Layout, rng: &mut Pcg64, camera: &CameraPath, frames: u32, resolution: [u32; 2]) -> u32 {
    let (centre, radius) = layout.subject();
    let views: Vec<Cone> = samples(frames, 40).map(|frame| Cone::new(camera, frame, resolution)).collect();
    let hidden = |middle: Vec3, reach: f32| views.iter().all(|view| !view.touches(middle, reach));
    let wanted = 1 + rng.below(3);
    let mut placed = 0;
    for _ in 0..90 {
        if placed == wanted {
            break;
        }
        let (sin, cos) = rng.between(0.0, 360.0).to_radians().sin_cos();
        let away = Vec2::new(sin, cos);
        let mut body = if rng.chance(0.5) { wall(rng, radius) } else { post(rng, radius) };
        let distance = radius * rng.between(1.0, 3.0) + body.radius;
        body.place(Vec2::new(centre.x, centre.z) + distance * away, 0.0);
        let ball = body.radius.hypot(0.5 * body.height);
        let apart = |cone: &Cone| body.spot().distance(Vec2::new(cone.eye.x, cone.eye.z)) > body.radius + CLEARANCE;
        let open = matches!(layout.space, Space::Open);
        if open && layout.fits(&body, GAP) && views.iter().all(apart) && hidden(body.foot + 0.5 * body.height * Vec3::Y, ball) {
            body.subject = false;
            layout.bodies.push(body);
            placed += 1;
            continue;
        }
        // A slab that hangs above the view; in rooms, outside before the openings.
        let (size, rise) = (Vec2::new(rng.between(0.5, 1.6), rng.between(0.15, 0.7)) * radius.min(4.0), rng.between(0.6, 3.0));
        let ball = size.length();
        let middle = match layout.space {
            Space::Open => centre + Vec3::new(away.x * radius, rise * radius + 0.5, away.y * radius) * rng.between(0.8, 1.5),
            Space::Room { half, height } => {
                let out = half.length() + ball + rng.between(0.3, 2.0);
                Vec3::new(away.x * out, height * rng.between(0.4, 1.6) + 0.5, away.y * out)
            }
        };
        // Clear of everything below it.
        let top = layout.bodies.iter().map(|b| b.top() + b.rise).fold(0.0, f32::max);
        let middle = if open { middle.max(Vec3::new(f32::MIN, top + 0.3, f32::MIN)) } else { middle };
        let far = |cone: &Cone| cone.eye.distance(middle) > ball + CLEARANCE;
        if middle.y > 0.2 && views.iter().all(far) && hidden(middle, ball + 0.05) {
            let plate = Shape::Box { size: [2.0 * size.x, 0.06, 2.0 * size.y].map(|v| Pcg64::tidy(v.max(0.05))), bevel: 0.0 };
            let turn = rng.between(0.0, 360.0);
            layout.structure.push((format!("canopy_{}", placed + 1), Part::shape(plate, Role::Wall, middle).spun(turn)));
            placed += 1;
        }
    }
    placed
}

/// What a picture may show, widened to a cone.
struct Cone {
    eye: Vec3,
    ahead: Vec3,
    /// Half the angle of the picture's diagonal, radians.
    half: f32,
}

impl Cone {
    fn new(camera: &CameraPath, frame: u32, resolution: [u32; 2]) -> Self {
        let view = camera.view(frame);
        let lens = Lens::new(view.vertical_fov, resolution);
        let tall = (0.5 * view.vertical_fov).to_radians().tan();
        let ahead = (view.target - view.eye).normalize_or(DVec3::NEG_Z).as_vec3();
        Self { eye: view.eye.as_vec3(), ahead, half: tall.hypot(tall * lens.aspect).atan() }
    }

    /// Whether a ball may be in the picture.
    fn touches(&self, middle: Vec3, radius: f32) -> bool {
        let to = middle - self.eye;
        let distance = to.length();
        if distance <= radius {
            return true;
        }
        let angle = (to.dot(self.ahead) / distance).clamp(-1.0, 1.0).acos();
        angle < self.half + (radius / distance).asin()
    }
}

/// A wall, upright.
fn wall(rng: &mut Pcg64, radius: f32) -> Body {
    let (half, height) = (rng.between(0.4, 1.2) * radius, rng.between(0.8, 2.5) * radius);
    let block = Part::block(Vec3::new(-half, 0.0, -0.08), Vec3::new(half, height, 0.08), Role::Wall);
    Body::composed("screen", vec![block.turned(rng.between(0.0, 360.0))], half.hypot(0.08), height)
}

/// A pole or a column.
fn post(rng: &mut Pcg64, radius: f32) -> Body {
    let (thick, height) = (Pcg64::tidy((rng.between(0.05, 0.25) * radius).max(0.05)), rng.between(1.2, 3.0) * radius.max(0.5));
    let column = Shape::Cylinder { radius: thick, height: Pcg64::tidy(height), bevel: 0.0 };
    Body::composed(
        "pillar",
        vec![Part::shape(column, Role::Wall, Vec3::new(0.0, 0.5 * Pcg64::tidy(height), 0.0))],
        thick,
        height + 1e-3,
    )
}
