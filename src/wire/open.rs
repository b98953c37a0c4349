//! How many streams of changes are open.

use metrics::gauge;

use crate::service::Meter;

const NAME: &str = "union3d_streams";

/// The metric of it.
pub(super) const STREAMS: Meter =
    Meter::gauge(NAME, "Streams of changes that are open").by("protocol", &["http", "grpc"]);

/// A stream that is open: counted until it is dropped.
pub(super) struct OpenStream {
    protocol: &'static str,
}

impl OpenStream {
    /// Counts a stream of lines over HTTP.
    pub(super) fn http() -> Self {
        Self::new("http")
    }

    /// Counts a stream of gRPC.
    pub(super) fn grpc() -> Self {
        Self::new("grpc")
    }

    fn new(protocol: &'static str) -> Self {
        gauge!(NAME, "protocol" => protocol).increment(1);
        Self { protocol }
    }
}

impl Drop for OpenStream {
    fn drop(&mut self) {
        gauge!(NAME, "protocol" => self.protocol).decrement(1);
    }
}
