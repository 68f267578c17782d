//! Named families of environments. Each draws its parameters from ranges of its own; a family is what a data set keeps apart
//! between training and test.

mod dusk;
mod figures;
mod indoor;
mod night;
mod outdoor;
mod soft;
mod studio;

use super::{Air, CloudKind, CloudLayer, Ground, Horizon, HorizonKind, Scenery, Sky, Sun};
use crate::draw::Draw;
use rand_pcg::Pcg64;

/// Kinds of light, for splits that hold some of each.
pub const GROUPS: [&str; 7] = ["outdoor_sun", "outdoor_soft", "sunset", "night", "studio", "interior", "abstract"];

/// Name, index into [`GROUPS`], recipe.
type Recipe = (&'static str, usize, fn(&mut Pcg64) -> Sky);

const RECIPES: &[Recipe] = &[
    ("clear_high_sun", 0, outdoor::clear_high_sun),
    ("clear_low_sun", 0, outdoor::clear_low_sun),
    ("hazy_sun", 0, outdoor::hazy_sun),
    ("tinted_sun", 0, outdoor::tinted_sun),
    ("alpine_sun", 0, outdoor::alpine_sun),
    ("snow_field", 0, outdoor::snow_field),
    ("desert_dunes", 0, outdoor::desert_dunes),
    ("canyon", 0, outdoor::canyon),
    ("seaside", 0, outdoor::seaside),
    ("sea_low_sun", 0, outdoor::sea_low_sun),
    ("fair_cumulus", 0, outdoor::fair_cumulus),
    ("cirrus_sun", 0, outdoor::cirrus_sun),
    ("altocumulus_sun", 0, outdoor::altocumulus_sun),
    ("meadow_trees", 0, outdoor::meadow_trees),
    ("forest_canopy", 0, outdoor::forest_canopy),
    ("village", 0, outdoor::village),
    ("city_day", 0, outdoor::city_day),
    ("city_canyon", 0, outdoor::city_canyon),
    ("pergola", 0, outdoor::pergola),
    ("hills_low_sun", 0, outdoor::hills_low_sun),
    ("overcast_plain", 1, soft::overcast_plain),
    ("overcast_hills", 1, soft::overcast_hills),
    ("fog", 1, soft::fog),
    ("stratus_glow", 1, soft::stratus_glow),
    ("storm", 1, soft::storm),
    ("storm_break", 1, soft::storm_break),
    ("rainy_city", 1, soft::rainy_city),
    ("open_shade", 1, soft::open_shade),
    ("winter_woods", 1, soft::winter_woods),
    ("grey_sea", 1, soft::grey_sea),
    ("soft_gradient", 1, soft::soft_gradient),
    ("sunset_clear", 2, dusk::sunset_clear),
    ("sunset_streaks", 2, dusk::sunset_streaks),
    ("sunset_sea", 2, dusk::sunset_sea),
    ("sunset_ridges", 2, dusk::sunset_ridges),
    ("sunset_skyline", 2, dusk::sunset_skyline),
    ("sunset_cumulus", 2, dusk::sunset_cumulus),
    ("storm_sunset", 2, dusk::storm_sunset),
    ("dawn_mist", 2, dusk::dawn_mist),
    ("twilight_glow", 2, dusk::twilight_glow),
    ("moonlit_clear", 3, night::moonlit_clear),
    ("moonlit_clouds", 3, night::moonlit_clouds),
    ("moonlit_sea", 3, night::moonlit_sea),
    ("milky_way", 3, night::milky_way),
    ("street_lamps", 3, night::street_lamps),
    ("neon_signs", 3, night::neon_signs),
    ("harbour", 3, night::harbour),
    ("campfire", 3, night::campfire),
    ("city_glow", 3, night::city_glow),
    ("skyline_night", 3, night::skyline_night),
    ("festival_strings", 3, night::festival_strings),
    ("three_point", 4, studio::three_point),
    ("clamshell", 4, studio::clamshell),
    ("rim_pair", 4, studio::rim_pair),
    ("ring_light", 4, studio::ring_light),
    ("overhead_softbox", 4, studio::overhead_softbox),
    ("strip_walls", 4, studio::strip_walls),
    ("light_tent", 4, studio::light_tent),
    ("turntable_sweep", 4, studio::turntable_sweep),
    ("beauty_dish", 4, studio::beauty_dish),
    ("leaf_gobo", 4, studio::leaf_gobo),
    ("blinds", 4, studio::blinds),
    ("led_grid", 4, studio::led_grid),
    ("gel_pair", 4, studio::gel_pair),
    ("dome_array", 4, studio::dome_array),
    ("tube_lights", 4, studio::tube_lights),
    ("hard_spot", 4, studio::hard_spot),
    ("stage", 4, studio::stage),
    ("window_room", 5, indoor::window_room),
    ("sunlit_room", 5, indoor::sunlit_room),
    ("skylight_hall", 5, indoor::skylight_hall),
    ("corridor_panels", 5, indoor::corridor_panels),
    ("office_ceiling", 5, indoor::office_ceiling),
    ("warehouse", 5, indoor::warehouse),
    ("church_windows", 5, indoor::church_windows),
    ("showroom_tunnel", 5, indoor::showroom_tunnel),
    ("attic", 5, indoor::attic),
    ("lamp_room", 5, indoor::lamp_room),
    ("greenhouse", 5, indoor::greenhouse),
    ("arcade", 5, indoor::arcade),
    ("cave_mouth", 5, indoor::cave_mouth),
    ("color_gradient", 6, figures::color_gradient),
    ("color_shapes", 6, figures::color_shapes),
    ("soft_blobs", 6, figures::soft_blobs),
];

/// Names of the families, in a fixed order.
pub const ENVIRONMENTS: [&str; RECIPES.len()] = {
    let mut names = [""; RECIPES.len()];
    let mut index = 0;
    while index < names.len() {
        names[index] = RECIPES[index].0;
        index += 1;
    }
    names
};

/// A sky of the family `name` (of [`ENVIRONMENTS`]) with parameters drawn from its ranges; `None` for an unknown name.
///
/// Every parameter is rounded as a scene file shows it, and passes [`Sky::validate`].
///
/// ```
/// use renderflow_scenes::{seed::Seed, sky};
/// let sky = sky::random_of("desert_dunes", &mut Seed::root(5).child("environment", 0).rng());
/// assert!(sky.is_some_and(|sky| sky.validate().is_empty()));
/// ```
pub fn random_of(name: &str, rng: &mut Pcg64) -> Option<Sky> {
    RECIPES.iter().find(|recipe| recipe.0 == name).map(|recipe| recipe.2(rng))
}

/// The same of the family at `place` in [`ENVIRONMENTS`].
pub(crate) fn random_at(place: usize, rng: &mut Pcg64) -> Sky {
    RECIPES[place].2(rng)
}

/// Group (of [`GROUPS`]) of the family `name`; an empty string for an unknown name.
pub fn group(name: &str) -> &'static str {
    RECIPES.iter().find(|recipe| recipe.0 == name).map_or("", |recipe| GROUPS[recipe.1])
}

