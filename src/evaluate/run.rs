//! Evaluates methods on sequences. Methods run one after the other on all threads, so that each has its own seconds; then all
//! metrics are computed in parallel.

use super::find::TestSequence;
use super::method::Method;
use super::renderer::{self, Drawing, MethodRenderer, Picture};
use super::results::{ABOUT, About, Score, SequenceSummary, TRUTH, Truth, VERSION, picture_file};
use crate::dataset::Sequence;
use crate::dataset::job;
use crate::dataset::layout::AUDIT;
use crate::dataset::record::Record;
use crate::dataset::testset::{Audit, decibel, display_variance};
use crate::metrics::temporal::{Pair, correspondence, temporal};
use crate::metrics::{self, Hdr, Metrics, Networks, median, values};
use crate::util::cancel::Cancel;
use crate::util::output::Claim;
use crate::util::progress::Progress;
use crate::util::text::plural;
use crate::util::{machine, picture};
use anyhow::{Context, Result, bail, ensure};
use rayon::prelude::*;
use renderflow_frame::image::Rgb;
use renderflow_frame::{Frame, color, file};
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::Path;

/// The colour curve before the metrics.
pub const CURVE: &str =
    "sRGB(clamp(exposure x linear, 0, 1)), exposure from the environment alone; metrics on floats, not quantised";

/// Said of a frame of G-buffers only.
const NO_BEAUTY: &str = "no beauty to compare with";

/// What to evaluate, and how.
pub struct Options<'a> {
    /// The methods, and what they need.
    pub rendering: renderer::Options<'a>,
    /// LPIPS, if its weights are there.
    pub lpips: &'a Networks,
    /// The first two of every `every` frames are evaluated; 1 = all. They are two because changes between frames are measured
    /// too.
    pub every: u32,
    /// Whether pictures are compared with the truth before it was denoised.
    pub raw_truth: bool,
    /// Number of frames in each sequence whose pictures are stored.
    pub pictures: usize,
    /// Heading of the report.
    pub title: String,
    /// More settings for the report.
    pub settings: Vec<(String, String)>,
}

/// Evaluates `tests` into the results folder `out`. Sequences that are complete there stay, unless their data changed; results of
/// sequences that are not among `tests` stay too, but no longer count. Every frame is one unit of `progress`.
///
/// # Errors
/// When stopped; when the folder holds results of other methods, settings, metrics or another machine; when a sequence cannot be
/// read or lacks truth.
pub fn run(tests: &[TestSequence], options: &Options, out: &Path, progress: &Progress, cancel: &Cancel) -> Result<()> {
    check(options, out)?;
    let named = |test: &TestSequence| test.sequence.folder.display().to_string();
    tests.iter().try_for_each(|test| ready(test, options.every).with_context(|| named(test)))?;
    let digests = digests(tests, |sequence| chosen(sequence.len(), options.every), cancel)?;
    let claim = claim(&About { sequences: Some(digests.clone()), ..about(options) }, out)?;
    let evaluation = Evaluation { options, claim: &claim, progress, cancel };
    for test in tests {
        let name = test.place();
        let data = &digests[&name];
        let class = out.join(&test.set).join(&test.class);
        let done = class.join(format!("{}.json", test.sequence.name));
        let indices = chosen(test.sequence.len(), options.every);
        let stored: Option<SequenceSummary> = file::read_json(&done).ok();
        let numbers: Vec<usize> = indices.iter().map(|&i| test.sequence.numbers[i]).collect();
        let wanted = shown(&indices, &test.sequence.transforms.keyframes, options.pictures).len();
        let whole = |stored: &SequenceSummary| {
            stored.frames == numbers && stored.data.as_ref() == Some(data) && stored.shown.len() >= wanted
        };
        if let Some(stored) = stored.filter(whole) {
            // An audit may have come later, and seconds too.
            let truth = Truth { spp: stored.truth.spp, noise: stored.truth.noise, ..told(&test.sequence) };
            if truth != stored.truth {
                claim.write()?;
                file::write_json(&done, &SequenceSummary { truth, ..stored })?;
            }
            progress.resume(indices.len() as u64);
            continue;
        }
        progress.message(name);
        let summary = evaluation.sequence(test, &indices, &class).with_context(|| named(test))?;
        file::write_json(&done, &SequenceSummary { data: Some(data.clone()), ..summary })?;
    }
    claim.write()
}

