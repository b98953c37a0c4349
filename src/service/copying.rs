//! Reading all bodies as of one moment, some at a time, while they change: listings, audits and snapshots.
//!
//! ```text
//!   the set, durable now ── before ──> the set as it was when the reading began, from the cursor on
//! ```
//! What changes find of the bodies that are yet to be read is kept, and takes the place of what is there now. The order of the
//! listing depends on the ids alone, so a cursor stays true whatever becomes of the table. Memory is what has changed ahead of the
//! cursor since, never the set.

use std::sync::{Arc, Weak};

use parking_lot::Mutex;

use super::Published;
use super::before::Before;
use super::kind::SceneKind;
use super::set::{BodySet, View};
use crate::engine::Cursor;
use crate::geometry::{CubeId, Effect};
use crate::log::Kind;

/// A reading under way.
pub(super) struct Copying<K: SceneKind> {
    /// The last body read.
    after: Option<Cursor>,
    /// What the bodies that have changed since were, as far as they come later.
    before: Before<K>,
    /// How many bodies were noted in it.
    noted: usize,
    /// When more are noted, the reading is given up.
    noted_max: usize,
}

/// The readings of one set.
pub(super) struct Copies<K: SceneKind>(Mutex<Vec<Weak<Mutex<Copying<K>>>>>);

/// A reading that has begun, and the state that it is of.
pub(super) type Begun<K> = (Published<K>, Arc<Mutex<Copying<K>>>);

/// Bodies with their ids; none at the end.
type NextBodies<K> = Option<Vec<(CubeId, <K as Kind>::Body)>>;

/// So much has changed ahead of a reading that it was given up.
#[derive(Clone, Copy, Debug)]
pub(super) struct GivenUp;

impl<K: SceneKind> Default for Copies<K> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<K: SceneKind> Copies<K> {
    /// Begins a reading of the durable state, which is given up when more than so many bodies change ahead of it. None when a step has
    /// failed.
    pub(super) fn begin(&self, set: &BodySet<K>, noted_max: usize) -> Option<Begun<K>> {
        let copying = Arc::new(Mutex::new(Copying {
            after: None,
            before: Before::default(),
            noted: 0,
            noted_max,
        }));
        // Held until it is in the list: no state becomes durable in between.
        let mut copies = self.0.lock();
        let published = set.view()?.published();
        copies.retain(|copy| copy.strong_count() > 0);
        copies.push(Arc::downgrade(&copying));
        Some((published, copying))
    }

    /// Takes note of changes, and makes them the durable state by `show`. Noting comes first: what is noted of a body is true already.
    pub(super) fn note<'a>(
        &self,
        effects: &(impl Iterator<Item = &'a Effect<K::Body>> + Clone),
        show: impl FnOnce(),
    ) {
        let copies = self.0.lock();
        for copying in copies.iter().filter_map(Weak::upgrade) {
            let mut copying = copying.lock();
            effects.clone().for_each(|effect| copying.note(effect));
        }
        show();
    }
}

impl<K: SceneKind> Copying<K> {
    /// Takes note of a change that is about to be the set's.
    fn note(&mut self, effect: &Effect<K::Body>) {
        if self.is_given_up() {
            return;
        }
        let comes = |id| Some(Cursor::of(id)) > self.after;
        for (id, body) in effect.deleted.iter().filter(|(id, _)| comes(*id)) {
            self.before.note_deleted(*id, body.clone());
            self.noted += 1;
        }
        for (id, body) in effect.inserted.iter().filter(|(id, _)| comes(*id)) {
            self.before.note_inserted(*id, body.clone());
            self.noted += 1;
        }
        if self.is_given_up() {
            self.before = Before::default();
        }
    }

    fn is_given_up(&self) -> bool {
        self.noted > self.noted_max
    }

