//! COCO instances: `OUT/<split>/seq-000123_0007.png` and `OUT/annotations/instances_<split>.json`.
//!
//! One annotation an object and frame, its mask as compressed run lengths (column by column, as pycocotools has them), from the
//! object ids at pixel centres. Categories are mesh families: those that the sequence recorded, else what stands in an object's
//! name before the first `_01`. A category has the same id in every split: the program's mesh families have theirs by their place
//! in its list, from 1 on, in all datasets; a user's models (`file`) follow, then what else stands in the scenes of the dataset
//! (ground, walls, ...), by name. A part of a dataset is exported with the ids of the whole.

use super::picture::{byte, png};
use super::{Job, displayed};
use crate::dataset::Sequence;
use crate::dataset::whole::{self, key};
use anyhow::{Context, Result, bail};
use renderflow_frame::Image;
use renderflow_frame::file;
use renderflow_scenes::shapes::FAMILIES;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

#[derive(Serialize)]
struct Instances {
    info: Info,
    images: Vec<Picture>,
    annotations: Vec<Annotation>,
    categories: Vec<Category>,
}

#[derive(Serialize)]
struct Info {
    description: &'static str,
    version: &'static str,
}

#[derive(Serialize)]
struct Picture {
    id: usize,
    file_name: String,
    width: usize,
    height: usize,
}

#[derive(Serialize)]
struct Category {
    id: usize,
    name: String,
    supercategory: &'static str,
}

#[derive(Serialize)]
struct Annotation {
    id: usize,
    image_id: usize,
    category_id: usize,
    segmentation: RunLengths,
    area: usize,
    /// x, y of the top left corner, width, height.
    bbox: [usize; 4],
    iscrowd: u8,
    /// The object in its scene, so that instances can be followed from frame to frame.
    object_id: u32,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct RunLengths {
    /// Height, width.
    size: [usize; 2],
    counts: String,
}

/// One object in one frame.
struct Mask {
    object: u32,
    area: usize,
    bbox: [usize; 4],
    runs: RunLengths,
}

/// The lengths of runs in pycocotools' characters. The first run is of pixels outside of the mask. From the third on, each length
/// is stored as its difference to the one before the last, in groups of five bits, lowest first; bit 6 is set where another group
/// follows (`rleToString` of maskApi.c).
fn characters(runs: &[i64]) -> String {
    let mut text = String::new();
    for (i, &run) in runs.iter().enumerate() {
        let mut rest = if i > 2 { run - runs[i - 2] } else { run };
        loop {
            let bits = (rest & 0x1f) as u8;
            rest >>= 5;
            let more = rest != if bits & 0x10 != 0 { -1 } else { 0 };
            text.push(char::from(48 + bits + if more { 0x20 } else { 0 }));
            if !more {
                break;
            }
        }
    }
    text
}

/// The masks of all objects in a frame, by id.
fn masks(ids: &Image<u32>) -> Vec<Mask> {
    struct Growing {
        runs: Vec<i64>,
        /// Where the last run ends, column by column.
        end: usize,
        area: usize,
        low: [usize; 2],
        high: [usize; 2],
    }
    let (width, height) = (ids.width, ids.height);
    let mut found: BTreeMap<u32, Growing> = BTreeMap::new();
    for x in 0..width {
        for y in 0..height {
            let id = ids.pixels[y * width + x];
            if id == 0 {
                continue;
            }
            let at = x * height + y;
            let new = || Growing { runs: Vec::new(), end: 0, area: 0, low: [x, y], high: [x, y] };
            let mask = found.entry(id).or_insert_with(new);
            match mask.runs.last_mut() {
                Some(run) if mask.end == at => *run += 1,
                _ => mask.runs.extend([(at - mask.end) as i64, 1]),
            }
            mask.end = at + 1;
            mask.area += 1;
            mask.low = [mask.low[0].min(x), mask.low[1].min(y)];
            mask.high = [mask.high[0].max(x), mask.high[1].max(y)];
        }
    }
    let finish = |(object, mut mask): (u32, Growing)| {
        if mask.end < width * height {
            mask.runs.push((width * height - mask.end) as i64);
        }
        let [[x, y], [right, bottom]] = [mask.low, mask.high];
        let runs = RunLengths { size: [height, width], counts: characters(&mask.runs) };
        Mask { object, area: mask.area, bbox: [x, y, right + 1 - x, bottom + 1 - y], runs }
    };
    found.into_iter().map(finish).collect()
}

#[derive(Deserialize)]
struct Scene {
    objects: Vec<Named>,
    #[serde(default)]
    lights: Vec<Lamp>,
}

/// A light. Its id follows those of the objects.
#[derive(Deserialize)]
struct Lamp {
    name: String,
    kind: BTreeMap<String, serde::de::IgnoredAny>,
}

#[derive(Deserialize)]
struct Named {
    name: String,
}

/// The part of a name before its first number: `table` for `table_07`, and for its part `table_07_2`.
fn family(name: &str) -> &str {
    let mut end = 0;
    for word in name.split('_') {
        if end > 0 && !word.is_empty() && word.bytes().all(|b| b.is_ascii_digit()) {
            return &name[..end - 1];
        }
        end += word.len() + 1;
    }
    name
}

/// Category names by id, from 1 on.
#[derive(Default)]
pub struct Categories(BTreeMap<String, usize>);

impl Categories {
    /// The categories of the dataset in `root`; `exported` is a part of it, or the whole.
    ///
    /// # Errors
    /// When a scene cannot be read.
    pub fn of(root: &Path, exported: &[Sequence]) -> Result<Self> {
        let whole = whole::open(root).map(|found| found.sequences).unwrap_or_else(|_| {
            eprintln!("note: {}: is not complete; ids of what is no mesh family may be others once it is", root.display());
            Vec::new()
        });
        let families: Vec<&str> = FAMILIES.iter().copied().chain([USERS]).collect();
        let mut others = BTreeSet::new();
        for sequence in if whole.is_empty() { exported } else { &whole } {
            let new = |name: &String| !name.is_empty() && !families.contains(&name.as_str());
            others.extend(categories(sequence)?.into_iter().filter(new));
        }
        Ok(Self(families.into_iter().map(str::to_owned).chain(others).zip(1..).collect()))
    }