/// The [digest](Sequence::digest) of the data of each sequence, of which the frames `chosen` are read, by its place.
///
/// # Errors
/// When stopped; when a file cannot be read.
pub(super) fn digests(
    tests: &[TestSequence],
    chosen: impl Fn(&Sequence) -> Vec<usize> + Sync,
    cancel: &Cancel,
) -> Result<BTreeMap<String, String>> {
    let digest = |test: &TestSequence| {
        cancel.check()?;
        let sequence = &test.sequence;
        let digest = sequence.digest(&chosen(sequence)).with_context(|| sequence.folder.display().to_string())?;
        Ok((test.place(), digest))
    };
    tests.par_iter().map(digest).collect()
}

/// The number of frames of a sequence that are evaluated.
pub fn frames(test: &TestSequence, every: u32) -> usize {
    chosen(test.sequence.len(), every).len()
}

/// Checks that results of these options may be written into the folder `out`.
///
/// # Errors
/// When the folder holds results of other methods, settings, metrics or another machine, or anything else.
pub fn check(options: &Options, out: &Path) -> Result<()> {
    claim(&about(options), out).map(drop)
}

/// The truth that a frame holds; with `raw`, as it was before it was denoised.
fn truth_of(frame: &Frame, raw: bool) -> Result<&Rgb> {
    let traced = frame.raw.as_ref().filter(|_| raw);
    let picture = traced.or(frame.beauty.as_ref()).with_context(|| format!("has {NO_BEAUTY}"))?;
    ensure!(!raw || traced.is_some() || frame.info.denoiser.is_none(), "does not hold its truth before it was denoised");
    Ok(picture)
}

/// Checks that the truth of a sequence can be compared, as far as its files and its record show.
fn ready(test: &TestSequence, every: u32) -> Result<()> {
    for index in chosen(test.sequence.len(), every) {
        let file = &test.sequence.transforms.files[index];
        ensure!(test.sequence.folder.join(file).is_file(), "{file}: is not there");
        let recorded = test.sequence.record.iter().flat_map(|record| &record.frames).find(|frame| frame.file == *file);
        ensure!(recorded.is_none_or(|frame| frame.spp > 0), "frame {} has {NO_BEAUTY}", test.sequence.numbers[index]);
    }
    Ok(())
}

/// The processor and the number of threads, on which seconds depend.
pub fn machine() -> String {
    format!("{}, {}", machine::processor(), plural(rayon::current_num_threads(), "thread"))
}

/// The names of the LPIPS networks that are there.
pub fn lpips(networks: &Networks) -> String {
    let named = [("AlexNet", networks.alex.is_some()), ("SqueezeNet", networks.squeeze.is_some())];
    let there: Vec<&str> = named.into_iter().filter(|(_, there)| *there).map(|(name, _)| name).collect();
    if there.is_empty() { "none".into() } else { there.join(", ") }
}

/// The facts about an evaluation, without its sequences.
fn about(options: &Options) -> About {
    let mut settings = vec![
        ("camera rays per pixel of the G-buffer".to_owned(), options.rendering.guide_samples.to_string()),
        ("scattering events of a path".to_owned(), options.rendering.max_bounces.to_string()),
        (
            "frames".to_owned(),
            match options.every {
                1 => "all".to_owned(),
                every => format!("two of every {every}"),
            },
        ),
    ];
    let Drawing { steps, seed } = options.rendering.drawing;
    let drawing = [("Euler steps of the paper's network", steps != 1, steps.into()), ("seed of its noise", seed != 0, seed)];
    settings
        .extend(drawing.into_iter().filter(|(_, other, _)| *other).map(|(name, _, value)| (name.to_owned(), value.to_string())));
    settings.extend(options.raw_truth.then(|| ("truth".to_owned(), "before it was denoised".to_owned())));
    settings.extend(options.settings.iter().cloned());
    About {
        version: VERSION,
        program: concat!("renderflow ", env!("CARGO_PKG_VERSION")).into(),
        title: options.title.clone(),
        machine: machine(),
        lpips: Some(lpips(options.lpips)),
        curve: CURVE.into(),
        methods: options.rendering.methods.iter().map(Method::describe).collect(),
        settings,
        sequences: None,
    }
}

