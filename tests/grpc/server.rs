//! A server of both APIs, and clients of both.

use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Status};
use tonic_types::StatusExt;
use union3d::service::{FailHook, Readiness, Service, ServiceConfig};
use union3d::wire::access::Access;
use union3d::wire::door::Door;
use union3d::wire::http::Limits;
use union3d::wire::proto::union_service_client::UnionServiceClient;
use union3d::wire::proto::{
    ApplyChangeRequest, Change, CreateSceneRequest, Detail, GetMassPropertiesRequest,
    MassProperties, Outcome, SceneSettings,
};
use union3d::wire::{grpc, http};

/// How long is waited for what must come: so long that a hang is told from a slow machine.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

pub(crate) type Client = UnionServiceClient<Channel>;

pub(crate) struct Server {
    pub(crate) http: String,
    pub(crate) grpc: String,
    pub(crate) service: Service,
    pub(crate) draining: CancellationToken,
    pub(crate) serving: JoinHandle<()>,
    pub(crate) client: Client,
    /// Over HTTP. Kept: each new one reads the certificates of the machine's authorities.
    web: reqwest::Client,
    data: TempDir,
}

impl Server {
    pub(crate) async fn start() -> Self {
        Self::with(Limits::default(), |config| config, None).await
    }

    pub(crate) async fn with(
        limits: Limits,
        config: impl FnOnce(ServiceConfig) -> ServiceConfig,
        faults: Option<FailHook>,
    ) -> Self {
        let data = tempfile::tempdir().unwrap();
        let config = config(ServiceConfig::new(data.path()));
        Self::on(data, limits, config, faults, true).await
    }

    /// A server on data that is there, whether or not it is ready.
    pub(crate) async fn on(
        data: TempDir,
        limits: Limits,
        config: ServiceConfig,
        faults: Option<FailHook>,
        wait: bool,
    ) -> Self {
        Self::of(data, limits, config, faults, wait, Access::default()).await
    }

    /// For those who may.
    pub(crate) async fn guarded(access: Access) -> Self {
        let data = tempfile::tempdir().unwrap();
        let config = ServiceConfig::new(data.path());
        Self::of(data, Limits::default(), config, None, true, access).await
    }

    async fn of(
        data: TempDir,
        limits: Limits,
        config: ServiceConfig,
        faults: Option<FailHook>,
        wait: bool,
        access: Access,
    ) -> Self {
        union3d::wire::trust::install_provider();
        let service = match faults {
            Some(faults) => Service::start_with_failpoints(config, faults).unwrap(),
            None => Service::start(config).unwrap(),
        };
        if wait {
            eventually("the service is ready", async || {
                matches!(service.readiness(), Readiness::Ready { .. })
            })
            .await;
        }
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let http = format!("http://{}", listener.local_addr().unwrap());
        let (door, draining) = (Door::default(), CancellationToken::new());
        let served = http::serve(
            door.clone(),
            listener,
            service.clone(),
            limits,
            access.clone(),
            draining.clone(),
        );
        tokio::spawn(served);
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let grpc = format!("http://{}", listener.local_addr().unwrap());
        let served = grpc::serve(
            door,
            listener,
            service.clone(),
            limits,
            access,
            draining.clone(),
        );
        let serving = tokio::spawn(served);
        let client = UnionServiceClient::new(channel(&grpc).await);
        Self {
            http,
            grpc,
            service,
            draining,
            serving,
            client,
            web: reqwest::Client::new(),
            data,
        }
    }

    /// Shuts down and gives the data back.
    pub(crate) async fn stop(self) -> TempDir {
        self.draining.cancel();
        self.service.shutdown().await;
        self.data
    }

    /// Creates a scene of cubes of this edge, one step a unit.
    pub(crate) async fn scene(&self, name: &str, edge: u32) {
        let settings = SceneSettings {
            edge: edge.into(),
            steps_per_unit: Some(1),
            ..SceneSettings::default()
        };
        let request = CreateSceneRequest {
            scene: name.to_owned(),
            settings: Some(settings),
            solids: None,
        };
        let created = self.client().create_scene(request).await.unwrap();
        assert!(created.into_inner().created);
    }

