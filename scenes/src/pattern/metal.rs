//! Metal, bare, worn, rusty and painted.

use super::field::{Cells, Grid, blend, chance, floor, fraction, gain, mix, smooth, wrap};
use super::sheet::{MapSet, Maps, Place, Spot};
use crate::family::family;

family! {
    /// Rust on metal: metal, light rust, dark rust. Rust is a dielectric, metal is not.
    pattern Rust: 3 colors [[0.45, 0.44, 0.43], [0.32, 0.11, 0.03], [0.09, 0.035, 0.02]], roughness [0.25, 1.0], depth 0.006;
    /// Patches along an edge.
    patches: u32 [1, 16] or 3;
    /// Share of the surface that is rusty.
    cover: f32 [0.0, 1.0] or 0.45;
    /// Stains that run from rusty places down the metal.
    runs: f32 [0.0, 1.0] or 0.3;
}

impl Rust {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let seed = |k: u32| self.seed.wrapping_add(k);
        let patch = Grid::noise(n, [self.patches; 2], 6, seed(1));
        let tone = Grid::noise(n, [6, 6], 5, seed(2));
        let pits = Grid::noise(n, [48, 48], 3, seed(3));
        let run = Grid::noise(n, [24, 1], 3, seed(4));
        let (cover, runs) = (f64::from(self.cover), f64::from(self.runs));
        let level = mix(0.75, -0.75, cover);
        self.common().maps(wanted, |Place { x, y, u, v, .. }| {
            let (a, t, p) = (patch.texel(x, y), tone.texel(x, y), pits.texel(x, y));
            let amount = a + 0.15 * p - level;
            let rust = smooth(-0.02, 0.06, amount);
            // What stands above on the wall has run down over the metal.
            let above = patch.at(u, v - 0.06).max(patch.at(u, v - 0.13) - 0.1) - level;
            let stain = runs * smooth(-0.05, 0.3, above + 0.35 * run.texel(x, y)) * (1.0 - rust);
            let oxide = gain(blend(colors[1], colors[2], smooth(-0.5, 0.7, t + 0.8 * amount - 0.25)), 1.0 + 0.35 * p);
            let metal = blend(gain(colors[0], 1.0 + 0.12 * t), colors[1], 0.6 * stain);
            Spot {
                color: blend(metal, oxide, rust),
                rough: mix(0.12 + 0.2 * t + 0.5 * stain, 0.85 + 0.2 * p, rust),
                metallic: (1.0 - rust) * (1.0 - 0.6 * stain),
                height: rust * (0.45 + 0.35 * p + 0.25 * t) + 0.02 * t,
            }
        })
    }
}

family! {
    /// Bare metal with fine scratches in any direction: metal, tarnish.
    pattern Scratched: 2 colors [[0.72, 0.72, 0.73], [0.42, 0.37, 0.3]], roughness [0.08, 0.6], depth 0.0012;
    /// Scratches.
    scratches: u32 [1, 2000] or 400;
    /// 0 = all along u, 1 = any direction.
    spread: f32 [0.0, 1.0] or 1.0;
    /// Longest scratch in widths of the texture.
    length: f32 [0.02, 1.0] or 0.35;
    /// Tarnish and finger marks.
    tarnish: f32 [0.0, 1.0] or 0.35;
}

impl Scratched {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let marks =
            Grid::scratches(n, self.scratches, f64::from(self.length), 0.004, f64::from(self.spread), self.seed.wrapping_add(1));
        let smear = Grid::noise(n, [3, 3], 6, self.seed.wrapping_add(2));
        let tarnish = f64::from(self.tarnish);
        self.common().maps(wanted, |Place { x, y, .. }| {
            let (mark, smear) = (marks.texel(x, y), smear.texel(x, y));
            let foul = tarnish * smooth(-0.2, 0.8, smear);
            Spot {
                color: gain(blend(colors[0], colors[1], foul * (1.0 - mark)), 1.0 - 0.15 * mark),
                rough: 0.1 + 0.6 * foul + 0.55 * mark + 0.08 * smear,
                metallic: 1.0,
                height: 1.0 - mark,
            }
        })
    }
}

family! {
    /// Paint on metal with chips down to it, rimmed by primer: paint, primer, metal.
    pattern ChippedPaint: 3 colors [[0.05, 0.18, 0.3], [0.35, 0.12, 0.07], [0.5, 0.49, 0.47]], roughness [0.15, 0.75], depth 0.003;
    /// Coarseness: chips along an edge.
    chips: u32 [2, 32] or 8;
    /// Share of the surface without paint.
    worn: f32 [0.0, 1.0] or 0.25;
    /// Scratches through the paint.
    scratches: u32 [0, 500] or 60;
}

