//! The exact core alone, geometry and engine, from the same sources: what needs no server is compiled optimised in seconds, and
//! its tests, which take far longer without optimisation, run so.

#[path = "../../src/engine/mod.rs"]
pub mod engine;
#[path = "../../src/geometry/mod.rs"]
pub mod geometry;

#[cfg(test)]
#[path = "../oracle/random.rs"]
mod random;
