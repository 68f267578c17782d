//! What moves in a glTF file, and its cameras.

use super::access::Buffers;
use super::curve::{Accessors, Curve, Weights};
use super::tree::{self, Local, Node};
use super::{document, label};
use crate::description::{Animation, NameOrNumber};
use crate::error::{Error, Result};
use glam::{DAffine3, DVec3};
use gltf::Document;
use gltf::animation::Property;
use gltf::json::camera::Type;
use gltf::json::validation::Checked;
use renderflow_frame::file;
use renderflow_frame::reach::Reach;
use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::rc::Rc;

/// A camera on a node of the file's scene.
pub(crate) struct Camera {
    pub name: Option<String>,
    /// Place of its node in the tree.
    node: usize,
    /// `None` for an orthographic one.
    pub lens: Option<Lens>,
}

/// A perspective projection.
#[derive(Clone, Copy)]
pub(crate) struct Lens {
    /// Vertical field of view, radians.
    pub yfov: f64,
    /// Width over height of the picture that it was made for.
    pub aspect: Option<f64>,
}

/// The node tree of a file's scene, its cameras, and an animation of it where one is played.
pub(crate) struct Rig {
    nodes: Vec<Node>,
    pub cameras: Vec<Camera>,
    /// Names of the file's animations.
    pub clips: Vec<Option<String>>,
    tracks: Vec<Track>,
    /// What moves the weights of morph targets, by the place of the node.
    weights: HashMap<usize, Rc<Weights>>,
    /// Seconds of the animation.
    pub length: f64,
    /// What of the animation is not played, one sentence each.
    pub notes: Vec<String>,
}

/// What a curve moves.
struct Track {
    /// Place of the node in the tree.
    node: usize,
    property: Property,
    curve: Rc<Curve>,
}

/// Names and numbers of the cameras on the nodes of the file's scene.
pub(super) fn cameras(document: &Document, nodes: &[Node]) -> Vec<Camera> {
    let all: Vec<gltf::Node> = document.nodes().collect();
    let json = document.as_json();
    let found = nodes.iter().enumerate().filter_map(|(place, node)| {
        let json_camera = json.cameras.get(json.nodes.get(node.index)?.camera?.value())?;
        let name = all.get(node.index)?.name().or(json_camera.name.as_deref()).map(str::to_owned);
        let perspective = json_camera.perspective.as_ref().filter(|_| json_camera.type_ == Checked::Valid(Type::Perspective));
        let lens = perspective.map(|p| Lens { yfov: f64::from(p.yfov), aspect: p.aspect_ratio.map(f64::from) });
        Some(Camera { name, node: place, lens })
    });
    found.collect()
}

/// Number of morph targets of the mesh of a node; its primitives all have as many (glTF 2.0, section 3.7.2.2).
fn targets(document: &Document, node: usize) -> usize {
    let mesh = document.nodes().nth(node).and_then(|node| node.mesh());
    mesh.and_then(|mesh| Some(mesh.primitives().next()?.morph_targets().count())).unwrap_or(0)
}

/// Reads the tree and the cameras of a file, and the animation that is asked for.
pub(crate) fn read(path: &Path, reach: &Reach, animation: Option<&Animation>) -> Result<Rig> {
    let bytes = file::read(path)?;
    let (document, blob) = document::parse(path, &bytes)?;
    drop(bytes);
    let nodes = tree::nodes(path, &document)?;
    let cameras = cameras(&document, &nodes);
    let clips = document.animations().map(|a| a.name().map(str::to_owned)).collect();
    let mut rig = Rig { nodes, cameras, clips, tracks: vec![], weights: HashMap::new(), length: 0.0, notes: vec![] };
    if let Some(animation) = animation {
        let index = clip(path, &document, animation.clip.as_ref())?;
        let buffers = Buffers::read(path, reach, &document, blob)?;
        tree::add_instances(path, &document, &buffers, &mut rig.nodes)?;
        rig.play(path, &document, &buffers, index)?;
    }
    Ok(rig)
}

/// The number of the animation that is asked for.
fn clip(path: &Path, document: &Document, choice: Option<&NameOrNumber>) -> Result<usize> {
    let names = document.animations().map(|a| a.name());
    let choice = choice.cloned().unwrap_or(NameOrNumber::Number(0));
    choice.find(names.clone()).ok_or_else(|| {
        let known = label::list(names);
        let reason = match (known.is_empty(), &choice) {
            (true, _) => "the file has no animation".to_owned(),
            (false, NameOrNumber::Number(number)) => format!("there is no animation {number}; there are {known}"),
            (false, name) => format!("no animation is named {name}; there are {known}"),
        };
        Error::model(path, "", reason)
    })
}

