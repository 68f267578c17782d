//! Weights files of the networks: published ones in either layout (safetensors, whole or in shards, and PyTorch's `.pth`), and
//! this program's own safetensors with configuration and provenance inside.
//!
//! A file is opened by its list of tensors; values are read one tensor at a time, straight from their place in the file, and
//! turned into f32 in this program's order of axes. The most memory in use is that of the network and of two copies of its
//! largest tensor, as with a mapped file, but without the faults of one that changes while it is mapped.

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
