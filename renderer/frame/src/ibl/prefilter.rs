//! Convolution of the sphere with a radially symmetric lobe, by a tree of solid-angle cells.
//!
//! Each cell holds its energy, the direction its energy comes from on average and its geometric mean direction. A cell that is
//! small against its distance from the lobe's axis stands for all its texels, so far cells are large and near ones fine. Since a
//! cell radiates from its energy's own direction, a sun keeps its place and all of its energy in every cell that holds it; the
//! lobe's norm is summed over the same cells, so a constant environment stays exactly constant.

use crate::environment::Environment;
use crate::image::{Image, Rgb};
use glam::{Vec2, Vec3A, Vec4};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Width of the finest layer; 0.7 degrees, a third of the narrowest lobe's half-width.
const FINEST_WIDTH: usize = 512;
/// Layers of the tree: 512 x 256 down to 4 x 2.
const LAYERS: usize = 8;
/// Largest size of a cell as a share of its distance from the axis (or of the lobe's width, if that is more).
const OPENING: f32 = 0.25;
/// The same for a narrow lobe. Most texels are the narrowest lobe's, and with larger cells its error is about that of the next
/// two (docs/measurements/renderer-notes.md, prefiltered environments).
const NARROW_OPENING: f32 = 0.35;
/// Squared roughness below which a lobe is narrow.
const NARROW: f32 = 0.05;
/// Columns and rows of a block of output texels, which share one list of cells.
const BLOCK: [usize; 2] = [8, 4];
const LANES: usize = BLOCK[0] * BLOCK[1];

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
}

/// The mean directions of 2 x 2 cells: those of each row from left to right.
struct Quad {
    x: Vec4,
    y: Vec4,
    z: Vec4,
}

/// What decides about the cells of a layer, by the cosine between their direction and the middle of a block's axes.
struct Limits {
    /// Cells below it are below every horizon of the block.
    horizon: f32,
    /// Cells above it are too large for their distance. No cell of the finest layer is.
    near: f32,
}

