//! Periodic noise, cells and marks on the unit square, in plain double-precision arithmetic: the same numbers on every machine.

use glam::DVec2;

/// A well-mixed number of a lattice point.
pub(super) fn hash(x: u32, y: u32, seed: u32) -> u32 {
    let mut h = seed ^ 0x9e37_79b9;
    for c in [x, y] {
        h = (h ^ c).wrapping_mul(0x85eb_ca6b);
        h ^= h >> 13;
        h = h.wrapping_mul(0xc2b2_ae35);
        h ^= h >> 16;
    }
    h
}

/// [`hash`] as a number in 0..1.
pub(super) fn chance(x: u32, y: u32, seed: u32) -> f64 {
    f64::from(hash(x, y, seed)) / 4_294_967_296.0
}

/// Largest whole number not above `x`. (`f64::floor` is a call on processors without an instruction for it.)
pub(super) fn floor(x: f64) -> i64 {
    let whole = x as i64;
    whole - i64::from(x < whole as f64)
}

/// The part of `x` after the point, 0..1.
pub(super) fn fraction(x: f64) -> f64 {
    x - floor(x) as f64
}

/// `x` modulo a period of whole numbers.
pub(super) fn wrap(x: i64, period: u32) -> u32 {
    // Nearly every place is inside already or one period off, and a division takes as long as ten additions.
    let n = i64::from(period);
    if (0..n).contains(&x) {
        x as u32
    } else if (-n..0).contains(&x) {
        (x + n) as u32
    } else {
        x.rem_euclid(n) as u32
    }
}

/// Linear from `a` at 0 to `b` at 1.
pub(super) fn mix(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}

/// [`mix`] by channel.
pub(super) fn blend(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    std::array::from_fn(|c| mix(a[c], b[c], t))
}

/// A colour times a gain.
pub(super) fn gain(color: [f64; 3], by: f64) -> [f64; 3] {
    color.map(|v| v * by)
}

/// 0 below `low`, 1 above `high`, smooth between; a step where they are equal.
pub(super) fn smooth(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low).max(1e-12)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// sin(2 pi x) by its series to the 13th power, within 1e-9: the library's sine differs between machines.
pub(super) fn wave(x: f64) -> f64 {
    let t = fraction(x + 0.5) - 0.5;
    let t = if t > 0.25 {
        0.5 - t
    } else if t < -0.25 {
        -0.5 - t
    } else {
        t
    };
    let a = std::f64::consts::TAU * t;
    let q = a * a;
    let inner = 1.0 - q / 72.0 * (1.0 - q / 110.0 * (1.0 - q / 156.0));
    a * (1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0 * inner)))
}

/// Distance of `x` from the nearest whole number.
pub(super) fn to_whole(x: f64) -> f64 {
    let f = fraction(x);
    f.min(1.0 - f)
}

/// Standard deviation of every noise.
const DEVIATION: f64 = 0.35;

/// Values at the middles of `n` by `n` texels of a pattern that repeats.
pub(super) struct Grid {
    n: usize,
    values: Vec<f64>,
}

impl Grid {
    /// Fractal gradient noise (Perlin 2002) with `cells` lattice cells along u and v and `octaves` octaves of half the size and
    /// height; of mean 0 and a standard deviation of 0.35, about -1..=1. Octaves finer than two texels a cell are left out.
    pub fn noise(n: usize, cells: [u32; 2], octaves: u32, seed: u32) -> Self {
        let mut values = vec![0.0; n * n];
        let mut weight = 1.0;
        for octave in 0..octaves {
            let cells = cells.map(|c| c << octave);
            if octave > 0 && 2 * cells[0].max(cells[1]) as usize > n {
                break;
            }
            add_noise(&mut values, n, cells, weight, seed.wrapping_add(octave.wrapping_mul(0x9e37)));
            weight *= 0.5;
        }
        // A few large cells may lie all above zero or all near it: thresholds would cut none or all of them.
        let area = values.len() as f64;
        let mean = values.iter().sum::<f64>() / area;
        let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / area;
        let scale = DEVIATION / variance.sqrt().max(1e-9);
        values.iter_mut().for_each(|v| *v = (*v - mean) * scale);
        Self { n, values }
    }

