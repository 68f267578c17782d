//! Directional albedo of the GGX lobe, tabulated once a process.
//!
//! With the Fresnel reflectance `f0 + (1 - f0) w(c)` the single-scattering albedo is `f0 (e - b) + b`, where `e` is the albedo at
//! reflectance 1 and `b` the part weighted by `w`: Schlick's `(1 - c)^5` for conductors, that of a dielectric for coats. The
//! table holds `b` of the four functions of [`fresnel::basis`], of which every dielectric's is a combination. All depend on
//! (cosine, roughness) only.

use super::ggx::{Ggx, MIN_ALPHA};
use crate::angle::sin_cos_turns;
use crate::number::whole;
use crate::simd;
use glam::{DVec4, Vec3A, Vec4};
use renderflow_frame::fresnel::{self, Dielectric, schlick_weight};
use std::sync::OnceLock;

/// Nodes along the view, even in [`Abscissa`].
pub(super) const COSINES: usize = 48;
/// Nodes along roughness, even in its square root from [`MIN_ALPHA`] on.
pub(super) const ROUGHNESSES: usize = 40;
/// Strata of the integration, (radial, azimuthal over half a turn).
const STRATA: [usize; 2] = [48, 24];
/// Bend of the abscissa that resolves Schlick's `(1 - cos)^5`.
const WIDE: f32 = 0.5;
/// Bend that resolves the layer of grazing views, which is as wide as the lobe: this times `roughness^1.5`.
const NARROW: f32 = 0.12;

/// Where a cosine lies along a row, 0..=1, the mean of two hyperbolae: grazing views are spread out, where the albedo changes
/// fast.
#[derive(Clone, Copy, Debug)]
pub(super) struct Abscissa {
    narrow: f32,
}

impl Abscissa {
    /// `root` is the root of the roughness, `alpha^(1/4)`.
    #[inline(always)]
    pub fn new(root: f32) -> Self {
        Self { narrow: NARROW * root * root * root }
    }

    #[inline(always)]
    pub fn at(self, cos: f32) -> f32 {
        let (wide, narrow) = (cos + WIDE, cos + self.narrow);
        // One division for both hyperbolae.
        0.5 * cos * ((1.0 + WIDE) * narrow + (1.0 + self.narrow) * wide) / (wide * narrow)
    }

    /// Inverse of [`Self::at`] by bisection.
    pub fn cosine(self, x: f32) -> f32 {
        let (mut low, mut high) = (0.0_f32, 1.0_f32);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if self.at(middle) < x { low = middle } else { high = middle }
        }
        if x >= 1.0 { 1.0 } else { low }
    }
}

/// Square root of the roughness below which `alpha` is constant.
pub(super) fn lowest_root() -> f32 {
    MIN_ALPHA.sqrt().sqrt()
}

/// Albedo of a lobe seen at one cosine: `e` of the module's text, and the four `b` less their mirror-like parts `e w(cos)`. The
/// rest is small for smooth surfaces, whose `b` would otherwise need nodes both where `w` changes and where the lobe does; what
/// was taken off is added again for the `w` asked for, exactly.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Albedo {
    /// Albedo with Fresnel reflectance 1.
    pub e: f32,
    pub rest: Vec4,
}

impl Albedo {
    /// From `e` and the four `b`, for a view at `cos`.
    pub fn new(e: f32, parts: Vec4, cos: f32) -> Self {
        Self { e, rest: parts - e * fresnel::basis(cos) }
    }

    #[inline(always)]
    pub fn lerp(self, other: Self, t: f32) -> Self {
        Self { e: self.e + (other.e - self.e) * t, rest: self.rest + (other.rest - self.rest) * t }
    }

    /// The four `b`; here and below `cos` belongs to the view direction.
    pub fn parts(&self, cos: f32) -> Vec4 {
        (self.rest + self.e * fresnel::basis(cos)).max(Vec4::ZERO)
    }

    /// `b` of Schlick's weight.
    #[inline(always)]
    pub fn schlick(&self, cos: f32) -> f32 {
        (self.rest.x + self.e * schlick_weight(cos)).max(0.0)
    }