/// Cells of one environment in map space (rotation and intensity left to the tables made from it).
pub struct Pyramid {
    /// `layers[l]` is row-major, `FINEST_WIDTH >> l` wide and half as high.
    layers: Vec<Vec<Cell>>,
    /// The directions of `layers[l]`, row-major, half as wide and high.
    quads: Vec<Vec<Quad>>,
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
                Cell { energy, source: moment.unwrap_or(centre), centre, solid_angle }
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
                    merge([fine[first], fine[first + 1], fine[first + 2 * width], fine[first + 2 * width + 1]])
                })
                .collect();
            layers.push(coarse);
        }
        let quads = layers.iter().enumerate().map(|(layer, cells)| quads(cells, FINEST_WIDTH >> layer)).collect();
        Self { layers, quads }
    }

    /// The environment convolved with the normalised `kernel`, as a map of `width x height` (multiples of 8 and 4).
    pub fn convolve(&self, kernel: Kernel, width: usize, height: usize) -> Rgb {
        let grid = Environment { map: Rgb::filled(width, height, [0.0; 3]), rotation: 0.0, intensity: 1.0 };
        let mut pixels = vec![[0.0; 3]; width * height];
        pixels.par_chunks_mut(width * BLOCK[1]).enumerate().for_each(|(block_row, rows)| {
            let mut lists = Lists::default();
            for block_column in 0..width / BLOCK[0] {
                let axes: [Vec3A; LANES] = std::array::from_fn(|lane| {
                    grid.texel_direction(block_column * BLOCK[0] + lane % BLOCK[0], block_row * BLOCK[1] + lane / BLOCK[0])
                });
                self.collect(kernel, &axes, &mut lists);
                let values = pulp::Arch::new().dispatch(Sum { lists: &lists, axes: &axes, kernel });
                for (lane, value) in values.into_iter().enumerate() {
                    rows[lane / BLOCK[0] * width + block_column * BLOCK[0] + lane % BLOCK[0]] = value;
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
        let [x, y, z] = middle.to_array().map(Vec4::splat);
        let limits: [Limits; LAYERS] = std::array::from_fn(|layer| Limits::new(kernel, layer, block_radius));
        let coarsest = LAYERS - 1;
        let Lists { stack, whole, split } = lists;
        stack.extend((0..self.quads[coarsest].len()).map(|i| (coarsest, i, 0)));
        while let Some((layer, column, row)) = stack.pop() {
            let (width, limits) = (FINEST_WIDTH >> layer, &limits[layer]);
            let quad = &self.quads[layer][row * (width / 2) + column];
            let cosines = quad.x * x + quad.y * y + quad.z * z;
            let above = cosines.cmpge(Vec4::splat(limits.horizon)).bitmask();
            let near = cosines.cmpgt(Vec4::splat(limits.near)).bitmask();
            for (bit, (dx, dy)) in [(0, 0), (1, 0), (0, 1), (1, 1)].into_iter().enumerate() {
                if above & 1 << bit == 0 {
                    continue;
                }
                let (x, y) = (2 * column + dx, 2 * row + dy);
                if near & 1 << bit != 0 {
                    stack.push((layer - 1, x, y));
                    continue;
                }
                let cell = &self.layers[layer][y * width + x];
                let list = if cell.source == cell.centre { &mut *whole } else { &mut *split };
                list.push(*cell);
            }
        }
    }
}

impl Limits {
    fn new(kernel: Kernel, layer: usize, block_radius: f32) -> Self {
        // A lobe falls to a quarter of its peak 2 alpha from the axis; broad lobes need the horizon resolved instead.
        let (lobe, largest, opening) = match kernel {
            Kernel::Cosine => (1.0, 0.1, OPENING),
            Kernel::Ggx { alpha } if alpha < NARROW => (2.0 * alpha, 0.25, NARROW_OPENING),
            Kernel::Ggx { alpha } => (2.0 * alpha, if alpha < 0.25 { 0.25 } else { 0.1 }, OPENING),
        };
        let size = cell_size(layer);
        let reach = block_radius + 0.75 * size;
        // The distance d at which the size is opening sqrt(lobe^2 + d^2).
        let opened = (size / opening).powi(2) - lobe * lobe;
        let near = if layer == 0 {
            f32::INFINITY
        } else if size > largest {
            f32::NEG_INFINITY
        } else if opened > 0.0 {
            // Chords of unit vectors: their squared length is 2 - 2 cos.
            1.0 - 0.5 * (opened.sqrt() + reach).powi(2)
        } else {
            f32::INFINITY
        };
        Self { horizon: -reach, near }
    }
}

/// Longer side of the cells of a layer in radians.
fn cell_size(layer: usize) -> f32 {
    2.0 * PI / (FINEST_WIDTH >> layer) as f32
}

fn merge(children: [Cell; 4]) -> Cell {
    let energy: Vec3A = children.iter().map(|c| c.energy).sum();
    let solid_angle: f32 = children.iter().map(|c| c.solid_angle).sum();
    let weighted = |weight: fn(&Cell) -> f32, direction: fn(&Cell) -> Vec3A| {
        children.iter().map(|c| direction(c) * weight(c)).sum::<Vec3A>().try_normalize()
    };
    let centre = weighted(|c| c.solid_angle, |c| c.centre).unwrap_or(children[0].centre);
    let source = weighted(|c| c.energy.element_sum(), |c| c.source).unwrap_or(centre);
    Cell { energy, source, centre, solid_angle }
}

/// The directions of the `cells` of a layer that is `width` cells wide.
fn quads(cells: &[Cell], width: usize) -> Vec<Quad> {
    let rows = cells.chunks_exact(2 * width);
    let quads = rows.flat_map(|rows| {
        (0..width / 2).map(move |column| {
            let four = [0, 1, width, width + 1].map(|i| rows[2 * column + i].centre);
            let of = |c: usize| Vec4::from_array(four.map(|centre| centre[c]));
            Quad { x: of(0), y: of(1), z: of(2) }
        })
    });
    quads.collect()
}

/// Cells of one block's lobes: those with one direction, and those whose energy and area have directions of their own.
#[derive(Default)]
struct Lists {
    whole: Vec<Cell>,
    split: Vec<Cell>,
    /// Layer, column and row of quads that are still to be looked at.
    stack: Vec<(usize, usize, usize)>,
}

/// [`Lists::sum`], compiled for several kinds of processors. No operation is fused, so all of them find the same bits.
struct Sum<'a> {
    lists: &'a Lists,
    axes: &'a [Vec3A; LANES],
    kernel: Kernel,
}

impl pulp::NullaryFnOnce for Sum<'_> {
    type Output = [[f32; 3]; LANES];

    #[inline(always)]
    fn call(self) -> Self::Output {
        match self.kernel {
            Kernel::Cosine => self.lists.sum(self.axes, |c| c.max(0.0)),
            Kernel::Ggx { alpha } => {
                // 1 - (n.h)^2 (1 - alpha^2) with (n.h)^2 = (1 + c) / 2, written in 1 - c to keep its digits at the peak.
                let (a2, slope) = (alpha * alpha, 0.5 * (1.0 - alpha * alpha));
                self.lists.sum(self.axes, |c| {
                    let base = a2 + slope * (1.0 - c);
                    // Scaled to 1 at the peak; the scale cancels against the norm.
                    let d = a2 / base;
                    d * d * c.max(0.0)
                })
            }
        }
    }
}

impl Lists {
    /// Weighted mean radiance about each axis. Loops run over lanes innermost so that they vectorise.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // One loop over five arrays.
    fn sum(&self, axes: &[Vec3A; LANES], kernel: impl Fn(f32) -> f32) -> [[f32; 3]; LANES] {
        let (x, y, z) = (axes.map(|a| a.x), axes.map(|a| a.y), axes.map(|a| a.z));
        let weigh = |d: Vec3A, i: usize| kernel(x[i] * d.x + y[i] * d.y + z[i] * d.z);
        let mut sums = [[0.0_f32; LANES]; 4];
        for cell in &self.whole {
            for i in 0..LANES {
                let weight = weigh(cell.centre, i);
                sums[0][i] += weight * cell.energy.x;
                sums[1][i] += weight * cell.energy.y;
                sums[2][i] += weight * cell.energy.z;
                sums[3][i] += weight * cell.solid_angle;
            }
        }
        for cell in &self.split {
            for i in 0..LANES {
                let weight = weigh(cell.source, i);
                sums[0][i] += weight * cell.energy.x;
                sums[1][i] += weight * cell.energy.y;
                sums[2][i] += weight * cell.energy.z;
                sums[3][i] += weigh(cell.centre, i) * cell.solid_angle;
            }
        }
        // The axis itself lies in the lobe, so the norm is positive.
        std::array::from_fn(|i| [sums[0][i], sums[1][i], sums[2][i]].map(|s| s / sums[3][i].max(f32::MIN_POSITIVE)))
    }
}
