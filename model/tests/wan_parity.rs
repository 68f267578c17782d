//! The wan networks against diffusers: every tensor of a folder of fixtures, intermediate activations too.
//!
//! `references/wan_fixtures.py` makes such a folder; `RENDERFLOW_FIXTURES` names another one than the project's own.

mod wan;

use burn::tensor::{Device, Tensor, TensorData};
use renderflow_model::wan::activations::record;
use renderflow_model::wan::dit::Prepared;
use renderflow_model::wan::flow::{Conditions, KeyframeConfig, KeyframeLatent};
use renderflow_model::wan::names::Named;
use renderflow_model::wan::weights::{LoadOptions, Source, is_context_path, is_text_path, load};
use renderflow_model::wan::{Activation, Dit, DitConfig, DitInput, Flow, FlowConfig, Gelu, Vace, VaceConfig, Vae, VaeConfig};
use std::collections::BTreeMap;
use std::path::Path;
use wan::gradients::tensor;
use wan::{Comparison, Fixtures, Values, values};

const VAE: f32 = 2e-5;
const DIT: f32 = 1e-5;

fn vae(fixtures: &Fixtures, weights: &Path) -> Vae {
    let config = VaeConfig::read(&fixtures.file("vae_config.json")).expect("configuration");
    let vae = Vae::new(&config, 0, &Device::flex()).expect("network");
    load(vae, &Source::open(weights).expect("weights"), LoadOptions::default()).expect("weights that fit").0
}

fn dit(fixtures: &Fixtures, weights: &Path) -> Dit {
    let config = DitConfig::read(&fixtures.file("dit_config.json")).expect("configuration");
    let dit = Dit::new(&config, 0, &Device::flex()).expect("network");
    load(dit, &Source::open(weights).expect("weights"), LoadOptions::default()).expect("weights that fit").0
}

fn compare_vae(fixtures: &Fixtures, weights: &Path) {
    let vae = vae(fixtures, weights);
    let mut references = fixtures.references("vae_io.safetensors");
    let mut comparison = Comparison::default();
    let z = vae.config().z_dim;
    let statistics = |values: &[f32]| Values { shape: vec![z], values: values.to_vec() };
    comparison.check("latents_mean", &statistics(&vae.config().latents_mean), &references.values("latents_mean"), 1e-6);
    comparison.check("latents_std", &statistics(&vae.config().latents_std), &references.values("latents_std"), 1e-6);
    for f in references.starts_of(".enc.input") {
        let input = references.tensor(&format!("{f}.enc.input"));
        let (moments, mut activations) = record(|| vae.moments(input).expect("encodes"));
        let mode = moments.clone().narrow(1, 0, z);
        let mut check = |name: &str, got: Tensor<5>| {
            let name = format!("{f}.{name}");
            comparison.check(&name, &values(got), &references.values(&name), VAE);
        };
        check("enc.moments", moments);
        check("enc.mode", mode.clone());
        check("enc.mode_normalised", vae.normalise(mode));
        let input = references.tensor(&format!("{f}.dec.input_normalised"));
        let mut check = |name: &str, got: Tensor<5>| {
            let name = format!("{f}.{name}");
            comparison.check(&name, &values(got), &references.values(&name), VAE);
        };
        check("dec.input", vae.denormalise(input.clone()));
        check("dec.output", vae.decode_normalised(input.clone()).expect("decodes"));
        let (output, decoded) = record(|| vae.decode(vae.denormalise(input)).expect("decodes"));
        activations.extend(decoded);
        check("dec.output_unclamped", output);
        if f == "f1" {
            for Activation { name, shape, values } in activations {
                let name = format!("f1.act.{name}");
                if references.has(&name) {
                    comparison.check(&name, &Values { shape, values }, &references.values(&name), VAE);
                }
            }
        }
    }
    references.all_were_used();
    comparison.finish();
}

#[test]
fn parity_vae() {
    let Some(fixtures) = wan::fixtures() else { return };
    compare_vae(&fixtures, &fixtures.file("vae_weights.diffusers.safetensors"));
}

#[test]
fn parity_vae_original_names() {
    let Some(fixtures) = wan::fixtures() else { return };
    for file in ["vae_weights.original-names.safetensors", "vae_weights.original-names.pth"] {
        if let Some(weights) = fixtures.optional(file) {
            compare_vae(&fixtures, &weights);
        }
    }
}

fn input(references: &mut wan::References, case: &str, text: bool) -> DitInput {
    let times = references.values(&format!("{case}timestep")).values;
    let text_tokens = references.tensor(&format!("{case}text"));
    DitInput {
        latents: references.tensor(&format!("{case}hidden_states")),
        times: times.into_iter().map(f64::from).collect(),
        text: text.then_some(text_tokens),
    }
}

