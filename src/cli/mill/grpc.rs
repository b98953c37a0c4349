//! A program on its way over gRPC: a window of changes in flight, sent again when the connection breaks.

use std::collections::VecDeque;
use std::error::Error;
use std::time::{Duration, Instant};

use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Request, Status, Streaming};
use uuid::Uuid;

use super::super::client::{PATIENCE, SceneWanted, causes, unreached};
use super::super::credentials::{ADVICE, Credentials};
use super::line::Material;
use union3d::wire::grpc::Missing;
use union3d::wire::proto::union_service_client::UnionServiceClient;
use union3d::wire::proto::{
    Box as Block, Change, CreateSceneRequest, Detail, GetMassPropertiesRequest,
    GetMassPropertiesResponse, ListCubesRequest, Outcome, SceneSettings, StreamChangesRequest,
    StreamChangesResponse, StreamOpening, StreamedChange, Volumes,
    stream_changes_request as request, stream_changes_response as response,
};

/// The calls of a server.
pub(super) type Client = UnionServiceClient<InterceptedService<Channel, Bearer>>;

/// Shows the key with every call.
#[derive(Clone)]
pub(super) struct Bearer(Option<MetadataValue<Ascii>>);

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> tonic::Result<Request<()>> {
        if let Some(key) = &self.0 {
            request.metadata_mut().insert("authorization", key.clone());
        }
        Ok(request)
    }
}

/// Changes sent ahead of their acknowledgements: as many as the server takes in.
const IN_FLIGHT_MAX: usize = 256;

/// The first and the longest pause before it is tried again.
const PAUSE_MIN: Duration = Duration::from_millis(20);
const PAUSE_MAX: Duration = Duration::from_secs(1);

/// How long is waited for the end of a stream in which all is acknowledged.
const END_PATIENCE: Duration = Duration::from_secs(5);

/// Why the server did not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    /// The address is no address.
    #[error("{server:?} is no address of a server: {cause} (try grpc://127.0.0.1:7374)")]
    Address { server: String, cause: String },
    /// Nobody answers.
    #[error("cannot reach {server}: {cause} ({})", unreached(cause))]
    Unreachable { server: String, cause: String },
    /// It answers with an error.
    #[error("{server}: {}{}", status.message(), advice(status))]
    Refused { server: String, status: Status },
    /// Its answer cannot be read.
    #[error("{server} answers without {0} (is it of the same version?)", missing)]
    Unreadable {
        server: String,
        missing: &'static str,
    },
}

/// What to do about a server that does not let one in.
fn advice(status: &Status) -> &'static str {
    if status.code() == Code::Unauthenticated {
        ADVICE
    } else {
        ""
    }
}

/// What is left of the patience with a server.
///
/// Only an acknowledgement restores it, not a stream that opens: else a change that breaks every stream would be sent for ever.
#[derive(Debug, Default)]
struct Patience {
    /// When the connection broke for the first time since the last acknowledgement.
    broken_since: Option<Instant>,
    pause: Duration,
}

impl Patience {
    /// How long to wait before the next attempt, each time longer; none when it has come to its end.
    fn pause(&mut self, now: Instant) -> Option<Duration> {
        let since = *self.broken_since.get_or_insert(now);
        if now - since >= PATIENCE {
            return None;
        }
        self.pause = (self.pause * 2).clamp(PAUSE_MIN, PAUSE_MAX);
        Some(self.pause)
    }
}

/// A change that has been sent and not been acknowledged, and what it is for its sender.
struct Sent<T> {
    what: T,
    message: StreamedChange,
}

/// A change that has been acknowledged.
pub(super) struct Done<T> {
    /// What it is for its sender.
    pub(super) what: T,
    pub(super) outcome: Outcome,
    /// What it removed itself: others may change the scene too.
    pub(super) removed: i128,
    /// The state after it.
    pub(super) after: Material,
}

