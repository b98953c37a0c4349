//! Bodies by id, in the order of the listing, for each kind of scene.

use std::collections::BTreeMap;
use std::ops::Bound;

use crate::engine::{Cursor, IdTable};
use crate::geometry::{CubeId, Place};

/// Bodies by id, in the order of the listing.
pub trait Table<Body>: Default + Send + Sync + 'static {
    /// Inserts a body; false, and nothing done, when the id is there.
    fn insert(&mut self, id: CubeId, body: Body) -> bool;

    /// The body of this id.
    fn get(&self, id: CubeId) -> Option<Body>;

    /// Whether there is no body.
    fn is_empty(&self) -> bool;

    /// Removes all bodies; may keep their room.
    fn clear(&mut self);

    /// The bodies that stand after the cursor in the listing, in its order.
    fn bodies_after(&self, after: Option<Cursor>) -> impl Iterator<Item = (CubeId, Body)> + '_;
}

impl Table<Place> for IdTable {
    fn insert(&mut self, id: CubeId, place: Place) -> bool {
        self.insert(id, place)
    }

    fn get(&self, id: CubeId) -> Option<Place> {
        self.get(id)
    }

    fn is_empty(&self) -> bool {
        self.is_empty()
    }

    fn clear(&mut self) {
        self.clear();
    }

    fn bodies_after(&self, after: Option<Cursor>) -> impl Iterator<Item = (CubeId, Place)> + '_ {
        self.cubes_after(after)
    }
}

impl<Body: Clone + Send + Sync + 'static> Table<Body> for BTreeMap<Cursor, (CubeId, Body)> {
    fn insert(&mut self, id: CubeId, body: Body) -> bool {
        let cursor = Cursor::of(id);
        let is_new = !self.contains_key(&cursor);
        if is_new {
            self.insert(cursor, (id, body));
        }
        is_new
    }

    fn get(&self, id: CubeId) -> Option<Body> {
        self.get(&Cursor::of(id)).map(|(_, body)| body.clone())
    }

    fn is_empty(&self) -> bool {
        self.is_empty()
    }

    fn clear(&mut self) {
        self.clear();
    }

    fn bodies_after(&self, after: Option<Cursor>) -> impl Iterator<Item = (CubeId, Body)> + '_ {
        let from = after.map_or(Bound::Unbounded, Bound::Excluded);
        self.range((from, Bound::Unbounded))
            .map(|(_, body)| body.clone())
    }
}
