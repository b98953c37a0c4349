//! The boundary of a union as faces: what engines list, and what meshes and pictures are made of.

mod face;
pub mod solids;

pub use face::{Face, FaceSink, NoStock, Region};
