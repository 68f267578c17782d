//! `sequence.json`: what a finished sequence holds. It is written last, so a sequence that has one is complete.

use super::agreement::Agreement;
use super::plan::{Plan, is_keyframe};
use super::statistics::Statistics;
use crate::dataset::layout::{DESCRIPTIONS, FAILURES, RECORD, frame_file};
use crate::util::text::plural;
use anyhow::{Context, Result, anyhow, ensure};
use renderflow_frame::file;
use renderflow_frame::reach::plain_name;
use renderflow_renderer::light::EnvironmentLight;
use renderflow_scenes::procedural::{Composed, Split, Used};
use renderflow_scenes::{LoadedScene, shapes};
use serde::{Deserialize, Serialize};
use std::io::ErrorKind;
use std::path::Path;

/// A finished sequence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Format version, 1.
    pub version: u32,
    /// Folder name.
    pub name: String,
    /// Number in the plan.
    pub index: u32,
    /// Split it belongs to.
    pub split: Split,
    /// BLAKE3 of the plan it was made from.
    pub plan: String,
    /// Seed of all random sampling.
    pub seed: u64,
    /// BLAKE3 of the scene's canonical JSON.
    pub scene: String,
    /// Kind of layout.
    pub layout: String,
    /// Kind of camera path.
    pub camera: String,
    /// Whether objects move.
    pub moving: bool,
    /// Whether materials change.
    pub changing: bool,
    /// The light.
    pub environment: EnvironmentEntry,
    /// Objects that were drawn from the catalogue or from the user's models.
    pub objects: Vec<ObjectEntry>,
    /// Materials on objects; how many of them have textures, and how many are more than half metal.
    pub materials: [usize; 3],
    /// Triangles in the scene; a mesh counts wherever it is placed.
    pub triangles: u64,
    /// Numbers of the keyframes.
    pub keyframes: Vec<usize>,
    /// File name and BLAKE3 of the descriptions.
    pub descriptions: Vec<(String, String)>,
    /// The frames.
    pub frames: Vec<FrameEntry>,
    /// How well the channels agree with one another.
    pub agreement: Agreement,
    /// What the pixels are like.
    pub statistics: Statistics,
}

/// The light of a sequence.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EnvironmentEntry {
    /// Family in the catalogue, or `builtin:NAME`, or `file:PATH`.
    pub family: String,
    /// Number in the catalogue.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub number: Option<u32>,
    /// Mean of squared radiance over the square of its mean: 1 = flat, thousands = a sun.
    pub concentration: f32,
    /// Factor from radiance to display-linear.
    pub exposure: f32,
}

/// An object of a sequence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObjectEntry {
    /// Name in the scene.
    pub name: String,
    /// Mesh family; `file` for a user's model.
    pub family: String,
    /// Number in the catalogue.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mesh: Option<u32>,
    /// The user's model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Hashes of the geometry of its meshes; models may have several.
    pub geometry: Vec<String>,
}

impl ObjectEntry {
    fn new(used: &Used, geometry: Vec<String>) -> Self {
        let Used { object, family, mesh, file } = used.clone();
        Self { name: object, family, mesh, file, geometry }
    }
}

/// A frame of a sequence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameEntry {
    /// File name.
    pub file: String,
    /// Its number in the sequence.
    pub number: usize,
    /// Whether it is a keyframe.
    pub keyframe: bool,
    /// Samples a pixel; 0 = G-buffer only.
    pub spp: u32,
    /// Bytes of the file.
    pub bytes: u64,
    /// BLAKE3 of the file.
    pub blake3: String,
}

/// A frame that could not be made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Failure {
    /// Its number in the sequence; `None` when the whole sequence could not be started or finished.
    pub frame: Option<usize>,
    /// Seed of the sequence's rendering, where it is known.
    pub seed: Option<u64>,
    /// What went wrong.
    pub error: String,
}

/// What the files of a sequence hold.
#[derive(Clone, Debug, Default)]
pub struct Checked {
    /// The frames.
    pub frames: Vec<FrameEntry>,
    /// File name and BLAKE3 of the descriptions.
    pub descriptions: Vec<(String, String)>,
    /// How well the channels agree with one another.
    pub agreement: Agreement,
    /// What the pixels are like.
    pub statistics: Statistics,
}

