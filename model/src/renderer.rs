//! Networks that render sequences: frames go in one after the other, pictures come out in the same order.
//!
//! [`WanRenderer`] (the paper's graph) makes them in overlapping clips, so that a picture comes out up to a clip later than its frame went
//! in, or each by itself. The memory in use does not grow with the sequence.

use crate::wan::pictures::DepthBounds;
use crate::wan::video::WanRenderer;
use crate::{Error, Result, weights};
use renderflow_frame::image::Rgb;
use renderflow_frame::{Frame, Light};
use safetensors::tensor::Dtype;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What a renderer says about itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct About {
    /// Short name: `wan`.
    pub name: &'static str,
    /// What its weights say about themselves, as JSON.
    pub header: String,
    /// Whether it can make use of keyframes.
    pub keyframes: bool,
    /// Whether its pictures go beyond display white; otherwise radiance ends there.
    pub hdr: bool,
    /// Frames rendered together; 1 = each by itself, in any order.
    pub clip: usize,
}

impl About {
    /// Whether frames are rendered several at a time.
    pub fn in_clips(&self, options: Options) -> bool {
        self.clip > 1 && !options.stills
    }
}

/// How pictures are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Make use of the sequence's keyframes.
    pub keyframes: bool,
    /// Euler steps from t = 0; 1 is what the network is trained for.
    pub steps: usize,
    /// Render each frame by itself, in any order, also with a network that makes clips: sharper, since a latent frame then stands for one
    /// picture, but not held together over time.
    pub stills: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { keyframes: false, steps: 1, stills: false }
    }
}

/// A rendered frame that others may be guided by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KeyframePlace {
    /// Number of the frame in the sequence; distances are counted in them.
    pub number: usize,
    /// Index of the frame among those stored.
    pub index: usize,
}

/// A sequence, as far as it does not arrive frame by frame. What a renderer does not ask for is never made.
pub trait Sequence: Sync {
    /// The light.
    ///
    /// # Errors
    /// When it cannot be read.
    fn light(&self) -> Result<&Light>;
    /// Depths of the whole sequence.
    ///
    /// # Errors
    /// When frames cannot be read.
    fn depth_bounds(&self) -> Result<DepthBounds>;
    /// Keyframes, by ascending number.
    fn keyframes(&self) -> &[KeyframePlace];
    /// A keyframe with its beauty.
    ///
    /// # Errors
    /// When it cannot be read.
    fn keyframe(&self, index: usize) -> Result<Frame>;
}

/// A frame to be rendered.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Number of the frame in the sequence.
    pub number: usize,
    /// Index of the frame among those stored.
    pub index: usize,
    /// Its G-buffer; a beauty is not looked at.
    pub frame: &'a Frame,
}

/// A finished frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// [`View::index`].
    pub index: usize,
    /// Scene-linear radiance.
    pub linear: Rgb,
}

/// A network that renders sequences.
pub trait Renderer: Send + Sync {
    /// What it is.
    fn about(&self) -> About;
    /// Begins with a sequence.
    ///
    /// # Errors
    /// For 0 steps, an exposure that is no positive number, and when keyframes are asked for that the weights cannot use.
    fn begin<'a>(&'a self, sequence: &'a dyn Sequence, options: Options) -> Result<Box<dyn Session + 'a>>;
}

