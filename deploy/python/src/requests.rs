//! A scene that is asked by requests of the HTTP API.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::{Body, Bytes, to_bytes};
use axum::http::{Method, Request, StatusCode, header};
use percent_encoding::{NON_ALPHANUMERIC, utf8_percent_encode};
use prost::Message;
use pyo3::prelude::*;
use tower::ServiceExt;
use union3d::engine::Side;
use union3d::wire::memory::{Answered, HistoryWanted};
use union3d::wire::problem::{Code, Problem};
use union3d::wire::proto::Change;
use uuid::Uuid;

use crate::directory::Directory;
use crate::failure::Failure;
use crate::server::{Server, Unsent};
use crate::waiting::wait;

/// How long to wait before a request that was not taken is sent again.
const PAUSE: Duration = Duration::from_millis(20);

/// How long a server that cannot be reached, or cannot answer yet, is tried again.
const PATIENCE: Duration = Duration::from_secs(30);

/// A scene that requests reach.
#[derive(Debug)]
pub(crate) struct RequestedScene {
    channel: Channel,
    /// The directory it is in, if any, open as long as this lives.
    _directory: Option<Arc<Directory>>,
}

/// A scene by its name, and who is asked.
#[derive(Clone, Debug)]
struct Channel {
    api: Api,
    name: String,
}

/// Who answers requests of the HTTP API.
#[derive(Clone, Debug)]
enum Api {
    /// A service of this process.
    Here(Router),
    /// A server.
    There(Server),
}

/// A request, which can be sent again.
#[derive(Clone, Debug)]
struct Asked {
    method: Method,
    /// Below the scene, with its query.
    path: String,
    headers: Vec<(header::HeaderName, String)>,
    body: Bytes,
}

impl Asked {
    fn new(method: Method, path: impl Into<String>) -> Self {
        Self {
            method,
            path: path.into(),
            headers: Vec::new(),
            body: Bytes::new(),
        }
    }

    fn with(mut self, name: header::HeaderName, value: impl Into<String>) -> Self {
        self.headers.push((name, value.into()));
        self
    }

    fn with_json(mut self, body: impl Into<Bytes>) -> Self {
        self.body = body.into();
        self.with(header::CONTENT_TYPE, "application/json")
    }
}

impl RequestedScene {
    /// The scene of this name, which need not be there yet.
    pub(crate) fn of_directory(directory: Arc<Directory>, name: &str) -> Self {
        Self {
            channel: Channel {
                api: Api::Here(directory.api()),
                name: name.to_owned(),
            },
            _directory: Some(directory),
        }
    }

    /// The scene of this name on a server, which need not be there yet.
    pub(crate) fn of_server(server: Server, name: &str) -> Self {
        Self {
            channel: Channel {
                api: Api::There(server),
                name: name.to_owned(),
            },
            _directory: None,
        }
    }

    /// Creates it; one with the same settings that is there is left as it is.
    pub(crate) fn create(&self, py: Python<'_>, settings: &str) -> Result<String, Failure> {
        let asked = Asked::new(Method::PUT, "").with_json(settings.to_owned());
        self.text(py, asked)
    }

    /// What it is: its settings, its state, how many bodies it has.
    pub(crate) fn describe(&self, py: Python<'_>) -> Result<String, Failure> {
        self.text(py, Asked::new(Method::GET, ""))
    }

    pub(crate) fn change(
        &self,
        py: Python<'_>,
        change: &Change,
        answered: Answered,
        dry_run: bool,
    ) -> Result<String, Failure> {
        let returned = match answered {
            Answered::Change => "minimal",
            Answered::Totals => "representation",
        };
        let path = format!("/changes?return={returned}&dry_run={dry_run}");
        let mut asked =
            Asked::new(Method::POST, path).with(header::CONTENT_TYPE, "application/x-protobuf");
        asked.body = py.detach(|| change.encode_to_vec()).into();
        if !dry_run {
            asked = asked.with(KEY, key());
        }
        self.text(py, asked)
    }

