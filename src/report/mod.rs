//! The report of an evaluation: pages that need no other files.
//!
//! [`build`] makes `index.html` and a page for each sequence from a results folder; [`table`] computes the rows, also for
//! terminals.

mod ablation;
mod charts;
pub mod dataset;
pub(crate) mod html;
mod index;
mod place;
pub mod plot;
mod sequence;
pub mod steps;
mod style;
mod summary;
pub mod table;

use crate::evaluate::results::Results;
use crate::util::cancel::Cancel;
use crate::util::output;
use crate::util::progress::Progress;
use anyhow::{Context, Result, ensure};
use renderflow_frame::file::Draft;
use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The first page of a report.
const INDEX: &str = "index.html";

/// Everything that the pages are made from.
struct View<'a> {
    results: &'a Results,
    means: table::Means<'a>,
    /// Colours of methods.
    palette: style::Palette,
    /// File name of each sequence's page.
    pages: Vec<String>,
}

/// Writes `out/index.html` and a page for each sequence; each page is a unit of progress. The same results give the same bytes.
/// Pages are renamed to their places together, once all are made.
///
/// # Errors
/// When there is no sequence, when a picture is damaged, when another file has the name of a page, when a file cannot be written,
/// or when stopped.
pub fn build(results: &Results, out: &Path, progress: &Progress, cancel: &Cancel) -> Result<()> {
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
        cancel.check()?;
        progress.message(view.pages[number].clone());
        drafts.push(written(place, sequence::html(&view, number)?)?);
        progress.add(1);
    }
    // The index comes last, so that everything it links to is there when somebody opens it.
    drafts.push(written(&index, index::html(&view)?)?);
    progress.add(1);
    drafts.into_iter().try_for_each(|draft| Ok(draft.finish()?))
}

/// `<set>-<class>-<sequence>.html`, without characters that file names and addresses cannot hold, and without repeats.
fn page_names(results: &Results) -> Vec<String> {
    let mut taken = BTreeSet::from([INDEX.to_owned()]);
    let name = |scored: &crate::evaluate::results::Scored| {
        let about = &scored.about;
        let whole = format!("{}-{}-{}", about.set, about.class, about.name);
        let safe = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' };
        let stem: String = whole.chars().map(safe).collect();
        let names = std::iter::once(format!("{stem}.html")).chain((2..).map(|n| format!("{stem}-{n}.html")));
        // Some file systems ignore case.
        names.into_iter().find(|name| taken.insert(name.to_lowercase())).unwrap_or_default()
    };
    results.sequences.iter().map(name).collect()
}
