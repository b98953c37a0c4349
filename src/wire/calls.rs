//! What a call does between its decoding and its answer, the same over HTTP and gRPC.

use std::any::Any;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use sha2::{Digest, Sha256};

use super::convert::Settings;
use super::kind::{HistoryTotals, Opened, ShownKind};
use super::problem::{Code, Fault, Problem};
use super::solids::{DefinedShape, NewSolids, Scale, SolidSettings};
use crate::engine::solids::Body;
use crate::geometry::convex::Point;
use crate::geometry::{CubeId, Place};
use crate::service::{
    AnyScene, Applied, Audit, Counting, Cubes, HistoryRow, Motion, NamedShape, Operations,
    Published, Scene, SceneKind, SceneName, SceneOf, Seq, Service, ServiceError, SolidScene,
    Submission,
};

/// The settings that a scene was given when it was created, read once in its life; none when they are in a form that is not known.
pub(super) fn settings<K: ShownKind>(scene: &SceneOf<K>) -> Option<Arc<K::Settings>> {
    scene.settings_as(K::settings)
}

/// A scene of cubes with its settings.
pub(super) fn open(service: &Service, name: &str) -> Result<(Arc<Scene>, Arc<Settings>), Problem> {
    with_settings(service.scene(name)?)
}

/// A scene of solids with its settings.
pub(super) fn open_solids(
    service: &Service,
    name: &str,
) -> Result<(Arc<SolidScene>, Arc<SolidSettings>), Problem> {
    with_settings(service.solid_scene(name)?)
}

/// A scene of either kind with its settings.
pub(super) fn open_any(service: &Service, name: &str) -> Result<Opened, Problem> {
    Ok(match service.any_scene(name)? {
        AnyScene::Cubes(scene) => {
            let (scene, settings) = with_settings(scene)?;
            Opened::Cubes(scene, settings)
        }
        AnyScene::Solids(scene) => {
            let (scene, settings) = with_settings(scene)?;
            Opened::Solids(scene, settings)
        }
    })
}

/// A scene with its settings.
type WithSettings<K> = (Arc<SceneOf<K>>, Arc<<K as ShownKind>::Settings>);

fn with_settings<K: ShownKind>(scene: Arc<SceneOf<K>>) -> Result<WithSettings<K>, Problem> {
    let Some(settings) = settings(&scene) else {
        // A scene that does not run says why by itself; one that runs has settings.
        scene.published()?;
        return Err(Problem::new(
            Code::Internal,
            "the scene's settings are in a form that this version does not know",
        ));
    };
    Ok((scene, settings))
}

/// The name of a scene's life, in a form that every JSON reader keeps exact.
pub(super) fn incarnation(number: u64) -> String {
    format!("{number:016x}")
}

/// A name that a scene can have.
pub(super) fn scene_name(name: &str) -> Result<SceneName, Problem> {
    SceneName::new(name).map_err(|detail| Fault::in_parameter("scene", detail, name).into())
}

/// Creates a scene; true when it is new.
pub(super) async fn create(
    service: &Service,
    name: &SceneName,
    settings: &Settings,
) -> Result<(Arc<Scene>, bool), Problem> {
    let created = service
        .create(name, settings.edge(), settings.stock(), &settings.text())
        .await;
    Ok(created?)
}

/// Creates a scene of solids; true when it is new.
pub(super) async fn create_solids(
    service: &Service,
    name: &SceneName,
    wanted: &NewSolids,
) -> Result<(Arc<SolidScene>, bool), Problem> {
    let NewSolids {
        settings,
        stock,
        shapes,
    } = wanted;
    let text = settings.text();
    Ok(service
        .create_solids(name, stock.clone(), shapes, &text)
        .await?)
}

/// Defines a shape of a scene: the shape as it is there then.
pub(super) async fn define(scene: &SolidScene, shape: NamedShape) -> Result<DefinedShape, Problem> {
    let submission = Submission {
        operations: Operations::Define(shape.definition()),
        counting: Counting::Net,
        motion: Motion::default(),
        key: None,
    };
    scene.change(submission).await?;
    let shapes = scene.context()?;
    let defined = shapes.get(&shape.name).and_then(DefinedShape::of);
    defined.ok_or_else(|| Problem::new(Code::Internal, "the shape is kept in an unknown form"))
}

/// A solid by its id.
pub(super) async fn solid(scene: &SolidScene, id: CubeId) -> Result<Body, Problem> {
    let found = scene.body(id).await?;
    found.ok_or_else(|| {
        let name = scene.name().as_str();
        let detail = format!("there is no solid {} in scene {name:?}", id.0);
        Problem::new(Code::NoSuchCube, detail)
    })
}

