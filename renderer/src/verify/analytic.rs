//! Scenes whose picture is known on paper, rendered by every integrator with every sampler.
//!
//! A pixel's error is its value less the one on paper. Pixels draw independent samples, so the mean error over a picture must
//! keep within four of its standard errors, found from the scatter of the pixels themselves, plus a stated bias where the scene
//! is only an approximation of the one on paper (a faceted sphere, a sky of texels, a mirror of finite sharpness).

mod emission;
mod punctual;

use super::scenes::{self, Part};
use super::{Check, Effort, Outcome, Ticker, Worst};
use crate::compile::RenderScene;
use crate::integrator;
use crate::light::Sampling;
use crate::sampler::Sampler;
use crate::settings::{Budget, DirectLight, Settings};
use glam::{Affine3A, DVec3, Quat, Vec2, Vec3, Vec3A};
use renderflow_frame::{Camera, Environment, Frame};
use renderflow_scenes::loaded::PunctualLight;
use renderflow_scenes::shapes::Shape;
use renderflow_scenes::{LoadedScene, Mesh, Texture};

/// Checks of this file.
pub const CHECKS: &[Check] = &[
    Check {
        name: "analytic.path",
        about: "path-traced scenes with a closed form: mean error within 4 standard errors, for every way to find light and every sampler",
        run: path,
    },
    Check {
        name: "analytic.ibl",
        about: "split-sum shading where it is exact (convex diffuse bodies): mean error below 1 %",
        run: ibl,
    },
];

/// Standard errors that a mean may be off.
const ERRORS: f64 = 4.0;
/// Rounding of single precision along a path, relative.
const ROUNDING: f64 = 1e-5;
/// Edge of the pictures in pixels.
const EDGE: usize = 24;

/// What a pixel shows on paper, `None` for pixels left out.
type Paper = Box<dyn Fn(&Shot<'_>, usize, usize) -> Option<DVec3> + Send + Sync>;

/// A scene and its picture on paper.
struct Case {
    name: String,
    parts: Vec<Part>,
    textures: Vec<Texture>,
    lights: Vec<PunctualLight>,
    environment: Environment,
    camera: Camera,
    max_bounces: u32,
    paper: Paper,
    /// Relative error that the approximations of the scene may cause.
    bias: f64,
    /// Whether the split sum has the same answer.
    ibl: bool,
    /// Whether light samples alone are not hopelessly noisy: nothing is smoother than a roughness of 0.3, and no light touches
    /// what it lights (there the variance is infinite).
    lights_alone: bool,
    /// Whether scattering alone is not: light comes from more than 1 % of the directions.
    scattering_alone: bool,
}

/// A rendered frame with what papers ask of it.
struct Shot<'a> {
    frame: &'a Frame,
    camera: &'a Camera,
}

impl Shot<'_> {
    fn at(&self, x: usize, y: usize) -> usize {
        y * self.frame.width + x
    }

    /// Share of the pixel that shows the scene.
    fn coverage(&self, x: usize, y: usize) -> f64 {
        self.frame.alpha.pixels[self.at(x, y)].into()
    }

    /// Mean world-space normal over the samples that hit the scene, times their share.
    fn normal(&self, x: usize, y: usize) -> DVec3 {
        let normal = self.frame.guide_normal.as_ref().map_or([0.0; 3], |i| i.pixels[self.at(x, y)]);
        (self.camera.camera_to_world.matrix3 * Vec3A::from_array(normal)).as_dvec3()
    }

    /// World-space direction through the middle of a pixel.
    fn direction(&self, x: usize, y: usize) -> DVec3 {
        self.camera.ray_direction(Vec2::new(x as f32 + 0.5, y as f32 + 0.5)).as_dvec3()
    }

    /// World-space point that the middle of a pixel shows.
    fn point(&self, x: usize, y: usize) -> DVec3 {
        let depth = self.frame.depth.pixels[self.at(x, y)];
        self.camera.unproject(Vec2::new(x as f32 + 0.5, y as f32 + 0.5), depth).as_dvec3()
    }
}

/// The same value in every fully covered pixel.
fn everywhere(value: DVec3) -> Paper {
    Box::new(move |shot, x, y| (shot.coverage(x, y) == 1.0).then_some(value))
}

const LIGHT: DVec3 = DVec3::new(0.5, 1.0, 2.0);
const ALBEDO: DVec3 = DVec3::new(0.8, 0.5, 0.25);

fn rgb(v: DVec3) -> [f32; 3] {
    v.as_vec3().to_array()
}

