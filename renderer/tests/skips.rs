//! What is left out because it cannot matter does not matter: the pictures are the same, bit for bit, and less is done.

mod common;

use common::{camera, check_frame, compile, diffuse, plane, render_with, scene, sphere, sunny};
use glam::{Affine2, Affine3A, Vec2, Vec3, Vec3A};
use renderflow_frame::{Environment, Frame, Image};
use renderflow_renderer::{Channels, Filter, RenderScene, Settings, Skips, Stats, render_gbuffer};
use renderflow_scenes::loaded::{AlphaMask, Encoding, Texture, Wrap};
use renderflow_scenes::{LoadedScene, Material, Principled, TextureSlot};

/// A ball on a plane, with a black ball beside it; a third of the picture is sky.
fn balls(ball: Material, environment: Environment) -> LoadedScene {
    let place = |x: f32| Affine3A::from_translation(Vec3::new(x, 1.0, 0.0));
    let black = Material::from(Principled { base_color: Vec3A::from_array([0.0; 3]), specular: 0.0, ..Principled::default() });
    let parts = vec![
        (sphere(12, true), ball, place(-1.1)),
        (sphere(12, true), black, place(1.1)),
        (plane(8.0), diffuse([0.6; 3]), Affine3A::IDENTITY),
    ];
    scene(parts, environment, camera([0.0, 1.6, 6.0], [0.0, 1.2, 0.0], 45.0, 48, 40))
}

fn textured(environment: Environment) -> LoadedScene {
    let slot = TextureSlot::default();
    let mut loaded = balls(Material { base_color_texture: Some(slot), ..Material::default() }, environment);
    let texels = (0..64).map(|i| [(i * 4) as u8, 200, (255 - i * 3) as u8, 255]).collect();
    loaded.textures.push(Texture::from_rgba8("ramp", [8, 8], texels, Encoding::Srgb, [Wrap::Repeat; 2]));
    loaded
}

/// One scene for every kind of compiled set and light.
fn scenes() -> Vec<(&'static str, RenderScene)> {
    let glossy = Material::from(Principled { metallic: 1.0, roughness: 0.1, ..Principled::default() });
    let lamp = Material { emissive: [4.0, 3.0, 2.0], ..Material::default() };
    let sided = Material { double_sided: false, alpha_mask: Some(AlphaMask { cutoff: 0.5, factor: 1.0 }), ..Material::default() };
    let layered = Material::from(Principled { sheen: 0.5, clearcoat: 0.7, subsurface: 0.3, ..Principled::default() });
    let (flat, dark) = (|| Environment::constant([0.7, 0.8, 0.9]), || Environment::constant([0.0; 3]));
    let all = vec![
        ("metal, sunny", balls(glossy.clone(), sunny())),
        ("textured, sunny", textured(sunny())),
        ("lamp, sunny", balls(lamp.clone(), sunny())),
        ("lamp, no sky", balls(lamp, dark())),
        ("layers, sunny", balls(layered, sunny())),
        ("single-sided, sunny", balls(sided, sunny())),
        ("metal, flat", balls(glossy.clone(), flat())),
        ("textured, flat", textured(flat())),
        ("metal, dark", balls(glossy, dark())),
    ];
    all.into_iter().map(|(name, loaded)| (name, compile(&loaded))).collect()
}

fn settings(skips: Skips) -> Settings {
    Settings { spp: 8, max_bounces: 3, skips, ..Settings::default() }
}

/// Rays of a frame, and the frame, with the switch that `off` turns off.
fn without(scene: &RenderScene, off: impl FnOnce(&mut Skips)) -> (Frame, Stats) {
    let mut skips = Skips::ALL;
    off(&mut skips);
    render_with(scene, &settings(skips))
}

