//! Edits of a scene in steps: values that go from one end to another, while everything else stays.

use super::Sequence;
use super::job::{SequenceJob, TruthSettings};
use super::source::{Setting, apply};
use crate::util::cancel::Cancel;
use crate::util::progress::Progress;
use crate::util::text::short;
use anyhow::{Context, Result};
use renderflow_frame::frame_file::Profile;
use renderflow_frame::reach::Reach;
use renderflow_scenes::LoadReport;
use renderflow_scenes::description::{
    CameraPath, EnvironmentLight, EnvironmentSource, Geometry, Material, Object, Scene, Transform,
};
use renderflow_scenes::shapes::Shape;
use serde_json::Value;
use std::path::Path;
use std::str::FromStr;

/// A value of a scene that changes from step to step. As text: `PATH=FROM..TO`; both ends are numbers, or lists of as many
/// numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Sweep {
    path: Vec<String>,
    ends: [Vec<f64>; 2],
    /// Whether the value is a list.
    list: bool,
}

impl FromStr for Sweep {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        const FORM: &str = "give PATH=FROM..TO, as in materials/0/roughness=1..0 or materials/0/base_color=[0,0,1]..[0,1,0]";
        let (path, ends) = text.split_once('=').ok_or(FORM)?;
        let path = Setting::steps(path)?;
        // A number may begin with its point, so there may be several places with two points.
        let split = |(at, _): (usize, &str)| Some([numbers(&ends[..at])?, numbers(&ends[at + 2..])?]);
        let points = (0..ends.len()).filter_map(|at| ends.get(at..at + 2).map(|two| (at, two))).filter(|(_, two)| *two == "..");
        let [(from, list), (to, both)] = points.into_iter().find_map(split).ok_or(FORM)?;
        if list != both || from.len() != to.len() {
            return Err("the ends have different numbers of values".into());
        }
        Ok(Self { path, ends: [from, to], list })
    }
}

/// The numbers of one end, and whether they are a list.
fn numbers(text: &str) -> Option<(Vec<f64>, bool)> {
    let finite = |number: f64| number.is_finite().then_some(number);
    let number = |text: &str| text.trim().parse().ok().and_then(finite);
    match text.trim().strip_prefix('[') {
        None => Some((vec![number(text)?], false)),
        Some(rest) => Some((rest.strip_suffix(']')?.split(',').map(number).collect::<Option<_>>()?, true)),
    }
}

impl Sweep {
    /// A sweep of one number.
    fn new(path: &[&str], from: &[f64], to: &[f64]) -> Self {
        let path = path.iter().map(|&step| step.to_owned()).collect();
        Self { path, ends: [from.to_owned(), to.to_owned()], list: from.len() > 1 }
    }

    /// The values at `share` of the way; 0 and 1 are the ends, exactly.
    fn values(&self, share: f64) -> Vec<f64> {
        let [from, to] = &self.ends;
        from.iter().zip(to).map(|(a, b)| (1.0 - share) * a + share * b).collect()
    }

    fn setting(&self, share: f64) -> Setting {
        let values = self.values(share);
        let value = if self.list { Value::from(values) } else { values.first().copied().map_or(Value::Null, Value::from) };
        Setting::new(self.path.clone(), value)
    }

    /// The last name of its path.
    pub fn name(&self) -> &str {
        let name = self.path.iter().rev().find(|step| step.parse::<usize>().is_err());
        name.map_or("value", String::as_str)
    }

    /// Name and value at `share` of the way, for a heading.
    pub fn label(&self, share: f64) -> String {
        let values: Vec<String> = self.values(share).into_iter().map(short).collect();
        format!("{} {}", self.name(), values.join(" "))
    }
}

/// A scene, and sweeps of its values that happen together.
#[derive(Clone, Debug)]
pub struct Edit {
    /// Name of the edit, for folders and headings: letters, digits, `-` and `_`.
    pub name: String,
    /// The scene. The sweeps replace some of its values.
    pub scene: Scene,
    /// The sweeps.
    pub sweeps: Vec<Sweep>,
}

impl Edit {
    /// Sweeps of a user's scene.
    pub fn new(scene: Scene, sweeps: Vec<Sweep>) -> Self {
        let plain = |c: char| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' };
        let mut name: String = sweeps.iter().map(Sweep::name).collect::<Vec<_>>().join("-").chars().map(plain).collect();
        name.truncate(LONGEST_NAME);
        Self { name, scene, sweeps }
    }

