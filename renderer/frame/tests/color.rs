//! Colour curves against scikit-image 0.26 and closed forms.

use renderflow_frame::color::{display, linear_to_srgb, luminance, reinhard, srgb_to_linear};

/// `skimage.color.rgb2xyz([[[s, s, s]]])[..., 1]` for each s.
const SRGB_AND_LINEAR: [(f32, f32); 9] = [
    (0.0, 0.0),
    (0.02, 0.001_547_987_6),
    (0.0405, 0.003_134_744_8),
    (0.1, 0.010_022_826),
    (0.25, 0.050_876_09),
    (0.5, 0.214_041_14),
    (0.735, 0.499_458_16),
    (0.9, 0.787_412_3),
    (1.0, 1.0),
];

#[test]
fn srgb_is_that_of_scikit_image_both_ways() {
    for (srgb, linear) in SRGB_AND_LINEAR {
        assert!((srgb_to_linear(srgb) - linear).abs() < 1e-6, "{srgb}");
        assert!((linear_to_srgb(linear) - srgb).abs() < 1e-6, "{linear}");
    }
}

#[test]
fn display_exposes_then_clamps_then_encodes() {
    let shown = display([0.107_020_57, -3.0, f32::INFINITY], 2.0);
    assert!((shown[0] - 0.5).abs() < 1e-6);
    assert_eq!(shown[1], 0.0);
    assert!((shown[2] - 1.0).abs() < 1e-6);
}

#[test]
fn reinhard_maps_white_to_one_and_luminance_weighs_to_one() {
    for white in [1.0, 4.0, 16.0] {
        assert!((reinhard(white, white) - 1.0).abs() < 1e-6);
    }
    // Without a white point the curve is v / (1 + v).
    assert!((reinhard(3.0, 1e9) - 0.75).abs() < 1e-6);
    assert!((luminance([1.0; 3]) - 1.0).abs() < 1e-6);
    assert!((luminance([0.0, 1.0, 0.0]) - 0.715_16).abs() < 1e-4);
}
