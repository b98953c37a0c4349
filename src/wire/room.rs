//! The memory that requests take of the budget that all share, as the bytes of their bodies arrive.
//!
//! What a client announces takes nothing. A body whose client has used up its share is refused, to be sent again.

use std::net::SocketAddr;

use axum::extract::ConnectInfo;
use axum::http::Extensions;

use super::problem::{Code, Problem};
use crate::service::Client;

/// What a byte of a change that is JSON takes in memory, with what it is decoded to and what the scene keeps beside it, until it is
/// answered. Measured by tests/attack/weights.py, of 300,000 cubes: 6.4 with short numbers, 4.2 with long ones;
/// deletions of short numbers alone take more, 11.6.
pub(super) const JSON_WEIGHT: u64 = 8;

/// The same of a change that is a message, whose integers are packed: 21 with short numbers, 9 with long ones, over HTTP and gRPC.
pub(super) const MESSAGE_WEIGHT: u64 = 24;

/// Whose a request is.
pub(super) fn client(extensions: &Extensions) -> Client {
    let peer = extensions.get::<ConnectInfo<SocketAddr>>();
    peer.map_or(Client::Unknown, |ConnectInfo(peer)| Client::at(peer.ip()))
}

/// The client holds its share.
pub(super) fn share_used() -> Problem {
    let detail = "other requests of this client, or of many clients, have the memory that there is for it now";
    Problem::new(Code::MemoryUsed, detail)
}

/// What bytes take that are decoded.
pub(super) fn weighed(bytes: usize, weight: u64) -> u64 {
    u64::try_from(bytes).map_or(u64::MAX, |bytes| bytes.saturating_mul(weight))
}

/// A body that does not fit in the share of a client that is alone.
pub(super) fn too_large(bytes_max: u64) -> Problem {
    let detail = format!(
        "it is larger than {bytes_max} bytes, which is all that one client may take of memory_bytes_max"
    );
    Problem::new(Code::TooLarge, detail)
}
