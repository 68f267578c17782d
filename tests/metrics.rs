//! PSNR and SSIM against scikit-image (numbers from `tests/references/skimage_metrics.py`).

use renderflow::metrics::{psnr::psnr, ssim::ssim};
use renderflow_frame::image::Rgb;
use serde::Deserialize;

#[derive(Deserialize)]
struct Reference {
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    width: usize,
    height: usize,
    noise: f64,
    psnr: f64,
    ssim: f64,
}

/// The pictures of the script: a ramp mixed with a linear congruential generator.
fn picture(width: usize, height: usize, seed: u32, smooth: f64) -> Rgb {
    let mut state = seed;
    Rgb::from_fn(width, height, |x, y| {
        let ramp = ((x * 3 + y * 5) % 64) as f64 / 64.0;
        [0; 3].map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (smooth * ramp + (1.0 - smooth) * f64::from(state >> 8) / f64::from(1 << 24)) as f32
        })
    })
}

#[test]
fn equal_to_scikit_image() {
    let reference: Reference = serde_json::from_str(include_str!("references/skimage_metrics.json")).unwrap();
    assert!(reference.cases.len() >= 6);
    for case in reference.cases {
        let a = picture(case.width, case.height, 1, 1.0 - case.noise / 2.0);
        let b = picture(case.width, case.height, 2, 1.0 - case.noise);
        let (p, s) = (psnr(&a, &b), ssim(&a, &b).unwrap());
        assert!((p - case.psnr).abs() < 1e-4, "{}x{}: PSNR {p} against {}", case.width, case.height, case.psnr);
        assert!((s - case.ssim).abs() < 1e-4, "{}x{}: SSIM {s} against {}", case.width, case.height, case.ssim);
    }
}

#[test]
fn edge_cases() {
    let a = picture(16, 16, 3, 0.5);
    assert_eq!(psnr(&a, &a), f64::INFINITY);
    assert!((ssim(&a, &a).unwrap() - 1.0).abs() < 1e-12);
    assert_eq!(ssim(&picture(10, 64, 1, 0.5), &picture(10, 64, 1, 0.5)), None);
    assert_eq!(ssim(&a, &picture(16, 17, 3, 0.5)), None);
}
