//! Light from places in the scene: emissive triangles, points and spots.

use super::MAX_RADIANCE;
use super::punctual::{Lamp, direction_and_distance};
use super::sampler::{LightSample, Source, UNITS};
use super::tree::{LightTree, TreeLight};
use glam::{DVec3, Vec3A};
use renderflow_frame::color::luminance;
use std::f32::consts::FRAC_PI_2;

/// A triangle that emits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EmissiveTriangle {
    /// Corners in the space that shading points are in; counter-clockwise seen from the front.
    pub corners: [Vec3A; 3],
    /// Emitted radiance, the mean over the triangle where it is textured. It only decides how often the triangle is drawn.
    pub radiance: Vec3A,
    /// Whether the back emits as well.
    pub two_sided: bool,
    /// The caller's number for it, unique.
    pub id: u32,
}

/// A point that light falls on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Receiver {
    /// The point.
    pub p: Vec3A,
    /// Unit geometric normal, on the side from which light counts; zero where light from all sides does.
    pub n: Vec3A,
}

/// Which of the lights that stand somewhere in the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LightId {
    /// The emissive triangle of this number.
    Triangle(u32),
    /// The point or spot of this number.
    Lamp(u32),
}

/// How one of many lights is chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Selection {
    /// By what it may send to the point: a tree of lights.
    #[default]
    Tree,
    /// By its power, whatever the point: for measurements.
    Power,
}

/// Lights at places in the scene. One is drawn as its [`Selection`] says, and points within a triangle uniformly.
///
/// Probabilities are whole multiples of one over the random numbers that lead here: a light's probability is then exactly how
/// often it is drawn, however many there are. By power, a triangle too faint for a single number is never drawn and has density
/// 0; samples of materials find it, with their whole weight.
#[derive(Clone, Debug)]
pub struct EmitterLight {
    /// Sorted by id. They are the first items.
    emitters: Vec<Emitter>,
    /// The items after these.
    lamps: Vec<Lamp>,
    choice: Choice,
}

#[derive(Clone, Debug)]
enum Choice {
    Tree(LightTree),
    Power(PowerTable),
}

#[derive(Clone, Copy, Debug)]
struct Emitter {
    corners: [Vec3A; 3],
    /// Unit, of the front.
    n: Vec3A,
    id: u32,
    two_sided: bool,
    /// Density over the area of this triangle, times the probability to draw it where that is always the same; 0 when it is never
    /// drawn.
    pdf_area: f32,
}

/// One over the random numbers of a tree, 2^46.
const TREE_UNIT: f32 = 1.0 / (UNITS as f32 * UNITS as f32);

impl EmitterLight {
    /// Tables for `triangles`. Ignored are those of no area, those that are black, and those whose corners or
    /// radiance are not finite and >= 0. `None` when nothing is left. Radiance beyond [`MAX_RADIANCE`] is limited to it.
    pub fn new(triangles: impl IntoIterator<Item = EmissiveTriangle>, selection: Selection) -> Option<Self> {
        Self::with_units(triangles, Vec::new(), selection, UNITS)
    }

    /// As [`Self::new`], with points and spots, for [`Self::pick`] of `0..units`.
    pub(super) fn with_units(
        triangles: impl IntoIterator<Item = EmissiveTriangle>,
        lamps: Vec<Lamp>,
        selection: Selection,
        units: u32,
    ) -> Option<Self> {
        // With their luminance of a square metre of one side, and their area.
        let mut weighted: Vec<(Emitter, f64, f64)> = Vec::new();
        for triangle in triangles {
            let [a, b, c] = triangle.corners.map(|p| p.as_dvec3());
            // In f64, so that no finite triangle's area is lost: metres from 1e-20 to 1e30 have one.
            let cross: DVec3 = (b - a).cross(c - a);
            let area = 0.5 * cross.length();
            let usable = triangle.radiance.is_finite() && triangle.radiance.cmpge(Vec3A::ZERO).all();
            let strength = area * f64::from(luminance(triangle.radiance.min(Vec3A::splat(MAX_RADIANCE)).to_array()));
            if !usable || !strength.is_finite() || strength <= 0.0 {
                continue;
            }
            let EmissiveTriangle { corners, two_sided, id, .. } = triangle;
            let n = (cross / (2.0 * area)).as_vec3a();
            weighted.push((Emitter { corners, n, id, two_sided, pdf_area: 0.0 }, strength, area));
        }
        if weighted.is_empty() && lamps.is_empty() || units == 0 {
            return None;
        }
        weighted.sort_by_key(|(emitter, ..)| emitter.id);
        let density = |probability: f64, area: f64| {
            let pdf_area = (probability / area) as f32;
            // A speck of 1e-36 square metres has no finite density; as a light it is left to the material's samples.
            if pdf_area.is_finite() { pdf_area } else { 0.0 }
        };
        let choice = match selection {
            Selection::Power => {
                let sides = |emitter: &Emitter| if emitter.two_sided { 2.0 } else { 1.0 };
                let triangles = weighted.iter().map(|(emitter, strength, _)| sides(emitter) * strength);
                let table = PowerTable::new(&triangles.chain(lamps.iter().map(Lamp::power)).collect::<Vec<_>>(), units);
                for (i, (emitter, _, area)) in weighted.iter_mut().enumerate() {
                    emitter.pdf_area = density(f64::from(table.units(i)) / f64::from(UNITS), *area);
                }
                Choice::Power(table)
            }
            Selection::Tree => {
                weighted.iter_mut().for_each(|(emitter, _, area)| emitter.pdf_area = density(1.0, *area));
                let largest = weighted.iter().map(|(_, strength, _)| *strength).chain(lamps.iter().map(Lamp::strength));
                let largest = largest.fold(0.0, f64::max);
                let triangles = weighted.iter().map(|(emitter, strength, _)| emitter.in_tree((strength / largest) as f32));
                let lamps = lamps.iter().map(|lamp| in_tree(lamp, (lamp.strength() / largest) as f32));
                let numbered = triangles.chain(lamps).zip(0..).map(|(light, item)| TreeLight { item, ..light });
                Choice::Tree(LightTree::new(numbered.collect(), u64::from(units) * u64::from(UNITS))?)
            }
        };
        Some(Self { emitters: weighted.into_iter().map(|(emitter, ..)| emitter).collect(), lamps, choice })
    }

