//! OBJ and MTL features, one by one, in small files written here; and scenes around a single model.

mod common;

use common::anywhere;
use common::{asset, empty_scene, load_model, model_scene};
use glam::{Vec2, Vec3, Vec3A, Vec4};
use renderflow_frame::reach::Reach;
use renderflow_scenes::description::EnvironmentSource;
use renderflow_scenes::load::{self, ModelView};
use renderflow_scenes::loaded::AlphaMask;
use renderflow_scenes::mipmap::Texels;
use renderflow_scenes::{LoadedScene, Result, Scene};
use std::path::{Path, PathBuf};

struct Files(tempfile::TempDir);

impl Files {
    fn new(files: &[(&str, &str)]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        Self(folder)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn load(&self) -> Result<LoadedScene> {
        load::load(&model_scene(&self.path("model.obj"), None), &anywhere())
    }

    fn error(&self) -> String {
        self.load().expect_err("must be refused").to_string().replace(self.0.path().to_str().unwrap(), "FOLDER")
    }
}

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

fn obj(faces: &str) -> Files {
    Files::new(&[("model.obj", &format!("{SQUARE}{faces}"))])
}

#[test]
fn quads_and_relative_indices_become_triangles() {
    for faces in ["f 1 2 3 4", "f -4 -3 -2 -1", "f 1 2 3 \\\n 4", "f 1// 2// 3// 4//"] {
        let scene = obj(faces).load().unwrap();
        assert_eq!(scene.meshes[0].triangles, [[0, 1, 2], [0, 2, 3]], "{faces}");
        assert_eq!(scene.report.notes, [""; 0], "{faces}");
    }
}

/// An arrow whose second corner points inwards: a fan from the first corner would leave it.
#[test]
fn faces_that_are_not_convex_are_cut_inside() {
    let text = "v -2 0 0\nv 0 1 0\nv 2 0 0\nv 0 4 0\nv 9 9 9\nf 1 2 3 4\nf 1 3 5\n";
    let scene = Files::new(&[("model.obj", text)]).load().unwrap();
    let mesh = &scene.meshes[0];
    let twice = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
        (b - a).cross(c - a).z
    };
    let areas: Vec<f32> = mesh.triangles.iter().map(twice).collect();
    assert_eq!(areas.len(), 3, "{areas:?}");
    assert!(areas.iter().all(|area| *area > 0.0) && areas[0] + areas[1] == 12.0, "{areas:?}");
}

#[test]
fn texture_coordinates_run_down() {
    let scene = obj("vt 0 0\nvt 0.25 1 0\nvn 0 0 2\nf 1/1/1 2/2/1 3/1/1").load().unwrap();
    assert_eq!(scene.meshes[0].uvs[..2], [Vec2::new(0.0, 1.0), Vec2::new(0.25, 0.0)]);
    assert_eq!(scene.meshes[0].normals, [Vec3::Z; 3]);
}

#[test]
fn what_does_not_exist_costs_a_face_not_the_file() {
    let scene = obj("f 1 2 9\nf 1 2 3\nf 0 1 2\nl 1 2\np 1\nf 1 2\nf 1/7 3/7 4/7\n").load().unwrap();
    assert_eq!(scene.report.triangles.dropped(), 2);
    assert_eq!(scene.meshes[0].triangles.len(), 2);
    let expected = [
        "model.obj: line 5: the face names vertex \"9\", there are 4: the face is left out",
        "model.obj: 3 points and lines skipped",
        "model.obj: 1 faces whose texture coordinates or normals do not exist are shown without",
    ];
    let notes: Vec<String> =
        scene.report.notes.iter().map(|n| format!("model.obj{}", n.split("model.obj").nth(1).unwrap())).collect();
    assert_eq!(notes, expected);
}

#[test]
fn faces_with_and_without_normals_keep_what_they_have() {
    let scene = obj("vn 0 0 1\nf 1//1 2//1 3//1\nf 1 3 4\n").load().unwrap();
    let normals: Vec<usize> = scene.meshes.iter().map(|m| m.normals.len()).collect();
    assert_eq!(normals, [3, 0]);
}

