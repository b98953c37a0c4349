//! A client of the public HTTP API: makes a scene, streams cubes into it, reads what they measure.

use std::time::{Duration, Instant};

use bytes::Bytes;
use prost::Message;
use reqwest::{StatusCode, Url, header};
use serde::Serialize;
use serde_json::{Value, json, value::RawValue};

use super::credentials::{ADVICE, Credentials};
use union3d::geometry::Place;
use union3d::wire::convert::{SettingsDocument, StockDocument};
use union3d::wire::proto::{Change, ChangeBatch};
use union3d::wire::solids::ShapeDocument;

/// How long a server that cannot be reached, cannot answer yet, or acknowledges nothing more, is tried again.
pub(crate) const PATIENCE: Duration = Duration::from_secs(30);

/// Why the server did not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    /// The address is no address.
    #[error("{server:?} is no address of a server: {cause} (try http://127.0.0.1:7373)")]
    Address { server: String, cause: String },
    /// Nobody answers.
    #[error("cannot reach {url}: {cause} ({})", unreached(cause))]
    Unreachable { url: Url, cause: String },
    /// It answers with a problem.
    #[error("{url} answers {status}: {detail}{}", advice(*status))]
    Refused {
        url: Url,
        status: StatusCode,
        detail: String,
        /// Of a batch: which change is at fault.
        change: Option<u16>,
    },
    /// The scene cannot take these cubes.
    #[error(
        "scene {scene:?} exists with {name} {there}, these cubes need {wanted}: choose another --scene, or the same {name}"
    )]
    OtherScene {
        scene: String,
        name: &'static str,
        there: String,
        wanted: String,
    },
    /// Its answer cannot be read.
    #[error(
        "cannot make sense of the answer of {url}: {cause} (is this a union3d server of the same version?)"
    )]
    Unreadable { url: Url, cause: String },
}

/// What the scene must be like for these cubes.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct SceneWanted {
    /// Its name.
    pub(crate) name: String,
    /// Edge of its cubes, in user units.
    pub(crate) edge: f64,
    /// Lattice steps in a user unit.
    pub(crate) steps_per_unit: u32,
    /// Label of the user unit.
    pub(crate) unit: String,
    /// The block of material, if any.
    pub(crate) stock: Option<StockDocument>,
}

impl SceneWanted {
    /// The settings to make it with.
    fn settings(&self) -> SettingsDocument {
        SettingsDocument {
            steps_per_unit: self.steps_per_unit.into(),
            unit: self.unit.clone(),
            stock: self.stock,
            ..SettingsDocument::with_edge(self.edge)
        }
    }
}

/// One scene of one server.
#[derive(Clone, Debug)]
pub(crate) struct Client {
    http: reqwest::Client,
    scene: Url,
    /// Whether the server has answered before: then it is worth waiting for when it is away.
    reached: bool,
}

impl Client {
    /// The scene that is wanted, made if it is not there, and the largest id in it (0 when it is empty).
    pub(crate) async fn open(
        server: &str,
        credentials: &Credentials,
        wanted: &SceneWanted,
    ) -> Result<(Self, u64), Failure> {
        let mut this = Self::of(server, credentials, &wanted.name)?;
        let Some(there) = this.describe().await? else {
            this.create(&wanted.settings()).await?;
            return Ok((this, 0));
        };
        compare(wanted, &there)?;
        let largest = if field(&there, "cubes").as_u64() == Some(0) {
            0
        } else {
            this.largest_id().await?
        };
        Ok((this, largest))
    }

