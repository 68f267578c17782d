//! Compares anybody's pictures with the truth: names are matched by rule, and the colour curve and the metrics are the same for
//! all.

use super::find::{TestSequence, find};
use super::results::{ABOUT, About, Group, MethodInfo, Score, SequenceSummary, TRUTH, Truth, VERSION, picture_file, place};
use super::run::{CURVE, forget, lpips, write_scores};
use crate::dataset::sequence::find_folders;
use crate::metrics::temporal::{Pair, correspondence, temporal};
use crate::metrics::{self, Hdr, Networks, values};
use crate::util::cancel::Cancel;
use crate::util::output::Claim;
use crate::util::progress::Progress;
use crate::util::text::plural;
use crate::util::{files, picture};
use anyhow::{Context, Result, bail, ensure};
use rayon::prelude::*;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::{Frame, color, exr, file, hdr};
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Endings of pictures that can be compared. If a picture is there with several endings, the first one here is taken: radiance
/// before display values.
pub const ENDINGS: [&str; 3] = ["exr", "hdr", "png"];

/// The first bytes of every OpenEXR file.
const EXR: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// How to compare.
pub struct Options<'a> {
    /// LPIPS, if its weights are there.
    pub lpips: &'a Networks,
    /// Name of the method in tables.
    pub label: String,
    /// Factor from radiance to display-linear, for truth that is not a dataset and so has no exposure of its own; `None` for 1.
    pub exposure: Option<f32>,
    /// Leaves out truth without a picture, instead of failing.
    pub partial: bool,
    /// Number of frames in each sequence whose pictures are stored.
    pub pictures: usize,
}

/// A picture: display values; radiance and coverage where the file holds them.
struct Read {
    display: Rgb,
    linear: Option<Rgb>,
    alpha: Option<Image<f32>>,
    frame: Option<Frame>,
}

/// A picture and its truth.
struct Match<'a> {
    /// Number of the frame.
    number: usize,
    truth: &'a Path,
    picture: PathBuf,
}

/// A sequence of truth, or a folder of pictures.
struct TruthFolder {
    set: String,
    class: String,
    /// Its name in the results.
    name: String,
    /// Path below the truth; the predictions may lie under the same path.
    path: PathBuf,
    exposure: f32,
    test: Option<TestSequence>,
    /// Number and file of every truth. The number comes from the names of the files, or is the position where two names end in
    /// the same number or one ends in none.
    truths: Vec<(usize, PathBuf)>,
}

impl TruthFolder {
    /// The set, the class and the name in one text.
    fn place(&self) -> String {
        place(&self.set, &self.class, &self.name)
    }

    /// The folders in which its predictions may be, below that of all.
    fn places(&self) -> [PathBuf; 4] {
        let class = PathBuf::from(&self.class).join(&self.name);
        [self.path.clone(), PathBuf::from(&self.set).join(&class), class, PathBuf::from(&self.name)]
    }
}

