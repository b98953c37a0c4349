//! A set of cubes to be measured, and those that replace some of them.

use std::path::Path;

use union3d::engine::recount;
use union3d::geometry::{Edge, Place, Totals};

use super::cubes::{numbered, read};
use super::failure::Failure;
use super::sets::Cube;
use super::workload::{EDGE_STEPS, Workload};

/// Four fifths of the places of a workload or a file are the set; the last fifth comes after it.
pub(crate) struct Scenario {
    pub(crate) name: String,
    pub(crate) edge: Edge,
    /// The set, oldest first.
    pub(crate) cubes: Vec<Cube>,
    /// What comes after: the path goes on.
    pub(crate) following: Vec<Cube>,
}

impl Scenario {
    fn new(name: String, edge: Edge, places: Vec<Place>) -> Self {
        let mut cubes = numbered(places);
        let following = cubes.split_off((cubes.len() * 4).div_ceil(5));
        Self {
            name,
            edge,
            cubes,
            following,
        }
    }

    /// So many cubes of a workload.
    /// # Errors
    /// They do not fit the lattice.
    pub(crate) fn of(workload: Workload, cubes: usize, seed: u64) -> Result<Self, Failure> {
        let edge = Edge::new(EDGE_STEPS)?;
        let name = workload.name();
        let places = workload
            .places(edge, cubes + cubes / 4, seed)
            .map_err(|invalid| format!("{name}: too many cubes for the lattice: {invalid}"))?;
        Ok(Self::new(name, edge, places))
    }

    /// The cubes of a file, named after it.
    /// # Errors
    /// Those of [`read`].
    pub(crate) fn of_file(path: &Path, edge: Edge) -> Result<Self, Failure> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        Ok(Self::new(name.into_owned(), edge, read(path, edge)?))
    }

    /// What the set must measure, from its places alone.
    pub(crate) fn totals(&self) -> Totals {
        recount(self.edge, None, self.cubes.iter().map(|(_, place)| *place))
    }
}