/// Diffuse reflectance of a ground.
fn ground(rng: &mut Pcg64) -> [f32; 3] {
    let level = rng.log(0.05, 0.5);
    tint(rng, level, 0.35).map(|v| v.min(0.9))
}

/// A colour of about the given level whose channels differ by up to the share `spread`.
fn tint(rng: &mut Pcg64, level: f32, spread: f32) -> [f32; 3] {
    [0; 3].map(|_| Pcg64::tidy(level * rng.between(1.0 - spread, 1.0 + spread)))
}

/// A scenery with nothing in it yet.
struct Place {
    air: Air,
    clouds: Vec<CloudLayer>,
    horizon: Option<Horizon>,
    ground: Ground,
}

impl Place {
    fn sky(self) -> Sky {
        let Self { air, clouds, horizon, ground } = self;
        let horizon = horizon.map(Box::new);
        let (glows, stars, cover, lights) = (Vec::new(), None, None, Vec::new());
        Sky::Scenery(Scenery { air, clouds, glows, stars, horizon, cover, lights, ground })
    }
}

/// A number that names clouds, hills, lamps.
fn which(rng: &mut Pcg64) -> u32 {
    rng.below(1 << 30)
}

fn degrees(rng: &mut Pcg64) -> f32 {
    rng.between(0.0, 360.0)
}

