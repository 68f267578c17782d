use super::*;
use glam::Quat;

fn make(transforms: &[Affine3A], sharing: Sharing) -> Geometry {
    let positions =
        vec![Vec3::new(-1.0, -1.0, 0.2), Vec3::new(1.0, -1.0, 0.0), Vec3::new(0.0, 1.0, -0.1), Vec3::new(0.0, 0.0, 1.0)];
    let triangles = vec![[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]];
    let mesh = Mesh { positions, triangles, ..Mesh::default() };
    let instances =
        transforms.iter().map(|&t| Instance { name: String::new(), mesh: 0, material: 0, object_id: 1, transforms: vec![t] });
    Geometry::new(vec![mesh], instances.collect(), Wanted { uv_sets: 0, tangents: vec![false], colors: false }, sharing)
}

/// Filters hear of the side that the placed corners have, whether trees are shared or not, mirrored or not.
#[test]
fn filters_hear_of_the_side_seen_in_the_world() {
    let transforms: Vec<Affine3A> = (0..30u8)
        .map(|i| {
            let f = f32::from(i);
            let mirror = Vec3::new(if i % 2 == 0 { 0.3 } else { -0.3 }, 0.2, 0.4);
            let turn = Quat::from_euler(glam::EulerRot::XYZ, f, 0.7 * f, 0.3);
            Affine3A::from_scale_rotation_translation(mirror, turn, Vec3::new(f.sin(), (2.0 * f).cos(), (0.7 * f).sin()))
        })
        .collect();
    let mut scratch = Scratch::default();
    let mut sides = [0; 2];
    for sharing in [Sharing::Never, Sharing::Always] {
        let geometry = make(&transforms, sharing);
        for i in 0..2000u16 {
            let f = f32::from(i);
            let origin = Vec3A::new((1.1 * f).sin(), (1.7 * f).cos(), (2.3 * f).sin()) * 3.0;
            let ray = Ray::new(origin, (Vec3A::new((0.3 * f).cos(), (0.9 * f).sin(), 0.0) - origin).normalize());
            let seen = |c: &Candidate| {
                let [a, b, d] = geometry.surface(&c.hit).corners;
                let facing = (b - a).cross(d - a).normalize_or_zero().dot(ray.direction);
                // Edge-on either answer is right.
                facing.abs() < 1e-4 || (facing < 0.0) == c.front
            };
            assert!(!geometry.occluded_where(&ray, &mut scratch, |c| !seen(c)));
            for front in [false, true] {
                let hit = geometry.closest_where(&ray, &mut scratch, |c| c.front == front);
                assert_eq!(hit.is_some(), geometry.occluded_where(&ray, &mut scratch, |c| c.front == front));
                if let Some(hit) = hit {
                    sides[usize::from(front)] += 1;
                    let n = geometry.surface(&hit).n.dot(ray.direction);
                    assert!(n.abs() < 1e-4 || (n < 0.0) == front);
                }
            }
            let all = geometry.closest_where(&ray, &mut scratch, |_| true);
            assert_eq!(all, geometry.closest(&ray, &mut scratch));
            assert_eq!(all.is_some(), geometry.occluded(&ray, &mut scratch));
        }
    }
    assert!(sides.iter().all(|&n| n > 500), "{sides:?}");
}

#[test]
fn normals_of_any_size_are_unit() {
    for (a, b) in [
        (Vec3A::X * 1e-18, Vec3A::Y * 1e-12),
        (Vec3A::X * 1e12, Vec3A::Y * 1e12),
        (Vec3A::X, Vec3A::X),
        (Vec3A::X, Vec3A::ZERO),
        (Vec3A::ZERO, Vec3A::ZERO),
        (Vec3A::X * 1e-40, Vec3A::Y),
    ] {
        let (n, _) = normal(a, b);
        assert!((n.length() - 1.0).abs() < 1e-6, "{a} {b} {n}");
    }
    assert!(normal(Vec3A::X * 1e-18, Vec3A::Y * 1e-12).0.distance(Vec3A::Z) < 1e-6);
}
