//! FLIP: the difference an observer sees when flipping between two pictures (Andersson et al. 2020, "FLIP: A Difference Evaluator
//! for Alternating Images"), for display values (LDR-FLIP).

mod colour;
mod filters;

use colour::{hunt_lab, hyab};
use filters::Filters;
use renderflow_frame::Image;
use renderflow_frame::image::Rgb;

/// Exponent of the colour difference (the paper's q_c).
const COLOUR_EXPONENT: f32 = 0.7;
/// Exponent of the feature difference (q_f).
const FEATURE_EXPONENT: f32 = 0.5;
/// Up to this share of the largest colour difference the scale is linear (p_c) ...
const KNEE: f32 = 0.4;
/// ... and this is its value there (p_t).
const KNEE_VALUE: f32 = 0.95;

/// How many pixels fill one degree of the observer's view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewing {
    /// Pixels per degree, 0.1 to 1000.
    pub pixels_per_degree: f64,
}

impl Viewing {
    /// An observer at `distance` metres from a screen `width` metres and `pixels` pixels wide.
    pub fn screen(distance: f64, width: f64, pixels: f64) -> Self {
        Self { pixels_per_degree: distance * (pixels / width) * std::f64::consts::PI / 180.0 }
    }
}

impl Default for Viewing {
    /// The values of the paper and its program: 0.7 m from a screen 0.7 m and 3840 pixels wide, 67.02 pixels per degree.
    fn default() -> Self {
        Self::screen(0.7, 0.7, 3840.0)
    }
}

/// FLIP of every pixel, and its mean.
#[derive(Clone, Debug, PartialEq)]
pub struct FlipMap {
    /// 0 (no visible difference) to 1.
    pub map: Image<f32>,
    /// Mean over all pixels.
    pub mean: f64,
}

impl FlipMap {
    /// Mean over the pixels with `mask` above 0; `None` when there are none.
    pub fn masked(&self, mask: &Image<f32>) -> Option<f64> {
        super::masked_mean(self.map.pixels.iter().map(|v| f64::from(*v)), mask)
    }
}

/// Everything that FLIP needs of one picture. It is half the work, so keep it for a truth that several pictures are compared
/// with.
#[derive(Clone, Debug)]
pub struct Seen {
    viewing: Viewing,
    width: usize,
    height: usize,
    /// The picture as the eye sees it: CIELAB with Hunt's adjustment.
    colour: Vec<[f32; 3]>,
    /// Lengths of the gradients of luminance at edges and points.
    features: Vec<[f32; 2]>,
}

impl Seen {
    /// `picture` holds display values (sRGB curve applied). Values outside of 0..=1 are clamped, and NaN counts as 0. `None` for
    /// a picture without pixels or a `viewing` out of range.
    pub fn new(picture: &Rgb, viewing: Viewing) -> Option<Self> {
        let (width, height) = (picture.width, picture.height);
        // Outside, kernels are single pixels, or wider than any picture.
        let usable = (0.1..=1000.0).contains(&viewing.pixels_per_degree);
        if picture.pixels.is_empty() || picture.pixels.len() != width * height || !usable {
            return None;
        }
        let filters = Filters::new(viewing.pixels_per_degree);
        let opponent = colour::opponent(picture);
        let features = filters.features(&opponent[0], width);
        let colour = hunt_lab(&filters.spatial(opponent, width));
        Some(Self { viewing, width, height, colour, features })
    }

    /// FLIP between `self` and `other` (the order makes no difference). `None` when size or viewing differ.
    pub fn compare(&self, other: &Self) -> Option<FlipMap> {
        if (self.width, self.height, self.viewing) != (other.width, other.height, other.viewing) {
            return None;
        }
        let largest = colour::largest_difference().powf(COLOUR_EXPONENT);
        let pictures = self.colour.iter().zip(&other.colour).zip(self.features.iter().zip(&other.features));
        let pixels: Vec<f32> = pictures
            .map(|((a, b), (fa, fb))| {
                let colour = spread(hyab(*a, *b).powf(COLOUR_EXPONENT), largest);
                let feature = (fa[0] - fb[0]).abs().max((fa[1] - fb[1]).abs());
                let feature = (feature * std::f32::consts::FRAC_1_SQRT_2).powf(FEATURE_EXPONENT).min(1.0);
                colour.powf(1.0 - feature)
            })
            .collect();
        let mean = pixels.iter().map(|v| f64::from(*v)).sum::<f64>() / pixels.len() as f64;
        Some(FlipMap { map: Image { width: self.width, height: self.height, pixels }, mean })
    }
}

/// Maps a colour difference to 0..=1. Small differences get most of the range, since large ones look alike.
fn spread(difference: f32, largest: f32) -> f32 {
    let knee = KNEE * largest;
    if difference < knee {
        KNEE_VALUE / knee * difference
    } else {
        (KNEE_VALUE + (difference - knee) / (largest - knee) * (1.0 - KNEE_VALUE)).min(1.0)
    }
}
