//! `union3d demo`.

use super::Outcome;

/// Arguments of `demo`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

/// Runs `demo`.
pub(crate) fn run(_args: Args) -> Outcome {
    Err("not there yet".into())
}
