//! The writer's side of a scene's log: create, open, append.
//!
//! Knows the order in which things must happen to be durable. Reading it all back is in `replay`, making it shorter in
//! `snapshot` and `trim`.

use std::collections::HashMap;
use std::fmt;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::bytes::{Malformed, count};
use super::chunks::SnapshotWriter;
use super::codec::{Encoder, RECORD_CUBES_MAX};
use super::database::{Database, generation_without_write_ahead};
use super::files::{CommitMarker, Site, create_whole};
use super::history::HistoryReader;
use super::kind::{Cubes, Kind};
use super::tables::{CHUNKS_MAX, Changes, Definitions, Keys, Meta, Packed, Snapshot};
use super::wal::{self, WriteAhead};
use super::{Header, HistoryRow, Keep, KeyRecord, LogError, Record, Seq};
use crate::geometry::Effect;

/// A scene's log in one SQLite database. There is one writer: the service holds a lock on the data directory.
///
/// After an error of [`Self::append`] nothing of it has happened, unless the process or the machine dies next: then what was
/// not answered for may turn out to be there after all, whole, as with any commit whose answer was lost.
pub struct Log<K: Kind> {
    pub(super) database: Database,
    pub(super) meta: Meta<K>,
    /// What bodies stand on.
    pub(super) context: K::Context,
    pub(super) keep: Keep,
    /// The one to replay from.
    pub(super) snapshot: Option<Snapshot<K>>,
    pub(super) under_way: Option<SnapshotWriter<K>>,
    /// Whether there may be chunks that belong to neither.
    pub(super) chunks_left_over: bool,
    /// Number of every key in the table.
    pub(super) keys: HashMap<Box<str>, u64>,
    pub(super) encoder: Encoder,
    pub(super) bytes: Vec<u8>,
}

/// The log of a scene of cubes.
pub type SceneLog = Log<Cubes>;

impl<K: Kind> fmt::Debug for Log<K> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Log")
            .field("site", &self.database.site)
            .field("superblock", &self.database.superblock)
            .finish_non_exhaustive()
    }
}

impl<K: Kind> Log<K> {
    /// Creates the scene's directory and log, durably, appearing whole (temporary name, then rename).
    /// # Errors
    /// [`LogError::Failed`] when the directory is there already, otherwise the disk's.
    pub fn create(directory: &Path, header: &Header<K>, keep: Keep) -> Result<Self, LogError> {
        Self::create_with(directory, header, &[], keep)
    }

