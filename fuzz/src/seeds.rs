//! Writes the seeds that are made by the project's own writers: `cargo run --release --features seeds --bin seeds`.

use exr_crate::image::{Encoding, Image as ExrImage, Layer};
use exr_crate::prelude::*;
use glam::{Affine3A, Vec3A};
use image::{DynamicImage, GrayImage, ImageFormat, Luma, RgbImage};
use renderflow_frame::compact::{self, Keep};
use renderflow_frame::image::Rgb;
use renderflow_frame::tracks::Tracks;
use renderflow_frame::transforms::{self, Sequence};
use renderflow_frame::{Camera, Frame, FrameInfo, Image, exr, hdr};
use renderflow_scenes::sky;
use std::io::Cursor;
use std::path::Path;

fn main() -> std::result::Result<(), Box<dyn std::error::Error>> {
    let seeds = Path::new(env!("CARGO_MANIFEST_DIR")).join("seeds");
    let put = |target: &str, name: &str, bytes: &[u8]| -> std::io::Result<()> {
        std::fs::create_dir_all(seeds.join(target))?;
        std::fs::write(seeds.join(target).join(name), bytes)
    };

    let camera = Camera::look_at(Vec3A::new(1.5, 2.0, 3.0), Vec3A::ZERO, Vec3A::Y, 0.8, 4, 3);
    let ramp = |scale: f32| Image::from_fn(4, 3, move |x, y| [scale * x as f32, scale * y as f32, 0.1]);
    let mut frame = Frame {
        width: 4,
        height: 3,
        beauty: Some(ramp(1.0)),
        alpha: Image::filled(4, 3, 1.0),
        albedo: ramp(0.2),
        normal: Image::filled(4, 3, [0.0, 0.0, 1.0]),
        depth: Image::from_fn(4, 3, |x, _| if x > 0 { x as f32 } else { f32::INFINITY }),
        material: ramp(0.25),
        object_id: Image::filled(4, 3, 1),
        material_id: Image::filled(4, 3, 2),
        info: FrameInfo { camera, spp: 4, seed: 7, exposure: 0.5, ..FrameInfo::default() },
        ..Frame::default()
    };
    put("exr", "frame.exr", &exr::encode(Path::new("frame.exr"), &frame)?.0)?;
    frame.raw = frame.beauty.clone();
    frame.variance = frame.beauty.clone();
    frame.irradiance = frame.beauty.clone();
    frame.motion = Some(Image::filled(4, 3, [0.5, -0.5]));
    put("exr", "frame_more_channels.exr", &exr::encode(Path::new("frame.exr"), &frame)?.0)?;
    for (name, keep) in [("training", Keep::Training), ("all", Keep::All)] {
        let (file, _) = compact::encode_with(Path::new("frame.rff"), &frame, keep)?;
        put("rff", &format!("{name}.rff"), &file)?;
        // The form of the target that puts checksums right: length of the header, header as text, blocks.
        let stored = u32::from_le_bytes([file[8], file[9], file[10], file[11]]) as usize;
        let json = zstd::decode_all(&file[16..16 + stored])?;
        let length = (json.len() as u32).to_le_bytes();
        put("rff", &format!("{name}.parts"), &[&length, &json[..], &file[16 + stored..]].concat())?;
    }

    // Pictures in every compression and layout of blocks that the library writes, whole and as half floats.
    let pixel = |at: Vec2<usize>| (at.x() as f32, 0.5 * at.y() as f32, f16::from_f32(0.1 + (at.x() % 3) as f32));
    let compressions = [
        ("plain", Compression::Uncompressed),
        ("rle", Compression::RLE),
        ("zip1", Compression::ZIP1),
        ("zip16", Compression::ZIP16),
        ("piz", Compression::PIZ),
        ("pxr24", Compression::PXR24),
        ("b44", Compression::B44),
        ("b44a", Compression::B44A),
    ];
    for (name, compression) in compressions {
        for (layout, blocks) in [("lines", Blocks::ScanLines), ("tiles", Blocks::Tiles(Vec2(4, 3)))] {
            let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
            let layer = Layer::new((9, 7), LayerAttributes::default(), encoding, SpecificChannels::rgb(pixel));
            let mut bytes = Cursor::new(vec![]);
            ExrImage::from_layer(layer).write().to_buffered(&mut bytes)?;
            put("exr", &format!("{name}_{layout}.exr"), bytes.get_ref())?;
        }
    }

    let sky =
        |width, height| Rgb::from_fn(width, height, |x, y| [(x * y % 7) as f32, 0.25 * (y / 2) as f32, 1e3 / (1 + x) as f32]);
    let wide = hdr::encode(&sky(16, 8));
    put("hdr", "run_lengths.hdr", &wide)?;
    put("hdr", "too_narrow_for_run_lengths.hdr", &hdr::encode(&sky(4, 2)))?;
    let plain = hdr::encode(&sky(4, 2));
    let texels = &plain[plain.len() - 4 * 4 * 2..];
    put("hdr", "other_orientation.hdr", &[b"#?RADIANCE\n\n+X 2 -Y 4\n", texels].concat())?;
    // Rows of the format's first version: (1, 1, 1, n) repeats.
    put("hdr", "repetitions.hdr", b"#?RGBE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2\n\n-Y 2 +X 300\n\x40\x50\x60\x80\x01\x01\x01\x2b\x01\x01\x01\x01\x80\x90\xa0\x82\x01\x01\x01\x2b\x01\x01\x01\x01")?;

    let track = |shift: f32| vec![Affine3A::IDENTITY, Affine3A::from_translation(glam::Vec3::X * shift)];
    let sequence = Sequence {
        cameras: vec![camera; 2],
        files: vec!["0000.exr".into(), "0001.exr".into()],
        keyframes: vec![0],
        exposure: 0.5,
        environment: "environment.hdr".into(),
        environment_rotation: 0.25,
        environment_intensity: 1.0,
        tracks: Tracks { objects: [(1, track(0.5))].into() },
    };
    std::fs::create_dir_all(seeds.join("transforms"))?;
    transforms::write(&seeds.join("transforms/moving.json"), &sequence)?;
    let own_size = Camera { width: 8, ..camera };
    let different = Sequence { cameras: vec![camera, own_size], tracks: Tracks::default(), ..sequence };
    transforms::write(&seeds.join("transforms/intrinsics_of_each_frame.json"), &different)?;

    let color = RgbImage::from_fn(9, 5, |x, y| image::Rgb([x as u8 * 25, y as u8 * 50, 128]));
    let grey = GrayImage::from_fn(8, 8, |x, y| Luma([(x * y * 4) as u8]));
    let color = DynamicImage::from(color);
    for (name, picture) in [
        ("rgb8.png", color.clone()),
        ("rgba8.png", color.to_rgba8().into()),
        ("rgb16.png", color.to_rgb16().into()),
        ("grey8.png", grey.clone().into()),
        ("grey16_alpha.png", color.to_luma_alpha16().into()),
    ] {
        let mut bytes = Cursor::new(vec![]);
        picture.write_to(&mut bytes, ImageFormat::Png)?;
        put("texture", name, bytes.get_ref())?;
    }
    for (name, picture) in [("rgb.jpg", color), ("grey.jpg", grey.into())] {
        let mut bytes = Cursor::new(vec![]);
        picture.write_to(&mut bytes, ImageFormat::Jpeg)?;
        put("texture", name, bytes.get_ref())?;
    }

    // One scene for each family of skies.
    for (_, sky) in sky::library() {
        let scene = serde_json::json!({
            "version": 1, "name": "sky", "resolution": [4, 4],
            "camera": { "type": "poses", "poses": [{ "eye": [0, 0, 3], "target": [0, 0, 0] }], "vertical_fov": 40 },
            "environment": { "source": { "sky": sky } },
            "objects": []
        });
        put("scene", &format!("sky_{}.json", sky.family()), scene.to_string().as_bytes())?;
    }

    #[cfg(feature = "all")]
    for (name, precision) in
        [("half", renderflow_model::weights::Precision::F16), ("single", renderflow_model::weights::Precision::F32)]
    {
        use renderflow_model::fusion::{Fusion, FusionConfig};
        let fusion = Fusion::untrained(&FusionConfig { widths: [16; 4], ..FusionConfig::default() }, 1)?;
        put("weights", &format!("{name}.safetensors"), &fusion.encode(precision)?)?;
    }
    Ok(())
}
