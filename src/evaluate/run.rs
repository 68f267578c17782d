//! Evaluates methods on sequences: one after the other on all threads, so that their seconds are their own; then all metrics at once.

use super::find::TestSequence;
use super::method::Method;
use super::renderer::{self, MethodRenderer, Picture};
use super::results::{ABOUT, About, METRICS, Score, Sequence, TRUTH, Truth, VERSION, picture_file};
use crate::dataset::SequenceView;
use crate::dataset::record::Record;
use crate::metrics::temporal::{Pair, correspondence, temporal};
use crate::metrics::{self, Hdr, Metrics, Networks, median};
use crate::output::Claim;
use crate::progress::Progress;
use crate::report::picture;
use crate::testset::{AUDIT, Audit, decibel, display_variance};
use crate::truth::Interrupted;
use anyhow::{Context, Result, bail, ensure};
use rayon::prelude::*;
use renderflow_frame::image::Rgb;
use renderflow_frame::{Frame, color, file};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// How radiance becomes what the metrics see.
pub const CURVE: &str =
    "sRGB(clamp(exposure x linear, 0, 1)), exposure from the environment alone; metrics on floats, not quantised";

/// Said of a frame of G-buffers only.
const NO_BEAUTY: &str = "no beauty to compare with";

/// What to evaluate, and how.
pub struct Options<'a> {
    /// The methods and what they need.
    pub rendering: renderer::Options<'a>,
    /// LPIPS where its weights are there.
    pub lpips: &'a Networks,
    /// Of every so many frames the first two; 1 = all. Two, since what changes between frames is measured too.
    pub every: u32,
    /// Frames a sequence whose pictures are kept.
    pub pictures: usize,
    /// Heading of the report.
    pub title: String,
    /// Settings beyond these, for the report.
    pub settings: Vec<(String, String)>,
}

/// Evaluates `tests` into the results folder `out`; sequences that are complete there are kept. One unit of `progress` a frame.
///
/// # Errors
/// [`Interrupted`] when stopped; when the folder holds results of other methods or settings; when a sequence cannot be read or lacks truth.
pub fn run(tests: &[TestSequence], options: &Options, out: &Path, progress: &Progress, cancel: &AtomicBool) -> Result<()> {
    let claim = claim(options, out)?;
    for test in tests {
        ready(test, options.every).with_context(|| test.folder.path.display().to_string())?;
    }
    for test in tests {
        let class = out.join(&test.set).join(&test.class);
        let done = class.join(format!("{}.json", test.folder.name()));
        let indices = chosen(&test.folder.numbers, options.every);
        let there: Option<Sequence> = file::read_json(&done).ok();
        let numbers: Vec<usize> = indices.iter().map(|&i| test.folder.numbers[i]).collect();
        if there.is_some_and(|there| there.frames == numbers) {
            progress.resume(indices.len() as u64);
            continue;
        }
        progress.message(format!("{}/{}/{}", test.set, test.class, test.folder.name()));
        let work = || sequence(test, &indices, options, &class, &claim, progress, cancel);
        let about = work().with_context(|| test.folder.path.display().to_string())?;
        file::write_json(&done, &about)?;
    }
    Ok(())
}

/// Frames of a sequence that are evaluated where of every `every` frames the first two are.
pub fn frames(test: &TestSequence, every: u32) -> usize {
    chosen(&test.folder.numbers, every).len()
}

/// Checks that results of these options may be written into the folder `out`.
///
/// # Errors
/// When the folder holds results of other methods or settings, or anything else.
pub fn check(options: &Options, out: &Path) -> Result<()> {
    claim(options, out).map(drop)
}

/// Checks that the truth of a sequence can be compared with, as far as its files and its record tell.
fn ready(test: &TestSequence, every: u32) -> Result<()> {
    for index in chosen(&test.folder.numbers, every) {
        let file = &test.folder.sequence.files[index];
        ensure!(test.folder.path.join(file).is_file(), "{file}: is not there");
        let recorded = test.record.iter().flat_map(|record| &record.frames).find(|frame| frame.file == *file);
        ensure!(recorded.is_none_or(|frame| frame.spp > 0), "frame {} has {NO_BEAUTY}", test.folder.numbers[index]);
    }
    Ok(())
}

