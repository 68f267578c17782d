//! Textures reach the picture where they should, and filtered as they should be.

mod common;

use common::{camera, check_frame, compile, diffuse, plane, render, render_with, scene, sphere};
use glam::{Affine2, Affine3A, Vec2, Vec3, Vec3A, Vec4};
use renderflow_frame::reach::Reach;
use renderflow_frame::{Camera, Environment, Frame, Image};
use renderflow_renderer::{Settings, render_gbuffer};
use renderflow_scenes::loaded::{AlphaMask, Encoding, Texture, Wrap};
use renderflow_scenes::{LoadedScene, Material, Principled, Scene, TextureSlot, load};

/// Edge of the pictures from above, and of the square they show, which is exactly filled.
const EDGE: usize = 48;

fn slot(uv_transform: Affine2) -> Option<TextureSlot> {
    Some(TextureSlot { uv_transform, ..TextureSlot::default() })
}

/// Looks down on the square of edge 2 about the origin: pixel (x, y) shows u = (x + 0.5) / EDGE, v = (y + 0.5) / EDGE.
fn from_above() -> Camera {
    Camera::look_at(Vec3A::Y * 8.0, Vec3A::ZERO, Vec3A::NEG_Z, 2.0 * (1.0_f32 / 8.0).atan(), EDGE, EDGE)
}

fn textured(material: Material, texture: Texture, look: Camera) -> LoadedScene {
    let mut loaded = scene(vec![(plane(2.0), material, Affine3A::IDENTITY)], Environment::constant([1.0; 3]), look);
    loaded.textures.push(texture);
    loaded
}

/// Texels of a pattern that repeats nowhere.
fn colour(x: usize, y: usize) -> [u8; 4] {
    [(16 * x + y) as u8, (255 - 13 * y) as u8, ((x * x + 7 * y) % 256) as u8, 255]
}

fn pattern(size: usize, encoding: Encoding, wrap: [Wrap; 2]) -> Texture {
    let texels = (0..size * size).map(|i| colour(i % size, i / size)).collect();
    Texture::from_rgba8("pattern", [size, size], texels, encoding, wrap)
}

/// Black and white in turn; each field is `field` texels wide.
fn checker(size: usize, field: usize, encoding: Encoding) -> Texture {
    let texels =
        (0..size * size).map(|i| if (i % size / field + i / size / field).is_multiple_of(2) { [255; 4] } else { [0, 0, 0, 255] });
    Texture::from_rgba8("checker", [size, size], texels.collect(), encoding, [Wrap::Repeat; 2])
}

/// sRGB as IEC 61966-2-1 prints it.
fn srgb(value: u8) -> f32 {
    let v = f64::from(value) / 255.0;
    (if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }) as f32
}

fn close(a: &[f32; 3], b: [f32; 3], tolerance: f32) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= tolerance)
}

#[test]
fn texels_are_exact_from_near() {
    for (encoding, decode) in [(Encoding::Srgb, srgb as fn(u8) -> f32), (Encoding::Linear, |v| f32::from(v) / 255.0)] {
        let material = Material { base_color_texture: slot(Affine2::IDENTITY), ..diffuse([1.0, 0.5, 1.0]) };
        let compiled = compile(&textured(material, pattern(16, encoding, [Wrap::Repeat; 2]), from_above()));
        assert!(compiled.features().textures && !compiled.features().full());
        let frame = render_gbuffer(&compiled, &Settings::default()).expect("in range");
        // Of every three by three pixels the middle one looks at the centre of a texel.
        for (x, y) in (0..256).map(|i| (i % 16, i / 16)) {
            let [r, g, b, _] = colour(x, y).map(decode);
            let found = frame.albedo.pixels[(3 * y + 1) * EDGE + 3 * x + 1];
            // Pixel centres are met to a few millionths of the square.
            assert!(close(&found, [r, 0.5 * g, b], 5e-4), "texel {x} {y}: {found:?} for {:?}", [r, 0.5 * g, b]);
        }
        // The beauty is the albedo times the light; between texels it is linear, so whole pixels are near their centres' colour.
        let (frame, _) = render(&compiled, 64);
        check_frame(&frame);
        let beauty = &frame.beauty.as_ref().expect("rendered").pixels;
        let mean = |image: &[[f32; 3]], c: usize| image.iter().map(|p| f64::from(p[c])).sum::<f64>() / image.len() as f64;
        for c in 0..3 {
            assert!((mean(beauty, c) / mean(&frame.albedo.pixels, c) - 1.0).abs() < 2e-3);
            assert!((mean(beauty, c) / mean(&frame.guide_albedo.as_ref().expect("rendered").pixels, c) - 1.0).abs() < 1e-5);
        }
    }
}

