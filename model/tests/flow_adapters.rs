//! What the renderer's adapters do, and what they leave alone.

mod wan;

use burn::tensor::{Device, Tensor};
use renderflow_model::wan::dit::{DitInput, Rope};
use renderflow_model::wan::flow::{Conditions, Environment, Group, Intrinsic};
use renderflow_model::wan::layers::modulated_norm;
use renderflow_model::wan::{Flow, FlowConfig};
use renderflow_model::{ops, parameters};
use wan::flow::{CLIP, TIMES, both, conditions, difference, invert, latents, velocity, warm, warmed};
use wan::values;

/// The environment's projections, the attributes' embedder where it is 0, and the keyframe adapter leave the backbone bit for
/// bit.
#[test]
fn adapters_begin_as_nothing() {
    let device = Device::flex();
    for config in both() {
        let mut flow = Flow::new(&config, 3, &device).expect("network");
        flow.attributes = warmed(flow.attributes, &device);
        assert!(
            velocity(&flow, &conditions(&config, CLIP, &[], &device)).iter().all(|&v| v == 0.0),
            "the first image is the albedo"
        );
        let z_t = values(latents(CLIP, &device)).values;
        assert!(Intrinsic::ALL.iter().all(|&intrinsic| invert(&flow, intrinsic) == z_t), "and the first albedo is the image");

        // With a head, but adapters that have learned nothing.
        flow.dit.head = warmed(flow.dit.head, &device);
        let nothing = parameters::export(&flow.attributes).iter().map(|p| vec![0.0; p.values.len()]).collect::<Vec<_>>();
        let nothing: Vec<&[f32]> = nothing.iter().map(Vec::as_slice).collect();
        flow.attributes = parameters::import(flow.attributes, &nothing, &device);
        let input = DitInput { latents: latents(CLIP, &device), times: vec![1000.0, 750.0], text: None };
        let plain = values(flow.dit.forward(input).expect("runs").neg()).values;
        assert!(plain.iter().any(|&v| v != 0.0));
        assert!(velocity(&flow, &conditions(&config, CLIP, &[], &device)) == plain, "environment");
        assert!(velocity(&flow, &conditions(&config, CLIP, &[0.5, 3.0], &device)) == plain, "keyframes");
    }
}

/// What an adapter has learned is not seen where it is not asked for.
#[test]
fn adapters_leave_the_rest_alone() {
    let device = Device::flex();
    for config in both() {
        let flow = warm(&config, &device);
        let (without, with) = (conditions(&config, CLIP, &[], &device), conditions(&config, CLIP, &[0.5], &device));
        let bare = FlowConfig { keyframes: None, inverse: None, ..config.clone() };
        let mut base = Flow::new(&bare, 3, &device).expect("network");
        (base.dit, base.attributes, base.environment) = (flow.dit.clone(), flow.attributes.clone(), flow.environment.clone());
        assert!(velocity(&base, &without) == velocity(&flow, &without));
        assert!(difference(&velocity(&flow, &with), &velocity(&flow, &without)) > 1e-3, "keyframes act");

        let moved = |group: Group| {
            let mut all = parameters::export(&flow);
            let of_group = all.iter_mut().filter(|p| Group::of(&p.name) == group);
            of_group.for_each(|p| p.values.iter_mut().for_each(|v| *v = 1.25 * *v + 0.01));
            let values: Vec<&[f32]> = all.iter().map(|p| p.values.as_slice()).collect();
            parameters::import(flow.clone(), &values, &device)
        };
        let (keyframes, inverse) = (moved(Group::Keyframes), moved(Group::Inverse));
        assert!(velocity(&keyframes, &without) == velocity(&flow, &without));
        assert!(velocity(&keyframes, &with) != velocity(&flow, &with));
        assert!(velocity(&inverse, &with) == velocity(&flow, &with));
        for intrinsic in Intrinsic::ALL {
            assert!(invert(&keyframes, intrinsic) == invert(&flow, intrinsic));
            assert!(invert(&inverse, intrinsic) != invert(&flow, intrinsic));
        }
        let each = Intrinsic::ALL.map(|intrinsic| invert(&flow, intrinsic));
        assert!((1..4).all(|i| each[i] != each[i - 1]), "intrinsics differ");
    }
}

/// A token sees itself and what adapters bring.
fn without_self_attention(mut flow: Flow, device: &Device) -> Flow {
    for block in &mut flow.dit.blocks {
        let out = block.attention.to_out.clone();
        let zeros: Vec<Vec<f32>> = parameters::export(&out).iter().map(|p| vec![0.0; p.values.len()]).collect();
        let zeros: Vec<&[f32]> = zeros.iter().map(Vec::as_slice).collect();
        block.attention.to_out = parameters::import(out, &zeros, device);
    }
    flow
}