/// Compares the pictures below `predictions` with those below `truth` and writes results into `out`. Returns how many were
/// compared.
///
/// A picture belongs to the truth of the same path, endings apart; else to the only one of the same folder whose name ends in the
/// same number. Where one is there with several endings, the EXR is taken, else the HDR. The folder of a truth's sequence may be
/// named in full or by its last part, and left out where there is only one.
///
/// PNG holds display values as they are. EXR and HDR hold scene-linear radiance, which becomes sRGB(clamp(exposure x radiance))
/// with the exposure of the truth's sequence, or `options.exposure` where the truth is no dataset.
///
/// Every comparison is made again. Results of other folders of truth in `out` stay, but no longer count.
///
/// # Errors
/// When a picture is missing (unless `partial`), cannot be read, or differs in size; all missing ones are counted, the first
/// named. When an exposure is given for a dataset.
pub fn run(
    predictions: &Path,
    truth: &Path,
    options: &Options,
    out: &Path,
    progress: &Progress,
    cancel: &Cancel,
) -> Result<usize> {
    let folders = folders(truth, options.exposure)?;
    let pairs = matched(predictions, &folders, options.partial)?;
    let method = MethodInfo::new("pictures".into(), options.label.clone(), Group::Other);
    let mut asked = BTreeMap::new();
    for (folder, pairs) in folders.iter().zip(&pairs).filter(|(_, pairs)| !pairs.is_empty()) {
        let twice = asked.insert(folder.place(), data(pairs)?).is_some();
        ensure!(!twice, "{}: two of its folders would be called {} in the results", truth.display(), folder.name);
    }
    let about = About {
        version: VERSION,
        program: concat!("renderflow ", env!("CARGO_PKG_VERSION")).into(),
        title: format!("{} against the truth", options.label),
        machine: crate::util::machine::processor(),
        lpips: Some(lpips(options.lpips)),
        curve: CURVE.into(),
        methods: vec![method],
        settings: vec![
            ("pictures".into(), predictions.display().to_string()),
            ("truth".into(), truth.display().to_string()),
            ("exposure where the truth has none".into(), options.exposure.unwrap_or(1.0).to_string()),
        ],
        sequences: Some(asked.clone()),
    };
    // The folders of truth and pictures are settings here: other folders make another comparison.
    let claim = Claim::agreed(out, ABOUT, &about, |stored: &About| {
        let same = (&stored.methods, &stored.settings) == (&about.methods, &about.settings);
        ensure!(same, "the folder holds results of other pictures or settings; choose another folder");
        Ok(())
    })?;
    progress.length(pairs.iter().map(|pairs| pairs.len() as u64).sum());
    let mut compared = 0;
    for (folder, pairs) in folders.iter().zip(&pairs) {
        if pairs.is_empty() {
            continue;
        }
        let class = out.join(&folder.set).join(&folder.class);
        let (about, scores, shown_pictures) = sequence(folder, pairs, options, progress, cancel)?;
        let about = SequenceSummary { data: asked.get(&folder.place()).cloned(), ..about };
        claim.write()?;
        forget(&class.join(format!("{}.json", about.name)))?;
        for (name, bytes) in shown_pictures {
            file::write_atomic(&class.join(&folder.name).join(name), &bytes)?;
        }
        write_scores(&class.join(format!("{}.jsonl", about.name)), &scores)?;
        file::write_json(&class.join(format!("{}.json", about.name)), &about)?;
        compared += scores.len();
    }
    Ok(compared)
}

/// Finds the truth: sequences, or folders of plain pictures, whose exposure is 1 or the one that is given.
fn folders(truth: &Path, given: Option<f32>) -> Result<Vec<TruthFolder>> {
    let exposure = given.unwrap_or(1.0);
    ensure!(exposure.is_finite() && exposure > 0.0, "the exposure {exposure} is not a positive number");
    if !find_folders(truth)?.is_empty() {
        ensure!(given.is_none(), "{}: is a dataset, which has an exposure of its own; leave out --exposure", truth.display());
        let folder = |test: TestSequence| TruthFolder {
            set: test.set.clone(),
            class: test.class.clone(),
            name: test.sequence.name.clone(),
            path: test.sequence.folder.strip_prefix(truth).unwrap_or(Path::new("")).to_owned(),
            exposure: test.sequence.exposure(),
            truths: (0..test.sequence.len()).map(|i| (test.sequence.numbers[i], test.sequence.file(i))).collect(),
            test: Some(test),
        };
        return Ok(find(truth)?.into_iter().map(folder).collect());
    }
    let mut by_folder: BTreeMap<PathBuf, Vec<PathBuf>> = BTreeMap::new();
    for path in pictures(truth)? {
        let parent = path.parent().and_then(|p| p.strip_prefix(truth).ok()).unwrap_or(Path::new("")).to_owned();
        by_folder.entry(parent).or_default().push(path);
    }
    ensure!(!by_folder.is_empty(), "{}: neither sequences nor pictures ({})", truth.display(), ENDINGS.join(", "));
    let own = truth.file_name().map_or_else(|| "truth".into(), |name| name.to_string_lossy().into_owned());
    let folder = |(path, paths): (PathBuf, Vec<PathBuf>)| {
        let name = path.to_string_lossy().into_owned();
        let numbers: Vec<Option<usize>> = paths.iter().map(|path| number(path)).collect();
        let distinct: BTreeSet<usize> = numbers.iter().copied().flatten().collect();
        let numbered = distinct.len() == paths.len();
        let truths = paths.into_iter().enumerate().map(|(i, path)| (if numbered { numbers[i].unwrap_or(i) } else { i }, path));
        // The results of NAME are in the files NAME.json and NAME.jsonl.
        let name = if name.is_empty() { own.clone() } else { name.replace(['/', '\\'], "-").replace(".json", "-json") };
        TruthFolder { set: own.clone(), class: "pictures".into(), name, path, exposure, test: None, truths: truths.collect() }
    };
    Ok(by_folder.into_iter().map(folder).collect())
}

