//! Parameters of the principled material (Burley 2012), each declared once. The description of a scene, the loaded material, the
//! path tracer and the deferred renderer all use this list.
//!
//! A new parameter is one entry here. The tests of this crate then ask for a new `schema.json` and for an example in
//! `examples/materials.json`. The renderer ignores the parameter until a lobe reads it.

use glam::Vec3A;

/// Passes the parameters to the macro `$then`, after the tokens in `{ }`. An entry gives the doc comment, the name, the type in a
/// scene file, the default, and the attributes of the field in a scene file. Every number of every parameter lies in 0..=1.
///
/// Parameters of the first version of the scene format are always written; a newer one is written only where it differs from its
/// default, so that older scenes keep their bytes.
macro_rules! with_parameters {
    ($then:ident! { $($first:tt)* }) => {
        $then! {
            { $($first)* }
            /// Linear Rec.709, 0..=1.
            base_color: [f32; 3] = [0.8; 3], (serde(default = "grey"), schemars(inner(range(min = 0, max = 1))));
            /// 0..=1.
            metallic: f32 = 0.0, (serde(default), schemars(range(min = 0, max = 1)));
            /// 0..=1.
            roughness: f32 = 0.5, (serde(default = "half"), schemars(range(min = 0, max = 1)));
            /// 0..=1; 0.5 means 4% at normal incidence.
            specular: f32 = 0.5, (serde(default = "half"), schemars(range(min = 0, max = 1)));
            /// 0..=1, 0 by default; share of the base colour's hue in the dielectric reflection.
            specular_tint: f32 = 0.0, (serde(default, skip_serializing_if = "is_zero"), schemars(range(min = 0, max = 1)));
            /// 0..=1, 0 by default; stretch of highlights; along the direction of growing u where the mesh has texture
            /// coordinates.
            anisotropic: f32 = 0.0, (serde(default, skip_serializing_if = "is_zero"), schemars(range(min = 0, max = 1)));
            /// 0..=1, 0 by default; grazing component of cloth.
            sheen: f32 = 0.0, (serde(default, skip_serializing_if = "is_zero"), schemars(range(min = 0, max = 1)));
            /// 0..=1, 0 by default; share of the base colour's hue in the sheen.
            sheen_tint: f32 = 0.0, (serde(default, skip_serializing_if = "is_zero"), schemars(range(min = 0, max = 1)));
            /// 0..=1, 0 by default; second specular layer.
            clearcoat: f32 = 0.0, (serde(default, skip_serializing_if = "is_zero"), schemars(range(min = 0, max = 1)));
            /// 0..=1, 1 by default; gloss of that layer: 0 like satin, 1 like glass.
            clearcoat_gloss: f32 = 1.0, (serde(default = "one", skip_serializing_if = "is_one"), schemars(range(min = 0, max = 1)));
            /// 0..=1, 0 by default; share of the diffuse shape that approximates subsurface scattering.
            subsurface: f32 = 0.0, (serde(default, skip_serializing_if = "is_zero"), schemars(range(min = 0, max = 1)));
            /// 0..=1, 0 by default; share of the part that is no metal that lets light through, coloured by the base colour. The
            /// index of refraction is that of `specular`: 0.26 is water (1.33), 0.5 is glass (1.5).
            transmission: f32 = 0.0, (serde(default, skip_serializing_if = "is_zero"), schemars(range(min = 0, max = 1)));
        }
    };
}
pub(crate) use with_parameters;

/// A type that a parameter may have.
pub(crate) trait Parameter: Copy {
    /// The type in a scene file.
    type Stored: Copy;
    /// The parameter that a scene file holds.
    fn of(stored: Self::Stored) -> Self;
    /// Each number, with the suffix that a JSON pointer to it has.
    fn for_each(self, f: impl FnMut(&str, f32));
    /// The parameter whose numbers are the results of calls of `f`.
    fn from_fn(f: impl FnMut() -> f32) -> Self;
    /// The parameter with every number in 0..=1.
    fn clamped(self) -> Self;
    /// The parameter between this one, at `t` = 0, and `other`, at `t` = 1.
    fn mixed(self, other: Self, t: f64) -> Self;
}

impl Parameter for f32 {
    type Stored = Self;

    #[inline(always)]
    fn of(stored: Self) -> Self {
        stored
    }

    fn for_each(self, mut f: impl FnMut(&str, f32)) {
        f("", self);
    }

    fn from_fn(mut f: impl FnMut() -> f32) -> Self {
        f()
    }

    #[inline(always)]
    fn clamped(self) -> Self {
        self.clamp(0.0, 1.0)
    }

    fn mixed(self, other: Self, t: f64) -> Self {
        (f64::from(self) * (1.0 - t) + f64::from(other) * t) as f32
    }
}

impl Parameter for Vec3A {
    type Stored = [f32; 3];

    #[inline(always)]
    fn of(stored: [f32; 3]) -> Self {
        Self::from_array(stored)
    }

    fn for_each(self, mut f: impl FnMut(&str, f32)) {
        for (suffix, value) in ["/0", "/1", "/2"].into_iter().zip(self.to_array()) {
            f(suffix, value);
        }
    }

