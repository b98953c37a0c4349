//! Judging operations: what a sequence of them does to the set, before anything is changed.

use crate::geometry::{CUBES_MAX, CubeId, Effect, Place};

use super::prefetch::AHEAD;
use super::{Counts, Engine, Judged, Op, Rejected};

impl Engine {
    /// Judges operations in their order against the set, changing nothing. O(operations), and a sort of them unless their
    /// ids come in increasing order.
    /// # Errors
    /// [`Rejected`] names the first operation at fault.
    pub fn judge(&self, ops: &[Op]) -> Result<Judged, Rejected> {
        let (effect, in_order) = match first_of_id(ops) {
            None => self.judge_once_each(ops)?,
            Some(first) => self.judge_again(ops, &first)?,
        };
        let (inserted, deleted) = (effect.inserted.len() as u64, effect.deleted.len() as u64);
        let cubes = self.len() - deleted + inserted;
        if cubes > CUBES_MAX {
            return Err(Rejected::TooManyCubes { cubes });
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

    /// Judges operations of which no two name the same id.
    fn judge_once_each(&self, ops: &[Op]) -> Result<(Effect, Counts), Rejected> {
        let mut effect = Effect::default();
        let mut counts = Counts::default();
        for (index, op) in ops.iter().enumerate() {
            if let Some(ahead) = ops.get(index + AHEAD) {
                self.ids.prefetch(id_of(ahead));
            }
            let before = self.ids.get(id_of(op));
            match (*op, after(index, op, before, &mut counts)?) {
                (Op::Delete(id), None) => effect.deleted.extend(before.map(|place| (id, place))),
                (Op::Insert(id, place), Some(_)) if before.is_none() => {
                    effect.inserted.push((id, place));
                }
                _ => {}
            }
        }
        Ok((effect, counts))
    }

    /// Judges operations, given for each the first one that names the same id.
    fn judge_again(&self, ops: &[Op], first: &[usize]) -> Result<(Effect, Counts), Rejected> {
        /// An id that some operation names.
        struct Touched {
            id: CubeId,
            before: Option<Place>,
            now: Option<Place>,
        }
        let mut touched: Vec<Touched> = Vec::with_capacity(ops.len());
        // Where in `touched` the id of each operation is.
        let mut entries: Vec<usize> = Vec::with_capacity(ops.len());
        let mut counts = Counts::default();
        for (index, op) in ops.iter().enumerate() {
            if let Some(ahead) = ops.get(index + AHEAD) {
                self.ids.prefetch(id_of(ahead));
            }
            let entry = if let Some(entry) = entries.get(first[index]) {
                *entry
            } else {
                let id = id_of(op);
                let before = self.ids.get(id);
                let now = before;
                touched.push(Touched { id, before, now });
                touched.len() - 1
            };
            entries.push(entry);
            let now = &mut touched[entry].now;
            *now = after(index, op, *now, &mut counts)?;
        }
        let mut effect = Effect::default();
        for Touched { id, before, now } in touched {
            if before != now {
                effect.deleted.extend(before.map(|place| (id, place)));
                effect.inserted.extend(now.map(|place| (id, place)));
            }
        }
        Ok((effect, counts))
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
