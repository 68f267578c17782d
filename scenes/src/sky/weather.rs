//! Skies out of doors: gradients, clear, cloudy, sunset, overcast.

use super::analytic::Atmosphere;
use super::canvas::{Dome, Emitter, Radiance, disc, luminance, rgb, smoothstep, toward};
use super::fields::Sun;
use crate::noise;
use glam::DVec3;
use std::f64::consts::PI;
use std::sync::Arc;

pub(super) fn uniform(radiance: [f32; 3]) -> Dome {
    let radiance = rgb(radiance);
    Dome { background: Box::new(move |_| radiance), emitters: Vec::new(), points: Vec::new() }
}

pub(super) fn gradient(zenith: [f32; 3], horizon: [f32; 3], ground: [f32; 3], sharpness: f32) -> Dome {
    let (zenith, horizon, ground, sharpness) = (rgb(zenith), rgb(horizon), rgb(ground), f64::from(sharpness));
    let background = move |d: DVec3| if d.y > 0.0 { horizon.lerp(zenith, d.y.powf(sharpness)) } else { ground };
    Dome { background: Box::new(background), emitters: Vec::new(), points: Vec::new() }
}

/// The sun's disc; what stands before it lets `passes` through. Below the horizon nothing is seen.
fn sun_disc(sun: &Sun, irradiance: DVec3, passes: impl Fn(DVec3) -> f64 + Sync + 'static) -> Option<Emitter> {
    let radius = f64::from(sun.radius).to_radians();
    let strength = irradiance * f64::from(sun.gain);
    // A disc of radius r seen from its front has projected solid angle pi sin^2 r.
    let radiance = strength / (PI * radius.sin().powi(2));
    let axis = toward(sun.elevation, sun.azimuth);
    let emitter = disc(axis, radius, move |d| if d.y > 0.0 { radiance * passes(d) } else { DVec3::ZERO });
    (luminance(emitter.energy) > 0.0).then_some(emitter)
}

/// Radiance of level ground under `atmosphere` and `sun`.
fn lit_ground(atmosphere: &Atmosphere, sun: &Sun, sun_share: f64, ground: [f32; 3]) -> DVec3 {
    let direct = atmosphere.sun_irradiance * (f64::from(sun.gain) * sun_share * atmosphere.sun.y.max(0.0));
    rgb(ground) * (direct + atmosphere.sky_irradiance) / PI
}

/// The sky above, `ground` below.
fn over_ground(sky: impl Fn(DVec3) -> DVec3 + Sync + 'static, ground: DVec3) -> Radiance {
    Box::new(move |d| if d.y > 0.0 { sky(d) } else { ground })
}

fn atmosphere(sun: &Sun, turbidity: f32, ground: [f32; 3], mean: f32) -> Arc<Atmosphere> {
    let axis = toward(sun.elevation, sun.azimuth);
    Arc::new(Atmosphere::new(axis, f64::from(turbidity), rgb(ground), f64::from(mean)))
}

pub(super) fn daylight(sun: &Sun, turbidity: f32, ground: [f32; 3], mean: f32) -> Dome {
    let air = atmosphere(sun, turbidity, ground, mean);
    let below = lit_ground(&air, sun, 1.0, ground);
    let emitters = sun_disc(sun, air.sun_irradiance, |_| 1.0).into_iter().collect();
    Dome { background: over_ground(move |d| air.radiance(d), below), emitters, points: Vec::new() }
}

/// Which clouds stand in the sky.
#[derive(Clone)]
pub(super) struct Clouds {
    pub coverage: f32,
    pub scale: f32,
    pub seed: u32,
}

impl Clouds {
    /// Optical thickness, 0..=1, in direction `d`.
    fn density(&self, d: DVec3) -> f64 {
        if d.y <= 0.0 {
            return 0.0;
        }
        // A flat layer of clouds that bends down a little, so that they do not vanish at the horizon.
        let p = d / (d.y + 0.12) * (1.6 / f64::from(self.scale));
        let wool = 0.5 + 0.5 * noise::fractal(DVec3::new(p.x, p.z, 0.5), 5, self.seed) / 0.45;
        // The noise is about normal with mean 0.5; this threshold covers the wanted share.
        let edge = 1.15 - 1.3 * f64::from(self.coverage);
        smoothstep(edge - 0.12, edge + 0.3, wool) * smoothstep(0.0, 0.08, d.y)
    }
}

