//! Ways to get a picture, by name.

use super::results::{Group, Method};
use anyhow::{Result, bail, ensure};

/// How a path-traced picture is cleaned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Clean {
    /// Not at all.
    Raw,
    /// OIDN with least error.
    High,
    /// OIDN in least time.
    Fast,
    /// The network that reads all that is given ([`renderflow_model::fusion`]).
    Neural,
}

/// How many samples a pixel a path-traced picture has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Samples {
    /// This many, 1..=65536.
    Count(u32),
    /// As many as this many milliseconds allow for the whole picture, 1 at least; at 256 x 256 pixels, and in proportion to the pixels
    /// at other sizes.
    Within(u32),
    /// As many as the seconds allow that the method of this id took for the frame, 1 at least.
    AsLongAs(String),
}

/// Where the denoiser's guides come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Guides {
    /// The camera rays of the samples themselves.
    Own,
    /// A G-buffer of its own, whose seconds are paid.
    GBuffer,
}

/// Which other frames' samples are taken in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Neighbours {
    /// None.
    Alone,
    /// Those of the [`REACH`] frames before and after.
    Around,
    /// Those of the [`REACH`] frames before.
    Before,
}

/// How many frames away samples are taken from.
pub const REACH: usize = 2;

/// A way to trace a picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tracing {
    /// How many.
    pub samples: Samples,
    /// What follows.
    pub clean: Clean,
    /// What the denoiser is led by, where one follows.
    pub guides: Guides,
    /// What is taken in beside them.
    pub neighbours: Neighbours,
    /// Whether the network reads keyframes too.
    pub keyframes: bool,
}

/// A part of the deferred renderer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Lights taken out of the environment and shaded by themselves.
    Lights,
    /// All shadows but ambient occlusion.
    Shadows,
    /// Shadow maps of lights and sky; screen-space shadows of the lights stay.
    Maps,
    /// Shadows of the rest of the environment.
    Sky,
    /// Ambient occlusion.
    Occlusion,
    /// Screen-space reflections.
    Reflections,
    /// Screen-space indirect light.
    Indirect,
}

/// The networks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Network {
    /// The compact one.
    Compact,
    /// The paper's.
    Wan,
}

/// A way to get a picture.
#[derive(Clone, Debug, PartialEq)]
pub enum Way {
    /// Split-sum image-based lighting.
    Ibl,
    /// The deferred renderer, with a part left out.
    Deferred(Option<Part>),
    /// Keyframes carried along; in the holes the deferred renderer, or the split sum.
    Warp {
        /// Which of the two.
        deferred: bool,
    },
    /// The network that reads all that is given, on the terms of deferred shading.
    Fused {
        /// Whether it reads keyframes carried over them.
        keyframes: bool,
    },
    /// The compact network.
    Neural {
        /// Whether it reads them.
        keyframes: bool,
    },
    /// The paper's network, in clips.
    Wan {
        /// Whether it reads them.
        keyframes: bool,
        /// Each frame by itself instead.
        stills: bool,
    },
    /// Path tracing.
    Traced(Tracing),
}

const PARTS: [(Part, &str, &str); 7] = [
    (Part::Lights, "lights", "no lights taken out of the environment"),
    (Part::Shadows, "shadows", "no shadows"),
    (Part::Maps, "maps", "screen-space shadows only"),
    (Part::Sky, "sky", "no shadows of the sky"),
    (Part::Occlusion, "occlusion", "no ambient occlusion"),
    (Part::Reflections, "reflections", "no screen-space reflections"),
    (Part::Indirect, "indirect", "no screen-space indirect light"),
];

