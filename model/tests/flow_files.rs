//! The renderer in files: its own come back bit for bit, published ones give what they have, and the rest begins by rule.

mod wan;

use burn::tensor::Device;
use renderflow_model::parameters::{self, Parameter};
use renderflow_model::wan::flow::{Environment, Group, Query};
use renderflow_model::wan::names::{Named, Naming};
use renderflow_model::wan::weights::{Header, Network, Precision, Provenance, Source, save};
use renderflow_model::wan::{Dit, DitConfig, Flow, FlowConfig, Vace, VaceConfig};
use std::path::Path;
use wan::flow::{config, warm, warmed};

fn header(network: Network) -> Header {
    let provenance = Provenance { sources: vec!["base.pth".into()], seed: Some(7), steps: 20, program: "test".into() };
    Header { network, provenance }
}

fn saved(path: &Path, flow: &Flow, naming: Naming) -> Source {
    save(path, flow, &header(Network::WanFlow(flow.config().clone())), Precision::F32, naming).expect("saves");
    Source::open(path).expect("opens")
}

fn of_group(flow: &Flow, groups: &[Group]) -> Vec<Parameter> {
    parameters::export(flow).into_iter().filter(|p| groups.contains(&Group::of(&p.name))).collect()
}

#[test]
fn what_is_saved_is_read() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("flow.safetensors");
    let device = Device::flex();
    for config in [config(Query::Dedicated, Environment::Pooled, 3), config(Query::Reused, Environment::Tokens, 0)] {
        let flow = warm(&config, &device);
        for naming in [Naming::Diffusers, Naming::Original] {
            let source = saved(&path, &flow, naming);
            let (read, found, report) = Flow::read(&source, |config| config, 0, &device).expect("fits");
            assert_eq!((found, read.config()), (header(Network::WanFlow(config.clone())), &config));
            assert_eq!((report.naming, report.read), (naming, flow.entries().len()));
            assert!(report.ignored.is_empty() && report.kept.is_empty());
            assert_eq!(parameters::export(&read), parameters::export(&flow));
        }
    }
}

/// Stage 2 begins with the file of stage 1, and who needs no keyframes does not read their adapter.
#[test]
fn adapters_are_added_and_left_out() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("flow.safetensors");
    let device = Device::flex();
    let full = config(Query::Dedicated, Environment::Pooled, 3);
    let bare = FlowConfig { keyframes: None, inverse: None, ..full.clone() };
    let base = warm(&bare, &device);
    let source = saved(&path, &base, Naming::Diffusers);
    let (grown, found, report) = Flow::read(&source, |_| full.clone(), 11, &device).expect("fits");
    assert_eq!(found.network, Network::WanFlow(full.clone()));
    assert_eq!(of_group(&grown, &[Group::Base]), parameters::export(&base));
    let mut fresh = Flow::new(&full, 11, &device).expect("network");
    fresh.inverse.as_mut().expect("adapter").embed = base.dit.patch.copy();
    let adapters = [Group::Keyframes, Group::Inverse];
    assert_eq!(of_group(&grown, &adapters), of_group(&fresh, &adapters));
    assert_eq!((report.read, report.kept.len()), (base.entries().len(), grown.entries().len() - base.entries().len()));

    let flow = warm(&full, &device);
    let source = saved(&path, &flow, Naming::Original);
    let (cut, _, report) = Flow::read(&source, |_| bare.clone(), 0, &device).expect("fits");
    assert_eq!(parameters::export(&cut), of_group(&flow, &[Group::Base]));
    assert_eq!(report.ignored.len(), flow.entries().len() - cut.entries().len());

    let error = |change: &dyn Fn(&mut FlowConfig)| {
        let mut config = full.clone();
        change(&mut config);
        Flow::read(&source, |_| config, 0, &device).expect_err("must fail").to_string()
    };
    assert!(error(&|c| c.dit.layers = 3).contains("of another configuration"));
    assert!(error(&|c| c.environment = Environment::Tokens).contains("of another configuration"));
    assert!(error(&|c| c.keyframes.as_mut().expect("adapter").lora_rank = 2).contains("keyframes adapter"));
    assert!(error(&|c| c.inverse.as_mut().expect("adapter").prompts = 6).contains("inverse adapter"));
}