/// Drops a scene with its data.
pub(super) async fn remove(service: &Service, name: &str) -> Result<(), Problem> {
    // A name that cannot exist is one that does not.
    let no_such = |_| ServiceError::NoSuchScene(name.to_owned());
    let name = SceneName::new(name).map_err(no_such)?;
    Ok(service.remove(&name).await?)
}

/// An idempotency key as it was sent.
pub(super) fn idempotency_key(sent: &[u8]) -> Result<Box<str>, Problem> {
    key(sent).map_err(|fault| {
        let parameter = Some("Idempotency-Key".into());
        Fault { parameter, ..fault }.into()
    })
}

/// An idempotency key, or what is wrong with it, without its place.
pub(super) fn key(sent: &[u8]) -> Result<Box<str>, Fault> {
    let visible = sent.iter().all(u8::is_ascii_graphic);
    match std::str::from_utf8(sent) {
        Ok(key) if visible && (1..=64).contains(&key.len()) => Ok(key.into()),
        _ => {
            let detail = "is not one key of 1 to 64 visible ASCII characters";
            let sent = String::from_utf8_lossy(sent);
            let parameter = None;
            Err(Fault {
                parameter,
                ..Fault::in_parameter("", detail, &sent)
            })
        }
    }
}

/// What an idempotency key stands for: a body and how it is read.
pub(super) fn digest(kind: &str, body: &[u8]) -> [u8; 32] {
    Sha256::new()
        .chain_update(kind)
        .chain_update([0])
        .chain_update(body)
        .finalize()
        .into()
}

/// Makes the scene's cubes what they were at `to`. `body` is what the key, if any, stands for.
pub(super) async fn revert<K: SceneKind>(
    scene: &SceneOf<K>,
    to: Seq,
    key: Option<Box<str>>,
    body: &[u8],
) -> Result<Applied<K>, Problem> {
    let submission = Submission {
        operations: Operations::Revert(to),
        counting: Counting::Net,
        motion: Motion::default(),
        key: key.map(|key| (key, digest("revert", body))),
    };
    Ok(scene.change(submission).await?)
}

/// The current totals, or past ones, or those after a wait.
pub(super) async fn published<K: SceneKind>(
    scene: &SceneOf<K>,
    at: Option<u64>,
    wait: Option<u64>,
    wait_max: Duration,
) -> Result<Published<K>, Problem> {
    match (at, wait) {
        (None, None) => Ok(scene.published()?),
        (Some(seq), None) => Ok(scene.at(Seq(seq)).await?),
        (None, Some(seq)) => wait_for(scene, Seq(seq), wait_max).await,
        (Some(_), Some(seq)) => {
            let detail = "cannot stand together with at: what is past need not be waited for";
            Err(Fault::in_parameter("wait", detail, &seq.to_string()).into())
        }
    }
}

async fn wait_for<K: SceneKind>(
    scene: &SceneOf<K>,
    seq: Seq,
    time: Duration,
) -> Result<Published<K>, Problem> {
    let Some(published) = scene.wait_for(seq, time).await? else {
        let newest = scene.published()?.seq.0;
        let detail = format!(
            "seq {} did not come within {} s; the newest is {newest}",
            seq.0,
            time.as_secs_f64()
        );
        return Err(Problem::new(Code::WaitTimeout, detail).with("newest", newest));
    };
    Ok(published)
}

/// Rows of the history that are read at once.
const HISTORY_PAGE_ROWS: usize = 1_000;

/// Rows of the history on their way out, a page at a time.
pub(super) struct HistoryRows<K: SceneKind = Cubes> {
    scene: Arc<SceneOf<K>>,
    /// Where to go on; none when there are no more.
    pub(super) next: Option<u64>,
    pub(super) to: u64,
    moves: Option<[u64; 2]>,
    left: u64,
}

impl<K: SceneKind> HistoryRows<K> {
    /// Rows from one seq to another, and of moves from one number to another; what is left out has no bound.
    pub(super) fn new(
        scene: Arc<SceneOf<K>>,
        [from, to]: [Option<u64>; 2],
        [move_from, move_to]: [Option<u64>; 2],
        limit: u64,
    ) -> Result<Self, Problem> {
        let newest = scene.published()?.seq.0;
        let moves = (move_from.is_some() || move_to.is_some())
            .then(|| [move_from.unwrap_or(0), move_to.unwrap_or(u64::MAX)]);
        Ok(Self {
            scene,
            next: Some(from.unwrap_or(1).max(1)),
            to: to.unwrap_or(newest).min(newest),
            moves,
            left: limit,
        })
    }

