//! Light from emissive triangles.

use super::MAX_RADIANCE;
use super::sampler::UNITS;
use glam::{DVec3, Vec3A};
use renderflow_frame::color::luminance;

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

/// A point on an emitter, seen from a shading point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EmitterSample {
    /// Unit direction from the shading point to `p`.
    pub wi: Vec3A,
    /// Distance to `p`, > 0.
    pub distance: f32,
    /// The point.
    pub p: Vec3A,
    /// Unit geometric normal of the emitter, on the side of the shading point.
    pub n: Vec3A,
    /// Number of the triangle.
    pub id: u32,
    /// Weights of its corners, each 0..=1.
    pub barycentrics: [f32; 3],
    /// Density of `wi`, per steradian, > 0.
    pub pdf: f32,
}

/// Emissive triangles, drawn by power: area times luminance times emitting sides; points within one uniformly.
///
/// Probabilities are whole multiples of 1 / units, where `units` is how many random numbers lead here: a triangle's probability
/// is then exactly how often it is drawn, however many there are. One too faint for a single unit is never drawn and has density
/// 0; samples of materials find it, with their whole weight.
#[derive(Clone, Debug)]
pub struct EmitterLight {
    /// Sorted by id.
    emitters: Vec<Emitter>,
    /// `cumulative[i]` = units of emitters 0..=i.
    cumulative: Vec<u32>,
    /// First emitter for every `1 << shift` units.
    guide: Vec<u32>,
    shift: u32,
}

#[derive(Clone, Copy, Debug)]
struct Emitter {
    corners: [Vec3A; 3],
    /// Unit, of the front.
    n: Vec3A,
    id: u32,
    two_sided: bool,
    /// Density over the area of this triangle, times the probability to draw it; 0 when it is never drawn.
    pdf_area: f32,
}

impl EmitterLight {
    /// Tables for `triangles`. Ignored are those of no area, those that are black, and those whose corners or
    /// radiance are not finite and >= 0. `None` when nothing is left. Radiance beyond [`MAX_RADIANCE`] is limited to it.
    pub fn new(triangles: impl IntoIterator<Item = EmissiveTriangle>) -> Option<Self> {
        Self::with_units(triangles, UNITS)
    }

    /// As [`Self::new`] for [`Self::pick`] of `0..units`.
    pub(super) fn with_units(triangles: impl IntoIterator<Item = EmissiveTriangle>, units: u32) -> Option<Self> {
        let mut weighted: Vec<(Emitter, f64, f64)> = Vec::new();
        for triangle in triangles {
            let [a, b, c] = triangle.corners.map(|p| p.as_dvec3());
            // In f64, so that no finite triangle's area is lost: metres from 1e-20 to 1e30 have one.
            let cross: DVec3 = (b - a).cross(c - a);
            let area = 0.5 * cross.length();
            let usable = triangle.radiance.is_finite() && triangle.radiance.cmpge(Vec3A::ZERO).all();
            let power = area * f64::from(luminance(triangle.radiance.min(Vec3A::splat(MAX_RADIANCE)).to_array()));
            let power = if triangle.two_sided { 2.0 * power } else { power };
            if !usable || !power.is_finite() || power <= 0.0 {
                continue;
            }
            let EmissiveTriangle { corners, two_sided, id, .. } = triangle;
            let n = (cross / (2.0 * area)).as_vec3a();
            weighted.push((Emitter { corners, n, id, two_sided, pdf_area: 0.0 }, power, area));
        }
        weighted.sort_by_key(|(emitter, ..)| emitter.id);
        // Relative to the largest: no sum overflows.
        let largest = weighted.iter().map(|(_, power, _)| *power).fold(0.0, f64::max);
        let total: f64 = weighted.iter().map(|(_, power, _)| power / largest).sum();
        if weighted.is_empty() || units == 0 {
            return None;
        }
        let (mut sum, mut below) = (0.0, 0);
        let mut emitters = Vec::with_capacity(weighted.len());
        let mut cumulative = Vec::with_capacity(weighted.len());
        let last = weighted.len() - 1;
        for (i, (mut emitter, power, area)) in weighted.into_iter().enumerate() {
            sum += power / largest / total;
            // The sum is 1 at the end but for its rounding, which is far below half a unit.
            let above = if i == last { units } else { ((sum * f64::from(units)).round() as u32).clamp(below, units) };
            let probability = f64::from(above - below) / f64::from(UNITS);
            let pdf_area = (probability / area) as f32;
            // A speck of 1e-36 square metres has no finite density; as a light it is left to the material's samples.
            emitter.pdf_area = if pdf_area.is_finite() { pdf_area } else { 0.0 };
            emitters.push(emitter);
            cumulative.push(above);
            below = above;
        }
        let shift = (units / (emitters.len() as u32).max(1)).max(1).ilog2();
        let mut first = 0;
        let guide = (0..=(units - 1) >> shift)
            .map(|slot| {
                while cumulative[first] <= slot << shift {
                    first += 1;
                }
                first as u32
            })
            .collect();
        Some(Self { emitters, cumulative, guide, shift })
    }

