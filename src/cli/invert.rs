use super::WeightsArgs;
use super::infer::{self, Data};
use crate::dataset::export::picture::{byte, png, word};
use crate::dataset::{Dataset, Sequence};
use crate::evaluate::external::radiance;
use crate::evaluate::inverter::{Inverter, WanOptions};
use crate::metrics::intrinsics::Buffers;
use crate::util::cancel::Cancel;
use crate::util::device;
use crate::util::output::{self, Claim};
use crate::util::progress::Progress;
use crate::util::{files, picture};
use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use renderflow_frame::image::Rgb;
use renderflow_frame::{color, file};
use renderflow_model::inverse::InverseNet;
use renderflow_model::wan::flow::Intrinsic;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The file that says what made the pictures in a folder.
const RECORD: &str = "invert.json";
/// Endings of pictures that can be read.
const ENDINGS: [&str; 5] = ["png", "jpg", "jpeg", "exr", "hdr"];

const HELP: &str = "\
Examples:
  renderflow invert photo.jpg -o buffers
  renderflow invert --data data/test --only albedo,normal --exr -o buffers
  renderflow invert photos/ --weights wan/inverse.safetensors --vae wan/vae.safetensors -o buffers-wan

Writes NAME.albedo.png (sRGB), NAME.normal.png (0.5 + 0.5 n, camera space: x right, y up, z towards the camera), NAME.depth.png (16 bits;
0 nearest to 1 farthest, in the logarithm of depth over a range that a picture does not tell) and NAME.material.png (roughness, metallic,
specular). With --exr the same as numbers: albedo linear, normals of length 1.

Photos are turned as their EXIF data say. A picture of more than 512 pixels along its longer side is read at a reduced size; its albedo
keeps all of its detail, and the other buffers are interpolated.";

/// Find the albedo, normal, depth and material behind pictures
///
/// The network for it is inside the program; --weights names another one, or the paper's network with an inverse adapter. If the
/// command was stopped, the same command continues.
#[derive(Args)]
#[command(after_help = HELP)]
pub struct Invert {
    /// Pictures, or folders of pictures: PNG, JPEG (display values), EXR, HDR (radiance)
    #[arg(required_unless_present = "data", conflicts_with = "data")]
    pictures: Vec<PathBuf>,
    /// A sequence folder, or a folder of them; their beauty is the picture
    #[arg(long, help_heading = "Input")]
    data: Option<PathBuf>,
    #[command(flatten)]
    weights: WeightsArgs,
    /// What to find
    #[arg(long, value_enum, value_delimiter = ',', default_values = ["albedo", "normal", "depth", "material"], help_heading = "Output")]
    only: Vec<Intrinsic>,
    /// Pictures that the paper's network inverts together, 1 by default: 1 takes each by itself; more suits the frames of a
    /// video, and keeps each clip consistent
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1025), help_heading = "Network")]
    clip: Option<u32>,
    /// Euler steps of the paper's network, 1 by default; it is trained for 1
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1000), help_heading = "Network")]
    steps: Option<u32>,
    /// Factor from radiance to display-linear of EXR and HDR pictures
    #[arg(long, default_value_t = 1.0, conflicts_with = "data", help_heading = "Input")]
    exposure: f32,
    /// Also write the numbers as EXR
    #[arg(long, help_heading = "Output")]
    exr: bool,
    /// Folder to write to
    #[arg(long, short = 'o', help_heading = "Output")]
    out: PathBuf,
}

/// What decides the pictures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Record {
    /// BLAKE3 of the weights, which are in files or inside the program. Older programs recorded none of those inside them.
    weights: Vec<String>,
    only: Vec<Intrinsic>,
    clip: u32,
    steps: u32,
    exposure: f32,
    exr: bool,
    tile: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    device: Option<String>,
    /// What was read, by the name of what is written; empty in older folders.
    #[serde(default, skip_serializing_if = "Data::is_empty")]
    data: Data,
}

/// A picture to invert.
struct Item<'a> {
    /// Path of what is written, without the names of intrinsics.
    name: PathBuf,
    from: Origin<'a>,
}

enum Origin<'a> {
    File(PathBuf),
    Sequence(&'a Sequence, usize),
}