#[test]
fn other_files_are_refused_by_name() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("some.safetensors");
    let device = Device::flex();
    let (dit, config) = (DitConfig::tiny(), FlowConfig::tiny());
    let network = Dit::new(&dit, 1, &device).expect("network");
    save(&path, &network, &header(Network::WanDit(dit)), Precision::F32, Naming::Diffusers).expect("saves");
    let source = Source::open(&path).expect("opens");
    let error = Flow::read(&source, |config| config, 0, &device).expect_err("must fail").to_string();
    assert!(error.contains("some.safetensors") && error.contains("another network"), "{error}");
    let state = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/references/wan_state.pth");
    let foreign = Source::open(&state).expect("opens");
    let error = Flow::read(&foreign, |config| config, 0, &device).expect_err("must fail").to_string();
    assert!(error.contains("wan_state.pth: not a file of this program"), "{error}");
    let error = Flow::adopt(&config, &foreign, None, 0, &device).expect_err("must fail").to_string();
    assert!(error.contains("tensors do not fit") && error.contains("is missing"), "{error}");

    // A renderer with a tensor missing, and one with a tensor too many.
    let flow = Flow::new(&config, 1, &device).expect("network");
    let with_keyframes = config.clone().with_keyframes(Default::default());
    let wrong = header(Network::WanFlow(with_keyframes));
    save(&path, &flow, &wrong, Precision::F32, Naming::Diffusers).expect("saves");
    let error =
        |path: &Path| Flow::read(&Source::open(path).expect("opens"), |config| config, 0, &device).expect_err("must fail");
    let text = error(&path).to_string();
    assert!(text.contains("keyframe_embedding.weight [32, 4, 2, 2] is missing"), "{text}");
    let inverse = Flow::new(&config.clone().with_inverse(Default::default()), 1, &device).expect("network");
    save(&path, &inverse, &header(Network::WanFlow(config.clone())), Precision::F32, Naming::Diffusers).expect("saves");
    // Tensors of an adapter that neither the file's own configuration nor the asked-for one has.
    let text = error(&path).to_string();
    assert!(text.contains("is not part of the network"), "{text}");
    let source = saved(&path, &flow, Naming::Diffusers);
    let error = Flow::adopt(&config, &source, None, 0, &device).expect_err("must fail").to_string();
    assert!(error.contains("a renderer already"), "{error}");
}

/// VACE of the size of the tiny renderer, with nothing at 0.
fn vace(device: &Device) -> Vace {
    let config = VaceConfig { vace_in_channels: FlowConfig::tiny().reference_channels(), ..VaceConfig::tiny() };
    warmed(Vace::new(&config, 21, device).expect("network"), device)
}

fn values<M: burn::module::Module>(module: &M) -> Vec<Vec<f32>> {
    parameters::export(module).into_iter().map(|p| p.values).collect()
}

