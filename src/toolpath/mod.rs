//! G-code to positions: what the tip of the cutter does, line by line, in millimetres.
//!
//! ```text
//!   text ── lines ── Block ── Machine ── Move ── positions
//!     └── O-words, calls ──┘  (modes, frames,  (straight lines, arcs,
//!          (Interpreter)       compensation)    at least one every step)
//! ```
//!
//! Knows nothing of cubes, lattices or scenes. Everything here is a float: the lattice begins where a position becomes a cube.
//!
//! The path is right, or the program is refused at its line. What a word means, and which words are let pass because they change
//! nothing of the path, stands in one table (`codes`), by dialect; controllers are followed where they differ.
//!
//! The machine starts absolute (G90), in millimetres (G21), in the plane XY (G17), in G54, with arc centres relative to the start
//! (G91.1) and no motion word in force. Where it stands is not known: coordinates count from what the program says first.

mod arc;
mod block;
mod codes;
mod comment;
mod compensation;
mod cycle;
mod dialect;
mod event;
mod expression;
mod flow;
mod frames;
mod interpreter;
mod machine;
mod options;
mod parameters;
mod path;
mod spline;
mod stock;
mod text;
mod tools;

pub use codes::words_table;
pub use dialect::Dialect;
pub use event::{Event, InvalidLine, Warning};
pub use interpreter::Interpreter;
pub use options::{Options, RapidPath};
pub use path::{Motion, Move, Plane, Sampler};
pub use stock::StockComment;
pub use tools::{Bit, Cone, Shaped, Tool, ToolEnd, ToolShape, ToolTable, bit, bits};
