//! What a weights file is, told by its header, a configuration beside it or its shapes; and files turned into others.

use burn::tensor::Device;
use renderflow_model::parameters::export;
use renderflow_model::wan::names::{Named, Naming};
use renderflow_model::wan::weights::{
    Evidence, Found, Header, Identity, LoadOptions, Network, Precision, Provenance, Source, check, convert, identify, load, save,
};
use renderflow_model::wan::{Dit, DitConfig, Vace, VaceConfig, Vae, VaeConfig};
use std::path::Path;

/// A transformer with heads of the published width, so that its shapes say enough.
fn dit() -> DitConfig {
    DitConfig { heads: 1, head_dim: 128, layers: 4, ..DitConfig::tiny() }
}

/// Small autoencoders whose levels, times and blocks differ.
fn vaes() -> [VaeConfig; 3] {
    let odd = VaeConfig {
        base_dim: 6,
        decoder_base_dim: 4,
        dim_mult: vec![1, 3, 2],
        num_res_blocks: 1,
        temporal_downsample: vec![true, false],
        ..VaeConfig::tiny()
    };
    [VaeConfig::tiny(), odd, VaeConfig { z_dim: 16, base_dim: 4, decoder_base_dim: 6, ..VaeConfig::wan() }]
}

/// A file of another program: the tensors without this program's entry.
fn foreign<M: Named>(path: &Path, network: &M, header: Network, naming: Naming) {
    let header = Header { network: header, provenance: Provenance::default() };
    save(path, network, &header, Precision::F32, naming).expect("saves");
    let bytes = std::fs::read(path).expect("file");
    let tensors = safetensors::SafeTensors::deserialize(&bytes).expect("tensors");
    std::fs::write(path, safetensors::serialize(tensors.iter(), None).expect("bytes")).expect("write");
}

fn found(path: &Path) -> Found {
    match identify(&Source::open(path).expect("opens")).expect("identified") {
        Identity::Wan(found) => *found,
        other => panic!("{other:?}"),
    }
}

#[test]
fn shapes_tell_the_network() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("weights.safetensors");
    let device = Device::flex();
    let expect = |network: &Network, naming| {
        let found = found(&path);
        assert_eq!(&found.header.network, network);
        assert_eq!((found.naming, found.evidence), (naming, Evidence::Shapes));
        assert!(!found.assumed.is_empty());
        let source = Source::open(&path).expect("opens");
        check(&source, network).expect("fits");
        let sum: u64 = source.table().parts().iter().map(|(_, _, parameters)| parameters).sum();
        assert_eq!(sum, source.table().parameters());
    };
    for naming in [Naming::Diffusers, Naming::Original] {
        for config in vaes() {
            let network = Network::WanVae(config.clone());
            foreign(&path, &Vae::new(&config, 1, &device).expect("network"), network.clone(), naming);
            expect(&network, naming);
        }
        for config in [dit(), dit().without_text(), DitConfig { cross_attn_norm: false, ..dit() }] {
            let network = Network::WanDit(config.clone());
            foreign(&path, &Dit::new(&config, 1, &device).expect("network"), network.clone(), naming);
            let config = if config.text_dim.is_none() { DitConfig { cross_attn_norm: false, ..config } } else { config };
            expect(&Network::WanDit(config), naming);
        }
        let config = VaceConfig { dit: dit(), vace_layers: vec![0, 2], vace_in_channels: 24 };
        let network = Network::WanVace(config.clone());
        foreign(&path, &Vace::new(&config, 1, &device).expect("network"), network.clone(), naming);
        expect(&network, naming);
    }
}

#[test]
fn a_header_or_a_configuration_tells_more_than_shapes() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("weights.safetensors");
    let config = DitConfig::tiny();
    let network = Dit::new(&config, 1, &Device::flex()).expect("network");
    foreign(&path, &network, Network::WanDit(config.clone()), Naming::Diffusers);
    // Heads of 16 channels are no published ones.
    let unknown = identify(&Source::open(&path).expect("opens")).expect("read");
    assert!(matches!(&unknown, Identity::Unknown(reason) if reason.contains("config.json")), "{unknown:?}");
    let beside = r#"{"num_attention_heads": 2, "attention_head_dim": 16, "in_channels": 4, "ffn_dim": 64, "num_layers": 2,
        "text_dim": 24, "freq_dim": 32}"#;
    std::fs::write(folder.path().join("config.json"), beside).expect("write");
    let by_config = found(&path);
    assert_eq!(by_config.header.network, Network::WanDit(config.clone()));
    assert_eq!(by_config.evidence, Evidence::Config(folder.path().join("config.json")));
    assert_eq!(by_config.header.provenance.sources, ["weights.safetensors"]);
    // What the program wrote itself wins.
    let header = Header { network: Network::WanDit(config), provenance: Provenance { steps: 7, ..Default::default() } };
    save(&path, &network, &header, Precision::F32, Naming::Original).expect("saves");
    let own = found(&path);
    assert_eq!((own.header, own.evidence, own.naming), (header, Evidence::Header, Naming::Original));
}

