//! The family `scenery`: air, clouds, stars, a silhouette, a cover, lamps and a ground, each lit by the others where it shows.

use super::analytic::Atmosphere;
use super::canvas::{Dome, disc, luminance, rgb, toward};
use super::clouds::{CloudLight, Layer};
use super::cover::Shade;
use super::horizon::{AIR, Light, Silhouette, heading, turn};
use super::lights;
use super::parts::{Air, CloudLayer, Cover, Glow, Ground, Horizon, LightGroup, Stars};
use crate::family::family;
use crate::noise;
use crate::seed::Seed;
use glam::DVec3;
use rand::RngExt;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

family! {
    /// A place out of doors: air, clouds, stars, a silhouette on the horizon, something overhead, lamps, and a ground.
    pub struct Scenery {
        /// The sky behind everything, with the sun or the moon.
        air: Air;
        /// Layers of clouds from the highest to the lowest.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        clouds: Vec<CloudLayer> [; count 0, 4];
        /// Soft bright places.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        glows: Vec<Glow> [; count 0, 12];
        /// Stars.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        stars: Option<Stars>;
        /// What stands on the horizon.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        horizon: Option<Box<Horizon>>;
        /// What covers the eye.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        cover: Option<Box<Cover>>;
        /// Groups of lamps.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        lights: Vec<LightGroup> [; count 0, 4];
        /// What lies below the horizon.
        ground: Ground;
    }
}

/// The air alone.
enum Backdrop {
    Clear(Box<Atmosphere>, DVec3),
    Gradient { zenith: DVec3, horizon: DVec3, sharpness: f64 },
    Overcast { zenith: DVec3, sun: DVec3, glow: f64 },
}

/// The sun or the moon.
#[derive(Clone, Copy)]
struct Star {
    axis: DVec3,
    radius: f64,
    /// On a surface that faces it, nothing before it.
    irradiance: DVec3,
}

/// Everything above the horizon before silhouettes and covers.
struct Heaven {
    backdrop: Backdrop,
    star: Option<Star>,
    clouds: Vec<Layer>,
    light: CloudLight,
    /// Middle, inverse width and flatness, radiance.
    glows: Vec<(DVec3, f64, f64, DVec3)>,
    milky_way: Option<(DVec3, DVec3, u32)>,
}

impl Backdrop {
    fn radiance(&self, d: DVec3) -> DVec3 {
        match self {
            Self::Clear(air, tint) => air.radiance(d) * *tint,
            Self::Gradient { zenith, horizon, sharpness } => horizon.lerp(*zenith, d.y.max(0.0).powf(*sharpness)),
            Self::Overcast { zenith, sun, glow } => {
                let angle = d.dot(*sun).clamp(-1.0, 1.0).acos().to_degrees();
                *zenith * ((1.0 + 2.0 * d.y.max(0.0)) / 3.0) * (1.0 + glow * (-(angle / 28.0).powi(2)).exp())
            }
        }
    }
}

