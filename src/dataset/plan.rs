//! A dataset plan: everything that is needed to make the same dataset again, byte for byte, on any machine.

use super::denoise::Denoise;
use crate::util::files;
use anyhow::{Context, Result, bail, ensure};
use renderflow_frame::frame_file::Profile;
use renderflow_frame::reach::Reach;
use renderflow_frame::words;
use renderflow_renderer::{Budget, Settings};
use renderflow_scenes::catalog::Catalog;
use renderflow_scenes::procedural::{Composed, Composition, ENVIRONMENT_COUNT, MESH_COUNT, Pool, Request, Split, compose};
use renderflow_scenes::validate::{MAX_FRAMES, MAX_RESOLUTION};
use renderflow_scenes::{description::EnvironmentSource, seed::Seed};
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

impl Plan {
    /// Sequences that a plan may have.
    pub const SEQUENCES: RangeInclusive<u32> = 1..=1_000_000;
    /// Frames that a sequence may have; also the range of steps and gaps between frames.
    pub const FRAMES: RangeInclusive<u32> = 1..=MAX_FRAMES;
    /// Pixels that a side of a picture may have.
    pub const RESOLUTION: RangeInclusive<u32> = 1..=MAX_RESOLUTION;
    /// Members that a catalogue may have.
    pub const CATALOGUE: RangeInclusive<u32> = 1..=1_000_000;
    /// Samples for each pixel that a plan may ask for; 0 = G-buffers only.
    pub const SPP: RangeInclusive<u32> = 0..=*Settings::SPP.end();
    /// The step between frames where a plan does not name one.
    pub const FRAME_STEP: u32 = 1;
    /// The number of meshes where a plan does not name it.
    pub const MESHES: u32 = MESH_COUNT;
    /// The number of environments where a plan does not name it.
    pub const ENVIRONMENTS: u32 = ENVIRONMENT_COUNT;
}

/// Counts, sizes, the seed, and what scenes are made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Format version, 2.
    pub version: u32,
    /// Root of the seed tree.
    pub seed: u64,
    /// Sequences of each split; one scene each.
    pub sequences: Counts,
    /// Frames of a sequence, 1..=100000.
    pub frames: u32,
    /// Only frames 0, step, 2 step, ... are rendered; 1 = all. For training, many scenes are worth more than many frames of one
    /// scene.
    #[serde(default = "frame_step")]
    pub frame_step: u32,
    /// Width and height in pixels, each 1..=16384.
    pub resolution: [u32; 2],
    /// How the truth is rendered.
    pub render: Render,
    /// Which frames are keyframes, and how the others are rendered.
    #[serde(default)]
    pub keyframes: Keyframes,
    /// How frames are stored.
    #[serde(default)]
    pub storage: Profile,
    /// Meshes in the catalogue that all sequences draw from, 1..=1000000.
    #[serde(default = "meshes")]
    pub meshes: u32,
    /// Maps in the catalogue of environments, 1..=1000000.
    #[serde(default = "environments")]
    pub environments: u32,
    /// Nothing: a plan of version 0.1 may say `classic = false`; one that asks for the composer of that version is refused.
    #[serde(default, skip_serializing, deserialize_with = "not_classic")]
    pub classic: (),
    /// What scenes look like.
    #[serde(default = "Composition::opaque")]
    pub composition: Composition,
    /// What each split may draw from; no two splits share anything.
    #[serde(default)]
    pub splits: Splits,
    /// More folders that its models may name files in.
    #[serde(skip)]
    pub allowed: Allowed,
}

/// Folders that the user allows the models of a plan to name files in. They are not part of the plan, so plans are equal whatever
/// is allowed.
#[derive(Clone, Debug, Default)]
pub struct Allowed(pub Vec<PathBuf>);

