//! The native part of the Python package: scenes in memory, in directories and on servers, and arrays as columns of a change.
//!
//! ```text
//!   union3d/*.py ── what people call: names, types, documents as objects
//!     └─ Scene ── backend ─┬─ memory                   the engine, called directly
//!          │               └─ requests ─┬─ directory   a service of this process, asked as over HTTP but without a socket
//!          │                            └─ server      over HTTP
//!          └─ columns      arrays in user units or lattice steps to lattice steps, with every fault and its place
//! ```
//! Answers are JSON texts of the HTTP API, whatever the backend: the Python side reads them all in one way.

mod backend;
mod columns;
mod directory;
mod failure;
mod requests;
mod scene;
mod server;
mod settings;
mod waiting;

/// As in the program, for what Rust allocates; Python has its own.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use crate::scene::Scene;
}
