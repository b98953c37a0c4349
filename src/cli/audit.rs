//! `union3d audit`.

use super::Outcome;

/// Arguments of `audit`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

/// Runs `audit`.
pub(crate) fn run(_args: Args) -> Outcome {
    Err("not there yet".into())
}
