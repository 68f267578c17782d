//! Ranges of parameters.

use super::Shape;

impl Shape {
    /// Parameters out of their documented range: (JSON pointer below the shape, message such as `-1 is outside 0..=1`).
    pub fn validate(&self) -> Vec<(String, String)> {
        let mut faults = Faults::default();
        match self {
            Self::Plane { size } => faults.range("size", *size, 0.01, 1e4),
            Self::Disc { radius } => faults.range("radius", *radius, 0.01, 1e4),
            Self::Box { size, bevel } => {
                faults.ranges("size", size, 0.01, 1e4);
                faults.range("bevel", *bevel, 0.0, 0.5 * size.iter().copied().fold(f32::INFINITY, f32::min));
            }
            Self::Sphere { radius } => faults.range("radius", *radius, 0.01, 1e3),
            Self::Cylinder { radius, height, bevel } => {
                faults.range("radius", *radius, 0.01, 1e3);
                faults.range("height", *height, 0.01, 1e3);
                faults.range("bevel", *bevel, 0.0, radius.min(0.5 * height));
            }
            Self::Cone { radius, top_radius, height } => {
                faults.range("radius", *radius, 0.01, 1e3);
                faults.range("top_radius", *top_radius, 0.0, 1e3);
                faults.range("height", *height, 0.01, 1e3);
            }
            Self::Capsule { radius, height } => {
                faults.range("radius", *radius, 0.01, 500.0);
                faults.range("height", *height, 2.0 * radius, 1e3);
            }
            Self::Torus { radius, tube } => {
                faults.range("radius", *radius, 0.01, 1e3);
                faults.range("tube", *tube, 0.005, 0.95 * radius);
            }
            Self::TorusKnot { p, q, radius, tube } => {
                faults.range("p", *p as f32, 1.0, 7.0);
                faults.range("q", *q as f32, 1.0, 7.0);
                if greatest_common_divisor(*p, *q) > 1 {
                    faults.0.push(("/q".into(), format!("{q} shares a factor with p = {p}: the curve would be walked twice")));
                }
                faults.range("radius", *radius, 0.05, 100.0);
                faults.range("tube", *tube, 0.005, 0.3 * radius);
            }
            Self::Superellipsoid { size, vertical, horizontal } => {
                faults.ranges("size", size, 0.01, 1e3);
                faults.range("vertical", *vertical, 0.2, 2.5);
                faults.range("horizontal", *horizontal, 0.2, 2.5);
            }
            Self::Lathe { radii, height, wall } => {
                if !(2..=16).contains(&radii.len()) {
                    faults.0.push(("/radii".into(), format!("{} radii, outside 2..=16", radii.len())));
                }
                faults.ranges("radii", radii, 0.01, 100.0);
                faults.range("height", *height, 0.05, 100.0);
                let smallest = radii.iter().copied().fold(100.0, f32::min);
                faults.range("wall", *wall, 0.0, 0.5 * smallest.min(*height));
            }
            Self::Pipe { radius, inner_radius, height } => {
                faults.range("radius", *radius, 0.01, 1e3);
                faults.range("inner_radius", *inner_radius, 0.05 * radius, 0.95 * radius);
                faults.range("height", *height, 0.01, 1e3);
            }
            Self::Prism { sides, radius, height, star, twist, taper } => {
                faults.range("sides", *sides as f32, 3.0, 24.0);
                faults.range("radius", *radius, 0.01, 1e3);
                faults.range("height", *height, 0.01, 1e3);
                faults.range("star", star.unwrap_or(1.0), 0.2, 1.0);
                faults.range("twist", *twist, -360.0, 360.0);
                faults.range("taper", *taper, 0.1, 1.5);
            }
            Self::Gear { teeth, radius, depth, hole, height } => {
                faults.range("teeth", *teeth as f32, 5.0, 48.0);
                faults.range("radius", *radius, 0.05, 100.0);
                faults.range("depth", *depth, 0.03, 0.4);
                faults.range("hole", *hole, 0.05, (0.95 - depth).min(0.5));
                faults.range("height", *height, 0.01, 100.0);
            }
            Self::Spring { radius, tube, turns, height } => {
                faults.range("radius", *radius, 0.05, 100.0);
                faults.range("tube", *tube, 0.005, 0.6 * radius);
                faults.range("turns", *turns, 0.5, 12.0);
                faults.range("height", *height, 0.05, 100.0);
            }
            Self::Rock { radius, roughness, frequency, .. } => {
                faults.range("radius", *radius, 0.01, 1e3);
                faults.range("roughness", *roughness, 0.0, 0.6);
                faults.range("frequency", *frequency, 0.3, 6.0);
            }
            Self::Arch { width, height, depth, thickness } => {
                faults.range("width", *width, 0.05, 100.0);
                faults.range("height", *height, 0.5 * width, 100.0);
                faults.range("depth", *depth, 0.01, 100.0);
                faults.range("thickness", *thickness, 0.01, 0.45 * width);
            }
            Self::Stairs { steps, size } => {
                faults.range("steps", *steps as f32, 2.0, 24.0);
                faults.ranges("size", size, 0.05, 100.0);
            }
            Self::Supershape { lobes, vertical_lobes, n, k, size } => {
                faults.range("lobes", *lobes as f32, 0.0, 16.0);
                faults.range("vertical_lobes", *vertical_lobes as f32, 0.0, 16.0);
                faults.range("n", *n, 0.3, 20.0);
                faults.range("k", *k, 0.3, 20.0);
                faults.range("size", *size, 0.01, 1e3);
            }
            other => {
                if let Some(model) = other.model() {
                    model.check(&mut faults);
                }
            }
        }
        faults.0
    }
}

fn greatest_common_divisor(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

/// Collects (pointer, message) pairs of values outside their range.
#[derive(Default)]
pub(crate) struct Faults(pub Vec<(String, String)>);

impl Faults {
    /// Notes `value` when it is not in `low..=high` (NaN included).
    pub fn range(&mut self, field: &str, value: f32, low: f32, high: f32) {
        if !(low..=high).contains(&value) {
            self.0.push((format!("/{field}"), format!("{value} is outside {low}..={high}")));
        }
    }

    /// Notes a list that is empty or longer than `most`.
    pub fn count(&mut self, field: &str, length: usize, most: usize) {
        if !(1..=most).contains(&length) {
            self.0.push((format!("/{field}"), format!("{length} entries, outside 1..={most}")));
        }
    }

    /// As [`Self::range`] for each element.
    pub fn ranges(&mut self, field: &str, values: &[f32], low: f32, high: f32) {
        for (index, &value) in values.iter().enumerate() {
            self.range(&format!("{field}/{index}"), value, low, high);
        }
    }
}
