//! A tree over lights, by which those are drawn often that may send much to a point: near, strong, and shining there (Conty
//! Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting"; Pharr, Jakob and Humphreys 2023,
//! section 12.6.3). The tree is not split adaptively: one light is drawn at a time.
//!
//! On the way down, a node's share of the random numbers is divided among its four children by their importance, in whole
//! numbers. The share that is left at a light is exactly how often it is drawn, however deep it lies, and following the same way
//! without a random number gives it again. A light that may send anything keeps one of the 2^46 random numbers at least, unless
//! they run out.
//!
//! The tree is built with two children a node. Every other level is then left out, so that four children are judged at once.

use super::emitters::Receiver;
use glam::{BVec4A, Vec3A, Vec4};
use rayon::join;
use std::f32::consts::{FRAC_PI_2, PI};

/// A light as the tree sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct TreeLight {
    /// Number of the light.
    pub item: u32,
    /// Box around it.
    pub low: Vec3A,
    pub high: Vec3A,
    /// Unit direction that it mainly shines into.
    pub axis: Vec3A,
    /// Radians about the axis within which it shines fully, and radians beyond these where it ends.
    pub theta_o: f32,
    pub theta_e: f32,
    /// Whether it shines along -`axis` too.
    pub two_sided: bool,
    /// Intensity along the axis, relative to the largest, 0..=1.
    pub strength: f32,
}

/// A subtree, or a light.
#[derive(Clone, Copy, Debug)]
struct Bound {
    /// A ball around all its lights.
    center: [f32; 3],
    radius: f32,
    /// A cone around the directions that they mainly shine into.
    axis: [f32; 3],
    strength: f32,
    cos_o: f32,
    /// Cosine of the angle beyond the cone where all end.
    cos_e: f32,
    /// Number of a node; with [`LEAF`] that of a light. [`TWO_SIDED`] where one of its lights is.
    reference: u32,
}

const LEAF: u32 = 1 << 31;
const TWO_SIDED: u32 = 1 << 30;
const NUMBER: u32 = TWO_SIDED - 1;

impl Bound {
    const NOTHING: Self =
        Self { center: [0.0; 3], radius: 0.0, axis: [0.0; 3], strength: 0.0, cos_o: 0.0, cos_e: 0.0, reference: 0 };
}

/// Children of a node as the tree is built.
type Pair = [Bound; 2];

/// Four subtrees or lights, with the numbers of [`Bound`]; those that are not there have no strength.
#[derive(Clone, Copy, Debug)]
struct Node {
    center: [Vec4; 3],
    radius: Vec4,
    axis: [Vec4; 3],
    strength: Vec4,
    cos_o: Vec4,
    sin_o: Vec4,
    cos_e: Vec4,
    /// 1 where one of the lights is two-sided, otherwise 0.
    two_sided: Vec4,
    references: [u32; 4],
}

/// The tree.
#[derive(Clone, Debug)]
pub(super) struct LightTree {
    /// The first is the root.
    nodes: Vec<Node>,
    root: u32,
    /// The way to each light: bits 2k and 2k + 1 are the number of the child that it goes on to at depth k.
    ways: Vec<u64>,
    /// Random numbers that lead here.
    range: u64,
}

/// Cosines this far below the horizon may be rounding.
const ROUNDING: f32 = 1e-3;
/// Cosines count as at least this. Importance is a guess; where it is too small the rare sample counts too much: bounds are
/// loose at grazing angles, shading normals lean, and shiny surfaces are brightest there.
const LEAST_COS: f32 = 0.05;
/// Least strength, and least squared distance: sums of importances stay positive and finite.
const LEAST: f32 = 1e-36;
/// From this depth on lists are halved, so that a way has less than 64 steps.
const DEEP: u32 = 30;
/// Places at which a list is tried to be cut.
const BINS: usize = 12;
/// Lists this long are built by several threads.
const MANY: usize = 4096;