#[test]
fn published_weights_are_adopted() {
    let folder = tempfile::tempdir().expect("folder");
    let (dit_path, vace_path) = (folder.path().join("dit.safetensors"), folder.path().join("vace.safetensors"));
    let device = Device::flex();
    let full = config(Query::Dedicated, Environment::Pooled, 3);
    let vace = vace(&device);
    let dit = warmed(Dit::new(&DitConfig::tiny(), 22, &device).expect("network"), &device);
    for naming in [Naming::Diffusers, Naming::Original] {
        save(&dit_path, &dit, &header(Network::WanDit(dit.config().clone())), Precision::F32, naming).expect("saves");
        save(&vace_path, &vace, &header(Network::WanVace(vace.config().clone())), Precision::F32, naming).expect("saves");
        let (dit_file, vace_file) = (Source::open(&dit_path).expect("opens"), Source::open(&vace_path).expect("opens"));
        for (base, context, backbone) in
            [(&dit_file, None, &dit), (&dit_file, Some(&vace_file), &dit), (&vace_file, None, &vace.dit)]
        {
            let (flow, adoption) = Flow::adopt(&full, base, context, 5, &device).expect("fits");
            println!("{adoption}");
            // The backbone is that of the file.
            assert_eq!(values(&flow.dit.blocks[1].attention), values(&backbone.blocks[1].attention));
            assert_eq!(values(&flow.dit.blocks[0].ffn), values(&backbone.blocks[0].ffn));
            assert_eq!(values(&flow.dit.time), values(&backbone.time));
            assert_eq!(values(&flow.dit.head), values(&backbone.head));
            assert_eq!(adoption.read, flow.dit.entries().len());
            assert!(adoption.ignored.iter().any(|name| name.contains("text_embed")));
            // Copies have lives of their own.
            assert_eq!(values(&flow.environment.embed), values(&backbone.patch));
            assert_eq!(values(&flow.inverse.as_ref().expect("adapter").embed), values(&backbone.patch));
            let ids: std::collections::HashSet<_> = flow.entries().into_iter().map(|e| e.id).collect();
            assert_eq!(ids.len(), flow.entries().len());
            // The attributes' embedder: VACE's channels before the buffers' zeros.
            let [weight, bias] = &values(&flow.attributes)[..] else { panic!("weight and bias") };
            if context.is_some() || std::ptr::eq(base, &vace_file) {
                let [want, want_bias] = &values(&vace.patch)[..] else { panic!("weight and bias") };
                assert!(weight[..want.len()] == want[..] && bias == want_bias);
                assert!(weight[want.len()..].iter().all(|&v| v == 0.0) && weight.len() > want.len());
            } else {
                assert!(weight.iter().chain(bias).all(|&v| v == 0.0));
            }
            // The rest begins as without a file.
            let fresh = Flow::new(&full, 5, &device).expect("network");
            assert_eq!(values(&flow.environment.blocks), values(&fresh.environment.blocks));
            assert_eq!(of_group(&flow, &[Group::Keyframes]), of_group(&fresh, &[Group::Keyframes]));
        }
    }
    // Without context where one is named.
    let dit_file = Source::open(&dit_path).expect("opens");
    let error = Flow::adopt(&full, &dit_file, Some(&dit_file), 5, &device).expect_err("must fail").to_string();
    assert!(error.contains("vace_patch_embedding.weight: missing"), "{error}");
    // A context of another size.
    let small = warmed(Vace::new(&VaceConfig::tiny(), 21, &device).expect("network"), &device);
    save(&vace_path, &small, &header(Network::WanVace(small.config().clone())), Precision::F32, Naming::Original).expect("saves");
    let vace_file = Source::open(&vace_path).expect("opens");
    let error = Flow::adopt(&full, &vace_file, None, 5, &device).expect_err("must fail").to_string();
    assert!(error.contains("vace_patch_embedding.weight") && error.contains("[32, 72, 1, 2, 2] is expected"), "{error}");
}

/// Adopted weights can be trained: each parameter of the first stage has a gradient.
#[test]
fn adopted_weights_learn() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("vace.safetensors");
    let device = Device::flex().autodiff();
    let network = vace(&Device::flex());
    save(&path, &network, &header(Network::WanVace(network.config().clone())), Precision::F32, Naming::Original).expect("saves");
    let config = FlowConfig::tiny();
    let (flow, _) = Flow::adopt(&config, &Source::open(&path).expect("opens"), None, 5, &device).expect("fits");
    let clip = [1, 2, 4, 4];
    let conditions = wan::flow::conditions(&config, clip, &[], &device);
    let velocity = flow.velocity(wan::flow::latents(clip, &device), &[0.0], &conditions);
    let mut found = wan::gradients::weighed(velocity.expect("renders")).backward();
    for (parameter, gradient) in
        parameters::export(&flow).iter().zip(parameters::gradients(&flow, &mut found).expect("gradients"))
    {
        let gradient = gradient.unwrap_or_else(|| panic!("{} has no gradient", parameter.name));
        // The environment's embedder learns once its projections are no longer 0.
        let waits = parameter.name.starts_with("environment.embed");
        assert!(waits != gradient.iter().any(|&g| g != 0.0), "{}", parameter.name);
    }
}