    /// The next rows; none when there are no more, or as many as were asked for.
    pub(super) async fn page(&mut self) -> Result<Option<Vec<HistoryRow<K>>>, ServiceError> {
        let Some(from) = self.next.filter(|from| *from <= self.to) else {
            self.next = None;
            return Ok(None);
        };
        let limit = usize::try_from(self.left)
            .map_or(HISTORY_PAGE_ROWS, |left| left.min(HISTORY_PAGE_ROWS));
        if limit == 0 {
            return Ok(None);
        }
        let rows = self
            .scene
            .history(Seq(from), Seq(self.to), self.moves, limit)
            .await?;
        self.left -= rows.len() as u64;
        let last = rows.last().filter(|_| rows.len() == limit);
        self.next = last
            .map(|row| row.seq.0 + 1)
            .filter(|next| *next <= self.to);
        Ok(Some(rows))
    }
}

/// Where a cube is.
pub(super) async fn cube(scene: &Scene, id: CubeId) -> Result<Place, Problem> {
    scene.cube(id).await?.ok_or_else(|| {
        let name = scene.name().as_str();
        let detail = format!("there is no cube {} in scene {name:?}", id.0);
        Problem::new(Code::NoSuchCube, detail)
    })
}

/// What is said of a point that is none.
pub(super) const NO_POINT: &str = "is not three finite numbers x,y,z";

/// The lattice point of a point in user units; `sent` is how the client said it.
pub(super) fn point(at: [f64; 3], sent: &str, settings: &Settings) -> Result<[i32; 3], Problem> {
    if !at.iter().all(|coordinate| coordinate.is_finite()) {
        return Err(Fault::in_parameter("at", NO_POINT, sent).into());
    }
    settings.point(at).map_err(|(axis, invalid)| {
        let detail = format!("{}: {invalid}", ["x", "y", "z"][axis]);
        Fault::in_parameter("at", detail, sent).into()
    })
}

/// The same in a scene of solids.
pub(super) fn point_among_solids(at: [f64; 3], sent: &str, scale: Scale) -> Result<Point, Problem> {
    if !at.iter().all(|coordinate| coordinate.is_finite()) {
        return Err(Fault::in_parameter("at", NO_POINT, sent).into());
    }
    scale
        .point(at, "")
        .map_err(|fault| Fault::in_parameter("at", fault.to_string(), sent).into())
}

/// Recounts everything and compares: the seq that it is as of, and the number of cubes.
pub(super) async fn audit<K: ShownKind>(
    scene: &Arc<SceneOf<K>>,
    settings: &K::Settings,
) -> Result<(Seq, u64), Problem> {
    audited(scene.name().as_str(), &scene.audit().await?, settings)
}

/// What an audit of a scene has found: the seq that it is as of, and the number of cubes.
pub(super) fn audited<K: ShownKind>(
    name: &str,
    audit: &Audit<K>,
    settings: &K::Settings,
) -> Result<(Seq, u64), Problem> {
    if audit.is_equal() {
        return Ok((audit.seq, K::count(&audit.recounted)));
    }
    let seq = audit.seq.0;
    let shown = |totals| {
        serde_json::to_value(K::properties(Some(name), Some(seq), totals, settings))
            .expect("numbers and strings are JSON")
    };
    let detail = format!(
        "at seq {seq} the totals of scene {name:?} are not those of its {}",
        K::Properties::BODIES
    );
    Err(Problem::new(Code::AuditDifference, detail)
        .with("seq", seq)
        .with("kept", shown(&audit.kept))
        .with("recounted", shown(&audit.recounted)))
}

/// Answers after `time` at the latest.
pub(super) async fn within<T>(
    time: Duration,
    work: impl Future<Output = Result<T, Problem>>,
) -> Result<T, Problem> {
    let Ok(done) = tokio::time::timeout(time, work).await else {
        let detail = format!("there was no answer within {} s", time.as_secs_f64());
        return Err(Problem::new(Code::AnswerTimeout, detail));
    };
    done
}

/// The problem of a handler that panicked.
pub(super) fn panicked(cause: &(dyn Any + Send)) -> Problem {
    let text = cause
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| cause.downcast_ref::<&str>().copied());
    tracing::error!(cause = text.unwrap_or("unknown"), "a handler panicked");
    let detail = "the server's log has the cause, by the request's id";
    Problem::new(Code::Internal, detail)
}
