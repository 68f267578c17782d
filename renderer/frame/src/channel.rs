//! The channel table: names, types and meaning of every channel in a frame file.