impl PartialEq for Allowed {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

// Values that a plan file may leave out.
fn frame_step() -> u32 {
    Plan::FRAME_STEP
}
fn meshes() -> u32 {
    Plan::MESHES
}
fn environments() -> u32 {
    Plan::ENVIRONMENTS
}
fn max_bounces() -> u32 {
    Settings::default().max_bounces
}
fn no_denoiser() -> Denoise {
    Denoise::None
}

/// Why a plan or an option that asks for the classic composer is refused.
pub const NO_CLASSIC: &str =
    "the classic composer of version 0.1 is gone; leave `classic` out to get scenes of the present composer";

fn not_classic<'de, D: serde::Deserializer<'de>>(from: D) -> std::result::Result<(), D::Error> {
    if bool::deserialize(from)? { Err(serde::de::Error::custom(NO_CLASSIC)) } else { Ok(()) }
}

/// A number for each split.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Counts {
    /// For training.
    pub train: u32,
    /// For choosing settings.
    pub val: u32,
    /// For the results that are reported.
    pub test: u32,
}

/// How the truth is rendered.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Render {
    /// Samples for each pixel, 0..=16777216; 0 = G-buffers only, for sequences that a network will render.
    pub spp: u32,
    /// Whether noisier pixels get more samples, with `spp` samples for each pixel on average.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub adaptive: bool,
    /// How often a path may scatter, 1..=1024.
    #[serde(default = "max_bounces")]
    pub max_bounces: u32,
    /// Denoiser of the beauty, `oidn` or `none`. Machines without it refuse the plan, so that all frames of a dataset are
    /// denoised alike.
    #[serde(default = "no_denoiser")]
    pub denoise: Denoise,
    /// Whether frames hold the unoccluded irradiance.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub irradiance: bool,
    /// Whether frames hold the Euclidean distance as well as the planar depth (full storage only: it follows from the depth).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub distance: bool,
    /// Number of groups to split the light into, 0..=8.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub light_groups: u32,
}

impl Render {
    /// The settings of the renderer for frames with `spp` samples for each pixel; 0 = G-buffers only.
    pub fn settings(&self, spp: u32) -> Settings {
        Settings {
            spp,
            max_bounces: self.max_bounces,
            irradiance: self.irradiance,
            light_groups: self.light_groups,
            budget: if self.adaptive && spp > 0 { Budget::Average } else { Budget::Uniform },
            ..Settings::default()
        }
    }
}

fn is_zero(v: &u32) -> bool {
    *v == 0
}

/// Which frames are keyframes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Keyframes {
    /// Frames 0, gap, 2 gap, ... are keyframes, 1..=100000.
    pub gap: u32,
    /// Samples for each pixel of the frames between them; 0 = G-buffers only, absent = the same number as keyframes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub between_spp: Option<u32>,
}

impl Keyframes {
    /// The gap where a plan does not name one, in frames.
    pub const GAP: u32 = 16;
}

impl Default for Keyframes {
    fn default() -> Self {
        Self { gap: Self::GAP, between_spp: None }
    }
}

/// What the sequences of each split may draw from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Splits {
    /// For training.
    pub train: Sources,
    /// For choosing settings.
    pub val: Sources,
    /// For the results that are reported.
    pub test: Sources,
}

/// Families and files of one split.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Sources {
    /// Mesh families.
    pub mesh_families: Vec<String>,
    /// Environment families.
    pub environment_families: Vec<String>,
    /// Named maps of the project's `hdri/` folder.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub builtin_environments: Vec<String>,
    /// Model files (glTF, OBJ, PLY) of the user.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub models: Vec<UserFile>,
    /// Environment maps (.hdr, .exr) of the user.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub hdris: Vec<UserFile>,
}

/// A file that a plan names. The hash keeps a different file with the same name out of the dataset.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UserFile {
    /// Absolute path.
    pub path: String,
    /// BLAKE3 of the file, hexadecimal; files that it refers to are not included.
    pub blake3: String,
}

/// The splits, in the order in which sequences are numbered.
pub const SPLITS: [Split; 3] = Split::ALL;

impl Counts {
    /// The number of one split.
    pub fn of(&self, split: Split) -> u32 {
        match split {
            Split::Train => self.train,
            Split::Val => self.val,
            Split::Test => self.test,
        }
    }

    /// The number of one split, for changing it.
    pub fn of_mut(&mut self, split: Split) -> &mut u32 {
        match split {
            Split::Train => &mut self.train,
            Split::Val => &mut self.val,
            Split::Test => &mut self.test,
        }
    }
}

impl Splits {
    /// The sources of one split.
    pub fn of(&self, split: Split) -> &Sources {
        match split {
            Split::Train => &self.train,
            Split::Val => &self.val,
            Split::Test => &self.test,
        }
    }

