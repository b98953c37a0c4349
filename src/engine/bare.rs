//! A yardstick: what storing the cubes costs, with nothing computed.

use crate::geometry::{CubeId, Edge, Place};

use super::EngineSize;
use super::grid::Grid;
use super::ids::IdTable;

/// A set of cubes in the engine's own table of ids and grid, without any geometry: no neighbours, no totals.
///
/// The time of an [`Engine`](super::Engine) over that of a `Bare` with the same cubes is the price of the totals.
#[derive(Debug)]
pub struct Bare {
    ids: IdTable,
    grid: Grid,
}

impl Bare {
    /// An empty set of cubes of `edge`.
    pub fn new(edge: Edge) -> Self {
        Self {
            ids: IdTable::new(),
            grid: Grid::for_neighbours(edge),
        }
    }

    /// Stores a cube; false, and nothing done, when the id is there.
    pub fn insert(&mut self, id: CubeId, place: Place) -> bool {
        let new = self.ids.insert(id, place);
        if new {
            self.grid.insert(place, id);
        }
        new
    }

    /// Removes a cube; false when it is not there.
    pub fn delete(&mut self, id: CubeId) -> bool {
        match self.ids.remove(id) {
            None => false,
            Some(place) => {
                let found = self.grid.remove(place, id);
                assert!(found, "a cube of the table is in the grid");
                true
            }
        }
    }

    /// Number of cubes. O(1).
    pub fn len(&self) -> u64 {
        self.ids.len() as u64
    }

    /// Whether there is no cube. O(1).
    pub fn is_empty(&self) -> bool {
        self.ids.len() == 0
    }

    /// Bytes of the table and of the grid.
    pub fn size(&self) -> EngineSize {
        EngineSize {
            ids: self.ids.size(),
            grid: self.grid.size(),
        }
    }
}
