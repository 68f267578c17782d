//! `renderflow render` with what it does only when asked.

mod common;

use common::{renderflow, stderr, succeed};
use renderflow_frame::image::Rgb;
use renderflow_frame::{Frame, exr, file};

#[test]
fn light_groups_sum_to_raw_and_irradiance_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let common = |out: &str| {
        let words =
            ["render", "--seed", "3", "--frames", "1", "--resolution", "32", "--spp", "8", "--denoise", "none", "--out", out];
        words.map(str::to_owned).to_vec()
    };
    let render = |out: &str, more: &[&str]| {
        let all: Vec<String> = common(&path(out)).into_iter().chain(more.iter().map(|w| (*w).to_owned())).collect();
        succeed(&all.iter().map(String::as_str).collect::<Vec<_>>());
        exr::read(&folder.path().join(out).join("frame.0000.exr")).unwrap()
    };
    let plain = render("plain", &[]);
    assert!(plain.light.iter().all(Option::is_none) && plain.irradiance.is_none());
    assert_eq!(plain.info.bsdf, "conserving");

    let split = render("split", &["--light-groups", "5", "--irradiance"]);
    assert_eq!(split.light.iter().flatten().count(), 5);
    let irradiance = split.irradiance.as_ref().unwrap();
    assert!(irradiance.pixels.iter().flatten().any(|v| *v > 0.0));
    // Groups cost nothing in the picture.
    assert_eq!(plain.raw, split.raw);
    let raw = split.raw.as_ref().unwrap();
    for (i, pixel) in raw.pixels.iter().enumerate() {
        for (c, whole) in pixel.iter().enumerate() {
            let sum: f32 = split.light.iter().flatten().map(|group| group.pixels[i][c]).sum();
            // Six half-precision roundings.
            assert!((sum - whole).abs() <= 6.0 * 2f32.powi(-11) * whole + 1e-6, "pixel {i}: {sum} of {whole}");
        }
    }

    // What the network reads besides is written when it is asked for, and changes nothing else.
    let shares = render("shares", &["--indirect"]);
    assert!(plain.indirect.is_none() && plain.hidden.is_none() && shares.raw == plain.raw);
    let total = |picture: &Option<Rgb>| picture.as_ref().unwrap().pixels.as_flattened().iter().sum::<f32>();
    assert!(total(&shares.hidden) > 0.0 && (0.0..total(&shares.raw)).contains(&total(&shares.indirect)));
    let again: Vec<String> = common(&path("shares"));
    let refused = renderflow(&again.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(stderr(&refused).contains("the indirect light was there, now not there"), "{}", stderr(&refused));

    let published = render("published", &["--bsdf", "published"]);
    assert_eq!(published.info.bsdf, "published");
    assert_ne!(published.raw, plain.raw);

    // A folder is of one form of the BRDF.
    let again: Vec<String> = common(&path("plain")).into_iter().chain(["--bsdf".into(), "published".into()]).collect();
    let refused = renderflow(&again.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(!refused.status.success() && stderr(&refused).contains("other settings"), "{}", stderr(&refused));
}

#[test]
fn frames_tell_how_paths_were_split_and_limited_and_others_do_not_go_on_from_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let words = |out: &str, more: &[&str]| -> Vec<String> {
        let common =
            ["render", "--seed", "3", "--frames", "1", "--resolution", "24", "--spp", "16", "--denoise", "none", "--out"];
        common.iter().copied().chain([path(out).as_str()]).chain(more.iter().copied()).map(str::to_owned).collect()
    };
    let render = |out: &str, more: &[&str]| {
        succeed(&words(out, more).iter().map(String::as_str).collect::<Vec<_>>());
        exr::read(&folder.path().join(out).join("frame.0000.exr")).unwrap()
    };
    let refused = |out: &str, more: &[&str]| {
        let output = renderflow(&words(out, more).iter().map(String::as_str).collect::<Vec<_>>());
        assert!(!output.status.success(), "{more:?}");
        stderr(&output)
    };
    let plain = render("plain", &[]);
    assert_eq!((plain.info.branches, plain.info.indirect_limit), (Some(2), None));
    // No more than four share a ray here, or fewer than four rays would be left.
    assert_eq!(render("many", &["--branches", "64"]).info.branches, Some(4));
    let single = render("single", &["--branches", "1"]);
    assert_eq!(single.info.branches, None);
    assert_ne!(single.raw, plain.raw);
    let limited = render("limited", &["--clamp-indirect", "0.01"]);
    assert_eq!(limited.info.indirect_limit, Some(0.01));
    let sum = |frame: &Frame| -> f64 { frame.raw.as_ref().unwrap().pixels.iter().flatten().map(|v| f64::from(*v)).sum() };
    assert!(sum(&limited) < sum(&plain), "{} of {}", sum(&limited), sum(&plain));

    for (out, more) in [("plain", &["--branches", "4"][..]), ("plain", &["--clamp-indirect", "10"]), ("limited", &[])] {
        let text = refused(out, more);
        assert!(text.contains("other settings"), "{out} {more:?}: {text}");
    }
    assert!(refused("plain", &["--branches", "4"]).contains("the number of samples that share a camera ray was 2, now 4"));
    assert!(refused("limited", &["--clamp-indirect", "0.02"]).contains("the limit of indirect light was 0.01, now 0.02"));
    for bad in ["0", "-1", "inf", "NaN", "x"] {
        assert!(refused("bad", &[&format!("--clamp-indirect={bad}")]).contains("--clamp-indirect"), "{bad}");
    }
    assert!(refused("bad", &["--branches", "65"]).contains("1..=64"));

    // A map of samples is replayed with the split it was made with.
    let adaptive = render("adaptive", &["--adaptive", "--branches", "2"]);
    assert_eq!(adaptive.info.branches, Some(2));
    let map = path("adaptive/frame.0000.exr");
    let replayed = render("replayed", &["--sample-map", &map]);
    assert_eq!((replayed.info.branches, &replayed.raw), (Some(2), &adaptive.raw));
    render("replayed", &["--sample-map", &map]);
    assert!(refused("replayed", &["--adaptive", "--branches", "1"]).contains("other settings"));
    assert!(refused("bad", &["--sample-map", &map, "--branches", "2"]).contains("cannot be used"));
}

