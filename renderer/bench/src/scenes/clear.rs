//! Scenes of glass, panes and blended surfaces, on which other renderers are asked for the same picture. What is opaque is
//! Lambertian and what is clear is smooth or nearly so, because there the models of all renderers are the same.

use super::{BenchScene, Described, at, builtin, look, plastic, turned};
use anyhow::Result;
use image::{ImageBuffer, ImageFormat, Rgba};
use renderflow_scenes::description::{EnvironmentSource, Material};
use renderflow_scenes::shapes::Shape;
use renderflow_scenes::sky::Sky;
use std::io::Cursor;

/// Every scene.
pub const CLEAR: [BenchScene; 9] = [
    BenchScene { name: "glass_ball", about: "a glass ball on a floor under a generated sky", make: glass_ball },
    BenchScene { name: "tinted_glass", about: "balls of glass that absorb, and one of coloured surface", make: tinted_glass },
    BenchScene { name: "rough_glass", about: "a ball of slightly rough glass", make: rough_glass },
    BenchScene { name: "thick_slab", about: "things behind and below thick slabs of glass and water", make: thick_slab },
    BenchScene { name: "pane", about: "things behind a clear pane and a coloured one", make: pane },
    BenchScene {
        name: "leaf_cards",
        about: "blended cards whose textures have soft edges, and a plainly blended ball",
        make: leaf_cards,
    },
    BenchScene { name: "partly_clear", about: "a ball that is clear by a share", make: partly_clear },
    BenchScene { name: "faded_glass", about: "a ball of glass that is blended as well", make: faded_glass },
    BenchScene { name: "lamp_room", about: "glass, a pane, and blended cards in a room with a lamp", make: lamp_room },
];

/// Lambertian.
fn matte(name: &str, base_color: [f32; 3]) -> Material {
    plastic(name, base_color, 0.0, 0.0)
}

/// Smooth glass of index of refraction 1.5.
fn glass(name: &str) -> Material {
    Material { transmission: 1.0, ..plastic(name, [1.0; 3], 0.0, 0.5) }
}

fn sheet(name: &str, base_color: [f32; 3]) -> Material {
    Material { thin_walled: true, base_color, ..glass(name) }
}

fn ball(radius: f32) -> Shape {
    Shape::Sphere { radius }
}

fn slab(size: [f32; 3]) -> Shape {
    Shape::Box { size, bevel: 0.0 }
}

/// A floor with three coloured things on it, under a smooth sky.
fn stage(name: &str) -> Result<Described> {
    let mut d = Described::new(name, look([2.2, 2.4, 4.6], [0.0, 0.6, 0.0], 36.0), builtin("overcast_bright")?);
    d.shape(Shape::Plane { size: 12.0 }, matte("floor", [0.5, 0.48, 0.45]), at(0.0, 0.0, 0.0));
    d.shape(slab([0.6, 1.2, 0.6]), matte("red", [0.7, 0.12, 0.08]), turned(-1.3, 0.6, -1.2, [0.0, 25.0, 0.0]));
    d.shape(ball(0.5), matte("green", [0.15, 0.55, 0.2]), at(0.2, 0.5, -1.6));
    d.shape(slab([0.5, 0.8, 0.5]), matte("blue", [0.1, 0.2, 0.65]), turned(1.5, 0.4, -0.9, [0.0, -15.0, 0.0]));
    Ok(d)
}

fn glass_ball() -> Result<Described> {
    let mut d = stage("glass_ball")?;
    d.shape(ball(0.8), glass("glass"), at(0.0, 0.81, 0.4));
    Ok(d)
}

fn tinted_glass() -> Result<Described> {
    let mut d = stage("tinted_glass")?;
    let amber = Material { attenuation_color: [0.9, 0.5, 0.1], attenuation_distance: 0.8, ..glass("amber") };
    d.shape(ball(0.7), amber, at(-0.7, 0.71, 0.5));
    let bottle = Material { base_color: [0.6, 0.9, 0.7], specular: 0.35, ..glass("bottle") };
    d.shape(ball(0.45), bottle, at(0.7, 0.46, 0.7));
    let dark = Material { attenuation_color: [0.02, 0.1, 0.3], attenuation_distance: 0.3, ..glass("dark") };
    d.shape(slab([0.5; 3]), dark, turned(0.4, 0.26, 1.7, [0.0, 30.0, 0.0]));
    Ok(d)
}

fn rough_glass() -> Result<Described> {
    let mut d = stage("rough_glass")?;
    d.shape(ball(0.8), Material { roughness: 0.1, ..glass("rough") }, at(0.0, 0.81, 0.4));
    Ok(d)
}

fn thick_slab() -> Result<Described> {
    let mut d = stage("thick_slab")?;
    d.shape(slab([1.8, 1.3, 0.5]), glass("upright"), turned(-0.4, 0.66, 0.4, [0.0, 12.0, 0.0]));
    // Water: index of refraction 1.333.
    d.shape(slab([1.4, 0.3, 1.0]), Material { specular: 0.25466, ..glass("water") }, at(1.0, 0.16, 1.2));
    Ok(d)
}

