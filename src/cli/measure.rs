//! `union3d measure`.

use super::Outcome;

/// Arguments of `measure`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {}

/// Runs `measure`.
pub(crate) fn run(_args: Args) -> Outcome {
    Err("not there yet".into())
}