impl LightTree {
    /// A tree over `lights`, at least one, for [`Self::pick`] of `0..range`, at most 2^46. [`TreeLight::item`] are `0..` their
    /// number.
    pub fn new(mut lights: Vec<TreeLight>, range: u64) -> Option<Self> {
        if lights.is_empty() || lights.len() >= NUMBER as usize || range == 0 {
            return None;
        }
        let mut pairs = vec![[Bound::NOTHING; 2]; lights.len() - 1];
        let root = build(&mut lights, &mut pairs, 0, 0).reference;
        let mut tree = Self { nodes: Vec::new(), root: root & (LEAF | NUMBER), ways: vec![0; lights.len()], range };
        if root & LEAF == 0 {
            tree.collapse(&pairs);
        }
        Some(tree)
    }

    /// Makes the nodes from `pairs`, of which the first is the root.
    fn collapse(&mut self, pairs: &[Pair]) {
        self.nodes.push(Node::EMPTY);
        // Pairs that become nodes: number, node, depth, and the way there.
        let mut open: Vec<(usize, usize, u32, u64)> = vec![(0, 0, 0, 0)];
        let mut children = Vec::with_capacity(4);
        while let Some((pair, node, depth, way)) = open.pop() {
            children.clear();
            for child in pairs[pair] {
                match child.reference & LEAF {
                    0 => children.extend(pairs[(child.reference & NUMBER) as usize]),
                    _ => children.push(child),
                }
            }
            for (k, child) in children.iter().enumerate() {
                let (number, way) = (child.reference & NUMBER, way | (k as u64) << (2 * depth));
                let leaf = child.reference & LEAF != 0;
                let reference = if leaf { LEAF | number } else { self.nodes.len() as u32 };
                self.nodes[node].set(k, child, reference);
                if leaf {
                    self.ways[number as usize] = way;
                } else {
                    self.nodes.push(Node::EMPTY);
                    open.push((number as usize, reference as usize, depth + 1, way));
                }
            }
        }
    }

    /// The light that random number `unit` of the range leads to, and how many of all lead there. `None` where it leads to lights
    /// that send nothing to `at`.
    #[inline]
    pub fn pick(&self, mut unit: u64, at: &Receiver) -> Option<(usize, u64)> {
        let (mut reference, mut range) = (self.root, self.range);
        while reference & LEAF == 0 {
            let node = self.nodes.get(reference as usize)?;
            let parts = node.parts(range, at)?;
            let mut child = 0;
            while child < 3 && unit >= parts[child] {
                unit -= parts[child];
                child += 1;
            }
            range = parts[child];
            reference = node.references[child];
        }
        Some(((reference & NUMBER) as usize, range))
    }

    /// How many of all random numbers lead to light `item`.
    #[inline]
    pub fn units(&self, item: usize, at: &Receiver) -> u64 {
        let (mut reference, mut range, mut way) = (self.root, self.range, self.ways[item]);
        while reference & LEAF == 0 {
            let node = &self.nodes[reference as usize];
            let child = (way & 3) as usize;
            match node.parts(range, at) {
                Some(parts) if parts[child] > 0 => range = parts[child],
                _ => return 0,
            }
            reference = node.references[child];
            way >>= 2;
        }
        range
    }
}

/// Cosine and sine of the angle a - b, 0 where b is larger.
#[inline(always)]
fn less((sin_a, cos_a): (Vec4, Vec4), (sin_b, cos_b): (Vec4, Vec4)) -> (Vec4, Vec4) {
    let smaller = cos_a.cmpgt(cos_b);
    let sin = Vec4::select(smaller, Vec4::ZERO, sin_a * cos_b - cos_a * sin_b);
    (sin, Vec4::select(smaller, Vec4::ONE, cos_a * cos_b + sin_a * sin_b))
}

#[inline(always)]
fn sin_of(cos: Vec4) -> Vec4 {
    (1.0 - cos * cos).max(Vec4::ZERO).sqrt()
}

