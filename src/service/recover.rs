//! From a log to a running scene: the one way in, at start and after a failure.

use std::collections::HashMap;
use std::path::Path;
use std::time::Instant;

use parking_lot::{Condvar, Mutex};

use super::scene::{Condition, Feed, Scene};
use super::writer::{Live, inject};
use super::{FaultStep, Published, Seq, meters};
use crate::engine::Engine;
use crate::geometry::{CubeId, Edge, Effect, Place, Totals};
use crate::log::{Keep, LogError, Replayed, SceneLog};

/// Lets a few scenes at a time be replayed: each replay can use all cores, and memory is not counted twice.
pub(super) struct Gate {
    free: Mutex<usize>,
    changed: Condvar,
}

/// A place behind the [`Gate`], given back when dropped.
pub(super) struct Pass<'a>(&'a Gate);

/// Why a scene does not run.
#[derive(Debug)]
pub(super) enum Halt {
    /// The log does not work; it may later.
    Log(LogError),
    /// The end was announced meanwhile.
    Ended,
}

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
    /// How many cubes may wait for others.
    fn waiting_max(self) -> usize {
        match self {
            Self::Every => 0,
            Self::Some => 1 << 22,
        }
    }
}

/// The state that a replay rebuilds.
pub(super) struct Rebuilt {
    pub(super) engine: Engine,
    seq: Seq,
    at_ms: u64,
    next_id: u64,
    compare: Compare,
    /// What is not in the engine yet.
    waiting: Effect,
    /// Which of the insertions that wait is of which cube: as long as there are deletions after them.
    inserted: Option<HashMap<CubeId, usize>>,
    /// What the totals must be when it is; nothing amid a snapshot.
    expected: Option<Totals>,
}

impl Gate {
    pub(super) fn new(places: usize) -> Self {
        Self {
            free: Mutex::new(places),
            changed: Condvar::new(),
        }
    }

    /// Waits for a place; none when `ended` says so first.
    fn enter(&self, ended: impl Fn() -> bool) -> Option<Pass<'_>> {
        let mut free = self.free.lock();
        loop {
            if ended() {
                return None;
            }
            if *free > 0 {
                *free -= 1;
                return Some(Pass(self));
            }
            self.changed.wait(&mut free);
        }
    }

    /// Makes those who wait look again whether they have ended.
    pub(super) fn nudge(&self) {
        // Under the lock, so that nobody is between its look and its wait.
        let _free = self.free.lock();
        self.changed.notify_all();
    }
}

impl Drop for Pass<'_> {
    fn drop(&mut self) {
        *self.0.free.lock() += 1;
        self.0.changed.notify_all();
    }
}

impl From<LogError> for Halt {
    fn from(error: LogError) -> Self {
        Self::Log(error)
    }
}

/// Opens the scene's log, proves that it takes writes, and replays it.
pub(super) fn reopen(scene: &Scene) -> Result<Live, Halt> {
    let ended = || scene.inbox.ended().is_some();
    let _pass = scene.setup.gate.enter(ended).ok_or(Halt::Ended)?;
    inject(scene, FaultStep::Open)?;
    let (mut log, notices) =
        SceneLog::open(&scene.setup.config.disk, &scene.directory, keep(scene))?;
    for notice in &notices {
        tracing::warn!(scene = scene.name().as_str(), "{notice}");
    }
    scene.keep_notices(notices);
    log.probe()?;
    scene.set_permille(0);
    scene.set_condition(Condition::Recovering);
    let start = Instant::now();
    let live = revive(scene, log)?;
    let published = live.published();
    meters::recovered(start.elapsed());
    tracing::info!(
        scene = scene.name().as_str(),
        seq = published.seq.0,
        cubes = published.totals.cubes,
        milliseconds = start.elapsed().as_millis(),
        "recovered"
    );
    Ok(live)
}

/// Limits of what the scene's log keeps.
pub(super) fn keep(scene: &Scene) -> Keep {
    Keep {
        snapshot_log_bytes_min: scene.setup.config.snapshot_log_bytes_min,
        history_changes_max: scene.setup.config.history_changes_max,
        idempotency_keys_max: scene.setup.config.idempotency_keys_max,
        revert_changes_max: scene.setup.config.revert_changes_max,
        revert_bytes_max: scene.setup.config.revert_bytes_max,
    }
}

/// Replays an open log.
pub(super) fn revive(scene: &Scene, mut log: SceneLog) -> Result<Live, Halt> {
    if !scene.keep_header(log.header()) {
        let detail = "another scene's files were put here while it was stopped".to_owned();
        let path = scene.directory.clone();
        return Err(LogError::Foreign { path, detail }.into());
    }
    let rebuilt = rebuild(
        &mut log,
        &scene.directory,
        Compare::Some,
        |permille| scene.set_permille(permille),
        || scene.inbox.ended().is_some(),
    )?;
    let history = log.history()?;
    let created_ms = log.created_ms();
    let mut published = rebuilt.published();
    if published.seq == Seq(0) {
        published.at_ms = created_ms;
    }
    Ok(Live::new(
        log,
        &published,
        rebuilt.next_id,
        scene.setup.config.scene_cubes_max,
        Feed::new(rebuilt.engine, &published, history),
    ))
}

