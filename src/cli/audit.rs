//! `union3d audit`: checks a data directory that no server uses.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use indicatif::{ProgressBar, ProgressStyle};
use union3d::service::{Offline, OfflineAudit};

use super::Outcome;

/// Check a data directory: every checksum, every total against a recount
///
/// Opens every scene of DIR as the server does at start, compares every checksum, replays its log comparing the totals at every
/// change, and recounts the totals from the cubes alone. Prints a line for each scene. The exit status is 1 when anything is
/// wrong, 0 when all is well.
///
/// Refuses a directory that a running server uses: ask that one with `POST /v1/scenes/{scene}/audit`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The data directory (what `serve --data` was given)
    #[arg(value_name = "DIR")]
    directory: PathBuf,
}

/// Runs `audit`.
pub(crate) fn run(args: Args) -> Outcome {
    let Args { directory } = args;
    let data = Offline::open(&directory)?;
    let mut out = std::io::stdout().lock();
    let names: Vec<_> = data.scenes().cloned().collect();
    let width = names.iter().map(|name| name.as_str().len()).max();
    let width = width.unwrap_or(0).max("scene".len());
    writeln!(
        out,
        "{:width$}  {:>12}  {:>12}  {:>12}  result",
        "scene", "seq", "bodies", "records"
    )?;
    let mut wrong = 0_u32;
    for name in &names {
        let bar = progress(name.as_str());
        let audited = data.audit(name, &mut |permille| bar.set_position(permille.into()));
        bar.finish_and_clear();
        let name = name.as_str();
        match audited {
            Ok(audited) => {
                let OfflineAudit {
                    audit,
                    records,
                    notices,
                } = audited;
                let equal = audit.is_equal();
                writeln!(
                    out,
                    "{name:width$}  {:>12}  {:>12}  {records:>12}  {}",
                    audit.seq().0,
                    audit.bodies(),
                    if equal {
                        "equal to the recount"
                    } else {
                        "DIFFERS from the recount"
                    }
                )?;
                for notice in notices {
                    writeln!(out, "{:width$}  note: {notice}", "")?;
                }
                if !equal {
                    wrong += 1;
                    let [kept, recounted] = audit.shown();
                    writeln!(out, "{:width$}  kept:      {kept}", "")?;
                    writeln!(out, "{:width$}  recounted: {recounted}", "")?;
                }
            }
            Err(error) => {
                wrong += 1;
                writeln!(
                    out,
                    "{name:width$}  {:>12}  {:>12}  {:>12}  REFUSED: {error}",
                    "-", "-", "-"
                )?;
            }
        }
    }
    match (wrong, names.len()) {
        (0, count) => writeln!(out, "{count} of {count} scenes are well")?,
        (wrong, count) => writeln!(out, "{wrong} of {count} scenes are not well")?,
    }
    Ok(if wrong == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

/// A bar of a thousand parts, drawn only on a terminal.
pub(super) fn progress(name: &str) -> ProgressBar {
    let style = ProgressStyle::with_template("{prefix} {wide_bar} {percent} % {eta}")
        .expect("the template is well-formed");
    ProgressBar::new(1000)
        .with_style(style)
        .with_prefix(name.to_owned())
}
