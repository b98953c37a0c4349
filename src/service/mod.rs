//! Scenes and their writers: from a submitted change to durable, published totals.
//!
//! Knows scenes, queues, threads and durability. Never knows HTTP, JSON, user units or floats.
//!
//! ```text
//!   Service (registry) ── names to scenes, the data directory and its lock
//!     └─ Scene ── what clients hold: change, published, subscribe, history, questions
//!          │  inbox (bounded)                     ▲ feed (totals that are durable; the set of cubes as it is durable)
//!          ▼                                      │
//!        writer ── one thread: judge, apply, append with one sync, publish, answer; upkeep in between
//!          └─ lifecycle ── open the log, replay it, serve, and again after a failure
//!   MemoryScene ── the same judgement and answers without a log: for a program that keeps a scene in its own memory
//! ```

mod any;
mod backup;
mod before;
mod budget;
mod clock;
mod copying;
mod failpoint;
mod feed;
mod gate;
mod gauges;
mod inbox;
mod judge;
mod kind;
mod lifecycle;
mod load;
mod machine;
mod memory;
mod meters;
mod next_id;
mod offline;
mod places;
mod reading;
mod registry;
mod replay;
mod revert;
mod scene;
mod set;
mod solids;
mod table;
mod together;
mod upkeep;
mod writer;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::engine::{Counts, Op, Rejected};
use crate::geometry::{CUBES_MAX, CubeId};
pub use crate::log::{Cubes, HistoryRow, Kind, Motion, Seq};
pub use any::{AnyScene, SceneFacts, SolidScene};
pub use backup::Copied;
pub use budget::{Budget, Client, Share};
pub use failpoint::{FailHook, FailPoint};
pub use gauges::{Gauges, Spread, StateGauges};
pub use kind::SceneKind;
pub use load::Load;
pub use machine::{Disk, memory_limit_bytes};
pub use memory::MemoryScene;
pub use meters::{Meter, describe_metrics};
pub use offline::{AnyAudit, Offline, OfflineAudit};
pub use reading::{Reading, Selected};
pub use registry::Service;
pub use scene::{Scene, SceneOf};
pub use solids::{NamedShape, SHAPES_MAX, Shapes, SolidTotals, Solids};

/// Most operations of one change: what one record of the log holds.
pub const CHANGE_OPERATIONS_MAX: usize = crate::log::RECORD_CUBES_MAX;

/// How the service runs. Everything has a default but the directory.
#[derive(Clone, Debug)]
pub struct ServiceConfig {
    /// Data directory.
    pub data: PathBuf,
    /// Changes that may wait in one scene's queue.
    pub queue_changes_max: usize,
    /// Operations that may wait in one scene's queue, whatever the number of changes; a single larger change still fits an empty
    /// queue. Bounds its memory (some hundred megabytes).
    pub queue_operations_max: usize,
    /// Operations that one group commit takes together (a single larger change is taken alone).
    pub group_operations_max: usize,
    /// Newest changes whose totals are kept.
    pub history_changes_max: u64,
    /// Newest idempotency keys kept, per scene.
    pub idempotency_keys_max: u64,
    /// Newest changes of a scene that can be reverted, however large it is.
    pub revert_changes_max: u64,
    /// Most bytes kept for that, per scene.
    pub revert_bytes_max: u64,
    /// A log shorter than this since its last snapshot wants none. In bytes.
    pub snapshot_log_bytes_min: u64,
    /// Cubes of a snapshot that are read and written between two groups: the default takes a few milliseconds.
    pub snapshot_step_cubes: usize,
    /// Pages of 4 KiB in a scene's write-ahead file from which on they are moved into its database.
    pub write_ahead_pages_max: u64,
    /// How long a stopped scene waits between two tries of the disk.
    pub probe_interval: Duration,
    /// Most cubes of a scene.
    pub scene_cubes_max: u64,
    /// Scenes that are replayed at the same time: each replay can use all cores, and takes memory.
    pub replays_max: usize,
    /// Most scenes.
    pub scenes_max: usize,
    /// Free bytes of the data directory's file system below which nothing more is taken in.
    pub disk_free_bytes_min: u64,
    /// The memory that requests and audits share, in bytes.
    pub memory_bytes_max: u64,
}

