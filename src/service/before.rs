//! Where cubes were before some changes: what it takes to read a set as it was then.
//!
//! ```text
//!   the set now   ──── cubes that no change named ──────────────┐
//!   before        ──── cubes that some change named, each as it was before the first of them ──┴──> the set then
//! ```
//! Readers see the last durable state in this way while changes are on their way, and so does a snapshot that is written while
//! changes go on.

use std::ops::Bound;

use super::tiered::Tiered;
use crate::engine::{Cursor, Engine};
use crate::geometry::{CubeId, Effect, Place};

/// Where a cube was, if anywhere.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Was {
    pub(super) id: CubeId,
    pub(super) place: Option<Place>,
}

impl Was {
    /// The cube, if it was somewhere.
    pub(super) fn cube(self) -> Option<(CubeId, Place)> {
        self.place.map(|place| (self.id, place))
    }
}

/// A cube that a change names, with its place in the listing.
pub(super) type Touched = (Cursor, Was);

/// Where the cubes that some changes named were before the first of them.
#[derive(Debug, Default)]
pub(super) struct Before(Tiered<Cursor, Was>);

/// The cubes that an effect names and that come after `after` in the listing, in its order, as they were before it.
pub(super) fn touched(effect: &Effect, after: Option<Cursor>) -> Vec<Touched> {
    let Effect { deleted, inserted } = effect;
    let was = |id, place| (Cursor::of(id), Was { id, place });
    let touched = deleted.iter().map(|&(id, place)| was(id, Some(place)));
    let touched = touched.chain(inserted.iter().map(|&(id, _)| was(id, None)));
    let mut touched: Vec<Touched> = touched.filter(|(at, _)| Some(*at) > after).collect();
    // Of a cube that moves, the deletion counts: before it the cube was somewhere.
    touched.sort_unstable_by_key(|(at, was)| (*at, was.place.is_none()));
    touched.dedup_by_key(|(at, _)| *at);
    touched
}

impl Before {
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Notes a cube; false, and nothing done, when an earlier change has named it.
    pub(super) fn note(&mut self, (at, was): Touched) -> bool {
        self.0.insert(at, was)
    }

    /// What [`Self::replace`] takes to note many cubes at once, and those of them that no earlier change has named.
    pub(super) fn merged(&self, touched: Vec<Touched>) -> (Vec<Touched>, Vec<Touched>) {
        self.0.merged(touched)
    }

    /// Takes a list that [`Self::merged`] made, and gives back the one before, which takes time to drop.
    pub(super) fn replace(&mut self, merged: Vec<Touched>) -> Vec<Touched> {
        self.0.replace_many(merged)
    }

    /// Where a cube was, when some change has named it.
    pub(super) fn get(&self, id: CubeId) -> Option<Was> {
        self.0.get(Cursor::of(id))
    }

    /// The listing of the cubes as they were, after a cursor, from the engine as it is now. None stands for a cube that was not there.
    pub(super) fn listing<'a>(
        &'a self,
        engine: &'a Engine,
        after: Option<Cursor>,
    ) -> impl Iterator<Item = (Cursor, Option<(CubeId, Place)>)> + 'a {
        let mut now = engine
            .cubes_after(after)
            .map(|(id, place)| (Cursor::of(id), (id, place)))
            .peekable();
        let mut touched = self
            .0
            .from(after.map_or(Bound::Unbounded, Bound::Excluded))
            .peekable();
        std::iter::from_fn(move || match (now.peek(), touched.peek()) {
            (Some((here, _)), touched) if touched.is_none_or(|(at, _)| here < at) => {
                now.next().map(|(at, cube)| (at, Some(cube)))
            }
            (here, Some((at, _))) => {
                if here.is_some_and(|(here, _)| here == at) {
                    now.next();
                }
                let (at, was) = touched.next()?;
                Some((at, was.cube()))
            }
            _ => None,
        })
    }
}
