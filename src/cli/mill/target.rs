//! Where the cubes of a program go: into an engine in this process, or to a server.

use std::time::Duration;

use serde_json::Value;
use serde_json::value::RawValue;
use uuid::Uuid;

use super::super::client::{Client, SceneWanted};
use super::grpc::GrpcStream;
use super::tally::{Cut, Kind};
use union3d::engine::Engine;
use union3d::geometry::{CubeId, Effect, Place, Totals};
use union3d::wire::convert::{self, Settings};

/// Cubes of one change: a longer line becomes several, all with its number.
const PART_CUBES_MAX: usize = 65_536;

/// One line of the program on its way, or a part of it.
#[derive(Debug)]
pub(super) struct Part {
    pub(super) line: u64,
    pub(super) kind: Kind,
    /// Machine time; none when the program gives no feed.
    pub(super) duration: Option<Duration>,
    pub(super) places: Vec<Place>,
}

/// What a scene's totals say about material. Units: steps.
#[derive(Clone, Copy, Debug)]
pub(super) struct State {
    /// Volume removed from the stock, or of the union where there is none.
    pub(super) removed: i128,
    /// Area of the union.
    pub(super) area: i128,
}

impl State {
    /// From the API's mass properties; none when they are not that.
    fn read(properties: &Value) -> Option<Self> {
        let exact = |value: &Value| value["exact"]["volume"].as_str()?.parse().ok();
        Some(Self {
            removed: match &properties["removed"] {
                Value::Null => exact(properties)?,
                removed => exact(removed)?,
            },
            area: properties["exact"]["area"].as_str()?.parse().ok()?,
        })
    }

    fn of(totals: &Totals) -> Self {
        Self {
            removed: match &totals.stock {
                Some(stock) => stock.removed.volume,
                None => totals.measures.volume,
            },
            area: totals.measures.area(),
        }
    }
}

impl Part {
    pub(super) fn new(line: u64, kind: Kind) -> Self {
        Self {
            line,
            kind,
            duration: None,
            places: Vec::new(),
        }
    }

    /// Whether what comes next belongs to it. A dwell belongs to the move that its line has, too.
    pub(super) fn takes(&self, line: u64, kind: Kind) -> bool {
        self.line == line && (self.kind == kind || [self.kind, kind].contains(&Kind::Dwell))
    }

    /// Makes what comes next part of it.
    pub(super) fn join(&mut self, kind: Kind, time: Option<Duration>) {
        if self.kind == Kind::Dwell {
            self.kind = kind;
        }
        if let Some(time) = time {
            self.duration = Some(self.duration.unwrap_or_default() + time);
        }
    }

    /// The changes that a line becomes once it is whole: before, how many cubes share its time is not known. Each has the share of
    /// the machine time that it has of the cubes, in nanoseconds that add up to the whole.
    pub(super) fn changes(self) -> Vec<Self> {
        if self.places.len() <= PART_CUBES_MAX {
            return vec![self];
        }
        let whole = self.places.len() as u128;
        // Nanoseconds of the first so many cubes.
        let due = |cubes: u128| Some(self.duration?.as_nanos() * cubes / whole);
        let mut before = 0;
        let changes = self.places.chunks(PART_CUBES_MAX).map(|places| {
            let after = before + places.len() as u128;
            let share = due(after).zip(due(before)).map(|(to, from)| to - from);
            let duration = share.map(Duration::from_nanos_u128);
            before = after;
            Self {
                line: self.line,
                kind: self.kind,
                duration,
                places: places.to_vec(),
            }
        });
        changes.collect()
    }

    /// Machine time in seconds, as a change has it.
    pub(super) fn seconds(&self) -> Option<f64> {
        self.duration.map(|duration| duration.as_secs_f64())
    }

    /// What it did: what it removed itself (others may change the scene too), and the state after it.
    pub(super) fn cut(&self, removed: i128, after: State) -> Cut {
        Cut {
            line: self.line,
            kind: self.kind,
            duration: self.duration,
            cubes: self.places.len() as u64,
            removed,
            total_removed: after.removed,
            area: after.area,
        }
    }
}

/// Where the cubes go.
pub(super) enum Target {
    Engine {
        engine: Box<Engine>,
        next_id: u64,
    },
    Http {
        client: Client,
        next_id: u64,
        /// Names this run in the keys of its changes.
        run: Uuid,
        changes: u64,
    },
    Grpc(Box<GrpcStream>),
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
            client,
            next_id: largest_id + 1,
            run: Uuid::new_v4(),
            changes: 0,
        }
    }

    pub(super) async fn grpc(
        server: &str,
        wanted: &SceneWanted,
    ) -> Result<Self, Box<dyn std::error::Error>> {
        Ok(Self::Grpc(Box::new(
            GrpcStream::open(server, wanted).await?,
        )))
    }

    /// Sends a part on its way; answers what is done by now.
    pub(super) async fn send(
        &mut self,
        part: Part,
    ) -> Result<Vec<Cut>, Box<dyn std::error::Error>> {
        match self {
            Self::Engine { engine, next_id } => {
                let before = State::of(&engine.totals());
                let ids = (*next_id..).map(CubeId);
                *next_id += part.places.len() as u64;
                let effect = Effect {
                    deleted: vec![],
                    inserted: ids.zip(part.places.iter().copied()).collect(),
                };
                engine.apply(&effect)?;
                let after = State::of(&engine.totals());
                Ok(vec![part.cut(after.removed - before.removed, after)])
            }
            Self::Http {
                client,
                next_id,
                run,
                changes,
            } => {
                *changes += 1;
                let key = format!("{}-{changes}", run.simple());
                let seconds = part.seconds();
                let answer = client
                    .move_and_measure(*next_id, &part.places, part.line, seconds, &key)
                    .await?;
                *next_id += part.places.len() as u64;
                let (removed, after) = read(&answer).ok_or(
                    "cannot make sense of the server's answer (is it of the same version?)",
                )?;
                Ok(vec![part.cut(removed, after)])
            }
            Self::Grpc(stream) => Ok(stream.send(part).await?),
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
                (vec![], serde_json::value::to_raw_value(&properties)?)
            }
            Self::Http { client, .. } => (vec![], client.mass_properties().await?),
            Self::Grpc(stream) => {
                let (cuts, properties) = stream.finish().await?;
                (cuts, RawValue::from_string(properties)?)
            }
        })
    }
}

/// What a change removed and the state after it, from the API's answer to it; none when it is not that.
fn read(answer: &Value) -> Option<(i128, State)> {
    let removed = answer["volume_removed_exact"].as_str()?.parse().ok()?;
    Some((removed, State::read(&answer["mass_properties"])?))
}