/// What is evaluated where nobody says otherwise.
pub const STANDARD: &str = "ibl,deferred,warp,neural,neural+keys,pt1+oidn,pt4+oidn";
/// Everything: parts switched off, all path-traced rows, equal time.
pub const ALL: &str = "ibl,deferred,deferred-lights,deferred-shadows,deferred-maps,deferred-sky,deferred-occlusion,deferred-reflections,\
deferred-indirect,warp-ibl,warp,neural,neural+keys,pt1,pt2,pt4,pt8,pt1+fast,pt2+fast,pt4+fast,pt8+fast,pt1+oidn,pt2+oidn,pt4+oidn,\
pt8+oidn,pt1+oidn+gbuffer,pt2+oidn+gbuffer,pt4+oidn+gbuffer,pt8+oidn+gbuffer,pt1+oidn+around,pt2+oidn+around,pt4+oidn+around,\
pt8+oidn+around,pt1+oidn+before,pt2+oidn+before,pt4+oidn+before,pt8+oidn+before,equal-deferred+fast,equal-deferred,equal-neural+keys";
/// What is traced in each budget, after the milliseconds.
const IN_BUDGET: [&str; 8] =
    ["+fast", "+fast+gbuffer", "+fast+around", "+fast+before", "+oidn", "+oidn+gbuffer", "+oidn+around", "+oidn+before"];
/// Longest budget, milliseconds: an hour.
const LONGEST: u32 = 3_600_000;

impl Way {
    /// The way named `id`; the names are in the help of `renderflow evaluate`.
    ///
    /// # Errors
    /// When there is none of that name.
    pub fn parse(id: &str) -> Result<Self> {
        if let Some(part) = id.strip_prefix("deferred-") {
            let Some((part, ..)) = PARTS.iter().find(|(_, name, _)| *name == part) else {
                let names: Vec<&str> = PARTS.iter().map(|part| part.1).collect();
                bail!("{id}: deferred has no part {part:?}, only {}", names.join(", "));
            };
            return Ok(Self::Deferred(Some(*part)));
        }
        if id.starts_with("equal-") || id.starts_with("pt") {
            return Tracing::parse(id).map(Self::Traced);
        }
        Ok(match id {
            "ibl" => Self::Ibl,
            "deferred" => Self::Deferred(None),
            "warp" => Self::Warp { deferred: true },
            "warp-ibl" => Self::Warp { deferred: false },
            "deferred+neural" => Self::Fused { keyframes: false },
            "warp+neural" => Self::Fused { keyframes: true },
            "neural" => Self::Neural { keyframes: false },
            "neural+keys" => Self::Neural { keyframes: true },
            "wan" => Self::Wan { keyframes: false, stills: false },
            "wan+keys" => Self::Wan { keyframes: true, stills: false },
            "wan-stills" => Self::Wan { keyframes: false, stills: true },
            "wan-stills+keys" => Self::Wan { keyframes: true, stills: true },
            _ => bail!("there is no method {id:?}; the help of `renderflow evaluate` lists them"),
        })
    }

    /// The ways of a comma-separated list in which `standard` and `all` stand for lists of their own, each once. A method whose time
    /// another one is given comes before it.
    ///
    /// # Errors
    /// As [`Self::parse`], and for an empty list.
    pub fn list(text: &str) -> Result<Vec<Self>> {
        let mut ways: Vec<Self> = Vec::new();
        let add = |ways: &mut Vec<Self>, way: Self| {
            if !ways.contains(&way) {
                ways.push(way);
            }
        };
        for name in text.split(',').map(str::trim).filter(|name| !name.is_empty()) {
            let names = match name {
                "standard" => STANDARD,
                "all" => ALL,
                other => other,
            };
            for id in names.split(',') {
                let way = Self::parse(id)?;
                if let Self::Traced(Tracing { samples: Samples::AsLongAs(to), .. }) = &way {
                    add(&mut ways, Self::parse(to)?);
                }
                add(&mut ways, way);
            }
        }
        ensure!(!ways.is_empty(), "no methods to evaluate");
        Ok(ways)
    }

