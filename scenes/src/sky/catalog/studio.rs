//! Rigs of lamps. Powers follow from the irradiance that arrives at the object, drawn over wide ranges.

use super::{degrees, tint, which};
use crate::draw::Draw;
use crate::sky::{Backdrop, Lamp, LampShape, Mask, Sky};
use rand_pcg::Pcg64;

/// Light colours between candle and blue sky, sometimes saturated.
fn lamp_color(rng: &mut Pcg64) -> [f32; 3] {
    if rng.chance(0.2) {
        let hue = rng.between(0.0, 360.0);
        let saturation = rng.between(0.3, 0.95);
        return Pcg64::hsv(hue, saturation, 1.0);
    }
    let warmth = rng.between(-1.0, 1.0);
    let (red, blue) = if warmth > 0.0 { (1.0, 1.0 - 0.6 * warmth) } else { (1.0 + 0.4 * warmth, 1.0) };
    [red, 1.0 - 0.22 * warmth.abs(), blue].map(Pcg64::tidy)
}

/// Where a lamp stands: azimuth and elevation in degrees, metres from the object.
#[derive(Clone, Copy)]
struct Stand {
    azimuth: f32,
    elevation: f32,
    distance: f32,
}

impl Stand {
    fn new(azimuth: f32, elevation: f32, distance: f32) -> Self {
        Self { azimuth, elevation, distance }
    }

    fn near(rng: &mut Pcg64, azimuth: f32, elevation: f32) -> Self {
        let turn = rng.between(-12.0, 12.0);
        Self::new(azimuth + turn, elevation + rng.between(-8.0, 8.0), rng.between(1.8, 3.5))
    }

    /// As [`Self::near`], at any elevation between two.
    fn within(rng: &mut Pcg64, azimuth: f32, elevation: [f32; 2]) -> Self {
        let elevation = rng.between(elevation[0], elevation[1]);
        Self::near(rng, azimuth, elevation)
    }

    /// A lamp whose middle brings `irradiance` to a surface that faces it.
    fn lamp(self, size: [f32; 2], irradiance: f32, color: [f32; 3]) -> Lamp {
        let (azimuth, elevation) = (f64::from(self.azimuth).to_radians(), f64::from(self.elevation).to_radians());
        let distance = f64::from(self.distance);
        let across = distance * elevation.cos();
        let position =
            [across * azimuth.sin(), distance * elevation.sin(), -across * azimuth.cos()].map(|v| Pcg64::tidy(v as f32));
        let size = size.map(|s| Pcg64::tidy(s.clamp(0.02, 20.0)));
        let power = Pcg64::tidy((irradiance * self.distance * self.distance / (size[0] * size[1])).clamp(0.01, 9e4));
        Lamp { position, size, roll: 0.0, shape: LampShape::Rectangle, color, power, softness: 0.2, mask: None }
    }
}

fn round(lamp: Lamp) -> Lamp {
    Lamp { shape: LampShape::Ellipse, softness: 0.1, ..lamp }
}

fn rig(rng: &mut Pcg64, lamps: Vec<Lamp>, darkest: f32, brightest: f32) -> Sky {
    let dim = rng.log(darkest.max(0.016), brightest);
    let backdrop = rng.chance(0.5).then(|| {
        // Paper or a wall that the lamps light a little, brighter below or above.
        let (base, rise) = (dim * rng.log(0.5, 8.0), dim * rng.log(0.5, 8.0));
        Backdrop {
            azimuth: degrees(rng),
            width: rng.between(50.0, 220.0),
            top: rng.between(20.0, 80.0),
            bottom: if rng.chance(0.5) { -90.0 } else { rng.between(-35.0, -8.0) },
            base: tint(rng, base, 0.1),
            rise: tint(rng, rise, 0.1),
        }
    });
    Sky::Studio { lamps, fill: tint(rng, dim, 0.06), floor: tint(rng, 0.7 * dim, 0.06), backdrop }
}

/// A key light's irradiance: dim to glaring.
fn key(rng: &mut Pcg64) -> f32 {
    rng.log(0.6, 8.0)
}

