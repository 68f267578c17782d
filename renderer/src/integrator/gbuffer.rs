//! First hits of camera rays: the G-buffer at pixel centres, and guides over the pixel.

mod store;

use super::tracer::{SHOTS, camera_ray_at};
use super::visible::Visible;
use crate::accel::{Hit, Scratch};
use crate::camera::{Filter, Projector};
use crate::clear::{beyond, first_hit};
use crate::compile::{CompiledMaterial, RenderScene};
use crate::error::Result;
use crate::features::Features;
use crate::film::Film;
use crate::film::{FirstHit, GuideStatistics};
use crate::interaction::{Cone, Interaction};
use crate::ray::Ray;
use crate::sampler::Points;
use crate::schedule::{self, TILE, Tile};
use crate::settings::Settings;
use crate::simd;
use crate::stats::Stats;
use glam::{DVec2, Vec2, Vec3A};
use rayon::prelude::*;
use renderflow_frame::{Environment, Frame};
use std::sync::atomic::AtomicBool;
use store::{empty_frame, guide_normal, store, store_guides};

/// Largest difference between the unit normals at the centre and at a corner of a pixel that counts as plain.
const PLAIN_NORMALS: f32 = 0.25;
/// Shares of the centre and of each corner in the mean over a plain pixel: exact for polynomials of the third degree.
const CENTRE_SHARE: f32 = 2.0 / 3.0;
const CORNER_SHARE: f32 = 1.0 / 12.0;
/// Columns and rows of the spots in a pixel that shows a texture, and their number.
const GRID: usize = 3;
const SPOTS: usize = GRID * GRID;
/// The share of the pixel that textures are filtered over at each spot, one part of so many. Half of what a spot stands for is
/// best (docs/measurements/renderer-notes.md, gbuffer).
const SPOT_SHARES: u32 = 2 * SPOTS as u32;
/// Numbers of guide rays that the spots stand for: fewer rays take less time, and more know better.
const SPOTS_FOR: std::ops::RangeInclusive<u32> = SPOTS as u32 + 1..=32;
/// Guide rays a pixel below which asking whether it is plain does not pay.
const PLAIN_FROM: u32 = 4;

/// The G-buffer of one pixel, from the ray through its centre.
#[derive(Clone, Copy, Debug)]
struct Centre {
    albedo: [f32; 3],
    normal: [f32; 3],
    depth: f32,
    material: [f32; 3],
    transmittance: [f32; 3],
    through: [f32; 3],
    irradiance: [f32; 3],
    motion: [f32; 2],
    motion_prev: [f32; 2],
    object_id: u32,
    material_id: u32,
}

impl Centre {
    /// The environment is seen.
    const MISS: Self = Self {
        albedo: [0.0; 3],
        normal: [0.0; 3],
        depth: f32::INFINITY,
        material: [0.0; 3],
        transmittance: [0.0; 3],
        through: [0.0; 3],
        irradiance: [0.0; 3],
        motion: [0.0; 2],
        motion_prev: [0.0; 2],
        object_id: 0,
        material_id: 0,
    };
}

/// The cameras that motion vectors refer to.
struct Views {
    current: Projector,
    next: Option<(usize, Projector)>,
    previous: Option<(usize, Projector)>,
}

impl Views {
    fn new(scene: &RenderScene) -> Self {
        let at = |frame: usize| (frame, Projector::new(scene.camera_at(frame)));
        let frame = scene.frame();
        Self {
            current: at(frame).1,
            next: (frame + 1 < scene.frames()).then(|| at(frame + 1)),
            previous: frame.checked_sub(1).map(at),
        }
    }

    /// Motion of the point of `hit` in the image to the next frame, and to the previous frame.
    fn motion(&self, scene: &RenderScene, hit: &Hit) -> [[f32; 2]; 2] {
        // Both ends are projected from the same corners, so that a still point has exactly no motion.
        let here = self.current.project(scene.geometry.point_at(hit, scene.pose()));
        [&self.next, &self.previous].map(|view| {
            let motion = view.as_ref().and_then(|(frame, projector)| {
                let there = projector.project(scene.geometry.point_at(hit, scene.pose_at(*frame)))?;
                Some(there - here?)
            });
            motion.filter(|m: &DVec2| m.is_finite()).unwrap_or(DVec2::ZERO).as_vec2().to_array()
        })
    }
}

