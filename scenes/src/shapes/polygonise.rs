//! Solids given by a function, negative inside, to closed triangle meshes.
//!
//! A dual method (surface nets, Gibson 1998, with one vertex for each separate sheet in a cell as in Nielson 2004): each crossed
//! grid edge becomes a polygon of the vertices of the four cells around it. Sharp features are kept as in dual contouring (Ju et
//! al. 2002): a vertex descends towards the planes through its crossings. Where two sheets meet in one face of the grid, a
//! further point in that face keeps them apart, so every edge of the result belongs to exactly two triangles.

use super::builder::Builder;
use super::parts::planar;
use glam::DVec3;
use std::collections::HashMap;

/// A solid: negative inside, about a distance near the surface, and nowhere changing by more than twice the way.
pub(super) trait Field: Fn(DVec3) -> f64 {}
impl<F: Fn(DVec3) -> f64> Field for F {}

/// Grid axes as offsets.
const AXES: [DVec3; 3] = [DVec3::X, DVec3::Y, DVec3::Z];

struct Grid {
    low: DVec3,
    step: f64,
    /// Vertices along each axis.
    size: [usize; 3],
    values: Vec<f64>,
}

impl Grid {
    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.size[1] + y) * self.size[0] + x
    }

    fn stride(&self, axis: usize) -> usize {
        [1, self.size[0], self.size[0] * self.size[1]][axis]
    }

    fn position(&self, index: usize) -> DVec3 {
        let (nx, ny) = (self.size[0], self.size[1]);
        self.low + self.step * DVec3::new((index % nx) as f64, (index / nx % ny) as f64, (index / (nx * ny)) as f64)
    }

    fn inside(&self, index: usize) -> bool {
        self.values[index] < 0.0
    }
}

/// Where the surface crosses a grid edge, and its outward normal there.
#[derive(Clone, Copy)]
struct Crossing {
    /// Three times the grid vertex plus the axis.
    key: usize,
    at: DVec3,
    /// The same, away from the grid's vertices, where several crossings would meet.
    apart: DVec3,
    normal: DVec3,
}

/// Grid vertices along the edge of a block that is passed over when the surface is far from it.
const BLOCK: usize = 4;

/// Values of the field at the grid vertices of a block. The border of the grid stays outside.
fn sample_block(grid: &mut Grid, start: [usize; 3], field: &impl Field) {
    let (low, step) = (grid.low, grid.step);
    let vertex = |c: [f64; 3]| low + step * DVec3::from(c);
    let middle = field(vertex(start.map(|i| i as f64 + 0.5 * (BLOCK - 1) as f64)));
    // A field changes by less than twice the way: half the time is saved where most of the grid is far away.
    let far = middle.abs() > 3f64.sqrt() * (BLOCK - 1) as f64 * grid.step;
    for z in start[2]..(start[2] + BLOCK).min(grid.size[2] - 1) {
        for y in start[1]..(start[1] + BLOCK).min(grid.size[1] - 1) {
            for x in start[0]..(start[0] + BLOCK).min(grid.size[0] - 1) {
                let value = if far { middle } else { field(vertex([x as f64, y as f64, z as f64])) };
                let index = grid.index([x, y, z]);
                grid.values[index] = if value.is_nan() { grid.step } else { value };
            }
        }
    }
}

/// Crossings in the order of their keys, and where to find each: an index, or `NONE`.
struct Crossings {
    all: Vec<Crossing>,
    of: Vec<u32>,
}

const NONE: u32 = u32::MAX;

impl Crossings {
    fn get(&self, key: usize) -> Option<&Crossing> {
        self.of.get(key).and_then(|&i| self.all.get(i as usize))
    }
}

/// The vertices of the crossed cells, for each edge of the cell.
struct Sheets {
    all: Vec<[Option<Sheet>; 12]>,
    of: Vec<u32>,
}

/// A mesh vertex of a cell.
#[derive(Clone, Copy)]
struct Sheet {
    vertex: u32,
    feature: bool,
}

