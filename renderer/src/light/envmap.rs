//! Light from the environment map, drawn in proportion to what it emits.

use super::LightSample;
use super::distribution::{Grid, sample_linear};
use glam::{Vec3A, Vec4};
use renderflow_frame::Environment;
use renderflow_frame::environment::atan2;
use std::f32::consts::{FRAC_1_PI, TAU};

/// Importance sampling of an [`Environment`].
///
/// The sampled cells lie *between* texel centres, where the map is bilinear, so the density follows the interpolated radiance:
/// a cell is drawn by its mean (over solid angle) and a point within it by a bilinear density. It is positive wherever radiance
/// is, including the reach of a one-texel sun into its neighbours.
#[derive(Clone, Debug)]
pub struct EnvironmentLight {
    kind: Kind,
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
    /// Radians, as in [`Environment::rotation`].
    rotation: f32,
    /// `height + 2` rows of `width + 1` texels: a row beyond each pole and the first column again at the end.
    /// xyz = radiance with the gain applied, w = the sampling weight, relative to the brightest texel.
    texels: Vec<Vec4>,
    /// One band of directions for each row of cells, `height + 1`.
    bands: Vec<Band>,
    grid: Grid,
    /// `density = weight * this`: one over the integral of the weight over the sphere.
    inverse_total: f32,
    /// The environment itself where the width is odd: half a turn past the pole then falls between texels, which the
    /// table does not hold exactly.
    odd: Option<Environment>,
}

/// Directions between two parallels. `q = (1 - cos) / 2` of the angle from the nearer pole measures solid angle and keeps full
/// precision near it, unlike the cosine itself.
#[derive(Clone, Copy, Debug)]
struct Band {
    /// `q` at the upper edge.
    start: f32,
    /// `q` at the lower edge minus `start`; negative in the southern half.
    extent: f32,
    /// 1 where `q` is measured from the zenith, -1 from the nadir.
    sign: f32,
}

/// A place in the map: the four texels around it, and where between them.
struct Place {
    /// Interpolated along the row above and the row below.
    above: Vec4,
    below: Vec4,
    row: usize,
    /// Linear in the polar angle, from the row above (0) to the row below (1).
    fraction: f32,
    /// Share of the band's solid angle above the place.
    t: f32,
}