/// Three tiles each way, moved by one: every wrap by its definition.
#[test]
fn wraps_and_transforms_reach_the_picture() {
    let fold = |i: i64, wrap: Wrap| match wrap {
        Wrap::Repeat => i.rem_euclid(4) as usize,
        Wrap::Clamp => i.clamp(0, 3) as usize,
        Wrap::Mirror => {
            let i = i.rem_euclid(8) as usize;
            if i < 4 { i } else { 7 - i }
        }
    };
    let wraps = [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp];
    for (wu, wv) in wraps.into_iter().flat_map(|u| wraps.map(|v| (u, v))) {
        // As KHR_texture_transform composes them: offset, rotation, scale.
        for quarter in [false, true] {
            let turn = if quarter { std::f32::consts::FRAC_PI_2 } else { 0.0 };
            let transform =
                Affine2::from_translation(Vec2::splat(-1.0)) * Affine2::from_angle(-turn) * Affine2::from_scale(Vec2::splat(3.0));
            let material = Material { base_color_texture: slot(transform), ..diffuse([1.0; 3]) };
            let compiled = compile(&textured(material, pattern(4, Encoding::Linear, [wu, wv]), from_above()));
            let frame = render_gbuffer(&compiled, &Settings::default()).expect("in range");
            // 12 texels each way, four pixels each: the mean of the middle four is the texel's, where its neighbours blend
            // evenly.
            for (x, y) in (0..144).map(|i| (i64::from(i % 12), i64::from(i / 12))) {
                // -1 + x and -1 + y tiles; turned, u = -1 + y and v = -1 - x.
                let (column, row) = if quarter { (y - 4, -5 - x) } else { (x - 4, y - 4) };
                let texel = |dx: i64, dy: i64| {
                    let [r, g, b, _] = colour(fold(column + dx, wu), fold(row + dy, wv)).map(|v| f32::from(v) / 255.0);
                    Vec3::new(r, g, b)
                };
                // Four looks an eighth of a texel from the centre: 3/4 + 1/8 of it along each axis, the rest of its neighbours.
                let weights = [(-1, 0.0625), (0, 0.875), (1, 0.0625)];
                let expected: Vec3 = weights.iter().flat_map(|&(i, a)| weights.map(|(j, b)| texel(i, j) * (a * b))).sum();
                let found: Vec3 = [(1, 1), (2, 1), (1, 2), (2, 2)]
                    .iter()
                    .map(|&(i, j)| Vec3::from(frame.albedo.pixels[(4 * y as usize + j) * EDGE + 4 * x as usize + i]))
                    .sum::<Vec3>()
                    / 4.0;
                assert!(found.distance(expected) < 1e-3, "{wu:?} {wv:?} {quarter} {x} {y}: {found} for {expected}");
            }
        }
    }
}