    /// The sources of one split, for changing them.
    pub fn of_mut(&mut self, split: Split) -> &mut Sources {
        match split {
            Split::Train => &mut self.train,
            Split::Val => &mut self.val,
            Split::Test => &mut self.test,
        }
    }
}

/// Whether frame `number` is a keyframe, if frames 0, gap, 2 gap, ... are; with a gap of 0, no frame is.
pub fn is_keyframe(gap: u32, number: usize) -> bool {
    gap > 0 && number.is_multiple_of(gap as usize)
}

/// How a frame of a plan is rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// As a keyframe. So are all frames of a plan that does not tell them apart.
    Full,
    /// As a frame between keyframes, with its own number of samples.
    Between,
    /// Without light.
    GBuffer,
}

impl Plan {
    /// Reads and checks a plan file: TOML if its name ends in .toml, JSON otherwise.
    pub fn read(path: &Path) -> Result<Self> {
        let plan: Self = if files::has_ending(path, &["toml"]) {
            let text = renderflow_frame::file::read_text(path)?;
            toml::from_str(&text).map_err(|e| anyhow::anyhow!("{}{}", path.display(), toml_error(&text, &e)))?
        } else {
            renderflow_frame::file::read_json(path)?
        };
        plan.check().with_context(|| format!("{}", path.display()))?;
        Ok(plan)
    }

    /// Checks the range of every field, and that no two splits share a source.
    pub fn check(&self) -> Result<()> {
        ensure!(self.version == 2, "/version: {} is not 2", self.version);
        let range = |at: &str, value: u32, range: RangeInclusive<u32>| {
            ensure!(range.contains(&value), "{at}: {value} is outside {}..={}", range.start(), range.end());
            Ok(())
        };
        let counts = [("train", self.sequences.train), ("val", self.sequences.val), ("test", self.sequences.test)];
        let total: u64 = counts.iter().map(|&(_, n)| u64::from(n)).sum();
        let most = *Self::SEQUENCES.end();
        ensure!((1..=u64::from(most)).contains(&total), "/sequences: {total} in all is outside 1..={most}");
        range("/frames", self.frames, Self::FRAMES)?;
        range("/frame_step", self.frame_step, Self::FRAMES)?;
        range("/keyframes/gap", self.keyframes.gap, Self::FRAMES)?;
        range("/keyframes/between_spp", self.keyframes.between_spp.unwrap_or(0), Self::SPP)?;
        range("/render/spp", self.render.spp, Self::SPP)?;
        range("/render/max_bounces", self.render.max_bounces, Settings::MAX_BOUNCES)?;
        range("/render/light_groups", self.render.light_groups, Settings::LIGHT_GROUPS)?;
        ensure!(
            matches!(self.render.denoise, Denoise::Oidn | Denoise::None),
            "/render/denoise: must be oidn or none, which are the same on every machine"
        );
        range("/meshes", self.meshes, Self::CATALOGUE)?;
        range("/environments", self.environments, Self::CATALOGUE)?;
        for (axis, &size) in self.resolution.iter().enumerate() {
            range(&format!("/resolution/{axis}"), size, Self::RESOLUTION)?;
        }
        self.composition.check().map_err(|e| anyhow::anyhow!("{e}"))?;
        self.check_splits()
    }

    /// What the plan asks for without effect: one sentence each, with the place in the plan.
    pub fn idle(&self) -> Vec<String> {
        const COMPACT: &str = "compact frames do not hold them";
        const BARE: &str = "with /render/spp 0 no frame has a picture";
        let (compact, bare) = (self.storage == Profile::Compact, self.render.spp == 0);
        let (groups, between) = (self.render.light_groups > 0, self.keyframes.between_spp);
        let keys = [
            (
                "/render/distance",
                compact && self.render.distance,
                "compact frames do not hold it, because it follows from the depth",
            ),
            ("/render/light_groups", compact && groups, COMPACT),
            ("/render/light_groups", bare && !compact && groups, BARE),
            ("/render/adaptive", bare && self.render.adaptive, BARE),
            ("/keyframes/between_spp", bare && between.is_some_and(|spp| spp > 0), BARE),
        ];
        let idle = keys.into_iter().filter(|(_, idle, _)| *idle);
        idle.map(|(key, _, reason)| format!("{key}: has no effect: {reason}")).collect()
    }

