//! Leaves, with nothing between them.

use super::field::{blend, chance, floor, gain, smooth, wave, wrap};
use super::sheet::{MapSet, Maps, Place, Spot};
use crate::family::family;

family! {
    /// Leaves that overlap, with holes between them: leaf, second tone, vein. The holes are in the alpha of the colour, which
    /// `opacity` and `alpha_cutoff` look at.
    pattern Leaves: 3 colors [[0.1, 0.22, 0.04], [0.2, 0.28, 0.05], [0.3, 0.38, 0.14]], roughness [0.35, 0.75], depth 0.006;
    /// Leaves along an edge.
    leaves: u32 [2, 48] or 9;
    /// Share of places that have a leaf.
    density: f32 [0.1, 1.0] or 0.8;
    /// Length of a leaf over its width.
    slender: f32 [1.0, 6.0] or 2.2;
    /// How much leaves differ in colour and direction.
    uneven: f32 [0.0, 1.0] or 0.6;
}

/// Half the length of a leaf in distances of neighbours.
const REACH: f64 = 0.8;

/// The uppermost leaf at a place.
struct Leaf {
    /// Above which others it lies, and what its colour is.
    order: f64,
    tone: f64,
    /// 0 at the rim, 1 at most in the middle.
    inside: f64,
    /// -1 at the stem, 1 at the tip; distance from the middle vein.
    along: f64,
    across: f64,
}

impl Leaves {
    pub(super) fn maps(&self, wanted: MapSet) -> Maps {
        let colors = self.palette();
        let (count, seed) = (f64::from(self.leaves), self.seed);
        let (density, slender, uneven) = (f64::from(self.density), f64::from(self.slender), f64::from(self.uneven));
        self.common().maps_with_alpha(wanted, |Place { u, v, texel, .. }| {
            let (p, q) = (u * count, v * count);
            let (column, row) = (floor(p), floor(q));
            let edge = 0.75 * texel * count;
            let mut top: Option<Leaf> = None;
            for (j, i) in (row - 1..=row + 1).flat_map(|j| (column - 1..=column + 1).map(move |i| (j, i))) {
                let (x, y) = (wrap(i, self.leaves), wrap(j, self.leaves));
                // A leaf of every layer stands in each cell.
                for layer in 0..2u32 {
                    let draw = |k: u32| chance(x, y, seed.wrapping_add(64 * layer + k));
                    if draw(0) > density || top.as_ref().is_some_and(|top| top.order > draw(1)) {
                        continue;
                    }
                    // They hang about the direction of v.
                    let turn = 0.25 + (0.15 + 0.35 * uneven) * (draw(2) - 0.5);
                    let (cos, sin) = (wave(turn + 0.25), wave(turn));
                    let away = [p - i as f64 - 0.5 - 0.7 * (draw(3) - 0.5), q - j as f64 - 0.5 - 0.7 * (draw(4) - 0.5)];
                    let length = REACH * (1.0 - 0.3 * uneven * draw(5));
                    let along = (away[0] * cos + away[1] * sin) / length;
                    let across = (away[1] * cos - away[0] * sin) / length * slender;
                    // A lens, widest below its middle.
                    let half = (1.0 - along * along) * (1.0 - 0.3 * along);
                    let inside = half - across.abs();
                    if along.abs() < 1.0 && inside > -edge * slender {
                        top = Some(Leaf { order: draw(1), tone: draw(6), inside, along, across });
                    }
                }
            }
            let Some(leaf) = top else {
                // Holes have the colour of leaves, so that no other colour bleeds into them.
                return (Spot { color: colors[0], rough: 0.5, metallic: 0.0, height: 0.0 }, 0.0);
            };
            let width = 0.05 + edge;
            let side = smooth(0.0, 0.06, wave(6.0 * (leaf.along + 0.5 * leaf.across.abs())) - 0.9);
            let vein = (1.0 - smooth(0.0, width, leaf.across.abs())).max(0.5 * side);
            let color = blend(colors[0], colors[1], uneven * leaf.tone);
            let color = blend(gain(color, 1.0 + 0.4 * uneven * (leaf.tone - 0.5)), colors[2], vein);
            let bulge = smooth(0.0, 0.5, leaf.inside);
            let spot =
                Spot { color, rough: 0.3 + 0.5 * leaf.tone, metallic: 0.0, height: leaf.order + 0.3 * bulge - 0.15 * vein };
            (spot, smooth(-edge * slender, edge * slender, leaf.inside))
        })
    }
}
