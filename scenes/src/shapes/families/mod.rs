//! The families with files of their own.

pub(super) mod buildings;
pub(super) mod fractals;
pub(super) mod furnishings;
pub(super) mod furniture;
pub(super) mod implicit;
pub(super) mod machine;
pub(super) mod outlines;
pub(super) mod plants;
pub(super) mod polyhedra;
pub(super) mod round;
pub(super) mod sea;
pub(super) mod strands;
pub(super) mod terrain;
pub(super) mod trees;
pub(super) mod vessels;
