//! Weights files of the networks: published ones in either layout (safetensors, whole or in shards, and PyTorch's `.pth`), and
//! this program's own safetensors with configuration and provenance inside.
//!
//! Opening a file reads its list of tensors. Values are then read from the file one tensor at a time, and converted to f32 in
//! this program's order of axes. Memory holds the network and two copies of its largest tensor. That is as much as with a mapped
//! file, but without the faults that a mapped file causes when it changes.

mod convert;
mod identify;
mod load;
mod open;
mod save;
mod source;

pub use convert::{check, convert};
pub use identify::{Evidence, Found, Identity, identify};
pub use load::{LoadOptions, LoadReport, is_context_path, is_text_path, load};
pub use open::Adoption;
pub use save::{Header, Network, Precision, Provenance, save};
pub use source::{ElementType, Row, Source, Table};
