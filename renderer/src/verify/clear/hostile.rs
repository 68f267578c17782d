//! Scenes of clear and blended surfaces that nobody should make, and everybody does.

use super::super::scenes::{self, Part};
use super::super::{Effort, Outcome, Ticker, Worst};
use crate::integrator;
use crate::settings::Settings;
use glam::{Affine2, Affine3A, Quat, Vec3, Vec3A};
use renderflow_frame::{Camera, Environment};
use renderflow_scenes::loaded::{Encoding, Wrap};
use renderflow_scenes::shapes::Shape;
use renderflow_scenes::{Material, Principled, Texture, TextureSlot};

/// A scene, and what is known of its picture under a white sky.
struct Case {
    name: String,
    parts: Vec<Part>,
    textures: Vec<Texture>,
    camera: Camera,
    /// Radiance 1 from everywhere, or none.
    lit: bool,
    /// Mean radiance on paper with its tolerance, or nothing but that it is no more than the light that there is.
    mean: Option<(f64, f64)>,
}

fn glass(specular: f32, roughness: f32) -> Material {
    let surface =
        Principled { base_color: Vec3A::ONE, roughness, specular, transmission: 1.0, metallic: 0.0, ..Principled::default() };
    Material::from(surface)
}

fn pane(specular: f32, roughness: f32) -> Material {
    Material { thin_walled: true, ..glass(specular, roughness) }
}

fn ball(radius: f32, at: Vec3, material: Material) -> Part {
    Part::new(Shape::Sphere { radius }, material, Affine3A::from_translation(at))
}

fn block(size: [f32; 3], at: Vec3, material: Material) -> Part {
    Part::new(Shape::Box { size, bevel: 0.0 }, material, Affine3A::from_translation(at))
}

/// A square that looks at the camera, `z` metres before the origin.
fn square(size: f32, z: f32, material: Material) -> Part {
    let turn = Affine3A::from_quat(Quat::from_rotation_x(std::f32::consts::FRAC_PI_2));
    Part::new(Shape::Plane { size }, material, Affine3A::from_translation(Vec3::Z * z) * turn)
}

fn case(name: impl Into<String>, parts: Vec<Part>, mean: Option<(f64, f64)>) -> Case {
    let camera = scenes::camera([0.3, 0.2, 4.0], [0.0; 3], 30.0, 12, 12);
    Case { name: name.into(), parts, textures: Vec::new(), camera, lit: true, mean }
}

/// Texels from a small hash, so that every value occurs.
fn noise(encoding: Encoding) -> Texture {
    let texels = (0..64u32).map(|i| (i.wrapping_mul(0x9e37_79b9) ^ 0x5bd1_e995).to_le_bytes()).collect();
    Texture::from_rgba8("noise", [8, 8], texels, encoding, [Wrap::Repeat; 2])
}

