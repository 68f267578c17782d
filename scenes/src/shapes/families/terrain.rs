//! Blocks of land.

use crate::draw::Draw;
use crate::family::{choice, family};
use crate::noise;
use crate::shapes::builder::Builder;
use crate::shapes::families::round::cellular;
use crate::shapes::parts::Dice;
use glam::{DVec2, DVec3};

choice! {
    /// The kind of land.
    Land {
        /// Rolling hills.
        Hills,
        /// Sharp ridges.
        Mountains,
        /// Flat steps.
        Terraces,
        /// Dunes under one wind.
        Dunes,
        /// Round craters.
        Craters,
        /// A mountain in a plain.
        Peak,
        /// A valley cut by a river.
        Canyon,
        /// Cobbles.
        Cobbles,
    }
}

family! {
    /// A closed block with a height field on top and straight sides.
    shape Terrain("terrain", Upright) |rng| {
        /// The kind of land.
        land: Land = Land::draw(rng);
        /// Largest height over the width.
        relief: f32 [0.02, 0.8] = rng.between(0.12, 0.45);
        /// Features across the block.
        frequency: f32 [0.5, 8] = rng.log(1.4, 4.5);
        /// Depth over width of the block.
        deep: f32 [0.3, 1] = rng.between(0.6, 1.0);
        /// Thickness of the block below its lowest point, as a share of the width.
        base: f32 [0.01, 0.5] = rng.between(0.03, 0.12);
        /// Which land.
        seed: u32 = rng.below(1 << 30);
    }
}

impl Terrain {
    fn height(&self, p: DVec2, offset: DVec3) -> f64 {
        let q = DVec3::new(p.x, 0.0, p.y) * f64::from(self.frequency) + offset;
        let seed = self.seed;
        let fractal = |scale: f64, octaves: u32| noise::fractal(q * scale, octaves, seed);
        match self.land {
            Land::Hills => 0.5 + 0.7 * fractal(1.0, 4),
            Land::Mountains => {
                let (mut sum, mut weight, mut scale, mut last) = (0.0, 0.5, 1.0, 1.0);
                // Musgrave's ridged multifractal: detail grows on the ridges.
                for octave in 0..5 {
                    let ridge = (1.0 - 1.6 * noise::gradient(q * scale, seed.wrapping_add(octave)).abs()).max(0.0).powi(2);
                    sum += weight * ridge * last;
                    (last, weight, scale) = (ridge, weight * 0.55, scale * 2.1);
                }
                sum
            }
            Land::Terraces => {
                let h = 5.0 * (0.5 + 0.7 * fractal(0.8, 3));
                let step = h - h.floor();
                (h.floor() + (3.0 * step - 1.2).clamp(0.0, 1.0).powi(2)) / 5.0
            }
            Land::Dunes => {
                let bent = q.x * 1.6 + 1.3 * fractal(0.7, 2);
                let saw = bent - bent.floor();
                let crest = if saw < 0.72 { (saw / 0.72).powf(1.4) } else { ((1.0 - saw) / 0.28).powf(0.9) };
                0.35 * crest * (0.8 + 0.8 * fractal(0.5, 2)) + 0.1
            }
            Land::Craters => {
                let [d, _] = cellular(q * 0.9, seed);
                let bowl = (d / 0.42).min(1.4);
                let rim = (-(bowl - 1.0).powi(2) / 0.03).exp();
                0.35 + 0.25 * fractal(1.3, 4) + 0.16 * rim - 0.3 * (1.0 - bowl * bowl).max(0.0)
            }
            Land::Peak => {
                let d = p.length() * 2.2 * (1.0 + 0.35 * fractal(0.8, 3));
                (1.0 - d).max(0.0).powf(1.3) + 0.12 * (0.5 + fractal(1.5, 5)) * (1.2 - d).clamp(0.15, 1.0)
            }
            Land::Canyon => {
                let river = (p.x + 0.3 * (p.y * 5.0 + offset.x).sin() + 0.25 * fractal(0.7, 3)).abs();
                let wall = (river * 7.0).min(1.0);
                let h = 4.0 * wall.powf(0.7) + 0.5 * fractal(2.0, 4);
                let step = h - h.floor();
                0.2 * (h.floor() + step.powi(3)) + 0.1
            }
            Land::Cobbles => {
                let [a, c] = cellular(q * 1.5, seed);
                0.25 * (2.2 * (c - a)).min(1.0).powf(0.5) + 0.06 * fractal(1.0, 3)
            }
        }
    }

    fn build(&self) -> (Builder, f64) {
        let mut b = Builder::default();
        let offset = Dice::new(self.seed).direction() * 5.0;
        let deep = f64::from(self.deep);
        let nx = 88;
        let nz = ((nx as f64 * deep) as usize).max(8);
        let plain = |i: usize, j: usize| DVec2::new(i as f64 / nx as f64 - 0.5, (j as f64 / nz as f64 - 0.5) * deep);
        let mut heights: Vec<f64> =
            (0..=nz).flat_map(|j| (0..=nx).map(move |i| (i, j))).map(|(i, j)| self.height(plain(i, j), offset)).collect();
        let low = heights.iter().copied().fold(f64::INFINITY, f64::min);
        let high = heights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let scale = f64::from(self.relief) / (high - low).max(1e-9);
        heights.iter_mut().for_each(|h| *h = (*h - low) * scale);
        let top = |i: usize, j: usize| {
            let p = plain(i, j);
            DVec3::new(p.x, heights[j * (nx + 1) + i], p.y)
        };
        let under = |i: usize, j: usize| {
            let p = plain(i, j);
            DVec3::new(p.x, -f64::from(self.base), p.y)
        };
        // Along z, then along x: up.
        b.cells(nz, nx, [3.0 * deep, 3.0], |j, i| top(i, j));
        let rim: Vec<(usize, usize)> = (0..nx)
            .map(|i| (i, nz))
            .chain((1..=nz).rev().map(|j| (nx, j)))
            .chain((1..=nx).rev().map(|i| (i, 0)))
            .chain((0..nz).map(|j| (0, j)))
            .collect();
        for k in 0..rim.len() {
            let ((i, j), (i1, j1)) = (rim[k], rim[(k + 1) % rim.len()]);
            b.facet(&[under(i, j), under(i1, j1), top(i1, j1), top(i, j)]);
        }
        let bottom: Vec<DVec3> = rim.iter().rev().map(|&(i, j)| under(i, j)).collect();
        b.fan(&bottom);
        (b, 50.0)
    }
}
