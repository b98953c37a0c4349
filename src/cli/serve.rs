//! `union3d serve`.

use super::Outcome;

/// Arguments of `serve`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

/// Runs `serve`.
pub(crate) fn run(_args: Args) -> Outcome {
    Err("not there yet".into())
}
