//! From a log to the state that it leads to, as data.
//!
//! Knows the log and the engine. Never knows a scene, its threads or its clients.

use std::collections::HashMap;
use std::path::Path;

use super::kind::SceneKind;
use super::next_id::NextId;
use super::{Published, Seq};
use crate::geometry::{CubeId, Effect};
use crate::log::{Log, LogError, Replayed};

/// Which of the recorded totals a replay compares with those that it comes to.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Compare {
    /// Those after every change.
    Every,
    /// The newest, and some on the way: what many changes do together is done at once, which is faster. When some differ
    /// everything is done again, comparing all, so that the first at fault is named.
    Some,
}

impl Compare {
    /// How many bodies may wait for others.
    fn waiting_max<K: SceneKind>(self) -> usize {
        match self {
            Self::Every => 0,
            Self::Some => K::REPLAYED_TOGETHER_MAX,
        }
    }
}

/// The state that a replay rebuilds.
pub(super) struct Rebuilt<K: SceneKind> {
    pub(super) engine: K::Engine,
    seq: Seq,
    at_ms: u64,
    pub(super) next_id: NextId,
    compare: Compare,
    /// What is not in the engine yet.
    waiting: Effect<K::Body>,
    /// Which of the insertions that wait is of which cube: as long as there are deletions after them.
    inserted: Option<HashMap<CubeId, usize>>,
    /// What the totals must be when it is; nothing amid a snapshot.
    expected: Option<K::Totals>,
    /// What they are.
    totals: K::Totals,
}

/// Rebuilds the state that a log leads to, comparing totals on the way; none when `ended` says so on the way.
pub(super) fn rebuild<K: SceneKind>(
    log: &mut Log<K>,
    directory: &Path,
    compare: Compare,
    mut progress: impl FnMut(u32),
    ended: impl Fn() -> bool,
) -> Result<Option<Rebuilt<K>>, LogError> {
    let engine = K::engine(log.header()).map_err(|detail| LogError::Foreign {
        path: directory.to_owned(),
        detail,
    })?;
    let mut rebuilt = Rebuilt::new(engine, compare);
    let (mut has_ended, mut fits) = (false, true);
    let result = log.replay(&mut progress, &mut |replayed| {
        has_ended = has_ended || ended();
        fits = fits && !has_ended && rebuilt.visit(&replayed);
        fits
    });
    if has_ended {
        return Ok(None);
    }
    fits = fits && (result.is_err() || rebuilt.flush());
    if !fits && compare == Compare::Some {
        let path = directory.display();
        tracing::warn!(%path, "totals differ from those recorded: all of them are compared now");
        return rebuild(log, directory, Compare::Every, progress, ended);
    }
    result?;
    Ok(Some(rebuilt))
}

impl<K: SceneKind> Rebuilt<K> {
    fn new(engine: K::Engine, compare: Compare) -> Self {
        Self {
            totals: K::totals(&engine),
            engine,
            seq: Seq(0),
            at_ms: 0,
            next_id: NextId::FIRST,
            compare,
            waiting: Effect::default(),
            inserted: None,
            expected: None,
        }
    }

    /// Where it stands.
    pub(super) fn published(&self) -> Published<K> {
        Published {
            seq: self.seq,
            at_ms: self.at_ms,
            totals: self.totals,
        }
    }

    /// Takes one step; false when it does not lead to the totals that were recorded.
    fn visit(&mut self, replayed: &Replayed<'_, K>) -> bool {
        match *replayed {
            Replayed::SnapshotBegin { cubes } => {
                K::reserve(&mut self.engine, cubes);
                true
            }
            Replayed::Cubes(cubes) => {
                for (id, _) in cubes {
                    self.next_id.pass(*id);
                }
                self.add(&[], cubes, None)
            }
            Replayed::SnapshotEnd {
                seq,
                at_ms,
                totals,
                next_id,
            } => {
                (self.seq, self.at_ms) = (seq, at_ms);
                self.next_id = self.next_id.of_record(next_id);
                self.expected = Some(*totals);
                self.flush()
            }
            Replayed::Change(record) => {
                if record.seq.0 != self.seq.0 + 1 {
                    return false;
                }
                (self.seq, self.at_ms) = (record.seq, record.at_ms);
                let Effect { deleted, inserted } = &record.effect;
                for (id, _) in inserted {
                    self.next_id.pass(*id);
                }
                self.add(deleted, inserted, Some(&record.totals))
            }
        }
    }