impl Heaven {
    fn new(s: &Scenery) -> Self {
        let (backdrop, star, gain) = match &s.air {
            Air::Clear { sun, sun_tint, turbidity, luminance, tint } => {
                let axis = toward(sun.elevation, sun.azimuth);
                let ground = match &s.ground {
                    Ground::Plain { color, .. } | Ground::Water { color, .. } => rgb(*color),
                };
                let air = Atmosphere::new(axis, f64::from(*turbidity), ground, f64::from(*luminance));
                let irradiance = air.sun_irradiance * rgb(*sun_tint) * f64::from(sun.gain);
                let star = Star { axis, radius: f64::from(sun.radius).to_radians(), irradiance };
                (Backdrop::Clear(Box::new(air), rgb(*tint)), Some(star), f64::from(sun.gain))
            }
            Air::Gradient { zenith, horizon, sharpness } => {
                let (zenith, horizon) = (rgb(*zenith), rgb(*horizon));
                (Backdrop::Gradient { zenith, horizon, sharpness: f64::from(*sharpness) }, None, 1.0)
            }
            Air::Overcast { zenith, glow, glow_elevation, glow_azimuth } => {
                let sun = toward(*glow_elevation, *glow_azimuth);
                (Backdrop::Overcast { zenith: rgb(*zenith), sun, glow: f64::from(*glow) }, None, 1.0)
            }
        };
        let shaded = irradiance(|d| backdrop.radiance(d)) / PI;
        // Clouds are not driven to glare by a strong disc, as in the family `cloudy`.
        let (sun, sunlit) = match (&star, &backdrop) {
            (Some(star), _) => (star.axis, star.irradiance * (gain.min(2.0) / gain.max(1e-6) / PI)),
            (None, Backdrop::Overcast { sun, glow, .. }) => (*sun, shaded * (0.3 * glow)),
            (None, _) => (DVec3::Y, DVec3::ZERO),
        };
        let milky_way = s.stars.as_ref().filter(|stars| stars.milky_way != [0.0; 3]).map(|stars| {
            let mut rng = Seed::root(u64::from(stars.seed)).child("milky way", 0).rng();
            let y = rng.random_range(-0.8..0.8f64);
            ((heading(rng.random::<f64>()) * (1.0 - y * y).sqrt()).with_y(y), rgb(stars.milky_way), stars.seed)
        });
        let lobe = |glow: &Glow| {
            let inverse = 1.0 / f64::from(glow.width).to_radians();
            (toward(glow.elevation, glow.azimuth), inverse, inverse * f64::from(glow.flatness), rgb(glow.radiance))
        };
        Self {
            backdrop,
            star,
            clouds: s.clouds.iter().map(Layer::new).collect(),
            light: CloudLight { sun, sunlit, shaded },
            glows: s.glows.iter().map(lobe).collect(),
            milky_way,
        }
    }

    /// Radiance in direction `d` above the horizon.
    fn radiance(&self, d: DVec3) -> DVec3 {
        let mut sky = self.backdrop.radiance(d);
        if let Some((pole, color, seed)) = self.milky_way {
            let off = d.dot(pole);
            if off.abs() < 0.45 {
                let wool = noise::fractal(d * 3.5, 4, seed);
                let rift = 1.0 - 0.75 * (-((off + 0.12 * wool) / 0.05).powi(2)).exp();
                sky += color * ((-(off / 0.17).powi(2)).exp() * (0.55 + 1.3 * wool).max(0.08) * rift);
            }
        }
        for &(axis, across, up, radiance) in &self.glows {
            let off = d - axis;
            let level = (off.x * off.x + off.z * off.z) * across * across + off.y * off.y * up * up;
            if level < 30.0 {
                sky += radiance * (-level).exp();
            }
        }
        self.clouds.iter().fold(sky, |behind, layer| layer.before(behind, d, &self.light))
    }

    fn passes(&self, d: DVec3) -> f64 {
        self.clouds.iter().map(|layer| layer.passes(d)).product()
    }
}

/// Irradiance of level ground under `sky`.
fn irradiance(sky: impl Fn(DVec3) -> DVec3) -> DVec3 {
    let (rings, sectors) = (24u32, 48u32);
    let mut sum = DVec3::ZERO;
    for ring in 0..rings {
        // Equal steps of y^2 are equal projected solid angles.
        let y = ((f64::from(ring) + 0.5) / f64::from(rings)).sqrt();
        for sector in 0..sectors {
            let d = heading((f64::from(sector) + 0.5) / f64::from(sectors)) * (1.0 - y * y).sqrt();
            sum += sky(d.with_y(y));
        }
    }
    sum * PI / f64::from(rings * sectors)
}

/// All that stands above the horizon.
struct Above {
    heaven: Heaven,
    silhouette: Option<Silhouette>,
    shade: Option<Shade>,
}

impl Above {
    /// Share of the light of the sky in direction `d` that reaches the eye past silhouette and cover.
    fn seen(&self, d: DVec3) -> f64 {
        if d.y <= 0.0 || self.silhouette.as_ref().is_some_and(|s| !s.is_open(d)) {
            return 0.0;
        }
        self.shade.as_ref().map_or(1.0, |shade| shade.open(d))
    }