    /// Path tracing in each of `budgets`, seconds a frame of 256 x 256 pixels: with OIDN in least time and of least error, led by its own
    /// camera rays and by a G-buffer, and with the samples of frames around and before.
    ///
    /// # Errors
    /// When one is no whole number of milliseconds, 1 ms to an hour.
    pub fn budgets(budgets: &[f64]) -> Result<Vec<Self>> {
        let mut ways: Vec<Self> = Vec::new();
        for seconds in budgets {
            let milliseconds = 1000.0 * seconds;
            let whole = milliseconds.round();
            let fits = (milliseconds - whole).abs() < 1e-6 && (1.0..=f64::from(LONGEST)).contains(&whole);
            ensure!(fits, "a budget of {seconds} s: whole milliseconds from .001 to {} s", LONGEST / 1000);
            for rest in IN_BUDGET {
                let way = Self::parse(&format!("pt-{whole}ms{rest}"))?;
                if !ways.contains(&way) {
                    ways.push(way);
                }
            }
        }
        Ok(ways)
    }

    /// Name in files and options.
    pub fn id(&self) -> String {
        match self {
            Self::Ibl => "ibl".into(),
            Self::Deferred(None) => "deferred".into(),
            Self::Deferred(Some(part)) => format!("deferred-{}", named(*part).0),
            Self::Warp { deferred: true } => "warp".into(),
            Self::Warp { deferred: false } => "warp-ibl".into(),
            Self::Fused { keyframes: false } => "deferred+neural".into(),
            Self::Fused { keyframes: true } => "warp+neural".into(),
            Self::Neural { keyframes: false } => "neural".into(),
            Self::Neural { keyframes: true } => "neural+keys".into(),
            Self::Wan { keyframes, stills } => {
                let [stills, keyframes] =
                    [(*stills, "-stills"), (*keyframes, "+keys")].map(|(on, name)| if on { name } else { "" });
                format!("wan{stills}{keyframes}")
            }
            Self::Traced(tracing) => tracing.id(),
        }
    }

    /// Whether it reads the truth of keyframes.
    pub fn needs_keyframes(&self) -> bool {
        match self {
            Self::Warp { .. } => true,
            Self::Fused { keyframes } | Self::Neural { keyframes } | Self::Wan { keyframes, .. } => *keyframes,
            Self::Traced(tracing) => tracing.keyframes,
            Self::Ibl | Self::Deferred(_) => false,
        }
    }

    /// Whether a network makes it, and whether it then reads keyframes.
    pub fn network(&self) -> Option<(Network, bool)> {
        match self {
            Self::Neural { keyframes } => Some((Network::Compact, *keyframes)),
            Self::Wan { keyframes, .. } => Some((Network::Wan, *keyframes)),
            _ => None,
        }
    }

    /// Whether a network that makes clips is to make each frame by itself.
    pub fn in_stills(&self) -> bool {
        matches!(self, Self::Wan { stills: true, .. })
    }

    /// Whether it starts from the deferred picture.
    pub fn is_deferred(&self) -> bool {
        matches!(self, Self::Deferred(_) | Self::Warp { deferred: true } | Self::Fused { .. })
    }

    /// Whether the network that reads all that is given makes it.
    pub fn is_fused(&self) -> bool {
        matches!(self, Self::Fused { .. } | Self::Traced(Tracing { clean: Clean::Neural, .. }))
    }