    /// The same, with definitions from the start.
    /// # Errors
    /// As of [`Self::create`].
    pub fn create_with(
        directory: &Path,
        header: &Header<K>,
        definitions: &[Box<[u8]>],
        keep: Keep,
    ) -> Result<Self, LogError> {
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH);
        let meta = Meta {
            header: header.clone(),
            created_ms: since_1970
                .ok()
                .and_then(|duration| duration.as_millis().try_into().ok())
                .unwrap_or(0),
        };
        create_whole(directory, |temporary| {
            Database::create::<K>(&Site::new(temporary), &meta, definitions)
        })?;
        let (mut log, _) = Self::open(directory, keep)?;
        log.database.settle()?;
        Ok(log)
    }

    /// Opens an existing one. `notices` says what SQLite cut off its write-ahead file, if it did.
    ///
    /// Checks what can be checked without reading the cubes; [`Self::replay`] does the rest and must come before the first append.
    /// Refusing changes no file.
    /// # Errors
    /// [`LogError::Damaged`] and [`LogError::Foreign`] when the files are not what they were, [`LogError::Newer`] when a newer program
    /// made them.
    pub fn open(directory: &Path, keep: Keep) -> Result<(Self, Vec<String>), LogError> {
        let site = Site::new(directory);
        let page_size = site.check_database_header::<K>()?;
        let write_ahead =
            wal::inspect(&site.write_ahead(), page_size).map_err(|error| site.io(&error))?;
        if let WriteAhead::Broken { detail, frame } = write_ahead {
            let place = frame.map_or_else(String::new, |frame| format!(" (frame {frame})"));
            return Err(site.damaged(
                site.marked_seq(),
                format_args!("SQLite's write-ahead file: {detail}{place}"),
            ));
        }
        let commit_marker = site.commit_marker();
        let (database, meta) = Database::open::<K>(site, page_size)?;
        let (site, superblock) = (&database.site, &database.superblock);
        if write_ahead != WriteAhead::Empty
            && generation_without_write_ahead(site, database.seal)
                .is_some_and(|generation| generation > superblock.generation)
        {
            return Err(site.damaged(
                superblock.seq,
                "SQLite's write-ahead file ends before what is in the database already",
            ));
        }
        let notices = notices(
            write_ahead,
            commit_marker,
            superblock.generation,
            superblock.seq,
        );
        let context =
            K::context(&meta.header).map_err(|error| site.damaged(superblock.seq, error))?;
        let mut log = Self {
            database,
            meta,
            context,
            keep,
            snapshot: None,
            under_way: None,
            chunks_left_over: false,
            keys: HashMap::new(),
            encoder: Encoder::new(),
            bytes: Vec::new(),
        };
        log.load_definitions()?;
        log.load_snapshot()?;
        log.load_keys()?;
        Ok((log, notices))
    }

    /// Appends records and keys, all or nothing, and returns once they are on stable storage.
    /// # Errors
    /// [`LogError::Full`] or [`LogError::Failed`].
    /// # Panics
    /// When the records do not continue the log without a gap, or a key is there already.
    pub fn append(&mut self, records: &[Record<K>], keys: &[KeyRecord<K>]) -> Result<(), LogError> {
        if records.is_empty() && keys.is_empty() {
            return Ok(());
        }
        for (record, seq) in records.iter().zip(self.seq().0 + 1..) {
            assert_eq!(record.seq.0, seq, "changes are appended in their order");
        }
        for record in keys {
            assert!(
                !self.keys.contains_key(&record.key),
                "a key is answered once"
            );
        }
        self.check_sizes(records)?;
        let Self {
            database,
            context,
            encoder,
            bytes,
            ..
        } = self;
        database.transact(|connection, seal, superblock| {
            for record in records {
                let Effect { deleted, inserted } = &record.effect;
                bytes.clear();
                encoder.encode::<K, 2>([deleted, inserted], context, bytes);
                let operations = Packed {
                    number: record.seq.0,
                    cubes: bytes,
                };
                operations.insert_operations(connection, seal, record.reverts_to)?;
                superblock.seq = record.seq;
                superblock.operations_bytes += count(bytes.len());
                superblock.operations_cubes += count(deleted.len()) + count(inserted.len());
                let row = HistoryRow::<K> {
                    seq: record.seq,
                    at_ms: record.at_ms,
                    inserted: count(inserted.len()),
                    deleted: count(deleted.len()),
                    motion: record.motion,
                    volume_removed: record.volume_removed,
                    totals: record.totals,
                };
                bytes.clear();
                K::put_totals(bytes, &row.totals);
                Changes::insert(connection, seal, &row, bytes)?;
            }
            for record in keys {
                Keys::insert(connection, seal, superblock.keys_next, record)?;
                superblock.keys_next += 1;
            }
            Ok(())
        })?;
        let numbers = self.database.superblock.keys_next - count(keys.len())..;
        self.keys
            .extend(keys.iter().map(|record| record.key.clone()).zip(numbers));
        Ok(())
    }

    /// Appends a definition, and returns once it is on stable storage. It takes no seq.
    /// # Errors
    /// [`LogError::Full`] or [`LogError::Failed`].
    /// # Panics
    /// When it cannot come next: ask [`Kind::define`] first.
    pub fn define(&mut self, definition: &[u8]) -> Result<(), LogError> {
        let mut context = self.context.clone();
        K::define(&mut context, definition).expect("its kind was asked before");
        self.database.transact(|connection, seal, superblock| {
            let number = superblock.definitions.expect("the kind defines");
            Definitions::insert(connection, seal, number, definition)?;
            superblock.definitions = Some(number + 1);
            Ok(())
        })?;
        self.context = context;
        Ok(())
    }

    /// What bodies stand on: all definitions so far.
    pub fn context(&self) -> &K::Context {
        &self.context
    }

    /// What was fixed at creation.
    pub fn header(&self) -> &Header<K> {
        &self.meta.header
    }

    /// When the scene was created, in milliseconds since 1970.
    pub fn created_ms(&self) -> u64 {
        self.meta.created_ms
    }

    /// Newest seq in the log.
    pub fn seq(&self) -> Seq {
        self.database.superblock.seq
    }

    /// The answer recorded for a key, with the body's hash, if it is kept. Looks in memory first: no I/O for unknown keys.
    /// # Errors
    /// [`LogError::Damaged`] when its row is not what was written.
    pub fn key(&self, key: &str) -> Result<Option<KeyRecord<K>>, LogError> {
        let Some(&number) = self.keys.get(key) else {
            return Ok(None);
        };
        let site = &self.database.site;
        let read = || {
            self.database
                .connection
                .prepare_cached("SELECT * FROM keys WHERE number = ?")?
                .query_row([number.cast_signed()], |row| {
                    Ok(Keys::parse(row, self.database.seal))
                })
        };
        match read().map_err(site.sqlite(self.seq()))? {
            Ok((_, record)) if &*record.key == key => Ok(Some(record)),
            Ok(_) => Err(site.damaged(self.seq(), "an idempotency key")),
            Err(error) => Err(site.damaged(
                self.seq(),
                format_args!("the answer to an idempotency key: {error}"),
            )),
        }
    }

    /// Writes and syncs something beside the log: shows that the disk takes writes again, and has the room that the end of a replay
    /// needs, before the log is read. The log itself must not be written before a replay has made durable what it stands on.
    /// # Errors
    /// The disk's.
    pub fn probe(&self) -> Result<(), LogError> {
        let site = &self.database.site;
        site.probe().map_err(|error| site.io(&error))
    }

    /// Whether SQLite's write-ahead file has grown so long that [`Self::checkpoint`] should shorten it. No I/O.
    pub fn wants_checkpoint(&self) -> bool {
        self.database.unmoved_pages() >= self.keep.write_ahead_pages_max
    }

    /// Pages of SQLite's write-ahead file that were not in the database at the last commit; 0 since the last checkpoint. No I/O.
    pub fn unmoved_pages(&self) -> u64 {
        self.database.unmoved_pages()
    }

    /// How long the last append took to become durable: SQLite's writing of the write-ahead file, and its sync.
    pub fn commit_time(&self) -> Duration {
        self.database.commit_time()
    }

    /// Moves what SQLite's write-ahead file holds into the database, so that the file does not grow for ever. Nothing that was appended
    /// depends on it. Answers how many pages are left, because somebody still reads them in that file.
    /// # Errors
    /// The disk's. The log must then be opened and replayed anew before it is written: what was moved may be on the disk in parts.
    pub fn checkpoint(&mut self) -> Result<u64, LogError> {
        self.database.checkpoint()
    }

    /// Bytes on disk.
    pub fn size_bytes(&self) -> u64 {
        self.database.site.size_bytes()
    }

    /// A reader of the history, for as long as the log is open.
    /// # Errors
    /// The disk's.
    pub fn history(&self) -> Result<HistoryReader<K>, LogError> {
        Ok(HistoryReader::new(
            self.database.site.clone(),
            self.database.reader()?,
            self.database.seal,
            K::nothing(&self.meta.header),
            self.meta.created_ms,
        ))
    }

    fn load_definitions(&mut self) -> Result<(), LogError> {
        let Some(count) = self.database.superblock.definitions else {
            return Ok(());
        };
        let Database {
            site,
            connection,
            seal,
            superblock,
            ..
        } = &self.database;
        let context = &mut self.context;
        let mut expected = 0;
        let mut read = || -> rusqlite::Result<Result<(), Malformed>> {
            let mut statement = connection.prepare("SELECT * FROM definitions ORDER BY number")?;
            let mut rows = statement.query([])?;
            while let Some(row) = rows.next()? {
                let defined = Definitions::parse(row, *seal).and_then(|(number, definition)| {
                    if number != expected {
                        return Err(Malformed("it is missing"));
                    }
                    K::define(context, definition)
                });
                if let Err(error) = defined {
                    return Ok(Err(error));
                }
                expected += 1;
            }
            Ok(if expected == count {
                Ok(())
            } else {
                Err(Malformed("it is missing"))
            })
        };
        let found = read().map_err(site.sqlite(superblock.seq))?;
        found.map_err(|error| {
            site.damaged(
                superblock.seq,
                format_args!("definition {expected}: {error}"),
            )
        })
    }

    fn load_snapshot(&mut self) -> Result<(), LogError> {
        let Database {
            site,
            connection,
            seal,
            superblock,
            ..
        } = &self.database;
        if superblock.snapshot != 0 {
            let snapshot = connection
                .query_row(
                    "SELECT * FROM snapshots WHERE number = ?",
                    [superblock.snapshot.cast_signed()],
                    |row| Ok(Snapshot::parse(row, *seal)),
                )
                .map_err(site.sqlite(superblock.seq))?
                .map_err(|error| {
                    site.damaged(superblock.seq, format_args!("its snapshot: {error}"))
                })?;
            if snapshot.seq > superblock.seq {
                return Err(
                    site.damaged(superblock.seq, "its snapshot is newer than its superblock")
                );
            }
            self.snapshot = Some(snapshot);
        }
        let (first, end) = self.snapshot_chunks();
        self.chunks_left_over = connection
            .query_row(
                "SELECT EXISTS(SELECT 1 FROM chunks WHERE id < ?1) OR EXISTS(SELECT 1 FROM chunks WHERE id >= ?2)",
                [first, end],
                |row| row.get(0),
            )
            .map_err(site.sqlite(superblock.seq))?;
        Ok(())
    }

    /// Ids that the chunks of the snapshot can have: from, to before.
    pub(super) fn snapshot_chunks(&self) -> (i64, i64) {
        let first = self.database.superblock.snapshot * CHUNKS_MAX;
        (first.cast_signed(), (first + CHUNKS_MAX).cast_signed())
    }

    fn load_keys(&mut self) -> Result<(), LogError> {
        let Database {
            site,
            connection,
            seal,
            superblock,
            ..
        } = &self.database;
        let mut expected = superblock.keys_first;
        let mut read = || -> rusqlite::Result<Result<(), LogError>> {
            let mut statement = connection.prepare("SELECT * FROM keys ORDER BY number")?;
            let mut rows = statement.query([])?;
            while let Some(row) = rows.next()? {
                match Keys::parse::<K>(row, *seal) {
                    Ok((number, record)) if number == expected => {
                        self.keys.insert(record.key, number);
                        expected += 1;
                    }
                    _ => break,
                }
            }
            Ok(if expected == superblock.keys_next {
                Ok(())
            } else {
                Err(site.damaged(
                    superblock.seq,
                    format_args!("idempotency key {expected} is missing or damaged"),
                ))
            })
        };
        read().map_err(site.sqlite(superblock.seq))?
    }

    fn check_sizes(&self, records: &[Record<K>]) -> Result<(), LogError> {
        for Record { seq, effect, .. } in records {
            let bodies = effect.deleted.iter().chain(&effect.inserted);
            let weight: usize = bodies.map(|(_, body)| K::weight(body)).sum();
            if weight > RECORD_CUBES_MAX {
                let limit = RECORD_CUBES_MAX;
                return Err(self.database.site.failed(format_args!(
                    "change {} has {weight} bodies; a record takes {limit}",
                    seq.0
                )));
            }
        }
        Ok(())
    }
}

