//! The renderer as a whole: stages, batches, counts, names, limits.

mod wan;

use burn::tensor::{Device, Tensor};
use renderflow_model::parameters;
use renderflow_model::wan::flow::{Conditions, Group, Intrinsic, InverseConfig, KeyframeConfig, KeyframeLatent, Query, Shared};
use renderflow_model::wan::layers::Dense;
use renderflow_model::wan::names::{Named, Naming};
use renderflow_model::wan::{Flow, FlowConfig};
use wan::account::{Part, account};
use wan::flow::{CLIP, TIMES, both, conditions, difference, invert, latents, velocity, warm};
use wan::gradients::{tensor, weighed};
use wan::values;

#[test]
fn stages_are_the_whole() {
    let device = Device::flex();
    for config in both() {
        let flow = warm(&config, &device);
        let run = |(mut tokens, shared): (Tensor<3>, Shared)| {
            let count = shared.tensors().len();
            let shared = shared.with_tensors(shared.tensors());
            (0..config.dit.layers).for_each(|i| tokens = flow.block(i, tokens.clone(), &shared));
            (count, values(flow.finish(tokens, &shared)).values)
        };
        for (keyframes, count) in [(vec![], 3), (vec![-1.0, 2.25], 4)] {
            let conditions = conditions(&config, CLIP, &keyframes, &device);
            let prepared = flow.prepare(latents(CLIP, &device), &TIMES, &conditions).expect("fits");
            assert_eq!(prepared.0.dims()[1], 2 * 2 * 3);
            assert!(run(prepared) == (count, velocity(&flow, &conditions)));
        }
        let z_t = latents(CLIP, &device);
        let prepared = flow.prepare_inverse(z_t.clone(), &TIMES, Intrinsic::Depth).expect("fits");
        let (count, velocity) = run(prepared);
        assert_eq!(count, 3);
        let half = velocity.len() / 2;
        let end: Vec<f32> = values(z_t)
            .values
            .iter()
            .zip(&velocity)
            .enumerate()
            .map(|(i, (z, v))| z + if i < half { 1.0 } else { 0.75 } * v)
            .collect();
        assert!(difference(&invert(&flow, Intrinsic::Depth), &end) < 1e-6);
    }
}

/// Shared tensors reach the blocks: with others in their place the result is another.
#[test]
fn shared_tensors_are_what_the_blocks_see() {
    let device = Device::flex();
    let [config, _] = both();
    let flow = warm(&config, &device);
    let conditions = conditions(&config, CLIP, &[1.0], &device);
    let (tokens, shared) = flow.prepare(latents(CLIP, &device), &TIMES, &conditions).expect("fits");
    let of = |shared: &Shared| values(flow.finish(flow.block(0, tokens.clone(), shared), shared)).values;
    for i in 0..shared.tensors().len() {
        let mut tensors = shared.tensors();
        tensors[i] = tensors[i].clone().mul_scalar(1.5);
        assert!(of(&shared.with_tensors(tensors)) != of(&shared), "tensor {i}");
    }
}

/// Each clip of a batch is rendered by itself, at its own time.
#[test]
fn a_batch_is_its_clips_one_by_one() {
    let device = Device::flex();
    for config in both() {
        let flow = warm(&config, &device);
        let all = conditions(&config, CLIP, &[0.5, -2.0], &device);
        let z_t = latents(CLIP, &device);
        let together = velocity(&flow, &all);
        let inverse = invert(&flow, Intrinsic::Normal);
        let size = together.len() / 2;
        for i in 0..2 {
            let cut = |x: &Tensor<5>| x.clone().narrow(0, i, 1);
            let one = Conditions {
                attributes: cut(&all.attributes),
                environment: cut(&all.environment),
                keyframes: all.keyframes.iter().map(|k| KeyframeLatent { latent: cut(&k.latent), time: k.time }).collect(),
            };
            let alone = flow.velocity(cut(&z_t), &TIMES[i..=i], &one).expect("renders");
            assert!(difference(&values(alone).values, &together[i * size..][..size]) < 1e-5);
            let alone = flow.invert(cut(&z_t), &TIMES[i..=i], Intrinsic::Normal).expect("inverts");
            assert!(difference(&values(alone).values, &inverse[i * size..][..size]) < 1e-5);
        }
    }
}

