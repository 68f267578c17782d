//! The report's tables and pages, from made-up results.

mod example;

use renderflow::evaluate::results::Results;
use renderflow::report::{self, table};
use renderflow::util::cancel::Cancel;
use renderflow::util::progress::Progress;
use std::collections::BTreeMap;
use std::path::Path;

fn results(folder: &Path) -> Results {
    example::write(folder);
    Results::read(folder).unwrap()
}

/// Pages by file name.
fn pages(results: &Results, out: &Path) -> BTreeMap<String, String> {
    report::build(results, out, &Progress::new("report", 5), &Cancel::default()).unwrap();
    let files = std::fs::read_dir(out).unwrap().map(|entry| entry.unwrap());
    files.map(|f| (f.file_name().into_string().unwrap(), std::fs::read_to_string(f.path()).unwrap())).collect()
}

#[test]
fn means_and_intervals_are_those_computed_by_hand() {
    let folder = tempfile::tempdir().unwrap();
    let results = results(folder.path());
    let means = table::Means::new(&results);
    let synthetic = table::Filter { set: Some("synthetic"), ..Default::default() };
    let rows = means.rows(synthetic);
    let ids: Vec<&str> = rows.iter().map(|row| row.method.id.as_str()).collect();
    assert_eq!(ids, ["ibl", "deferred", "deferred-shadow", "neural", "pt-1", "pt-4", "equal-neural", "warp", "pt-4000ms"]);
    // Frames 1 to 3 of sequences at +1, +3, +2: (20 + 21 + 22) / 3 + (1 + 3 + 2) / 3 less 1.
    let ibl = &rows[0].cells["psnr"];
    assert!((ibl.mean - 22.0).abs() < 1e-12 && ibl.sequences == 3);
    // The mean of three draws from 21, 22, 23 is 21 or 23 in one of 27 draws each: more than 2.5 %, so the interval ends there.
    // For three values Student's t is 4.303 where a normal distribution has 1.96, and the square root of 3 / 2 is 1.225.
    let near =
        |range: Option<[f64; 2]>, expected: [f64; 2]| range.unwrap().iter().zip(expected).all(|(a, b)| (a - b).abs() < 0.01);
    assert!(near(ibl.range, [22.0 - 2.689, 22.0 + 2.689]), "{:?}", ibl.range);
    // Without the third sequence: draws from 31 and 33 are both 31 in a quarter. 12.706 / 1.96 and 1.414.
    let last = &rows[5].cells["psnr"];
    assert!(near(last.range, [32.0 - 9.168, 32.0 + 9.168]), "{:?}", last.range);
    assert_eq!((last.mean, rows[5].sequences), (32.0, 2));
    // Frames 1 to 3 take 11, 12, 13 ms, and their sequences 10, 30, 20 ms more; the last method has 62 ms, and 10 and 30 more.
    assert!((rows[0].seconds.unwrap() - 0.032).abs() < 1e-12 && (rows[5].seconds.unwrap() - 0.082).abs() < 1e-12);
    // The temporal value of frame 0 is missing, and keyframes count nowhere anyway.
    assert!((rows[1].mean("temporal").unwrap() - 0.25).abs() < 1e-12);
    assert!(rows[0].mean("rel_mse").is_none() && rows[1].mean("rel_mse").is_some() && rows[1].mean("lpips_alex").is_none());

    let open = means.rows(table::Filter { class: Some("open"), ..synthetic });
    assert!((open[0].mean("psnr").unwrap() - 21.5).abs() < 1e-12);
    // One sequence has no interval.
    let assets = means.rows(table::Filter { set: Some("assets"), ..Default::default() });
    assert_eq!((assets[0].mean("psnr"), assets[0].cells["psnr"].range), (Some(20.0), None));
    // The same step on every sequence: no doubt about it.
    let change = means.difference(synthetic, "deferred-shadow", "deferred", "psnr").unwrap();
    assert_eq!((change.mean, change.range), (2.0, Some([2.0, 2.0])));
    assert_eq!(table::given(&rows, rows[6].method).unwrap().method.id, "neural");
    assert!(table::given(&rows, rows[5].method).is_none());
    assert_eq!(table::parent(&results.about.methods, rows[2].method).unwrap().id, "deferred");
}

#[test]
fn the_truth_of_keyframes_is_paid_by_who_reads_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut results = results(folder.path());
    let synthetic = table::Filter { set: Some("synthetic"), ..Default::default() };
    let of = |results: &Results| -> Vec<[Option<f64>; 2]> {
        let means = table::Means::new(results);
        means.rows(synthetic).iter().map(|row| [row.seconds, row.seconds_with_truth]).collect()
    };
    let found = of(&results);
    // A keyframe's truth takes 3 s, and serves four frames.
    let [warp, with_truth] = found[7].map(Option::unwrap);
    assert!((warp - 0.102).abs() < 1e-12 && (with_truth - warp - 0.75).abs() < 1e-12, "{found:?}");
    assert!(found.iter().enumerate().all(|(i, [seconds, with_truth])| i == 7 || seconds == with_truth), "{found:?}");
    // The seconds of all frames stand for those of keyframes; where there are none, nothing is said.
    results.sequences[1].about.truth.keyframe_seconds = None;
    let mean = 0.75 - (3.0 - 2.5) / 4.0 / 3.0;
    assert!((of(&results)[7][1].unwrap() - warp - mean).abs() < 1e-12);
    results.sequences[1].about.truth.seconds = None;
    assert_eq!((of(&results)[7], of(&results)[0]), ([Some(warp), None], found[0]));
}

