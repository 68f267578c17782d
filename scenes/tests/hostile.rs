//! Small files that ask for much: refused with a reason, before the memory or the time is spent.

mod common;

use common::{empty_scene, grey};
use renderflow_scenes::description::Scene;
use renderflow_scenes::load;
use std::io::Cursor;

/// What loading `bytes` as a texture says.
fn texture_error(bytes: &[u8]) -> String {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("t.jpg"), bytes).unwrap();
    let mut material = grey("m");
    material.base_color_texture = Some("t.jpg".into());
    let scene = Scene { materials: vec![material], ..empty_scene() };
    load::load(&scene, folder.path()).expect_err("the texture was accepted").to_string()
}

/// A JPEG of 8 x 8 grey texels whose header says otherwise.
fn jpeg_claiming(width: u16, height: u16) -> Vec<u8> {
    let mut bytes = Cursor::new(vec![]);
    image::GrayImage::from_pixel(8, 8, image::Luma([100])).write_to(&mut bytes, image::ImageFormat::Jpeg).unwrap();
    let mut bytes = bytes.into_inner();
    // Start of frame (ITU T.81, B.2.2): marker, length, precision, height, width.
    let frame = bytes.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    bytes[frame + 5..frame + 7].copy_from_slice(&height.to_be_bytes());
    bytes[frame + 7..frame + 9].copy_from_slice(&width.to_be_bytes());
    bytes
}

#[test]
fn a_jpeg_cut_off_behind_a_large_header_is_refused() {
    let error = texture_error(&jpeg_claiming(8192, 8192));
    assert!(error.contains("t.jpg: 8192 x 8192 texels cannot be in"), "{error}");
    let error = texture_error(&jpeg_claiming(16384, 16384));
    assert!(error.contains("t.jpg: 16384 x 16384 is more than 67108864 texels"), "{error}");
}
