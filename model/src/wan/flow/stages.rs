//! The renderer in stages: the part before the blocks, one block, and the part after them. A caller that recomputes activations
//! keeps the tokens between blocks, and runs a block again for its gradient.

use super::inverse::WithPrompt;
use super::keyframes::WithKeyframes;
use super::{Conditions, Environment, Flow, Intrinsic, InverseAdapter, KeyframeAdapter, KeyframeLatent};
use crate::wan::activations;
use crate::wan::dit::{BlockAdapter, DitInput, Prepared, Rope, expect, patches, token_grid};
use crate::{Error, Result};
use burn::tensor::Tensor;

/// The inputs of every block and the head besides the tokens.
#[derive(Clone, Debug)]
pub struct Shared {
    /// Embedded time `[b, 1, width]`.
    pub time: Tensor<3>,
    /// Modulation of the blocks `[b, 6, width]`. Each block adds its own to it.
    pub modulation: Tensor<3>,
    /// Embedded environment: `[b, frames, width]`, or one token for each token of the picture. `None` for inverse rendering.
    pub environment: Option<Tensor<3>>,
    /// Tokens of all keyframes `[b, m, width]`.
    pub keyframes: Option<Tensor<3>>,
    /// Prompt tokens that select the intrinsic, `[b, tokens, width]`, for inverse rendering.
    pub prompt: Option<Tensor<3>>,
    places: Rope,
    keyframe_places: Option<Rope>,
    grid: [usize; 3],
    intrinsic: Option<Intrinsic>,
}

impl Shared {
    /// Every tensor that depends on parameters or inputs, in a fixed order.
    pub fn tensors(&self) -> Vec<Tensor<3>> {
        let always = [&self.time, &self.modulation].into_iter();
        always.chain([&self.environment, &self.keyframes, &self.prompt].into_iter().flatten()).cloned().collect()
    }

    /// Replaces the [`Self::tensors`], for instance by detached ones.
    ///
    /// # Panics
    /// When the number of tensors differs.
    pub fn with_tensors(&self, tensors: Vec<Tensor<3>>) -> Self {
        let count = tensors.len();
        assert!(count == self.tensors().len(), "{count} tensors where {} are shared", self.tensors().len());
        let mut tensors = tensors.into_iter();
        let mut shared = self.clone();
        let places = [Some(&mut shared.time), Some(&mut shared.modulation)].into_iter();
        let optional = [&mut shared.environment, &mut shared.keyframes, &mut shared.prompt].map(Option::as_mut);
        places.chain(optional).flatten().zip(&mut tensors).for_each(|(place, tensor)| *place = tensor);
        shared
    }
}

impl Flow {
    /// The tokens `[b, n, width]` before the first block, and the inputs that blocks share. The arguments are those of
    /// [`Self::velocity`].
    ///
    /// # Errors
    /// As for [`Self::velocity`].
    pub fn prepare(&self, z_t: Tensor<5>, times: &[f64], conditions: &Conditions) -> Result<(Tensor<3>, Shared)> {
        let (config, patch) = (&self.config, self.config.dit.patch_size);
        let [b, _, f, h, w] = z_t.dims();
        let (attributes, environment) = (&conditions.attributes, &conditions.environment);
        let channels = config.attribute_channels();
        let fits = attributes.dims() == [b, channels, f, h, w];
        expect(fits, || format!("attributes {:?} instead of {:?}", attributes.dims(), [b, channels, f, h, w]))?;
        let [eb, ec, ef, eh, ew] = environment.dims();
        let size_fits = config.environment == Environment::Pooled || [eh, ew] == [h, w];
        let fits = [eb, ec, ef] == [b, config.vae.z_dim, f] && size_fits;
        expect(fits, || format!("environment {:?} beside latents {:?}", environment.dims(), z_t.dims()))?;
        token_grid(patch, environment)?;
        let Prepared { tokens, time, modulation, rope, grid, .. } = self.dit.prepare(input(z_t, times)?)?;
        let keyframes = match (&self.keyframes, conditions.keyframes.as_slice()) {
            (_, []) => None,
            (None, _) => return Err(Error::config("keyframes", "this renderer has no keyframe adapter")),
            (Some(adapter), keyframes) => Some(self.keyframe_tokens(adapter, keyframes, [b, h, w])?),
        };

        let attributes = self.attributes.forward(patches(attributes.clone(), patch));
        activations::report("attribute_embedding", || attributes.clone());
        let environment = self.environment.embedded(patches(environment.clone(), patch), f);
        activations::report("environment_embedding", || environment.clone());
        let (keyframes, keyframe_places) = keyframes.unzip();
        let shared = Shared {
            time,
            modulation,
            environment: Some(environment),
            keyframes,
            prompt: None,
            places: rope,
            keyframe_places,
            grid,
            intrinsic: None,
        };
        Ok((tokens + attributes, shared))
    }