    /// A scene of a server, whether or not it is there.
    pub(crate) fn of(
        server: &str,
        credentials: &Credentials,
        scene_name: &str,
    ) -> Result<Self, Failure> {
        let address = |cause: String| Failure::Address {
            server: server.to_owned(),
            cause,
        };
        let server_url = Url::parse(server).map_err(|error| address(error.to_string()))?;
        let scheme = server_url.scheme();
        if !["http", "https"].contains(&scheme) {
            return Err(address(
                "it begins with neither http:// nor https://".to_owned(),
            ));
        }
        let tls = credentials.trust.http(scheme == "https");
        let mut scene = server_url;
        scene
            .path_segments_mut()
            .map_err(|()| address("it has no path".to_owned()))?
            .pop_if_empty()
            .extend(["v1", "scenes", scene_name]);
        let authorization = credentials.authorization.clone().into_iter();
        let http = reqwest::Client::builder()
            .tls_backend_preconfigured(tls)
            .connect_timeout(Duration::from_secs(5))
            .default_headers(
                authorization
                    .map(|key| (header::AUTHORIZATION, key))
                    .collect(),
            )
            .build()
            .map_err(|error| address(causes(&error)))?;
        Ok(Self {
            http,
            scene,
            reached: false,
        })
    }

    /// What the server says of the scene; none when it is not there.
    pub(crate) async fn describe(&mut self) -> Result<Option<Value>, Failure> {
        let request = self.http.get(self.scene.clone());
        let answer = self.ask(request).await;
        self.reached = true;
        match answer {
            Ok(text) => parse(&self.scene, &text).map(Some),
            Err(Failure::Refused { status, .. }) if status == StatusCode::NOT_FOUND => Ok(None),
            Err(failure) => Err(failure),
        }
    }

    /// Makes the scene.
    pub(crate) async fn create(&self, settings: &impl Serialize) -> Result<(), Failure> {
        let request = self.http.put(self.scene.clone()).json(settings);
        self.ask(request).await.map(drop)
    }

    /// Defines a shape of the scene; one that is there already stays as it is, and another of its name is refused.
    pub(crate) async fn define(&self, name: &str, shape: &ShapeDocument) -> Result<(), Failure> {
        let mut url = self.below("shapes");
        if let Ok(mut segments) = url.path_segments_mut() {
            segments.push(name);
        }
        let request = self.http.put(url).json(shape);
        self.ask(request).await.map(drop)
    }

    /// Address of the scene.
    pub(crate) fn url(&self) -> &Url {
        &self.scene
    }

    /// Its mass properties as the server wrote them.
    pub(crate) async fn mass_properties(&self) -> Result<Box<RawValue>, Failure> {
        let url = self.below("mass-properties");
        let text = self.ask(self.http.get(url.clone())).await?;
        RawValue::from_string(text).map_err(|error| Failure::Unreadable {
            url,
            cause: error.to_string(),
        })
    }

    /// Inserts cubes with the ids from `first_id` on, durably, and answers the mass properties after it. Sent again it changes
    /// nothing, so a lost answer is no harm.
    pub(crate) async fn insert_and_measure(
        &self,
        first_id: u64,
        places: &[Place],
    ) -> Result<Value, Failure> {
        let mut answer = self.change(&inserted(first_id, places)).await?;
        Ok(answer["mass_properties"].take())
    }

    /// Applies a change, durably. Sent again it must change nothing.
    async fn change(&self, change: &Change) -> Result<Value, Failure> {
        let url = self.below("changes");
        let text = self.ask(self.message(url.clone(), change)).await?;
        parse(&url, &text)
    }

    /// Applies changes one after the other, durably; answers what each did. Their keys make a second sending harmless.
    pub(crate) async fn batch(&self, batch: &ChangeBatch) -> Result<Vec<Value>, Failure> {
        #[derive(serde::Deserialize)]
        struct Answer {
            outcomes: Vec<Value>,
        }
        let url = self.below("changes/batch");
        let text = self.ask(self.message(url.clone(), batch)).await?;
        let answer = serde_json::from_str(&text);
        let Answer { outcomes } = answer.map_err(|error| unreadable(&url, &error))?;
        Ok(outcomes)
    }

    fn message(&self, url: Url, message: &impl Message) -> reqwest::RequestBuilder {
        self.http
            .post(url)
            .header(header::CONTENT_TYPE, "application/x-protobuf")
            .body(Bytes::from(message.encode_to_vec()))
    }

