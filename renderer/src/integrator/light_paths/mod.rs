//! Light paths: from the environment or a lamp over a shiny or clear body to a surface that the camera sees.
//!
//! A path from the camera finds a caustic only when a direction drawn blindly at the first surface meets the body just where it
//! mirrors the sun. Followed the other way, light that meets the body *is* the caustic. Both ways find the paths `environment -
//! xk - ... - x1 - camera`, k >= 2, with xk on such a body; so do light samples at xk. The three are weighed against each other
//! by the power heuristic, so that nothing is counted twice and each does what it does best (Veach 1997: these are the strategies
//! of bidirectional path tracing with all, all but the last, and the last of the vertices on the camera's side).
//!
//! Let a light path stand for one in `N` where pixels have `N` samples, `pi(wi)` be the density of the direction drawn at xi
//! towards the light, `pi'` that of the direction towards the camera if xi is seen from the light's side, `ni . in` and `ni .
//! out` the cosines of those directions, `w` the direction of the light and `pl(w)` the density of light samples. The expected
//! number of paths per pixel and solid angles at x1 to xk is
//!
//! - drawn at all surfaces: `N p1 ... pk(w)`,
//! - light sampled at xk: `N p1 ... p(k-1) pl(w)`,
//! - light path: `N q pl(w) (product over i = k..2 of pi' (ni . in) / (ni . out)) (n1 . in) J`, where `q` is the number of paths
//!   aimed at the body per square metre across their direction for one sample a pixel, and `J = d^2 cos^3 / (fx fy) / (n1 . out)`
//!   the area at x1 that a pixel sees. The distances between the surfaces cancel.
//!
//! So the third over the second is `q reach(k-1) pk' (nk . in) / (nk . out)` with `reach(1) = (n1 . in) J / p1` and `reach(i) =
//! reach(i-1) pi' (ni . in) / (ni . out) / pi`: a path from the camera carries `reach` along. For weights, `pi'` is that of the
//! interaction as the camera's side sees it, in both directions alike, so that they sum to 1 whatever a light path's own density
//! is.
//!
//! A lamp stands somewhere: the paths from a point of it are aimed into the cone around the body, and at a distance `d` from
//! it `q pl(w)` becomes `M pc pd / d^2` times the density of light samples over `pl(lamp)`, with `M` paths for one sample a
//! pixel, `pc` and `pl` the probabilities to draw the lamp for the middle of the body and for xk, and `pd` the density of
//! directions in the cone.
//!
//! A blended surface stops a path with the probability that its coverage is. All three counts have that factor once for each of
//! x1 to xk, so it is no part of the weights. A light path was stopped at x1 when it arrived there: the ray that joins it to the
//! camera leaves only what lies before x1 to chance.
//!
//! Light paths pass no surface from behind, and `reach` is 0 once a path from the camera has (see `crate::query`). Where a path
//! crosses a surface, cosines are those of the two sides; what panes let through is the same in both directions and no part of
//! the weights.

mod casters;
mod trace;

pub(crate) use casters::CausticCasters;
pub(super) use casters::PathStart;
pub(super) use trace::{Deposit, LightPaths, trace};

use crate::compile::RenderScene;
use crate::features::Features;
use crate::integrator::scatter::Scatterer;
use crate::interaction::Interaction;
use crate::settings::Settings;
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

/// Largest ratio of densities; beyond it a light path has all the weight in any case.
const LARGEST_RATIO: f32 = 1e18;

fn longest(settings: &Settings) -> usize {
    settings.max_bounces.min(MOST_SURFACES) as usize
}

/// `pi' (ni . in) / (ni . out)` at the surface `at` of a path that goes on along `wi`, towards the light, and came from `wo`.
#[inline(always)]
pub(super) fn turned<F: Features>(
    at: &Interaction,
    (bsdf, scatterer): (&F::Bsdf, &Scatterer<'_, F>),
    (wo, wi): (Vec3A, Vec3A),
) -> f32 {
    scatterer.reversed_pdf(bsdf, wo, wi) * slant::<F>(at, wi) / at.n.dot(wo)
}

/// Cosine between the surface `at` and a direction, on whichever side.
#[inline(always)]
fn slant<F: Features>(at: &Interaction, wi: Vec3A) -> f32 {
    let cos = at.n.dot(wi);
    if F::CLEAR { cos.abs() } else { cos }
}

impl CausticCasters {
    /// `reach(1)`: of the first surface `at`, seen from `wo`, left along `wi` with density `pdf`.
    #[inline(always)]
    pub fn reach<F: Features>(&self, scene: &RenderScene, at: &Interaction, (wo, wi): (Vec3A, Vec3A), pdf: f32) -> f32 {
        seen_area(scene, at, wo) * slant::<F>(at, wi) / pdf
    }

    /// Density of light paths over that of light samples, of the path that leaves `at` along `wi` for the light that begins at
    /// `start`, and came from `wo` with `reach`; 0 where no light paths are aimed.
    #[inline(always)]
    pub fn ratio<F: Features>(
        &self,
        scene: &RenderScene,
        reach: f32,
        at: &Interaction,
        (bsdf, scatterer): (&F::Bsdf, &Scatterer<'_, F>),
        (wo, wi): (Vec3A, Vec3A),
        start: &PathStart,
    ) -> f32 {
        let aimed = self.aimed(scene, at.instance, &at.receiver::<F>(), start);
        if aimed == 0.0 {
            return 0.0;
        }
        let ratio = aimed * reach * turned::<F>(at, (bsdf, scatterer), (wo, wi));
        // Its square must stay finite. What overflowed on the way is left to the other strategies, from both sides.
        if ratio.is_finite() { ratio.min(LARGEST_RATIO) } else { 0.0 }
    }
}
