//! Convolution over time that sees only the past, and the cache of past frames.

use crate::ops;
use crate::wan::init::{Init, Start};
use crate::wan::names::{Layout, Listing};
use burn::module::{Module, Param};
use burn::tensor::Tensor;

/// Number of frames that a causal convolution remembers.
const KEPT: usize = 2;

/// The last input frames of every convolution over time, in the order in which a pass runs them.
#[derive(Clone, Debug, Default)]
pub struct Cache {
    slots: Vec<Option<Tensor<5>>>,
    next: usize,
    chunks: usize,
    zeros: bool,
}

impl Cache {
    /// The cache before the first chunk.
    pub fn new() -> Self {
        Self::default()
    }

    /// A cache with frames of zeros before the first chunk: the three-dimensional form, for comparison.
    #[doc(hidden)]
    pub fn of_zeros() -> Self {
        Self { zeros: true, ..Self::default() }
    }

    /// Begins a pass over the next chunk.
    pub(super) fn begin(&mut self) {
        self.rewind();
        self.chunks += 1;
    }

    /// Returns to the first convolution. Networks do this themselves; single convolutions need it.
    #[doc(hidden)]
    pub fn rewind(&mut self) {
        self.next = 0;
    }

    /// Whether the current pass is the first.
    pub(super) fn is_first(&self) -> bool {
        self.chunks == 1
    }

    /// Skips the next convolution.
    pub(super) fn skip(&mut self) {
        self.slot();
    }

    fn slot(&mut self) -> &mut Option<Tensor<5>> {
        let at = self.next;
        self.next += 1;
        if at == self.slots.len() {
            self.slots.push(None);
        }
        &mut self.slots[at]
    }

    /// Puts the frames that the next convolution remembers before `x` `[b, t, h, w, c]`, and remembers the last `keep` frames of
    /// both.
    pub(super) fn extend(&mut self, x: Tensor<5>, keep: usize) -> Tensor<5> {
        let zeros = self.zeros;
        let slot = self.slot();
        let both = match slot.take() {
            Some(history) => Tensor::cat(vec![history, x], 1),
            None if zeros => with_zeros(x, keep),
            None => x,
        };
        let frames = both.dims()[1];
        let kept = keep.min(frames);
        *slot = Some(both.clone().narrow(1, frames - kept, kept));
        both
    }
}

/// A convolution `3 x k x k` (k is 1 or 3). A frame sees itself and the two frames before it, with zeros before the first frame.
#[derive(Module, Debug)]
pub struct CausalConv {
    /// `[k, k, 3, channels in, channels out]`, the newest frame last.
    pub weight: Param<Tensor<5>>,
    /// `[channels out]`.
    pub bias: Param<Tensor<1>>,
}

impl CausalConv {
    /// He-initialised (He et al. 2015).
    pub fn new(init: &mut Init, k: usize, from: usize, to: usize) -> Self {
        let inputs = 3 * k * k * from;
        let std = (2.0 / inputs as f32).sqrt();
        Self { weight: init.weight([k, k, 3, from, to], Start::Normal(std)), bias: init.offsets(inputs, to) }
    }

    /// `[b, t, h, w, channels in]` to `[b, t, h, w, channels out]`, continuing after the frames in the cache.
    pub fn forward(&self, x: Tensor<5>, cache: &mut Cache) -> Tensor<5> {
        let frames = x.dims()[1];
        self.over(cache.extend(x, KEPT), frames)
    }

    /// The last `frames` frames of the convolved `x`.
    pub(super) fn over(&self, x: Tensor<5>, frames: usize) -> Tensor<5> {
        let newest = x.dims()[1] - frames;
        ops::conv_over_time(x, self.weight.val(), self.bias.val(), 1, newest)
    }

    /// One output frame for each `step` input frames, from the last of them and the two before it, without zeros before the first
    /// frame.
    pub(super) fn strided(&self, x: Tensor<5>, step: usize) -> Tensor<5> {
        ops::conv_over_time(x, self.weight.val(), self.bias.val(), step, KEPT)
    }

    /// Lists the tensors under `name`.
    pub fn list(&self, list: &mut Listing, name: &str) {
        list.push(&self.weight, format!("{name}.weight"), Layout::Kernel3);
        list.push(&self.bias, format!("{name}.bias"), Layout::Same);
    }
}

/// Puts `count` frames of zeros before `x` `[b, t, h, w, c]`.
fn with_zeros(x: Tensor<5>, count: usize) -> Tensor<5> {
    let [b, _, h, w, c] = x.dims();
    Tensor::cat(vec![Tensor::zeros([b, count, h, w, c], &x.device()), x], 1)
}
