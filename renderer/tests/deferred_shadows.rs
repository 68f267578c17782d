//! Shadow maps with known occluders.

use glam::{Vec2, Vec3A};
use renderflow_frame::image::Image;
use renderflow_renderer::deferred::{ShadowMap, axes};

const SIZE: usize = 512;
/// Metres each map covers, about the origin.
const EXTENT: f32 = 8.0;

/// A map filled by `z(world point on the plane through the origin) -> distance towards the light at which something stands`.
fn map(light: Vec3A, hit: impl Fn(Vec3A, Vec3A) -> Option<f32>) -> ShadowMap {
    let [right, down, away] = axes(light);
    let texel = EXTENT / SIZE as f32;
    let at = |i: usize| -0.5 * EXTENT + (i as f32 + 0.5) * texel;
    let depth = Image::from_fn(SIZE, SIZE, |x, y| {
        let origin = right * at(x) + down * at(y) - away * 50.0;
        hit(origin, away).map_or(f32::INFINITY, |t| t - 50.0)
    });
    ShadowMap::new(light, [-0.5 * EXTENT; 2], EXTENT, depth)
}

/// Distance along a ray to the ground y = 0, or before it to a half-plane x < 0 at `height`.
fn roof_and_ground(height: f32) -> impl Fn(Vec3A, Vec3A) -> Option<f32> {
    move |o, d| {
        let roof = (height - o.y) / d.y;
        Some(if (o + d * roof).x < 0.0 { roof } else { -o.y / d.y })
    }
}

/// Mean over the turns of the pattern, as its filter takes it.
fn mean(map: &ShadowMap, p: Vec3A, radius: f32) -> f32 {
    (0..16).map(|k| map.visibility(p, Vec3A::Y, radius, (k as f32 + 0.5) / 16.0)).sum::<f32>() / 16.0
}

#[test]
fn the_shadow_of_an_edge_is_in_its_place_and_as_wide_as_its_penumbra() {
    for (light, height, radius) in
        [(Vec3A::Y, 1.0, 0.15_f32), (Vec3A::Y, 1.0, 0.3), (Vec3A::new(0.5, 1.0, 0.2).normalize(), 0.8, 0.1)]
    {
        let map = map(light, roof_and_ground(height));
        // Where the light's middle grazes the edge, and half the width of the penumbra about it.
        let across = (light.x * light.x + light.y * light.y).sqrt() / (light.y * light.y);
        let (edge, half) = (-height * light.x / light.y, height * radius.tan() * across);
        assert_eq!(mean(&map, Vec3A::new(edge + 1.3 * half, 0.0, 0.1), radius), 1.0);
        assert_eq!(mean(&map, Vec3A::new(edge - 1.5 * half, 0.0, 0.1), radius), 0.0);
        let middle = mean(&map, Vec3A::new(edge, 0.0, 0.1), radius);
        assert!((middle - 0.5).abs() < 0.1, "{middle} under the edge");
        // The share of a disc beyond a chord at half its radius is 0.196.
        let (less, more) = (
            mean(&map, Vec3A::new(edge - 0.5 * half, 0.0, 0.1), radius),
            mean(&map, Vec3A::new(edge + 0.5 * half, 0.0, 0.1), radius),
        );
        assert!((less - 0.196).abs() < 0.12 && (more - 0.804).abs() < 0.12, "{less} {more} for radius {radius}, height {height}");
    }
}

#[test]
fn a_lit_plane_has_no_acne_however_grazing_the_light() {
    for degrees in [3.0_f32, 10.0, 30.0, 60.0, 90.0] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let light = Vec3A::new(cos * 0.8, sin, cos * 0.6).normalize();
        let map = map(light, |o, d| Some(-o.y / d.y));
        for radius in [0.0, 0.005, 0.1] {
            for k in 0..2000 {
                let p = Vec3A::new((k as f32 * 0.618).fract() * 3.0 - 1.5, 0.0, (k as f32 * 0.7548).fract() * 3.0 - 1.5);
                if map.covers(p, 80.0) {
                    let seen = map.visibility(p, Vec3A::Y, radius, (k % 16) as f32 / 16.0);
                    assert_eq!(seen, 1.0, "at {p}, light at {degrees} degrees, radius {radius}");
                }
            }
        }
    }
}

#[test]
fn contact_shadows_start_at_the_contact() {
    // A box from x = -1 to 0 as high as 0.5, under a light from the left.
    let light = Vec3A::new(-1.0, 1.0, 0.0).normalize();
    let map = map(light, |o, d| {
        let (low, high) = (Vec3A::new(-1.0, -1.0, -9.0), Vec3A::new(0.0, 0.5, 9.0));
        let (a, b) = ((low - o) / d, (high - o) / d);
        let (near, far) = (Vec2::new(a.min(b).x, a.min(b).y), Vec2::new(a.max(b).x, a.max(b).y));
        let ground = -o.y / d.y;
        Some(if near.max_element() < far.min_element() { near.max_element().min(ground) } else { ground })
    });
    for x in [0.05, 0.2, 0.4] {
        assert!(mean(&map, Vec3A::new(x, 0.0, 0.0), 0.01) < 0.05, "light at {x} behind the box");
    }
    assert_eq!(mean(&map, Vec3A::new(0.56, 0.0, 0.0), 0.01), 1.0);
}

#[test]
fn maps_without_content_hold_nothing_back() {
    let empty = ShadowMap::new(Vec3A::Y, [0.0; 2], 1.0, Image::filled(0, 0, 0.0));
    let open = map(Vec3A::Y, |_, _| None);
    for map in [empty, open] {
        for p in [Vec3A::ZERO, Vec3A::splat(1e30), Vec3A::splat(f32::NAN)] {
            assert_eq!(map.visibility(p, Vec3A::Y, 0.1, 0.3), 1.0);
            assert!(map.lit(p, Vec3A::Y, [0.0; 2]));
        }
    }
}
