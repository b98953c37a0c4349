//! `union3d man`, `union3d completions` and `union3d config`: what a package installs beside the program.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Command;
use clap_complete::Shell;

use super::Outcome;

/// Write the manual pages into a directory
///
/// One of the program and one of each of its commands, for section 1 of the manual.
#[derive(Debug, clap::Args)]
pub(crate) struct ManArgs {
    /// The directory, made when it is not there.
    directory: PathBuf,
}

/// Print what completes commands in a shell
///
/// For bash: `union3d completions bash > /etc/bash_completion.d/union3d`
#[derive(Debug, clap::Args)]
pub(crate) struct CompletionsArgs {
    /// The shell.
    shell: Shell,
}

/// Print an example of the server's configuration file, with every setting and its default
#[derive(Debug, clap::Args)]
pub(crate) struct ConfigArgs {}

/// Runs `man`.
pub(crate) fn man(args: &ManArgs, command: Command) -> Outcome {
    let failed = |error: std::io::Error| format!("{}: {error}", args.directory.display());
    std::fs::create_dir_all(&args.directory).map_err(failed)?;
    clap_mangen::generate_to(command, &args.directory).map_err(failed)?;
    Ok(ExitCode::SUCCESS)
}

/// Runs `completions`.
pub(crate) fn completions(args: &CompletionsArgs, mut command: Command) -> Outcome {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut command, "union3d", &mut text);
    std::io::stdout().lock().write_all(&text)?;
    Ok(ExitCode::SUCCESS)
}

/// Runs `config`.
pub(crate) fn config() -> Outcome {
    write!(std::io::stdout().lock(), "{}", union3d::config::example())?;
    Ok(ExitCode::SUCCESS)
}