#[test]
fn roughness_and_metallic_come_from_green_and_blue() {
    let texels = vec![[9, 51, 204, 255], [9, 255, 0, 255], [9, 0, 255, 255], [9, 102, 102, 255]];
    let texture = Texture::from_rgba8("packed", [2, 2], texels, Encoding::Linear, [Wrap::Clamp; 2]);
    let material = Material {
        metallic_roughness_texture: slot(Affine2::IDENTITY),
        surface: Principled { roughness: 0.5, metallic: 0.75, ..Principled::default() },
        ..Material::default()
    };
    let compiled = compile(&textured(material, texture, from_above()));
    let frame = render_gbuffer(&compiled, &Settings::default()).expect("in range");
    for (x, y, rough, metal) in [(0, 0, 0.2, 0.8), (1, 0, 1.0, 0.0), (0, 1, 0.0, 1.0), (1, 1, 0.4, 0.4)] {
        // A corner pixel: beyond the texel's centre, where clamping holds it.
        let at = y * (EDGE - 1) * EDGE + x * (EDGE - 1);
        assert!(close(&frame.material.pixels[at], [0.5 * rough, 0.75 * metal, 0.5], 1e-6), "{:?}", frame.material.pixels[at]);
    }
}

#[test]
fn normal_maps_lean_along_tangent_and_bitangent() {
    // Leans along +x, +y of tangent space; the bitangent is the normal's cross product with the tangent times the handedness.
    for (stored, strength, handedness, expected) in [
        ([218, 128, 218], 1.0, 1.0, Vec3::new(1.0, 1.0, 0.0)),
        ([128, 218, 218], 1.0, 1.0, Vec3::new(0.0, 1.0, -1.0)),
        ([128, 218, 218], 1.0, -1.0, Vec3::new(0.0, 1.0, 1.0)),
        ([218, 128, 218], 0.5, 1.0, Vec3::new(0.5, 1.0, 0.0)),
        ([128, 128, 255], 1.0, 1.0, Vec3::Y),
    ] {
        let [x, y, z] = stored;
        let texture = Texture::from_rgba8("normal", [1, 1], vec![[x, y, z, 255]], Encoding::Normal, [Wrap::Repeat; 2]);
        let material = Material { normal_texture: slot(Affine2::IDENTITY).map(|s| (s, strength)), ..diffuse([0.5; 3]) };
        let mut loaded = textured(material, texture, from_above());
        loaded.meshes[0].tangents = vec![Vec4::new(1.0, 0.0, 0.0, handedness); 4];
        for below in [false, true] {
            let mut loaded = loaded.clone();
            if below {
                // From behind, the normal is turned as a whole.
                loaded.cameras[0] = Camera::look_at(Vec3A::NEG_Y * 8.0, Vec3A::ZERO, Vec3A::NEG_Z, 0.2, 3, 3);
            }
            let look = loaded.cameras[0];
            let frame = render_gbuffer(&compile(&loaded), &Settings::default()).expect("in range");
            let middle = look.height / 2 * look.width + look.width / 2;
            let found = look.camera_to_world.matrix3 * Vec3A::from_array(frame.normal.pixels[middle]);
            let expected = Vec3A::from(expected.normalize()) * if below { -1.0 } else { 1.0 };
            assert!(found.distance(expected) < 0.01, "{stored:?} {strength} {handedness} {below}: {found} for {expected}");
        }
    }
}

/// A PNG of one texel, (218, 128, 218): the normal leans by 45 degrees to where u grows.
const LEANING: [u8; 69] = [
    137, 80, 78, 71, 13, 10, 26, 10, 0, 0, 0, 13, 73, 72, 68, 82, 0, 0, 0, 1, 0, 0, 0, 1, 8, 2, 0, 0, 0, 144, 119, 83, 222, 0, 0,
    0, 12, 73, 68, 65, 84, 120, 156, 99, 184, 213, 112, 11, 0, 4, 108, 2, 53, 16, 227, 244, 66, 0, 0, 0, 0, 73, 69, 78, 68, 174,
    66, 96, 130,
];

