//! What an evaluation leaves behind, and all that tables, plots and the report are made from.
//!
//! ```text
//! RESULTS/results.json                           About: methods, settings, machine
//! RESULTS/<set>/<class>/<sequence>.json          SequenceSummary: written last, so one that has it is complete
//! RESULTS/<set>/<class>/<sequence>.jsonl         a Score a line: one method on one frame
//! RESULTS/<set>/<class>/<sequence>/0007.ibl.png  display values of frame 7 by method `ibl`; `truth` is the reference
//! ```

use crate::util::files;
use anyhow::{Result, ensure};
use renderflow_frame::reach::plain_name;
use renderflow_frame::{file, words};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// File of [`About`].
pub const ABOUT: &str = "results.json";
/// Number of pixels, 256 x 256, that the seconds of a budget are for. Larger and smaller pictures get seconds in proportion.
pub const BUDGET_PIXELS: f64 = 65536.0;
/// Version of the format. Since version 2, a method says what it reads and what it is compared with.
pub const VERSION: u32 = 2;
/// The name of the reference where pictures are named by method.
pub const TRUTH: &str = "truth";

/// The facts about a method for tables and plots.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MethodInfo {
    /// Short name in files: letters, digits, `-`, `_`, `.`, `+`.
    pub id: String,
    /// Name in tables.
    pub label: String,
    /// The group that it is listed with.
    pub group: Group,
    /// Methods of one series are joined by a line in plots of error against time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub series: Option<String>,
    /// Samples for each pixel, for path tracing with a fixed number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spp: Option<u32>,
    /// Seconds that a picture of [`BUDGET_PIXELS`] may take, for rows of a budget.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<f64>,
    /// Whether it reads the truth of keyframes. Then it also pays for their seconds.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub reads_keyframes: bool,
    /// Id of the method whose seconds it may take.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_of: Option<String>,
    /// Id of the method that it changes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part_of: Option<String>,
    /// What readers should know about it, in one sentence.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
}

impl MethodInfo {
    /// A method without further facts.
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
    /// A baseline with a part switched off or on, which shows what the part is worth.
    Ablation,
    /// A network.
    Neural,
    /// Path tracing.
    PathTraced,
    /// Path tracing that may take the seconds of another method.
    EqualTime,
    /// Path tracing within given seconds.
    Budget,
    /// Pictures from elsewhere.
    Other,
}

impl Group {
    /// Whether it traces paths.
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
    /// Name of the processor, and number of threads.
    pub machine: String,
    /// The LPIPS networks that were there; `None` where nobody wrote it down.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips: Option<String>,
    /// How radiance becomes the display values that metrics see.
    pub curve: String,
    /// In the order of table rows.
    pub methods: Vec<MethodInfo>,
    /// Name and value of every setting.
    pub settings: Vec<(String, String)>,
    /// What the last run asked for: the digest of the data of each sequence ([`SequenceSummary::data`]), by its
    /// [`place`](SequenceSummary::place). Results of other sequences or data do not count. `None` where nobody wrote it down:
    /// then all count.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sequences: Option<BTreeMap<String, String>>,
}

impl About {
    /// Whether the last run asked for this result.
    fn counts(&self, sequence: &SequenceSummary) -> bool {
        let Some(asked) = &self.sequences else { return true };
        sequence.data.is_some() && asked.get(&sequence.place()) == sequence.data.as_ref()
    }
}

/// One sequence.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SequenceSummary {
    /// Test set it belongs to.
    pub set: String,
    /// Class of scene.
    pub class: String,
    /// Folder name.
    pub name: String,
    /// BLAKE3 of what was compared; `None` where nobody wrote it down.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub data: Option<String>,
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// Numbers of the frames evaluated.
    pub frames: Vec<usize>,
    /// Numbers of those that are keyframes.
    pub keyframes: Vec<usize>,
    /// Frames in the sequence for each keyframe; with several keyframes, their distance. `None` without keyframes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub keyframe_gap: Option<f64>,
    /// Share of the sequence's frames that are keyframes, whichever frames were evaluated. `None` without keyframes, and where
    /// nobody wrote it down.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub keyframe_share: Option<f64>,
    /// Numbers of the frames whose pictures are stored.
    pub shown: Vec<usize>,
    /// Factor from radiance to display-linear.
    pub exposure: f32,
    /// Facts about the scene (layout, camera, light, triangles, ...): name and value.
    pub facts: Vec<(String, String)>,
    /// Facts about the reference.
    pub truth: Truth,
    /// Seconds of work that was done once, before the first frame, by the name of the work. No frame's seconds include them.
    pub once: Vec<(String, f64)>,
}