impl Record {
    /// The record of sequence `index` whose files are `checked`.
    pub fn new(plan: &Plan, index: u32, composed: &Composed, loaded: &LoadedScene, checked: Checked) -> Result<Self> {
        let geometry = |object: &str| {
            // Parts of a model are named after their object.
            let part = |name: &str| name.strip_prefix(object).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'));
            let mut meshes: Vec<usize> = loaded.instances.iter().filter(|i| part(&i.name)).map(|i| i.mesh).collect();
            meshes.sort_unstable();
            meshes.dedup();
            meshes.into_iter().map(|mesh| shapes::geometry_hash(&loaded.meshes[mesh])).collect()
        };
        let objects = composed.meshes.iter().map(|used| ObjectEntry::new(used, geometry(&used.object)));
        let mut on_objects: Vec<usize> = loaded.instances.iter().map(|instance| instance.material).collect();
        on_objects.sort_unstable();
        on_objects.dedup();
        let count = |which: &dyn Fn(&renderflow_scenes::Material) -> bool| {
            on_objects.iter().filter(|&&m| which(&loaded.materials[m])).count()
        };
        let textured = count(&|m| m.texture_slots().next().is_some());
        let metal = count(&|m| m.surface.metallic > 0.5);
        let light = EnvironmentLight::new(&loaded.environment)?;
        Ok(Self {
            version: 1,
            name: Plan::sequence_name(index),
            index,
            split: plan.split(index),
            plan: plan.hash(),
            seed: loaded.seed,
            scene: loaded.hash.clone(),
            layout: composed.layout.name().to_owned(),
            camera: composed.camera.name().to_owned(),
            moving: composed.moving,
            changing: composed.changing,
            environment: EnvironmentEntry {
                family: composed.environment.clone(),
                number: composed.environment_number,
                concentration: light.concentration(),
                exposure: renderflow_frame::ibl::exposure(&loaded.environment),
            },
            objects: objects.collect(),
            materials: [on_objects.len(), textured, metal],
            triangles: loaded.instances.iter().map(|instance| loaded.meshes[instance.mesh].triangles.len() as u64).sum(),
            keyframes: plan.keyframe_numbers().collect(),
            descriptions: checked.descriptions,
            frames: checked.frames,
            agreement: checked.agreement,
            statistics: checked.statistics,
        })
    }

    /// The same record, with everything that follows from composing alone taken from `composed`.
    #[must_use]
    pub fn with_composed(&self, composed: &Composed) -> Self {
        let mut geometry = self.objects.iter().map(|object| object.geometry.clone());
        let objects = composed.meshes.iter().map(|used| ObjectEntry::new(used, geometry.next().unwrap_or_default()));
        Self {
            scene: composed.scene.hash(),
            seed: composed.scene.seed,
            layout: composed.layout.name().to_owned(),
            camera: composed.camera.name().to_owned(),
            moving: composed.moving,
            changing: composed.changing,
            environment: EnvironmentEntry {
                family: composed.environment.clone(),
                number: composed.environment_number,
                ..self.environment
            },
            objects: objects.collect(),
            ..self.clone()
        }
    }

    /// Reads the record in the folder of a sequence; `None` where there is none.
    ///
    /// # Errors
    /// When the file cannot be read, is not a record, or names files outside of the folder.
    pub fn read(folder: &Path) -> Result<Option<Self>> {
        Ok(Self::read_with_bytes(folder)?.map(|(record, _)| record))
    }

