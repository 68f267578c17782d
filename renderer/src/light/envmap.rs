//! Light from the environment map, drawn in proportion to what it emits.

use super::distribution::{Grid, sample_linear};
use crate::angle::{polar, sin_cos_turns};
use crate::error::{Error, Result};
use crate::number::whole;
use crate::sampler::LANES;
use glam::{Vec3A, Vec4};
use rayon::prelude::*;
use renderflow_frame::Environment;
use renderflow_frame::environment::atan2;
use std::f32::consts::{FRAC_1_PI, TAU};

/// Largest radiance of a texel, gain applied; brighter components are limited to it and counted. The 6 orders of magnitude up to
/// the largest float are room for the products of a path: a sharp lobe's density (up to 3e5) and sums of samples.
pub const MAX_RADIANCE: f32 = 1e32;
/// Light whose brightest component is fainter than this is none: its inverse would not be finite.
const MIN_RADIANCE: f32 = 1e-37;

/// What the density of light samples is proportional to. The estimate with multiple importance sampling has the same mean for
/// all; only [`Sampling::Plain`] is unbiased without it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Sampling {
    /// Radiance: positive wherever there is light.
    Plain,
    /// Radiance above the mean of the sphere, 0 elsewhere (Karlik et al. 2019, "MIS Compensation", section 5.1). The faint
    /// directions are left to samples of the material, which is dense there: every material has a diffuse or specular lobe over
    /// the whole hemisphere. For mirror-like lobes nothing changes: their samples carry the weight either way.
    ///
    /// The error is less than that of `Plain` on most scenes (docs/measurements/renderer-notes.md, compensation).
    #[default]
    Compensated,
}

impl Sampling {
    /// Share of the mean of the sphere that is taken off.
    fn share(self) -> f32 {
        match self {
            Self::Plain => 0.0,
            Self::Compensated => 1.0,
        }
    }
}

/// A direction towards the environment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnvironmentSample {
    /// World-space unit direction.
    pub wi: Vec3A,
    /// Scene-linear radiance arriving from `wi` when nothing is in between.
    pub radiance: Vec3A,
    /// Density of `wi`, per steradian, > 0.
    pub pdf: f32,
}

/// Texels that could not be used as they are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Repairs {
    /// Components that were NaN or negative and count as black. Maps read from files have none: the reader repairs and counts
    /// them.
    pub black: usize,
    /// Components that were infinite or, times the gain, beyond [`MAX_RADIANCE`], and count as that.
    pub limited: usize,
}

/// Importance sampling of an [`Environment`].
///
/// The sampled cells lie *between* texel centres, where the map is bilinear, so the density follows the interpolated radiance:
/// a cell is drawn by its mean (over solid angle) and a point within it by a bilinear density. It is positive wherever radiance
/// is (with [`Sampling::Plain`]), including the reach of a one-texel sun into its neighbours.
#[derive(Clone, Debug)]
pub struct EnvironmentLight {
    kind: Kind,
    repairs: Repairs,
    concentration: f32,
}

#[derive(Clone, Debug)]
enum Kind {
    /// The same radiance from everywhere: no table, no look-up.
    Constant(Vec3A),
    Map(Box<Map>),
}

#[derive(Clone, Debug)]
struct Map {
    /// Columns and rows of the map.
    width: usize,
    height: usize,
    inverse_width: f32,
    /// [`Environment::rotation`] in turns, 0..=1.
    rotation: f32,
    /// `height + 2` rows of `width + 1` texels: a row beyond each pole and the first column again at the end.
    /// xyz = radiance with the gain applied, w = the sampling weight, relative to the brightest texel.
    texels: Vec<Vec4>,
    /// One band of directions for each row of cells, `height + 1`.
    bands: Vec<Band>,
    grid: Grid,
    /// `density = weight * this`: one over the integral of the weight over the sphere.
    inverse_total: f32,
}

/// Directions between two parallels. `q = (1 - cos) / 2` of the angle from the nearer pole measures solid angle and keeps full
/// precision near it, unlike the cosine itself.
#[derive(Clone, Copy, Debug)]
struct Band {
    /// `q` at the upper edge.
    start: f32,
    /// `q` at the lower edge minus `start`; negative in the southern half.
    extent: f32,
    inverse_extent: f32,
    /// 1 where `q` is measured from the zenith, -1 from the nadir.
    sign: f32,
}

