//! What the server shows of itself to those who run it: `/metrics`, and the table of it in `deploy/README.md`.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tempfile::TempDir;
use union3d::engine::Op;
use union3d::geometry::{CubeId, Edge, Place};
use union3d::service::{
    Counting, FailPoint, Gauges, Motion, Operations, Readiness, Scene, SceneName, SceneState,
    Service, ServiceConfig, Spread, Submission,
};
use union3d::wire::proto::ListScenesRequest;
use union3d::wire::proto::union_service_client::UnionServiceClient;

use serve::Server;

#[path = "oracle/serve.rs"]
mod serve;

/// How long is waited for what must come: so long that a hang is told from a slow machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// The metrics of a server, as they are read.
struct Metrics(String);

impl Metrics {
    async fn of(server: &Server) -> Self {
        let answer = reqwest::get(format!("{}/metrics", server.url)).await;
        Self(answer.unwrap().text().await.unwrap())
    }

    /// The value of a series, named as it is shown.
    #[track_caller]
    fn value(&self, series: &str) -> f64 {
        let values = self.0.lines().filter_map(|line| line.strip_prefix(series));
        let mut values = values.filter_map(|rest| rest.strip_prefix(' '));
        match (values.next(), values.next()) {
            (Some(value), None) => value.parse().unwrap(),
            _ => panic!("not exactly one {series} in {}", self.0),
        }
    }

    /// The rows of a table: name, type and meaning of each metric, by name.
    fn table(&self) -> Vec<String> {
        let mut found: BTreeMap<&str, (&str, &str)> = BTreeMap::new();
        for line in self.0.lines() {
            if let Some((name, help)) = line
                .strip_prefix("# HELP ")
                .and_then(|help| help.split_once(' '))
            {
                found.entry(name).or_default().1 = help;
            }
            if let Some((name, shape)) = line
                .strip_prefix("# TYPE ")
                .and_then(|shape| shape.split_once(' '))
            {
                found.entry(name).or_default().0 = shape;
            }
        }
        let rows = found.into_iter();
        rows.map(|(name, (shape, help))| format!("| `{name}` | {shape} | {help} |"))
            .collect()
    }
}

/// The text of a file of the repository.
fn text(path: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap()
}

