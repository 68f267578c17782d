//! The scene of the viewer, and one picture of it at a time.

use super::camera;
use super::changes::{changed, values, written};
use super::method::Method;
use super::state::{Choice, Hello, MaterialValues, Parameter, State, Value, fitting};
use crate::dataset::job::clean::{denoise, fuse};
use crate::dataset::shading::{BUFFERS, TRACED};
use crate::util::cancel::Cancel;
use anyhow::{Context, Result};
use glam::DVec3;
use renderflow_frame::image::{Image, Rgb};
use renderflow_frame::{Frame, ibl};
use renderflow_model::fusion::{Fusion, Record};
use renderflow_renderer::deferred::{self, Deferred, LIGHTS, Lighting, ShadowTiles};
use renderflow_renderer::denoise::{self as oidn, Denoiser, Quality};
use renderflow_renderer::film::Film;
use renderflow_renderer::{Channels, RenderScene, Settings, expose, render, render_gbuffer_until};
use renderflow_scenes::description::Scene;
use renderflow_scenes::{LoadedScene, Principled};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// Most samples per pixel of the path-traced picture.
pub const MOST_SAMPLES: u32 = 4096;

/// The scene, and what was made of it for the state that stands.
pub struct Stage {
    description: Scene,
    /// The materials as they were loaded.
    materials: Vec<(String, bool, Principled)>,
    scene: RenderScene,
    origin: DVec3,
    lighting: Arc<Lighting>,
    tiles: ShadowTiles,
    network: Fusion,
    /// OIDN with least error, and in least time; `None` where it is not found.
    denoisers: Option<[Mutex<Denoiser>; 2]>,
    /// The state that stands.
    state: State,
    /// How many times smaller than asked for pictures are; 0 before the first state.
    scale: u32,
    gbuffer: Option<Timed<Frame>>,
    shaded: Option<Timed<Deferred>>,
    /// The path-traced samples.
    film: Option<Timed<Film>>,
}

/// Something, and the seconds that it took.
struct Timed<T> {
    value: T,
    seconds: f64,
}

/// Radiance, or display values of a channel.
#[derive(Clone)]
pub enum Content {
    /// Scene-linear radiance.
    Radiance(Rgb),
    /// Values for the screen, 0..=1.
    Display(Rgb),
}

/// A picture and what it cost.
#[derive(Clone)]
pub struct Made {
    /// The picture.
    pub content: Content,
    /// Samples per pixel; 0 for methods that trace none.
    pub samples: u32,
    /// Seconds, of everything that it needs.
    pub seconds: f64,
}

impl Stage {
    /// Compiles the scene.
    ///
    /// # Errors
    /// When the scene cannot be compiled.
    pub fn new(description: Scene, loaded: LoadedScene, network: Fusion) -> Result<Self> {
        let scene = RenderScene::compile(&loaded)?;
        let lighting = Arc::new(Lighting::new(Arc::clone(scene.light()), LIGHTS));
        let open = |quality| Denoiser::with_options(oidn::Options { quality, ..oidn::Options::default() }).ok().map(Mutex::new);
        let denoisers = open(Quality::High).zip(open(Quality::Fast)).map(|(high, fast)| [high, fast]);
        let materials = loaded
            .materials
            .iter()
            .map(|material| (material.name.clone(), material.texture_slots().next().is_some(), material.surface));
        let state = home(&description);
        Ok(Self {
            materials: materials.collect(),
            origin: loaded.origin,
            description,
            scene,
            lighting,
            tiles: ShadowTiles::default(),
            network,
            denoisers,
            state,
            scale: 0,
            gbuffer: None,
            shaded: None,
            film: None,
        })
    }

