//! Figures: checks, stripes, dots, patches and paint.

use super::field::{Cells, Grid, blend, chance, floor, fraction, gain, mix, smooth, to_whole, wave, wrap};
use super::sheet::{MapSet, Maps, Place, Spot};
use crate::family::family;

family! {
    /// Squares of two colours in turn, with fine grooves between them and wear.
    pattern Checker: 2 colors [[0.75, 0.72, 0.65], [0.05, 0.05, 0.06]], roughness [0.15, 0.5], depth 0.002;
    /// Pairs of squares along an edge.
    pairs: u32 [1, 16] or 4;
    /// How much squares of one colour differ, and how worn they are.
    wear: f32 [0.0, 1.0] or 0.3;
}

impl Checker {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, wear, squares) = (self.palette(), f64::from(self.wear), 2 * self.pairs);
        let worn = Grid::noise(self.resolution as usize, [4, 4], 5, self.seed);
        self.common().maps(wanted, |Place { x, y, u, v, texel }| {
            let (i, j) = (u * f64::from(squares), v * f64::from(squares));
            let (a, b) = (floor(i) as u32, floor(j) as u32);
            let groove = to_whole(i).min(to_whole(j)) / (texel * f64::from(squares)).max(0.012);
            let tone = 1.0 + wear * 0.35 * (chance(a, b, self.seed) - 0.5) + wear * 0.25 * worn.texel(x, y);
            let line = smooth(0.0, 1.2, groove);
            Spot {
                color: gain(colors[((a + b) % 2) as usize], tone * mix(0.55, 1.0, line)),
                rough: (0.3 + wear * 0.7 * worn.texel(x, y) + (1.0 - line)).clamp(0.0, 1.0),
                metallic: 0.0,
                height: smooth(0.0, 2.5, groove) + 0.1 * wear * worn.texel(x, y),
            }
        })
    }
}

family! {
    /// Stripes of uneven widths along u, as on awnings and shirts: ground, first and second stripe, thin line.
    pattern Stripes: 4 colors [[0.82, 0.8, 0.74], [0.55, 0.08, 0.06], [0.05, 0.1, 0.25], [0.75, 0.5, 0.1]], roughness [0.5, 0.8], depth 0.0015;
    /// Groups of stripes across the texture.
    groups: u32 [1, 16] or 3;
    /// How much the widths of groups differ.
    uneven: f32 [0.0, 1.0] or 0.5;
    /// Strength of the cloth's threads.
    threads: f32 [0.0, 1.0] or 0.5;
}

impl Stripes {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let fine = Grid::noise(n, [16, 128], 2, self.seed);
        let groups = f64::from(self.groups);
        let threads = f64::from(self.threads);
        let uneven = f64::from(self.uneven);
        self.common().maps(wanted, |Place { x, y, v, texel, .. }| {
            let p = v * groups;
            let group = floor(p) as u32 % self.groups;
            let draw = |k: u32| mix(0.5, chance(group, k, self.seed), uneven);
            // Two bands and a line, each about its own middle.
            let f = fraction(p);
            let edge = 0.75 * texel * groups;
            let band = |middle: f64, half: f64| 1.0 - smooth(half - edge, half + edge, (f - middle).abs());
            let mut color = blend(colors[0], colors[1], band(0.28, 0.05 + 0.14 * draw(0)));
            color = blend(color, colors[2], band(0.68, 0.03 + 0.15 * draw(1)));
            color = blend(color, colors[3], band(0.48 + 0.04 * draw(2), 0.012 + 0.015 * draw(3)));
            let thread = fine.texel(x, y);
            Spot {
                color: gain(color, 1.0 + 0.3 * threads * thread),
                rough: 0.5 + 0.5 * thread,
                metallic: 0.0,
                height: threads * (0.5 + 0.5 * thread),
            }
        })
    }
}