/// Values and gradients of a clip large enough to be shared out are the same bits whoever computes them.
#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let device = Device::flex().autodiff();
    let mut config = FlowConfig::small().with_keyframes(KeyframeConfig::default()).with_inverse(InverseConfig::default());
    config.dit.layers = 1;
    let flow = warm(&config, &device);
    let (z, f, h, w) = (16, 2, 20, 36);
    let conditions = Conditions {
        attributes: tensor([1, config.attribute_channels(), f, h, w], 0.2, &device),
        environment: tensor([1, z, f, 32, 64], 0.3, &device),
        keyframes: vec![KeyframeLatent { latent: tensor([1, z, 1, h, w], 0.4, &device), time: 0.75 }],
    };
    let run = || {
        let z_t = tensor([1, z, f, h, w], 0.1, &device);
        let rendered = flow.velocity(z_t.clone(), &[0.25], &conditions).expect("renders");
        let back = flow.invert(z_t, &[0.5], Intrinsic::Material).expect("inverts");
        let found = [rendered.clone(), back.clone()].map(|x| values(x.without_autodiff()).values);
        (found, parameters::gradients(&flow, &mut (weighed(rendered) + weighed(back)).backward()).expect("gradients"))
    };
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    let (values, gradients) = pool(1).install(run);
    assert!(values.iter().flatten().all(|v| v.is_finite()) && gradients.iter().flatten().flatten().all(|g| g.is_finite()));
    for threads in [3, 8] {
        let (more_values, more_gradients) = pool(threads).install(run);
        assert!(more_values == values, "values with {threads} threads");
        for ((parameter, more), one) in parameters::export(&flow).iter().zip(&more_gradients).zip(&gradients) {
            assert!(more == one, "gradient of {} with {threads} threads", parameter.name);
        }
    }
}

/// The published size, item by item, from shapes alone.
#[test]
fn parity_parameter_counts_of_the_renderer() {
    use Part::*;
    let base = FlowConfig::wan_1_3b();
    let with_keyframes = base.clone().with_keyframes(KeyframeConfig::default());
    let counted = account(&base);
    println!("{counted}");
    let of_base = [
        (Backbone, 1_126_858_816),
        (AttributeEmbedder, 886_272),
        (EnvironmentEmbedder, 99_840),
        (EnvironmentAdapter, 141_649_920),
        (Autoencoder, 126_892_531),
    ];
    for (part, parameters) in of_base {
        assert_eq!(counted.of(part), parameters, "{}", part.name());
    }
    assert_eq!((counted.items.len(), counted.total()), (5, 1_396_387_379));
    assert_eq!(counted.total() - counted.of(Autoencoder), 1_269_494_848);

    let counted = account(&with_keyframes);
    println!("{counted}");
    let added = [(KeyframeAttention, 283_392_000), (KeyframeEmbedder, 99_840), (KeyframeLora, 20_152_320)];
    for (part, parameters) in of_base.into_iter().chain(added) {
        assert_eq!(counted.of(part), parameters, "{}", part.name());
    }
    assert_eq!((counted.items.len(), counted.total()), (8, 1_700_031_539));
    assert_eq!(counted.of(KeyframeAttention) + counted.of(KeyframeEmbedder), 283_491_840);

    // Without queries of its own, and without corrections.
    let reused = KeyframeConfig { query: Query::Reused, lora_rank: 0, ..KeyframeConfig::default() };
    let counted = account(&base.clone().with_keyframes(reused));
    assert_eq!(counted.of(KeyframeAttention), 283_392_000 - 30 * (1536 * 1536 + 2 * 1536));
    assert_eq!(counted.of(KeyframeLora), 0);
    let counted = account(&base.with_inverse(InverseConfig::default()));
    println!("{counted}");
    assert_eq!(counted.of(InverseEmbedder), 99_840);
    assert_eq!(counted.of(InverseLora), 30 * 3 * 32 * 2 * 1536);
    assert_eq!(counted.of(InversePrompts), 30 * (9_446_400 + 3_072) + 5 * 4 * 1536);
    assert_eq!(counted.of(InverseHeads), 4 * (1536 * 1536 + 1536 + 1536 * 64 + 64));

    let small = account(&FlowConfig::small().with_keyframes(KeyframeConfig::default()));
    println!("{small}");
    let transformer = small.total() - small.of(Autoencoder);
    assert!((19_000_000..21_000_000).contains(&transformer), "{transformer}");
}

