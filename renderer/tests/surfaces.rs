//! Surfaces that are there from one side only, or not everywhere, that shine, are brushed, or whose normals lean.

mod common;

use common::{camera, compile, diffuse, furthest, plane, render, render_with, scene, sphere};
use glam::{Affine2, Affine3A, Quat, Vec2, Vec3, Vec3A, Vec4};
use renderflow_frame::{Camera, Environment, Frame, Image};
use renderflow_renderer::{DirectLight, Mode, RenderScene, Settings, Sharing, Skips, render_gbuffer};
use renderflow_scenes::loaded::{AlphaMask, Encoding, Texture, Wrap};
use renderflow_scenes::{LoadedScene, Material, Mesh, Principled, TextureSlot};

const SLOT: Option<TextureSlot> = Some(TextureSlot { texture: 0, uv_transform: Affine2::IDENTITY, set: 0 });

fn flat(value: f32) -> Environment {
    Environment::constant([value; 3])
}

/// Not flat, so that light samples and shadow rays are used. (One texel alone that differs would be a rare event.)
fn nearly_flat(value: f32) -> Environment {
    let map = Image::from_fn(32, 16, |x, y| [value * if (x + y) % 2 == 0 { 1.00005 } else { 0.99995 }; 3]);
    Environment { map, rotation: 0.0, intensity: 1.0 }
}

fn down(size: f32, height: f32) -> (Mesh, Affine3A) {
    let turn = Quat::from_rotation_x(std::f32::consts::PI);
    (plane(size), Affine3A::from_rotation_translation(turn, Vec3::Y * height))
}

fn beauty(frame: &Frame) -> &[[f32; 3]] {
    frame.beauty.as_ref().map_or(&[], |i| &i.pixels)
}

fn mean(frame: &Frame) -> f64 {
    beauty(frame).iter().flatten().map(|&v| f64::from(v)).sum::<f64>() / (3 * beauty(frame).len()) as f64
}

fn tangents(mesh: Mesh) -> Mesh {
    let count = mesh.positions.len();
    Mesh { tangents: vec![Vec4::new(1.0, 0.0, 0.0, 1.0); count], ..mesh }
}

/// Mirrors a mesh's winding, as loading does for mirrored placements.
fn reversed(mut mesh: Mesh) -> Mesh {
    mesh.triangles.iter_mut().for_each(|t| t.reverse());
    mesh
}

fn single_sided(material: Material) -> Material {
    Material { double_sided: false, ..material }
}

#[test]
fn single_sided_squares_are_seen_from_the_front_alone() {
    let mirror = Affine3A::from_scale(Vec3::new(-1.0, 1.0, 1.0));
    let turned = Affine3A::from_quat(Quat::from_rotation_z(0.5)) * Affine3A::from_scale(Vec3::new(1.0, 2.0, -0.5));
    for (name, transform) in [("as it is", Affine3A::IDENTITY), ("mirrored", mirror), ("turned and mirrored", turned)] {
        let mirrored = transform.matrix3.determinant() < 0.0;
        let mesh = if mirrored { reversed(plane(2.0)) } else { plane(2.0) };
        let up = transform.transform_vector3(Vec3::Y).normalize();
        for (side, front) in [(1.0, true), (-1.0, false)] {
            // Two copies, so that both kinds of placement are used.
            for sharing in [Sharing::Never, Sharing::Always] {
                let eye = (3.0 * side * up + Vec3::new(0.1, 0.05, 0.07)).to_array();
                let mut loaded = scene(
                    vec![(mesh.clone(), single_sided(diffuse([0.5; 3])), transform)],
                    flat(1.0),
                    camera(eye, [0.0; 3], 5.0, 6, 6),
                );
                let mut again = loaded.instances[0].clone();
                again.transforms[0].translation += Vec3A::X * 50.0;
                loaded.instances.push(again);
                let compiled = RenderScene::compile_with(&loaded, sharing).expect("consistent");
                assert!(compiled.features().cutouts);
                let (frame, _) = render(&compiled, 4);
                let expected = if front { 0.5 } else { 1.0 };
                assert!(
                    beauty(&frame).iter().flatten().all(|&v| v == expected),
                    "{name}, {side}, {sharing:?}: {:?}",
                    beauty(&frame)[0]
                );
                assert!(frame.object_id.pixels.iter().all(|&id| (id != 0) == front));
                assert!(frame.depth.pixels.iter().all(|d| d.is_finite() == front));
                assert!(frame.alpha.pixels.iter().all(|&a| a == if front { 1.0 } else { 0.0 }));
            }
        }
    }
}

