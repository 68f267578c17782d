//! The names of path-traced rows, and what they mean.

use super::Method;
use crate::dataset::around::{Neighbours, REACH};
use crate::evaluate::results::{Group, MethodInfo};
use anyhow::{Result, bail, ensure};
use renderflow_renderer::denoise::Quality;

/// How a path-traced picture is denoised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum Clean {
    /// Not at all.
    #[value(name = "none")]
    Raw,
    /// OIDN with least error.
    #[value(name = "oidn")]
    High,
    /// OIDN in least time.
    Fast,
    /// The network that reads samples ([`renderflow_model::fusion`]). It also reads OIDN's picture of this effort, if there is
    /// one.
    #[value(skip)]
    Neural(Option<Quality>),
}

/// The number of samples for each pixel of a path-traced picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Samples {
    /// This number, 1..=65536.
    Count(u32),
    /// The number that this many milliseconds allow for the whole picture, at least 1. The milliseconds are for 256 x 256 pixels;
    /// other sizes get time in proportion.
    Within(u32),
    /// The number that the seconds of another method (by id) on this frame allow, at least 1.
    AsLongAs(String),
}

/// Where the denoiser's guides come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Guides {
    /// The camera rays of the samples themselves.
    Own,
    /// A separate G-buffer; the method pays for its seconds.
    GBuffer,
}

/// How a path-traced picture is made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tracing {
    /// The number of samples.
    pub samples: Samples,
    /// Whether the samples are spread by the detail of the G-buffer ([`renderflow_renderer::Budget::Detail`]). Their number is
    /// the average then.
    pub adaptive: bool,
    /// How the picture is denoised.
    pub clean: Clean,
    /// Where the denoiser's guides come from, if it is denoised.
    pub guides: Guides,
    /// Which other frames' samples are used as well.
    pub neighbours: Neighbours,
    /// Whether the network reads keyframes too.
    pub keyframes: bool,
}

/// What is rendered in each budget, as it follows the milliseconds in names.
pub(super) const IN_BUDGET: [&str; 8] =
    ["+fast", "+fast+gbuffer", "+fast+around", "+fast+before", "+oidn", "+oidn+gbuffer", "+oidn+around", "+oidn+before"];
/// The longest budget in milliseconds: an hour.
pub(super) const LONGEST: u32 = 3_600_000;

/// Takes `suffix` off the end of `text`, and returns whether it was there.
fn cut(text: &mut &str, suffix: &str) -> bool {
    let rest = text.strip_suffix(suffix);
    *text = rest.unwrap_or(text);
    rest.is_some()
}

