//! Keeps the rays of a render, so that they can be traced again alone: what a render costs beyond them is then known.
//!
//! Only with the feature `record`, which measurements turn on (the example `shading_cost` of renderflow-bench).

use crate::ray::Ray;
use glam::Vec3A;
use std::cell::RefCell;

/// A ray of a render, with the kind of query.
#[derive(Clone, Copy, Debug)]
pub struct Recorded {
    /// World-space origin, metres.
    pub origin: Vec3A,
    /// World-space unit direction.
    pub direction: Vec3A,
    /// Whether only the existence of a hit mattered.
    pub any: bool,
    /// How many rays, this one and those after it, were traced together; 0 for those after the first.
    pub together: usize,
}

thread_local! {
    static RAYS: RefCell<Option<Vec<Recorded>>> = const { RefCell::new(None) };
}

/// Runs `render` and returns the rays that it traced on this thread, in order.
pub fn record(render: impl FnOnce()) -> Vec<Recorded> {
    RAYS.set(Some(Vec::new()));
    render();
    RAYS.take().unwrap_or_default()
}

#[inline]
pub(crate) fn ray(ray: &Ray, any: bool) {
    keep(ray, any, 1);
}

/// Rays that are asked together what they meet first.
#[inline]
pub(crate) fn packet(rays: &[Ray]) {
    for (i, ray) in rays.iter().enumerate() {
        keep(ray, false, if i == 0 { rays.len() } else { 0 });
    }
}

#[inline]
fn keep(ray: &Ray, any: bool, together: usize) {
    RAYS.with_borrow_mut(|rays| {
        if let Some(rays) = rays {
            rays.push(Recorded { origin: ray.origin, direction: ray.direction, any, together });
        }
    });
}
