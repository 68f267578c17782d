//! The denoiser against pictures denoised by OIDN's own program, and on pictures that would upset it.

use renderflow_frame::image::Rgb;
use renderflow_renderer::denoise::{DenoiseError, Denoiser, MAX_RADIANCE, Options, Quality, VARIABLE};
use std::path::{Path, PathBuf};

fn fixtures() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/assets/oidn");
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: no fixtures in {}", folder.display());
    None
}

/// A denoiser, where the library is found. If the variable names it, it must be there.
fn denoiser() -> Option<Denoiser> {
    let opened = Denoiser::new();
    assert!(opened.is_ok() || std::env::var_os(VARIABLE).is_none(), "{:?}", opened.err());
    opened.map_err(|error| println!("skipped: {error}")).ok()
}

/// A little-endian colour PFM, turned so that the first row is at the top.
fn read_pfm(path: &Path) -> Rgb {
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut fields = bytes.splitn(4, |byte| *byte == b'\n' || *byte == b' ');
    let mut field = || std::str::from_utf8(fields.next().unwrap_or_default()).unwrap_or_default().to_owned();
    assert_eq!(field(), "PF");
    let (width, height): (usize, usize) = (field().parse().expect("width"), field().parse().expect("height"));
    let rest = fields.next().unwrap_or_default();
    let start = bytes.len() - rest.len() + rest.iter().position(|byte| *byte == b'\n').expect("scale line") + 1;
    let values: Vec<f32> = bytes[start..].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    assert_eq!(values.len(), width * height * 3);
    let rows: Vec<&[f32]> = values.chunks_exact(3 * width).collect();
    let pixels = rows.iter().rev().flat_map(|row| row.as_chunks::<3>().0.iter().copied()).collect();
    Rgb { width, height, pixels }
}

fn relative_rmse(a: &Rgb, b: &Rgb) -> f64 {
    let (mut error, mut energy) = (0.0, 0.0);
    for (a, b) in a.pixels.iter().flatten().zip(b.pixels.iter().flatten()) {
        error += f64::from(a - b).powi(2);
        energy += f64::from(*b).powi(2);
    }
    (error / energy).sqrt()
}

#[test]
fn results_are_those_of_the_library() {
    let (Some(folder), Some(_)) = (fixtures(), denoiser()) else { return };
    let [color, albedo, normal, clean] =
        ["color", "albedo", "normal", "clean"].map(|name| read_pfm(&folder.join(format!("{name}.pfm"))));
    let noisy = relative_rmse(&color, &clean);
    for (name, quality, clean_guides) in [
        ("denoised_high_aux", Quality::High, false),
        ("denoised_high_cleanaux", Quality::High, true),
        ("denoised_fast_cleanaux", Quality::Fast, true),
    ] {
        let expected = read_pfm(&folder.join(format!("{name}.pfm")));
        let mut denoiser = Denoiser::with_options(Options { quality, clean_guides }).unwrap_or_else(|error| panic!("{error}"));
        let denoised = denoiser.denoise(&color, Some(&albedo), Some(&normal)).unwrap_or_else(|error| panic!("{error}"));
        // Other instruction sets round differently; other settings differ by 1e-2.
        let difference = relative_rmse(&denoised, &expected);
        let error = relative_rmse(&denoised, &clean);
        println!("{name}: {difference:.1e} from the reference; error {noisy:.3} before, {error:.3} after");
        assert!(difference < 2e-3, "{name}: {difference}");
        assert!(error < 0.6 * noisy, "{name}: {error}");
        // The filter is kept: a second picture gives the same bits.
        assert_eq!(denoiser.denoise(&color, Some(&albedo), Some(&normal)).ok(), Some(denoised));
        assert_eq!(denoiser.clamped(), 0);
    }
}

/// A grey card with a little deterministic noise.
fn card(width: usize, height: usize) -> Rgb {
    Rgb::from_fn(width, height, |x, y| {
        let noise = ((x * 7919 + y * 104_729) % 97) as f32 / 97.0 - 0.5;
        [0.5 + 0.3 * noise, 0.4, 0.3 - 0.2 * noise]
    })
}

