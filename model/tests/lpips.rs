//! LPIPS against the `lpips` package's own numbers (the fixtures' reference.json), and what happens with bad input.
mod common;

use burn::tensor::Device;
use renderflow_frame::image::Rgb;
use renderflow_model::Error;
use renderflow_model::fusion::batch::Batch;
use renderflow_model::fusion::loss::perceptual;
use renderflow_model::fusion::record::PixelInputs;
use renderflow_model::lpips::{Backbone, Lpips, weights_folder};
use std::path::{Path, PathBuf};

const BACKBONES: [(Backbone, &str); 2] = [(Backbone::Alex, "alex"), (Backbone::Squeeze, "squeeze")];

const FIXTURES_VARIABLE: &str = "RENDERFLOW_LPIPS_FIXTURES";

/// Somebody said where weights or fixtures are: then everything has to be there.
fn named() -> bool {
    weights_folder().is_some() || std::env::var_os(FIXTURES_VARIABLE).is_some()
}

/// The weights folder, or `None` (with a line that says so) when nobody named one and the default is not there.
fn weights() -> Option<PathBuf> {
    let folder = common::lpips_folder();
    if !named() && !folder.join(Backbone::Alex.file_name()).exists() {
        println!("skipped: no LPIPS weights at {}", folder.display());
        return None;
    }
    Some(folder)
}

/// The fixtures folder; like the weights, it must exist if it was named.
fn fixtures(weights: &Path) -> Option<PathBuf> {
    if let Some(folder) = std::env::var_os(FIXTURES_VARIABLE) {
        return Some(folder.into());
    }
    let folder = weights.join("fixtures");
    if !folder.join("reference.json").exists() {
        assert!(!named(), "no fixtures in the named folder {}", folder.display());
        println!("skipped: no LPIPS fixtures at {}", folder.display());
        return None;
    }
    Some(folder)
}

fn read_png(path: &Path) -> Rgb {
    let picture = image::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display())).to_rgb8();
    let pixels = picture.pixels().map(|p| p.0.map(|v| f32::from(v) / 255.0)).collect();
    Rgb { width: picture.width() as usize, height: picture.height() as usize, pixels }
}

/// A smooth picture that differs with `phase`.
fn waves(width: usize, height: usize, phase: f32) -> Rgb {
    Rgb::from_fn(width, height, |x, y| [0, 1, 2].map(|c| 0.5 + 0.5 * (0.3 * x as f32 + 0.2 * (y * (c + 1)) as f32 + phase).sin()))
}

#[test]
fn lpips_equals_the_reference_for_every_pair() {
    let Some(weights) = weights() else { return };
    let Some(fixtures) = fixtures(&weights) else { return };
    let text = std::fs::read(fixtures.join("reference.json")).expect("reference.json of the fixtures");
    let reference: serde_json::Value = serde_json::from_slice(&text).expect("reference.json");
    let networks = BACKBONES.map(|(backbone, key)| (Lpips::load(&weights, backbone).expect("weights"), key));
    let (mut compared, mut worst) = (0, 0.0_f64);
    for pair in reference["pairs"].as_array().expect("pairs") {
        let file = |key: &str| fixtures.join(pair[key].as_str().expect("file name"));
        let (a, b) = (read_png(&file("a")), read_png(&file("b")));
        for (network, key) in &networks {
            let expected = pair[*key]["f64"].as_f64().expect("distance");
            let distance = f64::from(network.distance(&a, &b).expect("distance"));
            println!("{} {key}: {distance:.7} against {expected:.7}", pair["name"]);
            worst = worst.max((distance - expected).abs());
            compared += 1;
        }
    }
    assert!(compared >= 16, "only {compared} distances were compared");
    assert!(worst < 1e-5, "largest difference {worst:e}");
    println!("{compared} distances, largest difference {worst:e}");
}

#[test]
fn lpips_of_a_picture_with_itself_is_zero_and_order_does_not_matter() {
    let Some(weights) = weights() else { return };
    let (a, b) = (waves(45, 38, 0.0), waves(45, 38, 1.0));
    for (backbone, _) in BACKBONES {
        let network = Lpips::load(&weights, backbone).expect("weights");
        assert_eq!(network.distance(&a, &a).expect("distance"), 0.0);
        let (ab, ba) = (network.distance(&a, &b).expect("distance"), network.distance(&b, &a).expect("distance"));
        assert!(ab > 0.0 && (ab - ba).abs() < 1e-6, "{ab} {ba}");
    }
}