impl ChippedPaint {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let seed = |k: u32| self.seed.wrapping_add(k);
        let wear = Grid::noise(n, [2, 2], 3, seed(1));
        let chips = Grid::noise(n, [self.chips; 2], 4, seed(2));
        let cells = Cells::new([2 * self.chips; 2], 0.8, seed(3));
        let marks = Grid::scratches(n, self.scratches, 0.3, 0.005, 1.0, seed(4));
        let peel = Grid::noise(n, [64, 64], 2, seed(5));
        let level = mix(0.62, -0.75, f64::from(self.worn));
        self.common().maps(wanted, |Place { x, y, u, v, .. }| {
            let (a, c) = (wear.texel(x, y), chips.texel(x, y));
            // Flakes have straight rims: whole cells go where wear is high.
            let flake = cells.at(u + 0.004 * c, v + 0.004 * c).draw(1) - 0.5;
            let amount = 0.6 * a + 0.5 * c + 0.35 * flake - level + 0.7 * (marks.texel(x, y) - 0.25).max(0.0);
            let (primer, metal) = (smooth(-0.01, 0.03, amount), smooth(0.045, 0.09, amount));
            let paint = gain(colors[0], 1.0 + 0.1 * a);
            Spot {
                color: blend(blend(paint, gain(colors[1], 1.0 + 0.2 * c), primer), gain(colors[2], 1.0 + 0.15 * c), metal),
                rough: mix(mix(0.15 + 0.1 * a, 0.95, primer), 0.4 + 0.25 * c, metal),
                metallic: metal,
                height: 1.0 - 0.55 * primer - 0.45 * metal + 0.06 * peel.texel(x, y) * (1.0 - primer),
            }
        })
    }
}

family! {
    /// Metal brushed along u: metal, darker lines.
    pattern Brushed: 2 colors [[0.7, 0.7, 0.71], [0.5, 0.5, 0.52]], roughness [0.15, 0.5], depth 0.0006;
    /// Lines across the texture.
    lines: u32 [16, 256] or 160;
    /// How strongly lines differ.
    contrast: f32 [0.0, 1.0] or 0.5;
    /// Marks of use.
    smudges: f32 [0.0, 1.0] or 0.25;
}

impl Brushed {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let fine = Grid::noise(n, [3, self.lines], 2, self.seed.wrapping_add(1));
        let broad = Grid::noise(n, [1, (self.lines / 8).max(2)], 3, self.seed.wrapping_add(2));
        let smear = Grid::noise(n, [3, 3], 5, self.seed.wrapping_add(3));
        let (contrast, smudges) = (f64::from(self.contrast), f64::from(self.smudges));
        self.common().maps(wanted, |Place { x, y, .. }| {
            let line = 0.7 * fine.texel(x, y) + 0.5 * broad.texel(x, y);
            let foul = smudges * smooth(0.0, 0.7, smear.texel(x, y));
            Spot {
                color: gain(blend(colors[0], colors[1], 0.4 + contrast * 0.8 * line), 1.0 - 0.2 * foul),
                rough: 0.4 + contrast * 0.45 * line + 0.6 * foul,
                metallic: 1.0,
                height: 0.5 + 0.5 * line,
            }
        })
    }
}

family! {
    /// Metal beaten with a round hammer: metal, tarnish between the dents.
    pattern Hammered: 2 colors [[0.75, 0.5, 0.35], [0.25, 0.16, 0.1]], roughness [0.12, 0.45], depth 0.01;
    /// Dents along an edge.
    dents: u32 [2, 48] or 10;
    /// How unevenly dents are placed.
    uneven: f32 [0.0, 1.0] or 0.8;
    /// Tarnish.
    tarnish: f32 [0.0, 1.0] or 0.35;
    /// 0 = dielectric (beaten leather, orange peel), 1 = metal.
    metallic: f32 [0.0, 1.0] or 1.0;
}

impl Hammered {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let cells = Cells::new([self.dents; 2], 0.8 * f64::from(self.uneven), self.seed.wrapping_add(1));
        let smear = Grid::noise(n, [4, 4], 5, self.seed.wrapping_add(2));
        let (tarnish, metallic) = (f64::from(self.tarnish), f64::from(self.metallic));
        self.common().maps(wanted, |Place { x, y, u, v, .. }| {
            let (cell, smear) = (cells.at(u, v), smear.texel(x, y));
            // A bowl of which neighbours cut the rim away; the rim is rounded.
            let rim = (cell.edge / 0.18).min(1.0);
            let round = 0.09 * (1.0 - rim) * (1.0 - rim);
            let bowl = cell.near * cell.near - round;
            let foul = tarnish * smooth(0.1, 0.9, 0.9 * bowl + 0.4 * smear + 0.2);
            Spot {
                color: gain(blend(colors[0], colors[1], foul), 0.97 + 0.06 * cell.draw(1)),
                rough: 0.15 + 0.75 * foul + 0.1 * smear,
                metallic: metallic * (1.0 - 0.4 * foul),
                height: bowl * (0.8 + 0.4 * cell.draw(2)),
            }
        })
    }
}

