//! The report of an evaluation: pages that need nothing but themselves.
//!
//! [`build`] makes `index.html` and a page a sequence from a results folder; [`table`] computes the rows, for terminals too.

mod ablation;
mod charts;
pub(crate) mod html;
mod index;
pub mod picture;
mod place;
pub mod plot;
mod sequence;
mod style;
mod summary;
pub mod table;

use crate::evaluate::results::Results;
use crate::output;
use crate::progress::Progress;
use crate::truth::Interrupted;
use anyhow::{Context, Result, ensure};
use renderflow_frame::file::Draft;
use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// The page one opens.
const INDEX: &str = "index.html";

/// What the pages are made from.
struct View<'a> {
    results: &'a Results,
    means: table::Means<'a>,
    /// Colours of methods.
    palette: style::Palette,
    /// File name of each sequence's page.
    pages: Vec<String>,
}

/// Writes `out/index.html` and a page for each sequence; a unit of progress each. The same results make the same bytes. The pages
/// are put at their places together, once all are made.
///
/// # Errors
/// When there is no sequence, a picture is damaged, another file has the name of a page, a file cannot be written, or with
/// [`Interrupted`].
pub fn build(results: &Results, out: &Path, progress: &Progress, cancel: &AtomicBool) -> Result<()> {
    ensure!(!results.sequences.is_empty(), "no sequence is complete: nothing to report");
    let view = View {
        results,
        means: table::Means::new(results),
        palette: style::Palette::new(&results.about.methods),
        pages: page_names(results),
    };
    let index = out.join(INDEX);
    let places: Vec<PathBuf> = view.pages.iter().map(|page| out.join(page)).collect();
    places.iter().chain([&index]).try_for_each(|place| output::check_page(place))?;
    let written = |place: &Path, page: String| -> Result<Draft> {
        let mut draft = Draft::new(place)?;
        draft.write_all(page.as_bytes()).with_context(|| format!("{}: cannot write", place.display()))?;
        draft.close()?;
        Ok(draft)
    };
    let mut drafts = Vec::with_capacity(places.len() + 1);
    for (number, place) in places.iter().enumerate() {
        if cancel.load(Ordering::Relaxed) {
            return Err(Interrupted.into());
        }
        progress.message(view.pages[number].clone());
        drafts.push(written(place, sequence::html(&view, number)?)?);
        progress.add(1);
    }
    // Last: whoever opens it finds all that it links to.
    drafts.push(written(&index, index::html(&view)?)?);
    progress.add(1);
    drafts.into_iter().try_for_each(|draft| Ok(draft.finish()?))
}

/// `<set>-<class>-<sequence>.html`, with what file names and addresses cannot hold replaced, and none twice.
fn page_names(results: &Results) -> Vec<String> {
    let mut taken = BTreeSet::from([INDEX.to_owned()]);
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
