//! Random parameters of each family, all inside their documented ranges, about one metre in size.

use super::{FAMILIES, RANDOM_FAMILIES, Shape};
use crate::draw::Draw;
use rand_pcg::Pcg64;

impl Shape {
    /// A random solid of the first [`RANDOM_FAMILIES`]; every solid one of them is equally likely.
    pub fn random(rng: &mut Pcg64) -> Self {
        // The first two families are the open ones.
        let family = FAMILIES[2 + rng.below(RANDOM_FAMILIES as u32 - 2) as usize];
        Self::random_of(family, rng)
    }

    /// A random member of `family`, one of [`FAMILIES`]; a sphere for any other name.
    pub fn random_of(family: &str, rng: &mut Pcg64) -> Self {
        match family {
            "plane" => Self::Plane { size: rng.log(0.5, 2.0) },
            "disc" => Self::Disc { radius: rng.log(0.3, 1.0) },
            "box" => {
                let size = [0; 3].map(|_| rng.between(0.4, 1.2));
                let thinnest = size.iter().copied().fold(f32::INFINITY, f32::min);
                let bevel = if rng.chance(0.6) { Pcg64::tidy(thinnest * rng.between(0.02, 0.3)) } else { 0.0 };
                Self::Box { size, bevel }
            }
            "cylinder" => {
                let (radius, height) = (rng.between(0.15, 0.55), rng.between(0.3, 1.3));
                let bevel = if rng.chance(0.6) { Pcg64::tidy(radius.min(0.5 * height) * rng.between(0.03, 0.5)) } else { 0.0 };
                Self::Cylinder { radius, height, bevel }
            }
            "cone" => {
                let radius = rng.between(0.25, 0.6);
                let top_radius = if rng.chance(0.4) { Pcg64::tidy(radius * rng.between(0.2, 0.8)) } else { 0.0 };
                Self::Cone { radius, top_radius, height: rng.between(0.5, 1.3) }
            }
            "capsule" => {
                let radius = rng.between(0.12, 0.35);
                Self::Capsule { radius, height: Pcg64::tidy(radius * rng.between(2.5, 6.0)) }
            }
            "torus" => {
                let radius = rng.between(0.3, 0.5);
                Self::Torus { radius, tube: Pcg64::tidy(radius * rng.between(0.15, 0.6)) }
            }
            "torus_knot" => {
                let (p, q) = [(2, 3), (3, 2), (2, 5), (3, 4), (3, 5), (1, 4), (1, 6), (5, 2)][rng.below(8) as usize];
                let radius = rng.between(0.3, 0.45);
                let most = 0.5 / p.max(q) as f32;
                Self::TorusKnot { p, q, radius, tube: Pcg64::tidy(radius * rng.between(0.06, most.clamp(0.1, 0.2))) }
            }
            "superellipsoid" => Self::Superellipsoid {
                size: [0; 3].map(|_| rng.between(0.5, 1.1)),
                vertical: rng.log(0.25, 2.2),
                horizontal: rng.log(0.25, 2.2),
            },
            "lathe" => {
                let count = 3 + rng.below(5) as usize;
                let radii: Vec<f32> = (0..count).map(|_| rng.between(0.12, 0.5)).collect();
                let smallest = radii.iter().copied().fold(f32::INFINITY, f32::min);
                let wall = if rng.chance(0.5) { Pcg64::tidy(smallest * rng.between(0.1, 0.4)) } else { 0.0 };
                Self::Lathe { radii, height: rng.between(0.6, 1.3), wall }
            }
            "pipe" => {
                let radius = rng.between(0.25, 0.55);
                let inner_radius = Pcg64::tidy(radius * rng.between(0.4, 0.9));
                Self::Pipe { radius, inner_radius, height: rng.between(0.2, 1.0) }
            }
            "prism" => Self::Prism {
                sides: 3 + rng.below(8),
                radius: rng.between(0.3, 0.6),
                height: rng.between(0.2, 1.2),
                star: rng.chance(0.5).then(|| rng.between(0.4, 0.85)),
                twist: if rng.chance(0.4) { rng.between(-120.0, 120.0) } else { 0.0 },
                taper: if rng.chance(0.4) { rng.between(0.3, 1.0) } else { 1.0 },
            },
            "gear" => {
                let teeth = 7 + rng.below(18);
                let (depth, hole) = (rng.between(0.1, 0.25), rng.between(0.1, 0.45));
                Self::Gear { teeth, radius: rng.between(0.35, 0.6), depth, hole, height: rng.between(0.1, 0.4) }
            }
            "spring" => {
                let (radius, turns) = (rng.between(0.2, 0.45), rng.between(2.0, 6.0));
                let height = rng.between(0.6, 1.1);
                // Thin enough that neighbouring turns stay apart.
                let tube = Pcg64::tidy((0.3 * radius).min(0.42 * height / turns) * rng.between(0.4, 0.9));
                Self::Spring { radius, tube: tube.max(0.01), turns, height }
            }
            "rock" => Self::Rock {
                radius: rng.between(0.35, 0.55),
                roughness: rng.between(0.2, 0.6),
                frequency: rng.log(0.8, 3.0),
                seed: rng.below(1 << 30),
                facets: rng.chance(0.4),
            },
            "arch" => {
                let width = rng.between(0.6, 1.2);
                Self::Arch {
                    width,
                    height: Pcg64::tidy(width * rng.between(0.55, 1.3)),
                    depth: rng.between(0.2, 0.6),
                    thickness: Pcg64::tidy(width * rng.between(0.12, 0.3)),
                }
            }
            "stairs" => Self::Stairs {
                steps: 3 + rng.below(8),
                size: [rng.between(0.6, 1.2), rng.between(0.4, 1.0), rng.between(0.4, 1.0)],
            },
            "supershape" => Self::Supershape {
                lobes: 2 + rng.below(9),
                vertical_lobes: 2 * rng.below(4),
                n: rng.log(1.0, 8.0),
                k: rng.log(1.5, 8.0),
                size: rng.between(0.7, 1.1),
            },
            other => match Self::random_model(other, rng) {
                Some(shape) => shape,
                None => Self::Sphere { radius: rng.between(0.3, 0.55) },
            },
        }
    }
}