/// The same radiance from everywhere but for every other texel, which is a trifle brighter, and the rest, which is as much
/// darker: no longer "flat", so that light sampling runs.
fn nearly_flat(radiance: DVec3) -> Environment {
    let mut environment = scenes::environment(128, 64, |_| [0.0; 3]);
    for (i, texel) in environment.map.pixels.iter_mut().enumerate() {
        *texel = rgb(radiance * if (i % 128 + i / 128) % 2 == 0 { 1.00005 } else { 0.99995 });
    }
    environment
}

/// Radiance `LIGHT (1 + y / 2)`: irradiance on a normal n is `pi LIGHT (1 + n.y / 3)`.
fn linear_sky() -> Environment {
    scenes::environment(512, 256, |d| rgb(LIGHT * f64::from(1.0 + 0.5 * d.y)))
}

/// `LIGHT` from one half of the sky, nothing from the other. The edge between the halves lies between texels, where the map runs
/// linearly from one to the other, the same on both sides.
fn half_sky(lit: impl Fn(Vec3A) -> bool) -> Environment {
    scenes::environment(512, 256, |d| if lit(d) { rgb(LIGHT) } else { [0.0; 3] })
}

fn sphere() -> Shape {
    Shape::Sphere { radius: 1.0 }
}

fn view(height: f32) -> Camera {
    scenes::camera([0.3, height, 4.0], [0.0; 3], 40.0, EDGE, EDGE)
}

/// A view of nothing but the middle of the plane y = 0.
fn plane_view() -> Camera {
    scenes::camera([0.0, 5.0, 5.0], [0.0; 3], 30.0, EDGE, EDGE)
}

/// The inside of a sphere of radius 1 whose top, above the polar angle `opening`, is missing.
fn bowl(opening: f64) -> Mesh {
    let (rings, segments) = (160_u32, 320_u32);
    let mut mesh = Mesh { name: "bowl".into(), ..Mesh::default() };
    for i in 0..=rings {
        let theta = opening + (std::f64::consts::PI - opening) * f64::from(i) / f64::from(rings);
        for j in 0..segments {
            let phi = std::f64::consts::TAU * f64::from(j) / f64::from(segments);
            mesh.positions.push(DVec3::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin()).as_vec3());
        }
    }
    for i in 0..rings {
        for j in 0..segments {
            let next = (j + 1) % segments;
            let [a, b, c, d] = [i * segments + j, i * segments + next, (i + 1) * segments + j, (i + 1) * segments + next];
            mesh.triangles.push([a, c, b]);
            if i + 1 < rings {
                mesh.triangles.push([b, c, d]);
            }
        }
    }
    mesh
}

/// A case with neither bias nor textures.
fn plain(name: &str, parts: Vec<Part>, environment: Environment, camera: Camera, paper: Paper) -> Case {
    Case {
        name: name.into(),
        lights_alone: parts.iter().all(|p| p.material.surface.metallic == 0.0 || p.material.surface.roughness >= 0.3),
        parts,
        textures: Vec::new(),
        lights: Vec::new(),
        environment,
        camera,
        max_bounces: 4,
        paper,
        bias: 0.0,
        ibl: false,
        scattering_alone: true,
    }
}

/// A diffuse square of edge `size` in the plane y = 0.
fn ground_of(size: f32, albedo: DVec3) -> Part {
    Part::new(Shape::Plane { size }, scenes::diffuse(rgb(albedo)), Affine3A::IDENTITY)
}

fn flat(radiance: DVec3) -> Environment {
    Environment::constant(rgb(radiance))
}

