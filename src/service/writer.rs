//! The writer of a scene: what its one thread does while the scene runs.
//!
//! ```text
//!   serve: judge ─ apply ─ append (one sync) ─ publish ─ answer
//!      └── between two groups: a step of upkeep ──┘
//! ```
//! Nothing is answered or shown before the sync has returned. The engine runs ahead of the log only inside one group;
//! when the append fails, the engine is dropped and rebuilt from what the disk kept (`lifecycle`).

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Instant;

use super::clock::Clock;
use super::failpoint::{self, FailPoint};
use super::feed::Feed;
use super::inbox::{Pending, Reply};
use super::judge::{Accepted, Judging, Unfit};
use super::kind::SceneKind;
use super::next_id::NextId;
use super::scene::{Condition, SceneOf};
use super::together::{Together, Waiting};
use super::upkeep::Upkeep;
use super::{Applied, Counting, Operations, Published, Seq, ServiceError, Submission, meters};
use crate::engine::Access;
use crate::engine::Counts;
use crate::geometry::Effect;
use crate::log::{KeyRecord, Log, LogError, Record, RecordedOutcome};

/// Upkeep that did not fit the disk is tried again after this many probe intervals.
const UPKEEP_PAUSE_PROBES: u32 = 60;

/// Owns what a running scene changes.
pub(super) struct Writer<K: SceneKind> {
    log: Log<K>,
    clock: Clock,
    /// Newest durable state; the engine, which is in the feed, is at it between two groups.
    published: Published<K>,
    next_id: NextId,
    feed: Arc<Feed<K>>,
    upkeep: Upkeep<K>,
    /// Whose commit has failed.
    pub(super) unanswered: Vec<Reply<K>>,
}

/// Why a scene does not run.
#[derive(Debug)]
pub(super) enum Halt {
    /// The log does not work; it may later.
    Log(LogError),
    /// The end was announced meanwhile.
    Ended,
}

impl From<LogError> for Halt {
    fn from(error: LogError) -> Self {
        Self::Log(error)
    }
}

/// What is told to a client once the commit is durable.
type Outcome<K> = Result<Applied<K>, ServiceError>;

/// What shares one commit.
struct Group<K: SceneKind> {
    /// Accepted and not yet applied.
    together: Together<K>,
    /// Of the changes before those that wait.
    outcomes: Vec<Outcome<K>>,
    records: Vec<Record<K>>,
    /// Net counts of the records.
    net: Vec<Counts>,
    keys: Vec<KeyRecord<K>>,
    /// Index in `keys`, by key.
    keyed: HashMap<Box<str>, usize>,
}

impl<K: SceneKind> Writer<K> {
    pub(super) fn new(
        log: Log<K>,
        published: &Published<K>,
        next_id: NextId,
        feed: Feed<K>,
    ) -> Self {
        Self {
            log,
            clock: Clock::default(),
            published: *published,
            next_id,
            feed: Arc::new(feed),
            upkeep: Upkeep::Rest(None),
            unanswered: Vec::new(),
        }
    }

    /// Newest durable state.
    pub(super) fn published(&self) -> &Published<K> {
        &self.published
    }

    /// Lets callers in: readers are answered at once, changes as soon as the thread runs.
    pub(super) fn begin(&self, scene: &SceneOf<K>) {
        scene.set_permille(1000);
        scene.pulse.begin(self.log.unmoved_pages());
        // The inbox first: who sees the scene running may change it at once. Nothing is taken from it before this returns.
        scene.inbox.open();
        scene.set_condition(Condition::Running(self.feed.clone()));
        scene.set_started();
    }

    /// Serves until the log fails or the end comes.
    pub(super) fn serve(&mut self, scene: &SceneOf<K>) -> Halt {
        let group_operations_max = scene.setup.config.group_operations_max;
        loop {
            let idle_work =
                self.log.wants_checkpoint() || self.upkeep.waits(&self.log, &self.feed.set);
            let Some(group) = scene.inbox.next_group(group_operations_max, idle_work) else {
                return Halt::Ended;
            };
            if let Err(error) = self.commit(scene, group).and_then(|()| self.keep_up(scene)) {
                return Halt::Log(error);
            }
        }
    }

