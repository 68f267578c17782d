use super::{WeightsArgs, infer};
use crate::dataset::export::picture::{byte, png, word};
use crate::dataset::{Dataset, SequenceFolder};
use crate::output::Claim;
use crate::progress::Progress;
use crate::report::picture;
use crate::truth::Interrupted;
use anyhow::{Context, Result, bail, ensure};
use clap::{Args, ValueEnum};
use renderflow_frame::image::Rgb;
use renderflow_frame::{color, file, hdr};
use renderflow_model::wan::flow::Intrinsic;
use renderflow_model::wan::video::WanRenderer;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// What made the pictures of a folder.
const RECORD: &str = "invert.json";
/// Endings of pictures that can be read.
const ENDINGS: [&str; 5] = ["png", "jpg", "jpeg", "exr", "hdr"];

const HELP: &str = "\
Examples:
  renderflow invert photos/ --weights wan/inverse.safetensors --vae wan/vae.safetensors --out buffers
  renderflow invert --data data/test --weights wan/inverse.safetensors --only albedo,normal --exr --out buffers

Writes NAME.albedo.png (sRGB), NAME.normal.png (0.5 + 0.5 n, camera space: x right, y up, z towards the camera), NAME.depth.png (16 bits;
0 nearest to 1 farthest, in the logarithm of depth over a range that a picture does not tell) and NAME.material.png (roughness, metallic,
specular). With --exr the same as numbers: albedo linear, normals of length 1.";

/// Finds the buffers behind pictures with the inverse adapter of the paper's network. Run again with the same weights and options, it
/// goes on where it was stopped.
#[derive(Args)]
#[command(after_help = HELP)]
pub struct Invert {
    /// Pictures, or folders of them: PNG, JPEG (display values), EXR, HDR (radiance)
    #[arg(required_unless_present = "data", conflicts_with = "data")]
    pictures: Vec<PathBuf>,
    /// A sequence folder, or a folder of them, whose beauty is the picture
    #[arg(long)]
    data: Option<PathBuf>,
    #[command(flatten)]
    weights: WeightsArgs,
    /// What to find
    #[arg(long, value_enum, value_delimiter = ',', default_values = ["albedo", "normal", "depth", "material"])]
    only: Vec<IntrinsicArg>,
    /// Pictures at a time: 1 = each by itself, more for the frames of a video, which are then consistent within each clip
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1025))]
    clip: u32,
    /// Euler steps; 1 is what the network is trained for
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    steps: u32,
    /// Factor from radiance to display-linear of EXR and HDR pictures
    #[arg(long, default_value_t = 1.0, conflicts_with = "data")]
    exposure: f32,
    /// Write the numbers as EXR, too
    #[arg(long)]
    exr: bool,
    /// Folder to write to
    #[arg(long)]
    out: PathBuf,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum IntrinsicArg {
    Albedo,
    Normal,
    Depth,
    Material,
}

impl From<IntrinsicArg> for Intrinsic {
    fn from(argument: IntrinsicArg) -> Self {
        match argument {
            IntrinsicArg::Albedo => Self::Albedo,
            IntrinsicArg::Normal => Self::Normal,
            IntrinsicArg::Depth => Self::Depth,
            IntrinsicArg::Material => Self::Material,
        }
    }
}

/// What decides the pictures.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Record {
    weights: Vec<String>,
    only: Vec<Intrinsic>,
    clip: u32,
    steps: u32,
    exposure: f32,
    exr: bool,
    tile: Option<usize>,
}

/// A picture to be taken apart.
struct Item<'a> {
    /// Path of what is written, without the names of intrinsics.
    name: PathBuf,
    from: Origin<'a>,
}

enum Origin<'a> {
    File(PathBuf),
    Sequence(&'a SequenceFolder, usize),
}

impl Invert {
    pub fn run(self, cancel: &AtomicBool) -> Result<()> {
        ensure!(self.exposure.is_finite() && self.exposure > 0.0, "--exposure: {} is not a positive number", self.exposure);
        let dataset = self.data.as_deref().map(Dataset::open).transpose()?;
        let groups = match &dataset {
            Some(dataset) => dataset.sequences.iter().map(frames).collect(),
            None => self.files()?,
        };
        let weights = self.weights.weights.as_deref();
        let weights = weights.context("--weights: name those of the paper's network with an inverse adapter")?;
        let mut renderer = WanRenderer::load(weights, self.weights.vae.as_deref())?;
        if let Some(pixels) = self.weights.tile {
            renderer = renderer.tiled(pixels)?;
        }
        ensure!(renderer.inverts(), "{}: has no inverse adapter", weights.display());
        let mut only: Vec<Intrinsic> = Vec::new();
        for intrinsic in self.only.iter().copied().map(Intrinsic::from) {
            if !only.contains(&intrinsic) {
                only.push(intrinsic);
            }
        }
        for folder in dataset.iter().flat_map(|dataset| &dataset.sequences) {
            infer::ready(folder).with_context(|| folder.path.display().to_string())?;
        }
        let claim = self.claim(&only)?;
        let progress = Progress::new("invert", groups.iter().map(|group| group.len() as u64).sum());
        for clip in groups.iter().flat_map(|group| group.chunks(self.clip as usize)) {
            if cancel.load(Ordering::Relaxed) {
                return Err(Interrupted.into());
            }
            let outputs = |item: &Item| only.iter().flat_map(|i| self.outputs(&item.name, *i)).collect::<Vec<PathBuf>>();
            if clip.iter().flat_map(outputs).all(|path| path.is_file()) {
                progress.resume(clip.len() as u64);
                continue;
            }
            self.clip(&renderer, clip, &only, &claim)?;
            progress.add(clip.len() as u64);
        }
        progress.finish();
        Ok(())
    }