    fn check_splits(&self) -> Result<()> {
        let catalog = self.catalog();
        let meshes: Vec<&str> = (0..self.meshes).map(|k| catalog.mesh_family(k)).collect();
        let environments: Vec<&str> = (0..self.environments).map(|k| catalog.environment_family(k)).collect();
        let builtin = renderflow_scenes::sky::names();
        let mut taken = std::collections::HashMap::new();
        for split in SPLITS {
            let sources = self.splits.of(split);
            let known =
                |what: &str, names: &[String], all: &[&str]| match names.iter().position(|name| !all.contains(&name.as_str())) {
                    Some(i) => bail!("/splits/{split}/{what}/{i}: {:?} is not in the catalogue", names[i]),
                    None => Ok(()),
                };
            known("mesh_families", &sources.mesh_families, &meshes)?;
            known("environment_families", &sources.environment_families, &environments)?;
            known("builtin_environments", &sources.builtin_environments, &builtin)?;
            let lists = [
                ("mesh_families", &sources.mesh_families, "mesh family"),
                ("environment_families", &sources.environment_families, "environment family"),
                ("builtin_environments", &sources.builtin_environments, "map"),
            ];
            let files = |files: &[UserFile]| -> Vec<String> { files.iter().map(|f| f.blake3.clone()).collect() };
            let hashes = [("models", files(&sources.models), "model"), ("hdris", files(&sources.hdris), "map")];
            let lists = lists.map(|(field, names, kind)| (field, names.clone(), kind)).into_iter().chain(hashes);
            for (field, names, kind) in lists {
                for (i, name) in names.into_iter().enumerate() {
                    if let Some(other) = taken.insert((field, name.clone()), split)
                        && other != split
                    {
                        bail!("/splits/{split}/{field}/{i}: {kind} {name} belongs to {other} already");
                    }
                }
            }
            if self.sequences.of(split) > 0 {
                ensure!(
                    !sources.mesh_families.is_empty() || !sources.models.is_empty(),
                    "/splits/{split}: has sequences, but no mesh families and no models"
                );
                ensure!(
                    !(sources.environment_families.is_empty()
                        && sources.builtin_environments.is_empty()
                        && sources.hdris.is_empty()),
                    "/splits/{split}: has sequences, but no environments"
                );
            }
        }
        Ok(())
    }

    /// The files that scenes of the plan may name: the files in the plan, the files that their models name beside them, and what
    /// is allowed.
    pub fn reach(&self) -> Reach {
        let sources = || SPLITS.into_iter().map(|split| self.splits.of(split));
        let listed = sources().flat_map(|s| s.models.iter().chain(&s.hdris)).map(|file| &file.path);
        Reach::folder(".").allow(listed).allow(&self.allowed.0)
    }

    /// Sequences in all.
    pub fn total(&self) -> u32 {
        self.sequences.train + self.sequences.val + self.sequences.test
    }

    /// Folder name of sequence `index`.
    pub fn sequence_name(index: u32) -> String {
        format!("seq-{index:06}")
    }

    /// The seed from which everything in sequence `index` follows, apart from its split.
    fn sequence_seed(&self, index: u32) -> Seed {
        Seed::root(self.seed).child("sequence", u64::from(index))
    }

    /// Name of the scene of sequence `index`. It is unique within a plan.
    pub fn scene_name(&self, index: u32) -> String {
        let split = self.split(index);
        format!("{split}_{}", Self::sequence_name(index))
    }

    /// Split of sequence `index`: training comes first, test comes last.
    pub fn split(&self, index: u32) -> Split {
        match index {
            i if i < self.sequences.train => Split::Train,
            i if i - self.sequences.train < self.sequences.val => Split::Val,
            _ => Split::Test,
        }
    }

    /// Numbers of the frames that are rendered.
    pub fn numbers(&self) -> impl Iterator<Item = usize> + use<> {
        (0..self.frames as usize).step_by(self.frame_step as usize)
    }