pub(super) fn cloudy(sun: &Sun, turbidity: f32, clouds: &Clouds, ground: [f32; 3], mean: f32) -> Dome {
    let air = atmosphere(sun, turbidity, ground, mean);
    let sun_axis = toward(sun.elevation, sun.azimuth);
    let veil = {
        let clouds = clouds.clone();
        move |d: DVec3| (-7.0 * clouds.density(d)).exp()
    };
    let below = lit_ground(&air, sun, veil(sun_axis), ground);
    let emitters = sun_disc(sun, air.sun_irradiance, veil).into_iter().collect();
    // Clouds are lit by the sun from one side and by the sky from all; thick ones are grey below.
    let (sunlit, shaded) = (air.sun_irradiance * f64::from(sun.gain).min(2.0) / PI, air.sky_irradiance / PI);
    let clouds = clouds.clone();
    let sky = move |d: DVec3| {
        let density = clouds.density(d);
        if density == 0.0 {
            return air.radiance(d);
        }
        let cos = d.dot(sun_axis);
        let thin = (1.0 - density).powi(2);
        let lining = 0.25 + 0.5 * thin + 1.5 * thin * smoothstep(0.75, 1.0, cos);
        let cloud = sunlit * 0.45 * lining + shaded * (0.35 + 0.5 * (1.0 - density));
        air.radiance(d).lerp(cloud, 1.0 - (-4.0 * density).exp())
    };
    Dome { background: over_ground(sky, below), emitters, points: Vec::new() }
}

pub(super) fn sunset(sun: &Sun, turbidity: f32, bands: f32, seed: u32, ground: [f32; 3], mean: f32) -> Dome {
    let air = atmosphere(sun, turbidity, ground, mean);
    let sun_axis = toward(sun.elevation, sun.azimuth);
    let band = move |d: DVec3| {
        // Long in azimuth, thin in elevation, and thinning out towards the zenith.
        let wool = noise::fractal(DVec3::new(d.x * 2.2, d.y * 13.0, d.z * 2.2), 4, seed);
        f64::from(bands) * smoothstep(0.0, 0.45, wool) * smoothstep(0.015, 0.06, d.y) * (1.0 - smoothstep(0.25, 0.75, d.y))
    };
    let below = lit_ground(&air, sun, 1.0, ground);
    let emitters = sun_disc(sun, air.sun_irradiance, move |d| (-3.0 * band(d)).exp()).into_iter().collect();
    let sky = move |d: DVec3| {
        let clear = air.radiance(d);
        let strength = band(d);
        // Seen from below against the light: glowing near the sun, slate elsewhere.
        let glow = smoothstep(0.3, 1.0, d.dot(sun_axis));
        let lit = DVec3::new(1.0, 0.5, 0.22) * (0.6 + 2.5 * glow * glow) * luminance(clear);
        clear.lerp(clear * 0.35 + lit * 0.65, 0.85 * strength)
    };
    Dome { background: over_ground(sky, below), emitters, points: Vec::new() }
}

pub(super) fn overcast(zenith: [f32; 3], ground: [f32; 3], glow: f32, [elevation, azimuth]: [f32; 2]) -> Dome {
    let zenith = rgb(zenith);
    let (sun, glow) = (toward(elevation, azimuth), f64::from(glow));
    // The standard sky's irradiance on level ground is 7 pi / 9 of the zenith's radiance.
    let below = rgb(ground) * zenith * (7.0 / 9.0);
    let sky = move |d: DVec3| {
        let angle = d.dot(sun).clamp(-1.0, 1.0).acos().to_degrees();
        zenith * ((1.0 + 2.0 * d.y) / 3.0) * (1.0 + glow * (-(angle / 28.0).powi(2)).exp())
    };
    Dome { background: over_ground(sky, below), emitters: Vec::new(), points: Vec::new() }
}