/// A scene of a server, and the stream of changes into it. `T` is what each change is for its sender.
pub(super) struct GrpcStream<T> {
    server: String,
    scene: String,
    client: Client,
    to: mpsc::Sender<StreamChangesRequest>,
    from: Streaming<StreamChangesResponse>,
    in_flight: VecDeque<Sent<T>>,
    patience: Patience,
    /// Names this run in the keys of its changes, so that those sent twice act once.
    run: Uuid,
    sent: u64,
}

/// A connection to a server.
pub(super) async fn connect(server: &str, credentials: &Credentials) -> Result<Client, Failure> {
    let address = |cause: String| Failure::Address {
        server: server.to_owned(),
        cause,
    };
    let url = match server.strip_prefix("grpc://") {
        Some(rest) => format!("http://{rest}"),
        None => match server.strip_prefix("grpcs://") {
            Some(rest) => format!("https://{rest}"),
            None => server.to_owned(),
        },
    };
    let is_tls = url.starts_with("https://");
    let mut endpoint = Endpoint::from_shared(url)
        .map_err(|error| address(error.to_string()))?
        .connect_timeout(Duration::from_secs(5));
    if is_tls {
        endpoint = endpoint
            .tls_config(credentials.trust.grpc())
            .map_err(|error| address(causes(&error)))?;
    }
    let channel = endpoint
        .connect()
        .await
        .map_err(|error| Failure::Unreachable {
            server: server.to_owned(),
            cause: causes(&error),
        })?;
    let key = credentials.authorization.as_ref().map(|key| {
        let mut value = MetadataValue::try_from(key.as_bytes()).expect("it was a header before");
        value.set_sensitive(true);
        value
    });
    Ok(UnionServiceClient::with_interceptor(channel, Bearer(key)))
}

/// What a server says against a call.
pub(super) fn refused(server: &str) -> impl Fn(Status) -> Failure {
    move |status| Failure::Refused {
        server: server.to_owned(),
        status,
    }
}

/// Opens the scene of cubes that is wanted, made if it is not there, and answers the largest id in it; 0 when it is empty.
pub(super) async fn open_cubes(
    client: &mut Client,
    server: &str,
    wanted: &SceneWanted,
) -> Result<u64, Failure> {
    let refused = refused(server);
    let settings = SceneSettings {
        edge: wanted.edge,
        steps_per_unit: Some(wanted.steps_per_unit),
        unit: Some(wanted.unit.clone()),
        stock: wanted.stock.map(|stock| Block {
            min: Some(stock.min.into()),
            max: Some(stock.max.into()),
        }),
        ..SceneSettings::default()
    };
    let create = CreateSceneRequest {
        scene: wanted.name.clone(),
        settings: Some(settings),
        solids: None,
    };
    client.create_scene(create).await.map_err(&refused)?;
    let properties = client
        .get_mass_properties(GetMassPropertiesRequest {
            scene: wanted.name.clone(),
            ..GetMassPropertiesRequest::default()
        })
        .await
        .map_err(&refused)?
        .into_inner()
        .mass_properties;
    let mut largest_id = 0;
    if properties.as_ref().is_some_and(|scene| scene.cubes > 0) {
        let request = ListCubesRequest {
            scene: wanted.name.clone(),
        };
        let mut cubes = client
            .list_cubes(request)
            .await
            .map_err(&refused)?
            .into_inner();
        while let Some(page) = cubes.message().await.map_err(&refused)? {
            let ids = page.cubes.into_iter().flat_map(|cubes| cubes.insert_id);
            largest_id = ids.fold(largest_id, u64::max);
        }
    }
    Ok(largest_id)
}

impl<T> GrpcStream<T> {
    /// Opens a stream into a scene that is there.
    pub(super) async fn open(
        server: &str,
        mut client: Client,
        scene: &str,
    ) -> Result<Self, Failure> {
        let (to, from) = stream(&mut client, scene).await.map_err(refused(server))?;
        Ok(Self {
            server: server.to_owned(),
            scene: scene.to_owned(),
            client,
            to,
            from,
            in_flight: VecDeque::new(),
            patience: Patience::default(),
            run: Uuid::new_v4(),
            sent: 0,
        })
    }