#[test]
fn lpips_refuses_pictures_it_cannot_compare() {
    let Some(weights) = weights() else { return };
    for (backbone, _) in BACKBONES {
        let network = Lpips::load(&weights, backbone).expect("weights");
        let side = backbone.smallest_side();
        assert!(network.distance(&waves(side, side, 0.0), &waves(side, side, 1.0)).expect("distance").is_finite());
        for (w, h) in [(1, 1), (0, 0), (side - 1, side), (side, side - 1)] {
            let error = network.distance(&waves(w, h, 0.0), &waves(w, h, 1.0)).expect_err("too small");
            assert!(error.to_string().contains("too small"), "{error}");
        }
        let error = network.distance(&waves(40, 40, 0.0), &waves(40, 41, 0.0)).expect_err("sizes differ");
        assert!(error.to_string().contains("40x41"), "{error}");
        let mut broken = waves(40, 40, 0.0);
        broken.pixels[83][1] = f32::NAN;
        let error = network.distance(&broken, &waves(40, 40, 0.0)).expect_err("not a number");
        assert!(error.to_string().contains("pixel (3, 2)"), "{error}");
    }
}

#[test]
fn lpips_names_the_tensor_that_is_wrong() {
    let Some(weights) = weights() else { return };
    let folder = tempfile::tempdir().expect("folder");
    let target = folder.path().join(Backbone::Squeeze.file_name());
    let load = || Lpips::load(folder.path(), Backbone::Squeeze).expect_err("must fail");

    assert!(matches!(load(), Error::Frame(renderflow_frame::Error::Io { .. })));

    let bytes = std::fs::read(weights.join(Backbone::Squeeze.file_name())).expect("weights");
    std::fs::write(&target, &bytes[..bytes.len() / 2]).expect("write");
    let error = load();
    assert!(matches!(&error, Error::Tensor { reason, .. } if reason.contains("cut off")), "{error}");

    std::fs::write(&target, &bytes[..40]).expect("write");
    assert!(matches!(load(), Error::Frame(renderflow_frame::Error::Malformed { .. })));

    std::fs::copy(weights.join(Backbone::Alex.file_name()), &target).expect("copy");
    let error = load();
    assert!(matches!(&error, Error::Tensor { tensor, .. } if tensor == "net.features.0.weight"), "{error}");
    assert!(error.to_string().contains("[64, 3, 11, 11]"), "{error}");

    // One weight of one tensor replaced by infinity.
    let name = "net.features.7.expand3x3.weight";
    let (header, metadata) = safetensors::SafeTensors::read_metadata(&bytes).expect("metadata");
    let at = header + 8 + metadata.info(name).expect("tensor").data_offsets.0;
    let mut broken = bytes.clone();
    broken[at..at + 4].copy_from_slice(&f32::INFINITY.to_le_bytes());
    std::fs::write(&target, &broken).expect("write");
    assert!(matches!(load(), Error::Tensor { tensor, .. } if tensor == name));
}

