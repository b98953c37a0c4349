//! The one thread of a scene that owns its engine and its log.
//!
//! ```text
//!          ┌───────────────────────────── reopen ◄──── probe_interval ────┐
//!          ▼                                                              │
//!   serve: judge ─ apply ─ append (one sync) ─ publish ─ answer ──failure───► stopped
//!          └── between two groups: a chunk of a snapshot, or a slice of trimming ──┘
//! ```
//! Nothing is answered or shown before the sync has returned. The engine runs ahead of the log only inside one group;
//! when the append fails, the engine is dropped and rebuilt from what the disk kept.

use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use super::inbox::{Pending, Reply};
use super::recover::{Halt, next_id_after, reopen};
use super::scene::{Condition, Feed, Scene};
use super::{
    Applied, CHANGE_OPERATIONS_MAX, Counting, FaultStep, Motion, Operations, Published, SceneState,
    Seq, ServiceError, Submission, meters,
};
use crate::engine::{Access, Counts, Engine, Judged, Op};
use crate::geometry::{CubeId, Effect, Place, Totals};
use crate::log::{Answer, KeyRecord, LogError, Record, SceneLog, Step};

/// Cubes that one step of a snapshot writes: a few milliseconds between two groups.
const SNAPSHOT_CHUNK_CUBES: usize = 65_536;

/// Upkeep that did not fit the disk is tried again after this many probe intervals.
const UPKEEP_PAUSE_PROBES: u32 = 60;

/// A scene that runs.
pub(super) struct Live {
    log: SceneLog,
    /// Newest durable state; the engine, which is in the feed, is at it between two groups.
    published: Published,
    /// The next id the server may give; 0 when there is none left.
    next_id: u64,
    /// Most cubes of the scene.
    cubes_max: u64,
    feed: Arc<Feed>,
    upkeep: Upkeep,
    /// Whose commit has failed.
    unanswered: Vec<Reply>,
}

/// What is done a little at a time, between groups.
enum Upkeep {
    /// Nothing, until the log wants something (and not before the time, if any).
    Rest(Option<Instant>),
    /// A snapshot is being written.
    Snapshot {
        cubes: Vec<(CubeId, Place)>,
        written: usize,
    },
    /// What the snapshot made superfluous is being dropped.
    Trim,
}

/// First and last of consecutive ids.
type IdRange = (CubeId, CubeId);

/// What is answered once the commit is durable.
type Answered = Result<Applied, ServiceError>;

/// What shares one commit.
#[derive(Default)]
struct Group {
    records: Vec<Record>,
    /// Net counts of the records.
    net: Vec<Counts>,
    keys: Vec<KeyRecord>,
    /// Index in `keys`, by key.
    keyed: HashMap<Box<str>, usize>,
}

/// Runs a scene until its end. `live` is there when the scene was just created.
pub(super) fn run(scene: &Scene, mut live: Option<Live>) {
    loop {
        let (halt, unanswered) = match live.take().map_or_else(|| attempt(scene), Ok) {
            Ok(live) => serve_until_halt(scene, live),
            Err(halt) => (halt, Vec::new()),
        };
        let Halt::Log(error) = halt else {
            return;
        };
        let comes_back = stop(scene, &error);
        // After the condition: who hears of the failure and looks again must not see the scene running.
        let refusal = unacknowledged(&error);
        for reply in unanswered {
            reply.send(Err(refusal.clone()));
        }
        let ended = || scene.inbox.wait_end(scene.setup.config.probe_interval);
        if !comes_back || ended().is_some() {
            return;
        }
    }
}

/// One try to bring the scene back.
fn attempt(scene: &Scene) -> Result<Live, Halt> {
    // A panic here is met again at every try (the log is the same), so the scene is refused rather than retried.
    let live = catch_unwind(AssertUnwindSafe(|| reopen(scene))).unwrap_or_else(|_| {
        Err(Halt::Log(LogError::Foreign {
            path: scene.directory.clone(),
            detail:
                "replay failed by a fault of this program; see its log, and try a newer version"
                    .to_owned(),
        }))
    })?;
    live.begin(scene);
    Ok(live)
}