    /// What the page is told first.
    pub fn hello(&self) -> Hello {
        let choice = |method: Method| Choice {
            name: method,
            label: match method {
                Method::Denoised if self.denoisers.is_none() => "path traced (OIDN is not found)",
                _ => method.label(),
            },
            group: if method.channel().is_some() { "G-buffer" } else { "method" },
        };
        let parameters = values(&Principled::default()).into_iter().map(|(name, value)| Parameter {
            label: name.replace('_', " ").replace("color", "colour"),
            name,
            r#type: if matches!(value, Value::Color(_)) { "color" } else { "number" },
            range: [0.0, 1.0],
        });
        let materials = self.materials.iter().map(|(name, textured, surface)| MaterialValues {
            name: name.clone(),
            textured: *textured,
            values: values(surface).into_iter().collect(),
        });
        Hello {
            name: self.description.name.clone(),
            resolution: fitting(self.description.resolution),
            frames: self.description.frames,
            methods: Method::ALL.map(choice).into(),
            parameters: parameters.collect(),
            materials: materials.collect(),
            state: self.home(),
        }
    }

    /// The scene as it was opened.
    pub fn home(&self) -> State {
        home(&self.description)
    }

    /// Changes the scene to `state`. What was made of it is forgotten, unless only the methods change.
    ///
    /// # Errors
    /// When the state cannot be rendered.
    pub fn apply(&mut self, state: State) -> Result<()> {
        state.check()?;
        let frame = state.frame.min(self.description.frames.saturating_sub(1));
        if self.scene.frame() != frame as usize {
            self.scene.set_frame(frame as usize);
        }
        self.scene.turn_environment(state.rotation.to_radians());
        if !Arc::ptr_eq(&self.lighting.whole, self.scene.light()) {
            self.lighting = Arc::new(self.lighting.turned(Arc::clone(self.scene.light())));
        }
        let numbers = self.state.materials.keys().chain(state.materials.keys());
        for number in numbers.copied().collect::<std::collections::BTreeSet<_>>() {
            let changes = state.materials.get(&number);
            if self.state.materials.get(&number) != changes
                && let Some((_, _, surface)) = self.materials.get(number)
            {
                self.scene.set_surface(number, &changed(surface, changes))?;
            }
        }
        let before = std::mem::replace(&mut self.state, state);
        if self.scale == 0 || !before.shows_the_same(&self.state) {
            self.scale = 0;
            self.set_scale(1);
        }
        Ok(())
    }

    /// Renders at a resolution this many times smaller from now on.
    pub fn set_scale(&mut self, scale: u32) {
        if self.scale != scale {
            self.scale = scale;
            let [width, height] = self.state.resolution.map(|side| side.div_ceil(scale));
            let camera = camera::shown(&self.description, &self.state);
            self.scene.look_with(camera.at_from(0, [width, height], self.origin));
            (self.gbuffer, self.shaded, self.film) = (None, None, None);
        }
    }

    /// Columns and rows of pictures now.
    pub fn size(&self) -> [usize; 2] {
        [self.scene.camera().width, self.scene.camera().height]
    }

    /// Factor from radiance to display values.
    pub fn exposure(&self) -> f32 {
        self.scene.exposure()
    }

    /// Samples per pixel traced so far.
    pub fn samples(&self) -> u32 {
        self.film.as_ref().map_or(0, |film| film.value.samples())
    }

    /// Seconds per sample so far.
    pub fn seconds_a_sample(&self) -> Option<f64> {
        self.film.as_ref().map(|film| film.seconds / f64::from(film.value.samples().max(1)))
    }

    /// Traces `count` more samples per pixel.
    ///
    /// # Errors
    /// When stopped.
    pub fn trace(&mut self, count: u32, cancel: &Cancel) -> Result<()> {
        let started = Instant::now();
        let from = self.samples();
        let settings = Settings { spp: MOST_SAMPLES, branches: 1, channels: GUIDED, ..Settings::default() };
        let (film, _) = expose(&self.scene, &settings, from..(from + count).min(MOST_SAMPLES), &|_, _| (), cancel)?;
        match &mut self.film {
            None => self.film = Some(Timed { value: film, seconds: started.elapsed().as_secs_f64() }),
            Some(sum) => {
                sum.value.merge(&film)?;
                sum.seconds += started.elapsed().as_secs_f64();
            }
        }
        Ok(())
    }

