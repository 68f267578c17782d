//! Processes that train one network together. Each makes its share of every batch, and all take the same steps with the mean of
//! their gradients. Process 0 writes the files of the run.
//!
//! Sums are taken in the order of the processes, whatever carries the messages. So runs with equally many processes have the same
//! bytes, and the processes hold the same numbers.

use super::config::Gradients;
use super::optimizer::Optimizer;
use super::report::{Progress, StepResult};
use crate::{Error, Result, parameters};
use burn::tensor::{Device, Tensor};
use bytemuck::Pod;
use half::f16;
use std::cell::Cell;
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};

pub use super::links::{Links, Share};

/// Values that are summed at a time, so that buffers stay small.
const PIECE: usize = 1 << 22;
/// Half floats below 2^15 have room for rounding.
const LARGEST_EXPONENT: i32 = 15;

/// The processes that train a network together; usually one.
pub struct Team {
    links: Option<Box<dyn Links>>,
    share: Share,
    /// Whether the processes have agreed that the run is over.
    parted: Cell<bool>,
}

impl Team {
    /// A process that trains alone.
    pub fn alone() -> Self {
        Self { links: None, share: Share::WHOLE, parted: Cell::new(false) }
    }

    /// The team that `links` joins.
    pub fn new(links: impl Links + 'static) -> Self {
        let share = links.share();
        Self { links: Some(Box::new(links)), share, parted: Cell::new(false) }
    }

    /// The team that `mpirun` or `srun` has started, or this process alone. Call it once, on the main thread.
    ///
    /// # Errors
    /// [`Error::Team`] when this process is one of several and cannot reach the others: without the feature `mpi`, and when the
    /// launcher and the MPI library do not know each other.
    pub fn from_environment() -> Result<Self> {
        match launched(&|variable| std::env::var(variable).ok()) {
            None => Ok(Self::alone()),
            Some((variable, size)) => {
                let links = super::launch::join(variable, size)?;
                let share = links.share();
                Ok(Self { links: Some(links), share, parted: Cell::new(false) })
            }
        }
    }

    /// Which items of every batch this process makes.
    pub fn share(&self) -> Share {
        self.share
    }

    /// Number of processes, at least 1.
    pub fn size(&self) -> usize {
        self.share.size
    }

    /// The number of this process among those that a launcher has started on the same machine, counted from 0.
    pub fn place_on_machine(&self) -> usize {
        place(&|variable| std::env::var(variable).ok())
    }

    /// Whether this process writes the files of the run and reports its progress. One process of a team does.
    pub fn leads(&self) -> bool {
        self.share.rank == 0
    }

