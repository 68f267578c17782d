//! Stone and earth.

use super::field::{Cells, Grid, blend, gain, mix, smooth, wave};
use super::sheet::{MapSet, Maps, Place, Spot};
use crate::family::family;

family! {
    /// Polished marble: ground, clouds, veins.
    pattern Marble: 3 colors [[0.8, 0.79, 0.76], [0.6, 0.6, 0.6], [0.2, 0.19, 0.2]], roughness [0.05, 0.3], depth 0.0;
    /// Veins along an edge.
    veins: u32 [1, 12] or 3;
    /// How far veins are bent.
    turbulence: f32 [0.0, 1.0] or 0.5;
    /// How sharp and dark veins are.
    contrast: f32 [0.0, 1.0] or 0.6;
}

impl Marble {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let seed = |k: u32| self.seed.wrapping_add(k);
        let warp = [Grid::noise(n, [3, 3], 4, seed(1)), Grid::noise(n, [3, 3], 4, seed(2))];
        let large = Grid::noise(n, [self.veins; 2], 2, seed(3));
        let small = Grid::noise(n, [2 * self.veins + 1; 2], 2, seed(4));
        let cloud = Grid::noise(n, [2, 2], 5, seed(5));
        let (bend, contrast) = (0.16 * f64::from(self.turbulence), f64::from(self.contrast));
        self.common().maps(wanted, |Place { x, y, u, v, .. }| {
            let (a, b) = (u + bend * warp[0].texel(x, y), v + bend * warp[1].texel(x, y));
            // A vein is where noise changes its sign; its width differs along it.
            let width = mix(0.3, 0.07, contrast);
            let thick = 1.0 + 0.8 * cloud.texel(x, y);
            let main = 1.0 - smooth(0.0, width * thick.max(0.15), large.at(a, b).abs());
            let hair = 1.0 - smooth(0.0, 0.06, small.at(b, a).abs());
            let mist = smooth(-0.3, 0.9, cloud.at(a, b));
            let ground = blend(colors[0], colors[1], mix(0.3, 0.9, contrast) * mist);
            let vein = (main * main * mix(0.5, 1.0, contrast) + 0.6 * hair * hair * mist).min(1.0);
            Spot {
                color: blend(ground, colors[2], vein),
                rough: 0.2 + 0.5 * vein + 0.2 * mist,
                metallic: 0.0,
                height: 1.0 - vein,
            }
        })
    }
}

family! {
    /// Granite, polished or rough: four minerals.
    pattern Granite: 4 colors [[0.55, 0.47, 0.42], [0.3, 0.29, 0.28], [0.7, 0.68, 0.65], [0.04, 0.04, 0.045]], roughness [0.08, 0.4], depth 0.0;
    /// Grains along an edge.
    grains: u32 [8, 128] or 64;
    /// How unevenly minerals are spread.
    clumps: f32 [0.0, 1.0] or 0.5;
    /// Share of the fourth mineral.
    dark: f32 [0.0, 1.0] or 0.3;
}

impl Granite {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let seed = |k: u32| self.seed.wrapping_add(k);
        let cells = Cells::new([self.grains; 2], 0.8, seed(1));
        let clump = Grid::noise(n, [(self.grains / 8).max(2); 2], 4, seed(2));
        let fine = Grid::noise(n, [2 * self.grains; 2], 2, seed(3));
        let (clumps, dark, bend) = (f64::from(self.clumps), f64::from(self.dark), 0.35 / f64::from(self.grains));
        self.common().maps(wanted, |Place { x, y, u, v, .. }| {
            let (large, small) = (clump.texel(x, y), fine.texel(x, y));
            let cell = cells.at(u + bend * small, v - bend * small);
            let level = cell.draw(1) + 0.5 * clumps * large;
            let black = cell.draw(2) + 0.4 * clumps * clump.at(v, u) < 0.7 * dark;
            let color = if black {
                colors[3]
            } else if level < 0.45 {
                colors[0]
            } else if level < 0.72 {
                colors[1]
            } else {
                colors[2]
            };
            Spot {
                color: gain(color, 0.85 + 0.3 * cell.draw(3) + 0.12 * small),
                rough: 0.7 * cell.draw(4) + 0.3 * f64::from(u8::from(black)),
                metallic: 0.0,
                height: 0.5 * cell.draw(5) + 0.4 * small,
            }
        })
    }
}

