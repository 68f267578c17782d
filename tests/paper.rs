//! `renderflow paper --smoke`: every table is made, nothing is made twice, and a stop loses nothing.

mod common;

use clap::ValueEnum;
use common::{renderflow, stderr};
use renderflow::paper::Part;
use serde_json::Value;
use std::path::{Path, PathBuf};

fn smoke(out: &Path, words: &[&str]) -> Value {
    let output = renderflow(&[&["paper", "--smoke", "--json", "-q", "-o", out.to_str().unwrap()][..], words].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Label, and the first number of a row.
fn first(row: &Value) -> (&str, Option<f64>) {
    (row["label"].as_str().unwrap(), row["values"]["psnr_full"]["mean"].as_f64())
}

#[test]
fn every_table_is_made_once() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("paper");
    // Two tables first, as if the rest had been stopped.
    let some = smoke(&out, &["--only", "steps,strategies"]);
    assert_eq!(some.as_array().unwrap().len(), 2);
    let weights = out.join("runs");
    let kept = common::files(&weights);
    let all = smoke(&out, &[]);
    let tables = all.as_array().unwrap();
    assert_eq!(tables.len(), Part::value_variants().len());
    // What was there has stayed to the byte.
    let now = common::files(&weights);
    for (name, bytes) in &kept {
        assert!(now.iter().any(|(other, same)| other == name && same == bytes), "{name} was made again");
    }
    let table = |title: &str| tables.iter().find(|table| table["title"] == title).unwrap_or_else(|| panic!("{title}"));
    let rows = |title: &str| table(title)["rows"].as_array().unwrap().clone();
    for (title, count) in [
        ("Methods", 16),
        ("Inverse rendering", 3),
        ("Training strategies", 5),
        ("Losses on pictures", 3),
        ("Keyframe adapters", 10),
        ("What the bridge begins with", 5),
        ("Distances between keyframes", 8),
        ("Steps", 3),
        ("Determinism", 4),
        ("A long sequence", 6),
        ("The same seconds", 28),
        ("High dynamic range and flicker", 12),
        ("Scenes that were learnt from", 10),
        ("Seconds by size", 4),
        ("Data and time", 5),
    ] {
        assert_eq!(rows(title).len(), count, "{title}");
    }
    // The same weights and the same question give the same number wherever they stand.
    let [base, one] = [rows("Training strategies")[4].clone(), rows("Steps")[0].clone()];
    assert_eq!(first(&base).1, first(&one).1);
    assert_eq!(first(&rows("Losses on pictures")[2]).1, first(&one).1);
    for row in rows("Methods").iter().filter(|row| !row["label"].as_str().unwrap().starts_with("path tracing")) {
        let (label, psnr) = first(row);
        assert!(psnr.is_some_and(|psnr| psnr > 3.0), "{label}: {row}");
    }
    // Keyframes are where the row says. They are the truth itself, which helps the mean error and does not drown it.
    let gaps = rows("Distances between keyframes");
    let of = |label: &str| gaps.iter().find(|row| row["label"] == label).unwrap_or_else(|| panic!("{label}"));
    let [two, three] = ["warped keyframes, no network, 2", "warped keyframes, no network, 3"].map(of);
    let mean = |row: &Value, id: &str| row["values"][id]["mean"].as_f64().unwrap();
    assert_ne!(mean(two, "psnr_full"), mean(three, "psnr_full"));
    for row in [two, three] {
        let (all, between) = (mean(row, "psnr_all"), mean(row, "psnr_full"));
        assert!(all > between && all < between + 10.0, "{row}");
    }
    // The paper's network sees the same keyframes.
    let [two, three] = ["RenderFlow, 2", "RenderFlow, 3"].map(of);
    assert_ne!(mean(two, "psnr_all"), mean(three, "psnr_all"));
    // Bridges from the albedo do not depend on the seed; those from noise do.
    let notes: Vec<String> = rows("Determinism").iter().map(|row| row["note"].as_str().unwrap().to_owned()).collect();
    assert!(notes[..2].iter().all(|note| note.contains("the same bits")), "{notes:?}");
    assert!(notes[2..].iter().all(|note| note.contains("another picture")), "{notes:?}");
    let text = std::fs::read_to_string(out.join("paper.md")).unwrap();
    for words in
        ["24.214 / .874 / .113", "20.984 / .793 / .165", "these numbers mean nothing", "determinism.svg", "cube-color.png"]
    {
        assert!(text.contains(words), "{words} is not in\n{text}");
    }
    for name in ["determinism.svg", "progressive.svg", "cone-roughness.png", "cone-roughness.gif", "paper.json"] {
        assert!(out.join(name).is_file(), "{name}");
    }
    // Again: the same tables, from what is kept.
    let before = common::files(&out.join("rows"));
    assert!(before.iter().any(|(name, _)| name.contains("inverse-")), "recovered buffers are measured again");
    assert_eq!(smoke(&out, &[]), all);
    assert!(before == common::files(&out.join("rows")));
}

/// An autoencoder that was trained elsewhere gives the rows that it gives where it was trained.
#[test]
fn rows_stand_on_the_autoencoder_that_is_given() {
    let folder = tempfile::tempdir().unwrap();
    let (here, there) = (folder.path().join("here"), folder.path().join("there"));
    let rows = |tables: Value| tables[0]["rows"].as_array().unwrap().iter().map(|row| first(row).1).collect::<Vec<_>>();
    let trained = rows(smoke(&here, &["--only", "losses"]));
    let runs = |out: &Path| -> Vec<PathBuf> {
        let of = |entry: std::io::Result<std::fs::DirEntry>| entry.unwrap().path();
        let name = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().starts_with("autoencoder");
        std::fs::read_dir(out.join("runs")).unwrap().map(of).filter(name).collect()
    };
    // Weights of the same header and other values make other rows, of the same training runs.
    let folders = |name: &str| std::fs::read_dir(here.join(name)).unwrap().count();
    let [rows_before, runs_before] = ["rows", "runs"].map(folders);
    let mut bytes = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/model/weights/fusion.safetensors")).unwrap();
    let last = bytes.len() - 2;
    bytes[last] ^= 1;
    let other = folder.path().join("other.safetensors");
    std::fs::write(&other, bytes).unwrap();
    smoke(&here, &["--only", "losses", "--weights", other.to_str().unwrap()]);
    assert_eq!(["rows", "runs"].map(folders), [2 * rows_before, runs_before]);

    let weights = runs(&here)[0].join("weights.safetensors");
    let words = ["--only", "losses", "--vae", weights.to_str().unwrap()];
    assert_eq!(rows(smoke(&there, &words)), trained);
    let given = runs(&there);
    assert_eq!(given.len(), 1);
    assert!(std::fs::read(given[0].join("weights.safetensors")).unwrap() == std::fs::read(&weights).unwrap());
    assert!(!given[0].join("log.jsonl").exists(), "it was trained again");
    let text = std::fs::read_to_string(there.join("paper.md")).unwrap();
    assert!(text.contains("The autoencoder is given."), "{text}");

    // It is too small for the whole experiments, which say so before they make anything.
    let whole = folder.path().join("whole");
    let output = renderflow(&["paper", "-o", whole.to_str().unwrap(), "--vae", weights.to_str().unwrap()]);
    assert!(!output.status.success() && stderr(&output).contains("of another preset than wan-small"), "{}", stderr(&output));
    assert!(!whole.exists());
}

#[test]
fn folders_of_other_things_and_impossible_times_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mine = folder.path().join("mine.txt");
    std::fs::write(&mine, "mine").unwrap();
    let mine = mine.to_str().unwrap();
    let out = folder.path().to_str().unwrap();
    let missing = folder.path().join("no-weights");
    let missing = missing.to_str().unwrap();
    for (words, said) in [
        (&["--smoke"][..], "not empty"),
        (&["--minutes", "0"], "not a positive number"),
        (&["--minutes", "nan"], "not a positive number"),
        (&["--smoke", "--minutes", "3"], "cannot be used with"),
        (&["--resolution", "100"], "no multiple of 32"),
        (&["--only", "nothing"], "invalid value"),
        (&["--smoke", "--weights", missing], "no-weights"),
        (&["--smoke", "--vae", missing], "no-weights"),
        (&["--smoke", "--vae", mine], "not a safetensors file"),
    ] {
        let output = renderflow(&[&["paper", "-o", out][..], words].concat());
        assert!(!output.status.success() && stderr(&output).contains(said), "{words:?}: {}", stderr(&output));
    }
    assert_eq!(common::files(folder.path()).len(), 1);
}