    /// Straight marks on zero ground: `count` lines of at most `length`, thinner than `width` (both in widths of the texture) and
    /// of heights up to 1; the direction is along u where `spread` is 0, any where it is 1.
    pub fn scratches(n: usize, count: u32, length: f64, width: f64, spread: f64, seed: u32) -> Self {
        let mut values = vec![0.0_f64; n * n];
        for k in 0..count {
            let draw = |i: u32| chance(k, i, seed);
            let start = DVec2::new(draw(0), draw(1));
            let turn = 0.5 * spread * (draw(2) - 0.5);
            let along = DVec2::new(wave(turn + 0.25), wave(turn));
            let (length, depth) = (length * mix(0.1, 1.0, draw(3) * draw(3)), mix(0.2, 1.0, draw(4) * draw(4)));
            // Nothing is thinner than a texel: it would come and go along the line.
            let half = (0.5 * width * mix(0.3, 1.0, draw(5))).max(0.7 / n as f64);
            let bend = 0.06 * length * (draw(6) - 0.5);
            let steps = (2.0 * length * n as f64) as u32 + 1;
            let reach = (half * n as f64) as i64 + 1;
            for step in 0..=steps {
                let t = f64::from(step) / f64::from(steps);
                // Thin at both ends, slightly bent.
                let p = (start + along * (t * length) + along.perp() * (bend * 4.0 * t * (1.0 - t))) * n as f64;
                let height = depth * smooth(0.0, 0.15, t.min(1.0 - t));
                let (x, y) = (floor(p.x), floor(p.y));
                for (j, i) in (y - reach..=y + reach).flat_map(|j| (x - reach..=x + reach).map(move |i| (j, i))) {
                    let distance = (DVec2::new(i as f64, j as f64) + 0.5 - p).length() / n as f64;
                    let value = height * (1.0 - smooth(0.0, half + 0.5 / n as f64, distance));
                    let spot = &mut values[wrap(j, n as u32) as usize * n + wrap(i, n as u32) as usize];
                    *spot = spot.max(value);
                }
            }
        }
        Self { n, values }
    }

    /// Value of a texel.
    pub fn texel(&self, x: usize, y: usize) -> f64 {
        self.values[y * self.n + x]
    }

    /// Bilinear value; any coordinates.
    pub fn at(&self, u: f64, v: f64) -> f64 {
        let (x, y) = (u * self.n as f64 - 0.5, v * self.n as f64 - 0.5);
        let (i, j) = (floor(x), floor(y));
        let (fx, fy) = (x - i as f64, y - j as f64);
        let place = |k: i64| wrap(k, self.n as u32) as usize;
        let (i0, i1) = (place(i), place(i + 1));
        let (above, below) = (place(j) * self.n, place(j + 1) * self.n);
        let row = |from: usize| mix(self.values[from + i0], self.values[from + i1], fx);
        mix(row(above), row(below), fy)
    }
}

/// One octave. On a row, what a lattice column gives is linear in the distance from it: two numbers a column, six operations a
/// texel.
fn add_noise(values: &mut [f64], n: usize, cells: [u32; 2], weight: f64, seed: u32) {
    let [columns, rows] = cells.map(|c| c.max(1));
    let gradient = |x: u32, y: u32| {
        let h = hash(x, y, seed);
        let part = |bits: u32| f64::from(bits & 0xffff) / 32767.5 - 1.0;
        DVec2::new(part(h), part(h >> 16)).try_normalize().unwrap_or(DVec2::X)
    };
    let lattice: Vec<DVec2> = (0..rows).flat_map(|y| (0..columns).map(move |x| gradient(x, y))).collect();
    let fade = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let places: Vec<(usize, f64, f64)> = (0..n)
        .map(|x| {
            let p = (x as f64 + 0.5) / n as f64 * f64::from(columns);
            let f = fraction(p);
            (floor(p) as usize, f, fade(f))
        })
        .collect();
    let mut lines = vec![(0.0, 0.0); columns as usize + 1];
    for (y, row) in values.chunks_exact_mut(n).enumerate() {
        let p = (y as f64 + 0.5) / n as f64 * f64::from(rows);
        let (j, f) = (floor(p) as u32, fraction(p));
        let t = fade(f);
        let line = |j: u32| &lattice[(j % rows * columns) as usize..][..columns as usize];
        for (i, (above, below)) in line(j).iter().zip(line(j + 1)).enumerate() {
            lines[i] = (mix(above.x, below.x, t), mix(above.y * f, below.y * (f - 1.0), t));
        }
        lines[columns as usize] = lines[0];
        for (value, &(i, f, t)) in row.iter_mut().zip(&places) {
            let ((a, b), (c, d)) = (lines[i], lines[i + 1]);
            *value += weight * mix(a * f + b, c * (f - 1.0) + d, t);
        }
    }
}

/// Scattered points, one to a lattice cell, and the cells of what is nearest to each (Worley 1996).
pub(super) struct Cells {
    count: [u32; 2],
    points: Vec<DVec2>,
}

/// A place among [`Cells`]. Lengths are in lattice cells.
#[derive(Clone, Copy)]
pub(super) struct Cell {
    /// Which cell: a well-mixed number.
    pub id: u32,
    /// Vector from the nearest point.
    pub from: DVec2,
    /// Distance from the nearest point.
    pub near: f64,
    /// Distance from the border to the second nearest point's cell.
    pub edge: f64,
}

