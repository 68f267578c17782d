//! Shadow maps: what a distant light sees, and how much of it a point sees.

use glam::{Affine3A, Mat3A, Vec3A};
use renderflow_frame::image::Image;
use std::f32::consts::TAU;

/// Orthographic depth as seen from a distant light. It is plain data.
#[derive(Clone, Debug, PartialEq)]
pub struct ShadowMap {
    /// World space (relative to the cameras' origin) to the map: x right and y down in texels (centres at +0.5), z in metres away
    /// from the light.
    pub world_to_map: Affine3A,
    /// Metres a texel covers, the same along both axes.
    pub texel: f32,
    /// z of the surface nearest to the light at each texel's centre; +inf where there is none.
    pub depth: Image<f32>,
    /// Smallest finite depth, +inf if there is none. It limits how far above a point an occluder can be.
    pub nearest: f32,
}

/// Number of taps of the blocker search and of the filter. The 4 x 4 pattern turns them at each pixel, and its filter combines 16
/// pixels.
const TAPS: usize = 16;
/// Largest radius of search and filter, as a share of the map's width.
const WIDEST: f32 = 0.15;
/// Offset of the receiver along its normal, texels, where light grazes it.
const NORMAL_OFFSET: f32 = 1.5;
/// Depth allowance, texels.
const BIAS: f32 = 0.7;
/// Smallest radius of the filter in texels; it hides the steps between texels.
const NARROWEST: f32 = 0.9;
/// Offset and allowance for single taps of coarse maps.
const COARSE_OFFSET: f32 = 1.5;
const COARSE_BIAS: f32 = 1.5;
/// Largest slope (depth over width) of the receiver's plane that taps beside the point are compared with.
const STEEPEST: f32 = 20.0;

/// A spiral of points that covers the unit disc evenly (Vogel 1979).
#[rustfmt::skip]
const DISC: [(f32, f32); TAPS] = [
    (0.176777, 0.000000), (-0.225772, 0.206826), (0.034558, -0.393771), (0.284571, 0.371173),
    (-0.522223, -0.092374), (0.494695, -0.314685), (-0.165466, 0.615525), (-0.315561, -0.607594),
    (0.684642, 0.250030), (-0.712256, 0.294009), (0.343354, -0.733729), (0.253730, 0.808932),
    (-0.764746, -0.443186), (0.897134, -0.197232), (-0.547507, 0.778772), (-0.126487, -0.976090),
];

/// Orthonormal axes (right, down, away from the light) of a map for the unit direction `light` towards it.
pub fn axes(light: Vec3A) -> [Vec3A; 3] {
    let away = -light;
    let right = away.any_orthonormal_vector();
    [right, away.cross(right), away]
}

impl ShadowMap {
    /// A map of `size x size` texels over the square that starts at `low` (metres along the first two of [`axes`]) and is
    /// `extent` metres wide; `depth` holds z, metres along the third axis, at the texels' centres.
    pub fn new(light: Vec3A, low: [f32; 2], extent: f32, depth: Image<f32>) -> Self {
        let [right, down, away] = axes(light);
        let texel = extent / depth.width.max(1) as f32;
        let rows = Mat3A::from_cols(right / texel, down / texel, away).transpose();
        let nearest = depth.pixels.iter().copied().filter(|z| z.is_finite()).fold(f32::INFINITY, f32::min);
        let world_to_map = Affine3A { matrix3: rows, translation: Vec3A::new(-low[0] / texel, -low[1] / texel, 0.0) };
        Self { world_to_map, texel, depth, nearest }
    }

    /// Whether a world-space point lies on the map, at least `margin` texels inside its border.
    pub fn covers(&self, p_world: Vec3A, margin: f32) -> bool {
        let p = self.world_to_map.transform_point3a(p_world);
        let inside = |at: f32, size: usize| at >= margin && at < size as f32 - margin;
        inside(p.x, self.depth.width) && inside(p.y, self.depth.height)
    }