/// A place in the map: the four texels around it, and where between them.
struct Place {
    /// Interpolated along the row above and the row below.
    above: Vec4,
    below: Vec4,
    /// The cell, and where it is along the row.
    column: usize,
    row: usize,
    s: f32,
    /// Linear in the polar angle, from the row above (0) to the row below (1).
    fraction: f32,
    /// Share of the band's solid angle above the place.
    t: f32,
}

/// A direction drawn in a cell.
struct Within {
    /// Where along the row and, of solid angle, from the row above.
    s: f32,
    t: f32,
    x: f32,
    y: f32,
    z: f32,
    /// Polar angle over pi.
    v: f32,
}

/// Radians in turns, 0..=1.
fn turns(rotation: f32) -> f32 {
    (f64::from(rotation) / std::f64::consts::TAU).rem_euclid(1.0) as f32
}

impl EnvironmentLight {
    /// This light turned to `rotation` (radians), which costs a copy of its tables.
    pub fn turned(&self, rotation: f32) -> Self {
        let mut turned = self.clone();
        if let Kind::Map(map) = &mut turned.kind {
            map.rotation = turns(rotation);
        }
        turned
    }

    /// [`Self::with_sampling`] with [`Sampling::default`].
    ///
    /// # Errors
    /// As [`Self::with_sampling`].
    pub fn new(environment: &Environment) -> Result<Self> {
        Self::with_sampling(environment, Sampling::default())
    }

    /// Builds the sampling tables, 22 bytes a texel, on rayon's threads (so never call it while a cell or lock is held that one
    /// of its tasks may ask for). [`Self::repairs`] counts texels whose radiance was unusable.
    ///
    /// # Errors
    /// When the rotation is not finite, the intensity not finite or negative, or the map's size and texel count differ.
    pub fn with_sampling(environment: &Environment, sampling: Sampling) -> Result<Self> {
        let Environment { map, rotation, intensity } = environment;
        if !rotation.is_finite() {
            return Err(Error::inconsistent("environment/rotation", format!("{rotation} is not finite")));
        }
        if !(0.0..=f32::MAX).contains(intensity) {
            return Err(Error::inconsistent("environment/intensity", format!("{intensity} is not a finite number >= 0")));
        }
        let pixels = &map.pixels;
        if map.width.checked_mul(map.height) != Some(pixels.len()) {
            let reason = format!("{} texels for {} x {}", pixels.len(), map.width, map.height);
            return Err(Error::inconsistent("environment/map", reason));
        }
        let (repairs, brightest) = inspect(pixels, *intensity);
        let constant = |radiance| Self { kind: Kind::Constant(radiance), repairs, concentration: 1.0 };
        if environment.is_constant() {
            return Ok(constant(pixels.first().map_or(Vec3A::ZERO, |texel| usable(texel, *intensity))));
        }
        if brightest < MIN_RADIANCE {
            return Ok(constant(Vec3A::ZERO));
        }
        let (mean, concentration) = moments(environment, brightest);
        let average = |rgb: Vec3A| (rgb.x + rgb.y + rgb.z) / 3.0;
        let inverse = 1.0 / brightest;
        let texel = |less: f32| {
            move |rgb: &[f32; 3]| {
                let radiance = usable(rgb, *intensity);
                radiance.extend((average(radiance * inverse) - less).max(0.0))
            }
        };
        // Rounding can leave nothing above the mean of a map that is constant but for its last bits.
        let made = Map::new(environment, texel(sampling.share() * average(mean * inverse)));
        let kind = match made.or_else(|| Map::new(environment, texel(0.0))) {
            Some(map) => Kind::Map(Box::new(map)),
            None => return Ok(constant(Vec3A::ZERO)),
        };
        Ok(Self { kind, repairs, concentration })
    }

    /// What had to be done to the map's texels.
    pub fn repairs(&self) -> Repairs {
        self.repairs
    }

    /// How much brighter the environment is where light comes from than everywhere: the mean of squared radiance over the square
    /// of its mean, >= 1. The same from everywhere makes 1, all light from one of `n` equal parts of the sphere `n`.
    pub fn concentration(&self) -> f32 {
        self.concentration
    }