/// A scene's name: `[a-z0-9][a-z0-9._-]{0,62}`.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct SceneName(String);

/// Totals that are durable and visible.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Published<K: Kind = Cubes> {
    /// Newest durable change.
    pub seq: Seq,
    /// Its time, ms since 1970 (the scene's creation for seq 0).
    pub at_ms: u64,
    /// Totals after it.
    pub totals: K::Totals,
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
pub enum Operations<K: Kind = Cubes> {
    /// With the client's ids.
    Named(Vec<Op<K::Body>>),
    /// Deletions by id, then insertions that the server numbers (consecutive ids).
    Numbered {
        /// Ids to delete.
        delete: Vec<CubeId>,
        /// Bodies to insert.
        insert: Vec<K::Body>,
    },
    /// Whatever makes the set of bodies what it was at this seq. O(operations since).
    Revert(Seq),
    /// Says what these would do if they came next: the answer is as if they had been applied, but nothing is, and no seq is taken.
    DryRun(Box<Operations<K>>),
    /// Defines something that bodies stand on, as the log keeps it: no change of the set, and no seq.
    Define(Box<[u8]>),
}

/// One change on its way in.
#[derive(Clone, Debug)]
pub struct Submission<K: Kind = Cubes> {
    /// What to do.
    pub operations: Operations<K>,
    /// How to count it.
    pub counting: Counting,
    /// Which movement of a machine it belongs to. A change for which something is said here takes a seq even when it changes no
    /// cube: time has passed, and nothing was cut.
    pub motion: Motion,
    /// By which a retry is known.
    pub key: Option<Key>,
}

/// An idempotency key, and SHA-256 of the body that came with it.
pub type Key = (Box<str>, [u8; 32]);

/// Changes of one stream: after one that was not applied none is, also not those that were queued already.
#[derive(Clone, Debug, Default)]
pub struct Chain(Arc<AtomicBool>);

/// A change that is durable (or changed nothing).
#[derive(Clone, Debug)]
pub struct Applied<K: Kind = Cubes> {
    /// Seq, time and totals after it.
    pub published: Published<K>,
    /// What the operations did.
    pub counts: Counts,
    /// First and last id the server gave.
    pub assigned: Option<(CubeId, CubeId)>,
    /// Volume it removed from the stock, or added to the union where there is no stock. Units: as of the kind's totals (cubes: steps cubed).
    pub volume_removed: i128,
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
    /// A newer version of this program made its files; this one leaves them alone.
    Newer {
        /// Which.
        cause: String,
    },
}

impl SceneState {
    /// The names of all states, in the order of [`SceneState::index`].
    pub const NAMES: [&str; 5] = ["running", "recovering", "stopped", "damaged", "newer"];

    /// Which of [`SceneState::NAMES`] it is.
    pub fn index(&self) -> usize {
        match self {
            Self::Running => 0,
            Self::Recovering { .. } => 1,
            Self::Stopped { .. } => 2,
            Self::Damaged { .. } => 3,
            Self::Newer { .. } => 4,
        }
    }
}

