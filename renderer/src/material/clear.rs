//! The principled material with its clear part: what [`Bsdf`] reflects and what [`super::glass`] mirrors and passes, mixed by
//! `transmission`.

use super::glass::{Glass, GlassView};
use super::{Bsdf, BsdfEval, BsdfSample, MIN_PDF, Mode, Principled, Side, View};
use glam::Vec3A;

/// The scattering function of one surface point that may be clear, in its local frame.
#[derive(Clone, Copy)]
pub struct ClearBsdf {
    opaque: Bsdf<true>,
    glass: Option<Glass>,
    /// Share of the clear part.
    share: f32,
}

impl ClearBsdf {
    /// Prepares the lobes that `surface` has. The clear part is the share `transmission` of what is no metal.
    #[inline(always)]
    pub fn new(surface: &Principled, mode: Mode) -> Self {
        let clamped = surface.clamped();
        let share = clamped.transmission * (1.0 - clamped.metallic);
        let glass = (share > 0.0).then(|| Glass::new(&clamped, mode));
        Self { opaque: Bsdf::new(surface, mode), glass, share }
    }

    /// Prepares what depends on `wo` alone; see [`Bsdf::view`].
    #[inline(always)]
    pub fn view(&self, wo: Vec3A, side: Side) -> ClearView<'_> {
        let opaque = self.opaque.view(wo);
        let glass = self.glass.as_ref().filter(|_| wo.z > 0.0).map(|glass| glass.view(wo, side));
        let chance = match glass {
            None => 0.0,
            Some(_) if opaque.is_black() => 1.0,
            Some(_) => self.share,
        };
        ClearView { opaque, glass, share: self.share, chance }
    }
}

/// A [`ClearBsdf`] seen from one direction.
#[derive(Clone, Copy)]
pub struct ClearView<'a> {
    opaque: View<'a, true>,
    glass: Option<GlassView<'a>>,
    share: f32,
    /// Chance of drawing from the clear part.
    chance: f32,
}