    /// The largest id in the scene, from the listing of all its cubes.
    async fn largest_id(&self) -> Result<u64, Failure> {
        let url = self.below("cubes");
        let request = self
            .http
            .get(url.clone())
            .header(header::ACCEPT, "application/x-ndjson");
        let mut answer = self.send(request).await?;
        let unreadable = |cause: String| Failure::Unreadable {
            url: url.clone(),
            cause,
        };
        let (mut largest, mut rest) = (0, Vec::new());
        loop {
            let piece = answer
                .chunk()
                .await
                .map_err(|error| unreadable(causes(&error)))?;
            rest.extend_from_slice(piece.as_deref().unwrap_or(b"\n"));
            let whole = rest
                .iter()
                .rposition(|byte| *byte == b'\n')
                .map_or(0, |end| end + 1);
            for line in rest[..whole].split(|byte| *byte == b'\n') {
                if !line.trim_ascii().is_empty() {
                    let cube: Value = serde_json::from_slice(line)
                        .map_err(|error| unreadable(error.to_string()))?;
                    let id = cube["insert"]["id"].as_u64();
                    largest =
                        largest.max(id.ok_or_else(|| unreadable("a cube without id".into()))?);
                }
            }
            rest.drain(..whole);
            if piece.is_none() {
                return Ok(largest);
            }
        }
    }

    /// A copy of its log, as it comes.
    pub(crate) async fn backup(&self) -> Result<reqwest::Response, Failure> {
        self.send(self.http.get(self.below("backup"))).await
    }

    /// Its mesh, as it comes.
    pub(crate) async fn mesh(
        &self,
        query: &[(&str, String)],
    ) -> Result<reqwest::Response, Failure> {
        let mut url = self.below("mesh");
        url.query_pairs_mut().extend_pairs(query);
        self.send(self.http.get(url)).await
    }

    /// Names of the server's scenes.
    pub(crate) async fn scene_names(
        server: &str,
        credentials: &Credentials,
    ) -> Result<Vec<String>, Failure> {
        #[derive(serde::Deserialize)]
        struct List {
            scenes: Vec<Named>,
        }
        #[derive(serde::Deserialize)]
        struct Named {
            name: String,
        }
        let mut this = Self::of(server, credentials, "")?;
        if let Ok(mut segments) = this.scene.path_segments_mut() {
            segments.pop_if_empty();
        }
        let url = this.scene.clone();
        let text = this.ask(this.http.get(url.clone())).await?;
        let list: List = serde_json::from_str(&text).map_err(|error| Failure::Unreadable {
            url,
            cause: error.to_string(),
        })?;
        Ok(list.scenes.into_iter().map(|named| named.name).collect())
    }

    fn below(&self, name: &str) -> Url {
        let mut url = self.scene.clone();
        if let Ok(mut segments) = url.path_segments_mut() {
            segments.extend(name.split('/'));
        }
        url
    }

    async fn ask(&self, request: reqwest::RequestBuilder) -> Result<String, Failure> {
        let answer = self.send(request).await?;
        let url = answer.url().clone();
        answer.text().await.map_err(|error| Failure::Unreadable {
            url,
            cause: causes(&error),
        })
    }

    /// Sends a request until it is answered: a full queue is waited for as long as it takes, a server that is away or not
    /// ready for a while. Every request of this client may be repeated.
    async fn send(&self, request: reqwest::RequestBuilder) -> Result<reqwest::Response, Failure> {
        let started = Instant::now();
        loop {
            let attempt = request.try_clone().expect("no body is a stream");
            let wait = match attempt.send().await {
                Ok(answer) if answer.status().is_success() => return Ok(answer),
                Ok(answer) => {
                    let patient = match answer.status() {
                        StatusCode::TOO_MANY_REQUESTS => true,
                        StatusCode::SERVICE_UNAVAILABLE => started.elapsed() < PATIENCE,
                        _ => false,
                    };
                    if !patient {
                        return Err(refusal(answer).await);
                    }
                    retry_after(&answer)
                }
                Err(error)
                    if self.reached && !error.is_builder() && started.elapsed() < PATIENCE =>
                {
                    Duration::from_millis(200)
                }
                Err(error) => {
                    return Err(Failure::Unreachable {
                        url: error.url().unwrap_or(&self.scene).clone(),
                        cause: causes(&error),
                    });
                }
            };
            tokio::time::sleep(wait).await;
        }
    }
}