/// The claim on the results folder, which is written before the first result.
fn claim(about: &About, out: &Path) -> Result<Claim> {
    Claim::agreed(out, ABOUT, about, |stored: &About| {
        let same = (&stored.methods, &stored.settings) == (&about.methods, &about.settings);
        ensure!(same, "the folder holds results of other methods or settings; choose another folder");
        // Older programs wrote "1 threads".
        let (then, now) = (&stored.machine.replace(", 1 threads", ", 1 thread"), &about.machine);
        ensure!(then == now, "the folder holds seconds of {then}, and these would be of {now}; choose another folder");
        if let (Some(then), Some(now)) = (&stored.lpips, &about.lpips) {
            ensure!(then == now, "the folder holds results with LPIPS of {then}, and here it is {now}; choose another folder");
        }
        Ok(())
    })
}

/// Indices of the frames to evaluate: the first two of every `every` frames.
pub(super) fn chosen(frames: usize, every: u32) -> Vec<usize> {
    (0..frames).filter(|i| (i % every.max(1) as usize) < 2).collect()
}

/// Chooses `count` frames, spread evenly over the frames that are not keyframes, or over all where every frame is one.
fn shown(indices: &[usize], keyframes: &[usize], count: usize) -> Vec<usize> {
    let between: Vec<usize> = indices.iter().copied().filter(|i| !keyframes.contains(i)).collect();
    let from = if between.is_empty() { indices } else { &between };
    let count = count.min(from.len());
    (0..count).map(|k| from[(2 * k + 1) * from.len() / (2 * count)]).collect()
}

/// The last frame that was evaluated.
struct Before {
    number: usize,
    index: usize,
    frame: Frame,
    truth: Rgb,
    pictures: BTreeMap<String, Rgb>,
}

/// What all sequences of an evaluation share.
struct Evaluation<'a> {
    options: &'a Options<'a>,
    claim: &'a Claim,
    progress: &'a Progress,
    cancel: &'a Cancel,
}