    /// What tables and plots say about it.
    pub fn describe(&self) -> Method {
        let (label, group, note) = match self {
            Self::Ibl => ("IBL (split sum)".to_owned(), Group::Baseline, "prefiltered environment, no shadows"),
            Self::Deferred(None) => {
                let note =
                    "lights of the environment with shadow maps, ambient occlusion, screen-space reflections and indirect light";
                ("Deferred".into(), Group::Baseline, note)
            }
            Self::Deferred(Some(part)) => (format!("Deferred, {}", named(*part).1), Group::Ablation, ""),
            Self::Warp { deferred: true } => {
                ("warped keyframes + Deferred".into(), Group::Baseline, "no network; reads the truth of keyframes")
            }
            Self::Warp { deferred: false } => {
                ("warped keyframes + IBL".into(), Group::Baseline, "no network; reads the truth of keyframes")
            }
            Self::Fused { keyframes: false } => ("Deferred + network".into(), Group::Neural, ""),
            Self::Fused { keyframes: true } => {
                ("warped keyframes + Deferred + network".into(), Group::Neural, "reads the truth of keyframes")
            }
            Self::Neural { keyframes: false } => ("neural".into(), Group::Neural, ""),
            Self::Neural { keyframes: true } => ("neural + keyframes".into(), Group::Neural, "reads the truth of keyframes"),
            Self::Wan { keyframes: false, stills: false } => {
                ("wan".into(), Group::Neural, "clips of frames at once; each has its share of their seconds")
            }
            Self::Wan { keyframes: true, stills: false } => {
                ("wan + keyframes".into(), Group::Neural, "clips of frames at once; reads the truth of keyframes")
            }
            Self::Wan { keyframes: false, stills: true } => ("wan, frame by frame".into(), Group::Neural, ""),
            Self::Wan { keyframes: true, stills: true } => {
                ("wan, frame by frame + keyframes".into(), Group::Neural, "reads the truth of keyframes")
            }
            Self::Traced(tracing) => return tracing.describe(),
        };
        Method { id: self.id(), label, group, series: None, spp: None, budget: None, note: note.into() }
    }
}

/// Takes `suffix` off the end of `text` and says whether it was there.
fn cut(text: &mut &str, suffix: &str) -> bool {
    let rest = text.strip_suffix(suffix);
    *text = rest.unwrap_or(text);
    rest.is_some()
}

impl Tracing {
    /// `pt4`, `pt-50ms` or `equal-METHOD`; then `+oidn` or `+fast` (`equal-` has OIDN of least error by itself), `+gbuffer`, and `+around` or
    /// `+before`.
    fn parse(id: &str) -> Result<Self> {
        let mut rest = id;
        // After `equal-` they are part of the other method's name.
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
            let to = Way::parse(to)?;
            let timed = !matches!(&to, Way::Traced(Self { samples: Samples::AsLongAs(_), .. }));
            ensure!(timed, "{id}: needs a method with a time of its own");
            return Ok(Self { samples: Samples::AsLongAs(to.id()), clean, guides, neighbours, keyframes });
        }
        let clean = if cut(&mut rest, "+oidn") {
            Clean::High
        } else if cut(&mut rest, "+fast") {
            Clean::Fast
        } else if cut(&mut rest, "+neural") {
            Clean::Neural
        } else {
            Clean::Raw
        };
        let Some(samples) = rest.strip_prefix("pt") else { bail!("there is no method {id:?}") };
        if let Some((_, after)) = samples.split_once('+') {
            bail!(
                "{id}: +{after} has no place there: +oidn, +fast or +neural, then +gbuffer, then +around or +before, then +keys"
            );
        }
        ensure!(
            clean != Clean::Raw || (guides, neighbours) == (Guides::Own, Neighbours::Alone),
            "{id}: +gbuffer, +around and +before are for the denoiser: put +oidn, +fast or +neural before"
        );
        ensure!(!keyframes || clean == Clean::Neural, "{id}: +keys is for the network: put +neural before");
        // The network reads the G-buffer always.
        ensure!(guides == Guides::Own || clean != Clean::Neural, "{id}: +neural has a G-buffer by itself");
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
        Ok(Self { samples, clean, guides, neighbours, keyframes })
    }

    fn id(&self) -> String {
        let (from, clean) = match (&self.samples, self.clean) {
            (Samples::Count(spp), clean) => (format!("pt{spp}"), clean.suffix()),
            (Samples::Within(milliseconds), clean) => (format!("pt-{milliseconds}ms"), clean.suffix()),
            (Samples::AsLongAs(to), Clean::Fast) => (format!("equal-{to}"), "+fast"),
            (Samples::AsLongAs(to), _) => (format!("equal-{to}"), ""),
        };
        let guides = if self.guides == Guides::GBuffer { "+gbuffer" } else { "" };
        let keyframes = if self.keyframes { "+keys" } else { "" };
        format!("{from}{clean}{guides}{}{keyframes}", self.neighbours.suffix())
    }

    /// What follows the samples, in words.
    fn words(&self) -> String {
        let guides = if self.guides == Guides::GBuffer { ", guided by a G-buffer" } else { "" };
        let keyframes = if self.keyframes { ", keyframes" } else { "" };
        format!("{}{guides}{}{keyframes}", self.clean.label(), self.neighbours.label())
    }

    fn describe(&self) -> Method {
        let words = self.words();
        let series = format!("path traced{words}");
        let (label, group, budget) = match &self.samples {
            Samples::Count(spp) => (format!("{spp} spp{words}"), Group::PathTraced, None),
            Samples::Within(milliseconds) => {
                let seconds = f64::from(*milliseconds) / 1000.0;
                (format!("{series} in {seconds} s"), Group::Budget, Some(seconds))
            }
            Samples::AsLongAs(to) => {
                let to = Way::parse(to).map_or_else(|_| to.clone(), |way| way.describe().label);
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
            Guides::Own if self.clean == Clean::Neural => Some("pays for the G-buffer"),
            Guides::Own => Some("guided by its own camera rays"),
            Guides::GBuffer => Some("pays for the G-buffer"),
        });
        note.extend((self.neighbours != Neighbours::Alone).then_some("each frame's samples are traced and paid once"));
        let (series, spp) = match self.samples {
            Samples::Count(spp) => (Some(series), Some(spp)),
            Samples::Within(_) => (Some(series), None),
            Samples::AsLongAs(_) => (None, None),
        };
        Method { id: self.id(), label, group, series, spp, budget, note: note.join("; ") }
    }
}

