//! Unidirectional path tracing with sampled lights and multiple importance sampling.

use super::light_paths::{self, CausticCasters};
use super::path::Path;
use super::scatter::Scatterer;
use crate::accel::{Hit, Scratch};
use crate::clear::{Medium, Straight, first_hit};
use crate::compile::RenderScene;
use crate::features::{Brdf, Features};
use crate::film::FirstHit;
use crate::interaction::{Cone, Interaction};
use crate::light::{LightGroups, LightSampleCache};
use crate::material::{Mode, Prepared};
use crate::query::Sight;
use crate::ray::Ray;
use crate::sampler::{PixelSampler, Points};
use crate::settings::Settings;
use crate::simd;
use crate::stats::Stats;
use glam::{Vec2, Vec3A};
use renderflow_frame::frame::LIGHT_GROUPS;

/// Number of camera samples whose rays are traced together.
pub(super) const SHOTS: usize = 16;

/// A camera sample that is to be traced.
#[derive(Clone, Copy)]
pub(super) struct Shot {
    pub sampler: PixelSampler,
    pub pixel: (usize, usize),
    pub index: u32,
    /// Number of samples of the pixel that are traced one after the other. It affects how much is computed in advance, never the
    /// sample.
    pub count: u32,
    /// False where the pixel is known to see only the environment: then the same directions are looked up without tracing rays.
    pub seen: bool,
}

/// One camera sample.
pub(super) struct Sample {
    /// Finite; 0 where the estimate was not finite.
    pub radiance: Vec3A,
    pub first: Option<FirstHit>,
}

/// The state of one thread that traces paths.
pub(super) struct Tracer<'a, F: Features> {
    pub(super) scene: &'a RenderScene,
    pub(super) settings: &'a Settings,
    /// Number of samples that share a camera ray.
    branches: u32,
    /// Light samples at the first surface behind a camera ray.
    lights: u32,
    /// The objects that light paths are aimed at; `None` where there are none.
    pub(super) casters: Option<&'a CausticCasters>,
    /// Directions of the light groups, where asked for.
    directions: Option<LightGroups>,
    /// Largest contribution of indirect light, as it counts for one branch.
    limit: f32,
    /// What the current path is inside of. Only scenes with clear surfaces look at it.
    pub(super) medium: Medium,
    /// Radiance of the current sample, all and by group.
    radiance: Vec3A,
    groups: [Vec3A; LIGHT_GROUPS],
    /// The part of the radiance that met two surfaces or more.
    indirect: Vec3A,
    /// What light samples at the first surface would have added to the radiance if nothing had hidden them.
    pub(super) hidden: Vec3A,
    /// See [`Settings::shares`], of the current sample.
    shares: u32,
    /// Cone of a camera ray: what one of the samples of a pixel covers.
    camera_cone: Cone,
    /// Camera rays of the shots aimed at, and what they meet.
    rays: [Ray; SHOTS],
    hits: [Option<Hit>; SHOTS],
    pub(super) scratch: Scratch,
    pub(super) points: Points,
    pub(super) light_samples: LightSampleCache,
    /// BSDFs made before, by material.
    bsdfs: &'a [Option<Prepared>],
    pub(super) stats: Stats,
    features: std::marker::PhantomData<F>,
}

/// The arguments of [`Tracer::aim`].
struct Aim<'t, 'a, F: Features> {
    tracer: &'t mut Tracer<'a, F>,
    shots: &'t [Shot],
}

impl<F: Features> simd::Work for Aim<'_, '_, F> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        self.tracer.find_first(self.shots);
    }
}

/// The arguments of [`Tracer::sample`].
struct CameraSample<'t, 'a, F: Features> {
    tracer: &'t mut Tracer<'a, F>,
    place: usize,
    shot: &'t Shot,
}

impl<F: Features> simd::Work for CameraSample<'_, '_, F> {
    type Output = Sample;
    #[inline(always)]
    fn run(self) -> Sample {
        self.tracer.trace(self.place, self.shot)
    }
}

/// The arguments of [`Tracer::probe`].
struct Probes<'t, 'a, F: Features> {
    tracer: &'t mut Tracer<'a, F>,
    shots: &'t [Shot],
}

