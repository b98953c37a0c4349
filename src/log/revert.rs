//! The way from the newest state to an earlier one, by the changes between them.
//!
//! Knows which operations are kept; what becomes of the difference is the service's.
//!
//! A revert makes a state that had been before. So states are a tree, and the way between two of them leads over the
//! changes that tell them apart, however often there were reverts meanwhile:
//!
//! ```text
//!   1 ── 2 ── 3 ── 4          5 reverts to 2: it is the same state
//!        └─ (5) ── 6 ── 7     from 7 to 4: undo 7 and 6, redo 3 and 4; what 5 did is not read
//! ```

use super::kind::{Cubes, Kind};
use super::scene::Log;
use super::{LogError, Seq};
use crate::geometry::Effect;

/// A change on the way from one state to another.
#[derive(Clone, Copy, Debug)]
pub enum Step<'a, K: Kind = Cubes> {
    /// It is taken back.
    Undo(&'a Effect<K::Body>),
    /// It is done again.
    Redo(&'a Effect<K::Body>),
}

impl<K: Kind> Log<K> {
    /// Oldest seq that can be reverted to: the operations of every later change are kept.
    pub fn oldest_reachable(&self) -> Seq {
        Seq(self.database.superblock.operations_first - 1)
    }

    /// Shows what leads from the newest state to that at `to`, in order. `to` is reachable. O(operations that tell the two states
    /// apart, and changes between them).
    /// # Errors
    /// [`LogError::Damaged`] when a record is missing or not what was written.
    pub fn way_to(&self, to: Seq, visit: &mut dyn FnMut(Step<'_, K>)) -> Result<(), LogError> {
        assert!(
            self.oldest_reachable() <= to && to <= self.seq(),
            "operations that were dropped are not asked for"
        );
        let (mut from, mut to) = (self.origin(self.seq())?, self.origin(to)?);
        let mut redone = Vec::new();
        // The newer of two different states is never the one that both have come from.
        while from != to {
            if from > to {
                visit(Step::Undo(&self.effect(from)?));
                from = self.origin(Seq(from.0 - 1))?;
            } else {
                redone.push(to);
                to = self.origin(Seq(to.0 - 1))?;
            }
        }
        for seq in redone.into_iter().rev() {
            visit(Step::Redo(&self.effect(seq)?));
        }
        Ok(())
    }

    /// The first seq with the same state, as far as it can be reached: of a revert, what it reverts to.
    fn origin(&self, seq: Seq) -> Result<Seq, LogError> {
        let oldest = self.oldest_reachable();
        let mut origin = seq;
        while origin > oldest {
            let sql = "SELECT seq, back_to, back_crc FROM operations WHERE seq = ?";
            match self.one(sql, origin, |row| self.reverts_to(row, 0, origin))? {
                Some(reverts_to) if reverts_to >= oldest => origin = reverts_to,
                _ => break,
            }
        }
        Ok(origin)
    }

    fn effect(&self, seq: Seq) -> Result<Effect<K::Body>, LogError> {
        let sql = "SELECT * FROM operations WHERE seq = ?";
        self.one(sql, seq, |row| self.operations(row, 0, seq))
    }

    /// The row of one change, which there must be.
    fn one<T>(
        &self,
        sql: &str,
        seq: Seq,
        read: impl FnOnce(&rusqlite::Row<'_>) -> Result<T, LogError>,
    ) -> Result<T, LogError> {
        let site = &self.database.site;
        let sqlite = site.sqlite(seq);
        let mut statement = self
            .database
            .connection
            .prepare_cached(sql)
            .map_err(&sqlite)?;
        let mut rows = statement.query([seq.0.cast_signed()]).map_err(&sqlite)?;
        match rows.next().map_err(&sqlite)? {
            Some(row) => read(row),
            None => Err(site.damaged(seq, "the change is missing")),
        }
    }
}
