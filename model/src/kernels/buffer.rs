//! Outputs that are first touched by the thread that computes them.
use rayon::prelude::*;
use std::mem::MaybeUninit;

/// `count * length` floats, computed in parallel: `write(i, chunk)` for chunk `i` of `length` floats (the last may be shorter
/// when `total` is no multiple), which it finds zeroed. `state` is what a worker keeps from one chunk to the next.
///
/// A plain `vec![0.0; n]` is zeroed by one thread before the others may start.
pub fn fill<S: Send>(
    total: usize,
    length: usize,
    state: impl Fn() -> S + Sync + Send,
    write: impl Fn(&mut S, usize, &mut [f32]) + Sync + Send,
) -> Vec<f32> {
    let mut values = Box::<[f32]>::new_uninit_slice(total);
    if total > 0 {
        values.par_chunks_mut(length).enumerate().for_each_init(state, |state, (i, chunk)| write(state, i, zeroed(chunk)));
    }
    // SAFETY: the chunks cover the whole slice and each was zeroed before `write` saw it; had a call panicked, so had this
    // function.
    unsafe { values.assume_init() }.into_vec()
}

/// Like [`fill`] with two outputs of the same size.
pub fn fill_two<S: Send>(
    total: usize,
    length: usize,
    state: impl Fn() -> S + Sync + Send,
    write: impl Fn(&mut S, usize, &mut [f32], &mut [f32]) + Sync + Send,
) -> (Vec<f32>, Vec<f32>) {
    let (mut a, mut b) = (Box::<[f32]>::new_uninit_slice(total), Box::<[f32]>::new_uninit_slice(total));
    if total > 0 {
        let chunks = a.par_chunks_mut(length).zip(b.par_chunks_mut(length)).enumerate();
        chunks.for_each_init(state, |state, (i, (a, b))| write(state, i, zeroed(a), zeroed(b)));
    }
    // SAFETY: as in `fill`.
    unsafe { (a.assume_init().into_vec(), b.assume_init().into_vec()) }
}

fn zeroed(chunk: &mut [MaybeUninit<f32>]) -> &mut [f32] {
    chunk.fill(MaybeUninit::new(0.0));
    // SAFETY: every element has just been written, and MaybeUninit<f32> has the layout of f32.
    unsafe { std::slice::from_raw_parts_mut(chunk.as_mut_ptr().cast(), chunk.len()) }
}