impl Rig {
    fn play(&mut self, path: &Path, document: &Document, buffers: &Buffers, index: usize) -> Result<()> {
        let animation = &document.as_json().animations[index];
        let own = self.nodes.iter().enumerate().filter(|(_, node)| !node.instance);
        let places: HashMap<usize, usize> = own.map(|(place, node)| (node.index, place)).collect();
        let accessors = Accessors { path, buffers, all: document.accessors().collect() };
        let (mut curves, mut moved) = (HashMap::new(), HashSet::new());
        for (number, channel) in animation.channels.iter().enumerate() {
            let place = format!("/animations/{index}/channels/{number}/target");
            let node = channel.target.node.value();
            let Checked::Valid(property) = channel.target.path else {
                return Err(Error::model(path, format!("{place}/path"), "not one of the values allowed here"));
            };
            if node >= document.as_json().nodes.len() {
                return Err(Error::model(path, format!("{place}/node"), format!("there is nothing with the index {node}")));
            }
            if !moved.insert((node, property as u8)) {
                return Err(Error::model(path, place, "another channel moves the same property of the node"));
            }
            // A node of another scene is not shown.
            let Some(&node) = places.get(&node) else { continue };
            let sampler = channel.sampler.value();
            let read_from = format!("/animations/{index}/samplers/{sampler}");
            let Some(json) = animation.samplers.get(sampler) else {
                return Err(Error::model(path, read_from, "is missing"));
            };
            if property == Property::MorphTargetWeights {
                let targets = targets(document, self.nodes[node].index);
                if targets > 0 {
                    let weights = accessors.weights(json, &read_from, targets)?;
                    self.length = self.length.max(weights.end());
                    self.weights.insert(node, Rc::new(weights));
                }
                continue;
            }
            if matches!(self.nodes[node].local, Local::Matrix(_)) {
                let reason = format!("node {} has a matrix, which no animation moves", self.nodes[node].index);
                return Err(Error::model(path, place, reason));
            }
            let quaternions = property == Property::Rotation;
            let curve = match curves.get(&(sampler, quaternions)) {
                Some(known) => Rc::clone(known),
                None => {
                    let read = Rc::new(accessors.curve(json, &read_from, quaternions)?);
                    curves.insert((sampler, quaternions), Rc::clone(&read));
                    read
                }
            };
            self.length = self.length.max(curve.end());
            self.tracks.push(Track { node, property, curve });
        }
        if self.tracks.is_empty() && self.weights.is_empty() {
            let name = label::of(index, animation.name.as_deref());
            self.notes.push(format!("the animation {name} moves no node of the file's scene"));
        }
        Ok(())
    }

    /// Number of nodes.
    pub(crate) fn nodes(&self) -> usize {
        self.nodes.len()
    }

    /// Node to model space of every node, at a second of the animation.
    pub(crate) fn pose(&self, seconds: f64) -> Vec<DAffine3> {
        let mut locals: Vec<Local> = self.nodes.iter().map(|node| node.local).collect();
        for Track { node, property, curve } in &self.tracks {
            let Local::Parts(parts) = &mut locals[*node] else { continue };
            match property {
                Property::Translation => parts.translation = curve.vector(seconds).truncate(),
                Property::Scale => parts.scale = curve.vector(seconds).truncate(),
                Property::Rotation => parts.rotation = curve.rotation(seconds),
                Property::MorphTargetWeights => {}
            }
        }
        let mut world: Vec<DAffine3> = Vec::with_capacity(locals.len());
        for (node, local) in self.nodes.iter().zip(&locals) {
            let parent = node.parent.map_or(DAffine3::IDENTITY, |parent| world[parent]);
            world.push(parent * local.affine());
        }
        world
    }

    /// Weights of the morph targets of the node at `place` (of an instance, those of its node) at a second of the animation,
    /// where it moves them.
    pub(crate) fn weights(&self, place: usize, seconds: f64) -> Option<Vec<f32>> {
        let node = self.nodes.get(place).filter(|node| node.instance).and_then(|node| node.parent);
        self.weights.get(&node.unwrap_or(place)).map(|weights| weights.at(seconds))
    }

    /// Where a camera of the file is in [`Self::pose`]: its position, the direction of its view, and what is up in its picture;
    /// the last two of any length.
    pub(crate) fn view(&self, camera: &Camera, pose: &[DAffine3], to_world: DAffine3) -> [DVec3; 3] {
        let transform = to_world * pose[camera.node];
        [transform.translation, transform.transform_vector3(DVec3::NEG_Z), transform.transform_vector3(DVec3::Y)]
    }
}
