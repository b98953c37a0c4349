//! What is done for a log between two groups of changes, a little at a time: a snapshot, then dropping what it makes superfluous.
//!
//! ```text
//!   rest ──log is long──► snapshot: begin, a chunk, a chunk, ..., finish ──► trim: a slice, a slice, ... ──► rest
//! ```
//! A snapshot is of the seq it was begun at: its chunks are read as of that moment while changes go on in between (`copying`).

use std::sync::Arc;
use std::time::Instant;

use parking_lot::Mutex;

use super::copying::Copying;
use super::feed::Feed;
use super::kind::SceneKind;
use super::next_id::NextId;
use super::set::BodySet;
use super::{Published, meters};
use crate::log::{Log, LogError};

/// Why a set can be read here.
const WHOLE: &str = "the writer takes no step meanwhile, and none has failed";

/// What is being done.
pub(super) enum Upkeep<K: SceneKind> {
    /// Nothing, until the log wants something (and not before the time, if any).
    Rest(Option<Instant>),
    /// A snapshot is being written.
    Snapshot(Arc<Mutex<Copying<K>>>),
    /// What the snapshot made superfluous is being dropped.
    Trim,
}

impl<K: SceneKind> Upkeep<K> {
    /// Whether there is something to do while nobody asks.
    pub(super) fn waits(&self, log: &Log<K>, set: &BodySet<K>) -> bool {
        match self {
            Self::Rest(after) => {
                after.is_none_or(|after| Instant::now() >= after)
                    && (log.wants_snapshot(set.len()) || log.wants_trim())
            }
            Self::Snapshot(_) | Self::Trim => true,
        }
    }

    /// One step, short enough that changes hardly wait for it; of a snapshot, so many cubes. The set is at its durable state.
    pub(super) fn step(
        &mut self,
        log: &mut Log<K>,
        feed: &Feed<K>,
        published: &Published<K>,
        next_id: NextId,
        snapshot_step_cubes: usize,
    ) -> Result<(), LogError> {
        match self {
            Self::Rest(_) if log.wants_snapshot(feed.set.len()) => {
                log.snapshot_begin(published.at_ms, &published.totals, next_id.recorded())?;
                let (begun, copying) = feed.copy(usize::MAX).expect(WHOLE);
                assert_eq!(
                    begun.seq, published.seq,
                    "the log and the set are of one seq"
                );
                *self = Self::Snapshot(copying);
            }
            Self::Rest(_) => *self = Self::Trim,
            Self::Snapshot(copying) => {
                let view = feed.set.view().expect(WHOLE);
                let bodies = copying.lock().next(&view, snapshot_step_cubes);
                drop(view);
                if let Some(bodies) = bodies.expect("a snapshot is never given up") {
                    log.snapshot_add(&bodies)?;
                } else {
                    log.snapshot_finish()?;
                    meters::snapshot_written();
                    *self = Self::Trim;
                }
            }
            Self::Trim => {
                if !log.trim()? {
                    *self = Self::Rest(None);
                }
            }
        }
        Ok(())
    }
}