    fn claim(&self, only: &[Intrinsic]) -> Result<Claim> {
        let record = Record {
            weights: self.weights.digests()?,
            tile: self.weights.tile,
            only: only.to_vec(),
            clip: self.clip,
            steps: self.steps,
            exposure: self.exposure,
            exr: self.exr,
        };
        Claim::new(&self.out, RECORD, &record, infer::OTHERS)
    }

    /// Files of an intrinsic: PNG, and EXR where wanted.
    fn outputs(&self, name: &Path, intrinsic: Intrinsic) -> Vec<PathBuf> {
        let path = |ending: &str| {
            let mut path = self.out.join(name).into_os_string();
            path.push(format!(".{}.{ending}", intrinsic.name()));
            PathBuf::from(path)
        };
        if self.exr { vec![path("png"), path("exr")] } else { vec![path("png")] }
    }

    /// Takes the pictures of one clip apart.
    fn clip(&self, renderer: &WanRenderer, clip: &[Item], only: &[Intrinsic], claim: &Claim) -> Result<()> {
        let pictures = clip.iter().map(|item| self.read(item)).collect::<Result<Vec<Rgb>>>()?;
        let Some(Rgb { width, height, .. }) = pictures.first() else { return Ok(()) };
        let (width, height) = (*width, *height);
        if let Some((item, other)) = clip.iter().zip(&pictures).find(|(_, p)| (p.width, p.height) != (width, height)) {
            let first = clip[0].name.display();
            let (name, w, h) = (item.name.display(), other.width, other.height);
            bail!("{name}: {w}x{h} pixels in a clip that begins with the {width}x{height} of {first}");
        }
        let planes: Vec<Vec<f32>> = pictures.iter().map(planes).collect();
        let slices: Vec<&[f32]> = planes.iter().map(Vec::as_slice).collect();
        let found = renderer.invert(&slices, [width, height], only, self.steps as usize)?;
        claim.write()?;
        for (intrinsic, found) in only.iter().zip(found) {
            for (item, values) in clip.iter().zip(found) {
                self.write(&item.name, *intrinsic, &values, [width, height])?;
            }
        }
        Ok(())
    }

    fn write(&self, name: &Path, intrinsic: Intrinsic, values: &[f32], [width, height]: [usize; 2]) -> Result<()> {
        let pixels = width * height;
        let pixel = |i: usize| [values[i], values[pixels + i], values[2 * pixels + i]];
        let unit = |p: [f32; 3]| p.map(|v| 0.5 + 0.5 * v);
        let numbers = (0..pixels).map(|i| match intrinsic {
            Intrinsic::Albedo => unit(pixel(i)).map(color::srgb_to_linear),
            Intrinsic::Normal => glam::Vec3::from(pixel(i)).normalize_or_zero().to_array(),
            Intrinsic::Depth => [unit(pixel(i)).iter().sum::<f32>() / 3.0; 3],
            Intrinsic::Material => unit(pixel(i)),
        });
        let numbers = Rgb { width, height, pixels: numbers.collect() };
        let values = numbers.pixels.iter();
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

    /// Display values.
    fn read(&self, item: &Item) -> Result<Rgb> {
        match &item.from {
            Origin::Sequence(folder, index) => {
                let frame = folder.frame(*index)?;
                let beauty = frame.beauty.with_context(|| format!("{}: has no beauty", item.name.display()))?;
                Ok(beauty.map(|p| color::display(*p, folder.sequence.exposure)))
            }
            Origin::File(path) if ["exr", "hdr"].contains(&ending(path).as_str()) => {
                Ok(hdr::read(path)?.map.map(|p| color::display(*p, self.exposure)))
            }
            Origin::File(path) => picture::display_values(path),
        }
    }

    /// The pictures that were named, a group each folder; files named by themselves make one.
    fn files(&self) -> Result<Vec<Vec<Item<'_>>>> {
        let (mut groups, mut single) = (Vec::new(), Vec::new());
        for path in &self.pictures {
            if path.is_dir() {
                folders(path, Path::new(""), &mut groups)?;
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

/// Frames of a sequence.
fn frames(folder: &SequenceFolder) -> Vec<Item<'_>> {
    let name = |index: usize| Path::new(&folder.name()).join(&folder.sequence.files[index]).with_extension("");
    (0..folder.len()).map(|index| Item { name: name(index), from: Origin::Sequence(folder, index) }).collect()
}

/// Adds the pictures of a folder and of those inside it, by name.
fn folders(folder: &Path, below: &Path, groups: &mut Vec<Vec<Item>>) -> Result<()> {
    let unreadable = || format!("{}: cannot list", folder.display());
    let (mut pictures, mut inside) = (Vec::new(), Vec::new());
    for entry in std::fs::read_dir(folder).with_context(unreadable)? {
        let path = entry.with_context(unreadable)?.path();
        if path.is_dir() {
            inside.push(path);
        } else if ENDINGS.contains(&ending(&path).as_str()) {
            let name = below.join(path.file_stem().unwrap_or_default());
            pictures.push(Item { name, from: Origin::File(path) });
        }
    }
    pictures.sort_by(|a, b| a.name.cmp(&b.name));
    inside.sort();
    groups.push(pictures);
    inside.iter().try_for_each(|path| folders(path, &below.join(path.file_name().unwrap_or_default()), groups))
}

fn ending(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
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
    image.write().to_buffered(&mut bytes).with_context(|| format!("{}: cannot write", path.display()))?;
    Ok(bytes.into_inner())
}

/// Display values as planes of -1..=1.
fn planes(picture: &Rgb) -> Vec<f32> {
    (0..3).flat_map(|c| picture.pixels.iter().map(move |p| 2.0 * p[c].clamp(0.0, 1.0) - 1.0)).collect()
}
