//! Tells the crate which trained weights lie beside it.

fn main() {
    println!("cargo::rerun-if-changed=weights");
    for (network, option) in [("fusion", "shipped_weights"), ("inverse", "shipped_inverse")] {
        println!("cargo::rustc-check-cfg=cfg({option})");
        if std::path::Path::new("weights").join(network).with_extension("safetensors").is_file() {
            println!("cargo::rustc-cfg={option}");
        }
    }
}
