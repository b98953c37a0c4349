//! `union3d restore`: brings scenes back from copies.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use union3d::service::{Offline, SceneName};

use super::Outcome;
use super::audit::progress;

/// Bring scenes back from copies that `backup` made
///
/// Each FILE becomes a scene of the data directory, which no server may use meanwhile, under the name of the file (without .union3d) or that of
/// --name. It is checked as `audit` checks a directory before it appears: what is not right to the last checksum and total is
/// refused, and nothing has changed. A scene that is there already is never replaced: drop it first.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The data directory (what `serve --data` is given); created when it is not there
    #[arg(value_name = "DIR")]
    directory: PathBuf,
    /// Copies that `backup` or `GET /v1/scenes/{scene}/backup` made
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    /// The scene's name, when it is not to be the file's; for one FILE
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
}

/// Runs `restore`.
pub(crate) fn run(args: Args) -> Outcome {
    let Args {
        directory,
        files,
        name,
    } = args;
    if name.is_some() && files.len() > 1 {
        return Err("--name is for one file".into());
    }
    let names = files.iter().map(|file| named(file, name.as_deref()));
    let names = names.collect::<Result<Vec<_>, _>>()?;
    let data = Offline::open_or_create(&directory)?;
    for (file, name) in files.iter().zip(names) {
        let bar = progress(name.as_str());
        let restored = data.restore(&name, file, &mut |permille| {
            bar.set_position(permille.into());
        });
        bar.finish_and_clear();
        let audit = restored?.audit;
        writeln!(
            std::io::stdout(),
            "{}  seq {}  {} bodies, equal to the recount",
            name.as_str(),
            audit.seq().0,
            audit.bodies()
        )?;
    }
    Ok(ExitCode::SUCCESS)
}

fn named(file: &Path, given: Option<&str>) -> Result<SceneName, String> {
    let from_file = || {
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        name.strip_suffix(".union3d").unwrap_or(&name).to_owned()
    };
    let name = given.map_or_else(from_file, str::to_owned);
    SceneName::new(&name).map_err(|error| {
        format!(
            "{}: {name:?} is no name of a scene, {error}; give one with --name",
            file.display()
        )
    })
}
