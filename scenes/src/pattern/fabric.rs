//! Cloth, leather and old paint: what bends and tears.

use super::field::{Cells, Grid, blend, chance, floor, fraction, gain, mix, smooth, to_whole, wave, wrap};
use super::sheet::{MapSet, Maps, Place, Spot};
use crate::family::family;

family! {
    /// Plain weave, from gauze to basketry: warp (runs along v), weft (runs along u), what shows between.
    pattern Woven: 3 colors [[0.45, 0.36, 0.24], [0.55, 0.46, 0.32], [0.08, 0.06, 0.04]], roughness [0.6, 0.95], depth 0.008;
    /// Pairs of threads along an edge.
    pairs: u32 [2, 64] or 16;
    /// Width of threads in distances of neighbours.
    width: f32 [0.4, 1.0] or 0.9;
    /// How much threads differ.
    uneven: f32 [0.0, 1.0] or 0.4;
}

impl Woven {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let count = 2 * self.pairs;
        let fine = [Grid::noise(n, [count, 128], 2, self.seed), Grid::noise(n, [128, count], 2, self.seed.wrapping_add(1))];
        let shade = Grid::noise(n, [4, 4], 4, self.seed.wrapping_add(2));
        let (width, uneven) = (f64::from(self.width), f64::from(self.uneven));
        self.common().maps(wanted, |Place { x, y, u, v, .. }| {
            let (p, q) = (u * f64::from(count), v * f64::from(count));
            let (i, j) = (floor(p) as u32, floor(q) as u32);
            let draw = |line: u32, k: u32| chance(line, k, self.seed) - 0.5;
            // Height of a thread: round across, a wave along; the higher of the two shows.
            let thread = |across: f64, line: u32, k: u32| {
                let half = 0.5 * width * (1.0 + 0.3 * uneven * draw(line, k));
                let off = (across - 0.5 - 0.12 * uneven * draw(line, k + 1)) / half;
                (off.abs() < 1.0).then(|| (1.0 - off * off).sqrt())
            };
            let swell = if (i + j) % 2 == 0 { 1.0 } else { -1.0 } * wave(0.5 * fraction(p)) * wave(0.5 * fraction(q));
            let warp = thread(fraction(p), i, 10).map(|h| 0.6 * h + 0.4 * swell);
            let weft = thread(fraction(q), j, 20).map(|h| 0.6 * h - 0.4 * swell);
            let (color, height, line, which) = match (warp, weft) {
                (Some(a), Some(b)) if a >= b => (colors[0], a, i, 0),
                (Some(a), None) => (colors[0], a, i, 0),
                (_, Some(b)) => (colors[1], b, j, 1),
                (None, None) => (colors[2], -0.3, 0, 2),
            };
            let fibre = if which == 2 { 0.0 } else { fine[1 - which].texel(x, y) };
            let tone = 1.0 + uneven * (0.5 * draw(line, 30 + which as u32) + 0.12 * shade.texel(x, y)) + 0.12 * fibre;
            Spot {
                color: gain(blend(colors[2], color, smooth(-0.3, 0.5, height)), tone),
                rough: 0.5 + 0.4 * fibre,
                metallic: 0.0,
                height: height + 0.08 * fibre,
            }
        })
    }
}

family! {
    /// Stocking stitch: yarn, second yarn of its rows, depth between stitches.
    pattern Knitted: 3 colors [[0.5, 0.12, 0.1], [0.7, 0.66, 0.58], [0.05, 0.02, 0.02]], roughness [0.75, 1.0], depth 0.015;
    /// Stitches along an edge.
    stitches: u32 [4, 48] or 14;
    /// Pairs of rows of the second yarn; 0 = none.
    bands: u32 [0, 8] or 2;
    /// How fluffy the yarn is.
    fluff: f32 [0.0, 1.0] or 0.5;
}

impl Knitted {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let fine = Grid::noise(n, [64, 64], 3, self.seed);
        let (fluff, count) = (f64::from(self.fluff), f64::from(self.stitches));
        self.common().maps(wanted, |Place { x, y, u, v, .. }| {
            let hair = fine.texel(x, y);
            let p = u * count + 0.05 * fluff * hair;
            // Each stitch is a V: the rows rise towards both sides of a column.
            let side = 2.0 * to_whole(p);
            let q = v * count + 0.45 * side;
            let (row, across) = (wrap(floor(q), self.stitches), fraction(q));
            let legs = 1.0 - (2.0 * fraction(2.0 * p) - 1.0).powi(2);
            let along = 1.0 - (2.0 * across - 1.0).powi(2);
            let height = (legs.max(0.0).sqrt() * 0.65 + 0.35) * along.max(0.0).sqrt();
            let ply = wave(2.0 * across + 3.0 * side + 0.3 * hair);
            let band = row * self.bands * 2 / self.stitches;
            let yarn = colors[usize::from(self.bands > 0 && band % 2 == 1)];
            let tone = 1.0 + 0.2 * fluff * hair + 0.1 * ply + 0.12 * (chance(row, 1, self.seed) - 0.5);
            Spot {
                color: blend(colors[2], gain(yarn, tone), smooth(-0.2, 0.7, height + 0.2 * fluff * hair)),
                rough: 0.7 + 0.3 * hair,
                metallic: 0.0,
                height: height + 0.07 * ply + 0.12 * fluff * hair,
            }
        })
    }
}

