//! The boundary of a union as faces: what engines list, and what meshes and pictures are made of.

pub mod cubes;
mod face;
pub mod mesh;
pub mod mesh_file;
pub mod solids;

pub use face::{Face, FaceSink, NoStock, Region};