#[test]
fn not_a_number_is_dropped_and_counted() {
    let scene = obj("v nan 0 0\nv inf 0 0\nv -1.#IND 0 0\nf 1 2 3\nf 1 2 5\nf 1 2 6\nf 1 2 7\n").load().unwrap();
    assert_eq!((scene.report.triangles.dropped(), scene.meshes[0].triangles.len()), (3, 1));
    if let Some(path) = asset("obj/edge/tinyobjloader/test-nan.obj") {
        assert!(load_model(&path).unwrap().report.triangles.dropped() > 0);
    }
}

#[test]
fn errors_name_the_line() {
    assert_eq!(
        obj("f 1 2 3\n\nf a b c\n").error(),
        "/objects/0 (model): FOLDER/model.obj line 7: \"a\" is not a corner of a face: 1, 1/2, 1//3 and 1/2/3 are (not an OBJ file?)"
    );
    assert!(obj("v 1 2\n").error().contains("model.obj line 5: v has 2 numbers, 3 are needed"));
    assert!(obj("v 1 two 3\n").error().contains("model.obj line 5: \"two\" is not a number"));
}

/// The refusal of a model without a triangle to render says why there is none, and where.
#[test]
fn what_becomes_of_the_triangles_is_said() {
    let refusal = |text: &str| {
        let files = Files::new(&[("model.obj", text)]);
        let path = files.path("model.obj");
        let error = load::describe_model(&path, None, &ModelView::default(), &Reach::of(&path)).unwrap_err().to_string();
        error.split_once("model.obj: ").map(|(_, reason)| reason.to_owned()).expect("names the file")
    };
    assert_eq!(
        refusal(&format!("{SQUARE}f 1 2 9\nf 1 2 3 -7\n")),
        "none of the model's 3 triangles can be rendered: 3 have a vertex that does not exist (line 5: the face names vertex \"9\", there are 4)"
    );
    assert_eq!(
        refusal("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 2 2 3\n"),
        "none of the model's 2 triangles can be rendered: 1 has a coordinate that is not finite (line 1: vertex 1 is (nan, 0, 0)), 1 has no area"
    );
    assert_eq!(
        refusal(&format!("{SQUARE}f 1 2 -9\n")),
        "the model's only triangle cannot be rendered: 1 has a vertex that does not exist (line 5: the face names vertex \"-9\", there are 4 before it)"
    );
    assert_eq!(refusal(SQUARE), "the model has no triangle to render");
    assert_eq!(refusal(&format!("{SQUARE}l 1 2\n")), "the model has no triangle to render (1 points and lines skipped)");
    // The first of them is noted where others are rendered.
    let loaded = obj("f 1 2 3\nf 1 2 9\nf 1 2 8\n").load().unwrap();
    let [note] = &loaded.report.notes[..] else { panic!("{:?}", loaded.report.notes) };
    assert!(note.ends_with("model.obj: line 6: the face names vertex \"9\", there are 4: the face is left out"), "{note}");
}

const PAINTED: &str = "mtllib paint.mtl\nusemtl red\nf 1 2 3\nusemtl shiny\nf 1 3 4\n";

fn painted(library: &str) -> Files {
    Files::new(&[("model.obj", &format!("{SQUARE}{PAINTED}")), ("paint.mtl", library)])
}

#[test]
fn materials_become_principled() {
    let scene = painted(
        "newmtl red\nKd 0.8 0.1 0.05\nNs 98\nillum 1\nKs 1 1 1\nnewmtl shiny\nKd 0.5\nPr 0.125\nPm 1\nKs 0.25 0.25 0.25\nd 0.5\nnewmtl unused\nmap_Kd gone.png\n",
    )
    .load()
    .unwrap();
    let red = &scene.materials[scene.instances[0].material];
    // alpha^2 = 2 / (98 + 2), roughness = alpha^(1/2).
    assert_eq!(
        (red.name.as_str(), red.surface.base_color.to_array(), red.surface.specular, red.surface.metallic),
        ("red", [0.8, 0.1, 0.05], 0.0, 0.0)
    );
    assert!((red.surface.roughness - 0.02_f32.powf(0.25)).abs() < 1e-6);
    let shiny = &scene.materials[scene.instances[1].material];
    assert_eq!((shiny.surface.base_color.to_array(), shiny.surface.roughness, shiny.surface.metallic), ([0.5; 3], 0.125, 1.0));
    assert!((shiny.surface.specular - 0.25).abs() < 1e-6);
    assert_eq!((red.opacity, shiny.opacity, scene.report.blended), (None, Some(0.5), 1));
}