    /// How frame `number` is rendered.
    pub fn quality(&self, number: usize) -> Quality {
        let key = number.is_multiple_of(self.keyframes.gap as usize);
        match (key, self.keyframes.between_spp) {
            _ if self.render.spp == 0 => Quality::GBuffer,
            (false, Some(0)) => Quality::GBuffer,
            (false, Some(spp)) if spp != self.render.spp => Quality::Between,
            _ => Quality::Full,
        }
    }

    /// BLAKE3 of the plan as compact JSON.
    pub fn hash(&self) -> String {
        let text = serde_json::to_vec(self).unwrap_or_default();
        blake3::hash(&text).to_hex().to_string()
    }

    /// Numbers of the stored frames that are keyframes.
    pub fn keyframe_numbers(&self) -> impl Iterator<Item = usize> + use<> {
        let gap = self.keyframe_gap();
        self.numbers().filter(move |&number| is_keyframe(gap, number))
    }

    /// The gap between keyframes; 0 where no frame has a picture.
    pub fn keyframe_gap(&self) -> u32 {
        if self.render.spp == 0 { 0 } else { self.keyframes.gap }
    }

    /// Samples a pixel that frame `number` should have.
    pub fn samples(&self, number: usize) -> u32 {
        match self.quality(number) {
            Quality::Full => self.render.spp,
            Quality::Between => self.keyframes.between_spp.unwrap_or(self.render.spp),
            Quality::GBuffer => 0,
        }
    }

    /// Folder of sequence `index` in the dataset `out`.
    pub fn folder(&self, out: &Path, index: u32) -> PathBuf {
        out.join(self.split(index).name()).join(Self::sequence_name(index))
    }

    /// Folder of sequence `index` within its dataset, such as `train/seq-000012`.
    pub fn place(&self, index: u32) -> String {
        format!("{}/{}", self.split(index), Self::sequence_name(index))
    }

    /// Meshes and environments by number.
    pub fn catalog(&self) -> Catalog {
        Catalog::new(self.seed, self.meshes, self.environments)
    }

    /// The scene of sequence `index`; depends on the plan and `index` only.
    pub fn compose(&self, catalog: &Catalog, index: u32) -> Result<Composed> {
        let seed = self.sequence_seed(index);
        let split = self.split(index);
        let sources = self.splits.of(split);
        let paths = |files: &[UserFile]| -> Vec<String> { files.iter().map(|f| f.path.clone()).collect() };
        let (models, hdris) = (paths(&sources.models), paths(&sources.hdris));
        let pool = Pool {
            catalog,
            mesh_families: &sources.mesh_families,
            environment_families: &sources.environment_families,
            models: &models,
            hdris: &hdris,
            builtin: &sources.builtin_environments,
            allowed: &self.allowed.0,
        };
        let request = Request {
            seed,
            name: self.scene_name(index),
            resolution: self.resolution,
            frames: self.frames,
            composition: &self.composition,
            pool: &pool,
        };
        let composed = compose(&request).map_err(|e| anyhow::anyhow!("{}: {e}", Self::sequence_name(index)))?;
        for used in composed.meshes.iter().filter_map(|used| used.file.as_deref()) {
            check_file(&sources.models, used)?;
        }
        if let EnvironmentSource::File(path) = &composed.scene.environment.source {
            check_file(&sources.hdris, path)?;
        }
        Ok(composed)
    }
}

/// Checks that a user's file is still the one that was planned.
fn check_file(files: &[UserFile], path: &str) -> Result<()> {
    let Some(planned) = files.iter().find(|file| file.path == path) else { return Ok(()) };
    let found = files::hash(Path::new(path))?;
    ensure!(found == planned.blake3, "{path}: is not the file that was planned (BLAKE3 {found}, not {})", planned.blake3);
    Ok(())
}

/// Where and why a TOML parser failed, without the line itself, which may be long.
fn toml_error(text: &str, error: &toml::de::Error) -> String {
    let reason = words::plain(error.message().lines().next().unwrap_or_default());
    let Some(before) = error.span().and_then(|span| text.get(..span.start)) else { return format!(": {reason}") };
    let column = before.rsplit('\n').next().unwrap_or_default().chars().count() + 1;
    format!(": line {}, column {column}: {reason}", before.matches('\n').count() + 1)
}
