//! With the feature `oidn`: lets the tests and benches of this crate find the library without LD_LIBRARY_PATH.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=OIDN_DIR");
    if std::env::var_os("CARGO_FEATURE_OIDN").is_none() {
        return;
    }
    let Some(folder) = std::env::var_os("OIDN_DIR").filter(|folder| !folder.is_empty()) else {
        return; // pkg-config finds a system-wide OIDN, which needs no search path.
    };
    let folder = std::path::Path::new(&folder).join("lib");
    if !folder.join("libOpenImageDenoise.so").exists() {
        println!(
            "cargo::error=the feature `oidn` needs Open Image Denoise 2.5 in {}: run `make oidn`, or set OIDN_DIR to an \
             installed copy (empty: ask pkg-config)",
            folder.display()
        );
    }
    // Link arguments of a library do not reach the programs that use it: the root package has the same lines.
    println!("cargo::rustc-link-arg=-Wl,-rpath,{}", folder.display());
}