/// A change that inserts cubes with the ids from `first_id` on.
pub(crate) fn inserted(first_id: u64, places: &[Place]) -> Change {
    let column = |axis: usize| places.iter().map(|place| place.corner()[axis]).collect();
    Change {
        insert_id: (first_id..).take(places.len()).collect(),
        x: column(0),
        y: column(1),
        z: column(2),
        ..Change::default()
    }
}

fn parse(url: &Url, text: &str) -> Result<Value, Failure> {
    serde_json::from_str(text).map_err(|error| unreadable(url, &error))
}

fn unreadable(url: &Url, error: &serde_json::Error) -> Failure {
    Failure::Unreadable {
        url: url.clone(),
        cause: error.to_string(),
    }
}

/// Whether a scene that is there can take the cubes.
fn compare(wanted: &SceneWanted, there: &Value) -> Result<(), Failure> {
    let settings = [
        ("edge", json!(wanted.edge)),
        ("steps_per_unit", json!(wanted.steps_per_unit)),
        ("unit", json!(wanted.unit)),
        ("stock", json!(wanted.stock)),
    ];
    for (name, value) in settings {
        let found = field(there, name);
        let equal = match (found.as_f64(), value.as_f64()) {
            (Some(found), Some(value)) => (found - value).abs() <= value.abs() * 1e-12,
            _ => *found == value,
        };
        if !equal {
            return Err(Failure::OtherScene {
                scene: wanted.name.clone(),
                name,
                there: found.to_string(),
                wanted: value.to_string(),
            });
        }
    }
    Ok(())
}

/// A field of a scene's description, whether its settings stand by themselves or not.
fn field<'value>(scene: &'value Value, name: &str) -> &'value Value {
    match &scene[name] {
        Value::Null => &scene["settings"][name],
        found => found,
    }
}

/// What to do about a server that cannot be reached.
pub(crate) fn unreached(cause: &str) -> &'static str {
    if cause.contains("certificate") {
        "--ca FILE names what is trusted besides the authorities of this machine"
    } else {
        "is the server running? `union3d serve` starts one"
    }
}

/// What to do about a server that does not let one in.
fn advice(status: StatusCode) -> &'static str {
    if status == StatusCode::UNAUTHORIZED {
        ADVICE
    } else {
        ""
    }
}

async fn refusal(answer: reqwest::Response) -> Failure {
    let (url, status) = (answer.url().clone(), answer.status());
    let text = answer.text().await.unwrap_or_default();
    let problem: Value = serde_json::from_str(&text).unwrap_or_default();
    let detail = problem["detail"]
        .as_str()
        .or(problem["title"].as_str())
        .unwrap_or(text.trim());
    Failure::Refused {
        url,
        status,
        detail: detail.to_owned(),
        change: problem["change"]
            .as_u64()
            .and_then(|index| index.try_into().ok()),
    }
}

fn retry_after(answer: &reqwest::Response) -> Duration {
    let seconds = answer
        .headers()
        .get(header::RETRY_AFTER)
        .and_then(|value| value.to_str().ok()?.parse().ok());
    Duration::from_secs(seconds.unwrap_or(1)).max(Duration::from_millis(100))
}

/// The innermost cause of an error: the outermost alone says little.
pub(crate) fn causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        text = cause.to_string();
        next = cause.source();
    }
    text
}
