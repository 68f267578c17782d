//! Named families of environments: valid, finite, distinct, closed around the eye, and as bright as the paper says where that is
//! known.

use rayon::prelude::*;
use renderflow_frame::color::luminance;
use renderflow_frame::hdr;
use renderflow_frame::image::Rgb;
use renderflow_scenes::seed::Seed;
use renderflow_scenes::sky::{self, ENVIRONMENTS, GROUPS, Sky};
use std::collections::{BTreeMap, HashSet};
use std::f64::consts::{PI, TAU};

fn draw(name: &str, k: u64) -> Sky {
    sky::random_of(name, &mut Seed::root(2026).child(name, k).rng()).expect("a known family")
}

fn solid_angle(map: &Rgb, y: usize) -> f64 {
    let (top, bottom) = (PI * y as f64 / map.height as f64, PI * (y + 1) as f64 / map.height as f64);
    TAU / map.width as f64 * (top.cos() - bottom.cos())
}

/// Luminance integrated over the sphere.
fn flux(map: &Rgb) -> f64 {
    let row = |y: usize| (0..map.width).map(|x| f64::from(luminance(*map.at(x, y)))).sum::<f64>() * solid_angle(map, y);
    (0..map.height).map(row).sum()
}

/// Mean of the squared luminance over the square of its mean.
fn concentration(map: &Rgb) -> f64 {
    let row = |y: usize| (0..map.width).map(|x| f64::from(luminance(*map.at(x, y))).powi(2)).sum::<f64>() * solid_angle(map, y);
    (0..map.height).map(row).sum::<f64>() * 4.0 * PI / flux(map).powi(2)
}

/// Mean step of the logarithm between the columns beside u = 0/1, or the largest one between any two others. A seam is a step in
/// every row; a sun is one in a few, and counts little.
fn roughness(map: &Rgb, seam: bool) -> f64 {
    let (w, h) = (map.width, map.height);
    let value = |x: usize, y: usize| f64::from(luminance(*map.at(x % w, y))).max(1e-6).ln();
    let columns: Vec<usize> = if seam { vec![w - 1] } else { (0..w - 1).collect() };
    columns
        .iter()
        .map(|&x| (0..h).map(|y| (value(x, y) - value(x + 1, y)).abs().min(0.3)).sum::<f64>() / h as f64)
        .fold(0.0, f64::max)
}

#[test]
fn names_groups_and_recipes_fit_together() {
    assert!(ENVIRONMENTS.len() >= 40);
    assert_eq!(ENVIRONMENTS.iter().collect::<HashSet<_>>().len(), ENVIRONMENTS.len(), "every name once");
    let mut sizes: BTreeMap<&str, usize> = BTreeMap::new();
    for name in ENVIRONMENTS {
        assert!(GROUPS.contains(&sky::group(name)), "{name}");
        *sizes.entry(sky::group(name)).or_default() += 1;
    }
    assert!(GROUPS.iter().all(|group| sizes.get(group).is_some_and(|&n| n >= 3)), "{sizes:?}");
    assert!(sky::random_of("no_such_place", &mut Seed::root(0).rng()).is_none());
    assert_eq!(sky::group("no_such_place"), "");
}

#[test]
fn every_family_draws_valid_distinct_closed_maps() {
    draws(3);
}

#[test]
#[ignore = "all the maps: a minute"]
fn every_family_draws_16_valid_distinct_closed_maps() {
    draws(16);
}

