//! Wood.

use super::field::{Cells, Grid, blend, chance, floor, fraction, gain, mix, smooth, to_whole, wave, wrap};
use super::sheet::{MapSet, Maps, Place, Spot};
use crate::family::family;

family! {
    /// Boards side by side along u: light wood, dark wood, gaps.
    pattern Planks: 3 colors [[0.42, 0.25, 0.12], [0.2, 0.1, 0.045], [0.03, 0.02, 0.015]], roughness [0.25, 0.8], depth 0.004;
    /// Boards across the texture.
    boards: u32 [1, 24] or 6;
    /// How much boards differ.
    contrast: f32 [0.0, 1.0] or 0.5;
    /// Strength of the grain.
    grain: f32 [0.0, 1.0] or 0.6;
    /// Wear and dirt.
    worn: f32 [0.0, 1.0] or 0.3;
}

impl Planks {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let seed = |k: u32| self.seed.wrapping_add(k);
        let rings = Grid::noise(n, [2, 12], 4, seed(1));
        let fibres = Grid::noise(n, [6, 128], 2, seed(2));
        let dirt = Grid::noise(n, [4, 4], 4, seed(3));
        let (contrast, grain, worn) = (f64::from(self.contrast), f64::from(self.grain), f64::from(self.worn));
        let boards = f64::from(self.boards);
        self.common().maps(wanted, |Place { x, y, u, v, texel }| {
            let board = floor(v * boards) as u32;
            let draw = |k: u32| chance(board, k, self.seed);
            // Each board is cut from another part of the wood, and ends somewhere else.
            let ring = rings.at(u + draw(0), v + draw(1));
            let fibre = fibres.at(u + draw(2), v);
            let figure = smooth(0.1, 0.95, 0.5 + 0.5 * wave(1.5 * ring + 0.25 * fibre + draw(3)));
            let end = to_whole(u + draw(4));
            let away = (to_whole(v * boards) / boards).min(end);
            let gap = 1.0 - smooth(0.0007, 0.0007 + 1.5 * texel, away);
            let shade = 0.55 * grain * figure + 0.2 * grain * fibre + contrast * (draw(5) - 0.35);
            let wood = gain(blend(colors[0], colors[1], shade.clamp(-0.2, 1.0)), 1.0 + 0.3 * contrast * (draw(6) - 0.5));
            let foul = worn * smooth(-0.1, 0.8, dirt.texel(x, y));
            Spot {
                color: blend(gain(wood, 1.0 - 0.35 * foul), colors[2], gap),
                rough: 0.25 + 0.25 * fibre + 0.15 * figure + 0.6 * foul + 0.4 * gap,
                metallic: 0.0,
                height: smooth(0.0, 0.006, away) * (0.85 + 0.15 * draw(7)) + 0.08 * grain * (fibre + figure),
            }
        })
    }
}

family! {
    /// One piece of wood, cut along the trunk, grain along u, with knots: early wood, late wood, knots.
    pattern Wood: 3 colors [[0.52, 0.32, 0.16], [0.26, 0.13, 0.055], [0.1, 0.045, 0.02]], roughness [0.3, 0.7], depth 0.002;
    /// Year rings across the texture.
    rings: u32 [2, 48] or 14;
    /// How wavy the rings are.
    wavy: f32 [0.0, 1.0] or 0.5;
    /// How many knots.
    knots: f32 [0.0, 1.0] or 0.4;
    /// Strength of pores and fibres.
    fibres: f32 [0.0, 1.0] or 0.5;
}

