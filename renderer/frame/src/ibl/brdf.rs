//! The environment BRDF: what the split sum multiplies the prefiltered radiance with.

use std::f32::consts::TAU;
use std::sync::OnceLock;

/// Table points along n.v and along roughness, both from 0 to 1.
const N_DOT_V_STEPS: usize = 64;
const ROUGHNESS_STEPS: usize = 64;
/// Quadrature points along each of the two random numbers of a visible normal.
const QUADRATURE: usize = 24;

/// The (scale, bias) on F0 of the split sum for n.v and roughness, each 0..=1: `F0 * scale + bias` is the share of uniform light that
/// one reflection from the microfacet surface returns (GGX with alpha = roughness^2, height-correlated Smith masking, Schlick's Fresnel).
/// Values outside 0..=1 are clamped.
#[inline]
pub fn environment_brdf(n_dot_v: f32, roughness: f32) -> [f32; 2] {
    static TABLE: OnceLock<Vec<[f32; 2]>> = OnceLock::new();
    let table = TABLE.get_or_init(|| {
        // One thread: a rayon worker that waits here would pick up a row of pixels, come back for the table and wait for itself.
        (0..N_DOT_V_STEPS * ROUGHNESS_STEPS)
            .map(|i| {
                let (column, row) = (i % N_DOT_V_STEPS, i / N_DOT_V_STEPS);
                integrate(grid_n_dot_v(column as f32), row as f32 / (ROUGHNESS_STEPS - 1) as f32)
            })
            .collect()
    });
    let x = n_dot_v.clamp(0.0, 1.0).sqrt() * (N_DOT_V_STEPS - 1) as f32;
    let y = roughness.clamp(0.0, 1.0) * (ROUGHNESS_STEPS - 1) as f32;
    let (column, row) = ((x as usize).min(N_DOT_V_STEPS - 2), (y as usize).min(ROUGHNESS_STEPS - 2));
    let (s, t) = (x - column as f32, y - row as f32);
    let first = row * N_DOT_V_STEPS + column;
    let (a, b, c, d) = (table[first], table[first + 1], table[first + N_DOT_V_STEPS], table[first + N_DOT_V_STEPS + 1]);
    std::array::from_fn(|i| {
        let (top, bottom) = (a[i] + (b[i] - a[i]) * s, c[i] + (d[i] - c[i]) * s);
        top + (bottom - top) * t
    })
}

/// n.v of a table column: squared steps, since both factors change fastest at grazing angles.
fn grid_n_dot_v(column: f32) -> f32 {
    (column / (N_DOT_V_STEPS - 1) as f32).powi(2)
}

/// Mean of G2/G1 (1 - Fc) and G2/G1 Fc over normals visible from v (Heitz 2018), with Fc = (1 - v.h)^5.
fn integrate(n_dot_v: f32, roughness: f32) -> [f32; 2] {
    let alpha = (roughness * roughness).max(1e-4);
    let nv = n_dot_v.max(1e-4);
    let v = glam::Vec3A::new((1.0 - nv * nv).max(0.0).sqrt(), 0.0, nv);
    // Lambda of Smith's masking for the angle with this cosine.
    let lambda = |cosine: f32| {
        let c2 = cosine * cosine;
        0.5 * ((1.0 + alpha * alpha * (1.0 - c2).max(0.0) / c2).sqrt() - 1.0)
    };
    let lambda_v = lambda(nv);
    // The hemisphere stretched to roughness 1, seen from v.
    let vh = glam::Vec3A::new(alpha * v.x, 0.0, v.z).normalize();
    let across = glam::Vec3A::Y;
    let up = vh.cross(across);
    let (mut scale, mut bias) = (0.0_f64, 0.0_f64);
    for i in 0..QUADRATURE {
        // The height q = s^(3/2) of the disc's hemisphere instead of its radius: points gather near the rim, where GGX has its long tail.
        let s = (i as f32 + 0.5) / QUADRATURE as f32;
        let q = s * s.sqrt();
        let radius = (1.0 - q * q).sqrt();
        let measure = f64::from(3.0 * s * s);
        for j in 0..QUADRATURE {
            let (sin, cos) = (TAU * (j as f32 + 0.5) / QUADRATURE as f32).sin_cos();
            let t1 = radius * cos;
            let tilt = 0.5 * (1.0 + vh.z);
            let t2 = (1.0 - tilt) * (1.0 - t1 * t1).max(0.0).sqrt() + tilt * radius * sin;
            let nh = across * t1 + up * t2 + vh * (1.0 - t1 * t1 - t2 * t2).max(0.0).sqrt();
            let h = glam::Vec3A::new(alpha * nh.x, alpha * nh.y, nh.z.max(0.0)).normalize();
            let v_dot_h = v.dot(h).clamp(0.0, 1.0);
            let l_z = 2.0 * v_dot_h * h.z - v.z;
            if l_z > 0.0 {
                let weight = measure * f64::from((1.0 + lambda_v) / (1.0 + lambda_v + lambda(l_z)));
                let fresnel = f64::from((1.0 - v_dot_h).powi(5));
                scale += weight * (1.0 - fresnel);
                bias += weight * fresnel;
            }
        }
    }
    let norm: f64 = (0..QUADRATURE).map(|i| 3.0 * ((i as f64 + 0.5) / QUADRATURE as f64).powi(2) * QUADRATURE as f64).sum();
    [(scale / norm) as f32, (bias / norm) as f32]
}
