//! Where cubes were before some changes: what it takes to read a set as it was then.
//!
//! ```text
//!   the set now  ── cubes that no change named ──────────────────┬──> the set then
//!   before       ── cubes named, each as it was before the first ─┘
//! ```
//! Readers see the last durable state in this way while changes are on their way, and so does a snapshot that is written while
//! changes go on. Both tables are the engine's own, in the order of the listing: noting a cube costs a part of what inserting it
//! does, and looking one up takes no longer for many changes than for few.

use crate::engine::{Cursor, Engine, IdTable};
use crate::geometry::{CubeId, Place};

/// Where the cubes that some changes named were before the first of them. No cube is in both tables.
#[derive(Debug, Default)]
pub(super) struct Before {
    /// Those that were somewhere.
    there: IdTable,
    /// Those that were nowhere; with where they were inserted first, which nobody asks for.
    absent: IdTable,
}

impl Before {
    /// Forgets all, but keeps the room.
    pub(super) fn clear(&mut self) {
        self.there.clear();
        self.absent.clear();
    }

    pub(super) fn is_empty(&self) -> bool {
        self.there.is_empty() && self.absent.is_empty()
    }

    /// Notes a cube that a change deletes; false, and nothing done, when a change before has named it. A cube that moves is noted as deleted
    /// first.
    pub(super) fn note_deleted(&mut self, id: CubeId, place: Place) -> bool {
        (self.absent.is_empty() || self.absent.get(id).is_none()) && self.there.insert(id, place)
    }

    /// Notes a cube that a change inserts, unless a change before has named it.
    pub(super) fn note_inserted(&mut self, id: CubeId, place: Place) {
        if self.there.is_empty() || self.there.get(id).is_none() {
            self.absent.insert(id, place);
        }
    }

    /// Where a cube was.
    pub(super) fn place(&self, engine: &Engine, id: CubeId) -> Option<Place> {
        let there = self.there.get(id);
        there.or_else(|| match self.absent.get(id) {
            None => engine.get(id),
            Some(_) => None,
        })
    }

    /// Whether a change has named a cube.
    pub(super) fn names(&self, id: CubeId) -> bool {
        self.there.get(id).is_some() || self.absent.get(id).is_some()
    }

    /// The listing of the cubes as they were, after a cursor, from the engine as it is now. None stands for a cube that was not there.
    pub(super) fn listing<'a>(
        &'a self,
        engine: &'a Engine,
        after: Option<Cursor>,
    ) -> impl Iterator<Item = (Cursor, Option<(CubeId, Place)>)> + 'a {
        let with_cursor = |(id, place)| (Cursor::of(id), (id, place));
        let mut now = engine.cubes_after(after).map(with_cursor).peekable();
        let mut there = self.there.cubes_after(after).map(with_cursor).peekable();
        std::iter::from_fn(move || {
            let is_there = match (there.peek(), now.peek()) {
                (Some((at, _)), Some((here, _))) => at <= here,
                (Some(_), None) => true,
                (None, _) => false,
            };
            if is_there {
                let (at, cube) = there.next()?;
                now.next_if(|(here, _)| *here == at);
                return Some((at, Some(cube)));
            }
            let (here, cube) = now.next()?;
            let was_absent = !self.absent.is_empty() && self.absent.get(cube.0).is_some();
            Some((here, (!was_absent).then_some(cube)))
        })
    }
}
