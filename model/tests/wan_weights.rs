//! Weights files of the wan networks: what is written is read, in either naming, in shards, from PyTorch; what does not fit is
//! named.

mod wan;

use burn::tensor::Device;
use half::bf16;
use renderflow_model::parameters;
use renderflow_model::wan::names::{Named, Naming};
use renderflow_model::wan::weights::{ElementType, Header, LoadOptions, Network, Precision, Provenance, Source, load, save};
use renderflow_model::wan::{Dit, DitConfig, Vace, VaceConfig, Vae, VaeConfig};
use safetensors::tensor::{Dtype, TensorView};
use std::collections::BTreeMap;
use std::path::Path;

fn header(config: &DitConfig) -> Header {
    let provenance = Provenance { sources: vec!["base.safetensors".into()], seed: Some(4), steps: 12, program: "test".into() };
    Header { network: Network::WanDit(config.clone()), provenance }
}

fn tiny(seed: u64) -> Dit {
    Dit::new(&DitConfig::tiny(), seed, &Device::flex()).expect("network")
}

fn open(path: &Path) -> Source {
    Source::open(path).expect("opens")
}

type Blob = (Dtype, Vec<usize>, Vec<u8>);

/// The tensors of a saved network, to be tampered with.
fn blobs(path: &Path) -> BTreeMap<String, Blob> {
    let bytes = std::fs::read(path).expect("file");
    let tensors = safetensors::SafeTensors::deserialize(&bytes).expect("safetensors");
    tensors.iter().map(|(name, view)| (name.to_string(), (view.dtype(), view.shape().to_vec(), view.data().to_vec()))).collect()
}

fn write(path: &Path, blobs: &BTreeMap<String, Blob>) {
    let views: Vec<(&String, TensorView)> =
        blobs.iter().map(|(name, blob)| (name, TensorView::new(blob.0, blob.1.clone(), &blob.2).expect("tensor"))).collect();
    std::fs::write(path, safetensors::serialize(views, None).expect("bytes")).expect("write");
}

#[test]
fn what_is_saved_is_loaded() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("dit.safetensors");
    let network = tiny(1);
    let want = parameters::export(&network);
    for naming in [Naming::Diffusers, Naming::Original] {
        save(&path, &network, &header(network.config()), Precision::F32, naming).expect("saves");
        assert_eq!(std::fs::read_dir(folder.path()).expect("folder").count(), 1, "nothing is left beside it");
        let source = open(&path);
        assert_eq!(source.header().expect("header"), Some(header(network.config())));
        let (loaded, report) = load(tiny(2), &source, LoadOptions::default()).expect("fits");
        assert_eq!((report.naming, report.read), (naming, network.entries().len()));
        assert!(report.ignored.is_empty() && report.kept.is_empty());
        assert_eq!(parameters::export(&loaded), want);
        // Same weights, same bytes.
        let again = folder.path().join("again.safetensors");
        save(&again, &loaded, &header(network.config()), Precision::F32, naming).expect("saves");
        assert_eq!(std::fs::read(&path).expect("file"), std::fs::read(&again).expect("file"));
        std::fs::remove_file(again).expect("removed");
    }
    for (precision, element, bits) in [(Precision::F16, ElementType::F16, 11), (Precision::Bf16, ElementType::Bf16, 8)] {
        save(&path, &network, &header(network.config()), precision, Naming::Diffusers).expect("saves");
        let source = open(&path);
        assert!(source.table().rows.iter().all(|row| row.element == element));
        let (loaded, _) = load(tiny(2), &source, LoadOptions::default()).expect("fits");
        for (got, want) in parameters::export(&loaded).iter().zip(&want) {
            for (got, want) in got.values.iter().zip(&want.values) {
                let bound = (want.abs() * 0.5f32.powi(bits)).max(1e-7);
                assert!((got - want).abs() <= bound, "{got} for {want}");
            }
        }
    }
}

#[test]
fn the_other_networks_keep_their_headers() {
    let folder = tempfile::tempdir().expect("folder");
    let vae = VaeConfig::tiny();
    let vace = VaceConfig::tiny();
    let device = Device::flex();
    let path = folder.path().join("vae.safetensors");
    let header = |network| Header { network, provenance: Provenance::default() };
    let wanted = header(Network::WanVae(vae.clone()));
    save(&path, &Vae::new(&vae, 1, &device).expect("network"), &wanted, Precision::F32, Naming::Original).expect("saves");
    assert_eq!(open(&path).header().expect("header"), Some(wanted));
    load(Vae::new(&vae, 0, &device).expect("network"), &open(&path), LoadOptions::default()).expect("fits");
    let wanted = header(Network::WanVace(vace.clone()));
    save(&path, &Vace::new(&vace, 1, &device).expect("network"), &wanted, Precision::Bf16, Naming::Original).expect("saves");
    assert_eq!(open(&path).header().expect("header"), Some(wanted));
    load(Vace::new(&vace, 0, &device).expect("network"), &open(&path), LoadOptions::default()).expect("fits");
}