family! {
    /// Chips of stone ground flush in a binder: three kinds of chips, binder.
    pattern Terrazzo: 4 colors [[0.65, 0.3, 0.2], [0.2, 0.22, 0.25], [0.75, 0.72, 0.66], [0.62, 0.6, 0.56]], roughness [0.1, 0.45], depth 0.0;
    /// Large chips along an edge.
    chips: u32 [4, 48] or 12;
    /// Share of the surface that chips cover.
    cover: f32 [0.0, 1.0] or 0.6;
    /// How much chips of one kind differ.
    variation: f32 [0.0, 1.0] or 0.4;
}

impl Terrazzo {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let seed = |k: u32| self.seed.wrapping_add(k);
        let (large, small) = (Cells::new([self.chips; 2], 0.8, seed(1)), Cells::new([3 * self.chips; 2], 0.8, seed(2)));
        let warp = Grid::noise(n, [2 * self.chips; 2], 2, seed(3));
        let cloud = Grid::noise(n, [4, 4], 5, seed(4));
        let (cover, variation) = (f64::from(self.cover), f64::from(self.variation));
        let bend = 0.2 / f64::from(self.chips);
        self.common().maps(wanted, |Place { x, y, u, v, texel }| {
            let shift = bend * warp.texel(x, y);
            let binder = gain(colors[3], 1.0 + 0.1 * cloud.texel(x, y));
            let (mut color, mut chip) = (binder, 0.0_f64);
            for (k, (cells, count)) in [(&small, 3 * self.chips), (&large, self.chips)].into_iter().enumerate() {
                let cell = cells.at(u + shift, v - shift);
                if cell.draw(1) > cover {
                    continue;
                }
                // Chips keep a distance from their neighbours that differs from chip to chip.
                let away = cell.edge - 0.04 - 0.16 * cell.draw(2);
                let inside = smooth(0.0, 1.6 * texel * f64::from(count), away);
                let stone = colors[(cell.id >> 5) as usize % 3];
                let tone = 1.0 + variation * (cell.draw(3 + k as u32) - 0.5);
                color = blend(color, gain(stone, tone + 0.1 * warp.texel(x, y)), inside);
                chip = chip.max(inside);
            }
            Spot { color, rough: mix(0.75, 0.15, chip) + 0.2 * cloud.texel(x, y), metallic: 0.0, height: chip }
        })
    }
}

family! {
    /// Earth that dried and tore: earth, second tone, depth of the cracks.
    pattern CrackedEarth: 3 colors [[0.4, 0.28, 0.17], [0.3, 0.2, 0.12], [0.06, 0.04, 0.025]], roughness [0.8, 1.0], depth 0.02;
    /// Plates along an edge.
    plates: u32 [2, 24] or 6;
    /// Width of the cracks in plates.
    gap: f32 [0.01, 0.3] or 0.08;
    /// How far the rims of plates are bent upwards.
    curl: f32 [0.0, 1.0] or 0.4;
    /// How winding cracks are.
    wavy: f32 [0.0, 1.0] or 0.5;
}

