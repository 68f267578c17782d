//! Sequences through the paper's graph: clips as the paper makes them, the same bits however they arrive, one clip's memory.

mod common;

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use common::clip;
use common::sequence::{Bounded, Memory, SIDE};
use renderflow_frame::{DepthBounds, Light};
use renderflow_model::device::NetworkDevice;
use renderflow_model::parameters::{self, to_vec};
use renderflow_model::renderer::{Options, Rendered, Renderer, Session, State, View};
use renderflow_model::wan::flow::{Conditions, Intrinsic, InverseConfig, KeyframeConfig, KeyframeLatent};
use renderflow_model::wan::names::Naming;
use renderflow_model::wan::pictures::{Kind, Pictures, radiance};
use renderflow_model::wan::video::{AUTOENCODER_FILE, ClipSession, WanRenderer};
use renderflow_model::wan::weights::{Header, Network, Precision, Provenance, save};
use renderflow_model::wan::{Autoencoder, Flow, FlowConfig, Vae, open as open_renderer};

/// A module whose parameters are all moved away from their initial values, zeros among them.
fn disturbed<M: Module>(module: M) -> M {
    let moved = parameters::export(&module).into_iter().enumerate().map(|(k, p)| {
        let shift = |i: usize| 0.05 * (((i * 37 + k * 11) % 101) as f32 / 50.0 - 1.0);
        p.values.iter().enumerate().map(|(i, v)| v + shift(i)).collect::<Vec<f32>>()
    });
    let moved: Vec<Vec<f32>> = moved.collect();
    parameters::import(module, &moved.iter().map(Vec::as_slice).collect::<Vec<_>>(), &Device::flex())
}

fn plain() -> FlowConfig {
    FlowConfig::tiny()
}

fn adapted() -> FlowConfig {
    let inverse = InverseConfig { lora_rank: 2, lora_alpha: 2.0, ..InverseConfig::default() };
    plain().with_keyframes(KeyframeConfig { lora_rank: 2, lora_alpha: 2.0, ..KeyframeConfig::default() }).with_inverse(inverse)
}

fn networks(config: &FlowConfig) -> (Flow, Vae, Header) {
    let device = Device::flex();
    let flow = disturbed(Flow::new(config, 3, &device).expect("network"));
    let vae = disturbed(Vae::new(&config.vae, 4, &device).expect("network"));
    (flow, vae, Header { network: Network::WanFlow(config.clone()), provenance: Provenance::default() })
}

fn wan(config: &FlowConfig) -> WanRenderer {
    let (flow, vae, header) = networks(config);
    WanRenderer::new(flow, vae, header, Device::flex()).expect("renderer")
}

/// All frames of a sequence, in one go.
fn all(renderer: &dyn Renderer, sequence: &Memory, options: Options) -> Vec<Rendered> {
    let mut session = renderer.begin(sequence, options).expect("begins");
    let mut rendered = Vec::new();
    for index in 0..sequence.len() {
        rendered.extend(session.push(sequence.view(index)).expect("renders"));
    }
    rendered.extend(session.finish().expect("ends"));
    rendered
}

fn indices(rendered: &[Rendered]) -> Vec<usize> {
    rendered.iter().map(|r| r.index).collect()
}

/// Frames `[3, 20, 20]`, padded to 32 pixels a side, as a clip.
fn tensor(frames: &[Vec<f32>]) -> Tensor<5> {
    let mut values = Vec::new();
    for channel in 0..3 {
        for frame in frames {
            let side = (frame.len() / 3).isqrt();
            let at = |x: usize, y: usize| frame[(channel * side + y.min(side - 1)) * side + x.min(side - 1)];
            values.extend((0..32 * 32).map(|i| at(i % 32, i / 32)));
        }
    }
    Tensor::from_data(TensorData::new(values, [1, 3, frames.len(), 32, 32]), &Device::flex())
}