/// Why the service did not do what it was asked. Nothing has changed then, with the one exception that [`Scene::change`] names.
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
    /// A newer version of this program made the scene's files.
    #[error("the scene is refused: {cause}")]
    Newer {
        /// Which.
        cause: String,
    },
    /// Too many changes wait.
    #[error("{waiting} changes are waiting already")]
    QueueFull {
        /// How many.
        waiting: usize,
    },
    /// A reading of all bodies took so long that too much has changed.
    #[error(
        "more than {changed} bodies have changed while the listing was read; list again, and read faster"
    )]
    ReadTooSlowly {
        /// How many may change.
        changed: usize,
    },
    /// There are as many scenes as may be.
    #[error("there are {scenes} scenes, as many as may be")]
    TooManyScenes {
        /// How many.
        scenes: usize,
    },
    /// What requests share of the memory is used up, or the client's share of it.
    #[error(
        "it takes {wanted} bytes of the memory that requests share, of which so many are not free for it now"
    )]
    MemoryUsed {
        /// How many bytes it takes.
        wanted: u64,
    },
    /// The change does not fit the scene.
    #[error(transparent)]
    Rejected(#[from] Rejected),
    /// The change does not fit the scene of solids.
    #[error(transparent)]
    RejectedSolids(#[from] crate::engine::solids::Rejected),
    /// What is to be defined cannot be.
    #[error("{cause}")]
    NotDefined {
        /// Why.
        cause: String,
    },
    /// The scene is of another kind than what is asked.
    #[error("scene {name:?} is of {kind}; this call is for scenes of another kind")]
    OtherKind {
        /// Its name.
        name: String,
        /// Its kind, in words.
        kind: &'static str,
    },
    /// One record does not hold the change.
    #[error(
        "the change has {operations} operations, and one change holds at most {CHANGE_OPERATIONS_MAX}; go back by way of a seq in between, or send it in parts"
    )]
    TooManyOperations {
        /// How many it has.
        operations: usize,
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
    /// The cubes of that seq are no longer known: the changes since are in a snapshot.
    #[error("seq {} cannot be gone back to any more; the oldest that can is {}", seq.0, oldest.0)]
    NotReachable {
        /// Asked for.
        seq: Seq,
        /// Oldest there is.
        oldest: Seq,
    },
    /// A change before it in its chain was not applied.
    #[error("a change before it in its stream was not applied")]
    Abandoned,
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
pub struct Audit<K: Kind = Cubes> {
    /// Seq it is as of.
    pub seq: Seq,
    /// Totals kept.
    pub kept: K::Totals,
    /// Totals recounted from the bodies alone.
    pub recounted: K::Totals,
}

impl<K: SceneKind> Audit<K> {
    /// Whether the totals kept are those recounted.
    pub fn is_equal(&self) -> bool {
        K::agree(&self.kept, &self.recounted)
    }
}

impl ServiceConfig {
    /// The defaults, for a data directory.
    pub fn new(data: impl Into<PathBuf>) -> Self {
        Self {
            data: data.into(),
            queue_changes_max: 1024,
            queue_operations_max: 1 << 24,
            group_operations_max: 65_536,
            history_changes_max: 10_000_000,
            idempotency_keys_max: 100_000,
            revert_changes_max: 1_000_000,
            revert_bytes_max: 1 << 30,
            snapshot_log_bytes_min: 16 << 20,
            snapshot_step_cubes: 1 << 16,
            write_ahead_pages_max: 1000,
            probe_interval: Duration::from_secs(1),
            scene_cubes_max: CUBES_MAX,
            replays_max: 2,
            scenes_max: 10_000,
            disk_free_bytes_min: 0,
            memory_bytes_max: 1 << 30,
        }
    }
}

impl Chain {
    /// Whether a change of it was not applied.
    pub fn is_broken(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }

    /// Keeps the changes that come after from being applied.
    fn break_off(&self) {
        self.0.store(true, Ordering::Release);
    }
}

impl SceneName {
    /// Most bytes of a name.
    const BYTES_MAX: usize = 63;

    /// Checks a name; the error says what is wrong.
    pub fn new(name: &str) -> Result<Self, String> {
        let Some(first) = name.bytes().next() else {
            return Err("a scene's name is empty".to_owned());
        };
        if name.len() > Self::BYTES_MAX {
            return Err(format!(
                "a scene's name has {} bytes; the most is {}",
                name.len(),
                Self::BYTES_MAX
            ));
        }
        let plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit();
        if !plain(first) {
            return Err(format!(
                "a scene's name begins with a-z or 0-9, not {name:?}"
            ));
        }
        match name
            .chars()
            .find(|&c| !(c.is_ascii_lowercase() || c.is_ascii_digit() || "._-".contains(c)))
        {
            Some(wrong) => Err(format!(
                "a scene's name is made of a-z, 0-9, '.', '_' and '-', not {wrong:?}"
            )),
            None => Ok(Self(name.to_owned())),
        }
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}
