//! Ranges of numbers on the command line.

use clap::builder::RangedI64ValueParser;
use std::ops::RangeInclusive;

/// Accepts the numbers in `range`.
pub fn within(range: RangeInclusive<u32>) -> RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(i64::from(*range.start())..=i64::from(*range.end()))
}