/// What the ray through a corner of a pixel sees, for the guides.
#[derive(Clone, Copy)]
enum Corner {
    Nothing,
    /// A material, and the shading normal without the normal map.
    Surface(usize, Vec3A),
    /// A hole is near, so the pixel may see both its edge and what lies behind.
    Holed,
}

/// What is known about the guides of a pixel from the rays through its centre and its corners.
#[derive(Clone, Copy)]
enum Kind {
    /// Guide rays must find out.
    Edge,
    /// Nothing, or one material without texture: the mean first hit.
    Plain(Option<FirstHit>),
    /// One material whose colour or normal differs from point to point.
    Textured(usize),
}

/// One pass over the camera rays of a frame.
struct Pass<'a> {
    scene: &'a RenderScene,
    settings: &'a Settings,
    visible: &'a Visible,
    /// The film whose camera rays the guides repeat.
    film: Option<&'a Film>,
    projector: Projector,
    views: Option<Views>,
    irradiance: Option<&'a Environment>,
    /// Whether any value at pixel centres is requested.
    centres: bool,
    /// Whether guides are requested.
    guides: bool,
    /// Whether anything has holes that come and go from point to point.
    holed: bool,
}

/// Centre and guides of a pixel.
type Pixel = (Centre, Option<GuideStatistics>);
/// Centres and guides of a tile.
type Pixels = Vec<Pixel>;
/// Bytes that a pixel takes until it is stored.
pub(super) const HELD: u64 = size_of::<Pixel>() as u64;

/// A tile of a pass, which one thread works on.
struct TilePass<'t, 'a, F: Features> {
    pass: &'t Pass<'a>,
    tile: Tile,
    scratch: Scratch,
    points: Points,
    stats: Stats,
    features: std::marker::PhantomData<F>,
}

impl<F: Features> simd::Work for TilePass<'_, '_, F> {
    type Output = (Pixels, Stats);
    #[inline(always)]
    fn run(mut self) -> (Pixels, Stats) {
        let pixels = self.pixels();
        (pixels, self.stats)
    }
}

impl<F: Features> TilePass<'_, '_, F> {
    #[inline(always)]
    fn pixels(&mut self) -> Pixels {
        let pass = self.pass;
        let seen: Vec<bool> = self.tile.pixels().map(|(x, y)| pass.visible.at(x, y)).collect();
        let any = seen.contains(&true);
        let plain = any && pass.asks_for_plain();
        let image_point = |(x, y): (usize, usize), offset: f32| Vec2::new(x as f32 + offset, y as f32 + offset);

        let mut hits = [None; TILE * TILE];
        let mut passed = [false; TILE * TILE];
        if any && (pass.centres || plain) {
            let points = self.tile.pixels().zip(&seen).map(|(at, &seen)| seen.then(|| image_point(at, 0.5)));
            self.look_at(points, (&mut hits, &mut passed));
        }
        let mut corners = [Corner::Nothing; (TILE + 1) * (TILE + 1)];
        let mut kinds = [Kind::Edge; TILE * TILE];
        let mut spots = [None; SPOTS * TILE * TILE];
        if plain {
            let asked: Vec<bool> = (0..seen.len()).map(|at| seen[at] && !passed[at] && self.is_even(hits[at].as_ref())).collect();
            self.look_at_corners(&asked, &mut corners);
            for at in (0..seen.len()).filter(|at| asked[*at]) {
                kinds[at] = self.kind(at, hits[at].as_ref(), &corners);
            }
            if F::TEXTURES && kinds.iter().any(|kind| matches!(kind, Kind::Textured(_))) {
                self.look_at_spots(&mut kinds[..seen.len()], &hits, &mut spots);
            }
        }

        let mut pixels = Pixels::with_capacity(seen.len());
        for (at, (x, y)) in self.tile.pixels().enumerate() {
            // No closures around these: they would not be inlined, and so be compiled for SSE2 with all that they call.
            let mut surface = None;
            if pass.centres
                && let Some(hit) = hits[at]
            {
                let ray = crate::camera::ray(pass.scene.camera(), image_point((x, y), 0.5));
                // One ray stands for the whole pixel here: textures are filtered over it, geometry is not.
                surface = Some((hit, Interaction::new::<F>(pass.scene, &ray, &hit, Cone::camera(pass.scene.camera(), 1))));
            }
            let mut guides = None;
            if pass.guides {
                let rays = pass.rays(y * pass.scene.camera().width + x);
                let found = guides.insert(GuideStatistics::default());
                match kinds[at] {
                    _ if !seen[at] => found.push_misses(rays.into()),
                    Kind::Plain(first) => found.push_alike(rays.into(), first),
                    Kind::Textured(_) => {
                        let first = self.mean_of_spots((x, y), &spots[SPOTS * at..SPOTS * (at + 1)]);
                        found.push_alike(rays.into(), Some(first));
                    }
                    Kind::Edge => self.push_guides((x, y), rays, found),
                }
            }
            let centre = match &surface {
                Some((hit, surface)) if pass.centres => self.centre((x, y), hit, surface),
                _ => Centre::MISS,
            };
            pixels.push((centre, guides));
        }
        pixels
    }