/// The seed of a scene file, of its copy beside the frames, and of the frames' headers are one.
#[test]
fn a_seed_samples_a_scene_from_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let scene = path("scene.json");
    succeed(&["compose", "--seed", "7", "--resolution", "24x24", "--frames", "1", "--out", &scene]);
    let words = |out: &str, more: &[&str]| -> Vec<String> {
        let common = ["render", "--scene", scene.as_str(), "--spp", "4", "--denoise", "none", "--out"];
        common.iter().copied().chain([path(out).as_str()]).chain(more.iter().copied()).map(str::to_owned).collect()
    };
    let run = |out: &str, more: &[&str]| renderflow(&words(out, more).iter().map(String::as_str).collect::<Vec<_>>());
    let read = |out: &str| {
        let written: serde_json::Value =
            serde_json::from_slice(&std::fs::read(folder.path().join(out).join("scene.json")).unwrap()).unwrap();
        (written["seed"].as_u64().unwrap(), exr::read(&folder.path().join(out).join("frame.0000.exr")).unwrap())
    };
    let own: serde_json::Value = serde_json::from_slice(&std::fs::read(&scene).unwrap()).unwrap();
    let own = own["seed"].as_u64().unwrap();
    assert!(run("own", &[]).status.success() && run("other", &["--seed", "99"]).status.success());
    let ((seed, plain), (other_seed, other)) = (read("own"), read("other"));
    assert_eq!((seed, plain.info.seed, other_seed, other.info.seed), (own, own, 99, 99));
    assert!(plain.raw != other.raw && plain.albedo == other.albedo && plain.depth == other.depth);
    // The scene as it was written is the same picture without the flag.
    succeed(&["render", "--scene", &path("other/scene.json"), "--spp", "4", "--denoise", "none", "--out", &path("again")]);
    assert_eq!(read("again").1.raw, other.raw);

    // A reference of the same seed has the same noise: another seed is taken, and said.
    let reference = path("own/frame.0000.exr");
    let compared = run("compared", &["--reference", &reference]);
    let said = stderr(&compared);
    assert!(compared.status.success() && said.contains(&format!("was sampled with the seed {own} of this scene")), "{said}");
    let (seed, frame) = read("compared");
    assert!(seed != own && frame.info.seed == seed && frame.raw != plain.raw, "{seed}");
    // Both have 4 samples of their own: the error is theirs, not that of one picture with itself.
    let table = String::from_utf8_lossy(&compared.stdout).into_owned();
    let relmse: f64 = table
        .lines()
        .find(|line| line.trim_start().starts_with("4 "))
        .unwrap()
        .split_whitespace()
        .nth(3)
        .unwrap()
        .parse()
        .unwrap();
    assert!(relmse > 1e-5, "{table}");
    // The same command goes on; a seed that is asked for is kept, with a warning; another one needs none.
    assert!(run("compared", &["--reference", &reference]).status.success());
    let warned = run("kept", &["--reference", &reference, "--seed", &own.to_string()]);
    assert!(stderr(&warned).contains("warning") && stderr(&warned).contains("errors look too small"), "{}", stderr(&warned));
    assert_eq!(read("kept").0, own);
    let third = run("third", &["--reference", &reference, "--seed", "5"]);
    assert!(third.status.success() && !stderr(&third).contains("was sampled with"), "{}", stderr(&third));
}

