//! Judging a change: what it does to the set of bodies, or why it is refused. Nothing changes here.

use super::kind::SceneKind;
use super::next_id::{IdRange, NextId};
use super::revert::{self, Past};
use super::{
    CHANGE_OPERATIONS_MAX, Counting, Operations, Seq, ServiceConfig, ServiceError, meters,
};
use crate::engine::{Counts, Op};
use crate::geometry::{CubeId, Effect};
use crate::log::{LogError, Motion};

/// What a change is judged against: the state after all that was accepted before it.
pub(super) struct Judging<'a, K: SceneKind, P> {
    pub(super) engine: &'a K::Engine,
    /// Seq of the engine. For a revert, of the past too.
    pub(super) newest: Seq,
    pub(super) past: &'a P,
    pub(super) next_id: NextId,
    pub(super) config: &'a ServiceConfig,
}

/// A change that can be applied.
pub(super) struct Accepted<K: SceneKind> {
    pub(super) effect: Effect<K::Body>,
    /// What its operations did, counted as its client wants it.
    pub(super) counts: Counts,
    /// The same by net effect.
    pub(super) net: Counts,
    /// Ids that the server gave: used up only when the change is applied.
    pub(super) assigned: Option<IdRange>,
    /// The seq whose bodies it brings back.
    pub(super) reverts_to: Option<Seq>,
}

impl<K: SceneKind> Accepted<K> {
    /// Whether it takes a seq. A move that cuts nothing is a change too; but operations sent again that are done already are none.
    pub(super) fn takes_seq(&self, motion: Motion) -> bool {
        let is_move = motion.is_said() && self.net.unchanged == 0;
        self.effect != Effect::default() || is_move
    }
}

/// Why a change is not applied.
pub(super) enum Unfit {
    /// It is refused: its client is told.
    Refused(ServiceError),
    /// The log could not be read: the scene stops.
    Unread(LogError),
}

impl<E: Into<ServiceError>> From<E> for Unfit {
    fn from(refusal: E) -> Self {
        Self::Refused(refusal.into())
    }
}

impl<K: SceneKind, P: Past<K>> Judging<'_, K, P> {
    /// Judges a change. O(operations); a revert, O(operations that tell its state and the newest one apart).
    pub(super) fn judge(
        &self,
        operations: Operations<K>,
        counting: Counting,
    ) -> Result<Accepted<K>, Unfit> {
        let (ops, assigned) = match operations {
            Operations::Named(ops) => (ops, None),
            Operations::Numbered { delete, insert } => {
                let wanted = insert.len() as u64;
                let is_taken = |id| K::get(self.engine, id).is_some();
                let assigned = (wanted > 0).then(|| self.next_id.range(wanted, is_taken));
                let ids = assigned.map_or(0..=0, |(first, last)| first.0..=last.0);
                let insert = ids
                    .zip(insert)
                    .map(|(id, body)| Op::Insert(CubeId(id), body));
                let delete = delete.into_iter().map(Op::Delete);
                (delete.chain(insert).collect(), assigned)
            }
            Operations::Revert(to) => {
                let (newest, oldest) = (self.newest, self.past.oldest_reachable());
                if to > newest {
                    return Err(ServiceError::SeqNotReached { seq: to, newest }.into());
                }
                if to < oldest {
                    return Err(ServiceError::NotReachable { seq: to, oldest }.into());
                }
                let effect = revert::effect(self.engine, self.past, to).map_err(Unfit::Unread)?;
                weigh::<K>(&effect)?;
                let net = Counts {
                    inserted: effect.inserted.len() as u64,
                    deleted: effect.deleted.len() as u64,
                    unchanged: 0,
                };
                return Ok(Accepted {
                    effect,
                    counts: net,
                    net,
                    assigned: None,
                    reverts_to: Some(to),
                });
            }
            Operations::Define(_) | Operations::DryRun(_) => {
                unreachable!("neither is a change of the set of bodies")
            }
        };
        let judged = K::judge(self.engine, &ops, self.config);
        let judged = judged.inspect_err(|_| meters::refused())?;
        weigh::<K>(&judged.effect)?;
        Ok(Accepted {
            effect: judged.effect,
            counts: match counting {
                Counting::Net => judged.net,
                Counting::InOrder => judged.in_order,
            },
            net: judged.net,
            assigned,
            reverts_to: None,
        })
    }
}

/// Refuses what one record does not hold.
fn weigh<K: SceneKind>(effect: &Effect<K::Body>) -> Result<(), ServiceError> {
    let bodies = effect.deleted.iter().chain(&effect.inserted);
    let operations = bodies.map(|(_, body)| K::weight(body)).sum();
    if operations > CHANGE_OPERATIONS_MAX {
        return Err(ServiceError::TooManyOperations { operations });
    }
    Ok(())
}