/// One clip by the paper's words: the pictures of five frames from `first` on, of which the first is given as `reference`.
fn by_hand(
    (flow, vae, _): &(Flow, Vae, Header),
    sequence: &Memory,
    first: usize,
    reference: Option<&Vec<f32>>,
    keyframes: &[(usize, f64)],
    steps: usize,
) -> Vec<Vec<f32>> {
    let pages: Vec<Pictures> = (0..5).map(|i| sequence.pictures((first + i).min(sequence.len() - 1))).collect();
    let encode = |frames: &[Vec<f32>]| vae.encode_normalised(tensor(frames)).expect("latents");
    let of = |kind| encode(&pages.iter().map(|page| page.of(kind).to_vec()).collect::<Vec<_>>());
    let grey = vec![vec![0.0; 3 * SIDE * SIDE]; 5];
    let mut given = grey.clone();
    if let Some(reference) = reference {
        given[0].clone_from(reference);
    }
    // A latent frame shows the mask of its second frame, which is never given.
    let mask = Tensor::ones([1, 64, 2, 4, 4], &Device::flex());
    let parts = vec![encode(&given), encode(&grey), mask, of(Kind::Normal), of(Kind::Depth), of(Kind::Material)];
    let key = |&(index, time): &(usize, f64)| {
        let latent = encode(&[sequence.pictures(index).of(Kind::Target).to_vec()]);
        KeyframeLatent { latent, time }
    };
    let conditions = Conditions {
        attributes: Tensor::cat(parts, 1),
        environment: of(Kind::Environment),
        keyframes: keyframes.iter().map(key).collect(),
    };
    let mut z = of(Kind::Albedo);
    for step in 0..steps {
        let time = step as f64 / steps as f64;
        let velocity = flow.velocity(z.clone(), &[time], &conditions).expect("velocity");
        z = z + velocity.div_scalar(steps as f64);
    }
    let values = to_vec(vae.decode_normalised(z).expect("pictures"));
    let pictures = (0..5).map(|i| {
        let mut picture: Vec<f32> = Vec::new();
        for channel in 0..3 {
            for y in 0..SIDE {
                picture.extend_from_slice(&values[((channel * 5 + i) * 32 + y) * 32..][..SIDE]);
            }
        }
        // Where nothing is seen, the environment is known.
        for (j, value) in picture.iter_mut().enumerate() {
            if pages[i].mask[j % (SIDE * SIDE)] == 0.0 {
                *value = pages[i].albedo[j];
            }
        }
        picture
    });
    pictures.collect()
}

fn assert_shown(rendered: &Rendered, picture: &[f32], sequence: &Memory) {
    let expected = radiance(picture, SIDE, SIDE, sequence.clip.light.exposure()).expect("radiance");
    let frame = &sequence.clip.frames[rendered.index];
    let mut covered = 0;
    for (i, (found, expected)) in rendered.linear.pixels.iter().zip(&expected.pixels).enumerate() {
        if frame.alpha.pixels[i] > 0.0 {
            covered += 1;
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() <= 1e-6), "frame {} pixel {i}", rendered.index);
        }
    }
    assert!(covered > 50, "{covered} pixels");
}

#[test]
fn a_sequence_is_rendered_in_clips_that_begin_with_the_last_frame_of_the_one_before() {
    let config = plain();
    let sequence = Memory::new(11, &[]);
    let networks = networks(&config);
    for steps in [1, 2] {
        let rendered = all(&wan(&config), &sequence, Options { steps, ..Options::default() });
        assert_eq!(indices(&rendered), (0..11).collect::<Vec<_>>());
        let first = by_hand(&networks, &sequence, 0, None, &[], steps);
        let second = by_hand(&networks, &sequence, 4, Some(&first[4]), &[], steps);
        // Two frames are left: frames 9 and 10, and the last one again.
        let third = by_hand(&networks, &sequence, 8, Some(&second[4]), &[], steps);
        let pictures = first.iter().chain(&second[1..]).chain(&third[1..3]);
        for (rendered, picture) in rendered.iter().zip(pictures) {
            assert_shown(rendered, picture, &sequence);
        }
        // The environment where nothing is seen, to the bit.
        let frame = &sequence.clip.frames[9];
        let sky: Vec<usize> = (0..SIDE * SIDE).filter(|&i| frame.alpha.pixels[i] == 0.0).collect();
        assert!(sky.len() > 20, "{} pixels of sky", sky.len());
        for i in sky {
            let direction = frame.info.camera.ray_direction(glam::Vec2::new((i % SIDE) as f32 + 0.5, (i / SIDE) as f32 + 0.5));
            assert_eq!(rendered[9].linear.pixels[i], sequence.clip.light.environment.radiance(direction));
        }
    }
}

