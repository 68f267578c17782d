//! The `renderflow` command.
#![forbid(unsafe_code)]

/// Layers of the network allocate their outputs afresh; the system's allocator returns such blocks at once and pays for their
/// pages again.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    renderflow::cli::main()
}