    /// Whether no light comes from anywhere.
    pub fn is_black(&self) -> bool {
        matches!(self.kind, Kind::Constant(radiance) if radiance == Vec3A::ZERO)
    }

    /// The radiance where it is the same from all directions; sampling the material then suffices.
    pub fn constant(&self) -> Option<Vec3A> {
        match self.kind {
            Kind::Constant(radiance) => Some(radiance),
            Kind::Map(_) => None,
        }
    }

    /// Draws a direction; `u` in 0..1. `None` when the environment is black, or when the draw falls exactly on the rim
    /// of a light, where radiance and density vanish together.
    #[inline(always)]
    pub fn sample(&self, u: [f32; 2]) -> Option<EnvironmentSample> {
        match &self.kind {
            Kind::Constant(radiance) => {
                if *radiance == Vec3A::ZERO {
                    return None;
                }
                let (sin_phi, cos_phi) = sin_cos_turns(u[0]);
                let sin = 2.0 * (u[1] * (1.0 - u[1])).max(0.0).sqrt();
                let wi = Vec3A::new(sin * sin_phi, 1.0 - 2.0 * u[1], -sin * cos_phi);
                Some(EnvironmentSample { wi, radiance: *radiance, pdf: 0.25 * FRAC_1_PI })
            }
            Kind::Map(map) => map.sample(u),
        }
    }

    /// [`Self::sample`] of all `u`, an array a number, bit for bit.
    #[inline(always)]
    pub(super) fn sample_all(&self, u: [&[f32; LANES]; 2], drawn: &mut [Option<EnvironmentSample>; LANES]) {
        if let Kind::Map(map) = &self.kind {
            return map.sample_all(u, drawn);
        }
        for (lane, to) in drawn.iter_mut().enumerate() {
            *to = self.sample([u[0][lane], u[1][lane]]);
        }
    }

    /// Density with which [`Self::sample`] draws the world-space unit direction `wi`, per steradian.
    #[inline(always)]
    pub fn pdf(&self, wi: Vec3A) -> f32 {
        match &self.kind {
            Kind::Constant(radiance) if *radiance == Vec3A::ZERO => 0.0,
            Kind::Constant(_) => 0.25 * FRAC_1_PI,
            Kind::Map(map) => map.pdf(&map.place(wi)),
        }
    }

    /// Radiance from the world-space unit direction `wi`: [`Environment::radiance`] of the repaired map.
    #[inline(always)]
    pub fn radiance(&self, wi: Vec3A) -> Vec3A {
        match &self.kind {
            Kind::Constant(radiance) => *radiance,
            Kind::Map(map) => map.radiance(&map.place(wi)),
        }
    }

    /// [`Self::radiance`] and [`Self::pdf`] in one look-up, for a path that leaves the scene.
    #[inline(always)]
    pub fn radiance_and_pdf(&self, wi: Vec3A) -> (Vec3A, f32) {
        match &self.kind {
            Kind::Constant(radiance) => (*radiance, self.pdf(wi)),
            Kind::Map(map) => {
                let place = map.place(wi);
                (map.radiance(&place), map.pdf(&place))
            }
        }
    }
}

