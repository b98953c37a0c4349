//! The subcommands: each a file with its arguments and a `run`.

mod audit;
mod backup;
mod client;
mod credentials;
mod cutter;
mod demo;
mod export;
mod input;
mod key;
mod man;
mod measure;
mod mill;
mod path;
mod program;
mod progress;
mod report;
mod restore;
mod serve;
mod solids;
mod stock;

use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};

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
    Export(export::Args),
    Backup(backup::Args),
    Restore(restore::Args),
    Key(key::Args),
    Config(man::ConfigArgs),
    Completions(man::CompletionsArgs),
    Man(man::ManArgs),
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
        Command::Export(args) => export::run(&args),
        Command::Backup(args) => backup::run(args),
        Command::Restore(args) => restore::run(args),
        Command::Key(args) => key::run(args),
        Command::Config(man::ConfigArgs {}) => man::config(),
        Command::Completions(args) => man::completions(&args, Cli::command()),
        Command::Man(args) => man::man(&args, Cli::command()),
    };
    outcome.unwrap_or_else(|error| {
        if is_unread(&*error) {
            return ExitCode::from(UNREAD);
        }
        eprintln!("union3d: {error}");
        ExitCode::FAILURE
    })
}

/// The status of a program that nobody reads any more, as shells show it: 128 and the number of the signal SIGPIPE.
const UNREAD: u8 = 128 + 13;

/// Whether who read the output has gone, as `head` does: no fault, and nothing to say.
fn is_unread(error: &(dyn std::error::Error + 'static)) -> bool {
    let mut causes = std::iter::successors(Some(error), |error| error.source());
    causes.any(|cause| {
        let kind = match cause.downcast_ref::<std::io::Error>() {
            Some(error) => Some(error.kind()),
            None => cause
                .downcast_ref::<serde_json::Error>()
                .and_then(serde_json::Error::io_error_kind),
        };
        kind == Some(std::io::ErrorKind::BrokenPipe)
    })
}