    /// Share, 0..=1, of a light's disc of `angular_radius` radians that a world-space point with unit normal `n_world` sees;
    /// `turn` (0..1) rotates the taps. A search for blockers gives the width of the penumbra, which is the width of the filter
    /// (Fernando 2005). Points outside the map are lit.
    pub fn visibility(&self, p_world: Vec3A, n_world: Vec3A, angular_radius: f32, turn: f32) -> f32 {
        if !(self.texel > 0.0 && self.texel.is_finite()) {
            return 1.0;
        }
        let texel = self.texel;
        // The normal in metres along all three axes of the map.
        let n = (self.world_to_map.matrix3 * n_world) * Vec3A::new(texel, texel, 1.0);
        let facing = (-n.z).clamp(0.0, 1.0);
        let sine = (1.0 - facing * facing).sqrt();
        let p = self.world_to_map.transform_point3a(p_world + n_world * (NORMAL_OFFSET * texel * sine));
        if !p.is_finite() {
            return 1.0;
        }
        // Change in depth of the receiver's own plane per texel.
        let slope = [n.x, n.y].map(|along| (along / facing.max(1e-3)).clamp(-STEEPEST, STEEPEST) * texel);
        let bias = BIAS * texel;
        // How far above the receiver's plane the map's surface lies at a tap; `None` where it lies below.
        let above = |dx: f32, dy: f32| {
            let z = self.at(p.x + dx, p.y + dy)?;
            let gap = p.z + slope[0] * dx + slope[1] * dy - bias - z;
            (gap > 0.0).then_some(gap)
        };
        let spread = angular_radius.clamp(0.0, 0.6).tan() / texel;
        let widest = (WIDEST * self.depth.width as f32).max(NARROWEST);
        let (sin, cos) = (turn * TAU).sin_cos();

        let search = (spread * (p.z - self.nearest)).clamp(NARROWEST, widest);
        let (mut blockers, mut sum) = (0.0, 0.0);
        for (x, y) in DISC {
            // Most taps are near the middle: where ground extends towards the light, the search is far wider than any blocker's
            // shadow.
            let (x, y) = (x * (x * x + y * y), y * (x * x + y * y));
            let (dx, dy) = (search * (x * cos - y * sin), search * (x * sin + y * cos));
            if let Some(gap) = above(dx, dy) {
                // Only blockers inside the light's cone count; the farther aside, the higher they must be.
                let reach = spread * gap + NARROWEST;
                if dx * dx + dy * dy <= reach * reach {
                    blockers += 1.0;
                    sum += gap;
                }
            }
        }
        if blockers == 0.0 {
            return 1.0;
        }
        let radius = (spread * sum / blockers).clamp(NARROWEST, widest);
        let shadowed = DISC.iter().filter(|(x, y)| above(radius * (x * cos - y * sin), radius * (x * sin + y * cos)).is_some());
        1.0 - shadowed.count() as f32 / TAPS as f32
    }

    /// Whether nothing stands between the light and a world-space point with unit normal `n_world`: one tap, moved by `jitter`
    /// texels.
    pub fn lit(&self, p_world: Vec3A, n_world: Vec3A, jitter: [f32; 2]) -> bool {
        let p = self.world_to_map.transform_point3a(p_world + n_world * (COARSE_OFFSET * self.texel));
        self.at(p.x + jitter[0], p.y + jitter[1]).is_none_or(|z| z + COARSE_BIAS * self.texel >= p.z)
    }

    /// Depth at a point of the map; `None` outside the map.
    #[inline]
    fn at(&self, x: f32, y: f32) -> Option<f32> {
        let inside = x >= 0.0 && y >= 0.0 && x < self.depth.width as f32 && y < self.depth.height as f32;
        inside.then(|| self.depth.pixels[y as usize * self.depth.width + x as usize])
    }
}
