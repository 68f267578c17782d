//! What tells the weights of networks apart: files with the same header may hold other values.

use super::files;
use anyhow::Result;
use renderflow_model::network::trained::Described;
use renderflow_model::wan::video::{AUTOENCODER_FILE, WanRenderer};
use std::path::{Path, PathBuf};

/// BLAKE3 of the file `weights`, and of the autoencoder that the paper's network in it needs. Without `weights`, of the weights
/// of `N` inside the program.
///
/// # Errors
/// When a file cannot be read.
pub fn digests<N: Described>(weights: Option<&Path>, vae: Option<&Path>) -> Result<Vec<String>> {
    let Some(path) = weights else { return Ok(inside::<N>().into_iter().collect()) };
    let second = WanRenderer::recognises(path).then(|| autoencoder(vae, path));
    std::iter::once(path).chain(second.as_deref()).map(files::hash).collect()
}

/// BLAKE3 of the weights of a network inside the program.
pub fn inside<N: Described>() -> Option<String> {
    N::shipped().map(|bytes| blake3::hash(bytes).to_hex().to_string())
}

/// The file of the autoencoder of the paper's network in the file `weights`: the one that is named, or the one beside it.
pub fn autoencoder(named: Option<&Path>, weights: &Path) -> PathBuf {
    named.map_or_else(|| weights.with_file_name(AUTOENCODER_FILE), Path::to_owned)
}
