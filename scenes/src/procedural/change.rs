//! Materials that change along a sequence.

use crate::description::{Material, MaterialChange};
use crate::draw::Draw;
use rand_pcg::Pcg64;

/// Gives up to four of the materials at `candidates` something to become; returns how many.
pub(super) fn change(rng: &mut Pcg64, materials: &mut [Material], candidates: &[usize]) -> usize {
    let mut order = candidates.to_vec();
    for k in 1..order.len() {
        order.swap(k, rng.below(k as u32 + 1) as usize);
    }
    order.truncate(1 + rng.below(4) as usize);
    for &index in &order {
        let material = &mut materials[index];
        material.change = Some(target(rng, material));
    }
    order.len()
}

/// Another colour, another polish, another substance, or all of it.
fn target(rng: &mut Pcg64, material: &Material) -> MaterialChange {
    let (hue, saturation, value) = (rng.between(0.0, 360.0), rng.between(0.3, 0.9), rng.log(0.2, 0.9));
    let color = Pcg64::hsv(hue, saturation, value);
    // Far from what it was: a change that nobody sees is none.
    let roughness = if material.roughness > 0.4 { rng.between(0.06, 0.25) } else { rng.between(0.6, 1.0) };
    let metallic = if material.metallic > 0.5 { 0.0 } else { 1.0 };
    match rng.weighted(&[0.35, 0.25, 0.2, 0.2]) {
        0 => MaterialChange { base_color: Some(color), ..MaterialChange::default() },
        1 => MaterialChange { roughness: Some(roughness), ..MaterialChange::default() },
        2 => MaterialChange { base_color: Some(color), metallic: Some(metallic), ..MaterialChange::default() },
        _ => MaterialChange {
            base_color: Some(color),
            metallic: Some(metallic),
            roughness: Some(roughness),
            specular: Some(rng.between(0.2, 0.9)),
        },
    }
}