#[test]
fn converting_there_and_back_changes_nothing() {
    let folder = tempfile::tempdir().expect("folder");
    let [first, second, third] = ["a", "b", "c"].map(|name| folder.path().join(format!("{name}.safetensors")));
    let config = VaeConfig::tiny();
    let vae = Vae::new(&config, 1, &Device::flex()).expect("network");
    let provenance = Provenance { sources: vec!["base".into()], seed: Some(3), steps: 9, program: "test".into() };
    let header = Header { network: Network::WanVae(config.clone()), provenance };
    save(&first, &vae, &header, Precision::F32, Naming::Diffusers).expect("saves");
    let open = |path: &Path| Source::open(path).expect("opens");
    let report = convert(&open(&first), &second, &header, Precision::F32, Naming::Original).expect("converts");
    assert_eq!((report.naming, report.read), (Naming::Diffusers, vae.entries().len()));
    assert_eq!((found(&second).header, found(&second).naming), (header.clone(), Naming::Original));
    convert(&open(&second), &third, &header, Precision::F32, Naming::Diffusers).expect("converts");
    assert_eq!(std::fs::read(&first).expect("file"), std::fs::read(&third).expect("file"));
    // Half precision is that of saving in half precision.
    for precision in [Precision::F16, Precision::Bf16] {
        convert(&open(&second), &third, &header, precision, Naming::Diffusers).expect("converts");
        save(&second.with_extension("half.safetensors"), &vae, &header, precision, Naming::Diffusers).expect("saves");
        let saved = std::fs::read(second.with_extension("half.safetensors")).expect("file");
        assert_eq!(std::fs::read(&third).expect("file"), saved);
    }
    let (loaded, _) =
        load(Vae::new(&config, 0, &Device::flex()).expect("network"), &open(&second), LoadOptions::default()).expect("fits");
    assert_eq!(export(&loaded), export(&vae));
}

#[test]
fn what_cannot_be_converted_is_named_and_leaves_nothing() {
    let folder = tempfile::tempdir().expect("folder");
    let (from, to) = (folder.path().join("from.safetensors"), folder.path().join("to.safetensors"));
    let network = Network::WanVae(VaeConfig::tiny());
    let header = Header { network: network.clone(), provenance: Provenance::default() };
    let tensors = |change: &dyn Fn(&str, &mut Vec<f32>) -> bool| {
        let vae = Vae::new(&VaeConfig::tiny(), 1, &Device::flex()).expect("network");
        save(&from, &vae, &header, Precision::F32, Naming::Diffusers).expect("saves");
        let source = Source::open(&from).expect("opens");
        let mut blobs = Vec::new();
        for row in source.table().rows {
            let mut values = source.read(&row.name).expect("values");
            if change(&row.name, &mut values) {
                blobs.push((row.name, row.shape, values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>()));
            }
        }
        let views = blobs.iter().map(|(name, shape, bytes)| {
            (name, safetensors::tensor::TensorView::new(safetensors::Dtype::F32, shape.clone(), bytes).expect("tensor"))
        });
        std::fs::write(&from, safetensors::serialize(views, None).expect("bytes")).expect("write");
        let error = convert(&Source::open(&from).expect("opens"), &to, &header, Precision::F16, Naming::Original);
        let left: Vec<_> = std::fs::read_dir(folder.path()).expect("folder").map(|e| e.expect("entry").file_name()).collect();
        assert_eq!(left, ["from.safetensors"], "something is left behind");
        error.expect_err("must fail").to_string()
    };
    let message = tensors(&|name, _| name != "quant_conv.bias");
    assert!(message.contains("from.safetensors") && message.contains("quant_conv.bias [8] is missing"), "{message}");
    let message = tensors(&|name, values| {
        if name == "decoder.conv_in.bias" {
            values[3] = 1e6;
        }
        true
    });
    assert!(message.contains("decoder.conv_in.bias") && message.contains("1000000 cannot be stored"), "{message}");
    let message = tensors(&|name, values| {
        if name == "decoder.conv_out.weight" {
            values[3] = f32::NAN;
        }
        true
    });
    assert!(message.contains("decoder.conv_out.weight") && message.contains("NaN"), "{message}");
}