/// The order of `usemtl` and `mtllib` is free, and where it matters which library defines a name, the last one before it does.
#[test]
fn libraries_may_be_named_after_their_materials() {
    let reds = |faces: &str| {
        let text = format!("{SQUARE}{faces}");
        let libraries = [("a.mtl", "newmtl red\nKd 0.25 0 0\n"), ("b.mtl", "newmtl red\nKd 0.5 0 0\nnewmtl blue\nKd 0 0 1\n")];
        let scene = Files::new(&[("model.obj", text.as_str()), libraries[0], libraries[1]]).load().unwrap();
        assert_eq!(scene.report.notes, [""; 0], "{faces}");
        let color = |i: usize| scene.materials[scene.instances[i].material].surface.base_color.to_array();
        (0..scene.instances.len()).map(color).collect::<Vec<[f32; 3]>>()
    };
    let (first, second, blue) = ([0.25, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, 1.0]);
    assert_eq!(reds("usemtl red\nf 1 2 3\nmtllib a.mtl\n"), [first]);
    assert_eq!(reds("usemtl\tred\nf 1 2 3\nmtllib\ta.mtl\n"), [first]);
    assert_eq!(reds("usemtl blue\nf 1 2 3\nusemtl red\nf 1 3 4\nmtllib \\\nb.mtl\n"), [blue, second]);
    assert_eq!(reds("mtllib a.mtl\nusemtl red\nf 1 2 3\nmtllib b.mtl\nusemtl red\nf 1 3 4\n"), [first, second]);
    assert_eq!(reds("mtllib a.mtl\nusemtl blue\nf 1 2 3\nmtllib b.mtl\n"), [blue]);
    // A library that is named again at once is the same one; where two take turns, the last one before a name defines it.
    assert_eq!(reds("mtllib a.mtl\nmtllib a.mtl\nusemtl red\nf 1 2 3\nmtllib a.mtl\nusemtl red\nf 1 3 4\n"), [first]);
    assert_eq!(reds("mtllib a.mtl\nmtllib b.mtl\nmtllib a.mtl\nusemtl red\nf 1 2 3\n"), [first]);
    let long = format!("# {}\nnewmtl red\n", " ".repeat(1 << 20));
    let turns = "mtllib a.mtl\nmtllib b.mtl\n".repeat(8);
    let files = Files::new(&[("model.obj", &format!("{SQUARE}{turns}f 1 2 3\n")), ("a.mtl", &long), ("b.mtl", &long)]);
    assert!(files.error().contains("is named too often"), "{}", files.error());
    // Errors still know their line.
    let files =
        Files::new(&[("model.obj", &format!("{SQUARE}usemtl red\nf 1 2 3\nmtllib a.mtl\nf a b c\n")), ("a.mtl", "newmtl red\n")]);
    assert!(files.error().contains("model.obj line 8: \"a\" is not a corner of a face"), "{}", files.error());
}

/// An image of one row of grey or coloured pixels.
fn png<const N: usize>(pixels: &[[u8; N]], color: image::ExtendedColorType) -> Vec<u8> {
    let mut out = vec![];
    let encoder = image::codecs::png::PngEncoder::new(&mut out);
    image::ImageEncoder::write_image(encoder, pixels.as_flattened(), pixels.len() as u32, 1, color).unwrap();
    out
}

fn texels(scene: &LoadedScene, slot: &Option<renderflow_scenes::TextureSlot>) -> Vec<[u8; 4]> {
    match &scene.textures[slot.as_ref().expect("a texture").texture].levels[0].texels {
        Texels::Bytes(texels) => texels.clone(),
        Texels::Words(_) => panic!("8 bits a channel"),
    }
}