impl CrackedEarth {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let seed = |k: u32| self.seed.wrapping_add(k);
        let cells = Cells::new([self.plates; 2], 0.8, seed(1));
        let inner = Cells::new([3 * self.plates; 2], 0.8, seed(2));
        let warp = [Grid::noise(n, [2 * self.plates; 2], 3, seed(3)), Grid::noise(n, [2 * self.plates; 2], 3, seed(4))];
        let fine = Grid::noise(n, [16, 16], 5, seed(5));
        let (gap, curl) = (0.5 * f64::from(self.gap), f64::from(self.curl));
        let bend = 0.25 * f64::from(self.wavy) / f64::from(self.plates);
        self.common().maps(wanted, |Place { x, y, u, v, texel }| {
            let (a, b) = (u + bend * warp[0].texel(x, y), v + bend * warp[1].texel(x, y));
            let (plate, part) = (cells.at(a, b), inner.at(a, b));
            let grain = fine.texel(x, y);
            let soft = 1.5 * texel * f64::from(self.plates);
            let solid = smooth(gap - soft, gap + soft, plate.edge);
            // Finer cracks run through some plates, less deep.
            let hair = if plate.draw(3) < 0.7 { 0.5 * (1.0 - smooth(0.02, 0.06 + 3.0 * soft, part.edge)) } else { 0.0 };
            let rim = 1.0 - smooth(gap, gap + 0.3, plate.edge);
            let earth = gain(blend(colors[0], colors[1], plate.draw(1) + 0.3 * grain), 1.0 + 0.2 * grain + 0.12 * curl * rim);
            Spot {
                color: blend(colors[2], earth, solid * (1.0 - 0.7 * hair)),
                rough: 0.6 + 0.4 * grain,
                metallic: 0.0,
                height: solid * (0.75 + 0.35 * curl * rim * rim - 0.35 * hair + 0.1 * plate.draw(2)) + 0.08 * grain,
            }
        })
    }
}

family! {
    /// Wind ripples in sand or snow: crest, trough, grains of another colour.
    pattern Sand: 3 colors [[0.6, 0.47, 0.3], [0.45, 0.33, 0.2], [0.2, 0.14, 0.1]], roughness [0.75, 1.0], depth 0.012;
    /// Ripples down the texture; 0 = none.
    ripples: u32 [0, 48] or 12;
    /// How wavy ripples are.
    wavy: f32 [0.0, 1.0] or 0.6;
    /// Coarseness: grains along an edge.
    grains: u32 [16, 128] or 96;
}

impl Sand {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let seed = |k: u32| self.seed.wrapping_add(k);
        let bend = Grid::noise(n, [3, 2], 4, seed(1));
        let strength = Grid::noise(n, [3, 4], 2, seed(2));
        let grain = Grid::noise(n, [self.grains; 2], 2, seed(3));
        let (wavy, ripples) = (1.4 * f64::from(self.wavy), f64::from(self.ripples));
        self.common().maps(wanted, |Place { x, y, v, .. }| {
            let fine = grain.texel(x, y);
            let phase = wave(v * ripples + wavy * bend.texel(x, y));
            // Crests are sharper than troughs.
            let crest = 0.5 + 0.5 * phase;
            let wind = (0.65 + 0.4 * strength.texel(x, y)).clamp(0.15, 1.0);
            let ripple = if self.ripples == 0 { 0.5 + 0.4 * bend.texel(x, y) } else { wind * crest * crest };
            let sand = blend(colors[1], colors[0], smooth(0.0, 0.9, ripple + 0.2 * fine));
            Spot {
                color: blend(sand, colors[2], smooth(0.45, 0.85, fine)),
                rough: 0.6 + 0.4 * fine,
                metallic: 0.0,
                height: ripple + 0.07 * fine,
            }
        })
    }
}

family! {
    /// Soft blotches of three colours into each other.
    pattern Blotches: 3 colors [[0.5, 0.42, 0.3], [0.3, 0.33, 0.2], [0.18, 0.14, 0.1]], roughness [0.4, 0.9], depth 0.006;
    /// Blotches along an edge.
    count: u32 [1, 32] or 4;
    /// Octaves of detail.
    detail: u32 [1, 7] or 5;
    /// How sharply colours meet.
    contrast: f32 [0.0, 1.0] or 0.4;
}

impl Blotches {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let (colors, n) = (self.palette(), self.resolution as usize);
        let first = Grid::noise(n, [self.count; 2], self.detail, self.seed.wrapping_add(1));
        let second = Grid::noise(n, [self.count + 1; 2], self.detail, self.seed.wrapping_add(2));
        let soft = mix(0.8, 0.04, f64::from(self.contrast));
        self.common().maps(wanted, |Place { x, y, .. }| {
            let (a, b) = (first.texel(x, y), second.texel(x, y));
            let color = blend(colors[0], colors[1], smooth(-soft, soft, a));
            let third = smooth(0.15 - soft, 0.35 + soft, b);
            Spot { color: blend(color, colors[2], third), rough: 0.5 + 0.7 * b, metallic: 0.0, height: 0.5 + 0.5 * a + 0.2 * b }
        })
    }
}