#[test]
fn results_from_before_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let mut expected = results(folder.path());
    for (path, keys) in [("synthetic/open/first.json", &["keyframe_gap"][..]), ("results.json", &[])] {
        let path = folder.path().join(path);
        let mut value: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        let fields = value.as_object_mut().unwrap();
        keys.iter().for_each(|key| assert!(fields.remove(*key).is_some(), "{key}"));
        if let Some(truth) = fields.get_mut("truth") {
            assert!(truth.as_object_mut().unwrap().remove("keyframe_seconds").is_some());
        }
        if let Some(methods) = fields.get_mut("methods").and_then(|methods| methods.as_array_mut()) {
            methods.pop();
            assert!(methods.iter().all(|method| method.get("budget").is_none()), "a field that earlier programs do not know");
        }
        std::fs::write(&path, value.to_string()).unwrap();
    }
    expected.about.methods.pop();
    let first = &mut expected.sequences[1].about;
    (first.keyframe_gap, first.truth.keyframe_seconds) = (None, None);
    assert_eq!(Results::read(folder.path()).unwrap(), expected);
}

/// Methods of version 1 do not say what they read: a table made from their names could be wrong.
#[test]
fn results_of_another_version_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    results(folder.path());
    let path = folder.path().join("results.json");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replacen("\"version\": 2", "\"version\": 1", 1)).unwrap();
    let said = Results::read(folder.path()).unwrap_err().to_string();
    assert!(said.contains("/version: 1 is not 2: evaluate again"), "{said}");
}

#[test]
fn a_sequence_of_keyframes_only_counts_them_all() {
    let folder = tempfile::tempdir().unwrap();
    let mut results = results(folder.path());
    results.sequences.truncate(1);
    results.sequences[0].scores.retain(|score| score.key);
    let means = table::Means::new(&results);
    assert_eq!(means.rows(table::Filter::default())[0].mean("psnr"), Some(100.0));
    // No method is left without a row by values that are not numbers.
    results.sequences[0].scores[0].values.insert("psnr".into(), f64::NAN);
    assert_eq!(table::Means::new(&results).rows(table::Filter::default())[0].mean("psnr"), Some(100.0));
}

#[test]
fn the_terminal_gets_lined_up_markdown() {
    let folder = tempfile::tempdir().unwrap();
    let results = results(folder.path());
    let text = table::markdown(&results, table::Filter { set: Some("synthetic"), without_ablations: true, ..Default::default() });
    let lines: Vec<&str> = text.lines().filter(|line| line.starts_with('|')).collect();
    let widths: std::collections::BTreeSet<usize> = lines.iter().map(|line| line.chars().count()).collect();
    assert_eq!((lines.len(), widths.len()), (10, 1), "{text}");
    assert!(text.starts_with("synthetic: 3 sequences, 9 frames\n"), "{text}");
    let ibl: Vec<&str> = lines[2].split('|').map(str::trim).collect();
    assert_eq!(
        ibl[1..],
        ["IBL", "22.00", "19.31 to 24.69", "0.5000", "-", "0.5000", "23.00", "-", "0.50", "0.0320", "0.0320", ""]
    );
    let whole = table::markdown(&results, table::Filter::default());
    assert!(whole.contains("Path tracing in the time of Neural (8 spp)"), "{whole}");
    assert!(whole.contains("Path tracing in 4 s (8 spp)") && whole.contains("| s/frame with truth |"), "{whole}");
    assert!(whole.contains("assets: 1 sequence, 3 frames") && whole.contains("Deferred without shadow"), "{whole}");
}

