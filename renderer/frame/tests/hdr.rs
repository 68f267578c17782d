//! Environment maps against the `image` crate's decoder, and damaged files.

mod common;

use renderflow_frame::image::Rgb;
use renderflow_frame::{Error, hdr};
use std::path::Path;

fn decode(bytes: &[u8]) -> Result<hdr::LoadedMap, Error> {
    hdr::decode(Path::new("sky.hdr"), bytes)
}

fn by_image_crate(bytes: &[u8]) -> Rgb {
    let decoded = image::load_from_memory_with_format(bytes, image::ImageFormat::Hdr).unwrap().into_rgb32f();
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    Rgb { width, height, pixels: decoded.pixels().map(|p| p.0).collect() }
}

/// A map with a wide range of exponents, runs, and literals; `width` decides whether rows carry run lengths.
fn test_map(width: usize, height: usize) -> Rgb {
    Rgb::from_fn(width, height, |x, y| {
        let sun = if (x, y) == (width / 2, 1) { 7e4 } else { 1.0 };
        let scale = 2f32.powi((x % 61) as i32 - 30);
        if x % 7 < 4 { [0.25, 0.5, 0.125] } else { [sun, scale * (0.3 + y as f32), 1e-3 * x as f32] }
    })
}

#[test]
fn real_maps_decode_to_the_bits_of_the_image_crate() {
    let Some(folder) = common::asset("hdri") else { return };
    let maps: Vec<_> = common::files(&folder).into_iter().filter(|p| p.extension().is_some_and(|e| e == "hdr")).collect();
    assert!(!maps.is_empty());
    // Two are enough to cover run lengths; all of them would take seconds.
    for path in maps.iter().take(2) {
        let loaded = hdr::read(path).unwrap();
        assert_eq!(loaded.repaired, 0);
        assert_eq!(loaded.map, by_image_crate(&std::fs::read(path).unwrap()), "{}", path.display());
    }
}

#[test]
fn encoded_maps_are_read_by_the_image_crate_and_encode_to_the_same_bytes_again() {
    for (width, height) in [(1, 1), (7, 5), (8, 4), (300, 9), (1024, 3)] {
        let map = test_map(width, height);
        let bytes = hdr::encode(&map);
        let decoded = decode(&bytes).unwrap().map;
        assert_eq!(decoded, by_image_crate(&bytes));
        assert_eq!(hdr::encode(&decoded), bytes, "{width} x {height}");
        for (original, quantised) in map.pixels.iter().zip(&decoded.pixels) {
            let largest = original.iter().fold(0f32, |a, &b| a.max(b));
            for (a, b) in original.iter().zip(quantised) {
                // Half a step of an 8-bit mantissa that is at least 128 for the largest component.
                assert!((a - b).abs() <= largest / 256.0, "{original:?} became {quantised:?}");
            }
        }
    }
}

#[test]
fn extreme_values_stay_finite_and_survive_a_second_round() {
    let values = [f32::MAX, 1.7e38, 1e30, f32::MIN_POSITIVE, 1e-38, 1e-40, 1e-45, 0.0, -1.0, f32::NAN, f32::INFINITY];
    let map = Rgb::from_fn(values.len(), 1, |x, _| [values[x], 0.5 * values[x], 0.0]);
    let bytes = hdr::encode(&map);
    let decoded = decode(&bytes).unwrap().map;
    assert!(decoded.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0));
    assert_eq!(hdr::encode(&decoded), bytes);
    // 1.7e38 is within half a step of the largest value of the format, 255 * 2^119.
    assert!((decoded.pixels[1][0] / 1.7e38 - 1.0).abs() < 1.0 / 256.0);
    // 0.999 = 255.74 / 256 rounds to 256, which is a mantissa of 128 one exponent up.
    let almost = Rgb::filled(1, 1, [0.999, 0.25, 0.0]);
    assert_eq!(decode(&hdr::encode(&almost)).unwrap().map.pixels, [[1.0, 0.25, 0.0]]);
    assert_eq!(decoded.pixels[8], [0.0; 3]);
    assert_eq!(decoded.pixels[9], [0.0; 3]);
}

/// Texel bytes written out by hand in all eight orders must give one picture.
#[test]
fn all_orientations_give_the_same_picture() {
    let (width, height) = (3usize, 2usize);
    let texel = |x: usize, y: usize| [(128 + x) as u8, (128 + 16 * y) as u8, 0, 129];
    let expected = Rgb::from_fn(width, height, |x, y| [2.0 * (128 + x) as f32 / 256.0, 2.0 * (128 + 16 * y) as f32 / 256.0, 0.0]);
    for transposed in [false, true] {
        for (flip_x, flip_y) in [(false, false), (true, false), (false, true), (true, true)] {
            let x_axis = format!("{}X {width}", if flip_x { '-' } else { '+' });
            let y_axis = format!("{}Y {height}", if flip_y { '+' } else { '-' });
            let size = if transposed { format!("{x_axis} {y_axis}") } else { format!("{y_axis} {x_axis}") };
            let mut bytes = format!("#?RGBE\nFORMAT=32-bit_rle_rgbe\n\n{size}\n").into_bytes();
            let at = |x: usize, y: usize| texel(if flip_x { width - 1 - x } else { x }, if flip_y { height - 1 - y } else { y });
            let order: Vec<(usize, usize)> = if transposed {
                (0..width).flat_map(|x| (0..height).map(move |y| (x, y))).collect()
            } else {
                (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).collect()
            };
            order.iter().for_each(|&(x, y)| bytes.extend(at(x, y)));
            assert_eq!(decode(&bytes).unwrap().map, expected, "{size}");
        }
    }
}

