//! Tells the crate whether trained weights lie beside it.

fn main() {
    println!("cargo::rustc-check-cfg=cfg(shipped_weights)");
    println!("cargo::rerun-if-changed=weights");
    if std::path::Path::new("weights/fusion.safetensors").is_file() {
        println!("cargo::rustc-cfg=shipped_weights");
    }
}