#[test]
fn pages_hold_what_they_must_and_ask_for_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let results = results(folder.path());
    // The test in the browser looks at the same pages.
    let kept = std::env::var_os("RENDERFLOW_REPORT_OUT").map(std::path::PathBuf::from);
    let out = kept.unwrap_or_else(|| folder.path().join("report"));
    let pages = pages(&results, &out);
    let names: Vec<&str> = pages.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        [
            "assets-foliage-leaves.html",
            "index.html",
            "synthetic-open-first.html",
            "synthetic-open-third.html",
            "synthetic-rooms___halls-second_____.html",
        ]
    );
    for (name, page) in &pages {
        assert!(page.starts_with("<!doctype html>") && page.ends_with("</html>\n"), "{name}");
        for outside in ["http://", "https://", "src=\"//", "@import", "url(", "fetch("] {
            assert!(!page.contains(outside), "{name} asks for {outside}");
        }
        assert!(!page.contains("<script>x") && !page.contains("<b>") && !page.contains("NaN"), "{name}");
        assert!(page.contains("a &lt;b&gt; &amp; &quot;c&quot; &#39;d&#39; &lt;/script&gt;"), "{name}");
        // Every link leads to a page or a place on this one.
        for link in page.split("href=\"").skip(1).filter_map(|rest| rest.split('"').next()).filter(|link| *link != "data:,") {
            let there = link.strip_prefix('#').map_or(pages.contains_key(link), |id| page.contains(&format!("id=\"{id}\"")));
            assert!(there, "{name}: {link}");
        }
    }
    let index = &pages["index.html"];
    for text in [
        "Example &lt;results&gt;",
        "Error against time",
        "Error and flicker against all seconds",
        "temporal against seconds a frame with truth",
        "Table of the budgets",
        "s/frame with truth",
        "Convergence of path tracing",
        "What parts are worth",
        "The truth&#39;s own error",
        "By class of scene",
        "2 of 3 sequences",
        "22.00<small>19.31 to 24.69</small>",
        "a processor, 4 threads",
        // 92 ms where the network takes 62.
        "1.48 x given",
        // 112 ms where the budget is 93.75.
        "1.19 x given",
    ] {
        assert!(index.contains(text) || index.contains(&text.replace("&#39;", "'")), "{text}");
    }
    // 1 set of 1 sequence and 1 of 3: a card each with its thumbnail. Above them stand the truth and the best of three kinds.
    assert_eq!(index.matches("<li><a href=").count(), 4);
    let before = index.split("<nav").next().unwrap();
    assert_eq!(before.matches("src=\"data:image/png;base64,").count(), 4);
    assert_eq!(index.matches("src=\"data:image/png;base64,").count(), 4 + 4);
    assert!(before.contains("<figcaption>Truth</figcaption>") && before.contains(" dB</figcaption>"), "{before}");
    // One row with keyframes is no best of many.
    assert!(before.contains("path tracing, <em>Neural</em> is best") && before.contains("<em>Warped</em> scores"), "{before}");
    // The first click on PSNR puts the best on top; on seconds too.
    assert!(index.contains("data-first=\"descending\"><button type=\"button\" title=\"") && index.contains("less is better\">"));
    // So does the first click where changes are sorted.
    let changes = index.split("What parts are worth").nth(1).unwrap();
    assert!(changes.contains("data-first=\"descending\"><button type=\"button\" title=\"dB over pixels"));
    assert!(changes.contains("sorts by the change; more is better\""));
    let page = &pages["synthetic-open-first.html"];
    // Both halves of the picture carry their names.
    assert!(page.contains("id=\"left-name\"") && page.contains("id=\"right-name\""));
    let data = page.split("id=\"data\">").nth(1).unwrap().split("</script>").next().unwrap();
    let data: serde_json::Value = serde_json::from_str(data).unwrap();
    assert_eq!(data["frames"], serde_json::json!([0, 1, 2, 3, 4]));
    assert_eq!(data["methods"].as_array().unwrap().len(), 10);
    assert_eq!(data["methods"][2][1], example::NASTY);
    assert_eq!(data["psnr"]["1"]["ibl"], "20.00 dB");
    // Pictures are the files, byte for byte.
    let file = results.sequences.iter().find(|s| s.about.name == "first").unwrap().pictures.join("0003.neural.png");
    assert_eq!(data["pictures"]["3"]["neural"], renderflow::util::picture::base64(&std::fs::read(file).unwrap()));
}

#[test]
fn the_same_results_make_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let results = results(folder.path());
    assert!(pages(&results, &folder.path().join("a")) == pages(&results, &folder.path().join("b")));
}

#[test]
fn what_is_missing_or_damaged_is_met() {
    let folder = tempfile::tempdir().unwrap();
    let mut results = results(folder.path());
    let out = folder.path().join("report");
    // A sequence whose pictures are gone still has a page.
    std::fs::remove_dir_all(&results.sequences[0].pictures).unwrap();
    assert!(pages(&results, &out)["assets-foliage-leaves.html"].contains("No pictures were kept."));
    let damaged = results.sequences[1].pictures.join("0002.truth.png");
    std::fs::write(&damaged, b"not a picture").unwrap();
    let progress = Progress::new("report", 5);
    let error = report::build(&results, &out, &progress, &Cancel::default()).unwrap_err();
    assert!(error.to_string().contains(damaged.to_str().unwrap()), "{error:#}");
    let stopped = Cancel::default();
    stopped.set();
    let error = report::build(&results, &out, &progress, &stopped).unwrap_err();
    assert!(error.is::<renderflow::util::cancel::Interrupted>());
    results.sequences.clear();
    assert!(report::build(&results, &out, &progress, &Cancel::default()).is_err());
}