    /// Judges, applies, logs, publishes and answers one group.
    fn commit(&mut self, scene: &SceneOf<K>, pending: Vec<Pending<K>>) -> Result<(), LogError> {
        if pending.is_empty() {
            return Ok(());
        }
        let start = Instant::now();
        let (submissions, replies): (Vec<_>, Vec<_>) = pending
            .into_iter()
            .map(|pending| (pending.submission, pending.reply))
            .unzip();
        match self.make_durable(scene, submissions, &replies) {
            Ok(group) => {
                if let Some(newest) = group.newest() {
                    let changes = group.records.len();
                    meters::committed(changes, start.elapsed(), self.log.commit_time());
                    let pages = self.log.unmoved_pages();
                    scene.pulse.committed(pages, self.log.wants_checkpoint());
                    group.net.iter().for_each(meters::changed);
                    self.published = newest;
                    let effects = group.records.iter().map(|record| &record.effect);
                    self.feed.publish(&newest, &effects);
                }
                for (reply, outcome) in replies.into_iter().zip(group.outcomes) {
                    reply.send(outcome);
                }
                Ok(())
            }
            Err(error) => {
                self.unanswered = replies;
                Err(error)
            }
        }
    }

    /// Applies what is accepted of a group and appends it with one sync.
    fn make_durable(
        &mut self,
        scene: &SceneOf<K>,
        submissions: Vec<Submission<K>>,
        replies: &[Reply<K>],
    ) -> Result<Group<K>, LogError> {
        let mut group = Group {
            together: Together::default(),
            outcomes: Vec::with_capacity(submissions.len()),
            records: Vec::new(),
            net: Vec::new(),
            keys: Vec::new(),
            keyed: HashMap::new(),
        };
        for (submission, reply) in submissions.into_iter().zip(replies) {
            let outcome = if reply.is_abandoned() {
                Some(Err(ServiceError::Abandoned))
            } else {
                self.judge(scene, &mut group, submission)?
            };
            if let Some(outcome) = outcome {
                reply.judged(&outcome);
                // Those before it come first.
                self.apply_together(&mut group);
                group.outcomes.push(outcome);
            }
        }
        self.apply_together(&mut group);
        if !group.is_empty() {
            let hook = scene.setup.fail_hook.as_ref();
            failpoint::pass(hook, FailPoint::Append)?;
            self.log.append(&group.records, &group.keys)?;
            failpoint::pass(hook, FailPoint::Appended)?;
        }
        Ok(group)
    }

    /// Judges a change, unless its key was met before, and applies it: the engine is then ahead of the log. None while it waits for
    /// others.
    fn judge(
        &mut self,
        scene: &SceneOf<K>,
        group: &mut Group<K>,
        submission: Submission<K>,
    ) -> Result<Option<Outcome<K>>, LogError> {
        let bodies_max = self.feed.set.look(K::together_max);
        let is_admitted = group.together.admits(&submission, bodies_max, self.next_id);
        if !is_admitted {
            self.apply_together(group);
        }
        let Submission {
            operations,
            counting,
            motion,
            key,
        } = submission;
        if let Operations::Define(definition) = operations {
            return match scene.setup.check_disk() {
                Ok(()) => self.define(&definition).map(Some),
                Err(refusal) => Ok(Some(Err(refusal))),
            };
        }
        if let Operations::DryRun(operations) = operations {
            return self.dry_run(scene, *operations, counting).map(Some);
        }
        if let Some((key, body)) = &key
            && let Some(earlier) = self.met_before(group, key)?
        {
            return Ok(Some(if earlier.body == *body {
                Ok(replayed(&earlier.answer))
            } else {
                Err(ServiceError::KeyReused)
            }));
        }
        if let Err(refusal) = scene.setup.check_disk() {
            return Ok(Some(Err(refusal)));
        }
        let newest = group.newest().unwrap_or(self.published).seq;
        let accepted = match self.accept(scene, newest, operations, counting)? {
            Ok(accepted) => accepted,
            Err(refusal) => return Ok(Some(Err(refusal))),
        };
        for (id, _) in &accepted.effect.inserted {
            self.next_id.pass(*id);
        }
        let change = Waiting {
            accepted,
            motion,
            key,
        };
        if is_admitted && !change.accepted.effect.inserted.is_empty() {
            group.together.join(change);
            return Ok(None);
        }
        self.apply_together(group);
        Ok(Some(Ok(self.apply(group, change))))
    }