#[test]
fn the_length_of_a_sequence_changes_nothing_before_its_last_clip() {
    let renderer = wan(&plain());
    let long = all(&renderer, &Memory::new(10, &[]), Options::default());
    for frames in [1, 3, 5, 8] {
        // Bounds of depth are those of the whole sequence: here all are the same.
        let mut sequence = Memory::new(10, &[]);
        sequence.clip.frames.truncate(frames);
        let bounds = DepthBounds::of(&Memory::new(10, &[]).clip.frames);
        let sequence = Bounded { sequence, bounds };
        let mut session = renderer.begin(&sequence, Options::default()).expect("begins");
        let mut rendered = Vec::new();
        for index in 0..frames {
            rendered.extend(session.push(sequence.sequence.view(index)).expect("renders"));
        }
        rendered.extend(session.finish().expect("ends"));
        assert_eq!(indices(&rendered), (0..frames).collect::<Vec<_>>());
        let whole = if frames < 5 { 0 } else { 1 + (frames - 1) / 4 * 4 };
        assert!(rendered[..whole] == long[..whole], "{frames} frames");
        assert!(rendered.iter().all(|r| r.linear.pixels.iter().flatten().all(|v| v.is_finite())));
    }
}

#[test]
fn stops_between_clips_and_threads_change_no_bit() {
    let renderer = wan(&adapted());
    let sequence = Memory::new(11, &[0, 8]);
    for options in [Options::default(), Options { keyframes: true, ..Options::default() }] {
        let whole = all(&renderer, &sequence, options);
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
            let pieces = pool.install(|| {
                let mut rendered: Vec<Rendered> = Vec::new();
                let mut state = None;
                let mut index = 0;
                // Every piece is rendered by another session, which knows of the one before only its state.
                while index < sequence.len() {
                    let mut session = renderer.begin(&sequence, options).expect("begins");
                    if let Some(state) = state.take() {
                        let (file, bytes) = (std::path::Path::new("state"), State::encode(&state).expect("bytes"));
                        let state = State::decode(file, &bytes).expect("a state");
                        session.resume(sequence.view(index - 1), state).expect("resumes");
                    }
                    while index < sequence.len() && state.is_none() {
                        rendered.extend(session.push(sequence.view(index)).expect("renders"));
                        state = session.state();
                        index += 1;
                    }
                    if state.is_none() {
                        rendered.extend(session.finish().expect("ends"));
                    }
                }
                rendered
            });
            assert!(pieces == whole, "{options:?}, {threads} threads");
        }
    }
}

#[test]
fn numbers_left_out_begin_a_sequence() {
    let renderer = wan(&plain());
    let mut sequence = Memory::new(9, &[]);
    let bounds = DepthBounds::of(&sequence.clip.frames);
    for (i, number) in sequence.clip.numbers.iter_mut().enumerate() {
        *number = if i < 6 { i } else { i + 10 };
    }
    let whole = all(&renderer, &sequence, Options::default());
    assert_eq!(indices(&whole), (0..9).collect::<Vec<_>>());
    let sequence = Bounded { sequence, bounds };
    for part in [0..6, 6..9] {
        let mut session = renderer.begin(&sequence, Options::default()).expect("begins");
        let mut rendered = Vec::new();
        for index in part.clone() {
            rendered.extend(session.push(sequence.sequence.view(index)).expect("renders"));
        }
        rendered.extend(session.finish().expect("ends"));
        assert!(rendered == whole[part]);
    }
}

