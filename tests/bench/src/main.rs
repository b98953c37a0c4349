//! The measurements that union3d's documentation quotes, each one command.
//!
//! Every benchmark checks what it measures (totals against a recount or another way to the same set) and fails when it is
//! wrong. Random cubes come from a seed that is part of the printed command or its defaults. Knows union3d as its users do: the
//! engine through the library, the server through HTTP and gRPC; never how the server keeps its data.

mod bins;
mod count;
mod cubes;
mod engine;
mod expected;
mod failure;
mod figures;
mod flat;
mod hulls;
mod machine;
mod milling;
mod peers;
mod plot;
mod progress;
#[path = "../../oracle/random.rs"]
mod random;
mod scenario;
mod service;
mod sets;
mod solid_sets;
mod solids;
mod table;
mod union3;
mod workload;

use std::process::ExitCode;

use clap::Parser;

/// The server's: what is measured in this process is what it does there.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Measure union3d on this machine: the engine, the paper's table, a real server
#[derive(Debug, Parser)]
#[command(
    version,
    long_about = "Measures union3d on this machine and prints tables as Markdown (with --json as JSON), medians over the runs.

Every benchmark checks its results, and fails when they are wrong. Use a release build on a machine that does nothing else."
)]
struct Args {
    #[command(subcommand)]
    what: What,
}

// The words of each are with its arguments; any here would hide them.
#[derive(Debug, clap::Subcommand)]
enum What {
    Engine(engine::Args),
    Solids(solids::Args),
    Union3(union3::Args),
    Service(service::Args),
    Hulls(hulls::Args),
    Peers(peers::Args),
    Count(count::Args),
}

fn main() -> ExitCode {
    let args = Args::parse();
    if cfg!(debug_assertions) {
        eprintln!(
            "union3d-bench: this is a debug build: its figures say nothing about a release build"
        );
    }
    let outcome = match args.what {
        What::Engine(args) => engine::run(&args),
        What::Solids(args) => solids::run(&args),
        What::Union3(args) => union3::run(&args),
        What::Service(args) => service::run(&args),
        What::Hulls(args) => hulls::run(&args),
        What::Peers(args) => peers::run(&args),
        What::Count(args) => count::run(&args),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("union3d-bench: {error}");
            ExitCode::FAILURE
        }
    }
}