/// What the results are of, to be written before the first of them.
fn claim(options: &Options, out: &Path) -> Result<Claim> {
    let mut settings = vec![
        ("camera rays a pixel of the G-buffer".to_owned(), options.rendering.guide_samples.to_string()),
        ("scattering events of a path".to_owned(), options.rendering.max_bounces.to_string()),
        (
            "frames".to_owned(),
            match options.every {
                1 => "all".to_owned(),
                every => format!("two of every {every}"),
            },
        ),
    ];
    settings.extend(options.settings.iter().cloned());
    let about = About {
        version: VERSION,
        program: concat!("renderflow ", env!("CARGO_PKG_VERSION")).into(),
        title: options.title.clone(),
        machine: format!("{}, {} threads", crate::machine::processor(), rayon::current_num_threads()),
        curve: CURVE.into(),
        methods: options.rendering.methods.iter().map(Method::describe).collect(),
        settings,
    };
    Claim::agreed(out, ABOUT, &about, |there: &About| {
        let same = (&there.methods, &there.settings) == (&about.methods, &about.settings);
        ensure!(same, "the folder holds results of other methods or settings; choose another folder");
        Ok(())
    })
}

/// Indices of the frames to evaluate: of every `every` the first two.
fn chosen(numbers: &[usize], every: u32) -> Vec<usize> {
    (0..numbers.len()).filter(|i| (i % every.max(1) as usize) < 2).collect()
}

/// Spread evenly over the frames that are no keyframes (all, where every one is).
fn shown(indices: &[usize], keyframes: &[usize], count: usize) -> Vec<usize> {
    let between: Vec<usize> = indices.iter().copied().filter(|i| !keyframes.contains(i)).collect();
    let from = if between.is_empty() { indices } else { &between };
    let count = count.min(from.len());
    (0..count).map(|k| from[(2 * k + 1) * from.len() / (2 * count)]).collect()
}

/// A frame evaluated, kept for the next one.
struct Before {
    number: usize,
    index: usize,
    frame: Frame,
    truth: Rgb,
    pictures: BTreeMap<String, Rgb>,
}

fn sequence(
    test: &TestSequence,
    indices: &[usize],
    options: &Options,
    class: &Path,
    claim: &Claim,
    progress: &Progress,
    cancel: &AtomicBool,
) -> Result<Sequence> {
    let folder = &test.folder;
    let Some(&first) = indices.first() else { bail!("has no frames") };
    let exposure = folder.sequence.exposure;
    let view = SequenceView::new(folder);
    let mut methods = MethodRenderer::new(&view, &options.rendering)?;
    let shown = shown(indices, &folder.sequence.keyframes, options.pictures);
    let pictures = class.join(folder.name());
    let (mut scores, mut before, mut noise): (Vec<Score>, Option<Before>, Vec<f64>) = Default::default();
    for &index in indices {
        if cancel.load(Ordering::Relaxed) {
            return Err(Interrupted.into());
        }
        let (number, key) = (folder.numbers[index], folder.sequence.keyframes.contains(&index));
        let frame = folder.frame(index)?;
        let linear = frame.beauty.as_ref().with_context(|| format!("frame {number} has {NO_BEAUTY}"))?;
        let display = |picture: &Rgb| picture.map(|p| color::display(*p, exposure));
        let truth = display(linear);
        if let (Some(raw), Some(variance)) = (&frame.raw, &frame.variance) {
            noise.extend(display_variance(raw, variance, &frame.alpha, exposure));
        }
        let made = methods.render(index, cancel)?;
        let reference = metrics::Truth::new(&truth, Some(&frame.alpha), Some(Hdr { linear, exposure }), options.lpips)?;
        let moved = before.as_ref().filter(|before| before.number + 1 == number).map(|before| {
            let movement = folder.sequence.tracks.between(index, before.index);
            (before, correspondence(&frame, &before.frame, movement))
        });
        let measured: Vec<(Picture, Rgb, Metrics)> = made
            .into_par_iter()
            .with_max_len(1)
            .map(|made| {
                let picture = display(&made.linear);
                let mut metrics = reference.measure(&picture, Some(Hdr { linear: &made.linear, exposure }))?;
                if let Some((before, correspondence)) = &moved
                    && let Some(earlier) = before.pictures.get(&made.id)
                {
                    let (now, then) =
                        (Pair { picture: &picture, truth: &truth }, Pair { picture: earlier, truth: &before.truth });
                    metrics.temporal = temporal(now, then, correspondence).map(|t| 1000.0 * t);
                }
                Ok((made, picture, metrics))
            })
            .collect::<Result<_>>()?;
        let mut kept = BTreeMap::new();
        claim.write()?;
        if shown.contains(&index) {
            file::write_atomic(&pictures.join(picture_file(number, TRUTH)), &picture::png(&truth)?)?;
        }
        for (made, shown_as, metrics) in measured {
            if shown.contains(&index) {
                file::write_atomic(&pictures.join(picture_file(number, &made.id)), &picture::png(&shown_as)?)?;
            }
            let seconds = Some(made.seconds);
            scores.push(Score { method: made.id.clone(), frame: number, key, seconds, spp: made.spp, values: values(&metrics)? });
            kept.insert(made.id, shown_as);
        }
        drop(reference);
        before = Some(Before { number, index, frame, truth, pictures: kept });
        progress.add(1);
    }
    write_scores(&class.join(format!("{}.jsonl", folder.name())), &scores)?;
    let numbers = |indices: &[usize]| indices.iter().map(|&i| folder.numbers[i]).collect::<Vec<_>>();
    let size = folder.camera(first);
    let error: Option<Audit> = file::read_json(&folder.path.join(AUDIT)).ok();
    Ok(Sequence {
        set: test.set.clone(),
        class: test.class.clone(),
        name: folder.name(),
        width: size.width,
        height: size.height,
        frames: numbers(indices),
        keyframes: numbers(&folder.sequence.keyframes).into_iter().filter(|n| numbers(indices).contains(n)).collect(),
        keyframe_gap: keyframe_gap(&folder.sequence.keyframes, folder.len()),
        shown: numbers(&shown),
        exposure,
        facts: facts(test),
        truth: Truth {
            spp: folder.frame(first)?.info.spp,
            seconds: Some(median(&crate::truth::seconds(&folder.path))).filter(|s| s.is_finite()),
            keyframe_seconds: Some(median(&crate::truth::seconds_of(&folder.path, &numbers(&folder.sequence.keyframes))))
                .filter(|s| s.is_finite()),
            noise: (!noise.is_empty()).then(|| decibel(noise.iter().sum::<f64>() / noise.len() as f64)),
            error: error.map(|audit| audit.error),
        },
        once: methods.once(),
    })
}