async fn eventually<F: Future<Output = bool>>(what: &str, mut holds: impl FnMut() -> F) {
    let deadline = Instant::now() + PATIENCE;
    while !holds().await {
        assert!(Instant::now() < deadline, "in vain: {what}");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

/// A server with a scene of three cubes, made by one change, and one whose files are damaged.
async fn server(data: &TempDir) -> Server {
    let broken = data.path().join("scenes/broken");
    fs::create_dir_all(&broken).unwrap();
    fs::write(broken.join("scene.sqlite"), "nothing of ours").unwrap();
    let server = Server::start(data.path());
    eventually("the server is ready", || async {
        let ready = reqwest::get(format!("{}/readyz", server.url)).await;
        ready.unwrap().status() == 200
    })
    .await;
    let client = reqwest::Client::new();
    let scene = format!("{}/v1/scenes/part", server.url);
    let json = async |request: reqwest::RequestBuilder, body: &'static str| {
        let request = request
            .header("content-type", "application/json")
            .body(body);
        let answer = request.send().await.unwrap();
        assert!(answer.status().is_success(), "{answer:?}");
    };
    json(client.put(&scene), r#"{"edge":6}"#).await;
    let three =
        r#"{"insert":[{"id":1,"at":[0,0,0]},{"id":2,"at":[3,0,0]},{"id":3,"at":[20,0,0]}]}"#;
    json(client.post(format!("{scene}/changes")), three).await;
    server
}

/// Who reads the table knows all that is shown, and what each means; and all that the table promises is shown from the start, also
/// what has not happened yet.
#[tokio::test]
async fn every_metric_is_described_and_in_the_table() {
    let data = tempfile::tempdir().unwrap();
    let server = server(&data).await;
    let mut grpc = UnionServiceClient::connect(server.grpc.replace("grpc://", "http://"))
        .await
        .unwrap();
    grpc.list_scenes(ListScenesRequest::default())
        .await
        .unwrap();
    // The answer to a call is counted when it is over.
    eventually("the call is counted", || async {
        let metrics = Metrics::of(&server).await;
        metrics.0.contains("union3d_grpc_requests_total{")
    })
    .await;
    let shown = Metrics::of(&server).await.table();
    assert!(shown.len() > 40, "metrics are found: {shown:#?}");
    for row in &shown {
        assert!(!row.ends_with("|  |"), "without a meaning: {row}");
    }
    let readme = text("deploy/README.md");
    let table = readme
        .lines()
        .filter(|line| line.starts_with("| `union3d_") || line.starts_with("| `process_"));
    let table: Vec<&str> = table.collect();
    assert_eq!(
        table,
        shown,
        "the table of deploy/README.md should be:\n{}",
        shown.join("\n")
    );
}

#[tokio::test]
async fn what_there_is_shows() {
    let data = tempfile::tempdir().unwrap();
    let server = server(&data).await;
    let metrics = Metrics::of(&server).await;
    let build = format!(
        r#"union3d_build_info{{version="{}",profile="debug"}}"#,
        env!("CARGO_PKG_VERSION")
    );
    for (series, value) in [
        (&*build, 1.0),
        ("union3d_ready", 1.0),
        ("union3d_replay_progress_ratio", 1.0),
        (r#"union3d_scenes{state="running"}"#, 1.0),
        (r#"union3d_scenes{state="damaged"}"#, 1.0),
        (r#"union3d_scenes{state="newer"}"#, 0.0),
        (r#"union3d_scenes{state="stopped"}"#, 0.0),
        ("union3d_cubes", 3.0),
        ("union3d_solids", 0.0),
        ("union3d_commits_total", 1.0),
        ("union3d_commit_changes_count", 1.0),
        ("union3d_commit_changes_sum", 1.0),
        (r#"union3d_commit_changes_bucket{le="1"}"#, 1.0),
        ("union3d_sync_seconds_count", 1.0),
        ("union3d_cubes_inserted_total", 3.0),
        ("union3d_audit_differences_total", 0.0),
        ("union3d_queue_changes", 0.0),
        ("union3d_checkpoint_due_seconds_max", 0.0),
        ("union3d_subscriptions", 0.0),
        (r#"union3d_streams{protocol="http"}"#, 0.0),
        (r#"union3d_streams{protocol="grpc"}"#, 0.0),
    ] {
        assert_eq!(metrics.value(series), value, "{series}");
    }
    // The change, in frames of whole pages.
    let written = metrics.value(r#"union3d_write_ahead_bytes{state="running"}"#);
    assert!(written >= 4096.0, "{written}");
    assert_eq!(metrics.value("union3d_write_ahead_bytes_max"), written);
    let pages = metrics.value("union3d_unmoved_pages");
    assert!(
        pages >= 1.0 && pages * 4096.0 < written,
        "{pages} {written}"
    );
    let sync = metrics.value("union3d_sync_seconds_sum");
    assert!(0.0 < sync && sync <= metrics.value("union3d_commit_seconds_sum"));
    let (free, size) = ("union3d_disk_free_bytes", "union3d_disk_size_bytes");
    assert!(0.0 < metrics.value(free) && metrics.value(free) <= metrics.value(size));
    let memory = metrics.value("process_resident_memory_bytes");
    assert!(1e6 < memory && memory < metrics.value("union3d_memory_limit_bytes"));
    let files = metrics.value("process_open_fds");
    assert!(files > 3.0 && files < metrics.value("process_max_fds"));
    assert!(!metrics.0.contains("part"), "a series by scene");
}

/// Who follows a scene, or streams into it, is counted as long as that lasts.
#[tokio::test]
async fn what_is_open_shows() {
    let data = tempfile::tempdir().unwrap();
    let server = server(&data).await;
    let shows = |series: &'static str, value: f64| {
        let server = &server;
        eventually(series, move || async move {
            Metrics::of(server).await.value(series) == value
        })
    };
    let scene = format!("{}/v1/scenes/part", server.url);
    let events = reqwest::get(format!("{scene}/mass-properties/stream")).await;
    shows("union3d_subscriptions", 1.0).await;
    drop(events);
    shows("union3d_subscriptions", 0.0).await;

    let streams = r#"union3d_streams{protocol="http"}"#;
    let (lines, body) = tokio::sync::mpsc::channel::<Result<&'static str, std::io::Error>>(1);
    let body = reqwest::Body::wrap_stream(tokio_stream::wrappers::ReceiverStream::new(body));
    let request = reqwest::Client::new()
        .post(format!("{scene}/changes"))
        .header("content-type", "application/x-ndjson")
        .body(body);
    let answer = tokio::spawn(request.send());
    lines.send(Ok("{\"delete\":1}\n")).await.unwrap();
    shows(streams, 1.0).await;
    drop(lines);
    assert_eq!(answer.await.unwrap().unwrap().status(), 200);
    shows(streams, 0.0).await;
}

/// Names of metrics in a text, without what the parts of a histogram add.
fn named(text: &str) -> BTreeSet<String> {
    let words = text.split(|letter: char| !letter.is_ascii_alphanumeric() && letter != '_');
    let names = words.filter(|word| word.starts_with("union3d_") || word.starts_with("process_"));
    let plain = |name: &str| {
        let parts = ["_bucket", "_sum", "_count"];
        let whole = parts.iter().find_map(|part| name.strip_suffix(part));
        whole.unwrap_or(name).to_owned()
    };
    names.map(plain).collect()
}

/// A rule about a metric that is not there never fires, and a panel stays empty, without a word.
#[test]
fn alerts_and_the_dashboard_ask_for_metrics_that_are_shown() {
    let readme = text("deploy/README.md");
    let table = readme.lines().filter(|line| line.starts_with("| `"));
    let shown: BTreeSet<String> = table.flat_map(named).collect();
    for path in [
        "deploy/prometheus/alerts.yaml",
        "deploy/prometheus/alerts.test.yaml",
        "deploy/grafana/union3d.json",
    ] {
        let named = named(&text(path));
        assert!(named.len() > 10, "metrics are found in {path}");
        let unknown: Vec<_> = named.difference(&shown).collect();
        assert!(unknown.is_empty(), "{path} asks for {unknown:?}");
    }
    let dashboard: serde_json::Value =
        serde_json::from_str(&text("deploy/grafana/union3d.json")).unwrap();
    assert!(dashboard["panels"].as_array().unwrap().len() > 20);
}

/// Who is woken finds what to do, and every alert has been seen to fire.
#[test]
fn every_alert_has_a_paragraph_and_a_test() {
    let after = |text: &str, prefix: &str| -> BTreeSet<String> {
        let lines = text.lines().map(str::trim_start);
        let rest = lines.filter_map(|line| line.strip_prefix(prefix));
        rest.map(str::to_owned).collect()
    };
    let alerts = after(&text("deploy/prometheus/alerts.yaml"), "- alert: ");
    assert!(alerts.len() > 10, "{alerts:?}");
    assert_eq!(after(&text("deploy/README.md"), "### "), alerts);
    let tests = text("deploy/prometheus/alerts.test.yaml");
    for alert in alerts {
        let fires = format!("alertname: {alert}\n        exp_alerts:");
        assert!(tests.contains(&fires), "{alert} is not seen to fire");
    }
}

/// Two scenes whose writers are held: what waits is counted, together and where it is most.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_waits_shows() {
    let data = tempfile::tempdir().unwrap();
    // One that may be held while waiting.
    let hold = Arc::new(tokio::sync::RwLock::new(()));
    let (holding, mut held_up) = tokio::sync::mpsc::unbounded_channel();
    let hook = {
        let hold = hold.clone();
        Arc::new(move |point| {
            if point == FailPoint::Append {
                holding.send(()).unwrap();
                drop(hold.blocking_read());
            }
            None
        })
    };
    let service = Service::start_with_failpoints(ServiceConfig::new(data.path()), hook).unwrap();
    assert!(matches!(service.readiness(), Readiness::Ready { .. }));
    let mut scenes = Vec::new();
    for name in ["a", "b"] {
        let name = SceneName::new(name).unwrap();
        let edge = Edge::new(4).unwrap();
        let (scene, _) = service.create(&name, edge, None, "{}").await.unwrap();
        scenes.push(scene);
    }
    let held = hold.write().await;
    let mut answers = Vec::new();
    let mut submit = |scene: &Arc<Scene>, id: u64| {
        let scene = scene.clone();
        let place = Place::new([0; 3], Edge::new(4).unwrap()).unwrap();
        let inserted = [id, id + 1].map(|id| Op::Insert(CubeId(id), place));
        let submission = Submission {
            operations: Operations::Named(inserted.to_vec()),
            counting: Counting::Net,
            motion: Motion::default(),
            key: None,
        };
        answers.push(tokio::spawn(async move { scene.change(submission).await }));
    };
    let waits = async |expected: Spread| {
        let show = || {
            let now = service.gauges();
            assert_eq!(now.queue_operations.sum, 2 * now.queue_changes.sum);
            let reached = now.queue_changes == expected;
            async move { reached }
        };
        eventually(&format!("{expected:?}"), show).await;
    };
    // The first change of each is with its writer, and no longer in the queue.
    for scene in &scenes {
        submit(scene, 10);
        held_up.recv().await.unwrap();
    }
    submit(&scenes[0], 20);
    waits(Spread { sum: 1, max: 1 }).await;
    submit(&scenes[0], 30);
    waits(Spread { sum: 2, max: 2 }).await;
    submit(&scenes[1], 20);
    waits(Spread { sum: 3, max: 2 }).await;
    drop(held);
    for answer in answers {
        answer.await.unwrap().unwrap();
    }
    let Gauges {
        queue_changes,
        cubes,
        states,
        unmoved_pages,
        ..
    } = service.gauges();
    assert_eq!((queue_changes, cubes), (Spread::default(), 10));
    assert_eq!(states[SceneState::Running.index()].scenes, 2);
    assert!(unmoved_pages.max < unmoved_pages.sum, "{unmoved_pages:?}");
}