#[test]
fn light_coats_cloth_and_stretch_of_the_pbr_extension() {
    let scene = painted(
        "newmtl red\nKe 2 3 4\nPc 0.5\nPcr 0.2\nPs 0.25\naniso 0.75\nanisor 0.1\nTr 0.5\nnewmtl shiny\nmap_Ke glow.png\nKe 0 0 0\nPs nan\nPc 7\n",
    );
    std::fs::write(scene.path("glow.png"), png(&[[9, 8, 7]], image::ExtendedColorType::Rgb8)).unwrap();
    let scene = scene.load().unwrap();
    let red = &scene.materials[scene.instances[0].material];
    assert_eq!(
        (red.emissive, red.surface.clearcoat, red.surface.sheen, red.surface.anisotropic),
        ([2.0, 3.0, 4.0], 0.5, 0.25, 0.75)
    );
    // Roughness 0.2 is a width of 0.04 = mix(0.1, 0.001, gloss).
    assert!((0.1 + (0.001 - 0.1) * red.surface.clearcoat_gloss - 0.04).abs() < 1e-6);
    assert!(red.double_sided && red.alpha_mask.is_none());
    assert_eq!((red.opacity, scene.report.blended), (Some(0.5), 1));
    assert!(scene.report.notes.iter().any(|n| n.contains("rotation of the anisotropy")), "{:?}", scene.report.notes);
    let shiny = &scene.materials[scene.instances[1].material];
    assert_eq!(
        (shiny.emissive, shiny.surface.sheen, shiny.surface.clearcoat, shiny.surface.clearcoat_gloss),
        ([1.0; 3], 0.0, 1.0, 1.0)
    );
    assert_eq!(texels(&scene, &shiny.emissive_texture), [[9, 8, 7, 255]]);
}

#[test]
fn glass_and_maps_that_are_not_read_are_told() {
    let scene = painted("newmtl red\nillum 7\nNi 1.5\ndisp waves.png\nnewmtl shiny\nillum 9\nd -halo 0.25\n").load().unwrap();
    let notes = &scene.report.notes;
    assert!(notes.iter().any(|n| n.ends_with("material \"red\": its glass is not read")), "{notes:?}");
    assert!(notes.iter().any(|n| n.contains("displacement, decal or reflection map")), "{notes:?}");
    assert_eq!(notes.len(), 2, "{notes:?}");
    assert_eq!(scene.materials[scene.instances[1].material].opacity, Some(0.25));
}

#[test]
fn opacity_maps_become_the_alpha_of_the_colour() {
    use image::ExtendedColorType::{L8, Rgb8, Rgba8};
    let files = painted("newmtl red\nmap_Kd paint.png\nmap_d holes.png\nnewmtl shiny\nKd 0.5 0.5 0.5\nmap_d leaf.png\n");
    std::fs::write(files.path("paint.png"), png(&[[1, 2, 3], [4, 5, 6]], Rgb8)).unwrap();
    std::fs::write(files.path("holes.png"), png(&[[0], [255]], L8)).unwrap();
    std::fs::write(files.path("leaf.png"), png(&[[255, 255, 255, 90], [0, 0, 0, 200], [7, 7, 7, 255]], Rgba8)).unwrap();
    let scene = files.load().unwrap();
    let [red, shiny] = [0, 1].map(|i| &scene.materials[scene.instances[i].material]);
    // What is not there has the colour of what is beside it.
    assert_eq!(texels(&scene, &red.base_color_texture), [[4, 5, 6, 0], [4, 5, 6, 255]]);
    assert_eq!(texels(&scene, &shiny.base_color_texture), [[255, 255, 255, 90], [255, 255, 255, 200], [255; 4]]);
    assert_eq!((red.surface.base_color.to_array(), shiny.surface.base_color.to_array()), ([1.0; 3], [0.5; 3]));
    let mask = Some(AlphaMask { cutoff: 0.5, factor: 1.0 });
    assert_eq!((red.alpha_mask, shiny.alpha_mask, scene.report.alpha_masked), (mask, mask, 2));
    assert_eq!((scene.report.blended, scene.report.notes.len()), (0, 0));
    // Of another size, or lying otherwise: noted, the colour stays.
    let files =
        painted("newmtl red\nmap_Kd paint.png\nmap_d -s 2 2 2 paint.png\nnewmtl shiny\nmap_Kd paint.png\nmap_d one.png\n");
    std::fs::write(files.path("paint.png"), png(&[[1, 2, 3], [4, 5, 6]], Rgb8)).unwrap();
    std::fs::write(files.path("one.png"), png(&[[0]], L8)).unwrap();
    let scene = files.load().unwrap();
    assert_eq!(scene.report.notes.iter().filter(|n| n.contains("opacity map is not read")).count(), 2);
    assert!(scene.materials.iter().all(|m| m.alpha_mask.is_none() && m.base_color_texture.is_some()));
}

