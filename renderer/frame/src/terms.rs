//! Light of a deferred picture, separated by where it came from. The renderer computes the terms and the networks read them.

use crate::image::{Image, Rgb};

/// The terms of a deferred picture: scene-linear radiance, 0 where nothing is covered, and not multiplied by coverage. With
/// `alpha` and the background of the frame they add up to the picture: `alpha * (sum of direct + ambient_diffuse +
/// ambient_specular + reflections + indirect) + (1 - alpha) * background`.
#[derive(Clone, Debug, Default)]
pub struct ShadingTerms {
    /// Light that each dominant light of the environment sends to the camera, with shadows; the strongest light first. If the
    /// scene has lights of its own, all of theirs follows as one.
    pub direct: Vec<Rgb>,
    /// Share of each light that a pixel sees, 0..=1; empty where shadows are off.
    pub visibility: Vec<Image<f32>>,
    /// Share of the sky's diffuse light, 0..=1, that no shadow map of the sky blocks; `None` without such maps.
    pub sky: Option<Image<f32>>,
    /// Share of the cosine-weighted hemisphere, 0..=1, that nothing near covers; `None` where occlusion is off.
    pub occlusion: Option<Image<f32>>,
    /// Light of the environment without the dominant lights, reflected by the diffuse base.
    pub ambient_diffuse: Rgb,
    /// The same light, and the dominant lights in the mirrors of smooth surfaces, reflected by the GGX lobe; without what
    /// `reflections` replaces, and with the environment that is seen through clear surfaces.
    pub ambient_specular: Rgb,
    /// What the GGX lobe reflects of the picture itself; `None` where reflections are off.
    pub reflections: Option<Rgb>,
    /// Light that bounced once off what the picture shows; `None` where indirect light is off.
    pub indirect: Option<Rgb>,
    /// Irradiance over pi of the environment without the dominant lights, with nothing in its way.
    pub irradiance: Rgb,
}
