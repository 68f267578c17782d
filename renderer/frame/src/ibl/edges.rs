//! Pixels in which two surfaces meet. Their filtered albedo and normal are a mean of both, and shading the mean is not the mean
//! of the shadings: a rim of metal would mirror what neither surface mirrors. So each surface is shaded by itself, and then they
//! are blended.

use super::shade::brdf_at;
use crate::image::{Image, Rgb};
use crate::{Frame, is_depth};
use glam::Vec3A;
use rayon::prelude::*;

/// Squared distance between the surface in the middle of a pixel and the mean over the pixel above which the pixel may be an
/// edge. Albedo counts in full, and normals count half.
const MIXED: f32 = 0.0025;
/// Least squared distance between two surfaces that can be told apart.
const APART: f32 = 0.01;
/// Least coverage of the pixel and of its neighbour: where the environment shows as well, coverage already says how much.
const COVERED: f32 = 0.999;
/// Surfaces with normals whose cosine is below this meet at an edge.
const CREASE: f32 = 0.9;
/// Relative difference in depth from which one surface is behind the other.
const STEP: f32 = 0.03;
/// Share of the distance that a blend of two surfaces must explain.
const EXPLAINED: f32 = 0.5;

/// A pixel whose mean is a blend of the surface in its middle and of a neighbour's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// Index of the pixel.
    pub at: usize,
    /// Index of the neighbour.
    pub other: usize,
    /// Share of the neighbour's surface, 0..=1.
    pub share: f32,
    /// What the pixel shows on the whole: albedo, camera-space unit normal, and scale and bias of the split sum.
    mean: ([f32; 3], [f32; 3], [f32; 2]),
}

/// The surface in the middle of a pixel, or the mean over a pixel.
#[derive(Clone, Copy)]
struct Point {
    albedo: Vec3A,
    normal: Vec3A,
}

impl Point {
    fn minus(self, other: Self) -> Self {
        Self { albedo: self.albedo - other.albedo, normal: self.normal - other.normal }
    }

    fn dot(self, other: Self) -> f32 {
        self.albedo.dot(other.albedo) + 0.25 * self.normal.dot(other.normal)
    }
}

/// The normal in the middle of pixel `i`.
fn normal_of(frame: &Frame, i: usize) -> Vec3A {
    Vec3A::from_array(frame.normal.pixels[i]).normalize_or_zero()
}

/// Whether the surfaces in the middles of pixels `i` and `j` are two.
fn differ(frame: &Frame, i: usize, j: usize) -> bool {
    let [a, b] = [i, j].map(|k| frame.depth.pixels[k]);
    let [m, n] = [i, j].map(|k| frame.material.pixels[k]);
    m != n || (a - b).abs() > STEP * a.min(b) || normal_of(frame, i).dot(normal_of(frame, j)) < CREASE
}

/// How much the normal changes across pixel (x, y), along x and along y: to the pixel beside it that shows the same surface with
/// the smaller change; 0 where there is none.
pub(super) fn bend(frame: &Frame, x: usize, y: usize) -> [[f32; 3]; 2] {
    let (width, height) = (frame.width, frame.height);
    let at = y * width + x;
    if !is_depth(frame.depth.pixels[at]) {
        return [[0.0; 3]; 2];
    }
    let beside = |before: Option<usize>, after: Option<usize>| {
        let same = |j: &usize| is_depth(frame.depth.pixels[*j]) && !differ(frame, at, *j);
        let change = |from: usize, to: usize| normal_of(frame, to) - normal_of(frame, from);
        let changes = [before.filter(same).map(|j| change(j, at)), after.filter(same).map(|j| change(at, j))];
        let least = changes.into_iter().flatten().min_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
        least.filter(|change| change.is_finite()).map_or([0.0; 3], |change| change.to_array())
    };
    let across = beside((x > 0).then(|| at - 1), (x + 1 < width).then_some(at + 1));
    let down = beside((y > 0).then(|| at - width), (y + 1 < height).then_some(at + width));
    [across, down]
}

