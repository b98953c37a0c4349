//! Dropping what is not needed any more, a slice at a time, so that changes never wait long.
//!
//! Knows what is superfluous; each slice is a transaction that takes the rows and moves the superblock together.

use rusqlite::Connection;

use super::LogError;
use super::bytes::count;
use super::kind::Kind;
use super::scene::Log;
use super::tables::CHUNKS_MAX;

/// Bounds of a slice: milliseconds of work.
const SLICE_ROWS: u64 = 4096;
const SLICE_BYTES: u64 = 8 << 20;
const SLICE_CHUNKS: u64 = 8;
const SLICE_PAGES: u32 = 1024;

/// Rows past their limit before trimming is worth a transaction of its own.
const SLACK_ROWS: u64 = 1024;
/// And this part of the bytes.
const SLACK_BYTES_PART: u64 = 16;
/// Free pages are filled again by the next changes; the file is made shorter only when it is mostly and much of it empty.
const FREE_PAGES_MIN: u64 = 2048;
const FREE_OF_4_MIN: u64 = 3;

impl<K: Kind> Log<K> {
    /// Whether there is enough to drop that calling [`Self::trim`] pays. No I/O.
    pub fn wants_trim(&self) -> bool {
        self.chunks_left_over()
            || self.operations_past_limit(SLACK_ROWS)
            || self.changes_end() >= self.database.superblock.changes_first + SLACK_ROWS
            || self.keys_end() >= self.database.superblock.keys_first + SLACK_ROWS
    }

    /// Drops a slice of what is no longer needed (ops behind the snapshot, old totals, old snapshots, old keys); true when more is left.
    /// # Errors
    /// The disk's.
    pub fn trim(&mut self) -> Result<bool, LogError> {
        let superblock = self.database.superblock;
        if self.operations_past_limit(0) {
            self.trim_operations()?;
        } else if self.chunks_left_over() {
            self.trim_chunks()?;
        } else if self.changes_end() > superblock.changes_first {
            let end = self
                .changes_end()
                .min(superblock.changes_first + SLICE_ROWS);
            self.database.transact(|connection, _, superblock| {
                let dropped = end - superblock.changes_first;
                delete(
                    connection,
                    "DELETE FROM changes WHERE seq < ?",
                    end,
                    dropped,
                )?;
                superblock.changes_first = end;
                Ok(())
            })?;
        } else if self.keys_end() > superblock.keys_first {
            let end = self.keys_end().min(superblock.keys_first + SLICE_ROWS);
            self.database.transact(|connection, _, superblock| {
                let dropped = end - superblock.keys_first;
                delete(
                    connection,
                    "DELETE FROM keys WHERE number < ?",
                    end,
                    dropped,
                )?;
                superblock.keys_first = end;
                Ok(())
            })?;
            self.keys.retain(|_, &mut number| number >= end);
        } else {
            return self.trim_file();
        }
        Ok(true)
    }

    /// Whether there are operations in the snapshot that are past the limits, by more than some changes.
    fn operations_past_limit(&self, slack: u64) -> bool {
        let superblock = &self.database.superblock;
        let kept = superblock.seq.0 + 1 - superblock.operations_first;
        let kept_bytes = superblock.operations_bytes - superblock.dropped_bytes;
        let slack_bytes = if slack > 0 {
            self.keep.revert_bytes_max / SLACK_BYTES_PART
        } else {
            0
        };
        self.operations_end() > superblock.operations_first
            && (kept > self.keep.revert_changes_max.saturating_add(slack)
                || kept_bytes > self.keep.revert_bytes_max.saturating_add(slack_bytes))
    }

    /// Operations before this are in the snapshot.
    fn operations_end(&self) -> u64 {
        self.snapshot
            .as_ref()
            .map_or(0, |snapshot| snapshot.seq.0 + 1)
    }

    /// Changes before this are past the limit and not needed for replay. The newest is always kept.
    fn changes_end(&self) -> u64 {
        let past = (self.database.superblock.seq.0 + 1)
            .saturating_sub(self.keep.history_changes_max.max(1));
        past.min(self.operations_end())
    }