impl Invert {
    pub fn run(self, cancel: &Cancel) -> Result<()> {
        ensure!(self.exposure.is_finite() && self.exposure > 0.0, "--exposure: {} is not a positive number", self.exposure);
        let dataset = self.data.as_deref().map(Dataset::open).transpose()?;
        let groups = match &dataset {
            Some(dataset) => dataset.sequences.iter().map(frames).collect(),
            None => self.files()?,
        };
        let options = WanOptions { vae: self.weights.vae.as_deref(), tile: self.weights.tile };
        let network = Inverter::open(self.weights.weights.as_deref(), options, &self.weights.device.open()?)?;
        if let Inverter::Compact(_) = network {
            for (flag, given) in [("--clip", self.clip.is_some()), ("--steps", self.steps.is_some())] {
                ensure!(!given, "{flag} is an option of the paper's network, whose weights --weights names");
            }
        }
        let mut only: Vec<Intrinsic> = Vec::new();
        for intrinsic in self.only.iter().copied() {
            if !only.contains(&intrinsic) {
                only.push(intrinsic);
            }
        }
        for sequence in dataset.iter().flat_map(|dataset| &dataset.sequences) {
            infer::ready(sequence).with_context(|| sequence.folder.display().to_string())?;
        }
        let claim = self.claim(&only, data(dataset.as_ref(), &groups)?)?;
        let progress = Progress::new("invert", groups.iter().map(|group| group.len() as u64).sum());
        for clip in groups.iter().flat_map(|group| group.chunks(self.clip.unwrap_or(1) as usize)) {
            cancel.check()?;
            let outputs = |item: &Item| only.iter().flat_map(|i| self.outputs(&item.name, *i)).collect::<Vec<PathBuf>>();
            if clip.iter().flat_map(outputs).all(|path| path.is_file()) {
                progress.resume(clip.len() as u64);
                continue;
            }
            self.clip(&network, clip, &only, &claim)?;
            progress.add(clip.len() as u64);
        }
        progress.finish();
        Ok(())
    }

    fn claim(&self, only: &[Intrinsic], data: Data) -> Result<Claim> {
        let record = Record {
            weights: self.weights.digests::<InverseNet>()?,
            tile: self.weights.tile,
            device: device::recorded(&self.weights.device.get()?),
            only: only.to_vec(),
            clip: self.clip.unwrap_or(1),
            steps: self.steps.unwrap_or(1),
            exposure: self.exposure,
            exr: self.exr,
            data: infer::with_earlier(&self.out.join(RECORD), data),
        };
        Claim::agreed(&self.out, RECORD, &record, |there: &Record| {
            let options = |record: &Record| Record { data: Data::new(), ..record.clone() };
            ensure!(options(there) == options(&record), "the folder holds {}; choose another folder", infer::OTHERS);
            infer::same_data(&there.data, &record.data)
        })
    }

    /// Files of an intrinsic: PNG, and EXR if the user asks for it.
    fn outputs(&self, name: &Path, intrinsic: Intrinsic) -> Vec<PathBuf> {
        let path = |ending: &str| {
            let mut path = self.out.join(name).into_os_string();
            path.push(format!(".{}.{ending}", intrinsic.name()));
            PathBuf::from(path)
        };
        if self.exr { vec![path("png"), path("exr")] } else { vec![path("png")] }
    }

    /// Inverts the pictures of one clip.
    fn clip(&self, network: &Inverter, clip: &[Item], only: &[Intrinsic], claim: &Claim) -> Result<()> {
        let pictures = clip.iter().map(|item| self.read(item)).collect::<Result<Vec<Rgb>>>()?;
        let Some(Rgb { width, height, .. }) = pictures.first() else { return Ok(()) };
        let (width, height) = (*width, *height);
        if let Some((item, other)) = clip.iter().zip(&pictures).find(|(_, p)| (p.width, p.height) != (width, height)) {
            let first = clip[0].name.display();
            let (name, w, h) = (item.name.display(), other.width, other.height);
            bail!("{name}: {w}x{h} pixels in a clip that begins with the {width}x{height} of {first}");
        }
        let found = network.find(&pictures, only, self.steps.unwrap_or(1) as usize)?;
        claim.write()?;
        for (item, buffers) in clip.iter().zip(&found) {
            for intrinsic in only {
                self.write(&item.name, *intrinsic, network, buffers)?;
            }
        }
        Ok(())
    }

    fn write(&self, name: &Path, intrinsic: Intrinsic, network: &Inverter, buffers: &Buffers) -> Result<()> {
        let unit = |p: [f32; 3]| p.map(|v| 0.5 + 0.5 * v);
        let numbers = match intrinsic {
            Intrinsic::Albedo => buffers.albedo.as_ref().map(|albedo| albedo.map(|p| p.map(color::srgb_to_linear))),
            Intrinsic::Normal => {
                buffers.normal.as_ref().map(|normal| normal.map(|p| glam::Vec3::from(*p).normalize_or_zero().to_array()))
            }
            Intrinsic::Depth => buffers.depth.as_ref().map(|depth| network.shown_depth(depth).map(|d| [*d; 3])),
            Intrinsic::Material => buffers.material.clone(),
        };
        let numbers = numbers.context("the network found no such buffer")?;
        let (width, height, values) = (numbers.width, numbers.height, numbers.pixels.iter());
        let bytes = match intrinsic {
            Intrinsic::Albedo => png(width, height, values.map(|p| p.map(|v| byte(color::linear_to_srgb(v)))))?,
            Intrinsic::Normal => png(width, height, values.map(|p| unit(*p).map(byte)))?,
            Intrinsic::Depth => png(width, height, values.map(|p| [word(p[0])]))?,
            Intrinsic::Material => png(width, height, values.map(|p| p.map(byte)))?,
        };
        for path in self.outputs(name, intrinsic) {
            let bytes = if path.extension().is_some_and(|e| e == "exr") { &floats(&path, &numbers)? } else { &bytes };
            file::write_atomic(&path, bytes)?;
        }
        Ok(())
    }

