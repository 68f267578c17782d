//! Tells the crate whether trained weights lie beside it.

fn main() {
    println!("cargo::rustc-check-cfg=cfg(shipped_weights)");
    println!("cargo::rerun-if-changed=weights");
    if ["compact", "fusion"].iter().all(|name| std::path::Path::new(&format!("weights/{name}.safetensors")).is_file()) {
        println!("cargo::rustc-cfg=shipped_weights");
    }
}
