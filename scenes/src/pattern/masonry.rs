//! What walls and floors are laid of.

use super::field::{Cells, Grid, blend, chance, floor, fraction, gain, mix, smooth, to_whole, wave, wrap};
use super::sheet::{MapSet, Maps, Place, Spot};
use crate::family::family;

family! {
    /// Bricks in running bond: lighter brick, darker brick, mortar.
    pattern Bricks: 3 colors [[0.42, 0.16, 0.09], [0.24, 0.08, 0.05], [0.5, 0.47, 0.42]], roughness [0.7, 1.0], depth 0.008;
    /// Pairs of rows down the texture; half as many bricks along it.
    pairs: u32 [1, 16] or 4;
    /// Width of the joints in heights of a brick.
    joint: f32 [0.02, 0.3] or 0.12;
    /// How much bricks differ.
    contrast: f32 [0.0, 1.0] or 0.6;
    /// How broken edges and faces are.
    worn: f32 [0.0, 1.0] or 0.4;
}

impl Bricks {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let coarse = Grid::noise(n, [4 * self.pairs; 2], 3, self.seed);
        let fine = Grid::noise(n, [32, 32], 4, self.seed.wrapping_add(1));
        let (joint, contrast, worn) = (0.5 * f64::from(self.joint), f64::from(self.contrast), f64::from(self.worn));
        let (rows, columns) = (2 * self.pairs, self.pairs.max(1));
        self.common().maps(wanted, |Place { x, y, u, v, texel }| {
            let (rough, grain) = (coarse.texel(x, y), fine.texel(x, y));
            let down = v * f64::from(rows);
            let row = floor(down) as u32 % rows;
            let along = u * f64::from(columns) + 0.5 * f64::from(row % 2);
            let column = wrap(floor(along), columns);
            // Distance from the nearest joint, in heights of a brick, which is half as high as it is long.
            let aspect = f64::from(rows) / f64::from(columns);
            let away = (to_whole(along) * aspect).min(to_whole(down)) - joint - 0.05 * worn * rough;
            let soft = 1.2 * texel * f64::from(rows);
            let brick = smooth(-soft, soft, away);
            let draw = |k: u32| chance(column, row + 64 * k, self.seed);
            let tone = blend(colors[0], colors[1], contrast * draw(0) + 0.25 * grain.abs());
            let tone = gain(tone, 1.0 + 0.3 * contrast * (draw(1) - 0.5) + 0.22 * grain);
            let mortar = gain(colors[2], 0.9 + 0.25 * grain);
            let shape = smooth(0.0, 0.1 + 0.12 * worn, away) * (0.9 + 0.12 * draw(2));
            Spot {
                color: blend(mortar, tone, brick),
                rough: mix(1.0, 0.35 + 0.4 * grain + 0.2 * draw(3), brick),
                metallic: 0.0,
                height: shape + (0.06 + 0.12 * worn) * grain,
            }
        })
    }
}

family! {
    /// Square tiles with bevels and grout: most tiles, the others, grout.
    pattern Tiles: 3 colors [[0.7, 0.72, 0.7], [0.1, 0.22, 0.28], [0.4, 0.38, 0.35]], roughness [0.08, 0.9], depth 0.004;
    /// Tiles along an edge.
    count: u32 [1, 32] or 6;
    /// Width of the grout in tiles.
    grout: f32 [0.01, 0.25] or 0.05;
    /// Width of the bevel in tiles.
    bevel: f32 [0.01, 0.3] or 0.06;
    /// Share of the other tiles.
    mixed: f32 [0.0, 1.0] or 0.25;
    /// How much tiles of one colour differ, and how cloudy each is.
    variation: f32 [0.0, 1.0] or 0.3;
}

impl Tiles {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let cloud = Grid::noise(n, [6, 6], 5, self.seed);
        let fine = Grid::noise(n, [64, 64], 2, self.seed.wrapping_add(1));
        let (grout, bevel) = (0.5 * f64::from(self.grout), f64::from(self.bevel));
        let (mixed, variation, count) = (f64::from(self.mixed), f64::from(self.variation), f64::from(self.count));
        self.common().maps(wanted, |Place { x, y, u, v, texel }| {
            let (i, j) = (floor(u * count) as u32, floor(v * count) as u32);
            let away = to_whole(u * count).min(to_whole(v * count)) - grout;
            let soft = 1.2 * texel * count;
            let tile = smooth(-0.5 * soft, soft, away);
            let draw = |k: u32| chance(i, j + 64 * k, self.seed);
            // Every tile shows another part of the clouds.
            let cloudy = cloud.at(u + draw(5), v + draw(6));
            let tone = 1.0 + variation * (0.4 * (draw(0) - 0.5) + 0.35 * cloudy);
            let color = gain(colors[usize::from(draw(1) < mixed)], tone);
            let grain = fine.texel(x, y);
            // Tiles never lie in one plane.
            let tilt = 0.15 * ((draw(2) - 0.5) * fraction(u * count) + (draw(3) - 0.5) * fraction(v * count));
            Spot {
                color: blend(gain(colors[2], 0.9 + 0.3 * grain), color, tile),
                rough: mix(0.85 + 0.2 * grain, 0.12 * (1.0 + variation * cloudy), tile),
                metallic: 0.0,
                height: mix(0.15 * grain, smooth(0.0, bevel, away) + tilt, tile),
            }
        })
    }
}