    /// The scene at `step`, counted from 0, of `steps`. The first and the last step are the ends of the sweeps.
    ///
    /// # Errors
    /// When a sweep names no value of the scene, or leaves the range of its value.
    pub fn at(&self, step: u32, steps: u32) -> Result<Scene> {
        let share = share(step, steps);
        let settings: Vec<Setting> = self.sweeps.iter().map(|sweep| sweep.setting(share)).collect();
        let scene = apply(&self.scene, &settings)?;
        scene.validate().with_context(|| format!("sweep at {}", self.label(step, steps)))?;
        Ok(scene)
    }

    /// What changes, and its values at `step`.
    pub fn label(&self, step: u32, steps: u32) -> String {
        self.sweeps.iter().map(|sweep| sweep.label(share(step, steps))).collect::<Vec<_>>().join(", ")
    }
}

/// The steps of edits, rendered.
#[derive(Debug)]
pub struct Swept {
    /// The sequence of each step, with the name of its edit.
    pub steps: Vec<(String, Sequence)>,
    /// What loading the first scene had to decide; `None` without edits.
    pub load: Option<LoadReport>,
}

/// Path-traces one frame of each of `steps` steps of all `edits`, in the folders `NAME/STEP` of `out`. Frames that are there
/// stay.
///
/// # Errors
/// As [`Edit::at`], before anything is rendered; when stopped; when a folder holds something else or cannot be written.
pub fn render(edits: &[Edit], steps: u32, base: &Reach, out: &Path, settings: &TruthSettings, cancel: &Cancel) -> Result<Swept> {
    let mut jobs = Vec::new();
    for edit in edits {
        for step in 0..steps {
            let out = out.join(&edit.name).join(format!("{step:04}"));
            let scene = edit.at(step, steps)?;
            let job = SequenceJob { scene, base: base.clone(), out, keyframe_gap: 0, frame_step: 1, storage: Profile::Full };
            jobs.push((&edit.name, job));
        }
    }
    let progress = Progress::new("path tracing", 1000 * jobs.len() as u64);
    let mut swept = Swept { steps: Vec::new(), load: None };
    for (name, job) in &jobs {
        let mut sequence = job.open().with_context(|| job.out.display().to_string())?;
        let work = sequence.decide(settings, None)?;
        sequence.make(&work, settings, &progress, cancel)?;
        swept.load.get_or_insert(sequence.loaded.report);
        swept.steps.push(((*name).clone(), Sequence::open(&job.out)?));
    }
    progress.finish();
    Ok(swept)
}

/// Longest name of a folder that is made from the names of sweeps.
const LONGEST_NAME: usize = 60;

fn share(step: u32, steps: u32) -> f64 {
    f64::from(step) / f64::from(steps.saturating_sub(1).max(1))
}

/// The three edits of the paper's figure on materials: a red cone becomes smooth, a yellow cylinder becomes metal, and the colour
/// of a cube goes from blue to green. The paper gives all values but the shades of red and yellow, the sizes and the light.
pub fn published(resolution: [u32; 2]) -> Vec<Edit> {
    let material = |base_color, metallic, roughness, specular| Material { base_color, metallic, roughness, specular, ..body() };
    let cone = Shape::Cone { radius: 0.5, top_radius: 0.0, height: 1.1 };
    let cylinder = Shape::Cylinder { radius: 0.42, height: 1.0, bevel: 0.03 };
    let cube = Shape::Box { size: [0.8; 3], bevel: 0.02 };
    let roughness = Sweep::new(&["materials", "1", "roughness"], &[1.0], &[0.0]);
    let metallic = Sweep::new(&["materials", "1", "metallic"], &[0.0], &[1.0]);
    let color = Sweep::new(&["materials", "1", "base_color"], &[0.0, 0.0, 1.0], &[0.0, 1.0, 0.0]);
    let edit = |name: &str, shape, height, material, sweep| Edit {
        name: name.to_owned(),
        scene: stage(name, resolution, shape, height, material),
        sweeps: vec![sweep],
    };
    vec![
        edit("cone-roughness", cone, 1.1, material([0.7, 0.03, 0.03], 0.5, 1.0, 0.5), roughness),
        edit("cylinder-metallic", cylinder, 1.0, material([0.8, 0.62, 0.03], 0.0, 0.5, 0.5), metallic),
        edit("cube-color", cube, 0.8, material([0.0, 0.0, 1.0], 0.5, 0.5, 0.5), color),
    ]
}

fn body() -> Material {
    Material { name: "body".into(), ..Material::default() }
}

