//! Seeded gradient noise in plain arithmetic: the same numbers on every machine.

use glam::DVec3;

/// A well-mixed 32-bit hash of a lattice point (Jenkins-style avalanche over the coordinates).
fn hash(x: i64, y: i64, z: i64, seed: u32) -> u32 {
    let mut h = seed ^ 0x9e37_79b9;
    for c in [x, y, z] {
        h = (h ^ c as u32).wrapping_mul(0x85eb_ca6b);
        h ^= h >> 13;
        h = h.wrapping_mul(0xc2b2_ae35);
        h ^= h >> 16;
    }
    h
}

/// Gradient noise (Perlin 2002: quintic fade, twelve edge gradients), about -1..=1, zero at lattice points.
pub(crate) fn gradient(p: DVec3, seed: u32) -> f64 {
    let cell = p.floor();
    let f = p - cell;
    let fade = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let corner = |dx: i64, dy: i64, dz: i64| {
        let (x, y, z) = (f.x - dx as f64, f.y - dy as f64, f.z - dz as f64);
        let h = hash(cell.x as i64 + dx, cell.y as i64 + dy, cell.z as i64 + dz, seed) >> 28;
        let u = if h < 8 { x } else { y };
        let v = if h < 4 {
            y
        } else if h == 12 || h == 14 {
            x
        } else {
            z
        };
        (if h & 1 == 0 { u } else { -u }) + (if h & 2 == 0 { v } else { -v })
    };
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    let plane = |dz: i64| {
        let low = mix(corner(0, 0, dz), corner(1, 0, dz), fade.x);
        let high = mix(corner(0, 1, dz), corner(1, 1, dz), fade.x);
        mix(low, high, fade.y)
    };
    mix(plane(0), plane(1), fade.z)
}

/// Fractal sum of `octaves` of [`gradient`], each of half the size and half the height; about -1..=1.
pub(crate) fn fractal(p: DVec3, octaves: u32, seed: u32) -> f64 {
    let (mut sum, mut scale, mut weight, mut total) = (0.0, 1.0, 1.0, 0.0);
    for octave in 0..octaves {
        sum += weight * gradient(p * scale, seed.wrapping_add(octave.wrapping_mul(0x9e37)));
        total += weight;
        scale *= 2.0;
        weight *= 0.5;
    }
    sum / total
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_bounded_continuous_and_seeded() {
        let mut range = (0.0f64, 0.0f64);
        for i in 0..20_000 {
            let p = DVec3::new(f64::from(i) * 0.0137, f64::from(i % 91) * 0.11, f64::from(i % 17) * 0.23);
            let n = gradient(p, 7);
            range = (range.0.min(n), range.1.max(n));
            let step = (gradient(p + DVec3::splat(1e-6), 7) - n).abs();
            assert!(step < 1e-4, "jump of {step} at {p}");
        }
        assert!(range.0 > -1.1 && range.1 < 1.1 && range.1 - range.0 > 1.2, "range {range:?}");
        assert_eq!(gradient(DVec3::new(3.0, -2.0, 5.0), 1), 0.0);
        assert_ne!(gradient(DVec3::splat(0.3), 1), gradient(DVec3::splat(0.3), 2));
    }
}