/// Light passes a single-sided roof where it comes from behind, for shadow rays and bounce rays alike; the roof's front is black.
#[test]
fn single_sided_squares_throw_no_shadow_from_behind() {
    let look = || camera([0.3, 0.9, 0.0], [0.0; 3], 3.0, 8, 8);
    for environment in [flat(1.0), nearly_flat(1.0)] {
        for direct in [DirectLight::Mis, DirectLight::Scattering] {
            let lit = |roof: Option<bool>| {
                let mut parts = vec![(plane(10.0), diffuse([0.5; 3]), Affine3A::IDENTITY)];
                if let Some(faces_up) = roof {
                    let (mesh, placed) = down(40.0, 1.0);
                    let place = if faces_up { Affine3A::from_translation(Vec3::Y) } else { placed };
                    parts.push((mesh, single_sided(diffuse([0.0; 3])), place));
                }
                let scene = compile(&scene(parts, environment.clone(), look()));
                mean(&render_with(&scene, &Settings { spp: 64, direct, ..Settings::default() }).0)
            };
            // Rays from the floor meet the back of a roof that faces up, and pass.
            let (open, up, down) = (lit(None), lit(Some(true)), lit(Some(false)));
            println!("{direct:?}: open {open:.4}, roof that faces up {up:.4}, that faces down {down:.4}");
            assert!((up / open - 1.0).abs() < 1e-6);
            assert!(down < 0.01);
        }
    }
}

/// A lamp of its own: a square that emits, in a black world.
fn lamp(double_sided: bool) -> Material {
    Material { emissive: [2.0, 1.0, 0.5], double_sided, ..diffuse([0.0; 3]) }
}

#[test]
fn emitters_shine_from_the_sides_they_have() {
    for double_sided in [false, true] {
        for facing_floor in [false, true] {
            for mirrored in [false, true] {
                let (mesh, mut place) = down(0.5, 1.0);
                if !facing_floor {
                    place = Affine3A::from_translation(Vec3::Y);
                }
                let mesh = if mirrored { reversed(mesh) } else { mesh };
                if mirrored {
                    place *= Affine3A::from_scale(Vec3::new(-1.0, 1.0, 1.0));
                }
                let parts = vec![(plane(10.0), diffuse([0.5; 3]), Affine3A::IDENTITY), (mesh, lamp(double_sided), place)];
                let shines = double_sided || facing_floor;
                let mut floors = Vec::new();
                for direct in [DirectLight::Mis, DirectLight::Scattering, DirectLight::Lights] {
                    let settings = Settings { spp: 256, direct, ..Settings::default() };
                    // The floor below, and the lamp itself from below.
                    let loaded = scene(parts.clone(), flat(0.0), camera([0.2, 0.4, 0.3], [0.1, 0.0, 0.0], 10.0, 8, 8));
                    floors.push(mean(&render_with(&compile(&loaded), &settings).0));
                    let loaded = scene(parts.clone(), flat(0.0), camera([0.1, 0.4, 0.07], [0.0, 1.0, 0.0], 5.0, 4, 4));
                    let (frame, _) = render_with(&compile(&loaded), &Settings { spp: 4, ..settings });
                    let expected = if shines { [2.0, 1.0, 0.5] } else { [0.0; 3] };
                    assert!(beauty(&frame).iter().all(|&p| p == expected), "{direct:?} {:?}", beauty(&frame)[0]);
                }
                println!("double-sided {double_sided}, facing the floor {facing_floor}, mirrored {mirrored}: {floors:.4?}");
                for floor in &floors {
                    assert!(if shines { *floor > 0.01 && (floor / floors[0] - 1.0).abs() < 0.02 } else { *floor == 0.0 });
                }
            }
        }
    }
}

