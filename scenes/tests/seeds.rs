//! The tree of seeds that everything random follows from.

use rand::Rng;
use renderflow_scenes::seed::Seed;
use std::collections::BTreeSet;

#[test]
fn seeds_form_a_stable_tree() {
    // Stored when the tree was defined: a change here changes every dataset ever made.
    let leaf = Seed::root(7).child("sequence", 3);
    let pixel = leaf.child("frame", 12).child("pixel", 65_535);
    assert_eq!([Seed::root(0).u64(), leaf.u64(), pixel.u64(), leaf.rng().next_u64()], SEEDS);
    let mut seen = BTreeSet::new();
    for index in 0..1000 {
        assert!(seen.insert(Seed::root(1).child("a", index).u64()) && seen.insert(Seed::root(1).child("b", index).u64()));
        assert!(seen.insert(Seed::root(1000 + index).u64()));
    }
}

// The first three agree with the `blake3` package of Python: derive_key of "renderflow 2026 seed tree, root", then keyed hashes
// of (length of the label, label, index), each number 8 bytes little endian.
const SEEDS: [u64; 4] =
    [18_288_444_373_478_556_299, 18_365_428_502_637_909_720, 1_554_266_496_274_973_223, 16_068_202_164_324_143_780];
