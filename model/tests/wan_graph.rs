//! The wan networks against themselves: two-dimensional against three-dimensional form, chunks against the whole, counts and
//! names against the published ones.

mod wan;

use burn::tensor::ops::ConvOptions;
use burn::tensor::{Device, Tensor, TensorData, module};
use renderflow_model::wan::init::Init;
use renderflow_model::wan::names::{Named, Naming};
use renderflow_model::wan::vae::{Cache, CausalConv, Tiling};
use renderflow_model::wan::{Dit, DitConfig, DitInput, Vace, VaceConfig, Vae, VaeConfig};
use wan::{beside_repository, values};

/// Values between -1 and 1 without a pattern a convolution could share.
fn waves<const D: usize>(shape: [usize; D], seed: f32) -> Tensor<D> {
    let values: Vec<f32> =
        (0..shape.iter().product()).map(|i| (i as f32 * 0.7391 + seed).sin() * (i as f32 * 0.013).cos()).collect();
    Tensor::from_data(TensorData::new(values, shape), &Device::flex())
}

/// Largest difference over the largest value.
fn relative<const D: usize>(got: Tensor<D>, want: Tensor<D>) -> f32 {
    let (got, want) = (values(got), values(want));
    assert_eq!(got.shape, want.shape);
    assert!(got.values.iter().all(|v| v.is_finite()));
    let most = got.values.iter().zip(&want.values).fold(0.0f32, |most, (a, b)| most.max((a - b).abs()));
    most / want.values.iter().fold(0.0f32, |most, v| most.max(v.abs()))
}

#[test]
fn the_causal_convolution_is_one_over_time_and_space() {
    let device = Device::flex();
    for (k, b, frames, h, w, from, to) in [(3, 1, 5, 6, 7, 4, 5), (3, 2, 1, 3, 2, 9, 3), (1, 2, 4, 5, 3, 6, 8)] {
        let conv = CausalConv::new(&mut Init::new(9, &device), k, from, to);
        let x = waves([b, frames, h, w, from], 0.3);
        // burn's own: channels first, zeros before the first frame.
        let padded = Tensor::cat(vec![Tensor::zeros([b, 2, h, w, from], &device), x.clone()], 1).permute([0, 4, 1, 2, 3]);
        let weight = conv.weight.val().permute([4, 3, 2, 0, 1]);
        let options = ConvOptions::new([1, 1, 1], [0, k / 2, k / 2], [1, 1, 1], 1);
        let want = module::conv3d(padded, weight, Some(conv.bias.val()), options).permute([0, 2, 3, 4, 1]);
        let whole = conv.forward(x.clone(), &mut Cache::new());
        assert!(relative(whole, want.clone()) < 1e-6);
        for chunks in [vec![1; frames], vec![1, frames - 1], vec![frames - 1, 1]] {
            let (mut cache, mut start, mut parts) = (Cache::new(), 0, vec![]);
            for count in chunks.into_iter().filter(|&count| count > 0) {
                cache.rewind();
                parts.push(conv.forward(x.clone().narrow(1, start, count), &mut cache));
                start += count;
            }
            assert!(relative(Tensor::cat(parts, 1), want.clone()) < 1e-6);
        }
    }
}

#[test]
fn the_two_dimensional_form_is_exact() {
    let (device, config) = (Device::flex(), VaeConfig::tiny());
    let vae = Vae::new(&config, 3, &device).expect("network");
    for frames in [1, 5] {
        let pictures = waves([2, 3, frames, 24, 16], 0.1);
        let flat = vae.moments(pictures.clone()).expect("encodes");
        let deep = vae.moments_after(Cache::of_zeros(), pictures);
        let difference = relative(flat, deep);
        println!("{frames} frames, encoder: {difference:.1e}");
        assert!(difference < 1e-6);
        let latents = waves([2, 4, 1 + frames / 4, 3, 2], 0.5);
        let flat = vae.decode(latents.clone()).expect("decodes");
        let deep = vae.decode_after(Cache::of_zeros(), latents);
        let difference = relative(flat, deep);
        println!("{frames} frames, decoder: {difference:.1e}");
        assert!(difference < 1e-6);
    }
}