impl Tracing {
    /// Parses `pt4`, `pt-50ms` or `equal-METHOD`, followed by `+oidn` or `+fast` (`equal-` implies OIDN of least error),
    /// `+gbuffer`, and `+around` or `+before`.
    ///
    /// # Errors
    /// When the name is none of these, or its parts do not go together.
    pub(super) fn parse(id: &str) -> Result<Self> {
        let mut rest = id;
        // After `equal-`, they belong to the other method's name.
        let keyframes = !id.starts_with("equal-") && cut(&mut rest, "+keys");
        let neighbours = if cut(&mut rest, "+around") {
            Neighbours::Around
        } else if cut(&mut rest, "+before") {
            Neighbours::Before
        } else {
            Neighbours::Alone
        };
        let guides = if cut(&mut rest, "+gbuffer") { Guides::GBuffer } else { Guides::Own };
        if let Some(mut to) = rest.strip_prefix("equal-") {
            let clean = if cut(&mut to, "+fast") { Clean::Fast } else { Clean::High };
            let to = Method::parse(to)?;
            let timed = !matches!(&to, Method::Traced(Self { samples: Samples::AsLongAs(_), .. }));
            ensure!(timed, "{id}: needs a method with a time of its own");
            return Ok(Self { samples: Samples::AsLongAs(to.id()), adaptive: false, clean, guides, neighbours, keyframes });
        }
        let neural = cut(&mut rest, "+neural");
        let denoised = if cut(&mut rest, "+oidn") {
            Some(Quality::High)
        } else if cut(&mut rest, "+fast") {
            Some(Quality::Fast)
        } else {
            None
        };
        let clean = match denoised {
            _ if neural => Clean::Neural(denoised),
            Some(Quality::Fast) => Clean::Fast,
            Some(_) => Clean::High,
            None => Clean::Raw,
        };
        let adaptive = cut(&mut rest, "+adaptive");
        let Some(samples) = rest.strip_prefix("pt") else { bail!("there is no method {id:?}") };
        if let Some((_, after)) = samples.split_once('+') {
            bail!(
                "{id}: +{after} has no place there: +adaptive, +oidn or +fast, +neural, then +gbuffer, then +around or +before, then \
                 +keys"
            );
        }
        ensure!(
            clean != Clean::Raw || (guides, neighbours) == (Guides::Own, Neighbours::Alone),
            "{id}: +gbuffer, +around and +before are for the denoiser: put +oidn, +fast or +neural before"
        );
        ensure!(
            !adaptive || clean != Clean::Raw,
            "{id}: +adaptive is for pictures that are denoised: put +oidn, +fast or +neural after"
        );
        ensure!(!keyframes || neural, "{id}: +keys is for the network: put +neural before");
        // The network always reads the G-buffer.
        ensure!(guides == Guides::Own || !neural, "{id}: +neural has a G-buffer by itself");
        let samples = match samples.strip_prefix('-') {
            Some(budget) => match budget.strip_suffix("ms").map(str::parse) {
                Some(Ok(milliseconds @ 1..=LONGEST)) => Samples::Within(milliseconds),
                _ => bail!("{id}: {budget:?} is no budget, 1ms..={LONGEST}ms"),
            },
            None => match samples.parse() {
                Ok(spp @ 1..=65536) => Samples::Count(spp),
                _ => bail!("{id}: {samples:?} is no number of samples, 1..=65536"),
            },
        };
        Ok(Self { samples, adaptive, clean, guides, neighbours, keyframes })
    }

    /// Name in files and options.
    pub(super) fn id(&self) -> String {
        let (from, clean) = match (&self.samples, self.clean) {
            (Samples::Count(spp), clean) => (format!("pt{spp}"), clean.suffix()),
            (Samples::Within(milliseconds), clean) => (format!("pt-{milliseconds}ms"), clean.suffix()),
            (Samples::AsLongAs(to), Clean::Fast) => (format!("equal-{to}"), "+fast"),
            (Samples::AsLongAs(to), _) => (format!("equal-{to}"), ""),
        };
        let adaptive = if self.adaptive { "+adaptive" } else { "" };
        let guides = if self.guides == Guides::GBuffer { "+gbuffer" } else { "" };
        let keyframes = if self.keyframes { "+keys" } else { "" };
        format!("{from}{adaptive}{clean}{guides}{}{keyframes}", self.neighbours.suffix())
    }

    /// The frames whose samples are used for frame `index` of `count`, nearest first, without the frame itself.
    pub fn others(&self, index: usize, count: usize) -> Vec<usize> {
        self.neighbours.of(REACH, index, count)
    }

    /// Describes what follows the samples.
    fn words(&self) -> String {
        let adaptive = if self.adaptive { " adaptive" } else { "" };
        let guides = if self.guides == Guides::GBuffer { ", guided by a G-buffer" } else { "" };
        let keyframes = if self.keyframes { ", keyframes" } else { "" };
        format!("{adaptive}{}{guides}{}{keyframes}", self.clean.label(), self.neighbours.label())
    }