/// 16 skies of each family are valid, and the maps of the first `rendered` are as they should be.
fn draws(rendered: usize) {
    let maps: Vec<(&str, Vec<blake3::Hash>)> = ENVIRONMENTS
        .par_iter()
        .map(|&name| {
            let skies: Vec<Sky> = (0..16).map(|k| draw(name, k)).collect();
            for (k, sky) in skies.iter().enumerate() {
                assert_eq!(sky.validate(), [], "{name} {k}: {sky:?}");
            }
            let hashes = skies.iter().take(rendered).enumerate().map(|(k, sky)| {
                let json = serde_json::to_string(sky).expect("JSON");
                assert_eq!(serde_json::from_str::<Sky>(&json).expect("reads back"), *sky, "{name} {k}");
                let map = sky::render(sky, 64, 32);
                assert!(map.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0), "{name} {k}");
                let mean = flux(&map) / (4.0 * PI);
                assert!((0.015..6.0).contains(&mean), "{name} {k}: mean luminance {mean}");
                // All light in one texel of this size would be 2,600 or more.
                assert!((0.999..6e4).contains(&concentration(&map)), "{name} {k}: concentration {}", concentration(&map));
                let (seam, elsewhere) = (roughness(&map, true), roughness(&map, false));
                assert!(seam <= 1.3 * elsewhere + 0.02, "{name} {k}: a step of {seam} at the seam, {elsewhere} elsewhere");
                for y in [0, 31] {
                    let row: Vec<f64> = (0..64).map(|x| f64::from(luminance(*map.at(x, y))).max(1e-3).ln()).collect();
                    let step = (0..64).map(|x| (row[x] - row[(x + 1) % 64]).abs()).fold(0.0, f64::max);
                    let across = (0..32).map(|x| (row[x] - row[x + 32]).abs()).fold(0.0, f64::max);
                    // A sharp edge may cross the pole, but the texels round it are neighbours: no ring of spokes.
                    let wild = (0..64).filter(|&x| (row[x] - row[(x + 1) % 64]).abs() > 0.5).count();
                    assert!(wild <= 32, "{name} {k}: {wild} steps up to {step} round the pole, {across} across it");
                }
                blake3::hash(&hdr::encode(&map))
            });
            (name, hashes.collect())
        })
        .collect();
    let all: HashSet<blake3::Hash> = maps.iter().flat_map(|(_, hashes)| hashes).copied().collect();
    assert_eq!(all.len(), rendered * ENVIRONMENTS.len(), "two maps are equal");
}

#[test]
fn light_of_the_families_does_not_depend_on_the_size_of_the_map() {
    sizes(5);
}

#[test]
#[ignore = "every family: half a minute"]
fn light_of_every_family_does_not_depend_on_the_size_of_the_map() {
    sizes(1);
}

fn sizes(step: usize) {
    let faults: Vec<String> = ENVIRONMENTS
        .par_iter()
        .enumerate()
        .step_by(step)
        .flat_map_iter(|(index, name)| {
            let sky = draw(name, 100 + index as u64 % 3);
            let reference = flux(&sky::render(&sky, 512, 256));
            [100, 256].into_iter().filter_map(move |width| {
                let ratio = flux(&sky::render(&sky, width, width / 2)) / reference;
                ((ratio - 1.0).abs() >= 0.01).then(|| format!("{name} at {width}: {ratio} of the light"))
            })
        })
        .collect();
    assert_eq!(faults, [""; 0]);
}

/// The sun of a sky that has one.
fn sun(sky: &Sky) -> Option<&sky::Sun> {
    match sky {
        Sky::Daylight { sun, .. } | Sky::Cloudy { sun, .. } | Sky::Sunset { sun, .. } => Some(sun),
        Sky::Scenery(scenery) => match &scenery.air {
            sky::Air::Clear { sun, .. } => Some(sun),
            _ => None,
        },
        _ => None,
    }
}

#[test]
fn half_of_the_sun_families_have_low_hard_suns() {
    let (mut low, mut all) = (0, 0);
    for name in ENVIRONMENTS.iter().filter(|name| sky::group(name) == "outdoor_sun") {
        let suns: Vec<Sky> = (0..64).map(|k| draw(name, k)).collect();
        let suns: Vec<&sky::Sun> = suns.iter().filter_map(sun).collect();
        assert_eq!(suns.len(), 64, "{name}");
        low += suns.iter().filter(|sun| sun.elevation < 31.5 && sun.radius < 0.75).count();
        all += suns.len();
    }
    let share = low as f64 / all as f64;
    assert!((0.4..0.65).contains(&share), "share of low and hard suns {share}");
}

#[test]
fn a_catalogue_has_distinct_maps() {
    distinct(0..100);
}

#[test]
#[ignore = "the whole catalogue"]
fn a_catalogue_of_512_has_distinct_maps() {
    distinct(0..512);
}

fn distinct(entries: std::ops::Range<u64>) {
    let maps: HashSet<blake3::Hash> = entries
        .clone()
        .into_par_iter()
        .map(|k| {
            let name = ENVIRONMENTS[k as usize % ENVIRONMENTS.len()];
            let sky = sky::random_of(name, &mut Seed::root(1).child("environment", k).rng()).expect("known");
            blake3::hash(&hdr::encode(&sky::render(&sky, 32, 16)))
        })
        .collect();
    assert_eq!(maps.len() as u64, entries.end - entries.start);
}

fn irradiance(map: &Rgb) -> f64 {
    let row = |y: usize| {
        let cos = (PI * (y as f64 + 0.5) / map.height as f64).cos().max(0.0);
        (0..map.width).map(|x| f64::from(luminance(*map.at(x, y)))).sum::<f64>() * solid_angle(map, y) * cos
    };
    (0..map.height).map(row).sum()
}