#[test]
fn the_network_inside_the_program_cleans_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let render = |out: &str, denoise: &str, threads: &str| {
        let out = folder.path().join(out);
        let words = ["--threads", threads, "render", "--seed", "4", "--frames", "1", "--resolution", "50", "--spp", "4"];
        renderflow(&[&words[..], &["--denoise", denoise, "--out", out.to_str().unwrap()]].concat())
    };
    let read = |out: &str| exr::read(&folder.path().join(out).join("frame.0000.exr")).unwrap();
    for (out, denoise, threads) in [("raw", "none", "2"), ("a", "neural", "1"), ("b", "neural", "3")] {
        let output = render(out, denoise, threads);
        assert!(output.status.success(), "{}", stderr(&output));
    }
    let (raw, cleaned) = (read("raw"), read("a"));
    let name = cleaned.info.denoiser.clone().unwrap();
    let name = name.strip_prefix("oidn + ").unwrap_or(&name);
    assert!(name.starts_with("neural ") && name.len() == 23, "{name}");
    assert!(cleaned == read("b"), "the picture depends on the threads");
    // What the network read of the samples is kept if it is asked for.
    assert!(cleaned.indirect.is_none() && cleaned.hidden.is_none());
    let words =
        ["render", "--seed", "4", "--frames", "1", "--resolution", "50", "--spp", "4", "--denoise", "neural", "--indirect"];
    succeed(&[&words[..], &["--out", folder.path().join("kept").to_str().unwrap()]].concat());
    let kept = read("kept");
    assert!(kept.indirect.is_some() && kept.hidden.is_some());
    assert!(Frame { indirect: None, hidden: None, ..kept } == cleaned);
    let samples = |frame: &Frame| frame.raw.clone().or(frame.beauty.clone());
    assert_eq!(samples(&cleaned), samples(&raw));
    // The picture comes closer to one of many samples.
    let words = ["render", "--seed", "4", "--frames", "1", "--resolution", "50", "--spp", "512", "--denoise", "none"];
    succeed(&[&words[..], &["--out", folder.path().join("truth").to_str().unwrap()]].concat());
    let truth = read("truth").beauty.unwrap();
    let error = |frame: &Frame| -> f32 {
        let pairs = frame.beauty.as_ref().unwrap().pixels.iter().zip(&truth.pixels);
        pairs.flat_map(|(mine, truth)| (0..3).map(move |c| (mine[c] - truth[c]).abs().min(1.0))).sum()
    };
    assert!(error(&cleaned) < 0.55 * error(&raw), "nothing was cleaned: {} and {}", error(&cleaned), error(&raw));
    assert!(stderr(&render("a", "none", "1")).contains("the denoiser"));
    // The same weights in a file make the same frame. Others do not go on in its folder.
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/model/weights/fusion.safetensors");
    let mut bytes = std::fs::read(file).unwrap();
    let (last, other) = (bytes.len() - 2, folder.path().join("other.safetensors"));
    bytes[last] ^= 1;
    std::fs::write(&other, bytes).unwrap();
    let with = |out: &str, weights: &str, denoise: &str| {
        let out = folder.path().join(out);
        let words = ["render", "--seed", "4", "--frames", "1", "--resolution", "50", "--spp", "4", "--weights", weights];
        renderflow(&[&words[..], &["--denoise", denoise, "--out", out.to_str().unwrap()]].concat())
    };
    assert!(with("named", file, "neural").status.success());
    assert!(read("named") == cleaned);
    let refused = with("a", other.to_str().unwrap(), "neural");
    assert!(!refused.status.success() && stderr(&refused).contains("the denoiser"), "{}", stderr(&refused));
    let refused = with("none", file, "oidn");
    assert!(!refused.status.success() && stderr(&refused).contains("--denoise neural"), "{}", stderr(&refused));
    let plan = folder.path().join("plan.toml");
    let truth = ["dataset", "plan", "--seed", "1", "--sequences", "1", "--denoise", "neural", "--out", plan.to_str().unwrap()];
    let refused = renderflow(&truth);
    assert!(!refused.status.success() && stderr(&refused).contains("must not be its own"), "{}", stderr(&refused));
}