#[test]
fn the_loss_is_the_mean_distance_and_has_a_gradient() {
    use burn::tensor::{Tensor, TensorData};
    use renderflow_model::parameters::to_vec;

    let Some(weights) = weights() else { return };
    let device = Device::flex().autodiff();
    let (width, height) = (48, 40);
    let pairs = [(waves(width, height, 0.0), waves(width, height, 0.7)), (waves(width, height, 2.0), waves(width, height, 2.2))];
    let tensor = |pictures: [&Rgb; 2]| {
        let planes = |p: &Rgb| (0..3).flat_map(|c| p.pixels.iter().map(move |v| 2.0 * v[c] - 1.0)).collect::<Vec<f32>>();
        let values: Vec<f32> = pictures.into_iter().flat_map(planes).collect();
        Tensor::<4>::from_data(TensorData::new(values, [2, 3, height, width]), &device)
    };
    let (a, b) = (tensor([&pairs[0].0, &pairs[1].0]), tensor([&pairs[0].1, &pairs[1].1]));
    for (backbone, _) in BACKBONES {
        let lpips = Lpips::load_on(&weights.join(backbone.file_name()), backbone, &device).expect("weights");
        let metric = Lpips::load(&weights, backbone).expect("weights");
        let expected: f32 = pairs.iter().map(|(a, b)| metric.distance(a, b).expect("distance")).sum::<f32>() / 2.0;
        let number = |x: Tensor<1>| to_vec(x.without_autodiff())[0];
        let x = a.clone().require_grad();
        let loss = lpips.loss(x.clone(), b.clone()).expect("loss");
        let found = number(loss.clone());
        assert!((found - expected).abs() < 1e-5 * expected.max(0.1), "{backbone:?}: {found} instead of {expected}");
        let slope = to_vec(x.grad(&loss.backward()).expect("depends on x"));
        let length = slope.iter().map(|s| f64::from(*s).powi(2)).sum::<f64>().sqrt();
        assert!(length.is_finite() && length > 0.0);
        // Along the gradient.
        let step = 0.02;
        let moved = |by: f64| {
            let change: Vec<f32> = slope.iter().map(|s| (by * f64::from(*s) / length) as f32).collect();
            let change = Tensor::<4>::from_data(TensorData::new(change, [2, 3, height, width]), &device);
            f64::from(number(lpips.loss(a.clone() + change, b.clone()).expect("loss")))
        };
        let difference = (moved(step) - moved(-step)) / (2.0 * step);
        assert!((difference / length - 1.0).abs() < 0.05, "{backbone:?}: slope {length}, by differences {difference}");
        // Equal and flat pictures: no distance, and a gradient of zeros.
        let flat = Tensor::<4>::zeros([1, 3, height, width], &device).require_grad();
        let loss = lpips.loss(flat.clone(), flat.clone()).expect("loss");
        assert_eq!(number(loss.clone()), 0.0);
        assert!(to_vec(flat.grad(&loss.backward()).expect("depends on it")).iter().all(|s| s.is_finite()));
        let small = Tensor::<4>::zeros([1, 3, 8, 64], &device);
        assert!(lpips.loss(small.clone(), small).is_err());
    }
}

/// The loss of a batch of crops, of which the right half of the second shows no surface.
#[test]
fn the_derivative_of_a_batch_agrees_with_differences_where_surfaces_are_seen() {
    let Some(weights) = weights() else { return };
    let device = Device::flex().autodiff();
    let lpips = Lpips::for_loss(Some(&weights), &device).expect("weights");
    let (items, side) = (2, 32);
    let picture = |phase: f32| waves(side, items * side, phase).pixels.into_iter().map(|rgb| rgb.map(|v| 0.05 + 0.8 * v));
    let (drawn, truth): (Vec<_>, Vec<_>) = (picture(0.0).collect(), picture(0.7).collect());
    let seen = |i: usize| i < side * side || i % side < side / 2;
    let alpha = |i: usize| if seen(i) { 1.0 } else { 0.0 };
    let pixels = (0..items * side * side).map(|i| PixelInputs { alpha: alpha(i), ..PixelInputs::default() }).collect();
    let batch = Batch { items, width: side, height: side, pixels, truth, ..Batch::default() };
    let (value, slopes) = perceptual(&lpips, &batch, &drawn, &device).expect("a loss");
    assert!((0.01..1.0).contains(&value), "{value}");
    assert!(slopes.iter().enumerate().all(|(i, slope)| seen(i) || *slope == [0.0; 3]));
    let length = slopes.iter().flatten().map(|v| f64::from(v * v)).sum::<f64>().sqrt();
    let moved = |by: f64| {
        let along = drawn.iter().zip(&slopes);
        let moved: Vec<[f32; 3]> = along.map(|(at, slope)| [0, 1, 2].map(|c| at[c] + (by / length) as f32 * slope[c])).collect();
        f64::from(perceptual(&lpips, &batch, &moved, &device).expect("a loss").0)
    };
    let difference = (moved(0.02) - moved(-0.02)) / 0.04;
    assert!((difference / length - 1.0).abs() < 0.05, "slope {length}, by differences {difference}");
    // Small crops cannot be compared.
    let small = Batch { items: 1, width: 16, height: 16, truth: vec![[0.5; 3]; 256], ..batch.clone() };
    assert!(perceptual(&lpips, &small, &vec![[0.5; 3]; 256], &device).is_err());
}
