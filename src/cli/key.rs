//! `union3d key`: keys for those who may ask a server.

use std::io::Write;
use std::process::ExitCode;

use clap::{Args as ClapArgs, Subcommand, ValueEnum};
use union3d::wire::access::keys::{self, Right};

use super::Outcome;

/// Make keys for those who may ask a server
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    New(NewArgs),
}

/// Make a key
#[derive(Debug, ClapArgs)]
#[command(
    long_about = "Makes a key of 256 random bits. Its line for the file of keys, which has only the key's SHA-256, goes to standard output; the key itself goes to \
standard error, once: it is kept nowhere. A server takes up a changed file within seconds (`union3d serve --keys FILE`); to take a key back, delete its line.

Clients send `Authorization: Bearer KEY`, over HTTP and gRPC. The commands of this program take the key from --key-file or UNION3D_KEY.

Examples:
  union3d key new --name operator --rights admin --scenes '*' >> keys.toml
  union3d key new --name mill-3 --rights write --scenes 'part-*,jig' >> keys.toml 2> mill-3.key"
)]
struct NewArgs {
    /// Its name, which logs tell: letters, digits, - and _.
    #[arg(long, value_name = "NAME")]
    name: String,
    /// What it may do; each right includes those before it.
    #[arg(long, value_enum)]
    rights: Rights,
    /// Scenes by their names, or by how their names begin, with a star; * alone is all.
    #[arg(long, value_name = "SCENES", value_delimiter = ',', required = true)]
    scenes: Vec<String>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Rights {
    /// Ask everything, audits included; change nothing
    Read,
    /// Change scenes that are there
    Write,
    /// Create and drop scenes
    Admin,
}

/// Runs `key`.
pub(crate) fn run(args: Args) -> Outcome {
    let Command::New(NewArgs {
        name,
        rights,
        scenes,
    }) = args.command;
    let right = match rights {
        Rights::Read => Right::Read,
        Rights::Write => Right::Write,
        Rights::Admin => Right::Admin,
    };
    let key = keys::make(&name, right, &scenes)?;
    writeln!(std::io::stdout(), "{}", key.line)?;
    writeln!(std::io::stderr(), "{}", key.secret)?;
    Ok(ExitCode::SUCCESS)
}