impl<F: Features> simd::Work for Probes<'_, '_, F> {
    type Output = Vec<Probe>;
    #[inline(always)]
    fn run(self) -> Vec<Probe> {
        self.tracer.find_probes(self.shots)
    }
}

/// The contributions of two light samples and two paths behind one camera ray, each as if it were the only one of its kind, and
/// the number of rays that they took.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Probe {
    pub light: [Vec3A; 2],
    pub path: [Vec3A; 2],
    pub light_rays: u64,
    pub path_rays: u64,
}

/// Where light came from.
#[derive(Clone, Copy, Debug)]
pub(super) enum Origin {
    Environment(Vec3A),
    Emitter,
}

impl Origin {
    /// The light group that it is in.
    #[inline(always)]
    pub fn group(self, groups: &LightGroups) -> usize {
        match self {
            Self::Environment(wi) => groups.group(wi),
            Self::Emitter => groups.emitters(),
        }
    }
}

/// Camera ray of a sample of `pixel`, from the numbers of its set 0.
#[inline(always)]
pub(super) fn camera_ray_at(scene: &RenderScene, settings: &Settings, [u, v, s, t]: [f32; 4], pixel: (usize, usize)) -> Ray {
    let point = Vec2::new(pixel.0 as u32 as f32 + 0.5, pixel.1 as u32 as f32 + 0.5) + settings.filter.sample([u, v]);
    match &settings.lens {
        None => crate::camera::ray(scene.camera(), point),
        Some(lens) => lens.ray(scene.camera(), point, [s, t]),
    }
}

impl<'a, F: Features> Tracer<'a, F> {
    /// `lights` is the number of light samples at the first surface behind a camera ray.
    pub fn new(scene: &'a RenderScene, settings: &'a Settings, casters: Option<&'a CausticCasters>, lights: u32) -> Self {
        Self {
            scene,
            settings,
            directions: settings.groups(scene),
            branches: settings.branches(),
            lights,
            casters,
            limit: settings.clamp_indirect.unwrap_or(f32::INFINITY),
            medium: Medium::AIR,
            radiance: Vec3A::ZERO,
            groups: [Vec3A::ZERO; LIGHT_GROUPS],
            indirect: Vec3A::ZERO,
            hidden: Vec3A::ZERO,
            shares: settings.shares(0),
            camera_cone: Cone::camera(scene.camera(), settings.camera_shares(0)),
            rays: [Ray::new(Vec3A::ZERO, Vec3A::Z); SHOTS],
            hits: [None; SHOTS],
            scratch: Scratch::default(),
            points: Points::default(),
            light_samples: LightSampleCache::default(),
            bsdfs: settings.bsdfs(scene),
            stats: Stats::default(),
            features: std::marker::PhantomData,
        }
    }

    /// Shares of the last sample by light group.
    pub fn groups(&self) -> &[Vec3A; LIGHT_GROUPS] {
        &self.groups
    }

    /// Indirect and hidden light of the last sample.
    pub fn paths(&self) -> [Vec3A; 2] {
        [self.indirect, self.hidden]
    }

    pub fn into_stats(self) -> Stats {
        self.stats
    }

    /// Finds what the camera rays of up to [`SHOTS`] shots meet; either all or none of the shots are `seen`. Tracing them
    /// together takes a third of the time and gives the same hits.
    #[inline]
    pub fn aim(&mut self, shots: &[Shot]) {
        simd::run(Aim { tracer: self, shots });
    }

    #[inline(always)]
    fn find_first(&mut self, shots: &[Shot]) {
        let count = shots.len().min(SHOTS);
        let seen = shots.first().is_some_and(|shot| shot.seen);
        if F::FLAT_ENVIRONMENT && !seen && self.directions.is_none() {
            // The radiance is the same from all directions, so the direction does not matter.
            return;
        }
        for (ray, shot) in self.rays.iter_mut().zip(shots) {
            self.points.expect(shot.count);
            *ray = camera_ray_at(self.scene, self.settings, self.points.point(&shot.sampler, shot.index, 0), shot.pixel);
        }
        if seen {
            self.scene.trace_all::<F>(&self.rays[..count], &mut self.hits[..count], &mut self.scratch);
        } else {
            self.hits.fill(None);
        }
    }