fn serve_until_halt(scene: &Scene, mut live: Live) -> (Halt, Vec<Reply>) {
    let halt = catch_unwind(AssertUnwindSafe(|| live.serve(scene))).unwrap_or_else(|_| {
        // Nothing unlogged was shown, so a fault of this program is survived like one of the disk.
        Halt::Log(LogError::Failed {
            path: scene.directory.clone(),
            cause: "the writer failed by a fault of this program; see its log".to_owned(),
        })
    });
    (halt, live.unanswered)
}

/// Stops the scene for its callers; says whether it can come back by itself.
fn stop(scene: &Scene, error: &LogError) -> bool {
    let name = scene.name().as_str();
    let cause = error.to_string();
    let refusal = match error {
        LogError::Damaged { .. } | LogError::Foreign { .. } => {
            tracing::error!(
                scene = name,
                cause,
                "refused until its files are mended or dropped"
            );
            scene.set_condition(Condition::Damaged {
                cause: cause.clone(),
            });
            ServiceError::Damaged { cause }
        }
        LogError::Full { .. } | LogError::Failed { .. } => {
            // It is tried again every moment: only what is new is worth a line.
            if let SceneState::Stopped { cause: before, .. } = scene.state()
                && before == cause
            {
                tracing::debug!(scene = name, cause, "still stopped");
            } else {
                tracing::error!(
                    scene = name,
                    cause,
                    "stopped until the disk takes writes again"
                );
                meters::scene_stopped();
            }
            let full = matches!(error, LogError::Full { .. });
            scene.set_condition(Condition::Stopped {
                cause: cause.clone(),
                full,
            });
            ServiceError::Stopped { cause, full }
        }
    };
    scene.refuse_waiting(&refusal);
    scene.set_started();
    matches!(refusal, ServiceError::Stopped { .. })
}

impl Live {
    pub(super) fn new(
        log: SceneLog,
        published: &Published,
        next_id: u64,
        cubes_max: u64,
        feed: Feed,
    ) -> Self {
        Self {
            log,
            published: *published,
            next_id,
            cubes_max,
            feed: Arc::new(feed),
            upkeep: Upkeep::Rest(None),
            unanswered: Vec::new(),
        }
    }

    /// Newest durable state.
    pub(super) fn published(&self) -> &Published {
        &self.published
    }

    /// Lets callers in: readers are answered at once, changes as soon as the thread runs.
    pub(super) fn begin(&self, scene: &Scene) {
        scene.set_permille(1000);
        // The inbox first: who sees the scene running may change it at once. Nothing is taken from it before this returns.
        scene.inbox.open();
        scene.set_condition(Condition::Running(self.feed.clone()));
        scene.set_started();
    }

    /// Serves until the log fails or the end comes.
    fn serve(&mut self, scene: &Scene) -> Halt {
        let group_operations_max = scene.setup.config.group_operations_max;
        loop {
            let idle_work = self.upkeep_waits();
            let Some(group) = scene.inbox.take(group_operations_max, idle_work) else {
                return Halt::Ended;
            };
            if let Err(error) = self.commit(scene, group).and_then(|()| self.keep_up(scene)) {
                return Halt::Log(error);
            }
        }
    }

    /// Judges, applies, logs, publishes and answers one group.
    fn commit(&mut self, scene: &Scene, pending: Vec<Pending>) -> Result<(), LogError> {
        if pending.is_empty() {
            return Ok(());
        }
        let start = Instant::now();
        let (submissions, replies): (Vec<_>, Vec<_>) = pending
            .into_iter()
            .map(|pending| (pending.submission, pending.reply))
            .unzip();
        match self.judge_and_append(scene, submissions, &replies) {
            Ok((group, answers)) => {
                if let Some(newest) = group.newest() {
                    meters::committed(start.elapsed());
                    group.net.iter().for_each(meters::changed);
                    self.published = newest;
                    self.feed.publish(&newest);
                }
                for (reply, answer) in replies.into_iter().zip(answers) {
                    reply.send(answer);
                }
                Ok(())
            }
            Err(error) => {
                self.unanswered = replies;
                Err(error)
            }
        }
    }

