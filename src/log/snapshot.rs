//! When a snapshot is wanted, and writing it while changes go on.
//!
//! Knows that a snapshot counts only once its row is there, which is the last thing written. Dropping what it makes superfluous is `trim`'s.

use super::chunks::SnapshotWriter;
use super::kind::Kind;
use super::scene::Log;
use super::{LogError, Seq};
use crate::geometry::CubeId;

/// About what a body takes in a snapshot.
const BODY_BYTES: u64 = 16;
/// What a change of one body costs on replay beyond its body, in bytes of operations.
const CHANGE_BYTES: u64 = 48;

impl<K: Kind> Log<K> {
    /// Whether the log has grown longer than the live set of `bodies` is worth.
    pub fn wants_snapshot(&self, bodies: u64) -> bool {
        let superblock = &self.database.superblock;
        let (seq, bytes) = match &self.snapshot {
            Some(snapshot) => (snapshot.seq, snapshot.operations_bytes),
            None => (Seq(0), 0),
        };
        let log_bytes =
            superblock.operations_bytes - bytes + (superblock.seq.0 - seq.0) * CHANGE_BYTES;
        self.under_way.is_none()
            && log_bytes > self.keep.snapshot_log_bytes_min.max(bodies * BODY_BYTES)
    }

    /// Begins a snapshot as of the newest seq. An unfinished one is dropped.
    /// # Errors
    /// The disk's.
    pub fn snapshot_begin(
        &mut self,
        at_ms: u64,
        totals: &K::Totals,
        next_id: u64,
    ) -> Result<(), LogError> {
        self.chunks_left_over |= self.under_way.take().is_some();
        let writer =
            SnapshotWriter::begin(&mut self.database, &self.context, at_ms, totals, next_id)?;
        self.under_way = Some(writer);
        Ok(())
    }

    /// Adds bodies of the seq it was begun at to the snapshot under way; appends may come between.
    /// # Errors
    /// The disk's; the snapshot is then abandoned, the log is as it was.
    pub fn snapshot_add(&mut self, bodies: &[(CubeId, K::Body)]) -> Result<(), LogError> {
        let mut writer = self.snapshot_under_way()?;
        writer.add(&mut self.database, bodies)?;
        self.under_way = Some(writer);
        Ok(())
    }

    /// Makes the snapshot, whose chunks were verified as stored, the one to replay from.
    /// # Errors
    /// The disk's; the snapshot is then abandoned, the log is as it was.
    pub fn snapshot_finish(&mut self) -> Result<(), LogError> {
        let writer = self.snapshot_under_way()?;
        self.snapshot = Some(writer.finish(&mut self.database)?);
        Ok(())
    }

    /// The one under way, out of `self`, so that an error on the way leaves it abandoned.
    fn snapshot_under_way(&mut self) -> Result<SnapshotWriter<K>, LogError> {
        self.chunks_left_over = true;
        self.under_way
            .take()
            .ok_or_else(|| self.database.site.failed("no snapshot is under way"))
    }
}
