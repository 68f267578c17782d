//! Values that change over time: the samplers of animations (glTF 2.0, appendix C).

use super::access::Buffers;
use crate::error::{Error, Result};
use glam::DVec4;
use gltf::animation::Interpolation;
use renderflow_frame::words::number;
use std::ops::{Add, Mul};

/// The times of a curve, and what happens between them.
struct Keys {
    /// Seconds, at least one, never decreasing.
    times: Vec<f64>,
    interpolation: Interpolation,
}

/// What a node's property is at each time.
pub(super) struct Curve {
    keys: Keys,
    /// One for each time, or three where the curve is a cubic spline: its tangents around the value.
    values: Vec<DVec4>,
}

/// What the weights of a node's morph targets are at each time.
pub(super) struct Weights {
    keys: Keys,
    /// As those of a [`Curve`], each the weights of all targets one after the other.
    values: Vec<f32>,
    targets: usize,
}

/// An accessor of a document, by its number; `place` names it where the number is wrong.
pub(super) struct Accessors<'a> {
    pub path: &'a std::path::Path,
    pub buffers: &'a Buffers<'a>,
    pub all: Vec<gltf::Accessor<'a>>,
}

impl Accessors<'_> {
    fn floats<const N: usize>(&self, index: usize, place: &str) -> Result<Vec<[f32; N]>> {
        let Some(accessor) = self.all.get(index) else {
            return Err(Error::model(self.path, place, format!("there is nothing with the index {index}")));
        };
        let values = self.buffers.floats::<N>(accessor, place)?;
        match values.iter().position(|value| !value.iter().all(|v| v.is_finite())) {
            Some(at) => Err(Error::model(self.path, place, format!("element {at} of accessor {index} is not finite"))),
            None => Ok(values),
        }
    }

    fn keys(&self, sampler: &gltf::json::animation::Sampler, place: &str) -> Result<Keys> {
        let fail = |below: &str, reason: String| Err(Error::model(self.path, format!("{place}/{below}"), reason));
        let gltf::json::validation::Checked::Valid(interpolation) = sampler.interpolation else {
            return fail("interpolation", "not one of the values allowed here".into());
        };
        let times: Vec<f64> =
            self.floats::<1>(sampler.input.value(), &format!("{place}/input"))?.into_iter().map(|[t]| f64::from(t)).collect();
        let Some(first) = times.first() else { return fail("input", "there is no key".into()) };
        if *first < 0.0 {
            return fail("input", format!("the first key is at {} seconds, before 0", number(*first)));
        }
        if let Some(at) = times.windows(2).position(|pair| pair[1] < pair[0]) {
            let [a, b] = [at, at + 1].map(|i| number(times[i]));
            return fail("input", format!("key {} at {b} seconds comes after key {at} at {a}", at + 1));
        }
        Ok(Keys { times, interpolation })
    }

    /// Refuses another number of values than the keys need, with `each` for every one of a property.
    fn count(&self, keys: &Keys, each: usize, values: usize, place: &str) -> Result<()> {
        let needed = keys.stride() * keys.times.len() * each;
        if values == needed {
            return Ok(());
        }
        let of_targets = if each == 1 { String::new() } else { format!(" of {each} morph targets") };
        let reason = format!("{values} values where {} keys{of_targets} need {needed}", keys.times.len());
        Err(Error::model(self.path, place, reason))
    }

    /// Reads a curve of three numbers a key, or of quaternions.
    pub(super) fn curve(&self, sampler: &gltf::json::animation::Sampler, place: &str, quaternions: bool) -> Result<Curve> {
        let keys = self.keys(sampler, place)?;
        let output = format!("{place}/output");
        let index = sampler.output.value();
        let values: Vec<DVec4> = if quaternions {
            self.floats::<4>(index, &output)?.into_iter().map(|v| DVec4::from(v.map(f64::from))).collect()
        } else {
            self.floats::<3>(index, &output)?.into_iter().map(|v| glam::DVec3::from(v.map(f64::from)).extend(0.0)).collect()
        };
        self.count(&keys, 1, values.len(), &output)?;
        Ok(Curve { keys, values })
    }

    /// Reads the weights of `targets` morph targets.
    pub(super) fn weights(&self, sampler: &gltf::json::animation::Sampler, place: &str, targets: usize) -> Result<Weights> {
        let keys = self.keys(sampler, place)?;
        let output = format!("{place}/output");
        let values: Vec<f32> = self.floats::<1>(sampler.output.value(), &output)?.into_iter().flatten().collect();
        self.count(&keys, targets, values.len(), &output)?;
        Ok(Weights { keys, values, targets })
    }
}

