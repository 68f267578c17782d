//! `f(wo, wi) = f(wi, wo)`, for the materials that promise it.

use renderflow_renderer::material::Mode;
use renderflow_renderer::verify::bsdf;

#[test]
fn dielectrics_and_published_materials_are_reciprocal() {
    for mode in [Mode::Conserving, Mode::Published] {
        let worst = bsdf::reciprocity(mode, 200_000, 3);
        println!("{mode:?}: {worst:?}");
        assert!(worst.cases == 200_000 && worst.failures == 0, "{mode:?}: {worst:?}");
    }
}
