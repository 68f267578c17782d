//! Work in tiles: which pixels go together, how far it is, and how it stops. Results do not depend on any of it.

use crate::error::{Error, Result};
use crate::sampler::hash;
use rayon::prelude::*;
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Edge of a tile in pixels: neighbouring rays share cache lines of the tree, and there is enough work for many threads.
pub(crate) const TILE: usize = 8;
/// Number of tiles whose results are held before they are stored. It bounds memory to about 40 MB for pictures of any size.
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

/// Calls `work` for every tile of a `width x height` picture on rayon's threads and `store` with each result, in order, on this
/// one.
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

/// What one tile has of a picture: a piece of each of its rows, from the top; empty where there is none.
type Pieces<'a, P> = [&'a mut [P]; TILE];

/// A tile with its pixels in up to four pictures of one size; an empty picture has no pixels.
pub(crate) struct TilePixels<'a, A, B, C, D> {
    pub tile: Tile,
    pub first: Pieces<'a, A>,
    pub second: Pieces<'a, B>,
    pub third: Pieces<'a, C>,
    pub fourth: Pieces<'a, D>,
}

/// Calls `work` on rayon's threads for every tile of pictures of `width x height` pixels (or none), which are filled in place.
/// Calls `sum` with the results, in order, on this thread.
///
/// # Errors
/// As [`for_tiles`].
pub(crate) fn fill_tiles<A: Send, B: Send, C: Send, D: Send, T: Send>(
    (width, height): (usize, usize),
    (mut first, mut second, mut third, mut fourth): (&mut [A], &mut [B], &mut [C], &mut [D]),
    cancel: &AtomicBool,
    work: impl Fn(TilePixels<'_, A, B, C, D>) -> T + Sync,
    mut sum: impl FnMut(T),
) -> Result<()> {
    let columns = width.div_ceil(TILE).max(1);
    // As many rows of tiles at a time as hold a batch: their pieces take memory, too.
    for rows in (0..height.div_ceil(TILE)).collect::<Vec<_>>().chunks(BATCH.div_ceil(columns)) {
        let mut plots = Vec::with_capacity(rows.len() * columns);
        for y in rows.iter().map(|row| row * TILE) {
            let (a, b, c) = (cut(&mut first, width), cut(&mut second, width), cut(&mut third, width));
            let pieces = a.into_iter().zip(b).zip(c).zip(cut(&mut fourth, width));
            plots.extend(pieces.enumerate().map(|(column, (((first, second), third), fourth))| {
                let x = column * TILE;
                let tile = Tile { x, y, width: TILE.min(width - x), height: TILE.min(height - y) };
                TilePixels { tile, first, second, third, fourth }
            }));
        }
        if let Some(seed) = ORDER.get() {
            plots.sort_by_cached_key(|plot| hash::child(seed, (plot.tile.y / TILE * columns + plot.tile.x / TILE) as u64));
        }
        // Work that sees the request to stop ends early, so that what it made does not count.
        let going = || !cancel.load(Ordering::Relaxed);
        let run = |plot| going().then(|| work(plot)).filter(|_| going());
        let results: Vec<Option<T>> = plots.into_par_iter().with_max_len(1).map(run).collect();
        for result in results {
            sum(result.ok_or(Error::Cancelled)?);
        }
    }
    Ok(())
}

/// Takes the next row of tiles off `picture` and cuts it into their pieces.
fn cut<'a, P>(picture: &mut &'a mut [P], width: usize) -> Vec<Pieces<'a, P>> {
    let whole = std::mem::take(picture);
    let (band, rest) = whole.split_at_mut((width * TILE).min(whole.len()));
    *picture = rest;
    let mut tiles: Vec<Pieces<'a, P>> = (0..width.div_ceil(TILE)).map(|_| Pieces::default()).collect();
    for (y, row) in band.chunks_mut(width.max(1)).enumerate() {
        for (tile, piece) in tiles.iter_mut().zip(row.chunks_mut(TILE)) {
            tile[y] = piece;
        }
    }
    tiles
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
    fn pictures_are_filled_in_place() {
        for (width, height) in [(0, 0), (1, 1), (8, 8), (9, 17), (640, 3), (3, 640), (2000, 200)] {
            let (mut first, mut second) = (vec![(0, 0); width * height], vec![0u8; width * height]);
            let fill = || {
                let work = |plot: TilePixels<'_, (usize, usize), u8, u8, u8>| {
                    assert!(plot.third.iter().chain(&plot.fourth).all(|piece| piece.is_empty()));
                    for (i, at) in plot.tile.pixels().enumerate() {
                        let (column, row) = (i % plot.tile.width, i / plot.tile.width);
                        plot.first[row][column] = at;
                        plot.second[row][column] += 1;
                    }
                    plot.tile.width * plot.tile.height
                };
                let mut pixels = 0;
                let pictures = (&mut first[..], &mut second[..], &mut [][..], &mut [][..]);
                fill_tiles((width, height), pictures, &AtomicBool::new(false), work, |n| pixels += n).expect("not cancelled");
                pixels
            };
            assert_eq!(with_shuffled_tiles(5, fill), width * height);
            assert!(first.iter().enumerate().all(|(at, &(x, y))| (at % width, at / width) == (x, y)));
            assert!(second.iter().all(|&n| n == 1));
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
