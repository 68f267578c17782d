//! PLY files: all forms of one body against its corners, what is noted, and hostile files.

mod common;

use common::{anywhere, load_model, model_scene};
use glam::{Vec2, Vec3, Vec3A, Vec4};
use renderflow_scenes::{LoadedScene, load};
use std::path::PathBuf;

/// A file named `model.ply`; the folder lives as long as the first value.
fn file(bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.ply");
    std::fs::write(&path, bytes).unwrap();
    (folder, path)
}

fn loaded(bytes: &[u8]) -> Result<LoadedScene, String> {
    let (_folder, path) = file(bytes);
    load::load(&model_scene(&path, None), &anywhere()).map_err(|e| e.to_string())
}

fn error(bytes: &[u8]) -> String {
    let (folder, path) = file(bytes);
    let error = load::load(&model_scene(&path, None), &anywhere()).map(|_| ()).expect_err("must be refused").to_string();
    error.replace(folder.path().to_str().unwrap(), "FOLDER")
}

/// A header of a square with a triangle on it: five vertices of all attributes, a quad, a triangle, and elements and properties
/// that nobody asked for.
fn header(form: &str) -> Vec<u8> {
    format!(
        "ply\nformat {form} 1.0\ncomment made by hand\nelement vertex 5\nproperty double x\nproperty float y\nproperty float32 z\n\
         property float nx\nproperty float ny\nproperty float nz\nproperty float confidence\nproperty float s\nproperty float t\n\
         element junk 2\nproperty list ushort short numbers\nproperty uchar one\n\
         element face 2\nproperty uchar flags\nproperty list uchar int vertex_indices\nend_header\n"
    )
    .into_bytes()
}

const CORNERS: [[f32; 3]; 5] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.5, 2.0, 0.25]];
const FACES: [&[i32]; 2] = [&[0, 1, 2, 3], &[3, 2, 4]];

/// The body in binary; `put` appends a number of so many bytes, lowest first, in the order of the file.
fn binary(form: &str, big: bool) -> Vec<u8> {
    let mut bytes = header(form);
    let mut put = |number: &[u8]| {
        let mut number = number.to_vec();
        if big {
            number.reverse();
        }
        bytes.extend(number);
    };
    for [x, y, z] in CORNERS {
        put(&f64::from(x).to_le_bytes());
        for number in [y, z, 0.0, 0.0, 1.0, 0.5, x, y] {
            put(&number.to_le_bytes());
        }
    }
    for count in [0_u16, 3] {
        put(&count.to_le_bytes());
        (0..count).for_each(|_| put(&(-7_i16).to_le_bytes()));
        put(&[1]);
    }
    for face in FACES {
        put(&[9]);
        put(&[face.len() as u8]);
        face.iter().for_each(|index| put(&index.to_le_bytes()));
    }
    bytes
}

fn ascii() -> Vec<u8> {
    let mut text = String::from_utf8(header("ascii")).unwrap();
    for [x, y, z] in CORNERS {
        text += &format!("{x} {y} {z} 0 0 1 0.5 {x} {y}\n");
    }
    text += "0 1\n3 -7 -7 -7 1\n9 4 0 1 2 3\n9 3 3 2 4\n";
    text.into_bytes()
}

#[test]
fn every_form_holds_the_same_mesh() {
    let windows = String::from_utf8(ascii()).unwrap().replace('\n', "\r\n").into_bytes();
    let files = [ascii(), windows, binary("binary_little_endian", false), binary("binary_big_endian", true)];
    for bytes in files {
        let scene = loaded(&bytes).unwrap();
        let mesh = &scene.meshes[0];
        assert_eq!(mesh.positions, CORNERS.map(Vec3::from));
        assert_eq!(mesh.normals, [Vec3::Z; 5]);
        // v runs down here.
        assert_eq!(mesh.uvs, CORNERS.map(|[x, y, _]| Vec2::new(x, 1.0 - y)));
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [3, 2, 4]]);
        let notes: Vec<&str> = scene.report.notes.iter().map(|note| note.split_once(": ").unwrap().1).collect();
        let expected = [
            "properties of vertices that are not read: confidence",
            "2 elements \"junk\" are not read",
            "properties of faces that are not read: flags",
        ];
        assert_eq!(notes, expected);
    }
    // By its content, whatever the name says.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.obj");
    std::fs::write(&path, ascii()).unwrap();
    assert_eq!(load_model(&path).unwrap().meshes[0].triangles.len(), 3);
}