    /// `progress`, if this process reports it.
    pub(crate) fn report<'a>(&self, progress: &'a (dyn Fn(&Progress) + Sync)) -> &'a (dyn Fn(&Progress) + Sync) {
        if self.leads() { progress } else { &|_| () }
    }

    /// Whether the processes have agreed that the run is over. Until then, one that ends must end the others
    /// ([`Self::abort`]), which would wait for it.
    pub fn has_parted(&self) -> bool {
        self.parted.get()
    }

    /// Ends every process of the team with the exit code `status`. A process that trains alone goes on.
    pub fn abort(&self, status: u8) {
        if let Some(links) = &self.links {
            links.abort(status);
        }
    }

    /// The values of all processes, in their order.
    fn gather<T: Pod>(&self, own: &[T]) -> Result<Vec<T>> {
        let Some(links) = &self.links else { return Ok(own.to_vec()) };
        let mut all = vec![T::zeroed(); own.len() * self.size()];
        links.gather(bytemuck::cast_slice(own), bytemuck::cast_slice_mut(&mut all))?;
        Ok(all)
    }

    /// Whether a `flag` is set on any process.
    pub(super) fn any(&self, flag: bool) -> Result<bool> {
        Ok(self.gather(&[u8::from(flag)])?.contains(&1))
    }

    /// The seconds of training on process 0, and whether any process wants to stop.
    pub(super) fn agree(&self, elapsed: f64, stop: bool) -> Result<(f64, bool)> {
        let all = self.gather(&[elapsed, f64::from(u8::from(stop))])?;
        Ok((all[0], all.chunks_exact(2).any(|of| of[1] > 0.0)))
    }

    /// Agrees that the run is over, when every process has done what it had to do.
    pub(super) fn part(&self) -> Result<()> {
        self.any(false)?;
        self.parted.set(true);
        Ok(())
    }

    /// Refuses to begin where the processes differ in their options, data or weights. `options` holds all that must be equal
    /// beside the state of the optimiser.
    pub(super) fn check_start(&self, options: &str, optimizer: &Optimizer) -> Result<()> {
        if self.links.is_none() {
            return Ok(());
        }
        let mut hasher = DefaultHasher::new();
        options.hash(&mut hasher);
        let digests = self.gather(&[hasher.finish(), digest(optimizer), optimizer.steps])?;
        for (rank, of) in digests.chunks_exact(3).enumerate() {
            let differs = (0..3).find(|i| of[*i] != digests[*i]);
            if let Some(what) = differs.map(|i| ["other options or data", "other weights", "another step"][i]) {
                let reason = format!(
                    "process {rank} begins with {what} than process 0. Start every process with the same command, and put the output \
                     folder where all processes see it"
                );
                return Err(Error::Team { reason });
            }
        }
        Ok(())
    }

    /// Gives every process the state of process 0 if any process has another one, and returns whether that was so. Processors of
    /// different kinds round differently.
    pub(super) fn level(&self, optimizer: &mut Optimizer) -> Result<bool> {
        let Some(links) = &self.links else { return Ok(false) };
        let digests = self.gather(&[digest(optimizer)])?;
        if digests.iter().all(|digest| *digest == digests[0]) {
            return Ok(false);
        }
        for slot in &mut optimizer.slots {
            for values in [&mut slot.parameter.values, &mut slot.first, &mut slot.second, &mut slot.average] {
                for piece in values.chunks_mut(PIECE) {
                    links.broadcast(bytemuck::cast_slice_mut(piece))?;
                }
            }
        }
        Ok(true)
    }

    /// Replaces the loss, its terms and the gradients of the own share of a batch by the means over all shares. The same
    /// gradients are missing in all of them, and stay missing. `sizes` are those of the parameters; gradients come back on
    /// `device`.
    pub(super) fn mean(&self, result: &mut StepResult, sizes: &[usize], format: Gradients, device: &Device) -> Result<()> {
        let Some(links) = &self.links else { return Ok(()) };
        let mut flat = Vec::with_capacity(sizes.iter().sum());
        let present: Vec<bool> = result.gradients.iter().map(Option::is_some).collect();
        for gradient in &mut result.gradients {
            if let Some(values) = gradient.take() {
                flat.extend(parameters::read(values)?);
            }
        }
        // Whether values are finite must be known to all, and NaN is no maximum.
        let largest = flat.iter().fold(0.0_f32, |largest, v| if v.is_finite() { largest.max(v.abs()) } else { f32::INFINITY });
        let named = || result.terms.iter().chain(&result.squares);
        let mut hasher = DefaultHasher::new();
        named().for_each(|(name, _)| name.hash(&mut hasher));
        present.hash(&mut hasher);
        let all = self.gather(&[hasher.finish(), named().count() as u64, largest.to_bits().into()])?;
        let all: Vec<&[u64]> = all.chunks_exact(3).collect();
        if all.iter().any(|of| of[..2] != all[0][..2]) {
            return Err(Error::Team { reason: "the processes have different terms of the loss, or gradients".into() });
        }
        let largest = all.iter().map(|of| f32::from_bits(of[2] as u32)).fold(0.0, f32::max);

        let own: Vec<f32> = std::iter::once(result.total).chain(named().map(|(_, value)| *value)).collect();
        let gathered = self.gather(&own)?;
        let mean = |i: usize| gathered.chunks_exact(own.len()).map(|of| of[i]).sum::<f32>() / self.size() as f32;
        result.total = mean(0);
        let terms = result.terms.iter_mut().chain(&mut result.squares);
        terms.enumerate().for_each(|(i, (_, value))| *value = mean(i + 1));

        for piece in flat.chunks_mut(PIECE) {
            match format {
                Gradients::F32 => mean_piece::<f32>(links.as_ref(), piece, 1.0)?,
                Gradients::F16 => mean_piece::<f16>(links.as_ref(), piece, half_scale(largest))?,
            }
        }
        let mut rest = flat.as_slice();
        let given = result.gradients.iter_mut().zip(sizes).zip(present).filter(|(_, present)| *present);
        for ((gradient, size), _) in given {
            let (values, behind) = rest.split_at(*size);
            (*gradient, rest) = (Some(Tensor::from_data(values, device)), behind);
        }
        Ok(())
    }
}