    /// As [`Self::read`]; also returns the bytes of the file.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn read_with_bytes(folder: &Path) -> Result<Option<(Self, Vec<u8>)>> {
        let path = folder.join(RECORD);
        let bytes = match file::read_at_most(&path, file::LARGEST_TEXT) {
            Err(renderflow_frame::Error::Io { source, .. }) if source.kind() == ErrorKind::NotFound => return Ok(None),
            bytes => bytes?,
        };
        let record: Self = file::parse_json(&path, &bytes)?;
        ensure!(record.version == 1, "{}: /version: {} is not 1", path.display(), record.version);
        let plain = |pointer: String, name: &str| {
            plain_name(name).map_err(|reason| anyhow!("{}: {pointer}: {reason}", path.display()))?;
            Ok::<_, anyhow::Error>(())
        };
        for (i, frame) in record.frames.iter().enumerate() {
            plain(format!("/frames/{i}/file"), &frame.file)?;
        }
        for (i, (name, _)) in record.descriptions.iter().enumerate() {
            plain(format!("/descriptions/{i}/0"), name)?;
        }
        Ok(Some((record, bytes)))
    }

    /// What in it does not fit sequence `index` of `plan`: one sentence each, with the place in the record. No files are read.
    pub fn misfits(&self, plan: &Plan, index: u32) -> Vec<String> {
        let (split, name) = (plan.split(index), Plan::sequence_name(index));
        if (self.split, self.index, &self.name) != (split, index, &name) {
            let number =
                if self.name == Plan::sequence_name(self.index) { String::new() } else { format!(", number {}", self.index) };
            return vec![format!("is that of {}/{:.80}{number}", self.split, self.name)];
        }
        if self.plan != plan.hash() {
            return vec![format!("/plan: is of another plan (BLAKE3 {})", self.plan)];
        }
        let mut misfits = Vec::new();
        if !self.keyframes.iter().copied().eq(plan.keyframe_numbers()) {
            misfits.push("/keyframes: are not those of the plan".to_owned());
        }
        if !self.descriptions.iter().map(|(file, _)| file.as_str()).eq(DESCRIPTIONS) {
            misfits.push(format!("/descriptions: are not {}", DESCRIPTIONS.join(", ")));
        }
        let numbers: Vec<usize> = plan.numbers().collect();
        if self.frames.len() != numbers.len() {
            misfits.push(format!("/frames: {}, the plan has {}", plural(self.frames.len(), "frame"), numbers.len()));
        }
        for (i, (frame, number)) in self.frames.iter().zip(numbers).enumerate() {
            let samples = plan.samples(number);
            let right = frame.number == number
                && frame.file == frame_file(number, plan.storage)
                && frame.keyframe == is_keyframe(plan.keyframe_gap(), number)
                && (frame.spp == samples || plan.render.adaptive && samples > 0 && frame.spp > 0);
            if !right {
                misfits.push(format!("/frames/{i}: is not frame {number} of the plan"));
            }
        }
        misfits
    }

    /// The BLAKE3 that it holds for a frame or a description.
    pub fn hash_of(&self, file: &str) -> Option<&str> {
        let frames = self.frames.iter().map(|frame| (&frame.file, &frame.blake3));
        let descriptions = self.descriptions.iter().map(|(file, hash)| (file, hash));
        frames.chain(descriptions).find(|(name, _)| *name == file).map(|(_, hash)| hash.as_str())
    }
}

/// The failures of a sequence while it is made: those of this run, and those of earlier runs that it has not come to.
#[derive(Clone, Debug, Default)]
pub struct Failures {
    earlier: Vec<Failure>,
    new: Vec<Failure>,
}

impl Failures {
    /// Those that the folder of the sequence records. A record that cannot be read is as good as none.
    pub fn read(folder: &Path) -> Self {
        Self { earlier: failures(folder).unwrap_or_default(), new: Vec::new() }
    }

    /// Forgets that a frame failed earlier, because it is there now.
    pub fn mended(&mut self, frame: usize) {
        self.earlier.retain(|failure| failure.frame != Some(frame));
    }

    /// Adds a failure of this run, in place of an earlier one of the same frame.
    pub fn add(&mut self, failure: Failure) {
        self.earlier.retain(|earlier| earlier.frame != failure.frame);
        self.new.push(failure);
    }

    /// Whether this run had none.
    pub fn is_clean(&self) -> bool {
        self.new.is_empty()
    }

    /// Writes all of them, by frame.
    ///
    /// # Errors
    /// When the file cannot be written or removed.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let mut all = [&self.earlier[..], &self.new].concat();
        all.sort_by_key(|failure| failure.frame);
        write_failures(folder, &all)
    }
}

/// Reads the failures recorded in the folder of a sequence.
pub fn failures(folder: &Path) -> Result<Vec<Failure>> {
    let path = folder.join(FAILURES);
    if path.exists() { Ok(file::read_json(&path)?) } else { Ok(Vec::new()) }
}

/// Writes the failures; without any, removes the file.
pub fn write_failures(folder: &Path, failures: &[Failure]) -> Result<()> {
    let path = folder.join(FAILURES);
    if !failures.is_empty() {
        return Ok(file::write_json(&path, failures)?);
    }
    match std::fs::remove_file(&path) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            Err(error).with_context(|| format!("{}: cannot remove", path.display()))
        }
        _ => Ok(()),
    }
}
