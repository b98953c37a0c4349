//! Scenes and their writers (skeleton: the contract with `wire` and `cli`).
//!
//! Knows scenes, queues, threads and durability. Never knows HTTP, JSON, user units or floats.

use std::{path::PathBuf, sync::Arc, time::Duration};

use crate::engine::{Counts, Cursor, Op, Rejected, Side};
use crate::geometry::{CubeId, Edge, Place, Totals};
pub use crate::log::{HistoryRow, Seq};

/// How the service runs. Everything has a default but the directory.
#[derive(Clone, Debug)]
pub struct ServiceConfig {
    /// Data directory.
    pub data: PathBuf,
    /// Changes that may wait in one scene's queue.
    pub queue_changes_max: usize,
    /// Operations that one group commit takes together (a single larger change is taken alone).
    pub group_operations_max: usize,
    /// Newest changes whose totals are kept.
    pub history_changes_max: u64,
    /// Newest idempotency keys kept, per scene.
    pub idempotency_keys_max: u64,
    /// How long a stopped scene waits between two tries of the disk.
    pub probe_interval: Duration,
}

/// A scene's name: `[a-z0-9][a-z0-9._-]{0,62}`.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct SceneName(String);

/// Totals that are durable and visible.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Published {
    /// Newest durable change.
    pub seq: Seq,
    /// Its time, ms since 1970 (the scene's creation for seq 0).
    pub at_ms: u64,
    /// Totals after it.
    pub totals: Totals,
}

/// How operations are counted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Counting {
    /// By net effect: an atomic change.
    Net,
    /// One after the other: a slice of a stream.
    InOrder,
}

/// What a client wants done.
#[derive(Clone, Debug)]
pub enum Operations {
    /// With the client's ids.
    Named(Vec<Op>),
    /// Deletions by id, then insertions that the server numbers (consecutive ids).
    Numbered {
        /// Ids to delete.
        delete: Vec<CubeId>,
        /// Places to insert.
        insert: Vec<Place>,
    },
}

/// One change on its way in.
#[derive(Clone, Debug)]
pub struct Submission {
    /// What to do.
    pub operations: Operations,
    /// How to count it.
    pub counting: Counting,
    /// Idempotency key and SHA-256 of the body.
    pub key: Option<(Box<str>, [u8; 32])>,
}

/// A change that is durable (or changed nothing).
#[derive(Clone, Debug)]
pub struct Applied {
    /// Seq, time and totals after it.
    pub published: Published,
    /// What the operations did.
    pub counts: Counts,
    /// First and last id the server gave.
    pub assigned: Option<(CubeId, CubeId)>,
    /// Whether this is the recorded answer of an earlier request with the same key.
    pub replayed: bool,
}

/// Whether the service can answer for all its scenes.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Readiness {
    /// It can (a scene stopped or refused is reported by its own calls and in `troubled`).
    Ready {
        /// Scenes that are stopped or damaged, with the cause.
        troubled: Vec<(SceneName, String)>,
    },
    /// Replay is under way.
    Recovering {
        /// How far, over all scenes, 0 to 100.
        percent: u8,
    },
}

/// A scene's own state.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum SceneState {
    /// Answers.
    Running,
    /// Is being replayed.
    Recovering {
        /// 0 to 100.
        percent: u8,
    },
    /// A write failed; it comes back by itself.
    Stopped {
        /// Why.
        cause: String,
        /// Whether the disk is full.
        full: bool,
    },
    /// Its files are damaged; it does not come back by itself.
    Damaged {
        /// What, where, and what to do.
        cause: String,
    },
}