    fn id(&self, name: &str) -> Result<usize> {
        self.0.get(name).copied().with_context(|| format!("{name}: is not a category of the dataset"))
    }

    fn list(&self) -> Vec<Category> {
        let mut list: Vec<Category> =
            self.0.iter().map(|(name, &id)| Category { id, name: name.clone(), supercategory: "object" }).collect();
        list.sort_by_key(|category| category.id);
        list
    }
}

/// The family that records have for a user's models.
const USERS: &str = "file";

/// The kinds of lights that pixels can show.
const SEEN: [&str; 3] = ["sphere", "disk", "rectangle"];

/// Category of each object and then of each light; object id 1 is the first. It is empty for a light that no pixel shows.
fn categories(sequence: &Sequence) -> Result<Vec<String>> {
    let scene: Scene = file::read_json(&sequence.folder.join("scene.json"))?;
    let recorded =
        |name: &str| sequence.record.iter().flat_map(|r| &r.objects).find(|o| o.name == name).map(|o| o.family.clone());
    let objects = scene.objects.iter().map(|o| recorded(&o.name).unwrap_or_else(|| family(&o.name).to_owned()));
    let seen = |lamp: &Lamp| SEEN.iter().any(|kind| lamp.kind.contains_key(*kind));
    let lamps = scene.lights.iter().map(|lamp| if seen(lamp) { family(&lamp.name).to_owned() } else { String::new() });
    Ok(objects.chain(lamps).collect())
}

/// File name of a picture in the folder of its split.
fn picture_file(sequence: &Sequence, index: usize) -> String {
    format!("{}.png", key(sequence, index))
}

/// The annotations of a split.
fn annotations_file(sequences: &[Sequence], out: &Path) -> PathBuf {
    out.join(format!("annotations/instances_{}.json", sequences[0].split))
}

/// Checks that the annotations of a split, where an earlier export left some, hold no other sequences than these.
///
/// # Errors
/// When they do: the other sequences would be lost. When the annotations cannot be read.
pub fn holds_no_more(sequences: &[Sequence], out: &Path) -> Result<()> {
    #[derive(Deserialize)]
    struct Earlier {
        images: Vec<EarlierPicture>,
    }
    #[derive(Deserialize)]
    struct EarlierPicture {
        file_name: String,
    }
    let path = annotations_file(sequences, out);
    // It may be larger than other texts.
    let earlier: Earlier = match file::read(&path) {
        Err(error) if error.is_missing() => return Ok(()),
        bytes => file::parse_json(&path, &bytes?)?,
    };
    let frames = sequences.iter().flat_map(|sequence| (0..sequence.len()).map(move |index| (sequence, index)));
    let own: BTreeSet<String> = frames.map(|(sequence, index)| picture_file(sequence, index)).collect();
    match earlier.images.iter().find(|picture| !own.contains(&picture.file_name)) {
        Some(EarlierPicture { file_name }) => bail!(
            "{}: also lists {file_name}, which would be lost; export all of the split, or choose another folder",
            path.display()
        ),
        None => Ok(()),
    }
}

/// The sequences of one split.
pub fn split(sequences: &[Sequence], ids: &Categories, out: &Path, job: &Job) -> Result<()> {
    let (mut images, mut found): (Vec<Picture>, Vec<(usize, usize, Mask)>) = (Vec::new(), Vec::new());
    for sequence in sequences {
        let categories = categories(sequence)?;
        let folder = out.join(sequence.split.name());
        let frames = job.frames(sequence, |index, frame| {
            let picture = displayed(&frame, sequence.transforms.exposure)?;
            let file_name = picture_file(sequence, index);
            let bytes = png(frame.width, frame.height, picture.pixels.iter().map(|p| p.map(byte)))?;
            job.write(folder.join(&file_name), &bytes)?;
            Ok((file_name, frame.width, frame.height, masks(&frame.object_id)))
        })?;
        for (file_name, width, height, masks) in frames {
            let id = images.len() + 1;
            for mask in masks {
                let category = categories.get(mask.object as usize - 1);
                let category = category.with_context(|| format!("{file_name}: object {} is not in scene.json", mask.object))?;
                found.push((id, ids.id(category)?, mask));
            }
            images.push(Picture { id, file_name, width, height });
        }
    }
    let annotations = found.iter().zip(1..).map(|((image_id, category, mask), id)| Annotation {
        id,
        image_id: *image_id,
        category_id: *category,
        segmentation: mask.runs.clone(),
        area: mask.area,
        bbox: mask.bbox,
        iscrowd: 0,
        object_id: mask.object,
    });
    let annotations = annotations.collect();
    let categories = ids.list();
    let info = Info { description: "RenderFlow", version: env!("CARGO_PKG_VERSION") };
    let text = serde_json::to_vec(&Instances { info, images, annotations, categories })?;
    job.write(annotations_file(sequences, out), &text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_go_down_the_columns() {
        // pycocotools 2.0.10: encode(asfortranarray([[0, 1, 1], [0, 1, 0]])) and of a mask of ones.
        let ids = Image { width: 3, height: 2, pixels: vec![0, 7, 7, 0, 7, 0] };
        let [mask] = &masks(&ids)[..] else { panic!("one object") };
        assert_eq!((mask.object, mask.area, mask.bbox), (7, 3, [1, 0, 2, 2]));
        assert_eq!(mask.runs, RunLengths { size: [2, 3], counts: "231".into() });
        assert_eq!(masks(&Image::filled(3, 2, 1))[0].runs.counts, "06");
        assert_eq!(characters(&[5, 40, 900, 2]), "5X1Tl0jN");
        assert!(masks(&Image::filled(3, 2, 0)).is_empty());
    }

    #[test]
    fn families_are_what_stands_before_the_number() {
        for (name, expected) in [
            ("pipe_01", "pipe"),
            ("ground", "ground"),
            ("gear_box_12", "gear_box"),
            ("table_07_2", "table"),
            ("a_b", "a_b"),
            ("7_1", "7"),
        ] {
            assert_eq!(family(name), expected);
        }
    }
}