/// Every scene with its answer.
fn cases() -> Vec<Case> {
    let body = |material| vec![Part::new(sphere(), material, Affine3A::IDENTITY).flat()];
    let ground = |albedo| vec![ground_of(1000.0, albedo)];
    let mut all = Vec::new();

    // A convex body sees no part of itself: a diffuse one reflects albedo times light, a white metal all of it.
    for (sky, environment) in [("flat", flat(LIGHT)), ("sampled", nearly_flat(LIGHT))] {
        let bias = if sky == "flat" { 0.0 } else { 1e-4 };
        all.push(Case {
            bias,
            ibl: true,
            ..plain(
                &format!("diffuse sphere, {sky} sky"),
                body(scenes::diffuse(rgb(ALBEDO))),
                environment.clone(),
                view(1.0),
                everywhere(ALBEDO * LIGHT),
            )
        });
        for roughness in [0.0, 0.1, 0.4, 1.0] {
            // Compensation for multiple scattering closes the furnace within 0.5 %.
            all.push(Case {
                bias: 5e-3,
                ..plain(
                    &format!("white metal sphere of roughness {roughness}, {sky} sky"),
                    body(scenes::metal([1.0; 3], roughness)),
                    environment.clone(),
                    view(1.0),
                    everywhere(LIGHT),
                )
            });
        }
        all.push(Case {
            bias,
            ibl: true,
            ..plain(
                &format!("diffuse plane, {sky} sky"),
                ground(ALBEDO),
                environment.clone(),
                plane_view(),
                everywhere(ALBEDO * LIGHT),
            )
        });
        // White surfaces under a white sky are as bright as the sky, however often light passes between them.
        let white = || scenes::diffuse([1.0; 3]);
        let at = |x, y| Affine3A::from_translation(Vec3::new(x, y, 0.0));
        let room = vec![
            Part::new(Shape::Plane { size: 4.0 }, white(), Affine3A::IDENTITY),
            Part::new(sphere(), white(), at(-0.9, 1.0)).flat(),
            Part::new(sphere(), white(), at(1.15, 1.0)).flat(),
        ];
        let look = scenes::camera([0.0, 2.0, 5.0], [0.0, 0.7, 0.0], 40.0, EDGE, EDGE);
        let paper: Paper = Box::new(|_, _, _| Some(LIGHT));
        all.push(Case {
            max_bounces: 400,
            bias: 1e-4,
            ..plain(&format!("white things, {sky} sky"), room, environment, look, paper)
        });
    }

    // Irradiance of half a sky is half that of the whole where the plane is square to the edge between the halves ...
    all.push(Case {
        bias: 2e-4,
        ibl: true,
        ..plain(
            "diffuse plane, half a sky",
            ground(ALBEDO),
            half_sky(|d| d.x > 0.0),
            plane_view(),
            everywhere(0.5 * ALBEDO * LIGHT),
        )
    });
    // ... and (1 + cos) / 2 of it where it is tilted from it.
    for degrees in [30.0_f32, 75.0, 120.0] {
        let turn = Quat::from_rotation_x(degrees.to_radians());
        let parts = vec![Part::new(Shape::Plane { size: 1000.0 }, scenes::diffuse(rgb(ALBEDO)), Affine3A::from_quat(turn))];
        let eye = (turn * Vec3::new(0.0, 5.0, 5.0)).to_array();
        let share = 0.5 * (1.0 + f64::from(degrees).to_radians().cos());
        all.push(Case {
            bias: 1e-3,
            // The split sum's small irradiance map is up to 1.2 % too bright where only the rim of a surface's sky is lit.
            ibl: false,
            ..plain(
                &format!("diffuse plane tilted {degrees} degrees, upper half of the sky"),
                parts,
                half_sky(|d| d.y > 0.0),
                scenes::camera(eye, [0.0; 3], 30.0, EDGE, EDGE),
                everywhere(share * ALBEDO * LIGHT),
            )
        });
    }
    // Irradiance of a sky linear in y is linear in the normal: exact for mean normals too.
    let by_normal: Paper =
        Box::new(|shot, x, y| (shot.coverage(x, y) == 1.0).then(|| ALBEDO * LIGHT * (1.0 + shot.normal(x, y).y / 3.0)));
    all.push(Case {
        bias: 1e-4,
        ibl: true,
        ..plain("diffuse sphere, linear sky", body(scenes::diffuse(rgb(ALBEDO))), linear_sky(), view(0.5), by_normal)
    });
    all.push(Case {
        bias: 1e-4,
        ibl: true,
        ..plain("diffuse plane, linear sky", ground(ALBEDO), linear_sky(), plane_view(), everywhere(ALBEDO * LIGHT * (4.0 / 3.0)))
    });
    // A mirror shows the sky in the mirrored direction.
    let mirrored: Paper = Box::new(|shot, x, y| Some(LIGHT * (1.0 - 0.5 * shot.direction(x, y).y)));
    let mirror = vec![Part::new(Shape::Plane { size: 1000.0 }, scenes::metal([1.0; 3], 0.0), Affine3A::IDENTITY)];
    all.push(Case { bias: 3e-3, ..plain("mirror, linear sky", mirror, linear_sky(), plane_view(), mirrored) });

    // A sun of four texels, its irradiance summed over the map as it is interpolated.
    let (sun, irradiance) = small_sun();
    let paper = everywhere(ALBEDO * irradiance / std::f64::consts::PI);
    all.push(Case {
        bias: 5e-4,
        scattering_alone: false,
        ..plain("diffuse plane, small sun", ground(ALBEDO), sun, plane_view(), paper)
    });

    // A black disc above the plane hides its form factor's share of the sky.
    for (radius, height) in [(1.0_f64, 1.0_f64), (3.0, 1.0), (0.5, 2.0)] {
        // Not the large plane: rays leave a surface at a distance that grows with its triangles, 4e-4 m there.
        let plane = Shape::Plane { size: 10.0 };
        let mut parts = vec![Part::new(plane, scenes::diffuse(rgb(ALBEDO)), Affine3A::IDENTITY)];
        let place = Affine3A::from_translation(Vec3::new(0.0, height as f32, 0.0));
        parts.push(Part { mesh: disc(radius), material: scenes::diffuse([0.0; 3]), transform: place });
        for (sky, environment) in [("flat", flat(LIGHT)), ("sampled", nearly_flat(LIGHT))] {
            let eye = [0.0, 0.5 * height as f32, 0.2 * radius as f32];
            let paper: Paper =
                Box::new(move |shot, x, y| Some(ALBEDO * LIGHT * (1.0 - disc_share(shot.point(x, y), radius, height))));
            let look = scenes::camera(eye, [0.0; 3], 8.0, EDGE, EDGE);
            let name = format!("plane below a black disc of radius {radius} at height {height}, {sky} sky");
            all.push(Case { bias: 2e-4, ..plain(&name, parts.clone(), environment, look, paper) });
        }
    }

    // Integrating sphere: from anywhere inside, wall and opening fill the view by their shares of the sphere's area, so that with
    // the opening's share f and albedo a the wall shows L = a (f L_sky + (1 - f) L).
    for (opening, albedo) in [(1.0_f64, 0.5), (0.6, 0.8), (0.4, 0.95)] {
        let share = 0.5 * (1.0 - opening.cos());
        let wall = LIGHT * (albedo * share / (1.0 - albedo * (1.0 - share)));
        for (sky, environment) in [("flat", flat(LIGHT)), ("sampled", nearly_flat(LIGHT))] {
            let material = scenes::diffuse([albedo as f32; 3]);
            let parts = vec![Part { mesh: bowl(opening), material, transform: Affine3A::IDENTITY }];
            let look = scenes::camera([0.1, -0.2, 0.3], [0.4, -0.9, -0.2], 50.0, EDGE, EDGE);
            let name = format!("inside of a bowl open to {:.1} % with albedo {albedo}, {sky} sky", 100.0 * share);
            all.push(Case { max_bounces: 1000, bias: 5e-4, ..plain(&name, parts, environment, look, everywhere(wall)) });
        }
    }
    all.extend(emission::cases());
    all.extend(punctual::cases());
    all
}