#[inline(always)]
fn dot(a: &[Vec4; 3], b: &[Vec4; 3]) -> Vec4 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Node {
    const EMPTY: Self = Self {
        center: [Vec4::ZERO; 3],
        radius: Vec4::ZERO,
        axis: [Vec4::ZERO; 3],
        strength: Vec4::ZERO,
        cos_o: Vec4::ZERO,
        sin_o: Vec4::ZERO,
        cos_e: Vec4::ZERO,
        two_sided: Vec4::ZERO,
        references: [0; 4],
    };

    fn set(&mut self, k: usize, child: &Bound, reference: u32) {
        for along in 0..3 {
            self.center[along][k] = child.center[along];
            self.axis[along][k] = child.axis[along];
        }
        self.radius[k] = child.radius;
        self.strength[k] = child.strength;
        self.cos_o[k] = child.cos_o;
        self.sin_o[k] = (1.0 - child.cos_o * child.cos_o).max(0.0).sqrt();
        self.cos_e[k] = child.cos_e;
        self.two_sided[k] = if child.reference & TWO_SIDED != 0 { 1.0 } else { 0.0 };
        self.references[k] = reference;
    }

    /// How many of `range` random numbers lead to each child; `None` where none of them sends anything to `at`.
    #[inline(always)]
    fn parts(&self, range: u64, at: &Receiver) -> Option<[u64; 4]> {
        let importance = self.importance(at).to_array();
        let mut sums = importance.map(f64::from);
        for k in 1..4 {
            sums[k] += sums[k - 1];
        }
        let positive = importance.iter().filter(|&&v| v > 0.0).count() as u64;
        if positive == 0 {
            return None;
        }
        let Some(spare) = range.checked_sub(positive) else {
            // One each, until there are no more.
            let mut left = range;
            return Some(importance.map(|v| {
                let one = u64::from(v > 0.0).min(left);
                left -= one;
                one
            }));
        };
        // The last sum is the largest, so that nothing is left over.
        let scale = spare as f64;
        let mut before = 0;
        Some(std::array::from_fn(|k| {
            let until = (sums[k] / sums[3] * scale) as u64;
            let part = until - before + u64::from(importance[k] > 0.0);
            before = until;
            part
        }))
    }

    /// What the children may send to a point, roughly; 0 only where they send nothing.
    #[inline(always)]
    fn importance(&self, at: &Receiver) -> Vec4 {
        let spread = |v: Vec3A| [Vec4::splat(v.x), Vec4::splat(v.y), Vec4::splat(v.z)];
        let p = spread(at.p);
        let towards = [self.center[0] - p[0], self.center[1] - p[1], self.center[2] - p[2]];
        let (d2, r2) = (dot(&towards, &towards), self.radius * self.radius);
        let inverse = d2.sqrt().recip();
        // The angle that the ball covers.
        let sin_b = (self.radius * inverse).min(Vec4::ONE);
        let ball = (sin_b, sin_of(sin_b));
        let cos_w = -dot(&self.axis, &towards) * inverse;
        let cos_w = Vec4::select(self.two_sided.cmpgt(Vec4::ZERO), cos_w.abs(), cos_w);
        let (_, cos) = less(less((sin_of(cos_w), cos_w), (self.sin_o, self.cos_o)), ball);
        let mut sends: BVec4A = cos.cmpgt(self.cos_e - ROUNDING);
        let mut importance = self.strength * cos.max(Vec4::splat(LEAST_COS)) / d2.max(Vec4::splat(LEAST));
        if at.n != Vec3A::ZERO {
            let cos_i = dot(&spread(at.n), &towards) * inverse;
            let (_, cos) = less((sin_of(cos_i), cos_i), ball);
            sends &= cos.cmpgt(Vec4::splat(-ROUNDING));
            importance *= cos.max(Vec4::splat(LEAST_COS));
        }
        // In the ball, light may come from anywhere.
        let inside = d2.cmple(r2);
        let importance = Vec4::select(inside, self.strength / r2.max(Vec4::splat(LEAST)), importance);
        let sends = (sends | inside) & self.strength.cmpgt(Vec4::ZERO);
        Vec4::select(sends, importance.clamp(Vec4::splat(f32::MIN_POSITIVE), Vec4::splat(f32::MAX)), Vec4::ZERO)
    }
}

