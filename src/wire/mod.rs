//! The outside world: HTTP and gRPC in, lattice steps out, and back.
//!
//! ```text
//!   connections ── door ──> http, grpc
//!   request ── access ── http ─┬─ decode ── convert ── calls, atomic ──> service
//!                        grpc ─┘
//!   answer  <─ http, grpc ── convert ─────── Published <────── service
//!              every failure on the way ── problem (RFC 9457), with gRPC as a status
//! ```
//! `memory` answers in the same words for a scene that no service has.
//!
//! Knows HTTP, gRPC, JSON, protobuf and user units. Never keeps state of a scene, and never touches its files.

pub mod access;
mod atomic;
mod calls;
pub mod convert;
pub mod decode;
mod decoded;
pub mod documents;
pub mod door;
mod drawing;
mod failures;
pub mod grpc;
pub mod http;
mod kind;
pub mod memory;
mod objects;
mod open;
pub mod problem;
mod room;
mod slices;
pub mod solids;
pub mod trust;
mod vector;

/// Messages, server and client generated from `proto/union3d/v1/*.proto`.
#[expect(
    missing_docs,
    clippy::pedantic,
    clippy::large_enum_variant,
    reason = "generated; the documentation is in the proto files"
)]
pub mod proto {
    include!(concat!(env!("OUT_DIR"), "/union3d.v1.rs"));

    /// What the files say, as reflection tells it: an encoded `google.protobuf.FileDescriptorSet`.
    pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/union3d.bin"));
}