    fn judge_and_append(
        &mut self,
        scene: &Scene,
        submissions: Vec<Submission>,
        replies: &[Reply],
    ) -> Result<(Group, Vec<Answered>), LogError> {
        let mut group = Group::default();
        let mut answers = Vec::with_capacity(submissions.len());
        for (submission, reply) in submissions.into_iter().zip(replies) {
            let answer = if reply.is_abandoned() {
                Err(ServiceError::Abandoned)
            } else {
                self.judge_once(&mut group, submission)?
            };
            reply.judged(&answer);
            answers.push(answer);
        }
        if !group.is_empty() {
            inject(scene, FaultStep::Append)?;
            self.log.append(&group.records, &group.keys)?;
            inject(scene, FaultStep::Appended)?;
        }
        Ok((group, answers))
    }

    /// Judges a change unless its key was met before.
    fn judge_once(
        &mut self,
        group: &mut Group,
        mut submission: Submission,
    ) -> Result<Answered, LogError> {
        let Some((key, body)) = submission.key.take() else {
            return self.judge(group, submission);
        };
        let earlier = match group.keyed.get(&key) {
            Some(&index) => Some(group.keys[index].clone()),
            None => self.log.key(&key)?,
        };
        if let Some(earlier) = earlier {
            return Ok(if earlier.body == body {
                Ok(replayed(&earlier.answer))
            } else {
                Err(ServiceError::KeyReused)
            });
        }
        let answer = self.judge(group, submission)?;
        if let Ok(applied) = &answer {
            group.keyed.insert(key.clone(), group.keys.len());
            group.keys.push(KeyRecord {
                key,
                body,
                answer: recorded(applied),
            });
        }
        Ok(answer)
    }

    /// Judges a change against the engine and applies it: the engine is then ahead of the log.
    fn judge(&mut self, group: &mut Group, submission: Submission) -> Result<Answered, LogError> {
        let mut back_to = None;
        let judged = match submission.operations {
            Operations::Revert(to) => {
                assert!(group.is_empty(), "a going back is a group of its own");
                back_to = Some(to);
                self.judge_revert(to)?.map(|judged| (judged, None))
            }
            operations => self.judge_operations(operations),
        };
        let (counting, motion) = (submission.counting, submission.motion);
        Ok(judged.map(|(judged, assigned)| {
            self.apply(group, judged, assigned, counting, motion, back_to)
        }))
    }

    fn judge_operations(
        &self,
        operations: Operations,
    ) -> Result<(Judged, Option<IdRange>), ServiceError> {
        let (ops, assigned) = self.number(operations)?;
        let judged = self
            .feed
            .set
            .look(|engine| engine.judge(&ops, self.cubes_max));
        let judged = judged.inspect_err(|_| meters::refused())?;
        Ok((judged, assigned))
    }

    /// What makes the set of cubes what it was at `to`: the changes that tell the two apart undone and redone, and only the net
    /// effect kept.
    fn judge_revert(&self, to: Seq) -> Result<Result<Judged, ServiceError>, LogError> {
        let newest = self.published.seq;
        let oldest = self.log.oldest_reachable();
        if to > newest {
            return Ok(Err(ServiceError::SeqNotReached { seq: to, newest }));
        }
        if to < oldest {
            return Ok(Err(ServiceError::NotReachable { seq: to, oldest }));
        }
        // Where each cube on the way was at last.
        let mut then: HashMap<CubeId, Option<Place>> = HashMap::new();
        self.log.way_to(to, &mut |step| {
            let (gone, come) = match step {
                Step::Undo(Effect { deleted, inserted }) => (inserted, deleted),
                Step::Redo(Effect { deleted, inserted }) => (deleted, inserted),
            };
            then.extend(gone.iter().map(|&(id, _)| (id, None)));
            then.extend(come.iter().map(|&(id, place)| (id, Some(place))));
        })?;
        let mut then: Vec<(CubeId, Option<Place>)> = then.into_iter().collect();
        then.sort_unstable_by_key(|(id, _)| *id);
        let mut effect = Effect::default();
        self.feed.set.look(|engine| {
            for (id, then) in then {
                let now = engine.get(id);
                if now != then {
                    effect.deleted.extend(now.map(|place| (id, place)));
                    effect.inserted.extend(then.map(|place| (id, place)));
                }
            }
        });
        let operations = effect.deleted.len() + effect.inserted.len();
        if operations > CHANGE_OPERATIONS_MAX {
            return Ok(Err(ServiceError::TooManyOperations { operations }));
        }
        let counts = Counts {
            inserted: effect.inserted.len() as u64,
            deleted: effect.deleted.len() as u64,
            unchanged: 0,
        };
        Ok(Ok(Judged {
            effect,
            in_order: counts,
            net: counts,
        }))
    }