    /// Adds what deletions and insertions do, which lead to totals if these are recorded; now or later.
    fn add(
        &mut self,
        deleted: &[(CubeId, K::Body)],
        inserted: &[(CubeId, K::Body)],
        totals: Option<&K::Totals>,
    ) -> bool {
        for (id, body) in deleted {
            match self.forget(*id) {
                None => self.waiting.deleted.push((*id, body.clone())),
                Some(there) if there == *body => {}
                Some(_) => return false,
            }
        }
        if let Some(index) = &mut self.inserted {
            let numbers = self.waiting.inserted.len()..;
            let new = inserted.iter().zip(numbers);
            index.extend(new.map(|((id, _), number)| (*id, number)));
        }
        self.waiting.inserted.extend_from_slice(inserted);
        self.expected = totals.copied();
        let waiting = self.waiting.deleted.len() + self.waiting.inserted.len();
        waiting < self.compare.waiting_max::<K>() || self.flush()
    }

    /// Takes an insertion back that waits, and says what it was to be: an effect deletes first, so a later deletion of the body
    /// cannot be in the same one.
    fn forget(&mut self, id: CubeId) -> Option<K::Body> {
        let waiting = &mut self.waiting.inserted;
        if waiting.is_empty() {
            return None;
        }
        let index = self.inserted.get_or_insert_with(|| {
            let numbers = waiting.iter().zip(0..);
            numbers.map(|((id, _), number)| (*id, number)).collect()
        });
        let number = index.remove(&id)?;
        let (_, body) = waiting.swap_remove(number);
        if let Some((moved, _)) = waiting.get(number) {
            index.insert(*moved, number);
        }
        Some(body)
    }

    /// Applies what waits; false when it does not fit, or does not lead to the totals that were recorded. These are taken over whole:
    /// with what is no function of the set, such as how far rounding can be off.
    fn flush(&mut self) -> bool {
        let nothing_waits = self.waiting == Effect::default();
        if nothing_waits && self.expected.is_none() {
            return true;
        }
        let fits = K::apply(&mut self.engine, &self.waiting);
        self.waiting.deleted.clear();
        self.waiting.inserted.clear();
        self.inserted = None;
        self.totals = K::totals(&self.engine);
        match self.expected.take() {
            Some(expected) => {
                let fits = fits && K::agree(&expected, &self.totals);
                self.totals = expected;
                fits
            }
            None => fits,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::engine::Engine;
    use crate::geometry::{Edge, Place};
    use crate::log::{Cubes, Record};
    use crate::random::Random;
    use crate::service::Motion;

    /// What many changes do together is what they do one after the other: cubes that come and go, move, and come again.
    #[test]
    fn changes_taken_together_come_to_the_same() {
        let edge = Edge::new(4).unwrap();
        let mut random = Random::new(1);
        let mut below = |bound| random.below(bound);
        let mut live: BTreeMap<CubeId, Place> = BTreeMap::new();
        let mut engine = Engine::new(edge);
        let mut together = Rebuilt::<Cubes>::new(Engine::new(edge), Compare::Some);
        let mut apart = Rebuilt::<Cubes>::new(Engine::new(edge), Compare::Every);
        for seq in 1..=300 {
            let mut effect = Effect::default();
            for id in (0..12).map(CubeId) {
                if below(3) > 0 {
                    continue;
                }
                if let Some(place) = live.remove(&id) {
                    effect.deleted.push((id, place));
                }
                if below(3) > 0 {
                    let corner = [0; 3].map(|_: i64| below(9));
                    let place = Place::new(corner, edge).unwrap();
                    live.insert(id, place);
                    effect.inserted.push((id, place));
                }
            }
            engine.apply(&effect).unwrap();
            let record = Record {
                seq: Seq(seq),
                at_ms: seq,
                effect,
                reverts_to: None,
                motion: Motion::default(),
                volume_removed: 0,
                totals: engine.totals(),
            };
            assert!(together.visit(&Replayed::Change(&record)));
            assert!(apart.visit(&Replayed::Change(&record)));
            if below(40) == 0 {
                assert!(together.flush(), "seq {seq}");
            }
        }
        assert!(together.flush());
        for rebuilt in [together, apart] {
            let cubes: BTreeMap<_, _> = rebuilt.engine.cubes().collect();
            assert_eq!(cubes, live);
            let published = rebuilt.published();
            assert_eq!((published.seq, published.at_ms), (Seq(300), 300));
            assert_eq!(published.totals, engine.totals());
        }
    }
}
