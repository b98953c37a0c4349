//! What a change comes to that has been read.

use crate::service::{Cubes, Kind, Motion, Operations};

/// A decoded atomic change.
#[derive(Debug)]
pub struct Decoded<K: Kind = Cubes> {
    /// What to do: the deletions first.
    pub operations: Operations<K>,
    /// How many of the operations are deletions.
    pub deletions: usize,
    /// What the change belongs to.
    pub motion: Motion,
}