    /// Applies what was judged: the engine is then ahead of the log.
    fn apply(
        &mut self,
        group: &mut Group,
        judged: Judged,
        assigned: Option<IdRange>,
        counting: Counting,
        motion: Motion,
        back_to: Option<Seq>,
    ) -> Applied {
        let counts = match counting {
            Counting::Net => judged.net,
            Counting::InOrder => judged.in_order,
        };
        let mut published = group.newest().unwrap_or(self.published);
        let mut volume_removed = 0;
        // A move that cuts nothing is a change too; but operations sent again that are done already are none.
        let is_move = motion.is_said() && judged.net.unchanged == 0;
        if judged.effect != Effect::default() || is_move {
            self.feed.set.apply(&judged.effect);
            for &(id, _) in &judged.effect.inserted {
                self.next_id = next_id_after(self.next_id, id);
            }
            let before = removed(&published.totals);
            published = Published {
                seq: Seq(published.seq.0 + 1),
                at_ms: now_ms().max(published.at_ms),
                totals: self.feed.set.look(Engine::totals),
            };
            volume_removed = removed(&published.totals) - before;
            group.net.push(judged.net);
            group.records.push(Record {
                seq: published.seq,
                at_ms: published.at_ms,
                effect: judged.effect,
                back_to,
                motion,
                volume_removed,
                totals: published.totals,
            });
        }
        Applied {
            published,
            counts,
            assigned,
            volume_removed,
            replayed: false,
        }
    }

    /// The operations with all their ids. Ids are used up only by a change that is then applied.
    fn number(&self, operations: Operations) -> Result<(Vec<Op>, Option<IdRange>), ServiceError> {
        let (delete, insert) = match operations {
            Operations::Named(ops) => return Ok((ops, None)),
            Operations::Numbered { delete, insert } => (delete, insert),
            Operations::Revert(_) => unreachable!("what a revert does is read from the log"),
        };
        let mut ops: Vec<Op> = delete.into_iter().map(Op::Delete).collect();
        let wanted = insert.len() as u64;
        if wanted == 0 {
            return Ok((ops, None));
        }
        let first = self.next_id;
        let last = first
            .checked_add(wanted - 1)
            .filter(|_| first != 0)
            .ok_or(ServiceError::IdsExhausted { wanted })?;
        ops.extend(
            (first..=last)
                .zip(insert)
                .map(|(id, place)| Op::Insert(CubeId(id), place)),
        );
        Ok((ops, Some((CubeId(first), CubeId(last)))))
    }

    /// Whether there is upkeep to do while nobody asks.
    fn upkeep_waits(&self) -> bool {
        match self.upkeep {
            Upkeep::Rest(after) => {
                after.is_none_or(|after| Instant::now() >= after)
                    && (self.wants_snapshot() || self.log.wants_trim())
            }
            Upkeep::Snapshot { .. } | Upkeep::Trim => true,
        }
    }

    fn wants_snapshot(&self) -> bool {
        self.log.wants_snapshot(self.feed.set.look(Engine::len))
    }