impl ClearView<'_> {
    /// Whether nothing is scattered towards the viewer.
    #[inline(always)]
    pub fn is_black(&self) -> bool {
        self.glass.is_none() && self.opaque.is_black()
    }

    /// Value (times cosine) and density for `wi`, above or below the shading horizon.
    #[inline(always)]
    pub fn eval(&self, wi: Vec3A) -> BsdfEval {
        let Some(glass) = &self.glass else { return self.opaque.eval(wi) };
        let clear = glass.eval(wi);
        self.mixed(clear, wi)
    }

    /// `clear` of `wi` with what the opaque part scatters there.
    #[inline(always)]
    fn mixed(&self, clear: BsdfEval, wi: Vec3A) -> BsdfEval {
        if self.share >= 1.0 {
            return clear;
        }
        let opaque = self.opaque.eval(wi);
        BsdfEval {
            f_cos: clear.f_cos * self.share + opaque.f_cos * (1.0 - self.share),
            pdf: clear.pdf * self.chance + opaque.pdf * (1.0 - self.chance),
        }
    }

    /// Draws a direction above or below the shading horizon; see [`View::sample`].
    #[inline(always)]
    pub fn sample(&self, u_lobe: f32, u: [f32; 2]) -> Option<BsdfSample> {
        let Some(glass) = &self.glass else { return self.opaque.sample(u_lobe, u) };
        let (wi, clear) = if u_lobe < self.chance {
            let drawn = glass.sample(u_lobe / self.chance, u)?;
            (drawn.wi, BsdfEval { f_cos: drawn.weight * drawn.pdf, pdf: drawn.pdf })
        } else {
            let drawn = self.opaque.sample((u_lobe - self.chance) / (1.0 - self.chance), u)?;
            (drawn.wi, glass.eval(drawn.wi))
        };
        let value = self.mixed(clear, wi);
        if value.pdf < MIN_PDF {
            return None;
        }
        Some(BsdfSample { wi, weight: value.f_cos / value.pdf, pdf: value.pdf })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verify::chi_square::{Counts, Random, judge};

    fn glass(specular: f32, roughness: f32, transmission: f32) -> Principled {
        Principled { base_color: Vec3A::ONE, roughness, specular, transmission, ..Principled::default() }
    }

    const SIDES: [Side; 4] = [Side::Outside, Side::Inside, Side::Sheet, Side::Pane];

    fn direction(u: f64, v: f64) -> Vec3A {
        let z = 2.0 * u - 1.0;
        let (sin, cos) = (std::f64::consts::TAU * v).sin_cos();
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3A::new((r * cos) as f32, (r * sin) as f32, z as f32)
    }

    /// Shares of draws in cells of the sphere, and integrals of the density over them.
    #[test]
    fn draws_follow_the_density_on_both_sides() {
        const CELLS: usize = 24;
        let mut random = Random::new(5);
        let mut all = Vec::new();
        for mode in [Mode::Conserving, Mode::Published] {
            for side in SIDES {
                for (specular, roughness, transmission) in [(0.5, 0.6, 1.0), (0.25, 0.4, 1.0), (1.0, 0.9, 0.7)] {
                    for tilt in [0.2_f32, 1.2] {
                        let bsdf = ClearBsdf::new(&glass(specular, roughness, transmission), mode);
                        let wo = Vec3A::new(tilt.sin(), 0.0, tilt.cos());
                        let view = bsdf.view(wo, side);
                        let cell = |w: Vec3A| {
                            let z = ((f64::from(w.z) + 1.0) * 0.5 * CELLS as f64) as usize;
                            let phi = (f64::from(w.y.atan2(w.x)) / std::f64::consts::TAU).rem_euclid(1.0);
                            z.min(CELLS - 1) * CELLS + ((phi * CELLS as f64) as usize).min(CELLS - 1)
                        };
                        // The last cell holds the draws that carry nothing.
                        let mut expected = vec![0.0; CELLS * CELLS + 1];
                        let fine = 24 * CELLS;
                        for i in 0..fine {
                            for j in 0..fine {
                                let w = direction((i as f64 + 0.5) / fine as f64, (j as f64 + 0.5) / fine as f64);
                                expected[i / 24 * CELLS + j / 24] +=
                                    f64::from(view.eval(w).pdf) * 4.0 * std::f64::consts::PI / (fine * fine) as f64;
                            }
                        }
                        let sum: f64 = expected.iter().sum();
                        assert!(sum < 1.002, "{side:?} {sum}");
                        expected[CELLS * CELLS] = (1.0 - sum).max(0.0);
                        let name = format!("{mode:?} {side:?} {specular} {roughness} {transmission} {tilt}");
                        let mut counts = Counts::new(name, expected);
                        for _ in 0..40_000 {
                            let [lobe, u, v] = [random.next(), random.next(), random.next()];
                            counts.add(view.sample(lobe, [u, v]).map_or(CELLS * CELLS, |drawn| cell(drawn.wi)));
                        }
                        all.push(counts);
                    }
                }
            }
        }
        let outcome = judge("clear surfaces", &all);
        assert!(outcome.passed, "{outcome:?}");
    }

    /// The value and the density that a draw comes with are those of its direction.
    #[test]
    fn draws_carry_the_values_of_their_directions() {
        let mut random = Random::new(9);
        for side in SIDES {
            for roughness in [0.1, 0.3, 0.8] {
                for transmission in [1.0, 0.6] {
                    let bsdf = ClearBsdf::new(&glass(0.5, roughness, transmission), Mode::Conserving);
                    let view = bsdf.view(Vec3A::new(0.6, 0.0, 0.8), side);
                    let mut drawn = 0;
                    for _ in 0..2000 {
                        let [lobe, u, v] = [random.next(), random.next(), random.next()];
                        let Some(sample) = view.sample(lobe, [u, v]) else { continue };
                        drawn += 1;
                        let value = view.eval(sample.wi);
                        let error = (value.pdf / sample.pdf - 1.0).abs();
                        let weight = (value.f_cos / value.pdf / sample.weight - 1.0).abs().max_element();
                        assert!(error < 0.02 && weight < 0.01, "{side:?} {roughness}: {sample:?} {value:?}");
                    }
                    assert!(drawn > 1000);
                }
            }
        }
    }

    /// Without compensation, light takes the same way in both directions but for the squares of the indices (Veach 1997, section
    /// 5.2): f(wo, wi) / n_i^2 = f(wi, wo) / n_o^2.
    #[test]
    fn refraction_is_reciprocal_up_to_the_square_of_the_index() {
        let mut random = Random::new(3);
        let index = super::super::glass::refraction_index(0.5);
        for roughness in [0.3, 0.7, 1.0] {
            let bsdf = ClearBsdf::new(&glass(0.5, roughness, 1.0), Mode::Published);
            let mut compared = 0;
            for _ in 0..4000 {
                let wo = direction(f64::from(0.5 + 0.5 * random.next()), random.next().into());
                let wi = direction(f64::from(0.5 * random.next()), random.next().into());
                let there = bsdf.view(wo, Side::Outside).eval(wi).f_cos.x / -wi.z;
                // From inside everything is turned over.
                let back = bsdf.view(-wi, Side::Inside).eval(-wo).f_cos.x / wo.z;
                if there > 1e-3 {
                    compared += 1;
                    assert!((there * index * index / back - 1.0).abs() < 2e-3, "{wo} {wi}: {there} {back}");
                }
            }
            assert!(compared > 200, "{compared}");
        }
    }

    /// The numbers come from `tests/references/rough_dielectric.py`. Masking and shadowing of refracted light are taken as
    /// independent there, as in published mode.
    #[test]
    fn refraction_agrees_with_mitsuba() {
        let (mut compared, mut worst) = (0, 0.0_f32);
        for line in include_str!("../../tests/references/rough_dielectric.csv").lines().skip(1) {
            let numbers: Vec<f32> = line.split(',').map(|field| field.parse().unwrap()).collect();
            let [ior, alpha, ox, oy, oz, ix, iy, iz, expected] = numbers[..] else { panic!("{line}") };
            let specular = ((ior - 1.0) / (ior + 1.0)).powi(2) / 0.08;
            let bsdf = ClearBsdf::new(&glass(specular, alpha.sqrt(), 1.0), Mode::Published);
            // From inside everything is turned over.
            let (side, turn) = if oz > 0.0 { (Side::Outside, 1.0) } else { (Side::Inside, -1.0) };
            let value = bsdf.view(turn * Vec3A::new(ox, oy, oz), side).eval(turn * Vec3A::new(ix, iy, iz)).f_cos.x;
            let error = (value / expected - 1.0).abs();
            assert!(error < 2e-3, "{line}: {value}");
            worst = worst.max(error);
            compared += 1;
        }
        println!("largest difference of {compared}: {worst:.1e}");
        assert!(compared > 300);
    }

    /// All light that meets a white surface leaves it, on one side or the other.
    #[test]
    fn conserving_surfaces_lose_nothing() {
        // What is tabulated changes fastest for the roughest surfaces.
        let bound = |roughness: f32| {
            if roughness <= 0.5 {
                0.006
            } else if roughness < 1.0 {
                0.012
            } else {
                0.025
            }
        };
        for side in [Side::Outside, Side::Inside, Side::Sheet] {
            for specular in [0.05, 0.3, 0.5, 0.8, 1.0] {
                for roughness in [0.0, 0.1, 0.35, 0.5, 0.75, 1.0] {
                    for cos in [0.02_f32, 0.2, 0.5, 0.75, 1.0] {
                        let bsdf = ClearBsdf::new(&glass(specular, roughness, 1.0), Mode::Conserving);
                        let view = bsdf.view(Vec3A::new((1.0 - cos * cos).sqrt(), 0.0, cos), side);
                        let index = super::super::glass::refraction_index(specular);
                        let gain = match side {
                            Side::Outside => index * index,
                            Side::Inside => 1.0 / (index * index),
                            _ => 1.0,
                        };
                        let n = 96;
                        let mut sum = 0.0;
                        for i in 0..n * n {
                            let [u, v] = [(i % n) as f32 + 0.5, (i / n) as f32 + 0.5].map(|x| x / n as f32);
                            // Both lobes from each facet, by where the choice falls.
                            for lobe in 0..16 {
                                if let Some(drawn) = view.sample((lobe as f32 + 0.5) / 16.0, [u, v]) {
                                    sum += f64::from(drawn.weight.x * if drawn.wi.z < 0.0 { gain } else { 1.0 }) / 16.0;
                                }
                            }
                        }
                        let mean = sum / (n * n) as f64;
                        let name = format!("{side:?} {specular} {roughness} {cos}: {mean}");
                        assert!((mean - 1.0).abs() < bound(roughness), "{name}");
                    }
                }
            }
        }
    }
}