    /// `b` of a dielectric's weight.
    #[inline(always)]
    pub fn dielectric(&self, surface: &Dielectric, cos: f32) -> f32 {
        (self.rest.dot(surface.coefficients()) + self.e * surface.weight(cos)).max(0.0)
    }

    /// Albedo of a lobe with reflectance `f0` at normal incidence and 1 at grazing incidence, given its `b`.
    #[inline(always)]
    pub fn reflected(&self, f0: f32, b: f32) -> f32 {
        f0 * (self.e - b) + b
    }
}

/// Cosine-weighted hemispherical means `2 * integral of k(c) w(c) c dc` of a function `k` of the cosine `c`, for the weights `w`
/// = `1, c, F, F c, F c^2` with Schlick's `F = (1 - c)^5`.
pub(super) type Moments = [f32; 5];

/// [`Moments`] of `k = 1`.
pub(super) const UNIT_MOMENTS: Moments = [1.0, 2.0 / 3.0, 1.0 / 21.0, 1.0 / 84.0, 1.0 / 252.0];

/// [`Moments`] of `e`, and for each weight of the four `b`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct AlbedoMoments {
    pub whole: Moments,
    pub parts: [Vec4; 5],
}

impl AlbedoMoments {
    #[inline(always)]
    pub fn lerp(&self, other: &Self, t: f32) -> Self {
        Self {
            whole: std::array::from_fn(|k| self.whole[k] + (other.whole[k] - self.whole[k]) * t),
            parts: std::array::from_fn(|k| self.parts[k] + (other.parts[k] - self.parts[k]) * t),
        }
    }

    /// Moments of what a coat lets through that has the weights of `surface` and the reflectance `f0` at normal incidence.
    #[inline(always)]
    pub fn transmitted(&self, f0: f32, surface: &Dielectric) -> Moments {
        let coefficients = (1.0 - f0) * surface.coefficients();
        std::array::from_fn(|k| UNIT_MOMENTS[k] - f0 * self.whole[k] - self.parts[k].dot(coefficients))
    }
}

#[derive(Debug)]
pub(super) struct Table {
    /// `[roughness][cosine]`.
    nodes: Vec<[Albedo; COSINES]>,
    /// Cosines of the nodes of each row.
    pub cosines: Vec<[f32; COSINES]>,
    /// Of each row as interpolated, so that the lobes built on it close exactly.
    moments: Vec<AlbedoMoments>,
    /// [`lowest_root`].
    lowest_root: f32,
    /// Nodes in a unit of the square root.
    nodes_per_root: f32,
}

/// The row of the table that belongs to one roughness.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    index: u32,
    t: f32,
    abscissa: Abscissa,
    table: &'static Table,
}

impl Row {
    /// `roughness` in 0..=1 (above 1, as anisotropic lobes reach along one axis, the last row).
    #[inline(always)]
    pub fn new(roughness: f32) -> Self {
        let table = Table::get();
        let root = roughness.sqrt();
        let x = (root - table.lowest_root).max(0.0) * table.nodes_per_root;
        let i = whole(x).min(ROUGHNESSES - 2);
        let abscissa = Abscissa::new(root.clamp(table.lowest_root, 1.0));
        Self { index: i as u32, t: (x - i as f32).min(1.0), abscissa, table }
    }

    /// Index and share of the upper node along the view, for tables of the same layout.
    #[inline(always)]
    pub fn locate(&self, cos: f32) -> (usize, f32) {
        let x = self.abscissa.at(cos) * (COSINES - 1) as f32;
        let i = whole(x).min(COSINES - 2);
        (i, x - i as f32)
    }

    /// Index and share of the upper row.
    #[inline(always)]
    pub fn rows(&self) -> (usize, f32) {
        (self.index as usize, self.t)
    }

    /// Albedo for a view at cosine 0..=1.
    #[inline(always)]
    pub fn at(&self, cos: f32) -> Albedo {
        let (i, s) = self.locate(cos);
        let (lower, upper) = (&self.table.nodes[self.index as usize], &self.table.nodes[self.index as usize + 1]);
        lower[i].lerp(lower[i + 1], s).lerp(upper[i].lerp(upper[i + 1], s), self.t)
    }