    /// Traces `shot`, number `place` of the shots that were last passed to [`Self::aim`].
    #[inline]
    pub fn sample(&mut self, place: usize, shot: &Shot) -> Sample {
        simd::run(CameraSample { tracer: self, place, shot })
    }

    #[inline(always)]
    fn trace(&mut self, place: usize, shot: &Shot) -> Sample {
        self.points.expect(shot.count * self.branches);
        self.light_samples.expect(shot.count * self.lights);
        self.stats.samples += u64::from(self.branches);
        let shares = self.settings.shares(shot.index * self.branches);
        if shares != self.shares {
            self.shares = shares;
            self.camera_cone = Cone::camera(self.scene.camera(), self.settings.camera_shares(shot.index * self.branches));
        }
        (self.indirect, self.hidden) = (Vec3A::ZERO, Vec3A::ZERO);
        *(if shot.seen { &mut self.stats.camera_rays } else { &mut self.stats.skipped_rays }) += 1;
        if F::FLAT_ENVIRONMENT && !shot.seen && self.directions.is_none() {
            return Sample { radiance: self.scene.environment_light().radiance(Vec3A::Y), first: None };
        }
        let (ray, hit) = (self.rays[place % SHOTS], self.hits[place % SHOTS]);
        let (mut on, mut met, mut before, mut share) = (ray, hit, 0.0, Vec3A::ONE);
        if F::CLEAR {
            let straight = Straight::new(ray, hit, false).go_on::<F>(self.scene, &mut self.scratch);
            (on, met, before, share) = (straight.ray, straight.hit, straight.before, straight.weight);
        }
        self.radiance = Vec3A::ZERO;
        if self.directions.is_some() {
            self.groups = [Vec3A::ZERO; LIGHT_GROUPS];
        }
        let clear = if F::CLEAR || F::FULL && self.scene.features().blended { hit } else { None };
        let behind = clear.map(|hit| first_hit::<F>(self.scene, &ray, &hit, self.camera_cone, &mut self.scratch));
        let first = match met {
            None => {
                let radiance = self.scene.environment_light().radiance(ray.direction);
                self.add(if F::CLEAR { share * radiance } else { radiance }, Origin::Environment(ray.direction));
                behind
            }
            Some(hit) => {
                let cone = if F::CLEAR { self.camera_cone.at(before) } else { self.camera_cone };
                let surface = Interaction::new::<F>(self.scene, &on, &hit, cone);
                let first = behind.unwrap_or(FirstHit { albedo: surface.surface.base_color, ns: surface.ns });
                if F::FULL && surface.emitted != Vec3A::ZERO {
                    self.add(if F::CLEAR { share * surface.emitted } else { surface.emitted }, Origin::Emitter);
                }
                // Without light there is nothing to gather.
                if !(self.settings.skips.dark_scenes && self.scene.features().dark()) {
                    self.gather(&shot.sampler, shot.index, (surface, share), -ray.direction);
                }
                Some(first)
            }
        };
        if !self.hidden.is_finite() {
            self.hidden = Vec3A::ZERO;
        }
        if self.radiance.is_finite() {
            return Sample { radiance: self.radiance, first };
        }
        self.stats.non_finite_samples += 1;
        self.groups = [Vec3A::ZERO; LIGHT_GROUPS];
        self.indirect = Vec3A::ZERO;
        Sample { radiance: Vec3A::ZERO, first }
    }

    #[inline(always)]
    pub(super) fn add(&mut self, contribution: Vec3A, from: Origin) {
        self.radiance += contribution;
        if let Some(directions) = &self.directions {
            self.groups[from.group(directions)] += contribution;
        }
    }