impl Evaluation<'_> {
    /// Evaluates the frames `indices` of a sequence, and writes its scores and pictures into the folder of its class.
    fn sequence(&self, test: &TestSequence, indices: &[usize], class: &Path) -> Result<SequenceSummary> {
        let Self { options, claim, progress, cancel } = self;
        let sequence = &test.sequence;
        let Some(&first) = indices.first() else { bail!("has no frames") };
        let exposure = sequence.exposure();
        let mut methods = MethodRenderer::new(sequence, &options.rendering)?;
        let shown = shown(indices, &sequence.transforms.keyframes, options.pictures);
        let pictures = class.join(&sequence.name);
        let (mut scores, mut before, mut noise): (Vec<Score>, Option<Before>, Vec<f64>) = Default::default();
        for &index in indices {
            cancel.check()?;
            let (number, key) = (sequence.numbers[index], sequence.transforms.keyframes.contains(&index));
            let frame = sequence.frame(index)?;
            let linear = truth_of(&frame, options.raw_truth).with_context(|| format!("frame {number}"))?;
            let display = |picture: &Rgb| picture.map(|p| color::display(*p, exposure));
            let truth = display(linear);
            if let (Some(raw), Some(variance)) = (&frame.raw, &frame.variance) {
                noise.extend(display_variance(raw, variance, &frame.alpha, exposure));
            }
            let rendered = methods.render(index, cancel)?;
            let reference = metrics::Truth::new(&truth, Some(&frame.alpha), Some(Hdr { linear, exposure }), options.lpips)?;
            let moved = before.as_ref().filter(|before| before.number + 1 == number).map(|before| {
                let movement = sequence.transforms.tracks.between(index, before.index);
                (before, correspondence(&frame, &before.frame, movement))
            });
            let measured: Vec<(Picture, Rgb, Metrics)> = rendered
                .into_par_iter()
                .with_max_len(1)
                .map(|rendered| {
                    let picture = display(&rendered.linear);
                    let mut metrics = reference.measure(&picture, Some(Hdr { linear: &rendered.linear, exposure }))?;
                    if let Some((before, correspondence)) = &moved
                        && let Some(earlier) = before.pictures.get(&rendered.id)
                    {
                        let (now, then) =
                            (Pair { picture: &picture, truth: &truth }, Pair { picture: earlier, truth: &before.truth });
                        metrics.temporal = temporal(now, then, correspondence).map(|t| 1000.0 * t);
                    }
                    Ok((rendered, picture, metrics))
                })
                .collect::<Result<_>>()?;
            let mut displayed = BTreeMap::new();
            claim.write()?;
            // What is there of other data is no longer complete.
            forget(&class.join(format!("{}.json", sequence.name)))?;
            if shown.contains(&index) {
                file::write_atomic(&pictures.join(picture_file(number, TRUTH)), &picture::png(&truth)?)?;
            }
            for (rendered, shown_as, metrics) in measured {
                if shown.contains(&index) {
                    file::write_atomic(&pictures.join(picture_file(number, &rendered.id)), &picture::png(&shown_as)?)?;
                }
                let seconds = Some(rendered.seconds);
                scores.push(Score {
                    method: rendered.id.clone(),
                    frame: number,
                    key,
                    seconds,
                    spp: rendered.spp,
                    values: values(&metrics)?,
                });
                displayed.insert(rendered.id, shown_as);
            }
            drop(reference);
            before = Some(Before { number, index, frame, truth, pictures: displayed });
            progress.add(1);
        }
        write_scores(&class.join(format!("{}.jsonl", sequence.name)), &scores)?;
        let numbers = |indices: &[usize]| indices.iter().map(|&i| sequence.numbers[i]).collect::<Vec<_>>();
        let size = sequence.camera(first);
        Ok(SequenceSummary {
            set: test.set.clone(),
            class: test.class.clone(),
            name: sequence.name.clone(),
            data: None,
            width: size.width,
            height: size.height,
            frames: numbers(indices),
            keyframes: numbers(&sequence.transforms.keyframes).into_iter().filter(|n| numbers(indices).contains(n)).collect(),
            keyframe_gap: keyframe_gap(&sequence.transforms.keyframes, sequence.len()),
            keyframe_share: keyframe_share(&sequence.transforms.keyframes, sequence.len()),
            shown: numbers(&shown),
            exposure,
            facts: facts(test),
            truth: Truth {
                spp: sequence.frame(first)?.info.spp,
                // JSON has no NaN.
                noise: Some(decibel(noise.iter().sum::<f64>() / noise.len() as f64)).filter(|noise| !noise.is_nan()),
                ..told(sequence)
            },
            once: methods.once(),
        })
    }
}

/// What the folder of a sequence tells about its truth: seconds, and the error that an audit found.
fn told(sequence: &Sequence) -> Truth {
    let known = |seconds: Vec<f64>| Some(median(&seconds)).filter(|s| s.is_finite());
    let keyframes: Vec<usize> = sequence.transforms.keyframes.iter().map(|&i| sequence.numbers[i]).collect();
    let audit: Option<Audit> = file::read_json(&sequence.folder.join(AUDIT)).ok();
    Truth {
        seconds: known(job::seconds(&sequence.folder)),
        keyframe_seconds: known(job::seconds_of(&sequence.folder, &keyframes)),
        error: audit.map(|audit| audit.error),
        ..Truth::default()
    }
}

/// Frames for each keyframe in a sequence of `frames`; with several keyframes `keys`, their distance.
fn keyframe_gap(keys: &[usize], frames: usize) -> Option<f64> {
    match keys {
        [] => None,
        [_] => Some(frames as f64),
        [first, .., last] => Some((last.abs_diff(*first)) as f64 / (keys.len() - 1) as f64),
    }
}