    /// The G-buffer where the ray through the centre of pixel (x, y) meets `surface`.
    #[inline(always)]
    fn centre(&mut self, (x, y): (usize, usize), hit: &Hit, surface: &Interaction) -> Centre {
        let pass = self.pass;
        let mut centre = pass.centre((x, y), hit, surface);
        if F::FULL && pass.sees_through() {
            let camera = pass.scene.camera();
            let ray = crate::camera::ray(camera, Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
            let beyond = beyond::<F>(pass.scene, &ray, hit, Cone::camera(camera, 1), &mut self.scratch);
            centre.transmittance = beyond.transmittance.to_array();
            centre.through = pass.projector.direction_to_camera(beyond.direction).normalize_or_zero().to_array();
        }
        centre
    }

    /// Traces the rays through image points of the tile, sixteen at a time: what they hit, and whether they pass holes.
    #[inline(always)]
    fn look_at(&mut self, points: impl Iterator<Item = Option<Vec2>>, (hits, passed): (&mut [Option<Hit>], &mut [bool])) {
        let scene = self.pass.scene;
        let mut rays = [(0, Ray::new(Vec3A::ZERO, Vec3A::Z)); SHOTS];
        let mut points = points.enumerate().filter_map(|(at, point)| Some((at, point?)));
        loop {
            let mut count = 0;
            for (slot, (at, point)) in rays.iter_mut().zip(points.by_ref()) {
                *slot = (at, crate::camera::ray(scene.camera(), point));
                count += 1;
            }
            if count == 0 {
                break;
            }
            let mut found = [None; SHOTS];
            let packet = rays.map(|(_, ray)| ray);
            let through = scene.trace_centres::<F>(&packet[..count], &mut found[..count], &mut self.scratch);
            self.stats.camera_rays += count as u64;
            for (k, ((at, _), hit)) in rays.iter().zip(found).take(count).enumerate() {
                hits[*at] = hit;
                passed[*at] = self.pass.holed && (through >> k) & 1 == 1;
            }
        }
    }

    /// Whether a pixel whose centre meets `hit` may do without guide rays: there are no holes in its material, and no texture
    /// unless spots can show it.
    #[inline(always)]
    fn is_even(&self, hit: Option<&Hit>) -> bool {
        let scene = self.pass.scene;
        hit.is_none_or(|hit| {
            let material = &scene.materials[scene.geometry.material(hit)];
            let varies = F::TEXTURES && material.varies();
            !varies || (material.alpha_mask.is_none() && SPOTS_FOR.contains(&self.pass.settings.guide_samples))
        })
    }

    /// Traces rays through the corners of the pixels that are `asked`; neighbours share theirs.
    #[inline(always)]
    fn look_at_corners(&mut self, asked: &[bool], corners: &mut [Corner]) {
        let (scene, tile) = (self.pass.scene, self.tile);
        let columns = tile.width + 1;
        let mut wanted = [false; (TILE + 1) * (TILE + 1)];
        for (at, _) in asked.iter().enumerate().filter(|(_, asked)| **asked) {
            let first = at / tile.width * columns + at % tile.width;
            for step in [0, 1, columns, columns + 1] {
                wanted[first + step] = true;
            }
        }
        let point = |at: usize| Vec2::new((tile.x + at % columns) as f32, (tile.y + at / columns) as f32);
        let count = columns * (tile.height + 1);
        let mut hits = [None; (TILE + 1) * (TILE + 1)];
        let mut passed = [false; (TILE + 1) * (TILE + 1)];
        self.look_at((0..count).map(|at| wanted[at].then(|| point(at))), (&mut hits, &mut passed));
        for (at, hit) in hits.iter().enumerate().take(count) {
            if passed[at] {
                corners[at] = Corner::Holed;
            } else if let Some(hit) = hit {
                let ray = crate::camera::ray(scene.camera(), point(at));
                corners[at] = Corner::Surface(scene.geometry.material(hit), Interaction::smooth_normal(scene, &ray, hit));
            }
        }
    }

    /// What the rays through the centre, which meets `hit`, and the corners of pixel `at` of the tile tell about it.
    #[inline(always)]
    fn kind(&self, at: usize, hit: Option<&Hit>, corners: &[Corner]) -> Kind {
        let (scene, tile) = (self.pass.scene, self.tile);
        let columns = tile.width + 1;
        let first = at / tile.width * columns + at % tile.width;
        let corners = [0, 1, columns, columns + 1].map(|step| corners[first + step]);
        let Some(hit) = hit else {
            let nothing = corners.iter().all(|corner| matches!(corner, Corner::Nothing));
            return if nothing { Kind::Plain(None) } else { Kind::Edge };
        };
        let point = Vec2::new((tile.x + at % tile.width) as f32 + 0.5, (tile.y + at / tile.width) as f32 + 0.5);
        let material = scene.geometry.material(hit);
        let centre = Interaction::smooth_normal(scene, &crate::camera::ray(scene.camera(), point), hit);
        let mut ns = centre * CENTRE_SHARE;
        for corner in corners {
            match corner {
                Corner::Surface(seen, normal)
                    if seen == material && normal.distance_squared(centre) < PLAIN_NORMALS * PLAIN_NORMALS =>
                {
                    ns += normal * CORNER_SHARE;
                }
                _ => return Kind::Edge,
            }
        }
        let material_there = &scene.materials[material];
        if F::TEXTURES && material_there.varies() {
            return Kind::Textured(material);
        }
        Kind::Plain(Some(FirstHit { albedo: material_there.surface.base_color, ns }))
    }

    /// Traces rays through the spots of the pixels that show a texture; the one in the middle is the centre. Where one meets
    /// something else, the pixel becomes an edge.
    #[inline(always)]
    fn look_at_spots(&mut self, kinds: &mut [Kind], centres: &[Option<Hit>], spots: &mut [Option<Hit>]) {
        let (scene, tile) = (self.pass.scene, self.tile);
        let point = |i: usize| {
            let (at, spot) = (i / SPOTS, i % SPOTS);
            spot_at((tile.x + at % tile.width, tile.y + at / tile.width), spot)
        };
        let mut passed = [false; SPOTS * TILE * TILE];
        let wanted = |i: usize| matches!(kinds[i / SPOTS], Kind::Textured(_)) && i % SPOTS != SPOTS / 2;
        let points = (0..SPOTS * kinds.len()).map(|i| wanted(i).then(|| point(i)));
        self.look_at(points, (spots, &mut passed));
        for (at, kind) in kinds.iter_mut().enumerate() {
            spots[SPOTS * at + SPOTS / 2] = centres[at];
            let Kind::Textured(material) = *kind else { continue };
            let same = |i: usize| !passed[i] && spots[i].as_ref().is_some_and(|hit| scene.geometry.material(hit) == material);
            if !(SPOTS * at..SPOTS * (at + 1)).all(same) {
                *kind = Kind::Edge;
            }
        }
    }

    /// Mean first hit over pixel (x, y) by what its spots meet.
    #[inline(always)]
    fn mean_of_spots(&self, (x, y): (usize, usize), hits: &[Option<Hit>]) -> FirstHit {
        let (scene, camera) = (self.pass.scene, self.pass.scene.camera());
        let cone = Cone::camera(camera, SPOT_SHARES);
        let mut sum = FirstHit { albedo: Vec3A::ZERO, ns: Vec3A::ZERO };
        for (spot, hit) in hits.iter().enumerate() {
            if let Some(hit) = hit {
                let first = Interaction::guide::<F>(scene, &crate::camera::ray(camera, spot_at((x, y), spot)), hit, cone);
                sum.albedo += first.albedo;
                sum.ns += first.ns;
            }
        }
        let share = 1.0 / SPOTS as f32;
        FirstHit { albedo: sum.albedo * share, ns: sum.ns * share }
    }

    /// Adds the first hits of the first `rays` guide rays of pixel (x, y).
    #[inline(always)]
    fn push_guides(&mut self, (x, y): (usize, usize), rays: u32, guides: &mut GuideStatistics) {
        let Pass { scene, settings, .. } = *self.pass;
        let random = settings.random(scene, (x, y), None);
        let mut shares = self.pass.shares(0);
        let mut cone = Cone::camera(scene.camera(), shares);
        let mut packet = [Ray::new(Vec3A::ZERO, Vec3A::Z); SHOTS];
        let mut hits = [None; SHOTS];
        for start in (0..rays).step_by(SHOTS) {
            let count = (rays - start).min(SHOTS as u32) as usize;
            for (index, ray) in (start..rays).zip(&mut packet) {
                *ray = camera_ray_at(scene, settings, self.points.point(&random, index, 0), (x, y));
            }
            scene.trace_all::<F>(&packet[..count], &mut hits[..count], &mut self.scratch);
            for ((index, ray), hit) in (start..rays).zip(&packet).zip(&hits).take(count) {
                let mut first = None;
                if let Some(hit) = hit {
                    let own = self.pass.shares(index);
                    if own != shares {
                        (shares, cone) = (own, Cone::camera(scene.camera(), own));
                    }
                    first = Some(first_hit::<F>(scene, ray, hit, cone, &mut self.scratch));
                }
                guides.push(first);
            }
        }
        self.stats.camera_rays += u64::from(rays);
    }
}

/// The image point of a spot of pixel (x, y).
#[inline(always)]
fn spot_at((x, y): (usize, usize), spot: usize) -> Vec2 {
    let part = |i: usize| (i as f32 + 0.5) / GRID as f32;
    Vec2::new(x as f32 + part(spot % GRID), y as f32 + part(spot / GRID))
}

impl Pass<'_> {
    /// The number of guide rays of a pixel. The guides of a film are the first hits of its own camera rays.
    fn rays(&self, at: usize) -> u32 {
        self.film.map_or(self.settings.guide_samples, |film| film.pixels[at].count() as u32)
    }