    /// Mean of the path-traced samples.
    pub fn traced(&self) -> Option<Rgb> {
        self.film.as_ref().map(|film| film.value.mean())
    }

    /// The picture of `method`. Methods that refine take the samples that were traced, at least one.
    ///
    /// # Errors
    /// When stopped, or when a denoiser fails.
    pub fn picture(&mut self, method: Method, cancel: &Cancel) -> Result<Made> {
        if let Some(channel) = method.channel() {
            let buffer = self.gbuffer(cancel)?;
            let content = Content::Display(channel.tile(&buffer.value).picture);
            return Ok(Made { content, samples: 0, seconds: buffer.seconds });
        }
        if method.refines() {
            if self.film.is_none() {
                self.trace(1, cancel)?;
            }
            return self.refined(method, cancel);
        }
        // What another side made for this state counts as if it were made here.
        match method {
            Method::Ibl => {
                let light = Arc::clone(self.scene.light());
                let buffer = self.gbuffer(cancel)?;
                let shading = Instant::now();
                let image = ibl::shade(&buffer.value, &light).image;
                Ok(Made {
                    content: Content::Radiance(image),
                    samples: 0,
                    seconds: buffer.seconds + shading.elapsed().as_secs_f64(),
                })
            }
            Method::Deferred => {
                self.shade(cancel)?;
                let (buffer, shaded) = self.known()?;
                Ok(Made {
                    content: Content::Radiance(shaded.value.image.clone()),
                    samples: 0,
                    seconds: buffer.seconds + shaded.seconds,
                })
            }
            Method::Neural => {
                self.shade(cancel)?;
                let exposure = self.exposure();
                let (buffer, shaded) = self.known()?;
                let drawing = Instant::now();
                let mut record = Record::of(&buffer.value, &shaded.value.surfaces, exposure);
                record.add_deferred(&shaded.value.terms, exposure);
                let pixels = self.network.render(&record)?.into_iter().map(|rgb| rgb.map(|v| v / exposure)).collect();
                let image = Rgb { width: record.width, height: record.height, pixels };
                let seconds = buffer.seconds + shaded.seconds + drawing.elapsed().as_secs_f64();
                Ok(Made { content: Content::Radiance(image), samples: 0, seconds })
            }
            _ => {
                let before = self.gbuffer(cancel)?.seconds;
                let drawing = Instant::now();
                let spp = self.state.rays;
                let channels = if self.network.header().fusion.paths { TRACED } else { Channels::BEAUTY };
                let settings = Settings { spp, channels: Channels { guides: true, ..channels }, ..Settings::default() };
                let samples = render(&self.scene, &settings, &|_, _| (), cancel)?;
                let buffer = self.gbuffer.as_ref().context("no G-buffer")?;
                let denoiser = self.denoiser();
                let image = fuse(&self.network, denoiser, &self.scene, [&samples, &buffer.value], None, cancel)?;
                Ok(Made { content: Content::Radiance(image), samples: spp, seconds: before + drawing.elapsed().as_secs_f64() })
            }
        }
    }

    /// The picture of a method that refines, from the samples so far.
    fn refined(&mut self, method: Method, cancel: &Cancel) -> Result<Made> {
        let guided = method == Method::Denoised && self.denoisers.is_some();
        let mut seconds = if guided { self.gbuffer(cancel)?.seconds } else { 0.0 };
        let film = self.film.as_ref().context("no samples")?;
        seconds += film.seconds;
        let (mut image, samples) = (film.value.mean(), film.value.samples());
        if let (true, Some(denoiser), Some(buffer)) = (guided, self.denoiser(), &self.gbuffer) {
            let started = Instant::now();
            let guides = [buffer.value.guide_albedo.as_ref(), buffer.value.guide_normal.as_ref()];
            image = denoise(denoiser, &image, guides, cancel)?;
            seconds += started.elapsed().as_secs_f64();
        }
        Ok(Made { content: Content::Radiance(image), samples, seconds })
    }