/// Triangles that geometry drops must not shift the numbers of the emitters that stay.
#[test]
fn dropped_triangles_leave_the_others_their_light() {
    let mut lit = Vec::new();
    for broken in [false, true] {
        let (mut mesh, place) = down(0.5, 1.0);
        if broken {
            mesh.positions.extend([Vec3::NAN, Vec3::splat(3.0)]);
            mesh.normals.extend([Vec3::Y; 2]);
            mesh.uvs.extend([Vec2::ZERO; 2]);
            mesh.triangles.splice(0..0, [[0, 1, 4], [5, 5, 5]]);
            mesh.triangles.insert(3, [2, 4, 5]);
        }
        let parts = vec![(plane(10.0), diffuse([0.5; 3]), Affine3A::IDENTITY), (mesh, lamp(false), place)];
        let compiled = compile(&scene(parts, flat(0.0), camera([0.2, 0.4, 0.3], [0.1, 0.0, 0.0], 10.0, 12, 12)));
        for direct in [DirectLight::Mis, DirectLight::Scattering, DirectLight::Lights] {
            lit.push(mean(&render_with(&compiled, &Settings { spp: 256, direct, ..Settings::default() }).0));
        }
    }
    println!("whole and broken lamp, three ways each: {lit:.4?}");
    assert!(lit.iter().all(|v| (v / lit[0] - 1.0).abs() < 0.015));
}

fn rgba(size: usize, alpha: impl Fn(usize, usize) -> u8) -> Texture {
    let texels = (0..size * size).map(|i| [255, 255, 255, alpha(i % size, i / size)]).collect();
    Texture::from_rgba8("mask", [size, size], texels, Encoding::Linear, [Wrap::Clamp; 2])
}

/// A square with the left half cut out above a floor; both are white, the square's back a roof.
fn masked(texture: Texture, mask: AlphaMask, look: Camera) -> LoadedScene {
    let material = Material { base_color_texture: SLOT, alpha_mask: Some(mask), ..diffuse([0.5; 3]) };
    let parts =
        vec![(plane(2.0), material, Affine3A::from_translation(Vec3::Y)), (plane(100.0), diffuse([0.25; 3]), Affine3A::IDENTITY)];
    let mut loaded = scene(parts, flat(1.0), look);
    loaded.textures.push(texture);
    loaded
}

