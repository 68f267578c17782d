//! A tree of seeds: every random decision has an address (dataset / sequence / frame / pixel) and depends on nothing else.
//!
//! A node's children are keyed BLAKE3 hashes of a label and a number, so that sequences can be made in any order, on any machine,
//! and a new kind of decision (a new label) changes none of the old ones.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::SeedableRng;

/// A node of the tree: 256 bits.
///
/// ```
/// use renderflow_scenes::seed::Seed;
/// let sequence = Seed::root(7).child("sequence", 3);
/// assert_ne!(sequence.child("layout", 0).u64(), sequence.child("sky", 0).u64());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Seed([u8; 32]);

impl Seed {
    /// The root of a dataset (or of a single scene) with the number a person chose.
    pub fn root(number: u64) -> Self {
        Self(blake3::derive_key("renderflow 2026 seed tree, root", &number.to_le_bytes()))
    }

    /// Child `index` of the kind `label`.
    pub fn child(&self, label: &str, index: u64) -> Self {
        let mut hasher = blake3::Hasher::new_keyed(&self.0);
        // The length keeps ("a", ..) and a longer label from ever meeting.
        hasher.update(&(label.len() as u64).to_le_bytes()).update(label.as_bytes()).update(&index.to_le_bytes());
        Self(*hasher.finalize().as_bytes())
    }

    /// The first 64 bits, little endian, as a number for programs that take one.
    pub fn u64(&self) -> u64 {
        let mut bytes = [0; 8];
        bytes.copy_from_slice(&self.0[..8]);
        u64::from_le_bytes(bytes)
    }

    /// A generator that starts at this node.
    pub fn rng(&self) -> Pcg64 {
        Pcg64::from_seed(self.0)
    }
}
