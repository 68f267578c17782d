//! Materials that change along a sequence: every frame's picture is, bit for bit, that of a still scene with the materials the
//! frame has.

mod common;

use common::{camera, compile, compile_at, plane, scene, sphere, sunny};
use glam::{Affine3A, Vec3, Vec3A};
use renderflow_renderer::{Mode, RenderScene, Settings, render_with_stats};
use renderflow_scenes::{LoadedScene, Material, Principled};
use std::sync::atomic::AtomicBool;

const FRAMES: usize = 9;

/// Dull balls that become polished metal or glossy paint, a mirror that goes blind, one under clear coat and one that stays.
fn changing() -> LoadedScene {
    let becoming = |first: Principled, base_color: [f32; 3], [metallic, roughness, specular]: [f32; 3]| {
        let change = Some(Principled { base_color: base_color.into(), metallic, roughness, specular, ..first });
        Material { change, ..Material::from(first) }
    };
    let dull = Principled { base_color: Vec3A::new(0.7, 0.3, 0.2), roughness: 0.9, specular: 0.0, ..Principled::default() };
    let mirror = Principled { metallic: 1.0, roughness: 0.05, ..Principled::default() };
    let materials = [
        becoming(dull, [0.9, 0.8, 0.4], [1.0, 0.1, 0.5]),
        becoming(dull, [0.2, 0.3, 0.9], [0.0, 0.05, 1.0]),
        becoming(mirror, [0.1; 3], [0.0, 1.0, 0.0]),
        becoming(Principled { clearcoat: 1.0, ..dull }, [0.0; 3], [0.5, 0.3, 0.2]),
        dull.into(),
    ];
    let floor = becoming(Principled { roughness: 1.0, ..Principled::default() }, [0.8; 3], [0.0, 0.1, 0.5]);
    let mut parts = vec![(plane(10.0), floor, Affine3A::IDENTITY)];
    for (material, x) in materials.into_iter().zip([-2.0f32, -1.0, 0.0, 1.0, 2.0]) {
        let place = Affine3A::from_translation(Vec3::new(x, 0.45, 0.0)) * Affine3A::from_scale(Vec3::splat(0.45));
        parts.push((sphere(8, true), material, place));
    }
    let mut loaded = scene(parts, sunny(), camera([0.0, 2.0, 5.0], [0.0, 0.5, 0.0], 45.0, 40, 24));
    loaded.cameras = (0..FRAMES).map(|f| camera([0.1 * f as f32, 2.0, 5.0], [0.0, 0.5, 0.0], 45.0, 40, 24)).collect();
    loaded
}

/// The scene with the materials of `frame`, for ever.
fn frozen(loaded: &LoadedScene, frame: usize) -> LoadedScene {
    let materials = (0..loaded.materials.len()).map(|m| loaded.materials[m].at(frame as f64, loaded.cameras.len())).collect();
    LoadedScene { materials, ..loaded.clone() }
}

#[test]
fn frames_equal_those_of_still_scenes() {
    let loaded = changing();
    let mut walked = compile(&loaded);
    let mut light_paths = vec![];
    for frame in [0, 1, 8, 4, 4, 0, 100] {
        walked.set_frame(frame);
        let still = compile_at(&frozen(&loaded, frame), frame);
        assert_eq!(walked.features(), still.features(), "frame {frame}");
        for bsdf in [Mode::Conserving, Mode::Published] {
            let settings = Settings { spp: 16, bsdf, ..Settings::default() };
            let render = |scene| render_with_stats(scene, &settings, &|_, _| (), &AtomicBool::new(false)).expect("renders");
            let (picture, stats) = render(&walked);
            let (same, same_stats) = render(&still);
            assert!(picture == same && stats == same_stats, "frame {frame} differs from that of a still scene");
            light_paths.push(stats.light_paths);
        }
    }
    // The bodies that light paths are aimed at change, too.
    light_paths.sort_unstable();
    light_paths.dedup();
    assert!(light_paths.len() > 2, "{light_paths:?} light paths");
}

#[test]
fn the_ends_are_what_was_asked_for() {
    let loaded = changing();
    let at = |frame| loaded.materials[1].at(frame as f64, loaded.cameras.len());
    let (first, last) = (&loaded.materials[1], at(FRAMES - 1));
    assert_eq!(at(0), Material { change: None, ..first.clone() });
    let Principled { metallic, roughness, specular, base_color, .. } = last.surface;
    assert_eq!([metallic, roughness, specular], [1.0, 0.1, 0.5]);
    assert_eq!(base_color.to_array(), [0.9, 0.8, 0.4]);
    assert_eq!(at(4).surface.metallic, 0.5);
    assert_eq!(at(1000), last);
}

/// A target out of range is refused as a value out of range is.
#[test]
fn targets_out_of_range_are_refused() {
    let mut loaded = changing();
    loaded.materials[1].change = loaded.materials[1].change.map(|last| Principled { roughness: f32::NAN, ..last });
    let refused = RenderScene::compile(&loaded).err().map(|e| e.to_string()).unwrap_or_default();
    assert!(refused.contains("materials/1") && refused.contains("NaN"), "{refused:?}");
}
