//! The boundary of a union as faces: what engines list, and what meshes and pictures are made of; and where planes cut it.

mod face;
pub mod section;
pub mod slice;
pub mod solids;

pub use face::{Face, FaceSink, NoStock, Region};
