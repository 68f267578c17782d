//! What tells the weights of networks apart: files with the same header may hold other values.

use super::files;
use anyhow::Result;
use renderflow_model::network::trained::Described;
use renderflow_model::wan::video::{AUTOENCODER_FILE, WanRenderer};
use renderflow_model::wan::weights::Source;
use std::path::{Path, PathBuf};

/// BLAKE3 of the weights at `path`: of the one file that holds them, or of the hashes of an index and its shards. A folder stands
/// for the weights inside it.
///
/// # Errors
/// When a file cannot be read, or when there are no weights, or several, in a folder.
pub fn digest(path: &Path) -> Result<String> {
    let several = path.is_dir() || path.to_string_lossy().ends_with(".index.json");
    if !several {
        return files::hash(path);
    }
    let hashes = Source::open(path)?.files().into_iter().map(files::hash).collect::<Result<Vec<String>>>()?;
    Ok(match &hashes[..] {
        [one] => one.clone(),
        all => blake3::hash(&serde_json::to_vec(all)?).to_hex().to_string(),
    })
}

/// BLAKE3 of the weights at `weights`, and of the autoencoder that the paper's network in it needs. Without `weights`, of the
/// weights of `N` inside the program.
///
/// # Errors
/// When a file cannot be read.
pub fn digests<N: Described>(weights: Option<&Path>, vae: Option<&Path>) -> Result<Vec<String>> {
    let Some(path) = weights else { return Ok(inside::<N>().into_iter().collect()) };
    let second = WanRenderer::recognises(path).then(|| autoencoder(vae, path));
    std::iter::once(path).chain(second.as_deref()).map(digest).collect()
}

/// BLAKE3 of the weights of a network inside the program.
pub fn inside<N: Described>() -> Option<String> {
    N::shipped().map(|bytes| blake3::hash(bytes).to_hex().to_string())
}

/// The file of the autoencoder of the paper's network in the file `weights`: the one that is named, or the one beside it.
pub fn autoencoder(named: Option<&Path>, weights: &Path) -> PathBuf {
    named.map_or_else(|| weights.with_file_name(AUTOENCODER_FILE), Path::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;
    use safetensors::Dtype;
    use safetensors::tensor::TensorView;

    /// Writes a file with one tensor of one value.
    fn write(path: &Path, name: &str, value: f32) {
        let bytes = value.to_le_bytes();
        let tensors = [(name, TensorView::new(Dtype::F32, vec![1], &bytes).unwrap())];
        std::fs::write(path, safetensors::serialize(tensors, None).unwrap()).unwrap();
    }

    #[test]
    fn a_folder_and_an_index_are_told_by_their_files() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.safetensors");
        write(&file, "a", 1.0);
        let alone = digest(&file).unwrap();
        assert_eq!(alone, blake3::hash(&std::fs::read(&file).unwrap()).to_hex().as_str());
        assert_eq!(digest(folder.path()).unwrap(), alone);
        // Values in a shard count, although the index stays the same.
        let index = folder.path().join("all.safetensors.index.json");
        write(&folder.path().join("b.safetensors"), "b", 2.0);
        std::fs::write(&index, r#"{"weight_map": {"a": "a.safetensors", "b": "b.safetensors"}}"#).unwrap();
        let before = digest(&index).unwrap();
        assert_eq!(digest(folder.path()).unwrap(), before);
        write(&folder.path().join("b.safetensors"), "b", 3.0);
        assert_ne!(digest(&index).unwrap(), before);
        assert!(digest(&folder.path().join("none")).is_err());
    }
}