/// Why the service did not do what it was asked. Nothing has changed then.
#[derive(Clone, Debug, thiserror::Error)]
pub enum ServiceError {
    /// No scene of this name.
    #[error("there is no scene {0:?}")]
    NoSuchScene(String),
    /// A scene of this name exists with other settings.
    #[error("scene {name:?} exists with other settings")]
    SceneExists {
        /// Its name.
        name: String,
        /// Its settings.
        settings: String,
    },
    /// The scene is being replayed.
    #[error("the scene is being replayed: {percent} %")]
    Recovering {
        /// How far.
        percent: u8,
    },
    /// The scene is stopped after a failed write.
    #[error("the scene is stopped: {cause}")]
    Stopped {
        /// Why.
        cause: String,
        /// Whether the disk is full.
        full: bool,
    },
    /// The scene's files are damaged.
    #[error("the scene is refused: {cause}")]
    Damaged {
        /// What, where, and what to do.
        cause: String,
    },
    /// Too many changes wait.
    #[error("{waiting} changes are waiting already")]
    QueueFull {
        /// How many.
        waiting: usize,
    },
    /// The change does not fit the scene.
    #[error(transparent)]
    Rejected(#[from] Rejected),
    /// No more ids to give.
    #[error("the server has no {wanted} consecutive ids left to give")]
    IdsExhausted {
        /// How many were wanted.
        wanted: u64,
    },
    /// The key came before with another body.
    #[error("the idempotency key was used with another body")]
    KeyReused,
    /// The totals of that seq are no longer kept.
    #[error("seq {} is no longer kept; the oldest is {}", seq.0, oldest.0)]
    SeqNotKept {
        /// Asked for.
        seq: Seq,
        /// Oldest there is.
        oldest: Seq,
    },
    /// The scene has not come to that seq.
    #[error("seq {} has not come; the newest is {}", seq.0, newest.0)]
    SeqNotReached {
        /// Asked for.
        seq: Seq,
        /// Newest there is.
        newest: Seq,
    },
    /// The service is shutting down.
    #[error("the service is shutting down")]
    ShuttingDown,
    /// The data directory does not take the scene's files.
    #[error("{cause}")]
    Storage {
        /// Why.
        cause: String,
        /// Whether the disk is full.
        full: bool,
    },
}

/// Why the service cannot start.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct StartError(pub String);

/// The result of an audit.
#[derive(Clone, Debug)]
pub struct Audit {
    /// Seq it is as of.
    pub seq: Seq,
    /// Totals kept.
    pub kept: Totals,
    /// Totals recounted from the cubes alone.
    pub recounted: Totals,
}

/// All scenes of a data directory.
#[derive(Clone, Debug)]
pub struct Service {}

/// One scene.
#[derive(Debug)]
pub struct Scene {}

#[expect(unused_variables, reason = "skeleton")]
impl Service {
    /// Locks the data directory and starts to replay its scenes in the background.
    pub fn start(config: ServiceConfig) -> Result<Self, StartError> {
        unimplemented!()
    }
    /// Whether replay is done.
    pub fn readiness(&self) -> Readiness {
        unimplemented!()
    }
    /// Creates a scene, durably; true when it is new, false when it was there with the same settings.
    pub async fn create(
        &self,
        name: &SceneName,
        edge: Edge,
        settings: &str,
    ) -> Result<(Arc<Scene>, bool), ServiceError> {
        unimplemented!()
    }
    /// Drops a scene with its data.
    pub async fn remove(&self, name: &SceneName) -> Result<(), ServiceError> {
        unimplemented!()
    }
    /// A scene by name.
    pub fn scene(&self, name: &str) -> Result<Arc<Scene>, ServiceError> {
        unimplemented!()
    }
    /// All scenes, by name.
    pub fn scenes(&self) -> Vec<Arc<Scene>> {
        unimplemented!()
    }
    /// Refuses new changes, finishes those that wait, closes the logs.
    pub async fn shutdown(&self) {
        unimplemented!()
    }
}

impl SceneName {
    /// Checks a name; the error says what is wrong.
    pub fn new(name: &str) -> Result<Self, String> {
        let _ = name;
        unimplemented!()
    }
    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

#[expect(unused_variables, reason = "skeleton")]
impl Scene {
    /// Its name.
    pub fn name(&self) -> &SceneName {
        unimplemented!()
    }
    /// Its settings, as given to `create`.
    pub fn settings(&self) -> &str {
        unimplemented!()
    }
    /// Edge of its cubes.
    pub fn edge(&self) -> Edge {
        unimplemented!()
    }
    /// Random name of this life of the scene.
    pub fn incarnation(&self) -> u64 {
        unimplemented!()
    }
    /// How it is.
    pub fn state(&self) -> SceneState {
        unimplemented!()
    }
    /// Newest durable totals. Never waits for the writer.
    pub fn published(&self) -> Result<Published, ServiceError> {
        unimplemented!()
    }
    /// Submits a change and waits until it is durable. Dropping the future does not undo the change.
    pub async fn change(&self, submission: Submission) -> Result<Applied, ServiceError> {
        unimplemented!()
    }
    /// Newest totals now and whenever they change; a slow reader skips to the newest. None once the scene is dropped or stopped.
    pub fn subscribe(&self) -> Result<tokio::sync::watch::Receiver<Published>, ServiceError> {
        unimplemented!()
    }
    /// The first published state at or after `seq`; None after `timeout`.
    pub async fn wait_for(
        &self,
        seq: Seq,
        timeout: Duration,
    ) -> Result<Option<Published>, ServiceError> {
        unimplemented!()
    }
    /// A past state.
    pub async fn at(&self, seq: Seq) -> Result<Published, ServiceError> {
        unimplemented!()
    }
    /// Rows of the history from `from` to `to`, at most `limit`.
    pub async fn history(
        &self,
        from: Seq,
        to: Seq,
        limit: usize,
    ) -> Result<Vec<HistoryRow>, ServiceError> {
        unimplemented!()
    }
    /// Where a cube is.
    pub async fn cube(&self, id: CubeId) -> Result<Option<Place>, ServiceError> {
        unimplemented!()
    }
    /// A page of cubes, as `Engine::page`.
    pub async fn page(
        &self,
        after: Option<Cursor>,
        limit: usize,
    ) -> Result<(Vec<(CubeId, Place)>, Option<Cursor>), ServiceError> {
        unimplemented!()
    }
    /// All cubes as of one seq.
    pub async fn cubes(&self) -> Result<(Seq, Vec<(CubeId, Place)>), ServiceError> {
        unimplemented!()
    }
    /// Where a point lies.
    pub async fn contains(
        &self,
        point: [i32; 3],
    ) -> Result<(Seq, Side, Option<(CubeId, Place)>), ServiceError> {
        unimplemented!()
    }
    /// Recounts everything from the cubes alone, on another thread, and compares.
    pub async fn audit(&self) -> Result<Audit, ServiceError> {
        unimplemented!()
    }
}