family! {
    /// Discs on a lattice: ground, one half of the discs, the other half; they can stand out as studs.
    pattern Dots: 3 colors [[0.7, 0.68, 0.6], [0.6, 0.05, 0.08], [0.04, 0.2, 0.4]], roughness [0.2, 0.55], depth 0.004;
    /// Pairs of discs along an edge.
    pairs: u32 [1, 16] or 4;
    /// Mean radius in distances of neighbours.
    radius: f32 [0.05, 0.45] or 0.28;
    /// How much places and sizes differ.
    uneven: f32 [0.0, 1.0] or 0.15;
}

impl Dots {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, count) = (self.palette(), 2 * self.pairs);
        let dirt = Grid::noise(self.resolution as usize, [6, 6], 4, self.seed);
        let (radius, uneven) = (f64::from(self.radius), f64::from(self.uneven));
        self.common().maps(wanted, |Place { x, y, u, v, texel }| {
            let row = floor(v * f64::from(count)) as u32;
            // Every other row is shifted by half a distance.
            let p = u * f64::from(count) + 0.5 * f64::from(row % 2);
            let column = wrap(floor(p), count);
            let draw = |k: u32| chance(column, row + 64 * k, self.seed) - 0.5;
            let size = radius * (1.0 + 0.8 * uneven * draw(0));
            let play = uneven * (0.5 - size).max(0.0);
            let (a, b) = (fraction(p) - 0.5 - play * draw(1), fraction(v * f64::from(count)) - 0.5 - play * draw(2));
            let away = (a * a + b * b).sqrt();
            let edge = 0.75 * texel * f64::from(count);
            let inside = 1.0 - smooth(size - edge, size + edge, away);
            let disc = colors[if chance(column, row, self.seed ^ 0xd07) < 0.5 { 1 } else { 2 }];
            let round = (1.0 - (away / size).min(1.0).powi(2)).sqrt();
            Spot {
                color: gain(blend(colors[0], disc, inside), 1.0 + 0.08 * dirt.texel(x, y)),
                rough: mix(0.75, 0.1, inside) + 0.25 * dirt.texel(x, y),
                metallic: 0.0,
                height: round + 0.03 * dirt.texel(x, y),
            }
        })
    }
}

family! {
    /// Woodland camouflage: ground, then three colours of patches above each other.
    pattern Camouflage: 4 colors [[0.25, 0.24, 0.13], [0.09, 0.12, 0.05], [0.16, 0.1, 0.05], [0.02, 0.02, 0.02]], roughness [0.7, 0.95], depth 0.001;
    /// Patches along an edge.
    patches: u32 [1, 12] or 4;
    /// Share of the ground that is covered.
    cover: f32 [0.1, 0.9] or 0.55;
    /// How ragged patches are.
    ragged: f32 [0.0, 1.0] or 0.5;
}

impl Camouflage {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let layer = |k: u32| Grid::noise(n, [self.patches, self.patches + k % 2], 2, self.seed.wrapping_add(17 * k));
        let layers = [layer(1), layer(2), layer(3)];
        let warp = Grid::noise(n, [3 * self.patches; 2], 2, self.seed.wrapping_add(99));
        let cloth = Grid::noise(n, [128, 128], 1, self.seed.wrapping_add(5));
        let (cover, ragged) = (f64::from(self.cover), f64::from(self.ragged));
        let soft = 1.5 * f64::from(self.patches) / n as f64;
        self.common().maps(wanted, |Place { x, y, u, v, .. }| {
            let bend = 0.06 * ragged * warp.texel(x, y);
            let mut color = colors[0];
            for (k, layer) in layers.iter().enumerate() {
                let level = mix(0.75, -0.35, cover) + 0.12 * k as f64;
                let inside = smooth(level - soft, level + soft, layer.at(u + bend, v - bend));
                color = blend(color, colors[k + 1], inside);
            }
            let thread = cloth.texel(x, y);
            Spot { color: gain(color, 1.0 + 0.15 * thread), rough: 0.5 + 0.6 * thread, metallic: 0.0, height: 0.5 + 0.5 * thread }
        })
    }
}

