//! The log of a scene (skeleton: the contract with `service`).
//!
//! Knows records, snapshots, SQLite and CRCs. Never knows the engine, async or the wire.

use std::path::{Path, PathBuf};

use crate::geometry::{CubeId, Effect, Place, Totals};

/// Number of a change in its scene: 1 for the first; 0 is the empty scene before it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
pub struct Seq(pub u64);

/// One accepted change.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Record {
    /// Its number.
    pub seq: Seq,
    /// When it was accepted, in milliseconds since 1970.
    pub at_ms: u64,
    /// What it did to the set of cubes.
    pub effect: Effect,
    /// The totals after it.
    pub totals: Totals,
}

/// What was answered to a change, so that a retry with the same key is answered the same.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Answer {
    /// The scene's seq after the change.
    pub seq: Seq,
    /// When that was, in milliseconds since 1970.
    pub at_ms: u64,
    /// Counts.
    pub inserted: u64,
    /// Counts.
    pub deleted: u64,
    /// Counts.
    pub unchanged: u64,
    /// First and last id the server gave.
    pub assigned: Option<(CubeId, CubeId)>,
    /// Totals at `seq`.
    pub totals: Totals,
}

/// An idempotency key with what it stands for.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct KeyRecord {
    /// The client's key, at most 64 bytes.
    pub key: Box<str>,
    /// SHA-256 of the body it came with.
    pub body: [u8; 32],
    /// What was answered.
    pub answer: Answer,
}

/// What is fixed when a scene is created.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Header {
    /// Random name of this life of the scene: differs when a scene is dropped and created again.
    pub incarnation: u64,
    /// Edge in steps.
    pub edge_steps: u32,
    /// The settings as the wire wrote them; opaque here.
    pub settings: String,
}

/// What a replay meets, in this order: chunks of the newest snapshot (if any), its end, then changes by seq.
#[derive(Debug)]
pub enum Replayed<'a> {
    /// Some live cubes of the snapshot.
    Cubes(&'a [(CubeId, Place)]),
    /// The snapshot is complete: the totals must be these.
    SnapshotEnd {
        /// Seq of the snapshot.
        seq: Seq,
        /// Time of that seq.
        at_ms: u64,
        /// Totals at that seq.
        totals: &'a Totals,
        /// The next id the server may give.
        next_id: u64,
    },
    /// One change: after it the totals must be the record's.
    Change(&'a Record),
}

/// Append durably, replay from the start: all that the service asks of a log.
pub trait Log: Send {
    /// Appends records and keys, all or nothing, and returns once they are on stable storage.
    fn append(&mut self, records: &[Record], keys: &[KeyRecord]) -> Result<(), LogError>;
    /// Everything that is needed to rebuild the scene. `progress` gets a fraction in parts per thousand.
    /// `visit` answers false when the state it rebuilt differs from the totals it was shown: then [`LogError::Damaged`] names that seq.
    fn replay(
        &mut self,
        progress: &mut dyn FnMut(u32),
        visit: &mut dyn FnMut(Replayed<'_>) -> bool,
    ) -> Result<(), LogError>;
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
}

/// One row of the history.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct HistoryRow {
    /// Number of the change.
    pub seq: Seq,
    /// Its time, ms since 1970.
    pub at_ms: u64,
    /// Cubes it inserted and deleted.
    pub inserted: u64,
    /// Cubes it deleted.
    pub deleted: u64,
    /// Totals after it.
    pub totals: Totals,
}

/// A scene's log in one SQLite database.
#[derive(Debug)]
pub struct SceneLog {}

/// A scene's history, on a connection of its own: reading never waits for the writer.
#[derive(Debug)]
pub struct HistoryReader {}

#[expect(unused_variables, reason = "skeleton")]
impl SceneLog {
    /// Creates the scene's directory and log, durably, appearing whole (temporary name, then rename).
    pub fn create(directory: &Path, header: &Header, keep: Keep) -> Result<Self, LogError> {
        unimplemented!()
    }
    /// Opens an existing one. `notices` says what SQLite cut off its write-ahead file, if it did.
    pub fn open(directory: &Path, keep: Keep) -> Result<(Self, Vec<String>), LogError> {
        unimplemented!()
    }
    /// What was fixed at creation.
    pub fn header(&self) -> &Header {
        unimplemented!()
    }
    /// Newest seq in the log.
    pub fn seq(&self) -> Seq {
        unimplemented!()
    }
    /// The answer recorded for a key, with the body's hash, if it is kept. Looks in memory first: no I/O for unknown keys.
    pub fn key(&self, key: &str) -> Result<Option<KeyRecord>, LogError> {
        unimplemented!()
    }
    /// Writes and syncs something harmless: proves that the disk takes writes again.
    pub fn probe(&mut self) -> Result<(), LogError> {
        unimplemented!()
    }
    /// Whether the log has grown longer than the live set of `cubes` is worth.
    pub fn wants_snapshot(&self, cubes: u64) -> bool {
        unimplemented!()
    }
    /// Begins a snapshot as of the newest seq. An unfinished one is dropped.
    pub fn snapshot_begin(
        &mut self,
        at_ms: u64,
        totals: &Totals,
        next_id: u64,
    ) -> Result<(), LogError> {
        unimplemented!()
    }
    /// Adds some cubes (at most 65,536) to the snapshot under way; appends may come between.
    pub fn snapshot_add(&mut self, cubes: &[(CubeId, Place)]) -> Result<(), LogError> {
        unimplemented!()
    }
    /// Verifies the chunks as stored, makes the snapshot the one to replay from.
    pub fn snapshot_finish(&mut self) -> Result<(), LogError> {
        unimplemented!()
    }
    /// Drops a slice of what is no longer needed (ops behind the snapshot, old totals, old snapshots, old keys); true when more is left.
    pub fn trim(&mut self) -> Result<bool, LogError> {
        unimplemented!()
    }
    /// Bytes on disk.
    pub fn size_bytes(&self) -> u64 {
        unimplemented!()
    }
    /// A reader of the history.
    pub fn history(&self) -> Result<HistoryReader, LogError> {
        unimplemented!()
    }
    /// Checks every CRC of every record, whether needed for replay or not, and SQLite's own integrity. Count of records checked.
    pub fn verify(&mut self, progress: &mut dyn FnMut(u32)) -> Result<u64, LogError> {
        unimplemented!()
    }
}

#[expect(unused_variables, reason = "skeleton")]
impl HistoryReader {
    /// Oldest seq whose totals are kept (seq 0, the empty scene, counts as kept until anything was dropped), and the newest.
    pub fn range(&self) -> Result<(Seq, Seq), LogError> {
        unimplemented!()
    }
    /// The row of one seq; none when it is not kept. Seq 0 is the empty scene.
    pub fn at(&self, seq: Seq) -> Result<Option<HistoryRow>, LogError> {
        unimplemented!()
    }
    /// Rows from `from` to `to` (both included), oldest first, at most `limit`.
    pub fn rows(&self, from: Seq, to: Seq, limit: usize) -> Result<Vec<HistoryRow>, LogError> {
        unimplemented!()
    }
}