    /// OIDN: in least time while things move.
    fn denoiser(&self) -> Option<&Mutex<Denoiser>> {
        self.denoisers.as_ref().map(|denoisers| &denoisers[usize::from(self.state.moving)])
    }

    fn gbuffer(&mut self, cancel: &Cancel) -> Result<&Timed<Frame>> {
        if self.gbuffer.is_none() {
            let started = Instant::now();
            let value = render_gbuffer_until(&self.scene, &Settings { channels: BUFFERS, ..Settings::default() }, cancel)?;
            self.gbuffer = Some(Timed { value, seconds: started.elapsed().as_secs_f64() });
        }
        self.gbuffer.as_ref().context("no G-buffer")
    }

    /// Makes the deferred picture, if it is not there.
    fn shade(&mut self, cancel: &Cancel) -> Result<()> {
        self.gbuffer(cancel)?;
        if let (None, Some(buffer)) = (&self.shaded, &self.gbuffer) {
            let started = Instant::now();
            let shadows = self.tiles.maps(&self.scene, &self.lighting, &buffer.value);
            cancel.check()?;
            let value = deferred::shade(&buffer.value, &self.lighting, &shadows, &deferred::Options::default());
            self.shaded = Some(Timed { value, seconds: started.elapsed().as_secs_f64() });
        }
        Ok(())
    }

    fn known(&self) -> Result<(&Timed<Frame>, &Timed<Deferred>)> {
        self.gbuffer.as_ref().zip(self.shaded.as_ref()).context("no deferred picture")
    }

    /// The number of the material that is seen at a place, in shares of the picture; `None` where there is the background.
    ///
    /// # Errors
    /// When stopped.
    pub fn material_at(&mut self, [x, y]: [f32; 2], cancel: &Cancel) -> Result<Option<usize>> {
        let ids: &Image<u32> = &self.gbuffer(cancel)?.value.material_id;
        let place = |share: f32, count: usize| ((share.clamp(0.0, 1.0) * count as f32) as usize).min(count.saturating_sub(1));
        let id = *ids.at(place(x, ids.width), place(y, ids.height));
        Ok((id as usize).checked_sub(1))
    }

    /// The scene and the camera of the state, as JSON files; and what the scene cannot say.
    ///
    /// # Errors
    /// Never with a state that was applied.
    pub fn files(&self) -> Result<([String; 2], Vec<String>)> {
        let mut scene = self.description.clone();
        scene.camera = camera::saved(&scene, &self.state);
        scene.environment.rotation = self.state.rotation;
        scene.resolution = camera::resolution(&scene, &self.state);
        let mut notes = Vec::new();
        for (number, changes) in &self.state.materials {
            let Some((name, ..)) = self.materials.get(*number) else { continue };
            match scene.materials.iter_mut().find(|material| material.name == *name) {
                Some(material) => *material = written(material, changes)?,
                None => {
                    notes.push(format!("the material {name} belongs to a model file, so scene.json does not keep its changes"))
                }
            }
        }
        let camera = serde_json::to_string_pretty(&scene.camera)?;
        Ok(([serde_json::to_string_pretty(&scene)?, camera], notes))
    }
}

/// Samples, with what denoisers need beside them.
const GUIDED: Channels = Channels { guides: true, ..Channels::BEAUTY };