    /// The display values of a picture.
    fn read(&self, item: &Item) -> Result<Rgb> {
        match &item.from {
            Origin::Sequence(sequence, index) => {
                let frame = sequence.frame(*index)?;
                let beauty = frame.beauty.with_context(|| format!("{}: has no beauty", item.name.display()))?;
                Ok(beauty.map(|p| color::display(*p, sequence.exposure())))
            }
            Origin::File(path) if files::has_ending(path, &["exr", "hdr"]) => {
                Ok(radiance(path)?.map(|p| color::display(*p, self.exposure)))
            }
            Origin::File(path) => picture::display_values(path),
        }
    }

    /// The pictures that the user named: one group for each folder, and one for the files that were named directly.
    fn files(&self) -> Result<Vec<Vec<Item<'_>>>> {
        let (mut groups, mut single) = (Vec::new(), Vec::new());
        for path in &self.pictures {
            if path.is_dir() {
                groups.extend(groups_in(path, &self.out)?);
            } else {
                let name = PathBuf::from(path.file_stem().unwrap_or_default());
                single.push(Item { name, from: Origin::File(path.clone()) });
            }
        }
        groups.insert(0, single);
        groups.retain(|group| !group.is_empty());
        ensure!(!groups.is_empty(), "no picture ({}) among what was named", ENDINGS.join(", "));
        let mut names: Vec<&PathBuf> = groups.iter().flatten().map(|item| &item.name).collect();
        names.sort();
        if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
            bail!("two pictures would be written as {}", pair[0].display());
        }
        Ok(groups)
    }
}

/// What is read: sequences, or the files of `groups`.
fn data(dataset: Option<&Dataset>, groups: &[Vec<Item>]) -> Result<Data> {
    let file = |item: &Item| match &item.from {
        Origin::File(path) => Some(files::hash(path).map(|hash| (item.name.display().to_string(), hash))),
        Origin::Sequence(..) => None,
    };
    match dataset {
        Some(dataset) => infer::data(dataset),
        None => groups.iter().flatten().filter_map(file).collect(),
    }
}

/// Frames of a sequence.
fn frames(sequence: &Sequence) -> Vec<Item<'_>> {
    let name = |index: usize| Path::new(&sequence.name).join(&sequence.transforms.files[index]).with_extension("");
    (0..sequence.len()).map(|index| Item { name: name(index), from: Origin::Sequence(sequence, index) }).collect()
}

/// The pictures of a folder and of all folders below it, a group for each of them. What an earlier run wrote to `out` is none of
/// them.
fn groups_in(folder: &Path, out: &Path) -> Result<Vec<Vec<Item<'static>>>> {
    let mut groups: BTreeMap<PathBuf, Vec<Item>> = BTreeMap::new();
    let (out, whole) = (output::resolved(out)?, output::resolved(folder)?);
    let inside = out != whole && out.starts_with(&whole);
    for path in files::walk(folder, &ENDINGS)? {
        if inside && output::resolved(&path)?.starts_with(&out) {
            continue;
        }
        let name = path.strip_prefix(folder).unwrap_or(&path).with_extension("");
        let below = name.parent().unwrap_or(Path::new("")).to_owned();
        groups.entry(below).or_default().push(Item { name, from: Origin::File(path) });
    }
    groups.values_mut().for_each(|group| group.sort_by(|a, b| a.name.cmp(&b.name)));
    Ok(groups.into_values().collect())
}

/// An EXR file of single precision; `path` stands in errors.
fn floats(path: &Path, picture: &Rgb) -> Result<Vec<u8>> {
    use exr::prelude::{Image, SpecificChannels, Vec2, WritableImage};
    let channels = SpecificChannels::rgb(|Vec2(x, y): Vec2<usize>| {
        let [r, g, b] = *picture.at(x, y);
        (r, g, b)
    });
    let mut bytes = std::io::Cursor::new(Vec::new());
    let image = Image::from_channels((picture.width, picture.height), channels);
    // Several threads would write their blocks in any order.
    image.write().non_parallel().to_buffered(&mut bytes).with_context(|| format!("{}: cannot write", path.display()))?;
    Ok(bytes.into_inner())
}
