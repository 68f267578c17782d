//! Metal and what looks like technology.

use super::*;

/// Of metal or of plastic and wood.
pub(crate) fn corrugated(rng: &mut Pcg64, metal: bool) -> Pattern {
    let base = if metal { one_of(rng, &METALS) } else { paint(rng) };
    let ribs = count(rng, 4, 32);
    Pattern::Corrugated(Corrugated {
        colors: [near(rng, base, 1.0), near(rng, [0.22, 0.17, 0.12], 1.0)],
        roughness: rough(rng, [0.12, 0.5], 0.4),
        // Slopes of about one half at the steepest, whatever the number of ribs.
        depth: Pcg64::tidy(rng.between(0.06, 0.22) / ribs as f32),
        ribs,
        square: if rng.chance(0.5) { 0.0 } else { rng.between(0.3, 1.0) },
        dirt: rng.between(0.0, 0.7),
        metallic: if metal { 1.0 } else { 0.0 },
        seed: seed(rng),
        ..Corrugated::default()
    })
}

pub(crate) fn rust(rng: &mut Pcg64) -> Pattern {
    let base = one_of(rng, &[METALS[0], METALS[1], METALS[7]]);
    Pattern::Rust(Rust {
        colors: [near(rng, base, 0.9), near(rng, [0.32, 0.11, 0.03], 1.0), near(rng, [0.09, 0.035, 0.02], 1.0)],
        roughness: rough(rng, [0.12, 0.4], 0.8),
        depth: deep(rng, 0.005),
        patches: count(rng, 1, 8),
        cover: rng.between(0.15, 0.85),
        runs: rng.between(0.0, 0.9),
        seed: seed(rng),
        ..Rust::default()
    })
}

pub(crate) fn scratched(rng: &mut Pcg64) -> Pattern {
    let base = one_of(rng, &METALS);
    Pattern::Scratched(Scratched {
        colors: [near(rng, base, 1.0), near(rng, base, 0.45)],
        roughness: rough(rng, [0.04, 0.25], 0.5),
        depth: deep(rng, 0.001),
        scratches: count(rng, 60, 700),
        spread: if rng.chance(0.6) { 1.0 } else { rng.between(0.0, 0.6) },
        length: rng.between(0.08, 0.6),
        tarnish: rng.between(0.0, 0.9),
        seed: seed(rng),
        ..Scratched::default()
    })
}

pub(crate) fn chipped_paint(rng: &mut Pcg64) -> Pattern {
    let (base, primer) = (one_of(rng, &METALS), one_of(rng, &[[0.35, 0.12, 0.07], [0.45, 0.45, 0.43], [0.12, 0.13, 0.12]]));
    Pattern::ChippedPaint(ChippedPaint {
        colors: [paint(rng), near(rng, primer, 1.0), near(rng, base, 0.85)],
        roughness: rough(rng, [0.08, 0.4], 0.6),
        depth: deep(rng, 0.003),
        chips: count(rng, 4, 20),
        worn: rng.between(0.1, 0.6),
        scratches: count(rng, 0, 200),
        seed: seed(rng),
        ..ChippedPaint::default()
    })
}

pub(crate) fn brushed(rng: &mut Pcg64) -> Pattern {
    let base = one_of(rng, &METALS);
    Pattern::Brushed(Brushed {
        colors: [near(rng, base, 1.0), near(rng, base, 0.75)],
        roughness: rough(rng, [0.1, 0.3], 0.4),
        depth: deep(rng, 0.0006),
        lines: count(rng, 60, 240),
        contrast: rng.between(0.2, 0.9),
        smudges: rng.between(0.0, 0.7),
        seed: seed(rng),
        ..Brushed::default()
    })
}

/// Of metal, or the peel of moulded plastic.
pub(crate) fn hammered(rng: &mut Pcg64, metal: bool) -> Pattern {
    let base = if metal { one_of(rng, &METALS) } else { paint(rng) };
    let dents = count(rng, 5, 24);
    Pattern::Hammered(Hammered {
        colors: [near(rng, base, 1.0), near(rng, base, 0.35)],
        roughness: rough(rng, [0.05, 0.3], 0.4),
        depth: Pcg64::tidy(rng.between(0.05, 0.14) / dents as f32),
        dents,
        uneven: rng.between(0.3, 1.0),
        tarnish: rng.between(0.0, 0.7),
        metallic: if metal { 1.0 } else { 0.0 },
        seed: seed(rng),
        ..Hammered::default()
    })
}

pub(crate) fn tread_plate(rng: &mut Pcg64) -> Pattern {
    let base = one_of(rng, &METALS);
    let pairs = count(rng, 4, 10);
    Pattern::TreadPlate(TreadPlate {
        colors: [near(rng, base, 0.95), near(rng, [0.16, 0.13, 0.1], 1.0)],
        roughness: rough(rng, [0.12, 0.4], 0.5),
        depth: Pcg64::tidy(rng.between(0.015, 0.04) / pairs as f32),
        pairs,
        length: rng.between(0.28, 0.48),
        dirt: rng.between(0.0, 0.8),
        scratches: count(rng, 0, 300),
        seed: seed(rng),
        ..TreadPlate::default()
    })
}

pub(crate) fn carbon_fibre(rng: &mut Pcg64) -> Pattern {
    let base = if rng.chance(0.75) { [0.06, 0.06, 0.065] } else { dye(rng) };
    Pattern::CarbonFibre(CarbonFibre {
        colors: [near(rng, base, 1.1), near(rng, base, 0.25)],
        roughness: rough(rng, [0.1, 0.3], 0.35),
        depth: deep(rng, 0.0015),
        repeats: count(rng, 2, 8),
        contrast: rng.between(0.4, 1.0),
        seed: seed(rng),
        ..CarbonFibre::default()
    })
}