/// A shape of this `height` on a ground, under a built-in sky.
fn stage(name: &str, resolution: [u32; 2], shape: Shape, height: f64, material: Material) -> Scene {
    let ground = Material { name: "ground".into(), base_color: [0.45; 3], roughness: 0.8, ..Material::default() };
    let object = |name: &str, shape, material: &Material, translation| Object {
        name: name.into(),
        geometry: Geometry::Shape(shape),
        material: Some(material.name.clone()),
        transform: Transform { translation, ..Transform::default() },
        motion: None,
        animation: None,
    };
    Scene {
        version: 1,
        name: name.into(),
        seed: 1,
        resolution,
        frames: 1,
        camera: CameraPath::Orbit {
            target: [0.0, 0.45 * height, 0.0],
            distance: 3.4,
            elevation: 18.0,
            azimuth: 30.0,
            degrees_per_frame: 0.0,
            vertical_fov: 34.0,
        },
        environment: EnvironmentLight {
            source: EnvironmentSource::Builtin("studio_three_point".into()),
            rotation: 0.0,
            intensity: 1.0,
        },
        objects: vec![
            object("ground", Shape::Plane { size: 12.0 }, &ground, [0.0; 3]),
            object("body", shape, &material, [0.0, 0.5 * height, 0.0]),
        ],
        materials: vec![ground, material],
        lights: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_are_numbers_or_lists_and_are_reached_exactly() {
        let sweep = |text: &str| text.parse::<Sweep>();
        for (text, first, middle, last) in [
            ("materials/0/roughness=1..0", "roughness 1", "roughness 0.5", "roughness 0"),
            ("a/b/3=.1...3", "b 0.1", "b 0.2", "b 0.3"),
            ("a=-1...5", "a -1", "a -0.25", "a 0.5"),
            ("x/c=[0, 0,1]..[0,1e0,0]", "c 0 0 1", "c 0 0.5 0.5", "c 0 1 0"),
        ] {
            let sweep = sweep(text).unwrap_or_else(|error| panic!("{text}: {error}"));
            assert_eq!([0.0, 0.5, 1.0].map(|share| sweep.label(share)), [first, middle, last], "{text}");
        }
        for bad in [
            "",
            "a",
            "a=1",
            "a=1..",
            "a=..1",
            "=1..2",
            "a//b=1..2",
            "a=1..x",
            "a=[1,2]..3",
            "a=[1,2]..[3]",
            "a=nan..1",
            "a=1..inf",
        ] {
            assert!(sweep(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn published_edits_change_what_the_paper_says_and_nothing_else() {
        let edits = published([32, 32]);
        assert_eq!(
            edits.iter().map(|edit| edit.name.as_str()).collect::<Vec<_>>(),
            ["cone-roughness", "cylinder-metallic", "cube-color"]
        );
        let ends = |edit: &Edit| [0, 4].map(|step| edit.at(step, 5).expect("a scene"));
        let values = |scene: &Scene| {
            let m = &scene.materials[1];
            (m.base_color, m.metallic, m.roughness, m.specular)
        };
        let [cone, cylinder, cube] = [0, 1, 2].map(|i| ends(&edits[i]));
        assert_eq!(
            [&cone[0], &cone[1]].map(|scene| {
                let (_, m, r, s) = values(scene);
                [m, r, s]
            }),
            [[0.5, 1.0, 0.5], [0.5, 0.0, 0.5]]
        );
        assert_eq!(
            [&cylinder[0], &cylinder[1]].map(|scene| {
                let (_, m, r, s) = values(scene);
                [m, r, s]
            }),
            [[0.0, 0.5, 0.5], [1.0, 0.5, 0.5]]
        );
        assert_eq!([&cube[0], &cube[1]].map(values), [([0.0, 0.0, 1.0], 0.5, 0.5, 0.5), ([0.0, 1.0, 0.0], 0.5, 0.5, 0.5)]);
        for [first, last] in [&cone, &cylinder, &cube] {
            let mut same = last.clone();
            same.materials[1] = first.materials[1].clone();
            assert_eq!(&same, first);
        }
    }

    #[test]
    fn a_sweep_that_leaves_its_range_is_named() {
        let mut edit = published([32, 32]).remove(0);
        edit.sweeps = vec!["materials/1/roughness=0..2".parse().expect("a sweep")];
        assert!(edit.at(0, 3).is_ok());
        let said = format!("{:#}", edit.at(2, 3).expect_err("roughness 2"));
        assert!(said.contains("sweep at roughness 2") && said.contains("/materials/1/roughness"), "{said}");
        edit.sweeps = vec!["materials/1/roughnes=0..1".parse().expect("a sweep")];
        assert!(format!("{:#}", edit.at(0, 3).expect_err("no such name")).contains("roughnes"));
    }
}
