//! `renderflow render` with what it does only when asked.

mod common;

use common::{renderflow, stderr, succeed};
use renderflow_frame::exr;

#[test]
fn light_groups_sum_to_raw_and_irradiance_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let common = |out: &str| {
        let words =
            ["render", "--seed", "3", "--frames", "1", "--resolution", "32", "--spp", "8", "--denoise", "none", "--out", out];
        words.map(str::to_owned).to_vec()
    };
    let render = |out: &str, more: &[&str]| {
        let all: Vec<String> = common(&path(out)).into_iter().chain(more.iter().map(|w| (*w).to_owned())).collect();
        succeed(&all.iter().map(String::as_str).collect::<Vec<_>>());
        exr::read(&folder.path().join(out).join("frame.0000.exr")).unwrap()
    };
    let plain = render("plain", &[]);
    assert!(plain.light.iter().all(Option::is_none) && plain.irradiance.is_none());
    assert_eq!(plain.info.bsdf, "conserving");

    let split = render("split", &["--light-groups", "5", "--irradiance"]);
    assert_eq!(split.light.iter().flatten().count(), 5);
    let irradiance = split.irradiance.as_ref().unwrap();
    assert!(irradiance.pixels.iter().flatten().any(|v| *v > 0.0));
    // Groups cost nothing in the picture.
    assert_eq!(plain.raw, split.raw);
    let raw = split.raw.as_ref().unwrap();
    for (i, pixel) in raw.pixels.iter().enumerate() {
        for (c, whole) in pixel.iter().enumerate() {
            let sum: f32 = split.light.iter().flatten().map(|group| group.pixels[i][c]).sum();
            // Six half-precision roundings.
            assert!((sum - whole).abs() <= 6.0 * 2f32.powi(-11) * whole + 1e-6, "pixel {i}: {sum} of {whole}");
        }
    }

    let published = render("published", &["--bsdf", "published"]);
    assert_eq!(published.info.bsdf, "published");
    assert_ne!(published.raw, plain.raw);

    // A folder is of one form of the BRDF.
    let again: Vec<String> = common(&path("plain")).into_iter().chain(["--bsdf".into(), "published".into()]).collect();
    let refused = renderflow(&again.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(!refused.status.success() && stderr(&refused).contains("other settings"), "{}", stderr(&refused));
}
