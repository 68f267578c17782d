//! The methods that are compared. A method is a variant of [`Method`], a row of [`METHODS`] and an arm of `MethodRenderer`;
//! names, lists, help and the columns of reports follow from the row. Path tracing has a grammar of names instead of rows
//! ([`tracing`]).

pub mod tracing;

use super::results::{Group, MethodInfo};
use anyhow::{Context, Result, ensure};
use std::fmt::Write;
use tracing::{Clean, Samples, Tracing};

/// A part of the deferred renderer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Lights that are taken out of the environment and shaded separately.
    Lights,
    /// All shadows except ambient occlusion.
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

/// How a picture is made.
#[derive(Clone, Debug, PartialEq)]
pub enum Method {
    /// Split-sum image-based lighting.
    Ibl,
    /// The deferred renderer, with a part left out.
    Deferred(Option<Part>),
    /// Keyframes carried to other frames; the deferred renderer or the split sum fills holes.
    Warp {
        /// Whether the deferred renderer fills them.
        deferred: bool,
    },
    /// The network that reads samples; here it reads terms of deferred shading instead.
    Neural {
        /// Whether it also reads keyframes.
        keyframes: bool,
    },
    /// The paper's network, in clips.
    Wan {
        /// Whether it reads keyframes.
        keyframes: bool,
        /// Whether it renders each frame by itself.
        stills: bool,
    },
    /// Path tracing.
    Traced(Tracing),
}

/// Everything that names, lists, help and tables say about a method.
#[derive(Debug)]
pub struct Entry {
    /// The method.
    pub method: Method,
    /// Name in files and options.
    pub id: &'static str,
    /// Name in tables.
    pub label: &'static str,
    /// The group of methods that it is listed with.
    pub group: Group,
    /// What readers of its rows should know, in a few words; empty where the label says it.
    pub note: &'static str,
    /// What it is, for the help.
    pub help: &'static str,
    /// The list that includes it.
    pub list: List,
}

/// Lists that stand for several methods.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum List {
    /// `standard`, and so also `all`.
    Standard,
    /// `all`.
    All,
    /// No list: it must be named.
    Named,
}

/// Every method but path tracing, in the order of tables.
pub static METHODS: &[Entry] = &[
    Entry {
        method: Method::Ibl,
        id: "ibl",
        label: "IBL (split sum)",
        group: Group::Baseline,
        note: "prefiltered environment, no shadows",
        help: "split-sum image-based lighting",
        list: List::Standard,
    },
    Entry {
        method: Method::Deferred(None),
        id: "deferred",
        label: "Deferred",
        group: Group::Baseline,
        note: "lights of the environment with shadow maps, ambient occlusion, screen-space reflections and indirect light",
        help: "lights taken out of the environment with shadow maps, ambient occlusion, screen-space reflections and indirect light",
        list: List::Standard,
    },
    part(Part::Lights, "deferred-lights", "Deferred, no lights taken out of the environment"),
    part(Part::Shadows, "deferred-shadows", "Deferred, no shadows"),
    part(Part::Maps, "deferred-maps", "Deferred, screen-space shadows only"),
    part(Part::Sky, "deferred-sky", "Deferred, no shadows of the sky"),
    part(Part::Occlusion, "deferred-occlusion", "Deferred, no ambient occlusion"),
    part(Part::Reflections, "deferred-reflections", "Deferred, no screen-space reflections"),
    part(Part::Indirect, "deferred-indirect", "Deferred, no screen-space indirect light"),
    Entry {
        method: Method::Warp { deferred: false },
        id: "warp-ibl",
        label: "warped keyframes + IBL",
        group: Group::Baseline,
        note: "no network; reads the truth of keyframes",
        help: "keyframes carried along by motion, ibl in the holes; no network",
        list: List::All,
    },
    Entry {
        method: Method::Warp { deferred: true },
        id: "warp",
        label: "warped keyframes + Deferred",
        group: Group::Baseline,
        note: "no network; reads the truth of keyframes",
        help: "keyframes carried along by motion, deferred in the holes; no network",
        list: List::Standard,
    },
    Entry {
        method: Method::Neural { keyframes: false },
        id: "neural",
        label: "neural",
        group: Group::Neural,
        note: "",
        help: "the network inside the program, on the terms of deferred shading",
        list: List::Standard,
    },
    Entry {
        method: Method::Neural { keyframes: true },
        id: "neural+keys",
        label: "neural + keyframes",
        group: Group::Neural,
        note: "reads the truth of keyframes",
        help: "the same with keyframes carried over its picture",
        list: List::Standard,
    },
    Entry {
        method: Method::Wan { keyframes: false, stills: false },
        id: "wan",
        label: "wan",
        group: Group::Neural,
        note: "clips of frames at once; each has its share of their seconds",
        help: "the paper's network; needs its --weights",
        list: List::Named,
    },
    Entry {
        method: Method::Wan { keyframes: true, stills: false },
        id: "wan+keys",
        label: "wan + keyframes",
        group: Group::Neural,
        note: "clips of frames at once; reads the truth of keyframes",
        help: "the same with keyframes",
        list: List::Named,
    },
    Entry {
        method: Method::Wan { keyframes: false, stills: true },
        id: "wan-stills",
        label: "wan, frame by frame",
        group: Group::Neural,
        note: "",
        help: "the paper's network on each frame by itself",
        list: List::Named,
    },
    Entry {
        method: Method::Wan { keyframes: true, stills: true },
        id: "wan-stills+keys",
        label: "wan, frame by frame + keyframes",
        group: Group::Neural,
        note: "reads the truth of keyframes",
        help: "the same with keyframes",
        list: List::Named,
    },
];

