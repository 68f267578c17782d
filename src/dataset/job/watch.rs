//! `renderflow render --reference` and `--tev`: the error of a picture, or the picture itself, while its samples double.

use crate::dataset::layout;
use crate::metrics::displayed::displayed;
use crate::metrics::psnr::capped;
use crate::metrics::relmse::{RelMse, relmse};
use crate::util::clock::{Spent, Stopwatch};
use crate::util::picture;
use crate::util::tev::Tev;
use anyhow::{Context, Result, bail};
use renderflow_frame::frame_file::Profile;
use renderflow_frame::image::Rgb;
use renderflow_frame::{Frame, color, exr, hdr};
use renderflow_renderer::{Budget, Film, RenderScene, Settings, Stats, develop, expose, render_with_stats};
use serde_json::{Value, json};
use std::fmt;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// A picture to compare with.
pub struct Target {
    picture: Rgb,
    /// Whether it holds display values (exposed, clamped, sRGB) in place of radiance.
    displayed: bool,
    /// Seed of its samples, where it is a frame of this program.
    seed: Option<u64>,
}

impl Target {
    /// Reads a frame of this program (its raw beauty, or else the beauty), any other OpenEXR file with `R`, `G`, `B`, a Radiance
    /// `.hdr`, or display values in a PNG or JPEG file.
    ///
    /// # Errors
    /// When it cannot be read, is none of these, or holds a value that is not finite.
    pub fn read(path: &Path) -> Result<Self> {
        let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
        let mut seed = None;
        let (picture, displayed) = match extension.to_str() {
            Some("exr") => {
                let (picture, own) = radiance(path)?;
                seed = own;
                (picture, false)
            }
            Some("hdr") => (hdr::read(path)?.map, false),
            _ => {
                let decoded = picture::display_values(path);
                (decoded.with_context(|| format!("{}: not a picture to compare with", path.display()))?, true)
            }
        };
        if let Some(at) = picture.pixels.iter().position(|p| !p.iter().all(|v| v.is_finite())) {
            let (x, y) = (at % picture.width, at / picture.width);
            bail!("{}: pixel ({x}, {y}) is not finite: {:?}", path.display(), picture.pixels[at]);
        }
        Ok(Self { picture, displayed, seed })
    }

    /// The seed of its samples, where it is a frame of this program.
    pub fn seed(&self) -> Option<u64> {
        self.seed
    }

    /// # Errors
    /// When a picture of `width x height` pixels cannot be compared with it.
    pub fn check_size(&self, width: usize, height: usize) -> Result<()> {
        let (own_width, own_height) = (self.picture.width, self.picture.height);
        if (own_width, own_height) != (width, height) {
            bail!(
                "the reference has {own_width} x {own_height} pixels, the picture {width} x {height}; --resolution sets the latter"
            );
        }
        Ok(())
    }

    /// Errors of `radiance`. Against display values what is beyond white counts as white.
    ///
    /// # Errors
    /// When the sizes differ.
    pub fn errors(&self, radiance: &Rgb, exposure: f32) -> Result<Errors> {
        let [image, reference] = if self.displayed {
            let white = 1.0 / exposure.max(f32::MIN_POSITIVE);
            let linear = self.picture.map(|p| p.map(|v| color::srgb_to_linear(v) * white));
            [radiance.map(|p| p.map(|v| v.min(white))), linear]
        } else {
            [radiance.clone(), self.picture.clone()]
        };
        let relmse = relmse(&image, &reference, None)?;
        Ok(Errors { relmse, psnr: displayed(&image, &reference, exposure)?.psnr })
    }
}

/// The raw beauty of a frame of this program and its seed, or the root channels of any other file.
fn radiance(path: &Path) -> Result<(Rgb, Option<u64>)> {
    if let Ok(frame) = exr::read(path)
        && let Some(picture) = frame.raw.or(frame.beauty)
    {
        return Ok((picture, (frame.info.spp > 0).then_some(frame.info.seed)));
    }
    Ok((exr::read_rgb(path)?, None))
}

/// The error of a picture, against a reference.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    relmse: RelMse,
    /// Decibel on display values.
    psnr: f64,
}