#[test]
fn the_first_frame_gets_a_sheet_and_several_frames_an_animation() {
    use image::AnimationDecoder;
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let render = |out: &str, frames: &str, more: &[&str]| {
        let out = path(out).to_string_lossy().into_owned();
        let words =
            ["render", "--seed", "3", "--resolution", "24x16", "--spp", "1", "--denoise", "none", "--frames", frames, "-o", &out];
        renderflow(&[&words[..], more].concat())
    };
    let succeeds = |out: &str, frames: &str, more: &[&str]| {
        let made = render(out, frames, more);
        assert!(made.status.success(), "{}", stderr(&made));
    };
    let frames = |name: &str| {
        let file = std::fs::File::open(path(name)).unwrap();
        let decoder = image::codecs::gif::GifDecoder::new(std::io::BufReader::new(file)).unwrap();
        decoder.into_frames().collect_frames().unwrap().len()
    };
    succeeds("one", "1", &[]);
    assert!(!path("one/frames.gif").exists(), "one frame does not move");
    let first = std::fs::read(path("one/sheet.png")).unwrap();
    let sheet = image::load_from_memory(&first).unwrap();
    // Four tiles in a row, two rows.
    assert!(sheet.width() >= 4 * 224 && sheet.height() > 2 * 150, "{} x {}", sheet.width(), sheet.height());
    // The frame now moves to a next one, so its sheet is another.
    succeeds("one", "3", &[]);
    assert_eq!(frames("one/frames.gif"), 3);
    assert_ne!(std::fs::read(path("one/sheet.png")).unwrap(), first);
    // The same bytes as at once, and with any number of threads.
    succeeds("whole", "3", &["--threads", "1"]);
    for name in ["sheet.png", "frames.gif"] {
        assert!(std::fs::read(path("one").join(name)).unwrap() == std::fs::read(path("whole").join(name)).unwrap(), "{name}");
    }
    succeeds("bare", "2", &["--no-sheet"]);
    assert!(!path("bare/sheet.png").exists() && !path("bare/frames.gif").exists());
    // With --overwrite another scene has another sheet.
    succeeds("one", "2", &["--set", "materials/0/roughness=.9", "--overwrite"]);
    assert_eq!(frames("one/frames.gif"), 2);
    // Files of others stay, and are found before the first sample.
    for name in ["sheet.png", "frames.gif"] {
        std::fs::create_dir(path(name)).unwrap();
        std::fs::write(path(name).join(name), "mine").unwrap();
        let refused = render(name, "2", &[]);
        assert!(refused.status.code() == Some(1) && stderr(&refused).contains("choose another folder"), "{}", stderr(&refused));
        assert_eq!(std::fs::read_dir(path(name)).unwrap().count(), 1);
        succeeds(name, "2", &["--no-sheet"]);
        assert_eq!(std::fs::read(path(name).join(name)).unwrap(), b"mine");
    }
}

