//! Where Embree is.

use crate::embree::Embree;
use anyhow::{Context, Result};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Names the library by its path.
const VARIABLE: &str = "RENDERFLOW_EMBREE";

/// Prints the folder that wheels of embreex keep their libraries in. The package itself is not run.
const ASK: &str =
    "import importlib.util as u, os\ns = u.find_spec('embreex')\nprint(os.path.dirname(os.path.dirname(s.origin)) if s else '')";

/// Embree at `named`, or where the environment says, or in the package embreex of `python`, or the system's version 4 or 3.
/// `None`, with a line that says so, where there is none.
///
/// # Errors
/// When it was named and cannot be used.
pub fn embree(named: Option<&Path>, python: &str) -> Result<Option<Embree>> {
    let named = named.map(Path::to_owned).or_else(|| std::env::var_os(VARIABLE).map(PathBuf::from));
    if let Some(path) = named {
        let embree = Embree::open(&path).context("Embree")?;
        println!("Embree {}: {}", embree.version(), path.display());
        return Ok(Some(embree));
    }
    let places = packaged(python).into_iter().chain(["libembree4.so.4", "libembree3.so.3"].map(PathBuf::from));
    let Some((place, embree)) = places.into_iter().find_map(|path| Embree::open(&path).ok().map(|e| (path, e))) else {
        println!(
            "skipped Embree: not found (pip install embreex==4.4.0.post1 for {python}, or name its library by --embree or {VARIABLE})"
        );
        return Ok(None);
    };
    println!("Embree {}: {}", embree.version(), place.display());
    if !embree.version().starts_with("4.") {
        println!("note: this is not Embree 4, which is faster");
    }
    Ok(Some(embree))
}

/// The library in the Python package embreex.
fn packaged(python: &str) -> Option<PathBuf> {
    let output = Command::new(python).args(["-c", ASK]).stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    let folder = String::from_utf8(output.stdout).ok()?;
    let folder = Path::new(folder.trim());
    if folder.as_os_str().is_empty() {
        return None;
    }
    let entries = std::fs::read_dir(folder.join("embreex.libs")).ok()?;
    entries.flatten().map(|e| e.path()).find(|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with("libembree4") && name.contains(".so")
    })
}