    /// Means over the hemisphere.
    #[inline(always)]
    pub fn moments(&self) -> AlbedoMoments {
        let i = self.index as usize;
        self.table.moments[i].lerp(&self.table.moments[i + 1], self.t)
    }
}

impl Table {
    /// The one table of the process.
    #[inline(always)]
    pub fn get() -> &'static Self {
        static TABLE: OnceLock<Table> = OnceLock::new();
        TABLE.get_or_init(Self::new)
    }

    /// Albedo of row `index` between the nodes `i` and `i + 1`.
    pub fn value(&self, index: usize, i: usize, s: f32) -> Albedo {
        let row = &self.nodes[index];
        row[i].lerp(row[i + 1], s)
    }

    /// Parametrisation of the views of row `index`.
    pub fn abscissa(&self, index: usize) -> Abscissa {
        Abscissa::new(self.root(index))
    }

    /// Roughness of row `index`.
    pub fn roughness(&self, index: usize) -> f32 {
        self.root(index).powi(2)
    }

    fn root(&self, index: usize) -> f32 {
        self.lowest_root + index as f32 / self.nodes_per_root
    }

    fn new() -> Self {
        let lowest_root = lowest_root();
        let root_step = (1.0 - lowest_root) / (ROUGHNESSES - 1) as f32;
        let mut table = Self { nodes: vec![], cosines: vec![], moments: vec![], lowest_root, nodes_per_root: root_step.recip() };
        let row = |i: usize| {
            let (root, abscissa) = (table.root(i), table.abscissa(i));
            let cosines = std::array::from_fn(|j| abscissa.cosine(j as f32 / (COSINES - 1) as f32));
            let ggx = Ggx::new(root.powi(4));
            let row = cosines.map(|cos| integrate(&ggx, cos));
            (row, cosines, moments(&row, &cosines, abscissa))
        };
        for (row, cosines, moments) in on_threads(ROUGHNESSES, row) {
            table.nodes.push(row);
            table.cosines.push(cosines);
            table.moments.push(moments);
        }
        table
    }
}

/// `make` of the numbers below `count`, on threads of its own. Not rayon's: a worker that waits here would pick up a tile, come
/// back for the table and wait for itself. Its workers all wait for this table at first, so that their processors are free.
pub(super) fn on_threads<T: Send>(count: usize, make: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get()).min(rayon::current_num_threads()).min(8);
    let part = |k: usize| (k..count).step_by(threads).map(&make).collect::<Vec<_>>();
    let part = &part;
    let mut parts: Vec<_> = std::thread::scope(|scope| {
        let helpers: Vec<_> =
            (1..threads).map(|k| std::thread::Builder::new().spawn_scoped(scope, move || part(k)).ok()).collect();
        let first = part(0);
        // A thread that could not be had: its part is made here.
        let join = |(k, helper): (usize, Option<std::thread::ScopedJoinHandle<'_, _>>)| {
            helper.and_then(|helper| helper.join().ok()).unwrap_or_else(|| part(k))
        };
        std::iter::once(first).chain((1..).zip(helpers).map(join)).map(Vec::into_iter).collect()
    });
    (0..count).filter_map(|i| parts[i % threads].next()).collect()
}

/// Albedo for an isotropic surface.
fn integrate(ggx: &Ggx<false>, cos: f32) -> Albedo {
    // At exactly grazing view the albedo is a limit; a cosine this small is on it.
    let view = cos.clamp(1e-6, 1.0);
    let (e, parts) = integrate_view(ggx, Vec3A::new((1.0 - view * view).sqrt(), 0.0, view), 0.5, STRATA);
    Albedo::new(e, parts, cos)
}

/// `e` and the four `b`. Midpoint rule over visible normals: the mean of `G2 / G1` is the albedo. `turn` is the share of a turn
/// of azimuths that stands for all of them (0.5 where the two halves mirror each other).
pub(super) fn integrate_view<const A: bool>(ggx: &Ggx<A>, wo: Vec3A, turn: f32, strata: [usize; 2]) -> (f32, Vec4) {
    simd::run(View { ggx, wo, turn, strata })
}