/// The pictures below a folder, by path. Of files that differ only in their ending, the one that holds most is taken.
fn pictures(folder: &Path) -> Result<Vec<PathBuf>> {
    let all = files::walk(folder, &ENDINGS)?;
    let count = all.len();
    let mut best: BTreeMap<PathBuf, PathBuf> = BTreeMap::new();
    let rank = |path: &Path| ENDINGS.iter().position(|known| *known == files::ending(path));
    for path in all {
        match best.entry(path.with_extension("")) {
            Entry::Vacant(place) => drop(place.insert(path)),
            Entry::Occupied(mut place) if rank(&path) < rank(place.get()) => drop(place.insert(path)),
            Entry::Occupied(_) => {}
        }
    }
    if best.len() < count {
        eprintln!(
            "note: {}: {} in several forms; radiance is taken (EXR, else HDR)",
            folder.display(),
            plural(count - best.len(), "picture")
        );
    }
    Ok(best.into_values().collect())
}

/// The number at the end of a file's name.
fn number(path: &Path) -> Option<usize> {
    let stem = path.file_stem()?.to_string_lossy().into_owned();
    let end = stem.trim_end_matches(|c: char| !c.is_ascii_digit());
    let digits = end.len() - end.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    end[end.len() - digits..].parse().ok()
}

/// Finds the prediction of every truth.
fn matched<'a>(predictions: &Path, folders: &'a [TruthFolder], partial: bool) -> Result<Vec<Vec<Match<'a>>>> {
    let all = pictures(predictions)?;
    let mut by_name: BTreeMap<(PathBuf, String), &PathBuf> = BTreeMap::new();
    let mut by_number: BTreeMap<(PathBuf, usize), Vec<&PathBuf>> = BTreeMap::new();
    for path in &all {
        let Ok(relative) = path.strip_prefix(predictions) else { continue };
        let parent = relative.parent().unwrap_or(Path::new("")).to_owned();
        let stem = relative.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        by_name.insert((parent.clone(), stem), path);
        if let Some(number) = number(path) {
            by_number.entry((parent, number)).or_default().push(path);
        }
    }
    let mut owners: BTreeMap<PathBuf, BTreeSet<usize>> = BTreeMap::new();
    for (i, folder) in folders.iter().enumerate() {
        for place in folder.places() {
            owners.entry(place).or_default().insert(i);
        }
    }
    let shared = |place: &Path| {
        owners.get(place).is_some_and(|owners| owners.len() > 1) && folders.iter().all(|folder| folder.path != place)
    };
    if let Some((parent, _)) = by_name.keys().find(|(parent, _)| shared(parent)) {
        let place = predictions.join(parent);
        bail!("{}: several sequences of the truth have this name; name the set and the class too", place.display());
    }
    let (mut pairs, mut missing) = (Vec::new(), Vec::new());
    for folder in folders {
        // Where a name is the whole path of one sequence and the last part of another's, it means the first.
        let mut places = folder.places().to_vec();
        places.retain(|place| *place == folder.path || owners[place].len() == 1);
        if folders.len() == 1 {
            places.push(PathBuf::new());
        }
        let mut truths_of: BTreeMap<usize, usize> = BTreeMap::new();
        folder.truths.iter().filter_map(|(_, truth)| number(truth)).for_each(|number| *truths_of.entry(number).or_default() += 1);
        let mut found = Vec::new();
        for (position, truth) in &folder.truths {
            let stem = truth.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let named = places.iter().find_map(|place| by_name.get(&(place.clone(), stem.clone())).copied());
            // A truth whose name ends in no number, or in that of another truth, is known by its name alone.
            let numbered = || -> Result<Option<&PathBuf>> {
                let own = number(truth).filter(|number| truths_of.get(number) == Some(&1));
                let Some(number) = own else { return Ok(None) };
                let Some(same) = places.iter().find_map(|place| by_number.get(&(place.clone(), number))) else {
                    return Ok(None);
                };
                ensure!(same.len() == 1, "{} and {} both end in {number}: which is it?", same[0].display(), same[1].display());
                Ok(Some(same[0]))
            };
            match named.map_or_else(numbered, |path| Ok(Some(path)))? {
                Some(path) => found.push(Match { number: *position, truth: truth.as_path(), picture: path.clone() }),
                None => missing.push(truth),
            }
        }
        pairs.push(found);
    }
    let count: usize = pairs.iter().map(Vec::len).sum();
    ensure!(
        count > 0,
        "{}: none of its {} has the name or number of a truth",
        predictions.display(),
        plural(all.len(), "picture")
    );
    if let Some(first) = missing.first().filter(|_| !partial) {
        bail!("{}: no picture for {} of the truths, the first is {}", predictions.display(), missing.len(), first.display());
    }
    Ok(pairs)
}

