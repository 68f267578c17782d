//! What a scene needs, as compile-time sets: the integrator is compiled once a set, so that what a scene lacks costs nothing.

use crate::material::{Bsdf, BsdfEval, BsdfSample, ClearBsdf, ClearView, Mode, Prepared, Principled, Side, View};
use glam::Vec3A;

/// Compile-time description of a scene. A branch on one of these constants disappears from the compiled integrator.
pub trait Features: Send + Sync + 'static {
    /// Some material looks something up in a texture (a colour, roughness, a normal).
    const TEXTURES: bool;
    /// The environment is the same from everywhere: sampling it explicitly could only add noise and shadow rays.
    const FLAT_ENVIRONMENT: bool;
    /// More than base colour, metallic, roughness and specular of opaque, double-sided surfaces that do not emit: the other lobes
    /// of the principled BRDF, its published mode, emitters, lights without an area, alpha masks, single-sided surfaces.
    const FULL: bool;
    /// Some surface lets light through by refraction or as a sheet. It implies [`Self::FULL`].
    const CLEAR: bool;
    /// The BSDF that [`Self::FULL`] and [`Self::CLEAR`] call for.
    type Bsdf: Brdf;
}

/// What a compiled scene needs, found once by the compiler.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FeatureSet {
    /// Some instance looks up base colour, metallic-roughness, a normal or emission.
    pub textures: bool,
    /// Some instance bends its normal with a map.
    pub normal_maps: bool,
    /// See [`Features::FLAT_ENVIRONMENT`].
    pub flat_environment: bool,
    /// The environment sends no light at all.
    pub black_environment: bool,
    /// Some material has a lobe beyond base colour, metallic, roughness and specular.
    pub layers: bool,
    /// Some surface emits.
    pub emitters: bool,
    /// There is a light without an area.
    pub punctual: bool,
    /// Some surface has holes, covers only a share of what lies behind, or exists from one side only: rays must ask before they
    /// stop there.
    pub cutouts: bool,
    /// Some surface covers only a share of what lies behind.
    pub blended: bool,
    /// Some surface has transmission.
    pub clear: bool,
    /// Some surface is a pane ([`Side::Pane`]).
    pub panes: bool,
}

impl FeatureSet {
    /// See [`Features::FULL`], for formulae in conserving mode.
    pub fn full(&self) -> bool {
        self.layers || self.lights() || self.cutouts
    }

    /// There are lights besides the environment.
    pub fn lights(&self) -> bool {
        self.emitters || self.punctual
    }

    /// Neither the environment nor anything else sends light: the beauty is black and no path is traced.
    pub fn dark(&self) -> bool {
        self.black_environment && !self.lights()
    }
}

/// One of the compiled sets.
pub struct Compiled<const TEXTURES: bool, const FLAT: bool, const FULL: bool>;

impl<const TEXTURES: bool, const FLAT: bool> Features for Compiled<TEXTURES, FLAT, false> {
    const TEXTURES: bool = TEXTURES;
    const FLAT_ENVIRONMENT: bool = FLAT;
    const FULL: bool = false;
    const CLEAR: bool = false;
    type Bsdf = Bsdf<false>;
}

impl<const TEXTURES: bool, const FLAT: bool> Features for Compiled<TEXTURES, FLAT, true> {
    const TEXTURES: bool = TEXTURES;
    const FLAT_ENVIRONMENT: bool = FLAT;
    const FULL: bool = true;
    const CLEAR: bool = false;
    type Bsdf = Bsdf<true>;
}

/// The compiled sets for scenes with clear surfaces. A flat environment is sampled there like any other.
pub struct Clear<const TEXTURES: bool>;

impl<const TEXTURES: bool> Features for Clear<TEXTURES> {
    const TEXTURES: bool = TEXTURES;
    const FLAT_ENVIRONMENT: bool = false;
    const FULL: bool = true;
    const CLEAR: bool = true;
    type Bsdf = ClearBsdf;
}

/// What the integrator asks of a BSDF; see [`Bsdf`] for the meaning of each.
pub trait Brdf: Copy {
    /// The BSDF seen from one direction.
    type View<'a>: BrdfView
    where
        Self: 'a;

    /// [`Bsdf::new`].
    fn new(surface: &Principled, mode: Mode) -> Self;
    /// The one of this kind among those made before.
    fn prepared(prepared: &Prepared) -> &Self;
    /// [`Bsdf::view`], or [`ClearBsdf::view`] of a surface that is `side` to the viewer.
    fn view(&self, wo: Vec3A, side: Side) -> Self::View<'_>;
}

