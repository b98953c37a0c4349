//! Where the cubes of a program go: into an engine in this process, or to a server.

use serde_json::Value;
use serde_json::value::{RawValue, to_raw_value};

use super::super::client::{Client, SceneWanted, inserted};
use super::super::credentials::Credentials;
use super::grpc::{self, Done, GrpcStream};
use super::http::{self, HttpStream, UNREADABLE};
use super::line::{LineChange, Material};
use super::tally::Cut;
use union3d::engine::Engine;
use union3d::geometry::{CubeId, Effect};
use union3d::wire::convert::{self, MassProperties, Settings};
use union3d::wire::proto::Change;

/// Where the cubes go.
pub(super) enum Target {
    Engine {
        engine: Box<Engine>,
        next_id: u64,
    },
    Http {
        stream: HttpStream<LineChange>,
        next_id: u64,
    },
    Grpc {
        stream: Box<GrpcStream<LineChange>>,
        server: String,
        next_id: u64,
    },
}

impl Target {
    pub(super) fn engine(settings: &Settings) -> Self {
        Self::Engine {
            engine: Box::new(Engine::new(settings.edge()).with_stock(settings.stock())),
            next_id: 1,
        }
    }

    pub(super) fn http(client: Client, largest_id: u64) -> Self {
        Self::Http {
            stream: HttpStream::new(client),
            next_id: largest_id + 1,
        }
    }

    pub(super) async fn grpc(
        server: &str,
        credentials: &Credentials,
        wanted: &SceneWanted,
    ) -> Result<Self, Box<dyn std::error::Error>> {
        let mut client = grpc::connect(server, credentials).await?;
        let largest_id = grpc::open_cubes(&mut client, server, wanted).await?;
        Ok(Self::Grpc {
            stream: Box::new(GrpcStream::open(server, client, &wanted.name).await?),
            server: server.to_owned(),
            next_id: largest_id + 1,
        })
    }

    /// Sends a change on its way; answers what is done by now.
    pub(super) async fn send(
        &mut self,
        change: LineChange,
    ) -> Result<Vec<Cut>, Box<dyn std::error::Error>> {
        match self {
            Self::Engine { engine, next_id } => {
                let before = Material::of(&engine.totals());
                let ids = (*next_id..).map(CubeId);
                *next_id += change.places.len() as u64;
                let effect = Effect {
                    deleted: vec![],
                    inserted: ids.zip(change.places.iter().copied()).collect(),
                };
                engine.apply(&effect)?;
                let after = Material::of(&engine.totals());
                Ok(vec![change.cut(after.removed - before.removed, after)])
            }
            Self::Http { stream, next_id } => {
                let message = message(next_id, &change);
                http_cuts(stream.send(change, message).await?)
            }
            Self::Grpc {
                stream, next_id, ..
            } => {
                let message = message(next_id, &change);
                let done = stream.send(change, message).await?;
                Ok(done.iter().map(cut).collect())
            }
        }
    }

    /// Waits for all that is on its way, and reads what the scene measures then.
    pub(super) async fn finish(
        self,
        settings: &Settings,
    ) -> Result<(Vec<Cut>, Box<RawValue>), Box<dyn std::error::Error>> {
        Ok(match self {
            Self::Engine { engine, .. } => {
                let totals = engine.totals();
                let properties = convert::mass_properties(None, None, &totals, settings);
                (vec![], to_raw_value(&properties)?)
            }
            Self::Http { stream, .. } => {
                let (done, properties) = stream.finish().await?;
                (http_cuts(done)?, properties)
            }
            Self::Grpc { stream, server, .. } => {
                let (done, answer) = stream.finish().await?;
                let properties: MassProperties = grpc::read(&server, answer.mass_properties)?;
                (done.iter().map(cut).collect(), to_raw_value(&properties)?)
            }
        })
    }
}

/// The change that a line is in a scene, with the next ids.
fn message(next_id: &mut u64, change: &LineChange) -> Change {
    let first_id = *next_id;
    *next_id += change.places.len() as u64;
    Change {
        r#move: Some(change.line),
        duration: change.seconds(),
        ..inserted(first_id, &change.places)
    }
}

fn http_cuts(done: Vec<http::Done<LineChange>>) -> Result<Vec<Cut>, Box<dyn std::error::Error>> {
    let cut = |done: http::Done<LineChange>| {
        let (removed, after) = read(&done.answer).ok_or(UNREADABLE)?;
        Ok(done.what.cut(removed, after))
    };
    done.into_iter().map(cut).collect()
}

fn cut(done: &Done<LineChange>) -> Cut {
    done.what.cut(done.removed, done.after)
}

/// What a change removed and the state after it, from the API's answer to it; none when it is not that.
fn read(answer: &Value) -> Option<(i128, Material)> {
    let removed = answer["volume_removed_exact"].as_str()?.parse().ok()?;
    Some((removed, Material::read(&answer["mass_properties"])?))
}
