//! The rules by which triangles are left out, kept and counted.

mod common;

use common::gltf::{FLOAT, File, bytes, document};
use renderflow_scenes::TriangleReport;
use serde_json::json;

/// Loads triangles over `positions` and returns what was counted and what is left.
fn triangles(positions: &[[f32; 3]], indices: &[[u32; 3]]) -> (TriangleReport, Vec<[u32; 3]>) {
    let order: Vec<u8> = indices.as_flattened().iter().flat_map(|i| i.to_le_bytes()).collect();
    let mut file = document(&[
        (FLOAT, "VEC3", positions.len(), false, bytes(positions.as_flattened())),
        (5125, "SCALAR", 3 * indices.len(), false, order),
    ]);
    file["meshes"][0]["primitives"][0]["indices"] = json!(1);
    let scene = File::new(&file).load().unwrap();
    assert!(scene.meshes[0].positions.iter().all(|p| p.is_finite()));
    (scene.report.triangles, scene.meshes[0].triangles.clone())
}

const CORNERS: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]];

#[test]
fn every_cause_is_counted_for_itself() {
    let mut positions = CORNERS.to_vec();
    positions.extend([[f32::NAN, 0.0, 0.0], [0.0, f32::INFINITY, 0.0], [0.5, 0.0, 0.0]]);
    let (report, left) = triangles(
        &positions,
        &[
            [0, 1, 2],
            // No such vertex, even beside one that is not a number.
            [0, 1, 7],
            [4, 1, u32::MAX - 1],
            // Not a number, infinite; a corner twice does not hide it.
            [0, 1, 4],
            [5, 1, 2],
            [4, 4, 4],
            // A corner twice, three in a line.
            [1, 1, 2],
            [3, 3, 3],
            [0, 6, 1],
            // The first again, from each corner.
            [0, 1, 2],
            [1, 2, 0],
            [2, 0, 1],
            [1, 3, 2],
        ],
    );
    assert_eq!(report, TriangleReport { out_of_range: 2, not_finite: 3, no_area: 3, duplicate: 3, needles: 0 });
    assert_eq!((report.dropped(), left), (11, vec![[0, 1, 2], [1, 3, 2]]));
}

/// A sheet with two faces, as exporters write it, keeps both; vertices of the same place are one, whatever sign their zeros have.
#[test]
fn duplicates_are_of_the_same_places_and_the_same_winding() {
    let mut positions = CORNERS.to_vec();
    positions.extend([[-0.0, 0.0, -0.0], [1.0, -0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, f32::MIN_POSITIVE]]);
    let (report, left) = triangles(&positions, &[[0, 1, 2], [0, 2, 1], [5, 6, 4], [6, 5, 4], [0, 1, 7]]);
    assert_eq!((report.duplicate, report.dropped()), (2, 2));
    assert_eq!(left, [[0, 1, 2], [0, 2, 1], [0, 1, 7]]);
}

/// Many triangles, some again elsewhere in the list: as many go as were added, and the first ones stay in their order.
#[test]
fn duplicates_in_a_big_mesh_are_all_found() {
    let n = 120_u32;
    let positions: Vec<[f32; 3]> = (0..n * n).map(|i| [(i % n) as f32, (i / n) as f32, (i * i % 97) as f32 * 0.1]).collect();
    let quads = (0..n * (n - 1)).filter(|i| i % n < n - 1);
    let grid: Vec<[u32; 3]> = quads.flat_map(|i| [[i, i + 1, i + n], [i + 1, i + n + 1, i + n]]).collect();
    let mut list = grid.clone();
    let added = grid.iter().enumerate().filter(|(i, _)| i % 7 == 3).map(|(i, t)| match i % 3 {
        0 => [t[0], t[1], t[2]],
        1 => [t[1], t[2], t[0]],
        _ => [t[2], t[0], t[1]],
    });
    list.extend(added);
    let (report, left) = triangles(&positions, &list);
    assert_eq!((report.duplicate, report.dropped()), (list.len() - grid.len(), list.len() - grid.len()));
    assert_eq!(left, grid);
}

#[test]
fn needles_are_kept_and_counted() {
    // Longest edge 1, height 1e-7, 1e-5; and the same needle at other sizes, where its area is far below single precision.
    for size in [1e-15, 1.0, 1e10_f32] {
        let positions =
            [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 1e-7, 0.0], [0.5, 0.0, 1e-5]].map(|p: [f32; 3]| p.map(|v| v * size));
        let (report, left) = triangles(&positions, &[[0, 1, 2], [0, 1, 3], [1, 2, 0]]);
        assert_eq!(report, TriangleReport { needles: 1, duplicate: 1, ..Default::default() }, "{size}");
        assert_eq!(left.len(), 2);
    }
}

/// Whether three points lie on a line is decided by the points' own digits: by the integer that is twice the area.
#[test]
fn areas_are_judged_exactly() {
    let base = 12_582_912_i64;
    let mut kept = 0;
    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1), (2, 2), (3, 5), (-1, -1), (7, -7)] {
        // Coordinates of 24 bits: every integer is a single-precision number.
        let points = [[0, 0], [base, base], [base / 2 + dx, base / 2 + dy]];
        let area = points[1][0] * points[2][1] - points[1][1] * points[2][0];
        let positions = points.map(|[x, y]| [x as f32, y as f32, 0.0]);
        let (report, left) = triangles(&positions, &[[0, 1, 2]]);
        assert_eq!(left.len(), usize::from(area != 0), "{dx} {dy}");
        assert_eq!(report.no_area, usize::from(area == 0));
        kept += left.len();
    }
    assert_eq!(kept, 4);
}

/// Normals whose squares are too small or too large for single precision keep their direction; those without one get that of the
/// triangles.
#[test]
fn normals_of_any_length_become_unit() {
    let normals = [[1e-21, 1e-21, 0.0], [3e38, 0.0, 3e38], [0.0, 1e-45, 0.0], [0.0; 3]];
    let mut file = document(&[
        (FLOAT, "VEC3", 4, false, bytes(CORNERS.as_flattened())),
        (FLOAT, "VEC3", 4, false, bytes(normals.as_flattened())),
    ]);
    file["meshes"][0]["primitives"][0] = json!({ "mode": 5, "attributes": { "POSITION": 0, "NORMAL": 1 } });
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let scene = File::new(&file).load().unwrap();
    for (got, expected) in
        scene.meshes[0].normals.iter().zip([[half, half, 0.0], [half, 0.0, half], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    {
        assert!(got.distance(expected.into()) < 1e-6, "{got} for {expected:?}");
    }
}
