//! Cubes by where they are: those of a few changes, for the question which of them hold a point.
//!
//! ```text
//!   newest in a cell ──> cube ──> cube before it in the same chain ──> ...
//! ```

use std::collections::{BTreeSet, HashMap};

use crate::geometry::{CubeId, Edge, Place};

/// Cubes in cells. A cell is an edge and a step wide, so the cubes that hold a point have their lower corners in two cells an axis.
#[derive(Debug, Default)]
pub struct Places {
    /// Number of the newest cube in a cell.
    newest: HashMap<Cell, usize>,
    cubes: Vec<Placed>,
}

#[derive(Debug)]
struct Placed {
    id: CubeId,
    place: Place,
    /// Number of the one before in the same cell.
    before: Option<usize>,
}

type Cell = [i32; 3];

impl Places {
    /// Forgets all; keeps the room unless it is far more than was needed.
    pub(super) fn clear(&mut self) {
        if self.cubes.len() * 4 < self.cubes.capacity() {
            *self = Self::default();
        } else {
            self.newest.clear();
            self.cubes.clear();
        }
    }

    pub(super) fn insert(&mut self, id: CubeId, place: Place, edge: Edge) {
        let before = self
            .newest
            .insert(cell(place.corner(), edge), self.cubes.len());
        self.cubes.push(Placed { id, place, before });
    }

    /// The cubes that hold a point (closed cubes). O(cubes around the point).
    pub(super) fn holding(
        &self,
        point: [i32; 3],
        edge: Edge,
    ) -> impl Iterator<Item = (CubeId, Place)> + '_ {
        let low = cell(point.map(|part| part.saturating_sub(edge.steps())), edge);
        let high = cell(point, edge);
        // Where both ends of an axis lie in one cell, each cell once.
        let cells: BTreeSet<Cell> = (0..8_u8)
            .map(|corner| {
                let end = |axis: usize| if corner >> axis & 1 == 0 { low } else { high }[axis];
                [end(0), end(1), end(2)]
            })
            .collect();
        let newest = cells.into_iter().filter_map(|one| self.newest.get(&one));
        let in_cells = newest.flat_map(|newest| {
            std::iter::successors(Some(&self.cubes[*newest]), |placed| {
                placed.before.map(|before| &self.cubes[before])
            })
        });
        in_cells
            .filter(move |placed| holds(placed.place, point, edge))
            .map(|placed| (placed.id, placed.place))
    }
}

fn cell(corner: [i32; 3], edge: Edge) -> Cell {
    corner.map(|part| part.div_euclid(edge.steps() + 1))
}

/// Whether the closed cube at `place` holds a point, which may be anywhere.
fn holds(place: Place, point: [i32; 3], edge: Edge) -> bool {
    let sides = place.corner().into_iter().zip(point);
    sides.fold(true, |holds, (low, at)| {
        holds & (0..=i64::from(edge.steps())).contains(&(i64::from(at) - i64::from(low)))
    })
}