#[test]
fn grey_maps_become_one_metallic_roughness_texture() {
    use image::ExtendedColorType::L8;
    let files =
        painted("newmtl red\nPr 0\nPm 0.5\nmap_Pr rough.png\nmap_Pm metal.png\nnewmtl shiny\nmap_Pm metal.png\nPr 0.25\n");
    std::fs::write(files.path("rough.png"), png(&[[10], [20]], L8)).unwrap();
    std::fs::write(files.path("metal.png"), png(&[[0], [255]], L8)).unwrap();
    let scene = files.load().unwrap();
    let [red, shiny] = [0, 1].map(|i| &scene.materials[scene.instances[i].material]);
    assert_eq!(texels(&scene, &red.metallic_roughness_texture), [[255, 10, 0, 255], [255, 20, 255, 255]]);
    assert_eq!(texels(&scene, &shiny.metallic_roughness_texture), [[255, 255, 0, 255], [255; 4]]);
    // A factor of zero, or none, beside a map means the map alone.
    assert_eq!(
        (red.surface.roughness, red.surface.metallic, shiny.surface.roughness, shiny.surface.metallic),
        (1.0, 0.5, 0.25, 1.0)
    );
    assert_eq!(scene.report.notes.len(), 0);
    std::fs::write(files.path("rough.png"), png(&[[10]], L8)).unwrap();
    let scene = files.load().unwrap();
    assert!(scene.report.notes[0].contains("pair of roughness and metallic maps"), "{:?}", scene.report.notes);
    assert_eq!(scene.materials[scene.instances[0].material].metallic_roughness_texture, None);
}

#[test]
fn a_missing_library_is_noted_and_a_missing_texture_is_an_error() {
    let scene = Files::new(&[("model.obj", &format!("{SQUARE}{PAINTED}"))]).load().unwrap();
    assert!(scene.instances.iter().all(|i| scene.materials[i.material].name == "default"));
    let notes = scene.report.notes.join("\n");
    assert!(notes.contains("the material library") && notes.contains("paint.mtl cannot be used"), "{notes}");
    assert!(notes.contains("no library defines the material \"shiny\""), "{notes}");
    let error = painted("newmtl red\nmap_Kd wood.png\n").error();
    assert!(
        error.starts_with("/objects/0 (model): material \"red\": cannot use texture FOLDER/wood.png: cannot read: "),
        "{error}"
    );
    let broken = painted("newmtl red\nKd 1 x 1\n").error();
    assert_eq!(broken, "/objects/0 (model): FOLDER/paint.mtl line 2: material parse error");
}

/// The bounding sphere of the model has radius 1, rests on the ground and lies inside the picture in every frame.
#[test]
fn a_single_model_is_scaled_placed_and_framed() {
    for name in ["gltf/pbr/Suzanne/Suzanne.gltf", "gltf/pbr/Avocado/Avocado.gltf", "obj/spot/spot_triangulated.obj"] {
        let Some(path) = asset(name) else { return };
        for resolution in [[96, 64], [64, 96]] {
            let view = ModelView { resolution, frames: 25, degrees_per_frame: 14.4, ..ModelView::default() };
            let scene = load::describe_model(&path, None, &view, &Reach::of(&path)).unwrap();
            assert!(Path::new(scene_file(&scene)).is_absolute());
            // Geometry is enough here: in grey, no texture is decoded.
            let mut grey = scene.clone();
            grey.objects[0].material = Some("ground".into());
            let loaded = load::load(&grey, &anywhere()).unwrap();
            let model = loaded.instances.iter().filter(|i| i.object_id == 1);
            let points: Vec<Vec3A> = model
                .flat_map(|i| {
                    let mesh = &loaded.meshes[i.mesh];
                    mesh.triangles.iter().flatten().map(|&v| i.transform(0).transform_point3a(mesh.positions[v as usize].into()))
                })
                .collect();
            let (low, high) = points.iter().fold((Vec3A::INFINITY, Vec3A::NEG_INFINITY), |(l, h), &p| (l.min(p), h.max(p)));
            let center = 0.5 * (low + high);
            let radius = points.iter().map(|p| p.distance(center)).fold(0.0, f32::max);
            assert!((radius - 1.0).abs() < 1e-3 && low.y.abs() < 1e-3, "{name}: radius {radius}, lowest {low}");
            for camera in &loaded.cameras {
                for &p in &points {
                    let (pixel, _) = camera.project(p).unwrap();
                    let inside =
                        pixel.x > 0.0 && pixel.y > 0.0 && pixel.x < resolution[0] as f32 && pixel.y < resolution[1] as f32;
                    assert!(inside, "{name}: {p} at {pixel}");
                }
            }
        }
    }
    let error = load::describe_model(Path::new("gone.glb"), None, &ModelView::default(), &anywhere()).unwrap_err().to_string();
    assert!(error.starts_with("gone.glb: cannot read: "), "{error}");
    let empty = Files::new(&[("model.obj", "v 0 0 0\n")]);
    let error = load::describe_model(&empty.path("model.obj"), None, &ModelView::default(), &anywhere()).unwrap_err().to_string();
    assert!(error.ends_with("model.obj: the model has no triangle to render"), "{error}");
}

