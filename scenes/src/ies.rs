//! Photometric profiles of luminaires: IES files (ANSI/IES LM-63, the revisions of 1986 to 2019), type C photometry.
//!
//! Vertical angles count from the luminaire's nadir, which is the -Z axis of a light here; horizontal angles turn about it from
//! +X towards +Y. Planes that a file leaves out follow from those it has by the symmetry that the standard says.

use crate::error::Error;
use glam::Vec3A;
use renderflow_frame::file;
use renderflow_frame::words::shortened;
use std::path::Path;

/// Largest file that is read, bytes.
pub const MAX_BYTES: u64 = 16 << 20;
/// Most vertical and most horizontal angles.
const MAX_ANGLES: usize = 1 << 14;

/// How bright a luminaire is in each direction, relative to its brightest one.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// Degrees from the nadir, rising, within 0..=180.
    vertical: Vec<f32>,
    /// Degrees about it, rising.
    horizontal: Vec<f32>,
    /// 0..=1, all vertical angles of the first horizontal one, then those of the next.
    values: Vec<f32>,
    symmetry: Symmetry,
}

/// What the planes that a file has say of the others.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Symmetry {
    /// One plane is all of them.
    Axial,
    /// Planes 0 to 90.
    Quadrants,
    /// Planes 0 to 180.
    Halves,
    /// Planes 90 to 270.
    Sides,
    /// Planes 0 to 360.
    None,
}

impl Profile {
    /// Reads a file.
    ///
    /// # Errors
    /// When it cannot be read, is larger than [`MAX_BYTES`], or is none.
    pub fn read(path: &Path) -> crate::Result<Self> {
        let bytes = file::read_at_most(path, MAX_BYTES)?;
        // Keywords may hold anything; the numbers are ASCII.
        Self::parse(&String::from_utf8_lossy(&bytes)).map_err(|reason| Error::model(path, "", reason))
    }

    /// Reads the text of a file.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (start, tilt) = tilt(text).ok_or("there is no line TILT=, so it is not an IES file")?;
        let mut numbers = Numbers(text[start..].split(|c: char| c.is_whitespace() || c == ',').filter(|word| !word.is_empty()));
        match tilt.to_ascii_uppercase().as_str() {
            "NONE" => {}
            // How the lamp's output depends on how it hangs: lights here do not know.
            "INCLUDE" => {
                numbers.next("the lamp's position")?;
                let count = numbers.count("the number of tilt angles")?;
                for _ in 0..2 * count {
                    numbers.next("the tilt table")?;
                }
            }
            _ => return Err(format!("TILT={}: only NONE and INCLUDE are read", shortened(tilt))),
        }
        for what in ["the number of lamps", "lumens per lamp", "the candela multiplier"] {
            numbers.next(what)?;
        }
        let vertical = numbers.count("the number of vertical angles")?;
        let horizontal = numbers.count("the number of horizontal angles")?;
        let kind = numbers.next("the photometric type")?;
        if kind != 1.0 {
            return Err(format!("photometric type {kind}: only type C, which is 1, is read"));
        }
        for what in ["the units", "the width", "the length", "the height", "the ballast factor", "the future use", "the watts"] {
            numbers.next(what)?;
        }
        let vertical = numbers.angles(vertical, "vertical")?;
        let horizontal = numbers.angles(horizontal, "horizontal")?;
        if vertical[0] < 0.0 || vertical[vertical.len() - 1] > 180.0 {
            return Err("vertical angles leave 0..=180".into());
        }
        let symmetry = match (horizontal[0], horizontal[horizontal.len() - 1]) {
            _ if horizontal.len() == 1 => Symmetry::Axial,
            (0.0, 90.0) => Symmetry::Quadrants,
            (0.0, 180.0) => Symmetry::Halves,
            (90.0, 270.0) => Symmetry::Sides,
            (0.0, 360.0) => Symmetry::None,
            (first, last) => return Err(format!("horizontal angles from {first} to {last} have no symmetry of type C")),
        };
        let mut values = Vec::new();
        for _ in 0..vertical.len() * horizontal.len() {
            let value = numbers.next("the candela values")?;
            if value < 0.0 {
                return Err(format!("the candela value {value} is negative"));
            }
            values.push(value);
        }
        let largest = values.iter().copied().fold(0.0, f64::max);
        if largest == 0.0 {
            return Err("all candela values are 0".into());
        }
        let values = values.into_iter().map(|value| (value / largest) as f32).collect();
        Ok(Self { vertical, horizontal, values, symmetry })
    }

    /// Relative intensity along the unit direction `d` in the light's space, 0..=1: between the angles of the file linearly in
    /// each, beyond its vertical angles 0.
    pub fn value(&self, d: Vec3A) -> f32 {
        // From both, so that small angles keep their digits.
        let vertical = d.x.hypot(d.y).atan2(-d.z).to_degrees();
        let Some((row, up)) = between(&self.vertical, vertical) else { return 0.0 };
        let turn = d.y.atan2(d.x).to_degrees().rem_euclid(360.0);
        let folded = match self.symmetry {
            Symmetry::Axial => self.horizontal[0],
            Symmetry::Quadrants => 90.0 - (90.0 - turn.min(360.0 - turn)).abs(),
            Symmetry::Halves => turn.min(360.0 - turn),
            Symmetry::Sides if turn < 90.0 => 180.0 - turn,
            Symmetry::Sides if turn > 270.0 => 540.0 - turn,
            Symmetry::Sides | Symmetry::None => turn,
        };
        let (plane, around) = between(&self.horizontal, folded).unwrap_or((0, 0.0));
        let count = self.vertical.len();
        let column = |plane: usize| {
            let at = |row: usize| self.values[plane.min(self.horizontal.len() - 1) * count + row.min(count - 1)];
            at(row) * (1.0 - up) + at(row + 1) * up
        };
        column(plane) * (1.0 - around) + column(plane + 1) * around
    }
}

