//! Cubes by where they are: those of a few changes, for the question which of them hold a point.
//!
//! ```text
//!   cubes    all, in the order in which they came: all that the writer does
//!   newest in a cell ──> cube ──> cube before it in the same cell ──> ...   made when somebody asks, of those that came since
//! ```

use std::collections::BTreeSet;

use parking_lot::Mutex;
use rustc_hash::FxHashMap;

use crate::geometry::{CubeId, Edge, Place};

/// Cubes in cells. A cell is an edge and a step wide, so the cubes that hold a point have their lower corners in two cells an axis.
#[derive(Debug, Default)]
pub struct Places {
    cubes: Vec<(CubeId, Place)>,
    cells: Mutex<Cells>,
}

/// Which of the cubes are in a cell, as far as they are looked at. Few ask, so the writer is spared it.
#[derive(Debug, Default)]
struct Cells {
    /// Number of the newest cube in a cell.
    newest: FxHashMap<Cell, usize>,
    /// Of every cube that was looked at, the number of the one before it in the same cell.
    before: Vec<Option<usize>>,
}

type Cell = [i32; 3];

impl Places {
    /// Forgets all; keeps the room unless it is far more than was needed.
    pub(super) fn clear(&mut self) {
        if self.cubes.len() * 4 < self.cubes.capacity() {
            *self = Self::default();
        } else {
            self.cubes.clear();
            let cells = self.cells.get_mut();
            cells.newest.clear();
            cells.before.clear();
        }
    }

    pub(super) fn insert(&mut self, id: CubeId, place: Place) {
        self.cubes.push((id, place));
    }

    /// The cubes that hold a point (closed cubes). O(cubes around the point, and cubes that came since somebody asked).
    pub(super) fn holding(&self, point: [i32; 3], edge: Edge) -> Vec<(CubeId, Place)> {
        let mut cells = self.cells.lock();
        cells.follow(&self.cubes, edge);
        let low = cell(point.map(|part| part.saturating_sub(edge.steps())), edge);
        let high = cell(point, edge);
        // Where both ends of an axis lie in one cell, each cell once.
        let around: BTreeSet<Cell> = (0..8_u8)
            .map(|corner| {
                let end = |axis: usize| if corner >> axis & 1 == 0 { low } else { high }[axis];
                [end(0), end(1), end(2)]
            })
            .collect();
        let newest = around.iter().filter_map(|one| cells.newest.get(one));
        let numbers = newest.flat_map(|&newest| {
            std::iter::successors(Some(newest), |&number| cells.before[number])
        });
        numbers
            .map(|number| self.cubes[number])
            .filter(|(_, place)| holds(*place, point, edge))
            .collect()
    }
}

impl Cells {
    /// Looks at the cubes that came since the last time.
    fn follow(&mut self, cubes: &[(CubeId, Place)], edge: Edge) {
        for (number, (_, place)) in cubes.iter().enumerate().skip(self.before.len()) {
            let before = self.newest.insert(cell(place.corner(), edge), number);
            self.before.push(before);
        }
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
