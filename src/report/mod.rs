//! The report of an evaluation: pages that need nothing but themselves.
//!
//! [`build`] makes `index.html` and a page a sequence from a results folder; [`table`] computes the rows, for terminals too.

mod ablation;
mod charts;
mod html;
mod index;
pub mod picture;
mod place;
mod plot;
mod sequence;
mod style;
mod summary;
pub mod table;

use crate::evaluate::results::Results;
use crate::progress::Progress;
use crate::truth::Interrupted;
use anyhow::{Result, ensure};
use renderflow_frame::file;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// What the pages are made from.
struct View<'a> {
    results: &'a Results,
    means: table::Means<'a>,
    /// Colours of methods.
    palette: style::Palette,
    /// File name of each sequence's page.
    pages: Vec<String>,
}

/// Writes `out/index.html` and a page for each sequence; a unit of progress each. The same results make the same bytes.
///
/// # Errors
/// When there is no sequence, a picture is damaged, a file cannot be written, or with [`Interrupted`].
pub fn build(results: &Results, out: &Path, progress: &Progress, cancel: &AtomicBool) -> Result<()> {
    ensure!(!results.sequences.is_empty(), "no sequence is complete: nothing to report");
    let view = View {
        results,
        means: table::Means::new(results),
        palette: style::Palette::new(&results.about.methods),
        pages: page_names(results),
    };
    for number in 0..results.sequences.len() {
        if cancel.load(Ordering::Relaxed) {
            return Err(Interrupted.into());
        }
        progress.message(view.pages[number].clone());
        file::write_atomic(&out.join(&view.pages[number]), sequence::html(&view, number)?.as_bytes())?;
        progress.add(1);
    }
    // Written last: whoever opens it finds all that it links to.
    file::write_atomic(&out.join("index.html"), index::html(&view)?.as_bytes())?;
    progress.add(1);
    Ok(())
}

/// `<set>-<class>-<sequence>.html`, with what file names and addresses cannot hold replaced, and none twice.
fn page_names(results: &Results) -> Vec<String> {
    let mut taken = BTreeSet::from(["index.html".to_owned()]);
    let name = |scored: &crate::evaluate::results::Scored| {
        let about = &scored.about;
        let whole = format!("{}-{}-{}", about.set, about.class, about.name);
        let safe = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' };
        let stem: String = whole.chars().map(safe).collect();
        let names = std::iter::once(format!("{stem}.html")).chain((2..).map(|n| format!("{stem}-{n}.html")));
        // File systems may not tell capitals.
        names.into_iter().find(|name| taken.insert(name.to_lowercase())).unwrap_or_default()
    };
    results.sequences.iter().map(name).collect()
}