/// The state in which a scene is opened.
pub fn home(description: &Scene) -> State {
    State {
        id: 0,
        moving: false,
        left: Method::Neural,
        right: Method::Denoised,
        split: true,
        camera: camera::viewpoint(description),
        frame: 0,
        rotation: description.environment.rotation,
        rays: 2,
        resolution: fitting(description.resolution),
        materials: BTreeMap::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::source::SceneSource;
    use renderflow_renderer::Settings;
    use renderflow_scenes::description::CameraPath;
    use renderflow_scenes::load;

    fn stage(frames: u32) -> Stage {
        let source = SceneSource { seed: Some(5), resolution: Some([48, 40]), frames: Some(frames), ..SceneSource::default() };
        let described = source.describe(&[]).unwrap();
        let loaded = load::load(&described.scene, &described.reach).unwrap();
        Stage::new(described.scene, loaded, Fusion::shipped().unwrap()).unwrap()
    }

    fn radiance(made: &Made) -> &Rgb {
        match &made.content {
            Content::Radiance(rgb) | Content::Display(rgb) => rgb,
        }
    }

    #[test]
    fn a_state_is_the_scene_that_it_saves() {
        let mut stage = stage(3);
        let cancel = Cancel::default();
        let mut state = stage.home();
        state.camera.eye[1] += 0.7;
        state.camera.vertical_fov = 55.0;
        state.rotation += 130.0;
        state.frame = 2;
        let changes = BTreeMap::from([
            ("roughness".to_owned(), Value::Number(0.07)),
            ("base_color".to_owned(), Value::Color([0.9, 0.1, 0.3])),
        ]);
        let names: Vec<String> = stage.description.materials.iter().map(|material| material.name.clone()).collect();
        let number = stage.materials.iter().position(|(name, ..)| names.contains(name)).unwrap();
        state.materials.insert(number, changes);
        stage.apply(state).unwrap();
        let shown = stage.picture(Method::Deferred, &cancel).unwrap();
        let ([saved, camera], notes) = stage.files().unwrap();
        assert!(notes.is_empty(), "{notes:?}");

        let scene: Scene = serde_json::from_str(&saved).unwrap();
        assert_eq!(serde_json::from_str::<CameraPath>(&camera).unwrap(), scene.camera);
        scene.validate().unwrap();
        let loaded = load::load(&scene, &renderflow_frame::reach::Reach::folder(".")).unwrap();
        let mut again = Stage::new(scene, loaded, Fusion::shipped().unwrap()).unwrap();
        let mut state = again.home();
        state.frame = 2;
        again.apply(state).unwrap();
        let expected = again.picture(Method::Deferred, &cancel).unwrap();
        let worst = radiance(&shown)
            .pixels
            .iter()
            .zip(&radiance(&expected).pixels)
            .flat_map(|(a, b)| (0..3).map(|c| (a[c] - b[c]).abs() / (0.05 + b[c].abs())));
        let mut worst: Vec<f32> = worst.collect();
        worst.sort_by(f32::total_cmp);
        // Only where a shadow's edge falls differently may pixels differ.
        assert!(worst[worst.len() * 98 / 100] < 2e-3, "{}", worst[worst.len() * 98 / 100]);
    }

    #[test]
    fn home_is_the_scene_as_it_was() {
        let mut stage = stage(2);
        let cancel = Cancel::default();
        let home = stage.home();
        stage.apply(home.clone()).unwrap();
        let before = radiance(&stage.picture(Method::Ibl, &cancel).unwrap()).clone();
        let mut state = home.clone();
        state.rotation = 77.0;
        state.frame = 1;
        for number in 0..stage.materials.len() {
            state.materials.insert(number, BTreeMap::from([("metallic".to_owned(), Value::Number(1.0))]));
        }
        stage.apply(state).unwrap();
        assert_ne!(radiance(&stage.picture(Method::Ibl, &cancel).unwrap()), &before);
        stage.apply(home).unwrap();
        assert_eq!(radiance(&stage.picture(Method::Ibl, &cancel).unwrap()), &before);
    }

    #[test]
    fn samples_add_up_to_the_picture_of_all_of_them() {
        let mut stage = stage(1);
        let cancel = Cancel::default();
        stage.apply(stage.home()).unwrap();
        for count in [1, 1, 2, 4] {
            stage.trace(count, &cancel).unwrap();
        }
        assert_eq!(stage.samples(), 8);
        let settings = Settings { spp: MOST_SAMPLES, branches: 1, channels: GUIDED, ..Settings::default() };
        let (film, _) = expose(&stage.scene, &settings, 0..8, &|_, _| (), &cancel).unwrap();
        let [a, b] = [stage.traced().unwrap(), film.mean()];
        let worst = a.pixels.iter().zip(&b.pixels).flat_map(|(a, b)| (0..3).map(|c| (a[c] - b[c]).abs() / (1e-3 + b[c].abs())));
        assert!(worst.fold(0.0, f32::max) < 1e-5);
    }

    #[test]
    fn another_method_keeps_the_samples_and_another_view_does_not() {
        let mut stage = stage(1);
        let cancel = Cancel::default();
        let mut state = stage.home();
        stage.apply(state.clone()).unwrap();
        stage.trace(4, &cancel).unwrap();
        (state.id, state.left, state.right, state.split, state.rays) = (7, Method::Path, Method::Albedo, false, 8);
        stage.apply(state.clone()).unwrap();
        assert_eq!((stage.samples(), stage.picture(Method::Path, &cancel).unwrap().samples), (4, 4));
        stage.set_scale(2);
        assert_eq!(stage.samples(), 0);
        let others: [fn(&mut State); 5] = [
            |s| s.camera.eye[0] += 0.1,
            |s| s.rotation += 1.0,
            |s| s.resolution = [64, 64],
            |s| s.frame += 1,
            |s| drop(s.materials.insert(0, BTreeMap::from([("metallic".to_owned(), Value::Number(0.3))]))),
        ];
        for (case, change) in others.into_iter().enumerate() {
            stage.apply(state.clone()).unwrap();
            stage.trace(1, &cancel).unwrap();
            let mut other = state.clone();
            change(&mut other);
            stage.apply(other).unwrap();
            assert_eq!(stage.samples(), 0, "case {case}");
        }
    }

    #[test]
    fn every_method_draws_at_every_scale() {
        let mut stage = stage(1);
        let cancel = Cancel::default();
        stage.apply(stage.home()).unwrap();
        for scale in [1, 2, 4] {
            stage.set_scale(scale);
            for method in Method::ALL {
                let made = stage.picture(method, &cancel).unwrap();
                let picture = radiance(&made);
                assert_eq!([picture.width, picture.height], [48usize.div_ceil(scale as usize), 40usize.div_ceil(scale as usize)]);
                assert!(picture.pixels.iter().flatten().all(|v| v.is_finite()), "{method:?}");
                assert!(made.seconds > 0.0);
            }
        }
        let background = stage.material_at([f32::NAN, 0.0], &cancel).unwrap();
        assert!(background.is_none_or(|number| number < stage.materials.len()));
    }

    #[test]
    fn scenes_of_any_size_fit_the_page() {
        for (size, expected) in
            [([640, 360], [640, 360]), ([16384, 4096], [2048, 512]), ([1, 1], [16, 16]), ([16384, 1], [2048, 16])]
        {
            assert_eq!(fitting(size), expected);
        }
    }

    #[test]
    fn states_that_cannot_be_rendered_are_refused() {
        let mut stage = stage(1);
        let home = stage.home();
        let bad: [fn(&mut State); 8] = [
            |s| s.camera.eye = s.camera.target,
            |s| s.camera.eye[0] = f64::NAN,
            |s| s.camera.vertical_fov = 0.0,
            |s| s.rotation = f32::INFINITY,
            |s| s.resolution = [0, 64],
            |s| s.resolution = [64, 1 << 20],
            |s| s.rays = 3,
            |s| drop(s.materials.insert(0, BTreeMap::from([("roughness".to_owned(), Value::Number(f32::NAN))]))),
        ];
        for (case, change) in bad.into_iter().enumerate() {
            let mut state = home.clone();
            change(&mut state);
            assert!(stage.apply(state).is_err(), "case {case}");
        }
        // What is only strange is rendered.
        let mut state = home;
        state.materials.insert(usize::MAX, BTreeMap::from([("roughness".to_owned(), Value::Number(0.5))]));
        state.materials.insert(
            0,
            BTreeMap::from([("nonsense".to_owned(), Value::Number(0.5)), ("sheen".to_owned(), Value::Color([9.0; 3]))]),
        );
        state.frame = u32::MAX;
        stage.apply(state).unwrap();
        stage.picture(Method::Neural, &Cancel::default()).unwrap();
    }
}
