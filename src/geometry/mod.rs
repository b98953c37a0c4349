//! What is measured: the lattice, cubes, octant masks, their weights, and the measures they add up to.
//!
//! Knows integers only. It must never know I/O, floats, async, serde, a grid, or who asks.
//!
//! ```text
//!   Place + Edge ── a cube        8 octants around a lattice point ── OctantMask ── Weights
//!                                 sum over points of weight * monomial ──────────── Measures
//! ```

pub mod convex;
mod cubes;
mod lattice;
mod measures;
mod octants;
mod weights;

pub use cubes::{Effect, StockMeasures, Totals};
pub use lattice::{
    Bounds, COORDINATE_MAX, CUBES_MAX, CubeId, EDGE_MAX, Edge, InvalidCube, InvalidEdge,
    InvalidStock, Place, Stock,
};
pub use measures::Measures;
pub use octants::{EdgeKind, OctantMask, VertexKind};
pub use weights::{WEIGHTS, Weights};