/// The waves of the times with angles taken in f32, as diffusers does and the original does not. Where a network amplifies the
/// difference, the references are that much off.
fn rounded_waves(dit: &Dit, input: &DitInput) -> Tensor<3> {
    let half = dit.config().freq_dim / 2;
    let angles = |t: f64| (0..half).map(move |i| t as f32 * (-(10_000f64.ln() as f32) * i as f32 / half as f32).exp());
    let waves = |&t: &f64| angles(t).map(f32::cos).chain(angles(t).map(f32::sin)).collect::<Vec<_>>();
    let values: Vec<f32> = input.times.iter().flat_map(waves).collect();
    Tensor::from_data(TensorData::new(values, [input.times.len(), 1, 2 * half]), &Device::flex())
}

/// How far an output moves with [`rounded_waves`]; never so far that a wave that is wrong would pass.
fn rounding(dit: &Dit, input: &DitInput, output: &Tensor<5>, run: impl Fn(Prepared) -> Tensor<5>) -> f32 {
    let mut state = dit.prepare(input.clone()).expect("runs");
    (state.time, state.modulation) = dit.time.forward(rounded_waves(dit, input));
    let moved: f32 = (run(state) - output.clone()).abs().max().into_scalar();
    moved.min(5e-5)
}

fn compare_dit(fixtures: &Fixtures, weights: &Path) {
    let dit = dit(fixtures, weights);
    let mut references = fixtures.references("dit_io.safetensors");
    let mut comparison = Comparison::default();
    for case in references.starts_of(".hidden_states") {
        let input = input(&mut references, &format!("{case}."), true);
        let output = dit.forward(input.clone()).expect("runs");
        let rounding = rounding(&dit, &input, &output, |state| dit.run(state));
        let name = format!("{case}.output");
        comparison.check(&name, &values(output), &references.values(&name), DIT + rounding);
    }
    for case in references.starts_of(".nocross.output") {
        let input = input(&mut references, &format!("{case}."), false);
        let (output, activations) = record(|| dit.forward(input.clone()).expect("runs"));
        let rounding = rounding(&dit, &input, &output, |state| dit.run(state));
        let name = format!("{case}.nocross.output");
        comparison.check(&name, &values(output), &references.values(&name), DIT + rounding);
        for Activation { name, shape, values } in activations {
            let name = format!("{case}.nocross.act.{name}");
            if references.has(&name) {
                // The reference takes the angles of its waves in f32: half a unit in the last place of 250 is 8e-6 already.
                let tolerance = if name.ends_with("timestep_sinusoid") { 3e-5 } else { DIT };
                comparison.check(&name, &Values { shape, values }, &references.values(&name), tolerance);
            }
        }
    }
    references.all_were_used();
    comparison.finish();
}

#[test]
fn parity_dit() {
    let Some(fixtures) = wan::fixtures() else { return };
    compare_dit(&fixtures, &fixtures.file("dit_weights.diffusers.safetensors"));
}

#[test]
fn parity_dit_original_names() {
    let Some(fixtures) = wan::fixtures() else { return };
    for file in ["dit_weights.original-names.safetensors", "dit_weights.original-names.pth"] {
        if let Some(weights) = fixtures.optional(file) {
            compare_dit(&fixtures, &weights);
        }
    }
}

/// The graph without text reads the same files, leaves the text's tensors aside and gives the same result.
#[test]
fn parity_dit_without_text() {
    let Some(fixtures) = wan::fixtures() else { return };
    let config = DitConfig::read(&fixtures.file("dit_config.json")).expect("configuration").without_text();
    let dit = Dit::new(&config, 0, &Device::flex()).expect("network");
    let source = Source::open(&fixtures.file("dit_weights.diffusers.safetensors")).expect("weights");
    let options = LoadOptions { ignore: &is_text_path, ..Default::default() };
    let (dit, report) = load(dit, &source, options).expect("weights that fit");
    assert_eq!(report.ignored.len(), 4 + config.layers * if config.cross_attn_norm { 12 } else { 10 });
    let mut references = fixtures.references("dit_io.safetensors");
    let mut comparison = Comparison::default();
    for case in references.starts_of(".nocross.output") {
        let input = input(&mut references, &format!("{case}."), false);
        let output = dit.forward(input.clone()).expect("runs");
        let rounding = rounding(&dit, &input, &output, |state| dit.run(state));
        let name = format!("{case}.nocross.output");
        comparison.check(&name, &values(output), &references.values(&name), DIT + rounding);
    }
    comparison.finish();
}

