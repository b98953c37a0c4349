//! Writes the chunks of one snapshot and reads each back.
//!
//! Knows the rows of a snapshot. When one is wanted and what becomes of it is known by `snapshot`.

use rusqlite::Connection;

use super::LogError;
use super::codec::{self, Cube, Encoder, count};
use super::database::Database;
use super::tables::{CHUNKS_MAX, Packed, Snapshot};
use crate::geometry::{CUBES_MAX, Edge, Totals};

/// Cubes of a full chunk: what replay holds in memory at a time.
const CHUNK_CUBES: usize = 1 << 16;
const _: () = assert!(CUBES_MAX >> CHUNK_CUBES.ilog2() < CHUNKS_MAX);

/// A snapshot that is being written: its chunks are there, its own row is not yet.
pub(super) struct SnapshotWriter {
    snapshot: Snapshot,
    edge: Edge,
    /// Cubes that do not fill a chunk yet.
    waiting: Vec<Cube>,
    /// Reads back what was written: the writer's own connection would answer from its cache.
    reader: Connection,
    encoder: Encoder,
    bytes: Vec<u8>,
}

impl SnapshotWriter {
    /// Begins a snapshot as of the newest seq, which has these totals.
    pub(super) fn begin(
        database: &mut Database,
        edge: Edge,
        at_ms: u64,
        totals: &Totals,
        next_id: u64,
    ) -> Result<Self, LogError> {
        let reader = database.reader()?;
        database.transact(|_, _, superblock| {
            superblock.snapshots_begun += 1;
            Ok(())
        })?;
        let superblock = &database.superblock;
        Ok(Self {
            snapshot: Snapshot {
                number: superblock.snapshots_begun,
                seq: superblock.seq,
                at_ms,
                totals: *totals,
                next_id,
                cubes: 0,
                chunks: 0,
                operations_bytes: superblock.operations_bytes,
                operations_cubes: superblock.operations_cubes,
            },
            edge,
            waiting: Vec::new(),
            reader,
            encoder: Encoder::new(),
            bytes: Vec::new(),
        })
    }

    /// Adds cubes, and writes the chunks that they fill.
    pub(super) fn add(&mut self, database: &mut Database, cubes: &[Cube]) -> Result<(), LogError> {
        self.waiting.extend_from_slice(cubes);
        while self.waiting.len() >= CHUNK_CUBES {
            self.write_chunk(database, CHUNK_CUBES)?;
        }
        Ok(())
    }

    /// Writes what is left, and makes the snapshot the one to replay from.
    pub(super) fn finish(mut self, database: &mut Database) -> Result<Snapshot, LogError> {
        if !self.waiting.is_empty() {
            self.write_chunk(database, self.waiting.len())?;
        }
        let snapshot = self.snapshot;
        database.transact(|connection, seal, superblock| {
            snapshot.insert(connection, seal)?;
            connection.execute(
                "DELETE FROM snapshots WHERE number <> ?",
                [snapshot.number.cast_signed()],
            )?;
            superblock.snapshot = snapshot.number;
            Ok(())
        })?;
        Ok(snapshot)
    }

    /// Writes the first `cubes` of those that wait, and reads them back.
    fn write_chunk(&mut self, database: &mut Database, cubes: usize) -> Result<(), LogError> {
        let mut chunk: Vec<_> = self.waiting.drain(..cubes).collect();
        // By id, differences are small; replay is free to take the cubes of a snapshot in any order.
        chunk.sort_unstable_by_key(|&(id, _)| id);
        self.bytes.clear();
        self.encoder.encode([&chunk], &mut self.bytes);
        let id = Snapshot::chunk(self.snapshot.number, self.snapshot.chunks);
        let packed = Packed {
            number: id,
            cubes: &self.bytes,
        };
        database.transact(|connection, seal, _| {
            packed.insert_chunk(connection, seal, count(chunk.len()))
        })?;
        self.snapshot.chunks += 1;
        self.snapshot.cubes += count(chunk.len());
        let stored = self
            .reader
            .prepare_cached("SELECT * FROM chunks WHERE id = ?")
            .and_then(|mut statement| {
                statement.query_row([id.cast_signed()], |row| {
                    Ok(Packed::chunk(row, database.seal)
                        .and_then(|(packed, _)| codec::decode::<1>(packed.cubes, self.edge)))
                })
            })
            .map_err(database.site.sqlite(database.superblock.seq))?;
        if stored != Ok([chunk]) {
            let what = "a chunk of a snapshot does not read as it was written";
            return Err(database.site.failed(what));
        }
        Ok(())
    }
}