pub(super) fn three_point(rng: &mut Pcg64) -> Sky {
    let turn = degrees(rng);
    let (level, side) = (key(rng), if rng.chance(0.5) { 1.0 } else { -1.0 });
    let lamps = [(45.0, 40.0, 1.0), (-55.0, 18.0, rng.log(0.1, 0.6)), (165.0, 48.0, rng.log(0.4, 2.0))]
        .into_iter()
        .map(|(azimuth, elevation, share)| {
            let color = lamp_color(rng);
            let size = [rng.log(0.5, 1.8), rng.log(0.5, 1.8)];
            let lamp = Stand::near(rng, turn + side * azimuth, elevation).lamp(size, level * share, color);
            Lamp { softness: rng.between(0.0, 0.5), ..lamp }
        })
        .collect();
    rig(rng, lamps, 0.01, 0.12)
}

pub(super) fn clamshell(rng: &mut Pcg64) -> Sky {
    let (turn, level, color) = (degrees(rng), key(rng), lamp_color(rng));
    let lamps = vec![
        Stand::near(rng, turn, 42.0).lamp([rng.log(0.8, 2.2), rng.log(0.6, 1.6)], level, color),
        Stand::near(rng, turn, -32.0).lamp([rng.log(0.8, 2.2), rng.log(0.4, 1.2)], level * rng.log(0.2, 0.8), color),
    ];
    rig(rng, lamps, 0.015, 0.2)
}

pub(super) fn rim_pair(rng: &mut Pcg64) -> Sky {
    let (turn, spread) = (degrees(rng), rng.between(25.0, 65.0));
    let mut lamps: Vec<Lamp> = [1.0f32, -1.0]
        .into_iter()
        .map(|side| {
            let (level, color) = (key(rng), lamp_color(rng));
            let size = [rng.log(0.12, 0.5), rng.log(1.0, 2.6)];
            Stand::near(rng, turn + 180.0 + side * spread, 12.0).lamp(size, level, color)
        })
        .collect();
    lamps.push(Stand::near(rng, turn, 30.0).lamp([1.2, 1.2], rng.log(0.05, 0.5), [1.0; 3]));
    rig(rng, lamps, 0.008, 0.06)
}

pub(super) fn ring_light(rng: &mut Pcg64) -> Sky {
    let (turn, level, color) = (degrees(rng), key(rng), lamp_color(rng));
    let lamp = Stand::within(rng, turn, [-5.0, 45.0]).lamp([rng.log(0.5, 2.5); 2], level, color);
    let lamp = Lamp { softness: 0.0, mask: Some(Mask::Ring { inner: rng.between(0.5, 0.9) }), ..round(lamp) };
    rig(rng, vec![lamp], 0.01, 0.15)
}

pub(super) fn overhead_softbox(rng: &mut Pcg64) -> Sky {
    let (level, color) = (key(rng), lamp_color(rng));
    let stand = Stand::new(degrees(rng), rng.between(72.0, 90.0), rng.between(1.6, 3.2));
    let lamp = stand.lamp([rng.log(1.0, 3.5), rng.log(1.0, 3.5)], level, color);
    let lamp = Lamp { roll: rng.between(0.0, 90.0), softness: rng.between(0.05, 0.6), ..lamp };
    rig(rng, vec![lamp], 0.02, 0.25)
}

pub(super) fn strip_walls(rng: &mut Pcg64) -> Sky {
    let (turn, count, level) = (degrees(rng), 2 + rng.below(7), key(rng));
    let color = lamp_color(rng);
    let (wide, tall) = (rng.log(0.1, 0.45), rng.between(1.6, 3.2));
    let lamps = (0..count)
        .map(|k| {
            let azimuth = turn + 360.0 * k as f32 / count as f32 + rng.between(-10.0, 10.0);
            Stand::new(azimuth, rng.between(0.0, 20.0), rng.between(1.8, 3.0)).lamp(
                [wide, tall],
                level * rng.log(0.3, 1.0),
                color,
            )
        })
        .collect();
    rig(rng, lamps, 0.01, 0.12)
}

/// White cloth all around, brighter where lamps stand behind it.
pub(super) fn light_tent(rng: &mut Pcg64) -> Sky {
    let (turn, level) = (degrees(rng), rng.log(0.3, 2.0));
    let mut lamps: Vec<Lamp> = (0..2 + rng.below(2))
        .map(|k| {
            let stand = Stand::near(rng, turn + 110.0 * k as f32, 25.0);
            let lamp = stand.lamp([rng.between(1.5, 2.8), rng.between(1.5, 2.8)], level * rng.log(0.5, 3.0), [1.0; 3]);
            Lamp { softness: 1.0, ..round(lamp) }
        })
        .collect();
    lamps.push(Lamp { softness: 1.0, ..Stand::new(turn, 88.0, 1.6).lamp([2.4, 2.4], level * rng.log(0.5, 2.0), [1.0; 3]) });
    let cloth = tint(rng, level, 0.06);
    Sky::Studio { lamps, fill: cloth, floor: cloth.map(|v| Pcg64::tidy(v * 0.85)), backdrop: None }
}