/// The share of keyframes among the `frames` of a sequence.
fn keyframe_share(keys: &[usize], frames: usize) -> Option<f64> {
    (!keys.is_empty()).then(|| keys.len() as f64 / frames as f64)
}

/// Removes the summary of a sequence, if there is one.
pub(super) fn forget(summary: &Path) -> Result<()> {
    match std::fs::remove_file(summary) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            Err(error).with_context(|| format!("{}: cannot remove", summary.display()))
        }
        _ => Ok(()),
    }
}

/// Writes one score on each line.
pub fn write_scores(path: &Path, scores: &[Score]) -> Result<()> {
    let mut text = String::new();
    for score in scores {
        text += &serde_json::to_string(score)?;
        text.push('\n');
    }
    Ok(file::write_atomic(path, text.as_bytes())?)
}

/// Describes the scene of a sequence in words.
fn facts(test: &TestSequence) -> Vec<(String, String)> {
    let Some(record) = &test.sequence.record else { return Vec::new() };
    let Record { layout, camera, moving, changing, environment, objects, materials, triangles, .. } = record;
    let change = match (moving, changing) {
        (true, true) => "objects move, materials change",
        (true, false) => "objects move",
        (false, true) => "materials change",
        _ => "none but the camera's",
    };
    let light = environment.family.rsplit('/').next().unwrap_or_default();
    let [all, textured, metal] = materials;
    let facts = [
        ("layout", layout.clone()),
        ("camera", camera.clone()),
        ("change", change.to_owned()),
        ("light", format!("{light}, concentration {:.1}", environment.concentration)),
        ("objects", objects.len().to_string()),
        ("triangles", triangles.to_string()),
        ("materials", format!("{all}, {textured} textured, {metal} metal")),
    ];
    facts.map(|(name, value)| (name.to_owned(), value)).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_come_in_pairs() {
        let numbers: Vec<usize> = (0..12).collect();
        assert_eq!(chosen(numbers.len(), 1), numbers);
        assert_eq!(chosen(numbers.len(), 5), [0, 1, 5, 6, 10, 11]);
        assert_eq!(chosen(numbers.len(), 0), numbers);
    }

    /// A denoised truth comes as it was traced where that is asked for, and one that was not denoised is itself.
    #[test]
    fn truth_comes_denoised_or_raw() {
        let [clean, noisy] = [0.5, 0.25].map(|v| Rgb::filled(2, 1, [v; 3]));
        let mut frame = Frame { beauty: Some(clean.clone()), ..Frame::default() };
        let shown = |frame: &Frame| [false, true].map(|raw| truth_of(frame, raw).ok().cloned());
        assert_eq!(shown(&frame), [Some(clean.clone()), Some(clean.clone())]);
        frame.info.denoiser = Some("OIDN".into());
        assert_eq!(shown(&frame), [Some(clean.clone()), None]);
        frame.raw = Some(noisy.clone());
        assert_eq!(shown(&frame), [Some(clean), Some(noisy)]);
        assert_eq!(shown(&Frame::default()), [None, None]);
    }

    #[test]
    fn pictures_are_of_frames_between_keyframes() {
        let all: Vec<usize> = (0..33).collect();
        let displayed = shown(&all, &[0, 16, 32], 3);
        assert_eq!(displayed.len(), 3);
        assert!(displayed.iter().all(|i| i % 16 != 0) && displayed.windows(2).all(|w| w[0] < w[1]), "{displayed:?}");
        assert_eq!(shown(&[0, 1], &[0, 1], 5), [0, 1]);
        assert_eq!(shown(&all, &[], 0), Vec::<usize>::new());
    }

    #[test]
    fn keyframes_share_the_frames() {
        assert_eq!([keyframe_gap(&[], 50), keyframe_gap(&[0], 9)], [None, Some(9.0)]);
        assert_eq!(keyframe_gap(&[0, 16, 32, 48], 50), Some(16.0));
        assert_eq!(keyframe_gap(&[0, 4, 9], 10), Some(4.5));
        assert_eq!([keyframe_share(&[], 50), keyframe_share(&[0, 25], 50)], [None, Some(0.04)]);
    }
}
