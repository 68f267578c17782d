//! Convolution of the sphere with a radially symmetric lobe, by a tree of solid-angle cells.
//!
//! Each cell holds its energy, the direction its energy comes from on average and its geometric mean direction. A cell that is
//! small against its distance from the lobe's axis stands for all its texels, so far cells are large and near ones fine. Since a
//! cell radiates from its energy's own direction, a sun keeps its place and all of its energy in every cell that holds it; the
//! lobe's norm is summed over the same cells, so a constant environment stays exactly constant.

use crate::environment::Environment;
use crate::image::{Image, Rgb};
use glam::{Vec2, Vec3A};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Width of the finest layer; 0.7 degrees, a third of the narrowest lobe's half-width.
const FINEST_WIDTH: usize = 512;
/// Layers of the tree: 512 x 256 down to 4 x 2.
const LAYERS: usize = 8;
/// Largest size of a cell as a share of its distance from the axis (or of the lobe's width, if that is more).
const OPENING: f32 = 0.25;
/// A block of output texels shares one list of cells.
const BLOCK: usize = 4;
const LANES: usize = BLOCK * BLOCK;

/// The lobe about an axis a, as a function of c = a.w.
#[derive(Clone, Copy, Debug)]
pub enum Kernel {
    /// max(0, c).
    Cosine,
    /// D(h) max(0, c), h halfway between a and w: the split sum's lobe with n = v = a.
    Ggx {
        /// Squared roughness, > 0.
        alpha: f32,
    },
}

#[derive(Clone, Copy)]
struct Cell {
    /// Radiance times solid angle.
    energy: Vec3A,
    /// Unit mean direction of the energy.
    source: Vec3A,
    /// Unit mean direction of the area.
    centre: Vec3A,
    solid_angle: f32,
    /// Longer side in radians: cells are as high as they are wide at the equator.
    size: f32,
}

/// Cells of one environment in map space (rotation and intensity left to the tables made from it).
pub struct Pyramid {
    /// `layers[l]` is row-major, `FINEST_WIDTH >> l` wide and half as high.
    layers: Vec<Vec<Cell>>,
}

impl Pyramid {
    pub fn new(environment: &Environment) -> Self {
        let (width, height) = (FINEST_WIDTH, FINEST_WIDTH / 2);
        let plain = Environment { rotation: 0.0, intensity: 1.0, ..environment.clone() };
        // Four texels a cell along each axis are as many as the place of a light inside its cell needs.
        let plain = plain.downsampled(plain.map.width.min(4 * width), plain.map.height.min(4 * height));
        let area = plain.downsampled(plain.map.width.min(width), plain.map.height.min(height));
        // Where the energy inside a cell comes from, if the map is finer than the cells.
        let moments =
            (area.map.width == width && area.map.height == height && plain.map.pixels.len() > width * height).then(|| {
                let columns = plain.map.width;
                let moment = |i: usize| {
                    let texel = Vec3A::from_array(plain.map.pixels[i]);
                    (plain.texel_direction(i % columns, i / columns) * texel.element_sum()).to_array()
                };
                let pixels = (0..plain.map.pixels.len()).into_par_iter().map(moment).collect();
                plain.with_map(Image { pixels, ..plain.map }).downsampled(width, height)
            });
        let grid = Environment { map: Rgb::filled(width, height, [0.0; 3]), rotation: 0.0, intensity: 1.0 };
        let finest: Vec<Cell> = (0..width * height)
            .into_par_iter()
            .map(|i| {
                let (x, y) = (i % width, i / width);
                // A map coarser than the cells is bilinear between its texels, as everywhere.
                let radiance = if area.map.width == width && area.map.height == height {
                    area.map.pixels[i]
                } else {
                    area.radiance_uv(Vec2::new((x as f32 + 0.5) / width as f32, (y as f32 + 0.5) / height as f32))
                };
                let solid_angle = grid.texel_solid_angle(y);
                let centre = grid.texel_direction(x, y);
                let moment = moments.as_ref().and_then(|m| Vec3A::from_array(m.map.pixels[i]).try_normalize());
                let energy = Vec3A::from_array(radiance) * solid_angle;
                Cell { energy, source: moment.unwrap_or(centre), centre, solid_angle, size: 2.0 * PI / width as f32 }
            })
            .collect();
        let mut layers = vec![finest];
        for layer in 1..LAYERS {
            let width = FINEST_WIDTH >> layer;
            let fine = &layers[layer - 1];
            let coarse = (0..width * (width / 2))
                .map(|i| {
                    let (x, y) = (i % width, i / width);
                    let first = 2 * y * 2 * width + 2 * x;
                    merge(
                        [fine[first], fine[first + 1], fine[first + 2 * width], fine[first + 2 * width + 1]],
                        2.0 * PI / width as f32,
                    )
                })
                .collect();
            layers.push(coarse);
        }
        Self { layers }
    }

