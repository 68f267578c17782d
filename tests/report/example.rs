//! A small results folder made up for tests: two sets, three classes, four sequences, values one can compute by head.

use renderflow::evaluate::results::{About, Group, MethodInfo, Score, SequenceSummary, TRUTH, Truth, VERSION, picture_file};
use renderflow::metrics::METRICS;
use renderflow::util::picture::png;
use renderflow_frame::file::{write_atomic, write_json};
use renderflow_frame::image::Rgb;
use std::path::Path;

/// What tries to get out of its element.
pub const NASTY: &str = "a <b> & \"c\" 'd' </script><script>x</script>";

/// Frames of every sequence; 0 and 4 are keyframes.
const FRAMES: usize = 5;
const SIZE: (usize, usize) = (48, 32);

/// Set, class, name, and what its PSNR is above the method's.
const SEQUENCES: [(&str, &str, &str, f64); 4] = [
    ("assets", "foliage", "leaves", 0.0),
    ("synthetic", "open", "first", 1.0),
    ("synthetic", "rooms & halls", "second <&\">", 3.0),
    ("synthetic", "open", "third", 2.0),
];

fn method(id: &str, label: &str, group: Group, series: Option<&str>, spp: Option<u32>) -> MethodInfo {
    let budget = (group == Group::Budget).then_some(4.0);
    let series = series.map(Into::into);
    MethodInfo { series, spp, budget, ..MethodInfo::new(id.into(), label.into(), group) }
}

pub fn methods() -> Vec<MethodInfo> {
    let mut methods = vec![
        method("ibl", "IBL", Group::Baseline, None, None),
        method("deferred", NASTY, Group::Baseline, None, None),
        method("deferred-shadow", "Deferred without shadow", Group::Ablation, None, None),
        method("neural", "Neural", Group::Neural, None, None),
        method("pt-1", "Path tracing 1 spp", Group::PathTraced, Some("Path tracing"), Some(1)),
        method("pt-4", "Path tracing 4 spp", Group::PathTraced, Some("Path tracing"), Some(4)),
        method("equal-neural", "Path tracing in the time of Neural", Group::EqualTime, None, None),
        method("warp", "Warped", Group::Baseline, None, None),
        // Of 256 x 256 pixels; the example's 48 x 32 are given 93.75 ms.
        method("pt-4000ms", "Path tracing in 4 s", Group::Budget, Some("Path tracing in a budget"), None),
    ];
    methods[2].part_of = Some("deferred".into());
    methods[6].time_of = Some("neural".into());
    methods[7].reads_keyframes = true;
    methods
}

/// PSNR of method number `method` on a frame that is no keyframe: 20, 22, ... plus the sequence's part, frames 1 to 3 at -1, 0,
/// +1.
fn psnr(method: usize, sequence: f64, frame: usize) -> f64 {
    20.0 + 2.0 * method as f64 + sequence + (frame as f64 - 2.0)
}

fn score(number: usize, method: &MethodInfo, part: f64, frame: usize) -> Score {
    let key = frame.is_multiple_of(4);
    let mut values = std::collections::BTreeMap::new();
    for metric in METRICS {
        let value = match metric.id {
            // Keyframes count nowhere: 100 would show.
            "psnr" | "psnr_full" if key => Some(100.0),
            "psnr" => Some(psnr(number, part, frame)),
            "psnr_full" => Some(psnr(number, part, frame) + 1.0),
            "temporal" if frame == 0 => None,
            // LPIPS could not be computed; the baseline without HDR output has no relMSE.
            "lpips_alex" | "lpips_squeeze" => None,
            "rel_mse" | "rel_mse_object" if method.id == "ibl" => None,
            _ => Some(0.5 / (1.0 + number as f64)),
        };
        if let Some(value) = value {
            values.insert(metric.id.to_owned(), value);
        }
    }
    // Dearer scenes: 10 times the part of the PSNR in milliseconds.
    let seconds = Some(0.01 * (1 + number) as f64 + 0.001 * frame as f64 + 0.01 * part);
    // What the time allows differs from frame to frame: 8 samples on average over frames that are no keyframes.
    let timed = matches!(method.group, Group::EqualTime | Group::Budget);
    let spp = if timed { Some(6 + frame as u32) } else { method.spp };
    Score { method: method.id.clone(), frame, key, seconds, spp, values }
}

/// A ramp that each method renders a little wrong, another way on each frame.
fn picture(frame: usize, method: usize) -> Rgb {
    let (width, height) = SIZE;
    Rgb::from_fn(width, height, |x, y| {
        let ramp = [x as f32 / width as f32, y as f32 / height as f32, frame as f32 / FRAMES as f32];
        let wrong = if (x / 4 + y / 4).is_multiple_of(2) { 0.03 * method as f32 } else { 0.0 };
        ramp.map(|v| (v + wrong).min(1.0))
    })
}

/// Writes the folder.
pub fn write(folder: &Path) {
    let methods = methods();
    let about = About {
        version: VERSION,
        program: "renderflow test".into(),
        title: "Example <results>".into(),
        machine: "a processor, 4 threads".into(),
        lpips: None,
        curve: "sRGB of exposed, clamped radiance".into(),
        methods: methods.clone(),
        settings: vec![("gap".into(), "4".into()), ("note".into(), NASTY.into())],
        sequences: None,
    };
    write_json(&folder.join("results.json"), &about).unwrap();
    for (set, class, name, part) in SEQUENCES {
        let place = folder.join(set).join(class.replace(' ', "_"));
        let stem = name.split(' ').next().unwrap();
        let mut lines = String::new();
        for frame in 0..FRAMES {
            // The last method was not run on the last sequence.
            for (number, method) in methods.iter().enumerate().filter(|(_, m)| !(m.id == "pt-4" && name == "third")) {
                lines += &(serde_json::to_string(&score(number, method, part, frame)).unwrap() + "\n");
                let file = place.join(stem).join(picture_file(frame, &method.id));
                write_atomic(&file, &png(&picture(frame, number + 1)).unwrap()).unwrap();
            }
            let file = place.join(stem).join(picture_file(frame, TRUTH));
            write_atomic(&file, &png(&picture(frame, 0)).unwrap()).unwrap();
        }
        write_atomic(&place.join(format!("{stem}.jsonl")), lines.as_bytes()).unwrap();
        let sequence = SequenceSummary {
            set: set.into(),
            class: class.into(),
            name: name.into(),
            data: None,
            width: SIZE.0,
            height: SIZE.1,
            frames: (0..FRAMES).collect(),
            keyframes: vec![0, 4],
            keyframe_gap: Some(4.0),
            keyframe_share: Some(0.4),
            shown: (0..FRAMES).collect(),
            exposure: 1.25,
            facts: vec![("light".into(), NASTY.into()), ("triangles".into(), "1234".into())],
            truth: Truth {
                spp: 256,
                seconds: Some(2.5),
                keyframe_seconds: Some(3.0),
                noise: Some(45.0 + part),
                error: (part > 1.5).then_some(48.0),
            },
            once: vec![("prefiltering".into(), 0.25)],
        };
        write_json(&place.join(format!("{stem}.json")), &sequence).unwrap();
    }
}
