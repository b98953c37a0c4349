//! The exact core alone, geometry, engine and the faces that it lists, from the same sources: what needs no server is compiled optimised in seconds, and
//! its tests, which take far longer without optimisation, run so.

/// Without the files that meshes are written to.
#[path = "../../src/boundary"]
pub mod boundary {
    pub mod cubes;
    mod face;
    pub mod mesh;
    pub mod solids;

    pub use face::{Face, FaceSink, NoStock, Region};
}
#[path = "../../src/engine/mod.rs"]
pub mod engine;
#[path = "../../src/geometry/mod.rs"]
pub mod geometry;

#[cfg(test)]
#[path = "../oracle/random.rs"]
mod random;
