//! Training of the inverse network.

use super::monitor::{FRAMES, Monitor};
use super::sequences::Learns;
use super::{Session, Train};
use crate::dataset::learning::Recipe;
use crate::util::device::DeviceArgs;
use anyhow::{Result, ensure};
use half::f16;
use renderflow_frame::color::{display, linear_to_srgb};
use renderflow_frame::image::Rgb;
use renderflow_model::fusion::Record;
use renderflow_model::fusion::training::Source;
use renderflow_model::inverse::Inverse;
use renderflow_model::inverse::example::Example;
use renderflow_model::inverse::training::{self, Config};
use renderflow_model::train::runner::RunContext;
use renderflow_model::train::sequences::Crop;
use std::collections::BTreeMap;
use std::path::Path;

impl Learns for Config {
    fn recipe() -> Recipe {
        // Only the picture and what is behind it are read.
        Recipe { bare: 1.0, frames: 1, deferred: false, ..Recipe::default() }
    }

    fn validation_recipe(&self, recipe: &Recipe) -> Recipe {
        Recipe { small: 0.0, relit: 0, skip: 0, count: None, ..recipe.clone() }
    }

    fn crops(&self) -> &[Crop] {
        &self.crops
    }

    fn first(&self) -> u64 {
        self.first
    }

    fn check(&self, recipe: &Recipe) -> Result<()> {
        let bare = recipe.bare >= 1.0 && recipe.keyed <= 0.0;
        ensure!(bare, "recipe.bare must be 1 and recipe.keyed 0: this network reads neither samples nor keyframes");
        Ok(self.validate()?)
    }

    fn learn(&self, train: &Train, source: &dyn Source, validation: &[Record<f16>], session: &Session) -> Result<()> {
        let Session { team, bars, folder, cancel } = *session;
        let start = train.start()?;
        let examples: Vec<Example> = validation.iter().map(Example::of).collect();
        let shown = &examples[..examples.len().min(FRAMES)];
        let sheets = |weights: &Path| match shown {
            [] => Ok(Vec::new()),
            shown => Ok(vec![("inverse".to_owned(), sheet(&Inverse::load(weights)?, shown)?)]),
        };
        let none = BTreeMap::new();
        let monitor = Monitor::new(&self.run.output, &none, &sheets);
        let tell = |progress: &_| monitor.tell(bars, progress);
        let context = RunContext { device: &DeviceArgs::from(train.device).get()?, progress: &tell, cancel, team };
        folder.begin()?;
        bars.finish(&training::run(self, source, start.as_ref(), &examples, context)?)
    }
}

/// A sheet with one row for each frame: the picture, then albedo, normals and material, each as it was found and as it is.
fn sheet(network: &Inverse, frames: &[Example]) -> Result<Rgb> {
    let mut rows = Vec::new();
    for frame in frames {
        let (width, height) = (frame.width, frame.height);
        let picture = Rgb::from_fn(width, height, |x, y| display(frame.at(x, y).radiance, 1.0));
        let found = network.find(&picture)?;
        let unit = |p: [f32; 3]| p.map(|v| 0.5 + 0.5 * v);
        let albedo = Rgb::from_fn(width, height, |x, y| frame.at(x, y).albedo.map(linear_to_srgb));
        let normal = Rgb::from_fn(width, height, |x, y| unit(frame.at(x, y).normal));
        let material = Rgb::from_fn(width, height, |x, y| frame.at(x, y).material);
        rows.push([picture, found.albedo, albedo, found.normal.map(|p| unit(*p)), normal, found.material, material]);
    }
    let (width, height) = (frames[0].width, frames[0].height);
    // A frame of another size is cut or repeated.
    let pixel = |x: usize, y: usize| {
        let picture = &rows[y / height][x / width];
        *picture.at((x % width) % picture.width, (y % height) % picture.height)
    };
    Ok(Rgb::from_fn(7 * width, rows.len() * height, pixel))
}