fn scene_file(scene: &Scene) -> &str {
    match &scene.objects[0].geometry {
        renderflow_scenes::description::Geometry::File(path) => path,
        other => panic!("{other:?}"),
    }
}

#[test]
fn environments_load_from_files_names_and_parameters() {
    let mut scene = empty_scene();
    (scene.environment.rotation, scene.environment.intensity) = (-90.0, 2.0);
    let light = load::load(&scene, &anywhere()).unwrap().environment;
    assert!((light.rotation - 1.5 * std::f32::consts::PI).abs() < 1e-6 && light.intensity == 2.0);
    assert_eq!(light.radiance(Vec3A::X), [2.0; 3]);
    // A name and its parameters are the same map.
    let (name, sky) = &renderflow_scenes::sky::library()[0];
    scene.environment.source = EnvironmentSource::Builtin(name.to_string());
    let named = load::load(&scene, &anywhere()).unwrap().environment;
    scene.environment.source = EnvironmentSource::Sky(sky.clone());
    assert!(named == load::load(&scene, &anywhere()).unwrap().environment && named.map.width > 1);
    scene.environment.source = EnvironmentSource::File("gone.hdr".into());
    let error = load::load(&scene, &Reach::folder("somewhere")).unwrap_err().to_string();
    assert!(error.starts_with("/environment/source: somewhere/gone.hdr: cannot "), "{error}");
    if let Some(path) = asset("hdri/studio_small_03_1k.hdr") {
        scene.environment.source = EnvironmentSource::File(path.file_name().unwrap().to_str().unwrap().into());
        let loaded = load::load(&scene, &Reach::of(&path)).unwrap();
        assert_eq!((loaded.environment.map.width, loaded.environment.map.height), (1024, 512));
    }
}

#[test]
fn normal_maps_need_texture_coordinates() {
    let Some(path) = asset("gltf/pbr/TwoSidedPlane/TwoSidedPlane_Normal.png") else { return };
    let Some(model) = asset("obj/sphere.obj") else { return };
    let mut scene = model_scene(&model, Some(common::grey("bumpy")));
    scene.materials[0].normal_texture = Some(path.to_str().unwrap().into());
    let loaded = load::load(&scene, &anywhere()).unwrap();
    let has_uvs = !loaded.meshes[0].uvs.is_empty();
    assert_eq!(loaded.meshes[0].tangents.is_empty(), !has_uvs);
    assert_eq!(loaded.report.notes.iter().any(|n| n.contains("is not applied")), !has_uvs);
    assert!(load_model(&model).unwrap().meshes[0].tangents.is_empty(), "nobody wants tangents without a normal map");
}