    fn from_fn(mut f: impl FnMut() -> f32) -> Self {
        Self::new(f(), f(), f())
    }

    #[inline(always)]
    fn clamped(self) -> Self {
        self.clamp(Self::ZERO, Self::ONE)
    }

    fn mixed(self, other: Self, t: f64) -> Self {
        Self::new(self.x.mixed(other.x, t), self.y.mixed(other.y, t), self.z.mixed(other.z, t))
    }
}

/// The type of a parameter in memory, by its type in a scene file.
macro_rules! in_memory {
    (f32) => {
        f32
    };
    ([f32; 3]) => {
        Vec3A
    };
}

macro_rules! principled {
    ({} $($(#[$doc:meta])* $name:ident: $type:tt = $default:expr, ($($attribute:meta),*);)*) => {
        /// Parameters of a principled material, either its factors or their values at one surface point, textures applied.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct Principled {
            $($(#[$doc])* pub $name: in_memory!($type),)*
        }

        impl Default for Principled {
            /// A grey, half rough dielectric.
            fn default() -> Self {
                Self { $($name: Parameter::of($default),)* }
            }
        }

        impl Principled {
            /// Calls `f` with every number of every parameter and its JSON pointer in a material, such as `roughness` or
            /// `base_color/1`.
            pub fn for_each(&self, mut f: impl FnMut(&str, f32)) {
                $(self.$name.for_each(|suffix, value| f(&format!("{}{suffix}", stringify!($name)), value));)*
            }

            /// Parameters whose numbers are the results of calls of `f`, in the order of declaration.
            pub fn from_fn(mut f: impl FnMut() -> f32) -> Self {
                Self { $($name: Parameter::from_fn(&mut f),)* }
            }

            /// Every parameter in its range.
            #[inline]
            pub fn clamped(&self) -> Self {
                Self { $($name: self.$name.clamped(),)* }
            }

            /// The parameters between these, at `t` = 0, and `other`, at `t` = 1.
            pub fn mixed(&self, other: &Self, t: f64) -> Self {
                Self { $($name: self.$name.mixed(other.$name, t),)* }
            }
        }

        impl From<&super::Material> for Principled {
            fn from(described: &super::Material) -> Self {
                Self { $($name: Parameter::of(described.$name),)* }
            }
        }
    };
}
with_parameters!(principled! {});

impl Principled {
    /// Whether only base colour, metallic, roughness and specular matter.
    pub fn is_plain(&self) -> bool {
        [self.specular_tint, self.anisotropic, self.sheen, self.clearcoat, self.subsurface, self.transmission]
            .iter()
            .all(|v| *v <= 0.0)
    }

    /// The parameters that matter to plain materials in their range, the others as they are.
    #[inline]
    pub fn clamped_plain(&self) -> Self {
        Self {
            base_color: self.base_color.clamped(),
            metallic: self.metallic.clamped(),
            roughness: self.roughness.clamped(),
            specular: self.specular.clamped(),
            ..*self
        }
    }

    /// The first number outside 0..=1 (or NaN), with its pointer.
    pub fn out_of_range(&self) -> Option<(String, f32)> {
        let mut found = None;
        self.for_each(|pointer, value| {
            if found.is_none() && !(0.0..=1.0).contains(&value) {
                found = Some((pointer.to_owned(), value));
            }
        });
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::description::Material;

    #[test]
    fn the_defaults_of_a_file_and_of_memory_agree() {
        let empty: Material = serde_json::from_str(r#"{"name": "a"}"#).unwrap();
        assert_eq!(Principled::from(&empty), Principled::default());
        assert_eq!(Principled::from(&Material::default()), Principled::default());
        let mut pointers = Vec::new();
        Principled::default().for_each(|pointer, _| pointers.push(pointer.to_owned()));
        assert_eq!((pointers.len(), pointers[2].as_str(), pointers[13].as_str()), (14, "base_color/2", "transmission"));
    }

    #[test]
    fn ranges_hold_for_every_parameter() {
        let mut wrong = Principled { base_color: Vec3A::new(0.5, 1.5, -1.0), ..Principled::default() };
        assert_eq!(wrong.out_of_range(), Some(("base_color/1".into(), 1.5)));
        wrong.base_color = Vec3A::ONE;
        assert_eq!(wrong.out_of_range(), None);
        wrong.subsurface = f32::NAN;
        assert_eq!(wrong.out_of_range().unwrap().0, "subsurface");
        wrong = Principled { sheen: 2.0, clearcoat_gloss: -3.0, base_color: Vec3A::splat(7.0), ..wrong };
        let clamped = Principled { subsurface: 0.0, ..wrong }.clamped();
        assert_eq!((clamped.sheen, clamped.clearcoat_gloss, clamped.base_color), (1.0, 0.0, Vec3A::ONE));
    }

    #[test]
    fn what_does_not_change_stays_to_the_bit() {
        let from = Principled { roughness: 0.1, base_color: Vec3A::new(0.3, 0.7, 0.9), ..Principled::default() };
        let to = Principled { metallic: 1.0, ..from };
        for t in [0.1, 1.0 / 3.0, 0.7] {
            assert_eq!(from.mixed(&to, t), Principled { metallic: t as f32, ..from });
        }
    }
}