family! {
    /// Leather: grain, second tone, creases.
    pattern Leather: 3 colors [[0.3, 0.13, 0.06], [0.2, 0.08, 0.035], [0.05, 0.02, 0.01]], roughness [0.3, 0.75], depth 0.004;
    /// Grains along an edge.
    grains: u32 [8, 96] or 36;
    /// Strength of large creases.
    creases: f32 [0.0, 1.0] or 0.4;
    /// Worn, lighter places.
    worn: f32 [0.0, 1.0] or 0.3;
}

impl Leather {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let seed = |k: u32| self.seed.wrapping_add(k);
        let cells = Cells::new([self.grains; 2], 0.8, seed(1));
        let warp = Grid::noise(n, [self.grains / 2; 2], 2, seed(2));
        let cloud = Grid::noise(n, [3, 3], 4, seed(3));
        let folds = Grid::noise(n, [5, 5], 3, seed(4));
        let (creases, worn, bend) = (f64::from(self.creases), f64::from(self.worn), 0.45 / f64::from(self.grains));
        self.common().maps(wanted, |Place { x, y, u, v, .. }| {
            let shift = bend * warp.texel(x, y);
            let cell = cells.at(u + shift, v - shift);
            let cloud = cloud.texel(x, y);
            let pebble = smooth(0.0, 0.3, cell.edge) * (0.75 + 0.4 * cell.draw(1));
            let fold = creases * (1.0 - smooth(0.0, 0.1, folds.texel(x, y).abs())) * smooth(-0.3, 0.5, cloud);
            let rubbed = worn * smooth(0.0, 0.8, cloud) * pebble;
            let tone = blend(colors[0], colors[1], smooth(-0.7, 0.7, 0.6 * cloud + 0.6 * (cell.draw(2) - 0.5)));
            let color = gain(tone, 1.0 + 0.6 * rubbed);
            Spot {
                color: blend(colors[2], color, (0.35 + 0.65 * pebble) * (1.0 - 0.6 * fold)),
                rough: 0.75 - 0.45 * pebble - 0.4 * rubbed + 0.3 * fold + 0.1 * cloud,
                metallic: 0.0,
                height: pebble - 0.9 * fold,
            }
        })
    }
}

family! {
    /// Old paint, cracked and flaking off: paint, second tone, what lies below, cracks.
    pattern CrackedPaint: 4 colors [[0.45, 0.58, 0.52], [0.36, 0.48, 0.42], [0.3, 0.22, 0.15], [0.06, 0.05, 0.04]], roughness [0.3, 0.95], depth 0.005;
    /// Flakes along an edge.
    flakes: u32 [2, 32] or 10;
    /// Share of flakes that fell off.
    lost: f32 [0.0, 1.0] or 0.25;
    /// How far flakes are stretched along v.
    stretch: f32 [0.0, 1.0] or 0.3;
}

impl CrackedPaint {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let seed = |k: u32| self.seed.wrapping_add(k);
        let rows = ((f64::from(self.flakes) * mix(1.0, 0.25, f64::from(self.stretch))) as u32).max(1);
        let cells = Cells::new([self.flakes, rows], 0.8, seed(1));
        let warp = [Grid::noise(n, [self.flakes; 2], 4, seed(2)), Grid::noise(n, [self.flakes; 2], 4, seed(3))];
        let wear = Grid::noise(n, [3, 2], 4, seed(4));
        let below = Grid::noise(n, [128, 6], 3, seed(5));
        let (lost, bend) = (f64::from(self.lost), 0.22 / f64::from(self.flakes));
        self.common().maps(wanted, |Place { x, y, u, v, texel }| {
            let (a, b) = (warp[0].texel(x, y), warp[1].texel(x, y));
            let cell = cells.at(u + bend * a, v + bend * b);
            let worn = wear.texel(x, y);
            // Whole flakes are gone, others only at their rims.
            let gone = cell.draw(1) + 0.8 * worn < mix(-0.35, 1.6, lost);
            let soft = 1.3 * texel * f64::from(self.flakes);
            let rim = cell.edge - 0.01 - 0.16 * (0.35 + worn).max(0.0) * cell.draw(2);
            let paint = if gone { 0.0 } else { smooth(-soft, soft, rim) };
            let crack = (1.0 - smooth(0.0, 0.012 + 0.035 * cell.draw(4) + 0.5 * soft, cell.edge)) * if gone { 0.3 } else { 1.0 };
            let wood = gain(colors[2], 1.0 + 0.4 * below.texel(x, y));
            let color = gain(blend(colors[0], colors[1], smooth(-0.6, 0.6, worn + 0.4 * (cell.draw(3) - 0.5))), 1.0 + 0.05 * a);
            // Flakes curl up at their rims.
            let curl = 0.4 * (1.0 - smooth(0.0, 0.2, cell.edge));
            Spot {
                color: blend(blend(wood, color, paint), colors[3], 0.85 * crack),
                rough: mix(0.85 + 0.15 * below.texel(x, y), 0.25 + 0.2 * worn, paint),
                metallic: 0.0,
                height: mix(0.12 * below.texel(x, y), 0.7 + curl + 0.04 * a, paint) - 0.3 * crack,
            }
        })
    }
}