    /// Defines a shape of a scene of solids.
    pub(crate) fn define(
        &self,
        py: Python<'_>,
        name: &str,
        shape: &str,
    ) -> Result<String, Failure> {
        let name = utf8_percent_encode(name, NON_ALPHANUMERIC);
        let asked = Asked::new(Method::PUT, format!("/shapes/{name}")).with_json(shape.to_owned());
        self.text(py, asked)
    }

    pub(crate) fn revert(&self, py: Python<'_>, to: u64) -> Result<String, Failure> {
        let asked = Asked::new(Method::POST, "/revert?return=minimal")
            .with_json(format!("{{\"to\":{to}}}"))
            .with(KEY, key());
        self.text(py, asked)
    }

    pub(crate) fn mass_properties(
        &self,
        py: Python<'_>,
        at: Option<u64>,
    ) -> Result<String, Failure> {
        let query = at.map(|at| format!("?at={at}")).unwrap_or_default();
        self.text(
            py,
            Asked::new(Method::GET, format!("/mass-properties{query}")),
        )
    }

    pub(crate) fn history(
        &self,
        py: Python<'_>,
        wanted: HistoryWanted,
    ) -> Result<Vec<u8>, Failure> {
        let parameters = [
            ("from", wanted.from),
            ("to", wanted.to),
            ("move_from", wanted.move_from),
            ("move_to", wanted.move_to),
            ("limit", wanted.limit),
        ];
        let given = parameters
            .into_iter()
            .filter_map(|(name, value)| Some(format!("{name}={}", value?)));
        let query: Vec<String> = given.collect();
        let asked = Asked::new(Method::GET, format!("/history?{}", query.join("&")))
            .with(header::ACCEPT, "text/csv");
        Ok(self.bytes(py, asked)?.into())
    }

    pub(crate) fn audit(&self, py: Python<'_>) -> Result<String, Failure> {
        self.text(py, Asked::new(Method::POST, "/audit").with_json("{}"))
    }

    /// Where points lie, and the id of a body that holds each.
    pub(crate) fn contains(
        &self,
        py: Python<'_>,
        points: Vec<[f64; 3]>,
    ) -> Result<Vec<(Side, Option<u64>)>, Failure> {
        let channel = self.channel.clone();
        wait(py, async move {
            let mut found = Vec::with_capacity(points.len());
            for [x, y, z] in points {
                let asked = Asked::new(Method::GET, format!("/contains?at={x},{y},{z}"));
                found.push(contained(&channel.send(asked).await?)?);
            }
            Ok(found)
        })
    }

    /// All bodies, a line of JSON each: `cubes` or `solids`.
    pub(crate) fn bodies(&self, py: Python<'_>, bodies: &str) -> Result<Bytes, Failure> {
        let asked = Asked::new(Method::GET, format!("/{bodies}"))
            .with(header::ACCEPT, "application/x-ndjson");
        self.bytes(py, asked)
    }

    fn text(&self, py: Python<'_>, asked: Asked) -> Result<String, Failure> {
        let bytes = self.bytes(py, asked)?;
        String::from_utf8(bytes.into()).map_err(|_| unreadable("it is not UTF-8"))
    }

    fn bytes(&self, py: Python<'_>, asked: Asked) -> Result<Bytes, Failure> {
        let channel = self.channel.clone();
        wait(py, async move { channel.send(asked).await })
    }
}