/// A black sky but for a sun of four texels, turned, and the irradiance on level ground.
fn small_sun() -> (Environment, DVec3) {
    let mut environment = Environment { rotation: 0.3, ..scenes::environment(128, 64, |_| [0.0; 3]) };
    for (x, y) in [(40, 12), (41, 12), (40, 13), (41, 13)] {
        environment.map.pixels[y * 128 + x] = [900.0, 800.0, 600.0];
    }
    let (columns, rows) = (2048_u32, 1024_u32);
    let mut irradiance = DVec3::ZERO;
    for j in 0..rows / 2 {
        let theta = std::f64::consts::PI * (f64::from(j) + 0.5) / f64::from(rows);
        let solid_angle = theta.sin() * std::f64::consts::PI / f64::from(rows) * std::f64::consts::TAU / f64::from(columns);
        for i in 0..columns {
            let uv = Vec2::new((i as f32 + 0.5) / columns as f32, (j as f32 + 0.5) / rows as f32);
            irradiance += Vec3A::from(environment.radiance(environment.direction(uv))).as_dvec3() * (theta.cos() * solid_angle);
        }
    }
    (environment, irradiance)
}

/// A disc in the plane y = 0 with the area of a circle of `radius`.
fn disc(radius: f64) -> Mesh {
    let n = 512_u32;
    let step = std::f64::consts::TAU / f64::from(n);
    let r = radius * (step / step.sin()).sqrt();
    let mut mesh = Mesh { name: "disc".into(), positions: vec![Vec3::ZERO], ..Mesh::default() };
    mesh.positions.extend((0..n).map(|i| {
        let (sin, cos) = (f64::from(i) * step).sin_cos();
        DVec3::new(r * cos, 0.0, r * sin).as_vec3()
    }));
    mesh.triangles.extend((0..n).map(|i| [0, 1 + i, 1 + (i + 1) % n]));
    mesh
}

