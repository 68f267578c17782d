//! `render --reference`: the error of a picture while its samples double.

mod common;

use common::{renderflow, stderr, succeed};
use renderflow_frame::exr;
use std::path::Path;

#[test]
fn a_reference_prints_the_error_at_every_doubling_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let words = |resolution: &str, spp: &str, out: &str, more: &[&str]| -> Vec<String> {
        let common = ["render", "--seed", "3", "--frames", "1", "--denoise", "none"];
        let given = ["--resolution", resolution, "--spp", spp, "--out", out];
        common.iter().chain(&given).chain(more).map(|w| (*w).to_owned()).collect()
    };
    let render = |words: Vec<String>| succeed(&words.iter().map(String::as_str).collect::<Vec<_>>());
    let fail = |words: Vec<String>| {
        let output = renderflow(&words.iter().map(String::as_str).collect::<Vec<_>>());
        assert!(!output.status.success());
        stderr(&output)
    };
    render(words("24", "64", &path("reference"), &[]));
    let reference = path("reference/frame.0000.exr");
    render(words("24", "12", &path("plain"), &[]));
    let table = render(words("24", "12", &path("watched"), &["--reference", &reference]));

    // Rows of 2, 4, 8 and 12 samples, two of which share a camera ray, with errors that fall.
    let rows: Vec<Vec<f64>> = table
        .lines()
        .map(|line| line.split_whitespace().map(str::parse).collect::<Result<Vec<f64>, _>>())
        .filter_map(Result::ok)
        .filter(|row| row.len() == 7)
        .collect();
    assert_eq!(rows.iter().map(|r| r[0]).collect::<Vec<_>>(), [2.0, 4.0, 8.0, 12.0], "{table}");
    assert!(rows.windows(2).all(|pair| pair[1][1] > pair[0][1]), "seconds grow: {table}");
    // The trimmed error: one bright sample decides the other in a picture of 24 x 24 pixels.
    assert!(rows[3][4] < 0.5 * rows[0][4] && rows[3][6] > rows[0][6], "{table}");
    for file in ["frame.0000.exr", "frame.0000.png"] {
        let [a, b] = ["plain", "watched"].map(|out| std::fs::read(folder.path().join(out).join(file)).unwrap());
        assert!(a == b, "{file}");
    }

    // Of frames that are there already, and against display values and plain radiance.
    let again = render(words("24", "12", &path("watched"), &["--reference", &reference]));
    assert!(again.lines().any(|line| line.split_whitespace().take(3).eq(["12", "-", "-"])), "{again}");
    render(words("24", "1", &path("display"), &["--reference", &path("reference/frame.0000.png")]));
    let raw = exr::read(Path::new(&reference)).unwrap().raw.unwrap();
    ::exr::prelude::write_rgb_file(path("rgb.exr"), 24, 24, |x, y| {
        let [r, g, b] = *raw.at(x, y);
        (r, g, b)
    })
    .unwrap();
    let other = render(words("24", "12", &path("plain"), &["--reference", &path("rgb.exr")]));
    let errors = |text: &str| {
        text.lines()
            .find(|l| l.trim_start().starts_with("12 "))
            .map(|l| l.split_whitespace().skip(3).map(str::to_owned).collect::<Vec<_>>())
    };
    assert_eq!(errors(&other), errors(&again));

    // Samples spread by need have no parts: one line.
    let adaptive = render(words("24", "16", &path("adaptive"), &["--adaptive", "--reference", &reference]));
    let numbers = |line: &&str| line.split_whitespace().filter(|word| word.parse::<f64>().is_ok()).count() == 7;
    assert_eq!(adaptive.lines().filter(numbers).count(), 1, "{adaptive}");

    let small = fail(words("16", "4", &path("small"), &["--reference", &reference]));
    assert!(small.contains("24 x 24") && small.contains("16 x 16"), "{small}");
    assert!(!folder.path().join("small").exists());
    let missing = fail(words("24", "4", &path("small"), &["--reference", &path("nowhere.exr")]));
    assert!(missing.contains("nowhere.exr"), "{missing}");
    ::exr::prelude::write_rgb_file(path("nan.exr"), 24, 24, |x, y| (if (x, y) == (5, 7) { f32::NAN } else { 1.0 }, 1.0, 1.0))
        .unwrap();
    let broken = fail(words("24", "4", &path("small"), &["--reference", &path("nan.exr")]));
    assert!(broken.contains("(5, 7)"), "{broken}");
    let mut many = words("24", "4", &path("small"), &["--reference", &reference]);
    many[4] = "3".into();
    assert!(fail(many).contains("--frames 1"));
}
