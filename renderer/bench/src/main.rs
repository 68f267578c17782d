//! The `renderflow-bench` command.
#![forbid(unsafe_code)]

/// The allocator of the product, so that what is measured is the same.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    renderflow_bench::cli::main()
}