/// A clip's beginning does not know its end, and clips of one batch do not know each other.
#[test]
fn time_is_causal_and_clips_are_apart() {
    let vae = Vae::new(&VaeConfig::tiny(), 3, &Device::flex()).expect("network");
    let clip = waves([2, 3, 9, 16, 24], 0.2);
    let all = vae.encode(clip.clone()).expect("encodes");
    let beginning = vae.encode(clip.clone().narrow(2, 0, 5)).expect("encodes");
    assert!(relative(beginning, all.clone().narrow(2, 0, 2)) < 1e-6);
    let second = vae.encode(clip.narrow(0, 1, 1)).expect("encodes");
    assert!(relative(second, all.clone().narrow(0, 1, 1)) < 1e-6);
    let pictures = vae.decode(all.clone()).expect("decodes");
    assert_eq!(pictures.dims(), [2, 3, 9, 16, 24]);
    let first = vae.decode(all.narrow(0, 0, 1).narrow(2, 0, 2)).expect("decodes");
    assert!(relative(first, pictures.narrow(0, 0, 1).narrow(2, 0, 5)) < 1e-6);
}

/// Tiles that overlap widely come near to the whole; a single tile is the whole.
#[test]
fn tiles_are_near_the_whole() {
    let vae = Vae::new(&VaeConfig::tiny(), 3, &Device::flex()).expect("network");
    let pictures = waves([1, 3, 5, 64, 128], 0.2);
    let latents = vae.encode(pictures.clone()).expect("encodes");
    let single = vae.encode_tiled(pictures.clone(), Tiling::default()).expect("encodes");
    assert_eq!(values(single).values, values(latents.clone()).values);
    let single = vae.decode_tiled(latents.clone(), Tiling::default()).expect("decodes");
    let whole = vae.decode(latents.clone()).expect("decodes");
    assert_eq!(values(single).values, values(whole.clone()).values);
    let tiling = Tiling { size: 8, overlap: 6 };
    let tiled = vae.encode_tiled(pictures.clone(), tiling).expect("encodes");
    let (encoder, tiled) = (relative(tiled, latents.clone()), vae.decode_tiled(latents, tiling).expect("decodes"));
    let decoder = relative(tiled, whole);
    println!("tiles: encoder {encoder:.2}, decoder {decoder:.2} of the largest value");
    assert!(encoder < 0.5 && decoder < 0.5);
    vae.encode_tiled(pictures.narrow(3, 0, 20), tiling).expect_err("no multiple of 8");
}

/// Both paths of the modulated normalisation, and clips of a batch with times of their own.
#[test]
fn a_batch_is_its_clips_one_by_one() {
    let config = DitConfig::tiny();
    let mut vace = Vace::new(&VaceConfig::tiny(), 5, &Device::flex()).expect("network");
    // Heads and hints begin at zero, where everything would agree.
    vace.dit.head.weight = Init::new(6, &Device::flex()).matrix(32, 16);
    vace.blocks[1].proj_out.weight = Init::new(7, &Device::flex()).matrix(32, 32);
    let (latents, text) = (waves([2, 4, 2, 6, 4], 0.0), waves([2, 5, 24], 0.4));
    let (context, times) = (waves([2, 24, 2, 6, 4], 0.9), [900.0, 10.5]);
    let run = |range: std::ops::Range<usize>, text: Option<&Tensor<3>>| {
        let cut = |x: &Tensor<5>| x.clone().narrow(0, range.start, range.len());
        let text = text.map(|text| text.clone().narrow(0, range.start, range.len()));
        let input = DitInput { latents: cut(&latents), times: times[range.clone()].to_vec(), text };
        vace.forward(input, cut(&context), Some(&[1.0, 0.7])).expect("runs")
    };
    for text in [Some(&text), None] {
        let both = run(0..2, text);
        assert_eq!(both.dims(), [2, config.out_channels, 2, 6, 4]);
        for i in 0..2 {
            assert!(relative(run(i..i + 1, text), both.clone().narrow(0, i, 1)) < 1e-5);
        }
    }
}

