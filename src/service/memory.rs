//! A scene in the memory of the program that holds it: judged, counted and gone back as one of a service, but nothing is kept.
//!
//! There is no log and no other thread, so that a large change takes no longer than it takes the engine. The newest changes are kept
//! in memory with what they did, for the history and for going back; older ones are forgotten.

use std::collections::VecDeque;

use super::clock::now_ms;
use super::judge::{Accepted, Judging, Unfit};
use super::kind::SceneKind;
use super::next_id::NextId;
use super::revert::Past;
use super::{
    Applied, Audit, Counting, HistoryRow, Motion, Operations, Published, Seq, ServiceConfig,
    ServiceError, Solids, Submission,
};
use crate::engine::{Counts, Side, solids};
use crate::geometry::convex::Point;
use crate::geometry::{CubeId, Edge, Effect, Place, Stock};
use crate::log::{Cubes, Header, Kind, LogError, Step};

/// A scene in memory.
#[derive(Debug)]
pub struct MemoryScene<K: SceneKind> {
    header: Header<K>,
    context: K::Context,
    engine: Engine<K>,
    /// Newest state.
    published: Published<K>,
    next_id: NextId,
    past: Kept<K>,
    /// For its limits alone.
    config: ServiceConfig,
}

/// An engine, which need not be shown.
struct Engine<K: SceneKind>(K::Engine);

impl<K: SceneKind> std::fmt::Debug for Engine<K> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("Engine")
    }
}

/// The newest changes.
#[derive(Debug)]
struct Kept<K: Kind> {
    /// Consecutive, oldest first, each with what it did.
    changes: VecDeque<(HistoryRow<K>, Effect<K::Body>)>,
    changes_max: usize,
    /// The state before the oldest of them.
    before: Published<K>,
}

impl<K: SceneKind> Past<K> for Kept<K> {
    fn oldest_reachable(&self) -> Seq {
        self.before.seq
    }

    fn way_to(&self, to: Seq, visit: &mut dyn FnMut(Step<'_, K>)) -> Result<(), LogError> {
        let newer = self.changes.iter().rev();
        for (_, effect) in newer.take_while(|(row, _)| row.seq > to) {
            visit(Step::Undo(effect));
        }
        Ok(())
    }
}

impl<K: Kind> Kept<K> {
    fn push(&mut self, row: HistoryRow<K>, effect: Effect<K::Body>) {
        self.changes.push_back((row, effect));
        if self.changes.len() > self.changes_max
            && let Some((oldest, _)) = self.changes.pop_front()
        {
            self.before = state_after(&oldest);
        }
    }
}

fn state_after<K: Kind>(row: &HistoryRow<K>) -> Published<K> {
    Published {
        seq: row.seq,
        at_ms: row.at_ms,
        totals: row.totals,
    }
}

impl MemoryScene<Cubes> {
    /// A scene of cubes without any. Of its newest `changes_max` changes the history is known, and they can be gone back.
    pub fn of_cubes(edge: Edge, stock: Option<Stock>, changes_max: usize) -> Self {
        Self::new(edge.steps().cast_unsigned(), stock, changes_max)
            .expect("an edge is all that a scene of cubes needs")
    }

    /// Where a point lies, and the cube of least id that holds it (closed cubes).
    pub fn contains(&self, point: [i32; 3]) -> (Side, Option<(CubeId, Place)>) {
        self.engine.0.contains(point)
    }
}

impl MemoryScene<Solids> {
    /// A scene of solids without any and without shapes. Of its newest `changes_max` changes the history is known, and they can be
    /// gone back.
    pub fn of_solids(stock: Option<solids::Stock>, changes_max: usize) -> Self {
        Self::new(0, stock, changes_max).expect("a scene of solids needs nothing")
    }

    /// Where a point lies in the union of the solids, cut to the stock where there is one, and the solid of least id that holds it there
    /// (closed solids).
    pub fn contains(&self, point: Point) -> (Side, Option<(CubeId, solids::Body)>) {
        let (side, holder) = self.engine.0.contains(point);
        let body = |id| Some((id, self.body(id)?));
        (side, holder.and_then(body))
    }
}

impl<K: SceneKind> MemoryScene<K> {
    fn new(edge_steps: u32, stock: Option<K::Stock>, changes_max: usize) -> Result<Self, String> {
        let header = Header {
            incarnation: 0,
            edge_steps,
            stock,
            settings: String::new(),
        };
        let engine = K::engine(&header)?;
        let published = Published {
            seq: Seq(0),
            at_ms: now_ms(),
            totals: K::totals(&engine),
        };
        Ok(Self {
            context: K::context(&header)?,
            header,
            engine: Engine(engine),
            published,
            next_id: NextId::FIRST,
            past: Kept {
                changes: VecDeque::new(),
                changes_max,
                before: published,
            },
            config: ServiceConfig::new(""),
        })
    }

    /// Newest state.
    pub fn published(&self) -> Published<K> {
        self.published
    }

    /// What its bodies stand on.
    pub fn context(&self) -> &K::Context {
        &self.context
    }