    /// [`Self::prepare`] for inverse rendering. The arguments are those of [`Self::invert`].
    ///
    /// # Errors
    /// As for [`Self::invert`].
    pub fn prepare_inverse(&self, z_t: Tensor<5>, times: &[f64], intrinsic: Intrinsic) -> Result<(Tensor<3>, Shared)> {
        let adapter = self.inverse()?;
        let b = z_t.dims()[0];
        let input = input(z_t, times)?;
        let Prepared { tokens, time, modulation, rope, grid, .. } = self.dit.prepare_embedded(&adapter.embed, input)?;
        let shared = Shared {
            time,
            modulation,
            environment: None,
            keyframes: None,
            prompt: Some(adapter.prompt(intrinsic, b)),
            places: rope,
            keyframe_places: None,
            grid,
            intrinsic: Some(intrinsic),
        };
        Ok((tokens, shared))
    }

    /// Runs block `i` on tokens `[b, n, width]`. The result has the same shape.
    ///
    /// # Panics
    /// When `i` is not below [`crate::wan::DitConfig::layers`].
    pub fn block(&self, i: usize, tokens: Tensor<3>, shared: &Shared) -> Tensor<3> {
        let tokens = match &shared.environment {
            Some(environment) => self.environment.modulate(i, tokens, environment.clone()),
            None => tokens,
        };
        let keyframes = self.keyframes.as_ref().zip(shared.keyframes.as_ref()).zip(shared.keyframe_places.as_ref());
        let with_keyframes =
            keyframes.map(|((adapter, tokens), places)| WithKeyframes { block: &adapter.blocks[i], tokens, places });
        let prompt = self.inverse.as_ref().zip(shared.prompt.as_ref());
        let with_prompt = prompt.map(|(adapter, prompt)| WithPrompt { block: &adapter.blocks[i], prompt });
        let adapter: &dyn BlockAdapter = match (&with_keyframes, &with_prompt) {
            (Some(keyframes), _) => keyframes,
            (None, Some(prompt)) => prompt,
            (None, None) => &Alone,
        };
        self.dit.blocks[i].run(tokens, &shared.modulation, &shared.places, adapter, &format!("block{i}"))
    }

    /// The velocity `[b, z, f, h, w]` of rendering or of inverse rendering, from the tokens after the last block.
    pub fn finish(&self, tokens: Tensor<3>, shared: &Shared) -> Tensor<5> {
        let normed = self.dit.head_norm(tokens, shared.time.clone());
        match (shared.intrinsic, &self.inverse) {
            (Some(intrinsic), Some(adapter)) => self.dit.unpatch(adapter.heads[intrinsic.index()].forward(normed), shared.grid),
            _ => self.dit.unpatch(self.dit.head.forward(normed), shared.grid).neg(),
        }
    }

    /// Runs all blocks and the head.
    pub(super) fn run(&self, mut tokens: Tensor<3>, shared: &Shared) -> Tensor<5> {
        for i in 0..self.dit.blocks.len() {
            tokens = self.block(i, tokens, shared);
        }
        self.finish(tokens, shared)
    }

    /// The inverse adapter.
    ///
    /// # Errors
    /// [`Error::Config`] when there is none.
    pub(super) fn inverse(&self) -> Result<&InverseAdapter> {
        self.inverse.as_ref().ok_or_else(|| Error::config("inverse", "this renderer has no inverse adapter"))
    }

    /// The tokens of all keyframes and their positions, for b clips of `h x w` latent pixels.
    fn keyframe_tokens(
        &self,
        adapter: &KeyframeAdapter,
        keyframes: &[KeyframeLatent],
        [b, h, w]: [usize; 3],
    ) -> Result<(Tensor<3>, Rope)> {
        let config = &self.config.dit;
        let mut places = Vec::new();
        let mut tokens = Vec::with_capacity(keyframes.len());
        for keyframe in keyframes {
            let (shape, want) = (keyframe.latent.dims(), [b, config.in_channels, 1, h, w]);
            expect(shape == want, || format!("a keyframe {shape:?} instead of {want:?}"))?;
            let valid = keyframe.time.is_finite() && keyframe.time.abs() <= 1e6;
            expect(valid, || format!("a keyframe at {} latent frames", keyframe.time))?;
            let [_, rows, columns] = token_grid(config.patch_size, &keyframe.latent)?;
            places.extend((0..rows * columns).map(|i| [keyframe.time, (i / columns) as f64, (i % columns) as f64]));
            tokens.push(adapter.embed.forward(patches(keyframe.latent.clone(), config.patch_size)));
        }
        let tokens = Tensor::cat(tokens, 1);
        let places = Rope::new(config, &places, &tokens.device());
        Ok((tokens, places))
    }
}

/// No adapter.
struct Alone;

impl BlockAdapter for Alone {}

/// The input of the transformer at times of the bridge.
fn input(latents: Tensor<5>, times: &[f64]) -> Result<DitInput> {
    let valid = times.iter().all(|t| (0.0..=1.0).contains(t));
    expect(valid, || format!("times {times:?} of the bridge; they must be from 0 (start) to 1 (end)"))?;
    Ok(DitInput { latents, times: times.iter().map(|t| 1000.0 * (1.0 - t)).collect(), text: None })
}