impl Map {
    fn new(environment: &Environment, texel: impl Fn(&[f32; 3]) -> Vec4 + Sync) -> Option<Self> {
        let (width, height) = (environment.map.width, environment.map.height);
        let mut texels = vec![Vec4::ZERO; (width + 1) * (height + 2)];
        texels.par_chunks_exact_mut(width + 1).enumerate().for_each(|(y, line)| {
            let source = y.clamp(1, height) - 1;
            let row = &environment.map.pixels[source * width..(source + 1) * width];
            if (1..=height).contains(&y) {
                line.iter_mut().zip(row).for_each(|(to, rgb)| *to = texel(rgb));
            } else {
                // Past a pole the map continues half a turn away.
                for (x, to) in line[..width].iter_mut().enumerate() {
                    *to = 0.5 * (texel(&row[(x + width / 2) % width]) + texel(&row[(x + width.div_ceil(2)) % width]));
                }
            }
            line[width] = line[0];
        });
        let bands: Vec<Band> = (0..=height).map(|row| Band::new(row, height)).collect();
        let (grid, total) = Grid::new(width, height + 1, |row, weights| {
            let solid_angle = std::f64::consts::TAU / width as f64 * 2.0 * f64::from(bands[row].extent.abs());
            let i = row * (width + 1);
            let (above, below) = (&texels[i..=i + width], &texels[i + width + 1..=i + 2 * width + 1]);
            for (column, weight) in weights.iter_mut().enumerate() {
                let corners = [above[column].w, above[column + 1].w, below[column].w, below[column + 1].w];
                let sum: f64 = corners_of_band(row, height, corners).iter().map(|&w| f64::from(w)).sum();
                *weight = 0.25 * sum * solid_angle;
            }
        })?;
        let inverse_total = (1.0 / total) as f32;
        (inverse_total.is_finite()).then_some(Self {
            width,
            height,
            inverse_width: (1.0 / width as f64) as f32,
            rotation: turns(environment.rotation),
            texels,
            bands,
            grid,
            inverse_total,
        })
    }

    /// The texels at the corners of a cell: above left, above right, below left, below right.
    #[inline(always)]
    fn around(&self, column: usize, row: usize) -> [Vec4; 4] {
        let i = row * (self.width + 1) + column;
        let j = i + self.width + 1;
        [self.texels[i], self.texels[i + 1], self.texels[j], self.texels[j + 1]]
    }

    /// Sampling weights at the corners of a cell, in the order of [`Self::around`].
    #[inline(always)]
    fn corners(&self, column: usize, row: usize) -> [f32; 4] {
        corners_of_band(row, self.height, self.around(column, row).map(|texel| texel.w))
    }

    #[inline(always)]
    fn sample(&self, u: [f32; 2]) -> Option<EnvironmentSample> {
        let cell = self.grid.sample(u);
        let within = self.warp(self.corners(cell.column, cell.row), self.bands[cell.row], cell.column as f32, cell.u);
        self.drawn((cell.column, cell.row), &within)
    }

    /// [`Self::sample`] of all `u`, step by step: the steps of one draw wait for each other, those of sixteen do not, and the
    /// middle ones work on vectors.
    #[inline(always)]
    fn sample_all(&self, u: [&[f32; LANES]; 2], drawn: &mut [Option<EnvironmentSample>; LANES]) {
        let mut cells = [(0, 0); LANES];
        let (mut bands, mut columns, mut rest) = ([[0.0; LANES]; 3], [0.0; LANES], [[0.0; LANES]; 2]);
        let mut corners = [[0.0; LANES]; 4];
        for lane in 0..LANES {
            let cell = self.grid.sample([u[0][lane], u[1][lane]]);
            let band = &self.bands[cell.row];
            cells[lane] = (cell.column, cell.row);
            columns[lane] = cell.column as f32;
            (bands[0][lane], bands[1][lane], bands[2][lane]) = (band.start, band.extent, band.sign);
            (rest[0][lane], rest[1][lane]) = (cell.u[0], cell.u[1]);
            let [a, b, c, d] = self.corners(cell.column, cell.row);
            (corners[0][lane], corners[1][lane], corners[2][lane], corners[3][lane]) = (a, b, c, d);
        }
        let mut within = [[0.0; LANES]; 6];
        for lane in 0..LANES {
            let band = Band { start: bands[0][lane], extent: bands[1][lane], inverse_extent: 0.0, sign: bands[2][lane] };
            let corners = [corners[0][lane], corners[1][lane], corners[2][lane], corners[3][lane]];
            let Within { s, t, x, y, z, v } = self.warp(corners, band, columns[lane], [rest[0][lane], rest[1][lane]]);
            (within[0][lane], within[1][lane], within[2][lane]) = (s, t, x);
            (within[3][lane], within[4][lane], within[5][lane]) = (y, z, v);
        }
        for (lane, to) in drawn.iter_mut().enumerate() {
            let [s, t, x, y, z, v] = &within;
            let within = Within { s: s[lane], t: t[lane], x: x[lane], y: y[lane], z: z[lane], v: v[lane] };
            *to = self.drawn(cells[lane], &within);
        }
    }

