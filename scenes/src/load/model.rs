//! Model files: what glTF, OBJ and PLY have in common, and a scene around a single model.

use super::deform::Deformer;
use super::gltf::lights::Light;
use super::gltf::rig::Rig;
use crate::description::{
    Animation, CameraPath, EnvironmentLight, EnvironmentSource, Geometry, Material as Described, Object, Scene, Transform,
    decimal,
};
use crate::error::{Error, Result};
use crate::model_format::Format;
use crate::shapes::Shape;
use crate::texture::Budget;
use crate::validate::{MAX_COORDINATE, MAX_SIZE, MIN_SIZE};
use crate::{LoadReport, Material, Mesh, Texture, TriangleReport};
use glam::{DAffine3, DVec3};
use renderflow_frame::reach::Reach;
use renderflow_frame::words::{number, shortened};
use std::path::Path;
use std::rc::Rc;

/// A mesh of a model, placed in the model's own space.
pub(crate) struct Part {
    pub name: String,
    /// Index into [`Model::meshes`].
    pub mesh: usize,
    /// Index into [`Model::materials`]; `None` = the default material.
    pub material: Option<usize>,
    /// Mesh space to model space, as the model rests. Where a skin moves its vertices, it is the same in every frame.
    pub transform: DAffine3,
    /// Place of its node in a glTF file's tree.
    pub node: usize,
    /// What moves its vertices against each other; only where the model was read to be animated.
    pub deformer: Option<Rc<Deformer>>,
}

impl Part {
    /// Place of the node that moves it as a whole; `None` where a skin does.
    pub(super) fn moving_node(&self) -> Option<usize> {
        let skinned = self.deformer.as_ref().is_some_and(|deformer| deformer.skin.is_some());
        (!skinned).then_some(self.node)
    }

    /// What is done to the vertices of a part that deforms before a node moves it.
    pub(super) fn deformed_from(&self) -> DAffine3 {
        if self.moving_node().is_some() { DAffine3::IDENTITY } else { self.transform }
    }
}

/// A model file as read, before repairs.
#[derive(Default)]
pub(crate) struct Model {
    pub meshes: Vec<Mesh>,
    pub parts: Vec<Part>,
    /// Empty when materials were not asked for.
    pub materials: Vec<Material>,
    pub textures: Vec<Texture>,
    pub report: LoadReport,
    /// Where the first vertex that does not exist is asked for, where the reader left its triangles out.
    pub missing_vertex: Option<String>,
    /// Lights on its nodes.
    pub lights: Vec<Light>,
    /// Names of the cameras in it.
    pub cameras: Vec<String>,
    /// Names of its animations.
    pub animations: Vec<String>,
    /// Where the first coordinate that is not finite stands, where the reader can say.
    pub not_finite: Option<String>,
}

/// Reads a model file, whose names lead where `reach` says; materials and textures only within a budget for the latter. What only
/// an animation needs comes with it where the model is to be `animated`: parts that are flattened as they rest, and what moves
/// vertices.
pub(crate) fn read(path: &Path, reach: &Reach, textures: Option<&Budget>, animated: bool) -> Result<Model> {
    match Format::of_file(path)? {
        Some(Format::Gltf) => super::gltf::read(path, reach, textures, animated),
        Some(Format::Obj) => super::obj::read(path, reach, textures),
        Some(Format::Ply) => super::ply::read(path, textures.is_some()),
        None => Err(Error::model(path, "", "neither glTF, nor OBJ, nor PLY")),
    }
}

/// The node tree of a model file, with the animation that is asked for.
pub(super) fn rig(path: &Path, reach: &Reach, animation: Option<&Animation>) -> Result<Rig> {
    match Format::of_file(path)? {
        Some(Format::Gltf) => super::gltf::rig::read(path, reach, animation),
        _ => Err(Error::model(path, "", "only a glTF file has animations")),
    }
}

/// How a single model is shown.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelView {
    /// Image size in pixels, width then height.
    pub resolution: [u32; 2],
    /// Frames of the sequence.
    pub frames: u32,
    /// Degrees the camera turns from a frame to the next.
    pub degrees_per_frame: f32,
    /// Degrees about +Y at frame 0; 0 = camera on the +Z side.
    pub azimuth: f32,
    /// Seed of the sequence.
    pub seed: u64,
    /// Light where no environment file is given.
    pub environment: EnvironmentSource,
    /// Put a grey ground plane under the model? A model that has a floor of its own at that height gets none: where triangles at
    /// its lowest height that can be seen from above cover half of the rectangle it stands on.
    pub ground: bool,
    /// An animation of the file that the model plays; without it, it rests.
    pub animation: Option<Animation>,
}

impl Default for ModelView {
    fn default() -> Self {
        Self {
            resolution: [256, 256],
            frames: 17,
            degrees_per_frame: 3.6,
            azimuth: 30.0,
            seed: 0,
            environment: EnvironmentSource::Builtin("clear_afternoon".into()),
            ground: true,
            animation: None,
        }
    }
}

