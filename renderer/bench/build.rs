//! With the feature `oidn`: lets the program and its tests find the library without LD_LIBRARY_PATH. A build script can set this
//! for its own package only, so the root package has the same lines.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=OIDN_DIR");
    if std::env::var_os("CARGO_FEATURE_OIDN").is_none() {
        return;
    }
    // First relative to target/release/, so that the folder can be moved as a whole; then where it was at build time.
    println!("cargo::rustc-link-arg=-Wl,-rpath,$ORIGIN/../../.oidn/pyoidn/oidn/lib");
    if let Some(folder) = std::env::var_os("OIDN_DIR").filter(|folder| !folder.is_empty()) {
        let folder = std::path::Path::new(&folder).join("lib");
        println!("cargo::rustc-link-arg=-Wl,-rpath,{}", folder.display());
    }
}
