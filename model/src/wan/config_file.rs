//! Published configuration files: diffusers' `config.json`, and the shorter file beside original weights.

use super::config::{DitConfig, Gelu, VaceConfig, VaeConfig};
use crate::{Error, Result};
use renderflow_frame::file;
use renderflow_frame::words::plain;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};
use std::path::Path;

/// A parsed file whose options are read one by one.
struct Options<'a> {
    path: &'a Path,
    values: Map<String, Value>,
}

impl<'a> Options<'a> {
    fn parse(path: &'a Path, text: &str) -> Result<Self> {
        match serde_json::from_str(text) {
            Ok(Value::Object(values)) => Ok(Self { path, values }),
            Ok(_) => Err(Error::malformed(path, "not a JSON object")),
            Err(e) => Err(Error::malformed(path, plain(&e.to_string()))),
        }
    }

    /// The first option of `names` that is present and not null.
    fn find<T: DeserializeOwned>(&self, names: &[&str]) -> Result<Option<T>> {
        let found = names.iter().find_map(|name| self.values.get(*name).filter(|v| !v.is_null()).map(|v| (name, v)));
        let Some((name, value)) = found else { return Ok(None) };
        let parsed = serde_json::from_value(value.clone());
        parsed.map(Some).map_err(|e| Error::malformed(self.path, format!("/{name}: {}", plain(&e.to_string()))))
    }

    fn need<T: DeserializeOwned>(&self, names: &[&str]) -> Result<T> {
        let missing = || Error::malformed(self.path, format!("/{}: missing", names.join(" or ")));
        self.find(names)?.ok_or_else(missing)
    }

    /// Refuses options that would change the graph in a way that this program does not support.
    fn refuse(&self, names: &[&str]) -> Result<()> {
        let off = |v: &Value| match v {
            Value::Null | Value::Bool(false) => true,
            Value::Array(items) => items.is_empty(),
            Value::Number(n) => n.as_f64() == Some(0.0),
            _ => false,
        };
        match names.iter().find(|name| self.values.get(**name).is_some_and(|v| !off(v))) {
            Some(name) => {
                let reason = format!("/{name}: {} is a variant of the network that is not supported", self.values[*name]);
                Err(Error::malformed(self.path, reason))
            }
            None => Ok(()),
        }
    }

    fn invalid(&self, error: Error) -> Error {
        Error::malformed(self.path, error.to_string())
    }
}

fn read(path: &Path) -> Result<String> {
    Ok(file::read_text(path)?)
}

impl VaeConfig {
    /// Reads diffusers' `config.json` of the autoencoder.
    ///
    /// # Errors
    /// When the file cannot be read, when an option is missing or out of range, or when a variant of the network is not
    /// supported.
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(path, &read(path)?)
    }

    /// Parses the text of such a file. `path` names it in messages.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self> {
        let options = Options::parse(path, text)?;
        options.refuse(&["attn_scales", "is_residual", "patch_size"])?;
        let base_dim = options.need(&["base_dim"])?;
        let config = Self {
            base_dim,
            decoder_base_dim: options.find(&["decoder_base_dim"])?.unwrap_or(base_dim),
            z_dim: options.need(&["z_dim"])?,
            dim_mult: options.need(&["dim_mult"])?,
            num_res_blocks: options.need(&["num_res_blocks"])?,
            // The published files spell this name with an e.
            temporal_downsample: options.need(&["temperal_downsample", "temporal_downsample"])?,
            in_channels: options.find(&["in_channels"])?.unwrap_or(3),
            out_channels: options.find(&["out_channels"])?.unwrap_or(3),
            latents_mean: options.need(&["latents_mean"])?,
            latents_std: options.need(&["latents_std"])?,
        };
        config.validate().map_err(|e| options.invalid(e))?;
        Ok(config)
    }
}

