//! Larger networks that begin as smaller ones (Chen, Goodfellow and Shlens 2016, "Net2Net").
//!
//! Channels that are added read what the others read, with small random weights, and nobody reads them yet: their weights in what
//! follows are 0, and learn at once. Convolutions that are added are 0, and leave alone what passes them.

use super::graph::{FusionConfig, LEVELS, PLAIN_PREFIX, SAMPLED_PREFIX, Size};
use crate::parameters::Parameter;
use crate::{Error, Result};

/// Size of the weights of added channels, of what a fresh network has. Large ones bring down a run within some hundred steps: the
/// optimiser's steps are as large for weights that were 0, and noisy samples reach far beyond what such weights are made for.
const SIZE: f32 = 0.1;

/// The parameters of a network of the configuration `to` that gives the pictures of another of `from` with the parameters `own`.
/// The parameters `fresh` are random ones of `to`.
///
/// # Errors
/// [`Error::Config`] where a U-Net would shrink, or the only one would be for some frames.
pub(super) fn grown(from: &FusionConfig, own: &[Parameter], to: &FusionConfig, fresh: Vec<Parameter>) -> Result<Vec<Parameter>> {
    let plain = from.plain().unwrap_or(from.sampled());
    let fits = |from: Size, to: Size| {
        let grows = |from: [usize; LEVELS], to: [usize; LEVELS]| from.iter().zip(to).all(|(from, to)| *from <= to);
        grows(from.widths, to.widths) && grows(from.refines, to.refines)
    };
    let fit =
        fits(from.sampled(), to.sampled()) && from.paths <= to.paths && to.plain().map_or(!from.separate, |to| fits(plain, to));
    if !fit {
        let reason = "the weights to begin with are of another network, of which this one is not a larger form";
        return Err(Error::config("network", reason));
    }
    let grow = |fresh: Parameter| -> Parameter {
        let (is_plain, shared) = (fresh.name.starts_with(PLAIN_PREFIX), !from.separate);
        let name = if shared { fresh.name.replacen(PLAIN_PREFIX, SAMPLED_PREFIX, 1) } else { fresh.name.clone() };
        // Convolutions that are added are 0 as they are.
        let Some(own) = own.iter().find(|own| own.name == name) else { return fresh };
        let [was, is] = if is_plain { [plain, to.plain().unwrap_or(plain)] } else { [from.sampled(), to.sampled()] };
        // What enters a level of the decoder is the coarser level, and then the finer one.
        let entered = name.split_once(".enter.").and_then(|(_, rest)| rest.split('.').next()?.parse::<usize>().ok());
        let coarser = entered.map(|i| [was, is].map(|size| size.widths[LEVELS - 1 - i]));
        Parameter { values: widened(&fresh, own, coarser), ..fresh }
    };
    Ok(fresh.into_iter().map(grow).collect())
}

/// The values of `own` in the shape of `fresh`. Outputs beyond those of `own` keep [`SIZE`] of their fresh values, and the
/// outputs of `own` read none of the inputs that are added. Where the inputs are those of two layers, `first` is the number of
/// the first layer's, in `own` and in `fresh`.
fn widened(fresh: &Parameter, own: &Parameter, first: Option<[usize; 2]>) -> Vec<f32> {
    let [(inputs, outputs), (own_inputs, own_outputs)] = [fresh, own].map(|parameter| match parameter.shape[..] {
        [.., inputs, outputs] => (inputs, outputs),
        [outputs] => (1, outputs),
        [] => (1, 1),
    });
    let [was, is] = first.unwrap_or([own_inputs, inputs]);
    // The input of `own` that input `i` is.
    let same = |i: usize| if i < is { (i < was).then_some(i) } else { Some(i - is + was) };
    let value = |at: usize| {
        let (place, input, output) = (at / outputs / inputs, at / outputs % inputs, at % outputs);
        if output >= own_outputs {
            return SIZE * fresh.values[at];
        }
        let own_input = same(input).filter(|&input| input < own_inputs);
        own_input.map_or(0.0, |input| own.values[(place * own_inputs + input) * own_outputs + output])
    };
    (0..fresh.values.len()).map(value).collect()
}