/// Rebuilds the state that a log leads to, comparing totals on the way; gives up when `ended` says so.
pub(super) fn rebuild(
    log: &mut SceneLog,
    directory: &Path,
    compare: Compare,
    mut progress: impl FnMut(u32),
    ended: impl Fn() -> bool,
) -> Result<Rebuilt, Halt> {
    let steps = i64::from(log.header().edge_steps);
    let edge = Edge::new(steps).map_err(|invalid| LogError::Foreign {
        path: directory.to_owned(),
        detail: invalid.to_string(),
    })?;
    let mut rebuilt = Rebuilt::new(Engine::new(edge).with_stock(log.header().stock), compare);
    let (mut has_ended, mut fits) = (false, true);
    let result = log.replay(&mut progress, &mut |replayed| {
        has_ended = has_ended || ended();
        fits = fits && !has_ended && rebuilt.visit(&replayed);
        fits
    });
    if has_ended {
        return Err(Halt::Ended);
    }
    fits = fits && (result.is_err() || rebuilt.settle());
    if !fits && compare == Compare::Some {
        let path = directory.display();
        tracing::warn!(%path, "totals differ from those recorded: all of them are compared now");
        return rebuild(log, directory, Compare::Every, progress, ended);
    }
    result?;
    Ok(rebuilt)
}

/// The id after the greatest one inserted so far; 0 when there is none left.
pub(super) fn next_id_after(next_id: u64, inserted: CubeId) -> u64 {
    if next_id == 0 {
        return 0;
    }
    match inserted.0.checked_add(1) {
        Some(next) => next.max(next_id),
        None => 0,
    }
}

impl Rebuilt {
    fn new(engine: Engine, compare: Compare) -> Self {
        Self {
            engine,
            seq: Seq(0),
            at_ms: 0,
            next_id: 1,
            compare,
            waiting: Effect::default(),
            inserted: None,
            expected: None,
        }
    }

    /// Where it stands.
    pub(super) fn published(&self) -> Published {
        Published {
            seq: self.seq,
            at_ms: self.at_ms,
            totals: self.engine.totals(),
        }
    }

    /// Takes one step; false when it does not lead to the totals that were recorded.
    fn visit(&mut self, replayed: &Replayed<'_>) -> bool {
        match *replayed {
            Replayed::SnapshotBegin { cubes } => {
                self.engine.reserve(cubes);
                true
            }
            Replayed::Cubes(cubes) => self.take(&[], cubes, None),
            Replayed::SnapshotEnd {
                seq,
                at_ms,
                totals,
                next_id,
            } => {
                (self.seq, self.at_ms, self.next_id) = (seq, at_ms, next_id);
                self.expected = Some(*totals);
                self.settle()
            }
            Replayed::Change(record) => {
                if record.seq.0 != self.seq.0 + 1 {
                    return false;
                }
                (self.seq, self.at_ms) = (record.seq, record.at_ms);
                let Effect { deleted, inserted } = &record.effect;
                for &(id, _) in inserted {
                    self.next_id = next_id_after(self.next_id, id);
                }
                self.take(deleted, inserted, Some(&record.totals))
            }
        }
    }

    /// Takes some cubes, which lead to totals if these are recorded; now or later.
    fn take(
        &mut self,
        deleted: &[(CubeId, Place)],
        inserted: &[(CubeId, Place)],
        totals: Option<&Totals>,
    ) -> bool {
        for (id, place) in deleted {
            match self.forget(*id) {
                None => self.waiting.deleted.push((*id, *place)),
                Some(there) if there == *place => {}
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
        waiting < self.compare.waiting_max() || self.settle()
    }

    /// Takes an insertion back that waits, and says where it was to be: an effect deletes first, so a later deletion of the cube
    /// cannot be in the same one.
    fn forget(&mut self, id: CubeId) -> Option<Place> {
        let waiting = &mut self.waiting.inserted;
        if waiting.is_empty() {
            return None;
        }
        let index = self.inserted.get_or_insert_with(|| {
            let numbers = waiting.iter().zip(0..);
            numbers.map(|((id, _), number)| (*id, number)).collect()
        });
        let number = index.remove(&id)?;
        let (_, place) = waiting.swap_remove(number);
        if let Some((moved, _)) = waiting.get(number) {
            index.insert(*moved, number);
        }
        Some(place)
    }

    /// Takes what waits; false when it does not fit, or does not lead to the totals that were recorded.
    fn settle(&mut self) -> bool {
        let fits = self.engine.apply(&self.waiting).is_ok();
        self.waiting.deleted.clear();
        self.waiting.inserted.clear();
        self.inserted = None;
        let expected = self.expected.take();
        fits && expected.is_none_or(|totals| totals == self.engine.totals())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::log::Record;
    use crate::service::Motion;

    /// What many changes do together is what they do one after the other: cubes that come and go, move, and come again.
    #[test]
    fn changes_taken_together_come_to_the_same() {
        let edge = Edge::new(4).unwrap();
        let mut random = 1_u64;
        let mut below = |end: u64| {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            random % end
        };
        let mut live: BTreeMap<CubeId, Place> = BTreeMap::new();
        let mut engine = Engine::new(edge);
        let mut together = Rebuilt::new(Engine::new(edge), Compare::Some);
        let mut apart = Rebuilt::new(Engine::new(edge), Compare::Every);
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
                    let corner = [0; 3].map(|_: i64| i64::try_from(below(9)).unwrap());
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
                back_to: None,
                motion: Motion::default(),
                volume_removed: 0,
                totals: engine.totals(),
            };
            assert!(together.visit(&Replayed::Change(&record)));
            assert!(apart.visit(&Replayed::Change(&record)));
            if below(40) == 0 {
                assert!(together.settle(), "seq {seq}");
            }
        }
        assert!(together.settle());
        for rebuilt in [together, apart] {
            let cubes: BTreeMap<_, _> = rebuilt.engine.cubes().collect();
            assert_eq!(cubes, live);
            let published = rebuilt.published();
            assert_eq!((published.seq, published.at_ms), (Seq(300), 300));
            assert_eq!(published.totals, engine.totals());
        }
    }
}