    /// Applies the changes that wait.
    fn apply_together(&mut self, group: &mut Group<K>) {
        let mut changes = group.together.take();
        if changes.len() <= 1 {
            if let Some(change) = changes.pop() {
                let applied = self.apply(group, change);
                group.outcomes.push(Ok(applied));
            }
            return;
        }
        let bodies = changes
            .iter()
            .flat_map(|change| &change.accepted.effect.inserted);
        let after = self.feed.set.insert_each(bodies.cloned().collect());
        let mut after = after.into_iter();
        for change in changes {
            let last = change.accepted.effect.inserted.len() - 1;
            let totals = after.nth(last).expect("there are totals after each body");
            let applied = self.record(group, change, totals);
            group.outcomes.push(Ok(applied));
        }
    }

    /// Judges operations against the engine, which is at `newest`.
    fn accept(
        &self,
        scene: &SceneOf<K>,
        newest: Seq,
        operations: Operations<K>,
        counting: Counting,
    ) -> Result<Result<Accepted<K>, ServiceError>, LogError> {
        let accepted = self.feed.set.look(|engine| {
            let judging = Judging {
                engine,
                newest,
                past: &self.log,
                next_id: self.next_id,
                config: &scene.setup.config,
            };
            judging.judge(operations, counting)
        });
        match accepted {
            Ok(accepted) => Ok(Ok(accepted)),
            Err(Unfit::Refused(refusal)) => Ok(Err(refusal)),
            Err(Unfit::Unread(error)) => Err(error),
        }
    }

    /// Says what operations would do. It is a group of its own, so that the engine is at the durable state.
    fn dry_run(
        &self,
        scene: &SceneOf<K>,
        operations: Operations<K>,
        counting: Counting,
    ) -> Result<Outcome<K>, LogError> {
        let accepted = match self.accept(scene, self.published.seq, operations, counting)? {
            Ok(accepted) => accepted,
            Err(refusal) => return Ok(Err(refusal)),
        };
        let Accepted { effect, .. } = accepted;
        let set = &self.feed.set;
        let foreseen = set.look_durable(|engine| K::dry_run(engine, &effect));
        let totals = foreseen.unwrap_or_else(|| {
            // Readers see the durable state meanwhile.
            set.apply(&effect);
            let totals = set.look(K::totals);
            set.apply(&Effect {
                deleted: effect.inserted,
                inserted: effect.deleted,
            });
            set.advance(&self.published, || {});
            totals
        });
        Ok(Ok(Applied {
            published: Published {
                totals,
                ..self.published
            },
            counts: accepted.counts,
            assigned: accepted.assigned,
            volume_removed: K::removed(&totals) - K::removed(&self.published.totals),
            replayed: false,
        }))
    }

    /// Makes a definition durable and shows it. It is a group of its own, and takes no seq.
    fn define(&mut self, definition: &[u8]) -> Result<Outcome<K>, LogError> {
        let mut context = self.log.context().clone();
        let answer = Ok(Applied {
            published: self.published,
            counts: Counts::default(),
            assigned: None,
            volume_removed: 0,
            replayed: false,
        });
        if K::is_defined(&context, definition) {
            return Ok(answer);
        }
        if let Err(malformed) = K::define(&mut context, definition) {
            return Ok(Err(ServiceError::NotDefined {
                cause: malformed.to_string(),
            }));
        }
        self.log.define(definition)?;
        self.feed.context.store(Arc::new(context));
        Ok(answer)
    }