fn cases() -> Vec<Case> {
    // Compensation closes the furnace of rough glass within 1 %; picture noise comes on top.
    const WHITE: Option<(f64, f64)> = Some((1.0, 0.03));
    let mut all = Vec::new();
    let (inner, outer) = (glass(0.3, 0.0), glass(0.7, 0.0));
    for (name, radius) in [("nested glass", 0.5), ("nested glass that nearly touches", 0.999_99), ("nested equal glass", 1.0)] {
        all.push(case(name, vec![ball(1.0, Vec3::ZERO, outer.clone()), ball(radius, Vec3::ZERO, inner.clone())], WHITE));
    }
    let deep = (1..=8).map(|i| ball(i as f32 / 8.0, Vec3::ZERO, glass(0.1 * i as f32, 0.0)));
    // A path that is inside of eight weighs a hundredth, and roulette makes it noisy: means of 12 x 12 pixels spread by .14.
    let camera = scenes::camera([0.3, 0.2, 4.0], [0.0; 3], 30.0, 48, 48);
    all.push(Case { camera, ..case("eight nested bodies of glass", deep.collect(), Some((1.0, 0.15))) });
    all.push(case(
        "glass that touches glass in a point",
        vec![ball(0.5, Vec3::X * 0.5, inner.clone()), ball(0.5, Vec3::X * -0.5, outer.clone())],
        WHITE,
    ));
    all.push(case(
        "blocks of glass with a common face",
        vec![block([1.0; 3], Vec3::X * 0.5, inner.clone()), block([1.0; 3], Vec3::X * -0.5, outer.clone())],
        WHITE,
    ));
    all.push(case(
        "glass that stands in another glass",
        vec![ball(0.6, Vec3::X * 0.4, inner.clone()), ball(0.6, Vec3::X * -0.4, outer.clone())],
        WHITE,
    ));
    all.push(case(
        "a block of glass on a floor in the plane of its face",
        vec![
            block([1.0; 3], Vec3::Y * -0.1, outer.clone()),
            Part::new(Shape::Plane { size: 4.0 }, scenes::diffuse([0.8; 3]), Affine3A::from_translation(Vec3::Y * -0.6)),
        ],
        None,
    ));
    for roughness in [0.0, 0.05, 0.3, 1.0] {
        let name = format!("camera inside of glass of roughness {roughness}");
        let camera = scenes::camera([0.1, 0.0, 0.2], [0.0, 0.3, -1.0], 60.0, 12, 12);
        all.push(Case { camera, ..case(name, vec![ball(1.0, Vec3::ZERO, glass(0.5, roughness))], None) });
    }
    // Seen from 4 m the sides of the thinnest ones are at one distance, and rays start beyond the other side: light is gained or
    // lost there by the square of the index, as where a body is open.
    for (thickness, mean) in [(1e-3, WHITE), (1e-5, WHITE), (1e-6, WHITE), (1e-7, None), (1e-9, None), (1e-20, None), (0.0, None)]
    {
        let thin = block([2.0, 2.0, thickness], Vec3::ZERO, outer.clone());
        all.push(case(format!("glass {thickness:e} m thin"), vec![thin], mean));
    }
    for count in [2, 8] {
        let panes = (0..count).map(|_| square(3.0, 0.0, pane(0.5, 0.0)));
        all.push(case(format!("{count} panes in one plane"), panes.collect(), WHITE));
        let sheets = (0..count).map(|_| square(3.0, 0.0, pane(0.5, 0.4)));
        all.push(case(format!("{count} rough sheets in one plane"), sheets.collect(), WHITE));
    }
    // Between many rough sheets light wanders for longer than paths are: what is left of it is not known there.
    for (count, name, roughness, mean) in
        [(64, "panes", 0.0, WHITE), (4, "rough sheets", 0.3, WHITE), (64, "rough sheets", 0.3, None)]
    {
        let row = (0..count).map(|i| square(6.0, 0.02 * i as f32 - 2.0, pane(0.5, roughness)));
        all.push(case(format!("{count} {name} in a row"), row.collect(), mean));
    }
    // Panes of an index of 1.01 mirror nothing: whatever passes one passes all.
    let row = (0..64).map(|i| square(6.0, 0.02 * i as f32 - 2.0, pane(0.0, 0.0)));
    all.push(case("64 panes without reflection in a row", row.collect(), WHITE));
    all.push(case(
        "a pane that touches a floor of its own plane",
        vec![square(3.0, 0.0, pane(0.5, 0.0)), square(3.0, 0.0, scenes::diffuse([1.0; 3]))],
        WHITE,
    ));
    let lamp = |opacity| Material { emissive: [1.0; 3], opacity: Some(opacity), ..scenes::diffuse([0.0; 3]) };
    for (layers, opacity) in [(1000, 0.001_f32), (1000, 0.5), (1000, 1.0), (3, 0.0), (3, 1e-30), (3, f32::MIN_POSITIVE)] {
        // The camera sees nothing else; everything lies in its last metre.
        let stack = (0..layers).map(|i| square(9.0, -1.0 + 1e-3 * i as f32, lamp(opacity)));
        let shown = 1.0 - (1.0 - f64::from(opacity)).powi(layers);
        let name = format!("{layers} layers of opacity {opacity:e}");
        all.push(Case { lit: false, ..case(format!("{name} that glow"), stack.collect(), Some((shown, 0.02))) });
        let white = Material { opacity: Some(opacity), ..scenes::diffuse([1.0; 3]) };
        let stack = (0..layers).map(|i| square(9.0, -1.0 + 1e-3 * i as f32, white.clone()));
        // Light wanders between a thousand half-open layers for longer than paths may be.
        all.push(case(format!("{name} that are white"), stack.collect(), Some((1.0, 0.1))));
    }
    let coplanar = (0..16).map(|_| square(9.0, 0.0, lamp(0.25)));
    all.push(case("16 blended surfaces in one plane", coplanar.collect(), None));
    for absorption in [0.0, f32::MIN_POSITIVE, 1.0, 1e30, f32::MAX] {
        let name = |what: &str| format!("{what} that absorbs {absorption:e} per metre");
        let dark = Material { absorption: [absorption; 3], ..outer.clone() };
        let clear = absorption < 1e-30;
        all.push(case(name("a ball"), vec![ball(1.0, Vec3::ZERO, dark.clone())], WHITE.filter(|_| clear)));
        let camera = scenes::camera([0.1, 0.0, 0.2], [0.0, 0.3, -1.0], 60.0, 12, 12);
        all.push(Case { camera, ..case(name("glass around the camera"), vec![ball(1.0, Vec3::ZERO, dark.clone())], None) });
        // No distance at all in a medium, and an endless one in another.
        let open = square(3.0, 0.0, dark.clone());
        all.push(case(name("an open square of glass"), vec![open.clone(), open], None));
    }
    let metal = Principled { metallic: 0.5, transmission: 0.5, base_color: Vec3A::ONE, ..Principled::default() };
    for roughness in [0.0, 0.3, 1.0] {
        let mixed = Material::from(Principled { roughness, ..metal });
        all.push(case(
            format!("half glass and half metal of roughness {roughness}"),
            vec![ball(1.0, Vec3::ZERO, mixed.clone())],
            None,
        ));
        let blended = Material { opacity: Some(0.5), ..mixed.clone() };
        all.push(case(format!("the same of roughness {roughness}, blended"), vec![ball(1.0, Vec3::ZERO, blended)], None));
        let single = Material { double_sided: false, ..pane(0.5, roughness) };
        all.push(case(
            format!("single-sided sheets of roughness {roughness}"),
            vec![square(3.0, 0.0, single.clone()), square(3.0, -0.5, single)],
            None,
        ));
    }
    for (thin_walled, roughness) in [(false, 0.0), (false, 1.0), (true, 0.0), (true, 1.0)] {
        let slot = |texture| Some(TextureSlot { texture, set: 0, uv_transform: Affine2::from_scale(glam::Vec2::splat(3.0)) });
        let textured = Material {
            thin_walled,
            base_color_texture: slot(0),
            transmission_texture: slot(1),
            metallic_roughness_texture: slot(1).filter(|_| roughness > 0.0),
            normal_texture: slot(2).map(|slot| (slot, 1.0)).filter(|_| roughness > 0.0),
            opacity: Some(0.9),
            absorption: [0.0, 1.0, 10.0],
            ..glass(0.5, roughness)
        };
        let textures = vec![noise(Encoding::Srgb), noise(Encoding::Linear), noise(Encoding::Normal)];
        let parts = vec![ball(0.8, Vec3::X * -0.6, textured.clone()), square(2.0, -1.0, textured)];
        all.push(Case { textures, ..case(format!("textured, thin-walled {thin_walled}, roughness {roughness}"), parts, None) });
    }
    all
}