impl EnvironmentLight {
    /// Builds the sampling tables, about 24 bytes a texel. Negative and NaN texels count as black.
    pub fn new(environment: &Environment) -> Self {
        let gain = |texel: &[f32; 3]| {
            Vec3A::from(texel.map(|value| {
                let value = value * environment.intensity;
                // Half of the largest float: sums of two products in the interpolation then stay finite.
                if value > 0.0 { value.min(0.5 * f32::MAX) } else { 0.0 }
            }))
        };
        let pixels = &environment.map.pixels;
        if environment.is_constant() {
            return Self { kind: Kind::Constant(pixels.first().map_or(Vec3A::ZERO, gain)) };
        }
        let brightest = pixels.iter().map(|texel| gain(texel).max_element()).fold(0.0, f32::max);
        // 1 / brightest must be finite; light this faint is none.
        if brightest < 1e-37 {
            return Self { kind: Kind::Constant(Vec3A::ZERO) };
        }
        let texel = |radiance: Vec3A| {
            let relative = radiance / brightest;
            radiance.extend((relative.x + relative.y + relative.z) / 3.0)
        };
        let kind = match Map::new(environment, |rgb| texel(gain(rgb))) {
            Some(map) => Kind::Map(Box::new(map)),
            None => Kind::Constant(Vec3A::ZERO),
        };
        Self { kind }
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
    #[inline]
    pub fn sample(&self, u: [f32; 2]) -> Option<LightSample> {
        match &self.kind {
            Kind::Constant(radiance) => {
                if *radiance == Vec3A::ZERO {
                    return None;
                }
                let (sin_phi, cos_phi) = (TAU * u[0]).sin_cos();
                let sin = 2.0 * (u[1] * (1.0 - u[1])).max(0.0).sqrt();
                let wi = Vec3A::new(sin * sin_phi, 1.0 - 2.0 * u[1], -sin * cos_phi);
                Some(LightSample { wi, radiance: *radiance, pdf: 0.25 * FRAC_1_PI })
            }
            Kind::Map(map) => map.sample(u),
        }
    }

    /// Density with which [`Self::sample`] draws the world-space unit direction `wi`, per steradian.
    #[inline]
    pub fn pdf(&self, wi: Vec3A) -> f32 {
        match &self.kind {
            Kind::Constant(radiance) if *radiance == Vec3A::ZERO => 0.0,
            Kind::Constant(_) => 0.25 * FRAC_1_PI,
            Kind::Map(map) => map.pdf(&map.place(wi)),
        }
    }

    /// Radiance from the world-space unit direction `wi`: [`Environment::radiance`].
    #[inline]
    pub fn radiance(&self, wi: Vec3A) -> Vec3A {
        match &self.kind {
            Kind::Constant(radiance) => *radiance,
            Kind::Map(map) => map.radiance(wi, &map.place(wi)),
        }
    }

    /// [`Self::radiance`] and [`Self::pdf`] in one look-up, for a path that leaves the scene.
    #[inline]
    pub fn radiance_and_pdf(&self, wi: Vec3A) -> (Vec3A, f32) {
        match &self.kind {
            Kind::Constant(radiance) => (*radiance, self.pdf(wi)),
            Kind::Map(map) => {
                let place = map.place(wi);
                (map.radiance(wi, &place), map.pdf(&place))
            }
        }
    }
}

impl Map {
    fn new(environment: &Environment, texel: impl Fn(&[f32; 3]) -> Vec4) -> Option<Self> {
        let (width, height) = (environment.map.width, environment.map.height);
        let row = |y: usize| environment.map.pixels[y * width..(y + 1) * width].iter().map(&texel);
        let mut texels = Vec::with_capacity((width + 1) * (height + 2));
        // Past a pole the map continues half a turn away.
        let beyond = |y: usize| -> Vec<Vec4> {
            let texels: Vec<Vec4> = row(y).collect();
            (0..width).map(|x| 0.5 * (texels[(x + width / 2) % width] + texels[(x + width.div_ceil(2)) % width])).collect()
        };
        texels.extend(beyond(0));
        texels.push(texels[0]);
        for y in 0..height {
            let first = texels.len();
            texels.extend(row(y));
            texels.push(texels[first]);
        }
        let first = texels.len();
        texels.extend(beyond(height - 1));
        texels.push(texels[first]);

        let bands: Vec<Band> = (0..=height).map(|row| Band::new(row, height)).collect();
        let mut map = Self {
            width,
            height,
            rotation: environment.rotation,
            texels,
            bands,
            grid: Grid::new(&[1.0], 1)?.0,
            inverse_total: 0.0,
            odd: (width % 2 == 1).then(|| environment.clone()),
        };
        let mut weights = Vec::with_capacity(width * (height + 1));
        for row in 0..=height {
            let solid_angle = std::f64::consts::TAU / width as f64 * 2.0 * f64::from(map.bands[row].extent.abs());
            for column in 0..width {
                let [a, b, c, d] = map.corners(column, row).map(f64::from);
                weights.push(0.25 * (a + b + c + d) * solid_angle);
            }
        }
        let (grid, total) = Grid::new(&weights, width)?;
        map.grid = grid;
        map.inverse_total = (1.0 / total) as f32;
        Some(map)
    }

    /// The texels at the corners of a cell: above left, above right, below left, below right.
    #[inline]
    fn around(&self, column: usize, row: usize) -> [Vec4; 4] {
        let i = row * (self.width + 1) + column;
        let j = i + self.width + 1;
        [self.texels[i], self.texels[i + 1], self.texels[j], self.texels[j + 1]]
    }

