//! Places the labels of a plot.

/// An upright rectangle: left, top, right, bottom.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch([f64; 4]);

impl Patch {
    /// By its centre and half its sides.
    pub fn around((x, y): (f64, f64), (w, h): (f64, f64)) -> Self {
        Self([x - w, y - h, x + w, y + h])
    }

    /// Its centre.
    pub fn center(&self) -> (f64, f64) {
        (0.5 * (self.0[0] + self.0[2]), 0.5 * (self.0[1] + self.0[3]))
    }

    /// Its point nearest to another.
    pub fn nearest(&self, (x, y): (f64, f64)) -> (f64, f64) {
        (x.clamp(self.0[0], self.0[2]), y.clamp(self.0[1], self.0[3]))
    }

    /// Distance to a point, 0 inside.
    pub fn distance(&self, at: (f64, f64)) -> f64 {
        let near = self.nearest(at);
        (near.0 - at.0).hypot(near.1 - at.1)
    }

    /// Area shared with another.
    fn overlap(&self, other: &Self) -> f64 {
        let side = |low: usize| (self.0[low + 2].min(other.0[low + 2]) - self.0[low].max(other.0[low])).max(0.0);
        side(0) * side(1)
    }

    fn area(&self) -> f64 {
        self.overlap(self)
    }
}

/// The parts of a plot that are taken already.
pub struct Taken {
    inside: Patch,
    boxes: Vec<Patch>,
}

impl Taken {
    /// An empty plot: left, top, right, bottom.
    pub fn new(inside: [f64; 4]) -> Self {
        Self { inside: Patch(inside), boxes: Vec::new() }
    }

    /// Keeps labels away from a rectangle.
    pub fn add(&mut self, taken: Patch) {
        self.boxes.push(taken);
    }

    /// Keeps labels away from a line, by small rectangles along it.
    pub fn segment(&mut self, from: (f64, f64), to: (f64, f64)) {
        let steps = ((to.0 - from.0).hypot(to.1 - from.1) / 8.0).ceil().clamp(1.0, 500.0) as usize;
        for step in 0..=steps {
            let t = step as f64 / steps as f64;
            self.add(Patch::around((from.0 + t * (to.0 - from.0), from.1 + t * (to.1 - from.1)), (2.0, 2.0)));
        }
    }

    /// Finds and takes the best place for a label near a point: the place that covers least, and of several such places the
    /// nearest.
    pub fn place(&mut self, at: (f64, f64), (width, height): (f64, f64)) -> Patch {
        let half = (0.5 * width + 2.0, 0.5 * height + 1.0);
        let mut best = (f64::INFINITY, Patch::around(at, half));
        for ring in 0..7 {
            for turn in 0..16 {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(turn) / 16.0).sin_cos();
                let gap = 6.0 + 11.0 * f64::from(ring);
                // On the ray from the point outwards, a side or a corner of the label touches the ring.
                let center = (at.0 + cos * gap + cos.signum() * half.0 * (cos.abs() * 2.0).min(1.0), at.1 + sin * (gap + half.1));
                let spot = Patch::around(center, half);
                let outside = spot.area() - spot.overlap(&self.inside);
                let covered: f64 = self.boxes.iter().map(|taken| spot.overlap(taken)).sum();
                let cost = 50.0 * outside + 10.0 * covered + spot.distance(at) + 0.01 * f64::from(turn);
                if cost < best.0 {
                    best = (cost, spot);
                }
            }
        }
        self.add(best.1);
        best.1
    }
}

/// Moves rising values apart to `gap`, as little as possible, and within `low` to `high` while there is room.
pub fn spread(values: &[f64], gap: f64, low: f64, high: f64) -> Vec<f64> {
    // Runs of labels that touch: (the mean of the values that their members ask for, number of members).
    let mut runs: Vec<(f64, usize)> = Vec::new();
    for value in values {
        runs.push((*value, 1));
        while let [.., (a, n), (b, m)] = runs[..] {
            if b - a >= gap * 0.5 * (n + m) as f64 {
                break;
            }
            runs.truncate(runs.len() - 2);
            runs.push(((a * n as f64 + b * m as f64) / (n + m) as f64, n + m));
        }
    }
    let mut spots: Vec<f64> = Vec::with_capacity(values.len());
    for (center, count) in runs {
        spots.extend((0..count).map(|i| center + gap * (i as f64 - 0.5 * (count - 1) as f64)));
    }
    let mut floor = low;
    for spot in &mut spots {
        *spot = spot.max(floor);
        floor = *spot + gap;
    }
    let mut ceiling = high;
    for spot in spots.iter_mut().rev() {
        *spot = spot.min(ceiling);
        ceiling = *spot - gap;
    }
    spots
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_do_not_cover_one_another() {
        let mut taken = Taken::new([0.0, 0.0, 300.0, 200.0]);
        let points = [(150.0, 100.0), (152.0, 101.0), (155.0, 99.0), (298.0, 2.0), (1.0, 199.0)];
        points.iter().for_each(|at| taken.add(Patch::around(*at, (4.0, 4.0))));
        let spots = points.map(|at| taken.place(at, (60.0, 12.0)));
        for (i, a) in spots.iter().enumerate() {
            assert_eq!(a.overlap(&taken.inside), a.area(), "{i} leaves the plot");
            assert!(spots[..i].iter().all(|b| a.overlap(b) == 0.0), "{i} covers another");
        }
    }

    #[test]
    fn names_are_pushed_apart_no_further_than_needed() {
        assert_eq!(spread(&[10.0, 50.0], 14.0, 0.0, 100.0), [10.0, 50.0]);
        assert_eq!(spread(&[50.0, 50.0, 50.0], 10.0, 0.0, 100.0), [40.0, 50.0, 60.0]);
        assert_eq!(spread(&[1.0, 2.0], 10.0, 0.0, 100.0), [0.0, 10.0]);
        assert_eq!(spread(&[99.0, 100.0], 10.0, 0.0, 100.0), [90.0, 100.0]);
        assert_eq!(spread(&[], 10.0, 0.0, 100.0), [0.0; 0]);
    }
}