const TRIANGLE: &str = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
const FACE: &str = "element face 1\nproperty list uchar int vertex_index\nend_header\n";

#[test]
fn one_colour_is_the_base_colour_and_several_are_those_of_the_vertices() {
    let colored = |kind: &str, colors: [&str; 3]| {
        let channels = ["red", "green", "blue"].map(|name| format!("property {kind} {name}\n")).concat();
        let text = format!(
            "ply\nformat ascii 1.0\n{TRIANGLE}{channels}{FACE}0 0 0 {}\n1 0 0 {}\n0 1 0 {}\n3 0 1 2\n",
            colors[0], colors[1], colors[2]
        );
        let scene = loaded(text.as_bytes()).unwrap();
        let color = scene.materials[scene.instances[0].material].surface.base_color;
        assert_eq!(scene.report.notes, [""; 0]);
        (color, scene.meshes[0].colors.clone())
    };
    let (color, colors) = colored("uchar", ["188 0 255"; 3]);
    // sRGB 188 is 0.503 linear (IEC 61966-2-1).
    assert!(color.distance(Vec3A::new(0.5029, 0.0, 1.0)) < 1e-3 && colors.is_empty(), "{color}");
    // 188 of 255 in 16 bits; wider types hold bytes.
    let (color, _) = colored("ushort", ["48316 0 65535"; 3]);
    assert!(color.distance(Vec3A::new(0.5029, 0.0, 1.0)) < 1e-3, "{color}");
    let (color, _) = colored("int", ["188 0 255"; 3]);
    assert!(color.distance(Vec3A::new(0.5029, 0.0, 1.0)) < 1e-3, "{color}");
    let (color, _) = colored("float", ["0.25 0.5 1"; 3]);
    assert_eq!(color, Vec3A::new(0.25, 0.5, 1.0));
    let (color, colors) = colored("uchar", ["188 0 255", "188 0 255", "0 188 0"]);
    assert_eq!(color, Vec3A::ONE);
    assert!(colors[1].distance(Vec4::new(0.5029, 0.0, 1.0, 1.0)) < 1e-3, "{colors:?}");
    assert!(colors[2].distance(Vec4::new(0.0, 0.5029, 0.0, 1.0)) < 1e-3, "{colors:?}");
}

