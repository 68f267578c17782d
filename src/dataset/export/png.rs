//! Every channel as PNG: pictures to look at in `OUT/<split>/seq-000123/<channel>_0007.png`, exact values in `values/` there, and
//! `data_ranges.json`, which says for each what its numbers mean.
//!
//! | file | bits | value |
//! |---|---|---|
//! | `rgb` | 3 x 8 | the picture: exposure, sRGB |
//! | `albedo` | 3 x 8 | sRGB |
//! | `normal`, `guide_normal`, `through` | 3 x 16 | n / 32767.5 - 1, camera space |
//! | `material`, `transmittance` | 3 x 16 | n / 65535, linear |
//! | `alpha` | 16 | n / 65535 |
//! | `depth` | 16 | min + (n - 1) / 65534 (max - min) metres, the sequence's range; 0 = miss |
//! | `motion`, `motion_prev` | 3 x 16 | min + n / 65535 (max - min) pixels, the sequence's range; x, y, 0 |
//! | `object_id`, `material_id` | 8, palette | the index is the number; as `samples` where one is beyond 255 |
//! | `values/beauty`, `raw`, `irradiance`, `light.N` | 3 x 16 | twice the bits of the half float, which loses nothing |
//! | `values/variance` | 3 x 16 | the same of the value rounded to half |
//! | `values/albedo`, `guide_albedo` | 3 x 16 | n / 65535, linear |
//! | `values/samples` | 16, or 4 x 8 | the number; in four bytes, lowest first, where one is beyond 65535 |

use super::picture::{byte, indexed, png, word};
use super::{Job, displayed};
use crate::dataset::Sequence;
use crate::util::picture::id_color;
use anyhow::Result;
use half::f16;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::{Frame, color, file};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// How the numbers of a channel become values.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Range {
    value: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    min: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    max: Option<f32>,
}

/// Smallest and largest number of a sequence; nothing where there are none.
#[derive(Clone, Copy)]
struct Span {
    low: f32,
    high: f32,
}

impl Span {
    fn of(values: impl Iterator<Item = f32>) -> Self {
        let none = Self { low: f32::INFINITY, high: f32::NEG_INFINITY };
        values.filter(|v| v.is_finite()).fold(none, |span, v| Self { low: span.low.min(v), high: span.high.max(v) })
    }

    fn with(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// A span that can be divided by; 0..1 where there was nothing.
    fn ends(self) -> (f32, f32) {
        if self.low > self.high { (0.0, 1.0) } else { (self.low, self.high) }
    }

    fn share(self, value: f32) -> f32 {
        let (low, high) = self.ends();
        if high > low { (value - low) / (high - low) } else { 0.0 }
    }
}

/// The ranges of a sequence that its pictures need.
#[derive(Clone, Copy)]
struct Spans {
    depth: Span,
    motion: Span,
    motion_prev: Span,
    /// Largest object id, material id and sample count.
    highest: [u32; 3],
}

impl Spans {
    fn of(frame: &Frame) -> Self {
        let motion = |image: &Option<Image<[f32; 2]>>| Span::of(image.iter().flat_map(|i| i.pixels.as_flattened()).copied());
        let highest = |image: Option<&Image<u32>>| image.and_then(|i| i.pixels.iter().copied().max()).unwrap_or(0);
        Self {
            depth: Span::of(frame.depth.pixels.iter().copied()),
            motion: motion(&frame.motion),
            motion_prev: motion(&frame.motion_prev),
            highest: [highest(Some(&frame.object_id)), highest(Some(&frame.material_id)), highest(frame.samples.as_ref())],
        }
    }