/// Every tensor has a name of its own, and its two groupings agree.
#[test]
fn names_tell_the_group() {
    for config in both() {
        let flow = Flow::new(&config, 3, &Device::flex()).expect("network");
        let count = parameters::export(&flow).len();
        assert_eq!(flow.entries().len(), count);
        for naming in [Naming::Diffusers, Naming::Original] {
            let names: std::collections::HashSet<String> = flow.entries().iter().map(|e| e.name(naming).to_string()).collect();
            assert_eq!(names.len(), count);
        }
        for group in Group::ALL {
            let parameters = parameters::export(&flow).into_iter().filter(|p| Group::of(&p.name) == group);
            let parameters: usize = parameters.map(|p| p.values.len()).sum();
            assert!(parameters > 0);
            for naming in [Naming::Diffusers, Naming::Original] {
                let tensors = flow.entries().into_iter().filter(|e| Group::of_tensor(e.name(naming)) == group);
                assert_eq!(tensors.map(|e| e.parameters()).sum::<u64>(), parameters as u64, "{group:?}, {naming:?}");
            }
        }
    }
}

/// The parts of a renderer do not depend on which others there are; copies begin as copies.
#[test]
fn parts_are_drawn_by_themselves() {
    let device = Device::flex();
    let [config, _] = both();
    let flow = Flow::new(&config, 3, &device).expect("network");
    let alone = Flow::new(&FlowConfig { keyframes: None, ..config.clone() }, 3, &device).expect("network");
    let of =
        |flow: &Flow| parameters::export(flow).into_iter().filter(|p| Group::of(&p.name) != Group::Keyframes).collect::<Vec<_>>();
    assert_eq!(of(&flow), of(&alone));
    let values = |dense: &Dense| parameters::export(dense);
    assert_eq!(values(&flow.environment.embed), values(&flow.dit.patch));
    assert_eq!(values(&flow.inverse.as_ref().expect("adapter").embed), values(&flow.dit.patch));
    let other = Flow::new(&config, 4, &device).expect("network");
    assert!(values(&other.attributes) != values(&flow.attributes));
}

#[test]
fn presets_are_valid_and_what_is_not_is_named() {
    for name in FlowConfig::PRESETS {
        let config = FlowConfig::preset(name).expect("preset");
        config.validate().expect("valid");
        let all = config.with_keyframes(KeyframeConfig::default()).with_inverse(InverseConfig::default());
        let text = serde_json::to_string(&all).expect("writes");
        assert_eq!(serde_json::from_str::<FlowConfig>(&text).expect("reads"), all);
    }
    assert!(FlowConfig::preset("wan").is_none());
    let wan = FlowConfig::wan_1_3b();
    assert_eq!((wan.reference_channels(), wan.attribute_channels(), wan.pixel_multiple()), (96, 144, 16));
    let [good, _] = both();
    let wrong = |option: &str, change: &dyn Fn(&mut FlowConfig)| {
        let mut config = good.clone();
        change(&mut config);
        let error = Flow::new(&config, 0, &Device::flex()).expect_err("must fail").to_string();
        assert!(error.starts_with(&format!("{option}: ")), "{error}");
    };
    wrong("dit.text_dim", &|c| c.dit.text_dim = Some(24));
    wrong("dit.in_channels", &|c| c.dit.in_channels = 5);
    wrong("dit.out_channels", &|c| c.dit.out_channels = 3);
    wrong("dit.patch_size", &|c| c.dit.patch_size = [2, 2, 2]);
    wrong("dit.patch_size", &|c| c.dit.patch_size = [1, 2, 1]);
    wrong("dit.heads", &|c| c.dit.heads = 0);
    wrong("vae.z_dim", &|c| c.vae.z_dim = 0);
    wrong("keyframes.lora_rank", &|c| c.keyframes.as_mut().expect("adapter").lora_rank = 1 << 20);
    wrong("keyframes.lora_alpha", &|c| c.keyframes.as_mut().expect("adapter").lora_alpha = f32::NAN);
    wrong("inverse.lora_alpha", &|c| c.inverse.as_mut().expect("adapter").lora_alpha = 0.0);
    wrong("inverse.prompts", &|c| c.inverse.as_mut().expect("adapter").prompts = 3);
    wrong("inverse.prompt_tokens", &|c| c.inverse.as_mut().expect("adapter").prompt_tokens = 0);
}