/// Adds the surface of `field` in the box `low..high` (closed at its border), `cells` grid cells along the longest edge. Sharp
/// edges and corners are kept when `sharp`.
pub(super) fn polygonise(b: &mut Builder, low: DVec3, high: DVec3, cells: usize, sharp: bool, field: impl Field) {
    let extent = high - low;
    let step = extent.max_element() / cells.clamp(4, 96) as f64;
    if !(step > 0.0 && extent.is_finite()) {
        return;
    }
    let size = extent.to_array().map(|e| (e / step - 1e-9).ceil().max(1.0) as usize + 1);
    let mut grid = Grid { low, step, size, values: Vec::new() };
    let count = size[0] * size[1] * size[2];
    grid.values = vec![step; count];
    let inner = size.map(|n| 1..n.saturating_sub(1));
    for z0 in inner[2].clone().step_by(BLOCK) {
        for y0 in inner[1].clone().step_by(BLOCK) {
            for x0 in inner[0].clone().step_by(BLOCK) {
                sample_block(&mut grid, [x0, y0, z0], &field);
            }
        }
    }
    let crossings = crossings(&grid, sharp, &field);
    let sheets = sheets(b, &grid, sharp, &crossings);
    polygons(b, &grid, &crossings, &sheets);
}

/// Finds the crossed edges.
fn crossings(grid: &Grid, sharp: bool, field: &impl Field) -> Crossings {
    let mut found = Crossings { all: Vec::new(), of: vec![NONE; 3 * grid.values.len()] };
    for index in 0..grid.values.len() {
        let p = grid.position(index);
        for (axis, direction) in AXES.into_iter().enumerate() {
            let other = index + grid.stride(axis);
            // The last layer is outside on both ends, so wrapped neighbours never cross.
            if other >= grid.values.len() || grid.inside(index) == grid.inside(other) {
                continue;
            }
            let (mut t0, mut t1, mut v0, mut v1) = (0.0, 1.0, grid.values[index], grid.values[other]);
            let mut t = v0 / (v0 - v1);
            for _ in 0..if sharp { 2 } else { 1 } {
                let v = field(p + direction * (t * grid.step));
                if (v < 0.0) == (v0 < 0.0) {
                    (t0, v0) = (t, v)
                } else {
                    (t1, v1) = (t, v)
                }
                if v0 != v1 {
                    t = t0 + (t1 - t0) * (v0 / (v0 - v1)).clamp(0.02, 0.98);
                }
            }
            let along = |t: f64| p + direction * (t * grid.step);
            let (at, apart) = (along(t), along(t.clamp(0.06, 0.94)));
            let normal = if sharp { gradient(field, at, 0.02 * grid.step) } else { DVec3::ZERO };
            found.of[3 * index + axis] = found.all.len() as u32;
            found.all.push(Crossing { key: 3 * index + axis, at, apart, normal });
        }
    }
    found
}

fn gradient(field: &impl Field, p: DVec3, h: f64) -> DVec3 {
    // Four corners of a tetrahedron instead of six differences.
    let k = [DVec3::new(1.0, -1.0, -1.0), DVec3::new(-1.0, -1.0, 1.0), DVec3::new(-1.0, 1.0, -1.0), DVec3::ONE];
    k.iter().map(|&k| k * field(p + h * k)).sum::<DVec3>().normalize_or_zero()
}

/// Edge `e` of a cell: axis `e / 4`, on the sides given by the lowest two bits of `e` along the next two axes. Its two corners.
fn edge_corners(e: usize) -> [usize; 2] {
    let axis = e / 4;
    let base = (e & 1) << ((axis + 1) % 3) | (e >> 1 & 1) << ((axis + 2) % 3);
    [base, base | 1 << axis]
}

/// Corners of a face in order, and the edges between each and the next.
fn face(axis: usize, side: usize) -> ([usize; 4], [usize; 4]) {
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let corners = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(a, b)| a << u | b << v | side << axis);
    let edges = [0, 1, 2, 3].map(|k| {
        let (a, b) = (corners[k], corners[(k + 1) % 4]);
        let along = (a ^ b).trailing_zeros() as usize;
        let low = a & b;
        along * 4 + (low >> ((along + 1) % 3) & 1) + 2 * (low >> ((along + 2) % 3) & 1)
    });
    (corners, edges)
}

/// For each edge of a cell with these inside corners: the number of its sheet, or 12 when it is not crossed.
fn sheet_of_edges(inside: u8) -> [u8; 12] {
    let is = |c: usize| inside >> c & 1 == 1;
    let mut sheet: [u8; 12] =
        std::array::from_fn(|e| if is(edge_corners(e)[0]) != is(edge_corners(e)[1]) { e as u8 } else { 12 });
    let mut join = |a: usize, b: usize| {
        let (from, to) = (sheet[a].max(sheet[b]), sheet[a].min(sheet[b]));
        sheet.iter_mut().filter(|s| **s == from).for_each(|s| *s = to);
    };
    for axis in 0..3 {
        for side in 0..2 {
            let (corners, edges) = face(axis, side);
            let crossed: Vec<usize> = (0..4).filter(|&k| is(corners[k]) != is(corners[(k + 1) % 4])).collect();
            if crossed.len() == 2 {
                join(edges[crossed[0]], edges[crossed[1]]);
            } else if crossed.len() == 4 {
                // Each inside corner is cut off alone.
                for k in (0..4).filter(|&k| is(corners[k])) {
                    join(edges[(k + 3) % 4], edges[k]);
                }
            }
        }
    }
    sheet
}

