//! Servers: requests over a connection.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::body::Bytes;
use axum::http::{Request, StatusCode, header};
use reqwest::{Client, Url};
use union3d::wire::problem::{Fault, Problem};
use union3d::wire::trust::Trust;

use crate::failure::Failure;
use crate::requests::unreadable;

/// A server, by the address below which its API is.
#[derive(Clone, Debug)]
pub(crate) struct Server {
    client: Client,
    base: Url,
    key: Option<Arc<str>>,
    /// Whether it has answered before: then it is worth waiting for when it is away.
    reached: Arc<AtomicBool>,
}

/// Why a request has no answer.
pub(crate) enum Unsent {
    /// Nobody was reached, or the connection broke.
    Away(Failure),
    /// It cannot be sent, or its answer cannot be read.
    Never(Failure),
}

impl Unsent {
    pub(crate) fn bad(cause: &str) -> Self {
        Self::Never(unreadable(cause))
    }
}

impl Server {
    /// A server and the name of a scene, from the address of the scene: `http://host:7373/part`.
    /// # Errors
    /// It is no such address, or `ca` is no file of certificates, to trust besides the machine's authorities.
    pub(crate) fn of_scene(
        address: &str,
        key: Option<&str>,
        ca: Option<&Path>,
    ) -> Result<(Self, String), Problem> {
        let wrong = |detail: String| {
            Problem::from(Fault {
                value: Some(address.into()),
                ..Fault::at("/url".to_owned(), detail, None)
            })
        };
        let mut base = Url::parse(address).map_err(|error| {
            wrong(format!(
                "is no address such as http://host:7373/part: {error}"
            ))
        })?;
        if !["http", "https"].contains(&base.scheme()) {
            return Err(wrong("begins with neither http:// nor https://".to_owned()));
        }
        let trust = ca.map(Trust::read).transpose().map_err(|error| {
            let detail = format!("is no file of certificates: {error}");
            Problem::from(Fault::at("/ca".to_owned(), detail, None))
        })?;
        let tls = trust.unwrap_or_default().http(base.scheme() == "https");
        let name = base
            .path_segments()
            .and_then(|mut segments| segments.next_back());
        let name = name.unwrap_or_default().to_owned();
        if name.is_empty() {
            return Err(wrong(
                "does not end with the name of a scene, as http://host:7373/part does".to_owned(),
            ));
        }
        if let Ok(mut segments) = base.path_segments_mut() {
            segments.pop();
        }
        base.set_query(None);
        base.set_fragment(None);
        let client = Client::builder()
            .tls_backend_preconfigured(tls)
            .connect_timeout(Duration::from_secs(5))
            .build()
            .map_err(|error| wrong(error.to_string()))?;
        let server = Self {
            client,
            base,
            key: key.map(Into::into),
            reached: Arc::default(),
        };
        Ok((server, name))
    }

    /// The address of a path of its API.
    pub(crate) fn address(&self, path: &str) -> String {
        format!("{}{path}", self.base.as_str().trim_end_matches('/'))
    }

    pub(crate) fn was_reached(&self) -> bool {
        self.reached.load(Ordering::Relaxed)
    }

    pub(crate) fn is_reached(&self) {
        self.reached.store(true, Ordering::Relaxed);
    }

    /// Sends a request, once.
    pub(crate) async fn send(
        &self,
        mut request: Request<Bytes>,
    ) -> Result<(StatusCode, Bytes), Unsent> {
        if let Some(key) = &self.key {
            let value = header::HeaderValue::try_from(format!("Bearer {key}"));
            let mut value =
                value.map_err(|_| Unsent::bad("the key has characters that no key has"))?;
            value.set_sensitive(true);
            request.headers_mut().insert(header::AUTHORIZATION, value);
        }
        let request = reqwest::Request::try_from(request);
        let request = request.map_err(|error| Unsent::bad(&error.to_string()))?;
        let answer = self
            .client
            .execute(request)
            .await
            .map_err(|error| self.away(&error))?;
        let status = answer.status();
        let body = answer.bytes().await.map_err(|error| self.away(&error))?;
        Ok((status, body))
    }

    fn away(&self, error: &reqwest::Error) -> Unsent {
        let mut cause: &dyn std::error::Error = error;
        while let Some(inner) = cause.source() {
            cause = inner;
        }
        let cause = cause.to_string();
        let advice = if cause.contains("certificate") {
            "ca names a file of what is trusted besides the authorities of this machine"
        } else {
            "is the server running?"
        };
        let detail = format!("cannot reach {}: {cause} ({advice})", self.base);
        let problem =
            serde_json::json!({"type": "/problems/unreachable", "status": 503, "detail": detail});
        Unsent::Away(Failure::Problem(problem.to_string()))
    }
}