/// The deferred renderer without a part. The label names what is missing after `Deferred, `.
const fn part(part: Part, id: &'static str, label: &'static str) -> Entry {
    Entry {
        method: Method::Deferred(Some(part)),
        id,
        label,
        group: Group::Ablation,
        note: "",
        help: "deferred without this part",
        list: List::All,
    }
}

/// Path-traced rows of the list `standard`.
const STANDARD_TRACED: [&str; 2] = ["pt1+oidn", "pt4+oidn"];
/// Path-traced rows of the list `all`: each of these with 1, 2, 4 and 8 samples for each pixel, then rows of equal time.
const ALL_TRACED: [&str; 6] = ["", "+fast", "+oidn", "+oidn+gbuffer", "+oidn+around", "+oidn+before"];
const ALL_EQUAL: [&str; 3] = ["equal-deferred+fast", "equal-deferred", "equal-neural+keys"];

impl List {
    /// The names of its methods.
    fn ids(self) -> Vec<String> {
        let rows = METHODS.iter().filter(|entry| entry.list <= self).map(|entry| entry.id.to_owned());
        let traced: Vec<String> = match self {
            Self::Standard => STANDARD_TRACED.map(str::to_owned).into(),
            Self::All => {
                let counted = ALL_TRACED.iter().flat_map(|form| [1, 2, 4, 8].map(|spp| format!("pt{spp}{form}")));
                counted.chain(ALL_EQUAL.map(str::to_owned)).collect()
            }
            Self::Named => Vec::new(),
        };
        rows.chain(traced).collect()
    }
}

/// The text about methods in the help.
pub fn help() -> String {
    let rows = METHODS.iter().map(|entry| (entry.id, entry.help)).chain(tracing::HELP);
    let standard = format!("the list of {}", List::Standard.ids().join(", "));
    let rows =
        rows.chain([("standard", standard.as_str()), ("all", "parts switched off, every form of path tracing, equal time")]);
    let mut text = String::new();
    for (name, help) in rows {
        // Writing to a string cannot fail.
        if name.len() < NAMES {
            let _ = write!(text, "\n  {name:NAMES$}");
        } else {
            let _ = write!(text, "\n  {name}\n  {:NAMES$}", "");
        }
        let mut column = 2 + NAMES;
        for word in help.split(' ') {
            if column + word.len() > WIDTH {
                text.truncate(text.trim_end().len());
                let _ = write!(text, "\n  {:NAMES$}", "");
                column = 2 + NAMES;
            }
            let _ = write!(text, "{word} ");
            column += word.len() + 1;
        }
        text.truncate(text.trim_end().len());
    }
    text
}

/// Columns of names in the help, and columns in all.
const NAMES: usize = 24;
const WIDTH: usize = 130;

impl Method {
    /// The method named `id`; the help of `renderflow evaluate` lists the names.
    ///
    /// # Errors
    /// When there is no such method.
    pub fn parse(id: &str) -> Result<Self> {
        if id.starts_with("equal-") || id.starts_with("pt") {
            return Tracing::parse(id).map(Self::Traced);
        }
        let found = METHODS.iter().find(|entry| entry.id == id);
        found
            .map(|entry| entry.method.clone())
            .with_context(|| format!("there is no method {id:?}; the help of `renderflow evaluate` lists them"))
    }