    pub(crate) fn client(&self) -> Client {
        self.client.clone()
    }

    pub(crate) async fn change(&self, scene: &str, change: Change) -> Result<Outcome, Status> {
        let request = ApplyChangeRequest {
            scene: scene.to_owned(),
            change: Some(change),
            ..ApplyChangeRequest::default()
        };
        let answer = self.client().apply_change(request).await?;
        Ok(answer.into_inner().outcome.unwrap())
    }

    pub(crate) async fn totals(&self, scene: &str) -> MassProperties {
        let request = GetMassPropertiesRequest {
            scene: scene.to_owned(),
            ..GetMassPropertiesRequest::default()
        };
        let answer = self.client().get_mass_properties(request).await.unwrap();
        answer.into_inner().mass_properties.unwrap()
    }

    /// What HTTP answers: status and JSON.
    pub(crate) async fn get(&self, path: &str) -> (u16, Value) {
        let url = format!("{}{path}", self.http);
        let answer = self.web.get(url).send().await.unwrap();
        let status = answer.status().as_u16();
        (status, answer.json().await.unwrap_or_default())
    }

    /// What HTTP answers to a change in JSON.
    pub(crate) async fn post(&self, path: &str, body: &Value) -> (u16, Value) {
        let url = format!("{}{path}", self.http);
        let request = self.web.post(url).json(body);
        let answer = request.send().await.unwrap();
        let status = answer.status().as_u16();
        (status, answer.json().await.unwrap_or_default())
    }
}

pub(crate) async fn channel(address: &str) -> Channel {
    let endpoint = Endpoint::from_shared(address.to_owned()).unwrap();
    endpoint.connect().await.unwrap()
}

/// A client whose connection takes as little as HTTP/2 has by default before it is read.
pub(crate) async fn slow_client(address: &str) -> Client {
    let endpoint = Endpoint::from_shared(address.to_owned()).unwrap();
    let endpoint = endpoint
        .initial_stream_window_size(65_535)
        .initial_connection_window_size(65_535);
    UnionServiceClient::new(endpoint.connect().await.unwrap())
}

/// Cubes with these ids in a row along x, their edge apart or overlapping as the scene has it.
pub(crate) fn row(ids: impl Iterator<Item = u64>) -> Change {
    let insert_id: Vec<u64> = ids.collect();
    let x: Vec<i32> = insert_id.iter().map(|id| *id as i32).collect();
    Change {
        y: vec![0; x.len()],
        z: vec![0; x.len()],
        insert_id,
        x,
        ..Change::default()
    }
}

pub(crate) fn deletion(ids: impl Iterator<Item = u64>) -> Change {
    Change {
        delete: ids.collect(),
        ..Change::default()
    }
}

pub(crate) const NONE: i32 = Detail::None as i32;
pub(crate) const VOLUME: i32 = Detail::Volume as i32;

/// Checks the code of a refusal and its reason, and answers its places at fault.
#[track_caller]
pub(crate) fn refused(status: &Status, code: Code, reason: &str) -> Vec<String> {
    assert_eq!(status.code(), code, "{status:?}");
    let details = status.get_error_details();
    let info = details
        .error_info()
        .unwrap_or_else(|| panic!("no details: {status:?}"));
    assert_eq!((&*info.reason, &*info.domain), (reason, "union3d"));
    let fields = details.bad_request().into_iter();
    let fields = fields.flat_map(|request| &request.field_violations);
    fields.map(|violation| violation.field.clone()).collect()
}

/// Waits until something holds.
pub(crate) async fn eventually(what: &str, mut holds: impl AsyncFnMut() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !holds().await {
        assert!(Instant::now() < deadline, "in vain: {what}");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}