    fn radiance(&self, d: DVec3) -> DVec3 {
        let open = self.shade.as_ref().map_or(1.0, |shade| shade.open(d));
        let mut light = DVec3::ZERO;
        if open > 0.0 {
            let standing = self.silhouette.as_ref().and_then(|s| s.radiance(d));
            light += standing.unwrap_or_else(|| self.heaven.radiance(d)) * open;
        }
        match &self.shade {
            Some(shade) if open < 1.0 => light + shade.radiance(d) * (1.0 - open),
            _ => light,
        }
    }
}

/// What lies below the horizon, lit.
enum Below {
    Plain { radiance: DVec3, variation: f64, seed: u32, air: Vec<DVec3>, haze: f64 },
    Water { body: DVec3, variance: f64, star: Option<(DVec3, DVec3)>, lamps: Vec<(DVec3, DVec3)> },
}

impl Below {
    fn radiance(&self, d: DVec3, above: &Above) -> DVec3 {
        let down = (-d.y).max(1e-3);
        match self {
            Self::Plain { radiance, variation, seed, air, haze } => {
                let mut ground = *radiance;
                if *variation > 0.0 {
                    // Patches on the plane; far ones are smaller than a texel and average out.
                    let wool = noise::fractal(DVec3::new(d.x / down, 0.4, d.z / down) * 1.6, 4, *seed);
                    ground *= (1.0 + 1.8 * variation * wool * (down / 0.12).min(1.0)).max(0.05);
                }
                let x = turn(d) * AIR as f64;
                let i = (x as usize).min(AIR - 1);
                ground.lerp(air[i].lerp(air[(i + 1) % AIR], x.fract()), haze * (-down / 0.025).exp())
            }
            Self::Water { body, variance, star, lamps } => {
                // Waves tilt what is seen at a grazing angle upwards.
                let up = down + 0.6 * variance.sqrt();
                let mirrored = d.with_y(up).normalize_or(DVec3::Y);
                let mut light = above.radiance(mirrored) * fresnel(up.min(1.0)) + *body;
                for &(axis, energy) in star.iter().chain(lamps) {
                    light += energy * glitter(d, axis, *variance);
                }
                light
            }
        }
    }
}

/// Unpolarised reflectance of water (index 1.33) by the cosine of the angle (Schlick 1994).
fn fresnel(cos: f64) -> f64 {
    0.02 + 0.98 * (1.0 - cos).max(0.0).powi(5)
}

/// Radiance of wavy water in direction `d` (down) for unit irradiance from direction `light`: mirror facets whose slopes are
/// Gaussian with the given variance (Cox and Munk 1954).
fn glitter(d: DVec3, light: DVec3, variance: f64) -> f64 {
    let half = light - d;
    let (cos_beta, view) = (half.y / half.length(), (-d.y).max(0.04));
    if cos_beta < 0.5 {
        return 0.0;
    }
    let slope = 1.0 / (cos_beta * cos_beta) - 1.0;
    if slope > 16.0 * variance {
        return 0.0;
    }
    let density = (-slope / variance).exp() / (PI * variance);
    let facing = (half.dot(light) / half.length()).clamp(0.0, 1.0);
    // Radiance per irradiance of a surface that faces the light; steep crests hide one another at grazing angles.
    fresnel(facing) * density / (4.0 * view * cos_beta.powi(4))
}

