//! Integer hashes that turn (seed, frame, pixel, set) into independent seeds.

/// The finaliser of SplitMix64 (Steele, Lea, Flood 2014): a bijection of 64 bits without visible structure.
#[inline]
pub fn mix(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9E37_79B9_7F4A_7C15);
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}

/// A seed of the tree below `parent`.
#[inline]
pub fn child(parent: u64, index: u64) -> u64 {
    mix(parent ^ mix(index))
}