/// One block as its formula: `f = (gamma + 1) f + beta`, `x = x + gate SA + KA`, `x = x + gate FFN`, with keyframe keys turned by
/// their place.
#[test]
fn a_block_is_its_formula() {
    let device = Device::flex();
    for config in both() {
        let flow = warm(&config, &device);
        let (dit, width, heads) = (&config.dit, config.dit.width(), config.dit.heads);
        let conditions = conditions(&config, CLIP, &[-0.75], &device);
        let (tokens, shared) = flow.prepare(latents(CLIP, &device), &TIMES, &conditions).expect("fits");
        let (block, adapter) = (&flow.dit.blocks[1], &flow.keyframes.as_ref().expect("adapter").blocks[1]);
        let [b, n, _] = tokens.dims();
        let environment = flow.environment.blocks[1].forward(shared.environment.clone().expect("environment"));
        let each = n / environment.dims()[1];
        let environment = environment.clone().reshape([b, n / each, 1, 2 * width]).repeat_dim(2, each).reshape([b, n, 2 * width]);
        let (gamma, beta) = (environment.clone().narrow(2, 0, width), environment.narrow(2, width, width));
        let x = tokens.clone() * (gamma + 1.0) + beta;
        let m = block.modulation.val() + shared.modulation.clone();
        let m = |i: usize| m.clone().narrow(1, i, 1);
        let y = modulated_norm(x.clone(), m(1), m(0), dit.layer_norm_eps);
        let (rope, key_rope) = (Rope::grid(dit, [2, 2, 3], 0.0, 1.0, &device), Rope::grid(dit, [1, 2, 3], -0.75, 1.0, &device));
        let (to_q, norm_q) = match &adapter.query {
            Some(own) => (&own.to_q, &own.norm_q),
            None => (&block.attention.to_q, &block.attention.norm_q),
        };
        let keys = shared.keyframes.clone().expect("keyframes");
        let q = rope.rotate(norm_q.forward(to_q.forward(y.clone())));
        let k = key_rope.rotate(adapter.norm_k.forward(adapter.to_k.forward(keys.clone())));
        let attended = adapter.to_out.forward(ops::attention(q, k, adapter.to_v.forward(keys), heads));
        let x = x + block.attention.self_attention(y, &rope) * m(2) + attended;
        let y = modulated_norm(x.clone(), m(4), m(3), dit.layer_norm_eps);
        let mut ffn = block.ffn.clone();
        if let Some([up, down]) = &adapter.ffn {
            (ffn.up, ffn.down) = (up.merged(ffn.up), down.merged(ffn.down));
        }
        let want = x + ffn.forward(y) * m(5);
        assert!(difference(&values(flow.block(1, tokens, &shared)).values, &values(want).values) < 1e-5);
    }
}

/// Pooled or not, what falls on a frame comes from the environment of that frame.
#[test]
fn the_environment_of_a_frame_acts_on_that_frame() {
    let device = Device::flex();
    for config in both() {
        let flow = without_self_attention(warm(&config, &device), &device);
        let of = |conditions: &Conditions| {
            let v = flow.velocity(latents(CLIP, &device), &TIMES, conditions).expect("renders");
            [0, 1].map(|i| values(v.clone().narrow(2, i, 1)).values)
        };
        let mut conditions = conditions(&config, CLIP, &[], &device);
        let one = of(&conditions);
        let [b, z, _, h, w] = conditions.environment.dims();
        let second = Tensor::cat(vec![Tensor::zeros([b, z, 1, h, w], &device), Tensor::ones([b, z, 1, h, w], &device)], 2);
        conditions.environment = conditions.environment + second;
        let other = of(&conditions);
        assert!(other[0] == one[0] && difference(&other[1], &one[1]) > 1e-3);
    }
}

/// Asked for one intrinsic, its prompt and its head are used and no other.
#[test]
fn each_intrinsic_has_a_prompt_and_a_head() {
    let device = Device::flex();
    let [config, _] = both();
    let flow = warm(&config, &device);
    let each = |flow: &Flow| Intrinsic::ALL.map(|intrinsic| invert(flow, intrinsic));
    let before = each(&flow);
    for (i, intrinsic) in Intrinsic::ALL.into_iter().enumerate() {
        assert_eq!(intrinsic.index(), i);
        let [prompts, tokens, width] = [5, 3, config.dit.width()];
        let row = (0..prompts * tokens * width).map(|j| if j / (tokens * width) == i { 0.5 } else { 0.0 }).collect::<Vec<f32>>();
        let row = Tensor::<1>::from_data(row.as_slice(), &device).reshape([prompts, tokens, width]);
        let mut prompted = flow.clone();
        let adapter = prompted.inverse.as_mut().expect("adapter");
        adapter.prompts = adapter.prompts.clone().map(|prompts| prompts + row);
        let mut headed = flow.clone();
        let heads = &mut headed.inverse.as_mut().expect("adapter").heads;
        heads[i].second.bias = heads[i].second.bias.clone().map(|bias| bias + 0.5);
        for (after, what) in [(each(&prompted), "prompt"), (each(&headed), "head")] {
            for j in 0..before.len() {
                assert_eq!(after[j] != before[j], i == j, "{what} {i} on intrinsic {j}");
            }
        }
    }
}