/// A sequence being rendered. A renderer that makes clips wants consecutive frames of one size; where a number is left out, what
/// follows is rendered as if a sequence began there.
pub trait Session {
    /// Takes the next frame and returns the frames finished by it, in order: none, one, or a clip.
    ///
    /// # Errors
    /// When the frame does not fit, and nothing has changed then; when a keyframe cannot be read or rendering fails.
    fn push(&mut self, view: View) -> Result<Vec<Rendered>>;
    /// Ends the sequence: the frames that were still waited for.
    ///
    /// # Errors
    /// As [`Self::push`].
    fn finish(&mut self) -> Result<Vec<Rendered>>;
    /// Makes ready what the frame of this number needs beside itself; [`Self::push`] does it where nobody did.
    ///
    /// # Errors
    /// As [`Self::push`].
    fn prepare(&mut self, _number: usize) -> Result<()> {
        Ok(())
    }
    /// What another session needs to go on after the last finished frame; `None` where frames are waited for, and always where each
    /// is rendered by itself.
    fn state(&self) -> Option<State> {
        None
    }
    /// Goes on after the frame `view`, with what [`Self::state`] said then: what follows is the same to the bit as without the stop.
    ///
    /// # Errors
    /// When the two do not belong together.
    fn resume(&mut self, _view: View, _state: State) -> Result<()> {
        Ok(())
    }
}

/// The end of a clip.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// [`View::number`] of the last finished frame.
    pub number: usize,
    /// Its columns and rows.
    pub size: [usize; 2],
    /// Its picture `[3, height, width]`, display values as -1..=1.
    pub picture: Vec<f32>,
}

/// What [`State::encode`] writes beside the picture.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StateHeader {
    number: usize,
    size: [usize; 2],
}

/// Name of the picture in the file of a [`State`].
const PICTURE: &str = "picture";

impl State {
    /// As the bytes of a safetensors file.
    ///
    /// # Errors
    /// When the picture has not the size it says.
    pub fn encode(&self) -> Result<Vec<u8>> {
        let path = Path::new("state to be written");
        let header = StateHeader { number: self.number, size: self.size };
        let header = serde_json::to_string(&header).map_err(|e| Error::malformed(path, e.to_string()))?;
        let bytes: Vec<u8> = self.picture.iter().flat_map(|v| v.to_le_bytes()).collect();
        let shape = [3, self.size[1], self.size[0]];
        weights::write_safetensors(path, &header, std::iter::once((PICTURE, Dtype::F32, &shape[..], &bytes[..])))
    }

    /// From what [`Self::encode`] wrote; `path` stands in errors.
    ///
    /// # Errors
    /// When the bytes are something else, or a value is not finite.
    pub fn decode(path: &Path, bytes: &[u8]) -> Result<Self> {
        let (tensors, header) = weights::open(path, bytes)?;
        let header = serde_json::from_str(&header).map_err(|e| Error::malformed(path, e.to_string()))?;
        let StateHeader { number, size } = header;
        let picture = weights::read_tensor(path, &tensors, PICTURE, &[3, size[1], size[0]])?;
        Ok(Self { number, size, picture })
    }
}

/// How the paper's graph is opened, beside its own weights.
#[derive(Clone, Copy, Debug, Default)]
pub struct Autoencoder<'a> {
    /// Its file; [`crate::wan::video::AUTOENCODER_FILE`] beside that of the renderer where none is named.
    pub file: Option<&'a Path>,
    /// Pixels a side of the tiles in which larger pictures are encoded and decoded; `None` = always in one piece.
    pub tile: Option<usize>,
}

/// Opens weights of the paper's network, which say so themselves.
///
/// # Errors
/// When a file cannot be read or holds another network; the message names file and tensor.
pub fn open(path: &Path, autoencoder: Autoencoder) -> Result<Box<dyn Renderer>> {
    let renderer = WanRenderer::load(path, autoencoder.file)?;
    Ok(match autoencoder.tile {
        Some(pixels) => Box::new(renderer.tiled(pixels)?),
        None => Box::new(renderer),
    })
}

/// Checks what every renderer asks of its options.
pub(crate) fn check(options: Options, exposure: f32) -> Result<()> {
    if options.steps == 0 {
        return Err(Error::config("steps", "must be at least 1"));
    }
    if !(exposure.is_finite() && exposure > 0.0) {
        return Err(Error::config("exposure", format!("{exposure} is not a positive number")));
    }
    Ok(())
}

/// The keyframes that matter to frames `first..=last`: the nearest at or before the first, those up to the last, and where there is
/// none of these the next one.
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
