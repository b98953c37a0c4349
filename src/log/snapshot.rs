//! Writing a snapshot while changes go on.
//!
//! Knows that a snapshot counts only once its row is there, which is the last thing written. Dropping what it makes superfluous is `trim`'s.

use super::codec::{self, Cube};
use super::database::Database;
use super::scene::{SceneLog, count};
use super::tables::{CHUNKS_MAX, Packed, Snapshot};
use super::{LogError, Seq};
use crate::geometry::{CUBES_MAX, CubeId, Place, Totals};

/// Cubes of a full chunk: what replay holds in memory at a time.
const CHUNK_CUBES: usize = 1 << 16;
const _: () = assert!(CUBES_MAX >> CHUNK_CUBES.ilog2() < CHUNKS_MAX);

/// About what a cube takes in a snapshot.
const CUBE_BYTES: u64 = 16;
/// What a change of one cube costs on replay beyond its cube, in bytes of operations.
const CHANGE_BYTES: u64 = 48;

/// A snapshot that is being written.
pub(super) struct UnderWay {
    snapshot: Snapshot,
    /// Cubes that do not fill a chunk yet.
    waiting: Vec<Cube>,
    /// Reads back what was written: the writer's own connection would answer from its cache.
    reader: rusqlite::Connection,
}

impl SceneLog {
    /// Whether the log has grown longer than the live set of `cubes` is worth.
    pub fn wants_snapshot(&self, cubes: u64) -> bool {
        let head = &self.database.head;
        let (seq, bytes) = match &self.snapshot {
            Some(snapshot) => (snapshot.seq, snapshot.operations_bytes),
            None => (Seq(0), 0),
        };
        let log_bytes = head.operations_bytes - bytes + (head.seq.0 - seq.0) * CHANGE_BYTES;
        self.under_way.is_none()
            && log_bytes > (cubes * CUBE_BYTES).max(self.keep.snapshot_log_bytes_min)
    }

    /// Begins a snapshot as of the newest seq. An unfinished one is dropped.
    /// # Errors
    /// The disk's.
    pub fn snapshot_begin(
        &mut self,
        at_ms: u64,
        totals: &Totals,
        next_id: u64,
    ) -> Result<(), LogError> {
        self.snapshot_abandon();
        let reader = self.database.reader()?;
        self.database.transact(|_, _, head| {
            head.snapshots_begun += 1;
            Ok(())
        })?;
        let head = &self.database.head;
        self.under_way = Some(UnderWay {
            snapshot: Snapshot {
                number: head.snapshots_begun,
                seq: head.seq,
                at_ms,
                totals: *totals,
                next_id,
                cubes: 0,
                chunks: 0,
                operations_bytes: head.operations_bytes,
                operations_cubes: head.operations_cubes,
            },
            waiting: Vec::new(),
            reader,
        });
        Ok(())
    }

    /// Adds some cubes (at most 65,536) to the snapshot under way; appends may come between.
    /// # Errors
    /// The disk's; the snapshot is then abandoned, the log is as it was.
    pub fn snapshot_add(&mut self, cubes: &[(CubeId, Place)]) -> Result<(), LogError> {
        let mut under_way = self.take_under_way()?;
        under_way.waiting.extend_from_slice(cubes);
        while under_way.waiting.len() >= CHUNK_CUBES {
            self.write_chunk(&mut under_way, CHUNK_CUBES)?;
        }
        self.under_way = Some(under_way);
        Ok(())
    }

    /// Makes the snapshot, whose chunks were verified as stored, the one to replay from.
    /// # Errors
    /// The disk's; the snapshot is then abandoned, the log is as it was.
    pub fn snapshot_finish(&mut self) -> Result<(), LogError> {
        let mut under_way = self.take_under_way()?;
        if !under_way.waiting.is_empty() {
            let rest = under_way.waiting.len();
            self.write_chunk(&mut under_way, rest)?;
        }
        let snapshot = under_way.snapshot;
        self.database.transact(|connection, seal, head| {
            snapshot.insert(connection, seal)?;
            connection.execute(
                "DELETE FROM snapshots WHERE number <> ?",
                [snapshot.number.cast_signed()],
            )?;
            head.snapshot = snapshot.number;
            Ok(())
        })?;
        self.snapshot = Some(snapshot);
        Ok(())
    }

    fn snapshot_abandon(&mut self) {
        self.chunks_left_over |= self.under_way.take().is_some();
    }

    /// Out of `self`, so that an error on the way leaves it abandoned.
    fn take_under_way(&mut self) -> Result<UnderWay, LogError> {
        self.chunks_left_over = true;
        self.under_way
            .take()
            .ok_or_else(|| self.database.site.failed("no snapshot is under way"))
    }

    /// Writes the first `cubes` of those that wait, and reads them back.
    fn write_chunk(&mut self, under_way: &mut UnderWay, cubes: usize) -> Result<(), LogError> {
        let snapshot = &mut under_way.snapshot;
        let mut chunk: Vec<_> = under_way.waiting.drain(..cubes).collect();
        // By id, differences are small; replay is free to take the cubes of a snapshot in any order.
        chunk.sort_unstable_by_key(|&(id, _)| id);
        self.bytes.clear();
        self.encoder.encode([&chunk], &mut self.bytes);
        let id = Snapshot::chunk(snapshot.number, snapshot.chunks);
        let packed = Packed {
            number: id,
            cubes: &self.bytes,
        };
        self.database.transact(|connection, seal, _| {
            packed.insert_chunk(connection, seal, count(chunk.len()))
        })?;
        snapshot.chunks += 1;
        snapshot.cubes += count(chunk.len());
        let Database {
            site, seal, head, ..
        } = &self.database;
        let stored = under_way
            .reader
            .prepare_cached("SELECT * FROM chunks WHERE id = ?")
            .and_then(|mut statement| {
                statement.query_row([id.cast_signed()], |row| {
                    Ok(Packed::chunk(row, *seal)
                        .and_then(|(packed, _)| codec::decode::<1>(packed.cubes, self.edge)))
                })
            })
            .map_err(site.sqlite(head.seq))?;
        if stored != Ok([chunk]) {
            return Err(site.failed("a chunk of a snapshot does not read as it was written"));
        }
        Ok(())
    }
}
