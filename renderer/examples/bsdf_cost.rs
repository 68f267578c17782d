//! Nanoseconds a material costs at one path vertex: preparation, view, one `eval` and one `sample`.
//!
//! `cargo run --release -p renderflow-renderer --example bsdf_cost`

use glam::Vec3A;
use renderflow_renderer::material::{Bsdf, Mode, Surface};
use std::hint::black_box;
use std::time::Instant;

const VERTICES: usize = 200_000;

fn main() {
    let surface = |metallic, roughness, specular| Surface {
        base_color: Vec3A::new(0.8, 0.5, 0.2),
        metallic,
        roughness,
        specular,
        ..Surface::default()
    };
    let plain = [
        ("Lambert", surface(0.0, 0.0, 0.0)),
        ("diffuse, rough", surface(0.0, 0.6, 0.0)),
        ("dielectric", surface(0.0, 0.4, 0.5)),
        ("metal", surface(1.0, 0.4, 0.5)),
    ];
    let dielectric = plain[2].1;
    let full = Surface { sheen: 0.5, clearcoat: 0.5, subsurface: 0.5, anisotropic: 0.5, specular_tint: 0.5, ..dielectric };
    println!("FULL = false");
    for (name, surface) in &plain {
        measure::<false>(name, surface, Mode::Conserving);
    }
    println!("FULL = true");
    for (name, surface) in plain.into_iter().chain([
        ("subsurface", Surface { subsurface: 0.5, ..dielectric }),
        ("sheen", Surface { sheen: 0.5, ..dielectric }),
        ("clearcoat", Surface { clearcoat: 0.5, ..dielectric }),
        ("anisotropic", Surface { anisotropic: 0.5, ..dielectric }),
        ("everything", full),
    ]) {
        measure::<true>(name, &surface, Mode::Conserving);
    }
    println!("published");
    measure::<true>("dielectric", &dielectric, Mode::Published);
    measure::<true>("everything", &full, Mode::Published);
}

fn measure<const FULL: bool>(name: &str, surface: &Surface, mode: Mode) {
    let mut best = f64::INFINITY;
    for _ in 0..15 {
        let begin = Instant::now();
        let mut x = 12345_u32;
        let mut next = || {
            x = x.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            (x >> 8) as f32 / 16_777_216.0
        };
        let mut sum = Vec3A::ZERO;
        for _ in 0..VERTICES {
            let wo = Vec3A::new(next() - 0.5, next() - 0.5, next() + 0.05).normalize();
            let wi = Vec3A::new(next() - 0.5, next() - 0.5, next() + 0.05).normalize();
            let bsdf = Bsdf::<FULL>::new(black_box(surface), mode);
            let view = bsdf.view(wo);
            sum += view.eval(wi).f_cos;
            if let Some(drawn) = view.sample(next(), [next(), next()]) {
                sum += drawn.weight;
            }
        }
        black_box(sum);
        best = best.min(begin.elapsed().as_secs_f64());
    }
    println!("  {name:16} {:6.1} ns", best * 1e9 / VERTICES as f64);
}
