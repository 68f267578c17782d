//! Faces of more than three corners.

use glam::{DVec3, Vec3};

/// Most corners of a face that is not cut as a fan: the work may grow with their square.
const MOST_CORNERS: usize = 1 << 12;
/// Overlap of a fan's triangles that may come from rounding, as a share of the square of the longest diagonal from its corner.
const ROUNDING: f64 = 1e-6;

/// Adds the triangles of a face to `triangles`. They are a fan from the first corner where that fits. If the face is not convex,
/// a fan may overlap itself or leave the face, and it is cut by its ears instead. Numbers without a vertex are not checked here.
pub(super) fn cut(face: &[u32], positions: &[Vec3], triangles: &mut Vec<[u32; 3]>) {
    if face.len() > 3
        && face.len() <= MOST_CORNERS
        && let Some(cut) = concave(face, positions)
    {
        triangles.extend(cut);
        return;
    }
    let Some((first, rest)) = face.split_first() else { return };
    triangles.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
}

/// The triangles of a face that a fan does not fit; `None` where it does, and where nothing fits.
fn concave(face: &[u32], positions: &[Vec3]) -> Option<Vec<[u32; 3]>> {
    let place = |vertex: &u32| positions.get(*vertex as usize).map(|place| place.as_dvec3());
    let corners: Vec<DVec3> = face.iter().map(place).collect::<Option<_>>()?;
    // Counted from the first corner.
    let spokes: Vec<DVec3> = corners.iter().map(|corner| corner - corners[0]).collect();
    let fan = || spokes[1..].windows(2).map(|pair| pair[0].cross(pair[1]));
    let normal: DVec3 = fan().sum::<DVec3>().try_normalize()?;
    let longest = spokes.iter().map(|spoke| spoke.length_squared()).fold(0.0, f64::max);
    if fan().all(|area| area.dot(normal) >= -ROUNDING * longest) {
        return None;
    }
    // Seen against the normal, corners go round counter-clockwise.
    let x = normal.any_orthonormal_vector();
    let y = normal.cross(x);
    let seen: Vec<[f64; 2]> = spokes.iter().map(|spoke| [spoke.dot(x), spoke.dot(y)]).collect();
    let mut indices: Vec<u32> = Vec::new();
    earcut::Earcut::new().earcut(seen.iter().copied(), &[], &mut indices);
    let area = |[a, b, c]: [usize; 3]| (spokes[b] - spokes[a]).cross(spokes[c] - spokes[a]).dot(normal);
    let cut = indices.chunks_exact(3).map(|t| {
        let [a, b, c] = [t[0], t[1], t[2]].map(|i| i as usize);
        let [b, c] = if area([a, b, c]) < 0.0 { [c, b] } else { [b, c] };
        [a, b, c].map(|corner| face[corner])
    });
    Some(cut.collect()).filter(|cut: &Vec<_>| !cut.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut_of(corners: &[[f32; 3]]) -> Vec<[u32; 3]> {
        let face: Vec<u32> = (0..corners.len() as u32).collect();
        let positions: Vec<Vec3> = corners.iter().copied().map(Vec3::from).collect();
        let mut triangles = vec![];
        cut(&face, &positions, &mut triangles);
        triangles
    }

    #[test]
    fn faces_that_a_fan_fits_are_fans() {
        let bent = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.2], [1.0, 1.0, 0.0], [0.0, 1.0, 0.2]];
        let hexagon = [[1.0, 0.0, 5.0], [0.5, 0.9, 5.0], [-0.5, 0.9, 5.0], [-1.0, 0.0, 5.0], [-0.5, -0.9, 5.0], [0.5, -0.9, 5.0]];
        // Not convex at the corner that the fan starts from.
        let arrow = [[0.0, 1.0, 0.0], [-2.0, 0.0, 0.0], [0.0, 4.0, 0.0], [2.0, 0.0, 0.0]];
        let point = [[1.0; 3]; 4];
        for corners in [&bent[..], &hexagon, &arrow, &point, &bent[..3], &bent[..2], &bent[..1], &[]] {
            let fan: Vec<[u32; 3]> = (2..corners.len() as u32).map(|last| [0, last - 1, last]).collect();
            assert_eq!(cut_of(corners), fan, "{corners:?}");
        }
        let mut unknown = vec![];
        cut(&[0, 1, 2, 9], &bent.map(Vec3::from), &mut unknown);
        assert_eq!(unknown, [[0, 1, 2], [0, 2, 9]]);
    }

    #[test]
    fn faces_that_are_not_convex_keep_their_area_and_their_side() {
        // The letter U, and an arrow that is not convex at its second corner, from every first corner and from either side.
        let u = [[-2, -2], [2, -2], [2, 2], [1, 2], [1, -1], [-1, -1], [-1, 2], [-2, 2]];
        let arrow = [[-2, 0], [0, 1], [2, 0], [0, 4]];
        for (outline, area) in [(&u[..], 10.0), (&arrow[..], 6.0)] {
            for start in 0..outline.len() {
                for sign in [1.0, -1.0] {
                    let mut corners: Vec<Vec3> = outline
                        .iter()
                        .map(|[x, y]| Vec3::new(*x as f32, 3.0, -(*y as f32)) * Vec3::new(1.0, 1.0, sign))
                        .collect();
                    corners.rotate_left(start);
                    let triangles = cut_of(&corners.iter().map(Vec3::to_array).collect::<Vec<_>>());
                    let areas = triangles.iter().map(|t| {
                        let [a, b, c] = t.map(|i| corners[i as usize]);
                        0.5 * (b - a).cross(c - a).y
                    });
                    let areas: Vec<f32> = areas.collect();
                    assert!(areas.iter().all(|area| area * sign >= 0.0), "{areas:?}");
                    assert!((areas.iter().sum::<f32>() * sign - area).abs() < 1e-4, "{areas:?}");
                }
            }
        }
    }
}