/// A switch of [`Skips`] turned off, and what must cost more then, if it is counted.
type Switch = (&'static str, fn(&mut Skips), fn(&Stats, &Stats) -> bool);

#[test]
fn pictures_do_not_depend_on_what_is_skipped() {
    let switches: [Switch; 6] = [
        (
            "environment_pixels",
            |s| s.environment_pixels = false,
            |off, on| off.camera_rays > on.camera_rays && off.skipped_rays == 0,
        ),
        ("shared_guides", |s| s.shared_guides = false, |off, on| off.camera_rays > on.camera_rays),
        ("zero_contributions", |s| s.zero_contributions = false, |off, on| off.shadow_rays > on.shadow_rays),
        ("black_surfaces", |s| s.black_surfaces = false, |_, _| true),
        ("last_any_hit", |s| s.last_any_hit = false, |off, on| off == on),
        ("dark_scenes", |s| s.dark_scenes = false, |off, on| off.bounce_rays > on.bounce_rays),
    ];
    let scenes = scenes();
    for (switch, off, costs) in switches {
        let mut saved = 0;
        for (name, scene) in &scenes {
            let ((plain, on), (frame, off)) = (without(scene, |_| ()), without(scene, off));
            check_frame(&plain);
            assert!(plain == frame, "{name}: the picture changes without {switch}");
            assert!(on.shadow_rays <= off.shadow_rays && on.bounce_rays <= off.bounce_rays && on.camera_rays <= off.camera_rays);
            saved += usize::from(costs(&off, &on));
        }
        println!("{switch}: saves something in {saved} of {} scenes", scenes.len());
        assert!(saved > 0, "{switch} saves nothing anywhere");
    }
}

/// The set compiled for everything rounds differently (a GGX lobe of two widths), which is all that differs.
#[test]
fn compiled_sets_give_the_same_picture() {
    for (name, scene) in &scenes() {
        let ((plain, _), (full, _)) = (without(scene, |_| ()), without(scene, |s| s.feature_sets = false));
        assert!(plain.alpha == full.alpha && plain.depth == full.depth && plain.albedo == full.albedo, "{name}");
        let pixels = |frame: &Frame| frame.raw.clone().expect("rendered").pixels;
        let (mut square, mut same) = (0.0, 0);
        for (a, b) in pixels(&plain).iter().flatten().zip(pixels(&full).iter().flatten()) {
            square += f64::from(a - b).powi(2) / (f64::from(*b).powi(2) + 0.01);
            same += usize::from(a == b);
        }
        let count = pixels(&full).len() * 3;
        println!("{name}: relMSE {:.1e}, {same} of {count} values bit-identical", square / count as f64);
        assert!(square / (count as f64) < 1e-8, "{name}");
    }
}

/// Light samples of a flat environment would change the noise, but not the mean.
#[test]
fn flat_environments_need_no_light_samples() {
    for (name, scene) in scenes().iter().filter(|(name, _)| name.ends_with("flat")) {
        let many = |skips: Skips| render_with(scene, &Settings { spp: 512, ..settings(skips) });
        let ((plain, on), (sampled, off)) = (many(Skips::ALL), many(Skips { flat_environment: false, ..Skips::ALL }));
        assert!(off.shadow_rays > 2 * on.shadow_rays);
        let pixels = |frame: &Frame| frame.raw.clone().expect("rendered").pixels;
        let variances = |frame: &Frame| frame.variance.clone().expect("asked for").pixels;
        let (mut difference, mut variance, mut total) = (0.0, [0.0; 2], 0.0);
        for (i, (a, b)) in pixels(&plain).iter().zip(&pixels(&sampled)).enumerate() {
            difference += f64::from(a[1] - b[1]);
            total += f64::from(a[1]);
            variance[0] += f64::from(variances(&plain)[i][1]);
            variance[1] += f64::from(variances(&sampled)[i][1]);
        }
        println!(
            "{name}: {:.1e} of the light apart, variance {:.1e} against {:.1e}",
            difference / total,
            variance[0],
            variance[1]
        );
        assert!(difference.abs() < 4.0 * (variance[0] + variance[1]).sqrt().max(1e-6 * total), "{name}");
        assert!(variance[0] < variance[1], "{name}");
    }
}

/// A channel has the same values whatever else is asked for, and none that is not is there or paid for.
#[test]
fn channels_are_independent() {
    let (_, scene) = &scenes()[0];
    let (all, full) = without(scene, |_| ());
    let rendered = |channels, irradiance| render_with(scene, &Settings { channels, irradiance, ..settings(Skips::ALL) });
    let (beauty, least) = rendered(Channels::BEAUTY, false);
    assert!(beauty.raw == all.raw && beauty.beauty == all.beauty && beauty.alpha == all.alpha);
    assert!(beauty.variance.is_none() && beauty.guide_albedo.is_none() && beauty.guide_normal.is_none());
    assert!(beauty.motion.is_none() && beauty.motion_prev.is_none() && beauty.irradiance.is_none());
    for (name, count) in [
        ("albedo", beauty.albedo.pixels.len()),
        ("normal", beauty.normal.pixels.len()),
        ("depth", beauty.depth.pixels.len()),
        ("material", beauty.material.pixels.len()),
        ("ids", beauty.object_id.pixels.len() + beauty.material_id.pixels.len()),
    ] {
        assert_eq!(count, 0, "{name}");
    }
    // Centre rays, one in every pixel that may see geometry, are all that the beauty alone saves; eight samples share four rays.
    assert_eq!(full.camera_rays - least.camera_rays, full.camera_rays / 5);
    assert_eq!((full.bounce_rays, full.shadow_rays), (least.bounce_rays, least.shadow_rays));

    let none = Channels::BEAUTY;
    let (frame, _) = rendered(Channels { gbuffer: true, ..none }, false);
    assert!(frame.depth == all.depth && frame.albedo == all.albedo && frame.normal == all.normal);
    assert!(frame.material == all.material && frame.object_id == all.object_id && frame.material_id == all.material_id);
    let (frame, _) = rendered(Channels { motion: true, ..none }, false);
    assert!(frame.motion == all.motion && frame.motion_prev == all.motion_prev && frame.depth.pixels.is_empty());
    let (frame, _) = rendered(Channels { guides: true, ..none }, false);
    assert!(frame.guide_albedo == all.guide_albedo && frame.guide_normal == all.guide_normal);
    let (frame, _) = rendered(Channels { variance: true, ..none }, false);
    assert!(frame.variance == all.variance);
    let (frame, stats) = rendered(none, true);
    let (whole, _) = rendered(Channels::ALL, true);
    assert!(frame.irradiance == whole.irradiance && frame.irradiance.is_some() && stats.camera_rays == full.camera_rays);

    // Without a beauty, too.
    let gbuffer = |channels| render_gbuffer(scene, &Settings { channels, ..settings(Skips::ALL) }).expect("in range");
    let (frame, bare) = (gbuffer(Channels::ALL), gbuffer(none));
    assert!(bare.alpha == frame.alpha && bare.depth.pixels.is_empty() && bare.guide_albedo.is_none());
    check_frame(&frame);
}

/// Root mean square difference of coverage, guide albedo and guide normal.
fn guide_differences(a: &Frame, b: &Frame) -> [f64; 3] {
    let values = |frame: &Frame| {
        let picture = |image: &Option<Image<[f32; 3]>>| image.as_ref().expect("asked for").pixels.as_flattened().to_vec();
        [frame.alpha.pixels.clone(), picture(&frame.guide_albedo), picture(&frame.guide_normal)]
    };
    let (a, b) = (values(a), values(b));
    [0, 1, 2].map(|i| {
        let square = |(a, b): (&f32, &f32)| f64::from(a - b).powi(2);
        (a[i].iter().zip(&b[i]).map(square).sum::<f64>() / a[i].len() as f64).sqrt()
    })
}

/// Where centre and corners of a pixel see one plain surface, sixteen rays would say the same: they are not farther from many
/// rays than sixteen rays in every pixel are, and pixel centres do not notice.
#[test]
fn plain_pixels_need_no_guide_rays() {
    for (name, scene) in &scenes() {
        let gbuffer = |plain_pixels, guide_samples, filter| {
            let skips = Skips { plain_pixels, ..Skips::ALL };
            render_gbuffer(scene, &Settings { guide_samples, filter, ..settings(skips) }).expect("in range")
        };
        let (with, without) = (gbuffer(true, 16, Filter::Box), gbuffer(false, 16, Filter::Box));
        check_frame(&with);
        assert!(with.albedo == without.albedo && with.normal == without.normal && with.depth == without.depth, "{name}");
        assert!(with.material == without.material && with.object_id == without.object_id, "{name}");
        assert!(with.motion == without.motion && with.material_id == without.material_id, "{name}");
        let many = gbuffer(false, 4096, Filter::Box);
        let (errors, plain) = (guide_differences(&with, &many), guide_differences(&without, &many));
        println!("{name}: {errors:.5?} with, {plain:.5?} without");
        for (error, plain) in errors.into_iter().zip(plain) {
            assert!(error <= plain * 1.05 + 1e-6, "{name}");
        }
        // A filter wider than the pixel sees beyond its corners.
        let wide = [true, false].map(|plain_pixels| gbuffer(plain_pixels, 16, Filter::BlackmanHarris));
        assert!(wide[0] == wide[1], "{name}");
    }
}

/// In a pixel that shows one texture, nine points stand for all rays. Noise of texels is the worst for them: over noise coarser
/// and finer than pixels, they are no farther from many rays than nine rays are.
#[test]
fn nine_points_of_a_texture_are_worth_nine_rays() {
    let mut state = 1u32;
    let mut random = || {
        state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        (state >> 24) as u8
    };
    let texels: Vec<[u8; 4]> = (0..256 * 256).map(|_| [random(), random(), random(), 255]).collect();
    for repeats in [0.05, 0.2, 1.0, 4.0] {
        let transform = Affine2::from_scale(Vec2::splat(repeats));
        let slot = TextureSlot { uv_transform: transform, ..TextureSlot::default() };
        let ground = Material { base_color_texture: Some(slot), ..diffuse([1.0; 3]) };
        let parts = vec![(plane(20.0), ground, Affine3A::IDENTITY)];
        let look = camera([0.0, 2.0, 3.0], [0.0, 0.0, 0.0], 45.0, 48, 40);
        let mut loaded = scene(parts, Environment::constant([1.0; 3]), look);
        loaded.textures.push(Texture::from_rgba8("noise", [256; 2], texels.clone(), Encoding::Srgb, [Wrap::Repeat; 2]));
        let scene = compile(&loaded);
        let gbuffer = |plain_pixels, guide_samples| {
            let skips = Skips { plain_pixels, ..Skips::ALL };
            render_gbuffer(&scene, &Settings { guide_samples, ..settings(skips) }).expect("in range")
        };
        let many = gbuffer(false, 4096);
        let albedo = |frame: &Frame| guide_differences(frame, &many)[1];
        let (with, without, few) = (gbuffer(true, 16), gbuffer(false, 16), gbuffer(false, 9));
        let [with_error, error, error_of_few] = [&with, &without, &few].map(albedo);
        println!("{repeats} repeats: {with_error:.5}; {error:.5} of sixteen rays, {error_of_few:.5} of nine");
        assert!(with.guide_albedo != without.guide_albedo, "no pixel shows the texture alone");
        assert!(with_error < 1.1 * error_of_few, "{repeats}");
    }
}