    /// Adds what `first` scatters towards `wo`, seen through panes that make the factor `through`.
    #[inline(always)]
    fn gather(&mut self, sampler: &PixelSampler, index: u32, (first, through): (Interaction, Vec3A), wo: Vec3A) {
        let mode = self.settings.bsdf;
        let (bsdfs, mut own) = (self.bsdfs, None);
        let bsdf = bsdf_of::<F>(bsdfs, &first, mode, &mut own);
        let split = Scatterer::<F>::new(&first, bsdf, wo, mode);
        if self.settings.skips.black_surfaces && split.is_black() {
            return;
        }
        let whole = Path::first(index, self.branches, self.lights);
        let part = |part, count| {
            let path = whole.part(part, count);
            if F::CLEAR { Path { beta: path.beta * through, ..path } } else { path }
        };
        if F::CLEAR {
            self.medium = Medium::AIR;
        }
        for light in 0..self.lights {
            self.sample_light(sampler, &part(light, self.lights), &first, (bsdf, &split), wo);
        }
        for branch in 0..self.branches {
            if F::CLEAR {
                self.medium = Medium::AIR;
            }
            if let Some((path, surface, wo)) = self.scatter(sampler, part(branch, self.branches), &first, (bsdf, &split), wo) {
                let before = self.radiance;
                self.follow(sampler, path, surface, wo);
                self.indirect += self.radiance - before;
            }
        }
    }

    /// The contributions of up to [`SHOTS`] shots, for light samples and paths separately: two of each behind every camera ray
    /// that hits a surface.
    pub fn probe(&mut self, shots: &[Shot]) -> Vec<Probe> {
        simd::run(Probes { tracer: self, shots })
    }

    #[inline(always)]
    fn find_probes(&mut self, shots: &[Shot]) -> Vec<Probe> {
        self.find_first(shots);
        self.points.expect(2 * shots.len() as u32);
        self.light_samples.expect(2 * shots.len() as u32);
        let mut probes = Vec::with_capacity(shots.len());
        for (place, shot) in shots.iter().enumerate().take(SHOTS) {
            let (ray, Some(hit)) = (self.rays[place], self.hits[place]) else { continue };
            let (first, wo) = (Interaction::new::<F>(self.scene, &ray, &hit, self.camera_cone), -ray.direction);
            let mode = self.settings.bsdf;
            let (bsdfs, mut own) = (self.bsdfs, None);
            let bsdf = bsdf_of::<F>(bsdfs, &first, mode, &mut own);
            let split = Scatterer::<F>::new(&first, bsdf, wo, mode);
            let whole = Path::first(shot.index, 2, 2);
            let mut probe = Probe::default();
            for part in 0..2 {
                let before = self.stats.rays();
                self.radiance = Vec3A::ZERO;
                self.sample_light(&shot.sampler, &whole.part(part, 2), &first, (bsdf, &split), wo);
                probe.light[part as usize] = self.radiance * 2.0;
                let between = self.stats.rays();
                self.radiance = Vec3A::ZERO;
                if F::CLEAR {
                    self.medium = Medium::AIR;
                }
                if let Some((path, surface, wo)) = self.scatter(&shot.sampler, whole.part(part, 2), &first, (bsdf, &split), wo) {
                    self.follow(&shot.sampler, path, surface, wo);
                }
                probe.path[part as usize] = self.radiance * 2.0;
                probe.light_rays += between - before;
                probe.path_rays += self.stats.rays() - between;
            }
            probes.push(probe);
        }
        probes
    }

    /// Continues from the second surface of a path.
    #[inline(always)]
    fn follow(&mut self, sampler: &PixelSampler, mut path: Path, mut surface: Interaction, mut wo: Vec3A) {
        let (mode, bsdfs) = (self.settings.bsdf, self.bsdfs);
        loop {
            let mut own = None;
            let bsdf = bsdf_of::<F>(bsdfs, &surface, mode, &mut own);
            let scatterer = Scatterer::<F>::new(&surface, bsdf, wo, mode);
            if self.settings.skips.black_surfaces && scatterer.is_black() {
                break;
            }
            self.sample_light(sampler, &path, &surface, (bsdf, &scatterer), wo);
            match self.scatter(sampler, path, &surface, (bsdf, &scatterer), wo) {
                Some(next) => (path, surface, wo) = next,
                None => break,
            }
        }
    }