/// Ground planes under models that bring a floor would fight with it for the pixels.
#[test]
fn a_model_with_a_floor_of_its_own_gets_no_ground() {
    let up = "v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nf 1 4 3 2\n";
    let down = "v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nf 1 2 3 4\n";
    let cube = |low: f32, high: f32, half: f32, from: usize, inwards: bool| {
        let mut text = String::new();
        for i in 0..8 {
            let pick = |bit: usize, a: f32, b: f32| if i & bit == 0 { a } else { b };
            text += &format!("v {} {} {}\n", pick(1, -half, half), pick(2, low, high), pick(4, -half, half));
        }
        for [a, b, c, d] in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
            let [a, b, c, d] = [a, b, c, d].map(|i: usize| i + from);
            text += &if inwards { format!("f {d} {c} {b} {a}\n") } else { format!("f {a} {b} {c} {d}\n") };
        }
        text
    };
    // A floor and walls without a front; with a ceiling its floor has something above it.
    let room = |ceiling: bool| {
        let mut text = cube(0.0, 2.0, 1.0, 1, true);
        let keep: Vec<usize> = if ceiling { vec![0, 1, 2, 3, 4] } else { vec![0, 1, 2, 4] };
        let (faces, corners): (Vec<&str>, Vec<&str>) = text.lines().partition(|line| line.starts_with('f'));
        let faces: Vec<&str> = keep.into_iter().map(|i| faces[i]).collect();
        text = [corners, faces].concat().join("\n");
        text + "\n"
    };
    let ball = std::fs::read_to_string(asset("obj/spot/spot_triangulated.obj").unwrap_or_default()).unwrap_or_default();
    let grounds = [
        ("a square that faces up", up.into(), false),
        ("a square that faces down", down.into(), false),
        ("a floor under a box", up.to_owned() + &cube(0.0, 1.0, 0.4, 5, false), false),
        ("a room", room(false), false),
        ("a room with a ceiling", room(true), false),
        ("a box", cube(0.0, 2.0, 1.0, 1, false), true),
        ("a box inside out", cube(0.0, 2.0, 1.0, 1, true), true),
        ("a slab", cube(0.0, 0.1, 1.0, 1, false), true),
        ("a small sheet under a box", up.replace("1", "0.3").replace("f 0.3 4", "f 1 4") + &cube(0.0, 1.0, 1.0, 5, false), true),
        ("a square on its edge", "v -1 0 0\nv 1 0 0\nv 1 2 0\nv -1 2 0\nf 1 2 3 4\n".into(), true),
        ("a table", cube(1.0, 1.1, 1.0, 1, false) + &cube(0.0, 1.0, 0.1, 9, false), true),
        ("a cow", ball, true),
    ];
    for (name, text, wanted) in grounds {
        if text.is_empty() {
            continue;
        }
        let files = Files::new(&[("model.obj", &text)]);
        for view in [ModelView::default(), ModelView { ground: false, ..ModelView::default() }] {
            let scene = load::describe_model(&files.path("model.obj"), None, &view, &anywhere()).unwrap();
            let found = scene.objects.iter().any(|object| object.name == "ground");
            assert_eq!(found, wanted && view.ground, "{name}: {text}");
            // It lies a little below a sheet that would fight with it.
            let ground = scene.objects.iter().find(|object| object.name == "ground");
            let height = if name.contains("small sheet") { -1e-3 } else { 0.0 };
            assert!(ground.is_none_or(|ground| ground.transform.translation == [0.0, height, 0.0]), "{name}");
            scene.validate().unwrap();
        }
    }
    let Some(path) = asset("obj/edge/tobj/cornell_box.obj") else { return };
    assert_eq!(load::describe_model(&path, None, &ModelView::default(), &anywhere()).unwrap().objects.len(), 1);
}

/// Colours behind the positions, as MeshLab and others write them, encoded as sRGB: 188 of 255 is .503 linear (IEC 61966-2-1).
#[test]
fn colors_of_vertices_are_read_where_the_first_has_one() {
    let text = "v 0 0 0 1 0 0.737\nv 1 0 0 0 0.737 0\nv 1 1 0\nf 1 2 3\n";
    let scene = Files::new(&[("model.obj", text)]).load().unwrap();
    let expected = [[1.0, 0.0, 0.5029, 1.0], [0.0, 0.5029, 0.0, 1.0], [1.0; 4]].map(Vec4::from);
    let colors = &scene.meshes[0].colors;
    assert!(colors.len() == 3 && colors.iter().zip(expected).all(|(a, b)| a.distance(b) < 1e-3), "{colors:?}");
    assert_eq!(scene.materials[scene.instances[0].material].surface.base_color, Vec3A::ONE);
    assert_eq!(scene.report.notes, [""; 0]);
    let later = "v 0 0 0\nv 1 0 0 0 0.737 0\nv 1 1 0 1 1 1 1\nf 1 2 3\n";
    let scene = Files::new(&[("model.obj", later)]).load().unwrap();
    assert!(scene.meshes[0].colors.is_empty());
    assert!(scene.report.notes[0].ends_with(": 2 vertices with colours that are not read"), "{:?}", scene.report.notes);
}