/// Degrees above the horizon of the camera around a single model.
const ELEVATION: f32 = 20.0;
/// Its vertical field of view, degrees.
const FIELD_OF_VIEW: f32 = 40.0;
/// Edge of the ground plane in radii of the model's bounding sphere: far enough that its corners are lost near the horizon.
const GROUND_EDGE: f32 = 60.0;
/// Space left around the bounding sphere in the picture.
const MARGIN: f32 = 1.1;

/// A scene around the model file `model`: scaled to a bounding sphere of 1 metre radius, resting on a grey ground plane,
/// an orbiting camera that sees all of it, lit by the map `environment` or else by `view.environment`.
///
/// The paths in the scene are absolute, so it can be saved in any folder. `reach` says which files the model may name.
///
/// # Errors
/// When the model cannot be read or has no triangle that can be rendered; the message says why its triangles cannot.
pub fn describe_model(model: &Path, environment: Option<&Path>, view: &ModelView, reach: &Reach) -> Result<Scene> {
    let (geometry, (center, radius, lowest)) = bounds(model, reach, view.animation.as_ref())?;
    let factor = (1.0 / radius) as f32;
    // The centre of the sphere above the origin, the lowest vertex in the plane y = 0. With the factor as the scene has it: far
    // out, its rounding would show.
    let scale = f64::from(factor);
    let height = (center.y - lowest) * scale;
    let moved = DVec3::new(-center.x * scale, -lowest * scale, -center.z * scale);
    let name = model.file_stem().map_or_else(|| "model".into(), |s| s.to_string_lossy().into_owned());
    let absolute = |path: &Path| -> Result<String> {
        Ok(std::path::absolute(path).map_err(Error::io(path, "find"))?.to_string_lossy().into_owned())
    };
    // The sphere fits the narrower direction of the picture.
    let aspect = (view.resolution[0] as f32 / view.resolution[1].max(1) as f32).min(1.0);
    let half_angle = ((0.5 * FIELD_OF_VIEW).to_radians().tan() * aspect).atan();
    let mut objects = vec![Object {
        name: name.clone(),
        geometry: Geometry::File(absolute(model)?),
        material: None,
        transform: Transform { translation: moved.to_array(), scale: [factor; 3], ..Transform::default() },
        motion: None,
        animation: view.animation.clone(),
    }];
    let mut materials = vec![];
    let own_floor = if view.ground { super::floor::share(&geometry, lowest, radius) } else { 1.0 };
    if own_floor < super::floor::SHARE {
        // Out of the way of what lies flat at the lowest height.
        let below = if own_floor > 0.0 { -super::floor::THICKNESS } else { 0.0 };
        materials.push(Described { name: "ground".into(), base_color: [0.5; 3], roughness: 0.6, ..Described::default() });
        objects.push(Object {
            name: if name == "ground" { "ground plane".into() } else { "ground".into() },
            geometry: Geometry::Shape(Shape::Plane { size: GROUND_EDGE }),
            material: Some("ground".into()),
            transform: Transform { translation: [0.0, below, 0.0], ..Transform::default() },
            motion: None,
            animation: None,
        });
    }
    let source = match environment {
        Some(path) => EnvironmentSource::File(absolute(path)?),
        None => view.environment.clone(),
    };
    let scene = Scene {
        version: crate::validate::VERSION,
        name,
        seed: view.seed,
        resolution: view.resolution,
        frames: view.frames,
        camera: CameraPath::Orbit {
            target: [0.0, height, 0.0],
            distance: decimal(MARGIN / half_angle.sin()),
            elevation: ELEVATION,
            azimuth: view.azimuth,
            degrees_per_frame: view.degrees_per_frame,
            vertical_fov: FIELD_OF_VIEW,
        },
        environment: EnvironmentLight { source, rotation: 0.0, intensity: 1.0 },
        materials,
        objects,
        lights: vec![],
    };
    scene.validate()?;
    Ok(scene)
}

/// A model file's box, metres, and the radius of the upright cylinder about the box's middle that contains the model.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Extent {
    pub low: DVec3,
    pub high: DVec3,
    pub radius: f64,
}

/// The room that a model file takes up.
pub(crate) fn extent(path: &Path, reach: &Reach) -> Result<Extent> {
    // What is left out of the model is not rendered either, and may name vertices that do not exist.
    let (model, _) = bounds(path, reach, None)?;
    let corners = || {
        model.parts.iter().flat_map(|part| {
            let mesh = &model.meshes[part.mesh];
            mesh.triangles.iter().flatten().map(move |&i| part.transform.transform_point3(mesh.positions[i as usize].as_dvec3()))
        })
    };
    let (low, high) = corners().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
    let middle = 0.5 * (low + high);
    let radius = corners().map(|p| (p.x - middle.x).hypot(p.z - middle.z)).fold(0.0, f64::max);
    Ok(Extent { low, high, radius })
}

/// Moments of an animation at which the room that it takes is measured.
const MOMENTS: u32 = 32;