impl Wood {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let seed = |k: u32| self.seed.wrapping_add(k);
        let warp = Grid::noise(n, [1, 4], 2, seed(1));
        let fine = Grid::noise(n, [8, 160], 2, seed(2));
        let spots = Cells::new([2, 3], 0.8, seed(3));
        let (wavy, knots, fibres, rings) =
            (f64::from(self.wavy), f64::from(self.knots), f64::from(self.fibres), f64::from(self.rings));
        self.common().maps(wanted, |Place { x, y, u, v, .. }| {
            let (bend, fibre) = (warp.texel(x, y), fine.texel(x, y));
            // Rings flow around knots, which are about twice as long as they are high.
            let cell = spots.at(u, v);
            let (mut knot, mut push) = (0.0, 0.0);
            if cell.draw(1) < knots {
                let size = 0.06 + 0.08 * cell.draw(2);
                let off = (cell.from * glam::DVec2::new(1.3, 1.0)).length() / size;
                knot = 1.0 - smooth(0.55, 1.15, off + 0.2 * bend);
                push = 1.6 * (1.0 - smooth(0.0, 3.2, off)) * cell.from.y.signum() * smooth(0.0, 0.5, cell.from.y.abs() / size);
                // The centre of the knot has rings of its own.
                push += 0.6 * knot * off;
            }
            let ring = fraction(v * rings + wavy * 0.16 * rings * bend + 0.12 * fibre + push);
            // Late wood darkens slowly and ends at once.
            let late = smooth(0.2, 0.92, ring) * (1.0 - smooth(0.95, 1.0, ring));
            let wood = blend(colors[0], colors[1], 0.8 * late + 0.25 * fibres * fibre + 0.15 * bend);
            Spot {
                color: gain(blend(wood, colors[2], 0.8 * knot), 1.0 + 0.12 * fibres * fibre),
                rough: 0.35 + 0.3 * fibre + 0.2 * late - 0.2 * knot,
                metallic: 0.0,
                height: 0.5 + 0.35 * fibres * fibre + 0.3 * late,
            }
        })
    }
}

family! {
    /// Blocks of parquet in turn along and across: light wood, dark wood, joints.
    pattern Parquet: 3 colors [[0.45, 0.28, 0.14], [0.24, 0.12, 0.05], [0.05, 0.03, 0.02]], roughness [0.12, 0.5], depth 0.0015;
    /// Pairs of blocks along an edge.
    pairs: u32 [1, 8] or 2;
    /// Strips of a block.
    strips: u32 [1, 8] or 4;
    /// How much strips differ.
    contrast: f32 [0.0, 1.0] or 0.5;
}

impl Parquet {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let grain = Grid::noise(n, [4, 64], 3, self.seed);
        let polish = Grid::noise(n, [3, 3], 4, self.seed.wrapping_add(1));
        let (blocks, strips, contrast) = (2 * self.pairs, f64::from(self.strips), f64::from(self.contrast));
        self.common().maps(wanted, |Place { x, y, u, v, texel }| {
            let (p, q) = (u * f64::from(blocks), v * f64::from(blocks));
            let (i, j) = (floor(p) as u32, floor(q) as u32);
            // Along and across in turn: the strip's own length and width.
            let turned = (i + j) % 2 == 1;
            let (long, wide) = if turned { (fraction(q), fraction(p)) } else { (fraction(p), fraction(q)) };
            let strip = wrap(floor(wide * strips), self.strips);
            let draw = |k: u32| chance(i * 8 + strip, j + 64 * k, self.seed);
            let fibre = grain.at(0.25 * long + draw(0), 0.25 * wide + draw(1));
            let away = (to_whole(wide * strips) / strips).min(to_whole(long)) / f64::from(blocks);
            let joint = 1.0 - smooth(0.0003, 0.0003 + 1.3 * texel, away);
            let shade = contrast * draw(2) + 0.4 * fibre + 0.15;
            let worn = polish.texel(x, y);
            Spot {
                color: blend(gain(blend(colors[0], colors[1], shade), 1.0 + 0.05 * worn), colors[2], 0.8 * joint),
                rough: mix(0.3 + 0.25 * worn + 0.15 * fibre, 1.0, joint),
                metallic: 0.0,
                height: smooth(0.0, 0.004, away) + 0.12 * fibre + 0.1 * draw(3),
            }
        })
    }
}
