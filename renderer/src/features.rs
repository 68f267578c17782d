//! What a scene needs, as compile-time sets: the integrator is compiled once a set, so that what a scene lacks costs nothing.

/// Compile-time description of a scene. A branch on one of these constants disappears from the compiled integrator.
pub trait Features: Send + Sync + 'static {
    /// Some material looks up base colour or metallic-roughness.
    const TEXTURES: bool;
    /// Some material bends its normal with a map.
    const NORMAL_MAPS: bool;
    /// The environment is the same from everywhere: sampling it explicitly could only add noise and shadow rays.
    const FLAT_ENVIRONMENT: bool;
}

/// What a compiled scene needs, found once by the compiler.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FeatureSet {
    /// See [`Features::TEXTURES`].
    pub textures: bool,
    /// See [`Features::NORMAL_MAPS`].
    pub normal_maps: bool,
    /// See [`Features::FLAT_ENVIRONMENT`].
    pub flat_environment: bool,
    /// The environment sends no light at all: the beauty is black and no path is traced.
    pub black_environment: bool,
}

/// One of the compiled sets; a normal map implies the texture path.
pub struct Compiled<const TEXTURES: bool, const NORMAL_MAPS: bool, const FLAT: bool>;

impl<const TEXTURES: bool, const NORMAL_MAPS: bool, const FLAT: bool> Features for Compiled<TEXTURES, NORMAL_MAPS, FLAT> {
    const TEXTURES: bool = TEXTURES;
    const NORMAL_MAPS: bool = NORMAL_MAPS;
    const FLAT_ENVIRONMENT: bool = FLAT;
}

/// Calls `$function::<F>($arguments...)` with the smallest compiled set that covers `$set`. Six sets exist:
/// {plain, textured, textured with normal maps} x {mapped, flat environment}.
macro_rules! with_features {
    ($set:expr, $function:ident($($argument:expr),* $(,)?)) => {{
        use $crate::features::Compiled;
        let set: $crate::features::FeatureSet = $set;
        match (set.normal_maps, set.textures, set.flat_environment) {
            (true, _, false) => $function::<Compiled<true, true, false>>($($argument),*),
            (true, _, true) => $function::<Compiled<true, true, true>>($($argument),*),
            (false, true, false) => $function::<Compiled<true, false, false>>($($argument),*),
            (false, true, true) => $function::<Compiled<true, false, true>>($($argument),*),
            (false, false, false) => $function::<Compiled<false, false, false>>($($argument),*),
            (false, false, true) => $function::<Compiled<false, false, true>>($($argument),*),
        }
    }};
}
pub(crate) use with_features;
