//! What all kinds have in common, written once.

/// A kind of pattern: a struct with its colours, roughness range, depth, seed and resolution, and parameters of its own, each with range
/// and default, as in the table at its place. Gives `Default`, `common()`, `check()` and `palette()`.
macro_rules! kind {
    (
        $(#[$doc:meta])*
        $name:ident: $count:literal colors $palette:expr, roughness $roughness:expr, depth $depth:literal;
        $( $(#[$field_doc:meta])* $field:ident: $ty:ident in $low:literal ..= $high:literal, $default:literal; )*
    ) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
        #[serde(deny_unknown_fields, default)]
        pub struct $name {
            /// Colours in the order named above, linear Rec.709, each 0..=1.
            #[schemars(inner(inner(range(min = 0, max = 1))))]
            pub colors: [[f32; 3]; $count],
            /// Roughness where the surface is smoothest and where it is roughest, each 0..=1.
            #[schemars(inner(range(min = 0, max = 1)))]
            pub roughness: [f32; 2],
            /// Depth of the relief in widths of the texture, 0..=0.2; 0 = flat, without a normal map.
            #[schemars(range(min = 0, max = 0.2))]
            pub depth: f32,
            $(
                $(#[$field_doc])*
                #[doc = concat!("Range ", stringify!($low), "..=", stringify!($high), ".")]
                #[schemars(range(min = $low, max = $high))]
                pub $field: $ty,
            )*
            /// Which of all such patterns.
            pub seed: u32,
            /// Texels along an edge, 64..=2048.
            #[schemars(range(min = 64, max = 2048))]
            pub resolution: u32,
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

            pub(super) fn check(&self, faults: &mut crate::shapes::Faults) {
                for (index, color) in self.colors.iter().enumerate() {
                    faults.ranges(&format!("colors/{index}"), color, 0.0, 1.0);
                }
                faults.ranges("roughness", &self.roughness, 0.0, 1.0);
                faults.range("depth", self.depth, 0.0, 0.2);
                $(
                    // Counts are small whole numbers: exact in single precision; a huge one stays out of its range.
                    faults.range(stringify!($field), self.$field as f32, $low as f32, $high as f32);
                )*
                faults.range("resolution", self.resolution as f32, 64.0, 2048.0);
            }

            fn palette(&self) -> [[f64; 3]; $count] {
                self.colors.map(|c| c.map(f64::from))
            }
        }
    };
}

pub(super) use kind;
