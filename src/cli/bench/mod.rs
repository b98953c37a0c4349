//! `union3d bench`: the measurements that the README quotes, each one command.
//!
//! Every benchmark checks what it measures (totals against a recount or another way to the same set) and fails when it is
//! wrong. Random cubes come from a seed that is part of the printed command or its defaults.

mod bins;
mod count;
mod cubes;
mod engine;
mod expected;
mod figures;
mod flat;
mod machine;
mod peers;
mod plot;
mod random;
mod service;
mod sets;
mod table;
mod union3;
mod workload;

use super::Outcome;

/// Measure the engine, the paper's table, or a real server on this machine
#[derive(Debug, clap::Args)]
#[command(
    long_about = "Measures on this machine and prints tables as Markdown (with --json as JSON), medians over the runs.

Every benchmark checks its results, and fails when they are wrong. Use a release build on a machine that does nothing else."
)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

// The words of each are with its arguments; any here would hide them.
#[derive(Debug, clap::Subcommand)]
enum What {
    Engine(engine::Args),
    Union3(union3::Args),
    Service(service::Args),
    Peers(peers::Args),
    Count(count::Args),
}

/// Runs `bench`.
pub(crate) fn run(args: Args) -> Outcome {
    if cfg!(debug_assertions) {
        eprintln!("union3d: this is a debug build: its figures say nothing about a release build");
    }
    match args.what {
        What::Engine(args) => engine::run(&args),
        What::Union3(args) => union3::run(&args),
        What::Service(args) => service::run(&args),
        What::Peers(args) => peers::run(&args),
        What::Count(args) => count::run(&args),
    }
}