/// The arguments of [`integrate_view`].
struct View<'a, const A: bool> {
    ggx: &'a Ggx<A>,
    wo: Vec3A,
    turn: f32,
    strata: [usize; 2],
}

impl<const A: bool> simd::Work for View<'_, A> {
    type Output = (f32, Vec4);
    #[inline(always)]
    fn run(self) -> (f32, Vec4) {
        self.integrate()
    }
}

/// Azimuths that are integrated together.
const LANES: usize = 16;

/// Azimuths: sine and cosine of each draw, and its weight; 0 beyond the last one.
#[derive(Clone, Copy, Default)]
struct Azimuths {
    sin: [f32; LANES],
    cos: [f32; LANES],
    share: [f32; LANES],
}

impl<const A: bool> View<'_, A> {
    #[inline(always)]
    fn integrate(self) -> (f32, Vec4) {
        let Self { ggx, wo, strata, .. } = self;
        let azimuths = self.azimuths();
        let caps = ggx.caps(wo);
        let (mut e, mut parts) = (0.0_f64, DVec4::ZERO);
        for i in 0..strata[0] {
            // Finer towards u = 1, where the mirrored directions meet the horizon: equal strata err by half of one there.
            let s = (i as f32 + 0.5) / strata[0] as f32;
            // Facets of a lobe wider than 1 reflect upwards only where u is small.
            let (u, weight) = if A { ((1.0 - s * s).powi(2), 4.0 * s * (1.0 - s * s)) } else { (1.0 - s * s, 2.0 * s) };
            let ring = caps.ring(u);
            for Azimuths { sin, cos, share } in &azimuths {
                let mut sums = [[0.0; LANES]; 5];
                for lane in 0..LANES {
                    let [x, y, z] = ggx.mirrored(wo, &caps, ring, (sin[lane], cos[lane]));
                    let own = weight * share[lane] * ggx.masking_ratio(wo, Vec3A::new(x, y, z));
                    let (hx, hy, hz) = (wo.x + x, wo.y + y, wo.z + z);
                    let basis = fresnel::basis_numbers(0.5 * (hx * hx + hy * hy + hz * hz).sqrt());
                    let up = z > 0.0;
                    sums[0][lane] = if up { own } else { 0.0 };
                    for (sum, value) in sums[1..].iter_mut().zip(basis) {
                        sum[lane] = if up { own * value } else { 0.0 };
                    }
                }
                let [whole, schlick, low, middle, high] = &sums;
                for lane in 0..LANES {
                    e += f64::from(whole[lane]);
                    parts += Vec4::new(schlick[lane], low[lane], middle[lane], high[lane]).as_dvec4();
                }
            }
        }
        let n = (strata[0] * strata[1]) as f64;
        ((e / n).min(1.0) as f32, (parts / n).min(DVec4::ONE).as_vec4())
    }

    /// Draws of a lobe much wider along x than along y turn within a narrow range of azimuths about y: they are finer there. The
    /// warp is (cos, sin) -> (stretch cos, sin), normalised.
    #[inline(always)]
    fn azimuths(&self) -> Vec<Azimuths> {
        let (stretch, count) = (self.ggx.stretch(), self.strata[1]);
        let mut azimuths = vec![Azimuths::default(); count.div_ceil(LANES)];
        for j in 0..count {
            let (sin, cos) = (std::f32::consts::TAU * self.turn * (j as f32 + 0.5) / count as f32).sin_cos();
            let u = sin.atan2(stretch * cos) / std::f32::consts::TAU;
            let (to, lane) = (&mut azimuths[j / LANES], j % LANES);
            (to.sin[lane], to.cos[lane]) = sin_cos_turns(u - u.floor());
            to.share[lane] = stretch / (stretch * stretch * cos * cos + sin * sin);
        }
        azimuths
    }
}

/// Five-point Gauss rule on 0..1.
pub(super) const GAUSS: [(f64, f64); 5] = [
    (0.046_910_077_030_668, 0.118_463_442_528_094_5),
    (0.230_765_344_947_158_5, 0.239_314_335_249_683_2),
    (0.5, 0.284_444_444_444_444_4),
    (0.769_234_655_052_841_5, 0.239_314_335_249_683_2),
    (0.953_089_922_969_332, 0.118_463_442_528_094_5),
];