    /// One step of upkeep, short enough that changes hardly wait for it.
    fn keep_up(&mut self, scene: &Scene) -> Result<(), LogError> {
        if !self.upkeep_waits() {
            return Ok(());
        }
        match self.upkeep_step() {
            // Changes may still fit where a snapshot does not; they will tell when they do not.
            Err(error @ LogError::Full { .. }) => {
                tracing::warn!(
                    scene = scene.name().as_str(),
                    "no snapshot for now: {error}"
                );
                let pause = scene.setup.config.probe_interval * UPKEEP_PAUSE_PROBES;
                self.upkeep = Upkeep::Rest(Some(Instant::now() + pause));
                Ok(())
            }
            result => result,
        }
    }

    fn upkeep_step(&mut self) -> Result<(), LogError> {
        let wants_snapshot = self.wants_snapshot();
        match &mut self.upkeep {
            Upkeep::Rest(_) if !wants_snapshot => {
                self.upkeep = Upkeep::Trim;
            }
            Upkeep::Rest(_) => {
                let Published { at_ms, totals, .. } = self.published;
                self.log.snapshot_begin(at_ms, &totals, self.next_id)?;
                self.upkeep = Upkeep::Snapshot {
                    cubes: self.feed.set.look(|engine| engine.cubes().collect()),
                    written: 0,
                };
            }
            Upkeep::Snapshot { cubes, written } if *written < cubes.len() => {
                let end = cubes.len().min(*written + SNAPSHOT_CHUNK_CUBES);
                self.log.snapshot_add(&cubes[*written..end])?;
                *written = end;
            }
            Upkeep::Snapshot { .. } => {
                self.log.snapshot_finish()?;
                meters::snapshot_written();
                self.upkeep = Upkeep::Trim;
            }
            Upkeep::Trim => {
                if !self.log.trim()? {
                    self.upkeep = Upkeep::Rest(None);
                }
            }
        }
        Ok(())
    }
}

impl Group {
    fn is_empty(&self) -> bool {
        self.records.is_empty() && self.keys.is_empty()
    }

    /// The state after the newest of its records.
    fn newest(&self) -> Option<Published> {
        self.records.last().map(|record| Published {
            seq: record.seq,
            at_ms: record.at_ms,
            totals: record.totals,
        })
    }
}

/// Volume that is gone: from the stock, or into the union where there is no stock.
fn removed(totals: &Totals) -> i128 {
    match &totals.stock {
        Some(stock) => stock.removed.volume,
        None => totals.measures.volume,
    }
}

/// What a change is answered when the commit it was in has failed.
fn unacknowledged(error: &LogError) -> ServiceError {
    ServiceError::Stopped {
        cause: format!(
            "{error}; this change was not acknowledged: when the scene is back it is there whole or not at all"
        ),
        full: matches!(error, LogError::Full { .. }),
    }
}

fn recorded(applied: &Applied) -> Answer {
    Answer {
        seq: applied.published.seq,
        at_ms: applied.published.at_ms,
        inserted: applied.counts.inserted,
        deleted: applied.counts.deleted,
        unchanged: applied.counts.unchanged,
        assigned: applied.assigned,
        volume_removed: applied.volume_removed,
        totals: applied.published.totals,
    }
}

fn replayed(answer: &Answer) -> Applied {
    Applied {
        published: Published {
            seq: answer.seq,
            at_ms: answer.at_ms,
            totals: answer.totals,
        },
        counts: Counts {
            inserted: answer.inserted,
            deleted: answer.deleted,
            unchanged: answer.unchanged,
        },
        assigned: answer.assigned,
        volume_removed: answer.volume_removed,
        replayed: true,
    }
}

/// Fails where a test wants it.
pub(super) fn inject(scene: &Scene, step: FaultStep) -> Result<(), LogError> {
    match scene.setup.faults.as_ref().and_then(|faults| faults(step)) {
        Some(error) => Err(error),
        None => Ok(()),
    }
}

/// Milliseconds since 1970.
fn now_ms() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| {
            u64::try_from(since.as_millis()).unwrap_or(u64::MAX)
        })
}
