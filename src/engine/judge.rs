//! Judging operations: what a sequence of them does to the set, before anything is changed.

use crate::geometry::{CubeId, Effect, Place};

use super::prefetch::AHEAD;
use super::{Counts, Engine, Judged, Op, Rejected};

/// What operations do to one cube.
struct Touched {
    id: CubeId,
    before: Option<Place>,
    now: Option<Place>,
}

impl Engine {
    /// Judges operations in their order against the set, changing nothing; it may come to `cubes_max` cubes. O(operations), and a
    /// sort of them unless their ids come in increasing order.
    /// # Errors
    /// [`Rejected`] names the first operation at fault.
    pub fn judge(&self, ops: &[Op], cubes_max: u64) -> Result<Judged, Rejected> {
        let first = first_of_id(ops);
        let mut touched: Vec<Touched> = Vec::with_capacity(ops.len());
        // Where in `touched` the id of each operation is; not kept where every operation names another.
        let mut entries: Vec<usize> = Vec::with_capacity(first.as_ref().map_or(0, Vec::len));
        let mut in_order = Counts::default();
        for (index, op) in ops.iter().enumerate() {
            if let Some(ahead) = ops.get(index + AHEAD) {
                self.ids.prefetch(id_of(ahead));
            }
            let known = first
                .as_ref()
                .and_then(|first| entries.get(first[index]).copied());
            let entry = known.unwrap_or(touched.len());
            if known.is_none() {
                let id = id_of(op);
                let before = self.ids.get(id);
                let now = before;
                touched.push(Touched { id, before, now });
            }
            if first.is_some() {
                entries.push(entry);
            }
            let now = &mut touched[entry].now;
            *now = after(index, op, *now, &mut in_order)?;
        }
        let mut effect = Effect::default();
        for Touched { id, before, now } in touched {
            if before != now {
                effect.deleted.extend(before.map(|place| (id, place)));
                effect.inserted.extend(now.map(|place| (id, place)));
            }
        }
        let (inserted, deleted) = (effect.inserted.len() as u64, effect.deleted.len() as u64);
        let cubes = self.len() - deleted + inserted;
        if cubes > cubes_max {
            return Err(Rejected::TooManyCubes { cubes, cubes_max });
        }
        let unchanged = ops.len() as u64 - inserted - deleted;
        let net = Counts {
            inserted,
            deleted,
            unchanged,
        };
        Ok(Judged {
            effect,
            in_order,
            net,
        })
    }
}

/// Where the cube that an operation names is after it, given where it is before it.
fn after(
    index: usize,
    op: &Op,
    before: Option<Place>,
    counts: &mut Counts,
) -> Result<Option<Place>, Rejected> {
    match (*op, before) {
        (Op::Delete(_), None) => counts.unchanged += 1,
        (Op::Delete(_), Some(_)) => {
            counts.deleted += 1;
            return Ok(None);
        }
        (Op::Insert(_, place), None) => {
            counts.inserted += 1;
            return Ok(Some(place));
        }
        (Op::Insert(_, asked), Some(there)) if there == asked => counts.unchanged += 1,
        (Op::Insert(id, asked), Some(there)) => {
            return Err(Rejected::IdConflict {
                index,
                id,
                there,
                asked,
            });
        }
    }
    Ok(before)
}

fn id_of(op: &Op) -> CubeId {
    let (Op::Delete(id) | Op::Insert(id, _)) = *op;
    id
}

/// For each operation the first one that names the same id; none when no id is named twice.
///
/// Sorted rather than hashed: nobody can choose ids that make it slow.
fn first_of_id(ops: &[Op]) -> Option<Vec<usize>> {
    if ops.is_sorted_by(|one, next| id_of(one) < id_of(next)) {
        return None;
    }
    let mut order: Vec<(CubeId, usize)> = ops.iter().map(id_of).zip(0..).collect();
    order.sort_unstable();
    if order.is_sorted_by(|(one, _), (next, _)| one < next) {
        return None;
    }
    let mut first = vec![0; ops.len()];
    for same in order.chunk_by(|(one, _), (next, _)| one == next) {
        for (_, index) in same {
            first[*index] = same[0].1;
        }
    }
    Some(first)
}