#[test]
fn holes_let_every_ray_pass() {
    let left = |x: usize, _: usize| if x < 8 { 0 } else { 255 };
    let mask = AlphaMask { cutoff: 0.5, factor: 1.0 };
    // u runs along x: the left half is that of x < 0.
    let look = camera([0.0, 6.0, 0.01], [0.0; 3], 16.0, 16, 16);
    let loaded = masked(rgba(16, left), mask, look);
    let compiled = compile(&loaded);
    assert!(compiled.features().cutouts);
    let frame = render_gbuffer(&compiled, &Settings::default()).expect("in range");
    for (i, &id) in frame.object_id.pixels.iter().enumerate() {
        let hole = i % 16 < 8;
        assert_eq!(id, if hole { 2 } else { 1 }, "pixel {i}");
        assert!((frame.depth.pixels[i] - if hole { 6.0 } else { 5.0 }).abs() < 0.1);
        assert_eq!(frame.albedo.pixels[i][0], if hole { 0.25 } else { 0.5 });
    }
    // A mask without its hole is as dark below as no mask; a mask that is all hole is as bright as no square at all.
    let floor = |texture: Texture, mask: AlphaMask, square: bool, direct: DirectLight, sky: Environment| {
        let mut loaded = masked(texture, mask, camera([0.2, 0.6, 0.1], [0.0; 3], 6.0, 8, 8));
        loaded.environment = sky;
        if !square {
            loaded.instances.remove(0);
        }
        let compiled = compile(&loaded);
        (mean(&render_with(&compiled, &Settings { spp: 64, direct, ..Settings::default() }).0), compiled.features().cutouts)
    };
    for (direct, sky) in
        [(DirectLight::Mis, flat(1.0)), (DirectLight::Mis, nearly_flat(1.0)), (DirectLight::Scattering, nearly_flat(1.0))]
    {
        let at = |alpha: u8, cutoff: f32, factor: f32, square: bool| {
            floor(rgba(4, |_, _| alpha), AlphaMask { cutoff, factor }, square, direct, sky.clone())
        };
        let (open, _) = at(255, 0.5, 1.0, false);
        let (closed, cutouts) = at(255, 0.5, 1.0, true);
        assert!(!cutouts && closed < 0.8 * open);
        // Nothing is cut out at cutoff 0, and nothing at cutoff 1 where alpha is 1.
        for (alpha, cutoff, factor) in [(0, 0.0, 1.0), (0, 0.0, 0.0), (255, 1.0, 1.0), (128, 0.5, 1.0)] {
            assert_eq!(at(alpha, cutoff, factor, true), (closed, false), "alpha {alpha}, cutoff {cutoff}, factor {factor}");
        }
        // All is cut out where alpha falls short of the cutoff.
        for (alpha, cutoff, factor) in [(0, 0.5, 1.0), (254, 1.0, 1.0), (127, 0.5, 1.0), (255, 0.5, 0.4), (255, 1.0, 0.99)] {
            let (light, cutouts) = at(alpha, cutoff, factor, true);
            assert!(cutouts && (light / open - 1.0).abs() < 1e-6, "alpha {alpha}, cutoff {cutoff}: {light} of {open}");
        }
    }
}

/// The factor alone decides where there is no texture.
#[test]
fn masks_without_texture_follow_the_factor() {
    for (factor, cutoff, there) in [(1.0, 0.5, true), (0.5, 0.5, true), (0.4, 0.5, false), (0.0, 0.0, true), (1.0, 1.0, true)] {
        let material = Material { alpha_mask: Some(AlphaMask { cutoff, factor }), ..diffuse([0.5; 3]) };
        let loaded =
            scene(vec![(plane(2.0), material, Affine3A::IDENTITY)], flat(1.0), camera([0.1, 5.0, 0.1], [0.0; 3], 5.0, 4, 4));
        let compiled = compile(&loaded);
        assert_eq!(compiled.features().cutouts, !there);
        let (frame, _) = render(&compiled, 4);
        assert!(beauty(&frame).iter().flatten().all(|&v| v == if there { 0.5 } else { 1.0 }));
    }
}

/// Spread of the highlight of a small bright spot in a brushed plane, along x and along z of the picture, in pixels.
fn highlight(anisotropic: f32, tangent: Vec3, flipped: bool) -> [f64; 2] {
    let mut map = Image::filled(256, 128, [0.0; 3]);
    // Straight above: the whole first row.
    map.pixels[..256].fill([100.0; 3]);
    let mut mesh = plane(20.0);
    mesh.tangents = vec![tangent.extend(1.0); 4];
    if flipped {
        mesh = reversed(mesh);
        mesh.normals = vec![-Vec3::Y; 4];
    }
    let material = Material::from(Principled {
        metallic: 1.0,
        roughness: 0.4,
        anisotropic,
        base_color: Vec3A::from_array([1.0; 3]),
        ..Principled::default()
    });
    // From above with +x to the right; the eye is near, so that pixels see the plane at different angles.
    let look = Camera::look_at(Vec3A::Y * 4.0, Vec3A::ZERO, Vec3A::NEG_Z, 1.6, 33, 33);
    let environment = Environment { map, rotation: 0.0, intensity: 1.0 };
    let compiled = compile(&scene(vec![(mesh, material, Affine3A::IDENTITY)], environment, look));
    let (frame, _) = render_with(&compiled, &Settings { spp: 64, max_bounces: 1, ..Settings::default() });
    let (mut total, mut spread) = (0.0, [0.0; 2]);
    for (i, pixel) in beauty(&frame).iter().enumerate() {
        let [x, y] = [i % 33, i / 33].map(|v| v as f64 - 16.0);
        let value = f64::from(pixel[1]);
        total += value;
        spread[0] += value * x * x;
        spread[1] += value * y * y;
    }
    spread.map(|s| (s / total).sqrt())
}

