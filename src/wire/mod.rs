//! The outside world: HTTP in, lattice steps out, and back.
//!
//! ```text
//!   request ── http ── decode ── convert ── Submission ──> service
//!   answer  <─ http ── convert ─────────── Published <──── service
//!              every failure on the way ── problem (RFC 9457)
//! ```
//! Knows HTTP, JSON, protobuf and user units. Never keeps state of a scene, and never touches its files.

mod atomic;
mod calls;
pub mod convert;
pub mod decode;
pub mod http;
mod openapi;
pub mod problem;

/// Messages generated from `proto/union3d/v1/union3d.proto`.
#[expect(
    missing_docs,
    reason = "generated; the documentation is in the proto file"
)]
pub mod proto {
    include!(concat!(env!("OUT_DIR"), "/union3d.v1.rs"));
}