family! {
    /// Stones set close together, from gravel to cobbles: light stone, dark stone, warm stone, what lies between.
    pattern Cobbles: 4 colors [[0.42, 0.4, 0.38], [0.16, 0.16, 0.17], [0.38, 0.28, 0.2], [0.08, 0.065, 0.05]], roughness [0.55, 0.95], depth 0.02;
    /// Stones along an edge.
    count: u32 [2, 48] or 8;
    /// 0 = a lattice, 1 = scattered.
    uneven: f32 [0.0, 1.0] or 0.7;
    /// Width of the gaps in stones.
    gap: f32 [0.0, 0.4] or 0.12;
    /// 0 = flat tops, 1 = round.
    round: f32 [0.0, 1.0] or 0.6;
}

impl Cobbles {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let cells = Cells::new([self.count; 2], 0.8 * f64::from(self.uneven), self.seed);
        let warp = Grid::noise(n, [2 * self.count; 2], 2, self.seed.wrapping_add(3));
        let fine = Grid::noise(n, [32, 32], 4, self.seed.wrapping_add(1));
        let (gap, round) = (0.5 * f64::from(self.gap), f64::from(self.round));
        let bend = 0.12 / f64::from(self.count);
        self.common().maps(wanted, |Place { x, y, u, v, texel }| {
            let shift = bend * warp.texel(x, y);
            let cell = cells.at(u + shift, v - shift);
            let grain = fine.texel(x, y);
            let away = cell.edge - gap * (0.7 + 0.6 * cell.draw(5));
            let stone = smooth(-1.5 * texel * f64::from(self.count), 0.03, away);
            let tone = blend(blend(colors[0], colors[1], cell.draw(1)), colors[2], cell.draw(2) * cell.draw(3));
            let dome = mix(smooth(0.0, 0.12, away), (1.0 - (1.0 - (2.2 * away).clamp(0.0, 1.0)).powi(2)).sqrt(), round);
            Spot {
                color: blend(gain(colors[3], 1.0 + 0.5 * grain), gain(tone, 0.9 + 0.3 * cell.draw(4) + 0.22 * grain), stone),
                rough: mix(1.0, 0.4 + 0.4 * grain, stone),
                metallic: 0.0,
                height: dome * (0.8 + 0.25 * cell.draw(6)) + 0.07 * grain,
            }
        })
    }
}

family! {
    /// Bits of stone or glass set in cement: three colours of bits, cement.
    pattern Mosaic: 4 colors [[0.6, 0.5, 0.3], [0.08, 0.2, 0.32], [0.45, 0.12, 0.08], [0.62, 0.6, 0.56]], roughness [0.1, 0.9], depth 0.004;
    /// Bits along an edge.
    count: u32 [3, 48] or 16;
    /// 0 = squares, 1 = shards.
    shards: f32 [0.0, 1.0] or 0.5;
    /// Width of the joints in bits.
    joint: f32 [0.01, 0.3] or 0.1;
    /// Figures along an edge that colours form; more make a speckle.
    figures: u32 [1, 16] or 3;
}

impl Mosaic {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let cells = Cells::new([self.count; 2], 0.12 + 0.65 * f64::from(self.shards), self.seed);
        let figure = Grid::noise(n, [self.figures; 2], 2, self.seed.wrapping_add(1));
        let fine = Grid::noise(n, [64, 64], 3, self.seed.wrapping_add(2));
        let (joint, count) = (0.5 * f64::from(self.joint), f64::from(self.count));
        self.common().maps(wanted, |Place { x, y, u, v, texel }| {
            let cell = cells.at(u, v);
            let grain = fine.texel(x, y);
            let middle = cell.from / count;
            let level = figure.at(u - middle.x, v - middle.y) + 0.35 * (cell.draw(1) - 0.5);
            let pick = if level > 0.18 {
                0
            } else if level > -0.18 {
                1
            } else {
                2
            };
            let away = cell.edge - joint;
            let bit = smooth(-texel * count, texel * count, away);
            let tilt = (cell.draw(4) - 0.5) * cell.from.x + (cell.draw(5) - 0.5) * cell.from.y;
            Spot {
                color: blend(
                    gain(colors[3], 0.85 + 0.2 * grain),
                    gain(colors[pick], 0.7 + 0.55 * cell.draw(2) + 0.06 * grain),
                    bit,
                ),
                rough: mix(0.9, 0.3 * cell.draw(3), bit),
                metallic: 0.0,
                height: mix(0.1 * grain, smooth(0.0, 0.1, away) + 0.6 * tilt, bit),
            }
        })
    }
}

