//! Photographed environments are drawn from their density, where they are at hand. Those made by arithmetic are checked by
//! `renderflow_renderer::verify::lights`.

use renderflow_frame::Environment;
use renderflow_renderer::light::{EnvironmentLight, Sampling};
use renderflow_renderer::verify::chi_square::judge;
use renderflow_renderer::verify::lights;
use std::path::Path;

const DRAWS: usize = 100_000;

#[test]
fn photographs_are_drawn_from_their_density() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/assets/hdri");
    let mut experiments = Vec::new();
    for name in ["potsdamer_platz_1k.hdr", "dikhololo_night_1k.hdr", "studio_small_03_1k.hdr"] {
        let path = folder.join(name);
        if !path.exists() {
            println!("{name} is skipped: not in {}", folder.display());
            continue;
        }
        let map = renderflow_frame::hdr::read(&path).unwrap_or_else(|error| panic!("{error}")).map;
        let environment = Environment { map, rotation: 0.7, intensity: 1.5 };
        for sampling in [Sampling::Plain, Sampling::Compensated] {
            let light = EnvironmentLight::with_sampling(&environment, sampling).expect("finite rotation and intensity");
            let name = format!("{name}, {sampling:?}");
            experiments.push(lights::environment_counts(&name, &environment, &light, DRAWS, experiments.len() as u64));
        }
    }
    let outcome = judge("photographs", &experiments);
    assert!(outcome.passed, "{}", outcome.detail);
}