    /// Draws a light and a point on it as seen from `at`; random numbers in 0..1, `choice` for the light. `None` when a triangle
    /// does not face `at`, when `at` is in its plane, or so near that the density (area density times distance squared over the
    /// cosine) is below the smallest normal float; [`Self::pdf`] then is 0. `None` too when nothing that was drawn sends light to
    /// `at`.
    #[inline]
    pub fn sample(&self, at: &Receiver, choice: [f32; 2], u: [f32; 2]) -> Option<LightSample> {
        self.pick(choice.map(|number| ((number * UNITS as f32) as u32).min(UNITS - 1)), at, u)
    }

    /// As [`Self::sample`] with the `unit`-th of the random numbers that lead here; `more` of 0..[`UNITS`] says which part of it.
    #[inline]
    pub(super) fn pick(&self, [unit, more]: [u32; 2], at: &Receiver, u: [f32; 2]) -> Option<LightSample> {
        let (item, probability) = match &self.choice {
            Choice::Power(table) => (table.pick(unit)?, 1.0),
            Choice::Tree(tree) => {
                let (item, units) = tree.pick(u64::from(unit) * u64::from(UNITS) + u64::from(more), at)?;
                (item, units as f32 * TREE_UNIT)
            }
        };
        let Some(emitter) = self.emitters.get(item) else {
            let lamp = item - self.emitters.len();
            let arriving = self.lamps.get(lamp)?.arriving(at.p)?;
            let pdf = match &self.choice {
                Choice::Power(table) => table.units(item) as f32 / UNITS as f32,
                Choice::Tree(_) => probability,
            };
            return Some(LightSample::punctual(arriving, Some(lamp as u32), pdf));
        };
        let barycentrics = to_triangle(u);
        let point = (0..3).map(|k| emitter.corners[k] * barycentrics[k]).sum::<Vec3A>();
        let (wi, distance) = direction_and_distance(point - at.p)?;
        let cos = -emitter.n.dot(wi);
        let pdf = emitter.pdf(probability, distance, cos);
        let n = if cos < 0.0 { -emitter.n } else { emitter.n };
        let source = Source::Emitter { id: emitter.id, barycentrics, n };
        (pdf > 0.0).then_some(LightSample { wi, distance, source, pdf })
    }

    /// The item that is triangle `id`.
    #[inline(always)]
    fn item(&self, id: u32) -> Option<usize> {
        // Lists of one mesh have consecutive numbers, where the first guess is right.
        let offset = id.wrapping_sub(self.emitters.first()?.id) as usize;
        match self.emitters.get(offset) {
            Some(emitter) if emitter.id == id => Some(offset),
            _ => self.emitters.binary_search_by_key(&id, |emitter| emitter.id).ok(),
        }
    }

    /// Probability with which [`Self::sample`] for `at` draws a triangle, wherever on it, or a lamp.
    pub(super) fn probability(&self, at: &Receiver, light: LightId) -> f32 {
        let item = match light {
            LightId::Triangle(id) => self.item(id),
            LightId::Lamp(number) => Some(self.emitters.len() + number as usize),
        };
        item.map_or(0.0, |item| match &self.choice {
            Choice::Power(table) => table.units(item) as f32 / UNITS as f32,
            Choice::Tree(tree) => tree.units(item, at) as f32 * TREE_UNIT,
        })
    }

