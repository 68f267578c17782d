//! Emissive triangles as lights: degenerate and extreme lists. How they are drawn is checked by
//! `renderflow_renderer::verify::emitters`.

use glam::Vec3A;
use renderflow_frame::Environment;
use renderflow_renderer::light::{
    EmissiveTriangle, EmitterLight, EnvironmentLight, LightSampler, Lights, MAX_RADIANCE, Receiver, Selection, Source,
};

fn triangle(id: u32, size: f32, radiance: f32) -> EmissiveTriangle {
    let corners = [Vec3A::ZERO, Vec3A::new(size, 0.0, 0.0), Vec3A::new(0.0, size, 0.0)];
    EmissiveTriangle { corners, radiance: Vec3A::splat(radiance), two_sided: false, id }
}

/// Receives light from all sides.
const ABOVE: Receiver = Receiver { p: Vec3A::new(0.1, 0.1, 2.0), n: Vec3A::ZERO };
const WAYS: [Selection; 2] = [Selection::Tree, Selection::Power];

#[test]
fn what_cannot_emit_is_ignored() {
    let flat = EmissiveTriangle { corners: [Vec3A::ZERO, Vec3A::X, Vec3A::X * 2.0], ..triangle(1, 1.0, 1.0) };
    let point = triangle(2, 0.0, 1.0);
    let black = triangle(3, 1.0, 0.0);
    let broken = [f32::NAN, f32::INFINITY, -1.0].map(|radiance| triangle(4, 1.0, radiance));
    let mut far = triangle(7, 1.0, 1.0);
    far.corners[1].x = f32::INFINITY;
    let all = [flat, point, black, broken[0], broken[1], broken[2], far];
    for way in WAYS {
        assert!(EmitterLight::new(all, way).is_none());
        let light = EmitterLight::new(all.into_iter().chain([triangle(8, 1.0, 1.0)]), way).expect("one emits");
        let pdf = |id, cos| light.pdf(&ABOVE, id, 1.0, cos);
        assert_eq!(pdf(3, 1.0), 0.0, "a black triangle is no light");
        assert!((pdf(8, 1.0) - 2.0).abs() < 1e-6 && pdf(8, -1.0) == 0.0);
    }
}

#[test]
fn radiance_beyond_the_limit_is_limited() {
    for way in WAYS {
        let light = EmitterLight::new([triangle(0, 1.0, 1e30), triangle(1, 1.0, f32::MAX)], way).expect("both emit");
        // The second is drawn as one of the largest radiance allowed, not as one of 3e38.
        assert!((light.pdf(&ABOVE, 0, 1.0, 1.0) / 2.0 / (1e30 / (1e30 + MAX_RADIANCE)) - 1.0).abs() < 1e-4);
    }
}

#[test]
fn one_kind_of_light_gets_all_samples() {
    let dark = || EnvironmentLight::new(&Environment::constant([0.0; 3])).expect("finite");
    let bright = || EnvironmentLight::new(&Environment::constant([1.0; 3])).expect("finite");
    let sources = |sampler: &LightSampler| {
        let samples = (0..64).map(|i| sampler.sample(&ABOVE, [i as f32 / 64.0, 0.0], [0.2, 0.3]));
        let (mut sky, mut emitter, mut none) = (0, 0, 0);
        for sample in samples {
            match sample.map(|s| s.source) {
                Some(Source::Environment { .. }) => sky += 1,
                Some(_) => emitter += 1,
                None => none += 1,
            }
        }
        (sky, emitter, none)
    };
    assert_eq!(sources(&LightSampler::new(dark(), Lights::of([triangle(0, 1.0, 1.0)]))), (0, 64, 0));
    assert_eq!(sources(&LightSampler::new(bright(), Lights::default())), (64, 0, 0));
    assert_eq!(sources(&LightSampler::new(dark(), Lights::default())), (0, 0, 64));
    let both = LightSampler::new(bright(), Lights::of([triangle(0, 1.0, 1.0)]));
    assert_eq!(sources(&both), (32, 32, 0));
    assert!((both.radiance_and_pdf(Vec3A::Y).1 - 0.125 / std::f32::consts::PI).abs() < 1e-7);
    assert!((both.pdf_emitter(&ABOVE, 0, 2.0, 0.5) - 8.0).abs() < 1e-5 && both.pdf_emitter(&ABOVE, 1, 2.0, 0.5) == 0.0);
}