/// Form factor from a patch of the plane y = 0 at `p` to a disc parallel to it around the y axis (Howell, A Catalog of Radiation
/// Heat Transfer Configuration Factors, B-13), multiplied through with the patch's squared distance from the axis.
fn disc_share(p: DVec3, radius: f64, height: f64) -> f64 {
    let (s2, h2, r2) = (p.x * p.x + p.z * p.z, height * height, radius * radius);
    let z = s2 + h2 + r2;
    0.5 * (1.0 - (z - 2.0 * r2) / (z * z - 4.0 * s2 * r2).sqrt())
}

/// Settings that must all have the same answer.
fn variants() -> Vec<(String, Settings)> {
    let directs = [DirectLight::Mis, DirectLight::Scattering, DirectLight::Lights];
    let both = |direct| [Sampler::Sobol, Sampler::Independent].map(|sampler| Settings { direct, sampler, ..Settings::default() });
    let even = directs.into_iter().flat_map(both).map(|s| (format!("{:?}, {:?}", s.direct, s.sampler), s));
    // The noisiest way shows best whether counts depend on what they average.
    let spread = [DirectLight::Mis, DirectLight::Scattering].into_iter().flat_map(both);
    let spread = spread.map(|s| Settings { budget: Budget::Average, ..s });
    even.chain(spread.map(|s| (format!("{:?}, {:?}, adaptive", s.direct, s.sampler), s))).collect()
}

impl Case {
    /// Whether noise would hide any error.
    fn hopeless(&self, direct: DirectLight) -> bool {
        match direct {
            DirectLight::Mis => false,
            DirectLight::Scattering => !self.scattering_alone,
            DirectLight::Lights => !self.lights_alone,
        }
    }

    fn compile(&self, sampling: Sampling) -> Result<RenderScene, String> {
        let scene = scenes::scene(self.parts.clone(), self.textures.clone(), self.environment.clone(), self.camera);
        let scene = LoadedScene { lights: self.lights.clone(), ..scene };
        let mut scene = RenderScene::compile(&scene).map_err(|e| e.to_string())?;
        scene.set_environment_sampling(sampling).map_err(|e| e.to_string())?;
        Ok(scene)
    }
}

/// What one rendered case says about its paper.
struct Verdict {
    /// Mean error as a share of what is allowed, worst channel.
    error: f64,
    /// Scatter of the pixels' errors over the variance they claim, worst channel.
    scatter: f64,
    /// Mean error and its standard error of the worst channel, both relative to the mean on paper.
    relative: [f64; 2],
    pixels: usize,
}

/// Compares a frame's `image` with the paper; `noise` allows four standard errors beside the case's bias.
fn compare(case: &Case, frame: &Frame, image: &[[f32; 3]], noise: bool, bias: f64) -> Verdict {
    let shot = Shot { frame, camera: &case.camera };
    let mut verdict = Verdict { error: 0.0, scatter: 0.0, relative: [0.0; 2], pixels: 0 };
    let mut errors = Vec::new();
    let (mut paper, mut claimed) = (DVec3::ZERO, DVec3::ZERO);
    for (x, y) in (0..frame.height).flat_map(|y| (0..frame.width).map(move |x| (x, y))) {
        let Some(expected) = (case.paper)(&shot, x, y) else { continue };
        let at = shot.at(x, y);
        errors.push(DVec3::from(image[at].map(f64::from)) - expected);
        paper += expected;
        claimed += frame.variance.as_ref().map_or(DVec3::ZERO, |v| DVec3::from(v.pixels[at].map(f64::from)));
    }
    verdict.pixels = errors.len();
    if errors.len() < 30 {
        verdict.error = f64::INFINITY;
        return verdict;
    }
    let n = errors.len() as f64;
    let mean = errors.iter().sum::<DVec3>() / n;
    let spread = errors.iter().map(|e| (e - mean) * (e - mean)).sum::<DVec3>() / (n - 1.0);
    let (paper, claimed) = (paper / n, claimed / n);
    for c in 0..3 {
        let standard_error = (spread[c] / n).sqrt();
        let systematic = (bias + ROUNDING) * paper[c].abs();
        let allowed = systematic + if noise { ERRORS * standard_error } else { 0.0 };
        // Where black is expected, exactly black is.
        let error = if mean[c] == 0.0 { 0.0 } else { mean[c].abs() / allowed };
        // A NaN must win here.
        if error.is_nan() || error > verdict.error {
            verdict.error = error;
            verdict.relative = [mean[c] / paper[c], standard_error / paper[c]];
        }
        verdict.scatter = verdict.scatter.max(spread[c] / (claimed[c] + systematic * systematic).max(f64::MIN_POSITIVE));
    }
    verdict
}

