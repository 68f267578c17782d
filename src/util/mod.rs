//! Things that every floor uses and that know nothing about rendering: console, files, signals, machine, pictures.

#[macro_use]
pub mod console;

pub mod cancel;
pub mod clock;
pub mod device;
pub mod files;
pub mod log;
pub mod machine;
pub mod output;
pub mod panic;
pub mod picture;
pub mod progress;
pub mod ranges;
pub mod sheet;
pub mod stop;
pub mod tev;
pub mod text;
pub mod weights;
