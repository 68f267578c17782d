//! The contract between the path tracer, the neural renderer and the files: what a channel means, where a camera looks,
//! how an environment is oriented, and which colour curve turns radiance into a picture.
//!
//! It is *not* a renderer: nothing here traces a ray through geometry. What both sides need of a frame (split-sum shading,
//! keyframe warping) is here once, so that baselines and networks see the same numbers.
#![forbid(unsafe_code)]

pub mod camera;
pub mod channel;
pub mod color;
pub mod compact;
pub mod depth;
pub mod distortion;
pub mod environment;
pub mod error;
pub mod exr;
pub mod file;
pub mod frame;
pub mod frame_file;
pub mod fresnel;
pub mod guard;
pub mod hdr;
pub mod ibl;
pub mod image;
pub mod light;
pub mod memory;
pub mod reach;
mod rgbe;
pub mod terms;
pub mod tracks;
pub mod transforms;
pub mod warp;
pub mod words;

pub use camera::Camera;
pub use depth::{DepthBounds, is_depth};
pub use distortion::Distortion;
pub use environment::Environment;
pub use error::{Error, Result};
pub use frame::{Frame, FrameInfo};
pub use image::Image;
pub use light::Light;