    /// Where in a cell, given its corners' weights, its band and column, and what is left of the random numbers.
    #[inline(always)]
    fn warp(&self, [a, b, c, d]: [f32; 4], band: Band, column: f32, u: [f32; 2]) -> Within {
        let t = sample_linear(0.5 * (a + b), 0.5 * (c + d), u[1]);
        let s = sample_linear(a + (c - a) * t, b + (d - b) * t, u[0]);
        let q = (band.start + band.extent * t).clamp(0.0, 1.0);
        let sin = 2.0 * (q * (1.0 - q)).sqrt();
        let y = band.sign * (1.0 - 2.0 * q);
        let (sin_phi, cos_phi) = sin_cos_turns((column + 0.5 + s) * self.inverse_width - self.rotation);
        Within { s, t, x: sin_phi * sin, y, z: -cos_phi * sin, v: polar(q.min(1.0 - q), y) }
    }

    #[inline(always)]
    fn drawn(&self, (column, row): (usize, usize), within: &Within) -> Option<EnvironmentSample> {
        let &Within { s, t, x, y, z, v } = within;
        let place = self.place_in(column, s, row, v, t);
        let pdf = self.pdf(&place);
        (pdf > 0.0).then(|| EnvironmentSample { wi: Vec3A::new(x, y, z), radiance: self.radiance(&place), pdf })
    }

    #[inline(always)]
    fn place_in(&self, column: usize, s: f32, row: usize, v: f32, t: f32) -> Place {
        let [a, b, c, d] = self.around(column, row);
        let fraction = (v * self.height as f32 + 0.5 - row as f32).clamp(0.0, 1.0);
        Place { above: a + (b - a) * s, below: c + (d - c) * s, column, row, s, fraction, t }
    }

    #[inline(always)]
    fn place(&self, wi: Vec3A) -> Place {
        // (1 - |y|) / 2 without cancellation near the poles.
        let near = 0.5 * (wi.x * wi.x + wi.z * wi.z) / (1.0 + wi.y.abs());
        let v = polar(near.min(0.5), wi.y);
        let row = whole(v * self.height as f32 + 0.5).min(self.height);
        let band = self.bands[row];
        let beyond = if wi.y * band.sign < 0.0 { 1.0 } else { 0.0 };
        let q = beyond + (1.0 - 2.0 * beyond) * near;
        let t = ((q - band.start) * band.inverse_extent).clamp(0.0, 1.0);

        let width = self.width as f32;
        // -1/2..=3/2 turns, brought to 0..1 by adding or subtracting at most one.
        let turns = atan2(wi.x, -wi.z) * (1.0 / TAU) + self.rotation;
        let x = turns * width - 0.5;
        let x = x + if x < 0.0 { width } else { 0.0 } - if x >= width { width } else { 0.0 };
        // A rounding may leave it at either end.
        let column = whole(x).min(self.width - 1);
        self.place_in(column, (x - column as f32).clamp(0.0, 1.0), row, v, t)
    }

    #[inline(always)]
    fn pdf(&self, place: &Place) -> f32 {
        let (above, below) = edges(place.row, self.height, place.above.w, place.below.w);
        ((above + (below - above) * place.t) * self.inverse_total).max(0.0)
    }

    #[inline(always)]
    fn radiance(&self, place: &Place) -> Vec3A {
        let (mut above, mut below) = (place.above, place.below);
        if self.width % 2 == 1 {
            // Half a turn past the pole then falls between texels, which the extra rows cannot hold exactly.
            if place.row == 0 {
                above = self.opposite(1, place);
            }
            if place.row == self.height {
                below = self.opposite(self.height, place);
            }
        }
        Vec3A::from_vec4(above + (below - above) * place.fraction)
    }

    /// What a row of texels holds half a turn away from a place, for maps of odd width.
    #[cold]
    fn opposite(&self, row: usize, place: &Place) -> Vec4 {
        let second_half = place.s >= 0.5;
        let column = (place.column + self.width / 2 + usize::from(second_half)) % self.width;
        let s = if second_half { place.s - 0.5 } else { place.s + 0.5 };
        let i = row * (self.width + 1) + column;
        self.texels[i] + (self.texels[i + 1] - self.texels[i]) * s
    }
}

