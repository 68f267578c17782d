//! Work in tiles: which pixels go together, how far it is, and how it stops. Results do not depend on any of it.

use crate::error::{Error, Result};
use crate::sampler::hash;
use rayon::prelude::*;
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Edge of a tile in pixels: neighbouring rays share cache lines of the tree, and there is enough work for many threads.
pub(crate) const TILE: usize = 8;
/// Tiles whose results are held before they are stored: bounds memory to some 60 MB, whatever the picture's size.
const BATCH: usize = 4096;

/// Most pixels whose results are held at a time.
pub(crate) fn most_pixels() -> u64 {
    (BATCH * TILE * TILE) as u64
}

/// Called with the work done and the total, in camera rays; from any thread, about once a tile.
pub type Progress<'a> = &'a (dyn Fn(u64, u64) + Sync);

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tile {
    pub x: usize,
    pub y: usize,
    pub width: usize,
    pub height: usize,
}

impl Tile {
    /// Pixels of the tile, row by row.
    pub fn pixels(self) -> impl Iterator<Item = (usize, usize)> {
        (self.y..self.y + self.height).flat_map(move |y| (self.x..self.x + self.width).map(move |x| (x, y)))
    }
}

thread_local! {
    /// Seed of the order in which this thread's calls of [`for_tiles`] start their tiles; `None` = reading order.
    static ORDER: Cell<Option<u64>> = const { Cell::new(None) };
}

/// Runs `render` with its tiles started in a random order: what checks that the order does not matter.
pub(crate) fn with_shuffled_tiles<R>(seed: u64, render: impl FnOnce() -> R) -> R {
    let before = ORDER.replace(Some(seed));
    let result = render();
    ORDER.set(before);
    result
}

/// Calls `work` for every tile of a `width x height` picture on rayon's threads and `store` with each result, in order, on this one.
///
/// # Errors
/// [`Error::Cancelled`] once `cancel` is set; tiles under way are finished first.
pub(crate) fn for_tiles<T: Send>(
    (width, height): (usize, usize),
    rays_per_pixel: u64,
    progress: Progress<'_>,
    cancel: &AtomicBool,
    work: impl Fn(Tile) -> T + Sync,
    mut store: impl FnMut(Tile, T),
) -> Result<()> {
    let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
    let tile = |index: usize| {
        let (x, y) = (index % columns * TILE, index / columns * TILE);
        Tile { x, y, width: TILE.min(width - x), height: TILE.min(height - y) }
    };
    let mut order: Vec<usize> = (0..columns * rows).collect();
    if let Some(seed) = ORDER.get() {
        order.sort_by_key(|&index| hash::child(seed, index as u64));
    }
    let total = (width * height) as u64 * rays_per_pixel;
    let done = AtomicU64::new(0);
    for batch in order.chunks(BATCH) {
        let results: Vec<Option<T>> = batch
            .par_iter()
            .with_max_len(1)
            .map(|&index| {
                if cancel.load(Ordering::Relaxed) {
                    return None;
                }
                let tile = tile(index);
                let result = work(tile);
                let rays = (tile.width * tile.height) as u64 * rays_per_pixel;
                progress(done.fetch_add(rays, Ordering::Relaxed) + rays, total);
                Some(result)
            })
            .collect();
        for (&index, result) in batch.iter().zip(results) {
            store(tile(index), result.ok_or(Error::Cancelled)?);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pixel_once() {
        for size in [(0, 0), (1, 1), (8, 8), (9, 17), (640, 3)] {
            let mut seen = vec![0u8; size.0 * size.1];
            let last = AtomicU64::new(0);
            let progress = |done: u64, total: u64| {
                assert!(done <= total);
                last.fetch_max(done, Ordering::Relaxed);
            };
            let work = |tile: Tile| tile.pixels().collect::<Vec<_>>();
            let store = |_: Tile, pixels: Vec<(usize, usize)>| pixels.iter().for_each(|&(x, y)| seen[y * size.0 + x] += 1);
            for_tiles(size, 5, &progress, &AtomicBool::new(false), work, store).expect("not cancelled");
            assert!(seen.iter().all(|&n| n == 1));
            assert_eq!(last.into_inner(), (size.0 * size.1 * 5) as u64);
        }
    }

    #[test]
    fn cancelling_stops() {
        let cancel = AtomicBool::new(false);
        let work = |_| cancel.store(true, Ordering::Relaxed);
        let result = for_tiles((640, 640), 1, &|_, _| (), &cancel, work, |_, ()| ());
        assert!(matches!(result, Err(Error::Cancelled)));
    }
}