/// A product on a paper sweep.
pub(super) fn turntable_sweep(rng: &mut Pcg64) -> Sky {
    let (turn, level) = (degrees(rng), key(rng));
    let paper = if rng.chance(0.5) { [1.0; 3] } else { Pcg64::hsv(degrees(rng), rng.between(0.2, 0.85), 1.0) };
    let bright = rng.log(0.1, 1.5);
    let rise = bright * rng.log(0.1, 1.0);
    let backdrop = Backdrop {
        azimuth: Pcg64::tidy(turn + 180.0),
        width: rng.between(80.0, 200.0),
        top: rng.between(25.0, 75.0),
        bottom: -90.0,
        base: paper.map(|v| Pcg64::tidy(v * bright)),
        rise: paper.map(|v| Pcg64::tidy(v * rise)),
    };
    let lamps = vec![
        Stand::near(rng, turn + 60.0, 35.0).lamp([rng.log(0.6, 1.8); 2], level, [1.0; 3]),
        Stand::near(rng, turn - 70.0, 25.0).lamp([rng.log(0.6, 1.8); 2], level * rng.log(0.1, 0.8), lamp_color(rng)),
    ];
    let dim = rng.log(0.02, 0.12);
    Sky::Studio { lamps, fill: tint(rng, dim, 0.1), floor: tint(rng, 0.6 * dim, 0.1), backdrop: Some(backdrop) }
}

pub(super) fn beauty_dish(rng: &mut Pcg64) -> Sky {
    let (turn, level, color) = (degrees(rng), key(rng), lamp_color(rng));
    let dish = round(Stand::near(rng, turn, 48.0).lamp([rng.log(0.35, 0.8); 2], level, color));
    let dish = Lamp { mask: rng.chance(0.6).then(|| Mask::Ring { inner: rng.between(0.1, 0.35) }), ..dish };
    let reflector = Stand::near(rng, turn + 120.0, 5.0).lamp([1.4, 1.8], level * rng.log(0.03, 0.25), [1.0; 3]);
    rig(rng, vec![dish, reflector], 0.008, 0.08)
}

/// A spot through a gobo of leaves.
pub(super) fn leaf_gobo(rng: &mut Pcg64) -> Sky {
    let (turn, level, color) = (degrees(rng), key(rng), lamp_color(rng));
    let lamp = Stand::near(rng, turn, 40.0).lamp([rng.log(0.8, 2.6), rng.log(0.8, 2.6)], level, color);
    let mask = Mask::Leaves { open: rng.between(0.25, 0.65), seed: which(rng) };
    rig(rng, vec![Lamp { softness: 0.1, mask: Some(mask), power: Pcg64::tidy(2.0 * lamp.power), ..round(lamp) }], 0.01, 0.08)
}

pub(super) fn blinds(rng: &mut Pcg64) -> Sky {
    let (turn, level, color) = (degrees(rng), key(rng), lamp_color(rng));
    let lamp = Stand::within(rng, turn, [8.0, 40.0]).lamp([rng.between(1.2, 2.6), rng.between(1.2, 2.6)], level, color);
    let mask = Mask::Slats { count: 4 + rng.below(11), open: rng.between(0.2, 0.7) };
    let window =
        Lamp { softness: 0.0, power: Pcg64::tidy(2.0 * lamp.power), roll: rng.between(-6.0, 6.0), mask: Some(mask), ..lamp };
    rig(rng, vec![window], 0.01, 0.1)
}

pub(super) fn led_grid(rng: &mut Pcg64) -> Sky {
    let turn = degrees(rng);
    let lamps = (0..1 + rng.below(3))
        .map(|k| {
            let (level, color) = (key(rng), lamp_color(rng));
            let stand = Stand::within(rng, turn + 100.0 * k as f32, [15.0, 75.0]);
            let lamp = stand.lamp([rng.between(0.8, 2.4), rng.between(0.8, 2.4)], level, color);
            let mask = Mask::Cells { cells: [3 + rng.below(10), 3 + rng.below(10)], open: rng.between(0.3, 0.8) };
            Lamp { softness: 0.0, roll: rng.between(0.0, 90.0), mask: Some(mask), ..lamp }
        })
        .collect();
    rig(rng, lamps, 0.01, 0.1)
}