fn bare(air: serde_json::Value, extra: serde_json::Value) -> Sky {
    let mut json =
        serde_json::json!({ "family": "scenery", "air": air, "ground": { "kind": "plain", "color": [0.0, 0.0, 0.0] } });
    for (key, value) in extra.as_object().expect("fields") {
        json[key] = value.clone();
    }
    serde_json::from_value(json).expect("a scenery")
}

#[test]
fn black_silhouettes_take_from_a_uniform_dome_what_they_cover() {
    let dome = serde_json::json!({ "kind": "gradient", "zenith": [1.0, 1.0, 1.0], "horizon": [1.0, 1.0, 1.0], "sharpness": 1.0 });
    let open = irradiance(&sky::render(&bare(dome.clone(), serde_json::json!({})), 512, 256));
    assert!((open / PI - 1.0).abs() < 1e-3, "a uniform dome gives pi, not {open}");
    for kind in ["hills", "ridges", "dunes", "trees", "skyline", "roofs", "cliffs"] {
        let horizon = serde_json::json!({ "horizon": { "kind": kind, "height": 35.0, "color": [0.0, 0.0, 0.0], "seed": 5 } });
        let map = sky::render(&bare(dome.clone(), horizon), 512, 256);
        // Column by column the rim is read off the map: sky of radiance 1 above elevation h gives cos^2 h / 2 a radian.
        let mut expected = 0.0;
        let mut highest = 0.0f64;
        for x in 0..512 {
            let dark: f64 = (0..128).map(|y| 1.0 - f64::from(luminance(*map.at(x, y))).min(1.0)).sum();
            let h = dark * PI / 256.0;
            highest = highest.max(h.to_degrees());
            expected += TAU / 512.0 * 0.5 * h.cos().powi(2);
        }
        let found = irradiance(&map);
        assert!((found / expected - 1.0).abs() < 0.01, "{kind}: {found}, expected {expected}");
        assert!(found < 0.99 * PI && (12.0..36.0).contains(&highest), "{kind}: {found} of pi, as high as {highest} degrees");
    }
}

#[test]
fn a_hill_hides_the_sun() {
    let flux_at = |elevation: f32, height: f32| {
        let air = |gain: f32| {
            serde_json::json!({ "kind": "clear", "turbidity": 2.5, "luminance": 0.4,
                "sun": { "elevation": elevation, "azimuth": 77.0, "gain": gain } })
        };
        let horizon =
            serde_json::json!({ "horizon": { "kind": "cliffs", "height": height, "color": [0.0, 0.0, 0.0], "seed": 3 } });
        let map = |gain: f32| flux(&sky::render(&bare(air(gain), horizon.clone()), 256, 128));
        map(1.0) - map(0.0)
    };
    let (clear, hidden) = (flux_at(40.0, 5.0), flux_at(2.0, 60.0));
    assert!(clear > 0.5 && hidden.abs() < 1e-9, "{clear} over a low hill, {hidden} behind a high one");
}

#[test]
fn suns_keep_their_colour() {
    let channel = |tint: [f32; 3], k: usize| {
        let air = |gain: f32| {
            serde_json::json!({ "kind": "clear", "turbidity": 2.5, "luminance": 0.4, "sun_tint": tint,
                "sun": { "elevation": 50.0, "azimuth": 10.0, "gain": gain } })
        };
        let map = |gain: f32| sky::render(&bare(air(gain), serde_json::json!({})), 256, 128);
        let sum = |map: &Rgb| {
            (0..128).map(|y| (0..256).map(|x| f64::from(map.at(x, y)[k])).sum::<f64>() * solid_angle(map, y)).sum::<f64>()
        };
        sum(&map(1.0)) - sum(&map(0.0))
    };
    for (k, tint) in [0.5f32, 1.0, 2.0].into_iter().enumerate() {
        let ratio = channel([0.5, 1.0, 2.0], k) / channel([1.0; 3], k);
        assert!((ratio / f64::from(tint) - 1.0).abs() < 0.01, "channel {k}: {ratio}");
    }
}

