//! One declaration for each parameter of shapes, skies and patterns: [`family!`].

use schemars::Schema;
use schemars::transform::Transform;
use serde_json::Value;

/// Collects (pointer, message) pairs of values outside their range.
#[derive(Default)]
pub(crate) struct Faults(pub Vec<(String, String)>);

impl Faults {
    /// What is wrong with `whole` and all its parameters.
    pub fn of(whole: &impl Parameter) -> Vec<(String, String)> {
        let mut faults = Self::default();
        whole.check("", Limits::NONE, &mut faults);
        faults.0
    }

    /// Notes what is wrong with the parameter at `field`.
    pub fn say(&mut self, field: &str, reason: String) {
        self.0.push((format!("/{field}"), reason));
    }

    /// Notes `value` when it is not in `low..=high` (NaN included).
    pub fn range(&mut self, field: &str, value: f32, low: f32, high: f32) {
        if !(low..=high).contains(&value) {
            self.say(field, format!("{value} is outside {low}..={high}"));
        }
    }

    /// Notes `value` when it keeps to its own range `wide`, but not to the narrower `low..=high` that other parameters leave it.
    pub fn narrower(&mut self, field: &str, value: f32, wide: [f32; 2], low: f32, high: f32) {
        if (wide[0]..=wide[1]).contains(&value) {
            self.range(field, value, low, high);
        }
    }
}

/// What the brackets of a parameter say.
#[derive(Clone, Copy)]
pub(crate) struct Limits {
    /// Least and greatest value of every number in it.
    pub numbers: Option<[f32; 2]>,
    /// Fewest and most entries of a list.
    pub count: Option<[usize; 2]>,
}

impl Limits {
    /// Any value.
    pub const NONE: Self = Self { numbers: None, count: None };
}

/// The value of a parameter, or a group of parameters.
pub(crate) trait Parameter {
    /// Notes what is out of range; `at` is the pointer of the value, without the first slash.
    fn check(&self, _at: &str, _limits: Limits, _faults: &mut Faults) {}
}

/// Pointer of a field of what lies at `at`.
pub(crate) fn below(at: &str, field: impl std::fmt::Display) -> String {
    if at.is_empty() { field.to_string() } else { format!("{at}/{field}") }
}

impl Parameter for bool {}

impl Parameter for f32 {
    fn check(&self, at: &str, limits: Limits, faults: &mut Faults) {
        if let Some([low, high]) = limits.numbers {
            faults.range(at, *self, low, high);
        }
    }
}

impl Parameter for u32 {
    fn check(&self, at: &str, limits: Limits, faults: &mut Faults) {
        // Ranges end at small whole numbers, exact in single precision; a huge one stays out of its range.
        (*self as f32).check(at, limits, faults);
    }
}

impl<T: Parameter> Parameter for [T] {
    fn check(&self, at: &str, limits: Limits, faults: &mut Faults) {
        for (index, value) in self.iter().enumerate() {
            value.check(&below(at, index), Limits { count: None, ..limits }, faults);
        }
    }
}

impl<T: Parameter, const N: usize> Parameter for [T; N] {
    fn check(&self, at: &str, limits: Limits, faults: &mut Faults) {
        self.as_slice().check(at, limits, faults);
    }
}

impl<T: Parameter> Parameter for Vec<T> {
    fn check(&self, at: &str, limits: Limits, faults: &mut Faults) {
        if let Some([few, many]) = limits.count
            && !(few..=many).contains(&self.len())
        {
            faults.say(at, format!("{} entries, outside {few}..={many}", self.len()));
        }
        self.as_slice().check(at, limits, faults);
    }
}

impl<T: Parameter> Parameter for Option<T> {
    fn check(&self, at: &str, limits: Limits, faults: &mut Faults) {
        self.iter().for_each(|value| value.check(at, limits, faults));
    }
}

impl<T: Parameter> Parameter for Box<T> {
    fn check(&self, at: &str, limits: Limits, faults: &mut Faults) {
        (**self).check(at, limits, faults);
    }
}

/// An enum of families or kinds, told apart by a tag.
pub(crate) trait Tagged {
    /// Tags as scene files write them, in the order of the enum.
    const NAMES: &'static [&'static str];

    /// Its tag.
    fn name(&self) -> &'static str;
}

/// What the brackets of a parameter say, for its JSON Schema.
pub(crate) struct Bounds {
    /// Least and greatest value of every number in it.
    pub numbers: Option<[Value; 2]>,
    /// Fewest and most entries of a list.
    pub count: Option<[usize; 2]>,
}