#[test]
fn what_is_held_does_not_grow_with_the_sequence() {
    let renderer = wan(&adapted());
    let most = |frames: usize| {
        let keyframes: Vec<usize> = (0..frames).step_by(8).collect();
        let sequence = Memory::new(frames, &keyframes);
        let mut clips =
            ClipSession::new(&renderer, &sequence, Options { keyframes: true, ..Options::default() }).expect("begins");
        let mut most = 0;
        for index in 0..frames {
            clips.push(sequence.view(index)).expect("renders");
            most = most.max(clips.held());
        }
        clips.finish().expect("ends");
        most
    };
    let short = most(13);
    assert_eq!(short, most(25));
    // Five frames of four buffers and an environment, two keyframes with latents, grey; nothing stands still.
    let (frame, latent) = (3 * (4 * SIDE * SIDE + 32 * 32) + 3 * SIDE * SIDE, 4 * 4 * 4);
    let bound = 5 * frame + 2 * (latent + 6 * SIDE * SIDE) + 2 * latent;
    assert!(short > frame && short <= bound, "{short} numbers, {bound} at most");
}

#[test]
fn what_stands_still_is_encoded_once_and_looks_the_same() {
    let config = plain();
    let mut sequence = Memory::new(13, &[]);
    // Only the albedo changes, in two clips; then, after a cut, only that again, from elsewhere.
    for i in (1..13).filter(|i| *i != 9) {
        let from = if i < 9 { 0 } else { 9 };
        sequence.clip.frames[i] = sequence.clip.frames[from].clone();
        sequence.clip.frames[i].albedo = sequence.clip.frames[from].albedo.map(|p| p.map(|v| v / (1.0 + i as f32)));
    }
    sequence.clip.numbers[9..].iter_mut().for_each(|number| *number += 10);
    let networks = networks(&config);
    let rendered = all(&wan(&config), &sequence, Options::default());
    let first = by_hand(&networks, &sequence, 0, None, &[], 1);
    let second = by_hand(&networks, &sequence, 4, Some(&first[4]), &[], 1);
    let third = by_hand(&networks, &sequence, 9, None, &[], 1);
    let pictures = first.iter().chain(&second[1..]).chain(&third[..4]);
    assert_eq!(rendered.len(), pictures.clone().count());
    for (rendered, picture) in rendered.iter().zip(pictures) {
        assert_shown(rendered, picture, &sequence);
    }
}

#[test]
fn keyframes_guide_what_is_between_them_and_are_returned_as_they_are() {
    let config = adapted();
    let renderer = wan(&config);
    let sequence = Memory::new(9, &[0, 8]);
    let without = all(&renderer, &sequence, Options::default());
    let with = all(&renderer, &sequence, Options { keyframes: true, ..Options::default() });
    for (with, without) in with.iter().zip(&without) {
        if [0, 8].contains(&with.index) {
            assert_eq!(Some(&with.linear), sequence.clip.frames[with.index].beauty.as_ref());
        } else {
            assert_ne!(with.linear, without.linear, "frame {}", with.index);
        }
    }
    let networks = networks(&config);
    let mut first = by_hand(&networks, &sequence, 0, None, &[(0, 0.0), (8, 2.0)], 1);
    first[0] = sequence.pictures(0).of(Kind::Target).to_vec();
    let second = by_hand(&networks, &sequence, 4, Some(&first[4]), &[(0, -1.0), (8, 1.0)], 1);
    for (rendered, picture) in with[1..].iter().zip(first[1..].iter().chain(&second[1..4])) {
        assert_shown(rendered, picture, &sequence);
    }
    // Without keyframes the adapter does not show.
    let (mut flow, vae, header) = networks;
    flow.keyframes = None;
    let bare = WanRenderer::new(flow, vae, header, Device::flex()).expect("renderer");
    assert!(all(&bare, &sequence, Options::default()) == without);
    // A sequence without keyframes is rendered without them.
    let none = Memory::new(9, &[]);
    assert!(all(&renderer, &none, Options { keyframes: true, ..Options::default() }) == without);
}