/// A sun between two elevations. Small discs are as common as large ones on a logarithmic scale.
fn sun(rng: &mut Pcg64, low: f32, high: f32) -> Sun {
    Sun { elevation: rng.between(low, high), azimuth: degrees(rng), radius: rng.log(0.27, 2.0), gain: rng.log(0.5, 3.0) }
}

/// A hard sun at 2 to 18 degrees: long shadows and strong glints, where networks fail first.
fn low_hard_sun(rng: &mut Pcg64) -> Sun {
    Sun { elevation: rng.between(2.0, 18.0), azimuth: degrees(rng), radius: rng.log(0.27, 0.7), gain: rng.log(1.0, 4.0) }
}

/// White more often than not, else up to clearly warm or cold.
fn sun_tint(rng: &mut Pcg64) -> [f32; 3] {
    if rng.chance(0.6) {
        return [1.0; 3];
    }
    let warmth = rng.between(-0.6, 1.0);
    let (red, blue) =
        if warmth > 0.0 { (1.0 + 0.3 * warmth, 1.0 - 0.55 * warmth) } else { (1.0 + 0.4 * warmth, 1.0 - 0.3 * warmth) };
    [red, 1.0 - 0.12 * warmth.abs(), blue].map(Pcg64::tidy)
}

/// Clear air with the given sun and haze between 1.6 and `haziest`.
fn clear(rng: &mut Pcg64, sun: Sun, haziest: f32) -> Air {
    Air::Clear { sun, sun_tint: sun_tint(rng), turbidity: rng.log(1.6, haziest), luminance: rng.log(0.2, 0.7), tint: [1.0; 3] }
}

fn plain(rng: &mut Pcg64, color: [f32; 3]) -> Ground {
    Ground::Plain { color: shaded(rng, color), variation: rng.between(0.1, 0.8), seed: which(rng) }
}

/// A colour near `color`: lighter or darker as a whole and a little in each channel.
fn shaded(rng: &mut Pcg64, color: [f32; 3]) -> [f32; 3] {
    let level = rng.log(0.65, 1.5);
    let each = tint(rng, level, 0.07);
    [0, 1, 2].map(|k| Pcg64::tidy((color[k] * each[k]).min(0.92)))
}

/// Ground of any common kind.
fn any_ground(rng: &mut Pcg64) -> Ground {
    let color = [GRASS, SAND, SOIL, CONCRETE, ASPHALT, ROCK, SNOW, RED_ROCK][rng.below(8) as usize];
    plain(rng, color)
}

fn skyline(rng: &mut Pcg64, kind: HorizonKind, height: [f32; 2], color: [f32; 3], haze: [f32; 2]) -> Horizon {
    Horizon {
        kind,
        height: rng.log(height[0], height[1]),
        color: shaded(rng, color),
        haze: rng.between(haze[0], haze[1]),
        lit: 0.0,
        luminance: 0.0,
        seed: which(rng),
    }
}

fn layer(rng: &mut Pcg64, kind: CloudKind, coverage: [f32; 2]) -> CloudLayer {
    CloudLayer {
        kind,
        coverage: rng.between(coverage[0], coverage[1]),
        scale: rng.log(0.5, 2.2),
        depth: rng.log(0.6, 1.5),
        direction: degrees(rng),
        seed: which(rng),
    }
}

const GRASS: [f32; 3] = [0.11, 0.15, 0.06];
const SAND: [f32; 3] = [0.45, 0.36, 0.24];
const SNOW: [f32; 3] = [0.78, 0.8, 0.84];
const SOIL: [f32; 3] = [0.2, 0.16, 0.12];
const ROCK: [f32; 3] = [0.24, 0.22, 0.2];
const RED_ROCK: [f32; 3] = [0.42, 0.22, 0.13];
const ASPHALT: [f32; 3] = [0.1, 0.1, 0.105];
const CONCRETE: [f32; 3] = [0.32, 0.31, 0.3];
const LEAVES: [f32; 3] = [0.07, 0.1, 0.035];
const SEA: [f32; 3] = [0.015, 0.035, 0.045];