/// Reads a picture; radiance becomes display values by `exposure`. If its size must be `expected`, the size is compared before
/// any pixel is decoded.
fn read(path: &Path, exposure: f32, expected: Option<[usize; 2]>) -> Result<Read> {
    let bytes = picture::bytes(path)?;
    if files::has_ending(path, &["png"]) {
        let picture = picture::decode(path, &bytes, expected)?;
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        let has_alpha = picture.color().has_alpha();
        let pixels = picture.into_rgba32f();
        let display = Rgb { width, height, pixels: pixels.pixels().map(|p| [p[0], p[1], p[2]]).collect() };
        let alpha = has_alpha.then(|| Image { width, height, pixels: pixels.pixels().map(|p| p[3]).collect() });
        return Ok(Read { display, linear: None, alpha, frame: None });
    }
    if let Some(expected) = expected {
        picture::same_size(path, hdr::size(path, &bytes)?, expected)?;
    }
    let linear = decode(path, &bytes)?;
    Ok(Read { display: linear.map(|p| color::display(*p, exposure)), linear: Some(linear), alpha: None, frame: None })
}

/// The radiance in an EXR or HDR file. Components below 0 count as 0, and a pixel that is not finite is black, which a note says.
///
/// # Errors
/// When it cannot be read.
pub fn radiance(path: &Path) -> Result<Rgb> {
    decode(path, &picture::bytes(path)?)
}

/// [`radiance`] from memory.
fn decode(path: &Path, bytes: &[u8]) -> Result<Rgb> {
    let (mut linear, mut broken) = if bytes.starts_with(&EXR) {
        (exr::decode_rgb(path, bytes)?, 0)
    } else {
        let map = hdr::decode(path, bytes)?;
        (map.map, map.repaired)
    };
    for pixel in &mut linear.pixels {
        if pixel.iter().all(|value| value.is_finite()) {
            // Denoisers and wide filters leave components slightly below 0; the others of the pixel are right.
            *pixel = pixel.map(|value| value.max(0.0));
        } else {
            *pixel = [0.0; 3];
            broken += 1;
        }
    }
    if broken > 0 {
        eprintln!("note: {}: {} made black: not finite", path.display(), plural(broken, "pixel"));
    }
    Ok(linear)
}

