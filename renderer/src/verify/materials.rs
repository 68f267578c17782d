//! The material of [`super::bsdf`]'s cases as checks of the suite, and its densities by chi-square.

use super::bsdf::{self, Worst as Found};
use super::chi_square::{Counts, DirectionGrid, Random, judge};
use super::{Check, Effort, Outcome, Ticker, Worst};
use crate::material::{Bsdf, Mode, Principled};
use glam::{DVec3, Vec3A};
use rayon::prelude::*;

/// Checks of this file.
pub const CHECKS: &[Check] = &[
    Check {
        name: "material.evaluations",
        about: "random materials and directions, limits and grazing ones among them: nothing NaN, infinite or negative, samples equal eval",
        run: evaluations,
    },
    Check {
        name: "material.weights",
        about: "weights of draws are bounded, by 25 in the conserving and 50 in the published form",
        run: weights,
    },
    Check {
        name: "material.plain",
        about: "the form that plain materials are compiled to equals the general one",
        run: |effort, ticker| {
            let (parts, count) = effort.pick((8, 25_000), (40, 100_000));
            collect(ticker, &MODES[..1], parts, ("relative difference", 1e-4), |_, part| bsdf::plain_form(count, 1 + part))
        },
    },
    Check {
        name: "material.values",
        about: "values known on paper: a Lambertian surface, a mirror, nothing below the horizon",
        run: |_, ticker| collect(ticker, &MODES[..1], 1, ("distance from the value on paper", 2e-3), |_, _| bsdf::known_values()),
    },
    Check {
        name: "material.reciprocity",
        about: "f(wo, wi) equals f(wi, wo) for the lobes that are reciprocal, and for conductors but for a factor of wo",
        run: reciprocity,
    },
    Check { name: "material.densities", about: "densities integrate to 1 over a grid of materials and views", run: densities },
    Check {
        name: "material.draws",
        about: "directions are drawn from the density claimed, every lobe and mixture (chi-square)",
        run: draws,
    },
    Check {
        name: "material.furnace",
        about: "conserving form under a white sky: albedo at most 1.001, and white materials within 0.5 % of 1 (anisotropic ones 2 % below), grazing views included",
        run: furnace,
    },
];

/// Both forms.
pub(super) const MODES: [Mode; 2] = [Mode::Conserving, Mode::Published];

/// Runs `case` for both modes and `parts` seeds in parallel; failures, and the largest error against `limit`.
pub(super) fn collect(
    ticker: &Ticker<'_>,
    modes: &[Mode],
    parts: u64,
    (claim, limit): (&str, f64),
    case: impl Fn(Mode, u64) -> Found + Sync,
) -> Vec<Outcome> {
    let jobs: Vec<(Mode, u64)> = modes.iter().flat_map(|mode| (0..parts).map(move |part| (*mode, part))).collect();
    ticker.expect(jobs.len() as u64);
    let found: Vec<(Mode, Found)> = jobs
        .into_par_iter()
        .filter(|_| !ticker.cancelled())
        .map(|(mode, part)| {
            let found = case(mode, part);
            ticker.add(1);
            (mode, found)
        })
        .collect();
    let (mut failures, mut errors) = (Worst::default(), Worst::default());
    for (mode, found) in &found {
        let place = || format!("{mode:?}: error {:.2e}; {}", found.error, found.parameters);
        failures.see(found.failures as f64, place);
        errors.see(found.error, place);
    }
    let total: f64 = found.iter().map(|(_, f)| f.failures as f64).sum();
    let cases = found.iter().map(|(_, f)| f.cases).sum();
    let counted = failures.at_most("cases beyond their bounds", 0.0);
    [Outcome { worst: total, ..counted }, errors.at_most(claim, limit)].map(|o| Outcome { cases, ..o }).to_vec()
}

fn evaluations(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let (parts, count) = effort.pick((8, 50_000), (100, 100_000));
    let mut outcomes = collect(ticker, &MODES, parts, ("relative difference of sample and eval", 1e-4), |mode, part| {
        bsdf::random_evaluations(mode, count, 1 + part)
    });
    let corners = collect(ticker, &MODES[..1], 1, ("", 0.0), |_, _| bsdf::corners());
    outcomes.extend(corners.into_iter().take(1).map(|o| Outcome { name: format!("corners: {}", o.name), ..o }));
    outcomes
}

fn weights(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let (parts, count) = effort.pick((8, 25_000), (40, 100_000));
    collect(ticker, &MODES, parts, ("largest weight", 50.0), |mode, part| bsdf::weights(mode, count, 5 + part))
}

fn reciprocity(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let (parts, count) = effort.pick((8, 25_000), (40, 100_000));
    let mut outcomes =
        collect(ticker, &MODES, parts, ("relative difference", 1e-4), |mode, part| bsdf::reciprocity(mode, count, 1 + part));
    let claim = ("relative difference around three directions", 1e-4);
    let conductors = collect(ticker, &MODES[..1], parts, claim, |_, part| bsdf::conductors(count / 2, 8 + part));
    outcomes.extend(conductors.into_iter().map(|o| Outcome { name: format!("conductors: {}", o.name), ..o }));
    outcomes
}

fn densities(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let surfaces: Vec<Principled> = bsdf::grid(false).into_iter().step_by(effort.pick(29, 3)).collect();
    let draws = effort.pick(20_000, 50_000);
    let mut outcomes = collect(ticker, &MODES, surfaces.len() as u64, ("", 1.0), |mode, part| {
        bsdf::pdf_integrals(mode, &surfaces[part as usize..=part as usize], draws, 2 + part)
    });
    // The error holds the noise of the share drawn below the horizon; the bound on each case knows it.
    outcomes.truncate(1);
    outcomes
}

