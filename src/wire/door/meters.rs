//! What is counted of connections. What strangers do is counted here rather than logged: they could fill a log.

use metrics::{counter, describe_counter, describe_gauge, gauge};

use super::Closed;
use super::activity::Overdue;

const THERE: &str = "union3d_connections";
const ACCEPTED: &str = "union3d_connections_accepted_total";
const REFUSED: &str = "union3d_connections_refused_total";
const CLOSED: &str = "union3d_connections_closed_total";

/// Why a connection may be closed.
const REASONS: [&str; 9] = [
    "broken",
    "handshake",
    "protocol",
    "head",
    "idle",
    "unread",
    "silent",
    "refused",
    "flood",
];

/// Describes the metrics to the recorder that is installed. Call it once, after installing.
pub fn describe() {
    describe_gauge!(THERE, "Connections of HTTP and gRPC that are there");
    describe_counter!(ACCEPTED, "Connections accepted");
    describe_counter!(
        REFUSED,
        "Connections closed at once because there were too many, in all or of one address"
    );
    describe_counter!(
        CLOSED,
        "Connections that the server closed before the client wanted it, by reason"
    );
    // Shown from the start, also what has not happened yet.
    gauge!(THERE).increment(0);
    counter!(ACCEPTED).increment(0);
    for limit in ["all", "address"] {
        counter!(REFUSED, "limit" => limit).increment(0);
    }
    for reason in REASONS {
        counter!(CLOSED, "reason" => reason).increment(0);
    }
}

pub(super) fn opened() {
    gauge!(THERE).increment(1);
    counter!(ACCEPTED).increment(1);
}

pub(super) fn ended() {
    gauge!(THERE).decrement(1);
}

pub(super) fn refused(limit: &'static str) {
    counter!(REFUSED, "limit" => limit).increment(1);
}

pub(super) fn closed(cause: &Closed) {
    let reason = match cause {
        Closed::Broken(_) => "broken",
        Closed::SlowHandshake => "handshake",
        Closed::Http1(_) | Closed::Http2(_) => "protocol",
        Closed::Overdue(Overdue::Head) => "head",
        Closed::Overdue(Overdue::Idle) => "idle",
        Closed::Overdue(Overdue::Unread) => "unread",
        Closed::Overdue(Overdue::Silent) => "silent",
        Closed::Refused(_) => "refused",
        Closed::Flood => "flood",
    };
    counter!(CLOSED, "reason" => reason).increment(1);
}
