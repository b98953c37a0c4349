//! The log of a scene: what was answered survives everything but the loss of the disk.
//!
//! Knows records, snapshots, SQLite and CRCs. Never knows the engine, async or the wire; nor, but for cubes, what a body is (`kind`).
//!
//! ```text
//!   append ──> changes, operations, keys ──┐                         ┌──> replay: chunks, then later changes
//!   snapshot_add ──> chunks ───────────────┴─> one SQLite database ──┼──> HistoryReader: totals by seq
//!              superblock: which rows there must be                  └──> verify
//! ```
//! Why a wrong total cannot come out, whatever happens to the files:
//! - A row other than the superblock is written once and sealed with a CRC, so a row that is there is right (`tables`).
//! - The superblock is part of every transaction and says which rows there must be, so none is missing and none too many.
//! - SQLite cuts a damaged write-ahead file off without a word; `wal` has looked at it before, and `files` keeps a commit
//!   marker outside: what was answered for. So damage in the middle is refused and a lost end is told.
//! - A write-ahead file that was cut can be older than the database it is laid over. Then the superblock is older than some
//!   page; SQLite's own check of its structure (`replay`) and the rows themselves show it.
//!
//! One question asks less: rows by the numbers of moves are found through an index, and how many there must be is written
//! nowhere. A damaged index can leave rows out of that answer; the rows that are in it are right, and no state depends on it.

mod backup;
mod bytes;
mod chunks;
mod codec;
mod columns;
mod database;
mod files;
#[doc(hidden)]
pub mod fuzzing;
mod history;
mod kind;
mod replay;
mod revert;
mod scene;
mod snapshot;
mod tables;
mod totals;
mod trim;
mod wal;

use std::path::PathBuf;

use crate::geometry::{CubeId, Effect};

pub use backup::restore;
pub use bytes::{Malformed, Reader};
pub(crate) use bytes::{put_signed, put_varint};
pub use codec::RECORD_CUBES_MAX;
pub use columns::{ColumnReader, ColumnWriter};
pub use files::{
    FILE_MODE, TEMPORARY_PREFIX, close_to_others, create_directories, is_of, is_open_to_others,
    remove_leftovers, remove_scene, write_ahead_bytes,
};
pub use history::HistoryReader;
pub(crate) use kind::COORDINATE_BYTES_MAX;
pub use kind::{Cubes, Kind};
pub use revert::Step;
pub use scene::{Log, SceneLog};
pub(crate) use totals::{put_bounds, read_bounds};

/// Number of a change in its scene: 1 for the first; 0 is the empty scene before it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
pub struct Seq(pub u64);

/// Which movement of a machine a change belongs to, as far as its sender says.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Motion {
    /// The sender's own number of the move or program line.
    pub number: Option<u64>,
    /// Machine time it took, in nanoseconds.
    pub duration_ns: Option<u64>,
}

impl Motion {
    /// Whether anything is said.
    pub fn is_said(&self) -> bool {
        self.number.is_some() || self.duration_ns.is_some()
    }
}

/// One accepted change.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Record<K: Kind = Cubes> {
    /// Its number.
    pub seq: Seq,
    /// When it was accepted, in milliseconds since 1970.
    pub at_ms: u64,
    /// What it did to the set of bodies.
    pub effect: Effect<K::Body>,
    /// The seq whose bodies it has brought back, when it is a revert.
    pub reverts_to: Option<Seq>,
    /// What it belongs to.
    pub motion: Motion,
    /// Volume it removed from the stock, or added to the union where there is no stock. Units: as of the kind's totals (cubes: steps cubed).
    pub volume_removed: i128,
    /// The totals after it.
    pub totals: K::Totals,
}

/// What was answered to a change, so that a retry with the same key is answered the same.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct RecordedOutcome<K: Kind = Cubes> {
    /// The scene's seq after the change.
    pub seq: Seq,
    /// When that was, in milliseconds since 1970.
    pub at_ms: u64,
    /// Cubes it inserted.
    pub inserted: u64,
    /// Cubes it deleted.
    pub deleted: u64,
    /// Operations that changed nothing.
    pub unchanged: u64,
    /// First and last id the server gave.
    pub assigned: Option<(CubeId, CubeId)>,
    /// As of the record; 0 when there is none.
    pub volume_removed: i128,
    /// Totals at `seq`.
    pub totals: K::Totals,
}