/// Attention to keyframes sees how far away in time they are, whole latent frames or not, before or after.
#[test]
fn keyframes_are_placed_by_distances() {
    let device = Device::flex();
    for mut config in both() {
        config.environment = Environment::Pooled;
        let flow = warm(&config, &device);
        let flow = without_self_attention(flow, &device);
        // Three times the same frame.
        let still = |x: Tensor<5>| x.narrow(2, 0, 1).repeat_dim(2, 3);
        let clip = [1, 3, 4, 4];
        let frames = |time: f64| {
            let Conditions { attributes, environment, keyframes } = conditions(&config, clip, &[time], &device);
            let conditions = Conditions { attributes: still(attributes), environment: still(environment), keyframes };
            let v = flow.velocity(still(latents(clip, &device)), &[0.0], &conditions).expect("renders");
            [0, 1, 2].map(|i| values(v.clone().narrow(2, i, 1)).values)
        };
        let (near, far) = (frames(1.25), frames(0.25));
        assert!(difference(&near[1], &far[0]) < 1e-5 && difference(&near[2], &far[1]) < 1e-5);
        let before = frames(-1.25);
        assert!(difference(&before[0], &frames(0.75)[2]) < 1e-5);
        for other in [0.25, 1.0, 1.5] {
            assert!(difference(&near[0], &frames(other)[0]) > 1e-3, "1.25 and {other} are told apart");
        }
        assert!(difference(&near[0], &before[0]) > 1e-3, "before and after are told apart");
    }
}

#[test]
fn the_order_of_keyframes_does_not_matter() {
    let device = Device::flex();
    for config in both() {
        let flow = warm(&config, &device);
        let mut conditions = conditions(&config, CLIP, &[-1.5, 0.0, 4.25], &device);
        let one = velocity(&flow, &conditions);
        conditions.keyframes.rotate_left(1);
        assert!(difference(&velocity(&flow, &conditions), &one) < 1e-5);
        conditions.keyframes.swap(0, 1);
        assert!(difference(&velocity(&flow, &conditions), &one) < 1e-5);
        conditions.keyframes.pop();
        assert!(difference(&velocity(&flow, &conditions), &one) > 1e-3, "each one counts");
    }
}

/// A mean has no place: with the pooled environment, only its tokens count, not where they are.
#[test]
fn a_pooled_environment_has_no_places() {
    let device = Device::flex();
    let turned = |config: &FlowConfig| {
        let flow = warm(config, &device);
        let mut conditions = conditions(config, CLIP, &[], &device);
        let one = velocity(&flow, &conditions);
        let w = conditions.environment.dims()[4];
        let (left, right) = (conditions.environment.clone().narrow(4, 0, 2), conditions.environment.narrow(4, 2, w - 2));
        conditions.environment = Tensor::cat(vec![right, left], 4);
        difference(&velocity(&flow, &conditions), &one)
    };
    let [pooled, tokens] = both();
    assert!(turned(&pooled) < 1e-5);
    assert!(turned(&tokens) > 1e-3);
}

/// A correction inside the weights is the correction beside them.
#[test]
fn corrections_can_be_merged() {
    let device = Device::flex();
    let [config, _] = both();
    let mut flow = warm(&config, &device);
    let (keyed, normal) = (conditions(&config, CLIP, &[0.5], &device), invert(&flow, Intrinsic::Normal));
    let rendered = velocity(&flow, &keyed);
    let mut merged = flow.clone();
    for (block, adapter) in merged.dit.blocks.iter_mut().zip(&mut merged.keyframes.as_mut().expect("adapter").blocks) {
        let [up, down] = adapter.ffn.take().expect("corrections");
        block.ffn.up = up.merged(block.ffn.up.clone());
        block.ffn.down = down.merged(block.ffn.down.clone());
    }
    assert!(difference(&velocity(&merged, &keyed), &rendered) < 1e-5);
    for (block, adapter) in flow.dit.blocks.iter_mut().zip(&mut flow.inverse.as_mut().expect("adapter").blocks) {
        let [q, k, v] = adapter.qkv.take().expect("corrections");
        block.attention.to_q = q.merged(block.attention.to_q.clone());
        block.attention.to_k = k.merged(block.attention.to_k.clone());
        block.attention.to_v = v.merged(block.attention.to_v.clone());
    }
    assert!(difference(&invert(&flow, Intrinsic::Normal), &normal) < 1e-5);
}
