//! Materials of a scene file.

use super::MaterialChange;
use super::principled::with_parameters;
use crate::pattern::Pattern;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

macro_rules! material {
    ({ $($rest:tt)* } $($(#[$doc:meta])* $name:ident: $type:tt = $default:expr, ($($attribute:meta),*);)*) => {
        /// Disney's principled material (Burley 2012), with light of its own and holes. What is left out has its default; what
        /// came after the first version is written only where it differs from it, so that older scenes keep their bytes.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(deny_unknown_fields)]
        pub struct Material {
            /// Unique name.
            pub name: String,
            $($(#[$doc])* $(#[$attribute])* pub $name: $type,)*
            $($rest)*
        }

        impl Default for Material {
            /// Grey, rough, without a name.
            fn default() -> Self {
                Self {
                    name: String::new(),
                    $($name: $default,)*
                    emissive: [0.0; 3],
                    alpha_cutoff: None,
                    opacity: None,
                    double_sided: true,
                    thin_walled: false,
                    attenuation_color: [1.0; 3],
                    attenuation_distance: 1.0,
                    base_color_texture: None,
                    metallic_roughness_texture: None,
                    normal_texture: None,
                    emissive_texture: None,
                    pattern: None,
                    texture_transform: TextureTransform::default(),
                    texture_wrap: TextureWrap::Repeat,
                    change: None,
                }
            }
        }
    };
}
with_parameters!(material! {
    /// Radiance that the surface emits, linear Rec.709, 0..=1e6; none by default.
    #[serde(default, skip_serializing_if = "is_black")]
    #[schemars(inner(range(min = 0, max = 1e6)))]
    pub emissive: [f32; 3],
    /// The surface is there where the alpha of `base_color_texture` reaches this, 0..=1; everywhere without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 1))]
    pub alpha_cutoff: Option<f32>,
    /// Share of the surface that covers what lies behind it, 0..=1, multiplied by the alpha of `base_color_texture`. Light goes
    /// straight through the rest. Without it the surface covers everything. Not together with `alpha_cutoff`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0, max = 1))]
    pub opacity: Option<f32>,
    /// Whether the surface exists seen from behind, too; true by default. A surface that bounds a clear body exists from both
    /// sides in any case.
    #[serde(default = "yes", skip_serializing_if = "is_true")]
    pub double_sided: bool,
    /// Whether a surface with `transmission` is a sheet without an inside, such as a window pane or a leaf, which does not bend
    /// light. Otherwise it bounds a body of glass or water with air outside. False by default.
    #[serde(default, skip_serializing_if = "is_false")]
    pub thin_walled: bool,
    /// Colour of white light after `attenuation_distance` inside the body, linear Rec.709, 1e-6..=1; white by default.
    #[serde(default = "white", skip_serializing_if = "is_white")]
    #[schemars(inner(range(min = 1e-6, max = 1)))]
    pub attenuation_color: [f32; 3],
    /// Metres inside the body after which light has the colour `attenuation_color`, 1e-9..=1e9; 1 by default.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    #[schemars(range(min = 1e-9, max = 1e9))]
    pub attenuation_distance: f32,
    /// Image multiplied with `base_color`, decoded from sRGB; relative to the scene file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base_color_texture: Option<String>,
    /// Image whose green is roughness and blue is metallic (glTF's layout), multiplied with the factors.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub metallic_roughness_texture: Option<String>,
    /// Tangent-space normal map, OpenGL (+y up).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub normal_texture: Option<String>,
    /// Image multiplied with `emissive`, decoded from sRGB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub emissive_texture: Option<String>,
    /// Texture made from parameters instead of images: colour, roughness, metallic and normals. They are multiplied with the
    /// factors, as images are: `base_color` 1, `metallic` 1 and `roughness` 1 show it as it is. Not together with images of the
    /// same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pattern: Option<Pattern>,
    /// How all of its textures lie on the surface.
    #[serde(default, skip_serializing_if = "TextureTransform::is_identity")]
    pub texture_transform: TextureTransform,
    /// How all of its textures go on beyond their edges.
    #[serde(default, skip_serializing_if = "TextureWrap::is_repeat")]
    pub texture_wrap: TextureWrap,
    /// What it becomes along the sequence; it stays as it is without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub change: Option<MaterialChange>,
});

/// Texture coordinates to places in the image: scale, then rotation, then offset, as KHR_texture_transform has it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TextureTransform {
    /// Widths and heights of the image, -1e6..=1e6; v runs down.
    #[schemars(inner(range(min = -1e6, max = 1e6)))]
    pub offset: [f32; 2],
    /// Degrees, counter-clockwise on the surface's coordinates.
    pub rotation: f32,
    /// Repetitions along u and v, -1e6..=1e6.
    #[schemars(inner(range(min = -1e6, max = 1e6)))]
    pub scale: [f32; 2],
}

impl Default for TextureTransform {
    fn default() -> Self {
        Self { offset: [0.0; 2], rotation: 0.0, scale: [1.0; 2] }
    }
}

impl TextureTransform {
    fn is_identity(&self) -> bool {
        *self == Self::default()
    }
}

/// How texture coordinates outside 0..1 behave, along u and v alike.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TextureWrap {
    /// The image again and again.
    #[default]
    Repeat,
    /// Again and again, every other one mirrored.
    Mirror,
    /// The texels of the edge.
    Clamp,
}

impl TextureWrap {
    fn is_repeat(&self) -> bool {
        *self == Self::Repeat
    }
}

fn grey() -> [f32; 3] {
    [0.8; 3]
}
fn half() -> f32 {
    0.5
}
fn one() -> f32 {
    1.0
}
fn yes() -> bool {
    true
}
fn is_zero(v: &f32) -> bool {
    *v == 0.0
}
fn is_one(v: &f32) -> bool {
    *v == 1.0
}
fn white() -> [f32; 3] {
    [1.0; 3]
}
fn is_white(v: &[f32; 3]) -> bool {
    *v == [1.0; 3]
}
fn is_false(v: &bool) -> bool {
    !*v
}
fn is_true(v: &bool) -> bool {
    *v
}
fn is_black(v: &[f32; 3]) -> bool {
    *v == [0.0; 3]
}