/// Where the text after the line `TILT=` starts, and what the line says.
fn tilt(text: &str) -> Option<(usize, &str)> {
    let mut start = 0;
    for line in text.split_inclusive('\n') {
        start += line.len();
        let line = line.trim();
        if line.get(..5).is_some_and(|head| head.eq_ignore_ascii_case("TILT=")) {
            return Some((start, line[5..].trim()));
        }
    }
    None
}

/// The angle at or below `degrees`, and the share of the way to the next; `None` beyond the ends (but for rounding).
fn between(angles: &[f32], degrees: f32) -> Option<(usize, f32)> {
    const ROUNDING: f32 = 1e-3;
    let (first, last) = (*angles.first()?, *angles.last()?);
    if degrees < first - ROUNDING || degrees > last + ROUNDING || degrees.is_nan() {
        return None;
    }
    let below = angles.partition_point(|&angle| angle <= degrees).saturating_sub(1);
    let Some(next) = angles.get(below + 1) else { return Some((below, 0.0)) };
    Some((below, ((degrees - angles[below]) / (next - angles[below])).clamp(0.0, 1.0)))
}

/// The numbers of a file, one after the other.
struct Numbers<I>(I);

impl<'a, I: Iterator<Item = &'a str>> Numbers<I> {
    fn next(&mut self, what: &str) -> Result<f64, String> {
        let word = self.0.next().ok_or_else(|| format!("the file ends before {what}"))?;
        match word.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(format!("{what}: {:?} is not a number", shortened(word))),
        }
    }

    fn count(&mut self, what: &str) -> Result<usize, String> {
        let number = self.next(what)?;
        if number.fract() != 0.0 || !(1.0..=MAX_ANGLES as f64).contains(&number) {
            return Err(format!("{what}: {number} is not a whole number from 1 to {MAX_ANGLES}"));
        }
        Ok(number as usize)
    }

    /// Rising angles.
    fn angles(&mut self, count: usize, what: &str) -> Result<Vec<f32>, String> {
        let mut angles: Vec<f32> = Vec::new();
        for _ in 0..count {
            let angle = self.next(&format!("the {what} angles"))? as f32;
            if angles.last().is_some_and(|&last| angle <= last) {
                return Err(format!("the {what} angles do not rise at {angle}"));
            }
            angles.push(angle);
        }
        Ok(angles)
    }
}
