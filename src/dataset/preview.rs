//! Shows a plan before it is rendered: contact sheets of its meshes, environments and scenes, and counts of its catalogue.

use super::contact;
use super::denoise::Denoise;
use super::job::TruthSettings;
use super::plan::{Plan, SPLITS, Sources};
use crate::util::cancel::Cancel;
use crate::util::output;
use crate::util::picture;
use crate::util::progress::Progress;
use crate::util::sheet::{self, Tile};
use anyhow::{Context, Result, bail, ensure};
use glam::Vec3;
use rayon::prelude::*;
use renderflow_frame::image::Rgb;
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

/// What a catalogue holds. What is only known once every mesh and map was made is absent unless it was counted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Inventory {
    /// Meshes.
    pub meshes: usize,
    /// Distinct meshes, by a hash of positions and triangles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distinct_meshes: Option<usize>,
    /// Meshes that enclose a volume: every edge has two triangles.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub watertight: Option<usize>,
    /// Triangles of all meshes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub triangles: Option<u64>,
    /// Environment maps.
    pub environments: usize,
    /// Distinct maps, by a hash of their texels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distinct_environments: Option<usize>,
    /// Members of each mesh family, and their mean triangles.
    pub families: BTreeMap<String, (usize, Option<u64>)>,
    /// Members of each environment family.
    pub environment_families: BTreeMap<String, usize>,
}

/// The sizes of the plan's catalogue and of its families. Nothing is made.
pub fn inventory(plan: &Plan) -> Inventory {
    let catalog = plan.catalog();
    let mut found = Inventory { meshes: plan.meshes as usize, environments: plan.environments as usize, ..Inventory::default() };
    for k in 0..plan.meshes {
        found.families.entry(catalog.mesh_family(k).to_owned()).or_default().0 += 1;
    }
    for k in 0..plan.environments {
        *found.environment_families.entry(catalog.environment_family(k).to_owned()).or_default() += 1;
    }
    found
}

/// As [`inventory`]; it also makes every mesh and every map, and counts what is distinct, watertight and how many triangles.
///
/// # Errors
/// When stopped.
pub fn counted(plan: &Plan, stop: &Cancel) -> Result<Inventory> {
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
    let maps: HashSet<_> = (0..plan.environments)
        .into_par_iter()
        .filter(|_| !stop.is_set())
        .map(|k| {
            let [width, height] = sky::LIBRARY_SIZE;
            let map = sky::render(&catalog.environment(k), width, height);
            progress.add(1);
            blake3::hash(&hdr::encode(&map))
        })
        .collect();
    stop.check()?;
    progress.finish();
    let mut found = inventory(plan);
    found.distinct_meshes = Some(meshes.iter().map(|mesh| &mesh.1).collect::<HashSet<_>>().len());
    found.watertight = Some(meshes.iter().filter(|mesh| mesh.2).count());
    found.triangles = Some(meshes.iter().map(|mesh| mesh.3).sum());
    found.distinct_environments = Some(maps.len());
    for (k, _, _, triangles) in &meshes {
        if let Some((_, mean)) = found.families.get_mut(catalog.mesh_family(*k)) {
            *mean = Some(mean.unwrap_or(0) + triangles);
        }
    }
    for (members, mean) in found.families.values_mut() {
        *mean = mean.map(|triangles| triangles / *members as u64);
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

/// The split that has this family among its own; empty where none has.
fn owner(plan: &Plan, of: fn(&Sources) -> &Vec<String>, family: &str) -> &'static str {
    SPLITS.iter().find(|split| of(plan.splits.of(**split)).iter().any(|name| name == family)).map_or("", |split| split.name())
}

/// The names and bytes of `meshes.png`, `environments.png` and `scenes.png`, with up to 64 pictures of `size` pixels each. Meshes
/// and environments come from the catalogue, starting with number `first`, and are labelled with number, family and the split
/// that the family belongs to. Scenes are spread over the plan's sequences, each at most once, and are labelled with number,
/// split and layout.
///
/// # Errors
/// When the catalogue ends before `first`, when a scene cannot be rendered, or when stopped.
pub fn sheets(plan: &Plan, size: u32, spp: u32, first: u32, stop: &Cancel) -> Result<Vec<(&'static str, Vec<u8>)>> {
    let catalog = plan.catalog();
    let count = SIDE * SIDE;
    ensure!(
        first < plan.meshes.max(plan.environments),
        "--first {first}: the catalogue has {} meshes and {} environments, counted from 0",
        plan.meshes,
        plan.environments
    );
    let scenes = count.min(plan.total());
    let [meshes, maps] = [plan.meshes, plan.environments].map(|all| first.min(all)..(first + count).min(all));
    let progress = Progress::new("preview", (meshes.len() + maps.len()) as u64 + u64::from(scenes));
    let settings =
        TruthSettings::quiet(Settings { spp, max_bounces: plan.render.max_bounces, ..Settings::default() }, Denoise::Auto)?;
    let picture = |scene: &Scene| -> Result<Rgb> {
        stop.check()?;
        let compiled = RenderScene::compile(&load::load(scene, &plan.reach())?)?;
        let (frame, _) = settings.frame(&compiled, &|_, _| (), stop)?;
        progress.add(1);
        contact::display(&frame).context("no picture")
    };
    let meshes = meshes.map(|k| {
        let (shape, family) = (catalog.mesh(k), catalog.mesh_family(k));
        let made = picture(&pedestal(&shape, k, size)).with_context(|| format!("mesh {k}: {shape:?}"))?;
        Ok(Tile::new(format!("{k} {family} {}", owner(plan, |s| &s.mesh_families, family)), made))
    });
    let meshes = meshes.collect::<Result<Vec<_>>>()?;
    let maps = maps.map(|k| {
        let map = sky::render(&catalog.environment(k), 2 * size as usize, size as usize);
        let light = renderflow_frame::Environment { map, rotation: 0.0, intensity: 1.0 };
        let exposure = ibl::exposure(&light);
        progress.add(1);
        let family = catalog.environment_family(k);
        let name = format!("{k} {family} {}", owner(plan, |s| &s.environment_families, family));
        Tile::new(name, light.map.map(|p| color::display(*p, exposure)))
    });
    let maps = maps.collect();
    let scenes = (0..scenes).map(|i| {
        let index = i * plan.total() / scenes;
        let mut composed = plan.compose(&catalog, index)?;
        composed.scene.resolution = [size; 2];
        let layout = format!("{:?}", composed.layout).to_lowercase();
        let name = format!("{} {} {layout}", Plan::sequence_name(index), plan.split(index));
        Ok(Tile::new(name, picture(&composed.scene)?))
    });
    let scenes = scenes.collect::<Result<Vec<_>>>()?;
    progress.finish();
    let sheets = SHEETS.into_iter().zip([meshes, maps, scenes]).filter(|(_, tiles)| !tiles.is_empty());
    sheets.map(|(name, tiles)| Ok((name, picture::png(&sheet::sheet(&tiles, SIDE as usize))?))).collect()
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
        animation: None,
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
        lights: vec![],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn earlier_counts_are_still_read() {
        let stored = r#"{"meshes":2,"distinct_meshes":2,"watertight":1,"triangles":30,"environments":1,"distinct_environments":1,
                         "families":{"gear":[2,15]},"environment_families":{"dusk":1}}"#;
        let found: Inventory = serde_json::from_str(stored).unwrap();
        assert_eq!((found.distinct_meshes, found.families["gear"]), (Some(2), (2, Some(15))));
    }
}
