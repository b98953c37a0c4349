//! G-code to positions: what the tip of the cutter does, line by line, in millimetres.
//!
//! ```text
//!   text ── words ── Block ── program ── Move ── path ── positions
//!           (gcode crate)     (the machine's      (straight lines, arcs,
//!                              modal state)         at least one every step)
//! ```
//!
//! Knows nothing of cubes, lattices or scenes. Everything here is a float: the lattice begins where a position becomes a cube.
//! Nothing is kept but the machine's state, so a program of any length runs in constant memory.
//!
//! The machine starts at the origin, absolute (G90), in millimetres (G21), in the XY plane (G17), with arc centres relative to
//! the start (G91.1) and no motion word in force.

mod arc;
mod path;
mod program;
mod words;

pub use path::{Motion, Move, Sampler};
pub use program::{Event, Fault, Moves, ReadError, Warning};
