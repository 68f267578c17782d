//! Light groups partition the sphere, in equal parts of each hemisphere, and turn with the map.

use glam::{Vec2, Vec3A};
use renderflow_frame::{Environment, image::Rgb};
use renderflow_renderer::light::LightGroups;
use renderflow_renderer::verify::chi_square::Random;

/// The group by its definition: sectors of azimuth from the map coordinates.
fn expected(environment: &Environment, directions: usize, wi: Vec3A) -> usize {
    let u = f64::from(environment.uv(wi).x);
    let upper = directions.div_ceil(2);
    if wi.y >= 0.0 || directions == 1 {
        ((u * upper as f64) as usize).min(upper - 1)
    } else {
        upper + ((u * (directions - upper) as f64) as usize).min(directions - upper - 1)
    }
}

fn turned(rotation: f32) -> Environment {
    Environment { map: Rgb::filled(4, 2, [1.0; 3]), rotation, intensity: 1.0 }
}

#[test]
fn groups_follow_their_definition() {
    let mut random = Random::new(1);
    for rotation in [0.0, 1.3, -2.0, 7.0] {
        let environment = turned(rotation);
        for count in 1..=LightGroups::MAXIMUM {
            let plain = LightGroups::new(count, rotation).expect("in range");
            for (groups, directions) in [(plain, count), (plain.with_emitters(), (count - 1).max(1))] {
                let mut differing = 0;
                for _ in 0..5000 {
                    let wi = random.direction().as_vec3a();
                    let group = groups.group(wi);
                    assert!(group < directions);
                    differing += usize::from(group != expected(&environment, directions, wi));
                }
                // Only where rounding puts a direction on the other side of a border.
                assert!(differing <= 1, "{differing} differ, {count} groups turned by {rotation}");
            }
        }
    }
}

#[test]
fn borders_belong_to_one_group() {
    for count in 1..=LightGroups::MAXIMUM {
        let groups = LightGroups::new(count, 0.0).expect("in range");
        assert_eq!(groups.group(Vec3A::Y), groups.group(Vec3A::Y), "the pole itself");
        assert_eq!(groups.group(Vec3A::NEG_Z), 0, "azimuth 0 on the horizon");
        for wi in [Vec3A::ZERO, Vec3A::NAN, Vec3A::NEG_Y, Vec3A::X, Vec3A::NEG_X, Vec3A::Z] {
            assert!(groups.group(wi) < count);
        }
    }
    let octants = LightGroups::new(8, 0.0).expect("in range");
    let quarter = |u: f32, v: f32| octants.group(turned(0.0).direction(Vec2::new(u, v)));
    let found: Vec<usize> = [0.3, 0.7].iter().flat_map(|&v| [0.1, 0.3, 0.6, 0.9].map(|u| quarter(u, v))).collect();
    assert_eq!(found, [0, 1, 2, 3, 4, 5, 6, 7]);
    let halves = LightGroups::new(2, 0.0).expect("in range");
    assert_eq!((halves.group(Vec3A::Y), halves.group(Vec3A::NEG_Y)), (0, 1));
}

#[test]
fn emitters_have_the_last_group() {
    for count in 1..=LightGroups::MAXIMUM {
        let groups = LightGroups::new(count, 0.0).expect("in range").with_emitters();
        assert_eq!(groups.emitters(), count - 1);
        let mut random = Random::new(2);
        let largest = (0..1000).map(|_| groups.group(random.direction().as_vec3a())).max();
        assert_eq!(largest, Some(count.saturating_sub(2)));
    }
}

#[test]
fn wrong_counts_and_rotations_are_refused() {
    for (count, rotation) in [(0, 0.0), (9, 0.0), (2, f32::NAN), (2, f32::INFINITY)] {
        assert!(LightGroups::new(count, rotation).is_err());
    }
}