impl Clean {
    fn suffix(self) -> &'static str {
        match self {
            Self::Raw => "",
            Self::High => "+oidn",
            Self::Fast => "+fast",
            Self::Neural => "+neural",
        }
    }

    fn label(self) -> &'static str {
        match self {
            Self::Raw => "",
            Self::High => " + OIDN",
            Self::Fast => " + OIDN fast",
            Self::Neural => " + network",
        }
    }
}

impl Neighbours {
    fn suffix(self) -> &'static str {
        match self {
            Self::Alone => "",
            Self::Around => "+around",
            Self::Before => "+before",
        }
    }

    fn label(self) -> &'static str {
        match self {
            Self::Alone => "",
            Self::Around => ", 2 frames before and after",
            Self::Before => ", 2 frames before",
        }
    }

    /// Frames whose samples are taken in for frame `index` of `count`, nearest first; itself is not among them.
    pub fn of(self, index: usize, count: usize) -> Vec<usize> {
        let before = (1..=REACH).filter_map(|step| index.checked_sub(step));
        let after = (1..=REACH).map(|step| index + step).filter(|&other| other < count);
        let mut frames: Vec<usize> = match self {
            Self::Alone => Vec::new(),
            Self::Around => before.chain(after).collect(),
            Self::Before => before.collect(),
        };
        frames.sort_by_key(|&other| (other.abs_diff(index), other));
        frames
    }
}

