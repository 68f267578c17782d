//! Meshes and images of the benchmark scenes that no parametric shape has: dense bodies, terrain, foliage, textures. All made by
//! arithmetic, written as glTF and PNG, so that every renderer reads the same files.

use anyhow::{Context, Result};
use glam::{DVec2, DVec3, Vec3};
use image::{ImageFormat, RgbImage};
use renderflow_scenes::Mesh;
use serde_json::json;
use std::f64::consts::{PI, TAU};
use std::io::Cursor;

/// Triangles with or without unit normals, metres.
pub struct Model {
    positions: Vec<[f32; 3]>,
    /// One a position; empty = flat shading.
    normals: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
}

impl Model {
    /// Triangles.
    pub fn triangle_count(&self) -> usize {
        self.triangles.len()
    }

    /// The mesh as loading it would give it.
    pub fn into_mesh(self, name: &str) -> Mesh {
        let vectors = |list: Vec<[f32; 3]>| list.into_iter().map(Vec3::from).collect();
        Mesh {
            name: name.into(),
            positions: vectors(self.positions),
            normals: vectors(self.normals),
            triangles: self.triangles,
            ..Mesh::default()
        }
    }

    /// A glTF file and the buffer beside it, called `buffer`.
    pub fn gltf(&self, buffer: &str) -> Result<[Vec<u8>; 2]> {
        let mut bytes: Vec<u8> = Vec::new();
        let mut views = Vec::new();
        let mut push = |data: &mut dyn Iterator<Item = [u8; 4]>, target: u32| {
            let start = bytes.len();
            bytes.extend(data.flatten());
            views.push(json!({"buffer": 0, "byteOffset": start, "byteLength": bytes.len() - start, "target": target}));
        };
        push(&mut self.triangles.iter().flatten().map(|i| i.to_le_bytes()), 34963);
        push(&mut self.positions.iter().flatten().map(|v| v.to_le_bytes()), 34962);
        let mut attributes = json!({"POSITION": 1});
        if !self.normals.is_empty() {
            push(&mut self.normals.iter().flatten().map(|v| v.to_le_bytes()), 34962);
            attributes["NORMAL"] = 2.into();
        }
        let bound = |pick: fn(f32, f32) -> f32, start: f32| {
            self.positions.iter().fold([start; 3], |a, p| [pick(a[0], p[0]), pick(a[1], p[1]), pick(a[2], p[2])])
        };
        let vectors =
            |view: u32, count: usize| json!({"bufferView": view, "componentType": 5126, "count": count, "type": "VEC3"});
        let mut accessors = vec![
            json!({"bufferView": 0, "componentType": 5125, "count": 3 * self.triangles.len(), "type": "SCALAR"}),
            vectors(1, self.positions.len()),
        ];
        accessors[1]["min"] = json!(bound(f32::min, f32::INFINITY));
        accessors[1]["max"] = json!(bound(f32::max, f32::NEG_INFINITY));
        if !self.normals.is_empty() {
            accessors.push(vectors(2, self.normals.len()));
        }
        let document = json!({
            "asset": {"version": "2.0", "generator": "renderflow"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": attributes, "indices": 0}]}],
            "accessors": accessors,
            "bufferViews": views,
            "buffers": [{"uri": buffer, "byteLength": bytes.len()}],
        });
        Ok([serde_json::to_vec(&document)?, bytes])
    }

    /// A grid of `columns x rows` cells with a point at `(i, j)`, normals averaged over the faces around a point. `wrap` joins
    /// the last column to the first.
    fn grid(columns: usize, rows: usize, wrap: bool, point: impl Fn(usize, usize) -> DVec3) -> Self {
        let width = if wrap { columns } else { columns + 1 };
        let points: Vec<DVec3> = (0..=rows).flat_map(|j| (0..width).map(move |i| (i, j))).map(|(i, j)| point(i, j)).collect();
        let at = |i: usize, j: usize| j * width + i % width;
        let mut triangles = Vec::with_capacity(2 * columns * rows);
        for j in 0..rows {
            for i in 0..columns {
                let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
                for t in [[a, b, c], [a, c, d]] {
                    // The triangles at a pole of a sphere have no area.
                    if t.iter().enumerate().all(|(k, &v)| points[v] != points[t[(k + 1) % 3]]) {
                        triangles.push(t);
                    }
                }
            }
        }
        let mut sums = vec![DVec3::ZERO; points.len()];
        for &[a, b, c] in &triangles {
            let across = (points[b] - points[a]).cross(points[c] - points[a]);
            for v in [a, b, c] {
                sums[v] += across;
            }
        }
        let single = |v: DVec3| v.as_vec3().to_array();
        Self {
            positions: points.iter().map(|&p| single(p)).collect(),
            normals: sums.iter().map(|n| single(n.normalize_or(DVec3::Y))).collect(),
            triangles: triangles.iter().map(|t| t.map(|v| v as u32)).collect(),
        }
    }
}

/// A hash of a lattice point to 0..1 (the mixer of PCG, O'Neill 2014, once a coordinate).
fn unit(words: [u32; 3]) -> f64 {
    let mut state = 0x9e37_79b9u32;
    for word in words {
        state = (state ^ word).wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        state = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
        state ^= state >> 22;
    }
    f64::from(state >> 8) / f64::from(1u32 << 24)
}

/// Value noise, 0..=1, that repeats every `period` cells.
fn noise(p: DVec2, period: u32, seed: u32) -> f64 {
    let cell = p.floor();
    let f = p - cell;
    let fade = f * f * (DVec2::splat(3.0) - 2.0 * f);
    let corner = |dx: i64, dy: i64| {
        let wrap = |v: f64, d: i64| (v as i64 + d).rem_euclid(i64::from(period)) as u32;
        unit([wrap(cell.x, dx), wrap(cell.y, dy), seed])
    };
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    mix(mix(corner(0, 0), corner(1, 0), fade.x), mix(corner(0, 1), corner(1, 1), fade.x), fade.y)
}

/// Sum of `octaves` of [`noise`], 0..=1; `p` in periods.
fn fractal(p: DVec2, cells: u32, octaves: u32, seed: u32) -> f64 {
    let (mut sum, mut weight, mut total, mut cells) = (0.0, 1.0, 0.0, cells);
    for octave in 0..octaves {
        sum += weight * noise(p * f64::from(cells), cells, seed + octave);
        total += weight;
        weight *= 0.5;
        cells *= 2;
    }
    sum / total
}

/// A sphere of about `radius` with bumps and fine ripples, some `2 * cells^2` triangles.
pub fn displaced_sphere(radius: f64, cells: usize) -> Model {
    Model::grid(cells, cells, true, |i, j| {
        // From the south pole up: cells are counter-clockwise from outside.
        let (longitude, latitude) = (TAU * i as f64 / cells as f64, PI * (j as f64 / cells as f64 - 0.5));
        let across = if j == 0 || j == cells { 0.0 } else { latitude.cos() };
        let d = DVec3::new(across * longitude.sin(), latitude.sin(), across * longitude.cos());
        let bumps = (5.0 * d.x + 1.3).sin() * (6.0 * d.y).sin() * (5.0 * d.z - 0.4).cos();
        let ripples = (31.0 * d.x + 2.0 * bumps).sin() * (29.0 * d.y).sin() * (33.0 * d.z).sin();
        d * radius * (1.0 + 0.14 * bumps + 0.025 * ripples)
    })
}

/// Hills on a square of `size` metres, highest about a tenth of it, `2 * cells^2` triangles; level near the middle.
pub fn terrain(size: f64, cells: usize) -> Model {
    Model::grid(cells, cells, false, |i, j| {
        // Along z first: faces look up.
        let (x, z) = (j as f64 / cells as f64 - 0.5, i as f64 / cells as f64 - 0.5);
        let away = ((x * x + z * z).sqrt() * 4.0).min(1.0);
        let height = fractal(DVec2::new(x + 0.5, z + 0.5), 6, 7, 17) - 0.5;
        DVec3::new(x, 0.2 * height * (0.06 + 0.94 * away * away), z) * size
    })
}

/// Crowns of single leaves (two flat triangles each) about the given trunks: (foot, height of the crown's middle, crown's
/// radius).
pub fn foliage(trunks: &[(DVec3, f64, f64)], leaves: usize, leaf: f64) -> Model {
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for (tree, &(foot, height, radius)) in trunks.iter().enumerate() {
        for number in 0..leaves {
            let random = |k: u32| unit([tree as u32, number as u32, k]);
            let direction = |a: f64, b: f64| {
                let (y, turn) = (2.0 * a - 1.0, TAU * b);
                let across = (1.0 - y * y).max(0.0).sqrt();
                DVec3::new(across * turn.cos(), y, across * turn.sin())
            };
            // Denser towards the outside, as leaves are.
            let place = direction(random(0), random(1)) * radius * random(2).powf(0.25);
            let centre = foot + DVec3::new(place.x, height + 1.2 * place.y, place.z);
            let normal = (direction(random(3), random(4)) + DVec3::new(0.0, 0.7, 0.0)).normalize_or(DVec3::Y);
            let (right, up) = normal.any_orthonormal_pair();
            let turn = DVec2::from_angle(TAU * random(5)) * leaf * (0.6 + 0.8 * random(6));
            let (long, wide) = ((right * turn.x + up * turn.y), (up * turn.x - right * turn.y) * 0.45);
            let first = positions.len() as u32;
            positions.extend([centre - long, centre + wide, centre + long, centre - wide].map(|p| p.as_vec3().to_array()));
            triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
    }
    Model { positions, normals: Vec::new(), triangles }
}

/// Images of a material, PNG: base colour (sRGB), roughness (green) and metallic (blue), normals (OpenGL).
pub struct Maps {
    /// Base colour.
    pub color: Vec<u8>,
    /// Roughness and metallic.
    pub surface: Vec<u8>,
    /// Tangent-space normals.
    pub normal: Vec<u8>,
}

/// What a texture is made of at a point: height in texture widths, colour (sRGB), roughness, metallic.
type Texel = (f64, [f64; 3], f64, f64);

fn maps(edge: u32, texel: impl Fn(DVec2) -> Texel) -> Result<Maps> {
    let size = f64::from(edge);
    let at = |x: u32, y: u32| texel(DVec2::new(f64::from(x % edge) + 0.5, f64::from(y % edge) + 0.5) / size);
    let byte = |v: f64| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    let png = |pixel: &dyn Fn(u32, u32) -> [f64; 3]| -> Result<Vec<u8>> {
        let mut out = Cursor::new(Vec::new());
        RgbImage::from_fn(edge, edge, |x, y| image::Rgb(pixel(x, y).map(byte)))
            .write_to(&mut out, ImageFormat::Png)
            .context("encoding a texture")?;
        Ok(out.into_inner())
    };
    Ok(Maps {
        color: png(&|x, y| at(x, y).1)?,
        surface: png(&|x, y| {
            let (_, _, roughness, metallic) = at(x, y);
            [1.0, roughness, metallic]
        })?,
        normal: png(&|x, y| {
            // v runs down, the map's +y up.
            let slope = |a: Texel, b: Texel| (b.0 - a.0) * 0.5 * size;
            let across = slope(at(x + edge - 1, y), at(x + 1, y));
            let up = slope(at(x, y + 1), at(x, y + edge - 1));
            (DVec3::new(-across, -up, 1.0).normalize() * 0.5 + DVec3::splat(0.5)).to_array()
        })?,
    })
}

/// Rows of rough bricks in mortar.
pub fn bricks(edge: u32) -> Result<Maps> {
    maps(edge, |p| {
        let row = (p.y * 8.0).floor();
        let along = p.x * 4.0 + if row as i64 % 2 == 0 { 0.0 } else { 0.5 };
        let (u, v) = (along.rem_euclid(1.0), (p.y * 8.0).rem_euclid(1.0));
        let rim = (u.min(1.0 - u) * 2.0).min(v.min(1.0 - v));
        let brick = ((rim - 0.05) / 0.07).clamp(0.0, 1.0);
        let tone = unit([along.floor().rem_euclid(4.0) as u32, row as u32, 3]);
        let grain = fractal(p, 32, 3, 40);
        let color = [0.62 + 0.2 * tone, 0.3 + 0.12 * tone, 0.24].map(|c| c * (0.75 + 0.5 * grain));
        let mortar = [0.72, 0.7, 0.66].map(|c| c * (0.8 + 0.4 * grain));
        let mixed = [0, 1, 2].map(|c| mortar[c] + (color[c] - mortar[c]) * brick);
        (0.012 * brick + 0.004 * grain, mixed, 0.9 - 0.25 * brick * tone, 0.0)
    })
}

/// Metal with scratches and patches of worn paint.
pub fn worn_metal(edge: u32) -> Result<Maps> {
    maps(edge, |p| {
        let patch = ((fractal(p, 5, 5, 70) - 0.47) / 0.05).clamp(0.0, 1.0);
        let grain = fractal(p, 48, 2, 90);
        let paint = [0.16, 0.42, 0.5];
        let bare = [0.86, 0.8, 0.72];
        let color = [0, 1, 2].map(|c| (bare[c] + (paint[c] - bare[c]) * patch) * (0.85 + 0.3 * grain));
        (0.003 * patch + 0.0015 * grain, color, 0.18 + 0.3 * grain + 0.2 * patch, 1.0 - patch)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six times the volume, positive where faces look outwards.
    fn volume(model: &Model) -> f64 {
        let at = |v: u32| Vec3::from(model.positions[v as usize]).as_dvec3();
        model.triangles.iter().map(|&[a, b, c]| at(a).dot(at(b).cross(at(c)))).sum::<f64>() / 6.0
    }

    #[test]
    fn bodies_look_outwards_and_have_the_size_asked_for() {
        let ball = displaced_sphere(1.0, 64);
        let sphere = 4.0 / 3.0 * PI;
        assert!((0.8..1.2).contains(&(volume(&ball) / sphere)), "{}", volume(&ball));
        assert!((7800..=8192).contains(&ball.triangle_count()));
        let land = terrain(10.0, 32);
        assert_eq!(land.triangle_count(), 2048);
        assert!(land.normals.iter().all(|n| n[1] > 0.0));
    }

    #[test]
    fn textures_repeat_without_a_seam() {
        for y in 0..20 {
            let y = f64::from(y) / 20.0;
            let jump = fractal(DVec2::new(0.0, y), 5, 4, 1) - fractal(DVec2::new(1.0 - 1e-9, y), 5, 4, 1);
            assert!(jump.abs() < 1e-6, "{jump}");
        }
    }
}
