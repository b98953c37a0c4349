//! Generates the Rust types and the gRPC service of `union3d/v1/*.proto` without a `protoc` on the machine.

use std::path::PathBuf;

use prost::Message;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-changed=proto");
    let files = protox::compile(["union3d/v1/union_service.proto"], ["proto"])?;
    // What reflection tells clients.
    let described = PathBuf::from(std::env::var("OUT_DIR")?).join("union3d.bin");
    std::fs::write(described, files.encode_to_vec())?;
    tonic_prost_build::configure().compile_fds(files)?;
    Ok(())
}
