//! Writes the chunks of one snapshot and reads each back.
//!
//! Knows the rows of a snapshot. When one is wanted and what becomes of it is known by `snapshot`.

use super::LogError;
use super::bytes::count;
use super::codec::{self, Encoder};
use super::database::{Database, Reader};
use super::kind::{Cubes, Kind};
use super::tables::{CHUNKS_MAX, Packed, Snapshot, chunk_number};
use crate::geometry::{CUBES_MAX, CubeId};

const _: () = assert!(CUBES_MAX >> Cubes::CHUNK_BODIES.ilog2() < CHUNKS_MAX);

/// A snapshot that is being written: its chunks are there, its own row is not yet.
pub(super) struct SnapshotWriter<K: Kind> {
    snapshot: Snapshot<K>,
    /// As of the seq of the snapshot: its bodies stand on nothing later.
    context: K::Context,
    /// Bodies that do not fill a chunk yet.
    waiting: Vec<(CubeId, K::Body)>,
    /// Reads back what was written: the writer's own connection would answer from its cache.
    reader: Reader,
    encoder: Encoder,
    bytes: Vec<u8>,
}

impl<K: Kind> SnapshotWriter<K> {
    /// Begins a snapshot as of the newest seq, which has these totals.
    pub(super) fn begin(
        database: &mut Database,
        context: &K::Context,
        at_ms: u64,
        totals: &K::Totals,
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
            context: context.clone(),
            waiting: Vec::new(),
            reader,
            encoder: Encoder::new(),
            bytes: Vec::new(),
        })
    }

    /// Adds bodies, and writes the chunks that they fill.
    pub(super) fn add(
        &mut self,
        database: &mut Database,
        bodies: &[(CubeId, K::Body)],
    ) -> Result<(), LogError> {
        self.waiting.extend_from_slice(bodies);
        while self.waiting.len() >= K::CHUNK_BODIES {
            self.write_chunk(database, K::CHUNK_BODIES)?;
        }
        Ok(())
    }

    /// Writes what is left, and makes the snapshot the one to replay from.
    pub(super) fn finish(mut self, database: &mut Database) -> Result<Snapshot<K>, LogError> {
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

    /// Writes the first `bodies` of those that wait, and reads them back.
    fn write_chunk(&mut self, database: &mut Database, bodies: usize) -> Result<(), LogError> {
        let mut chunk: Vec<_> = self.waiting.drain(..bodies).collect();
        // By id, differences are small; replay is free to take the bodies of a snapshot in any order.
        chunk.sort_unstable_by_key(|(id, _)| *id);
        self.bytes.clear();
        self.encoder
            .encode::<K, 1>([&chunk], &self.context, &mut self.bytes);
        let id = chunk_number(self.snapshot.number, self.snapshot.chunks);
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
            .connection()
            .expect("it is open as long as the database")
            .prepare_cached("SELECT * FROM chunks WHERE id = ?")
            .and_then(|mut statement| {
                statement.query_row([id.cast_signed()], |row| {
                    Ok(Packed::chunk(row, database.seal)
                        .and_then(|(packed, _)| codec::decode::<K, 1>(packed.cubes, &self.context)))
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
