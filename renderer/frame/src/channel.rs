//! The channel table: names, types and meaning of every channel in a frame file.
//!
//! [`LAYERS`] is the only description of a channel: the EXR reader, the writer and the header's conventions follow it.
//! To add a channel, add a field to [`Frame`] and a line here.

use crate::Frame;
use crate::image::{Image, Rgb};
use serde::Serialize;

/// How a channel is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Storage {
    /// 16-bit float; values beyond 65504 are clamped and counted.
    Half,
    /// 32-bit float.
    Float,
    /// 32-bit unsigned integer.
    Uint,
}

/// Channels that are written together or not at all.
#[derive(Debug)]
pub struct Layer {
    /// Part of the channel names before the dot; empty for the root channels.
    pub name: &'static str,
    /// Part of the channel names after the dot, one for each component.
    pub components: &'static [&'static str],
    /// Sample type of all channels of the layer.
    pub storage: Storage,
    /// Whether a frame may lack it.
    pub optional: bool,
    /// Quantity, unit, space and range.
    pub meaning: &'static str,
    pub(crate) field: Field,
}

/// Where in a [`Frame`] a layer lives.
#[derive(Debug)]
pub(crate) enum Field {
    Rgb(Access<Rgb>),
    Vec2(Access<Image<[f32; 2]>>),
    Scalar(Access<Image<f32>>),
    Id(Access<Image<u32>>),
}

/// Reads and sets one field of a frame; `get` returns `None` where an optional field is absent.
#[derive(Debug)]
pub(crate) struct Access<T: 'static> {
    pub get: fn(&Frame) -> Option<&T>,
    pub set: fn(&mut Frame, T),
    pub take: fn(&mut Frame) -> Option<T>,
}

/// The values of a layer.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Three numbers per pixel.
    Rgb(Rgb),
    /// Two numbers per pixel.
    Vec2(Image<[f32; 2]>),
    /// One number per pixel.
    Scalar(Image<f32>),
    /// One integer per pixel.
    Id(Image<u32>),
}

impl Layer {
    /// Moves the values of this layer out of `frame`; `None` where the frame lacks it.
    pub fn take(&self, frame: &mut Frame) -> Option<Values> {
        match &self.field {
            Field::Rgb(field) => (field.take)(frame).map(Values::Rgb),
            Field::Vec2(field) => (field.take)(frame).map(Values::Vec2),
            Field::Scalar(field) => (field.take)(frame).map(Values::Scalar),
            Field::Id(field) => (field.take)(frame).map(Values::Id),
        }
    }

    /// Whether a miss is +inf in this layer; no other layer holds infinities.
    pub(crate) fn is_infinite_at_miss(&self) -> bool {
        matches!(self.name, "depth" | "distance")
    }

    /// Full channel names, such as `albedo.R`, in the order of [`Self::components`].
    pub fn channel_names(&self) -> impl Iterator<Item = String> + '_ {
        self.components.iter().map(|component| match self.name {
            "" => (*component).to_owned(),
            name => format!("{name}.{component}"),
        })
    }
}

macro_rules! layer {
    ($name:literal, $components:expr, $storage:ident, optional $kind:ident $field:ident, $meaning:literal) => {
        Layer {
            name: $name,
            components: &$components,
            storage: Storage::$storage,
            optional: true,
            meaning: $meaning,
            field: Field::$kind(Access {
                get: |frame| frame.$field.as_ref(),
                set: |frame, value| frame.$field = Some(value),
                take: |frame| frame.$field.take(),
            }),
        }
    };
    (light $group:literal, $name:literal) => {
        Layer {
            name: $name,
            components: &RGB,
            storage: Storage::Half,
            optional: true,
            meaning: "share of raw by where the light entered; the groups there are sum to raw",
            field: Field::Rgb(Access {
                get: |frame| frame.light[$group].as_ref(),
                set: |frame, value| frame.light[$group] = Some(value),
                take: |frame| frame.light[$group].take(),
            }),
        }
    };
    ($name:literal, $components:expr, $storage:ident, $kind:ident $field:ident, $meaning:literal) => {
        Layer {
            name: $name,
            components: &$components,
            storage: Storage::$storage,
            optional: false,
            meaning: $meaning,
            field: Field::$kind(Access {
                get: |frame| Some(&frame.$field),
                set: |frame, value| frame.$field = value,
                take: |frame| Some(std::mem::take(&mut frame.$field)),
            }),
        }
    };
}

const RGB: [&str; 3] = ["R", "G", "B"];
const XYZ: [&str; 3] = ["X", "Y", "Z"];
const XY: [&str; 2] = ["X", "Y"];