    fn with(self, other: Self) -> Self {
        Self {
            depth: self.depth.with(other.depth),
            motion: self.motion.with(other.motion),
            motion_prev: self.motion_prev.with(other.motion_prev),
            highest: std::array::from_fn(|i| self.highest[i].max(other.highest[i])),
        }
    }
}

/// Twice the bits of a half float; negative values, which no light has, become 0.
fn half_bits(value: f32) -> u16 {
    2 * f16::from_f32(value.clamp(0.0, 65504.0)).to_bits()
}

/// The pictures of a frame: name, bytes, meaning.
fn pictures(frame: &Frame, exposure: f32, spans: &Spans) -> Result<Vec<(String, Vec<u8>, Range)>> {
    let (width, height) = (frame.width, frame.height);
    let mut found = Vec::new();
    let plain = |value| Range { value, min: None, max: None };
    if frame.beauty.is_some() {
        let picture = displayed(frame, exposure)?;
        let bytes = png(width, height, picture.pixels.iter().map(|p| p.map(byte)))?;
        found.push(("rgb".to_owned(), bytes, plain("sRGB of exposure x radiance, n / 255")));
    }
    let mut rgb = |name: String, picture: Option<&Rgb>, value: &'static str, code: fn(f32) -> u16| -> Result<()> {
        if let Some(picture) = picture {
            found.push((name, png(width, height, picture.pixels.iter().map(|p| p.map(code)))?, plain(value)));
        }
        Ok(())
    };
    let bits = "float whose half-float bits are n / 2, linear";
    for (name, picture) in [
        ("beauty", &frame.beauty),
        ("raw", &frame.raw),
        ("variance", &frame.variance),
        ("indirect", &frame.indirect),
        ("hidden", &frame.hidden),
        ("irradiance", &frame.irradiance),
    ] {
        rgb(format!("values/{name}"), picture.as_ref(), bits, half_bits)?;
    }
    for (group, picture) in frame.light.iter().enumerate() {
        rgb(format!("values/light.{group}"), picture.as_ref(), bits, half_bits)?;
    }
    for (name, picture) in [
        ("values/albedo", Some(&frame.albedo)),
        ("values/guide_albedo", frame.guide_albedo.as_ref()),
        ("material", Some(&frame.material)),
        ("transmittance", frame.transmittance.as_ref()),
    ] {
        rgb(name.into(), picture, "n / 65535, linear", word)?;
    }
    for (name, picture) in
        [("normal", Some(&frame.normal)), ("guide_normal", frame.guide_normal.as_ref()), ("through", frame.through.as_ref())]
    {
        rgb(name.into(), picture, "n / 32767.5 - 1, camera space", |v| word(0.5 * v + 0.5))?;
    }
    let albedo = png(width, height, frame.albedo.pixels.iter().map(|p| p.map(|v| byte(color::linear_to_srgb(v)))))?;
    found.push(("albedo".into(), albedo, plain("sRGB of the albedo, n / 255")));
    found.push(("alpha".into(), png(width, height, frame.alpha.pixels.iter().map(|&a| [word(a)]))?, plain("n / 65535")));
    let depth = |&d: &f32| if d.is_finite() { [1 + (65534.0 * spans.depth.share(d)).round() as u16] } else { [0] };
    let range = |value, span: Span| Range { value, min: Some(span.ends().0), max: Some(span.ends().1) };
    let depth = png(width, height, frame.depth.pixels.iter().map(depth))?;
    found.push(("depth".into(), depth, range("min + (n - 1) / 65534 (max - min) metres along the view; 0 = miss", spans.depth)));
    for (name, image, span) in [("motion", &frame.motion, spans.motion), ("motion_prev", &frame.motion_prev, spans.motion_prev)] {
        let Some(image) = image else { continue };
        let bytes = png(width, height, image.pixels.iter().map(|[x, y]| [word(span.share(*x)), word(span.share(*y)), 0]))?;
        found.push((name.into(), bytes, range("min + n / 65535 (max - min) pixels, +x right, +y down", span)));
    }
    let ids = [
        ("object_id", Some(&frame.object_id)),
        ("material_id", Some(&frame.material_id)),
        ("values/samples", frame.samples.as_ref()),
    ];
    for ((name, image), highest) in ids.into_iter().zip(spans.highest) {
        let Some(image) = image else { continue };
        let (bytes, range) = match (u8::try_from(highest), u16::try_from(highest)) {
            (Ok(highest), _) if !name.starts_with("values/") => {
                let palette: Vec<u8> = (0..=highest).flat_map(|id| id_color(id.into())).collect();
                (
                    indexed(width, height, &palette, image.pixels.iter().map(|&id| id as u8).collect())?,
                    plain("index of the palette"),
                )
            }
            (_, Ok(_)) => (png(width, height, image.pixels.iter().map(|&id| [id as u16]))?, plain("n")),
            _ => (png(width, height, image.pixels.iter().map(|id| id.to_le_bytes()))?, plain("R + 256 G + 65536 B + 16777216 A")),
        };
        found.push((name.into(), bytes, range));
    }
    Ok(found)
}

pub fn sequence(sequence: &Sequence, out: &Path, job: &Job) -> Result<()> {
    let folder = out.join(sequence.split.name()).join(&sequence.name);
    let quiet = job.quiet();
    let spans = quiet.frames(sequence, |_, frame| Ok(Spans::of(&frame)))?;
    let Some(spans) = spans.into_iter().reduce(Spans::with) else { return Ok(()) };
    let ranges = job.frames(sequence, |index, frame| {
        let mut ranges = BTreeMap::new();
        for (name, bytes, range) in pictures(&frame, sequence.transforms.exposure, &spans)? {
            job.write(folder.join(format!("{name}_{:04}.png", sequence.numbers[index])), &bytes)?;
            ranges.insert(name, range);
        }
        Ok(ranges)
    })?;
    // Frames between keyframes may lack a picture.
    let all: BTreeMap<String, Range> = ranges.into_iter().flatten().collect();
    let path = folder.join("data_ranges.json");
    job.write(path.clone(), &file::json(&path, &all)?)
}