/// Frames for each keyframe of a sequence of `frames`: the distance of its keyframes `keys` where there are several.
fn keyframe_gap(keys: &[usize], frames: usize) -> Option<f64> {
    match keys {
        [] => None,
        [_] => Some(frames as f64),
        [first, .., last] => Some((last.abs_diff(*first)) as f64 / (keys.len() - 1) as f64),
    }
}

/// Metrics by the name they have in [`METRICS`].
pub fn values(metrics: &Metrics) -> Result<BTreeMap<String, f64>> {
    let serde_json::Value::Object(fields) = serde_json::to_value(metrics)? else { return Ok(BTreeMap::new()) };
    let known = |id: &str| METRICS.iter().any(|metric| metric.id == id);
    Ok(fields.into_iter().filter_map(|(id, value)| Some((id, value.as_f64()?))).filter(|(id, _)| known(id)).collect())
}

/// Writes a score a line.
pub fn write_scores(path: &Path, scores: &[Score]) -> Result<()> {
    let mut text = String::new();
    for score in scores {
        text += &serde_json::to_string(score)?;
        text.push('\n');
    }
    Ok(file::write_atomic(path, text.as_bytes())?)
}

/// What the scene of a sequence is like, in words.
fn facts(test: &TestSequence) -> Vec<(String, String)> {
    let Some(record) = &test.record else { return Vec::new() };
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
        assert_eq!(chosen(&numbers, 1), numbers);
        assert_eq!(chosen(&numbers, 5), [0, 1, 5, 6, 10, 11]);
        assert_eq!(chosen(&numbers, 0), numbers);
    }

    #[test]
    fn pictures_are_of_frames_between_keyframes() {
        let all: Vec<usize> = (0..33).collect();
        let kept = shown(&all, &[0, 16, 32], 3);
        assert_eq!(kept.len(), 3);
        assert!(kept.iter().all(|i| i % 16 != 0) && kept.windows(2).all(|w| w[0] < w[1]), "{kept:?}");
        assert_eq!(shown(&[0, 1], &[0, 1], 5), [0, 1]);
        assert_eq!(shown(&all, &[], 0), Vec::<usize>::new());
    }

    #[test]
    fn keyframes_share_the_frames() {
        assert_eq!([keyframe_gap(&[], 50), keyframe_gap(&[0], 9)], [None, Some(9.0)]);
        assert_eq!(keyframe_gap(&[0, 16, 32, 48], 50), Some(16.0));
        assert_eq!(keyframe_gap(&[0, 4, 9], 10), Some(4.5));
    }

    #[test]
    fn every_metric_has_a_column() {
        let one = serde_json::to_value(Metrics::default()).unwrap();
        let fields: Vec<&String> = one.as_object().unwrap().keys().collect();
        for metric in METRICS {
            assert!(fields.contains(&&metric.id.to_owned()), "{}", metric.id);
        }
        assert_eq!(fields.len(), METRICS.len());
    }
}
