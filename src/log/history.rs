//! The totals of past changes.
//!
//! Knows the table of changes only, through a connection of its own: SQLite's readers see one moment and never wait for the writer.

use std::fmt;

use parking_lot::MappedMutexGuard;
use rusqlite::{Connection, Transaction};

use super::database::{Reader, read_superblock};
use super::files::Site;
use super::kind::{Cubes, Kind};
use super::tables::{Changes, Seal, Superblock, ordered};
use super::{HistoryRow, LogError, Motion, Seq};

/// A scene's history, on a connection of its own: reading never waits for the writer, but the log, when it is dropped, for who is reading.
/// Nothing can be read after that.
pub struct HistoryReader<K: Kind = Cubes> {
    site: Site,
    reader: Reader,
    seal: Seal,
    /// The totals of the empty scene.
    nothing: K::Totals,
    created_ms: u64,
}

impl<K: Kind> fmt::Debug for HistoryReader<K> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("HistoryReader")
            .field("site", &self.site)
            .finish_non_exhaustive()
    }
}

impl<K: Kind> HistoryReader<K> {
    pub(super) fn new(
        site: Site,
        reader: Reader,
        seal: Seal,
        nothing: K::Totals,
        created_ms: u64,
    ) -> Self {
        Self {
            site,
            reader,
            seal,
            nothing,
            created_ms,
        }
    }

    /// One more, so that who reads long keeps nobody waiting.
    pub(super) fn another(&self) -> Result<Self, LogError> {
        let reader = self.reader.another(&self.site)?;
        Ok(Self {
            site: self.site.clone(),
            reader: reader.ok_or_else(|| self.closed())?,
            seal: self.seal,
            nothing: self.nothing,
            created_ms: self.created_ms,
        })
    }

    /// Whether the log waits for this reader, to be closed.
    pub(super) fn is_closing(&self) -> bool {
        self.reader.is_closing()
    }

    /// Oldest seq whose totals are kept (seq 0, the empty scene, counts as kept until anything was dropped), and the newest.
    /// # Errors
    /// [`LogError::Damaged`] when the log is.
    pub fn range(&self) -> Result<(Seq, Seq), LogError> {
        let connection = self.connection()?;
        let (_, superblock) = self.moment(&connection)?;
        Ok((oldest(&superblock), superblock.seq))
    }

    /// The row of one seq; none when it is not kept. Seq 0 is the empty scene.
    /// # Errors
    /// [`LogError::Damaged`] when the row is missing or not what was written.
    pub fn at(&self, seq: Seq) -> Result<Option<HistoryRow<K>>, LogError> {
        Ok(self.rows(seq, seq, 1)?.pop())
    }

    /// Rows from `from` to `to` (both included), oldest first, at most `limit`. Begins with the oldest that is kept.
    /// # Errors
    /// [`LogError::Damaged`] when a row is missing or not what was written.
    pub fn rows(&self, from: Seq, to: Seq, limit: usize) -> Result<Vec<HistoryRow<K>>, LogError> {
        let connection = self.connection()?;
        let (moment, superblock) = self.moment(&connection)?;
        let first = from.max(oldest(&superblock));
        let last = to.min(superblock.seq);
        let mut rows = Vec::new();
        if first > last || limit == 0 {
            return Ok(rows);
        }
        if first == Seq(0) {
            rows.push(self.empty_scene());
        }
        let limit = u64::try_from(limit).expect("a count fits 64 bits");
        let end = last.0.saturating_add(1).min(first.0.saturating_add(limit));
        self.read(&moment, first.0.max(1), end, &mut rows)?;
        Ok(rows)
    }