pub(super) fn gel_pair(rng: &mut Pcg64) -> Sky {
    let (turn, hue) = (degrees(rng), degrees(rng));
    let other = hue + rng.between(90.0, 270.0);
    let lamps = [(hue, 70.0f32), (other, -80.0)]
        .into_iter()
        .map(|(hue, azimuth)| {
            let color = Pcg64::hsv(hue, rng.between(0.7, 1.0), 1.0);
            let level = key(rng);
            let stand = Stand::within(rng, turn + azimuth, [5.0, 45.0]);
            stand.lamp([rng.log(0.3, 1.8), rng.log(0.3, 1.8)], level, color)
        })
        .collect();
    rig(rng, lamps, 0.01, 0.06)
}

/// Many small lamps over a dome.
pub(super) fn dome_array(rng: &mut Pcg64) -> Sky {
    let count = 16 + rng.below(32);
    let (level, size, color) = (key(rng), rng.log(0.12, 0.45), lamp_color(rng));
    let turn = degrees(rng);
    let falloff = rng.between(0.0, 0.9);
    let lamps = (0..count)
        .map(|k| {
            // A spiral of equal solid angles over the upper half.
            let y = 0.05 + 0.93 * (k as f32 + 0.5) / count as f32;
            let azimuth = turn + 137.507_76 * k as f32;
            let share = 1.0 - falloff * (0.5 + 0.5 * (azimuth - turn).to_radians().cos());
            round(Stand::new(azimuth, y.asin().to_degrees(), 2.5).lamp(
                [size; 2],
                level * share.max(0.02) / count as f32 * 2.0,
                color,
            ))
        })
        .collect();
    rig(rng, lamps, 0.01, 0.12)
}

pub(super) fn tube_lights(rng: &mut Pcg64) -> Sky {
    let count = 3 + rng.below(8);
    let (turn, saturated) = (degrees(rng), rng.chance(0.5));
    let lamps = (0..count)
        .map(|_| {
            let color = if saturated { Pcg64::hsv(degrees(rng), rng.between(0.5, 1.0), 1.0) } else { lamp_color(rng) };
            let stand = Stand::new(turn + degrees(rng), rng.between(-10.0, 80.0), rng.between(1.5, 3.0));
            let lamp = stand.lamp([rng.log(0.03, 0.08), rng.between(0.8, 2.4)], rng.log(0.1, 3.0), color);
            Lamp { roll: rng.between(0.0, 180.0), softness: 0.0, ..lamp }
        })
        .collect();
    rig(rng, lamps, 0.008, 0.06)
}

/// One small glaring lamp in the dark.
pub(super) fn hard_spot(rng: &mut Pcg64) -> Sky {
    let (turn, level, color) = (degrees(rng), rng.log(1.0, 12.0), lamp_color(rng));
    let lamp = round(Stand::within(rng, turn, [15.0, 70.0]).lamp([rng.log(0.06, 0.25); 2], level, color));
    rig(rng, vec![lamp], 0.01, 0.06)
}

/// Rows of coloured lamps over a stage.
pub(super) fn stage(rng: &mut Pcg64) -> Sky {
    let (turn, hue) = (degrees(rng), degrees(rng));
    let mut lamps: Vec<Lamp> = (0..6 + rng.below(10))
        .map(|k| {
            let row = (k % 2) as f32;
            let color = Pcg64::hsv(hue + [0.0, 40.0, 180.0, 220.0][rng.below(4) as usize], rng.between(0.3, 1.0), 1.0);
            let stand = Stand::new(turn + rng.between(-80.0, 80.0) + 180.0 * row, rng.between(35.0, 70.0), rng.between(3.0, 6.0));
            round(stand.lamp([rng.log(0.15, 0.5); 2], rng.log(0.1, 3.0), color))
        })
        .collect();
    lamps.push(round(Stand::near(rng, turn, 25.0).lamp([0.5; 2], key(rng), [1.0, 0.93, 0.82])));
    rig(rng, lamps, 0.005, 0.05)
}