#[test]
fn inputs_that_do_not_fit_are_refused() {
    let device = Device::flex();
    for config in both() {
        let flow = warm(&config, &device);
        let run = |clip: [usize; 4], times: &[f64], change: &dyn Fn(&mut Conditions)| {
            let mut conditions = conditions(&config, clip, &[0.5], &device);
            change(&mut conditions);
            flow.velocity(latents(clip, &device), times, &conditions)
        };
        run(CLIP, &TIMES, &|_| {}).expect("fits");
        let zeros = |shape| Tensor::<5>::zeros(shape, &device);
        let channels = config.attribute_channels();
        let changes: [&dyn Fn(&mut Conditions); 9] = [
            &|c| c.attributes = zeros([2, channels - 1, 2, 4, 6]),
            &|c| c.attributes = zeros([2, channels, 1, 4, 6]),
            &|c| c.environment = zeros([2, 4, 1, 4, 6]),
            &|c| c.environment = zeros([1, 4, 2, 4, 6]),
            &|c| c.environment = zeros([2, 4, 2, 3, 6]),
            &|c| c.keyframes[0].latent = zeros([2, 4, 1, 4, 4]),
            &|c| c.keyframes[0].latent = zeros([1, 4, 1, 4, 6]),
            &|c| c.keyframes[0].time = f64::NAN,
            &|c| c.keyframes[0].time = 1e300,
        ];
        for (i, change) in changes.into_iter().enumerate() {
            let error = run(CLIP, &TIMES, change).expect_err(&format!("change {i} must fail")).to_string();
            assert!(error.starts_with("transformer: "), "{error}");
        }
        let times: [&[f64]; 4] = [&[0.5], &[0.5, 1.5], &[f64::NAN, 0.0], &[-0.1, 0.0]];
        for times in times {
            run(CLIP, times, &|_| {}).expect_err("times must fit");
            flow.invert(latents(CLIP, &device), times, Intrinsic::Albedo).expect_err("times must fit");
        }
        for clip in [[2, 2, 3, 6], [2, 0, 4, 6]] {
            run(clip, &TIMES, &|_| {}).expect_err("size must fit");
            flow.invert(latents(clip, &device), &TIMES, Intrinsic::Albedo).expect_err("size must fit");
        }
        let bare = FlowConfig { keyframes: None, inverse: None, ..config.clone() };
        let bare = Flow::new(&bare, 0, &device).expect("network");
        let conditions = conditions(&config, CLIP, &[0.5], &device);
        let error = bare.velocity(latents(CLIP, &device), &TIMES, &conditions).expect_err("no adapter");
        assert!(error.to_string().starts_with("keyframes: "), "{error}");
        let error = bare.invert(latents(CLIP, &device), &TIMES, Intrinsic::Albedo).expect_err("no adapter");
        assert!(error.to_string().starts_with("inverse: "), "{error}");
    }
}