/// What to tell about an end that is gone.
fn notices(
    write_ahead: WriteAhead,
    commit_marker: Option<CommitMarker>,
    generation: u64,
    seq: Seq,
) -> Vec<String> {
    let mut notices = Vec::new();
    if let WriteAhead::Torn { frames, bytes } = write_ahead {
        let missing = match commit_marker {
            Some(marker) if marker.seq <= seq => {
                ", and nothing that is known to have been acknowledged is missing"
            }
            _ => "",
        };
        notices.push(format!(
            "the end of SQLite's write-ahead file is no whole change and was cut off ({frames} frames, {bytes} bytes); the scene stands at seq {}{missing}",
            seq.0
        ));
    }
    match commit_marker {
        None => notices.push(format!(
            "the file \"acknowledged\" is missing or damaged, so it cannot be told whether later changes were lost; the scene stands at seq {}",
            seq.0
        )),
        Some(marker) if marker.seq > seq => notices.push(format!(
            "changes {} to {} were acknowledged and are lost with the end of SQLite's write-ahead file; the scene stands at seq {}",
            seq.0 + 1,
            marker.seq.0,
            seq.0
        )),
        Some(marker) if marker.generation > generation => notices.push(format!(
            "the end of SQLite's write-ahead file is lost, but no change with it; the scene stands at seq {}",
            seq.0
        )),
        Some(_) => {}
    }
    notices
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{CubeId, Edge, Place, Totals};
    use crate::log::{Motion, Replayed};

    const KEEP: Keep = Keep {
        history_changes_max: 10,
        idempotency_keys_max: 10,
        revert_changes_max: 0,
        revert_bytes_max: 0,
        snapshot_log_bytes_min: 1 << 24,
        write_ahead_pages_max: 1000,
    };

    fn record(seq: u64, cubes: u64) -> Record {
        let edge = Edge::new(1).unwrap();
        let place = Place::new([0; 3], edge).unwrap();
        Record {
            seq: Seq(seq),
            at_ms: 0,
            motion: Motion::default(),
            reverts_to: None,
            volume_removed: 0,
            effect: Effect {
                deleted: vec![],
                // Ids without a pattern, so that they take room.
                inserted: (0..cubes)
                    .map(|id| (CubeId(crc32fast::hash(&id.to_le_bytes()).into()), place))
                    .collect(),
            },
            totals: Totals::default(),
        }
    }

    /// A limit on pages stands for a full disk: SQLite says the same to both.
    #[test]
    fn a_full_disk_is_called_so_and_heals() {
        let data = tempfile::tempdir().unwrap();
        let path = data.path().join("scene");
        let header = Header {
            incarnation: 1,
            edge_steps: 1,
            stock: None,
            settings: String::new(),
        };
        let mut log = SceneLog::create(&path, &header, KEEP).unwrap();
        log.append(&[record(1, 1)], &[]).unwrap();
        let limit = |log: &SceneLog, pages: i64| {
            let connection = &log.database.connection;
            connection
                .pragma(None, "max_page_count", pages, |_| Ok(()))
                .unwrap();
        };
        limit(&log, 16);
        let superblock = log.database.superblock;
        let error = log
            .append(&[record(2, 10), record(3, 100_000)], &[])
            .unwrap_err();
        assert!(matches!(error, LogError::Full { .. }), "{error}");
        assert_eq!(
            log.database.superblock, superblock,
            "nothing of it has happened"
        );
        limit(&log, 1 << 20);
        log.probe().unwrap();
        log.append(&[record(2, 100_000)], &[]).unwrap();
        drop(log);
        let (mut log, notices) = SceneLog::open(&path, KEEP).unwrap();
        assert_eq!((log.seq(), notices), (Seq(2), vec![]));
        let mut counts = vec![];
        log.replay(&mut |_| {}, &mut |replayed| {
            if let Replayed::Change(record) = replayed {
                counts.push(record.effect.inserted.len());
            }
            true
        })
        .unwrap();
        assert_eq!(counts, [1, 100_000]);
    }
}
