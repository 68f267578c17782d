//! Bodies drawn out of plane outlines: extrusions with holes and letters of an unknown script.

use super::implicit::segment_distance;
use super::round::superellipse;
use crate::draw::Draw;
use crate::family::{choice, family};
use crate::shapes::builder::Builder;
use crate::shapes::parts::Dice;
use crate::shapes::polygonise::polygonise;
use glam::{DVec2, DVec3};
use std::collections::HashMap;
use std::f64::consts::TAU;

/// Triangles, counter-clockwise, of the region inside `outer` (counter-clockwise) and outside `holes` (clockwise).
pub(in crate::shapes) fn triangulate(outer: &[DVec2], holes: &[Vec<DVec2>]) -> Vec<[DVec2; 3]> {
    let points: Vec<DVec2> = outer.iter().chain(holes.iter().flatten()).copied().collect();
    let mut starts = Vec::new();
    let mut next = outer.len();
    for hole in holes {
        starts.push(next as u32);
        next += hole.len();
    }
    let mut indices: Vec<u32> = Vec::new();
    earcut::Earcut::new().earcut(points.iter().map(|p| p.to_array()), &starts, &mut indices);
    let mut triangles: Vec<[usize; 3]> = indices.chunks_exact(3).map(|t| [t[0] as usize, t[1] as usize, t[2] as usize]).collect();
    for t in &mut triangles {
        if (points[t[1]] - points[t[0]]).perp_dot(points[t[2]] - points[t[0]]) < 0.0 {
            t.swap(1, 2);
        }
    }
    flip_edges(&points, &mut triangles);
    triangles.into_iter().map(|t| t.map(|i| points[i])).collect()
}

/// Lawson's flips (1977) towards the constrained Delaunay triangulation: ear clipping leaves needles, and triangles without area
/// where an outline runs straight on.
fn flip_edges(points: &[DVec2], triangles: &mut [[usize; 3]]) {
    for _ in 0..200 {
        let mut left: HashMap<(usize, usize), usize> = HashMap::new();
        for (index, t) in triangles.iter().enumerate() {
            left.extend((0..3).map(|k| ((t[k], t[(k + 1) % 3]), index)));
        }
        let mut touched = vec![false; triangles.len()];
        let mut flipped = false;
        for index in 0..triangles.len() {
            for k in 0..3 {
                let t = triangles[index];
                let (a, b, c) = (t[k], t[(k + 1) % 3], t[(k + 2) % 3]);
                let Some(&other) = left.get(&(b, a)).filter(|&&o| !touched[o] && !touched[index]) else { continue };
                let Some(&d) = triangles[other].iter().find(|&&i| i != a && i != b) else { continue };
                // The angles that look at the shared edge: together more than a half turn?
                let angle = |apex: usize| {
                    let (p, q) = (points[a] - points[apex], points[b] - points[apex]);
                    p.perp_dot(q).abs().atan2(p.dot(q))
                };
                let area = |i: usize, j: usize, k: usize| (points[j] - points[i]).perp_dot(points[k] - points[i]);
                let small = 1e-12;
                if angle(c) + angle(d) > std::f64::consts::PI + 1e-7 && area(c, a, d) > small && area(d, b, c) > small {
                    triangles[index] = [c, a, d];
                    triangles[other] = [d, b, c];
                    (touched[index], touched[other], flipped) = (true, true, true);
                }
            }
        }
        if !flipped {
            break;
        }
    }
}

/// A plate of this outline along z from 0 to `height`, its rims bevelled by `bevel`.
pub(in crate::shapes) fn plate(b: &mut Builder, outer: &[DVec2], holes: &[Vec<DVec2>], height: f64, bevel: f64) {
    let key = |p: DVec2| ((p.x * 1e7).round() as i64, (p.y * 1e7).round() as i64);
    // The way into the region at each corner, long enough to move both edges by one.
    let mut inwards: HashMap<(i64, i64), DVec2> = HashMap::new();
    for ring in std::iter::once(outer).chain(holes.iter().map(Vec::as_slice)) {
        let n = ring.len();
        for i in 0..n {
            let (a, p, c) = (ring[(i + n - 1) % n], ring[i], ring[(i + 1) % n]);
            let (d0, d1) = ((p - a).normalize_or_zero().perp(), (c - p).normalize_or_zero().perp());
            let mean = (d0 + d1).normalize_or(d0);
            inwards.insert(key(p), mean / mean.dot(d0).max(0.4));
        }
    }
    let region = triangulate(outer, holes);
    let same = |p: DVec2| p;
    let inset = |p: DVec2| p + inwards.get(&key(p)).copied().unwrap_or_default() * bevel;
    if bevel > 0.0 {
        b.extrude(&region, &[(0.0, &inset), (bevel, &same), (height - bevel, &same), (height, &inset)]);
    } else {
        b.extrude(&region, &[(0.0, &same), (height, &same)]);
    }
}

/// A clockwise circle, for holes; turned by its place, so that corners of neighbours are not in one line.
pub(in crate::shapes) fn hole(centre: DVec2, radius: f64, steps: usize) -> Vec<DVec2> {
    (0..steps)
        .map(|i| centre + radius * DVec2::from_angle(0.05 + 0.37 * centre.x + 0.61 * centre.y - TAU * i as f64 / steps as f64))
        .collect()
}