/// The vertices of every crossed cell, keyed by its lowest grid vertex: one for each edge of the cell (edges of one sheet share
/// it).
fn sheets(b: &mut Builder, grid: &Grid, sharp: bool, crossings: &Crossings) -> Sheets {
    let table: Vec<[u8; 12]> = (0..=255).map(sheet_of_edges).collect();
    let mut made = Sheets { all: Vec::new(), of: vec![NONE; grid.values.len()] };
    let strides = [grid.stride(0), grid.stride(1), grid.stride(2)];
    let offset: [usize; 8] = std::array::from_fn(|c| (0..3).map(|a| (c >> a & 1) * strides[a]).sum());
    for z in 0..grid.size[2] - 1 {
        for y in 0..grid.size[1] - 1 {
            for x in 0..grid.size[0] - 1 {
                let cell = grid.index([x, y, z]);
                let inside = (0..8).fold(0u8, |m, c| m | u8::from(grid.inside(cell + offset[c])) << c);
                if inside == 0 || inside == 255 {
                    continue;
                }
                let sheet = table[usize::from(inside)];
                let alone = sheet.iter().all(|&s| s == 12 || s == *sheet.iter().min().unwrap_or(&12));
                let mut vertices = [None; 12];
                for first in 0..12 {
                    if usize::from(sheet[first]) != first {
                        continue;
                    }
                    let of: Vec<Crossing> = (0..12)
                        .filter(|&e| usize::from(sheet[e]) == first)
                        .filter_map(|e| crossings.get(3 * (cell + offset[edge_corners(e)[0]]) + e / 4).copied())
                        .collect();
                    let (at, feature) = place(&of, sharp && alone, grid.position(cell), grid.step);
                    let one = Sheet { vertex: b.vertex(at), feature };
                    for e in (0..12).filter(|&e| usize::from(sheet[e]) == first) {
                        vertices[e] = Some(one);
                    }
                }
                made.of[cell] = made.all.len() as u32;
                made.all.push(vertices);
            }
        }
    }
    made
}

/// Position of a vertex, and whether it is on a sharp feature.
fn place(of: &[Crossing], sharp: bool, low: DVec3, step: f64) -> (DVec3, bool) {
    let n = of.len().max(1) as f64;
    let mut p = of.iter().map(|c| c.at).sum::<DVec3>() / n;
    let mean = of.iter().map(|c| c.normal).sum::<DVec3>().normalize_or_zero();
    let spread = of.iter().map(|c| c.normal.dot(mean)).fold(1.0, f64::min);
    let margin = DVec3::splat(0.04 * step);
    let inside = |p: DVec3| p.clamp(low + margin, low + DVec3::splat(step) - margin);
    if !sharp || spread > 0.95 {
        return (inside(p), false);
    }
    // Descent on the squared distances to the planes: it leaves undetermined directions where the mean of the crossings put them.
    for _ in 0..24 {
        p += of.iter().map(|c| c.normal * c.normal.dot(c.at - p)).sum::<DVec3>() * (1.6 / n);
    }
    (inside(p), spread < 0.88)
}