    /// What was answered to a key, in this group or before.
    fn met_before(&self, group: &Group<K>, key: &str) -> Result<Option<KeyRecord<K>>, LogError> {
        match group.keyed.get(key) {
            Some(&index) => Ok(Some(group.keys[index].clone())),
            None => self.log.key(key),
        }
    }

    fn apply(&self, group: &mut Group<K>, change: Waiting<K>) -> Applied<K> {
        if change.accepted.effect != Effect::default() {
            self.feed.set.apply(&change.accepted.effect);
        }
        self.record(group, change, self.feed.set.look(K::totals))
    }

    /// Records what a change, which is applied, has led to.
    fn record(&self, group: &mut Group<K>, change: Waiting<K>, totals: K::Totals) -> Applied<K> {
        let Waiting {
            accepted,
            motion,
            key,
        } = change;
        let mut published = group.newest().unwrap_or(self.published);
        let mut volume_removed = 0;
        if accepted.takes_seq(motion) {
            let before = K::removed(&published.totals);
            published = Published {
                seq: Seq(published.seq.0 + 1),
                at_ms: self.clock.now_ms(published.at_ms),
                totals,
            };
            volume_removed = K::removed(&published.totals) - before;
            group.net.push(accepted.net);
            group.records.push(Record {
                seq: published.seq,
                at_ms: published.at_ms,
                effect: accepted.effect,
                reverts_to: accepted.reverts_to,
                motion,
                volume_removed,
                totals: published.totals,
            });
        }
        let applied = Applied {
            published,
            counts: accepted.counts,
            assigned: accepted.assigned,
            volume_removed,
            replayed: false,
        };
        if let Some((key, body)) = key {
            group.keyed.insert(key.clone(), group.keys.len());
            group.keys.push(KeyRecord {
                key,
                body,
                answer: recorded(&applied),
            });
        }
        applied
    }

    /// One step of upkeep, if there is one to take.
    fn keep_up(&mut self, scene: &SceneOf<K>) -> Result<(), LogError> {
        let Self {
            log, feed, upkeep, ..
        } = self;
        if log.wants_checkpoint() {
            let start = Instant::now();
            let left = log
                .checkpoint()
                .inspect_err(|_| meters::checkpoint_failed())?;
            meters::checkpointed(start.elapsed());
            scene.pulse.checkpointed(left);
            return Ok(());
        }
        if !upkeep.waits(log, &feed.set) {
            return Ok(());
        }
        let step_cubes = scene.setup.config.snapshot_step_cubes;
        match upkeep.step(log, feed, &self.published, self.next_id, step_cubes) {
            // Changes may still fit where a snapshot does not; they will tell when they do not.
            Err(error @ LogError::Full { .. }) => {
                tracing::warn!(
                    scene = scene.name().as_str(),
                    "no snapshot for now: {error}"
                );
                let pause = scene.setup.config.probe_interval * UPKEEP_PAUSE_PROBES;
                *upkeep = Upkeep::Rest(Some(Instant::now() + pause));
                Ok(())
            }
            result => result,
        }
    }
}

impl<K: SceneKind> Group<K> {
    fn is_empty(&self) -> bool {
        self.records.is_empty() && self.keys.is_empty()
    }

    /// The state after the newest of its records.
    fn newest(&self) -> Option<Published<K>> {
        self.records.last().map(|record| Published {
            seq: record.seq,
            at_ms: record.at_ms,
            totals: record.totals,
        })
    }
}

fn recorded<K: SceneKind>(applied: &Applied<K>) -> RecordedOutcome<K> {
    RecordedOutcome {
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

fn replayed<K: SceneKind>(answer: &RecordedOutcome<K>) -> Applied<K> {
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
