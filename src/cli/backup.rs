//! `union3d backup`: copies of scenes, from a server or from a data directory.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use tempfile::NamedTempFile;
use union3d::service::{Offline, SceneName};

use super::Outcome;
use super::client::Client;
use super::credentials::{Credentials, CredentialsArgs};

/// Copy scenes into files that `restore` brings back
///
/// Each scene becomes one file, NAME.union3d, of one moment of it, with its history. From a server (--server) changes go on meanwhile; a data
/// directory must not be in use, and every checksum is compared first. A file that is there already is replaced once the new one is
/// whole and on stable storage, so a directory of copies is always good. Prints a line for each.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The data directory (what `serve --data` was given), which no server uses
    #[arg(
        value_name = "DIR",
        required_unless_present = "server",
        conflicts_with = "server"
    )]
    directory: Option<PathBuf>,
    /// Address of a server to copy from instead
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    #[command(flatten)]
    credentials: CredentialsArgs,
    /// Where the copies go; created when it is not there
    #[arg(long, value_name = "DIR")]
    to: PathBuf,
    /// Only this scene; may be given several times
    #[arg(long, value_name = "NAME")]
    scene: Vec<String>,
}

/// Runs `backup`.
pub(crate) fn run(args: Args) -> Outcome {
    let Args {
        directory,
        server,
        credentials,
        to,
        scene: wanted,
    } = args;
    std::fs::create_dir_all(&to).map_err(|error| format!("{}: {error}", to.display()))?;
    match (directory, server) {
        (_, Some(server)) => {
            let runtime = tokio::runtime::Runtime::new()?;
            let credentials = credentials.read()?;
            runtime.block_on(from_server(&server, &credentials, wanted, &to))
        }
        (Some(directory), None) => from_directory(&directory, &wanted, &to),
        (None, None) => unreachable!("one of the two is required"),
    }
}

async fn from_server(
    server: &str,
    credentials: &Credentials,
    wanted: Vec<String>,
    to: &Path,
) -> Outcome {
    let names = if wanted.is_empty() {
        Client::scene_names(server, credentials).await?
    } else {
        wanted
    };
    for name in names {
        // What is no name of a scene is no name of a file either.
        let name = SceneName::new(&name).map_err(|error| format!("--scene {name:?}: {error}"))?;
        let mut answer = Client::of(server, credentials, name.as_str())?
            .backup()
            .await?;
        let mut file = begin(to)?;
        let mut size = 0;
        let announced = answer.content_length();
        while let Some(piece) = answer.chunk().await? {
            size += piece.len() as u64;
            file.write_all(&piece)
                .map_err(|error| format!("{}: {error}", file.path().display()))?;
        }
        if announced.is_some_and(|announced| announced != size) {
            return Err(format!("scene {}: the copy broke off", name.as_str()).into());
        }
        finish(file, &name, to, size)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn from_directory(directory: &Path, wanted: &[String], to: &Path) -> Outcome {
    let data = Offline::open(directory)?;
    for name in wanted {
        if !data.scenes().any(|own| own.as_str() == name) {
            return Err(format!("{} has no scene {name:?}", directory.display()).into());
        }
    }
    let is_wanted =
        |name: &&SceneName| wanted.is_empty() || wanted.iter().any(|one| one == name.as_str());
    for name in data.scenes().filter(is_wanted) {
        let file = begin(to)?;
        data.copy(name, file.path())?;
        let size = std::fs::metadata(file.path())?.len();
        finish(file, name, to, size)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// A file in the directory of copies that has no name of a copy yet.
fn begin(to: &Path) -> Result<NamedTempFile, String> {
    NamedTempFile::new_in(to).map_err(|error| format!("{}: {error}", to.display()))
}

/// Gives a copy its name, durably.
fn finish(file: NamedTempFile, name: &SceneName, to: &Path, size: u64) -> Result<(), String> {
    let path = to.join(format!("{}.union3d", name.as_str()));
    let failed = |error: std::io::Error| format!("{}: {error}", path.display());
    file.as_file().sync_all().map_err(failed)?;
    file.persist(&path).map_err(|error| failed(error.error))?;
    std::fs::File::open(to)
        .and_then(|directory| directory.sync_all())
        .map_err(failed)?;
    writeln!(std::io::stdout(), "{}  {size} bytes", path.display()).map_err(failed)
}
