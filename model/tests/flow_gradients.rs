//! Gradients of the renderer and every adapter against finite differences, tensor by tensor.

mod wan;

use burn::tensor::{Device, Tensor};
use renderflow_model::parameters;
use renderflow_model::wan::flow::{Conditions, Environment, Group, Intrinsic, KeyframeLatent, Query};
use renderflow_model::wan::{Flow, FlowConfig};
use wan::flow::{both, conditions, config, latents, warm};
use wan::gradients::{compare, weighed};

const CLIP: [usize; 4] = [2, 2, 4, 2];

/// A number that depends on every parameter: of rendering with keyframes and of each way back.
fn loss(flow: &Flow, device: &Device) -> Tensor<1> {
    let z_t = latents(CLIP, device);
    let conditions = conditions(flow.config(), CLIP, &[-0.75, 1.5], device);
    let rendered = flow.velocity(z_t.clone(), &[0.25, 0.75], &conditions).expect("renders");
    let back = |intrinsic| weighed(flow.invert(z_t.clone(), &[0.5, 0.0], intrinsic).expect("inverts"));
    Intrinsic::ALL.into_iter().fold(weighed(rendered), |sum, intrinsic| sum + back(intrinsic))
}

fn check(config: &FlowConfig) {
    let device = Device::flex().autodiff();
    compare(warm(config, &device), &device, |flow| loss(flow, &device));
}

#[test]
fn gradients_with_dedicated_queries() {
    check(&config(Query::Dedicated, Environment::Pooled, 3));
}

#[test]
fn gradients_with_reused_queries_and_environment_tokens() {
    check(&config(Query::Reused, Environment::Tokens, 2));
}

/// Only the group that learns has gradients, and they are those it has when everything learns.
#[test]
fn a_group_learns_alone() {
    let device = Device::flex().autodiff();
    let flow = warm(&config(Query::Dedicated, Environment::Pooled, 3), &device);
    let names: Vec<String> = parameters::export(&flow).into_iter().map(|p| p.name).collect();
    let gradients = |flow: &Flow| parameters::gradients(flow, &mut loss(flow, &device).backward()).expect("gradients");
    let all = gradients(&flow);
    for group in Group::ALL {
        let found = gradients(&flow.clone().learn_only(group));
        for ((name, found), all) in names.iter().zip(found).zip(&all) {
            assert_eq!(found.is_some(), Group::of(name) == group, "{name}");
            if let Some(found) = found {
                assert!(Some(&found) == all.as_ref(), "{name} has another gradient alone");
            }
        }
    }
}

/// Inputs far from what latents are, nothing at all, and keyframes of another day: values and gradients are numbers.
#[test]
fn extreme_inputs_stay_finite() {
    let device = Device::flex().autodiff();
    for config in both() {
        let flow = warm(&config, &device);
        for factor in [0.0, 1e-20, 1e4, 1e8] {
            let conditions = conditions(&config, CLIP, &[-1e6, 0.0, 1e6], &device);
            let conditions = Conditions {
                attributes: conditions.attributes * factor,
                environment: conditions.environment * factor,
                keyframes: conditions.keyframes.into_iter().map(|k| KeyframeLatent { latent: k.latent * factor, ..k }).collect(),
            };
            let z_t = latents(CLIP, &device) * factor;
            let rendered = flow.velocity(z_t.clone(), &[0.0, 1.0], &conditions).expect("renders");
            let back = flow.invert(z_t, &[0.0, 1.0], Intrinsic::Depth).expect("inverts");
            for values in [rendered.clone(), back.clone()].map(|x| wan::values(x.without_autodiff()).values) {
                assert!(values.iter().all(|v| v.is_finite()), "inputs of {factor}");
            }
            let mut found = (weighed(rendered) + weighed(back)).backward();
            for (parameter, gradient) in
                parameters::export(&flow).iter().zip(parameters::gradients(&flow, &mut found).expect("gradients"))
            {
                let finite = gradient.is_none_or(|g| g.iter().all(|v| v.is_finite()));
                assert!(finite, "{} with inputs of {factor}", parameter.name);
            }
        }
    }
}