impl DitConfig {
    /// Reads diffusers' `config.json` of the transformer, or the file beside the original weights.
    ///
    /// # Errors
    /// As [`VaeConfig::read`].
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(path, &read(path)?)
    }

    /// Parses the text of such a file. `path` names it in messages.
    ///
    /// # Errors
    /// As [`VaeConfig::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self> {
        let options = Options::parse(path, text)?;
        let config = Self::from_options(&options)?;
        config.validate().map_err(|e| options.invalid(e))?;
        Ok(config)
    }

    fn from_options(options: &Options) -> Result<Self> {
        options.refuse(&["image_dim", "added_kv_proj_dim", "pos_embed_seq_len"])?;
        let qk_norm: Value = options.find(&["qk_norm"])?.unwrap_or(Value::Bool(true));
        if qk_norm != Value::Bool(true) && qk_norm != "rms_norm_across_heads" {
            let reason = format!("/qk_norm: {qk_norm} is a variant of the network that is not supported");
            return Err(Error::malformed(options.path, reason));
        }
        let heads = options.need(&["num_attention_heads", "num_heads"])?;
        let head_dim = match options.find(&["attention_head_dim"])? {
            Some(head_dim) => head_dim,
            None => {
                let width: usize = options.need(&["attention_head_dim", "dim"])?;
                if heads == 0 || !width.is_multiple_of(heads) {
                    return Err(Error::malformed(options.path, format!("/dim: {width} is not a multiple of {heads} heads")));
                }
                width / heads
            }
        };
        let in_channels = options.need(&["in_channels", "in_dim"])?;
        let eps = options.find(&["eps"])?.unwrap_or(1e-6);
        Ok(Self {
            heads,
            head_dim,
            ffn_dim: options.need(&["ffn_dim"])?,
            layers: options.need(&["num_layers"])?,
            // The original files leave it out. It is always the width of umT5-xxl.
            text_dim: Some(options.find(&["text_dim"])?.unwrap_or(4096)),
            freq_dim: options.find(&["freq_dim"])?.unwrap_or(256),
            in_channels,
            out_channels: options.find(&["out_channels", "out_dim"])?.unwrap_or(in_channels),
            patch_size: options.find(&["patch_size"])?.unwrap_or([1, 2, 2]),
            cross_attn_norm: options.find(&["cross_attn_norm"])?.unwrap_or(true),
            layer_norm_eps: eps,
            qk_norm_eps: eps,
            activation: Gelu::Tanh,
            rope_theta: 10_000.0,
        })
    }
}

impl VaceConfig {
    /// Reads diffusers' `config.json` of VACE, or the file beside the original weights.
    ///
    /// # Errors
    /// As [`VaeConfig::read`].
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(path, &read(path)?)
    }

    /// Parses the text of such a file. `path` names it in messages.
    ///
    /// # Errors
    /// As [`VaeConfig::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self> {
        let options = Options::parse(path, text)?;
        let config = Self {
            dit: DitConfig::from_options(&options)?,
            vace_layers: options.need(&["vace_layers"])?,
            vace_in_channels: options.need(&["vace_in_channels", "vace_in_dim"])?,
        };
        config.validate().map_err(|e| options.invalid(e))?;
        Ok(config)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ORIGINAL: &str = r#"{"_class_name": "VaceWanModel", "dim": 1536, "eps": 1e-06, "ffn_dim": 8960, "freq_dim": 256, "in_dim": 16,
        "model_type": "vace", "num_heads": 12, "num_layers": 30, "out_dim": 16, "text_len": 512,
        "vace_layers": [0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28], "vace_in_dim": 96}"#;

    #[test]
    fn the_original_configuration_is_the_preset() {
        let path = Path::new("config.json");
        assert_eq!(VaceConfig::parse(path, ORIGINAL).expect("parses"), VaceConfig::wan_1_3b());
        assert_eq!(DitConfig::parse(path, ORIGINAL).expect("parses"), DitConfig::wan_1_3b());
    }

    #[test]
    fn errors_name_file_and_option() {
        let error = |from: &str, to: &str| {
            let text = ORIGINAL.replace(from, to);
            VaceConfig::parse(Path::new("some/config.json"), &text).expect_err("must fail").to_string()
        };
        for (from, to, part) in [
            ("\"num_layers\": 30", "\"num_layers\": -1", "/num_layers"),
            ("\"ffn_dim\": 8960,", "", "/ffn_dim: missing"),
            ("\"dim\": 1536", "\"dim\": 1537", "/dim"),
            ("\"vace_layers\": [0, 2", "\"vace_layers\": [0, 0", "vace_layers"),
            ("\"text_len\"", "\"image_dim\"", "/image_dim"),
            ("\"eps\": 1e-06", "\"eps\": 0", "layer_norm_eps"),
            ("{\"_class", "[{\"_class", "some/config.json"),
        ] {
            let message = error(from, to);
            assert!(message.contains(part) && message.contains("some/config.json"), "{message}");
        }
    }

    #[test]
    fn presets_are_valid_and_hold_the_published_constants() {
        for config in [VaceConfig::wan_1_3b(), VaceConfig::tiny()] {
            config.validate().expect("valid");
            assert_eq!((config.dit.layer_norm_eps, config.dit.qk_norm_eps), (1e-6, 1e-6));
            assert_eq!((config.dit.activation, config.dit.rope_theta), (Gelu::Tanh, 1e4));
        }
        for config in [VaeConfig::wan(), VaeConfig::tiny()] {
            config.validate().expect("valid");
            assert_eq!((config.spatial_factor(), config.temporal_factor()), (8, 4));
            assert_eq!([0, 1, 2, 5, 9].map(|n| config.latent_frames(n)), [None, Some(1), None, Some(2), Some(3)]);
        }
    }
}
