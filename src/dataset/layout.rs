//! The names of the files and folders of a dataset.
//!
//! ```text
//! DATASET/plan.json                    the plan; manifest.json follows when every sequence is complete
//! DATASET/logs/*.jsonl                 the logs of shards
//! DATASET/<split>/seq-000123/          a sequence: scene.json, transforms.json, env.hdr,
//!                                      frame.0000.exr | .rff, ..., and sequence.json, which is written last
//! ```

use renderflow_frame::frame_file::{self, Profile};
use std::path::Path;

/// The plan of a dataset.
pub const PLAN: &str = "plan.json";
/// The list of all sequences of a finished dataset.
pub const MANIFEST: &str = "manifest.json";
/// Folder for what was in the way.
pub const ASIDE: &str = "aside";

/// The scene of a sequence, with the full paths of the files that it names.
pub const SCENE: &str = "scene.json";
/// The cameras of a sequence. A folder is a sequence where it holds this file.
pub const TRANSFORMS: &str = "transforms.json";
/// The light of a sequence.
pub const ENVIRONMENT: &str = "env.hdr";
/// The descriptions of a sequence, beside its frames.
pub const DESCRIPTIONS: [&str; 3] = [SCENE, TRANSFORMS, ENVIRONMENT];
/// The record of a finished sequence.
pub const RECORD: &str = "sequence.json";
/// The list of the frames of a sequence that failed.
pub const FAILURES: &str = "failures.json";
/// The seconds that each frame of truth took.
pub const TIMING: &str = "timing.json";
/// The labelled channels of the first frame of a render.
pub const SHEET: &str = "sheet.png";
/// The frames of a render, one after the other.
pub const ANIMATION: &str = "frames.gif";
/// How far the truth of a sequence is from a longer render.
pub const AUDIT: &str = "audit.json";

/// File name of frame `number` of a sequence.
pub fn frame_file(number: usize, profile: Profile) -> String {
    format!("frame.{number:04}.{}", profile.extension())
}

/// Inverse of [`frame_file`]; `None` for other names.
pub fn frame_number(file: &str) -> Option<usize> {
    let (number, ending) = file.strip_prefix("frame.")?.split_once('.')?;
    frame_file::EXTENSIONS.contains(&ending).then(|| number.parse().ok())?
}

/// Whether `folder` is where a dataset keeps what was in the way, which is no part of it.
pub fn is_aside(folder: &Path) -> bool {
    folder.file_name().is_some_and(|name| name == ASIDE) && folder.with_file_name(PLAN).exists()
}

/// Whether `folder` holds a sequence.
pub fn is_sequence(folder: &Path) -> bool {
    folder.join(TRANSFORMS).is_file()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_frame_files() {
        for number in [0, 7, 9999, 12345] {
            for profile in [Profile::Full, Profile::Compact] {
                assert_eq!(frame_number(&frame_file(number, profile)), Some(number));
            }
        }
        for other in ["frame.0001.png", "frame.0001", "frame.x.exr", "image.0001.exr", "frame.0001.exr.tmp"] {
            assert_eq!(frame_number(other), None, "{other}");
        }
    }
}