#[test]
fn frames_are_cleaned_with_the_samples_of_frames_around_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let words = |out: &str, frames: &str, more: &[&str]| -> Vec<String> {
        let out = path(out).to_string_lossy().into_owned();
        let common = ["render", "--seed", "8", "--resolution", "48", "--no-sheet", "--frames", frames, "--out", &out];
        common.iter().chain(more).map(|word| (*word).to_owned()).collect()
    };
    let run = |out: &str, frames: &str, more: &[&str]| {
        let words = words(out, frames, more);
        renderflow(&words.iter().map(String::as_str).collect::<Vec<_>>())
    };
    let made = |out: &str, frames: &str, more: &[&str]| {
        let output = run(out, frames, more);
        assert!(output.status.success(), "{}", stderr(&output));
    };
    let frame = |out: &str, index: usize| exr::read(&path(out).join(format!("frame.{index:04}.exr"))).unwrap();
    let neural = ["--spp", "2", "--denoise", "neural"];
    let around = [&neural[..], &["--neighbours", "around"]].concat();

    made("alone", "5", &neural);
    made("around", "5", &around);
    made("truth", "5", &["--spp", "512", "--denoise", "none"]);
    let error = |out: &str| -> f32 {
        let of = |index: usize| {
            let (found, truth) = (frame(out, index), frame("truth", index));
            let pairs = found.beauty.unwrap().pixels.into_iter().zip(truth.beauty.unwrap().pixels).zip(truth.alpha.pixels);
            let curve = |v: f32| (8.0 * truth.info.exposure * v).ln_1p();
            let square = |(a, b): ([f32; 3], [f32; 3])| (0..3).map(|c| (curve(a[c]) - curve(b[c])).powi(2)).sum::<f32>();
            pairs.filter(|(_, alpha)| *alpha > 0.0).map(|(pair, _)| square(pair)).sum::<f32>()
        };
        (0..5).map(of).sum()
    };
    let errors = ["alone", "around"].map(error);
    println!("squared errors without and with the frames around: {errors:?}");
    assert!(errors[1] < 0.9 * errors[0], "{errors:?}");
    let first = frame("around", 0);
    let name = first.info.denoiser.unwrap();
    assert!(name.contains("neural ") && name.ends_with(", frames before and after"), "{name}");
    // The samples stay what they were.
    assert_eq!(first.raw, frame("alone", 0).raw);

    // Again: nothing is made. A frame that is lost comes back the same, though only the others are denoised.
    let bytes = || -> Vec<Vec<u8>> {
        (0..5).map(|index| std::fs::read(path("around").join(format!("frame.{index:04}.exr"))).unwrap()).collect()
    };
    let before = bytes();
    let modified = || std::fs::metadata(path("around").join("frame.0001.exr")).unwrap().modified().unwrap();
    let then = modified();
    made("around", "5", &around);
    assert_eq!((bytes(), modified()), (before.clone(), then));
    std::fs::remove_file(path("around").join("frame.0002.exr")).unwrap();
    made("around", "5", &around);
    assert!(bytes() == before, "a lost frame came back otherwise");

    // A raw sequence is denoised as it is, and its seconds count; a shorter one gets longer, and its frames get samples of the
    // new ones.
    // If it does not say what its light is made of, the network knows less.
    for (out, more) in [("later", &["--indirect"][..]), ("bare", &[])] {
        made(out, "5", &[&["--spp", "2", "--denoise", "none"], more].concat());
    }
    made("bare", "5", &around);
    let bare = frame("bare", 2);
    assert!(bare.indirect.is_none() && bare.info.denoiser == frame("around", 2).info.denoiser);
    assert_eq!(bare.raw, frame("around", 2).raw);
    assert_ne!(bare.beauty, frame("around", 2).beauty);
    let seconds = || -> Vec<f64> {
        let timing: serde_json::Value = file::read_json(&path("later").join("timing.json")).unwrap();
        timing["seconds"].as_array().unwrap().iter().map(|seconds| seconds.as_f64().unwrap()).collect()
    };
    let raw = seconds();
    made("later", "5", &around);
    let denoised = seconds();
    assert!(raw.iter().zip(&denoised).all(|(before, after)| before < after), "{raw:?}, {denoised:?}");
    made("longer", "3", &around);
    made("longer", "5", &around);
    for other in ["later", "longer"] {
        for (index, before) in before.iter().enumerate() {
            let now = std::fs::read(path(other).join(format!("frame.{index:04}.exr"))).unwrap();
            assert!(now == *before, "{other}: frame {index} is another");
        }
    }

    // Samples that are spread go to detail, and the sequence says so; its map makes the same picture again.
    let adaptive = [&neural[..], &["--adaptive"]].concat();
    made("adaptive", "5", &[&adaptive[..], &["--neighbours", "around"]].concat());
    made("spread", "5", &adaptive);
    made("again", "5", &[&neural[2..], &["--sample-map", &path("spread").display().to_string()]].concat());
    let [together, spread, again] = ["adaptive", "spread", "again"].map(|out| frame(out, 2));
    assert_eq!((spread.info.sampling.as_str(), spread.info.branches), ("detail 2", None));
    let counts = &spread.samples.as_ref().unwrap().pixels;
    assert!(counts.contains(&1) && counts.iter().any(|&count| count >= 4), "{counts:?}");
    assert_eq!((&together.raw, &together.samples), (&spread.raw, &spread.samples));
    assert_eq!((again.raw, again.beauty), (spread.raw, spread.beauty.clone()));
    assert_ne!(together.beauty, spread.beauty);

    // Frames that were denoised by themselves are of other settings, and some things do not go together.
    for (out, frames, more, reason) in [
        ("alone", "5", &around[..], "the denoiser was"),
        ("one", "1", &around[..], "--neighbours: the scene has one frame"),
        ("none", "5", &["--spp", "2", "--denoise", "none", "--neighbours", "before"], "--denoise none has none"),
        ("timed", "5", &["--time-budget", "1", "--neighbours", "before"], "cannot be used with"),
    ] {
        let refused = run(out, frames, more);
        assert!(!refused.status.success() && stderr(&refused).contains(reason), "{}", stderr(&refused));
    }
}
