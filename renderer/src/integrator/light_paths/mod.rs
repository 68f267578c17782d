//! Light paths: from the environment over a shiny body to a surface that the camera sees.
//!
//! A path from the camera finds a caustic only when a direction drawn blindly at the first surface meets the body just where it mirrors
//! the sun. Followed the other way, light that meets the body *is* the caustic. Both ways find the paths
//! `environment - x2 - x1 - camera`; so do light samples at x2. The three are weighed against each other by the power heuristic, so
//! that nothing is counted twice and each does what it does best (Veach 1997; this is the strategy with one camera vertex of
//! bidirectional path tracing, for paths of this length).
//!
//! With `N` samples a pixel, of which a light path stands for one in `N` paths of one sample a pixel, the expected number of paths per
//! pixel, solid angle at x1 and solid angle at x2 is
//!
//! - drawn at x1 and x2: `N p1(w1) p2(wi)`,
//! - drawn at x1, light sampled at x2: `N p1(w1) pl(wi)`,
//! - light path: `N q pl(wi) (n2 . wi) / (n2 . w21) p2'(w21) (n1 . w1) J`, where `q` is the number of paths per square metre across
//!   their direction for one sample a pixel, `p2'` the density with which x2 is left towards x1 when it is seen from the light, and
//!   `J = d^2 cos^3 / (fx fy) / (n1 . wo)` the area at x1 that a pixel sees. The two distances between x1 and x2 cancel.

mod casters;
mod trace;

pub(crate) use casters::Casters;
pub(super) use trace::{Deposit, trace};

use crate::compile::RenderScene;
use crate::features::Features;
use crate::integrator::Settings;
use crate::integrator::scatter::Scatterer;
use crate::interaction::Interaction;
use glam::Vec3A;

/// Surface that a pixel sees around `at` from its camera, in square metres: `J` above.
#[inline(always)]
fn seen_area(scene: &RenderScene, at: &Interaction, wo: Vec3A) -> f32 {
    let camera = scene.camera();
    let away = at.p - camera.position();
    // Cosine between the ray and the view axis, from which pixels are measured.
    let cos = -camera.camera_to_world.matrix3.z_axis.dot(-wo);
    away.length_squared() * cos * cos * cos / (camera.fl_x * camera.fl_y * at.n.dot(wo))
}

/// Most surfaces that light paths have.
pub(super) const MOST_SURFACES: u32 = 8;

fn longest(settings: &Settings) -> usize {
    settings.max_bounces.min(MOST_SURFACES) as usize
}

/// By what the density of a path changes at the surface `at`, not the first nor the last before the light, if it is followed the other
/// way; its density followed this way not counted.
#[inline(always)]
pub(super) fn turned<F: Features>(
    at: &Interaction,
    (bsdf, scatterer): (&F::Bsdf, &Scatterer<'_, F>),
    (wo, wi): (Vec3A, Vec3A),
) -> f32 {
    scatterer.reversed_pdf(bsdf, wo, wi) * at.n.dot(wi) / at.n.dot(wo)
}

/// How dense light paths are at the second surface of a path compared to light samples there, where both can be.
impl Casters {
    /// Of the first surface `at`, seen from `wo`, left along `wi` with density `pdf`: what [`Self::ratio`] needs of it.
    #[inline(always)]
    pub fn reach(&self, scene: &RenderScene, at: &Interaction, wo: Vec3A, wi: Vec3A, pdf: f32) -> f32 {
        seen_area(scene, at, wo) * at.n.dot(wi) / pdf
    }

    /// Density of light paths over that of light samples, of the path that leaves `at` for the light along `wi` and reaches it from
    /// `wo`.
    #[inline(always)]
    pub fn ratio<F: Features>(
        &self,
        scene: &RenderScene,
        reach: f32,
        at: &Interaction,
        (bsdf, scatterer): (&F::Bsdf, &Scatterer<'_, F>),
        (wo, wi): (Vec3A, Vec3A),
    ) -> f32 {
        let density = self.density[at.instance as usize];
        if density == 0.0 {
            return 0.0;
        }
        density / scene.lights.environment_share() * reach * turned::<F>(at, (bsdf, scatterer), (wo, wi))
    }
}