#[test]
fn every_tensor_that_does_not_fit_is_named() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("dit.safetensors");
    let network = tiny(1);
    save(&path, &network, &header(network.config()), Precision::F32, Naming::Original).expect("saves");
    let whole = blobs(&path);
    let error = |blobs: &BTreeMap<String, Blob>| {
        write(&path, blobs);
        load(tiny(0), &open(&path), LoadOptions::default()).expect_err("must fail").to_string()
    };

    let mut broken = whole.clone();
    broken.remove("blocks.1.self_attn.q.bias");
    broken.insert("blocks.2.self_attn.q.bias".into(), (Dtype::F32, vec![2], vec![0; 8]));
    broken.get_mut("head.head.weight").expect("there").1 = vec![32, 16];
    broken.insert("time_embedding.0.bias".into(), (Dtype::I32, vec![32], vec![0; 128]));
    let message = error(&broken);
    for part in [
        "dit.safetensors: 4 tensors do not fit",
        "blocks.1.self_attn.q.bias [32] is missing",
        "blocks.2.self_attn.q.bias [2] is not part of the network",
        "head.head.weight has the shape [32, 16] where [16, 32] is expected",
        "time_embedding.0.bias is not of floating-point numbers",
    ] {
        assert!(message.contains(part), "{part} in {message}");
    }

    let half = whole.clone().into_iter().enumerate().filter(|(i, _)| i % 2 == 0).map(|(_, entry)| entry).collect();
    let message = error(&half);
    let missing = whole.len() - half.len();
    assert!(message.contains(&format!("{missing} tensors do not fit")), "{message}");
    assert!(message.lines().count() == 12 && message.ends_with(&format!("and {} more", missing - 10)), "{message}");

    let mut broken = whole.clone();
    broken.get_mut("blocks.0.ffn.0.weight").expect("there").2[4..8].copy_from_slice(&f32::NAN.to_le_bytes());
    let message = error(&broken);
    assert!(message.contains("blocks.0.ffn.0.weight: holds NaN"), "{message}");

    let lacking: BTreeMap<_, _> = whole.clone().into_iter().filter(|(name, _)| !name.contains("text_embedding")).collect();
    write(&path, &lacking);
    let options = LoadOptions { may_lack: &|name| name.contains("text_embedder"), ..Default::default() };
    let (loaded, report) = load(tiny(8), &open(&path), options).expect("fits");
    assert_eq!(report.kept.len(), 4);
    let of = |network: &Dit| parameters::export(network).into_iter().partition::<Vec<_>, _>(|p| p.name.starts_with("text."));
    assert_eq!(of(&loaded), (of(&tiny(8)).0, of(&network).1));
}

#[test]
fn shards_are_one_network() {
    let folder = tempfile::tempdir().expect("folder");
    let single = folder.path().join("single.safetensors");
    let network = tiny(1);
    save(&single, &network, &header(network.config()), Precision::F32, Naming::Diffusers).expect("saves");
    let whole = blobs(&single);
    std::fs::remove_file(single).expect("removed");
    let name = |i: usize| format!("model-{i:05}-of-00003.safetensors");
    let map: serde_json::Map<String, serde_json::Value> =
        whole.keys().enumerate().map(|(i, tensor)| (tensor.clone(), name(i % 3).into())).collect();
    for shard in 0..3 {
        let part = whole.clone().into_iter().enumerate().filter(|(i, _)| i % 3 == shard).map(|(_, entry)| entry).collect();
        write(&folder.path().join(name(shard)), &part);
    }
    let index = folder.path().join("model.safetensors.index.json");
    let put = |map: &serde_json::Map<String, serde_json::Value>| {
        let text = serde_json::json!({"metadata": {"total_size": 0}, "weight_map": map}).to_string();
        std::fs::write(&index, text).expect("write");
    };
    put(&map);
    for path in [index.as_path(), folder.path()] {
        let (loaded, _) = load(tiny(2), &open(path), LoadOptions::default()).expect("fits");
        assert_eq!(parameters::export(&loaded), parameters::export(&network));
    }
    let error = |change: &dyn Fn(&mut serde_json::Map<String, serde_json::Value>)| {
        let mut map = map.clone();
        change(&mut map);
        put(&map);
        Source::open(&index).expect_err("must fail").to_string()
    };
    let wrong = error(&|map| drop(map.insert("proj_out.bias".into(), "../../elsewhere.safetensors".into())));
    assert!(wrong.contains("elsewhere") && wrong.contains("proj_out.bias"), "{wrong}");
    let wrong = error(&|map| drop(map.insert("another".into(), name(0).into())));
    assert!(wrong.contains("another: not in"), "{wrong}");
    let wrong = error(&|map| drop(map.remove("proj_out.bias")));
    assert!(wrong.contains("proj_out.bias, which the index does not list"), "{wrong}");
    let wrong = error(&|map| drop(map.insert("proj_out.bias".into(), "model-9.safetensors".into())));
    assert!(wrong.contains("index.json: /weight_map/proj_out.bias: there is no model-9.safetensors"), "{wrong}");
}