    /// The next bodies, at most so many: fewer, or none, where bodies were inserted since. None at the end. O(bodies asked for).
    pub(super) fn next(
        &mut self,
        view: &View<'_, K>,
        bodies_max: usize,
    ) -> Result<NextBodies<K>, GivenUp> {
        if self.is_given_up() {
            return Err(GivenUp);
        }
        let begun_after = self.after;
        let mut bodies = Vec::new();
        let listing = self.before.listing(view.listing(self.after), self.after);
        for (cursor, body) in listing.take(bodies_max) {
            bodies.extend(body);
            self.after = Some(cursor);
        }
        Ok((self.after != begun_after).then_some(bodies))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::engine::Engine;
    use crate::geometry::{Edge, Place, Totals};
    use crate::log::{Cubes, Seq};
    use crate::random::Random;

    /// A set in which cubes come, go and move.
    struct Busy {
        set: BodySet<Cubes>,
        copies: Copies<Cubes>,
        published: Published,
        random: Random,
        edge: Edge,
    }

    impl Busy {
        fn new(seed: u64) -> Self {
            let edge = Edge::new(4).unwrap();
            let published = Published {
                seq: Seq(0),
                at_ms: 0,
                totals: Totals::default(),
            };
            Self {
                set: BodySet::new(Engine::new(edge), &published),
                copies: Copies::default(),
                published,
                random: Random::new(seed),
                edge,
            }
        }

        /// Applies a change, and makes it durable after `meanwhile` has looked.
        fn change(&mut self, spread: u64, cubes: u64, mut meanwhile: impl FnMut(&Self)) {
            let mut effect = Effect::default();
            let mut named = BTreeMap::new();
            for _ in 0..self.random.below(cubes) {
                let corner = [(); 3].map(|()| self.random.within(0, 29));
                let place = Place::new(corner, self.edge).unwrap();
                let is_there = self.random.below(2) == 0;
                named.insert(CubeId(self.random.below(spread)), is_there.then_some(place));
            }
            let view = self.set.view().unwrap();
            for (id, place) in named {
                effect
                    .deleted
                    .extend(view.body(id).map(|there| (id, there)));
                effect.inserted.extend(place.map(|place| (id, place)));
            }
            drop(view);
            self.set.apply(&effect);
            meanwhile(self);
            self.published.seq.0 += 1;
            self.copies.note(&[&effect].into_iter(), || {
                self.set.advance(&self.published, || {});
            });
        }

        fn bodies(&self) -> Vec<(CubeId, Place)> {
            let view = self.set.view().unwrap();
            view.listing(None).filter_map(|(_, body)| body).collect()
        }
    }

    /// Whatever changes between two steps (cubes come, go, move, and the table grows and shrinks), and while a change is on its way: what
    /// is read is the set as it was at the first step, and no step reads more than it may.
    #[test]
    fn a_set_is_read_as_of_one_moment_while_it_changes() {
        for seed in 1..40_u64 {
            let mut busy = Busy::new(seed);
            for _ in 0..5 {
                busy.change(400, 300, |_| {});
            }
            let expected = busy.bodies();
            let (published, copying) = busy.copies.begin(&busy.set, usize::MAX).unwrap();
            assert_eq!(published.seq, Seq(5), "seed {seed}");
            let mut copied = Vec::new();
            let step = [1, 7, 64][usize::try_from(seed % 3).unwrap()];
            let read = |busy: &Busy, copied: &mut Vec<_>| {
                let view = busy.set.view().unwrap();
                let cubes = copying.lock().next(&view, step).unwrap();
                let goes_on = cubes.is_some();
                let cubes = cubes.unwrap_or_default();
                assert!(cubes.len() <= step, "seed {seed}");
                copied.extend(cubes);
                goes_on
            };
            while read(&busy, &mut copied) {
                let spread = [400, 4000][usize::try_from(seed % 2).unwrap()];
                busy.change(spread, 40, |busy| {
                    read(busy, &mut copied);
                });
            }
            assert_eq!(copied, expected, "seed {seed}");
        }
    }

    /// A reading that nobody goes on with does not keep all that changes.
    #[test]
    fn a_reading_left_behind_is_given_up() {
        let mut busy = Busy::new(7);
        for _ in 0..5 {
            busy.change(400, 300, |_| {});
        }
        let (_, copying) = busy.copies.begin(&busy.set, 100).unwrap();
        let (_, patient) = busy.copies.begin(&busy.set, usize::MAX).unwrap();
        for _ in 0..20 {
            busy.change(400, 300, |_| {});
        }
        let view = busy.set.view().unwrap();
        assert!(copying.lock().next(&view, 10).is_err());
        assert!(copying.lock().before.is_empty());
        assert!(patient.lock().next(&view, 10).is_ok());
    }
}
