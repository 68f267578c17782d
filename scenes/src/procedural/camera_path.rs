//! The orbit from which a composed scene is seen.

use super::layout::Layout;
use crate::description::{CameraPath, decimal};
use crate::draw::Draw;
use rand_pcg::Pcg64;

/// An orbit whose distance lets the objects fill the view of `resolution`.
pub(super) fn orbit(rng: &mut Pcg64, layout: &Layout, resolution: [u32; 2], degrees_per_frame: f32) -> CameraPath {
    let (centre, sphere) = layout.bounding_sphere();
    let vertical_fov = rng.between(30.0, 55.0);
    // The narrower of the two angles of view has to hold the sphere about the objects.
    let aspect = resolution[0].max(1) as f32 / resolution[1].max(1) as f32;
    let half = (0.5 * vertical_fov).to_radians();
    let narrow = half.min((half.tan() * aspect).atan());
    // Below 1 the outermost objects may touch the border of the picture.
    let distance = Pcg64::tidy(sphere / narrow.sin() * rng.between(0.75, 1.0));
    // Always outside the sphere, however wide the view.
    let distance = distance.max(Pcg64::tidy(1.1 * sphere + 0.1));
    CameraPath::Orbit {
        target: centre.to_array().map(Pcg64::tidy).map(decimal),
        distance: decimal(distance),
        elevation: rng.between(8.0, 45.0),
        azimuth: rng.between(0.0, 360.0),
        degrees_per_frame,
        vertical_fov,
    }
}
