//! The material at the limits of its parameters and directions.

use renderflow_renderer::material::Mode;
use renderflow_renderer::verify::bsdf;

fn evaluations(count: u64) {
    for mode in [Mode::Conserving, Mode::Published] {
        let worst = bsdf::random_evaluations(mode, count, 1);
        println!("{mode:?}: {worst:?}");
        assert!(worst.cases == count && worst.failures == 0, "{mode:?}: {worst:?}");
    }
}

#[test]
fn evaluations_are_finite() {
    evaluations(200_000);
}

#[test]
#[ignore = "a minute"]
fn ten_million_evaluations_are_finite() {
    evaluations(10_000_000);
}

#[test]
fn weights_are_bounded() {
    for mode in [Mode::Conserving, Mode::Published] {
        let worst = bsdf::weights(mode, 200_000, 5);
        println!("{mode:?}: {worst:?}");
        assert!(worst.cases == 200_000 && worst.failures == 0, "{mode:?}: {worst:?}");
    }
}

#[test]
fn densities_integrate_to_one() {
    let surfaces: Vec<_> = bsdf::grid(false).into_iter().step_by(11).collect();
    for mode in [Mode::Conserving, Mode::Published] {
        let worst = bsdf::pdf_integrals(mode, &surfaces, 100_000, 2);
        println!("{mode:?}: {worst:?}");
        assert!(worst.cases > 50 && worst.failures == 0, "{mode:?}: {worst:?}");
    }
}