/// The edges of `frame`, in the order of pixels; none without anti-aliased guides. The result has the same bits for any number of
/// threads.
pub(super) fn find(frame: &Frame) -> Vec<(usize, usize, f32)> {
    let (Some(albedo), Some(normal)) = (&frame.guide_albedo, &frame.guide_normal) else { return Vec::new() };
    let (width, height) = (frame.width, frame.height);
    let clear = |i: usize| frame.through.as_ref().is_some_and(|through| through.pixels[i] != [0.0; 3]);
    let whole = |i: usize| frame.alpha.pixels[i] >= COVERED && is_depth(frame.depth.pixels[i]) && !clear(i);
    let middle = |i: usize| Point { albedo: Vec3A::from_array(frame.albedo.pixels[i]), normal: normal_of(frame, i) };
    let edge = |i: usize| {
        if !whole(i) {
            return None;
        }
        let own = middle(i);
        let mean = Point { albedo: Vec3A::from_array(albedo.pixels[i]), normal: Vec3A::from_array(normal.pixels[i]) };
        let away = mean.minus(own);
        let distance = away.dot(away);
        // NaN is no edge.
        if !(MIXED..=f32::MAX).contains(&distance) {
            return None;
        }
        let (x, y) = (i % width, i / width);
        let rows = y.saturating_sub(1)..=(y + 1).min(height - 1);
        let around = rows.flat_map(|y| (x.saturating_sub(1)..=(x + 1).min(width - 1)).map(move |x| y * width + x));
        let mut best: Option<(f32, usize, f32)> = None;
        for j in around.filter(|&j| j != i && whole(j) && differ(frame, i, j)) {
            let between = middle(j).minus(own);
            let length = between.dot(between);
            if length < APART {
                continue;
            }
            let share = (away.dot(between) / length).clamp(0.0, 1.0);
            let rest = Point { albedo: away.albedo - share * between.albedo, normal: away.normal - share * between.normal };
            let rest = rest.dot(rest);
            if best.is_none_or(|(least, ..)| rest < least) {
                best = Some((rest, j, share));
            }
        }
        let (rest, other, share) = best?;
        (rest < (1.0 - EXPLAINED) * distance).then_some((i, other, share))
    };
    (0..width * height).into_par_iter().with_min_len(1024).filter_map(edge).collect()
}

/// Replaces what the pixels `found` show on the whole by the surfaces in their middles.
pub(super) fn part(
    frame: &Frame,
    found: Vec<(usize, usize, f32)>,
    [albedo, normal]: [&mut Rgb; 2],
    brdf: &mut Image<[f32; 2]>,
) -> Vec<Edge> {
    let edge = |(at, other, share): (usize, usize, f32)| {
        let mean = (albedo.pixels[at], normal.pixels[at], brdf.pixels[at]);
        albedo.pixels[at] = frame.albedo.pixels[at].map(|v| v.clamp(0.0, 1.0));
        if let Some(own) = Vec3A::from_array(frame.normal.pixels[at]).try_normalize() {
            normal.pixels[at] = own.to_array();
            brdf.pixels[at] = brdf_at(&frame.info.camera, (at % frame.width, at / frame.width), own, frame.material.pixels[at]);
        }
        Edge { at, other, share, mean }
    };
    found.into_iter().map(edge).collect()
}

/// Blends values, one for each pixel, at `edges`.
pub fn blend<T: Copy>(edges: &[Edge], values: &mut [T], blend: impl Fn(T, T, f32) -> T) {
    // A neighbour may be an edge itself: what counts is its own surface.
    let blended: Vec<T> = edges.iter().map(|edge| blend(values[edge.at], values[edge.other], edge.share)).collect();
    edges.iter().zip(blended).for_each(|(edge, value)| values[edge.at] = value);
}

/// As [`blend`], for pictures.
pub fn blend_picture(edges: &[Edge], picture: &mut Rgb) {
    blend(edges, &mut picture.pixels, |a, b, share| [0, 1, 2].map(|c| (1.0 - share) * a[c] + share * b[c]));
}

impl Edge {
    /// Puts what the pixel shows on the whole back.
    pub(super) fn restore(&self, [albedo, normal]: [&mut Rgb; 2], brdf: &mut Image<[f32; 2]>) {
        (albedo.pixels[self.at], normal.pixels[self.at], brdf.pixels[self.at]) = self.mean;
    }
}
