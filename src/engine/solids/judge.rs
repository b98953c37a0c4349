//! Judging operations: what a sequence of them does to the set, before anything is changed.

use std::collections::HashMap;

use super::super::Counts;
use super::{Body, Effect, Engine, SOLIDS_MAX, SolidId};

/// One operation on a scene's set of bodies.
pub type Op = crate::engine::Op<Body>;

/// The judgement of a sequence of operations that can be applied.
pub type Judged = crate::engine::Judged<Body>;

/// Why a sequence of operations is refused as a whole.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
pub enum Rejected {
    /// An inserted id has another body already.
    #[error("solid {} is already another body, so it cannot be inserted (operation {index})", id.0)]
    IdConflict {
        /// Which operation, from 0.
        index: usize,
        /// The id.
        id: SolidId,
    },
    /// The scene would hold too many bodies.
    #[error("the scene would hold {solids} solids; the most is {SOLIDS_MAX}")]
    TooManySolids {
        /// How many it would hold.
        solids: u64,
    },
}

/// An id that some operation names.
struct Touched<'a> {
    id: SolidId,
    before: Option<&'a Body>,
    now: Option<&'a Body>,
}

impl Engine {
    /// Judges operations in their order against the set, changing nothing. O(operations log bodies).
    /// # Errors
    /// [`Rejected`] names the first operation at fault.
    pub fn judge(&self, ops: &[Op]) -> Result<Judged, Rejected> {
        let mut touched: Vec<Touched> = Vec::with_capacity(ops.len());
        let mut entries: HashMap<SolidId, usize> = HashMap::with_capacity(ops.len());
        let mut in_order = Counts::default();
        for (index, op) in ops.iter().enumerate() {
            let (Op::Delete(id) | Op::Insert(id, _)) = op;
            let entry = *entries.entry(*id).or_insert_with(|| {
                let before = self.get(*id);
                touched.push(Touched {
                    id: *id,
                    before,
                    now: before,
                });
                touched.len() - 1
            });
            let now = &mut touched[entry].now;
            match (op, *now) {
                (Op::Delete(_), None) => in_order.unchanged += 1,
                (Op::Delete(_), Some(_)) => {
                    in_order.deleted += 1;
                    *now = None;
                }
                (Op::Insert(_, body), None) => {
                    in_order.inserted += 1;
                    *now = Some(body);
                }
                (Op::Insert(_, body), Some(there)) if body == there => in_order.unchanged += 1,
                (Op::Insert(id, _), Some(_)) => {
                    return Err(Rejected::IdConflict { index, id: *id });
                }
            }
        }
        let mut effect = Effect::default();
        for Touched { id, before, now } in touched {
            if before != now {
                effect.deleted.extend(before.map(|body| (id, body.clone())));
                effect.inserted.extend(now.map(|body| (id, body.clone())));
            }
        }
        let (inserted, deleted) = (effect.inserted.len() as u64, effect.deleted.len() as u64);
        let solids = self.len() - deleted + inserted;
        if solids > SOLIDS_MAX {
            return Err(Rejected::TooManySolids { solids });
        }
        let net = Counts {
            inserted,
            deleted,
            unchanged: ops.len() as u64 - inserted - deleted,
        };
        Ok(Judged {
            effect,
            in_order,
            net,
        })
    }
}