/// A line of the table of errors.
#[derive(Clone, Debug)]
pub enum Line {
    /// Names of the columns.
    Heading,
    /// The error of a picture.
    Row {
        /// Samples per pixel, or what was done to the picture.
        what: String,
        /// The error.
        errors: Errors,
        /// Spent since the render began, where it was watched.
        spent: Option<Spent>,
    },
    /// Seconds of the whole render, and of looking at its pictures.
    Total([f64; 2]),
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Heading => {
                write!(
                    f,
                    "{:>7}  {:>9}  {:>9}  {:>10}  {:>10}  {:>10}  {:>6}",
                    "spp", "seconds", "cpu s", "relMSE", "99 % trim", "median", "PSNR"
                )
            }
            Self::Row { what, errors: Errors { relmse, psnr }, spent } => {
                let time = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |v| format!("{v:.3}"));
                let [seconds, processor] = [spent.map(|s| s.seconds), spent.and_then(|s| s.processor)].map(time);
                let RelMse { mean, trimmed, median, .. } = relmse;
                write!(
                    f,
                    "{what:>7}  {seconds:>9}  {processor:>9}  {mean:>10.3e}  {trimmed:>10.3e}  {median:>10.3e}  {psnr:>6.2}"
                )
            }
            Self::Total([all, apart]) => {
                write!(f, "rendered in {all:.3} s with its G-buffer; comparing took {apart:.3} s more")
            }
        }
    }
}

impl Line {
    /// The line as an object; `None` for the heading.
    pub fn json(&self) -> Option<Value> {
        match self {
            Self::Heading => None,
            Self::Row { what, errors: Errors { relmse, psnr }, spent } => {
                let spp = what.parse::<u32>().map_or_else(|_| Value::from(&what[..]), Value::from);
                let RelMse { mean, trimmed, median, .. } = relmse;
                Some(json!({
                    "spp": spp, "seconds": spent.map(|s| s.seconds), "cpu_seconds": spent.and_then(|s| s.processor),
                    "relmse": mean, "relmse_trimmed": trimmed, "relmse_median": median, "psnr": capped(*psnr),
                }))
            }
            Self::Total([all, apart]) => Some(json!({ "spp": "total", "seconds": all, "comparing_seconds": apart })),
        }
    }
}

/// Looks at the picture whenever the samples have doubled: compares it with a reference, or shows it in a viewer.
#[derive(Default)]
pub struct Watch {
    compared: Option<Compared>,
    viewer: Option<Tev>,
}

/// A picture to compare with, and what gets each line of the table.
struct Compared {
    target: Target,
    tell: Box<dyn Fn(&Line) + Send + Sync>,
}

impl Watch {
    /// Also compares with `target`; `tell` gets each line of the table.
    pub fn compare(self, target: Target, tell: impl Fn(&Line) + Send + Sync + 'static) -> Self {
        Self { compared: Some(Compared { target, tell: Box::new(tell) }), ..self }
    }

    /// Also shows the pictures in `viewer`.
    pub fn show(self, viewer: Tev) -> Self {
        Self { viewer: Some(viewer), ..self }
    }

    /// Begins a picture.
    fn begin(&self, scene: &RenderScene) -> Result<()> {
        let camera = scene.camera();
        if let Some(Compared { target, tell }) = &self.compared {
            target.check_size(camera.width, camera.height)?;
            tell(&Line::Heading);
        }
        if let Some(viewer) = &self.viewer {
            viewer.create(&name(scene), [camera.width, camera.height]);
        }
        Ok(())
    }

    /// Looks at a picture of `spp` samples per pixel, which took `spent` so far.
    fn look(&self, scene: &RenderScene, picture: &Rgb, spp: u32, spent: Spent) -> Result<()> {
        if let Some(Compared { target, tell }) = &self.compared {
            let errors = target.errors(picture, scene.exposure())?;
            tell(&Line::Row { what: spp.to_string(), errors, spent: Some(spent) });
        }
        if let Some(viewer) = &self.viewer {
            viewer.update(&name(scene), picture);
        }
        Ok(())
    }

    /// What `render` gives, with its seconds and the error of its picture: for samples that are not spread evenly and have no
    /// parts.
    ///
    /// # Errors
    /// As `render`, and when the sizes differ.
    pub fn whole(
        &self,
        scene: &RenderScene,
        render: impl FnOnce() -> renderflow_renderer::Result<(Frame, Stats)>,
    ) -> Result<(Frame, Stats)> {
        self.begin(scene)?;
        let mut rendering = Total::default();
        let (frame, stats) = rendering.time(render)?;
        if let Some(raw) = &frame.raw {
            self.look(scene, raw, frame.info.spp, rendering.0)?;
        }
        Ok((frame, stats))
    }