impl Transform for Bounds {
    fn transform(&mut self, schema: &mut Schema) {
        if let Some([few, many]) = self.count.take() {
            schema.insert("minItems".into(), few.into());
            schema.insert("maxItems".into(), many.into());
        }
        let is = |kind: &str| match schema.get("type") {
            Some(Value::Array(kinds)) => kinds.iter().any(|k| k == kind),
            Some(one) => one == kind,
            None => false,
        };
        if let Some([low, high]) = self.numbers.clone()
            && (is("number") || is("integer"))
        {
            schema.insert("minimum".into(), low);
            schema.insert("maximum".into(), high);
        }
        if let Some(items) = schema.get_mut("items").and_then(|items| <&mut Schema>::try_from(items).ok()) {
            self.transform(items);
        }
    }
}

/// [`Limits`] of the words in a parameter's brackets; bounds after `least` and `most` may name the other parameters.
macro_rules! limits {
    () => {
        $crate::family::Limits::NONE
    };
    ($low:literal, $high:literal) => {
        $crate::family::limits!(@numbers $low as f32, $high as f32)
    };
    ($low:literal, $high:literal; most $most:expr) => {
        $crate::family::limits!(@numbers $low as f32, $most)
    };
    ($low:literal, $high:literal; least $least:expr) => {
        $crate::family::limits!(@numbers $least, $high as f32)
    };
    ($low:literal, $high:literal; least $least:expr; most $most:expr) => {
        $crate::family::limits!(@numbers $least, $most)
    };
    ($($low:literal, $high:literal)?; count $few:literal, $many:literal) => {
        $crate::family::Limits { count: Some([$few, $many]), ..$crate::family::limits!($($low, $high)?) }
    };
    (@numbers $low:expr, $high:expr) => {
        $crate::family::Limits { numbers: Some([$low, $high]), count: None }
    };
}
pub(crate) use limits;

/// [`Bounds`] of the words in a parameter's brackets.
macro_rules! bounds {
    ($($low:literal, $high:literal)? $(; least $least:expr)? $(; most $most:expr)?) => {
        $crate::family::bounds!(@both [$($low, $high)?] [])
    };
    ($($low:literal, $high:literal)?; count $few:literal, $many:literal) => {
        $crate::family::bounds!(@both [$($low, $high)?] [$few, $many])
    };
    (@both [$($low:literal, $high:literal)?] [$($few:literal, $many:literal)?]) => {
        $crate::family::Bounds {
            numbers: None $(.or(Some([serde_json::json!($low), serde_json::json!($high)])))?,
            count: None $(.or(Some([$few, $many])))?,
        }
    };
}
pub(crate) use bounds;

/// The sentence about the words in a parameter's brackets.
macro_rules! range_doc {
    ($low:literal, $high:literal; count $few:literal, $many:literal) => {
        concat!("Range ", stringify!($low), "..=", stringify!($high), "; ", $few, " to ", $many, " entries.")
    };
    (; count $few:literal, $many:literal) => {
        concat!("From ", $few, " to ", $many, " entries.")
    };
    ($low:literal, $high:literal $($more:tt)*) => {
        concat!("Range ", stringify!($low), "..=", stringify!($high), ".")
    };
}
pub(crate) use range_doc;

