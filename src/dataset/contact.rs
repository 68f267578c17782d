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

/// A channel of the G-buffer that people look at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Base colour.
    Albedo,
    /// Normal in camera space, -1..=1 as 0..=1.
    Normal,
    /// Depth on a logarithmic scale.
    Depth,
    /// Roughness, metallic and specular as red, green and blue.
    Material,
    /// A colour for each object.
    Objects,
    /// A colour for each material.
    Materials,
}

impl Channel {
    const ALL: [Self; 6] = [Self::Albedo, Self::Normal, Self::Depth, Self::Material, Self::Objects, Self::Materials];

    /// The channel of `frame` as a picture.
    pub fn tile(self, frame: &Frame) -> Tile {
        match self {
            Self::Albedo => Tile::new("albedo", frame.albedo.map(|p| p.map(color::linear_to_srgb))),
            Self::Normal => {
                let axes = |n: &[f32; 3]| if *n == [0.0; 3] { *n } else { n.map(|v| 0.5 * v + 0.5) };
                Tile::new("normal", frame.normal.map(axes))
            }
            Self::Depth => depth(&frame.depth),
            Self::Material => Tile::new("material (rough/metal/spec)", frame.material.clone()),
            Self::Objects => Tile::new("object ids", ids(&frame.object_id)),
            Self::Materials => Tile::new("material ids", ids(&frame.material_id)),
        }
    }
}

/// The channels that the frame has, as pictures.
pub fn tiles(frame: &Frame) -> Vec<Tile> {
    let mut tiles: Vec<Tile> = display(frame).map(|picture| Tile::new("beauty", picture)).into_iter().collect();
    tiles.extend(Channel::ALL.map(|channel| channel.tile(frame)));
    if let Some(motion) = &frame.motion {
        let length = motion.map(|[x, y]| x.hypot(*y));
        let most = length.pixels.iter().copied().filter(|v| v.is_finite()).fold(0.0, f32::max);
        tiles.push(numbers("motion to the next frame", &length, [0.0, most], |v| v, "px"));
    }
    tiles
}

/// Depth on a logarithmic scale: a horizon would leave no colours to what is near.
fn depth(depth: &Image<f32>) -> Tile {
    let finite = || depth.pixels.iter().copied().filter(|v| v.is_finite() && *v > 0.0);
    let [low, high] = [finite().reduce(f32::min), finite().reduce(f32::max)].map(|end| end.unwrap_or(1.0));
    numbers("depth (logarithmic)", depth, [low, high], f32::ln, "m")
}

/// Numbers on a colour scale from `low` to `high`, in equal steps of `place`; what is not finite is black.
fn numbers(name: &str, values: &Image<f32>, [low, high]: [f32; 2], place: fn(f32) -> f32, unit: &str) -> Tile {
    let share = |value: f32| if high > low { (place(value) - place(low)) / (place(high) - place(low)) } else { 0.0 };
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
        let image = Image { width: 4, height: 1, pixels: vec![2.0, 4.0, 8.0, f32::INFINITY] };
        let tile = depth(&image);
        let middle = tile.picture.pixels[1].iter().zip(viridis(0.5)).all(|(a, b)| (a - b).abs() < 1e-4);
        assert!(middle && tile.picture.pixels[0] == viridis(0.0) && tile.picture.pixels[2] == viridis(1.0));
        assert_eq!(tile.picture.pixels[3], [0.0; 3]);
        let bar = tile.bar.unwrap();
        assert_eq!([bar.low, bar.high], ["2 m", "8 m"]);
        let nothing = depth(&image.map(|_| f32::INFINITY));
        assert!(nothing.picture.pixels.iter().all(|p| *p == [0.0; 3]));
    }
}