    /// As `render_with_stats`, the same picture to the bit. Looking is not in the seconds printed. Adaptive settings give one
    /// look only: another number of samples would spread them otherwise.
    ///
    /// # Errors
    /// As `render_with_stats`, and when the sizes differ.
    pub fn render(
        &self,
        scene: &RenderScene,
        settings: &Settings,
        progress: &(dyn Fn(u64, u64) + Sync),
        cancel: &AtomicBool,
    ) -> Result<(Frame, Stats)> {
        if settings.budget != Budget::Uniform {
            return self.whole(scene, || render_with_stats(scene, settings, progress, cancel));
        }
        self.begin(scene)?;
        let pixels = (scene.camera().width * scene.camera().height) as u64;
        let total = pixels * u64::from(settings.spp);
        let mut rendering = Total::default();
        let mut looking = Total::default();
        let mut film: Option<Film> = None;
        let mut stats = Stats::default();
        let (mut done, mut next) = (0, first_look(settings.spp, settings.branches()));
        while done < settings.spp {
            next = settings.spp.min(next);
            let base = pixels * u64::from(done);
            let part = rendering.time(|| -> Result<Film> {
                let (part, more) = expose(scene, settings, done..next, &|now, _| progress(base + now, total), cancel)?;
                stats += more;
                Ok(match film.take() {
                    Some(mut whole) => {
                        whole.merge(&part)?;
                        whole
                    }
                    None => part,
                })
            })?;
            looking.time(|| self.look(scene, &part.mean(), next, rendering.0))?;
            film = Some(part);
            (done, next) = (next, next.saturating_mul(2));
        }
        let film = film.context("a picture of no samples has no error")?;
        let (frame, more) = rendering.time(|| develop(scene, settings, &film))?;
        stats += more;
        if let Some(Compared { tell, .. }) = &self.compared {
            tell(&Line::Total([rendering.0.seconds, looking.0.seconds]));
        }
        Ok((frame, stats))
    }

    /// Tells what became of the picture afterwards: the error of a denoised one.
    ///
    /// # Errors
    /// When the sizes differ.
    pub fn after(&self, what: &str, picture: &Rgb, exposure: f32) -> Result<()> {
        if let Some(Compared { target, tell }) = &self.compared {
            tell(&Line::Row { what: what.to_owned(), errors: target.errors(picture, exposure)?, spent: None });
        }
        Ok(())
    }

    /// Shows a finished frame with its channels.
    pub fn finish(&self, scene: &RenderScene, frame: &Frame) {
        if let Some(viewer) = &self.viewer {
            viewer.finish(&name(scene), frame);
        }
    }

    /// As [`Self::after`], for a picture that was stored before, with the names of the columns.
    ///
    /// # Errors
    /// When the sizes differ.
    pub fn stored(&self, spp: u32, picture: &Rgb, exposure: f32) -> Result<()> {
        if let Some(Compared { tell, .. }) = &self.compared {
            tell(&Line::Heading);
        }
        self.after(&spp.to_string(), picture, exposure)
    }
}

/// Name of a picture in a viewer.
fn name(scene: &RenderScene) -> String {
    format!("renderflow {}", layout::frame_file(scene.frame(), Profile::Full))
}

/// Samples after which the first look comes: six doublings before the end. Sixteen samples are numbered at once, so a
/// smaller part costs more than its share. The first look is not before the first camera ray is done, which several samples
/// share. It is a power of two, as the others are.
fn first_look(spp: u32, branches: u32) -> u32 {
    branches.max(1 << (spp / 64).max(1).ilog2())
}

/// Time of what was done now and then.
#[derive(Default)]
struct Total(Spent);

impl Total {
    fn time<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let clock = Stopwatch::start();
        let result = work();
        self.0 = self.0 + clock.spent();
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_look_is_six_doublings_before_the_end() {
        let first = |branches| [1, 12, 64, 127, 128, 256, 1000, 1024].map(|spp| first_look(spp, branches));
        assert_eq!(first(1), [1, 1, 1, 1, 2, 4, 8, 16]);
        assert_eq!(first(4), [4, 4, 4, 4, 4, 4, 8, 16]);
    }
}
