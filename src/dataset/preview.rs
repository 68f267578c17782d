//! Shows a plan before it is rendered: contact sheets of its meshes, environments and scenes, and counts of its catalogue.

use super::denoise::Denoise;
use super::job::TruthSettings;
use super::plan::Plan;
use crate::util::cancel::Cancel;
use crate::util::output;
use crate::util::picture;
use crate::util::progress::Progress;
use anyhow::{Context, Result, bail};
use glam::Vec3;
use rayon::prelude::*;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::{color, file, hdr, ibl};
use renderflow_renderer::{RenderScene, Settings};
use renderflow_scenes::description::{
    CameraPath, EnvironmentLight, EnvironmentSource, Geometry, Material, Object, Scene, Transform,
};
use renderflow_scenes::shapes::{self, Shape};
use renderflow_scenes::{load, sky};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashSet};
use std::path::Path;

/// Pictures along a side of a sheet.
const SIDE: u32 = 8;

/// File name of [`Inventory`] in the folder of the sheets.
pub const CATALOG: &str = "catalog.json";
/// File names of the sheets.
const SHEETS: [&str; 3] = ["meshes.png", "environments.png", "scenes.png"];

/// What a catalogue holds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Inventory {
    /// Meshes.
    pub meshes: usize,
    /// Distinct meshes, by a hash of positions and triangles.
    pub distinct_meshes: usize,
    /// Meshes that enclose a volume: every edge has two triangles.
    pub watertight: usize,
    /// Triangles of all meshes.
    pub triangles: u64,
    /// Environment maps.
    pub environments: usize,
    /// Distinct maps, by a hash of their texels.
    pub distinct_environments: usize,
    /// Members and mean triangles of each mesh family.
    pub families: BTreeMap<String, (usize, u64)>,
    /// Members of each environment family.
    pub environment_families: BTreeMap<String, usize>,
}

/// Makes every mesh and map in the plan's catalogue, and counts them.
pub fn inventory(plan: &Plan, stop: &Cancel) -> Result<Inventory> {
    let catalog = plan.catalog();
    let progress = Progress::new("catalogue", u64::from(plan.meshes) + u64::from(plan.environments));
    let meshes: Vec<_> = (0..plan.meshes)
        .into_par_iter()
        .filter(|_| !stop.is_set())
        .map(|k| {
            let mesh = shapes::mesh(&catalog.mesh(k));
            progress.add(1);
            (k, shapes::geometry_hash(&mesh), shapes::inspect(&mesh).watertight, mesh.triangles.len() as u64)
        })
        .collect();
    let maps: Vec<_> = (0..plan.environments)
        .into_par_iter()
        .filter(|_| !stop.is_set())
        .map(|k| {
            let [width, height] = sky::LIBRARY_SIZE;
            let map = sky::render(&catalog.environment(k), width, height);
            progress.add(1);
            (k, blake3::hash(&hdr::encode(&map)))
        })
        .collect();
    stop.check()?;
    progress.finish();
    let mut found = Inventory { meshes: meshes.len(), environments: maps.len(), ..Inventory::default() };
    found.distinct_meshes = meshes.iter().map(|mesh| &mesh.1).collect::<HashSet<_>>().len();
    found.distinct_environments = maps.iter().map(|map| map.1).collect::<HashSet<_>>().len();
    for (k, _, watertight, triangles) in &meshes {
        found.watertight += usize::from(*watertight);
        found.triangles += triangles;
        let family = found.families.entry(catalog.mesh_family(*k).to_owned()).or_default();
        *family = (family.0 + 1, family.1 + triangles);
    }
    for family in found.families.values_mut() {
        family.1 /= family.0 as u64;
    }
    for (k, _) in &maps {
        *found.environment_families.entry(catalog.environment_family(*k).to_owned()).or_default() += 1;
    }
    Ok(found)
}

/// Checks that a preview may be written into the folder `out`: its files come from an earlier preview, or are not there.
///
/// # Errors
/// When one of them is there and did not come from a preview.
pub fn check_folder(out: &Path) -> Result<()> {
    if file::read_json::<Inventory>(&out.join(CATALOG)).is_ok() {
        return Ok(());
    }
    let places = SHEETS.into_iter().chain([CATALOG]).map(|name| out.join(name));
    match places.into_iter().find(|path| output::exists(path)) {
        Some(path) => bail!("{}: already exists and is not part of a preview; choose another folder", path.display()),
        None => Ok(()),
    }
}