fn furnace(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let mut outcomes = Vec::new();
    for white in [true, false] {
        for (kind, wanted) in KINDS {
            let of_kind = bsdf::grid(white).into_iter().filter(wanted);
            let surfaces: Vec<Principled> = of_kind.step_by(effort.pick(11, 1)).collect();
            let tolerance = surfaces.iter().map(bsdf::furnace_tolerance).fold(0.0, f64::max);
            let claim = if white { ("distance of the albedo from 1", tolerance) } else { ("albedo beyond 1", 1e-3) };
            let found = collect(ticker, &MODES[..1], surfaces.len() as u64, claim, |_, part| {
                bsdf::furnace(&surfaces[part as usize..=part as usize], 128)
            });
            let color = if white { "white" } else { "coloured" };
            outcomes.extend(found.into_iter().map(|o| Outcome { name: format!("{color}, {kind}: {}", o.name), ..o }));
        }
    }
    outcomes
}

type Wanted = fn(&Principled) -> bool;

/// Materials by what closes their furnace, each with its own tables.
const KINDS: [(&str, Wanted); 3] = [
    ("plain", |s| s.clearcoat == 0.0 && s.anisotropic == 0.0),
    ("clearcoat", |s| s.clearcoat > 0.0 && s.anisotropic == 0.0),
    ("anisotropic", |s| s.anisotropic > 0.0),
];

fn draws(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let mixed = bsdf::grid(false).into_iter().step_by(effort.pick(37, 3));
    let surfaces: Vec<Principled> = bsdf::lobes().into_iter().step_by(effort.pick(2, 1)).chain(mixed).collect();
    vec![judge(
        "cells of directions about the mirror direction",
        &experiments(&surfaces, &[1.0, 0.6, 0.2, 0.02], 100_000, ticker),
    )]
}

/// One [`Counts`] for every surface, view and form of the material: `conserving`, `published`, and where a surface
/// [is plain](Principled::is_plain) the code that knows no other.
pub fn experiments(surfaces: &[Principled], views: &[f32], count: u32, ticker: &Ticker<'_>) -> Vec<Counts> {
    let forms = [(Mode::Conserving, true), (Mode::Published, true), (Mode::Conserving, false)];
    let jobs: Vec<_> = surfaces
        .iter()
        .flat_map(|surface| forms.map(|(mode, full)| (surface, mode, full)))
        .filter(|(surface, _, full)| *full || surface.is_plain())
        .flat_map(|(surface, mode, full)| views.iter().map(move |cos| (surface, mode, full, *cos)))
        .collect();
    ticker.expect(jobs.len() as u64);
    jobs.into_par_iter()
        .enumerate()
        .filter(|_| !ticker.cancelled())
        .map(|(number, (surface, mode, full, cos))| {
            let run = if full { experiment::<true> } else { experiment::<false> };
            let counts = run(mode, surface, cos, count, number as u64);
            ticker.add(1);
            counts
        })
        .collect()
}

/// Counts draws in cells about the mirror direction; the last cell holds those that carry nothing (below the horizon).
fn experiment<const FULL: bool>(mode: Mode, surface: &Principled, cos: f32, count: u32, seed: u64) -> Counts {
    let wo = bsdf::view(cos, 0.4 + cos);
    let bsdf = Bsdf::<FULL>::new(surface, mode);
    let view = bsdf.view(wo);
    let mirror = Vec3A::new(-wo.x, -wo.y, wo.z).as_dvec3();
    // Cells as fine as the sharpest lobe.
    let smooth = f64::from(surface.roughness.max(0.032)).powi(4);
    let spread = if surface.clearcoat > 0.0 { smooth.min(1e-4) } else { smooth };
    let spread = if surface.anisotropic > 0.0 { spread * f64::from(1.0 - 0.9 * surface.anisotropic) } else { spread };
    // Nor coarser than the mirror direction's height: cubature would miss the sliver of a cell that lies above the horizon.
    let spread = spread.min(f64::from(cos * cos)).max(1e-7);
    let grid = DirectionGrid::new(mirror, spread, 20, 24);
    let mut expected = grid.integrate(&|wi: DVec3| f64::from(view.pdf(wi.as_vec3a())));
    // What the integral lacks of 1 is lost; that it is not more than 1 is the claim of `material.densities`.
    expected.push((1.0 - expected.iter().sum::<f64>()).max(0.0));
    let mut counts = Counts::new(format!("{mode:?} {FULL} {surface:?} cos {cos}"), expected);
    let mut random = Random::new(seed);
    for _ in 0..count {
        let (lobe, u) = (random.next(), [random.next(), random.next()]);
        counts.add(view.sample(lobe, u).map_or(grid.cells(), |drawn| grid.cell(drawn.wi.as_dvec3())));
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The test has the power to see what it is for: draws of one roughness do not pass for those of a slightly larger one.
    #[test]
    fn a_wrong_density_is_refuted() {
        let surface = |roughness| Principled { metallic: 1.0, roughness, ..Principled::default() };
        let drawn = experiment::<true>(Mode::Conserving, &surface(0.30), 0.8, 100_000, 1);
        assert!(drawn.p_value() > 1e-6);
        let wo = bsdf::view(0.8, 1.2);
        let grid = DirectionGrid::new(Vec3A::new(-wo.x, -wo.y, wo.z).as_dvec3(), f64::from(0.30_f32).powi(4), 20, 24);
        let bsdf = Bsdf::<true>::new(&surface(0.31), Mode::Conserving);
        let view = bsdf.view(wo);
        let mut expected = grid.integrate(&|wi: DVec3| f64::from(view.pdf(wi.as_vec3a())));
        expected.push((1.0 - expected.iter().sum::<f64>()).max(0.0));
        assert!(Counts { expected, ..drawn }.p_value() < 1e-6);
    }
}