/// Radiance 1 from everywhere, but not flat, so that light samples are drawn.
fn white() -> Environment {
    let mut sky = scenes::environment(32, 16, |_| [1.0; 3]);
    sky.map.pixels.iter_mut().enumerate().for_each(|(i, texel)| *texel = [1.0 + 1e-4 * ((i + i / 32) % 2) as f32; 3]);
    sky
}

/// Renders every case under a white sky, under none, and under one with a sun.
pub(super) fn run(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    let cases = cases();
    ticker.expect(2 * cases.len() as u64);
    let (mut unsound, mut apart, mut bright) = (Worst::default(), Worst::default(), Worst::default());
    let mut beyond = Vec::new();
    for case in &cases {
        let skies = if case.lit { white() } else { Environment::constant([0.0; 3]) };
        for (sky, environment) in [("white", skies), ("sun", scenes::sunny())] {
            if ticker.cancelled() {
                break;
            }
            let name = || format!("{}, {sky}", case.name);
            match picture(case, environment, effort, ticker) {
                Ok((pixels, non_finite)) => {
                    let wrong = pixels.iter().flatten().filter(|v| !(v.is_finite() && **v >= 0.0)).count();
                    unsound.see(wrong as f64 + non_finite as f64, name);
                    let mean = pixels.iter().flatten().map(|v| f64::from(*v)).sum::<f64>() / (3 * pixels.len()) as f64;
                    if sky == "white" {
                        // A little more than all light there is, for noise; a camera inside of glass sees it squeezed together.
                        bright.see(mean, || format!("{}: {mean}", case.name));
                        if let Some((paper, tolerance)) = case.mean {
                            let place = format!("{}: {mean:.4}, not {paper:.4}", case.name);
                            let distance = (mean - paper).abs() / tolerance;
                            if distance.is_nan() || distance > 1.0 {
                                beyond.push(place.clone());
                            }
                            apart.see(distance, || place);
                        }
                    }
                }
                Err(reason) => unsound.see(f64::INFINITY, || format!("{}: {reason}", name())),
            }
            ticker.add(1);
        }
    }
    vec![
        unsound.at_most("values and samples that are not finite or negative", 0.0),
        with_all(apart.at_most("distance of the mean from the one on paper, in tolerances", 1.0), &beyond),
        // Squares of the largest index of refraction.
        bright.at_most("mean radiance under a sky of 1", 3.3),
    ]
}

/// A refuted claim with all places in place of the worst.
fn with_all(outcome: Outcome, places: &[String]) -> Outcome {
    if outcome.passed { outcome } else { Outcome { detail: places.join("\n"), ..outcome } }
}

type Pixels = Vec<[f32; 3]>;

fn picture(case: &Case, environment: Environment, effort: Effort, ticker: &Ticker<'_>) -> Result<(Pixels, u64), String> {
    let (parts, textures) = (case.parts.clone(), case.textures.clone());
    let scene = scenes::compile_textured(parts, textures, environment, case.camera)?;
    let settings = Settings { spp: effort.pick(32, 128), max_bounces: 1024, ..Settings::default() };
    let (frame, stats) =
        integrator::render_with_stats(&scene, &settings, &|_, _| (), ticker.cancel()).map_err(|e| e.to_string())?;
    Ok((frame.raw.ok_or("no beauty")?.pixels, stats.non_finite_samples))
}