#[test]
fn inputs_that_do_not_fit_are_refused() {
    let device = Device::flex();
    let vae = Vae::new(&VaeConfig::tiny(), 0, &device).expect("network");
    for shape in [[1, 3, 2, 16, 16], [1, 3, 0, 16, 16], [1, 4, 1, 16, 16], [1, 3, 1, 4, 16], [1, 3, 1, 20, 16]] {
        let error = vae.encode(Tensor::zeros(shape, &device)).expect_err("must fail").to_string();
        assert!(error.starts_with("autoencoder: "), "{error}");
    }
    for shape in [[1, 3, 1, 2, 2], [1, 4, 0, 2, 2]] {
        vae.decode(Tensor::zeros(shape, &device)).expect_err("must fail");
    }
    let dit = Dit::new(&DitConfig::tiny().without_text(), 0, &device).expect("network");
    let input = |shape, time| DitInput { latents: Tensor::zeros(shape, &device), times: vec![time], text: None };
    dit.forward(input([1, 4, 1, 2, 2], 3.0)).expect("runs");
    let text = DitInput { text: Some(Tensor::zeros([1, 5, 24], &device)), ..input([1, 4, 1, 2, 2], 3.0) };
    for wrong in [
        input([1, 5, 1, 2, 2], 0.0),
        input([1, 4, 1, 3, 2], 0.0),
        input([1, 4, 0, 2, 2], 0.0),
        input([2, 4, 1, 2, 2], 0.0),
        input([1, 4, 1, 2, 2], f64::NAN),
        text,
    ] {
        let error = dit.forward(wrong).expect_err("must fail").to_string();
        assert!(error.starts_with("transformer: "), "{error}");
    }
}

/// Parameters of the published networks, item by item. Nothing is made: the largest has 8.6 GB of them.
#[test]
fn parity_parameter_counts() {
    let device = Device::flex();
    let vae = Vae::new(&VaeConfig::wan(), 0, &device).expect("network");
    let part = |network: &dyn Fn(&str) -> bool, of: &dyn Named2| of.sum(network);
    assert_eq!(vae.count(), 126_892_531);
    assert_eq!(part(&|n| n.starts_with("encoder."), &vae), 53_595_872);
    assert_eq!(part(&|n| n.starts_with("decoder."), &vae), 73_295_331);
    assert_eq!(part(&|n| n.starts_with("quant_conv."), &vae), 1_056);
    assert_eq!(part(&|n| n.starts_with("post_quant_conv."), &vae), 272);

    let dit = Dit::new(&DitConfig::wan_1_3b(), 0, &device).expect("network");
    assert_eq!(dit.count(), 1_418_996_800);
    assert_eq!(part(&|n| n.starts_with("blocks.7.attn2."), &dit), 9_446_400);
    assert_eq!(part(&|n| n.starts_with("blocks.7.norm2."), &dit), 3_072);
    assert_eq!(part(&|n| n.contains("text_embedder"), &dit), 8_653_824);
    let backbone = Dit::new(&DitConfig::wan_1_3b().without_text(), 0, &device).expect("network");
    assert_eq!(backbone.count(), 1_126_858_816);

    let vace = Vace::new(&VaceConfig::wan_1_3b(), 0, &device).expect("network");
    assert_eq!(vace.count(), 2_153_972_032);
    assert_eq!(part(&|n| n.starts_with("vace_patch_embedding."), &vace), 591_360);
}

/// Sums over tensors by name.
trait Named2 {
    fn sum(&self, which: &dyn Fn(&str) -> bool) -> u64;
}

impl<M: Named> Named2 for M {
    fn sum(&self, which: &dyn Fn(&str) -> bool) -> u64 {
        self.entries().iter().filter(|entry| which(&entry.diffusers)).map(|entry| entry.parameters()).sum()
    }
}

/// Every name and shape of the published networks, in both layouts.
#[test]
fn parity_names_and_shapes() {
    let device = Device::flex();
    let vae = Vae::new(&VaeConfig::wan(), 0, &device).expect("network").entries();
    let dit = Dit::new(&DitConfig::wan_1_3b(), 0, &device).expect("network").entries();
    let vace = Vace::new(&VaceConfig::wan_1_3b(), 0, &device).expect("network").entries();
    for (file, entries) in [("names_vae_full", vae), ("names_dit_1.3B", dit), ("names_vace_1.3B", vace)] {
        let path = beside_repository(&format!("shared/spec/{file}.tsv"));
        let Ok(text) = std::fs::read_to_string(&path) else {
            println!("skipped: {} is not there", path.display());
            continue;
        };
        let mut want: Vec<String> = text.lines().skip(1).map(str::to_string).collect();
        let line = |e: &renderflow_model::wan::names::Entry| {
            format!("{}\t{}\t{:?}", e.name(Naming::Diffusers), e.name(Naming::Original), e.shape)
        };
        let mut got: Vec<String> = entries.iter().map(line).collect();
        want.sort();
        got.sort();
        assert_eq!(got.len(), want.len(), "{file}");
        for (got, want) in got.iter().zip(&want) {
            assert_eq!(got, want, "{file}");
        }
        println!("{file}: {} names and shapes", want.len());
    }
}
