//! Convex solids on the lattice: points, planes, hulls, sweeps, cutters.
//!
//! Knows integers only, and one body at a time. It must never know floats, user units, the union, or who asks.
//!
//! ```text
//!   points ── hull ──┐                          ┌─ vertices   lattice points
//!   cutter ──────────┴─> Solid ── sweep ──> Solid ─ facets     one reduced plane each, loops counterclockwise from outside
//!                        (at its anchor)        └─ edges      two vertices, two facets
//! ```
//!
//! Every facet is maximal (coplanar pieces are one facet), every edge too, and no vertex lies between others: a solid is a
//! function of the set of points that it contains, up to the order of its lists. Degenerate input (points repeated, in one line or
//! in one plane) is ordinary and leaves no trace.
//!
//! # Proof that everything fits
//! Coordinates lie within `2^30` of the origin, and two vertices of a solid differ by at most `2^21` along each axis
//! ([`EXTENT_MAX`]). The const assertions of `limits.rs` follow the bounds from there to the determinant of four planes.

mod builder;
mod cutter;
mod fixed;
mod hull;
mod limits;
mod plane;
mod point;
mod polygon;
mod solid;
mod sweep;
mod vector;

pub(crate) use builder::edges_of;
pub use cutter::{Cutter, End, InvalidCutter, RINGS_MAX, SIDES_MAX, STRAIGHT_ANGLE, cone};
pub use limits::{EXTENT_MAX, VERTICES_MAX};
pub use plane::Plane;
pub use point::{InvalidPoint, Point};
pub use polygon::{Deviation, Fit};
pub use solid::{Edge, Facet, InvalidSolid, Solid};
pub use sweep::InvalidSweep;
pub use vector::{cross, dot};
