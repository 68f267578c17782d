//! Examines the folder of a sequence and decides what to render, before anything is written.

use super::memory;
use super::{NO_MAP, OpenSequence, TruthSettings, with_absolute_paths};
use crate::dataset::around::Neighbours;
use crate::dataset::layout::{ENVIRONMENT, RECORD, SCENE, TIMING, TRANSFORMS};
use crate::util::output::{self, OVERWRITE};
use anyhow::{Result, bail, ensure};
use renderflow_frame::frame_file::{self, Profile};
use renderflow_frame::{Frame, exr, file, transforms};
use renderflow_renderer::Budget;
use renderflow_scenes::description::Scene;
use serde_json::Value::{self, Array, Null, Object};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Said of a file that is in the way of a render and did not come from one.
const FOREIGN: &str = "already exists, and nothing in the folder says that this program rendered it; choose another folder";

/// What is left to do in the folder of a sequence.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Numbers of the frames to render.
    pub missing: Vec<usize>,
    /// Numbers of the frames that are there as part of a shorter sequence, and are the same in this one but for their headers.
    pub lengthened: Vec<usize>,
}

impl OpenSequence<'_> {
    /// Examines the folder, and returns what [`make`](Self::make) must do. It renders frames that are missing or cannot be read,
    /// and with `overwrite` also frames of another scene or of other settings. If the folder holds the beginning of this
    /// sequence, its frames are kept. Nothing is written. `overwrite` is `None` for a command without this option.
    ///
    /// # Errors
    /// When the folder holds frames of another scene or of other settings, unless `overwrite` is set; when a file is in the way
    /// that is not part of an earlier render.
    pub fn decide(&self, settings: &TruthSettings, overwrite: Option<bool>) -> Result<Work> {
        // Light paths may take more; the compiled scene will know.
        memory::ensure(settings, self.job.scene.resolution.map(|v| v as usize), false, self.job.storage)?;
        settings.ensure_window(self.job.scene.resolution, self.job.numbers(self.loaded.cameras.len()).count())?;
        let (overwrite, way) = (overwrite == Some(true), overwrite.map_or("choose another folder", |_| OVERWRITE));
        let out = &self.job.out;
        let earlier = self.earlier();
        let (mut missing, mut lengthened, mut kept) = (Vec::new(), Vec::new(), false);
        for number in self.job.numbers(self.loaded.cameras.len()) {
            match self.found(number, settings)? {
                Existing::Same => {
                    kept = true;
                    continue;
                }
                Existing::Nothing => {}
                Existing::Other(_) if self.is_beginning(number, settings)? => {
                    kept = true;
                    // The last frame had no movement to a next one.
                    if !self.is_of(number, self.shorter(number as u32 + 1), settings)? {
                        lengthened.push(number);
                        continue;
                    }
                }
                Existing::Other(what) if !overwrite => bail!("{what}; {way}"),
                Existing::Other(what) if earlier.is_none() => bail!("{what}; {FOREIGN}"),
                Existing::Other(_) => {}
                // Somebody else put a picture there that can be read, but is not a frame of this program.
                Existing::Broken(_) if earlier.is_none() || exr::read_rgb(&self.path(number)).is_ok() => {
                    bail!(
                        "{}: already exists and is not a frame of this program; choose another folder",
                        self.path(number).display()
                    );
                }
                Existing::Broken(error) => eprintln!("note: rendered again: {}", crate::util::console::message(&error)),
            }
            if let Some(map) = &settings.sample_map {
                let (_, frame) = settings.mapped(map, number, self.loaded.cameras.len())?;
                ensure!(frame.samples.is_some(), "{}: frame {number} {NO_MAP}", map.display());
            }
            missing.push(number);
        }
        let Some(earlier) = earlier else {
            // Nothing says that these files are ours, so they must be equal to what would be written.
            let descriptions = self.descriptions()?;
            let described = |path: &Path| {
                descriptions.iter().any(|(own, bytes)| own == path && file::holds(path, bytes).is_ok_and(|same| same))
            };
            let pictures = missing.iter().map(|&number| self.path(number).with_extension("png"));
            let places = descriptions.iter().map(|(path, _)| path.clone()).chain([out.join(TIMING)]).chain(pictures);
            if let Some(path) = places.into_iter().find(|path| output::exists(path) && !described(path) && !kept) {
                bail!("{}: {FOREIGN}", path.display());
            }
            return Ok(Work { missing, lengthened });
        };
        if overwrite {
            let dataset = out.join(RECORD);
            ensure!(
                missing.is_empty() || !output::exists(&dataset),
                "{}: the folder is a sequence of a dataset; choose another",
                dataset.display()
            );
            let own = self.sequence()?.files;
            let old: Vec<&String> = earlier.files.iter().filter(|file| !own.contains(file) && out.join(file).is_file()).collect();
            if let (Some(first), Some(last)) = (old.first(), old.last()) {
                eprintln!(
                    "note: {}: {first} to {last} of the earlier render stay there, and are part of no sequence",
                    out.display()
                );
            }
            return Ok(Work { missing, lengthened });
        }
        let scene = if kept { Vec::new() } else { self.scene_differences() };
        ensure!(scene.is_empty(), "{}: is of another scene{}; {way}", out.join(SCENE).display(), listed(": ", &scene, ""));
        let keyframes = self.sequence()?.keyframes;
        let begins = earlier.cameras.len() <= self.job.numbers(self.loaded.cameras.len()).count();
        let until = if begins { earlier.cameras.len() } else { usize::MAX };
        ensure!(
            earlier.keyframes.iter().eq(keyframes.iter().filter(|&&key| key < until)),
            "{}: /keyframes: were {:?}, now {keyframes:?}; {way}",
            out.join(TRANSFORMS).display(),
            earlier.keyframes
        );
        Ok(Work { missing, lengthened })
    }

    /// Whether the files `paths`, which are made from the frames, may be written after `work`.
    ///
    /// # Errors
    /// When one of them is there, and nothing says that it came from an earlier render.
    pub fn check_beside(&self, work: &Work, paths: &[PathBuf]) -> Result<()> {
        let kept = work.missing.len() < self.job.numbers(self.loaded.cameras.len()).count();
        if kept || self.earlier().is_some() {
            return Ok(());
        }
        match paths.iter().find(|path| output::exists(path)) {
            Some(path) => bail!("{}: {FOREIGN}", path.display()),
            None => Ok(()),
        }
    }

    /// Cameras and files of an earlier render in the folder; `None` where there was none.
    fn earlier(&self) -> Option<transforms::Sequence> {
        let stored: Scene = file::read_json(&self.job.out.join(SCENE)).ok()?;
        let sequence = transforms::read(&self.job.out.join(TRANSFORMS)).ok()?;
        (stored.version == self.job.scene.version && sequence.environment == ENVIRONMENT).then_some(sequence)
    }

    /// The hash of this scene with `frames` frames, if it would be a beginning of this sequence. Materials that change do so over
    /// the whole sequence, so that each length has other pictures.
    fn shorter(&self, frames: u32) -> Option<String> {
        let scene = &self.job.scene;
        let still = self.loaded.materials.iter().all(|material| material.change.is_none());
        (still && frames < scene.frames).then(|| Scene { frames, ..scene.clone() }.hash())
    }

    /// Whether frame `number` is there as part of a shorter sequence: of the length that the folder tells, or ending here.
    fn is_beginning(&self, number: usize, settings: &TruthSettings) -> Result<bool> {
        let told = file::read_json::<Scene>(&self.job.out.join(SCENE)).ok().map(|scene| scene.frames);
        for frames in told.into_iter().chain([number as u32 + 1]) {
            if self.is_of(number, self.shorter(frames), settings)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Whether frame `number` is there with these settings, of the scene with this hash.
    fn is_of(&self, number: usize, hash: Option<String>, settings: &TruthSettings) -> Result<bool> {
        let Some(hash) = hash else { return Ok(false) };
        Ok(match frame_file::read(&self.path(number)) {
            Ok(frame) => {
                frame.info.check_scene(&hash, &self.loaded.files).is_ok()
                    && self.differences(&frame, number, settings)?.is_empty()
            }
            Err(_) => false,
        })
    }

    /// What is in the place of frame `number`.
    pub fn found(&self, number: usize, settings: &TruthSettings) -> Result<Existing> {
        let path = self.path(number);
        if !output::exists(&path) {
            return Ok(Existing::Nothing);
        }
        let frame = match frame_file::read(&path) {
            Ok(frame) => frame,
            Err(error) => return Ok(Existing::Broken(error.into())),
        };
        let other = frame.info.scene_hash != self.loaded.hash;
        let changed = frame.info.check_scene(&self.loaded.hash, &self.loaded.files).is_err();
        let scene = match (other, changed) {
            (true, _) => Some(format!("is of another scene{}", listed(" (", &self.scene_differences(), ")"))),
            (false, true) => Some("was rendered before files that the scene names changed".into()),
            (false, false) => None,
        };
        let settings = self.differences(&frame, number, settings)?;
        let settings = listed("is of other settings: ", &settings, "");
        let what: Vec<String> = scene.into_iter().chain((!settings.is_empty()).then_some(settings)).collect();
        Ok(if what.is_empty() { Existing::Same } else { Existing::Other(format!("{}: {}", path.display(), what.join(" and "))) })
    }

    /// How the settings of `frame` differ from those that it should have: the old and the new value of each.
    fn differences(&self, frame: &Frame, number: usize, settings: &TruthSettings) -> Result<Vec<String>> {
        let (info, render) = (&frame.info, &settings.render);
        let compact = self.job.storage == Profile::Compact;
        let mut found: Vec<String> = Vec::new();
        let mut put = |what: &str, was: String, now: String| found.push(format!("{what} was {was}, now {now}"));
        let yes = |given: bool| if given { "there" } else { "not there" }.to_owned();
        if render.spp == 0 {
            if info.spp != 0 || frame.beauty.is_some() {
                put("the picture", yes(true), yes(false));
            }
        } else {
            let mut expected = *render;
            let spread = |sampling: &str, spp: u32| match sampling {
                "" => format!("{spp} in every pixel"),
                sampling => sampling.to_owned(),
            };
            let was = spread(&info.sampling, info.spp);
            match &settings.sample_map {
                None if render.budget == Budget::Uniform && (!info.sampling.is_empty() || info.spp != render.spp) => {
                    put("the number of samples", was, spread("", render.spp));
                }
                None if render.budget == Budget::Uniform => {}
                None if info.sampling != expected.sampling() => put("the number of samples", was, expected.sampling()),
                None => {}
                Some(map) => {
                    let (mapped, other) = settings.mapped(map, number, self.loaded.cameras.len())?;
                    expected = mapped;
                    if frame.samples != other.samples {
                        put("the number of samples", was, format!("that of {}", map.display()));
                    }
                }
            }
            let none = |name: &Option<String>| name.clone().unwrap_or_else(|| "none".into());
            // Denoising with the frames around comes after rendering.
            let waits = settings.neighbours != Neighbours::Alone && info.denoiser.is_none();
            if info.denoiser != settings.denoiser_name() && !waits {
                put("the denoiser", none(&info.denoiser), none(&settings.denoiser_name()));
            }
            let lens = |lens: &str| if lens.is_empty() { "a pinhole".to_owned() } else { lens.to_owned() };
            let wanted = render.lens.map(|lens| lens.to_string()).unwrap_or_default();
            if info.lens != wanted {
                put("the lens", lens(&info.lens), lens(&wanted));
            }
            let shutter = |shutter: &str| if shutter.is_empty() { "open for one moment".to_owned() } else { shutter.to_owned() };
            let wanted = settings.shutter.map(|shutter| shutter.to_string()).unwrap_or_default();
            if info.shutter != wanted {
                put("the shutter", shutter(&info.shutter), shutter(&wanted));
            }
            if info.bsdf != render.bsdf.name() {
                put("the BRDF", info.bsdf.clone(), render.bsdf.name().into());
            }
            if let Some(bounces) = info.max_bounces.filter(|bounces| *bounces != render.max_bounces) {
                put("the number of bounces", bounces.to_string(), render.max_bounces.to_string());
            }
            let branches = info.branches.unwrap_or(1);
            if branches != expected.branches() {
                put("the number of samples that share a camera ray", branches.to_string(), expected.branches().to_string());
            }
            if info.indirect_limit != render.clamp_indirect {
                let limit = |limit: Option<f32>| limit.map_or_else(|| "none".into(), |limit| limit.to_string());
                put("the limit of indirect light", limit(info.indirect_limit), limit(render.clamp_indirect));
            }
            // Frames may lack them because the scene has no use for them.
            if !expected.light_paths && info.light_paths {
                put("tracing paths from the light", "on".into(), "off".into());
            }
            let groups = frame.light.iter().flatten().count();
            if groups != render.light_groups as usize && !compact {
                put("the number of light groups", groups.to_string(), render.light_groups.to_string());
            }
            // Raw frames without it are denoised as they are.
            let [has, wanted] = [frame.indirect.is_some(), settings.keeps_paths];
            if (if has { !settings.stores_paths() } else { wanted }) && !compact {
                put("the indirect light", yes(has), yes(wanted));
            }
        }
        if frame.irradiance.is_some() != render.irradiance {
            put("the irradiance", yes(frame.irradiance.is_some()), yes(render.irradiance));
        }
        if frame.distance.is_some() != settings.distance && !compact {
            put("the distance", yes(frame.distance.is_some()), yes(settings.distance));
        }
        Ok(found)
    }

    /// The places where `scene.json` in the folder differs from this scene; empty where it cannot be read.
    fn scene_differences(&self) -> Vec<String> {
        let stored = file::read_json::<Scene>(&self.job.out.join(SCENE)).ok();
        let own = with_absolute_paths(&self.job.scene, self.job.base.base()).ok();
        // Through text: a single-precision 3.6 would otherwise print as 3.5999999046325684.
        let value = |scene: Option<Scene>| serde_json::from_str(&serde_json::to_string(&scene?).ok()?).ok();
        let mut found = Vec::new();
        if let (Some(stored), Some(own)) = (value(stored), value(own)) {
            compare("", &stored, &own, &mut found);
        }
        let changes = self.loaded.materials.iter().any(|material| material.change.is_some());
        if let ([only], true) = (found.as_mut_slice(), changes)
            && only.starts_with("/frames ")
        {
            only.push_str("; its materials change from the first frame to the last, so each length has other pictures");
        }
        found
    }
}

/// The first few of `things`, between `before` and `after`; empty where there are none.
fn listed(before: &str, things: &[String], after: &str) -> String {
    const SHOWN: usize = 3;
    if things.is_empty() {
        return String::new();
    }
    let more = things.len().saturating_sub(SHOWN);
    let more = if more > 0 { format!("; {more} more") } else { String::new() };
    format!("{before}{}{more}{after}", things[..things.len().min(SHOWN)].join("; "))
}

/// Adds the pointer of every value that differs, with both values.
fn compare(pointer: &str, was: &Value, now: &Value, found: &mut Vec<String>) {
    let short = |value: &Value| match value {
        Array(_) | Object(_) => "a list or an object".to_owned(),
        Null => "none".to_owned(),
        value => {
            let text = value.to_string();
            if text.chars().count() <= 60 { text } else { format!("{}...", text.chars().take(57).collect::<String>()) }
        }
    };
    match (was, now) {
        (Object(a), Object(b)) => {
            let names: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
            for name in names {
                let at = |object: &serde_json::Map<String, Value>| object.get(name).cloned().unwrap_or(Null);
                compare(&format!("{pointer}/{name}"), &at(a), &at(b), found);
            }
        }
        (Array(a), Array(b)) if a.len() == b.len() => {
            for (index, (a, b)) in a.iter().zip(b).enumerate() {
                compare(&format!("{pointer}/{index}"), a, b, found);
            }
        }
        (Array(a), Array(b)) => found.push(format!("{pointer} had {} entries, now {}", a.len(), b.len())),
        _ if was != now => found.push(format!("{pointer} was {}, now {}", short(was), short(now))),
        _ => {}
    }
}

/// What is in the place of a frame.
pub enum Existing {
    /// The frame, of this scene and with these settings.
    Same,
    /// A frame of another scene or of other settings; in words, which.
    Other(String),
    /// Something that cannot be read as a frame.
    Broken(anyhow::Error),
    /// Nothing.
    Nothing,
}
