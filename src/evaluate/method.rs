//! Ways to get a picture, by name.

use super::results::{Group, Method};
use anyhow::{Result, bail, ensure};

/// How a path-traced picture is cleaned.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Clean {
    /// Not at all.
    Raw,
    /// OIDN with least error.
    High,
    /// OIDN in least time.
    Fast,
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
    /// The network.
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
    Traced {
        /// Samples a pixel.
        spp: u32,
        /// What follows.
        clean: Clean,
    },
    /// Path tracing in the seconds that another method took.
    Equal {
        /// Id of that method.
        to: String,
        /// What follows.
        clean: Clean,
    },
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
pt8+oidn,equal-deferred+fast,equal-deferred,equal-neural+keys";

impl Clean {
    fn suffix(self) -> &'static str {
        match self {
            Self::Raw => "",
            Self::High => "+oidn",
            Self::Fast => "+fast",
        }
    }
}

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
        if let Some(to) = id.strip_prefix("equal-") {
            let (to, clean) = match to.strip_suffix("+fast") {
                Some(to) => (to, Clean::Fast),
                None => (to, Clean::High),
            };
            ensure!(!matches!(Self::parse(to)?, Self::Equal { .. }), "{id}: needs a method with a time of its own");
            return Ok(Self::Equal { to: to.into(), clean });
        }
        if let Some(spp) = id.strip_prefix("pt") {
            let (spp, clean) = match spp.split_once('+') {
                None => (spp, Clean::Raw),
                Some((spp, "oidn")) => (spp, Clean::High),
                Some((spp, "fast")) => (spp, Clean::Fast),
                Some((_, clean)) => bail!("{id}: +oidn or +fast, not +{clean}"),
            };
            return match spp.parse() {
                Ok(spp @ 1..=65536) => Ok(Self::Traced { spp, clean }),
                _ => bail!("{id}: {spp:?} is no number of samples, 1..=65536"),
            };
        }
        Ok(match id {
            "ibl" => Self::Ibl,
            "deferred" => Self::Deferred(None),
            "warp" => Self::Warp { deferred: true },
            "warp-ibl" => Self::Warp { deferred: false },
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
                if let Self::Equal { to, .. } = &way {
                    add(&mut ways, Self::parse(to)?);
                }
                add(&mut ways, way);
            }
        }
        ensure!(!ways.is_empty(), "no methods to evaluate");
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
            Self::Neural { keyframes: false } => "neural".into(),
            Self::Neural { keyframes: true } => "neural+keys".into(),
            Self::Wan { keyframes, stills } => {
                let [stills, keyframes] =
                    [(*stills, "-stills"), (*keyframes, "+keys")].map(|(on, name)| if on { name } else { "" });
                format!("wan{stills}{keyframes}")
            }
            Self::Traced { spp, clean } => format!("pt{spp}{}", clean.suffix()),
            Self::Equal { to, clean: Clean::Fast } => format!("equal-{to}+fast"),
            Self::Equal { to, .. } => format!("equal-{to}"),
        }
    }

    /// Whether it reads the truth of keyframes.
    pub fn needs_keyframes(&self) -> bool {
        matches!(self, Self::Warp { .. } | Self::Neural { keyframes: true } | Self::Wan { keyframes: true, .. })
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
        matches!(self, Self::Deferred(_) | Self::Warp { deferred: true })
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
            Self::Traced { spp, clean } => (format!("{spp} spp{}", clean.label()), Group::PathTraced, ""),
            Self::Equal { to, clean } => {
                let to = Self::parse(to).map_or_else(|_| to.clone(), |way| way.describe().label);
                (format!("path traced{} in the time of {to}", clean.label()), Group::EqualTime, "1 spp at least")
            }
        };
        let (series, spp) = match self {
            Self::Traced { spp, clean } => (Some(format!("path traced{}", clean.label())), Some(*spp)),
            _ => (None, None),
        };
        Method { id: self.id(), label, group, series, spp, note: note.into() }
    }
}

impl Clean {
    fn label(self) -> &'static str {
        match self {
            Self::Raw => "",
            Self::High => " + OIDN",
            Self::Fast => " + OIDN fast",
        }
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
        let ways = Way::list("all,standard,wan,wan+keys,wan-stills,wan-stills+keys,pt300+fast,equal-ibl,equal-wan").unwrap();
        assert!(ways.len() >= 31, "{}", ways.len());
        for way in &ways {
            assert_eq!(&Way::parse(&way.id()).unwrap(), way);
        }
        let mut labels: Vec<String> = ways.iter().map(|way| way.describe().label).collect();
        labels.sort();
        labels.dedup();
        assert_eq!(labels.len(), ways.len(), "two methods share a label");
    }

    #[test]
    fn what_another_is_measured_against_comes_first() {
        let ways = Way::list("equal-neural+keys,ibl").unwrap();
        assert_eq!(ways.iter().map(Way::id).collect::<Vec<_>>(), ["neural+keys", "equal-neural+keys", "ibl"]);
        assert_eq!(Way::list("ibl, ibl").unwrap().len(), 1);
    }

    #[test]
    fn unknown_names_are_refused() {
        for name in ["", ",", "pt", "pt0", "pt99999", "pt4+nice", "deferred-sound", "equal-equal-ibl", "equal-", "cycles"] {
            assert!(Way::list(name).is_err(), "{name}");
        }
    }
}