impl Channel {
    /// Sends a request until it is taken or refused for good. Each can be sent twice: it reads, or it names what makes a second time
    /// harmless.
    async fn send(&self, asked: Asked) -> Result<Bytes, Failure> {
        let begun = Instant::now();
        loop {
            let is_patient = begun.elapsed() < PATIENCE;
            let (status, body) = match self.send_once(asked.clone()).await {
                Ok(answer) => answer,
                // A server that was there before is waited for while it is away.
                Err(Unsent::Away(_)) if self.api.was_reached() && is_patient => {
                    tokio::time::sleep(10 * PAUSE).await;
                    continue;
                }
                Err(Unsent::Away(failure) | Unsent::Never(failure)) => return Err(failure),
            };
            self.api.is_reached();
            match status {
                status if status.is_success() => return Ok(body),
                // The queue is full.
                StatusCode::TOO_MANY_REQUESTS => {}
                // A directory that was just opened is read to its end, however long that takes.
                StatusCode::SERVICE_UNAVAILABLE if self.api.may_recover(&body) => {}
                StatusCode::SERVICE_UNAVAILABLE if self.api.may_come_back() && is_patient => {}
                _ => {
                    let problem = String::from_utf8_lossy(&body).into_owned();
                    return Err(Failure::Problem(with_status(problem, status)));
                }
            }
            tokio::time::sleep(PAUSE).await;
        }
    }

    async fn send_once(&self, asked: Asked) -> Result<(StatusCode, Bytes), Unsent> {
        let name = utf8_percent_encode(&self.name, NON_ALPHANUMERIC);
        let path = format!("/v1/scenes/{name}{}", asked.path);
        let mut request = Request::builder().method(asked.method);
        for (name, value) in asked.headers {
            request = request.header(name, value);
        }
        match &self.api {
            Api::Here(router) => {
                // A name by which everybody may ask who is on this machine.
                let request = request.header(header::HOST, "localhost");
                let request = request.uri(path).body(Body::from(asked.body));
                let request = request.map_err(|error| Unsent::bad(&error.to_string()))?;
                let answer = router.clone().oneshot(request).await;
                let answer = answer.unwrap_or_else(|never| match never {});
                let status = answer.status();
                let body = to_bytes(answer.into_body(), usize::MAX).await;
                let body = body.map_err(|error| Unsent::Never(unreadable(&error.to_string())))?;
                Ok((status, body))
            }
            Api::There(server) => {
                let request = request.uri(server.address(&path)).body(asked.body);
                let request = request.map_err(|error| Unsent::bad(&error.to_string()))?;
                server.send(request).await
            }
        }
    }
}

impl Api {
    fn was_reached(&self) -> bool {
        match self {
            Self::Here(_) => true,
            Self::There(server) => server.was_reached(),
        }
    }

    fn is_reached(&self) {
        if let Self::There(server) = self {
            server.is_reached();
        }
    }

    fn may_recover(&self, body: &[u8]) -> bool {
        let problem: Option<serde_json::Value> = serde_json::from_slice(body).ok();
        let is_recovering =
            problem.is_some_and(|problem| problem["type"] == "/problems/recovering");
        matches!(self, Self::Here(_)) && is_recovering
    }

    fn may_come_back(&self) -> bool {
        matches!(self, Self::There(_))
    }
}

/// A problem that names its status, also where a proxy has answered with a page of its own.
fn with_status(problem: String, status: StatusCode) -> String {
    if problem.trim_start().starts_with('{') {
        return problem;
    }
    let detail = format!("the server answers {status}");
    serde_json::json!({"status": status.as_u16(), "title": detail}).to_string()
}

const KEY: header::HeaderName = header::HeaderName::from_static("idempotency-key");

/// A key that no other change has.
fn key() -> String {
    Uuid::new_v4().simple().to_string()
}

/// What is said of a point.
fn contained(body: &[u8]) -> Result<(Side, Option<u64>), Failure> {
    let answer: serde_json::Value =
        serde_json::from_slice(body).map_err(|error| unreadable(&error.to_string()))?;
    let side = match answer["side"].as_str() {
        Some("inside") => Side::Inside,
        Some("boundary") => Side::Boundary,
        Some("outside") => Side::Outside,
        _ => return Err(unreadable("it does not say where the point lies")),
    };
    let holder = answer["cube"]["id"].as_u64();
    Ok((side, holder.or(answer["solid"]["id"].as_u64())))
}

pub(crate) fn unreadable(cause: &str) -> Failure {
    let detail = format!("the answer cannot be read: {cause}");
    Problem::new(Code::Internal, detail).into()
}