family! {
    /// Sprayed and poured paint: wall, two fills with dark outlines, and the outline's colour.
    pattern Graffiti: 4 colors [[0.55, 0.53, 0.5], [0.75, 0.2, 0.03], [0.03, 0.35, 0.5], [0.02, 0.02, 0.03]], roughness [0.25, 0.85], depth 0.0015;
    /// Figures along an edge.
    figures: u32 [1, 8] or 2;
    /// Width of outlines.
    outline: f32 [0.0, 1.0] or 0.4;
    /// Drops of paint beside the figures.
    splatter: f32 [0.0, 1.0] or 0.5;
}

impl Graffiti {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let seed = |k: u32| self.seed.wrapping_add(31 * k);
        let layers = [Grid::noise(n, [self.figures; 2], 2, seed(1)), Grid::noise(n, [self.figures + 1; 2], 2, seed(2))];
        let warp = [Grid::noise(n, [2 * self.figures; 2], 2, seed(3)), Grid::noise(n, [2 * self.figures; 2], 2, seed(4))];
        let wall = Grid::noise(n, [8, 8], 5, seed(5));
        let drops = Cells::new([24, 24], 0.8, seed(6));
        let (line, splatter) = (0.16 * f64::from(self.outline), f64::from(self.splatter));
        let soft = 2.0 * f64::from(self.figures) / n as f64;
        self.common().maps(wanted, |Place { x, y, u, v, texel }| {
            let (a, b) = (u + 0.12 * warp[0].texel(x, y), v + 0.12 * warp[1].texel(x, y));
            let grain = wall.texel(x, y);
            let mut color = gain(colors[0], 1.0 + 0.3 * grain);
            let mut painted = 0.0_f64;
            for (k, layer) in layers.iter().enumerate() {
                let level = layer.at(a, b) - 0.12;
                let shade = gain(colors[k + 1], 0.75 + 0.5 * smooth(0.0, 0.7, level));
                let edge = smooth(-soft, soft, level);
                let filled = blend(colors[3], shade, smooth(line - soft, line + soft, level));
                color = blend(color, filled, edge);
                painted = painted.max(edge);
            }
            let drop = drops.at(u, v);
            let size = 0.3 * splatter * drop.draw(1) * drop.draw(2);
            let spot = 1.0 - smooth(size - 24.0 * texel, size, drop.near);
            color = blend(color, colors[1 + (drop.id % 3) as usize], spot);
            painted = painted.max(spot);
            Spot {
                color,
                rough: mix(0.85 + 0.3 * grain, 0.15 + 0.1 * grain, painted),
                metallic: 0.0,
                height: mix(0.5 + 0.5 * grain, 0.7 + 0.25 * grain, painted),
            }
        })
    }
}

family! {
    /// A round ripple of ribs, as on corrugated sheet, cords and grooved panels: rib, groove.
    pattern Corrugated: 2 colors [[0.6, 0.61, 0.62], [0.35, 0.33, 0.3]], roughness [0.2, 0.5], depth 0.012;
    /// Ribs across the texture.
    ribs: u32 [1, 64] or 12;
    /// 0 = a sine, 1 = flat ribs with steep sides.
    square: f32 [0.0, 1.0] or 0.0;
    /// Dirt in the grooves.
    dirt: f32 [0.0, 1.0] or 0.3;
    /// 0 = dielectric, 1 = metal.
    metallic: f32 [0.0, 1.0] or 1.0;
}

impl Corrugated {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let colors = self.palette();
        let stains = Grid::noise(self.resolution as usize, [4, 4], 5, self.seed);
        let (square, dirt, metallic) = (f64::from(self.square), f64::from(self.dirt), f64::from(self.metallic));
        self.common().maps(wanted, |Place { x, y, u, .. }| {
            let sine = wave(u * f64::from(self.ribs));
            let steep = mix(2.0, 0.35, square);
            let height = mix(0.5 + 0.5 * sine, smooth(-steep, steep, sine), square);
            let foul = dirt * smooth(0.2, 1.1, (1.0 - height) * 0.8 + 0.5 * stains.texel(x, y));
            Spot {
                color: gain(blend(colors[0], colors[1], foul), 1.0 + 0.06 * stains.texel(x, y)),
                rough: 0.3 + 0.25 * stains.texel(x, y) + foul,
                metallic: metallic * (1.0 - 0.8 * foul),
                height,
            }
        })
    }
}