/// What the integrator asks of a BSDF seen from one direction; see [`View`].
pub trait BrdfView {
    /// [`View::is_black`].
    fn is_black(&self) -> bool;
    /// [`View::eval`].
    fn eval(&self, wi: Vec3A) -> BsdfEval;
    /// [`View::pdf`].
    #[inline(always)]
    fn pdf(&self, wi: Vec3A) -> f32 {
        self.eval(wi).pdf
    }
    /// [`View::sample`].
    fn sample(&self, u_lobe: f32, u: [f32; 2]) -> Option<BsdfSample>;
}

impl Brdf for Bsdf<false> {
    type View<'a> = View<'a, false>;

    #[inline(always)]
    fn new(surface: &Principled, mode: Mode) -> Self {
        Self::new(surface, mode)
    }

    #[inline(always)]
    fn prepared(prepared: &Prepared) -> &Self {
        &prepared.plain
    }

    #[inline(always)]
    fn view(&self, wo: Vec3A, _: Side) -> View<'_, false> {
        self.view(wo)
    }
}

impl Brdf for Bsdf<true> {
    type View<'a> = View<'a, true>;

    #[inline(always)]
    fn new(surface: &Principled, mode: Mode) -> Self {
        Self::new(surface, mode)
    }

    #[inline(always)]
    fn prepared(prepared: &Prepared) -> &Self {
        &prepared.full
    }

    #[inline(always)]
    fn view(&self, wo: Vec3A, _: Side) -> View<'_, true> {
        self.view(wo)
    }
}

impl Brdf for ClearBsdf {
    type View<'a> = ClearView<'a>;

    #[inline(always)]
    fn new(surface: &Principled, mode: Mode) -> Self {
        Self::new(surface, mode)
    }

    #[inline(always)]
    fn prepared(prepared: &Prepared) -> &Self {
        &prepared.clear
    }

    #[inline(always)]
    fn view(&self, wo: Vec3A, side: Side) -> ClearView<'_> {
        self.view(wo, side)
    }
}

impl BrdfView for ClearView<'_> {
    #[inline(always)]
    fn is_black(&self) -> bool {
        self.is_black()
    }

    #[inline(always)]
    fn eval(&self, wi: Vec3A) -> BsdfEval {
        self.eval(wi)
    }

    #[inline(always)]
    fn sample(&self, u_lobe: f32, u: [f32; 2]) -> Option<BsdfSample> {
        self.sample(u_lobe, u)
    }
}

impl<const FULL: bool> BrdfView for View<'_, FULL> {
    #[inline(always)]
    fn is_black(&self) -> bool {
        self.is_black()
    }

    #[inline(always)]
    fn eval(&self, wi: Vec3A) -> BsdfEval {
        self.eval(wi)
    }

    #[inline(always)]
    fn sample(&self, u_lobe: f32, u: [f32; 2]) -> Option<BsdfSample> {
        self.sample(u_lobe, u)
    }
}

/// Calls `$function::<F>($arguments...)` with the smallest compiled set that covers `$set`; `$full` asks for [`Features::FULL`]
/// besides. Ten sets exist: {plain, textured} x {mapped, flat environment} x {basic, full}, and {plain, textured} with clear
/// surfaces.
macro_rules! with_features {
    ($set:expr, $full:expr, $function:ident($($argument:expr),* $(,)?)) => {{
        use $crate::features::{Clear, Compiled};
        let set: $crate::features::FeatureSet = $set;
        match (set.textures, set.flat_environment, set.full() || $full) {
            (false, ..) if set.clear => $function::<Clear<false>>($($argument),*),
            (true, ..) if set.clear => $function::<Clear<true>>($($argument),*),
            (false, false, false) => $function::<Compiled<false, false, false>>($($argument),*),
            (false, false, true) => $function::<Compiled<false, false, true>>($($argument),*),
            (false, true, false) => $function::<Compiled<false, true, false>>($($argument),*),
            (false, true, true) => $function::<Compiled<false, true, true>>($($argument),*),
            (true, false, false) => $function::<Compiled<true, false, false>>($($argument),*),
            (true, false, true) => $function::<Compiled<true, false, true>>($($argument),*),
            (true, true, false) => $function::<Compiled<true, true, false>>($($argument),*),
            (true, true, true) => $function::<Compiled<true, true, true>>($($argument),*),
        }
    }};
}
pub(crate) use with_features;
