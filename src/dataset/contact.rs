//! The contact sheet of a frame: its channels side by side, for people to look at.

use crate::util::picture;
use crate::util::sheet::{self, Bar, Tile, viridis};
use crate::util::text::short;
use anyhow::Result;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::{Frame, color};

/// A PNG of the frame's channels, four in a row, each with its name.
///
/// # Errors
/// When it cannot be encoded.
pub fn sheet(frame: &Frame) -> Result<Vec<u8>> {
    picture::png(&sheet::sheet(&tiles(frame), 4))
}

/// The picture of a frame in display values; `None` for a frame with G-buffers only.
pub fn display(frame: &Frame) -> Option<Rgb> {
    let beauty = frame.beauty.as_ref().or(frame.raw.as_ref())?;
    Some(beauty.map(|p| color::display(*p, frame.info.exposure)))
}

/// The channels that the frame has, as pictures.
pub fn tiles(frame: &Frame) -> Vec<Tile> {
    let mut tiles: Vec<Tile> = display(frame).map(|picture| Tile::new("beauty", picture)).into_iter().collect();
    tiles.push(Tile::new("albedo", frame.albedo.map(|p| p.map(color::linear_to_srgb))));
    let axes = |n: &[f32; 3]| if *n == [0.0; 3] { *n } else { n.map(|v| 0.5 * v + 0.5) };
    tiles.push(Tile::new("normal", frame.normal.map(axes)));
    tiles.push(numbers("depth", &frame.depth, "m", false));
    tiles.push(Tile::new("material (rough/metal/spec)", frame.material.clone()));
    tiles.push(Tile::new("object ids", ids(&frame.object_id)));
    tiles.push(Tile::new("material ids", ids(&frame.material_id)));
    if let Some(motion) = &frame.motion {
        tiles.push(numbers("motion to the next frame", &motion.map(|[x, y]| x.hypot(*y)), "px", true));
    }
    tiles
}

/// Numbers on a colour scale that spans them, from 0 if `from_zero`; what is not finite is black.
fn numbers(name: &str, values: &Image<f32>, unit: &str, from_zero: bool) -> Tile {
    let finite = || values.pixels.iter().copied().filter(|v| v.is_finite());
    let least = finite().reduce(f32::min).unwrap_or(0.0);
    let (low, high) = (if from_zero { 0.0 } else { least }, finite().reduce(f32::max).unwrap_or(0.0));
    let share = |value: f32| if high > low { (value - low) / (high - low) } else { 0.0 };
    let picture = values.map(|&v| if v.is_finite() { viridis(share(v)) } else { [0.0; 3] });
    let text = |value: f32| format!("{} {unit}", short(f64::from(value)));
    Tile { name: name.into(), picture, bar: Some(Bar { scale: viridis, low: text(low), high: text(high) }) }
}

fn ids(image: &Image<u32>) -> Rgb {
    image.map(|&id| picture::id_color(id).map(|byte| f32::from(byte) / 255.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_has_its_range_and_misses_are_black() {
        let depth = Image { width: 3, height: 1, pixels: vec![2.0, 6.5, f32::INFINITY] };
        let tile = numbers("depth", &depth, "m", false);
        assert_eq!(tile.picture.pixels, [viridis(0.0), viridis(1.0), [0.0; 3]]);
        let bar = tile.bar.unwrap();
        assert_eq!([bar.low, bar.high], ["2 m", "6.5 m"]);
        let nothing = numbers("depth", &depth.map(|_| f32::INFINITY), "m", false);
        assert!(nothing.picture.pixels.iter().all(|p| *p == [0.0; 3]));
    }
}