family! {
    /// Sheet with raised lozenges turned in turn, for stairs and floors: metal, dirt.
    pattern TreadPlate: 2 colors [[0.6, 0.6, 0.61], [0.16, 0.13, 0.1]], roughness [0.2, 0.7], depth 0.01;
    /// Pairs of lozenges along an edge.
    pairs: u32 [1, 16] or 4;
    /// Length of a lozenge in distances of neighbours.
    length: f32 [0.2, 0.48] or 0.4;
    /// Dirt between the lozenges.
    dirt: f32 [0.0, 1.0] or 0.4;
    /// Scratches on the lozenges.
    scratches: u32 [0, 1000] or 200;
}

impl TreadPlate {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let smear = Grid::noise(n, [4, 4], 5, self.seed.wrapping_add(1));
        let marks = Grid::scratches(n, self.scratches, 0.3, 0.004, 1.0, self.seed.wrapping_add(2));
        let (count, length, dirt) = (2.0 * f64::from(self.pairs), f64::from(self.length), f64::from(self.dirt));
        self.common().maps(wanted, |Place { x, y, u, v, .. }| {
            let (p, q) = (u * count, v * count);
            let turned = (floor(p) + floor(q)) % 2 == 0;
            let (a, b) = (fraction(p) - 0.5, fraction(q) - 0.5);
            let (along, across) = if turned { (a + b, a - b) } else { (a - b, a + b) };
            // Half the width of a lens between two arcs; diagonals are longer by the root of two.
            let along = along / (std::f64::consts::SQRT_2 * length);
            let half = 0.28 * length * (1.0 - along * along);
            let inside = half - across.abs() / std::f64::consts::SQRT_2;
            let top = smooth(-0.02, 0.06, inside);
            let foul = dirt * (1.0 - top) * smooth(-0.6, 0.6, smear.texel(x, y) + 0.8 * (0.3 - (inside + 0.3).abs()));
            let mark = marks.texel(x, y) * mix(0.4, 1.0, top);
            Spot {
                color: gain(blend(colors[0], colors[1], foul), 1.0 + 0.06 * smear.texel(x, y)),
                rough: 0.25 + 0.15 * smear.texel(x, y) + 0.7 * foul + 0.3 * mark,
                metallic: 1.0 - 0.9 * foul,
                height: top - 0.05 * mark,
            }
        })
    }
}

family! {
    /// Carbon fibre in twill of two over two: fibres lit, fibres dark.
    pattern CarbonFibre: 2 colors [[0.07, 0.07, 0.075], [0.015, 0.015, 0.017]], roughness [0.2, 0.5], depth 0.002;
    /// Repeats of four tows along an edge.
    repeats: u32 [1, 16] or 6;
    /// How strongly warp and weft differ.
    contrast: f32 [0.0, 1.0] or 0.7;
}

impl CarbonFibre {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let fine = [Grid::noise(n, [4, 128], 2, self.seed), Grid::noise(n, [128, 4], 2, self.seed.wrapping_add(1))];
        let (tows, contrast) = (4 * self.repeats, f64::from(self.contrast));
        self.common().maps(wanted, |Place { x, y, u, v, .. }| {
            let (p, q) = (u * f64::from(tows), v * f64::from(tows));
            let (i, j) = (floor(p), floor(q));
            // Which tow lies above moves on by one from row to row.
            let over = wrap(i + j, 4) < 2;
            let (across, along) = if over { (fraction(q), p - j as f64) } else { (fraction(p), q + i as f64) };
            let tow = 2.0 * across - 1.0;
            // A float runs over two tows and dips at its ends.
            let t = if over { fraction(0.5 * (p + j as f64)) } else { fraction(0.5 * (q + i as f64)) };
            let dip = 1.0 - (2.0 * t - 1.0).powi(2);
            let fibre = fine[usize::from(!over)].texel(x, y);
            let side = if over { 0.5 } else { -0.5 };
            let shine = 0.5 + contrast * (side + 0.25 * fibre) + 0.1 * (chance(wrap(floor(along), 64), 1, self.seed) - 0.5);
            let height = (1.0 - tow * tow).sqrt() * (0.4 + 0.6 * dip.sqrt());
            Spot {
                color: gain(blend(colors[1], colors[0], shine.clamp(0.0, 1.0)), 0.6 + 0.4 * height),
                rough: 0.4 - 0.3 * contrast * side + 0.3 * fibre,
                metallic: 0.0,
                height: height + 0.06 * fibre,
            }
        })
    }
}
