//! What a family with its own file provides, and the macro that writes its parameters once: type, range, default draw.

use super::Faults;
use super::builder::Builder;
use rand_pcg::Pcg64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How a body may rest on a floor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Stance {
    /// Its +Y stays up: furniture, plants, vessels, buildings, terrain.
    Upright,
    /// It may lie on any side.
    Any,
}

/// A family of bodies, from parameters in their ranges to a surface.
pub(super) trait Model {
    /// Name in scene files.
    fn family(&self) -> &'static str;
    /// What kind of thing it is.
    fn group(&self) -> &'static str;
    /// How it may rest.
    fn stance(&self) -> Stance;
    /// Largest extent of the finished mesh, metres.
    fn size(&self) -> f32;
    /// Notes parameters out of range.
    fn check(&self, faults: &mut Faults);
    /// The surface, in any size and place, and the crease angle in degrees.
    fn surface(&self) -> (Builder, f64);
    /// A random member.
    fn draw(rng: &mut Pcg64) -> Self
    where
        Self: Sized;
}

/// A parameter that may have a range.
pub(super) trait Ranged {
    fn check(&self, field: &str, low: f32, high: f32, faults: &mut Faults);
}

impl Ranged for f32 {
    fn check(&self, field: &str, low: f32, high: f32, faults: &mut Faults) {
        faults.range(field, *self, low, high);
    }
}

impl Ranged for u32 {
    fn check(&self, field: &str, low: f32, high: f32, faults: &mut Faults) {
        faults.range(field, *self as f32, low, high);
    }
}

impl<const N: usize> Ranged for [f32; N] {
    fn check(&self, field: &str, low: f32, high: f32, faults: &mut Faults) {
        faults.ranges(field, self, low, high);
    }
}

/// A family: `Name("family", "group", Stance) |rng| { field: type [low, high] = a random one; ... }`. Every family also has `size`,
/// and its inherent `build(&self) -> (Builder, f64)` makes the surface.
macro_rules! model {
    ($(#[$doc:meta])* $name:ident($family:literal, $group:literal, $stance:ident) |$rng:ident| {
        $($(#[$field_doc:meta])* $field:ident: $type:ty $([$low:literal, $high:literal])? = $draw:expr;)*
    }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
        #[serde(deny_unknown_fields)]
        pub struct $name {
            /// Largest extent of the bounding box, metres, 0.01..=1000.
            pub size: f32,
            $($(#[$field_doc])* $(#[doc = concat!("Range ", $low, "..=", $high, ".")])? pub $field: $type,)*
        }

        impl $crate::shapes::model::Model for $name {
            fn family(&self) -> &'static str {
                $family
            }
            fn group(&self) -> &'static str {
                $group
            }
            fn stance(&self) -> $crate::shapes::model::Stance {
                $crate::shapes::model::Stance::$stance
            }
            fn size(&self) -> f32 {
                self.size
            }
            fn check(&self, faults: &mut $crate::shapes::Faults) {
                faults.range("size", self.size, 0.01, 1e3);
                $($($crate::shapes::model::Ranged::check(&self.$field, stringify!($field), $low as f32, $high as f32, faults);)?)*
            }
            fn surface(&self) -> ($crate::shapes::builder::Builder, f64) {
                self.build()
            }
            fn draw($rng: &mut rand_pcg::Pcg64) -> Self {
                let size = $crate::draw::Draw::between($rng, 0.75, 1.25);
                $(let $field = $draw;)*
                Self { size, $($field),* }
            }
        }
    };
}
pub(super) use model;

/// A named choice of a family and its equally likely random draw.
macro_rules! choice {
    ($(#[$doc:meta])* $name:ident { $($(#[$variant_doc:meta])* $variant:ident),* $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
        #[serde(rename_all = "snake_case")]
        pub enum $name {
            $($(#[$variant_doc])* $variant),*
        }

        impl $name {
            fn draw(rng: &mut rand_pcg::Pcg64) -> Self {
                let all = [$(Self::$variant),*];
                all[$crate::draw::Draw::below(rng, all.len() as u32) as usize]
            }
        }
    };
}
pub(super) use choice;