    /// The environment convolved with the normalised `kernel`, as a map of `width x height` (multiples of 4).
    pub fn convolve(&self, kernel: Kernel, width: usize, height: usize) -> Rgb {
        let grid = Environment { map: Rgb::filled(width, height, [0.0; 3]), rotation: 0.0, intensity: 1.0 };
        let mut pixels = vec![[0.0; 3]; width * height];
        pixels.par_chunks_mut(width * BLOCK).enumerate().for_each(|(block_row, rows)| {
            let mut lists = Lists::default();
            for block_column in 0..width / BLOCK {
                let axes: [Vec3A; LANES] = std::array::from_fn(|lane| {
                    grid.texel_direction(block_column * BLOCK + lane % BLOCK, block_row * BLOCK + lane / BLOCK)
                });
                self.collect(kernel, &axes, &mut lists);
                let values = match kernel {
                    Kernel::Cosine => lists.sum(&axes, |c| c.max(0.0)),
                    Kernel::Ggx { alpha } => {
                        // 1 - (n.h)^2 (1 - alpha^2) with (n.h)^2 = (1 + c) / 2, written in 1 - c to keep its digits at the peak.
                        let (a2, slope) = (alpha * alpha, 0.5 * (1.0 - alpha * alpha));
                        lists.sum(&axes, move |c| {
                            let base = a2 + slope * (1.0 - c);
                            // Scaled to 1 at the peak; the scale cancels against the norm.
                            let d = a2 / base;
                            d * d * c.max(0.0)
                        })
                    }
                };
                for (lane, value) in values.into_iter().enumerate() {
                    rows[lane / BLOCK * width + block_column * BLOCK + lane % BLOCK] = value;
                }
            }
        });
        Image { width, height, pixels }
    }

    /// Cells that together cover the lobe about each of `axes`.
    fn collect(&self, kernel: Kernel, axes: &[Vec3A; LANES], lists: &mut Lists) {
        lists.split.clear();
        lists.whole.clear();
        let middle = axes.iter().sum::<Vec3A>().normalize();
        let block_radius = axes.iter().map(|axis| axis.distance(middle)).fold(0.0, f32::max);
        // A lobe falls to a quarter of its peak 2 alpha from the axis; broad lobes need the horizon resolved instead.
        let (lobe, largest) = match kernel {
            Kernel::Cosine => (1.0, 0.1),
            Kernel::Ggx { alpha } => (2.0 * alpha, if alpha < 0.25 { 0.25 } else { 0.1 }),
        };
        let coarsest = LAYERS - 1;
        let mut stack: Vec<(usize, usize, usize)> = (0..self.layers[coarsest].len())
            .map(|i| (coarsest, i % (FINEST_WIDTH >> coarsest), i / (FINEST_WIDTH >> coarsest)))
            .collect();
        while let Some((layer, x, y)) = stack.pop() {
            let width = FINEST_WIDTH >> layer;
            let cell = &self.layers[layer][y * width + x];
            let reach = block_radius + 0.75 * cell.size;
            // Below every horizon of the block.
            if cell.centre.dot(middle) < -reach {
                continue;
            }
            let distance = (cell.centre.distance(middle) - reach).max(0.0);
            if layer > 0 && cell.size > (OPENING * (lobe * lobe + distance * distance).sqrt()).min(largest) {
                stack.extend([(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| (layer - 1, 2 * x + dx, 2 * y + dy)));
            } else if cell.source == cell.centre {
                lists.whole.push(*cell);
            } else {
                lists.split.push(*cell);
            }
        }
    }
}

fn merge(children: [Cell; 4], size: f32) -> Cell {
    let energy: Vec3A = children.iter().map(|c| c.energy).sum();
    let solid_angle: f32 = children.iter().map(|c| c.solid_angle).sum();
    let weighted = |weight: fn(&Cell) -> f32, direction: fn(&Cell) -> Vec3A| {
        children.iter().map(|c| direction(c) * weight(c)).sum::<Vec3A>().try_normalize()
    };
    let centre = weighted(|c| c.solid_angle, |c| c.centre).unwrap_or(children[0].centre);
    let source = weighted(|c| c.energy.element_sum(), |c| c.source).unwrap_or(centre);
    Cell { energy, source, centre, solid_angle, size }
}

/// Cells of one block's lobes: those with one direction, and those whose energy and area have directions of their own.
#[derive(Default)]
struct Lists {
    whole: Vec<Cell>,
    split: Vec<Cell>,
}

impl Lists {
    /// Weighted mean radiance about each axis. Loops run over lanes innermost so that they vectorise.
    fn sum(&self, axes: &[Vec3A; LANES], kernel: impl Fn(f32) -> f32) -> [[f32; 3]; LANES] {
        let (x, y, z) = (axes.map(|a| a.x), axes.map(|a| a.y), axes.map(|a| a.z));
        let weigh = |d: Vec3A| -> [f32; LANES] { std::array::from_fn(|i| kernel(x[i] * d.x + y[i] * d.y + z[i] * d.z)) };
        let mut sums = [[0.0_f32; LANES]; 4];
        for cell in &self.whole {
            let weights = weigh(cell.centre);
            for (sum, factor) in sums.iter_mut().zip([cell.energy.x, cell.energy.y, cell.energy.z, cell.solid_angle]) {
                for i in 0..LANES {
                    sum[i] += weights[i] * factor;
                }
            }
        }
        for cell in &self.split {
            let (energy_weights, area_weights) = (weigh(cell.source), weigh(cell.centre));
            for (sum, factor) in sums.iter_mut().zip([cell.energy.x, cell.energy.y, cell.energy.z]) {
                for i in 0..LANES {
                    sum[i] += energy_weights[i] * factor;
                }
            }
            for i in 0..LANES {
                sums[3][i] += area_weights[i] * cell.solid_angle;
            }
        }
        // The axis itself lies in the lobe, so the norm is positive.
        std::array::from_fn(|i| [sums[0][i], sums[1][i], sums[2][i]].map(|s| s / sums[3][i].max(f32::MIN_POSITIVE)))
    }
}