#[test]
fn one_hot_pixel_stays_where_it_is() {
    let Some(mut denoiser) = denoiser() else { return };
    let calm = denoiser.denoise(&card(96, 64), None, None).unwrap_or_else(|error| panic!("{error}"));
    for value in [f32::INFINITY, 1e30, f32::NAN, f32::NEG_INFINITY, -1.0] {
        let mut picture = card(96, 64);
        picture.pixels[20 * 96 + 30] = [value; 3];
        let before = denoiser.clamped();
        let denoised = denoiser.denoise(&picture, None, None).unwrap_or_else(|error| panic!("{error}"));
        assert!(denoised.pixels.iter().flatten().all(|v| v.is_finite() && *v >= 0.0 && *v < 2.0 * MAX_RADIANCE));
        assert_eq!(denoiser.clamped() - before, if value > MAX_RADIANCE { 3 } else { 0 });
        // Its surroundings change; the rest of the picture keeps its values.
        for (i, (a, b)) in denoised.pixels.iter().zip(&calm.pixels).enumerate() {
            let distance = (i % 96).abs_diff(30).max((i / 96).abs_diff(20));
            let disturbed = a.iter().zip(b).any(|(a, b)| (a - b).abs() > 0.1 * b);
            assert!(!disturbed || distance <= 16, "{value} changes a pixel {distance} away from {b:?} to {a:?}");
        }
    }
}

#[test]
fn guides_and_sizes_may_change_between_pictures() {
    let Some(mut denoiser) = denoiser() else { return };
    let mut run = |width, height, guides: usize| {
        let albedo = Rgb::filled(width, height, [0.5; 3]);
        let normal = Rgb::filled(width, height, [0.0, 0.0, 1.0]);
        denoiser.denoise(&card(width, height), (guides > 0).then_some(&albedo), (guides > 1).then_some(&normal))
    };
    let first = run(64, 48, 2).unwrap_or_else(|error| panic!("{error}"));
    for (width, height, guides) in [(33, 17, 1), (1, 1, 2), (64, 48, 0), (0, 0, 0)] {
        let denoised = run(width, height, guides).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!((denoised.width, denoised.height, denoised.pixels.len()), (width, height, width * height));
    }
    assert_eq!(run(64, 48, 2).ok(), Some(first));
}

/// Device, filter and buffers stay from frame to frame of a sequence; nothing of a frame stays in them.
#[test]
fn a_kept_denoiser_gives_what_a_new_one_does() {
    let guides = [Rgb::filled(80, 60, [0.5; 3]), Rgb::filled(80, 60, [0.0, 0.0, 1.0])];
    let Some(mut kept) = denoiser() else { return };
    for frame in 1..4u8 {
        let picture = card(80, 60).map(|pixel| pixel.map(|v| v * f32::from(frame) + 0.01 * f32::from(frame)));
        let run = |denoiser: &mut Denoiser| denoiser.denoise(&picture, Some(&guides[0]), Some(&guides[1]));
        let (ours, fresh) = (run(&mut kept), run(&mut Denoiser::new().unwrap_or_else(|error| panic!("{error}"))));
        assert!(ours.is_ok() && ours.ok() == fresh.ok(), "frame {frame}");
    }
}

#[test]
fn unusable_guides_are_errors() {
    let Some(mut denoiser) = denoiser() else { return };
    let (picture, small) = (card(16, 16), card(16, 15));
    assert!(matches!(denoiser.denoise(&picture, Some(&small), None), Err(DenoiseError::GuideSize { guide: "albedo", .. })));
    assert!(matches!(denoiser.denoise(&picture, None, Some(&picture)), Err(DenoiseError::NormalAlone)));
}

/// A flag set from outside ends the work between the layers of the network; the denoiser serves the next picture as if nothing
/// had been.
#[test]
fn it_can_be_stopped_and_goes_on_with_the_next_picture() {
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::Duration;
    let picture = |size: usize| Rgb::from_fn(size, size, |x, y| [((x * y) % 7) as f32, 0.5, ((x + y) % 3) as f32]);
    let Some(mut denoiser) = denoiser() else { return };
    let (small, large) = (picture(64), picture(2400));
    let expected = denoiser.denoise(&small, None, None).unwrap_or_else(|error| panic!("{error}"));
    let stopped = AtomicBool::new(true);
    assert!(matches!(denoiser.denoise_until(&small, None, None, &stopped), Err(DenoiseError::Cancelled)));
    let cancel = AtomicBool::new(false);
    let result = std::thread::scope(|scope| {
        scope.spawn(|| {
            std::thread::sleep(Duration::from_millis(200));
            cancel.store(true, Ordering::Relaxed);
        });
        denoiser.denoise_until(&large, None, None, &cancel)
    });
    // Faster machines than there are may be done before.
    assert!(matches!(result, Ok(_) | Err(DenoiseError::Cancelled)));
    println!("stopped: {}", result.is_err());
    let again = denoiser.denoise(&small, None, None).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(again, expected);
}