    fn keys_end(&self) -> u64 {
        let past = self
            .database
            .superblock
            .keys_next
            .saturating_sub(self.keep.idempotency_keys_max);
        past.max(self.database.superblock.keys_first)
    }

    /// While a snapshot is under way its chunks are not left over, and those of the one before still needed.
    fn chunks_left_over(&self) -> bool {
        self.chunks_left_over && self.under_way.is_none()
    }

    fn trim_operations(&mut self) -> Result<(), LogError> {
        let end = self.operations_end();
        let keep = self.keep;
        self.database.transact(|connection, _, superblock| {
            let first = superblock.operations_first;
            let kept = superblock.seq.0 + 1 - first;
            let kept_bytes = superblock.operations_bytes - superblock.dropped_bytes;
            let mut statement = connection.prepare_cached(
                "SELECT length(cubes) FROM operations WHERE seq >= ? AND seq < ? ORDER BY seq LIMIT ?",
            )?;
            let mut rows =
                statement.query([first, end, SLICE_ROWS].map(u64::cast_signed))?;
            let (mut dropped, mut bytes) = (0, 0);
            while let Some(row) = rows.next()? {
                dropped += 1;
                bytes += row.get::<_, i64>(0)?.cast_unsigned();
                let enough = kept - dropped <= keep.revert_changes_max
                    && kept_bytes.saturating_sub(bytes) <= keep.revert_bytes_max;
                if enough || bytes > SLICE_BYTES {
                    break;
                }
            }
            drop(rows);
            // Never nothing, or a missing row would be trimmed for ever; `delete` notices.
            let end = first + dropped.max(1);
            delete(connection, "DELETE FROM operations WHERE seq < ?", end, end - first)?;
            superblock.operations_first = end;
            superblock.dropped_bytes += bytes;
            Ok(())
        })
    }

    fn trim_chunks(&mut self) -> Result<(), LogError> {
        let (first, end) = self.snapshot_chunks();
        let mut deleted = 0;
        self.database.transact(|connection, _, _| {
            // One range, then the other: an OR of both would read past every chunk of the snapshot.
            for sql in [
                "DELETE FROM chunks WHERE id IN (SELECT id FROM chunks WHERE id < ?1 ORDER BY id LIMIT ?3) AND ?2 = ?2",
                "DELETE FROM chunks WHERE id IN (SELECT id FROM chunks WHERE id >= ?2 ORDER BY id LIMIT ?3) AND ?1 = ?1",
            ] {
                deleted += connection
                    .prepare_cached(sql)?
                    .execute([first, end, SLICE_CHUNKS.cast_signed()])?;
            }
            Ok(())
        })?;
        self.chunks_left_over = deleted > 0;
        Ok(())
    }

    /// Gives free pages back to the file system.
    fn trim_file(&mut self) -> Result<bool, LogError> {
        let pages = |pragma| {
            self.database
                .connection
                .pragma_query_value(None, pragma, |row| row.get::<_, i64>(0))
                .map(i64::cast_unsigned)
                .map_err(self.database.site.sqlite(self.seq()))
        };
        let (free, all) = (pages("freelist_count")?, pages("page_count")?);
        if free < FREE_PAGES_MIN || free * 4 < all * FREE_OF_4_MIN {
            return Ok(false);
        }
        self.database.transact(|connection, _, _| {
            connection.pragma(None, "incremental_vacuum", SLICE_PAGES, |_| Ok(()))
        })?;
        Ok(true)
    }
}

/// Deletes exactly `rows`: the superblock said they are there.
fn delete(connection: &Connection, sql: &str, end: u64, rows: u64) -> rusqlite::Result<()> {
    let deleted = connection
        .prepare_cached(sql)?
        .execute([end.cast_signed()])?;
    if count(deleted) == rows {
        Ok(())
    } else {
        Err(rusqlite::Error::StatementChangedRows(deleted))
    }
}

const _: () = assert!(SLICE_CHUNKS < CHUNKS_MAX);
