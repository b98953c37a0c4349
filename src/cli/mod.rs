//! The subcommands: each a file with its arguments and a `run`.

mod audit;
mod backup;
mod client;
mod cutter;
mod demo;
mod input;
mod measure;
mod mill;
mod path;
mod program;
mod progress;
mod report;
mod restore;
mod serve;
mod solids;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// What a subcommand ends with: an exit status, or what went wrong and what to do.
pub(crate) type Outcome = Result<ExitCode, Box<dyn std::error::Error>>;

/// Exact mass properties of the union of many cubes, current while cubes are inserted and deleted.
#[derive(Debug, Parser)]
#[command(version, about, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

// The words of each command are with its arguments; any here would hide them.
#[derive(Debug, Subcommand)]
enum Command {
    Serve(serve::Args),
    Demo(demo::Args),
    Mill(mill::Args),
    Path(path::Args),
    Measure(measure::Args),
    Audit(audit::Args),
    Backup(backup::Args),
    Restore(restore::Args),
}

/// Reads the arguments, runs the subcommand and reports its error, if any, as one line on standard error.
pub(crate) fn main() -> ExitCode {
    let outcome = match Cli::parse().command {
        Command::Serve(args) => serve::run(args),
        Command::Demo(args) => demo::run(args),
        Command::Mill(args) => mill::run(args),
        Command::Path(args) => path::run(args),
        Command::Measure(args) => measure::run(args),
        Command::Audit(args) => audit::run(args),
        Command::Backup(args) => backup::run(args),
        Command::Restore(args) => restore::run(args),
    };
    outcome.unwrap_or_else(|error| {
        eprintln!("union3d: {error}");
        ExitCode::FAILURE
    })
}