    /// The calls of its server.
    pub(super) fn client(&mut self) -> &mut Client {
        &mut self.client
    }

    /// Sends a change; answers those that were acknowledged meanwhile.
    pub(super) async fn send(&mut self, what: T, change: Change) -> Result<Vec<Done<T>>, Failure> {
        self.sent += 1;
        let message = StreamedChange {
            tag: self.sent,
            change: Some(change),
            idempotency_key: Some(format!("{}-{}", self.run.simple(), self.sent)),
        };
        let mut done = Vec::new();
        while self.in_flight.len() >= IN_FLIGHT_MAX {
            done.extend(self.acknowledged().await?);
        }
        let sent = request::Message::Change(message.clone());
        self.in_flight.push_back(Sent { what, message });
        // There is room for all that is in flight; when the channel is closed, reading says why and sends all again.
        drop(self.to.try_send(StreamChangesRequest {
            message: Some(sent),
        }));
        Ok(done)
    }

    /// Waits for all that is in flight, and reads what the scene measures then.
    pub(super) async fn finish(
        mut self,
    ) -> Result<(Vec<Done<T>>, GetMassPropertiesResponse), Failure> {
        let mut done = Vec::new();
        while !self.in_flight.is_empty() {
            done.extend(self.acknowledged().await?);
        }
        // The stream ends as both sides know it: else the server cannot tell a client that has all from one that was lost.
        self.to = mpsc::channel(1).0;
        let rest = async { while let Ok(Some(_)) = self.from.message().await {} };
        // What was acknowledged stands, also when a server does not end the stream.
        drop(tokio::time::timeout(END_PATIENCE, rest).await);
        let request = GetMassPropertiesRequest {
            scene: self.scene.clone(),
            ..GetMassPropertiesRequest::default()
        };
        let answer = self.client.get_mass_properties(request).await;
        let answer = answer.map_err(|status| self.refused(status))?;
        Ok((done, answer.into_inner()))
    }

    async fn acknowledged(&mut self) -> Result<Option<Done<T>>, Failure> {
        let answer = self.from.message().await;
        self.read(answer).await
    }