#[test]
fn old_run_lengths_are_read() {
    let mut bytes = b"#?RADIANCE\n\n-Y 1 +X 600\n".to_vec();
    bytes.extend([200, 100, 50, 129]);
    // 87 + 2 * 256 = 599 repetitions.
    bytes.extend([1, 1, 1, 87, 1, 1, 1, 2]);
    let map = decode(&bytes).unwrap().map;
    assert_eq!(map, by_image_crate(&bytes));
    assert_eq!(map.pixels[599], [200.0 / 128.0, 100.0 / 128.0, 50.0 / 128.0]);
}

#[test]
fn every_truncation_is_an_error_that_names_the_file() {
    for width in [5, 40] {
        let bytes = hdr::encode(&test_map(width, 6));
        for length in 0..bytes.len() {
            let error = decode(&bytes[..length]).expect_err("a truncated file was accepted").to_string();
            assert!(error.starts_with("sky.hdr: "), "{error}");
        }
        assert!(decode(&bytes[..bytes.len() - 1]).unwrap_err().to_string().contains("row 6 of 6: the file ends here"));
    }
}

#[test]
fn malformed_headers_and_rows_are_errors_that_say_what_is_wrong() {
    let row_of_8 = b"#?RADIANCE\n\n-Y 1 +X 8\n\x02\x02\x00\x08";
    let with = |tail: &[u8]| [row_of_8, tail].concat();
    let cases: &[(&[u8], &str)] = &[
        (b"", "the file is empty"),
        (b"P6\n1 1\n255\nabc", "neither Radiance .hdr nor OpenEXR"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n", "the header has no end"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\nabcd", "only 32-bit_rle_rgbe is supported"),
        (b"#?RADIANCE\n\n-Y 1 -Y 1\nabcd", "size line"),
        (b"#?RADIANCE\n\n-Y 1 +X one\nabcd", "size line"),
        (b"#?RADIANCE\n\n-Y 0 +X 5\nabcd", "5 x 0 is outside"),
        (b"#?RADIANCE\n\n-Y 65536 +X 65536\nabcd", "65536 x 65536 is outside"),
        (b"#?RADIANCE\n\n-Y 16384 +X 16384\nabcd", "16384 x 16384 is outside 1..=65536 a side and 134217728 texels in all"),
        (b"#?RADIANCE\n\n-Y 99999999999999999999 +X 1\nabcd", "size line"),
        (b"#?RADIANCE\n\n-Y 1 +X 9\n\x02\x02\x00\x08", "it says it is 8 texels long, the header says 9"),
        (b"#?RADIANCE\n\n-Y 1 +X 4\n\x01\x01\x01\x03", "it begins with a repetition"),
        (b"#?RADIANCE\n\n-Y 1 +X 4\n\x09\x09\x09\x80\x01\x01\x01\xff", "a repetition leaves the row"),
        (&with(&[200, 7]), "a run has no length or leaves the row"),
        (&with(&[0]), "a run has no length or leaves the row"),
        (&with(&[9, 1, 2]), "a run has no length or leaves the row"),
        (&with(&[136, 7, 136, 7, 136, 7]), "the file ends here"),
    ];
    for (bytes, expected) in cases {
        let error = decode(bytes).unwrap_err().to_string();
        assert!(error.contains(expected), "{error:?} does not say {expected:?}");
    }
    let missing = hdr::read(Path::new("no/such/sky.hdr")).unwrap_err().to_string();
    assert!(missing.starts_with("no/such/sky.hdr: cannot read: "), "{missing}");
}

/// 50 kilobytes of repetitions that would become 3 gigabytes of floats.
#[test]
fn repetitions_do_not_fill_the_memory() {
    let mut bytes = b"#?RADIANCE\n\n-Y 2048 +X 65536\n".to_vec();
    for _ in 0..2048 {
        // 1 + 255 + 255 * 256 texels.
        bytes.extend([200, 100, 50, 129, 1, 1, 1, 255, 1, 1, 1, 255]);
    }
    let error = decode(&bytes).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("65536 x 2048 texels in a file of 24"), "{error}");
}

#[test]
fn openexr_maps_keep_half_and_float_and_count_repairs() {
    let (Some(rings), Some(broken)) =
        (common::asset("exr/TestImages/BrightRings.exr"), common::asset("exr/TestImages/BrightRingsNanInf.exr"))
    else {
        return;
    };
    let rings = hdr::read(&rings).unwrap();
    assert_eq!(rings.repaired, 0);
    assert!(rings.map.pixels.iter().flatten().fold(0f32, |a, &b| a.max(b)) > 1.0);
    let broken = hdr::read(&broken).unwrap();
    assert!(broken.repaired > 0);
    assert!(broken.map.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0));
}

#[test]
fn the_size_is_read_without_the_texels() {
    let size = |bytes: &[u8]| hdr::size(Path::new("sky.hdr"), bytes).map_err(|e| e.to_string());
    assert_eq!(size(&hdr::encode(&test_map(40, 6))), Ok([40, 6]));
    assert_eq!(size(b"#?RADIANCE\n\n+X 7 -Y 3\n"), Ok([7, 3]), "columns are stored as rows");
    assert_eq!(size(b"#?RADIANCE\n\n-Y 8192 +X 16384\n"), Ok([16384, 8192]));
    assert!(size(b"nothing").unwrap_err().starts_with("sky.hdr: neither Radiance"));
}