choice! {
    /// The outline of an extrusion.
    Outline {
        /// A closed wave with seeded lobes.
        Wave,
        /// A polygon with round corners.
        Rounded,
        /// A superellipse.
        Squircle,
        /// A heart-, drop- or shield-like one.
        Crest,
        /// A flower of round petals.
        Flower,
        /// A ragged star.
        Splinter,
    }
}

family! {
    /// A plate with a seeded outline and round or polygonal holes, bevelled, lying flat.
    shape Extrusion("mechanical", Any) |rng| {
        /// The outline.
        outline: Outline = Outline::draw(rng);
        /// Lobes, corners or petals.
        lobes: u32 [2, 14] = 3 + rng.below(7);
        /// Depth of the outline's features.
        depth: f32 [0, 0.6] = rng.between(0.1, 0.5);
        /// Holes asked for; those that find no room are left out.
        holes: u32 [0, 12] = rng.below(7);
        /// Thickness as a share of the width.
        thickness: f32 [0.02, 2] = rng.log(0.08, 0.7);
        /// Bevel as a share of the width.
        bevel: f32 [0, 0.03] = if rng.chance(0.3) { 0.0 } else { rng.between(0.005, 0.02) };
        /// Length over width of the outline.
        aspect: f32 [0.3, 3] = rng.log(0.6, 1.6);
        /// Which outline and holes.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Extrusion {
    fn outline(&self, dice: &mut Dice) -> Vec<DVec2> {
        let (n, depth) = (f64::from(self.lobes), f64::from(self.depth));
        let phases: Vec<(f64, f64)> = (0..4).map(|_| (dice.between(0.0, TAU), dice.between(-1.0, 1.0))).collect();
        let corners: Vec<DVec2> = (0..self.lobes.max(3))
            .map(|i| {
                let a = TAU * (f64::from(i) + 0.35 * dice.between(-1.0, 1.0)) / n.max(3.0);
                DVec2::from_angle(a) * dice.between(1.0 - depth, 1.0) * 0.5
            })
            .collect();
        let aspect = f64::from(self.aspect).sqrt();
        let stretch = DVec2::new(aspect, 1.0 / aspect);
        if self.outline == Outline::Splinter {
            return corners
                .iter()
                .enumerate()
                .flat_map(|(i, &c)| [c, (c + corners[(i + 1) % corners.len()]) * 0.5 * (0.9 - 0.6 * depth)])
                .map(|p| p * stretch)
                .collect();
        }
        let steps = 120;
        (0..steps)
            .map(|i| {
                let a = TAU * f64::from(i) / f64::from(steps);
                let r = match self.outline {
                    Outline::Wave => {
                        let waves = phases.iter().zip(2u32..).map(|(&(p, s), k)| s * (f64::from(k) * a + p).cos() / f64::from(k));
                        0.5 * (1.0 + 0.7 * depth * waves.sum::<f64>())
                    }
                    Outline::Rounded => {
                        // The distance to a regular polygon's side in this direction, rounded by a high mean.
                        let k = n.max(3.0);
                        let side =
                            (0..self.lobes.max(3)).map(|j| (a - TAU * f64::from(j) / k).cos().max(0.0).powf(24.0 - 30.0 * depth));
                        0.45 / side.sum::<f64>().max(1e-9).powf(1.0 / (24.0 - 30.0 * depth))
                    }
                    Outline::Squircle => 0.45 * superellipse(a, 0.2 + 1.4 * depth).length(),
                    Outline::Crest => {
                        0.5 * (1.0 - 0.5 * depth * a.sin() + 0.35 * depth * (2.0 * a).cos() + 0.2 * depth * (3.0 * a).sin())
                    }
                    _ => 0.5 * (1.0 - 0.8 * depth + 0.8 * depth * (0.5 * n * a).cos().abs().powf(0.6)),
                };
                DVec2::from_angle(a) * r * stretch
            })
            .collect()
    }

    fn build(&self) -> (Builder, f64) {
        let mut dice = Dice::new(self.seed);
        let outer = self.outline(&mut dice);
        let gap = 0.02 + 2.0 * f64::from(self.bevel);
        let mut rings: Vec<(DVec2, f64)> = Vec::new();
        let mut holes = Vec::new();
        for attempt in 0..40 {
            if rings.len() >= self.holes as usize {
                break;
            }
            // The first one is in the middle as often as not.
            let centre = if attempt == 0 && dice.chance(0.5) {
                DVec2::ZERO
            } else {
                DVec2::from_angle(dice.between(0.0, TAU)) * dice.between(0.08, 0.45)
            };
            let wanted = dice.between(0.03, if attempt == 0 { 0.22 } else { 0.1 });
            let edges = (0..outer.len()).map(|i| (outer[i], outer[(i + 1) % outer.len()]));
            let inside = edges.clone().filter(|(p, q)| {
                (p.y > centre.y) != (q.y > centre.y) && centre.x < p.x + (q.x - p.x) * (centre.y - p.y) / (q.y - p.y)
            });
            if inside.count() % 2 == 0 {
                continue;
            }
            let flat = |p: DVec2| p.extend(0.0);
            let rim = edges.map(|(p, q)| segment_distance(flat(centre), flat(p), flat(q))).fold(f64::INFINITY, f64::min);
            let others = rings.iter().map(|&(c, r)| c.distance(centre) - r).fold(f64::INFINITY, f64::min);
            let radius = wanted.min(rim - gap).min(others - gap);
            if radius > 0.02 {
                rings.push((centre, radius));
                holes.push(hole(centre, radius, [40, 40, 6, 4, 3][dice.below(5)]));
            }
        }
        let height = f64::from(self.thickness);
        let mut flat = Builder::default();
        plate(&mut flat, &outer, &holes, height, f64::from(self.bevel).min(0.4 * height));
        flat.turn_z_to_y();
        (flat, 30.0)
    }
}

family! {
    /// A letter of an unknown script: straight and bent strokes between the places of a small grid, standing upright or flat.
    shape Glyph("abstract", Any) |rng| {
        /// Strokes.
        strokes: u32 [1, 9] = 3 + rng.below(4);
        /// Width of a stroke as a share of the letter's width.
        weight: f32 [0.05, 0.35] = rng.between(0.1, 0.26);
        /// Thickness as a share of the letter's width.
        thickness: f32 [0.05, 1] = rng.between(0.15, 0.5);
        /// Share of bent strokes.
        bends: f32 [0, 1] = rng.between(0.0, 0.8);
        /// Slant, as a share of the height.
        slant: f32 [-0.5, 0.5] = if rng.chance(0.6) { 0.0 } else { rng.between(-0.3, 0.3) };
        /// Left and right alike.
        mirrored: bool = rng.chance(0.3);
        /// Square ends of strokes instead of round ones.
        square: bool = rng.chance(0.5);
        /// Which letter.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Glyph {
    fn build(&self) -> (Builder, f64) {
        let mut dice = Dice::new(self.seed);
        let place = |i: usize, j: usize| DVec2::new(i as f64 * 0.5 - 0.5, j as f64 * 0.5 - 1.0);
        let mut used = vec![(dice.below(3), dice.below(5))];
        let mut lines: Vec<(DVec2, DVec2)> = Vec::new();
        for _ in 0..self.strokes {
            // Every stroke begins where another has been, so the letter is in one piece.
            let (i, j) = used[dice.below(used.len())];
            let (k, l) = (dice.below(3), dice.below(5));
            if (i, j) == (k, l) {
                continue;
            }
            used.push((k, l));
            let (from, to) = (place(i, j), place(k, l));
            if dice.chance(f64::from(self.bends)) {
                let side = (to - from).perp() * dice.between(0.25, 0.5) * if dice.chance(0.5) { 1.0 } else { -1.0 };
                let at = |t: f64| from.lerp(to, t) + side * (1.0 - (2.0 * t - 1.0).powi(2));
                lines.extend((0..8).map(|s| (at(f64::from(s) / 8.0), at(f64::from(s + 1) / 8.0))));
            } else {
                lines.push((from, to));
            }
        }
        if lines.is_empty() {
            lines.push((place(1, 0), place(1, 4)));
        }
        if self.mirrored {
            let flip = |p: DVec2| DVec2::new(-p.x, p.y);
            lines.extend(lines.clone().iter().map(|&(a, b)| (flip(a), flip(b))));
        }
        let (weight, half) = (f64::from(self.weight), 0.5 * f64::from(self.thickness));
        let slant = f64::from(self.slant);
        let flat = |p: DVec3| {
            let q = DVec2::new(p.x, p.y);
            let stroke = |&(a, b): &(DVec2, DVec2)| {
                if self.square {
                    // A stroke lengthened by half its width and cut off straight.
                    let along = (b - a).normalize_or(DVec2::Y);
                    let d = q - 0.5 * (a + b);
                    let reach = 0.5 * a.distance(b) + weight * if lines.len() > 6 { 0.4 } else { 1.0 };
                    (d.dot(along).abs() - reach).max(d.dot(along.perp()).abs() - weight)
                } else {
                    segment_distance(q.extend(0.0), a.extend(0.0), b.extend(0.0)) - weight
                }
            };
            lines.iter().map(stroke).fold(f64::INFINITY, f64::min)
        };
        let low = lines.iter().fold(DVec2::INFINITY, |m, l| m.min(l.0).min(l.1)) - DVec2::splat(1.5 * weight + 0.08);
        let high = lines.iter().fold(DVec2::NEG_INFINITY, |m, l| m.max(l.0).max(l.1)) + DVec2::splat(1.5 * weight + 0.08);
        let mut b = Builder::default();
        let field = |p: DVec3| (p.z.abs() - half).max(flat(p));
        polygonise(&mut b, low.extend(-half - 0.08), high.extend(half + 0.08), 64, true, field);
        b.keep_largest();
        b.map_points(|p| DVec3::new(p.x + slant * p.y, p.y, p.z));
        (b, 32.0)
    }
}