/// Name and words of a part.
fn named(part: Part) -> (&'static str, &'static str) {
    PARTS.iter().find(|(known, ..)| *known == part).map_or(("", ""), |(_, name, words)| (*name, *words))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_lead_back_to_themselves() {
        let more = "wan,wan+keys,wan-stills,wan-stills+keys,pt300+fast,equal-ibl,equal-wan,equal-pt4+fast,equal-pt4+oidn+gbuffer+before,\
                    pt2+neural,pt-50ms+neural+around,pt4+neural+before+keys,pt1+neural+keys,deferred+neural,warp+neural,pt-50ms,pt-50ms+oidn,pt-800ms+fast+gbuffer+around,pt4+fast+before";
        let mut ways = Way::list(&format!("all,standard,{more}")).unwrap();
        ways.extend(Way::budgets(&[0.1, 0.8]).unwrap());
        assert!(ways.len() >= 60, "{}", ways.len());
        for way in &ways {
            assert_eq!(&Way::parse(&way.id()).unwrap(), way);
        }
        let mut labels: Vec<String> = ways.iter().map(|way| way.describe().label).collect();
        labels.sort();
        labels.dedup();
        assert_eq!(labels.len(), ways.len(), "two methods share a label");
    }

    #[test]
    fn parts_of_a_name_say_what_they_say() {
        let traced =
            |samples, clean, guides, neighbours| Way::Traced(Tracing { samples, clean, guides, neighbours, keyframes: false });
        let (own, alone) = (Guides::Own, Neighbours::Alone);
        for (id, expected) in [
            ("pt4", traced(Samples::Count(4), Clean::Raw, own, alone)),
            ("pt4+oidn", traced(Samples::Count(4), Clean::High, own, alone)),
            ("pt4+fast+gbuffer", traced(Samples::Count(4), Clean::Fast, Guides::GBuffer, alone)),
            ("pt-50ms+oidn+around", traced(Samples::Within(50), Clean::High, own, Neighbours::Around)),
            ("equal-ibl+before", traced(Samples::AsLongAs("ibl".into()), Clean::High, own, Neighbours::Before)),
            // What the seconds are taken of ends where its own parts begin.
            ("equal-pt4+oidn", traced(Samples::AsLongAs("pt4+oidn".into()), Clean::High, own, alone)),
            ("equal-pt4+fast", traced(Samples::AsLongAs("pt4".into()), Clean::Fast, own, alone)),
        ] {
            assert_eq!(Way::parse(id).unwrap(), expected, "{id}");
        }
    }

    #[test]
    fn budgets_are_rows_of_every_kind() {
        let ways = Way::budgets(&[0.05, 0.1, 0.05]).unwrap();
        assert_eq!(ways.len(), 2 * IN_BUDGET.len());
        let methods: Vec<Method> = ways.iter().map(Way::describe).collect();
        assert!(methods.iter().all(|method| method.group == Group::Budget && method.spp.is_none()));
        assert_eq!((methods[0].id.as_str(), methods[0].budget), ("pt-50ms+fast", Some(0.05)));
        for wrong in [0.0, -0.1, 0.0505, f64::NAN, f64::INFINITY, 3600.001] {
            assert!(Way::budgets(&[wrong]).is_err(), "{wrong}");
        }
    }

    #[test]
    fn neighbours_stay_inside_the_sequence() {
        assert_eq!(Neighbours::Around.of(3, 9), [2, 4, 1, 5]);
        assert_eq!(Neighbours::Before.of(3, 9), [2, 1]);
        assert_eq!((Neighbours::Around.of(0, 2), Neighbours::Around.of(8, 9)), (vec![1], vec![7, 6]));
        assert_eq!((Neighbours::Before.of(0, 9), Neighbours::Alone.of(3, 9)), (vec![], vec![]));
    }

    #[test]
    fn what_another_is_measured_against_comes_first() {
        let ways = Way::list("equal-neural+keys,ibl").unwrap();
        assert_eq!(ways.iter().map(Way::id).collect::<Vec<_>>(), ["neural+keys", "equal-neural+keys", "ibl"]);
        assert_eq!(Way::list("ibl, ibl").unwrap().len(), 1);
    }

    #[test]
    fn unknown_names_are_refused() {
        let traced = [
            "pt",
            "pt0",
            "pt99999",
            "pt4+nice",
            "pt4+gbuffer",
            "pt4+around",
            "pt4+around+oidn",
            "pt4+oidn+fast",
            "pt4+oidn+around+before",
            "pt4+oidn+keys",
            "pt4+keys",
            "pt4+neural+gbuffer",
            "equal-ibl+keys",
        ];
        let budgets = ["pt-", "pt-50", "pt-0ms", "pt-3600001ms", "pt-ms", "pt--5ms"];
        let others = ["", ",", "deferred-sound", "equal-equal-ibl", "equal-", "cycles"];
        for name in traced.iter().chain(&budgets).chain(&others) {
            assert!(Way::list(name).is_err(), "{name}");
        }
    }
}