/// An opacity is linear in every type, and counts like that of glTF's colours of vertices.
#[test]
fn alpha_is_the_opacity_of_the_surface() {
    let read = |properties: &str, colors: [&str; 3]| {
        let [a, b, c] = colors;
        let text = format!("ply\nformat ascii 1.0\n{TRIANGLE}{properties}{FACE}0 0 0 {a}\n1 0 0 {b}\n0 1 0 {c}\n3 0 1 2\n");
        let scene = loaded(text.as_bytes()).unwrap();
        let opacities: Vec<f32> = scene.meshes[0].colors.iter().map(|color| color.w).collect();
        (scene.materials[scene.instances[0].material].opacity, scene.report.blended, opacities, scene.report.notes)
    };
    let kinds = |color: &str, alpha: &str| {
        let property = |kind: &str, name: &str| format!("property {kind} {name}\n");
        ["red", "green", "blue"].map(|name| property(color, name)).concat() + &property(alpha, "alpha")
    };
    for (kind, fifth, full) in [("uchar", "51", "255"), ("ushort", "13107", "65535"), ("float", "0.2", "1")] {
        // The same everywhere: an opacity of the material.
        let line = format!("1 1 1 {fifth}");
        assert_eq!(read(&kinds("uchar", kind), [&line; 3]), (Some(0.2), 1, vec![], vec![]), "{kind}");
        // Of the vertices, and none where they cover everything.
        let [opaque, clear] = [full, "0"].map(|alpha| format!("9 9 9 {alpha}"));
        let mixed = read(&kinds("uchar", kind), [&line, &opaque, &clear]);
        assert_eq!(mixed, (Some(1.0), 1, vec![0.2, 1.0, 0.0], vec![]), "{kind}");
        assert_eq!(read(&kinds("float", kind), [&opaque; 3]), (None, 0, vec![], vec![]), "{kind}");
    }
    // Zeros alone are taken for an opacity that nobody has set.
    let (opacity, blended, opacities, notes) = read(&kinds("uchar", "uchar"), ["1 1 1 0", "9 9 9 0", "1 1 1 0"]);
    assert_eq!((opacity, blended, opacities), (None, 0, vec![1.0; 3]));
    assert!(notes.len() == 1 && notes[0].ends_with("the opacity of all vertices is 0; it is not used"), "{notes:?}");
    // Without a colour it is not read.
    let (opacity, _, opacities, notes) = read("property uchar alpha\n", ["51"; 3]);
    assert_eq!((opacity, opacities), (None, vec![]));
    assert!(notes.len() == 1 && notes[0].ends_with("properties of vertices that are not read: alpha"), "{notes:?}");
}

/// An arrow whose second corner points inwards: a fan from the first corner would leave it.
#[test]
fn faces_that_are_not_convex_are_cut_inside() {
    let vertices = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\n";
    let text = format!("ply\nformat ascii 1.0\n{vertices}{FACE}-2 0 0\n0 1 0\n2 0 0\n0 4 0\n4 0 1 2 3\n");
    let scene = loaded(text.as_bytes()).unwrap();
    let mesh = &scene.meshes[0];
    let areas = mesh.triangles.iter().map(|t| {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
        (b - a).cross(c - a).z
    });
    let areas: Vec<f32> = areas.collect();
    assert!(areas.iter().all(|area| *area > 0.0) && areas.iter().sum::<f32>() == 12.0, "{areas:?}");
}

#[test]
fn strips_and_missing_vertices() {
    let strips = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                  element tristrips 1\nproperty list int int vertex_indices\nend_header\n\
                  0 0 0\n1 0 0\n0 1 0\n1 1 0\n8 0 1 2 3 -1 1 3 2\n";
    let scene = loaded(strips.as_bytes()).unwrap();
    assert_eq!(scene.meshes[0].triangles, [[0, 1, 2], [1, 3, 2]]);
    assert_eq!(scene.report.triangles.duplicate, 1);
    let holes = format!(
        "ply\nformat ascii 1.0\n{TRIANGLE}{}0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 0 1 -2\n3 0 1 3\n1 0\n",
        FACE.replace("face 1", "face 4")
    );
    let scene = loaded(holes.as_bytes()).unwrap();
    assert_eq!((scene.meshes[0].triangles.len(), scene.report.triangles.out_of_range), (1, 2));
    assert!(scene.report.notes[0].ends_with("1 faces of fewer than three vertices skipped"), "{:?}", scene.report.notes);
}

