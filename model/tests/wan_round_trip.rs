//! What an autoencoder loses, measured by the program and counted here.

mod common;

use burn::tensor::{Device, Tensor, TensorData};
use common::clip;
use renderflow_frame::image::Rgb;
use renderflow_model::Clip;
use renderflow_model::parameters::to_vec;
use renderflow_model::wan::pictures::{BridgeStart, Kind};
use renderflow_model::wan::train::{Measured, clip_pictures::ClipPictures, round_trip};
use renderflow_model::wan::{Vae, VaeConfig};

const SIZE: usize = 64;

/// An autoencoder that has learnt nothing: what it loses does not matter.
fn autoencoder() -> Vae {
    Vae::new(&VaeConfig::tiny(), 5, &Device::flex()).expect("autoencoder")
}

/// The albedo of one clip of five frames, counted here.
#[test]
fn round_trips_are_counted_by_frame() {
    let (vae, clips) = (autoencoder(), vec![clip(5, SIZE)]);
    let all = |frames| round_trip(&vae, &clips, frames, usize::MAX, &mut |_| Ok(()));
    let found = all(5).expect("five frames");
    assert_eq!(found.iter().map(|row| row.of).collect::<Vec<_>>(), Kind::ALL.map(Measured::Kind));
    let all_pictures = ClipPictures::new(&clips[0], None, 8, 8).expect("pictures");
    let pictures = all_pictures.clip(0, 5, Kind::Albedo, all_pictures.whole());
    let tensor = Tensor::<5>::from_data(TensorData::new(pictures.clone(), [1, 3, 5, SIZE, SIZE]), &Device::flex());
    let back = to_vec(vae.decode_normalised(vae.encode_normalised(tensor).expect("latents")).expect("pictures"));
    for frame in 0..5 {
        let mut square = 0.0f64;
        for i in (0..pictures.len()).filter(|i| i / (SIZE * SIZE) % 5 == frame) {
            square += f64::from((pictures[i] - back[i]) / 2.0).powi(2) / (3 * SIZE * SIZE) as f64;
        }
        let expected = -10.0 * square.log10() as f32;
        let psnr = found[Kind::Albedo as usize].psnr[frame];
        assert!((psnr - expected).abs() < 1e-3, "frame {frame}: {psnr} instead of {expected} dB");
    }
    let stills = all(1).expect("stills");
    assert_eq!(stills[0].psnr.len(), 1);
    assert!(all(9).is_err());
    let mut done = Vec::new();
    let mut told = |n| {
        done.push(n);
        Ok(())
    };
    let first = round_trip(&vae, &clips, 1, 1, &mut told).expect("first frames");
    assert!(first != stills && first[Kind::Albedo as usize].psnr[0].is_finite());
    assert_eq!(done, (1..=clips.len()).collect::<Vec<_>>());
}

/// Where deferred shading is the truth, nothing is lost. Otherwise the loss is the one that is counted here.
#[test]
fn what_is_coded_as_a_change_is_measured() {
    let (vae, clip) = (autoencoder(), clip(5, SIZE));
    let measured = |shaded: Vec<Rgb>| {
        let clips = vec![Clip { shaded, ..clip.clone() }];
        let found = round_trip(&vae, &clips, 1, 1, &mut |_| Ok(())).expect("the first frame");
        assert_eq!(found.iter().map(|row| row.of).skip(6).collect::<Vec<_>>(), [Measured::Change, Measured::Deferred]);
        [6, 7].map(|row: usize| found[row].psnr[0])
    };
    let truth: Vec<Rgb> = clip.frames.iter().map(|frame| frame.beauty.clone().expect("truth")).collect();
    let dark: Vec<Rgb> = truth.iter().map(|truth| truth.map(|p| p.map(|v| 0.25 * v))).collect();
    let [change, deferred] = measured(truth);
    assert!(change > 90.0 && deferred > 90.0, "{change} and {deferred} dB");
    let [change, deferred] = measured(dark.clone());
    let clip = Clip { shaded: dark, ..clip };
    let coded = |kind: Kind| {
        let all = ClipPictures::starting(BridgeStart::Deferred, &clip, None, 8, 8).expect("pictures");
        let pictures = all.clip(0, 1, kind, all.whole());
        let tensor = Tensor::<5>::from_data(TensorData::new(pictures.clone(), [1, 3, 1, SIZE, SIZE]), &Device::flex());
        (pictures, to_vec(vae.decode_normalised(vae.encode_normalised(tensor).expect("latents")).expect("pictures")))
    };
    let ((truth, back), (start, lost)) = (coded(Kind::Target), coded(Kind::Albedo));
    let expected = |value: &dyn Fn(usize) -> f32| {
        let squares = (0..truth.len()).map(|i| f64::from((truth[i] - value(i)) / 2.0).powi(2));
        -10.0 * (squares.sum::<f64>() / truth.len() as f64).log10() as f32
    };
    let expected = [expected(&|i| (start[i] + back[i] - lost[i]).clamp(-1.0, 1.0)), expected(&|i| start[i])];
    for (found, expected) in [change, deferred].into_iter().zip(expected) {
        assert!((found - expected).abs() < 1e-3, "{found} instead of {expected} dB");
    }
}