    /// The number of equal shares of the pixel of which the texture look-ups of guide ray `index` cover one.
    fn shares(&self, index: u32) -> u32 {
        let of_film = |_| self.settings.camera_shares(index * self.settings.branches());
        self.film.map_or(self.settings.guide_samples, of_film)
    }

    /// Whether anything can be seen through surfaces, and is requested.
    fn sees_through(&self) -> bool {
        let features = self.scene.features();
        self.settings.channels.gbuffer && (features.clear || features.blended)
    }

    /// Whether pixels are tested for being plain. With a filter wider than the pixel, its corners are not enough.
    fn asks_for_plain(&self) -> bool {
        let rays = self.settings.guide_samples;
        let sharp = self.settings.filter == Filter::Box && self.settings.lens.is_none();
        let possible = self.guides && self.film.is_none() && sharp;
        // Rays to centres and corners do not tell what blended and clear surfaces show.
        let features = self.scene.features();
        let possible = possible && !features.clear && !features.blended;
        possible && rays > PLAIN_FROM && self.settings.skips.plain_pixels
    }

    /// The G-buffer where the ray through the centre of pixel (x, y) meets `surface`.
    #[inline(always)]
    fn centre(&self, (x, y): (usize, usize), hit: &Hit, surface: &Interaction) -> Centre {
        let (scene, camera) = (self.scene, self.scene.camera());
        let instance = &scene.geometry.instances[surface.instance as usize];
        let motion = self.views.as_ref().map(|views| views.motion(scene, hit)).unwrap_or_default();
        Centre {
            albedo: surface.surface.base_color.to_array(),
            normal: self.projector.direction_to_camera(surface.ns).normalize().to_array(),
            // The unnormalised camera direction has length 1 along the view, so its length converts distance to planar depth.
            depth: hit.t / camera.direction_cam(Vec2::new(x as f32 + 0.5, y as f32 + 0.5)).length(),
            material: [surface.surface.roughness, surface.surface.metallic, surface.surface.specular],
            transmittance: [0.0; 3],
            through: [0.0; 3],
            irradiance: self.irradiance.map_or([0.0; 3], |map| map.radiance(surface.ns)),
            motion: motion[0],
            motion_prev: motion[1],
            object_id: instance.object_id,
            material_id: instance.material as u32 + 1,
        }
    }
}

