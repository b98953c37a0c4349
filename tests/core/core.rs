//! The tests of the core, as one program: `tests/run` runs them with every assertion, and as a release is compiled. What comes
//! of a script must be the same in both; a golden hash says so.
#![allow(
    clippy::duplicate_mod,
    reason = "each of these is a program of its own when it is run alone"
)]

extern crate union3d_core as union3d;

#[path = "../boundary_cubes.rs"]
mod boundary_cubes;
#[path = "../boundary_solids.rs"]
mod boundary_solids;
#[path = "../convex.rs"]
mod convex;
#[path = "../engine.rs"]
mod engine;
#[path = "../geometry.rs"]
mod geometry;
#[path = "../solids.rs"]
mod solids;
