//! Burley's sheen (2012): `(1 - cos theta_d)^5` in the sheen colour, not divided by pi.

use glam::Vec3A;
use renderflow_frame::fresnel::schlick_weight;
use std::sync::OnceLock;

/// Nodes along the cosine.
const NODES: usize = 64;

/// Value of the lobe for sheen colour 1; `dot` = `wo . wi`.
#[inline]
pub(super) fn value(dot: f32) -> f32 {
    schlick_weight((0.5 * (1.0 + dot)).max(0.0).sqrt())
}

/// Directional albedo for sheen colour 1 and a view at cosine 0..=1, within 1e-4.
#[inline]
pub(super) fn albedo(cos: f32) -> f32 {
    static TABLE: OnceLock<[f32; NODES]> = OnceLock::new();
    let table = TABLE.get_or_init(|| std::array::from_fn(|i| integrate(i as f32 / (NODES - 1) as f32)));
    let x = cos * (NODES - 1) as f32;
    let i = (x as usize).min(NODES - 2);
    table[i] + (table[i + 1] - table[i]) * (x - i as f32)
}

/// Midpoint rule over the hemisphere, even in cosine squared and in half a turn of azimuths.
fn integrate(cos: f32) -> f32 {
    let (rings, sectors) = (96, 96);
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    let wo = Vec3A::new(sin, 0.0, cos);
    let mut sum = 0.0_f64;
    for i in 0..rings {
        let z2 = (i as f32 + 0.5) / rings as f32;
        for j in 0..sectors {
            let phi = std::f32::consts::PI * (j as f32 + 0.5) / sectors as f32;
            let r = (1.0 - z2).sqrt();
            sum += f64::from(value(wo.dot(Vec3A::new(r * phi.cos(), r * phi.sin(), z2.sqrt()))));
        }
    }
    (sum * std::f64::consts::PI / f64::from(rings * sectors)) as f32
}