    /// The methods in a comma-separated list, each once; `standard` and `all` stand for lists. If a method takes the time of
    /// another one, that one comes first.
    ///
    /// # Errors
    /// As [`Self::parse`], and for an empty list.
    pub fn list(text: &str) -> Result<Vec<Self>> {
        let mut methods: Vec<Self> = Vec::new();
        let add = |methods: &mut Vec<Self>, method: Self| {
            if !methods.contains(&method) {
                methods.push(method);
            }
        };
        for name in text.split(',').map(str::trim).filter(|name| !name.is_empty()) {
            let ids = match name {
                "standard" => List::Standard.ids(),
                "all" => List::All.ids(),
                other => vec![other.to_owned()],
            };
            for id in ids {
                let method = Self::parse(&id)?;
                if let Self::Traced(Tracing { samples: Samples::AsLongAs(to), .. }) = &method {
                    add(&mut methods, Self::parse(to)?);
                }
                add(&mut methods, method);
            }
        }
        ensure!(!methods.is_empty(), "no methods to evaluate");
        Ok(methods)
    }

    /// Path tracing within each of `budgets`, in seconds for each frame of 256 x 256 pixels: with OIDN in least time and with
    /// least error, guided by its own camera rays and by a G-buffer, and with the samples of frames before or around.
    ///
    /// # Errors
    /// When a budget is not a whole number of milliseconds from 1 ms to an hour.
    pub fn budgets(budgets: &[f64]) -> Result<Vec<Self>> {
        let mut methods: Vec<Self> = Vec::new();
        for seconds in budgets {
            let milliseconds = 1000.0 * seconds;
            let whole = milliseconds.round();
            let fits = (milliseconds - whole).abs() < 1e-6 && (1.0..=f64::from(tracing::LONGEST)).contains(&whole);
            ensure!(fits, "a budget of {seconds} s: whole milliseconds from .001 to {} s", tracing::LONGEST / 1000);
            for rest in tracing::IN_BUDGET {
                let method = Self::parse(&format!("pt-{whole}ms{rest}"))?;
                if !methods.contains(&method) {
                    methods.push(method);
                }
            }
        }
        Ok(methods)
    }