fn polygons(b: &mut Builder, grid: &Grid, crossings: &Crossings, sheets: &Sheets) {
    // Extra points in faces where two sheets meet, keyed by the two crossed edges they lie between.
    let mut between: HashMap<(usize, usize), u32> = HashMap::new();
    for crossing in &crossings.all {
        let key = crossing.key;
        let (index, axis) = (key / 3, key % 3);
        let (u, v) = (grid.stride((axis + 1) % 3), grid.stride((axis + 2) % 3));
        let far = index + grid.stride(axis);
        // The four cells, counter-clockwise about the axis, and what leads from the edge into the face after each.
        let around = [(0, 0), (1, 0), (1, 1), (0, 1)];
        let beside = [index + v, index - u, index - v, index + u];
        let mut ring: Vec<(u32, bool)> = Vec::with_capacity(8);
        let mut extra = false;
        for (k, (du, dv)) in around.into_iter().enumerate() {
            let cell = index - du * u - dv * v;
            let of_cell = sheets.of.get(cell).and_then(|&i| sheets.all.get(i as usize));
            let Some(sheet) = of_cell.and_then(|s| s[axis * 4 + du + 2 * dv]) else { continue };
            ring.push((sheet.vertex, sheet.feature));
            let (near_side, far_side) = (beside[k], beside[k] + grid.stride(axis));
            let ambiguous = grid.inside(near_side) != grid.inside(far_side) && grid.inside(near_side) != grid.inside(index);
            if ambiguous {
                // The inside end of this edge is cut off together with the edge from it into the face.
                let (end, side) = if grid.inside(index) { (index, near_side) } else { (far, far_side) };
                let across = if k % 2 == 0 { (axis + 2) % 3 } else { (axis + 1) % 3 };
                let other = 3 * end.min(side) + across;
                if let Some(c) = crossings.get(other) {
                    let middle = 0.5 * (crossing.apart + c.apart);
                    let point = *between.entry((key.min(other), key.max(other))).or_insert_with(|| b.vertex(middle));
                    ring.push((point, false));
                    extra = true;
                }
            }
        }
        if !grid.inside(index) {
            ring.reverse();
        }
        if extra {
            let centre = b.vertex(crossing.apart);
            for k in 0..ring.len() {
                triangle(b, [centre, ring[k].0, ring[(k + 1) % ring.len()].0]);
            }
        } else if let [p, q, r, s] = ring[..] {
            let length = |i: u32, j: u32| b.position(i).distance_squared(b.position(j));
            // A crease along a diagonal is kept; else the shorter one is cut.
            let first = match (p.1 && r.1, q.1 && s.1) {
                (true, false) => true,
                (false, true) => false,
                _ => length(p.0, r.0) <= length(q.0, s.0),
            };
            // Unless that leaves three corners in a line.
            let (one, two) = (thinnest(b, [p.0, q.0, r.0, s.0]), thinnest(b, [q.0, r.0, s.0, p.0]));
            let first = if first { one > 0.01 || one >= two } else { two <= 0.01 && one > two };
            if first {
                triangle(b, [p.0, q.0, r.0]);
                triangle(b, [p.0, r.0, s.0]);
            } else {
                triangle(b, [q.0, r.0, s.0]);
                triangle(b, [q.0, s.0, p.0]);
            }
        }
    }
}

/// The smaller of the sines at the outer corners of the two triangles `p q r` and `p r s`.
fn thinnest(b: &Builder, quad: [u32; 4]) -> f64 {
    let [p, q, r, s] = quad.map(|i| b.position(i));
    let sine = |a: DVec3, m: DVec3, c: DVec3| {
        let area = (m - a).cross(c - a).length();
        let sides = [a.distance(m), m.distance(c), c.distance(a)];
        area / (sides[0] * sides[1]).max(sides[1] * sides[2]).max(sides[2] * sides[0]).max(1e-300)
    };
    sine(p, q, r).min(sine(p, r, s))
}

fn triangle(b: &mut Builder, t: [u32; 3]) {
    let p = t.map(|i| b.position(i));
    let normal = (p[1] - p[0]).cross(p[2] - p[0]);
    b.face(t, p.map(|p| planar(p, normal)));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sheets_are_closed_loops() {
        for inside in 0..=255u8 {
            let sheet = sheet_of_edges(inside);
            let crossed = (0..12).filter(|&e| sheet[e] < 12).count();
            assert_eq!(crossed == 0, inside == 0 || inside == 255);
            for s in 0..12 {
                let size = sheet.iter().filter(|&&t| t == s).count();
                assert!(size == 0 || (3..=12).contains(&size), "{inside}: a sheet of {size} edges");
            }
        }
        // Two opposite corners are two sheets.
        let two = sheet_of_edges(0b1000_0001);
        assert_eq!(two.iter().filter(|&&s| s < 12).collect::<std::collections::BTreeSet<_>>().len(), 2);
    }

    #[test]
    fn noise_of_the_coarsest_kind_is_closed() {
        // Random signs at every grid vertex meet all ambiguous cases.
        for seed in 0..8u32 {
            let field = |p: DVec3| crate::noise::gradient(p * 7.3 + DVec3::splat(0.31), seed);
            let mut b = Builder::default();
            polygonise(&mut b, DVec3::splat(-1.0), DVec3::splat(1.0), 12, seed % 2 == 0, field);
            let report = crate::shapes::inspect(&b.finish("noise", 30.0));
            assert!(report.triangles > 100 && report.watertight, "{seed}: {report:?}");
        }
    }
}
