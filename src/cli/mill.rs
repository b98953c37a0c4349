//! `union3d mill`.

use super::Outcome;

/// Arguments of `mill`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

/// Runs `mill`.
pub(crate) fn run(_args: Args) -> Outcome {
    Err("not there yet".into())
}