    /// Its row of [`METHODS`]; `None` for path tracing.
    fn entry(&self) -> Option<&'static Entry> {
        METHODS.iter().find(|entry| entry.method == *self)
    }

    /// Name in files and options.
    pub fn id(&self) -> String {
        match self {
            Self::Traced(tracing) => tracing.id(),
            other => other.entry().map_or_else(String::new, |entry| entry.id.to_owned()),
        }
    }

    /// Whether it reads the truth of keyframes.
    pub fn needs_keyframes(&self) -> bool {
        match self {
            Self::Warp { .. } => true,
            Self::Neural { keyframes } | Self::Wan { keyframes, .. } => *keyframes,
            Self::Traced(tracing) => tracing.keyframes,
            Self::Ibl | Self::Deferred(_) => false,
        }
    }

    /// Whether the paper's network makes it.
    pub fn is_wan(&self) -> bool {
        matches!(self, Self::Wan { .. })
    }

    /// Whether it starts from the deferred picture.
    pub fn is_deferred(&self) -> bool {
        matches!(self, Self::Deferred(_) | Self::Warp { deferred: true } | Self::Neural { .. })
    }

    /// Whether the network that reads samples makes it.
    pub fn is_neural(&self) -> bool {
        matches!(self, Self::Neural { .. } | Self::Traced(Tracing { clean: Clean::Neural(_), .. }))
    }

    /// The facts about it for tables and plots.
    pub fn describe(&self) -> MethodInfo {
        if let Self::Traced(tracing) = self {
            return tracing.describe();
        }
        let Some(entry) = self.entry() else { return MethodInfo::new(self.id(), self.id(), Group::Other) };
        MethodInfo {
            note: entry.note.to_owned(),
            reads_keyframes: self.needs_keyframes(),
            part_of: matches!(self, Self::Deferred(Some(_))).then(|| Self::Deferred(None).id()),
            ..MethodInfo::new(entry.id.to_owned(), entry.label.to_owned(), entry.group)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::tracing::{Guides, IN_BUDGET};
    use super::*;
    use crate::dataset::around::Neighbours;

    #[test]
    fn names_lead_back_to_themselves() {
        let more = "wan,wan+keys,wan-stills,wan-stills+keys,pt300+fast,equal-ibl,equal-wan,equal-pt4+fast,equal-pt4+oidn+gbuffer+before,\
                    pt2+neural,pt-50ms+neural+around,pt4+neural+before+keys,pt1+neural+keys,pt-50ms,pt-50ms+oidn,pt-800ms+fast+gbuffer+around,pt4+fast+before";
        let mut methods = Method::list(&format!("all,standard,{more}")).unwrap();
        methods.extend(Method::budgets(&[0.1, 0.8]).unwrap());
        assert!(methods.len() >= 60, "{}", methods.len());
        for method in &methods {
            assert_eq!(&Method::parse(&method.id()).unwrap(), method);
        }
        let mut labels: Vec<String> = methods.iter().map(|method| method.describe().label).collect();
        labels.sort();
        labels.dedup();
        assert_eq!(labels.len(), methods.len(), "two methods share a label");
    }

    #[test]
    fn the_help_names_every_method_in_short_lines() {
        let help = help();
        for entry in METHODS {
            assert!(help.contains(&format!("\n  {} ", entry.id)), "{}", entry.id);
        }
        assert!(help.lines().all(|line| line.len() <= WIDTH && !line.ends_with(' ')), "{help}");
    }

    #[test]
    fn what_a_method_is_taken_from_is_said() {
        let told = |id: &str| {
            let info = Method::parse(id).unwrap().describe();
            (info.reads_keyframes, info.time_of, info.part_of)
        };
        assert_eq!(told("deferred-sky"), (false, None, Some("deferred".to_owned())));
        assert_eq!(told("equal-neural+keys"), (false, Some("neural+keys".to_owned()), None));
        assert_eq!(told("neural+keys"), (true, None, None));
        assert_eq!([told("pt4+neural+keys"), told("pt4+neural")].map(|told| told.0), [true, false]);
    }

    #[test]
    fn parts_of_a_name_say_what_they_say() {
        let traced = |samples, clean, guides, neighbours| {
            Method::Traced(Tracing { samples, adaptive: false, clean, guides, neighbours, keyframes: false })
        };
        let (own, alone) = (Guides::Own, Neighbours::Alone);
        for (id, expected) in [
            ("pt4", traced(Samples::Count(4), Clean::Raw, own, alone)),
            ("pt4+oidn", traced(Samples::Count(4), Clean::High, own, alone)),
            ("pt4+fast+gbuffer", traced(Samples::Count(4), Clean::Fast, Guides::GBuffer, alone)),
            ("pt-50ms+oidn+around", traced(Samples::Within(50), Clean::High, own, Neighbours::Around)),
            ("equal-ibl+before", traced(Samples::AsLongAs("ibl".into()), Clean::High, own, Neighbours::Before)),
            // The name of the other method ends where this method's own parts start.
            ("equal-pt4+oidn", traced(Samples::AsLongAs("pt4+oidn".into()), Clean::High, own, alone)),
            ("equal-pt4+fast", traced(Samples::AsLongAs("pt4".into()), Clean::Fast, own, alone)),
        ] {
            assert_eq!(Method::parse(id).unwrap(), expected, "{id}");
        }
        let spread = |id: &str| match Method::parse(id).unwrap() {
            Method::Traced(tracing) => (tracing.adaptive, Method::Traced(tracing).id()),
            _ => unreachable!(),
        };
        for id in ["pt4+adaptive+oidn", "pt-50ms+adaptive+oidn+neural+around", "equal-pt4+adaptive+oidn"] {
            assert_eq!(spread(id), (!id.starts_with("equal"), id.to_owned()));
        }
    }

    #[test]
    fn budgets_are_rows_of_every_kind() {
        let methods = Method::budgets(&[0.05, 0.1, 0.05]).unwrap();
        assert_eq!(methods.len(), 2 * IN_BUDGET.len());
        let methods: Vec<MethodInfo> = methods.iter().map(Method::describe).collect();
        assert!(methods.iter().all(|method| method.group == Group::Budget && method.spp.is_none()));
        assert_eq!((methods[0].id.as_str(), methods[0].budget), ("pt-50ms+fast", Some(0.05)));
        for wrong in [0.0, -0.1, 0.0505, f64::NAN, f64::INFINITY, 3600.001] {
            assert!(Method::budgets(&[wrong]).is_err(), "{wrong}");
        }
    }

    #[test]
    fn what_another_is_measured_against_comes_first() {
        let methods = Method::list("equal-neural+keys,ibl").unwrap();
        assert_eq!(methods.iter().map(Method::id).collect::<Vec<_>>(), ["neural+keys", "equal-neural+keys", "ibl"]);
        assert_eq!(Method::list("ibl, ibl").unwrap().len(), 1);
    }

    #[test]
    fn unknown_names_are_refused() {
        let traced = [
            "pt",
            "pt0",
            "pt99999",
            "pt4+nice",
            "pt4+adaptive",
            "pt4+oidn+adaptive",
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
            assert!(Method::list(name).is_err(), "{name}");
        }
    }
}
