//! Convolution for the CPU: implicit matrix products on channels-last pictures, without an im2col buffer.
pub mod portable;