    /// Sampling weights on the upper and the lower edge of a band, from those of the texel rows above and below. The bands at
    /// the poles are half as high as the distance of their texel rows, so one of their edges lies midway.
    #[inline]
    fn edges(&self, row: usize, above: f32, below: f32) -> (f32, f32) {
        let middle = 0.5 * (above + below);
        (if row == 0 { middle } else { above }, if row == self.height { middle } else { below })
    }

    /// Sampling weights at the corners of a cell, in the order of [`Self::around`].
    #[inline]
    fn corners(&self, column: usize, row: usize) -> [f32; 4] {
        let [a, b, c, d] = self.around(column, row).map(|texel| texel.w);
        let (a, c) = self.edges(row, a, c);
        let (b, d) = self.edges(row, b, d);
        [a, b, c, d]
    }

    fn sample(&self, u: [f32; 2]) -> Option<LightSample> {
        let cell = self.grid.sample(u);
        let [a, b, c, d] = self.corners(cell.column, cell.row);
        let t = sample_linear(a + b, c + d, cell.u[1]);
        let s = sample_linear(a + (c - a) * t, b + (d - b) * t, cell.u[0]);

        let band = self.bands[cell.row];
        let q = (band.start + band.extent * t).clamp(0.0, 1.0);
        let sin = 2.0 * (q * (1.0 - q)).sqrt();
        let phi = TAU * ((cell.column as f32 + 0.5 + s) / self.width as f32);
        let (sin_phi, cos_phi) = (phi - self.rotation).sin_cos();
        let wi = Vec3A::new(sin_phi * sin, band.sign * (1.0 - 2.0 * q), -cos_phi * sin);

        let angle = 2.0 * FRAC_1_PI * atan2(q.sqrt(), (1.0 - q).sqrt());
        let v = if band.sign > 0.0 { angle } else { 1.0 - angle };
        let place = self.place_in(cell.column, s, cell.row, v, t);
        let pdf = self.pdf(&place);
        (pdf > 0.0).then(|| LightSample { wi, radiance: self.radiance(wi, &place), pdf })
    }

    #[inline]
    fn place_in(&self, column: usize, s: f32, row: usize, v: f32, t: f32) -> Place {
        let [a, b, c, d] = self.around(column, row);
        let fraction = (v * self.height as f32 + 0.5 - row as f32).clamp(0.0, 1.0);
        Place { above: a + (b - a) * s, below: c + (d - c) * s, row, fraction, t }
    }

    #[inline]
    fn place(&self, wi: Vec3A) -> Place {
        let r2 = wi.x * wi.x + wi.z * wi.z;
        let v = atan2(r2.sqrt(), wi.y) * FRAC_1_PI;
        let row = ((v * self.height as f32 + 0.5) as usize).min(self.height);
        let band = self.bands[row];
        let y = band.sign * wi.y;
        // (1 - y) / 2 without cancellation near the pole.
        let q = if y > 0.0 { 0.5 * r2 / (1.0 + y) } else { 0.5 * (1.0 - y) };
        let t = ((q - band.start) / band.extent).clamp(0.0, 1.0);

        let turns = (atan2(wi.x, -wi.z) + self.rotation) * (1.0 / TAU);
        let x = (turns - turns.floor()) * self.width as f32 - 0.5;
        let x = if x < 0.0 { x + self.width as f32 } else { x };
        let column = (x as usize).min(self.width - 1);
        self.place_in(column, x - column as f32, row, v, t)
    }

    #[inline]
    fn pdf(&self, place: &Place) -> f32 {
        let (above, below) = self.edges(place.row, place.above.w, place.below.w);
        ((above + (below - above) * place.t) * self.inverse_total).max(0.0)
    }

    #[inline]
    fn radiance(&self, wi: Vec3A, place: &Place) -> Vec3A {
        if let Some(environment) = &self.odd {
            return Vec3A::from(environment.radiance(wi));
        }
        Vec3A::from_vec4(place.above + (place.below - place.above) * place.fraction)
    }
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
        Self { start: q(upper) as f32, extent: (q(lower) - q(upper)) as f32, sign: if north { 1.0 } else { -1.0 } }
    }
}
