//! The interface of networks that render sequences. A session takes frames one by one and returns their pictures in the same
//! order.
//!
//! [`WanRenderer`](crate::wan::video::WanRenderer) renders overlapping clips, so that a picture can come up to one clip later
//! than its frame. It can also render each frame alone. Memory does not grow with the length of the sequence.

use crate::{Error, Result, weights};
use renderflow_frame::image::Rgb;
use renderflow_frame::{DepthBounds, Frame, Light};
use safetensors::tensor::Dtype;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A description of a renderer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct About {
    /// Short name: `wan`.
    pub name: &'static str,
    /// Header of its weights as JSON.
    pub header: String,
    /// Whether it can use keyframes.
    pub keyframes: bool,
    /// Whether its pictures can be brighter than display white.
    pub hdr: bool,
    /// Whether it begins with the picture by deferred shading, [`View::shaded`].
    pub shaded: bool,
    /// Number of frames that are rendered together. With 1, frames can come in any order.
    pub clip: usize,
}

impl About {
    /// Whether several frames are rendered together with these options.
    pub fn in_clips(&self, options: Options) -> bool {
        self.clip > 1 && !options.stills
    }
}

/// Options of rendering.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Use the keyframes of the sequence.
    pub keyframes: bool,
    /// Number of Euler steps from t = 0, at least 1. The network is trained for 1.
    pub steps: usize,
    /// Seed of the noise that a network begins with. It changes nothing for a network that begins with the albedo.
    pub seed: u64,
    /// Render each frame alone, also with a network that renders clips. Frames can then come in any order. Pictures are sharper,
    /// because a latent frame stands for one picture, but they are less stable over time.
    pub stills: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { keyframes: false, steps: 1, seed: 0, stills: false }
    }
}

/// The position of a keyframe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KeyframePlace {
    /// Number of the frame in the sequence. Distances are differences of these numbers.
    pub number: usize,
    /// Index of the frame among the stored frames.
    pub index: usize,
}

/// Everything about a sequence that does not arrive frame by frame. Parts that a renderer does not ask for are not computed.
pub trait Sequence: Sync {
    /// The light.
    ///
    /// # Errors
    /// When it cannot be read.
    fn light(&self) -> Result<&Light>;
    /// The range of depths in the whole sequence.
    ///
    /// # Errors
    /// When frames cannot be read.
    fn depth_bounds(&self) -> Result<DepthBounds>;
    /// Keyframes, by ascending number.
    fn keyframes(&self) -> &[KeyframePlace];
    /// Loads a keyframe with its beauty.
    ///
    /// # Errors
    /// When the keyframe cannot be read.
    fn keyframe(&self, index: usize) -> Result<Frame>;
}

/// A frame to render.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Number of the frame in the sequence.
    pub number: usize,
    /// Index of the frame among the stored frames.
    pub index: usize,
    /// G-buffer of the frame. Its beauty is not read.
    pub frame: &'a Frame,
    /// The frame by deferred shading, as scene-linear radiance, for a renderer that begins with it ([`About::shaded`]). If
    /// keyframes are used, they are carried over it.
    pub shaded: Option<&'a Rgb>,
}

/// A rendered frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// [`View::index`].
    pub index: usize,
    /// Scene-linear radiance.
    pub linear: Rgb,
}

/// A network that renders sequences.
pub trait Renderer: Send + Sync {
    /// Describes the renderer.
    fn about(&self) -> About;
    /// Begins a sequence.
    ///
    /// # Errors
    /// For 0 steps, for an exposure that is not a positive number, and for keyframes if the weights cannot use them.
    fn begin<'a>(&'a self, sequence: &'a dyn Sequence, options: Options) -> Result<Box<dyn Session + 'a>>;
}

