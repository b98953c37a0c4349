//! How connections come in: one loop of accepting for HTTP and gRPC, TLS, HTTP/1 and HTTP/2, and their end.
//!
//! ```text
//!   socket ── TLS, if it is set up ── which protocol ─┬─ HTTP/1: hyper ──────────────┬─ router (HTTP or gRPC)
//!                                                     └─ HTTP/2: h2, bodies pumped ──┘
//!   beside each connection: what it is doing, and for how long it may
//! ```
//! Knows sockets, certificates and frames. Never knows what is asked or answered.

mod activity;
mod body;
mod frames;
mod heads;
mod http1;
mod http2;
mod meters;
mod places;
mod socket;
mod tls;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::ConnectInfo;
use axum::http::Request;
use axum::response::Response;
use tokio::net::{TcpListener, TcpStream};
use tokio::time::timeout;
use tokio_util::either::Either;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::ServiceExt;

use self::activity::{Activity, Overdue};
pub use self::meters::describe as describe_metrics;
use self::places::Places;
use self::socket::Socket;
pub use self::tls::{CertificateFiles, InvalidCertificate, Tls};

/// Pause after a connection could not be accepted for want of something that others may give back: files, memory.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// How long a client may take to close after it has been told that the connection ends.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(5);

/// What connections may take.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Connections at a time; further ones are closed at once.
    pub connections_max: usize,
    /// The same of one address: of IPv6, of the 2^64 addresses that one customer has.
    pub connections_per_address_max: usize,
    /// How long a TLS handshake may take.
    pub handshake_timeout: Duration,
    /// How long the head of a request may take to arrive, from its first byte; of HTTP/2, the opening of the connection.
    pub head_timeout: Duration,
    /// How long a connection may stay without a request.
    pub idle_timeout: Duration,
    /// How long a client may leave what is answered unread.
    pub unread_timeout: Duration,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            connections_max: 1024,
            connections_per_address_max: 256,
            handshake_timeout: Duration::from_secs(10),
            head_timeout: Duration::from_secs(10),
            idle_timeout: Duration::from_mins(5),
            unread_timeout: Duration::from_mins(1),
        }
    }
}

/// What the connections of a listener speak.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Protocol {
    /// HTTP/1, or HTTP/2 when the client begins with it.
    Http,
    /// HTTP/2 alone.
    Grpc,
}

/// The door of a server, through which all connections come, whatever they speak. A clone is the same door.
#[derive(Clone)]
pub struct Door {
    settings: Settings,
    tls: Option<Arc<Tls>>,
    places: Arc<Places>,
}

impl Default for Door {
    fn default() -> Self {
        Self::new(Settings::default(), None)
    }
}

impl Door {
    /// A door with these settings; with `tls` all connections are encrypted.
    pub fn new(settings: Settings, tls: Option<Arc<Tls>>) -> Self {
        Self {
            places: Places::new(
                settings.connections_max,
                settings.connections_per_address_max,
            ),
            settings,
            tls,
        }
    }

    /// Accepts connections until `draining` is cancelled, and then waits until those that are there have ended: each request that
    /// is under way is answered, and no further one taken.
    pub async fn serve(
        self,
        listener: TcpListener,
        protocol: Protocol,
        router: Router,
        draining: CancellationToken,
    ) {
        let connections = TaskTracker::new();
        loop {
            let accepted = tokio::select! {
                accepted = listener.accept() => accepted,
                () = draining.cancelled() => break,
            };
            match accepted {
                Ok((stream, peer)) => {
                    let Some(place) = self.places.take(peer.ip()) else {
                        continue;
                    };
                    let connection = Connection {
                        door: self.clone(),
                        protocol,
                        router: router.clone(),
                        draining: draining.clone(),
                    };
                    connections.spawn(async move {
                        if let Err(cause) = connection.run(stream, peer).await {
                            meters::closed(&cause);
                            tracing::debug!(%peer, "the connection is closed: {cause}");
                        }
                        drop(place);
                    });
                }
                Err(error) if concerns_one(&error) => {}
                Err(error) => {
                    tracing::warn!("cannot accept connections: {error}");
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                }
            }
        }
        // Who comes now is refused by the system, and does not wait for an answer that never comes.
        drop(listener);
        connections.close();
        connections.wait().await;
    }
}

/// Whether an error of accepting is that of the connection which would have been accepted.
fn concerns_one(error: &std::io::Error) -> bool {
    use std::io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    matches!(
        error.kind(),
        ConnectionAborted | ConnectionRefused | ConnectionReset
    )
}

/// A connection, from its acceptance to its end.
struct Connection {
    door: Door,
    protocol: Protocol,
    router: Router,
    draining: CancellationToken,
}

impl Connection {
    async fn run(self, stream: TcpStream, peer: SocketAddr) -> Result<(), Closed> {
        // Answers are small and somebody waits for each.
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!("cannot set TCP_NODELAY: {error}");
        }
        let begun = self.draining.run_until_cancelled(self.begin(stream)).await;
        let Some((socket, activity, is_http2)) = begun.transpose()? else {
            return Ok(());
        };
        let settings = &self.door.settings;
        let desk = Desk {
            router: self.router,
            peer,
        };
        if is_http2 {
            http2::serve(socket, activity, desk, settings, self.draining).await
        } else {
            http1::serve(socket, activity, desk, settings, self.draining).await
        }
    }

    /// The socket, encrypted if that is set up, and whether it speaks HTTP/2.
    async fn begin(&self, stream: TcpStream) -> Result<(Socket, Arc<Activity>, bool), Closed> {
        let settings = &self.door.settings;
        let stream = match &self.door.tls {
            None => Either::Left(stream),
            Some(tls) => {
                let encrypted = timeout(settings.handshake_timeout, tls.accept(stream)).await;
                Either::Right(encrypted.map_err(|_| Closed::SlowHandshake)??)
            }
        };
        let activity = Arc::new(Activity::new());
        let mut socket = Socket::new(stream, activity.clone());
        let is_http2 = match self.protocol {
            Protocol::Grpc => true,
            Protocol::Http => timeout(settings.head_timeout, socket.begins_http2())
                .await
                .map_err(|_| Overdue::Head)??,
        };
        Ok((socket, activity, is_http2))
    }
}

/// Who answers the requests of a connection.
#[derive(Clone)]
struct Desk {
    router: Router,
    peer: SocketAddr,
}

impl Desk {
    async fn answer(self, mut request: Request<Body>) -> Response {
        request.extensions_mut().insert(ConnectInfo(self.peer));
        let answer = self.router.oneshot(request).await;
        answer.unwrap_or_else(|never| match never {})
    }
}

/// Why a connection was ended before its client wanted it.
#[derive(Debug, thiserror::Error)]
enum Closed {
    #[error("it broke: {0}")]
    Broken(#[from] std::io::Error),
    #[error("the TLS handshake did not end in time")]
    SlowHandshake,
    #[error(transparent)]
    Http1(#[from] hyper::Error),
    #[error(transparent)]
    Http2(#[from] h2::Error),
    #[error(transparent)]
    Overdue(#[from] Overdue),
    #[error("what the client sent can be read in two ways: {0}")]
    Refused(heads::Refusal),
    #[error("the client sent nothing but frames without use")]
    Flood,
}