/// Declares parameters, each once, with documentation, type, range, default and random draw. From that follow the type, its form
/// in files, its JSON Schema, its documentation and its check.
///
/// ```text
/// /// What it is.
/// name: type [low, high] or default = draw;
/// ```
///
/// All behind the type may be absent. The brackets hold the range of every number of the parameter; `; most EXPRESSION` and
/// `; least EXPRESSION` narrow it by other parameters, which go by their names there, and `; count FEW, MOST` limits the entries
/// of a list. `or` is the default of a pattern; parameters of shapes and skies that a file may leave out have serde's `default`
/// attribute. Draws are made from top to bottom and may name what is above. What else must hold stands behind the parameters:
/// `, rules |faults, at| { ... }`.
///
/// There are five forms:
/// - `pub struct Name { ... }`: a part of others.
/// - `pub enum Name by "tag" { Variant = "name" { ... } ... }`: kinds told apart by a tag in the file.
/// - `pub enum Name by "tag" |rng| { Variant = "name" { ... } ... } or { Model = "name"; ... }`: the same with draws
///   (`with { ... }` before the parameters draws those that have no draw of their own), and with variants that are shapes with
///   files of their own.
/// - `shape Name("group", Stance) |rng| { ... }`: a shape with a file of its own. It has `size` besides, and its inherent
///   `build(&self) -> (Builder, f64)` makes the surface.
/// - `pattern Name: COUNT colors [...], roughness [...], depth ...; ...`: a pattern, which has a seed and a resolution besides.
macro_rules! family {
    (
        $(#[$doc:meta])*
        pub struct $name:ident {
            $($(#[$field_doc:meta])* $field:ident: $ty:ty $([$($range:tt)*])?;)*
        }
        $(, rules |$faults:ident, $at:ident| $rules:block)?
    ) => {
        $crate::family::family! {
            @struct [serde(deny_unknown_fields)] $(#[$doc])* $name {
                $($(#[$field_doc])* $field: $ty $([$($range)*])?;)*
            }
            $(, rules |$faults, $at| $rules)?
        }
    };

    (
        $(#[$doc:meta])*
        shape $name:ident($group:literal, $stance:ident) |$rng:ident| {
            $($(#[$field_doc:meta])* $field:ident: $ty:ty $([$($range:tt)*])? = $draw:expr;)*
        }
    ) => {
        $crate::family::family! {
            @struct [serde(deny_unknown_fields)] $(#[$doc])* $name {
                /// Largest extent of the bounding box, metres.
                size: f32 [0.01, 1000];
                $($(#[$field_doc])* $field: $ty $([$($range)*])?;)*
            }
        }

        impl $crate::shapes::model::Model for $name {
            fn group(&self) -> &'static str {
                $group
            }
            fn stance(&self) -> $crate::shapes::model::Stance {
                $crate::shapes::model::Stance::$stance
            }
            fn size(&self) -> f32 {
                self.size
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

    (
        $(#[$doc:meta])*
        pattern $name:ident: $count:literal colors $palette:expr, roughness $roughness:expr, depth $depth:literal;
        $($(#[$field_doc:meta])* $field:ident: $ty:ty [$($range:tt)*] or $default:literal;)*
    ) => {
        $crate::family::family! {
            @struct [serde(deny_unknown_fields, default)] $(#[$doc])* $name {
                /// Colours in the order named above, linear Rec.709.
                colors: [[f32; 3]; $count] [0, 1];
                /// Roughness where the surface is smoothest and where it is roughest.
                roughness: [f32; 2] [0, 1];
                /// Depth of the relief in widths of the texture; 0 = flat, without a normal map.
                depth: f32 [0, 0.2];
                $($(#[$field_doc])* $field: $ty [$($range)*];)*
                /// Which of all such patterns.
                seed: u32;
                /// Texels along an edge.
                resolution: u32 [64, 2048];
            }
        }

        impl Default for $name {
            fn default() -> Self {
                Self {
                    colors: $palette,
                    roughness: $roughness,
                    depth: $depth,
                    $($field: $default,)*
                    seed: 0,
                    resolution: 512,
                }
            }
        }

        impl $name {
            pub(super) fn common(&self) -> super::sheet::Common {
                super::sheet::Common {
                    size: self.resolution as usize,
                    roughness: self.roughness.map(f64::from),
                    depth: f64::from(self.depth),
                }
            }

            fn palette(&self) -> [[f64; 3]; $count] {
                self.colors.map(|c| c.map(f64::from))
            }
        }
    };

    (
        @struct [$container:meta] $(#[$doc:meta])* $name:ident {
            $($(#[$field_doc:meta])* $field:ident: $ty:ty $([$($range:tt)*])?;)*
        }
        $(, rules |$faults:ident, $at:ident| $rules:block)?
    ) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
        #[$container]
        pub struct $name {
            $(
                $(#[$field_doc])*
                $(
                    #[doc = $crate::family::range_doc!($($range)*)]
                    #[schemars(transform = $crate::family::bounds!($($range)*))]
                )?
                pub $field: $ty,
            )*
        }

        impl $crate::family::Parameter for $name {
            fn check(&self, at: &str, _: $crate::family::Limits, faults: &mut $crate::family::Faults) {
                let Self { $($field),* } = self;
                $(
                    let limits = $crate::family::limits!($($($range)*)?);
                    $crate::family::Parameter::check($field, &$crate::family::below(at, stringify!($field)), limits, faults);
                )*
                $(
                    let rules = |$faults: &mut $crate::family::Faults, $at: &str| $rules;
                    rules(faults, at);
                )?
            }
        }
    };

    (
        $(#[$doc:meta])*
        pub enum $name:ident by $tag:literal {
            $(
                $(#[$variant_doc:meta])*
                $variant:ident = $family:literal {
                    $($(#[$field_doc:meta])* $field:ident: $ty:ty $([$($range:tt)*])?;)*
                }
                $(, rules |$faults:ident, $at:ident| $rules:block)?
            )*
        }
        $(or { $($(#[$model_doc:meta])* $model:ident = $model_family:literal;)* })?
    ) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
        #[serde(rename_all = "snake_case", deny_unknown_fields, tag = $tag)]
        pub enum $name {
            $(
                $(#[$variant_doc])*
                $variant {
                    $(
                        $(#[$field_doc])*
                        $(
                            #[doc = $crate::family::range_doc!($($range)*)]
                            #[schemars(transform = $crate::family::bounds!($($range)*))]
                        )?
                        $field: $ty,
                    )*
                },
            )*
            $($($(#[$model_doc])* $model($model),)*)?
        }

        impl $crate::family::Tagged for $name {
            const NAMES: &'static [&'static str] = &[$($family,)* $($($model_family),*)?];

            fn name(&self) -> &'static str {
                match self {
                    $(Self::$variant { .. } => $family,)*
                    $($(Self::$model(_) => $model_family,)*)?
                }
            }
        }

        impl $crate::family::Parameter for $name {
            fn check(&self, at: &str, _: $crate::family::Limits, faults: &mut $crate::family::Faults) {
                match self {
                    $(
                        Self::$variant { $($field),* } => {
                            $(
                                let limits = $crate::family::limits!($($($range)*)?);
                                let place = $crate::family::below(at, stringify!($field));
                                $crate::family::Parameter::check($field, &place, limits, faults);
                            )*
                            $(
                                let rules = |$faults: &mut $crate::family::Faults, $at: &str| $rules;
                                rules(faults, at);
                            )?
                        }
                    )*
                    $($(
                        Self::$model(model) => {
                            $crate::family::Parameter::check(model, at, $crate::family::Limits::NONE, faults);
                        }
                    )*)?
                }
            }
        }
    };

    (
        $(#[$doc:meta])*
        pub enum $name:ident by $tag:literal |$rng:ident| {
            $(
                $(#[$variant_doc:meta])*
                $variant:ident = $family:literal $(with { $($shared:tt)* })? {
                    $($(#[$field_doc:meta])* $field:ident: $ty:ty $([$($range:tt)*])? $(= $draw:expr)?;)*
                }
                $(, rules |$faults:ident, $at:ident| $rules:block)?
            )*
        }
        or { $($(#[$model_doc:meta])* $model:ident = $model_family:literal;)* }
    ) => {
        $crate::family::family! {
            $(#[$doc])*
            pub enum $name by $tag {
                $(
                    $(#[$variant_doc])*
                    $variant = $family { $($(#[$field_doc])* $field: $ty $([$($range)*])?;)* }
                    $(, rules |$faults, $at| $rules)?
                )*
            }
            or { $($(#[$model_doc])* $model = $model_family;)* }
        }

        impl $name {
            /// A random member of the family of this name; `None` for a name of no family.
            fn draw(family: &str, $rng: &mut rand_pcg::Pcg64) -> Option<Self> {
                Some(match family {
                    $(
                        $family => {
                            $($($shared)*)?
                            $($(let $field = $draw;)?)*
                            Self::$variant { $($field),* }
                        }
                    )*
                    $($model_family => Self::$model(<$model as $crate::shapes::model::Model>::draw($rng)),)*
                    _ => return None,
                })
            }

            /// The shape with a file of its own, where it is one.
            fn model(&self) -> Option<&dyn $crate::shapes::model::Model> {
                match self {
                    $(Self::$model(model) => Some(model),)*
                    _ => None,
                }
            }
        }
    };
}
pub(crate) use family;

/// A named choice of a family and its equally likely random draw.
macro_rules! choice {
    ($(#[$doc:meta])* $name:ident { $($(#[$variant_doc:meta])* $variant:ident),* $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
        #[serde(rename_all = "snake_case")]
        pub enum $name {
            $($(#[$variant_doc])* $variant),*
        }

        impl $crate::family::Parameter for $name {}

        impl $name {
            fn draw(rng: &mut rand_pcg::Pcg64) -> Self {
                let all = [$(Self::$variant),*];
                all[$crate::draw::Draw::below(rng, all.len() as u32) as usize]
            }
        }
    };
}
pub(crate) use choice;