/// A sequence that is being rendered. A renderer of clips needs consecutive frames of one size. Where a frame number is missing,
/// rendering continues as if a new sequence began.
pub trait Session {
    /// Takes the next frame, and returns the frames that are now finished, in order.
    ///
    /// # Errors
    /// When the frame does not fit (the session is unchanged then), when a keyframe cannot be read, or when rendering fails.
    fn push(&mut self, view: View) -> Result<Vec<Rendered>>;
    /// Ends the sequence and returns the remaining frames.
    ///
    /// # Errors
    /// As [`Self::push`].
    fn finish(&mut self) -> Result<Vec<Rendered>>;
    /// Prepares the other inputs of the frame with this number. If it is not called, [`Self::push`] prepares them.
    ///
    /// # Errors
    /// As [`Self::push`].
    fn prepare(&mut self, _number: usize) -> Result<()> {
        Ok(())
    }
    /// The state that another session needs to continue after the last finished frame. `None` while frames of an unfinished clip
    /// are held, and always if frames are rendered alone.
    fn state(&self) -> Option<State> {
        None
    }
    /// Continues after the frame `view` from the [`Self::state`] of that time. The pictures are the same to the bit as without
    /// the stop.
    ///
    /// # Errors
    /// When the frame and the state do not belong together.
    fn resume(&mut self, _view: View, _state: State) -> Result<()> {
        Ok(())
    }
}

/// The last frame of a clip, from which the next clip continues.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// [`View::number`] of the last finished frame.
    pub number: usize,
    /// Columns and rows.
    pub size: [usize; 2],
    /// Picture `[3, height, width]`, display values scaled to -1..=1.
    pub picture: Vec<f32>,
}

/// The header of an encoded [`State`].
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StateHeader {
    number: usize,
    size: [usize; 2],
}

/// Name of the picture's tensor in an encoded [`State`].
const PICTURE: &str = "picture";

impl State {
    /// Encodes the state as a safetensors file.
    ///
    /// # Errors
    /// When the picture does not have the stated size.
    pub fn encode(&self) -> Result<Vec<u8>> {
        let path = Path::new("state to be written");
        let header = StateHeader { number: self.number, size: self.size };
        let header = serde_json::to_string(&header).map_err(|e| Error::malformed(path, e.to_string()))?;
        let bytes: Vec<u8> = self.picture.iter().flat_map(|v| v.to_le_bytes()).collect();
        let shape = [3, self.size[1], self.size[0]];
        weights::write_safetensors(path, &header, std::iter::once((PICTURE, Dtype::F32, &shape[..], &bytes[..])))
    }

    /// Decodes the bytes of [`Self::encode`]. `path` names them in messages.
    ///
    /// # Errors
    /// When the bytes are something else, or when a value is not finite.
    pub fn decode(path: &Path, bytes: &[u8]) -> Result<Self> {
        let (tensors, header) = weights::open(path, bytes)?;
        let header = serde_json::from_str(&header).map_err(|e| Error::malformed(path, e.to_string()))?;
        let StateHeader { number, size } = header;
        let picture = weights::read_tensor(path, &tensors, PICTURE, &[3, size[1], size[0]])?;
        Ok(Self { number, size, picture })
    }
}

/// Checks the options that every renderer has.
pub(crate) fn check(options: Options, exposure: f32) -> Result<()> {
    if options.steps == 0 {
        return Err(Error::config("steps", "must be at least 1"));
    }
    if !(exposure.is_finite() && exposure > 0.0) {
        return Err(Error::config("exposure", format!("{exposure} is not a positive number")));
    }
    Ok(())
}

/// The keyframes of frames `first..=last`: the nearest at or before the first frame, and those after it up to the last frame, or
/// the next one if there are none.
pub(crate) fn nearest(places: &[KeyframePlace], first: usize, last: usize) -> Vec<KeyframePlace> {
    let next = places.partition_point(|place| place.number <= first);
    let within = places[next..].iter().take_while(|place| place.number <= last).count();
    places[next.saturating_sub(1)..].iter().take(next.min(1) + within.max(1)).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clip_is_guided_from_both_sides() {
        let places: Vec<KeyframePlace> =
            [4, 6, 7, 20].into_iter().enumerate().map(|(index, number)| KeyframePlace { number, index }).collect();
        let numbers = |first, last| nearest(&places, first, last).iter().map(|place| place.number).collect::<Vec<_>>();
        assert_eq!(numbers(0, 0), [4]);
        assert_eq!(numbers(0, 6), [4, 6]);
        assert_eq!(numbers(4, 4), [4, 6]);
        assert_eq!(numbers(4, 8), [4, 6, 7]);
        assert_eq!(numbers(5, 5), [4, 6]);
        assert_eq!(numbers(8, 12), [7, 20]);
        assert_eq!(numbers(20, 24), [20]);
        assert_eq!(numbers(30, 34), [20]);
        assert_eq!(nearest(&[], 3, 9), []);
    }
}