/// Sampling weights on the upper and the lower edge of a band, from those of the texel rows above and below. The bands at
/// the poles are half as high as the distance of their texel rows, so one of their edges lies midway.
#[inline(always)]
fn edges(row: usize, height: usize, above: f32, below: f32) -> (f32, f32) {
    let middle = 0.5 * (above + below);
    (if row == 0 { middle } else { above }, if row == height { middle } else { below })
}

/// Sampling weights at the corners of a cell of band `row`, from those of its texels.
#[inline(always)]
fn corners_of_band(row: usize, height: usize, [a, b, c, d]: [f32; 4]) -> [f32; 4] {
    let (a, c) = edges(row, height, a, c);
    let (b, d) = edges(row, height, b, d);
    [a, b, c, d]
}

/// Radiance of a texel: NaN and negative components count as black, others are limited to [`MAX_RADIANCE`].
#[inline]
fn usable(rgb: &[f32; 3], intensity: f32) -> Vec3A {
    // An infinite texel of a light that is off is off.
    Vec3A::from(rgb.map(|v| if v > 0.0 && intensity > 0.0 { (v * intensity).min(MAX_RADIANCE) } else { 0.0 }))
}

/// What [`usable`] does to a map, and the brightest component it leaves.
fn inspect(pixels: &[[f32; 3]], intensity: f32) -> (Repairs, f32) {
    let texel = |rgb: &[f32; 3]| {
        let count = |f: &dyn Fn(f32) -> bool| rgb.iter().filter(|&&v| f(v)).count();
        let black = count(&|v| v.is_nan() || v < 0.0);
        let limited = count(&|v| v == f32::INFINITY || v * intensity > MAX_RADIANCE);
        (Repairs { black, limited }, usable(rgb, intensity).max_element())
    };
    let both = |a: (Repairs, f32), b: (Repairs, f32)| {
        (Repairs { black: a.0.black + b.0.black, limited: a.0.limited + b.0.limited }, a.1.max(b.1))
    };
    pixels.par_iter().with_min_len(1 << 12).map(texel).reduce(Default::default, both)
}

/// Mean of the usable texels, weighted by solid angle, and [`EnvironmentLight::concentration`] of their averages. Sums of rows
/// are added in order: the same bits for any number of threads.
fn moments(environment: &Environment, brightest: f32) -> (Vec3A, f32) {
    let map = &environment.map;
    let rows: Vec<(glam::DVec3, f64)> = map
        .pixels
        .par_chunks_exact(map.width)
        .enumerate()
        .map(|(y, row)| {
            let (mut sum, mut squares) = (glam::DVec3::ZERO, 0.0);
            for rgb in row {
                let radiance = usable(rgb, environment.intensity).as_dvec3();
                sum += radiance;
                squares += (radiance.element_sum() / f64::from(brightest)).powi(2);
            }
            let share = f64::from(environment.texel_solid_angle(y)) * 0.25 * std::f64::consts::FRAC_1_PI;
            (sum * share, squares * share)
        })
        .collect();
    let add = |(sum, squares): (glam::DVec3, f64), (row, more): (glam::DVec3, f64)| (sum + row, squares + more);
    let (mean, squares) = rows.into_iter().fold((glam::DVec3::ZERO, 0.0), add);
    let concentration = squares / (mean.element_sum() / f64::from(brightest)).powi(2);
    (mean.as_vec3a(), if concentration.is_finite() { concentration.max(1.0) as f32 } else { 1.0 })
}

impl Band {
    fn new(row: usize, height: usize) -> Self {
        let edge = |v: f64| v.clamp(0.0, 1.0) * std::f64::consts::PI;
        let upper = edge((row as f64 - 0.5) / height as f64);
        let lower = edge((row as f64 + 0.5) / height as f64);
        let north = 2 * row <= height;
        let q = |theta: f64| {
            let half = 0.5 * if north { theta } else { std::f64::consts::PI - theta };
            half.sin() * half.sin()
        };
        let extent = q(lower) - q(upper);
        Self {
            start: q(upper) as f32,
            extent: extent as f32,
            inverse_extent: (1.0 / extent) as f32,
            sign: if north { 1.0 } else { -1.0 },
        }
    }
}
