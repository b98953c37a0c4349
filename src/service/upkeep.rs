//! What is done for a log between two groups of changes, a little at a time: a snapshot, then dropping what it makes superfluous.
//!
//! ```text
//!   rest ──log is long──► snapshot: begin, a chunk, a chunk, ..., finish ──► trim: a slice, a slice, ... ──► rest
//! ```
//! A snapshot is of the seq it was begun at. Its chunks are read from the listing of the engine, each after the last one's cursor, while
//! changes go on in between: where these found the cubes that are yet to come is kept, and takes the place of what the engine has.
//! The order of the listing depends on the ids alone, so a cursor stays true whatever becomes of the table.

use std::time::Instant;

use super::before::Before;
use super::kind::SceneKind;
use super::next_id::NextId;
use super::set::BodySet;
use super::{Published, meters};
use crate::engine::Cursor;
use crate::geometry::{CubeId, Effect};
use crate::log::{Log, LogError};

/// What is being done.
pub(super) enum Upkeep<K: SceneKind> {
    /// Nothing, until the log wants something (and not before the time, if any).
    Rest(Option<Instant>),
    /// A snapshot is being written.
    Snapshot(Copying<K>),
    /// What the snapshot made superfluous is being dropped.
    Trim,
}

/// A set of bodies that is read as of one moment, some at a time, while it changes.
pub(super) struct Copying<K: SceneKind> {
    /// The last body read.
    after: Option<Cursor>,
    /// What the bodies that have changed since were, as far as they come later.
    before: Before<K>,
}

impl<K: SceneKind> Default for Copying<K> {
    fn default() -> Self {
        Self {
            after: None,
            before: Before::default(),
        }
    }
}

impl<K: SceneKind> Copying<K> {
    /// Takes note of a change that has been made to the set.
    fn note(&mut self, effect: &Effect<K::Body>) {
        let comes = |id| Some(Cursor::of(id)) > self.after;
        for (id, body) in effect.deleted.iter().filter(|(id, _)| comes(*id)) {
            self.before.note_deleted(*id, body.clone());
        }
        for (id, body) in effect.inserted.iter().filter(|(id, _)| comes(*id)) {
            self.before.note_inserted(*id, body.clone());
        }
    }

    /// The next bodies, at most so many: fewer where bodies were inserted since, and none at the end. O(bodies asked for).
    fn next(&mut self, engine: &K::Engine, bodies_max: usize) -> Vec<(CubeId, K::Body)> {
        let mut bodies = Vec::new();
        for (cursor, body) in self.before.listing(engine, self.after).take(bodies_max) {
            bodies.extend(body);
            self.after = Some(cursor);
        }
        bodies
    }
}

impl<K: SceneKind> Upkeep<K> {
    /// Whether there is something to do while nobody asks.
    pub(super) fn waits(&self, log: &Log<K>, set: &BodySet<K>) -> bool {
        match self {
            Self::Rest(after) => {
                after.is_none_or(|after| Instant::now() >= after)
                    && (log.wants_snapshot(set.len()) || log.wants_trim())
            }
            Self::Snapshot(_) | Self::Trim => true,
        }
    }

    /// Takes note of a change that is durable now.
    pub(super) fn note(&mut self, effect: &Effect<K::Body>) {
        if let Self::Snapshot(copying) = self {
            copying.note(effect);
        }
    }

    /// One step, short enough that changes hardly wait for it; of a snapshot, so many cubes. The set is at its durable state.
    pub(super) fn step(
        &mut self,
        log: &mut Log<K>,
        set: &BodySet<K>,
        published: &Published<K>,
        next_id: NextId,
        snapshot_step_cubes: usize,
    ) -> Result<(), LogError> {
        match self {
            Self::Rest(_) if log.wants_snapshot(set.len()) => {
                log.snapshot_begin(published.at_ms, &published.totals, next_id.recorded())?;
                *self = Self::Snapshot(Copying::default());
            }
            Self::Rest(_) => *self = Self::Trim,
            Self::Snapshot(copying) => {
                let before = copying.after;
                let bodies = set.look_durable(|engine| copying.next(engine, snapshot_step_cubes));
                if copying.after == before {
                    log.snapshot_finish()?;
                    meters::snapshot_written();
                    *self = Self::Trim;
                } else {
                    log.snapshot_add(&bodies)?;
                }
            }
            Self::Trim => {
                if !log.trim()? {
                    *self = Self::Rest(None);
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::engine::Engine;
    use crate::geometry::{Edge, Place};
    use crate::log::Cubes;
    use crate::random::Random;

    /// Whatever changes between two steps (cubes come, go, move, and the table grows and shrinks): what is read is the set as it was at
    /// the first one, and no step reads more than it may.
    #[test]
    fn a_set_is_read_as_of_one_moment_while_it_changes() {
        let edge = Edge::new(4).unwrap();
        for seed in 1..40_u64 {
            let mut random = Random::new(seed);
            let mut below = |bound| random.below(bound);
            let mut engine = Engine::new(edge);
            let mut change = |engine: &mut Engine, spread: u64, cubes: u64| {
                let mut effect = Effect::default();
                let mut named = BTreeMap::new();
                for _ in 0..below(cubes) {
                    let corner = [(); 3].map(|()| i64::try_from(below(30)).unwrap());
                    let place = Place::new(corner, edge).unwrap();
                    named.insert(CubeId(below(spread)), (below(2) == 0).then_some(place));
                }
                for (id, place) in named {
                    effect
                        .deleted
                        .extend(engine.get(id).map(|there| (id, there)));
                    effect.inserted.extend(place.map(|place| (id, place)));
                }
                engine.apply(&effect).unwrap();
                effect
            };
            for _ in 0..5 {
                change(&mut engine, 400, 300);
            }
            let expected: Vec<_> = engine.cubes().collect();
            let mut copying = Copying::<Cubes>::default();
            let mut copied = Vec::new();
            let step = [1, 7, 64][usize::try_from(seed % 3).unwrap()];
            loop {
                let after = copying.after;
                let cubes = copying.next(&engine, step);
                assert!(cubes.len() <= step);
                copied.extend(cubes);
                if copying.after == after {
                    break;
                }
                let spread = [400, 4000][usize::try_from(seed % 2).unwrap()];
                let effect = change(&mut engine, spread, 40);
                copying.note(&effect);
            }
            assert_eq!(copied, expected);
        }
    }
}