#[test]
fn stills_are_clips_of_one_frame_in_any_order() {
    let renderer = wan(&adapted());
    let sequence = Memory::new(7, &[0, 6]);
    for keyframes in [false, true] {
        let options = Options { keyframes, ..Options::default() };
        let mut stills = renderer.begin(&sequence, Options { stills: true, ..options }).expect("begins");
        let clips = all(&renderer, &sequence, options);
        for index in [3, 1, 2, 6, 0] {
            let still = stills.push(sequence.view(index)).expect("renders");
            let mut alone = renderer.begin(&sequence, options).expect("begins");
            assert!(alone.push(sequence.view(index)).expect("waits").is_empty());
            assert!(still == alone.finish().expect("renders") && still[0].index == index, "frame {index}");
            // Within a clip tokens see those of other frames; a keyframe is its own picture either way.
            assert!((still[0] == clips[index]) == (keyframes && [0, 6].contains(&index)), "frame {index}");
            assert!(stills.state().is_none());
        }
        assert!(stills.finish().expect("nothing left").is_empty());
    }
}

#[test]
fn bad_input_is_refused_in_words() {
    let renderer = wan(&plain());
    let sequence = Memory::new(6, &[0]);
    let refusal = |options| match renderer.begin(&sequence, options) {
        Ok(_) => panic!("must be refused"),
        Err(error) => error.to_string(),
    };
    assert!(refusal(Options { steps: 0, ..Options::default() }).contains("steps"));
    assert!(refusal(Options { keyframes: true, ..Options::default() }).contains("keyframe adapter"));
    let mut dark = Memory::new(1, &[]);
    dark.clip.light = Light::with_exposure(dark.clip.light.environment.clone(), 0.0);
    assert!(renderer.begin(&dark, Options::default()).is_err());

    let mut session = renderer.begin(&sequence, Options::default()).expect("begins");
    session.push(sequence.view(0)).expect("taken");
    let other = clip(1, 24);
    let view = View { number: 1, index: 1, frame: &other.frames[0], shaded: None };
    let message = session.push(view).expect_err("must fail").to_string();
    assert!(message.contains("24x24") && message.contains("20x20"), "{message}");
    // What was refused leaves the session as it was.
    for index in 1..5 {
        session.push(sequence.view(index)).expect("taken");
    }
    let state = session.state().expect("between clips");
    assert_eq!((state.number, state.size), (4, [SIDE; 2]));
    let mut again = renderer.begin(&sequence, Options::default()).expect("begins");
    assert!(again.resume(sequence.view(3), state.clone()).is_err());
    let mut short = state.clone();
    short.picture.pop();
    assert!(again.resume(sequence.view(4), short).is_err());
    let mut broken = state;
    broken.picture[7] = f32::NAN;
    assert!(again.resume(sequence.view(4), broken).is_err());

    let frame = vec![0.0; 3 * SIDE * SIDE];
    assert!(renderer.invert(&[&frame], [SIDE; 2], &[Intrinsic::Albedo], 1).is_err(), "no adapter");
    let inverse = wan(&adapted());
    assert!(inverse.invert(&[], [SIDE; 2], &[Intrinsic::Albedo], 1).is_err());
    assert!(inverse.invert(&[&frame], [SIDE, 19], &[Intrinsic::Albedo], 1).is_err());
    assert!(inverse.invert(&[&frame], [SIDE; 2], &[Intrinsic::Albedo], 0).is_err());
}