    /// Draws the next direction of the path and adds the emission that it meets. `None` where the path ends.
    #[inline(always)]
    fn scatter(
        &mut self,
        sampler: &PixelSampler,
        mut path: Path,
        surface: &Interaction,
        (bsdf, scatterer): (&F::Bsdf, &Scatterer<'_, F>),
        wo: Vec3A,
    ) -> Option<(Path, Interaction, Vec3A)> {
        let scene = self.scene;
        let skips = self.settings.skips;
        let [u, v, lobe, survive] = self.points.point(sampler, path.index, 2 * path.vertex - 1);
        let scattered = scatterer.sample(lobe, [u, v])?;
        let wi = scattered.wi;
        path.beta *= scattered.weight;
        let gain = if F::CLEAR { self.medium.gain() } else { 1.0 };
        if path.beta == Vec3A::ZERO || !path.survives(survive, gain) {
            return None;
        }

        let (ray, medium) = if F::CLEAR {
            (surface.spawn_either(wi), self.medium.along(scene, surface, wi))
        } else {
            (surface.spawn(wi), Medium::AIR)
        };
        // The number of draws that were made with this density.
        let pdf = path.draws() * scattered.pdf;
        let last = path.vertex == self.settings.max_bounces;
        if last && !(F::FULL && scene.features().emitters) {
            // The path ends here, so only visibility matters, not the surface.
            let contribution = path.beta * self.environment_behind((wi, pdf), &path, surface, (bsdf, scatterer), wo);
            if contribution != Vec3A::ZERO || !skips.zero_contributions {
                self.stats.shadow_rays += 1;
                let (sight, share) = if skips.last_any_hit || F::CLEAR {
                    scene.sight::<F>(&ray, &mut self.scratch)
                } else {
                    let sight = match scene.trace_noting::<F>(&ray, &mut self.scratch) {
                        (Some(_), _) => Sight::Hidden,
                        (None, true) => Sight::Through,
                        (None, false) => Sight::Clear,
                    };
                    (sight, Vec3A::ONE)
                };
                let left = |light: Vec3A| if F::CLEAR { light * share * medium.over(f32::INFINITY) } else { light };
                match sight {
                    Sight::Hidden => {}
                    Sight::Clear => self.add_scattered(&path, left(contribution), Origin::Environment(wi)),
                    Sight::Through => {
                        let path = path.unreached();
                        let light = self.environment_behind((wi, pdf), &path, surface, (bsdf, scatterer), wo);
                        self.add_scattered(&path, left(path.beta * light), Origin::Environment(wi));
                    }
                }
            }
            return None;
        }
        self.stats.bounce_rays += 1;
        let (hit, through) = scene.trace_noting::<F>(&ray, &mut self.scratch);
        let (mut ray, mut hit, mut through, mut before) = (ray, hit, through, 0.0);
        if F::CLEAR {
            let straight = Straight::new(ray, hit, through).go_on::<F>(scene, &mut self.scratch);
            (ray, hit, through, before) = (straight.ray, straight.hit, straight.through, straight.before);
            path.beta *= straight.weight * medium.over(before + hit.map_or(f32::INFINITY, |hit| hit.t));
            self.medium = medium;
            if path.beta == Vec3A::ZERO {
                return None;
            }
        }
        let Some(hit) = hit else {
            let path = if through { path.unreached() } else { path };
            let contribution = path.beta * self.environment_behind((wi, pdf), &path, surface, (bsdf, scatterer), wo);
            self.add_scattered(&path, contribution, Origin::Environment(wi));
            return None;
        };
        let cone = surface.cone.scattered(scattered.pdf, self.shares);
        let (cone, distance) = if F::CLEAR { (cone.at(before), before + hit.t) } else { (cone, hit.t) };
        let next = Interaction::new::<F>(scene, &ray, &hit, cone);
        if F::FULL && next.emitted != Vec3A::ZERO {
            let met = if through { path.unreached() } else { path };
            let weight = self.emitter_weight((wi, pdf), &met, (surface, &next), (bsdf, scatterer), wo, distance);
            self.add_scattered(&path, path.beta * next.emitted * weight, Origin::Emitter);
        }
        if path.vertex == 1
            && let Some(casters) = self.casters
        {
            path.reach = casters.reach::<F>(scene, surface, (wo, wi), scattered.pdf);
        } else if self.casters.is_some() {
            path.reach *= light_paths::turned::<F>(surface, (bsdf, scatterer), (wo, wi)) / scattered.pdf;
        }
        if through {
            path = path.unreached();
        }
        path.vertex += 1;
        (!last).then_some((path, next, -wi))
    }

    /// Adds light that reached surface `path.vertex` from its light source.
    #[inline(always)]
    pub(super) fn add_scattered(&mut self, path: &Path, contribution: Vec3A, from: Origin) {
        if path.vertex == 1 {
            return self.add(contribution, from);
        }
        let largest = contribution.max_element() * path.branches;
        if largest > self.limit {
            self.stats.clamped_contributions += 1;
            return self.add(contribution * (self.limit / largest), from);
        }
        self.add(contribution, from);
    }
}

/// The BSDF at `surface`: the material's prepared BSDF where the material is constant, and otherwise `own`.
#[inline(always)]
pub(super) fn bsdf_of<'b, F: Features>(
    bsdfs: &'b [Option<Prepared>],
    surface: &Interaction,
    mode: Mode,
    own: &'b mut Option<F::Bsdf>,
) -> &'b F::Bsdf {
    match bsdfs.get(surface.material) {
        Some(Some(prepared)) => F::Bsdf::prepared(prepared),
        _ => own.insert(F::Bsdf::new(&surface.surface, mode)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::Compiled;
    use crate::verify::scenes::{Part, camera, compile, diffuse, metal, sunny};
    use glam::Affine3A;
    use renderflow_scenes::shapes::Shape;

    /// The value of a camera sample does not depend on the samples that its ray was traced with.
    #[test]
    fn shots_are_the_same_together_and_alone() {
        let ball = |x: f32, material| {
            Part::new(Shape::Sphere { radius: 0.7 }, material, Affine3A::from_translation(Vec3A::new(x, 0.0, 0.0).into()))
        };
        let parts = vec![ball(-0.6, diffuse([0.8, 0.5, 0.2])), ball(0.6, metal([0.9; 3], 0.2))];
        let scene = compile(parts, sunny(), camera([0.2, 1.5, 4.0], [0.0; 3], 45.0, 24, 16)).unwrap();
        let settings = Settings { spp: 16, ..Settings::default() };
        let shots: Vec<Shot> = (0..24 * 16)
            .flat_map(|at| (0..3).map(move |index| (at, index)))
            .map(|(at, index)| Shot {
                sampler: settings.random(&scene, (at % 24, at / 24), Some(settings.sharing(settings.camera_samples(), 2))),
                pixel: (at % 24, at / 24),
                index,
                count: 1 + at as u32 % 20,
                seen: at % 5 > 0,
            })
            .collect();
        let (mut together, mut alone) = (
            Tracer::<Compiled<false, false, false>>::new(&scene, &settings, None, 2),
            Tracer::<Compiled<false, false, false>>::new(&scene, &settings, None, 2),
        );
        let mut met = 0;
        for shots in shots.chunk_by(|a, b| a.seen == b.seen).flat_map(|run| run.chunks(SHOTS)) {
            together.aim(shots);
            for (k, shot) in shots.iter().enumerate() {
                let other = Shot { count: 3, ..*shot };
                alone.aim(&[other]);
                let (a, b) = (together.sample(k, shot), alone.sample(0, &other));
                met += usize::from(a.first.is_some());
                assert_eq!(a.radiance.to_array().map(f32::to_bits), b.radiance.to_array().map(f32::to_bits), "{:?}", shot.pixel);
                assert_eq!(a.first.map(|f| (f.albedo, f.ns)), b.first.map(|f| (f.albedo, f.ns)));
            }
        }
        assert!(met > 100 && met < shots.len(), "{met}");
        assert_eq!(together.into_stats(), alone.into_stats());
    }
}
