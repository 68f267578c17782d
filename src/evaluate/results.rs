//! What an evaluation leaves behind, and all that tables, plots and the report are made from.
//!
//! ```text
//! RESULTS/results.json                           About: methods, settings, machine
//! RESULTS/<set>/<class>/<sequence>.json          Sequence: written last, so one that has it is complete
//! RESULTS/<set>/<class>/<sequence>.jsonl         a Score a line: one method on one frame
//! RESULTS/<set>/<class>/<sequence>/0007.ibl.png  display values of frame 7 by method `ibl`; `truth` is the reference
//! ```

use anyhow::{Context, Result, ensure};
use renderflow_frame::reach::plain_name;
use renderflow_frame::{file, words};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// File of [`About`].
pub const ABOUT: &str = "results.json";
/// Pixels of the pictures that a budget's seconds are for, 256 x 256; others are given seconds in proportion to theirs.
pub const BUDGET_PIXELS: f64 = 65536.0;
/// Version of the format: since 2 a method says what it reads and what it is measured against, which was told from names before.
pub const VERSION: u32 = 2;
/// Stands for the reference where pictures are named by method.
pub const TRUTH: &str = "truth";

/// A metric as tables name it.
#[derive(Clone, Copy, Debug)]
pub struct Metric {
    /// Key in [`Score::values`].
    pub id: &'static str,
    /// Head of a column.
    pub label: &'static str,
    /// What it is, in a sentence.
    pub meaning: &'static str,
    /// Digits after the point.
    pub digits: usize,
    /// Whether more is better.
    pub rising: bool,
}

/// Every metric, in the order of columns.
pub const METRICS: &[Metric] = &[
    Metric { id: "psnr", label: "PSNR", meaning: "dB over pixels that an object covers; 100 at most", digits: 2, rising: true },
    Metric {
        id: "psnr_full",
        label: "PSNR full",
        meaning: "dB over the full frame with the environment behind",
        digits: 2,
        rising: true,
    },
    Metric { id: "ssim", label: "SSIM", meaning: "structural similarity, full frame", digits: 4, rising: true },
    Metric {
        id: "ssim_object",
        label: "SSIM object",
        meaning: "structural similarity at covered pixels",
        digits: 4,
        rising: true,
    },
    Metric {
        id: "lpips_alex",
        label: "LPIPS",
        meaning: "learned perceptual distance (AlexNet), full frame",
        digits: 4,
        rising: false,
    },
    Metric {
        id: "lpips_squeeze",
        label: "LPIPS squeeze",
        meaning: "learned perceptual distance (SqueezeNet), full frame",
        digits: 4,
        rising: false,
    },
    Metric {
        id: "flip",
        label: "FLIP",
        meaning: "difference seen when two pictures are flipped, full frame",
        digits: 4,
        rising: false,
    },
    Metric { id: "flip_object", label: "FLIP object", meaning: "the same over covered pixels", digits: 4, rising: false },
    Metric {
        id: "rel_mse",
        label: "relMSE",
        meaning: "mean of squared error over squared truth + 0.01, exposed linear radiance, full frame",
        digits: 4,
        rising: false,
    },
    Metric { id: "rel_mse_object", label: "relMSE object", meaning: "the same over covered pixels", digits: 4, rising: false },
    Metric {
        id: "rel_mse_robust",
        label: "relMSE robust",
        meaning: "the same without the 0.1 % of pixels with the largest error, full frame",
        digits: 4,
        rising: false,
    },
    Metric {
        id: "temporal",
        label: "temporal",
        meaning: "mean difference of what changes from the frame before, both carried by the truth's motion; 1000 = white",
        digits: 2,
        rising: false,
    },
];

/// What tables and plots say of a method.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MethodInfo {
    /// Short name in files: letters, digits, `-`, `_`, `.`, `+`.
    pub id: String,
    /// Name in tables.
    pub label: String,
    /// What it belongs with.
    pub group: Group,
    /// Methods of one series are joined by a line in plots of error against time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub series: Option<String>,
    /// Samples a pixel, for rows of path tracing with a fixed number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spp: Option<u32>,
    /// Seconds that a picture of [`BUDGET_PIXELS`] may take, for rows of a budget.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<f64>,
    /// Whether it reads the truth of keyframes, whose seconds are then its own too.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub reads_keyframes: bool,
    /// Id of the method whose seconds it is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_of: Option<String>,
    /// Id of the method that it is a part of, or a change of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part_of: Option<String>,
    /// What one should know about it, in a sentence.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
}

impl MethodInfo {
    /// A method of which nothing more is to be said.
    pub fn new(id: String, label: String, group: Group) -> Self {
        Self {
            id,
            label,
            group,
            series: None,
            spp: None,
            budget: None,
            reads_keyframes: false,
            time_of: None,
            part_of: None,
            note: String::new(),
        }
    }
}

/// Kinds of methods.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Group {
    /// No network, no rays beyond the camera's.
    Baseline,
    /// A baseline with a part switched off or on, to see what the part is worth.
    Ablation,
    /// The network.
    Neural,
    /// Path tracing.
    PathTraced,
    /// Path tracing given the seconds of another method.
    EqualTime,
    /// Path tracing given seconds.
    Budget,
    /// Pictures from elsewhere.
    Other,
}

impl Group {
    /// Whether paths make the picture.
    pub fn is_traced(self) -> bool {
        matches!(self, Self::PathTraced | Self::EqualTime | Self::Budget)
    }
}