    /// W/m^2 that lamp `number` sends to a surface at `p` that faces it.
    pub(super) fn irradiance(&self, number: u32, p: Vec3A) -> Vec3A {
        let arriving = self.lamps.get(number as usize).and_then(|lamp| lamp.arriving(p));
        arriving.map_or(Vec3A::ZERO, |arriving| arriving.irradiance)
    }

    /// Density with which [`Self::sample`] for `at` draws, per steradian, a direction that meets triangle `id` at `distance`;
    /// `cos` is that between the triangle's front normal and the direction back to `at`, negative seen from behind. 0 for
    /// triangles that are no emitters.
    #[inline]
    pub fn pdf(&self, at: &Receiver, id: u32, distance: f32, cos: f32) -> f32 {
        let Some(item) = self.item(id) else { return 0.0 };
        let emitter = &self.emitters[item];
        let probability = match &self.choice {
            Choice::Power(_) => 1.0,
            Choice::Tree(_) if cos <= 0.0 && !emitter.two_sided => return 0.0,
            Choice::Tree(tree) => tree.units(item, at) as f32 * TREE_UNIT,
        };
        emitter.pdf(probability, distance, cos)
    }
}

impl Emitter {
    /// From density over area to density over solid angle: times the squared distance over the cosine.
    #[inline]
    fn pdf(&self, probability: f32, distance: f32, cos: f32) -> f32 {
        let cos = if self.two_sided { cos.abs() } else { cos };
        let pdf = self.pdf_area * probability * distance * distance / cos;
        // False for NaN as well.
        if cos > 0.0 && pdf >= f32::MIN_POSITIVE && pdf.is_finite() { pdf } else { 0.0 }
    }

    fn in_tree(&self, strength: f32) -> TreeLight {
        let [a, b, c] = self.corners;
        TreeLight {
            item: 0,
            low: a.min(b).min(c),
            high: a.max(b).max(c),
            axis: self.n,
            theta_o: 0.0,
            theta_e: FRAC_PI_2,
            two_sided: self.two_sided,
            strength,
        }
    }
}

fn in_tree(lamp: &Lamp, strength: f32) -> TreeLight {
    let (axis, theta_o, theta_e) = lamp.spread();
    let (low, high) = (lamp.position, lamp.position);
    TreeLight { item: 0, low, high, axis, theta_o, theta_e, two_sided: false, strength }
}

/// Items drawn by power, whatever the point.
#[derive(Clone, Debug)]
struct PowerTable {
    /// `cumulative[i]` = units of items 0..=i.
    cumulative: Vec<u32>,
    /// First item for every `1 << shift` units.
    guide: Vec<u32>,
    shift: u32,
}

impl PowerTable {
    /// Of at least one power > 0, for [`Self::pick`] of `0..units`.
    fn new(powers: &[f64], units: u32) -> Self {
        // Relative to the largest: no sum overflows.
        let largest = powers.iter().copied().fold(0.0, f64::max);
        let total: f64 = powers.iter().map(|power| power / largest).sum();
        let (mut sum, mut below) = (0.0, 0);
        let mut cumulative = Vec::with_capacity(powers.len());
        for (i, power) in powers.iter().enumerate() {
            sum += power / largest / total;
            // The sum is 1 at the end but for its rounding, which is far below half a unit.
            let last = i + 1 == powers.len();
            let above = if last { units } else { ((sum * f64::from(units)).round() as u32).clamp(below, units) };
            cumulative.push(above);
            below = above;
        }
        let shift = (units / (powers.len() as u32).max(1)).max(1).ilog2();
        let mut first = 0;
        let guide = (0..=(units - 1) >> shift)
            .map(|slot| {
                while cumulative[first] <= slot << shift {
                    first += 1;
                }
                first as u32
            })
            .collect();
        Self { cumulative, guide, shift }
    }

    #[inline]
    fn pick(&self, unit: u32) -> Option<usize> {
        let mut i = *self.guide.get((unit >> self.shift) as usize)? as usize;
        while *self.cumulative.get(i)? <= unit {
            i += 1;
        }
        Some(i)
    }

    #[inline]
    fn units(&self, i: usize) -> u32 {
        self.cumulative[i] - if i == 0 { 0 } else { self.cumulative[i - 1] }
    }
}

/// Barycentric weights of a uniform point: a map from the square that keeps neighbours together (Heitz 2019, "A Low-Distortion
/// Map Between Triangle and Square").
#[inline]
fn to_triangle([u, v]: [f32; 2]) -> [f32; 3] {
    let (a, b) = if v > u { (0.5 * u, v - 0.5 * u) } else { (u - 0.5 * v, 0.5 * v) };
    [a, b, (1.0 - a - b).max(0.0)]
}