    /// The rows from `from` to `to` whose move's number is one of `moves` (both included), oldest first, at most `limit`.
    /// # Errors
    /// [`LogError::Damaged`] when a row is not what was written.
    pub fn rows_of_moves(
        &self,
        from: Seq,
        to: Seq,
        moves: [u64; 2],
        limit: usize,
    ) -> Result<Vec<HistoryRow<K>>, LogError> {
        /// Of so many rows the order by seq is quickly made from the index by move; of more, the table is read in its order.
        const INDEXED_ROWS_MAX: i64 = 8_192;
        let connection = self.connection()?;
        let (moment, superblock) = self.moment(&connection)?;
        let sqlite = self.site.sqlite(from);
        let [first, last] = moves.map(ordered);
        let found: i64 = moment
            .prepare_cached(
                "SELECT count(*) FROM (SELECT 1 FROM changes INDEXED BY changes_by_move \
                 WHERE move BETWEEN ?1 AND ?2 LIMIT ?3)",
            )
            .and_then(|mut count| {
                count.query_row([first, last, INDEXED_ROWS_MAX + 1], |row| row.get(0))
            })
            .map_err(&sqlite)?;
        let index = if found > INDEXED_ROWS_MAX {
            "NOT INDEXED"
        } else {
            "INDEXED BY changes_by_move"
        };
        let sql = format!(
            "SELECT * FROM changes {index} WHERE move BETWEEN ?1 AND ?2 AND seq BETWEEN ?3 AND ?4 ORDER BY seq LIMIT ?5"
        );
        let mut statement = moment.prepare_cached(&sql).map_err(&sqlite)?;
        let limit = i64::try_from(limit).unwrap_or(i64::MAX);
        let ends =
            [from.max(oldest(&superblock)), to.min(superblock.seq)].map(|seq| seq.0.cast_signed());
        let mut rows = statement
            .query([first, last, ends[0], ends[1], limit])
            .map_err(&sqlite)?;
        let mut found = Vec::new();
        while let Some(row) = rows.next().map_err(&sqlite)? {
            let row = Changes::parse(row, self.seal)
                .map_err(|error| self.site.damaged(from, format_args!("the totals: {error}")))?;
            found.push(row);
        }
        Ok(found)
    }

    /// Appends every change from `first` to before `end`, all of which are kept.
    fn read(
        &self,
        moment: &Connection,
        first: u64,
        end: u64,
        to: &mut Vec<HistoryRow<K>>,
    ) -> Result<(), LogError> {
        let sqlite = self.site.sqlite(Seq(first));
        let mut statement = moment
            .prepare_cached("SELECT * FROM changes WHERE seq >= ? AND seq < ? ORDER BY seq")
            .map_err(&sqlite)?;
        let mut rows = statement
            .query([first.cast_signed(), end.cast_signed()])
            .map_err(&sqlite)?;
        for seq in (first..end).map(Seq) {
            let row = rows.next().map_err(&sqlite)?;
            let row = row
                .ok_or("the change is missing".to_owned())
                .and_then(|row| {
                    Changes::parse(row, self.seal).map_err(|error| format!("the totals: {error}"))
                })
                .and_then(|row| {
                    if row.seq == seq {
                        Ok(row)
                    } else {
                        Err("the change is missing".to_owned())
                    }
                })
                .map_err(|what| self.site.damaged(seq, what))?;
            to.push(row);
        }
        Ok(())
    }

    /// One moment of the log: until the transaction is dropped, all that is read is as of its superblock.
    pub(super) fn moment<'a>(
        &self,
        connection: &'a Connection,
    ) -> Result<(Transaction<'a>, Superblock), LogError> {
        let transaction = connection
            .unchecked_transaction()
            .map_err(self.site.sqlite(Seq(0)))?;
        let superblock = read_superblock(&self.site, connection, self.seal, Seq(0))?;
        Ok((transaction, superblock))
    }

    pub(super) fn connection(&self) -> Result<MappedMutexGuard<'_, Connection>, LogError> {
        self.reader.connection().ok_or_else(|| self.closed())
    }

    fn closed(&self) -> LogError {
        self.site.failed("the log was closed meanwhile")
    }

    fn empty_scene(&self) -> HistoryRow<K> {
        HistoryRow {
            seq: Seq(0),
            at_ms: self.created_ms,
            inserted: 0,
            deleted: 0,
            motion: Motion::default(),
            volume_removed: 0,
            totals: self.nothing,
        }
    }
}

fn oldest(superblock: &Superblock) -> Seq {
    if superblock.changes_first == 1 {
        Seq(0)
    } else {
        Seq(superblock.changes_first)
    }
}
