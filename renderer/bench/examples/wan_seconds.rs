//! Seconds of the paper's network at its published size, with random weights, on one square picture; needs up to 7 GB of memory.
//!
//! `cargo run --release -p renderflow-bench --example wan_seconds -- [renderer|autoencoder|transformer] [SIZE] [LAYERS]
//! [KEYFRAMES]`
//!
//! `renderer`, without a word: five pictures to latents, one velocity, one picture of the latents, three times; the weights are
//! drawn in the first. `autoencoder`: the two-dimensional form of single pictures and the three-dimensional one by turns.
//! `transformer`: with and without text by turns. SIZE is in pixels (512), LAYERS are the blocks of the transformer (30),
//! KEYFRAMES those given (0).

use burn::tensor::{Device, Tensor, TensorData};
use renderflow::util::machine;
use renderflow_model::wan::flow::{Conditions, KeyframeConfig, KeyframeLatent};
use renderflow_model::wan::names::Named;
use renderflow_model::wan::vae::Cache;
use renderflow_model::wan::{Dit, DitConfig, DitInput, Flow, FlowConfig, Vae, VaeConfig};
use std::error::Error;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let mut words = std::env::args().skip(1);
    let what = words.next().unwrap_or_else(|| "renderer".into());
    let mut number = |default: usize| words.next().map_or(Ok(default), |word| word.parse());
    let (size, layers, keyframes) = (number(512)?, number(30)?, number(0)?);
    match what.as_str() {
        "renderer" => renderer(size, layers, keyframes)?,
        "autoencoder" => autoencoder(size)?,
        "transformer" => transformer(size, layers)?,
        other => return Err(format!("{other}: not one of renderer, autoencoder and transformer").into()),
    }
    println!("peak memory {:.2} GB", machine::peak() as f64 / 1e9);
    Ok(())
}

/// Values between -1 and 1 without a pattern that a convolution could share.
fn waves<const D: usize>(shape: [usize; D], seed: f32) -> Tensor<D> {
    let values: Vec<f32> =
        (0..shape.iter().product()).map(|i| (i as f32 * 0.7391 + seed).sin() * (i as f32 * 0.013).cos()).collect();
    Tensor::from_data(TensorData::new(values, shape), &Device::flex())
}

/// Runs and prints the seconds. What is computed is looked at, so that it is computed.
fn timed<const D: usize>(
    what: &str,
    run: impl FnOnce() -> Result<Tensor<D>, Box<dyn Error>>,
) -> Result<Tensor<D>, Box<dyn Error>> {
    let start = Instant::now();
    let result = run()?;
    let mean: f32 = result.clone().abs().mean().into_scalar();
    println!("{what}: {:.2} s ({mean})", start.elapsed().as_secs_f32());
    Ok(result)
}

fn renderer(size: usize, layers: usize, keyframes: usize) -> Result<(), Box<dyn Error>> {
    let device = Device::flex();
    let mut config = FlowConfig::wan_1_3b();
    config.dit.layers = layers;
    if keyframes > 0 {
        config = config.with_keyframes(KeyframeConfig::default());
    }
    let flow = Flow::new(&config, 1, &device)?;
    let vae = Vae::new(&config.vae, 2, &device)?;
    for _ in 0..3 {
        let latents = timed("five pictures to latents", || {
            let encode = |seed| vae.encode_normalised(waves([1, 3, 1, size, size], seed).mul_scalar(0.5));
            Ok(Tensor::cat([0.1, 0.2, 0.3, 0.4, 0.5].into_iter().map(encode).collect::<Result<Vec<_>, _>>()?, 1))
        })?;
        let z = config.vae.z_dim;
        let part = |i: usize, count: usize| latents.clone().narrow(1, i * z, count * z);
        let mut reference = latents.dims();
        reference[1] = config.reference_channels();
        let conditions = Conditions {
            attributes: Tensor::cat(vec![Tensor::ones(reference, &device), part(1, 3)], 1),
            environment: part(4, 1),
            keyframes: (0..keyframes).map(|i| KeyframeLatent { latent: part(0, 1), time: 4.0 * i as f64 }).collect(),
        };
        let velocity = timed("velocity", || Ok(flow.velocity(part(0, 1), &[0.0], &conditions)?))?;
        timed("latents to a picture", || Ok(vae.decode_normalised(part(0, 1) + velocity)?))?;
    }
    println!("{} parameters", flow.count() + vae.count());
    Ok(())
}

fn autoencoder(size: usize) -> Result<(), Box<dyn Error>> {
    let vae = Vae::new(&VaeConfig::wan(), 1, &Device::flex())?;
    let (pictures, latents) = (waves([1, 3, 1, size, size], 0.1), waves([1, 16, 1, size / 8, size / 8], 0.2));
    for _ in 0..4 {
        let encode = |cache: Cache| Ok(vae.moments_after(cache, pictures.clone()));
        let decode = |cache: Cache| Ok(vae.decode_after(cache, latents.clone()));
        timed("encode, 2D", || encode(Cache::new()))?;
        timed("encode, 3D", || encode(Cache::of_zeros()))?;
        timed("decode, 2D", || decode(Cache::new()))?;
        timed("decode, 3D", || decode(Cache::of_zeros()))?;
    }
    Ok(())
}

fn transformer(size: usize, layers: usize) -> Result<(), Box<dyn Error>> {
    let dit = Dit::new(&DitConfig { layers, ..DitConfig::wan_1_3b() }, 1, &Device::flex())?;
    for i in 0..6 {
        let text = (i % 2 == 0).then(|| waves([1, 512, 4096], 0.2));
        let what = if text.is_some() { "with text" } else { "without text" };
        let input = DitInput { latents: waves([1, 16, 1, size / 8, size / 8], 0.1), times: vec![1000.0], text };
        timed(what, || Ok(dit.forward(input)?))?;
    }
    Ok(())
}
