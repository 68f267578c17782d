//! Validation of a [`Scene`]: ranges, names and references. Every violation is reported, not only the first.

mod light;

use crate::Principled;
use crate::description::{Animation, CameraFrame, CameraPath, EnvironmentSource, Geometry, Motion, Scene, Transform, same_shape};
use crate::error::{Error, Problem, Result};
use crate::model_format::Format;
use renderflow_frame::Distortion;
use std::collections::HashMap;
use std::fmt::Display;
use std::ops::RangeInclusive;

/// Format version written and read.
pub const VERSION: u32 = 1;
/// Most pixels along an edge.
pub const MAX_RESOLUTION: u32 = 16384;
/// Most frames of a sequence.
pub const MAX_FRAMES: u32 = 100_000;
/// Largest coordinate, metres: double precision is a tenth of a micrometre fine there, and what is near the camera keeps it.
pub const MAX_COORDINATE: f64 = 1e9;
/// Smallest distance of a camera from its target.
pub const MIN_DISTANCE: f64 = 1e-9;
/// Smallest size of a scale factor.
pub const MIN_SIZE: f32 = 1e-9;
/// Largest size of a scale factor.
pub const MAX_SIZE: f32 = 1e9;
/// Largest radiance that a material emits.
pub const MAX_EMISSION: f32 = 1e6;
/// Largest offset or number of repetitions of a texture.
pub const MAX_REPEAT: f32 = 1e6;
/// Largest height of a bounce and radius of a circle, metres, and longest bounce, frames.
pub const MAX_PATH: f32 = 1e6;
/// Smallest focal length, pixels.
pub const MIN_FOCAL: f64 = 1e-3;
/// Largest distance of a principal point from the corner of the picture, pixels.
pub const MAX_CENTRE: f64 = 1e6;
/// Largest coefficient of lens distortion.
pub const MAX_COEFFICIENT: f64 = 1e3;
/// Least frames in a second of an animation.
pub const MIN_RATE: f64 = 1e-3;
/// Most frames in a second of an animation, and its latest start, seconds.
pub const MAX_RATE: f64 = 1e6;
/// Largest radiance, gain or angle taken from a file (half floats end at 65504; this leaves room for the sun).
pub const MAX_VALUE: f32 = 1e9;

impl Scene {
    /// Checks ranges, references and uniqueness of names; finite values too, for scenes built in memory.
    ///
    /// # Errors
    /// [`Error::Invalid`] with every violation and its JSON pointer.
    pub fn validate(&self) -> Result<()> {
        let mut check = Check::default();
        check.scene(self);
        if check.problems.is_empty() { Ok(()) } else { Err(Error::Invalid { file: None, problems: check.problems }) }
    }
}

#[derive(Default)]
struct Check {
    problems: Vec<Problem>,
}

impl Check {
    fn say(&mut self, pointer: impl Into<String>, reason: impl Into<String>) {
        self.problems.push(Problem { pointer: pointer.into(), reason: reason.into() });
    }

    /// `NaN` is in no range, so this is the check for finite values too.
    fn range<T: PartialOrd + Display>(&mut self, pointer: impl Into<String>, value: T, range: RangeInclusive<T>) {
        if !range.contains(&value) {
            self.say(pointer, format!("{value} is outside {}..={}", range.start(), range.end()));
        }
    }

    fn vector<T: PartialOrd + Display + Clone, const N: usize>(
        &mut self,
        pointer: &str,
        value: [T; N],
        range: RangeInclusive<T>,
    ) {
        for (i, v) in value.into_iter().enumerate() {
            self.range(format!("{pointer}/{i}"), v, range.clone());
        }
    }

    fn position(&mut self, pointer: &str, value: [f64; 3]) {
        self.vector(pointer, value, -MAX_COORDINATE..=MAX_COORDINATE);
    }

    fn angle(&mut self, pointer: impl Into<String>, degrees: f32) {
        self.range(pointer, degrees, -MAX_VALUE..=MAX_VALUE);
    }

    fn name(&mut self, pointer: String, name: &str) {
        if name.trim().is_empty() {
            self.say(pointer, "is empty");
        } else if name.chars().any(char::is_control) {
            self.say(pointer, "contains a control character");
        }
    }

