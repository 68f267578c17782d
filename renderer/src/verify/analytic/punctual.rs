//! Scenes lit by points, spots and light from one direction, with the radiance known on paper.

use super::{ALBEDO, Case, EDGE, LIGHT, Paper, flat, ground_of, nearly_flat, plain, rgb};
use crate::verify::scenes;
use glam::{Affine3A, DVec3, Mat3A, Vec3};
use renderflow_frame::Camera;
use renderflow_scenes::ies::Profile;
use renderflow_scenes::loaded::{PunctualKind, PunctualLight};
use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

/// Shines along `ahead` from `place`.
fn light(kind: PunctualKind, place: DVec3, ahead: DVec3) -> PunctualLight {
    let z = -ahead.normalize().as_vec3a();
    let (x, y) = z.any_orthonormal_pair();
    let x = if x.cross(y).dot(z) > 0.0 { x } else { -x };
    let matrix3 = Mat3A::from_cols(x, y, z);
    let transforms = vec![Affine3A { matrix3, translation: place.as_vec3a() }];
    PunctualLight { name: "light".into(), kind, profile: None, transforms }
}

/// The middle of the floor, seen from beside the light.
fn look() -> Camera {
    scenes::camera([1.0, 3.0, 1.5], [0.1, 0.0, 0.2], 12.0, EDGE, EDGE)
}

/// A profile that falls evenly from 1 below to 0 at the horizon.
fn wedge() -> Option<Arc<Profile>> {
    Profile::parse("IESNA:LM-63-2002\nTILT=NONE\n1 -1 1 2 1 1 2 0 0 0 1 1 0\n0 90\n0\n7 0\n").ok().map(Arc::new)
}

/// Every scene with its answer.
pub(super) fn cases() -> Vec<Case> {
    let mut all = Vec::new();
    let strength = LIGHT * 20.0;
    let intensity = rgb(strength);
    let (place, ahead) = (DVec3::new(0.4, 2.0, -0.3), DVec3::new(-0.1, -1.0, 0.2));
    // Irradiance of the floor at `p` under a point with `intensity(cosine of the angle from `ahead`)`.
    let under = move |p: DVec3, intensity: &dyn Fn(f64) -> DVec3| {
        let to = p - place;
        let distance = to.length();
        intensity(to.dot(ahead.normalize()) / distance) * (-to.y / distance.powi(3))
    };
    let (inner, outer) = (0.05_f32, 0.5_f32);
    let cone = move |cos: f64| {
        let [inside, outside] = [inner, outer].map(|angle| f64::from(angle).cos());
        ((cos - outside) / (inside - outside)).clamp(0.0, 1.0).powi(2)
    };
    let point = light(PunctualKind::Point { intensity }, place, ahead);
    let spot = light(PunctualKind::Spot { intensity, inner, outer }, place, ahead);
    let sun = light(PunctualKind::Directional { irradiance: intensity }, place, ahead);
    let shaped = PunctualLight { profile: wedge(), ..point.clone() };
    type Irradiance = Box<dyn Fn(DVec3) -> DVec3 + Send + Sync>;
    let kinds: [(&str, PunctualLight, Irradiance); 4] = [
        ("a point", point.clone(), Box::new(move |p| under(p, &|_| strength))),
        ("a spot", spot, Box::new(move |p| under(p, &|cos| strength * cone(cos)))),
        ("light from one direction", sun.clone(), Box::new(move |_| strength * -ahead.normalize().y)),
        ("a point with a profile", shaped, Box::new(move |p| under(p, &|cos| strength * (1.0 - cos.acos() / FRAC_PI_2)))),
    ];
    for (name, light, irradiance) in kinds {
        let paper: Paper = Box::new(move |shot, x, y| Some(ALBEDO / PI * irradiance(shot.point(x, y))));
        let name = format!("floor below {name}");
        all.push(Case {
            lights: vec![light],
            bias: 1e-3,
            scattering_alone: false,
            ..plain(&name, vec![ground_of(10.0, ALBEDO)], flat(DVec3::ZERO), look(), paper)
        });
    }

    // All at once, under a sky: each is drawn some of the time.
    let lamps = [DVec3::new(-3.0, 1.0, 2.0), DVec3::new(0.5, 4.0, 0.5), DVec3::new(8.0, 3.0, -5.0)];
    for (sky, environment, part) in
        [("black", flat(DVec3::ZERO), 0.0), ("flat", flat(LIGHT), 1.0), ("sampled", nearly_flat(LIGHT), 1.0)]
    {
        let mut lights = vec![sun.clone(), point.clone()];
        lights.extend(lamps.map(|lamp| light(PunctualKind::Point { intensity }, lamp, DVec3::NEG_Y)));
        // One below the floor lights nothing.
        lights.push(light(PunctualKind::Point { intensity }, DVec3::new(0.2, -0.5, 0.2), DVec3::NEG_Y));
        let paper: Paper = Box::new(move |shot, x, y| {
            let p = shot.point(x, y);
            let of = |lamp: DVec3| strength * ((lamp - p).y / (lamp - p).length().powi(3));
            let sum = lamps.into_iter().map(of).sum::<DVec3>() + of(place) + strength * -ahead.normalize().y;
            Some(ALBEDO * (sum / PI + LIGHT * part))
        });
        all.push(Case {
            lights,
            bias: 1e-3,
            scattering_alone: false,
            ..plain(
                &format!("floor below a sun and four points, {sky} sky"),
                vec![ground_of(10.0, ALBEDO)],
                environment,
                look(),
                paper,
            )
        });
    }

    // A pane between a sun overhead and the floor takes the share 2 F / (1 + F) away that its two sides reflect, F = 0.04.
    let overhead = light(PunctualKind::Directional { irradiance: intensity }, place, DVec3::NEG_Y);
    let mut pane = scenes::diffuse([1.0; 3]);
    (pane.surface.transmission, pane.surface.specular, pane.thin_walled) = (1.0, 0.5, true);
    let place = Affine3A::from_translation(Vec3::new(0.0, 0.5, 0.0));
    let sheet = crate::verify::scenes::Part { transform: place, material: pane, ..ground_of(1.2, ALBEDO) };
    let reflected = 0.04 * 2.0 / 1.04;
    let paper: Paper = Box::new(move |_, _, _| Some(ALBEDO * strength / PI * (1.0 - reflected)));
    let below = scenes::camera([0.1, 0.3, 0.2], [0.1, 0.0, 0.1], 12.0, EDGE, EDGE);
    all.push(Case {
        lights: vec![overhead],
        bias: 1e-3,
        max_bounces: 1,
        scattering_alone: false,
        ..plain("floor below a pane and a sun", vec![ground_of(10.0, ALBEDO), sheet], flat(DVec3::ZERO), below, paper)
    });
    all
}