/// Calls `visit(node, share of the upper node, cosine, weight)` at the points of a cosine-weighted mean over the hemisphere,
/// taken interval by interval of a row's interpolant. The weights sum to 1.
pub(super) fn quadrature(cosines: &[f32; COSINES], abscissa: Abscissa, mut visit: impl FnMut(usize, f32, f64, f64)) {
    for (i, pair) in cosines.windows(2).enumerate() {
        let (low, step) = (f64::from(pair[0]), f64::from(pair[1] - pair[0]));
        for (x, weight) in GAUSS {
            let cos = low + step * x;
            let s = (abscissa.at(cos as f32) * (COSINES - 1) as f32 - i as f32).clamp(0.0, 1.0);
            visit(i, s, cos, 2.0 * cos * step * weight);
        }
    }
}

/// [`AlbedoMoments`] of a row.
fn moments(row: &[Albedo; COSINES], cosines: &[f32; COSINES], abscissa: Abscissa) -> AlbedoMoments {
    let (mut whole, mut sums) = ([0.0_f64; 5], [DVec4::ZERO; 5]);
    quadrature(cosines, abscissa, |i, s, cos, weight| {
        let albedo = row[i].lerp(row[i + 1], s);
        let parts = albedo.parts(cos as f32).as_dvec4();
        let f = (1.0 - cos).powi(5);
        for (k, factor) in [1.0, cos, f, f * cos, f * cos * cos].into_iter().enumerate() {
            whole[k] += weight * factor * f64::from(albedo.e);
            sums[k] += weight * factor * parts;
        }
    });
    AlbedoMoments { whole: whole.map(|v| v as f32), parts: sums.map(|v| v.as_vec4()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::ggx::alpha_xy;

    /// One draw after the other, each by the lobe's own functions.
    fn one_by_one<const A: bool>(ggx: &Ggx<A>, wo: Vec3A, turn: f32, strata: [usize; 2]) -> (f32, Vec4) {
        let (mut e, mut parts, stretch) = (0.0_f64, DVec4::ZERO, ggx.stretch());
        for i in 0..strata[0] {
            let s = (i as f32 + 0.5) / strata[0] as f32;
            let (u, weight) = if A { ((1.0 - s * s).powi(2), 4.0 * s * (1.0 - s * s)) } else { (1.0 - s * s, 2.0 * s) };
            for j in 0..strata[1] {
                let (sin, cos) = (std::f32::consts::TAU * turn * (j as f32 + 0.5) / strata[1] as f32).sin_cos();
                let azimuth = sin.atan2(stretch * cos) / std::f32::consts::TAU;
                let share = stretch / (stretch * stretch * cos * cos + sin * sin);
                if let Some(wi) = ggx.sample(wo, [u, azimuth - azimuth.floor()]).filter(|wi| wi.z > 0.0) {
                    let weight = weight * share * ggx.masking_ratio(wo, wi);
                    e += f64::from(weight);
                    parts += (weight * fresnel::basis(0.5 * (wo + wi).length())).as_dvec4();
                }
            }
        }
        let n = (strata[0] * strata[1]) as f64;
        ((e / n).min(1.0) as f32, (parts / n).min(DVec4::ONE).as_vec4())
    }

    #[test]
    fn sixteen_azimuths_together_give_the_bits_of_one_by_one() {
        let bits = |(e, parts): (f32, Vec4)| (e.to_bits(), parts.to_array().map(f32::to_bits));
        for roughness in [0.0, 0.1, 0.4, 0.8, 1.0] {
            for cos in [1e-6, 0.01, 0.3, 0.9, 1.0_f32] {
                let wo = Vec3A::new(0.6, 0.8, 0.0) * (1.0 - cos * cos).sqrt() + Vec3A::Z * cos;
                for strata in [[12, 24], [20, 40], [5, 1], [3, 17]] {
                    let round = Ggx::<false>::new(super::super::ggx::alpha(roughness));
                    let (found, expected) = (integrate_view(&round, wo, 0.5, strata), one_by_one(&round, wo, 0.5, strata));
                    assert_eq!(bits(found), bits(expected), "{roughness} {cos} {strata:?}");
                    let long = Ggx::<true>::with_widths(alpha_xy(roughness, 0.9));
                    let (found, expected) = (integrate_view(&long, wo, 1.0, strata), one_by_one(&long, wo, 1.0, strata));
                    assert_eq!(bits(found), bits(expected), "anisotropic, {roughness} {cos} {strata:?}");
                }
            }
        }
    }

    /// The numbers come from `tests/references/ggx_albedo.py`, which integrates the BRDF in another parametrisation.
    #[test]
    fn table_agrees_with_an_independent_integration() {
        let mut worst: f32 = 0.0;
        for line in include_str!("../../tests/references/ggx_albedo.csv").lines().skip(1) {
            let numbers: Vec<f32> = line.split(',').map(|field| field.parse().unwrap()).collect();
            let [alpha, cos, e, b, glass, water, aerogel] = numbers[..] else { panic!("{line}") };
            let albedo = Row::new(alpha.sqrt()).at(cos);
            worst = worst.max((albedo.e - e).abs()).max((albedo.schlick(cos) - b).abs());
            for (index, expected) in [(1.5_f32, glass), (1.33, water), (1.1, aerogel)] {
                let surface = Dielectric::new(((index - 1.0) / (index + 1.0)).powi(2));
                worst = worst.max((albedo.reflected(surface.f0(), albedo.dielectric(&surface, cos)) - expected).abs());
            }
        }
        println!("worst: {worst}");
        assert!(worst < 0.003, "{worst}");
    }

    #[test]
    fn moments_are_those_of_the_interpolant() {
        for roughness in [0.0, 0.1, 0.5, 0.77, 1.0] {
            let row = Row::new(roughness);
            let n = 100_000;
            let (mut whole, mut sums) = ([0.0_f64; 5], [DVec4::ZERO; 5]);
            for i in 0..n {
                // Uniform in cos^2: the weight 2 cos dcos.
                let cos = ((i as f64 + 0.5) / n as f64).sqrt();
                let (albedo, f) = (row.at(cos as f32), (1.0 - cos).powi(5));
                let parts = albedo.parts(cos as f32).as_dvec4();
                for (k, factor) in [1.0, cos, f, f * cos, f * cos * cos].into_iter().enumerate() {
                    whole[k] += factor * f64::from(albedo.e) / f64::from(n);
                    sums[k] += factor * parts / f64::from(n);
                }
            }
            let moments = row.moments();
            for k in 0..5 {
                let (a, b) = (moments.whole[k], moments.parts[k]);
                assert!((whole[k] - f64::from(a)).abs() < 1e-4, "{roughness}: {} {a}", whole[k]);
                assert!((sums[k] - b.as_dvec4()).abs().max_element() < 1e-4, "{roughness}: {} {b}", sums[k]);
            }
        }
    }

    /// Between the nodes, against an integration with nine times the strata.
    #[test]
    fn table_is_within_a_thousandth() {
        let mut worst = (0.0_f32, String::new());
        for i in 0..40 {
            let roughness = (i as f32 + 0.5) / 40.0;
            let row = Row::new(roughness);
            for cos in [0.0, 1e-4, 1e-3, 0.003, 0.01, 0.02, 0.035, 0.07, 0.15, 0.3, 0.55, 0.8, 0.95, 1.0_f32] {
                let view = cos.max(1e-6);
                let wo = Vec3A::new((1.0 - view * view).sqrt(), 0.0, view);
                let (e, parts) = integrate_view(&Ggx::new(super::super::ggx::alpha(roughness)), wo, 0.5, [144, 72]);
                let albedo = row.at(cos);
                let error = ((albedo.e - e) / e).abs().max((albedo.parts(cos) - parts).abs().max_element());
                if error > worst.0 {
                    worst = (error, format!("roughness {roughness} cos {cos}: {} {}, {e} {parts}", albedo.e, albedo.parts(cos)));
                }
            }
        }
        println!("worst: {} {}", worst.0, worst.1);
        assert!(worst.0 < 1.2e-3, "{} {}", worst.0, worst.1);
    }
}