    fn path(&mut self, pointer: String, path: &str) {
        if path.trim().is_empty() {
            self.say(pointer, "is an empty path");
        } else if path.contains('\0') {
            self.say(pointer, "contains a NUL character");
        }
    }

    fn unique<'a>(&mut self, list: &str, names: impl Iterator<Item = &'a str>) {
        let mut seen = HashMap::new();
        for (i, name) in names.enumerate() {
            if let Some(first) = seen.insert(name, i) {
                self.say(format!("/{list}/{i}/name"), format!("{name:?} is the name of /{list}/{first} too"));
                seen.insert(name, first);
            }
        }
    }

    fn scene(&mut self, scene: &Scene) {
        if scene.version != VERSION {
            self.say("/version", format!("{} is not a version this program reads (it reads {VERSION})", scene.version));
        }
        self.name("/name".into(), &scene.name);
        for (i, edge) in scene.resolution.into_iter().enumerate() {
            if !(1..=MAX_RESOLUTION).contains(&edge) {
                self.say(format!("/resolution/{i}"), format!("{edge} is outside 1..={MAX_RESOLUTION}"));
            }
        }
        if !(1..=MAX_FRAMES).contains(&scene.frames) {
            self.say("/frames", format!("{} is outside 1..={MAX_FRAMES}", scene.frames));
        }
        self.camera(&scene.camera, scene.resolution);
        self.environment(scene);
        self.materials(scene);
        self.objects(scene);
        self.lights(scene);
    }

    fn camera(&mut self, camera: &CameraPath, resolution: [u32; 2]) {
        let fov = match camera {
            CameraPath::Orbit { target, distance, elevation, azimuth, degrees_per_frame, vertical_fov } => {
                self.position("/camera/target", *target);
                self.range("/camera/distance", *distance, MIN_DISTANCE..=MAX_COORDINATE);
                self.range("/camera/elevation", *elevation, -89.0..=89.0);
                self.angle("/camera/azimuth", *azimuth);
                self.angle("/camera/degrees_per_frame", *degrees_per_frame);
                vertical_fov
            }
            CameraPath::Poses { poses, vertical_fov } => {
                if poses.is_empty() {
                    self.say("/camera/poses", "is empty; at least one pose is needed");
                }
                for (i, pose) in poses.iter().enumerate() {
                    self.position(&format!("/camera/poses/{i}/eye"), pose.eye);
                    self.position(&format!("/camera/poses/{i}/target"), pose.target);
                    self.vector(&format!("/camera/poses/{i}/up"), pose.up, -MAX_SIZE..=MAX_SIZE);
                    if pose.eye == pose.target {
                        self.say(format!("/camera/poses/{i}/target"), "is the same point as eye");
                    }
                    if pose.up == [0.0; 3] {
                        self.say(format!("/camera/poses/{i}/up"), "has no direction");
                    }
                }
                vertical_fov
            }
            CameraPath::Frames { size, frames } => return self.frames(*size, frames, resolution),
        };
        self.range("/camera/vertical_fov", *fov, 1.0..=170.0);
    }

    fn frames(&mut self, size: [u32; 2], frames: &[CameraFrame], resolution: [u32; 2]) {
        let before = self.problems.len();
        for (i, edge) in size.into_iter().enumerate() {
            self.range(format!("/camera/size/{i}"), edge, 1..=MAX_RESOLUTION);
        }
        if self.problems.len() == before && !same_shape(resolution, size) {
            let [[w, h], [sw, sh]] = [resolution, size];
            self.say("/resolution", format!("{w} x {h} has not the shape of the {sw} x {sh} pixels of the cameras"));
        }
        if frames.is_empty() || frames.len() > MAX_FRAMES as usize {
            self.say("/camera/frames", format!("has {} cameras; 1 to {MAX_FRAMES} are needed", frames.len()));
            return;
        }
        for (i, frame) in frames.iter().enumerate() {
            let at = |field: &str| format!("/camera/frames/{i}/{field}");
            for (row, numbers) in frame.camera_to_world.iter().enumerate() {
                self.range(at(&format!("camera_to_world/{row}/3")), numbers[3], -MAX_COORDINATE..=MAX_COORDINATE);
            }
            let axes = frame.rotation();
            if !((axes.transpose() * axes).abs_diff_eq(glam::DMat3::IDENTITY, 1e-3) && axes.determinant() > 0.0) {
                self.say(at("camera_to_world"), "is not a rotation and a translation");
            }
            self.range(at("fl_x"), frame.fl_x, MIN_FOCAL..=f64::from(MAX_VALUE));
            self.range(at("fl_y"), frame.fl_y, MIN_FOCAL..=f64::from(MAX_VALUE));
            self.range(at("cx"), frame.cx, -MAX_CENTRE..=MAX_CENTRE);
            self.range(at("cy"), frame.cy, -MAX_CENTRE..=MAX_CENTRE);
            let before = self.problems.len();
            if let Some(lens) = &frame.distortion {
                for (name, value) in Distortion::NAMES.into_iter().zip(lens.coefficients()) {
                    self.range(at(&format!("distortion/{name}")), value, -MAX_COEFFICIENT..=MAX_COEFFICIENT);
                }
            }
            if self.problems.len() == before
                && let Some(reason) = frame.folds(size)
            {
                self.say(at("distortion"), reason);
            }
        }
    }

    fn environment(&mut self, scene: &Scene) {
        let light = &scene.environment;
        self.angle("/environment/rotation", light.rotation);
        self.range("/environment/intensity", light.intensity, 0.0..=MAX_VALUE);
        match &light.source {
            EnvironmentSource::File(path) => self.path("/environment/source/file".into(), path),
            EnvironmentSource::Builtin(name) => {
                if !crate::sky::names().contains(&name.as_str()) {
                    let known = crate::sky::names().join(", ");
                    self.say("/environment/source/builtin", format!("no environment is named {name:?}; there are {known}"));
                }
            }
            EnvironmentSource::Sky(sky) => self.parameters("/environment/source/sky", sky.validate()),
            EnvironmentSource::Constant(radiance) => self.vector("/environment/source/constant", *radiance, 0.0..=MAX_VALUE),
        }
    }

    fn materials(&mut self, scene: &Scene) {
        self.unique("materials", scene.materials.iter().map(|m| m.name.as_str()));
        for (i, material) in scene.materials.iter().enumerate() {
            let at = |field: &str| format!("/materials/{i}/{field}");
            self.name(at("name"), &material.name);
            Principled::from(material).for_each(|field, value| self.range(at(field), value, 0.0..=1.0));
            self.range(at("alpha_cutoff"), material.alpha_cutoff.unwrap_or(0.0), 0.0..=1.0);
            self.range(at("opacity"), material.opacity.unwrap_or(0.0), 0.0..=1.0);
            if material.opacity.is_some() && material.alpha_cutoff.is_some() {
                self.say(at("opacity"), "cannot be used together with alpha_cutoff");
            }
            self.vector(&at("attenuation_color"), material.attenuation_color, 1e-6..=1.0);
            self.range(at("attenuation_distance"), material.attenuation_distance, MIN_SIZE..=MAX_SIZE);
            self.vector(&at("emissive"), material.emissive, 0.0..=MAX_EMISSION);
            if let Some(change) = &material.change {
                if let Some(color) = change.base_color {
                    self.vector(&at("change/base_color"), color, 0.0..=1.0);
                }
                let targets = [("metallic", change.metallic), ("roughness", change.roughness), ("specular", change.specular)];
                for (field, value) in targets {
                    self.range(at(&format!("change/{field}")), value.unwrap_or(0.0), 0.0..=1.0);
                }
            }
            let lie = &material.texture_transform;
            self.vector(&at("texture_transform/offset"), lie.offset, -MAX_REPEAT..=MAX_REPEAT);
            self.angle(at("texture_transform/rotation"), lie.rotation);
            self.vector(&at("texture_transform/scale"), lie.scale, -MAX_REPEAT..=MAX_REPEAT);
            for (field, texture) in [
                ("base_color_texture", &material.base_color_texture),
                ("metallic_roughness_texture", &material.metallic_roughness_texture),
                ("normal_texture", &material.normal_texture),
                ("emissive_texture", &material.emissive_texture),
            ] {
                if let Some(path) = texture {
                    self.path(at(field), path);
                    if material.pattern.is_some() && field != "emissive_texture" {
                        self.say(at(field), "cannot be used together with a pattern, which makes this texture itself");
                    }
                }
            }
            if let Some(pattern) = &material.pattern {
                self.parameters(&at("pattern"), pattern.validate());
            }
        }
    }

    fn objects(&mut self, scene: &Scene) {
        self.unique("objects", scene.objects.iter().map(|o| o.name.as_str()));
        for (i, object) in scene.objects.iter().enumerate() {
            let at = |field: &str| format!("/objects/{i}/{field}");
            self.name(at("name"), &object.name);
            match &object.geometry {
                Geometry::File(path) => {
                    self.path(at("geometry/file"), path);
                    // Without an ending the content decides, once it is read.
                    let named = std::path::Path::new(path).extension().is_some();
                    if named && Format::of(path).is_none() {
                        self.say(at("geometry/file"), format!("{path:?} is not a .gltf, .glb, .obj or .ply file"));
                    }
                }
                Geometry::Shape(shape) => self.parameters(&at("geometry/shape"), shape.validate()),
            }
            if let Some(name) = &object.material
                && !scene.materials.iter().any(|m| m.name == *name)
            {
                self.say(at("material"), format!("no material is named {name:?}"));
            }
            self.transform(&at("transform"), &object.transform);
            if let Some(motion) = &object.motion {
                self.motion(&at("motion"), motion, scene.frames);
            }
            if let Some(animation) = &object.animation {
                self.animation(&at("animation"), animation, &object.geometry);
            }
        }
    }

    fn motion(&mut self, pointer: &str, motion: &Motion, frames: u32) {
        let at = |field: &str| format!("{pointer}/{field}");
        let furthest = MAX_COORDINATE / f64::from(frames.max(1));
        self.vector(&at("translation"), motion.translation, -furthest..=furthest);
        self.angle(at("spin"), motion.spin);
        if let Some(bounce) = &motion.bounce {
            self.range(at("bounce/height"), bounce.height, 0.0..=MAX_PATH);
            self.range(at("bounce/frames"), bounce.frames, 1.0..=MAX_PATH);
        }
        if let Some(circle) = &motion.circle {
            self.vector(&at("circle/center"), circle.center, -MAX_PATH..=MAX_PATH);
            self.angle(at("circle/degrees"), circle.degrees);
        }
    }

    fn animation(&mut self, pointer: &str, animation: &Animation, geometry: &Geometry) {
        // Without an ending the content decides, once it is read.
        let rigid = match geometry {
            Geometry::Shape(_) => true,
            Geometry::File(path) => matches!(Format::of(path), Some(Format::Obj | Format::Ply)),
        };
        if rigid {
            self.say(pointer, "only a glTF file has animations");
        }
        self.range(format!("{pointer}/frames_per_second"), animation.frames_per_second, MIN_RATE..=MAX_RATE);
        self.range(format!("{pointer}/start"), animation.start, 0.0..=MAX_RATE);
    }

    fn transform(&mut self, pointer: &str, transform: &Transform) {
        self.position(&format!("{pointer}/translation"), transform.translation);
        for (i, degrees) in transform.rotation.into_iter().enumerate() {
            self.angle(format!("{pointer}/rotation/{i}"), degrees);
        }
        for (i, factor) in transform.scale.into_iter().enumerate() {
            if !(MIN_SIZE..=MAX_SIZE).contains(&factor.abs()) {
                let reason = format!("{factor} is outside {MIN_SIZE}..={MAX_SIZE} in size");
                self.say(format!("{pointer}/scale/{i}"), reason);
            }
        }
    }

    /// What a shape, a sky or a pattern says about its own parameters: pointers below it, and reasons.
    fn parameters(&mut self, pointer: &str, problems: Vec<(String, String)>) {
        for (below, reason) in problems {
            self.say(format!("{pointer}/{}", below.trim_start_matches('/')), reason);
        }
    }
}
