//! Positions in double precision that are written with as few digits as single precision needs wherever that says the same.
//!
//! The bytes of a scene whose numbers have at most single precision's digits (everything composed from a seed) are therefore
//! those that single precision would give, and every number reads back as it was.

use serde::Serializer;

/// The number that the shortest decimal of `value` names: 0.1 for the single-precision 0.1, not 0.10000000149.
pub fn decimal(value: f32) -> f64 {
    // Infinities and NaN have a text too; none of them fails to parse.
    value.to_string().parse().unwrap_or(f64::from(value))
}

/// One number.
pub(super) fn number<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    let single = *value as f32;
    if decimal(single) == *value { serializer.serialize_f32(single) } else { serializer.serialize_f64(*value) }
}

/// Three numbers, as a list.
pub(super) fn vector<S: Serializer>(value: &[f64; 3], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(value.map(Number))
}

/// One number in a list.
pub(super) struct Number(pub f64);

impl serde::Serialize for Number {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        number(&self.0, serializer)
    }
}