    /// Draws a point on an emitter as seen from `p`; random numbers in 0..1, `choice` for the triangle. `None` when the emitter
    /// does not face `p`, when `p` is in its plane, or so near that the density (area density times distance squared over the
    /// cosine) is below the smallest normal float; [`Self::pdf`] then is 0.
    #[inline]
    pub fn sample(&self, p: Vec3A, choice: f32, u: [f32; 2]) -> Option<EmitterSample> {
        self.pick(((choice * UNITS as f32) as u32).min(UNITS - 1), p, u)
    }

    /// As [`Self::sample`] with the `unit`-th of the random numbers that lead here.
    #[inline]
    pub(super) fn pick(&self, unit: u32, p: Vec3A, u: [f32; 2]) -> Option<EmitterSample> {
        let mut i = *self.guide.get((unit >> self.shift) as usize)? as usize;
        while *self.cumulative.get(i)? <= unit {
            i += 1;
        }
        let emitter = &self.emitters[i];
        let barycentrics = to_triangle(u);
        let point = (0..3).map(|k| emitter.corners[k] * barycentrics[k]).sum::<Vec3A>();
        let towards = point - p;
        // Scaled before squaring: distances from 1e-30 to 1e30 keep their digits.
        let scale = towards.abs().max_element();
        if !(scale > 0.0 && scale.is_finite()) {
            return None;
        }
        let scaled = towards / scale;
        let length = scaled.length();
        let (wi, distance) = (scaled / length, scale * length);
        let cos = -emitter.n.dot(wi);
        let pdf = emitter.pdf(distance, cos);
        let n = if cos < 0.0 { -emitter.n } else { emitter.n };
        (pdf > 0.0).then_some(EmitterSample { wi, distance, p: point, n, id: emitter.id, barycentrics, pdf })
    }

    /// Density with which [`Self::sample`] draws, per steradian, a direction that meets triangle `id` at `distance`; `cos` is
    /// that between the triangle's front normal and the direction back to the shading point, negative seen from behind. 0 for
    /// triangles that are no emitters.
    #[inline]
    pub fn pdf(&self, id: u32, distance: f32, cos: f32) -> f32 {
        // Lists of one mesh have consecutive numbers, where the first guess is right.
        let offset = id.wrapping_sub(self.emitters[0].id) as usize;
        let emitter = match self.emitters.get(offset) {
            Some(emitter) if emitter.id == id => emitter,
            _ => match self.emitters.binary_search_by_key(&id, |emitter| emitter.id) {
                Ok(i) => &self.emitters[i],
                Err(_) => return 0.0,
            },
        };
        emitter.pdf(distance, cos)
    }
}

impl Emitter {
    /// From density over area to density over solid angle: times the squared distance over the cosine.
    #[inline]
    fn pdf(&self, distance: f32, cos: f32) -> f32 {
        let cos = if self.two_sided { cos.abs() } else { cos };
        let pdf = self.pdf_area * distance * distance / cos;
        // False for NaN as well.
        if cos > 0.0 && pdf >= f32::MIN_POSITIVE && pdf.is_finite() { pdf } else { 0.0 }
    }
}

/// Barycentric weights of a uniform point: a map from the square that keeps neighbours together (Heitz 2019, "A Low-Distortion
/// Map Between Triangle and Square").
#[inline]
fn to_triangle([u, v]: [f32; 2]) -> [f32; 3] {
    let (a, b) = if v > u { (0.5 * u, v - 0.5 * u) } else { (u - 0.5 * v, 0.5 * v) };
    [a, b, (1.0 - a - b).max(0.0)]
}