impl Drop for Team {
    /// A process that panics would leave the others waiting.
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.abort(101);
        }
    }
}

/// A digest of the parameters, their moments and averages.
fn digest(optimizer: &Optimizer) -> u64 {
    let mut hasher = DefaultHasher::new();
    for slot in &optimizer.slots {
        for values in [&slot.parameter.values, &slot.first, &slot.second, &slot.average] {
            bytemuck::cast_slice::<f32, u8>(values).hash(&mut hasher);
        }
    }
    hasher.finish()
}

/// A number format on its way between processes.
trait Wire: Pod {
    fn pack(value: f32) -> Self;
    fn unpack(self) -> f32;
}

impl Wire for f32 {
    fn pack(value: f32) -> Self {
        value
    }

    fn unpack(self) -> f32 {
        self
    }
}

impl Wire for f16 {
    fn pack(value: f32) -> Self {
        Self::from_f32(value)
    }

    fn unpack(self) -> f32 {
        self.to_f32()
    }
}

/// The power of two that brings a value of `largest` into the top of the range of half floats; 1 for a value that is 0 or not
/// finite.
fn half_scale(largest: f32) -> f32 {
    if largest == 0.0 || !largest.is_finite() {
        return 1.0;
    }
    let exponent = largest.log2().ceil() as i32;
    ((LARGEST_EXPONENT - exponent).clamp(-100, 100) as f32).exp2()
}

/// Replaces values by their means over the processes. They travel as `W`, multiplied by `scale`.
///
/// Each process takes the mean of one part and sends it to the others. So a process sends and receives every value about twice,
/// however many processes there are.
fn mean_piece<W: Wire>(links: &dyn Links, piece: &mut [f32], scale: f32) -> Result<()> {
    let size = links.share().size;
    let part = piece.len().div_ceil(size);
    let mut sent: Vec<W> = piece.iter().map(|v| W::pack(v * scale)).collect();
    sent.resize(part * size, W::zeroed());
    let mut received = vec![W::zeroed(); part * size];
    links.exchange(bytemuck::cast_slice(&sent), bytemuck::cast_slice_mut(&mut received))?;
    let sum = |i: usize| (0..size).map(|rank| received[rank * part + i].unpack()).sum::<f32>();
    let own: Vec<W> = (0..part).map(|i| W::pack(sum(i) / size as f32)).collect();
    links.gather(bytemuck::cast_slice(&own), bytemuck::cast_slice_mut(&mut sent))?;
    piece.iter_mut().zip(&sent).for_each(|(value, mean)| *value = mean.unpack() / scale);
    Ok(())
}

/// The number of this process among those of its machine, counted from 0, as launchers store it: Open MPI; MPICH and Intel MPI;
/// `srun`. 0 where none does.
fn place(variable: &dyn Fn(&str) -> Option<String>) -> usize {
    let names = ["OMPI_COMM_WORLD_LOCAL_RANK", "MPI_LOCALRANKID", "SLURM_LOCALID"];
    names.iter().find_map(|name| variable(name)?.trim().parse().ok()).unwrap_or(0)
}

/// The variables in which launchers store how many processes they started: Open MPI; MPICH, Intel MPI and `srun --mpi=pmi2`;
/// every `srun`.
const LAUNCHERS: [&str; 3] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS"];

/// How many processes a launcher has started together with this one, if they are several, and the variable that says so.
fn launched(variable: &dyn Fn(&str) -> Option<String>) -> Option<(&'static str, usize)> {
    // A shell or a batch script inside a job is not one of its tasks.
    let rank = ["OMPI_COMM_WORLD_RANK", "PMI_RANK", "SLURM_PROCID"];
    let started = LAUNCHERS.iter().zip(rank).filter(|(_, rank)| variable(rank).is_some());
    let sizes = started.filter_map(|(name, _)| Some((*name, variable(name)?.trim().parse::<usize>().ok()?)));
    sizes.into_iter().find(|(_, size)| *size > 1)
}

#[cfg(test)]
#[path = "team_tests.rs"]
pub(crate) mod tests;