/// BLAKE3 of the pictures of a folder and their truths.
fn data(pairs: &[Match<'_>]) -> Result<String> {
    let one = |pair: &Match<'_>| Ok((pair.number, files::hash(pair.truth)?, files::hash(&pair.picture)?));
    let hashes = pairs.par_iter().map(one).collect::<Result<Vec<_>>>()?;
    Ok(blake3::hash(&serde_json::to_vec(&hashes)?).to_hex().to_string())
}

impl TruthFolder {
    fn truth(&self, path: &Path) -> Result<Read> {
        let Some(_) = &self.test else { return read(path, self.exposure, None) };
        let mut frame = renderflow_frame::frame_file::read(path)?;
        let linear = frame.beauty.take().with_context(|| format!("{}: has no beauty to compare with", path.display()))?;
        let display = linear.map(|p| color::display(*p, self.exposure));
        Ok(Read { display, linear: Some(linear), alpha: Some(frame.alpha.clone()), frame: Some(frame) })
    }
}

/// Name and bytes of a file.
type NamedFile = (String, Vec<u8>);

/// Compares the pictures of one folder. Returns its summary, the scores, and the pictures to store.
fn sequence(
    folder: &TruthFolder,
    pairs: &[Match<'_>],
    options: &Options,
    progress: &Progress,
    cancel: &Cancel,
) -> Result<(SequenceSummary, Vec<Score>, Vec<NamedFile>)> {
    let keyframes: Vec<usize> = folder
        .test
        .as_ref()
        .map_or_else(Vec::new, |test| test.sequence.transforms.keyframes.iter().map(|&i| test.sequence.numbers[i]).collect());
    let count = options.pictures.min(pairs.len());
    let shown: Vec<usize> = (0..count).map(|k| pairs[(2 * k + 1) * pairs.len() / (2 * count)].number).collect();
    // Neighbours are read twice, so that frames can be compared in parallel.
    let one = |i: usize| -> Result<(Read, Read)> {
        let Match { truth, picture, .. } = &pairs[i];
        let truth = folder.truth(truth)?;
        let size = [truth.display.width, truth.display.height];
        Ok((truth, read(picture, folder.exposure, Some(size))?))
    };
    let score = |i: usize| -> Result<(Score, [usize; 2], Vec<NamedFile>)> {
        cancel.check()?;
        let number = pairs[i].number;
        let (truth, picture) = one(i)?;
        // Radiance is compared where both files hold it.
        let both = truth.linear.is_some() && picture.linear.is_some();
        let truth_hdr = truth.linear.as_ref().filter(|_| both).map(|linear| Hdr { linear, exposure: folder.exposure });
        let picture_hdr = picture.linear.as_ref().filter(|_| both).map(|linear| Hdr { linear, exposure: folder.exposure });
        let reference = metrics::Truth::new(&truth.display, truth.alpha.as_ref(), truth_hdr, options.lpips)?;
        let mut metrics =
            reference.measure(&picture.display, picture_hdr).with_context(|| pairs[i].picture.display().to_string())?;
        if i > 0
            && pairs[i - 1].number + 1 == number
            && let (Some(test), Some(frame)) = (&folder.test, &truth.frame)
        {
            let (before, earlier) = one(i - 1)?;
            let at = |number: usize| test.sequence.numbers.iter().position(|&n| n == number).unwrap_or(0);
            let movement = test.sequence.transforms.tracks.between(at(number), at(pairs[i - 1].number));
            if let Some(previous) = &before.frame {
                let correspondence = correspondence(frame, previous, movement);
                let now = Pair { picture: &picture.display, truth: &truth.display };
                let then = Pair { picture: &earlier.display, truth: &before.display };
                metrics.temporal = temporal(now, then, &correspondence).map(|t| 1000.0 * t);
            }
        }
        let mut shown_pictures = Vec::new();
        if shown.contains(&number) {
            shown_pictures.push((picture_file(number, TRUTH), picture::png(&truth.display)?));
            shown_pictures.push((picture_file(number, "pictures"), picture::png(&picture.display)?));
        }
        progress.add(1);
        let key = keyframes.contains(&number);
        let size = [truth.display.width, truth.display.height];
        let values = values(&metrics)?;
        Ok((Score { method: "pictures".into(), frame: number, key, seconds: None, spp: None, values }, size, shown_pictures))
    };
    let scored = (0..pairs.len()).into_par_iter().with_max_len(1).map(score).collect::<Result<Vec<_>>>()?;
    let [width, height] = scored.first().map_or([0; 2], |(_, size, _)| *size);
    let numbers: Vec<usize> = pairs.iter().map(|pair| pair.number).collect();
    let about = SequenceSummary {
        set: folder.set.clone(),
        class: folder.class.clone(),
        name: folder.name.clone(),
        width,
        height,
        keyframes: keyframes.into_iter().filter(|key| numbers.contains(key)).collect(),
        frames: numbers,
        shown,
        exposure: folder.exposure,
        truth: Truth::default(),
        ..SequenceSummary::default()
    };
    let (mut scores, mut shown_pictures) = (Vec::with_capacity(scored.len()), Vec::new());
    for (score, _, pictures) in scored {
        scores.push(score);
        shown_pictures.extend(pictures);
    }
    Ok((about, scores, shown_pictures))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_end_in_numbers() {
        for (name, expected) in [
            ("frame.0007.exr", Some(7)),
            ("12.png", Some(12)),
            ("view3_final.png", Some(3)),
            ("a.png", None),
            ("r_0_05.hdr", Some(5)),
        ] {
            assert_eq!(number(Path::new(name)), expected, "{name}");
        }
    }

    /// The stems of the truths and pictures that belong together, by path.
    fn pairs(truths: &[&str], pictures: &[&str], partial: bool) -> Result<Vec<String>> {
        let folder = tempfile::tempdir()?;
        let [truth, mine] = ["truth", "mine"].map(|name| folder.path().join(name));
        for (root, names) in [(&truth, truths), (&mine, pictures)] {
            for name in names {
                file::write_atomic(&root.join(name), b"")?;
            }
        }
        let folders = folders(&truth, None)?;
        let found = matched(&mine, &folders, partial)?;
        let name = |root: &Path, path: &Path| path.strip_prefix(root).unwrap().with_extension("").display().to_string();
        let pair = |pair: &Match<'_>| format!("{} {}", name(&truth, pair.truth), name(&mine, &pair.picture));
        let mut named: Vec<String> = found.iter().flatten().map(pair).collect();
        named.sort();
        Ok(named)
    }

    #[test]
    fn truths_are_known_by_their_path_and_then_by_their_own_number() {
        let rooms = ["bathroom.png", "kitchen.png"];
        let said = pairs(&rooms, &["bathroom_1.png", "kitchen_0.png"], true).unwrap_err().to_string();
        assert!(said.contains("none of its 2 pictures"), "{said}");
        assert_eq!(pairs(&rooms, &["kitchen_0.png", "kitchen.exr"], true).unwrap(), ["kitchen kitchen"]);
        assert_eq!(pairs(&["left_1.png", "right_1.png"], &["out_1.png", "right_1.png"], true).unwrap(), ["right_1 right_1"]);
        assert_eq!(pairs(&["a0.png", "a1.png"], &["out_01.png", "out_00.png"], false).unwrap(), ["a0 out_00", "a1 out_01"]);
        let deep = ["1.png", "y/z/1.png", "y-z/1.png"];
        assert_eq!(pairs(&deep, &deep, false).unwrap(), ["1 1", "y-z/1 y-z/1", "y/z/1 y/z/1"]);
    }

    #[test]
    fn components_below_zero_cost_no_pixel() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let pixels = [[-0.01, 0.5, 2.0], [f32::NAN, 0.5, 0.5], [0.5, f32::INFINITY, 0.5], [0.25, 0.5, 1.0]];
        ::exr::prelude::write_rgb_file(&path, 4, 1, |x, _| (pixels[x][0], pixels[x][1], pixels[x][2])).unwrap();
        let found = read(&path, 1.0, Some([4, 1])).unwrap();
        let linear = found.linear.unwrap().pixels;
        assert_eq!(linear, [[0.0, 0.5, 2.0], [0.0; 3], [0.0; 3], [0.25, 0.5, 1.0]]);
        assert_eq!(found.display.pixels, linear.iter().map(|p| color::display(*p, 1.0)).collect::<Vec<_>>());
    }
}
