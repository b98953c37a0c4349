//! Exact mass properties of the union of many cubes, current while cubes are inserted and deleted: the map.
//!
//! A *scene* is a set of identical axis-aligned cubes on an integer lattice. Clients insert and delete cubes; volume,
//! area, edge length, moments, Euler characteristic and vertices of their union are current for every query, exact, and
//! durable. Nothing is sampled, voxelised or approximated, and the union itself is never built.
//!
//! One change, in a straight line; imports point the same way, never back (`tests/tidy.rs` keeps it so):
//!
//! ```text
//!   HTTP ─┬> wire ─> service ─┬─> engine ─> geometry     judge, then add or retract local contributions
//!   gRPC ─┘   │        │      └─> log ────> geometry     append: an answer means fsynced
//!             │        └─ publish: readers and subscribers see the new totals, without a lock
//!             └─ the only floats: user units <-> lattice steps
//! ```
//!
//! | module | knows | must never know |
//! |---|---|---|
//! | [`geometry`] | lattice, cubes, octant masks, weights, measures, convex solids: integers only | I/O, async, serde, floats |
//! | [`engine`] | the grid, the kernel, the set of cubes and its totals; in [`engine::solids`] the same of convex solids | the same, and who asks |
//! | [`boundary`] | faces of the union in floats, meshes of them | the log, who asks |
//! | [`log`] | records, snapshots, SQLite, checksums | the engine, async, the wire |
//! | [`service`] | scenes, their writers, queues, recovery | HTTP, gRPC, JSON, user units |
//! | [`wire`] | HTTP, gRPC, JSON, protobuf, user units, problems | the log, the grid |
//! | [`toolpath`] | G-code to motions | everything else |
//! | [`config`] | settings from file, environment and flags | how they are used |
//!
//! Where the invariants live:
//!
//! - The totals are a pure function of the set of cubes: [`engine`], compared with voxels and with a recount
//!   ([`engine::recount`]) in `tests/engine.rs`.
//! - The true values fit their types: const assertions in [`geometry`] beside the types, and in the engine's kernel.
//! - A change is applied whole or not at all: [`engine::Engine::apply`], the only door to the engine's state.
//! - One writer for each scene owns its engine and its log; nobody locks them: [`service`].
//! - Nothing is visible or answered before it is on stable storage, and replay is the way back after any failure:
//!   [`service`] and [`log`]; `tests/crash.rs` kills a real server in mid-stream.
//! - Nobody does what his key has not the right to: [`wire::access`], one table of what each call needs; `tests/http/access.rs` and
//!   `tests/grpc/access.rs` try every call.
//! - Damage to a file is refused with its place, and never gives a wrong total: [`log`], `tests/log.rs`.

pub mod boundary;
pub mod config;
#[deny(clippy::float_arithmetic)]
pub mod engine;
#[deny(clippy::float_arithmetic)]
pub mod geometry;
#[deny(clippy::float_arithmetic)]
pub mod log;
#[deny(clippy::float_arithmetic)]
pub mod service;
pub mod toolpath;
pub mod wire;

#[cfg(test)]
#[path = "../tests/oracle/random.rs"]
mod random;