#[test]
fn what_is_no_ply_is_refused_with_its_place() {
    let head = |text: &str| error(format!("ply\n{text}").as_bytes());
    for (said, expected) in [
        (head(""), "line 2: the header does not end"),
        (head("format ascii 2.0\n"), "line 2: \"format ascii 2.0\" is not known"),
        (head("format binary 1.0\n"), "line 2: \"binary\" is no format of PLY"),
        (head("property float x\n"), "line 2: the property belongs to no element"),
        (head("element vertex -3\n"), "line 2: \"-3\" is no number of elements"),
        (head("element vertex 3\nproperty half x\n"), "line 3: \"half\" is no type of a number"),
        (head("element face 1\nproperty list float int vertex_indices\n"), "line 3: \"float\" is no type of a number"),
        (head("element vertex 0\nend_header\n"), "line 3: the header has no format"),
        (head(&format!("format ascii 1.0\n{TRIANGLE}{FACE}0 0 0\n1 zero 0\n")), "vertex 1: \"zero\" is not a number"),
        (head(&format!("format ascii 1.0\n{TRIANGLE}{FACE}0 0 0\n1 0 0\n0 1 0\n3 0 1\n")), "face 0: the file ends"),
        (head(&format!("format ascii 1.0\n{TRIANGLE}{FACE}0 0 0\n1 0 0\n0 1 0\n-1\n")), "face 0: -1 is no length of a list"),
        (head("format ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n"), "vertex 0: the vertices have no y"),
        (
            head("format ascii 1.0\nelement face 0\nproperty list uchar int v\nend_header\n"),
            "face 0: the faces have no vertex_indices",
        ),
        (head("format ascii 1.0\nend_header\n"), "the file has no vertices"),
    ] {
        assert!(said.contains("FOLDER/model.ply") && said.ends_with(expected), "{said}, not {expected}");
    }
}

/// A header may claim what it likes.
#[test]
fn counts_of_a_header_take_no_memory() {
    let claim = |form: &str, elements: &str, data: &str| {
        error(format!("ply\nformat {form} 1.0\n{elements}end_header\n{data}").as_bytes())
    };
    let vertex = |count: &str| format!("element vertex {count}\nproperty float x\nproperty float y\nproperty float z\n");
    for form in ["ascii", "binary_little_endian"] {
        let said = claim(form, &vertex("1000000000000000000"), "0 0 0 0 0 0 ");
        assert!(said.ends_with("vertex 0: 1000000000000000000 vertices are too many"), "{said}");
        assert!(claim(form, &vertex("4000000000"), "0 0 0 0 0 0 ").ends_with("the file ends"));
        let faces = "element face 1000000000000000000\nproperty list uchar uchar vertex_indices\n";
        assert!(claim(form, &format!("{}{faces}", vertex("0")), "").ends_with("face 0: the file ends"));
        let junk = "element junk 1000000000000000000\nproperty float a\n";
        assert!(claim(form, &format!("{junk}{}", vertex("0")), "").ends_with("junk 0: the file ends"));
        // Elements without properties take nothing at all.
        let nothing = format!("element nothing 1000000000000000000\n{}", vertex("0"));
        assert!(loaded(format!("ply\nformat {form} 1.0\n{nothing}end_header\n").as_bytes()).is_ok());
    }
    let long = "element face 1\nproperty list uint uchar vertex_indices\n";
    let said = claim("binary_little_endian", &format!("{}{long}", vertex("0")), "\u{7f}\u{7f}\u{7f}\u{7f}0123");
    assert!(said.ends_with("face 0: the file ends"), "{said}");
    let peak = peak_alloc::PeakAlloc.peak_usage_as_mb();
    assert!(peak < 64.0, "{peak} MB");
}

#[global_allocator]
static ALLOCATOR: peak_alloc::PeakAlloc = peak_alloc::PeakAlloc;

/// A cloud of points is a scene without triangles; a view of it is refused with the reason.
#[test]
fn clouds_of_points_are_refused() {
    let (_folder, path) = file(format!("ply\nformat ascii 1.0\n{TRIANGLE}end_header\n0 0 0\n1 0 0\n0 1 0\n").as_bytes());
    let view = load::ModelView::default();
    let error = load::describe_model(&path, None, &view, &anywhere()).unwrap_err().to_string();
    assert!(error.ends_with("the model has no triangle to render (the file has no faces: points are not rendered)"), "{error}");
}