/// Builds the subtree of `lights`, with one pair less than these; `first` is the number of its first pair, that of its root.
fn build(lights: &mut [TreeLight], pairs: &mut [Pair], first: u32, depth: u32) -> Bound {
    if let [light] = lights {
        return around(&[*light], LEAF | light.item);
    }
    let middle = cut(lights, depth);
    let whole = around(lights, first);
    let count = lights.len();
    let (lights, more) = lights.split_at_mut(middle);
    let Some((pair, pairs)) = pairs.split_first_mut() else { return whole };
    let (pairs, more_pairs) = pairs.split_at_mut(middle - 1);
    let left = || build(lights, pairs, first + 1, depth + 1);
    let right = || build(more, more_pairs, first + middle as u32, depth + 1);
    *pair = if count >= MANY {
        join(left, right).into()
    } else {
        let (mut left, mut right) = (left, right);
        [left(), right()]
    };
    whole
}

/// The bound of `lights`.
fn around(lights: &[TreeLight], reference: u32) -> Bound {
    let two_sided = lights.iter().any(|light| light.two_sided);
    let (mut low, mut high) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
    let (mut strength, mut theta_e, mut sum) = (0.0_f64, 0.0_f32, Vec3A::ZERO);
    let reference_axis = lights[0].axis;
    for light in lights {
        low = low.min(light.low);
        high = high.max(light.high);
        strength += f64::from(light.strength);
        theta_e = theta_e.max(light.theta_e);
        sum += if two_sided && light.axis.dot(reference_axis) < 0.0 { -light.axis } else { light.axis };
    }
    let axis = sum.try_normalize().unwrap_or(reference_axis);
    let mut cos_o = 1.0_f32;
    for light in lights {
        let cos = axis.dot(light.axis).clamp(-1.0, 1.0);
        let cos = if two_sided { cos.abs() } else { cos };
        cos_o = cos_o.min(if light.theta_o == 0.0 { cos } else { (cos.acos() + light.theta_o).min(PI).cos() });
    }
    // A little wider, for rounding.
    let cos_o = (cos_o - 1e-6).max(-1.0);
    // Halves, so that nothing overflows.
    let center = 0.5 * low + 0.5 * high;
    let radius = (0.5 * high - 0.5 * low).length() * (1.0 + 1e-6) + center.abs().max_element() * 2e-7;
    Bound {
        center: center.to_array(),
        radius,
        axis: axis.to_array(),
        strength: (strength as f32).max(LEAST),
        cos_o,
        cos_e: theta_e.min(PI).cos(),
        reference: reference | if two_sided { TWO_SIDED } else { 0 },
    }
}

/// What the lights of a bin are together.
#[derive(Clone, Copy)]
struct Bin {
    count: usize,
    low: Vec3A,
    high: Vec3A,
    /// Sum of the axes, those of two-sided lights turned to one half.
    axes: Vec3A,
    strength: f32,
    theta_o: f32,
    theta_e: f32,
}

impl Bin {
    const EMPTY: Self = Self {
        count: 0,
        low: Vec3A::INFINITY,
        high: Vec3A::NEG_INFINITY,
        axes: Vec3A::ZERO,
        strength: 0.0,
        theta_o: 0.0,
        theta_e: 0.0,
    };

    fn add(&mut self, light: &TreeLight) {
        let axis = if light.two_sided {
            let largest = light.axis.abs().max_position();
            light.axis * light.axis.to_array()[largest].signum()
        } else {
            light.axis
        };
        *self = self.and(&Self {
            count: 1,
            low: light.low,
            high: light.high,
            axes: axis,
            strength: light.strength,
            theta_o: light.theta_o,
            theta_e: light.theta_e,
        });
    }