/// The names and bytes of `meshes.png`, `environments.png` and `scenes.png`, with 64 pictures of `size` pixels each. Meshes and
/// environments come from the catalogue, starting with number `first`; scenes are spread over the plan's sequences.
pub fn sheets(plan: &Plan, size: u32, spp: u32, first: u32, stop: &Cancel) -> Result<Vec<(&'static str, Vec<u8>)>> {
    let catalog = plan.catalog();
    let count = SIDE * SIDE;
    let progress = Progress::new("preview", u64::from(3 * count));
    let settings =
        TruthSettings::quiet(Settings { spp, max_bounces: plan.render.max_bounces, ..Settings::default() }, Denoise::Auto)?;
    let picture = |scene: &Scene, frame: usize| -> Result<Rgb> {
        stop.check()?;
        let mut compiled = RenderScene::compile(&load::load(scene, &plan.reach())?)?;
        compiled.set_frame(frame);
        let (frame, _) = settings.frame(&compiled, &|_, _| (), stop)?;
        progress.add(1);
        let beauty = frame.beauty.or(frame.raw).context("no picture")?;
        Ok(beauty.map(|p| color::display(*p, frame.info.exposure)))
    };
    let meshes: Vec<Rgb> = (first..first + count)
        .map(|k| picture(&pedestal(&catalog.mesh(k), k, size), 0).with_context(|| format!("mesh {k}: {:?}", catalog.mesh(k))))
        .collect::<Result<_>>()?;
    let meshes = sheet(&meshes)?;
    let maps: Vec<Rgb> = (first..first + count)
        .map(|k| {
            let map = sky::render(&catalog.environment(k), 2 * size as usize, size as usize);
            let light = renderflow_frame::Environment { map, rotation: 0.0, intensity: 1.0 };
            let exposure = ibl::exposure(&light);
            progress.add(1);
            light.map.map(|p| color::display(*p, exposure))
        })
        .collect();
    let maps = sheet(&maps)?;
    let scenes: Vec<Rgb> = (0..count)
        .map(|i| {
            let (index, turn) = (i * plan.total() / count, i % plan.total().max(1));
            // Where a plan has fewer sequences than the sheet has places, several frames of each are shown.
            let index = if plan.total() < count { turn } else { index };
            let frame = (i / plan.total().max(1)) * plan.frames / count.div_ceil(plan.total().max(1)).max(1);
            let mut scene = plan.compose(&catalog, index)?.scene;
            scene.resolution = [size; 2];
            picture(&scene, if plan.total() < count { frame as usize } else { 0 })
        })
        .collect::<Result<_>>()?;
    progress.finish();
    Ok(SHEETS.into_iter().zip([meshes, maps, sheet(&scenes)?]).collect())
}

/// A shape on a grey floor, seen from slightly above, in a studio's light.
fn pedestal(shape: &Shape, k: u32, size: u32) -> Scene {
    let report = shapes::inspect(&shapes::mesh(shape));
    let (low, high) = (Vec3::from(report.low), Vec3::from(report.high));
    let radius = 0.5 * low.distance(high);
    let material = |name: &str, base_color: [f32; 3]| Material { name: name.into(), base_color, ..Material::default() };
    let hue = |offset: f32| 0.45 + 0.25 * (std::f32::consts::TAU * (k as f32 * 0.381_966 + offset)).cos();
    let object = |name: &str, shape: Shape, lift: f32| Object {
        name: name.into(),
        geometry: Geometry::Shape(shape),
        material: Some(name.into()),
        transform: Transform { translation: [0.0, f64::from(lift), 0.0], ..Transform::default() },
        motion: None,
    };
    Scene {
        version: 1,
        name: format!("mesh_{k}"),
        seed: u64::from(k),
        resolution: [size; 2],
        frames: 1,
        camera: CameraPath::Orbit {
            target: [0.0, 0.0, 0.0],
            distance: f64::from(3.4 * radius.max(0.05)),
            elevation: 22.0,
            azimuth: 30.0,
            degrees_per_frame: 0.0,
            vertical_fov: 35.0,
        },
        environment: EnvironmentLight {
            source: EnvironmentSource::Builtin("studio_three_point".into()),
            rotation: 0.0,
            intensity: 1.0,
        },
        materials: vec![material("floor", [0.5; 3]), material("mesh", [hue(0.0), hue(0.333), hue(0.667)])],
        objects: vec![
            object("floor", Shape::Plane { size: 40.0 * radius.clamp(0.05, 200.0) }, low.y),
            object("mesh", shape.clone(), 0.0),
        ],
    }
}

/// A PNG of pictures of equal size, eight in a row.
fn sheet(pictures: &[Rgb]) -> Result<Vec<u8>> {
    let (width, height) = pictures.first().map_or((1, 1), |p| (p.width, p.height));
    let columns = SIDE as usize;
    let rows = pictures.len().div_ceil(columns);
    let sheet = Image::from_fn(columns * width, rows * height, |x, y| {
        let picture = pictures.get((y / height) * columns + x / width);
        picture.map_or([0.0; 3], |p| p.pixels[(y % height) * width + x % width])
    });
    picture::png(&sheet)
}