/// The reference of a sequence.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Samples for each pixel.
    pub spp: u32,
    /// Median seconds of a frame, if they were stored.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// Median seconds of a keyframe, if they were stored. Keyframes may have more samples than the frames between them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub keyframe_seconds: Option<f64>,
    /// PSNR (object) of the raw picture against a perfect one, dB, estimated from its variance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<f64>,
    /// PSNR (object) of the reference against a perfect picture, dB, if a longer render was made to estimate it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<f64>,
}

impl SequenceSummary {
    /// Its set, class and name, which are also the path of its results.
    pub fn place(&self) -> String {
        place(&self.set, &self.class, &self.name)
    }

    /// Seconds for each frame that a method pays for the truth of keyframes if it reads them: a keyframe's seconds, divided by
    /// the gap. `None` where they were not stored, or there are no keyframes.
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
    /// Wall seconds of this picture from a scene in memory; `None` for pictures from elsewhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seconds: Option<f64>,
    /// Samples for each pixel, for path tracing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spp: Option<u32>,
    /// The value of every metric in [`METRICS`](crate::metrics::METRICS) that could be computed.
    pub values: BTreeMap<String, f64>,
}

/// A complete sequence with its scores.
#[derive(Clone, Debug, PartialEq)]
pub struct Scored {
    /// The sequence.
    pub about: SequenceSummary,
    /// Folder of its pictures.
    pub pictures: PathBuf,
    /// One entry for each method and frame.
    pub scores: Vec<Score>,
}

/// A results folder.
#[derive(Clone, Debug, PartialEq)]
pub struct Results {
    /// The evaluation.
    pub about: About,
    /// Complete sequences, by set, class and name.
    pub sequences: Vec<Scored>,
}

/// The set, the class and the name of a sequence in one text.
pub fn place(set: &str, class: &str, name: &str) -> String {
    format!("{set}/{class}/{name}")
}

/// File name of a picture in the folder of its sequence.
pub fn picture_file(frame: usize, method: &str) -> String {
    format!("{frame:04}.{method}.png")
}

impl Results {
    /// Reads a results folder. Sequences that are not complete are left out, and so are those that the last run did not ask for,
    /// which a note on standard error counts.
    ///
    /// # Errors
    /// When a file cannot be read. The message names the file and the line.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(ABOUT);
        let about: About = file::read_json(&path)?;
        let version = about.version;
        ensure!(version == VERSION, "{}: /version: {version} is not {VERSION}: evaluate again with this program", path.display());
        for (i, method) in about.methods.iter().enumerate() {
            // Pictures are named after methods.
            plain_name(&method.id).map_err(|reason| anyhow::anyhow!("{}: /methods/{i}/id: {reason}", path.display()))?;
        }
        let (mut sequences, mut left_out) = (Vec::new(), 0);
        for set in folders(folder)? {
            for class in folders(&set)? {
                for file in files::list(&class)?.into_iter().filter(|path| path.extension().is_some_and(|e| e == "json")) {
                    let summary: SequenceSummary = file::read_json(&file)?;
                    if !about.counts(&summary) {
                        left_out += 1;
                        continue;
                    }
                    let scores = read_scores(&file.with_extension("jsonl"))?;
                    sequences.push(Scored { about: summary, pictures: file.with_extension(""), scores });
                }
            }
        }
        if left_out > 0 {
            eprintln!(
                "note: {}: {left_out} of the results are of sequences or data that the last run did not ask for, and do not count",
                folder.display()
            );
        }
        Ok(Self { about, sequences })
    }
}

/// Reads one score from each line.
pub fn read_scores(path: &Path) -> Result<Vec<Score>> {
    let text = file::read_text(path)?;
    let line = |(i, line)| {
        // Every entry is one line, so only the column is worth reporting.
        let reason = |e: serde_json::Error| words::plain(&e.to_string()).replace(" at line 1 column ", ", column ");
        serde_json::from_str(line).map_err(|e| anyhow::anyhow!("{}: line {}: {}", path.display(), i + 1, reason(e)))
    };
    text.lines().enumerate().map(line).collect()
}

fn folders(path: &Path) -> Result<Vec<PathBuf>> {
    Ok(files::list(path)?.into_iter().filter(|path| path.is_dir()).collect())
}
