//! Calls for those who run the service: health, readiness, metrics, and what the types of problems mean.

use std::sync::OnceLock;

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use metrics_exporter_prometheus::{PrometheusBuilder, PrometheusHandle};
use serde::Serialize;
use utoipa::ToSchema;

use super::App;
use super::request::Path;
use crate::service::{AnyScene, Readiness, SceneState};
use crate::wire::access::Ticket;
use crate::wire::problem::{Code, KINDS, Kind, Problem};

/// Upper bounds of the histograms, all of which are of times, in seconds.
const TIME_BUCKETS_SECONDS: &[f64] = &[
    0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0,
];

/// Installs the recorder of this process's metrics, once however often it is called. What was counted before is lost, so
/// call it before the service is started.
pub fn install_metrics() -> PrometheusHandle {
    static RECORDER: OnceLock<PrometheusHandle> = OnceLock::new();
    let install = || {
        let recorder = PrometheusBuilder::new()
            .set_buckets(TIME_BUCKETS_SECONDS)
            .expect("there are buckets")
            .build_recorder();
        let handle = recorder.handle();
        if metrics::set_global_recorder(recorder).is_err() {
            tracing::warn!("another recorder of metrics is installed; /metrics stays empty");
        }
        crate::service::describe_metrics();
        crate::wire::door::describe_metrics();
        metrics::describe_counter!("union3d_http_requests_total", "Requests answered");
        metrics::describe_histogram!(
            "union3d_http_request_duration_seconds",
            metrics::Unit::Seconds,
            "Time from a request's head to its answer's head"
        );
        metrics::describe_counter!("union3d_grpc_requests_total", "gRPC calls that are over");
        metrics::describe_histogram!(
            "union3d_grpc_request_duration_seconds",
            metrics::Unit::Seconds,
            "Time from a gRPC call's head to its answer's head"
        );
        metrics::describe_gauge!("union3d_scenes", "Scenes, by state");
        metrics::describe_gauge!("union3d_cubes", "Cubes of all scenes that answer");
        metrics::describe_gauge!("union3d_solids", "Solids of all scenes that answer");
        handle
    };
    RECORDER.get_or_init(install).clone()
}

/// That the process runs.
#[derive(Serialize, ToSchema)]
pub(crate) struct Health {
    /// Always `ok`.
    #[schema(example = "ok")]
    status: &'static str,
}

/// Whether the process runs
#[utoipa::path(get, path = "/healthz", tag = "operation",
    responses((status = 200, description = "It runs", body = Health)))]
pub(super) async fn get_healthz() -> Json<Health> {
    Json(Health { status: "ok" })
}

/// That the service answers.
#[derive(Serialize, ToSchema)]
pub(crate) struct Ready {
    /// Always true: otherwise the answer is a problem.
    ready: bool,
    /// Scenes that are stopped or damaged, of those that the key may read; without a key none, where there are keys.
    troubled: Vec<Troubled>,
    /// What those who run the server should know: that it is open to more than it should be, that the file of keys is broken.
    warnings: Vec<String>,
}

/// A scene that does not answer.
#[derive(Serialize, ToSchema)]
pub(crate) struct Troubled {
    /// Its name.
    scene: String,
    /// Why.
    cause: String,
}

/// Whether all scenes are replayed
#[utoipa::path(get, path = "/readyz", tag = "operation",
    responses((status = 200, description = "They are", body = Ready)))]
pub(super) async fn get_readyz(
    State(app): State<App>,
    Extension(ticket): Extension<Ticket>,
) -> Result<Json<Ready>, Problem> {
    match app.service.readiness() {
        Readiness::Ready { mut troubled } => {
            troubled.retain(|(scene, _)| ticket.may_read(scene.as_str()));
            let troubled = troubled.into_iter().map(|(scene, cause)| Troubled {
                scene: scene.as_str().to_owned(),
                cause,
            });
            Ok(Json(Ready {
                ready: true,
                troubled: troubled.collect(),
                warnings: app.access.warnings(),
            }))
        }
        Readiness::Recovering { percent } => {
            let detail = format!("the scenes are being replayed: {percent} %");
            Err(Problem::new(Code::Recovering, detail).with("percent", percent))
        }
    }
}

/// Metrics in the text format of Prometheus
#[utoipa::path(get, path = "/metrics", tag = "operation",
    responses((status = 200, description = "Metrics", body = String, content_type = "text/plain; version=0.0.4")))]
pub(super) async fn get_metrics(State(app): State<App>) -> Response {
    count_scenes(&app);
    app.metrics.run_upkeep();
    let kind = [(
        header::CONTENT_TYPE,
        "text/plain; version=0.0.4; charset=utf-8",
    )];
    (kind, app.metrics.render()).into_response()
}

/// Sets the gauges of what there is now.
fn count_scenes(app: &App) {
    let mut states = [
        ("running", 0_u32),
        ("recovering", 0),
        ("stopped", 0),
        ("damaged", 0),
    ];
    let (mut cubes, mut solids) = (0.0, 0.0);
    for scene in app.service.scenes() {
        let state = match scene.state() {
            SceneState::Running => 0,
            SceneState::Recovering { .. } => 1,
            SceneState::Stopped { .. } => 2,
            SceneState::Damaged { .. } => 3,
        };
        states[state].1 += 1;
        // A scene holds at most 2^31 cubes.
        let count = scene.newest().map_or(0, |(_, count)| count);
        let bodies = match scene {
            AnyScene::Cubes(_) => &mut cubes,
            AnyScene::Solids(_) => &mut solids,
        };
        *bodies += f64::from(u32::try_from(count).unwrap_or(u32::MAX));
    }
    for (state, count) in states {
        metrics::gauge!("union3d_scenes", "state" => state).set(count);
    }
    metrics::gauge!("union3d_cubes").set(cubes);
    metrics::gauge!("union3d_solids").set(solids);
}

/// What the types of problems mean.
#[derive(Serialize, ToSchema)]
pub(crate) struct Kinds {
    /// All of them.
    problems: &'static [Kind],
}

/// List the types of problems
#[utoipa::path(get, path = "/problems", tag = "operation",
    responses((status = 200, description = "All types", body = Kinds)))]
pub(super) async fn get_problems() -> Json<Kinds> {
    Json(Kinds { problems: KINDS })
}

/// What a type of problem means
///
/// The `type` of every problem is the path of this call.
#[utoipa::path(get, path = "/problems/{code}", tag = "operation",
    params(("code" = String, Path, description = "Last part of the type", example = "id-conflict")),
    responses((status = 200, description = "The type", body = Kind)))]
pub(super) async fn get_problem(Path(code): Path<String>) -> Result<Json<Kind>, Problem> {
    let found = KINDS.iter().find(|kind| kind.code == code);
    found
        .map(|kind| Json(*kind))
        .ok_or_else(|| super::no_such_path(&format!("/problems/{code}")))
}