/// A normal map that lies turned on a surface turns its normals along: they lean to where u grows as the map is looked up, and a
/// distant light shows it. The squares are one mesh, of which each turn gets tangents of its own.
#[test]
fn turned_normal_maps_turn_their_normals() {
    let lies = [(0.0, [1.0, 1.0]), (0.0, [3.0, 2.0]), (90.0, [1.0, 1.0]), (180.0, [1.0, 1.0]), (-90.0, [2.0, 2.0])];
    let lies: Vec<(f32, [f32; 2])> = lies.into_iter().chain([(-35.0, [1.0, 2.0]), (0.0, [-1.0, 1.0])]).collect();
    let (mut materials, mut objects) = (vec![], vec![]);
    for (i, (rotation, scale)) in lies.iter().enumerate() {
        let lie = format!(r#"{{ "rotation": {rotation:?}, "scale": {scale:?} }}"#);
        materials.push(format!(
            r#"{{ "name": "m{i}", "base_color": [0.5, 0.5, 0.5], "roughness": 1, "specular": 0, "normal_texture": "leaning.png",
                "texture_transform": {lie} }}"#
        ));
        objects.push(format!(
            r#"{{ "name": "o{i}", "geometry": {{ "shape": {{ "family": "plane", "size": 2 }} }}, "material": "m{i}",
                "transform": {{ "translation": [{}, 0, 0] }} }}"#,
            3 * i
        ));
    }
    let text = format!(
        r#"{{ "version": 1, "name": "turned", "resolution": [3, 3],
            "camera": {{ "type": "poses", "poses": [{{ "eye": [0, 8, 1], "target": [0, 0, 0] }}], "vertical_fov": 10 }},
            "environment": {{ "source": {{ "constant": [0, 0, 0] }} }}, "materials": [{}], "objects": [{}],
            "lights": [{{ "name": "sun", "kind": {{ "directional": {{ "irradiance": 1 }} }}, "target": [0, 0, 0],
                "transform": {{ "translation": [10, 10, 0] }} }}] }}"#,
        materials.join(","),
        objects.join(",")
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.json");
    std::fs::write(folder.path().join("leaning.png"), LEANING).unwrap();
    let mut loaded = load::load(&Scene::from_json(&path, &text).unwrap(), &Reach::of(&path)).unwrap();
    let mut seen: Vec<(f32, f32)> = vec![];
    for instance in loaded.instances.clone() {
        let transform = instance.transform(0);
        let mesh = &loaded.meshes[instance.mesh];
        let corners = mesh.triangles[0].map(|v| v as usize);
        let [a, b, c] = corners.map(|v| transform.transform_point3(mesh.positions[v]));
        let [ua, ub, uc] = corners.map(|v| mesh.uvs[v]);
        // How the place changes with u and v of the mesh, and with the u of the look-up.
        let (e, f, d, g) = (b - a, c - a, ub - ua, uc - ua);
        let (along_u, along_v) = ((e * g.y - f * d.y) / d.perp_dot(g), (f * d.x - e * g.x) / d.perp_dot(g));
        let slot = &loaded.materials[instance.material].normal_texture.as_ref().expect("a normal map").0;
        let step = slot.uv_transform.matrix2.inverse().x_axis;
        let expected = Vec3A::from((along_u * step.x + along_v * step.y).normalize() + Vec3::Y).normalize();

        let centre = transform.translation;
        loaded.cameras = vec![Camera::look_at(centre + Vec3A::Y * 8.0, centre, Vec3A::NEG_Z, 0.1, 3, 3)];
        let frame = render(&compile(&loaded), 4).0;
        let found = loaded.cameras[0].camera_to_world.matrix3 * Vec3A::from_array(frame.normal.pixels[4]);
        assert!(found.distance(expected) < 0.02, "{}: {found} for {expected}", instance.name);
        let raw = frame.raw.as_ref().expect("a picture");
        seen.push((expected.dot(Vec3A::new(1.0, 1.0, 0.0).normalize()).max(0.0), raw.at(1, 1)[0]));
    }
    for (cos, light) in &seen {
        for (other, less) in seen.iter().filter(|(other, _)| cos - other > 0.1) {
            assert!(light > less, "{light} at a cosine of {cos}, {less} at one of {other}");
        }
    }
    let mesh = |i: usize| loaded.instances[i].mesh;
    assert!(mesh(0) == mesh(1) && mesh(0) != mesh(2) && loaded.meshes.len() == 6, "{}", loaded.meshes.len());
}