    /// What an answer says; a connection that broke is made anew.
    async fn read(
        &mut self,
        answer: Result<Option<StreamChangesResponse>, Status>,
    ) -> Result<Option<Done<T>>, Failure> {
        let message = match answer {
            Ok(Some(answer)) => answer.message,
            Ok(None) => {
                let ended = Status::unavailable("the stream ended before all was acknowledged");
                return self.connect_again(ended).await.map(|()| None);
            }
            Err(status) if away(&status) => {
                return self.connect_again(status).await.map(|()| None);
            }
            Err(status) => return Err(self.refused(status)),
        };
        match message {
            Some(response::Message::Acknowledged(acknowledged)) => {
                let outcome = acknowledged.outcome.unwrap_or_default();
                let after = outcome.volumes.as_ref().and_then(state_of_volumes);
                let after = after.ok_or_else(|| self.without("volumes"))?;
                let oldest = self.in_flight.pop_front();
                let oldest = oldest.filter(|sent| sent.message.tag == acknowledged.tag);
                let oldest = oldest.ok_or_else(|| self.without("the order of what was sent"))?;
                self.patience = Patience::default();
                let removed = outcome.volume_removed_exact.parse();
                let removed = removed.map_err(|_| self.without("what the change removed"))?;
                Ok(Some(Done {
                    what: oldest.what,
                    outcome,
                    removed,
                    after,
                }))
            }
            Some(response::Message::Refused(refused)) => {
                let problem = refused.problem.unwrap_or_default();
                if problem.retry_after_seconds.is_some() {
                    let busy = Status::unavailable(problem.detail);
                    return self.connect_again(busy).await.map(|()| None);
                }
                let mut sent = self.in_flight.iter();
                let sent = sent.find(|sent| sent.message.tag == refused.tag);
                let change = sent.and_then(|sent| sent.message.change.as_ref());
                // What a program sends names the line as its move.
                let line = change.and_then(|change| change.r#move);
                let line = line.map_or_else(String::new, |line| format!("line {line}: "));
                let detail = format!("{line}{}", problem.detail);
                Err(self.refused(Status::failed_precondition(detail)))
            }
            Some(response::Message::Opened(_)) | None => Ok(None),
        }
    }

    /// Opens a stream anew, once the server is back, and sends again what was not acknowledged: the same cubes with the same ids
    /// and keys, so that what was applied all the same is not applied twice. `cause` is why.
    async fn connect_again(&mut self, mut cause: Status) -> Result<(), Failure> {
        loop {
            let Some(pause) = self.patience.pause(Instant::now()) else {
                return Err(self.refused(cause));
            };
            tokio::time::sleep(pause).await;
            match stream(&mut self.client, &self.scene).await {
                Ok((to, from)) => {
                    (self.to, self.from) = (to, from);
                    break;
                }
                Err(status) if away(&status) => cause = status,
                Err(status) => return Err(self.refused(status)),
            }
        }
        for sent in &self.in_flight {
            let message = Some(request::Message::Change(sent.message.clone()));
            // The channel has room for all of them; when it is closed, reading will say why.
            drop(self.to.try_send(StreamChangesRequest { message }));
        }
        Ok(())
    }

    fn refused(&self, status: Status) -> Failure {
        refused(&self.server)(status)
    }

    fn without(&self, missing: &'static str) -> Failure {
        without(&self.server)(missing)
    }
}

/// What is missing from an answer of a server.
pub(super) fn without(server: &str) -> impl Fn(&'static str) -> Failure {
    move |missing| Failure::Unreadable {
        server: server.to_owned(),
        missing,
    }
}

/// What an answer is made of, or what is missing from it.
pub(super) fn read<M: TryInto<P, Error = Missing>, P>(
    server: &str,
    message: Option<M>,
) -> Result<P, Failure> {
    let message = message.ok_or_else(|| without(server)("mass properties"))?;
    let read = message.try_into();
    read.map_err(|Missing(name)| without(server)(name))
}

/// A stream into a scene, opened.
async fn stream(
    client: &mut Client,
    scene: &str,
) -> Result<
    (
        mpsc::Sender<StreamChangesRequest>,
        Streaming<StreamChangesResponse>,
    ),
    Status,
> {
    let (to, requests) = mpsc::channel(IN_FLIGHT_MAX + 1);
    let opening = StreamOpening {
        scene: scene.to_owned(),
        detail: Detail::Volume.into(),
        ..StreamOpening::default()
    };
    let opening = StreamChangesRequest {
        message: Some(request::Message::Opening(opening)),
    };
    drop(to.try_send(opening));
    let from = client.stream_changes(ReceiverStream::new(requests)).await?;
    Ok((to, from.into_inner()))
}

/// Whether the server is away or not ready, rather than against it.
fn away(status: &Status) -> bool {
    match status.code() {
        Code::Unavailable | Code::Unknown | Code::Cancelled => true,
        // Said by the server it is final. With a source it was made here, of a connection that broke: so ends one that the server
        // had announced to close.
        Code::Internal => status.source().is_some(),
        _ => false,
    }
}

fn state_of_volumes(volumes: &Volumes) -> Option<Material> {
    let removed = volumes.exact_removed.as_ref();
    Some(Material {
        removed: removed.unwrap_or(&volumes.exact_union).parse().ok()?,
        area: volumes.exact_area.parse().ok()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patience_ends_though_streams_open() {
        let (mut patience, start) = (Patience::default(), Instant::now());
        let (mut waited, mut attempts) = (Duration::ZERO, 0);
        while let Some(pause) = patience.pause(start + waited) {
            (waited, attempts) = (waited + pause, attempts + 1);
        }
        assert!(waited >= PATIENCE && waited < PATIENCE + PAUSE_MAX);
        assert!(attempts < 40, "{attempts}");
    }

    #[test]
    fn what_the_server_says_of_itself_is_final() {
        assert!(away(&Status::unavailable("shutting down")));
        assert!(!away(&Status::internal("a fault")));
        assert!(!away(&Status::failed_precondition("no")));
    }
}