#[test]
fn a_ring_light_overhead_gives_the_difference_of_two_discs() {
    // A disc of radius r and radiance L at height h over a parallel receiver: pi L r^2 / (r^2 + h^2) (Siegel and Howell).
    let (outer, inner, h, radiance) = (0.8f64, 0.6f64, 1.5f64, 20.0f64);
    let disc = |r: f64| PI * radiance * r * r / (r * r + h * h);
    let expected = disc(outer) - disc(inner * outer);
    let sky: Sky =
        serde_json::from_value(serde_json::json!({ "family": "studio", "fill": [0.0, 0.0, 0.0], "floor": [0.0, 0.0, 0.0],
        "lamps": [{ "position": [0.0, h, 0.0], "size": [2.0 * outer, 2.0 * outer], "shape": "ellipse", "color": [1.0, 1.0, 1.0],
            "power": radiance, "mask": { "kind": "ring", "inner": inner } }] }))
        .expect("a studio");
    assert_eq!(sky.validate(), []);
    let found = irradiance(&sky::render(&sky, 256, 128));
    assert!((found / expected - 1.0).abs() < 0.02, "{found}, expected {expected}");
}

#[test]
fn lamps_and_stars_bring_the_asked_luminance() {
    let dark = serde_json::json!({ "kind": "gradient", "zenith": [0.0, 0.0, 0.0], "horizon": [0.0, 0.0, 0.0], "sharpness": 1.0 });
    for layout in ["scattered", "street", "strings", "signs", "fire"] {
        let group = serde_json::json!({ "lights": [{ "layout": layout, "palette": "mixed", "count": 17, "radius": 1.5, "elevation": 20.0,
            "luminance": 0.3, "seed": 4 }] });
        let mean = flux(&sky::render(&bare(dark.clone(), group), 256, 128)) / (4.0 * PI);
        assert!((mean / 0.3 - 1.0).abs() < 0.01, "{layout}: {mean}");
    }
    let stars = serde_json::json!({ "stars": { "count": 4000, "luminance": 0.2, "seed": 9 } });
    let mean = flux(&sky::render(&bare(dark, stars), 128, 64)) / (4.0 * PI);
    assert!((mean / 0.1 - 1.0).abs() < 0.1, "half of the stars stand above the horizon: {mean}");
}

#[test]
fn a_room_of_white_walls_is_a_furnace() {
    // Nearly all light stays: with reflectance r everywhere and openings of share s of the faces, black to what hits them, the
    // mean radiance of the walls is that of the openings times s r / (1 - r) (each face treated alike), here close to the
    // openings' own.
    let room = |reflectance: f32| -> Sky {
        serde_json::from_value(serde_json::json!({ "family": "room", "size": [4.0, 4.0, 4.0], "eye_height": 2.0, "walls": [reflectance, reflectance, reflectance],
            "floor": [reflectance, reflectance, reflectance], "ceiling": [reflectance, reflectance, reflectance],
            "openings": [{ "wall": "ceiling", "offset": [0.0, 0.0], "size": [1.0, 1.0], "radiance": [10.0, 10.0, 10.0] }] }))
        .expect("a room")
    };
    for reflectance in [0.2f32, 0.5, 0.8] {
        let map = sky::render(&room(reflectance), 256, 128);
        let opening = irradiance(&map) - irradiance(&sky::render(&room(0.0), 256, 128));
        let rho = f64::from(reflectance);
        // Power: 1 m2 sends pi 10; it bounces 1 / (1 - rho) times over 96 m2.
        let wall = 10.0 * rho / (1.0 - rho) / 96.0;
        // The upper half sees four half walls and the ceiling; the mean wall radiance is the scale of what they add.
        let ratio = opening / (PI * wall);
        assert!((0.6..1.25).contains(&ratio), "reflectance {reflectance}: {ratio} of the estimate");
    }
}

#[test]
fn parts_out_of_range_are_named() {
    let air = serde_json::json!({ "kind": "clear", "turbidity": 20.0, "luminance": 0.4, "sun_tint": [9.0, 1.0, 1.0], "sun": { "elevation": 95.0 } });
    let sky = bare(
        air,
        serde_json::json!({ "horizon": { "kind": "hills", "height": 80.0, "color": [2.0, 0.0, 0.0], "seed": 1 },
            "clouds": [{ "kind": "storm", "coverage": 1.5, "scale": 1.0, "seed": 1 }],
            "lights": [{ "layout": "fire", "palette": "flame", "count": 0, "radius": 1.0, "elevation": 0.0, "luminance": 1.0, "seed": 0 }] }),
    );
    let pointers: Vec<String> = sky.validate().into_iter().map(|(at, _)| at).collect();
    let expected = [
        "/air/sun/elevation",
        "/air/sun_tint/0",
        "/air/turbidity",
        "/clouds/0/coverage",
        "/horizon/height",
        "/horizon/color/0",
        "/lights/0/count",
    ];
    assert_eq!(pointers, expected);
    assert!(sky::render(&sky, 16, 8).pixels.iter().flatten().all(|v| v.is_finite()));
}