/// Every channel a frame file can hold.
pub const LAYERS: &[Layer] = &[
    layer!("", RGB, Half, optional Rgb beauty, "beauty with background, scene-linear radiance, denoised where a denoiser is named"),
    layer!("", ["A"], Half, Scalar alpha, "hit coverage, 0..1"),
    layer!("raw", RGB, Half, optional Rgb raw, "mean radiance before denoising, scene-linear"),
    layer!("variance", RGB, Float, optional Rgb variance, "variance of the mean of raw"),
    layer!("samples", ["N"], Uint, optional Id samples, "samples of raw in this pixel; without it all pixels have as many as spp says"),
    layer!(light 0, "light.0"),
    layer!(light 1, "light.1"),
    layer!(light 2, "light.2"),
    layer!(light 3, "light.3"),
    layer!(light 4, "light.4"),
    layer!(light 5, "light.5"),
    layer!(light 6, "light.6"),
    layer!(light 7, "light.7"),
    layer!("indirect", RGB, Half, optional Rgb indirect, "the part of raw that met two surfaces or more"),
    layer!("hidden", RGB, Half, optional Rgb hidden, "what light samples at the first surface would have added to raw if nothing had hidden their light; not what scattered rays would have found"),
    layer!("albedo", RGB, Half, Rgb albedo, "base colour, linear, 0..1, independent of the view; 0 at a miss"),
    layer!("normal", XYZ, Half, Rgb normal, "shading normal, camera space (+x right, +y up, +z to the viewer), unit length; 0 at a miss"),
    layer!("depth", ["Z"], Float, Scalar depth, "planar depth along -z, metres; +inf at a miss"),
    layer!("distance", ["Z"], Float, optional Scalar distance, "Euclidean distance from the camera, metres; +inf at a miss"),
    layer!("material", RGB, Half, Rgb material, "roughness, metallic, specular, each 0..1; 0 at a miss"),
    layer!("transmittance", RGB, Half, optional Rgb transmittance, "share of the light of what is seen through the surface that arrives, 0..1; 0 for opaque surfaces and at a miss"),
    layer!("through", XYZ, Half, optional Rgb through, "direction in which the environment is seen through clear surfaces, bent by them, camera space, unit length; 0 where a surface is behind them"),
    layer!("irradiance", RGB, Half, optional Rgb irradiance, "unoccluded integral of L max(0, ns.w) dw / pi over the environment"),
    layer!("guide_albedo", RGB, Half, optional Rgb guide_albedo, "albedo filtered over the pixel, premultiplied by coverage"),
    layer!("guide_normal", XYZ, Half, optional Rgb guide_normal, "normal filtered over the pixel, premultiplied by coverage, not unit length"),
    layer!("motion", XY, Half, optional Vec2 motion, "to the surface point's place in the next frame, pixels, +x right, +y down"),
    layer!("motion_prev", XY, Half, optional Vec2 motion_prev, "to the surface point's place in the previous frame, pixels, +x right, +y down"),
    layer!("object_id", ["I"], Uint, Id object_id, "object, one sample at the pixel centre; 0 = none"),
    layer!("material_id", ["I"], Uint, Id material_id, "material, one sample at the pixel centre; 0 = none"),
];

/// Version of the conventions; files of another version are refused.
pub const FORMAT: u32 = 1;

/// The conventions of a frame file as JSON: what the header of every file says about axes, units, colour and each channel.
pub fn conventions() -> String {
    // Structs rather than a JSON map: the order of keys, and so the bytes of the file, must not depend on cargo features.
    #[derive(Serialize)]
    struct Conventions {
        format: u32,
        world: &'static str,
        camera: &'static str,
        pixels: &'static str,
        color: &'static str,
        sampling: &'static str,
        channels: Vec<Described>,
    }
    #[derive(Serialize)]
    struct Described {
        names: Vec<String>,
        r#type: Storage,
        optional: bool,
        meaning: &'static str,
    }
    let channels = LAYERS
        .iter()
        .map(|layer| Described {
            names: layer.channel_names().collect(),
            r#type: layer.storage,
            optional: layer.optional,
            meaning: layer.meaning,
        })
        .collect();
    let conventions = Conventions {
        format: FORMAT,
        world: "+Y up, metres",
        camera: "OpenGL: +x right, +y up, view along -z",
        pixels: "first row at the top, centres at +0.5",
        color: "scene-linear Rec.709",
        sampling: "beauty, A, raw and guide_* are filtered over the pixel; all else is one sample at the pixel centre; NaN never occurs",
        channels,
    };
    serde_json::to_string(&conventions).unwrap_or_default()
}

/// Refuses [`conventions`] of another [`FORMAT`].
pub(crate) fn check_conventions(json: &str) -> std::result::Result<(), String> {
    #[derive(serde::Deserialize)]
    struct Version {
        format: u32,
    }
    let found: Version = serde_json::from_str(json).map_err(|e| e.to_string())?;
    if found.format != FORMAT {
        return Err(format!("frame format {} is not the one read here ({FORMAT})", found.format));
    }
    Ok(())
}