/// Burley 2012 and KHR_materials_anisotropy both widen the highlight along the tangent and narrow it across.
#[test]
fn brushed_metal_stretches_highlights_along_the_tangent() {
    let round = highlight(0.0, Vec3::X, false);
    let along = highlight(0.8, Vec3::X, false);
    let across = highlight(0.8, Vec3::Z, false);
    let back = highlight(0.8, Vec3::X, true);
    let opposite = highlight(0.8, Vec3::NEG_X, false);
    println!("spread in x and y: round {round:.3?}, tangent x {along:.3?}, tangent z {across:.3?}, from behind {back:.3?}");
    assert!((round[0] / round[1] - 1.0).abs() < 0.05);
    assert!(along[0] > 1.3 * along[1] && along[0] > 1.1 * round[0] && along[1] < 0.9 * round[1]);
    assert!((along[0] / across[1] - 1.0).abs() < 0.05 && (along[1] / across[0] - 1.0).abs() < 0.05);
    for other in [back, opposite] {
        assert!((0..2).all(|i| (other[i] / along[i] - 1.0).abs() < 0.05), "{other:?}");
    }
}

/// Without tangents highlights have no direction: brushed metal looks as if it were not brushed, whatever else it is on.
#[test]
fn nothing_is_brushed_without_tangents() {
    let brushed = |anisotropic: f32| {
        let base_color = Vec3A::from_array([0.9; 3]);
        Principled { metallic: 1.0, roughness: 0.4, anisotropic, base_color, ..Principled::default() }
    };
    // One material on two squares: the one on the left has tangents, and the one on the right has not.
    let squares = |anisotropic: f32, x: f32| {
        let part = |mesh: Mesh, x: f32| (mesh, Material::from(brushed(anisotropic)), Affine3A::from_translation(Vec3::X * x));
        let bare = Mesh { uvs: Vec::new(), ..plane(2.0) };
        let look = camera([x, 1.5, 2.0], [x, 0.0, 0.0], 20.0, 24, 16);
        let mut loaded = scene(vec![part(tangents(plane(2.0)), -3.0), part(bare, 3.0)], common::sunny(), look);
        loaded.instances[1].material = 0;
        loaded
    };
    for bsdf in [Mode::Conserving, Mode::Published] {
        // Compiled for the same features, so that roundings do not differ.
        let skips = Skips { feature_sets: false, ..Skips::ALL };
        let settings = Settings { spp: 16, max_bounces: 1, bsdf, skips, ..Settings::default() };
        let picture = |scene: &RenderScene| render_with(scene, &settings).0;
        let [left, right] = [-3.0, 3.0].map(|x| {
            let made = [0.0, 0.9].map(|anisotropic| picture(&compile(&squares(anisotropic, x))));
            assert!(made[0].object_id.pixels.iter().all(|&id| id == if x < 0.0 { 1 } else { 2 }), "{x} fills the picture");
            furthest(&made[0], &made[1])
        });
        assert!(left > 0.01 && right < 1e-3 * left, "{bsdf:?}: {left} with tangents, {right} without");
        // Of a material that becomes anisotropic later, no square has tangents.
        for x in [-3.0, 3.0] {
            let mut compiled = compile(&squares(0.0, x));
            let before = picture(&compiled);
            compiled.set_surface(0, &brushed(0.9)).expect("a material");
            let apart = furthest(&before, &picture(&compiled));
            assert!(apart < 1e-3 * left, "{bsdf:?}, {x}: {apart}");
        }
    }
}

