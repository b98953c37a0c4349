//! Exact mass properties of the union of many cubes, current while cubes are inserted and deleted.
pub mod config;
pub mod engine;
pub mod geometry;
pub mod log;
pub mod service;
pub mod toolpath;
pub mod wire;
