//! Reading everything back: for replay what is needed, for verification what there is.
//!
//! Knows which rows the superblock promises, and that a row too few or too many is damage like a wrong CRC. Memory: one chunk or one
//! record at a time.

use rusqlite::{Connection, Row};

use super::bytes::count;
use super::codec;
use super::database::Database;
use super::kind::{Kind, Named};
use super::scene::Log;
use super::tables::{Changes, Packed, Snapshot};
use super::{LogError, Record, Replayed, Seq};
use crate::geometry::Effect;

/// What is said when the rebuilt state differs from the recorded totals.
const DIFFERS: &str = "the totals rebuilt from the cubes differ from those recorded";

impl<K: Kind> Log<K> {
    /// Everything that is needed to rebuild the scene. `progress` gets a fraction in parts per thousand.
    /// `visit` answers false when the state it rebuilt differs from the totals it was shown.
    /// # Errors
    /// [`LogError::Damaged`] names the seq at which the files are not what was written, or the state differs. The disk's, when what
    /// was read cannot be made durable.
    pub fn replay(
        &mut self,
        progress: &mut dyn FnMut(u32),
        visit: &mut dyn FnMut(Replayed<'_, K>) -> bool,
    ) -> Result<(), LogError> {
        self.check_structure("quick_check")?;
        self.check_ends()?;
        let mut progress = Progress::new(self.cubes_to_replay(), progress);
        if let Some(snapshot) = &self.snapshot {
            self.replay_snapshot(snapshot, &mut progress, visit)?;
        }
        self.replay_changes(&mut progress, visit)?;
        self.database.settle()?;
        progress.finish();
        Ok(())
    }

    /// Checks every CRC of every record, whether needed for replay or not, and SQLite's own integrity. Count of records checked.
    /// # Errors
    /// [`LogError::Damaged`] names the first record at fault.
    pub fn verify(&mut self, progress: &mut dyn FnMut(u32)) -> Result<u64, LogError> {
        let Database {
            site,
            seal,
            superblock,
            ..
        } = &self.database;
        self.check_structure("integrity_check")?;
        self.check_ends()?;
        let changes = superblock.seq.0 + 1 - superblock.changes_first;
        let operations = superblock.seq.0 + 1 - superblock.operations_first;
        let chunks = self.snapshot.as_ref().map_or(0, |snapshot| snapshot.chunks);
        // Opening has read the settings, the superblock, the snapshot and the keys.
        let opened = 2 + u64::from(self.snapshot.is_some()) + count(self.keys.len());
        let mut progress = Progress::new(changes + operations + chunks, progress);
        let mut expected = superblock.changes_first;
        self.each("SELECT * FROM changes ORDER BY seq", [], |row| {
            let seq = expect(&mut expected, &mut progress);
            match Changes::parse::<K>(row, *seal) {
                Ok(row) if row.seq == seq => Ok(()),
                Ok(_) => Err(site.damaged(seq, "the change is missing")),
                Err(error) => Err(site.damaged(seq, format_args!("the totals: {error}"))),
            }
        })?;
        self.complete(expected)?;
        let mut expected = superblock.operations_first;
        self.each("SELECT * FROM operations ORDER BY seq", [], |row| {
            let seq = expect(&mut expected, &mut progress);
            self.reverts_to(row, 0, seq)?;
            self.operations(row, 0, seq).map(drop)
        })?;
        self.complete(expected)?;
        if let Some(snapshot) = &self.snapshot {
            self.chunks(snapshot, &mut |_| {
                progress.advance(1);
                true
            })?;
        }
        progress.finish();
        Ok(opened + changes + operations + chunks)
    }

    /// SQLite's own check of the file's structure. Damage there may leave every row right today and overwrite one tomorrow.
    fn check_structure(&self, pragma: &str) -> Result<(), LogError> {
        let Database {
            site,
            connection,
            superblock,
            ..
        } = &self.database;
        let found: String = connection
            .query_row(&format!("PRAGMA {pragma}(1)"), [], |row| row.get(0))
            .map_err(site.sqlite(superblock.seq))?;
        if found == "ok" {
            Ok(())
        } else {
            Err(site.damaged(superblock.seq, format_args!("SQLite finds {found:?}")))
        }
    }

    /// Whether the first and last rows are those that the superblock names; what lies between is counted by who reads it.
    fn check_ends(&self) -> Result<(), LogError> {
        let Database {
            site,
            connection,
            superblock,
            ..
        } = &self.database;
        for (table, first) in [
            ("changes", superblock.changes_first),
            ("operations", superblock.operations_first),
        ] {
            let expected = (first <= superblock.seq.0).then_some((first, superblock.seq.0));
            let ends = ends(connection, table).map_err(site.sqlite(superblock.seq))?;
            if ends != expected {
                return Err(site.damaged(
                    superblock.seq,
                    format_args!("table {table} has other changes than its superblock says"),
                ));
            }
        }
        let snapshots: i64 = connection
            .query_row("SELECT count(*) FROM snapshots", [], |row| row.get(0))
            .map_err(site.sqlite(superblock.seq))?;
        let replayed_from = self.snapshot.as_ref().map_or(0, |snapshot| snapshot.seq.0);
        let needed = [superblock.changes_first, superblock.operations_first];
        if snapshots != i64::from(self.snapshot.is_some())
            || needed.iter().any(|&first| first > replayed_from + 1)
        {
            return Err(site.damaged(
                superblock.seq,
                "its snapshot is not what its superblock says",
            ));
        }
        Ok(())
    }

    /// Measure of the work of a replay, for its progress.
    fn cubes_to_replay(&self) -> u64 {
        let cubes = self.database.superblock.operations_cubes;
        self.snapshot.as_ref().map_or(cubes, |snapshot| {
            snapshot.cubes + cubes.saturating_sub(snapshot.operations_cubes)
        })
    }

    fn replay_snapshot(
        &self,
        snapshot: &Snapshot<K>,
        progress: &mut Progress<'_>,
        visit: &mut dyn FnMut(Replayed<'_, K>) -> bool,
    ) -> Result<(), LogError> {
        let begin = Replayed::SnapshotBegin {
            cubes: snapshot.cubes,
        };
        let fits = visit(begin);
        self.chunks(snapshot, &mut |cubes| {
            progress.advance(count(cubes.len()));
            fits && visit(Replayed::Cubes(cubes))
        })?;
        let end = Replayed::SnapshotEnd {
            seq: snapshot.seq,
            at_ms: snapshot.at_ms,
            totals: &snapshot.totals,
            next_id: snapshot.next_id,
        };
        if visit(end) {
            Ok(())
        } else {
            Err(self.database.site.damaged(snapshot.seq, DIFFERS))
        }
    }

    /// Reads the chunks of a snapshot in their order; `visit` answers false when they do not fit together.
    fn chunks(
        &self,
        snapshot: &Snapshot<K>,
        visit: &mut dyn FnMut(&[Named<K>]) -> bool,
    ) -> Result<(), LogError> {
        let Database { site, seal, .. } = &self.database;
        let damaged = |what: &dyn std::fmt::Display| {
            site.damaged(snapshot.seq, format_args!("the snapshot: {what}"))
        };
        let (first, end) = self.snapshot_chunks();
        let mut expected = first.cast_unsigned();
        let mut cubes_found = 0;
        self.each(
            "SELECT * FROM chunks WHERE id >= ? AND id < ? ORDER BY id",
            [first, end],
            |row| {
                let (packed, cubes) = Packed::chunk(row, *seal).map_err(|error| damaged(&error))?;
                let [chunk] = codec::decode::<K, _>(packed.cubes, &self.context)
                    .map_err(|error| damaged(&error))?;
                if packed.number != expected || cubes != count(chunk.len()) {
                    return Err(damaged(&"a chunk is missing"));
                }
                expected += 1;
                cubes_found += cubes;
                if visit(&chunk) {
                    Ok(())
                } else {
                    Err(damaged(&"its cubes do not fit together"))
                }
            },
        )?;
        let chunks_found = expected - first.cast_unsigned();
        if (chunks_found, cubes_found) == (snapshot.chunks, snapshot.cubes) {
            Ok(())
        } else {
            Err(damaged(&"a chunk is missing"))
        }
    }

    fn replay_changes(
        &self,
        progress: &mut Progress<'_>,
        visit: &mut dyn FnMut(Replayed<'_, K>) -> bool,
    ) -> Result<(), LogError> {
        let Database { site, seal, .. } = &self.database;
        let from = self.snapshot.as_ref().map_or(0, |snapshot| snapshot.seq.0);
        let mut expected = from + 1;
        let sql = format!(
            "SELECT {}, operations.* FROM changes CROSS JOIN operations ON operations.seq = changes.seq \
             WHERE changes.seq > ? ORDER BY changes.seq",
            Changes::COLUMNS
        );
        self.each(&sql, [from.cast_signed()], |row| {
            let seq = Seq(expected);
            expected += 1;
            let change = match Changes::parse::<K>(row, *seal) {
                Ok(change) if change.seq == seq => change,
                Ok(_) => return Err(site.damaged(seq, "the change is missing")),
                Err(error) => return Err(site.damaged(seq, format_args!("the totals: {error}"))),
            };
            let effect = self.operations(row, Changes::COLUMN_COUNT, seq)?;
            let reverts_to = self.reverts_to(row, Changes::COLUMN_COUNT, seq)?;
            if (change.deleted, change.inserted)
                != (count(effect.deleted.len()), count(effect.inserted.len()))
            {
                return Err(site.damaged(seq, "its counts are wrong"));
            }
            progress.advance(change.deleted + change.inserted);
            let record = Record {
                seq,
                at_ms: change.at_ms,
                effect,
                reverts_to,
                motion: change.motion,
                volume_removed: change.volume_removed,
                totals: change.totals,
            };
            if visit(Replayed::Change(&record)) {
                Ok(())
            } else {
                Err(site.damaged(seq, DIFFERS))
            }
        })?;
        self.complete(expected)
    }

    /// What the columns of `operations`, from `first` on, did at `seq`.
    pub(super) fn operations(
        &self,
        row: &Row<'_>,
        first: usize,
        seq: Seq,
    ) -> Result<Effect<K::Body>, LogError> {
        let Database { site, seal, .. } = &self.database;
        let damaged = |error| site.damaged(seq, format_args!("the cubes: {error}"));
        let packed = Packed::operations(row, first, *seal).map_err(damaged)?;
        if packed.number != seq.0 {
            return Err(site.damaged(seq, "the cubes of the change are missing"));
        }
        let [deleted, inserted] =
            codec::decode::<K, _>(packed.cubes, &self.context).map_err(damaged)?;
        Ok(Effect { deleted, inserted })
    }

    /// Which seq the change at `seq` reverts to, from the columns of `operations` from `first` on.
    pub(super) fn reverts_to(
        &self,
        row: &Row<'_>,
        first: usize,
        seq: Seq,
    ) -> Result<Option<Seq>, LogError> {
        let Database { site, seal, .. } = &self.database;
        let reverts_to = Packed::reverts_to(row, first, *seal).map_err(|error| {
            site.damaged(seq, format_args!("the seq that it reverts to: {error}"))
        })?;
        if reverts_to.is_some_and(|reverts_to| reverts_to >= seq) {
            return Err(site.damaged(seq, "it reverts to a seq that had not come"));
        }
        Ok(reverts_to)
    }

    /// `expected` is the seq after the last that was read.
    fn complete(&self, expected: u64) -> Result<(), LogError> {
        let Database {
            site, superblock, ..
        } = &self.database;
        if expected == superblock.seq.0 + 1 {
            Ok(())
        } else {
            Err(site.damaged(Seq(expected), "the change is missing"))
        }
    }

    pub(super) fn each(
        &self,
        sql: &str,
        parameters: impl rusqlite::Params,
        mut visit: impl FnMut(&Row<'_>) -> Result<(), LogError>,
    ) -> Result<(), LogError> {
        let sqlite = self.database.site.sqlite(self.seq());
        let mut statement = self.database.connection.prepare(sql).map_err(&sqlite)?;
        let mut rows = statement.query(parameters).map_err(&sqlite)?;
        while let Some(row) = rows.next().map_err(&sqlite)? {
            visit(row)?;
        }
        Ok(())
    }
}

/// Least and greatest seq of a table, if it has any.
fn ends(connection: &Connection, table: &str) -> rusqlite::Result<Option<(u64, u64)>> {
    let end = |function| {
        // Apart, each is one step in the index; together SQLite would read the table.
        connection.query_row(&format!("SELECT {function}(seq) FROM {table}"), [], |row| {
            Ok(row.get::<_, Option<i64>>(0)?.map(i64::cast_unsigned))
        })
    };
    Ok(end("min")?.zip(end("max")?))
}

/// The seq that must come now.
fn expect(expected: &mut u64, progress: &mut Progress<'_>) -> Seq {
    progress.advance(1);
    *expected += 1;
    Seq(*expected - 1)
}

/// Turns work done into parts per thousand, each told once.
struct Progress<'a> {
    all: u64,
    done: u64,
    told: u32,
    tell: &'a mut dyn FnMut(u32),
}

impl<'a> Progress<'a> {
    fn new(all: u64, tell: &'a mut dyn FnMut(u32)) -> Self {
        tell(0);
        Self {
            all: all.max(1),
            done: 0,
            told: 0,
            tell,
        }
    }

    fn advance(&mut self, work: u64) {
        self.done += work;
        // Not all before the end: what the superblock says about the amount of work is only an estimate of it.
        let thousandths = (u128::from(self.done) * 1000 / u128::from(self.all)).min(999);
        self.say(u32::try_from(thousandths).expect("at most 999"));
    }

    fn finish(mut self) {
        self.say(1000);
    }

    fn say(&mut self, thousandths: u32) {
        if thousandths > self.told {
            self.told = thousandths;
            (self.tell)(thousandths);
        }
    }
}