    fn and(&self, other: &Self) -> Self {
        Self {
            count: self.count + other.count,
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            axes: self.axes + other.axes,
            strength: self.strength + other.strength,
            theta_o: self.theta_o.max(other.theta_o),
            theta_e: self.theta_e.max(other.theta_e),
        }
    }

    /// Strength times the surface of the box times the measure of the directions (Conty Estevez and Kulla, section 4.1). The cone
    /// of directions is guessed from the length of their mean, `(1 + cos) / 2` for directions that fill a cone evenly: that is a
    /// sum, which a bound is not.
    fn cost(&self) -> f32 {
        let size = self.high - self.low;
        let surface = size.x * size.y + size.y * size.z + size.z * size.x;
        // A line and a point have no surface, but count.
        let surface = surface.max(size.max_element().powi(2) * 1e-3);
        let cos = (2.0 * self.axes.length() / self.count.max(1) as f32 - 1.0).clamp(-1.0, 1.0);
        let theta_o = (cos.acos() + self.theta_o).min(PI);
        let theta_w = (theta_o + self.theta_e).min(PI);
        let (sin, cos) = theta_o.sin_cos();
        let spread = 2.0 * PI * (1.0 - cos)
            + FRAC_PI_2 * (2.0 * theta_w * sin - (theta_o - 2.0 * theta_w).cos() - 2.0 * theta_o * sin + cos);
        self.strength * surface * spread
    }
}

/// Orders `lights`, at least two, so that those of the first child come first; returns their number, neither 0 nor all.
fn cut(lights: &mut [TreeLight], depth: u32) -> usize {
    let count = lights.len();
    if count == 2 {
        return 1;
    }
    let center = |light: &TreeLight| 0.5 * light.low + 0.5 * light.high;
    let (mut low, mut high) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
    for light in lights.iter() {
        low = low.min(center(light));
        high = high.max(center(light));
    }
    let size = high - low;
    let longest = size.max_position();
    let bins = count.min(BINS);
    let place = |light: &TreeLight, along: usize| {
        let (at, low, size) = (center(light).to_array()[along], low.to_array()[along], size.to_array()[along]);
        (((at - low) / size * bins as f32) as usize).min(bins - 1)
    };
    let mut best: Option<(f32, usize, usize)> = None;
    if depth < DEEP {
        for along in (0..3).filter(|&along| size.to_array()[along] > 0.0 && size.is_finite()) {
            let mut filled = [Bin::EMPTY; BINS];
            lights.iter().for_each(|light| filled[place(light, along)].add(light));
            let mut above = [Bin::EMPTY; BINS];
            for k in (0..bins - 1).rev() {
                above[k] = filled[k + 1].and(&above[k + 1]);
            }
            let mut below = Bin::EMPTY;
            // Thin parts are cut across.
            let shape = size.max_element() / size.to_array()[along];
            for k in 0..bins - 1 {
                below = below.and(&filled[k]);
                if below.count > 0 && above[k].count > 0 {
                    let cost = (below.cost() + above[k].cost()) * shape;
                    if best.is_none_or(|(least, ..)| cost < least) {
                        best = Some((cost, along, k));
                    }
                }
            }
        }
    }
    if let Some((_, along, last)) = best {
        // Both ends run towards each other.
        let (mut from, mut to) = (0, count);
        while from < to {
            if place(&lights[from], along) <= last {
                from += 1;
            } else {
                to -= 1;
                lights.swap(from, to);
            }
        }
        if from > 0 && from < count {
            return from;
        }
    }
    let key = |light: &TreeLight| center(light).to_array()[longest];
    lights.select_nth_unstable_by(count / 2, |a, b| key(a).total_cmp(&key(b)).then(a.item.cmp(&b.item)));
    count / 2
}

#[cfg(test)]
mod tests;
