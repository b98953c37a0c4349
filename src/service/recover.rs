//! From a log to a running scene: the one way in, at start and after a failure.

use std::path::Path;
use std::time::Instant;

use parking_lot::{Condvar, Mutex};

use super::scene::{Condition, Feed, Scene};
use super::writer::{Live, inject};
use super::{FaultStep, Published, Seq, meters};
use crate::engine::Engine;
use crate::geometry::{CubeId, Edge, Effect, Totals};
use crate::log::{Keep, Log, LogError, Replayed, SceneLog};

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

/// The state that a replay rebuilds.
pub(super) struct Rebuilt {
    pub(super) engine: Engine,
    seq: Seq,
    at_ms: u64,
    next_id: u64,
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
    let (mut log, notices) = SceneLog::open(&scene.directory, keep(scene))?;
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
        Feed::new(rebuilt.engine, &published, history),
    ))
}

/// Rebuilds the state that a log leads to, comparing the totals at every step; gives up when `ended` says so.
pub(super) fn rebuild(
    log: &mut SceneLog,
    directory: &Path,
    mut progress: impl FnMut(u32),
    ended: impl Fn() -> bool,
) -> Result<Rebuilt, Halt> {
    let steps = i64::from(log.header().edge_steps);
    let edge = Edge::new(steps).map_err(|invalid| LogError::Foreign {
        path: directory.to_owned(),
        detail: invalid.to_string(),
    })?;
    let mut rebuilt = Rebuilt {
        engine: Engine::new(edge).with_stock(log.header().stock),
        seq: Seq(0),
        at_ms: 0,
        next_id: 1,
    };
    let mut has_ended = false;
    let result = log.replay(&mut progress, &mut |replayed| {
        has_ended = has_ended || ended();
        !has_ended && rebuilt.visit(&replayed)
    });
    if has_ended {
        return Err(Halt::Ended);
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
            Replayed::Cubes(cubes) => self
                .engine
                .apply(&Effect {
                    deleted: Vec::new(),
                    inserted: cubes.to_vec(),
                })
                .is_ok(),
            Replayed::SnapshotEnd {
                seq,
                at_ms,
                totals,
                next_id,
            } => {
                self.next_id = next_id;
                self.arrive(seq, at_ms, totals)
            }
            Replayed::Change(record) => {
                if record.seq.0 != self.seq.0 + 1 || self.engine.apply(&record.effect).is_err() {
                    return false;
                }
                for &(id, _) in &record.effect.inserted {
                    self.next_id = next_id_after(self.next_id, id);
                }
                self.arrive(record.seq, record.at_ms, &record.totals)
            }
        }
    }

    fn arrive(&mut self, seq: Seq, at_ms: u64, totals: &Totals) -> bool {
        self.seq = seq;
        self.at_ms = at_ms;
        self.engine.totals() == *totals
    }
}