/// An idempotency key with what it stands for.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct KeyRecord<K: Kind = Cubes> {
    /// The client's key, at most 64 bytes.
    pub key: Box<str>,
    /// SHA-256 of the body it came with.
    pub body: [u8; 32],
    /// What was answered.
    pub answer: RecordedOutcome<K>,
}

/// What is fixed when a scene is created.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Header<K: Kind = Cubes> {
    /// Random name of this life of the scene: differs when a scene is dropped and created again.
    pub incarnation: u64,
    /// Edge in steps; 0 where bodies are no cubes.
    pub edge_steps: u32,
    /// The material that is cut, if any.
    pub stock: Option<K::Stock>,
    /// The settings as the wire wrote them; opaque here.
    pub settings: String,
}

/// What a replay meets, in this order: the newest snapshot (if any), its chunks, its end, then changes by seq.
#[derive(Debug)]
pub enum Replayed<'a, K: Kind = Cubes> {
    /// There is a snapshot.
    SnapshotBegin {
        /// How many live bodies it has.
        cubes: u64,
    },
    /// Some live bodies of the snapshot.
    Cubes(&'a [(CubeId, K::Body)]),
    /// The snapshot is complete: the totals must be these.
    SnapshotEnd {
        /// Seq of the snapshot.
        seq: Seq,
        /// Time of that seq.
        at_ms: u64,
        /// Totals at that seq.
        totals: &'a K::Totals,
        /// The next id the server may give.
        next_id: u64,
    },
    /// One change: after it the totals must be the record's.
    Change(&'a Record<K>),
}

/// Why the log did not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// No space left on the device.
    #[error("no space left for {path}")]
    Full {
        /// File.
        path: PathBuf,
    },
    /// Other I/O or SQLite trouble.
    #[error("{path}: {cause}")]
    Failed {
        /// File.
        path: PathBuf,
        /// What happened.
        cause: String,
    },
    /// A record is damaged.
    #[error("{path}: damaged at seq {}: {detail}", seq.0)]
    Damaged {
        /// File.
        path: PathBuf,
        /// Where.
        seq: Seq,
        /// What, and what to do.
        detail: String,
    },
    /// Of a newer format than this program knows: a newer program reads it.
    #[error(
        "{path}: the log is of format {format}, this program knows {known}: a newer version of it reads this scene"
    )]
    Newer {
        /// File.
        path: PathBuf,
        /// Its format.
        format: i32,
        /// The newest that this program knows.
        known: i32,
    },
    /// Not a union3d log, or of a version this program does not know.
    #[error("{path}: {detail}")]
    Foreign {
        /// File.
        path: PathBuf,
        /// What.
        detail: String,
    },
}

/// Limits of what is kept.
#[derive(Clone, Copy, Debug)]
pub struct Keep {
    /// Newest changes whose totals are kept.
    pub history_changes_max: u64,
    /// Newest idempotency keys kept.
    pub idempotency_keys_max: u64,
    /// Newest changes whose operations are kept behind a snapshot, to revert by.
    pub revert_changes_max: u64,
    /// Most bytes of operations kept for that.
    pub revert_bytes_max: u64,
    /// A log shorter than this since its last snapshot is replayed in a moment: it wants none.
    pub snapshot_log_bytes_min: u64,
    /// Pages of SQLite's write-ahead file from which on they are moved into the database.
    pub write_ahead_pages_max: u64,
}

/// One row of the history.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct HistoryRow<K: Kind = Cubes> {
    /// Number of the change.
    pub seq: Seq,
    /// Its time, ms since 1970.
    pub at_ms: u64,
    /// Bodies it inserted.
    pub inserted: u64,
    /// Bodies it deleted.
    pub deleted: u64,
    /// What it belongs to.
    pub motion: Motion,
    /// Volume it removed from the stock, or added to the union where there is no stock. Units: as of the kind's totals (cubes: steps cubed).
    pub volume_removed: i128,
    /// Totals after it.
    pub totals: K::Totals,
}
