//! `union3d export`: the mesh of a scene as a file.

use std::fs::Permissions;
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::ValueEnum;
use union3d::boundary::mesh_file::Format;
use union3d::service::SceneName;

use super::Outcome;
use super::client::Client;
use super::credentials::{Credentials, CredentialsArgs};

/// Write a scene of a server as a mesh: STL, PLY, OBJ, 3MF or GLB
///
/// As of one moment, while changes go on. A file that is there already is replaced once the new one is whole.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Name of the scene
    #[arg(value_name = "SCENE")]
    scene: String,
    /// Address of the server
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:7373")]
    server: String,
    #[command(flatten)]
    credentials: CredentialsArgs,
    /// The file; its extension says which format
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// The format, whatever the extension
    #[arg(long, value_name = "NAME", value_parser = format)]
    format: Option<Format>,
    /// What of the scene [default: remaining, or union where there is no stock]
    #[arg(long, value_name = "PART", value_enum)]
    part: Option<Part>,
    /// Only what lies in this box, in the scene's unit, cut there and open
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", allow_hyphen_values = true)]
    r#box: Option<String>,
    /// Refuse a mesh of more triangles
    #[arg(long, value_name = "TRIANGLES")]
    at_most: Option<u64>,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum Part {
    /// The union of all bodies
    Union,
    /// What they remove from the stock
    Removed,
    /// What remains of the stock
    Remaining,
}

/// Runs `export`.
pub(crate) fn run(args: &Args) -> Outcome {
    let runtime = tokio::runtime::Runtime::new()?;
    let credentials = args.credentials.read()?;
    runtime.block_on(export(args, &credentials))
}

async fn export(args: &Args, credentials: &Credentials) -> Outcome {
    let path = &args.out;
    let extension = path.extension().and_then(|extension| extension.to_str());
    let format = match args.format {
        Some(format) => format,
        None => format(&extension.unwrap_or_default().to_ascii_lowercase())
            .map_err(|wrong| format!("--out {}: {wrong}; or give --format", path.display()))?,
    };
    let scene =
        SceneName::new(&args.scene).map_err(|error| format!("{:?}: {error}", args.scene))?;
    let part = args.part.map(|part| match part {
        Part::Union => "union",
        Part::Removed => "removed",
        Part::Remaining => "remaining",
    });
    let mut query = vec![("format", format.name().to_owned())];
    query.extend(part.map(|part| ("part", part.to_owned())));
    query.extend(args.r#box.iter().map(|text| ("box", text.clone())));
    query.extend(args.at_most.map(|most| ("at-most", most.to_string())));
    let client = Client::of(&args.server, credentials, scene.as_str())?;
    let mut answer = client.mesh(&query).await?;
    let failed = |error: std::io::Error| format!("{}: {error}", path.display());
    let directory = path.parent().filter(|parent| *parent != "");
    // Readable for whom other new files are: it is no secret of the server's.
    let mut new = tempfile::Builder::new();
    let new = new.permissions(Permissions::from_mode(0o666));
    let mut file = new
        .tempfile_in(directory.unwrap_or(".".as_ref()))
        .map_err(failed)?;
    let announced = answer.content_length();
    let mut size = 0;
    while let Some(piece) = answer.chunk().await? {
        size += piece.len() as u64;
        file.write_all(&piece).map_err(failed)?;
    }
    if announced.is_some_and(|announced| announced != size) {
        return Err(format!("scene {}: the mesh broke off", scene.as_str()).into());
    }
    file.as_file().sync_all().map_err(failed)?;
    file.persist(path).map_err(|error| failed(error.error))?;
    writeln!(std::io::stdout(), "{}  {size} bytes", path.display()).map_err(failed)?;
    Ok(ExitCode::SUCCESS)
}

fn format(name: &str) -> Result<Format, String> {
    Format::named(name).ok_or_else(|| {
        let names = Format::ALL.map(Format::name);
        format!("{name:?} is none of {}", names.join(", "))
    })
}