    /// Applies a change, whole or not at all. Its key is not looked at: no answer can be lost on the way.
    /// # Errors
    /// Those of [`super::Scene::change`] that the change itself gives cause for.
    pub fn change(&mut self, submission: Submission<K>) -> Result<Applied<K>, ServiceError> {
        let Submission {
            operations,
            counting,
            motion,
            key: _,
        } = submission;
        match operations {
            Operations::Define(definition) => self.define(&definition),
            Operations::DryRun(operations) => self.dry_run(*operations, counting),
            operations => {
                let accepted = self.accept(operations, counting)?;
                Ok(self.apply(accepted, motion))
            }
        }
    }

    fn accept(
        &self,
        operations: Operations<K>,
        counting: Counting,
    ) -> Result<Accepted<K>, ServiceError> {
        let judging = Judging {
            engine: &self.engine.0,
            newest: self.published.seq,
            past: &self.past,
            next_id: self.next_id,
            config: &self.config,
        };
        judging
            .judge(operations, counting)
            .map_err(|unfit| match unfit {
                Unfit::Refused(refusal) => refusal,
                Unfit::Unread(_) => unreachable!("memory can be read"),
            })
    }

    fn apply(&mut self, accepted: Accepted<K>, motion: Motion) -> Applied<K> {
        for (id, _) in &accepted.effect.inserted {
            self.next_id.pass(*id);
        }
        let mut volume_removed = 0;
        if accepted.takes_seq(motion) {
            self.take(&accepted.effect);
            let before = self.published;
            let totals = K::totals(&self.engine.0);
            volume_removed = K::removed(&totals) - K::removed(&before.totals);
            let row = HistoryRow {
                seq: Seq(before.seq.0 + 1),
                at_ms: now_ms().max(before.at_ms),
                inserted: accepted.net.inserted,
                deleted: accepted.net.deleted,
                motion,
                volume_removed,
                totals,
            };
            self.published = state_after(&row);
            self.past.push(row, accepted.effect);
        }
        Applied {
            published: self.published,
            counts: accepted.counts,
            assigned: accepted.assigned,
            volume_removed,
            replayed: false,
        }
    }

    fn take(&mut self, effect: &Effect<K::Body>) {
        let applied = K::apply(&mut self.engine.0, effect);
        assert!(applied, "an effect fits the set that it was judged against");
    }

    fn dry_run(
        &mut self,
        operations: Operations<K>,
        counting: Counting,
    ) -> Result<Applied<K>, ServiceError> {
        let accepted = self.accept(operations, counting)?;
        let foreseen = K::dry_run(&self.engine.0, &accepted.effect);
        let totals = foreseen.unwrap_or_else(|| {
            self.take(&accepted.effect);
            let totals = K::totals(&self.engine.0);
            self.take(&Effect {
                deleted: accepted.effect.inserted,
                inserted: accepted.effect.deleted,
            });
            totals
        });
        Ok(Applied {
            published: Published {
                totals,
                ..self.published
            },
            counts: accepted.counts,
            assigned: accepted.assigned,
            volume_removed: K::removed(&totals) - K::removed(&self.published.totals),
            replayed: false,
        })
    }

    fn define(&mut self, definition: &[u8]) -> Result<Applied<K>, ServiceError> {
        if !K::is_defined(&self.context, definition) {
            let mut context = self.context.clone();
            K::define(&mut context, definition).map_err(|malformed| ServiceError::NotDefined {
                cause: malformed.to_string(),
            })?;
            self.context = context;
        }
        Ok(Applied {
            published: self.published,
            counts: Counts::default(),
            assigned: None,
            volume_removed: 0,
            replayed: false,
        })
    }

    /// A past state.
    /// # Errors
    /// [`ServiceError::SeqNotReached`] beyond the newest, [`ServiceError::SeqNotKept`] before the oldest.
    pub fn at(&self, seq: Seq) -> Result<Published<K>, ServiceError> {
        let (newest, before) = (self.published, self.past.before);
        if seq > newest.seq {
            return Err(ServiceError::SeqNotReached {
                seq,
                newest: newest.seq,
            });
        }
        if seq == before.seq {
            return Ok(before);
        }
        let index = seq.0.checked_sub(before.seq.0 + 1);
        let kept = index.and_then(|index| self.past.changes.get(usize::try_from(index).ok()?));
        let row = kept.map(|(row, _)| row);
        row.map(state_after).ok_or(ServiceError::SeqNotKept {
            seq,
            oldest: before.seq,
        })
    }

    /// The changes that are kept, oldest first.
    pub fn history(&self) -> impl DoubleEndedIterator<Item = &HistoryRow<K>> {
        self.past.changes.iter().map(|(row, _)| row)
    }

    /// The body of an id.
    pub fn body(&self, id: CubeId) -> Option<K::Body> {
        K::get(&self.engine.0, id)
    }

    /// All bodies, in the order of the listing, which is fixed by the ids alone.
    pub fn bodies(&self) -> impl Iterator<Item = (CubeId, K::Body)> {
        K::bodies_after(&self.engine.0, None)
    }

    /// Recounts everything from the bodies alone, and compares.
    pub fn audit(&self) -> Audit<K> {
        let bodies = self.bodies().map(|(_, body)| body).collect();
        let recounted = K::recount(&self.header, bodies, &|| true);
        Audit {
            seq: self.published.seq,
            kept: self.published.totals,
            recounted: recounted.expect("nobody breaks it off"),
        }
    }
}