pub(super) fn scenery(s: &Scenery) -> Dome {
    let heaven = Heaven::new(s);
    let ground_color = match &s.ground {
        Ground::Plain { color, .. } | Ground::Water { color, .. } => rgb(*color),
    };
    let lamps: Vec<_> = s.lights.iter().flat_map(lights::lamps).collect();
    let lamp_light: DVec3 = lamps.iter().map(|lamp| lamp.energy * lamp.axis.y.max(0.0)).sum();
    let open_sky = irradiance(|d| heaven.radiance(d));
    let direct =
        |heaven: &Heaven, share: f64| heaven.star.map_or(DVec3::ZERO, |star| star.irradiance * (star.axis.y.max(0.0) * share));
    let veiled = heaven.star.map_or(0.0, |star| heaven.passes(star.axis));
    let air: Vec<DVec3> = (0..AIR).map(|i| heaven.radiance(heading(i as f64 / AIR as f64).with_y(0.03).normalize())).collect();

    let silhouette = s.horizon.as_deref().map(|horizon| {
        let ground = ground_color * (open_sky + direct(&heaven, veiled) + lamp_light) / PI;
        let light = Light {
            sun: heaven.star.map_or(DVec3::Y, |star| star.axis),
            sun_irradiance: heaven.star.map_or(DVec3::ZERO, |star| star.irradiance * veiled),
            ambient: open_sky * 0.5 + ground * (0.5 * PI) + lamp_light * 0.5,
            air: air.clone(),
        };
        Silhouette::new(horizon, light)
    });
    let mut above = Above { heaven, silhouette, shade: None };
    if let Some(cover) = s.cover.as_deref() {
        let mut shade = Shade::new(cover);
        let through = |share: &dyn Fn(DVec3) -> f64| irradiance(|d| above.radiance(d) * share(d));
        // Light that has come in, met the floor, and lights the inside; the sun counts with the share that its disc keeps.
        let entering = through(&|d| shade.open(d)) + lamp_light;
        let sun = above
            .heaven
            .star
            .map_or(DVec3::ZERO, |star| star.irradiance * (veiled * above.seen(star.axis) * shade.open(star.axis)));
        shade.inside = entering * 0.6 + sun * 0.3 + (entering + sun * 0.5) * ground_color * 0.6;
        shade.sun = above.heaven.star.map_or(DVec3::Y, |star| star.axis);
        above.shade = Some(shade);
    }
    let above = Arc::new(above);

    let mut emitters = Vec::new();
    let mut sun_share = 0.0;
    if let Some(star) = above.heaven.star {
        let radiance = star.irradiance / (PI * star.radius.sin().powi(2));
        let view = above.clone();
        let emitter =
            disc(
                star.axis,
                star.radius,
                move |d| {
                    if d.y > 0.0 { radiance * (view.heaven.passes(d) * view.seen(d)) } else { DVec3::ZERO }
                },
            );
        let whole = luminance(radiance) * TAU * (1.0 - star.radius.cos());
        if luminance(emitter.energy) > 0.0 {
            sun_share = luminance(emitter.energy) / whole;
            emitters.push(emitter);
        }
    }
    let lit = irradiance(|d| above.radiance(d)) + direct(&above.heaven, sun_share) + lamp_light;
    let below = match &s.ground {
        Ground::Plain { color, variation, seed } => {
            let haze = if s.cover.is_some() || s.horizon.as_ref().is_some_and(|h| h.haze < 0.2) { 0.0 } else { 0.6 };
            Below::Plain { radiance: rgb(*color) * lit / PI, variation: f64::from(*variation), seed: *seed, air, haze }
        }
        Ground::Water { color, wind } => {
            // Mean square slope over wind speed (Cox and Munk 1954).
            let variance = 0.003 + 0.00512 * f64::from(*wind);
            let star = above.heaven.star.filter(|star| star.axis.y > 0.0).map(|star| (star.axis, star.irradiance * sun_share));
            let lamps = lamps.iter().filter(|lamp| lamp.axis.y > 0.0).map(|lamp| (lamp.axis, lamp.energy)).collect();
            Below::Water { body: rgb(*color) * lit / PI, variance, star, lamps }
        }
    };
    let mut points = Vec::new();
    if let (Some(silhouette), Some(horizon)) = (&above.silhouette, s.horizon.as_deref()) {
        let visible = |d: DVec3| above.shade.as_ref().map_or(1.0, |shade| shade.open(d));
        points.extend(silhouette.windows(f64::from(horizon.lit), f64::from(horizon.luminance), visible));
    }
    let star_points = s.stars.as_ref().map(lights::stars).unwrap_or_default();
    points.extend(star_points.into_iter().filter_map(|(d, energy)| {
        let share = above.seen(d) * above.heaven.passes(d);
        (share > 0.0).then_some((d, energy * share))
    }));
    emitters.extend(lamps);
    let background = move |d: DVec3| if d.y > 0.0 { above.radiance(d) } else { below.radiance(d, &above) };
    Dome { background: Box::new(background), emitters, points }
}