impl Keys {
    /// Values that belong to a key.
    fn stride(&self) -> usize {
        if self.interpolation == Interpolation::CubicSpline { 3 } else { 1 }
    }

    /// Seconds of the last key.
    fn end(&self) -> f64 {
        self.times.last().copied().unwrap_or(0.0)
    }

    /// What `values` are at a time, held before the first key and after the last one; `mix` is for lines.
    fn at<V: Copy + Add<Output = V> + Mul<f64, Output = V>>(
        &self,
        seconds: f64,
        values: impl Fn(usize) -> V,
        mix: impl Fn(V, V, f64) -> V,
    ) -> V {
        let stride = self.stride();
        let value = |key: usize| values(key * stride + stride / 2);
        let after = self.times.partition_point(|&time| time <= seconds);
        if after == 0 || after == self.times.len() {
            return value(after.saturating_sub(1));
        }
        let key = after - 1;
        // Above zero: the key's time is at most `seconds` and the next one's is more.
        let length = self.times[after] - self.times[key];
        let share = (seconds - self.times[key]) / length;
        match self.interpolation {
            Interpolation::Step => value(key),
            Interpolation::Linear => mix(value(key), value(after), share),
            Interpolation::CubicSpline => {
                let (leaving, arriving) = (values(3 * key + 2) * length, values(3 * after) * length);
                let (s, s2, s3) = (share, share.powi(2), share.powi(3));
                value(key) * (2.0 * s3 - 3.0 * s2 + 1.0)
                    + leaving * (s3 - 2.0 * s2 + s)
                    + value(after) * (3.0 * s2 - 2.0 * s3)
                    + arriving * (s3 - s2)
            }
        }
    }
}

impl Curve {
    /// Seconds of the last key.
    pub(super) fn end(&self) -> f64 {
        self.keys.end()
    }

    /// Three numbers at a time, held before the first key and after the last one.
    pub(super) fn vector(&self, seconds: f64) -> DVec4 {
        self.keys.at(seconds, |i| self.values[i], |a, b, share| a + (b - a) * share)
    }

    /// A quaternion of any length at a time, held before the first key and after the last one. It goes the shorter way.
    pub(super) fn rotation(&self, seconds: f64) -> DVec4 {
        self.keys.at(seconds, |i| self.values[i], slerp)
    }
}

impl Weights {
    /// Seconds of the last key.
    pub(super) fn end(&self) -> f64 {
        self.keys.end()
    }

    /// The weight of each target at a time, held before the first key and after the last one.
    pub(super) fn at(&self, seconds: f64) -> Vec<f32> {
        let weight = |target: usize| {
            let value = |i: usize| f64::from(self.values[i * self.targets + target]);
            self.keys.at(seconds, value, |a, b, share| a + (b - a) * share) as f32
        };
        (0..self.targets).map(weight).collect()
    }
}

/// Between two rotations along the shorter arc, at an even speed. Of any length; one of zero length turns nothing.
fn slerp(a: DVec4, b: DVec4, share: f64) -> DVec4 {
    let [a, b] = [a, b].map(|q| q.normalize_or(DVec4::W));
    let b = if a.dot(b) < 0.0 { -b } else { b };
    // At most a right angle, and exact for small ones.
    let angle = 2.0 * (b - a).length().atan2((b + a).length());
    if angle < 1e-9 {
        return a + (b - a) * share;
    }
    (a * ((1.0 - share) * angle).sin() + b * (share * angle).sin()) / angle.sin()
}
