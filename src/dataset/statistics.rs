//! Describes the pixels of a dataset by counts over fixed bins, which add up from frames to sequences to the whole.

use glam::Vec2;
use renderflow_frame::Frame;
use serde::{Deserialize, Serialize};

/// Bins of a quantity.
#[derive(Clone, Copy, Debug)]
pub struct Axis {
    /// What is counted, in words.
    pub title: &'static str,
    /// Lower end of the first bin, which also counts values below it.
    pub low: f32,
    /// Upper end of the last bin, which also counts values above it.
    pub high: f32,
    /// Number of bins.
    pub bins: usize,
    /// Whether bins have equal ratios instead of equal widths.
    pub log: bool,
    pick: fn(&mut Statistics) -> &mut Vec<u64>,
    view: fn(&Statistics) -> &Vec<u64>,
}

macro_rules! axes {
    ($($quantity:ident, $field:ident, $title:literal, $low:literal .. $high:literal, $bins:literal, $log:literal;)*) => {
        /// What is counted, in the order of [`AXES`].
        #[derive(Clone, Copy)]
        enum Quantity {
            $($quantity,)*
        }

        /// Every quantity that is counted.
        pub const AXES: &[Axis] = &[$(Axis {
            title: $title,
            low: $low,
            high: $high,
            bins: $bins,
            log: $log,
            pick: |s| &mut s.$field,
            view: |s| &s.$field,
        },)*];
    };
}

axes! {
    Coverage, coverage, "covered share of a frame", 0.0..1.0, 20, false;
    Depth, depth, "depth of a pixel, metres", 0.1..1000.0, 40, true;
    Luminance, luminance, "exposed luminance of a pixel (1 = white)", 0.0001..100.0, 48, true;
    Albedo, albedo, "luminance of the albedo", 0.0..1.0, 20, false;
    Roughness, roughness, "roughness", 0.0..1.0, 20, false;
    Metallic, metallic, "metallic", 0.0..1.0, 10, false;
    Facing, facing, "cosine between normal and view", 0.0..1.0, 20, false;
    Motion, motion, "motion to the next frame, pixels", 0.01..1000.0, 40, true;
}

/// Counts of every quantity in [`AXES`]: frames for the coverage, pixels for all else (covered ones but for the luminance).
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Statistics {
    coverage: Vec<u64>,
    depth: Vec<u64>,
    luminance: Vec<u64>,
    albedo: Vec<u64>,
    roughness: Vec<u64>,
    metallic: Vec<u64>,
    facing: Vec<u64>,
    motion: Vec<u64>,
}

impl Quantity {
    fn axis(self) -> &'static Axis {
        &AXES[self as usize]
    }
}

impl Axis {
    fn bin(&self, value: f32) -> usize {
        let share = if self.log {
            (value.max(f32::MIN_POSITIVE) / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        };
        // The cast turns negative numbers into 0.
        ((share * self.bins as f32) as usize).min(self.bins - 1)
    }

    /// Lower end of bin `i`. For the number after the last bin, the upper end of the last bin.
    pub fn edge(&self, i: usize) -> f64 {
        let (low, high, share) = (f64::from(self.low), f64::from(self.high), i as f64 / self.bins as f64);
        if self.log { low * (high / low).powf(share) } else { low + (high - low) * share }
    }

    /// The counts, one for each bin.
    pub fn counts(&self, statistics: &Statistics) -> Vec<u64> {
        let mut counts = (self.view)(statistics).clone();
        counts.resize(self.bins, 0);
        counts
    }
}

fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

impl Statistics {
    /// Counts one frame.
    pub fn add_frame(&mut self, frame: &Frame) {
        let pixels = frame.depth.pixels.len().max(1);
        // Single precision counts no further than 2^24. Smaller frames keep the sums that their records hold.
        let alpha = frame.alpha.pixels.iter();
        let covered = if pixels > 1 << 24 {
            (alpha.map(|&a| f64::from(a)).sum::<f64>() / pixels as f64) as f32
        } else {
            alpha.sum::<f32>() / pixels as f32
        };
        self.count(Quantity::Coverage, std::iter::once(covered));
        let hit = |i: &usize| frame.depth.pixels[*i].is_finite();
        let hits: Vec<usize> = (0..frame.depth.pixels.len()).filter(hit).collect();
        self.count(Quantity::Depth, hits.iter().map(|&i| frame.depth.pixels[i]));
        self.count(Quantity::Albedo, hits.iter().map(|&i| luminance(frame.albedo.pixels[i])));
        self.count(Quantity::Roughness, hits.iter().map(|&i| frame.material.pixels[i][0]));
        self.count(Quantity::Metallic, hits.iter().map(|&i| frame.material.pixels[i][1]));
        let cosine = |&i: &usize| {
            let pixel = Vec2::new((i % frame.width) as f32 + 0.5, (i / frame.width) as f32 + 0.5);
            -frame.info.camera.direction_cam(pixel).normalize().dot(frame.normal.pixels[i].into())
        };
        self.count(Quantity::Facing, hits.iter().map(cosine));
        if let Some(motion) = &frame.motion {
            self.count(Quantity::Motion, hits.iter().map(|&i| Vec2::from(motion.pixels[i]).length()).filter(|m| *m > 0.0));
        }
        if let Some(beauty) = &frame.beauty {
            self.count(Quantity::Luminance, beauty.pixels.iter().map(|&p| frame.info.exposure * luminance(p)));
        }
    }

    fn count(&mut self, quantity: Quantity, values: impl Iterator<Item = f32>) {
        let axis = quantity.axis();
        let counts = (axis.pick)(self);
        counts.resize(axis.bins, 0);
        for value in values {
            counts[axis.bin(value)] += 1;
        }
    }

    /// Adds the counts of `other`. Sums stop at the largest number, since a damaged record may hold any.
    pub fn add(&mut self, other: &Self) {
        for axis in AXES {
            let more = axis.counts(other);
            let counts = (axis.pick)(self);
            counts.resize(axis.bins, 0);
            for (count, more) in counts.iter_mut().zip(more) {
                *count = count.saturating_add(more);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_hold_their_values() {
        for axis in AXES {
            for i in 0..axis.bins {
                let (low, high) = (axis.edge(i), axis.edge(i + 1));
                let middle = if axis.log { (low * high).sqrt() } else { 0.5 * (low + high) };
                assert_eq!(axis.bin(middle as f32), i, "{} at {middle}", axis.title);
            }
            assert_eq!(axis.bin(-1.0), 0);
            assert_eq!(axis.bin(1e30), axis.bins - 1);
            assert_eq!(axis.bin(f32::INFINITY), axis.bins - 1);
        }
    }

    #[test]
    fn sums_are_sums() {
        let mut one = Statistics::default();
        one.count(Quantity::Roughness, [0.02, 0.5, 0.5].into_iter());
        let mut two = Statistics::default();
        two.count(Quantity::Roughness, [0.51].into_iter());
        two.count(Quantity::Depth, [3.0].into_iter());
        one.add(&two);
        assert_eq!(Quantity::Roughness.axis().counts(&one)[10], 3);
        assert_eq!(Quantity::Roughness.axis().counts(&one).iter().sum::<u64>(), 4);
        assert_eq!(Quantity::Depth.axis().counts(&one).iter().sum::<u64>(), 1);
        let most = Statistics { depth: vec![u64::MAX], ..Statistics::default() };
        one.add(&most);
        one.add(&most);
        assert_eq!(Quantity::Depth.axis().counts(&one)[0], u64::MAX);
    }
}
