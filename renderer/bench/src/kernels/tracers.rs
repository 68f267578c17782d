//! Ways of casting a set of rays.

use super::OURS;
use super::rays::Kind;
use crate::embree::Scene;
use glam::Vec3A;
use renderflow_renderer::accel::{Accel, Scratch};
use renderflow_renderer::ray::Ray;

/// Casts rays (origin, direction) and says of each whether it hit something.
type Cast<'a> = Box<dyn FnMut(&[[Vec3A; 2]], &mut [bool]) + 'a>;

/// One way of casting rays.
pub struct Tracer<'a> {
    /// As in tables.
    pub name: String,
    /// Whether rates are compared with its.
    pub yardstick: bool,
    /// Casts.
    pub cast: Cast<'a>,
}

/// Every way to cast rays of `kind`; ours, one ray at a time, first. `embree` is scenes of it with their names, the first of
/// which is the yardstick.
pub fn for_rays<'a>(kind: Kind, accel: &'a Accel, embree: &'a [(String, Scene<'a>)]) -> Vec<Tracer<'a>> {
    let mut tracers = vec![Tracer { name: OURS.into(), yardstick: false, cast: ours(kind, accel) }];
    if kind == Kind::Primary {
        tracers.push(Tracer { name: format!("{OURS} packets"), yardstick: false, cast: our_packets(accel) });
    }
    for (index, (name, scene)) in embree.iter().enumerate() {
        tracers.push(Tracer { name: name.clone(), yardstick: index == 0, cast: single(kind, scene) });
        if kind == Kind::Primary && index == 0 {
            for (coherent, what) in [(false, "packets"), (true, "coherent packets")] {
                let cast: Cast<'a> = Box::new(move |rays, found| packets(scene, rays, found, coherent));
                tracers.push(Tracer { name: format!("{name} {what}"), yardstick: false, cast });
            }
        }
    }
    tracers
}

fn ours(kind: Kind, accel: &Accel) -> Cast<'_> {
    let mut scratch = Scratch::default();
    if kind == Kind::Shadow {
        Box::new(move |rays, found| {
            for (&[origin, direction], found) in rays.iter().zip(found) {
                *found = accel.occluded(&Ray::new(origin, direction), &mut scratch);
            }
        })
    } else {
        Box::new(move |rays, found| {
            for (&[origin, direction], found) in rays.iter().zip(found) {
                *found = accel.closest(&Ray::new(origin, direction), &mut scratch).is_some();
            }
        })
    }
}

/// Rays of our packets.
const PACKET: usize = 16;

fn our_packets(accel: &Accel) -> Cast<'_> {
    let mut scratch = Scratch::default();
    Box::new(move |rays, found| {
        let mut packet = Vec::with_capacity(PACKET);
        let mut hits = [None; PACKET];
        for (rays, found) in rays.chunks(PACKET).zip(found.chunks_mut(PACKET)) {
            packet.clear();
            packet.extend(rays.iter().map(|&[origin, direction]| Ray::new(origin, direction)));
            accel.closest_packet(&packet, &mut hits[..rays.len()], &mut scratch);
            for (found, hit) in found.iter_mut().zip(&hits) {
                *found = hit.is_some();
            }
        }
    })
}

fn single<'a>(kind: Kind, scene: &'a Scene<'_>) -> Cast<'a> {
    if kind == Kind::Shadow {
        Box::new(move |rays, found| {
            for (&[origin, direction], found) in rays.iter().zip(found) {
                *found = scene.occluded(origin, direction);
            }
        })
    } else {
        Box::new(move |rays, found| {
            for (&[origin, direction], found) in rays.iter().zip(found) {
                *found = scene.closest(origin, direction).is_some();
            }
        })
    }
}

fn packets(scene: &Scene<'_>, rays: &[[Vec3A; 2]], found: &mut [bool], coherent: bool) {
    for (rays, found) in rays.chunks(16).zip(found.chunks_mut(16)) {
        let hits = scene.closest16(rays, coherent);
        for (lane, found) in found.iter_mut().enumerate() {
            *found = hits >> lane & 1 != 0;
        }
    }
}