    /// The facts about it for tables and plots.
    pub(super) fn describe(&self) -> MethodInfo {
        let words = self.words();
        let series = format!("path traced{words}");
        let (label, group, budget) = match &self.samples {
            Samples::Count(spp) => (format!("{spp} spp{words}"), Group::PathTraced, None),
            Samples::Within(milliseconds) => {
                let seconds = f64::from(*milliseconds) / 1000.0;
                (format!("{series} in {seconds} s"), Group::Budget, Some(seconds))
            }
            Samples::AsLongAs(to) => {
                let to = Method::parse(to).map_or_else(|_| to.clone(), |method| method.describe().label);
                (format!("{series} in the time of {to}"), Group::EqualTime, None)
            }
        };
        let mut note = Vec::new();
        match self.samples {
            Samples::Count(_) => {}
            Samples::Within(_) => note.push("1 spp at least; seconds at 256 x 256, in proportion to the pixels at other sizes"),
            Samples::AsLongAs(_) => note.push("1 spp at least"),
        }
        note.extend(match self.guides {
            Guides::Own if self.clean == Clean::Raw => None,
            Guides::Own if self.clean.is_neural() => Some("pays for the G-buffer"),
            Guides::Own => Some("guided by its own camera rays"),
            Guides::GBuffer => Some("pays for the G-buffer"),
        });
        note.extend((self.neighbours != Neighbours::Alone).then_some("each frame's samples are traced and paid once"));
        let (series, spp) = match self.samples {
            Samples::Count(spp) => (Some(series), Some(spp)),
            Samples::Within(_) => (Some(series), None),
            Samples::AsLongAs(_) => (None, None),
        };
        let time_of = if let Samples::AsLongAs(to) = &self.samples { Some(to.clone()) } else { None };
        MethodInfo {
            series,
            spp,
            budget,
            time_of,
            reads_keyframes: self.keyframes,
            note: note.join("; "),
            ..MethodInfo::new(self.id(), label, group)
        }
    }
}

impl Clean {
    /// The effort of OIDN, if it runs.
    pub fn oidn(self) -> Option<Quality> {
        match self {
            Self::Raw => None,
            Self::High => Some(Quality::High),
            Self::Fast => Some(Quality::Fast),
            Self::Neural(denoised) => denoised,
        }
    }

    /// Whether the network that reads samples makes the picture.
    pub fn is_neural(self) -> bool {
        matches!(self, Self::Neural(_))
    }

    /// The part that it adds to the name of a method.
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Raw => "",
            Self::High => "+oidn",
            Self::Fast => "+fast",
            Self::Neural(None) => "+neural",
            Self::Neural(Some(Quality::Fast)) => "+fast+neural",
            Self::Neural(Some(_)) => "+oidn+neural",
        }
    }

    fn label(self) -> &'static str {
        match self {
            Self::Raw => "",
            Self::High => " + OIDN",
            Self::Fast => " + OIDN fast",
            Self::Neural(None) => " + network",
            Self::Neural(Some(Quality::Fast)) => " + OIDN fast + network",
            Self::Neural(Some(_)) => " + OIDN + network",
        }
    }
}

/// The lines about path-traced rows in the help: a name, and its meaning.
pub(super) const HELP: [(&str, &str); 7] = [
    (
        "pt4, pt4+oidn, pt4+fast",
        "path tracing with 4 samples per pixel: raw, denoised by OIDN with least error, or in least time; the denoiser is guided by the camera \
         rays of the samples",
    ),
    (
        "pt-50ms+oidn",
        "the samples that fit into 50 ms with OIDN, at least 1; for 256 x 256 pixels, and in proportion at other sizes",
    ),
    (
        "equal-deferred",
        "path tracing + OIDN in the seconds of another method (here deferred); equal-deferred+fast with OIDN in least time",
    ),
    (
        "pt4+adaptive+oidn",
        "4 samples per pixel on average, and more where the G-buffer shows detail; with any denoiser, and with seconds as well \
         (pt-50ms+adaptive+oidn+neural). From 8 samples on, the network takes its G-buffer from their camera rays",
    ),
    ("...+gbuffer", "after one of these with OIDN: guided by a G-buffer of 16 camera rays per pixel, whose seconds it pays for"),
    (
        "...+around, ...+before",
        "at the end of one of these with OIDN: with the samples of up to eight frames before and after, or before alone, each carried along \
         by motion and weighted by how well it agrees; each frame is traced and paid for once",
    ),
    (
        "pt4+neural",
        "the network that reads samples in place of OIDN, with the G-buffer that it reads; also pt-50ms+neural+around, \
         pt4+neural+before+keys (+keys last: with keyframes); pt4+oidn+neural, pt4+fast+neural: what OIDN makes of the samples, guided by \
         that G-buffer, is handed to the network beside them",
    ),
];