/// The whole evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct About {
    /// Format version, [`VERSION`].
    pub version: u32,
    /// Program and its version.
    pub program: String,
    /// Heading of the report.
    pub title: String,
    /// Name of the processor, and threads used.
    pub machine: String,
    /// How radiance becomes the display values that metrics see.
    pub curve: String,
    /// In the order of table rows.
    pub methods: Vec<MethodInfo>,
    /// Name and value of every setting.
    pub settings: Vec<(String, String)>,
}

/// One sequence.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sequence {
    /// Test set it belongs to.
    pub set: String,
    /// Class of scene.
    pub class: String,
    /// Folder name.
    pub name: String,
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// Numbers of the frames evaluated.
    pub frames: Vec<usize>,
    /// Numbers of those that are keyframes.
    pub keyframes: Vec<usize>,
    /// Frames of the whole sequence for each of its keyframes: their distance where there are several. `None` without keyframes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub keyframe_gap: Option<f64>,
    /// Numbers of the frames whose pictures are kept.
    pub shown: Vec<usize>,
    /// Factor from radiance to display-linear.
    pub exposure: f32,
    /// Name and value of what the scene is like (layout, camera, light, triangles, ...).
    pub facts: Vec<(String, String)>,
    /// What the reference is.
    pub truth: Truth,
    /// Seconds spent once a sequence before the first frame, by what they were spent on: in no frame's seconds.
    pub once: Vec<(String, f64)>,
}

/// The reference of a sequence.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Samples a pixel.
    pub spp: u32,
    /// Median seconds a frame, where they were kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// Median seconds of a keyframe, where they were kept: its frames may have more samples than those between.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub keyframe_seconds: Option<f64>,
    /// PSNR (object) that the noise left in the raw picture would score against a perfect one, dB; from its variance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<f64>,
    /// PSNR (object) that the reference as it is would score against a perfect one, dB, where a longer render was made to tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<f64>,
}

impl Sequence {
    /// Seconds a frame that the truth of keyframes costs a method that reads it: theirs, shared over their gap. `None` where they were not
    /// kept or there are no keyframes.
    pub fn truth_share(&self) -> Option<f64> {
        let seconds = self.truth.keyframe_seconds.or(self.truth.seconds)?;
        let gap = self.keyframe_gap.filter(|gap| *gap > 0.0)?;
        Some(seconds / gap).filter(|share| share.is_finite())
    }
}

/// One method on one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Id of the method.
    pub method: String,
    /// Number of the frame.
    pub frame: usize,
    /// Whether it is a keyframe.
    pub key: bool,
    /// Wall seconds for this picture from the scene in memory; `None` for pictures from elsewhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// Samples a pixel, for path tracing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spp: Option<u32>,
    /// Value of each metric in [`METRICS`] that could be computed.
    pub values: BTreeMap<String, f64>,
}

/// A complete sequence with its scores.
#[derive(Clone, Debug, PartialEq)]
pub struct Scored {
    /// The sequence.
    pub about: Sequence,
    /// Folder of its pictures.
    pub pictures: PathBuf,
    /// One entry a method and frame.
    pub scores: Vec<Score>,
}

/// A results folder.
#[derive(Clone, Debug, PartialEq)]
pub struct Results {
    /// The whole.
    pub about: About,
    /// Complete sequences, by set, class and name.
    pub sequences: Vec<Scored>,
}

/// File name of a picture in the folder of its sequence.
pub fn picture_file(frame: usize, method: &str) -> String {
    format!("{frame:04}.{method}.png")
}

impl Results {
    /// Reads a results folder; sequences that are not complete are left out.
    ///
    /// # Errors
    /// When a file cannot be read; the message names it and the line.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(ABOUT);
        let about: About = file::read_json(&path)?;
        let version = about.version;
        ensure!(version == VERSION, "{}: /version: {version} is not {VERSION}: evaluate again with this program", path.display());
        for (i, method) in about.methods.iter().enumerate() {
            // Names of pictures are made of them.
            plain_name(&method.id).map_err(|reason| anyhow::anyhow!("{}: /methods/{i}/id: {reason}", path.display()))?;
        }
        let mut sequences = Vec::new();
        for set in folders(folder)? {
            for class in folders(&set)? {
                for file in list(&class)?.into_iter().filter(|path| path.extension().is_some_and(|e| e == "json")) {
                    let scores = read_scores(&file.with_extension("jsonl"))?;
                    let about = file::read_json(&file)?;
                    sequences.push(Scored { about, pictures: file.with_extension(""), scores });
                }
            }
        }
        Ok(Self { about, sequences })
    }
}

/// Reads a score a line.
pub fn read_scores(path: &Path) -> Result<Vec<Score>> {
    let text = file::read_text(path)?;
    let line = |(i, line)| {
        // Every entry is a line of its own: only the column is worth telling.
        let reason = |e: serde_json::Error| words::plain(&e.to_string()).replace(" at line 1 column ", ", column ");
        serde_json::from_str(line).map_err(|e| anyhow::anyhow!("{}: line {}: {}", path.display(), i + 1, reason(e)))
    };
    text.lines().enumerate().map(line).collect()
}

fn folders(path: &Path) -> Result<Vec<PathBuf>> {
    Ok(list(path)?.into_iter().filter(|path| path.is_dir()).collect())
}

fn list(path: &Path) -> Result<Vec<PathBuf>> {
    let unreadable = || format!("{}: cannot list", path.display());
    let entries = std::fs::read_dir(path).with_context(unreadable)?;
    let mut paths = entries.map(|entry| Ok(entry.with_context(unreadable)?.path())).collect::<Result<Vec<_>>>()?;
    paths.sort();
    Ok(paths)
}