/// Mean and standard deviation of a channel.
fn spread(pixels: &[[f32; 3]]) -> [f64; 2] {
    let n = pixels.len() as f64;
    let mean = pixels.iter().map(|p| f64::from(p[1])).sum::<f64>() / n;
    [mean, (pixels.iter().map(|p| (f64::from(p[1]) - mean).powi(2)).sum::<f64>() / n).sqrt()]
}

/// The same texture without its coarser levels.
fn sharp(texture: &Texture) -> Texture {
    Texture { levels: texture.levels[..1].into(), ..texture.clone() }
}

/// A plane of a thousand checkers a side, seen so that a pixel covers some.
fn far(texture: Texture, look: Camera, repeats: f32) -> LoadedScene {
    let material = Material { base_color_texture: slot(Affine2::from_scale(Vec2::splat(repeats))), ..diffuse([1.0; 3]) };
    let mut loaded = scene(vec![(plane(2000.0), material, Affine3A::IDENTITY)], Environment::constant([1.0; 3]), look);
    loaded.textures.push(texture);
    loaded
}

#[test]
fn far_checkers_are_grey_without_aliasing() {
    for (encoding, tolerance) in [(Encoding::Linear, 0.01), (Encoding::Srgb, 0.01)] {
        for (name, look) in [
            ("from above", camera([0.0, 150.0, 0.1], [0.0; 3], 20.0, 32, 32)),
            ("at a slant", camera([0.0, 60.0, 150.0], [0.0; 3], 20.0, 32, 32)),
            ("grazing", camera([0.0, 10.0, 150.0], [0.0; 3], 3.0, 32, 32)),
        ] {
            let texture = checker(16, 1, encoding);
            let compiled = compile(&far(texture.clone(), look, 1000.0));
            let frame = render_gbuffer(&compiled, &Settings::default()).expect("in range");
            let aliased = render_gbuffer(&compile(&far(sharp(&texture), look, 1000.0)), &Settings::default()).expect("in range");
            let ([mean, deviation], [_, sharp]) = (spread(&frame.albedo.pixels), spread(&aliased.albedo.pixels));
            println!("{name}, {encoding:?}: mean {mean:.4}, deviation {deviation:.4}, without levels {sharp:.4}");
            assert!((mean / 0.5 - 1.0).abs() < tolerance && deviation < 0.02 && sharp > 0.1);
        }
    }
}

/// Filtering a colour by levels or by samples has the same mean, at every distance.
#[test]
fn levels_do_not_move_the_mean() {
    let mean_and_error = |frame: &Frame| {
        let image =
            |i: &Option<Image<[f32; 3]>>| i.as_ref().map_or(0.0, |i| i.pixels.iter().map(|p| f64::from(p[1])).sum::<f64>());
        let n = frame.alpha.pixels.len() as f64;
        (image(&frame.beauty) / n, image(&frame.variance).sqrt() / n)
    };
    let texels = (0..64 * 64_u32).map(|i| [0, (i.wrapping_mul(2_654_435_761) >> 24) as u8, 0, 255]).collect();
    let noise = Texture::from_rgba8("noise", [64, 64], texels, Encoding::Linear, [Wrap::Repeat; 2]);
    let mut filtering = 0;
    for (texture, repeats) in [(checker(16, 4, Encoding::Linear), 100.0), (noise, 30.0)] {
        for distance in [2.0_f32, 10.0, 60.0, 300.0] {
            for (height, mirror) in [(1.0, false), (0.2, false), (0.5, true)] {
                let look = camera([0.3, height * distance, distance], [0.3, 0.0, 0.1], 20.0, 40, 40);
                let picture = |texture: Texture| {
                    let mut loaded = far(texture, look, repeats);
                    if mirror {
                        // The texture is met after a first surface as well.
                        let ball = Affine3A::from_scale(Vec3::splat(0.2 * distance));
                        loaded.meshes.push(sphere(16, true));
                        loaded.materials.push(Material::from(Principled {
                            metallic: 1.0,
                            roughness: 0.2,
                            ..Principled::default()
                        }));
                        loaded.instances.push(common::instance(1, 1, ball));
                    }
                    let frame = render_with(&compile(&loaded), &Settings { spp: 4, max_bounces: 3, ..Settings::default() }).0;
                    let (mean, error) = mean_and_error(&frame);
                    (mean, error, frame.beauty)
                };
                let ((filtered, own, a), (bare, other, b)) = (picture(texture.clone()), picture(sharp(&texture)));
                filtering += usize::from(a != b);
                let error = 4.0 * (own * own + other * other).sqrt();
                println!(
                    "distance {distance}, height {height}: {filtered:.5} with levels, {bare:.5} without, allowed {error:.5}"
                );
                // Levels are stored in 8 bits.
                assert!((filtered - bare).abs() < error + 2e-3 * bare);
            }
        }
    }
    assert!(filtering >= 12, "levels were used in {filtering} pictures alone");
}