/// A normal map of bumps that lean by up to `degrees` from the surface, every texel its own way.
fn bumps(degrees: f32) -> Texture {
    let mut state = 7_u32;
    let mut random = || {
        state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    let texels = (0..64 * 64).map(|_| {
        let (lean, turn) = (degrees.to_radians() * random().sqrt(), std::f32::consts::TAU * random());
        let n = Vec3::new(lean.sin() * turn.cos(), lean.sin() * turn.sin(), lean.cos());
        let [x, y, z] = n.to_array().map(|v| ((0.5 * v + 0.5) * 255.0).round() as u8);
        [x, y, z, 255]
    });
    Texture::from_rgba8("bumps", [64, 64], texels.collect(), Encoding::Normal, [Wrap::Repeat; 2])
}

/// Whatever the shading normals of a white convex body are, under a white sky it is as bright as the sky.
#[test]
fn leaning_normals_keep_the_furnace_white() {
    // The sphere's own tangents: along u, which runs around +y.
    let with_tangents = |mesh: Mesh| {
        let around = |p: &Vec3| Vec3::new(-p.z, 0.0, p.x).normalize_or(Vec3::X).extend(1.0);
        Mesh { tangents: mesh.positions.iter().map(around).collect(), ..mesh }
    };
    let bodies: [(&str, Mesh, f32); 3] = [
        ("coarse smooth sphere", sphere(4, true), 0.0),
        ("bumpy sphere", with_tangents(sphere(12, true)), 60.0),
        ("bumpy plane", tangents(plane(3.0)), 60.0),
    ];
    for (body, mesh, lean) in bodies {
        for (kind, material) in [
            ("diffuse", diffuse([1.0; 3])),
            (
                "smooth metal",
                Material::from(Principled {
                    base_color: Vec3A::from_array([1.0; 3]),
                    metallic: 1.0,
                    roughness: 0.1,
                    ..Principled::default()
                }),
            ),
            (
                "rough metal",
                Material::from(Principled {
                    base_color: Vec3A::from_array([1.0; 3]),
                    metallic: 1.0,
                    roughness: 0.8,
                    ..Principled::default()
                }),
            ),
            (
                "coated",
                Material::from(Principled {
                    base_color: Vec3A::from_array([1.0; 3]),
                    roughness: 0.4,
                    specular: 1.0,
                    ..Principled::default()
                }),
            ),
        ] {
            let normal_texture = SLOT.filter(|_| lean > 0.0).map(|slot| (slot, 1.0));
            let material = Material { normal_texture, ..material.clone() };
            for (sky, environment, direct, spp) in [
                ("flat", flat(1.0), DirectLight::Mis, 256),
                ("sampled", nearly_flat(1.0), DirectLight::Mis, 256),
                ("sampled", nearly_flat(1.0), DirectLight::Scattering, 256),
            ] {
                let look = camera([0.5, 1.5, 3.0], [0.0; 3], 40.0, 20, 20);
                let mut loaded = scene(vec![(mesh.clone(), material.clone(), Affine3A::IDENTITY)], environment, look);
                loaded.textures.push(bumps(lean));
                let settings = Settings { spp, max_bounces: 64, direct, ..Settings::default() };
                let (frame, _) = render_with(&compile(&loaded), &settings);
                let variance = &frame.variance.as_ref().expect("rendered").pixels;
                let (mut sum, mut n, mut worst) = (0.0, 0.0, 0.0_f64);
                for (i, pixel) in beauty(&frame).iter().enumerate().filter(|(i, _)| frame.alpha.pixels[*i] == 1.0) {
                    let value = f64::from(pixel[1]);
                    sum += value;
                    n += 1.0;
                    let error = (value - 1.0).abs() - 5.0 * f64::from(variance[i][1]).sqrt();
                    worst = worst.max(error);
                }
                let average = sum / n;
                println!(
                    "{body}, {kind}, {sky} sky, {direct:?}: mean {average:.5}, worst pixel {worst:+.4} beyond 5 standard errors"
                );
                assert!(n > 100.0 && (average - 1.0).abs() < 5e-3 && worst < 5e-3);
            }
        }
    }
}
