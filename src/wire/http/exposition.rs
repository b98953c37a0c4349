//! What is counted of this process, in the text format of Prometheus.
//!
//! Counters and histograms are counted where things happen. Gauges are asked for when somebody reads them: of the service, of the
//! process, and of the machine.

use std::sync::OnceLock;
use std::time::Duration;

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use metrics::gauge;
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use metrics_process::Collector;

use super::App;
use crate::service::{
    Gauges, Meter, SceneState, ServiceError, describe_metrics, memory_limit_bytes,
};
use crate::wire::convert::float;
use crate::wire::door;
use crate::wire::open;
use crate::wire::problem::Problem;

/// Upper bounds of the histograms of times, in seconds.
const TIME_BUCKETS_SECONDS: &[f64] = &[
    0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0,
];

/// The histogram that is of no times, and its upper bounds.
const COUNTS: &str = "union3d_commit_changes";
const COUNT_BUCKETS: &[f64] = &[
    1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0, 512.0, 1024.0,
];

/// How often what was recorded is put into the histograms. Until then every time that was recorded is kept by itself, and
/// nobody need ever read the metrics.
const UPKEEP_INTERVAL: Duration = Duration::from_secs(5);

const BUILD: &str = "union3d_build_info";
const READY: &str = "union3d_ready";
const REPLAY: &str = "union3d_replay_progress_ratio";
const SCENES: &str = "union3d_scenes";
const CUBES: &str = "union3d_cubes";
const SOLIDS: &str = "union3d_solids";
const QUEUE_CHANGES: &str = "union3d_queue_changes";
const QUEUE_CHANGES_MAX: &str = "union3d_queue_changes_max";
const QUEUE_OPERATIONS: &str = "union3d_queue_operations";
const QUEUE_OPERATIONS_MAX: &str = "union3d_queue_operations_max";
const WRITE_AHEAD_BYTES: &str = "union3d_write_ahead_bytes";
const WRITE_AHEAD_BYTES_MAX: &str = "union3d_write_ahead_bytes_max";
const UNMOVED_PAGES: &str = "union3d_unmoved_pages";
const UNMOVED_PAGES_MAX: &str = "union3d_unmoved_pages_max";
const CHECKPOINT_DUE: &str = "union3d_checkpoint_due_seconds_max";
const SUBSCRIPTIONS: &str = "union3d_subscriptions";
const DISK_SIZE: &str = "union3d_disk_size_bytes";
const DISK_FREE: &str = "union3d_disk_free_bytes";
const MEMORY_LIMIT: &str = "union3d_memory_limit_bytes";

/// What is known here; the service has its own, and so has the process.
const METERS: &[Meter] = &[
    Meter::gauge(BUILD, "Always 1; the labels say what runs").by("version", &[]),
    Meter::counter("union3d_http_requests_total", "Requests answered").by("route", &[]),
    Meter::histogram(
        "union3d_http_request_duration_seconds",
        "Time from a request's head to its answer's head",
    )
    .by("route", &[]),
    Meter::counter("union3d_grpc_requests_total", "gRPC calls that are over").by("method", &[]),
    Meter::histogram(
        "union3d_grpc_request_duration_seconds",
        "Time from a gRPC call's head to its answer's head",
    )
    .by("method", &[]),
    open::STREAMS,
    Meter::gauge(
        READY,
        "1 when the replay that began at start is done, 0 before",
    ),
    Meter::gauge(
        REPLAY,
        "How far the replay that began at start has come, by bytes: 1 when it is done",
    ),
    Meter::gauge(SCENES, "Scenes, by state").by("state", &SceneState::NAMES),
    Meter::gauge(CUBES, "Cubes of all scenes that answer"),
    Meter::gauge(SOLIDS, "Solids of all scenes that answer"),
    Meter::gauge(QUEUE_CHANGES, "Changes waiting in the queues of all scenes"),
    Meter::gauge(
        QUEUE_CHANGES_MAX,
        "Changes waiting in the scene where most are",
    ),
    Meter::gauge(
        QUEUE_OPERATIONS,
        "Insertions and deletions in the changes that wait in all scenes",
    ),
    Meter::gauge(
        QUEUE_OPERATIONS_MAX,
        "Insertions and deletions that wait in the scene where most do",
    ),
    Meter::gauge(
        WRITE_AHEAD_BYTES,
        "Size of the write-ahead files of all scenes, by state of the scene",
    )
    .by("state", &SceneState::NAMES),
    Meter::gauge(
        WRITE_AHEAD_BYTES_MAX,
        "Size of the largest write-ahead file of a scene",
    ),
    Meter::gauge(
        UNMOVED_PAGES,
        "Pages of 4 KiB in the write-ahead files of all scenes that are not in their databases yet",
    ),
    Meter::gauge(UNMOVED_PAGES_MAX, "The same of the scene that has most"),
    Meter::gauge(
        CHECKPOINT_DUE,
        "Longest time that a scene's write-ahead file has been so long that it should be moved into its database; 0 while none is",
    ),
    Meter::gauge(
        SUBSCRIPTIONS,
        "Event streams, watches and waits that are told of each new state",
    ),
    Meter::gauge(DISK_SIZE, "Size of the disk of the data directory"),
    Meter::gauge(
        DISK_FREE,
        "Room on the disk of the data directory for users who are not root",
    ),
    Meter::gauge(
        MEMORY_LIMIT,
        "Memory of the machine, or of the control group of the process when that is less",
    ),
];