fn path(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    // The usual settings are tried hardest.
    let spp = |s: &Settings| if *s == Settings::default() { effort.pick(64, 1024) } else { effort.pick(32, 256) };
    let (cases, variants) = (cases(), variants());
    let rendered = |case: &Case| variants.iter().filter(|(_, settings)| !case.hopeless(settings.direct)).count() as u64;
    ticker.expect(cases.iter().map(rendered).sum());
    let (mut means, mut scatter, mut lost) = (Worst::default(), Worst::default(), Worst::default());
    for case in &cases {
        let (usual, plain) = (case.compile(Sampling::default()), case.compile(Sampling::Plain));
        for (variant, settings) in variants.iter().filter(|(_, settings)| !case.hopeless(settings.direct)) {
            // Light samples alone must be drawn wherever light comes from.
            let scene = if settings.direct == DirectLight::Lights { &plain } else { &usual };
            let settings = Settings { spp: spp(settings), max_bounces: case.max_bounces, ..*settings };
            let name = || format!("{}, {variant}", case.name);
            let rendered = scene.as_ref().map_err(Clone::clone).and_then(|scene| render(scene, &settings, ticker));
            if ticker.cancelled() {
                return Vec::new();
            }
            match rendered {
                Ok((frame, non_finite)) => {
                    let image = frame.beauty.as_ref().map_or(&[][..], |i| &i.pixels);
                    let found = compare(case, &frame, image, true, case.bias);
                    let told = |what: &str| {
                        let [mean, error] = found.relative;
                        format!(
                            "{}: {what}, mean off by {mean:+.2e}, standard error {error:.1e}, {} pixels",
                            name(),
                            found.pixels
                        )
                    };
                    means.see(found.error, || told("mean"));
                    scatter.see(found.scatter, || told("scatter"));
                    lost.see(non_finite as f64, name);
                }
                Err(reason) => means.see(f64::INFINITY, || format!("{}: {reason}", name())),
            }
            ticker.add(1);
        }
    }
    vec![
        means.at_most("mean error, share of 4 standard errors and the scene's own bias", 1.0),
        // 4 standard errors of the estimate of a variance from 200 pixels.
        scatter.at_most("scatter of pixels over the variance they claim", 1.4),
        lost.at_most("samples that were not finite", 0.0),
    ]
}

fn render(scene: &RenderScene, settings: &Settings, ticker: &Ticker<'_>) -> Result<(Frame, u64), String> {
    let rendered = integrator::render_with_stats(scene, settings, &|_, _| (), ticker.cancel());
    rendered.map(|(frame, stats)| (frame, stats.non_finite_samples)).map_err(|e| e.to_string())
}

fn ibl(effort: Effort, ticker: &Ticker<'_>) -> Vec<Outcome> {
    // Most of the time goes into the tables of each environment.
    let mut cases: Vec<Case> = cases().into_iter().filter(|c| c.ibl).step_by(effort.pick(2, 1)).collect();
    // The split sum knows no material without a coat: the roughest has the faintest, 0.5 % of the light.
    cases.iter_mut().flat_map(|c| &mut c.parts).for_each(|p| p.material.surface.roughness = 1.0);
    ticker.expect(cases.len() as u64);
    let mut means = Worst::default();
    for case in &cases {
        if ticker.cancelled() {
            break;
        }
        let settings = Settings { guide_samples: 1024, ..Settings::default() };
        let frame = scenes::compile(case.parts.clone(), case.environment.clone(), case.camera)
            .and_then(|scene| integrator::ibl::render(&scene, &settings).map_err(|e| e.to_string()));
        match frame {
            Ok(frame) => {
                let image = frame.beauty.as_ref().map_or(&[][..], |i| &i.pixels);
                let found = compare(case, &frame, image, false, 1e-2);
                means.see(found.error, || format!("{}: mean off by {:+.2e}", case.name, found.relative[0]));
            }
            Err(reason) => means.see(f64::INFINITY, || format!("{}: {reason}", case.name)),
        }
        ticker.add(1);
    }
    vec![means.at_most("mean error, share of 1 %", 1.0)]
}
