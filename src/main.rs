//! The `renderflow` command.
#![forbid(unsafe_code)]

fn main() -> std::process::ExitCode {
    renderflow::cli::main()
}