/// Installs the recorder of this process's metrics, once however often it is called. What was counted before is lost, so
/// call it before the service is started.
pub fn install_metrics() -> PrometheusHandle {
    static RECORDER: OnceLock<PrometheusHandle> = OnceLock::new();
    let install = || {
        let recorder = PrometheusBuilder::new()
            .set_buckets(TIME_BUCKETS_SECONDS)
            .and_then(|builder| {
                builder.set_buckets_for_metric(Matcher::Full(COUNTS.to_owned()), COUNT_BUCKETS)
            })
            .expect("there are buckets")
            .build_recorder();
        let handle = recorder.handle();
        if metrics::set_global_recorder(recorder).is_err() {
            tracing::warn!("another recorder of metrics is installed; /metrics stays empty");
        }
        describe_metrics();
        METERS.iter().for_each(Meter::describe);
        door::describe_metrics();
        Collector::default().describe();
        gauge!(BUILD, "version" => env!("CARGO_PKG_VERSION"), "profile" => profile()).set(1);
        handle
    };
    RECORDER.get_or_init(install).clone()
}

/// Keeps what is recorded small, for as long as it is polled.
pub async fn keep_metrics(metrics: PrometheusHandle) {
    let mut tick = tokio::time::interval(UPKEEP_INTERVAL);
    loop {
        tick.tick().await;
        metrics.run_upkeep();
    }
}

/// A build for tests is so much slower that whoever runs one by mistake should see it.
fn profile() -> &'static str {
    if cfg!(debug_assertions) {
        "debug"
    } else {
        "release"
    }
}

/// Metrics in the text format of Prometheus
#[utoipa::path(get, path = "/metrics", tag = "operation",
    responses((status = 200, description = "Metrics", body = String, content_type = "text/plain; version=0.0.4")))]
pub(super) async fn get_metrics(State(app): State<App>) -> Result<Response, Problem> {
    // Files are looked at, one a scene, and a disk may not answer.
    let text = tokio::task::spawn_blocking(move || {
        show(&app.service.gauges());
        Collector::default().collect();
        app.metrics.render()
    });
    let kind = [(
        header::CONTENT_TYPE,
        "text/plain; version=0.0.4; charset=utf-8",
    )];
    // It does not panic, so it fails only with a runtime that goes down.
    let text = text.await.map_err(|_| ServiceError::ShuttingDown)?;
    Ok((kind, text).into_response())
}

/// Sets the gauges of what there is now.
fn show(now: &Gauges) {
    for (name, state) in SceneState::NAMES.into_iter().zip(&now.states) {
        gauge!(SCENES, "state" => name).set(whole(state.scenes));
        gauge!(WRITE_AHEAD_BYTES, "state" => name).set(whole(state.write_ahead_bytes));
    }
    for (name, value) in [
        (CUBES, now.cubes),
        (SOLIDS, now.solids),
        (QUEUE_CHANGES, now.queue_changes.sum),
        (QUEUE_CHANGES_MAX, now.queue_changes.max),
        (QUEUE_OPERATIONS, now.queue_operations.sum),
        (QUEUE_OPERATIONS_MAX, now.queue_operations.max),
        (WRITE_AHEAD_BYTES_MAX, now.write_ahead_bytes_max),
        (UNMOVED_PAGES, now.unmoved_pages.sum),
        (UNMOVED_PAGES_MAX, now.unmoved_pages.max),
        (SUBSCRIPTIONS, now.subscriptions),
        (READY, u64::from(now.replay_percent == 100)),
    ] {
        gauge!(name).set(whole(value));
    }
    gauge!(CHECKPOINT_DUE).set(now.checkpoint_due_max.as_secs_f64());
    gauge!(REPLAY).set(f64::from(now.replay_percent) / 100.0);
    // What cannot be asked stays what it was: a disk without room would be a lie.
    if let Some(disk) = now.disk {
        gauge!(DISK_SIZE).set(whole(disk.size_bytes));
        gauge!(DISK_FREE).set(whole(disk.free_bytes));
    }
    if let Some(limit) = memory_limit_bytes() {
        gauge!(MEMORY_LIMIT).set(whole(limit));
    }
}

fn whole(number: u64) -> f64 {
    float(number.into())
}