/// A model file without materials, cleaned; centre and radius of a sphere around all its triangles, and the height of its lowest
/// vertex. With an animation, these are of all its moments together.
fn bounds(path: &Path, reach: &Reach, animation: Option<&Animation>) -> Result<(Model, (DVec3, f64, f64))> {
    let rig = animation.map(|animation| rig(path, reach, Some(animation))).transpose()?;
    let mut model = read(path, reach, None, rig.is_some())?;
    let mut dropped = model.report.triangles;
    // What `clean` takes away cannot be told afterwards.
    let first_missing = model.meshes.iter().find_map(missing_vertex);
    for mesh in &mut model.meshes {
        dropped += super::mesh::clean(mesh);
    }
    let each_corner = |visit: &mut dyn FnMut(DVec3)| {
        let moments = if rig.is_some() { MOMENTS } else { 0 };
        for moment in 0..=moments {
            let pose = rig.as_ref().map(|rig| {
                let second = rig.length * f64::from(moment) / f64::from(MOMENTS);
                (rig, second, rig.pose(second))
            });
            for part in &model.parts {
                let (pose, node) = (pose.as_ref(), part.moving_node());
                let transform = pose.zip(node).map_or(part.transform, |((.., pose), node)| pose[node]);
                let mesh = &model.meshes[part.mesh];
                let posed = pose.zip(part.deformer.as_ref());
                let posed = posed.map(|((rig, second, pose), deformer)| deformer.positions(rig, part.node, pose, *second));
                let positions = posed.as_ref().unwrap_or(&mesh.positions);
                let used = mesh.triangles.iter().flatten();
                used.for_each(|&i| visit(transform.transform_point3(positions[i as usize].as_dvec3())));
            }
        }
    };
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    each_corner(&mut |p| (low, high) = (low.min(p), high.max(p)));
    if low.x > high.x {
        model.missing_vertex = model.missing_vertex.take().or(first_missing);
        return Err(Error::model(path, "", nothing_to_render(&model, dropped)));
    }
    let center = 0.5 * low + 0.5 * high;
    let mut radius = 0.0_f64;
    each_corner(&mut |p| radius = radius.max(p.distance(center)));
    let sizes = f64::from(MIN_SIZE)..=f64::from(MAX_SIZE);
    if !(center.is_finite() && sizes.contains(&radius) && center.abs().max_element() <= MAX_COORDINATE * radius) {
        let corner = |v: DVec3| format!("({})", v.to_array().map(number).join(", "));
        let reason = format!("the model has no usable size: it reaches from {} to {}", corner(low), corner(high));
        return Err(Error::model(path, "", reason));
    }
    Ok((model, (center, radius, low.y)))
}

/// The first vertex of a mesh that a triangle names and that does not exist.
fn missing_vertex(mesh: &Mesh) -> Option<String> {
    let vertices = mesh.positions.len();
    let place = mesh.triangles.iter().flatten().position(|&i| i as usize >= vertices)?;
    let index = mesh.triangles.as_flattened()[place];
    Some(format!("mesh {:?}: triangle {} names vertex {index}, there are {vertices}", shortened(&mesh.name), place / 3))
}

/// Why no triangle of a model can be rendered, in words.
fn nothing_to_render(model: &Model, dropped: TriangleReport) -> String {
    let because = |reason: String| match model.report.notes.first() {
        Some(note) => format!("{reason} ({note})"),
        None => reason,
    };
    if dropped.dropped() == 0 {
        return because("the model has no triangle to render".into());
    }
    let at = |place: &Option<String>| place.as_ref().map(|place| format!(" ({place})")).unwrap_or_default();
    let causes = [
        (dropped.out_of_range, "a vertex that does not exist", at(&model.missing_vertex)),
        (dropped.not_finite, "a coordinate that is not finite", at(&model.not_finite)),
        (dropped.no_area, "no area", String::new()),
        (dropped.duplicate, "the same corners as another one", String::new()),
    ];
    let causes: Vec<String> = causes
        .iter()
        .filter(|(count, ..)| *count > 0)
        .map(|(count, what, at)| format!("{count} {} {what}{at}", if *count == 1 { "has" } else { "have" }))
        .collect();
    let causes = causes.join(", ");
    match dropped.dropped() {
        1 => format!("the model's only triangle cannot be rendered: {causes}"),
        count => format!("none of the model's {count} triangles can be rendered: {causes}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A face that names a vertex which does not exist is left out, here as in rendering.
    #[test]
    fn the_extent_leaves_out_what_is_not_rendered() {
        let folder = tempfile::tempdir().unwrap();
        let header = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n";
        let vertices = "0 0 0\n2 0 0\n0 3 0\n50 60 70\n";
        let extent_of = |faces: &str, count: usize| {
            let path = folder.path().join("model.ply");
            let faces = format!("element face {count}\nproperty list uchar int vertex_indices\nend_header\n{vertices}{faces}");
            std::fs::write(&path, format!("{header}{faces}")).unwrap();
            extent(&path, &Reach::of(&path)).unwrap()
        };
        let (whole, broken) = (extent_of("3 0 1 2\n", 1), extent_of("3 0 1 2\n3 0 1 99\n", 2));
        for found in [whole, broken] {
            assert_eq!((found.low, found.high), (DVec3::ZERO, DVec3::new(2.0, 3.0, 0.0)));
        }
    }
}