fn pane() -> Result<Described> {
    let mut d = stage("pane")?;
    let upright = |x, z, degrees| turned(x, 0.9, z, [90.0, degrees, 0.0]);
    d.shape(Shape::Plane { size: 1.6 }, sheet("clear", [1.0; 3]), upright(-0.6, 0.6, 20.0));
    d.shape(Shape::Plane { size: 1.4 }, sheet("stained", [0.9, 0.6, 0.2]), upright(0.7, 1.2, -35.0));
    Ok(d)
}

/// A leaf that is green within and clear at its corners, 64 x 64.
fn leaf() -> Result<Vec<u8>> {
    let texel = |x: u32, y: u32| {
        let [u, v] = [x, y].map(|p| (f64::from(p) + 0.5) / 32.0 - 1.0);
        let share = ((1.05 - (u * u + v * v).sqrt()) / 0.5).clamp(0.0, 1.0);
        let vein = 0.5 + 0.5 * (6.0 * u).cos();
        Rgba([60.0 + 90.0 * vein, 150.0 + 50.0 * v, 40.0, 255.0 * share].map(|c| c as u8))
    };
    let mut bytes = Cursor::new(Vec::new());
    ImageBuffer::from_fn(64, 64, texel).write_to(&mut bytes, ImageFormat::Png)?;
    Ok(bytes.into_inner())
}

/// Adds `count` cards in a row behind each other, from `x` along z.
fn cards(d: &mut Described, count: u8, x: f64) -> Result<()> {
    d.files.push(("leaf.png".into(), leaf()?));
    for i in 0..count {
        let (f, name) = (f64::from(i), format!("card_{i}"));
        let opacity = Some(0.95 - 0.05 * f32::from(i));
        let material = Material { base_color_texture: Some("leaf.png".into()), opacity, ..matte(&name, [1.0; 3]) };
        d.shape(Shape::Plane { size: 0.9 }, material, turned(x + 0.35 * f, 0.6, 1.2 - 0.4 * f, [80.0, 25.0 * f as f32, 0.0]));
    }
    Ok(())
}

fn leaf_cards() -> Result<Described> {
    let mut d = stage("leaf_cards")?;
    cards(&mut d, 5, -1.1)?;
    d.shape(ball(0.4), Material { opacity: Some(0.4), ..matte("gauze", [0.8, 0.7, 0.6]) }, at(0.9, 0.41, 1.1));
    Ok(d)
}

fn partly_clear() -> Result<Described> {
    let mut d = stage("partly_clear")?;
    // Glass whose opaque part is a Lambertian one would need an index of 1; the lobes of renderers differ by little here.
    let milky = Material { transmission: 0.6, base_color: [0.8, 0.9, 0.95], specular: 0.0, ..glass("milky") };
    d.shape(ball(0.8), milky, at(0.0, 0.81, 0.4));
    Ok(d)
}

fn faded_glass() -> Result<Described> {
    let mut d = stage("faded_glass")?;
    d.shape(ball(0.8), Material { opacity: Some(0.5), ..glass("faded") }, at(0.0, 0.81, 0.4));
    Ok(d)
}

fn lamp_room() -> Result<Described> {
    let mut d = Described::new("lamp_room", look([0.0, 1.4, 3.6], [0.0, 1.1, 0.0], 46.0), Sky::Uniform { radiance: [0.0; 3] });
    d.scene.environment.source = EnvironmentSource::Constant([0.02; 3]);
    let wall = |name: &str, color| matte(name, color);
    d.shape(slab([4.0, 0.2, 8.0]), wall("floor", [0.6, 0.55, 0.5]), at(0.0, -0.1, 0.0));
    d.shape(slab([4.0, 0.2, 8.0]), wall("ceiling", [0.7; 3]), at(0.0, 2.9, 0.0));
    d.shape(slab([4.4, 3.2, 0.2]), wall("back", [0.65, 0.65, 0.6]), at(0.0, 1.4, -1.9));
    d.shape(slab([0.2, 2.8, 8.0]), wall("left", [0.6, 0.15, 0.1]), at(-2.0, 1.4, 0.0));
    d.shape(slab([0.2, 2.8, 8.0]), wall("right", [0.12, 0.4, 0.15]), at(2.0, 1.4, 0.0));
    let lamp = Material { emissive: [6.0, 5.5, 5.0], double_sided: false, ..matte("lamp", [0.0; 3]) };
    d.shape(Shape::Plane { size: 1.6 }, lamp, turned(0.0, 2.79, -0.2, [180.0, 0.0, 0.0]));
    d.shape(ball(0.5), glass("glass"), at(-0.8, 0.51, -0.3));
    let amber = Material { attenuation_color: [0.9, 0.5, 0.1], attenuation_distance: 0.5, ..glass("amber") };
    d.shape(slab([0.7; 3]), amber, turned(0.85, 0.36, -0.7, [0.0, 35.0, 0.0]));
    d.shape(Shape::Plane { size: 1.1 }, sheet("pane", [0.9, 0.95, 1.0]), turned(0.6, 0.9, 0.5, [90.0, -30.0, 0.0]));
    cards(&mut d, 3, -0.9)?;
    Ok(d)
}