impl Cell {
    /// A number in 0..1 that belongs to the cell.
    pub fn draw(&self, which: u32) -> f64 {
        chance(self.id, which, 0x51ed)
    }
}

impl Cells {
    /// `count` cells along u and v, points up to `jitter` (0..=0.8) of half a cell off the middle.
    pub fn new(count: [u32; 2], jitter: f64, seed: u32) -> Self {
        let count = count.map(|c| c.max(1));
        let point = |x: u32, y: u32| {
            let off = DVec2::new(chance(x, y, seed), chance(x, y, seed ^ 0xabcd_1234)) - 0.5;
            0.5 + off * jitter
        };
        let points = (0..count[1]).flat_map(|y| (0..count[0]).map(move |x| point(x, y))).collect();
        Self { count, points }
    }

    /// The cell at a place; any coordinates.
    pub fn at(&self, u: f64, v: f64) -> Cell {
        let p = DVec2::new(u * f64::from(self.count[0]), v * f64::from(self.count[1]));
        let (i, j) = (floor(p.x), floor(p.y));
        let f = p - DVec2::new(i as f64, j as f64);
        let columns = [-1, 0, 1].map(|dx| wrap(i + dx, self.count[0]));
        let (mut first, mut second) = ((f64::INFINITY, DVec2::ZERO, 0), (f64::INFINITY, DVec2::ZERO));
        for dy in -1..=1_i64 {
            let row = wrap(j + dy, self.count[1]) * self.count[0];
            for (k, column) in columns.into_iter().enumerate() {
                let index = row + column;
                let to = self.points[index as usize] + DVec2::new(k as f64 - 1.0, dy as f64) - f;
                let distance = to.length_squared();
                if distance < first.0 {
                    second = (first.0, first.1);
                    first = (distance, to, index);
                } else if distance < second.0 {
                    second = (distance, to);
                }
            }
        }
        // The border is the bisector of the two nearest points.
        let edge = 0.5 * (second.0 - first.0) / (second.1 - first.1).length().max(1e-9);
        Cell { id: hash(first.2, 7, 0x77), from: -first.1, near: first.0.sqrt(), edge }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sine_is_a_sine() {
        for i in -4000..4000 {
            let x = f64::from(i) * 0.001_37;
            let expected = (std::f64::consts::TAU * x).sin();
            assert!((wave(x) - expected).abs() < 2e-9, "{x}: {} but {expected}", wave(x));
        }
    }

    #[test]
    fn noise_repeats_and_fills_its_range() {
        let grid = Grid::noise(128, [4, 8], 4, 3);
        let (low, high) = grid.values.iter().fold((0.0_f64, 0.0_f64), |(l, h), v| (l.min(*v), h.max(*v)));
        assert!(low > -1.5 && low < -0.7 && high < 1.5 && high > 0.7, "{low} .. {high}");
        for (u, v) in [(0.1, 0.7), (0.999, 0.001), (0.5, 0.0)] {
            assert!((grid.at(u, v) - grid.at(u + 1.0, v - 2.0)).abs() < 1e-9);
        }
        // At the lattice's own points gradient noise is 0.
        let mut single = Grid { n: 256, values: vec![0.0; 256 * 256] };
        add_noise(&mut single.values, 256, [4, 4], 1.0, 9);
        for k in 0..16 {
            let (u, v) = (f64::from(k % 4) / 4.0, f64::from(k / 4) / 4.0);
            assert!(single.at(u, v).abs() < 0.02, "{u}, {v}: {}", single.at(u, v));
        }
    }

    /// Against a search among all points and their images.
    #[test]
    fn the_nearest_cell_is_the_nearest() {
        let cells = Cells::new([5, 5], 0.8, 11);
        for k in 0..500_u32 {
            let (u, v) = (chance(k, 0, 1), chance(k, 1, 1));
            let mut all: Vec<f64> = (0..25)
                .flat_map(|i| (0..9).map(move |s| (i, s)))
                .map(|(i, s)| {
                    let p = cells.points[i] + DVec2::new((i % 5) as f64, (i / 5) as f64);
                    let shift = 5.0 * DVec2::new((s % 3) as f64 - 1.0, (s / 3) as f64 - 1.0);
                    (p + shift - 5.0 * DVec2::new(u, v)).length()
                })
                .collect();
            all.sort_by(f64::total_cmp);
            let found = cells.at(u, v);
            assert!((found.near - all[0]).abs() < 1e-12 && found.edge >= 0.0, "{} but {}", found.near, all[0]);
        }
    }
}
