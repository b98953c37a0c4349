//! A server behind a door, and bytes to and from it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use prost::Message;
use tempfile::TempDir;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;
use union3d::service::{FailHook, Readiness, Service, ServiceConfig};
use union3d::wire::access::Access;
use union3d::wire::door::{Door, Settings, Tls};
use union3d::wire::http::Limits;
use union3d::wire::{grpc, http};

/// Longer than anything here takes, so that a hang is told from a slow machine.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

pub(crate) struct Server {
    pub(crate) http: String,
    pub(crate) grpc: String,
    pub(crate) draining: CancellationToken,
    _data: TempDir,
}

/// What a server is started with.
#[derive(Default)]
pub(crate) struct Setup {
    pub(crate) door: Settings,
    pub(crate) tls: Option<Arc<Tls>>,
    pub(crate) limits: Limits,
    pub(crate) faults: Option<FailHook>,
}

impl Server {
    pub(crate) async fn start(setup: Setup) -> Self {
        let data = tempfile::tempdir().unwrap();
        let config = ServiceConfig::new(data.path());
        let service = match setup.faults {
            Some(faults) => Service::start_with_failpoints(config, faults).unwrap(),
            None => Service::start(config).unwrap(),
        };
        eventually("the service is ready", async || {
            matches!(service.readiness(), Readiness::Ready { .. })
        })
        .await;
        let door = Door::new(setup.door, setup.tls);
        let draining = CancellationToken::new();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let http = listener.local_addr().unwrap().to_string();
        let (limits, ended) = (setup.limits, draining.clone());
        tokio::spawn(http::serve(
            door.clone(),
            listener,
            service.clone(),
            limits,
            Access::default(),
            ended,
        ));
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let grpc = listener.local_addr().unwrap().to_string();
        let ended = draining.clone();
        tokio::spawn(grpc::serve(
            door,
            listener,
            service,
            limits,
            Access::default(),
            ended,
        ));
        Self {
            http,
            grpc,
            draining,
            _data: data,
        }
    }

    pub(crate) async fn connect(&self) -> TcpStream {
        TcpStream::connect(&self.http).await.unwrap()
    }

    /// What is answered to bytes, to the end of the connection.
    pub(crate) async fn ask(&self, bytes: impl AsRef<[u8]>) -> String {
        let mut stream = self.connect().await;
        stream.write_all(bytes.as_ref()).await.unwrap();
        rest(&mut stream).await
    }

    /// The value of a metric, with its labels as they are printed.
    pub(crate) async fn metric(&self, name: &str) -> f64 {
        let text = self
            .ask("GET /metrics HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
            .await;
        let line = text.lines().find_map(|line| line.strip_prefix(name));
        line.map_or(0.0, |value| value.trim().parse().unwrap())
    }

    /// Creates a scene of cubes of edge 1, one step a unit.
    pub(crate) async fn scene(&self, name: &str) {
        let body = "{\"edge\":1,\"steps_per_unit\":1}";
        let head = format!(
            "PUT /v1/scenes/{name} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Type: application/json\r\n"
        );
        let length = body.len();
        let request = format!("{head}Content-Length: {length}\r\n\r\n{body}");
        let answer = self.ask(request).await;
        assert!(answer.starts_with("HTTP/1.1 201"), "{answer}");
    }
}

/// Reads to the end of a connection. A reset is an end, too.
pub(crate) async fn rest(stream: &mut (impl AsyncRead + Unpin)) -> String {
    let mut bytes = Vec::new();
    let read = timeout(PATIENCE, stream.read_to_end(&mut bytes)).await;
    drop(read.expect("the connection ends"));
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Reads until this text has come.
pub(crate) async fn until(stream: &mut (impl AsyncRead + Unpin), text: &str) -> String {
    let mut bytes = Vec::new();
    let reading = async {
        while !String::from_utf8_lossy(&bytes).contains(text) {
            let length = stream.read_buf(&mut bytes).await.unwrap();
            assert!(length > 0, "it ended: {}", String::from_utf8_lossy(&bytes));
        }
    };
    timeout(PATIENCE, reading).await.expect("the text comes");
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Waits until something holds.
pub(crate) async fn eventually(what: &str, mut holds: impl AsyncFnMut() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !holds().await {
        assert!(Instant::now() < deadline, "in vain: {what}");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

pub(crate) type Requests = h2::client::SendRequest<Bytes>;

/// A connection of HTTP/2 over a stream, and a task that drives it, which gives how it ended.
pub(crate) async fn http2<S>(
    stream: S,
) -> (Requests, tokio::task::JoinHandle<Result<(), h2::Error>>)
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let (requests, connection) = h2::client::handshake(stream).await.unwrap();
    (requests, tokio::spawn(connection))
}

/// A message as gRPC sends it.
pub(crate) fn framed(message: &impl Message) -> Vec<u8> {
    let mut bytes = vec![0];
    let length = u32::try_from(message.encoded_len()).unwrap();
    bytes.extend_from_slice(&length.to_be_bytes());
    bytes.extend_from_slice(&message.encode_to_vec());
    bytes
}

/// A call's head.
pub(crate) fn call(address: &str, path: &str) -> axum::http::Request<()> {
    axum::http::Request::post(format!("http://{address}{path}"))
        .header("content-type", "application/grpc")
        .header("te", "trailers")
        .body(())
        .unwrap()
}

/// The status that ends a call, in its head or its trailers.
pub(crate) async fn status(answer: axum::http::Response<h2::RecvStream>) -> String {
    let (head, mut body) = answer.into_parts();
    let of = |headers: &axum::http::HeaderMap| {
        let status = headers.get("grpc-status");
        status.map(|status| status.to_str().unwrap().to_owned())
    };
    if let Some(status) = of(&head.headers) {
        return status;
    }
    while let Some(data) = body.data().await {
        let data = data.unwrap();
        let _ = body.flow_control().release_capacity(data.len());
    }
    of(&body.trailers().await.unwrap().unwrap()).unwrap()
}

/// The whole of a plain answer over HTTP/2.
pub(crate) async fn get(requests: &Requests, path: &str) -> (u16, String) {
    let mut requests = requests.clone().ready().await.unwrap();
    let request = axum::http::Request::get(format!("http://localhost{path}"));
    let (answer, _) = requests
        .send_request(request.body(()).unwrap(), true)
        .unwrap();
    let (head, mut body) = answer.await.unwrap().into_parts();
    let mut text = Vec::new();
    while let Some(data) = body.data().await {
        let data = data.unwrap();
        let _ = body.flow_control().release_capacity(data.len());
        text.extend_from_slice(&data);
    }
    (head.status.as_u16(), String::from_utf8(text).unwrap())
}