/// What a mask leaves of a surface is the same share at any distance, seen by many pixels or many to a pixel. Masks are not read
/// from coarser levels, whose mean alpha would be all of it or nothing of it, and holes at the centre and all corners of a pixel
/// do not make it empty.
#[test]
fn masks_cover_the_same_share_at_every_distance() {
    // Between the two texels alpha goes evenly from 0 to 1 and back: the share at or above the cutoff is 1 less the cutoff.
    let texels = vec![[255, 255, 255, 0], [255; 4]];
    let stripes = Texture::from_rgba8("stripes", [2, 1], texels, Encoding::Srgb, [Wrap::Repeat; 2]);
    for cutoff in [0.2, 0.45, 0.55, 0.8] {
        for repeats in [300.0, 3000.0, 30_000.0] {
            let mut loaded = far(stripes.clone(), camera([0.0, 150.0, 0.1], [0.0; 3], 20.0, 32, 32), repeats);
            loaded.materials[0].alpha_mask = Some(AlphaMask { cutoff, factor: 1.0 });
            let settings = Settings { guide_samples: 64, ..Settings::default() };
            let frame = render_gbuffer(&compile(&loaded), &settings).expect("in range");
            let share = frame.alpha.pixels.iter().sum::<f32>() / frame.alpha.pixels.len() as f32;
            assert!((share - (1.0 - cutoff)).abs() < 0.05, "cutoff {cutoff}, {repeats} repeats: {share}");
        }
    }
}

#[test]
fn emissive_textures_are_seen_as_they_are() {
    // Fields of four by four texels, each seen by twelve by twelve pixels.
    let fields = |x: usize, y: usize| [(60 * x) as u8, (255 - 40 * y) as u8, (20 * (x + y)) as u8, 255];
    let texels = (0..256).map(|i| fields(i % 16 / 4, i / 16 / 4)).collect();
    let texture = Texture::from_rgba8("fields", [16, 16], texels, Encoding::Srgb, [Wrap::Clamp; 2]);
    let material = Material { emissive: [2.0, 1.0, 3.0], emissive_texture: slot(Affine2::IDENTITY), ..diffuse([0.0; 3]) };
    let mut loaded = textured(material, texture, from_above());
    loaded.environment = Environment::constant([0.0; 3]);
    let (frame, _) = render(&compile(&loaded), 4);
    let beauty = &frame.beauty.as_ref().expect("rendered").pixels;
    for (x, y) in (0..16).map(|i| (i % 4, i / 4)) {
        let [r, g, b, _] = fields(x, y).map(srgb);
        for (i, j) in [(3, 3), (8, 8), (5, 6)] {
            let found = beauty[(12 * y + j) * EDGE + 12 * x + i];
            assert!(close(&found, [2.0 * r, g, 3.0 * b], 1e-5), "field {x} {y}: {found:?}");
        }
    }
}
