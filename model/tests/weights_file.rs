//! Weights files: what is written is read, what is wrong is named.

mod common;

use burn::tensor::Device;
use common::tiny;
use renderflow_model::network::Network;
use renderflow_model::parameters::export;
use renderflow_model::weights::{Precision, WeightsHeader, decode, encode, load, save};
use renderflow_model::{Error, NetworkConfig, NeuralRenderer};
use safetensors::SafeTensors;
use std::path::Path;

fn header() -> WeightsHeader {
    WeightsHeader { network: tiny(), steps: 12, keyframe_steps: 0, seed: 5 }
}

#[test]
fn round_trip() {
    let device = Device::flex();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.safetensors");
    let parameters = export(&Network::new(&tiny(), 5, &device).unwrap());
    save(&path, &header(), &parameters, Precision::F32).unwrap();
    let (network, read) = load(&path, &device).unwrap();
    assert_eq!(read, header());
    assert_eq!(export(&network), parameters);

    // Half precision: exact after the first rounding, and the same bytes every time.
    let bytes = encode(&header(), &parameters, Precision::F16).unwrap();
    let (network, _) = decode(&path, &bytes, &device).unwrap();
    for (a, b) in export(&network).iter().zip(&parameters) {
        for (a, b) in a.values.iter().zip(&b.values) {
            assert!((a - b).abs() <= 4.9e-4 * b.abs() + 6e-8, "{a} instead of {b}");
        }
    }
    assert_eq!(encode(&header(), &export(&network), Precision::F16).unwrap(), bytes);
}

#[test]
fn the_default_network_with_its_keyframe_stage_fits_into_eleven_megabytes() {
    let config = NetworkConfig { keyframes: Some(Default::default()), ..NetworkConfig::default() };
    let parameters = export(&Network::new(&config, 1, &Device::flex()).unwrap());
    let count = |prefix: &str| parameters.iter().filter(|p| p.name.starts_with(prefix)).map(|p| p.values.len()).sum::<usize>();
    let (base, keyframes) = (count("base."), count("keyframes."));
    println!("base {base}, keyframes {keyframes} parameters");
    assert!(base <= 4_600_000 && (300_000..=600_000).contains(&keyframes), "{base} and {keyframes}");
    let bytes = encode(&WeightsHeader { network: config, ..header() }, &parameters, Precision::F16).unwrap();
    assert!(bytes.len() < 11_000_000, "{} bytes", bytes.len());
}

#[test]
fn broken_files_are_named() {
    let device = Device::flex();
    let path = Path::new("some/file.safetensors");
    let parameters = export(&Network::new(&tiny(), 5, &device).unwrap());
    let message = |bytes: &[u8]| decode(path, bytes, &device).unwrap_err().to_string();

    assert!(message(b"not weights").starts_with("some/file.safetensors: not a safetensors file"), "{}", message(b"not weights"));
    let bytes = encode(&header(), &parameters, Precision::F16).unwrap();
    assert!(message(&bytes[..bytes.len() / 2]).contains("not a safetensors file"));

    let foreign = safetensors::serialize(Vec::<(&str, safetensors::tensor::TensorView)>::new(), None).unwrap();
    assert!(message(&foreign).contains("not weights of this program"), "{}", message(&foreign));

    let missing = encode(&header(), &parameters[1..], Precision::F16).unwrap();
    assert!(message(&missing).contains(&format!("tensor {}: missing", parameters[0].name)), "{}", message(&missing));

    let mut wrong = parameters.clone();
    wrong[2].shape = vec![wrong[2].values.len()];
    wrong[2].shape.insert(0, 1);
    let wrong = encode(&header(), &wrong, Precision::F16).unwrap();
    assert!(message(&wrong).contains(&parameters[2].name) && message(&wrong).contains("shape"), "{}", message(&wrong));

    let mut extra = parameters.clone();
    extra.push(renderflow_model::parameters::Parameter { name: "stray".into(), shape: vec![1], values: vec![0.0] });
    assert!(message(&encode(&header(), &extra, Precision::F16).unwrap()).contains("tensor stray"));

    let mut nan = parameters;
    nan[0].values[0] = f32::NAN;
    assert!(matches!(encode(&header(), &nan, Precision::F16), Err(Error::Tensor { .. })));

    let absent = NeuralRenderer::load(Path::new("/nonexistent/w.safetensors")).unwrap_err().to_string();
    assert!(absent.starts_with("/nonexistent/w.safetensors: cannot read"), "{absent}");
}

/// A few hundred bytes whose header describes the largest network there is.
#[test]
fn a_header_alone_does_not_fill_the_memory() {
    let network = NetworkConfig {
        widths: [4096; 3],
        encoder_blocks: [16; 3],
        decoder_blocks: [16; 3],
        token_width: 4096,
        heads: 64,
        transformer_blocks: 64,
        mlp_ratio: 16,
        condition_width: 4096,
        ..NetworkConfig::default()
    };
    let bytes = encode(&WeightsHeader { network, ..header() }, &[], Precision::F16).unwrap();
    assert!(bytes.len() < 1000);
    let error = decode(Path::new("some/file.safetensors"), &bytes, &Device::flex()).unwrap_err().to_string();
    assert!(error.starts_with("some/file.safetensors: the network its header describes has more than"), "{error}");
}

#[test]
fn the_metadata_is_json_that_others_can_read() {
    let parameters = export(&Network::new(&tiny(), 5, &Device::flex()).unwrap());
    let bytes = encode(&header(), &parameters, Precision::F16).unwrap();
    let (_, metadata) = SafeTensors::read_metadata(&bytes).unwrap();
    let text = &metadata.metadata().as_ref().unwrap()["renderflow"];
    let json: serde_json::Value = serde_json::from_str(text).unwrap();
    assert_eq!(json["network"]["start"], "ibl");
    assert_eq!(json["network"]["inputs"][0], "albedo");
    assert_eq!(json["steps"], 12);
}
