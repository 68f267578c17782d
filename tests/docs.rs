//! What readers are told: links lead somewhere, the README stays short, comments keep to the page.

use std::path::{Path, PathBuf};
use std::process::Command;

/// Most lines of the README.
const README_LINES: usize = 150;
/// Most columns of a comment line: `max_width` of rustfmt, which does not wrap comments.
const COLUMNS: usize = 130;

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Files that git tracks, or would track, with this ending; `None` outside a clone.
fn files(ending: &str) -> Option<Vec<PathBuf>> {
    let list = ["ls-files", "--cached", "--others", "--exclude-standard", "-z"];
    let output = Command::new("git").args(list).current_dir(root()).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let files: Vec<_> = text.split('\0').filter(|name| name.ends_with(ending)).map(|name| root().join(name)).collect();
    let files: Vec<_> = files.into_iter().filter(|path| path.is_file()).collect();
    (output.status.success() && !files.is_empty()).then_some(files)
}

/// Targets of the links and pictures of a Markdown page, with their lines; code is skipped.
fn links(text: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    let mut code = false;
    for (i, line) in text.lines().enumerate() {
        if line.trim_start().starts_with("```") {
            code = !code;
        }
        let prose: String = line.split('`').step_by(2).collect::<Vec<_>>().join("");
        if code {
            continue;
        }
        for part in prose.split("](").skip(1) {
            if let Some((target, _)) = part.split_once(')') {
                found.push((i + 1, target.to_owned()));
            }
        }
    }
    found
}

/// Names of the headings of a page, as links name them.
fn anchors(text: &str) -> Vec<String> {
    let headings = text.lines().filter(|line| line.starts_with('#'));
    let name = |line: &str| {
        let title = line.trim_start_matches('#').trim().to_lowercase();
        let kept = title.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
        kept.map(|c| if c == ' ' { '-' } else { c }).collect()
    };
    headings.map(name).collect()
}

/// Why a link of the page `page` with the text `text` leads nowhere.
fn broken(page: &Path, text: &str, target: &str) -> Option<String> {
    if target.contains("://") || target.starts_with("mailto:") {
        return None;
    }
    let (file, anchor) = target.split_once('#').map_or((target, None), |(file, anchor)| (file, Some(anchor)));
    let path = if file.is_empty() { page.to_owned() } else { page.parent()?.join(file) };
    if !path.exists() {
        return Some(format!("{target} does not exist"));
    }
    let anchor = anchor?;
    let other = if file.is_empty() { text.to_owned() } else { std::fs::read_to_string(&path).ok()? };
    (!anchors(&other).iter().any(|name| name == anchor)).then(|| format!("{target}: the page has no such heading"))
}

#[test]
fn links_lead_somewhere() {
    let Some(pages) = files(".md") else {
        println!("skipped: this is no clone of the repository");
        return;
    };
    let mut faults = Vec::new();
    for page in pages {
        let text = std::fs::read_to_string(&page).unwrap();
        for (line, target) in links(&text) {
            faults.extend(broken(&page, &text, &target).map(|fault| format!("{}:{line}: {fault}", page.display())));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn pages_of_the_book_are_in_its_summary() {
    let summary = std::fs::read_to_string(root().join("docs/SUMMARY.md")).unwrap();
    let listed: Vec<PathBuf> = links(&summary).into_iter().map(|(_, target)| root().join("docs").join(target)).collect();
    let Some(pages) = files(".md") else { return };
    let pages = pages.into_iter().filter(|page| page.starts_with(root().join("docs")) && !page.ends_with("SUMMARY.md"));
    let missing: Vec<_> = pages.filter(|page| !listed.contains(page)).collect();
    assert!(missing.is_empty(), "docs/SUMMARY.md does not list {missing:?}");
}

#[test]
fn the_readme_is_short() {
    let readme = std::fs::read_to_string(root().join("README.md")).unwrap();
    let lines = readme.lines().count();
    assert!(lines <= README_LINES, "README.md has {lines} lines, at most {README_LINES} are wanted");
}

#[test]
fn comments_keep_to_the_page() {
    let Some(sources) = files(".rs") else { return };
    let mut faults = Vec::new();
    for path in sources {
        let text = std::fs::read_to_string(&path).unwrap();
        // A row of a table is one line.
        let wraps = |line: &str| {
            let text = line.trim_start();
            text.starts_with("//") && !text.trim_start_matches(['/', '!', ' ']).starts_with('|')
        };
        let long = text.lines().enumerate().filter(|(_, line)| wraps(line) && line.chars().count() > COLUMNS);
        faults.extend(long.map(|(i, line)| format!("{}:{}: {} columns", path.display(), i + 1, line.chars().count())));
    }
    assert!(faults.is_empty(), "comments over {COLUMNS} columns:\n{}", faults.join("\n"));
}