#[test]
fn files_that_are_no_weights_are_refused() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("dit.safetensors");
    assert!(Source::open(folder.path()).expect_err("empty").to_string().contains("no weights"));
    assert!(Source::open(&path).expect_err("absent").to_string().contains("cannot read"));
    let network = tiny(1);
    save(&path, &network, &header(network.config()), Precision::F32, Naming::Diffusers).expect("saves");
    let bytes = std::fs::read(&path).expect("file");
    for length in [0, 7, 8, 100, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..length]).expect("write");
        let error = Source::open(&path).expect_err("cut off").to_string();
        assert!(error.contains("dit.safetensors"), "{error}");
    }
    let mut huge = bytes.clone();
    huge[..8].copy_from_slice(&u64::MAX.to_le_bytes());
    std::fs::write(&path, &huge).expect("write");
    Source::open(&path).expect_err("a length beyond the file");
    std::fs::write(&path, &bytes).expect("write");
    std::fs::write(folder.path().join("other.safetensors"), &bytes).expect("write");
    assert!(Source::open(folder.path()).expect_err("two files").to_string().contains("name the file"));
    for name in ["weights.gguf", "weights"] {
        Source::open(&folder.path().join(name)).expect_err("unknown kind");
    }
    let torch = folder.path().join("broken.pth");
    std::fs::write(&torch, b"no pickle").expect("write");
    assert!(Source::open(&torch).expect_err("broken").to_string().contains("broken.pth"));
    let mut odd = tiny(1);
    odd.head.bias = burn::module::Param::from_data([f32::INFINITY; 16], &Device::flex());
    let error = save(&path, &odd, &header(odd.config()), Precision::F32, Naming::Original).expect_err("not finite").to_string();
    assert!(error.contains("head.head.bias"), "{error}");
}

/// `references/wan_state.pth`: made with torch 2.15.0 by `references/wan_state.py`.
#[test]
fn pytorch_files_are_read() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/references/wan_state.pth");
    let source = open(&path);
    let names: Vec<&str> = source.names().collect();
    assert_eq!(names, ["conv1.weight", "half.weight", "head.head.bias", "transposed"]);
    let ramp = |count: usize| (0..count).map(|i| i as f32 / 8.0 - 1.0);
    assert_eq!(source.shape("conv1.weight"), Some(&[2, 3, 1, 2, 2][..]));
    assert_eq!(source.read("conv1.weight").expect("reads"), ramp(24).collect::<Vec<_>>());
    assert_eq!(source.element("half.weight"), Some(ElementType::F16));
    assert_eq!(source.read("half.weight").expect("reads"), ramp(6).collect::<Vec<_>>());
    assert_eq!(source.element("head.head.bias"), Some(ElementType::Bf16));
    assert_eq!(source.read("head.head.bias").expect("reads"), ramp(4).map(|v| bf16::from_f32(v).to_f32()).collect::<Vec<_>>());
    // A view with other strides comes in the order of its shape.
    assert_eq!(source.shape("transposed"), Some(&[3, 2][..]));
    assert_eq!(source.read("transposed").expect("reads"), [-1.0, -0.625, -0.875, -0.5, -0.75, -0.375]);
    let table = source.table();
    assert_eq!((table.rows.len(), table.parameters()), (4, 40));
    let text = table.to_string();
    assert!(text.contains("conv1.weight") && text.contains("[2, 3, 1, 2, 2]") && text.contains("4 tensors"), "{text}");
}

/// A damaged file is an error, or weights with other values; never a panic, and never a huge allocation.
#[test]
fn damaged_files_do_no_harm() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("dit.safetensors");
    let network = tiny(1);
    save(&path, &network, &header(network.config()), Precision::F16, Naming::Diffusers).expect("saves");
    let state = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/references/wan_state.pth");
    let files =
        [(path.clone(), std::fs::read(&path).expect("file")), (folder.path().join("x.pth"), std::fs::read(state).expect("file"))];
    let mut random = 0x2545_F491_4F6C_DD1Du64;
    let mut next = |below: usize| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 33) as usize % below
    };
    for (path, whole) in files {
        let mut opened = 0;
        for _ in 0..400 {
            let mut bytes = whole.clone();
            for _ in 0..1 + next(3) {
                // Headers are at the beginning, the directory of an archive at the end.
                let near = if next(2) == 0 { next(bytes.len().min(4000)) } else { next(bytes.len()) };
                bytes[near] = next(256) as u8;
            }
            if next(8) == 0 {
                bytes.truncate(next(whole.len()));
            }
            std::fs::write(&path, &bytes).expect("write");
            if let Ok(source) = Source::open(&path) {
                opened += 1;
                let _ = source.header();
                let names: Vec<String> = source.names().map(str::to_string).collect();
                let _ = names.iter().filter_map(|name| source.read(name).ok()).count();
                let _ = load(tiny(0), &source, LoadOptions::default());
            }
        }
        println!("{}: {opened} of 400 damaged files opened", path.display());
    }
}
