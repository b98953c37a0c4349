//! The exact online engine (skeleton: the signatures other modules build on).
use crate::geometry::{CubeId, Edge, Effect, Place, Totals};

/// One operation on a scene's set of cubes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Op {
    /// Delete the cube of this id; nothing happens when there is none.
    Delete(CubeId),
    /// Insert a cube; nothing happens when this id is at this place already.
    Insert(CubeId, Place),
}

/// How many operations did what.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Counts {
    /// Operations that inserted a cube.
    pub inserted: u64,
    /// Operations that deleted a cube.
    pub deleted: u64,
    /// Operations that changed nothing.
    pub unchanged: u64,
}

/// The judgement of a sequence of operations that can be applied.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Judged {
    /// What to apply.
    pub effect: Effect,
    /// Counts of the operations one after the other, as a stream reports them.
    pub in_order: Counts,
    /// Counts by net effect, as an atomic change reports them.
    pub net: Counts,
}

/// Why a sequence of operations is refused as a whole.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
pub enum Rejected {
    /// An inserted id is already at another place.
    #[error("cube {} is already at {:?}, so it cannot be inserted at {:?} (operation {index})", id.0, there.corner(), asked.corner())]
    IdConflict {
        /// Which operation, from 0.
        index: usize,
        /// The id.
        id: CubeId,
        /// Where the cube is.
        there: Place,
        /// Where it was to be inserted.
        asked: Place,
    },
    /// The scene would hold more than 2^31 cubes.
    #[error(
        "the scene would hold {cubes} cubes; the most is {}",
        crate::geometry::CUBES_MAX
    )]
    TooManyCubes {
        /// How many it would hold.
        cubes: u64,
    },
}

/// An effect does not fit the set it is applied to: an inserted id is present, or a deleted one absent or elsewhere.
/// Happens only in the replay of a damaged log.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("the effect on cube {} does not fit the set of cubes", id.0)]
pub struct Inconsistent {
    /// The first cube at fault.
    pub id: CubeId,
}

/// Where a point lies.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Side {
    /// In the interior of the union.
    Inside,
    /// On its (regularised) boundary.
    Boundary,
    /// Outside.
    Outside,
}

/// Position in the listing of a scene's cubes; the order is fixed by the ids alone, whatever the history.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Cursor(pub u64);

/// A persistent set of identical cubes whose totals are always current.
#[derive(Debug)]
pub struct Engine {
    edge: Edge,
    cubes: std::collections::BTreeMap<CubeId, Place>,
    totals: Totals,
}

impl Engine {
    /// An empty scene of cubes of `edge`.
    pub fn new(edge: Edge) -> Self {
        Self {
            edge,
            cubes: Default::default(),
            totals: Totals::default(),
        }
    }
    /// The edge of every cube.
    pub fn edge(&self) -> Edge {
        self.edge
    }
    /// Current totals. O(1).
    pub fn totals(&self) -> Totals {
        self.totals
    }
    /// Number of cubes. O(1).
    pub fn len(&self) -> u64 {
        self.cubes.len() as u64
    }
    /// Whether there is no cube.
    pub fn is_empty(&self) -> bool {
        self.cubes.is_empty()
    }
    /// Judges operations in their order against the set, changing nothing.
    /// # Errors
    /// [`Rejected`] names the first operation at fault.
    pub fn judge(&self, ops: &[Op]) -> Result<Judged, Rejected> {
        let mut overlay: std::collections::BTreeMap<CubeId, Option<Place>> = Default::default();
        let mut order = vec![];
        let mut in_order = Counts::default();
        for (index, op) in ops.iter().enumerate() {
            let id = match *op {
                Op::Delete(id) | Op::Insert(id, _) => id,
            };
            let now = *overlay.entry(id).or_insert_with(|| {
                order.push(id);
                self.cubes.get(&id).copied()
            });
            match (*op, now) {
                (Op::Delete(_), None) => in_order.unchanged += 1,
                (Op::Delete(_), Some(_)) => {
                    overlay.insert(id, None);
                    in_order.deleted += 1
                }
                (Op::Insert(_, place), None) => {
                    overlay.insert(id, Some(place));
                    in_order.inserted += 1
                }
                (Op::Insert(_, asked), Some(there)) if there == asked => in_order.unchanged += 1,
                (Op::Insert(_, asked), Some(there)) => {
                    return Err(Rejected::IdConflict {
                        index,
                        id,
                        there,
                        asked,
                    });
                }
            }
        }
        let mut effect = Effect::default();
        for id in order {
            let (before, after) = (self.cubes.get(&id).copied(), overlay[&id]);
            if before != after {
                if let Some(place) = before {
                    effect.deleted.push((id, place));
                }
                if let Some(place) = after {
                    effect.inserted.push((id, place));
                }
            }
        }
        let net = Counts {
            inserted: effect.inserted.len() as u64,
            deleted: effect.deleted.len() as u64,
            unchanged: (ops.len() - effect.inserted.len() - effect.deleted.len()) as u64,
        };
        Ok(Judged {
            effect,
            in_order,
            net,
        })
    }
    /// Applies an effect, whole or not at all: deletions first. The only door through which state changes.
    /// # Errors
    /// [`Inconsistent`] when the effect does not fit; then nothing has changed.
    pub fn apply(&mut self, effect: &Effect) -> Result<(), Inconsistent> {
        for (id, _) in &effect.deleted {
            self.cubes.remove(id);
        }
        for (id, place) in &effect.inserted {
            self.cubes.insert(*id, *place);
        }
        // STUB: volume is wrong under overlap until the real engine lands.
        self.totals.cubes = self.len();
        self.totals.measures.volume = i128::from(self.len()) * i128::from(self.edge.steps()).pow(3);
        Ok(())
    }
    /// Where the cube of this id is.
    pub fn get(&self, id: CubeId) -> Option<Place> {
        self.cubes.get(&id).copied()
    }
    /// Up to `limit` cubes after the cursor (from the beginning without one), and the cursor of the last when more follow.
    /// A cube that is there during the whole listing is listed exactly once, whatever changes meanwhile.
    pub fn page(
        &self,
        after: Option<Cursor>,
        limit: usize,
    ) -> (Vec<(CubeId, Place)>, Option<Cursor>) {
        let mut rows: Vec<_> = self
            .cubes
            .iter()
            .filter(|(id, _)| after.is_none_or(|c| id.0 > c.0))
            .take(limit + 1)
            .map(|(a, b)| (*a, *b))
            .collect();
        let more = rows.len() > limit;
        rows.truncate(limit);
        let cursor = if more {
            rows.last().map(|(id, _)| Cursor(id.0))
        } else {
            None
        };
        (rows, cursor)
    }
    /// All cubes with their ids, in the order of the listing. O(cubes).
    pub fn cubes(&self) -> impl Iterator<Item = (CubeId, Place)> + '_ {
        self.cubes.iter().map(|(a, b)| (*a, *b))
    }
    /// Where a lattice point lies, and a cube that holds it (closed cubes).
    pub fn contains(&self, point: [i32; 3]) -> (Side, Option<(CubeId, Place)>) {
        let _ = point;
        (Side::Outside, None)
    }
}

/// Recounts the totals from the places of the cubes alone, sharing no state with any engine. O(cubes).
pub fn recount(edge: Edge, cubes: impl Iterator<Item = Place>) -> Totals {
    let mut engine = Engine::new(edge);
    for (index, place) in cubes.enumerate() {
        let _ = engine.apply(&Effect {
            deleted: vec![],
            inserted: vec![(CubeId(index as u64), place)],
        });
    }
    engine.totals()
}
