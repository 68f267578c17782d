//! What carries numbers between the processes that train together, and which part of the work each has.

use super::sequences::Crop;
use crate::{Error, Result};
use std::ops::Range;

/// Which items of every batch a process makes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Share {
    /// Number of this process, below `size`.
    pub rank: usize,
    /// Number of processes, at least 1.
    pub size: usize,
}

impl Share {
    /// The share of a process that trains alone.
    pub const WHOLE: Self = Self { rank: 0, size: 1 };

    /// The items of this process in a batch of `items`, which is a multiple of the number of processes ([`Self::check_batch`]).
    pub fn of(self, items: usize) -> Range<usize> {
        items * self.rank / self.size..items * (self.rank + 1) / self.size
    }

    /// Refuses batches that the processes cannot share equally: the mean over processes would not be the mean over items.
    ///
    /// # Errors
    /// [`Error::Config`] naming the `option` that holds the number of `items`.
    pub fn check_batch(self, option: &'static str, items: usize) -> Result<()> {
        if items.is_multiple_of(self.size) {
            return Ok(());
        }
        Err(Error::config(option, format!("{items} cannot be shared equally by {} processes", self.size)))
    }

    /// Refuses kinds of crop that the processes cannot share equally.
    ///
    /// # Errors
    /// As [`Self::check_batch`].
    pub fn check_crops(self, crops: &[Crop]) -> Result<()> {
        crops.iter().try_for_each(|crop| self.check_batch("crops.batch", crop.batch))
    }
}

/// What carries bytes between the processes of a team. Every process makes the same calls in the same order.
pub trait Links {
    /// The number of this process, and how many there are.
    fn share(&self) -> Share;

    /// Sends part `i` of `sent` to process `i`, and stores what process `i` sends to this one in part `i` of `received`. Both
    /// have one part for each process, and all parts are equally long.
    ///
    /// # Errors
    /// When a process cannot be reached.
    fn exchange(&self, sent: &[u8], received: &mut [u8]) -> Result<()>;

    /// Stores the `part` of each process in `all`, in the order of the processes. All parts are equally long.
    ///
    /// # Errors
    /// As [`Self::exchange`].
    fn gather(&self, part: &[u8], all: &mut [u8]) -> Result<()>;

    /// Replaces `bytes` by those of process 0. They are equally many everywhere.
    ///
    /// # Errors
    /// As [`Self::exchange`].
    fn broadcast(&self, bytes: &mut [u8]) -> Result<()>;

    /// Ends every process of the team with the exit code `status`.
    fn abort(&self, status: u8);
}