/// Where coverage and guides come from.
#[derive(Clone, Copy)]
pub(super) enum GuidesFrom<'a> {
    /// Camera rays of their own.
    Rays,
    /// The camera rays of a film.
    Film(&'a Film),
    /// Nowhere: they stay empty until [`fill_guides`].
    Later,
}

/// Fills coverage and guides of a frame from the camera rays of `film`.
pub(super) fn fill_guides(frame: &mut Frame, scene: &RenderScene, film: &Film) {
    let projector = Projector::new(scene.camera());
    let guides = &film.guides;
    frame.alpha.pixels = guides.par_iter().map(GuideStatistics::coverage).collect();
    if let Some(image) = &mut frame.guide_albedo {
        image.pixels = guides.par_iter().map(GuideStatistics::albedo).collect();
    }
    if let Some(image) = &mut frame.guide_normal {
        image.pixels = guides.par_iter().map(|guides| guide_normal(guides, &projector)).collect();
    }
}

/// The frame with its G-buffer at pixel centres. Pictures that are not requested stay empty, and no ray is traced for them.
pub(super) fn frame<F: Features>(
    scene: &RenderScene,
    settings: &Settings,
    visible: &Visible,
    from: GuidesFrom<'_>,
    cancel: &AtomicBool,
) -> Result<(Frame, Stats)> {
    let film = if let GuidesFrom::Film(film) = from { Some(film) } else { None };
    let (width, height) = (scene.camera().width, scene.camera().height);
    let wanted = settings.channels;
    let projector = Projector::new(scene.camera());
    let mut frame = empty_frame(scene, settings);
    let mut stats = Stats::default();
    let kept = film.filter(|_| settings.skips.shared_guides);
    if let Some(film) = kept {
        fill_guides(&mut frame, scene, film);
    }
    let centres = wanted.gbuffer || wanted.motion || settings.irradiance;
    if !centres && kept.is_some() {
        return Ok((frame, stats));
    }
    let views = wanted.motion.then(|| Views::new(scene));
    let irradiance = settings.irradiance.then(|| scene.light().irradiance_map());
    let has_holes = |material: &CompiledMaterial| material.alpha_mask.is_some() && material.varies();
    let holed = scene.geometry.instances.iter().any(|instance| has_holes(&scene.materials[instance.material]));
    let guides = kept.is_none() && !matches!(from, GuidesFrom::Later);
    let pass = Pass { scene, settings, visible, film, projector, views, irradiance, centres, guides, holed };
    let work = |tile: Tile| {
        let (scratch, points, stats) = Default::default();
        simd::run(TilePass::<F> { pass: &pass, tile, scratch, points, stats, features: std::marker::PhantomData })
    };
    schedule::for_tiles((width, height), 1, &|_, _| (), cancel, work, |tile, (pixels, tile_stats)| {
        stats += tile_stats;
        for ((x, y), (centre, guides)) in tile.pixels().zip(pixels) {
            let at = y * width + x;
            store(&mut frame, at, &centre);
            if let Some(guides) = guides {
                store_guides(&mut frame, at, &guides, &projector);
            }
        }
    })?;
    Ok((frame, stats))
}