family! {
    /// Rendered wall with stains that run down: plaster, second tone, stain.
    pattern Plaster: 3 colors [[0.72, 0.66, 0.54], [0.62, 0.54, 0.4], [0.25, 0.2, 0.14]], roughness [0.75, 1.0], depth 0.006;
    /// Coarseness: bumps along an edge.
    bumps: u32 [2, 64] or 20;
    /// Strength of the stains.
    stains: f32 [0.0, 1.0] or 0.45;
    /// Streaks along an edge.
    streaks: u32 [1, 32] or 10;
    /// 0 = thrown on (bumps), 1 = trowelled (flat strokes).
    trowelled: f32 [0.0, 1.0] or 0.3;
}

impl Plaster {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let seed = |k: u32| self.seed.wrapping_add(k);
        let tone = Grid::noise(n, [2, 2], 4, seed(1));
        let bumps = Grid::noise(n, [self.bumps; 2], 3, seed(2));
        let streaks = Grid::noise(n, [self.streaks, 1], 3, seed(3));
        let strokes = Grid::noise(n, [(self.bumps / 3).max(1); 2], 2, seed(4));
        let (stains, trowelled) = (f64::from(self.stains), f64::from(self.trowelled));
        self.common().maps(wanted, |Place { x, y, u, v, .. }| {
            let (a, b) = (tone.texel(x, y), bumps.texel(x, y));
            let run = streaks.at(u + 0.01 * b, v + 0.1 * a);
            // Darkest under the middle, where a ledge would be; fades downwards and repeats.
            let ledge = 0.5 + 0.5 * wave(v + 0.05 * a);
            let stain = stains * smooth(0.1, 1.1, 0.55 * run + 0.5 * ledge + 0.35 * a);
            let color = blend(blend(colors[0], colors[1], smooth(-0.6, 0.6, a)), colors[2], stain);
            // Strokes end in sharp ridges.
            let ridge = 1.0 - strokes.at(u + 0.03 * a, v + 0.02 * b).abs();
            Spot {
                color: gain(color, 1.0 + 0.1 * b),
                rough: 0.6 + 0.3 * b + 0.3 * stain,
                metallic: 0.0,
                height: mix(0.5 + 0.5 * b, ridge * ridge + 0.1 * b, trowelled),
            }
        })
    }
}

family! {
    /// Cast concrete with pores, blotches and the lines of its formwork: light, dark, pore.
    pattern Concrete: 3 colors [[0.5, 0.49, 0.47], [0.33, 0.32, 0.3], [0.12, 0.115, 0.11]], roughness [0.6, 0.95], depth 0.004;
    /// Boards or panels along an edge; 0 = none to be seen.
    boards: u32 [0, 16] or 2;
    /// How many pores.
    pores: f32 [0.0, 1.0] or 0.4;
    /// Strength of the blotches.
    contrast: f32 [0.0, 1.0] or 0.5;
}

impl Concrete {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let seed = |k: u32| self.seed.wrapping_add(k);
        let blotch = Grid::noise(n, [3, 3], 5, seed(1));
        let fine = Grid::noise(n, [64, 64], 3, seed(2));
        let holes = Cells::new([40, 40], 0.8, seed(3));
        let (pores, contrast, boards) = (f64::from(self.pores), f64::from(self.contrast), f64::from(self.boards));
        self.common().maps(wanted, |Place { x, y, u, v, texel }| {
            let (a, grain) = (blotch.texel(x, y), fine.texel(x, y));
            let shift = 0.004 * grain;
            let cell = holes.at(u + shift, v - shift);
            let size = if cell.draw(1) < pores { 0.05 + 0.25 * cell.draw(2).powi(3) } else { 0.0 };
            let pore = if size > 0.0 { 1.0 - smooth(0.6 * size, size + 40.0 * texel, cell.near) } else { 0.0 };
            let mut tone = 1.6 * contrast * a + 0.2 * grain;
            let mut seam = 0.0;
            if self.boards > 0 {
                let board = floor(v * boards) as u32;
                tone += 0.5 * contrast * (chance(board, 3, self.seed) - 0.5);
                seam = 1.0 - smooth(0.0, 3.0 * texel, to_whole(v * boards) / boards);
            }
            let color = gain(blend(colors[0], colors[1], 0.5 + 0.6 * tone), 1.0 - 0.35 * seam);
            Spot {
                color: blend(color, colors[2], pore),
                rough: 0.5 + 0.4 * grain + 0.3 * a + 0.3 * pore,
                metallic: 0.0,
                height: 0.8 + 0.12 * grain + 0.08 * a - 0.8 * pore - 0.5 * seam,
            }
        })
    }
}
