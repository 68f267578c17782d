//! Random parameters of each family, all inside their documented ranges.
