//! What bodies were before some changes: what it takes to read a set as it was then.
//!
//! ```text
//!   the set now  ── bodies that no change named ──────────────────┬──> the set then
//!   before       ── bodies named, each as it was before the first ─┘
//! ```
//! Readers see the last durable state in this way while changes are on their way, and so does a snapshot that is written while
//! changes go on. Both tables are the engine's own, in the order of the listing: noting a body costs a part of what inserting it
//! does, and looking one up takes no longer for many changes than for few.

use std::ops::RangeInclusive;

use super::kind::SceneKind;
use super::table::Table;
use crate::engine::Cursor;
use crate::geometry::CubeId;
use crate::log::Kind;

/// A body at its place in a listing; none where there is none any more, or was none yet.
pub(super) type Listed<K> = (Cursor, Option<(CubeId, <K as Kind>::Body)>);

/// What the bodies that some changes named were before the first of them. No body is in both tables.
pub(super) struct Before<K: SceneKind> {
    /// Those that were there.
    there: K::Table,
    /// Those that were not; with what was inserted first, which nobody asks for.
    absent: K::Table,
    /// Consecutive ids of bodies that were not there, each a large change's: few. Those in `there` were there all the same.
    absent_ranges: Vec<RangeInclusive<CubeId>>,
}

impl<K: SceneKind> Default for Before<K> {
    fn default() -> Self {
        Self {
            there: K::Table::default(),
            absent: K::Table::default(),
            absent_ranges: Vec::new(),
        }
    }
}

impl<K: SceneKind> Before<K> {
    /// Forgets all, but keeps the room.
    pub(super) fn clear(&mut self) {
        self.there.clear();
        self.absent.clear();
        self.absent_ranges.clear();
    }

    pub(super) fn is_empty(&self) -> bool {
        self.there.is_empty() && self.absent.is_empty() && self.absent_ranges.is_empty()
    }

    /// Notes a body that a change deletes; false, and nothing done, when a change before has named it. A body that moves is noted as
    /// deleted first.
    pub(super) fn note_deleted(&mut self, id: CubeId, body: K::Body) -> bool {
        !self.was_absent(id) && self.there.insert(id, body)
    }

    /// Notes a body that a change inserts, unless a change before has named it.
    pub(super) fn note_inserted(&mut self, id: CubeId, body: K::Body) {
        if self.there.is_empty() || self.there.get(id).is_none() {
            self.absent.insert(id, body);
        }
    }

    /// Notes bodies of consecutive ids that a change inserts. O(1), so for those of large changes: looking up takes longer for each.
    pub(super) fn note_inserted_range(&mut self, ids: RangeInclusive<CubeId>) {
        self.absent_ranges.push(ids);
    }

    /// Whether a body was not there before a change that has inserted it first.
    fn was_absent(&self, id: CubeId) -> bool {
        self.absent_ranges.iter().any(|ids| ids.contains(&id))
            || (!self.absent.is_empty() && self.absent.get(id).is_some())
    }

    /// What a body was.
    pub(super) fn body(&self, engine: &K::Engine, id: CubeId) -> Option<K::Body> {
        let there = self.there.get(id);
        there.or_else(|| {
            let is_durable = !self.was_absent(id);
            is_durable.then(|| K::get(engine, id)).flatten()
        })
    }

    /// The bodies that were there before a change that named them.
    pub(super) fn there(&self) -> impl Iterator<Item = (CubeId, K::Body)> + '_ {
        self.there.bodies_after(None)
    }

    /// Whether a change has named a body.
    pub(super) fn names(&self, id: CubeId) -> bool {
        self.there.get(id).is_some() || self.was_absent(id)
    }

    /// The listing of the bodies as they were, after a cursor, from the listing after it as it is now. None stands for a body that was
    /// not there.
    pub(super) fn listing<'a>(
        &'a self,
        now: impl Iterator<Item = Listed<K>> + 'a,
        after: Option<Cursor>,
    ) -> impl Iterator<Item = Listed<K>> + 'a {
        let mut now = now.peekable();
        let there = self.there.bodies_after(after);
        let mut there = there
            .map(|(id, body)| (Cursor::of(id), (id, body)))
            .peekable();
        std::iter::from_fn(move || {
            let is_there = match (there.peek(), now.peek()) {
                (Some((at, _)), Some((here, _))) => at <= here,
                (Some(_), None) => true,
                (None, _) => false,
            };
            if is_there {
                let (at, body) = there.next()?;
                now.next_if(|(here, _)| *here == at);
                return Some((at, Some(body)));
            }
            let (here, body) = now.next()?;
            Some((here, body.filter(|(id, _)| !self.was_absent(*id))))
        })
    }
}