#[test]
fn pictures_lead_back_to_buffers() {
    let config = adapted();
    let (renderer, (flow, vae, _)) = (wan(&config), networks(&config));
    let sequence = Memory::new(3, &[]);
    let frames: Vec<Vec<f32>> = (0..3).map(|i| sequence.pictures(i).of(Kind::Target).to_vec()).collect();
    let slices: Vec<&[f32]> = frames.iter().map(Vec::as_slice).collect();
    let crop = |values: &[f32], frames: usize, frame: usize| -> Vec<f32> {
        let row = |channel: usize, y: usize| &values[((channel * frames + frame) * 32 + y) * 32..][..SIDE];
        (0..3).flat_map(|channel| (0..SIDE).flat_map(move |y| row(channel, y).iter().copied())).collect()
    };
    for count in [1, 3] {
        let padded: Vec<Vec<f32>> = (0..if count == 1 { 1 } else { 5 }).map(|i| frames[i.min(count - 1)].clone()).collect();
        let start = vae.encode_normalised(tensor(&padded)).expect("latents");
        let found = renderer.invert(&slices[..count], [SIDE; 2], &Intrinsic::ALL, 1).expect("inverts");
        assert_eq!(found.len(), 4);
        for (found, intrinsic) in found.iter().zip(Intrinsic::ALL) {
            let end = flow.invert(start.clone(), &[0.0], intrinsic).expect("latents");
            let values = to_vec(vae.decode_normalised(end).expect("pictures"));
            assert_eq!(found.len(), count);
            for (i, found) in found.iter().enumerate() {
                let expected = crop(&values, padded.len(), i);
                assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-5), "{intrinsic:?} {i}");
            }
        }
        assert_ne!(found[0], found[1]);
    }
    // Two steps: half of the way, and from there the whole way that is left.
    let start = vae.encode_normalised(tensor(&frames[..1])).expect("latents");
    let end = flow.invert(start.clone(), &[0.0], Intrinsic::Depth).expect("latents");
    let middle = (start + end).mul_scalar(0.5);
    let end = flow.invert(middle, &[0.5], Intrinsic::Depth).expect("latents");
    let expected = crop(&to_vec(vae.decode_normalised(end).expect("pictures")), 1, 0);
    let found = renderer.invert(&slices[..1], [SIDE; 2], &[Intrinsic::Depth], 2).expect("inverts");
    assert!(found[0][0].iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-5));
}

#[test]
fn a_file_tells_which_network_renders() {
    let folder = tempfile::tempdir().expect("folder");
    let path = |name: &str| folder.path().join(name);
    let config = plain();
    let (flow, vae, header) = networks(&config);
    let file = path("flow.safetensors");
    save(&file, &flow, &header, Precision::F32, Naming::Diffusers).expect("saves");
    let open = |path: &std::path::Path, file: Option<&std::path::Path>| {
        open_renderer(path, Autoencoder { file, tile: None }, &NetworkDevice::cpu())
    };
    let refusal = |path: &std::path::Path, vae: Option<&std::path::Path>| match open(path, vae) {
        Ok(_) => panic!("must be refused"),
        Err(error) => error.to_string(),
    };
    let message = refusal(&file, None);
    assert!(message.contains("flow.safetensors") && message.contains(AUTOENCODER_FILE), "{message}");
    let vae_header = |config| Header { network: Network::WanVae(config), provenance: Provenance::default() };
    let own = vae_header(config.vae.clone());
    save(&path(AUTOENCODER_FILE), &vae, &own, Precision::F32, Naming::Original).expect("saves");
    let sequence = Memory::new(2, &[]);
    let opened = open(&file, None).expect("opens");
    assert_eq!(
        (opened.about().name, opened.about().keyframes, opened.about().hdr, opened.about().clip),
        ("wan", false, false, 5)
    );
    let expected = all(&wan(&config), &sequence, Options::default());
    assert!(all(&*opened, &sequence, Options::default()) == expected);
    assert!(all(&*open(&file, Some(&path(AUTOENCODER_FILE))).expect("opens"), &sequence, Options::default()) == expected);
    // A tile as large as the picture changes nothing; there are no smaller ones than four latent pixels.
    let tiled = |tile| open_renderer(&file, Autoencoder { file: None, tile: Some(tile) }, &NetworkDevice::cpu());
    assert!(all(&*tiled(32).expect("opens"), &sequence, Options::default()) == expected);
    assert!(tiled(31).is_err_and(|error| error.to_string().contains("four")));
    // Another autoencoder, and an autoencoder where the renderer should be.
    let other = renderflow_model::wan::VaeConfig { latents_mean: vec![0.1; 4], ..config.vae.clone() };
    save(&path("other.safetensors"), &vae, &vae_header(other), Precision::F32, Naming::Diffusers).expect("saves");
    let message = refusal(&file, Some(&path("other.safetensors")));
    assert!(message.contains("other.safetensors") && message.contains("trained"), "{message}");
    let message = refusal(&path(AUTOENCODER_FILE), None);
    assert!(message.contains("another network"), "{message}");

    let message = refusal(&path("nothing.safetensors"), None);
    assert!(message.contains("nothing.safetensors"), "{message}");
}