/// A renderer that has just adopted published weights is the published transformer at `1000 (1 - t)`, with the sign turned,
/// whatever its attributes, its environment and its keyframes are.
#[test]
fn parity_of_an_adopted_renderer() {
    let Some(fixtures) = wan::fixtures() else { return };
    let device = Device::flex();
    let dit = DitConfig::read(&fixtures.file("dit_config.json")).expect("configuration").without_text();
    let z = dit.in_channels;
    let vae = VaeConfig { z_dim: z, latents_mean: vec![0.0; z], latents_std: vec![1.0; z], ..VaeConfig::tiny() };
    let config = FlowConfig { vae, dit, ..FlowConfig::tiny() };
    let config = config.with_keyframes(KeyframeConfig { lora_rank: 2, ..KeyframeConfig::default() });
    if let Err(reason) = config.validate() {
        println!("skipped: these dimensions are no renderer's: {reason}");
        return;
    }
    let files = ["dit_weights.diffusers.safetensors", "dit_weights.original-names.safetensors", "dit_weights.original-names.pth"];
    for weights in files.into_iter().filter_map(|file| fixtures.optional(file)) {
        let source = Source::open(&weights).expect("weights");
        let (flow, _) = Flow::adopt(&config, &source, None, 0, &device).expect("weights that fit");
        let mut references = fixtures.references("dit_io.safetensors");
        let mut comparison = Comparison::default();
        for case in references.starts_of(".nocross.output") {
            let input = input(&mut references, &format!("{case}."), false);
            let [b, _, f, h, w] = input.latents.dims();
            let [_, ph, pw] = config.dit.patch_size;
            let conditions = Conditions {
                attributes: tensor([b, config.attribute_channels(), f, h, w], 0.2, &device),
                environment: tensor([b, z, f, 2 * ph, 4 * pw], 0.3, &device),
                keyframes: vec![KeyframeLatent { latent: tensor([b, z, 1, h, w], 0.4, &device), time: 0.75 }],
            };
            let times: Vec<f64> = input.times.iter().map(|t| 1.0 - t / 1000.0).collect();
            let velocity = flow.velocity(input.latents.clone(), &times, &conditions).expect("renders");
            let output = flow.dit.forward(input.clone()).expect("runs");
            let rounding = rounding(&flow.dit, &input, &output, |state| flow.dit.run(state));
            let name = format!("{case}.nocross.output");
            comparison.check(&name, &values(velocity.neg()), &references.values(&name), DIT + rounding);
        }
        comparison.finish();
    }
}

#[test]
fn parity_vace() {
    let Some(fixtures) = wan::fixtures() else { return };
    let config = VaceConfig::read(&fixtures.file("vace_config.json")).expect("configuration");
    let source = Source::open(&fixtures.file("vace_weights.diffusers.safetensors")).expect("weights");
    let vace = Vace::new(&config, 0, &Device::flex()).expect("network");
    let (vace, _) = load(vace, &source, LoadOptions::default()).expect("weights that fit");
    let mut references = fixtures.references("vace_io.safetensors");
    let input = input(&mut references, "", true);
    let control = references.tensor("control");
    let want = references.values("output");
    let output = vace.forward(input.clone(), control.clone(), None).expect("runs");
    let mut comparison = Comparison::default();
    let run = |state| vace.run(state, control.clone(), None).expect("runs");
    let rounding = rounding(&vace.dit, &input, &output, run);
    comparison.check("output", &values(output), &want, DIT + rounding);
    // Hints times 0 are the transformer alone, whose weights are in the same file.
    let silent = vec![0.0; config.vace_layers.len()];
    let silent = vace.forward(input.clone(), control, Some(&silent)).expect("runs");
    let dit = Dit::new(&config.dit, 0, &Device::flex()).expect("network");
    let options = LoadOptions { ignore: &is_context_path, ..Default::default() };
    let (dit, _) = load(dit, &source, options).expect("weights that fit");
    let alone = dit.forward(input).expect("runs");
    comparison.check("without hints", &values(silent), &values(alone), 1e-7);
    references.all_were_used();
    comparison.finish();
}

/// Names and shapes of the sets that list them.
#[test]
fn parity_names_of_the_set() {
    let Some(fixtures) = wan::fixtures() else { return };
    let vae = VaeConfig::read(&fixtures.file("vae_config.json")).expect("configuration");
    let dit = DitConfig::read(&fixtures.file("dit_config.json")).expect("configuration");
    let vae = Vae::new(&vae, 0, &Device::flex()).expect("network").entries();
    let dit = Dit::new(&dit, 0, &Device::flex()).expect("network").entries();
    for (file, entries) in [("vae_names.json", vae), ("dit_names.json", dit)] {
        let Some(path) = fixtures.optional(file) else { continue };
        let text = std::fs::read_to_string(path).expect("names");
        let want: BTreeMap<String, (String, Vec<usize>)> = serde_json::from_str(&text).expect("names");
        let got: BTreeMap<_, _> = entries.into_iter().map(|e| (e.diffusers, (e.original, e.shape))).collect();
        assert_eq!(got, want, "{file}");
    }
}

/// What no output can tell: with the published constants another one of these would pass unnoticed.
#[test]
fn parity_constants() {
    let Some(fixtures) = wan::fixtures() else { return };
    for name in ["dit_config.json", "vace_config.json"] {
        let path = fixtures.file(name);
        let text = std::fs::read_to_string(&path).expect("configuration");
        let published: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let eps = published["eps"].as_f64().expect("eps");
        let config = DitConfig::read(&path).expect("configuration");
        assert_eq!((config.layer_norm_eps, config.qk_norm_eps), (eps, eps), "{name}");
        assert_eq!((config.activation, config.rope_theta), (Gelu::Tanh, 10_000.0), "{name}");
    }
}
