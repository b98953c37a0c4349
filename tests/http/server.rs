//! A server in this process, and short ways to ask it.

use std::future::Future;
use std::time::{Duration, Instant};

use reqwest::header::HeaderMap;
use reqwest::{Method, RequestBuilder};
use serde_json::Value;
use tempfile::TempDir;
use tokio_util::sync::CancellationToken;
use union3d::service::{FailHook, Readiness, Service, ServiceConfig};
use union3d::wire::access::Access;
use union3d::wire::door::Door;
use union3d::wire::http::{self, Limits};

use crate::described;

pub(crate) const JSON: &str = "application/json";
pub(crate) const NDJSON: &str = "application/x-ndjson";
pub(crate) const PROTOBUF: &str = "application/x-protobuf";

/// Longer than anything here takes, so that a hang is told from a slow machine.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

pub(crate) struct Server {
    pub(crate) address: String,
    pub(crate) service: Service,
    client: reqwest::Client,
    _data: TempDir,
}

pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) headers: HeaderMap,
    pub(crate) text: String,
}

impl Server {
    pub(crate) async fn start() -> Self {
        Self::with(Limits::default(), |config| config, None).await
    }

    pub(crate) async fn limited(limits: Limits) -> Self {
        Self::with(limits, |config| config, None).await
    }

    pub(crate) async fn with(
        limits: Limits,
        config: impl FnOnce(ServiceConfig) -> ServiceConfig,
        faults: Option<FailHook>,
    ) -> Self {
        let data = tempfile::tempdir().unwrap();
        Self::of(data, limits, config, faults, Access::default()).await
    }

    /// For those who may.
    pub(crate) async fn guarded(access: Access) -> Self {
        Self::guarded_on(tempfile::tempdir().unwrap(), access).await
    }

    /// The same on data that is there.
    pub(crate) async fn guarded_on(data: TempDir, access: Access) -> Self {
        Self::of(data, Limits::default(), |config| config, None, access).await
    }

    async fn of(
        data: TempDir,
        limits: Limits,
        config: impl FnOnce(ServiceConfig) -> ServiceConfig,
        faults: Option<FailHook>,
        access: Access,
    ) -> Self {
        union3d::wire::trust::install_provider();
        let config = config(ServiceConfig::new(data.path()));
        let service = match faults {
            Some(faults) => Service::start_with_failpoints(config, faults).unwrap(),
            None => Service::start(config).unwrap(),
        };
        eventually("the service is ready", || {
            let ready = matches!(service.readiness(), Readiness::Ready { .. });
            async move { ready }
        })
        .await;
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let serving = http::serve(
            Door::default(),
            listener,
            service.clone(),
            limits,
            access,
            CancellationToken::new(),
        );
        tokio::spawn(serving);
        Self {
            address,
            service,
            client: reqwest::Client::new(),
            _data: data,
        }
    }

    pub(crate) fn request(&self, method: &str, path: &str) -> RequestBuilder {
        let method = Method::from_bytes(method.as_bytes()).unwrap();
        let url = format!("http://{}{path}", self.address);
        self.client.request(method, url).timeout(PATIENCE)
    }

    pub(crate) async fn get(&self, path: &str) -> Answer {
        send(self.request("GET", path)).await
    }

    pub(crate) async fn send(&self, method: &str, path: &str, kind: &str, body: &str) -> Answer {
        let request = self.request(method, path).header("content-type", kind);
        send(request.body(body.to_owned())).await
    }

    /// Creates a scene of cubes of this edge, one step a unit.
    pub(crate) async fn scene(&self, name: &str, edge: u32) -> String {
        let settings = format!("{{\"edge\":{edge},\"steps_per_unit\":1}}");
        self.scene_with(name, &settings).await
    }

    /// Creates a scene and answers its path.
    pub(crate) async fn scene_with(&self, name: &str, settings: &str) -> String {
        let path = format!("/v1/scenes/{name}");
        let answer = self.send("PUT", &path, JSON, settings).await;
        assert_eq!(answer.status, 201, "{}", answer.text);
        path
    }

    pub(crate) async fn change(&self, scene: &str, body: &str) -> Answer {
        let path = format!("{scene}/changes");
        self.send("POST", &path, JSON, body).await
    }

    pub(crate) async fn lines(&self, scene: &str, body: &str) -> Answer {
        let path = format!("{scene}/changes");
        self.send("POST", &path, NDJSON, body).await
    }

    pub(crate) async fn totals(&self, scene: &str) -> Value {
        let answer = self.get(&format!("{scene}/mass-properties")).await;
        assert_eq!(answer.status, 200, "{}", answer.text);
        answer.json()
    }
}

/// Sends a request. Whatever is answered must be what the description of the API says.
pub(crate) async fn send(request: RequestBuilder) -> Answer {
    let (client, request) = request.build_split();
    let request = request.unwrap();
    let (method, url) = (request.method().clone(), request.url().clone());
    let response = client.execute(request).await.unwrap();
    let answer = Answer {
        status: response.status().as_u16(),
        headers: response.headers().clone(),
        text: response.text().await.unwrap(),
    };
    described::check(&client, &method, &url, &answer).await;
    answer
}

impl Answer {
    pub(crate) fn json(&self) -> Value {
        serde_json::from_str(&self.text).unwrap_or_else(|_| panic!("no JSON: {}", self.text))
    }

    pub(crate) fn header(&self, name: &str) -> &str {
        let value = self.headers.get(name);
        value.map_or("", |value| value.to_str().unwrap())
    }

    /// The JSON of an answer that went well.
    #[track_caller]
    pub(crate) fn ok(&self) -> Value {
        assert_eq!(self.status, 200, "{}", self.text);
        self.json()
    }

    /// Checks that this is a problem as RFC 9457 and this API promise it, and answers the document.
    #[track_caller]
    pub(crate) fn problem(&self, status: u16, code: &str) -> Value {
        assert_eq!(self.status, status, "{}", self.text);
        assert_eq!(self.header("content-type"), "application/problem+json");
        let document = self.json();
        assert_eq!(document["type"], format!("/problems/{code}"), "{document}");
        assert_eq!(document["status"], status, "{document}");
        for member in ["title", "detail"] {
            assert!(document[member].is_string(), "no {member} in {document}");
        }
        document
    }

    /// The places at fault of a 422.
    #[track_caller]
    pub(crate) fn places(&self) -> Vec<String> {
        let document = self.problem(422, "invalid");
        let errors = document["errors"].as_array().unwrap().iter();
        errors
            .map(|error| {
                assert!(error["detail"].is_string());
                let place = error.get("pointer").or(error.get("parameter"));
                place.unwrap().as_str().unwrap().to_owned()
            })
            .collect()
    }
}

/// Waits until something holds.
pub(crate) async fn eventually<F: Future<Output = bool>>(what: &str, mut holds: impl FnMut() -> F) {
    let deadline = Instant::now() + PATIENCE;
    while !holds().await {
        assert!(Instant::now() < deadline, "in vain: {what}");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}
