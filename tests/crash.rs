//! `kill -9` of a real server in mid-stream, again and again on the same data: nothing acknowledged is lost, nothing is
//! half there, and the totals equal a recount.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

#[path = "oracle/random.rs"]
mod random;

use random::Random;
use reqwest::{Client, StatusCode};
use serde_json::{Value, json};

const CLIENTS: u64 = 6;

/// Scenes that a server is killed over.
#[derive(Clone, Copy)]
enum Kind {
    Cubes,
    Solids,
}

impl Kind {
    fn settings(self) -> Value {
        match self {
            Self::Cubes => json!({"edge": 3, "steps_per_unit": 1}),
            Self::Solids => json!({
                "kind": "solids", "steps_per_unit": 1, "stock": {"hull": [[10, 10, 10], [90, 10, 10], [10, 80, 10], [90, 80, 10], [20, 20, 75], [80, 20, 75], [20, 70, 75]]},
                "shapes": {"b": {"box": [3, 2, 4]}, "h": {"hull": [[0, 0, 0], [5, 0, 0], [0, 5, 0], [0, 0, 5]]}},
            }),
        }
    }

    /// What its bodies are called.
    fn name(self) -> &'static str {
        match self {
            Self::Cubes => "cubes",
            Self::Solids => "solids",
        }
    }

    /// Bodies that a change inserts.
    fn batch(self) -> u64 {
        match self {
            Self::Cubes => 40,
            Self::Solids => 3,
        }
    }

    /// A body, a function of its id, as it is answered: moderately crowded.
    fn body(self, id: u64) -> Value {
        let point = |[x, y, z]: [u64; 3]| json!([x as f64, y as f64, z as f64]);
        let corner = at(id);
        match self {
            Self::Cubes => json!({"id": id, "at": point(corner)}),
            Self::Solids => {
                let [x, y, z] = corner;
                let to = [x + id % 7 + 1, y, z + id % 3];
                let shape = if id.is_multiple_of(2) { "b" } else { "h" };
                json!({"id": id, "shape": shape, "from": point(corner), "to": point(to)})
            }
        }
    }
}

/// A client, which needs what TLS is made of, though it speaks none here.
fn http_client() -> Client {
    union3d::wire::trust::install_provider();
    Client::new()
}

/// A server process; killed when dropped.
struct Server {
    process: Child,
    url: String,
}

impl Server {
    fn start(data: &Path) -> Self {
        Self::spawn(Command::new(env!("CARGO_BIN_EXE_union3d")), data)
    }

    /// On a file system of its own of this many MiB, which nobody else sees.
    fn start_on_small_disk(mount: &Path, mebibytes: u32) -> Self {
        let mut command = Command::new("unshare");
        command.args(["--map-root-user", "--mount", "sh", "-c"]);
        command.arg(r#"mount -t tmpfs -o "size=$1" tmpfs "$2" && shift 2 && exec "$@""#);
        command.args(["sh", &format!("{mebibytes}m")]).arg(mount);
        command.arg(env!("CARGO_BIN_EXE_union3d"));
        Self::spawn(command, &mount.join("data"))
    }

    fn spawn(mut command: Command, data: &Path) -> Self {
        let mut process = command
            .args([
                "serve",
                "--http",
                "127.0.0.1:0",
                "--grpc",
                "127.0.0.1:0",
                "--log-filter",
                "warn,tower_http=off",
                // Some of these disks are small.
                "--disk-free-bytes-min",
                "0",
                "--data",
            ])
            .arg(data)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let stdout = process.stdout.take().unwrap();
        BufReader::new(stdout).read_line(&mut line).unwrap();
        let url = line.split_whitespace().nth(1).expect(&line).to_owned();
        Self { process, url }
    }

    /// A path as the server sees it.
    fn path(&self, path: &Path) -> PathBuf {
        Path::new("/proc")
            .join(self.process.id().to_string())
            .join("root")
            .join(path.strip_prefix("/").unwrap())
    }

    /// SIGKILL, and wait until it is dead.
    fn kill(mut self) {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
    }

    async fn ready(&self, client: &Client) {
        let deadline = Instant::now() + Duration::from_secs(60);
        loop {
            let answer = client
                .get(format!("{}/readyz", self.url))
                .send()
                .await
                .unwrap();
            if answer.status() == StatusCode::OK {
                let body: Value = answer.json().await.unwrap();
                assert_eq!(body["troubled"], json!([]));
                return;
            }
            assert!(Instant::now() < deadline, "never ready: {answer:?}");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }

    fn scene(&self, rest: &str) -> String {
        format!("{}/v1/scenes/crash{rest}", self.url)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _dead = self.process.kill();
        let _dead = self.process.wait();
    }
}

fn id(client: u64, generation: u64, index: u64) -> u64 {
    (client << 48) | (generation << 8) | index
}

/// Lower corner of a cube of edge 3, a function of its id: moderately crowded.
fn at(id: u64) -> [u64; 3] {
    let mixed = id.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 16;
    [mixed % 97, (mixed / 97) % 89, (mixed / 8633) % 83]
}

/// Change `generation` of a client: a batch comes, the batch before the last goes.
fn change(kind: Kind, client: u64, generation: u64) -> Value {
    let ids = |generation| (0..kind.batch()).map(move |index| id(client, generation, index));
    let delete: Vec<u64> = match generation.checked_sub(2) {
        Some(old) if old > 0 => ids(old).collect(),
        _ => vec![],
    };
    let insert: Vec<Value> = ids(generation).map(|id| kind.body(id)).collect();
    json!({"delete": delete, "insert": insert})
}

/// All of a client's bodies after its change `generation`.
fn bodies_after(kind: Kind, client: u64, generation: u64) -> BTreeMap<u64, Value> {
    let batches = [generation.saturating_sub(1), generation];
    let ids = batches.into_iter().filter(|&batch| batch > 0);
    let ids = ids.flat_map(|batch| (0..kind.batch()).map(move |index| id(client, batch, index)));
    ids.map(|id| (id, kind.body(id))).collect()
}

/// What a client knows when its server dies.
struct Known {
    /// Its newest acknowledged change.
    acknowledged: u64,
    /// Greatest seq it was answered.
    seq: u64,
}

/// Sends changes one after the other until the server is gone.
async fn stream(kind: Kind, url: String, client: u64, from: u64, count: Arc<AtomicU64>) -> Known {
    let http = http_client();
    let mut known = Known {
        acknowledged: from,
        seq: 0,
    };
    loop {
        let generation = known.acknowledged + 1;
        let sent = http
            .post(format!("{url}?return=minimal"))
            .json(&change(kind, client, generation))
            .send()
            .await;
        let Ok(answer) = sent else {
            return known;
        };
        let status = answer.status();
        let Ok(body) = answer.json::<Value>().await else {
            return known;
        };
        assert_eq!(status, StatusCode::OK, "{body}");
        known.acknowledged = generation;
        known.seq = body["seq"].as_u64().unwrap();
        count.fetch_add(1, Ordering::Relaxed);
    }
}

/// All bodies of the scene, by client.
async fn bodies(kind: Kind, server: &Server, http: &Client) -> BTreeMap<u64, BTreeMap<u64, Value>> {
    let answer = http
        .get(server.scene(&format!("/{}", kind.name())))
        .header("accept", "application/x-ndjson")
        .send()
        .await
        .unwrap();
    assert_eq!(answer.status(), StatusCode::OK);
    let mut bodies: BTreeMap<u64, BTreeMap<u64, Value>> = BTreeMap::new();
    for line in answer.text().await.unwrap().lines() {
        let mut line: Value = serde_json::from_str(line).unwrap();
        let body = line["insert"].take();
        let id = body["id"].as_u64().unwrap();
        let twice = bodies.entry(id >> 48).or_default().insert(id, body);
        assert!(twice.is_none());
    }
    bodies
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_acknowledged_is_lost_and_nothing_is_half_there() {
    kill_again_and_again(Kind::Cubes, 60).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_solid_that_was_acknowledged_is_lost_and_nothing_is_half_there() {
    kill_again_and_again(Kind::Solids, 20).await;
}

async fn kill_again_and_again(kind: Kind, kills: u64) {
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().join("data");
    let http = http_client();
    let mut server = Server::start(&data);
    let made = http
        .put(server.scene(""))
        .json(&kind.settings())
        .send()
        .await
        .unwrap();
    assert_eq!(made.status(), StatusCode::CREATED);
    // The seed of the moments of death; the rest of the timing is the machine's.
    let mut moments = Random::new(12_345);
    let mut generations = vec![0_u64; CLIENTS as usize];
    for kill in 1..=kills {
        let count = Arc::new(AtomicU64::new(0));
        let streams: Vec<_> = (0..CLIENTS)
            .map(|client| {
                let from = generations[client as usize];
                let url = server.scene("/changes");
                tokio::spawn(stream(kind, url, client, from, count.clone()))
            })
            .collect();
        let enough = 3 + moments.below(60);
        let deadline = Instant::now() + Duration::from_secs(60);
        while count.load(Ordering::Relaxed) < enough {
            assert!(Instant::now() < deadline, "the server is too slow");
            tokio::time::sleep(Duration::from_micros(200)).await;
        }
        server.kill();
        let mut seq = 0;
        let mut acknowledged = Vec::new();
        for stream in streams {
            let known = stream.await.unwrap();
            seq = seq.max(known.seq);
            acknowledged.push(known.acknowledged);
        }

        server = Server::start(&data);
        server.ready(&http).await;
        let found = bodies(kind, &server, &http).await;
        for client in 0..CLIENTS {
            let mine = found.get(&client).cloned().unwrap_or_default();
            let last = acknowledged[client as usize];
            // The change that was under way is there whole or not at all.
            let kept = [last, last + 1]
                .into_iter()
                .find(|&generation| mine == bodies_after(kind, client, generation));
            generations[client as usize] = kept.unwrap_or_else(|| {
                panic!(
                    "kill {kill}, client {client}: neither change {last} nor {}",
                    last + 1
                )
            });
        }
        let changes: u64 = generations.iter().sum();
        let now: Value = http
            .get(server.scene("/mass-properties"))
            .send()
            .await
            .unwrap()
            .json()
            .await
            .unwrap();
        assert!(now["seq"].as_u64().unwrap() >= seq);
        assert_eq!(
            now["seq"],
            json!(changes),
            "one seq for each change that was kept"
        );
        let audit = http
            .post(server.scene("/audit"))
            .json(&json!({}))
            .send()
            .await
            .unwrap();
        assert_eq!(audit.status(), StatusCode::OK);
        let audit: Value = audit.json().await.unwrap();
        assert_eq!(audit["equal"], json!(true), "{audit}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_retry_with_the_same_key_after_a_crash_is_done_once() {
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().join("data");
    let http = http_client();
    let mut server = Server::start(&data);
    let settings = json!({"edge": 3, "steps_per_unit": 1});
    http.put(server.scene(""))
        .json(&settings)
        .send()
        .await
        .unwrap();
    let mut done = 0_u64;
    for kill in 0..10_u64 {
        let post = |server: &Server, number: u64| {
            http.post(server.scene("/changes?return=minimal"))
                .header("idempotency-key", format!("number-{number}"))
                .json(&json!({"insert": [{"at": at(number)}, {"at": at(number + 1)}]}))
                .send()
        };
        for _ in 0..kill {
            assert_eq!(post(&server, done).await.unwrap().status(), StatusCode::OK);
            done += 1;
        }
        // In mid-flight: the answer may or may not come.
        let request = tokio::spawn(post(&server, done));
        tokio::time::sleep(Duration::from_micros(300 * kill)).await;
        server.kill();
        let _lost = request.await.unwrap();
        server = Server::start(&data);
        server.ready(&http).await;
        let again: Value = post(&server, done).await.unwrap().json().await.unwrap();
        done += 1;
        assert_eq!(again["seq"], json!(done), "{again}");
        assert_eq!(
            again["assigned"],
            json!({"first": 2 * done - 1, "last": 2 * done})
        );
        let now: Value = http
            .get(server.scene(""))
            .send()
            .await
            .unwrap()
            .json()
            .await
            .unwrap();
        assert_eq!(now["cubes"], json!(2 * done));
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_signal_drains_and_ends_well() {
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().join("data");
    let http = http_client();
    for signal in ["-INT", "-TERM"] {
        let mut server = Server::start(&data);
        server.ready(&http).await;
        let settings = json!({"edge": 3, "steps_per_unit": 1});
        http.put(server.scene(""))
            .json(&settings)
            .send()
            .await
            .unwrap();
        // A subscriber that never goes away by itself must not keep the server.
        let events = http
            .get(server.scene("/mass-properties/stream"))
            .send()
            .await
            .unwrap();
        assert_eq!(events.status(), StatusCode::OK);
        let id = server.process.id().to_string();
        assert!(
            Command::new("kill")
                .args([signal, &id])
                .status()
                .unwrap()
                .success()
        );
        let deadline = Instant::now() + Duration::from_secs(30);
        let status = loop {
            if let Some(status) = server.process.try_wait().unwrap() {
                break status;
            }
            assert!(Instant::now() < deadline, "{signal} does not end it");
            tokio::time::sleep(Duration::from_millis(5)).await;
        };
        assert!(status.success(), "{signal}: {status}");
        drop(events);
    }
}

#[tokio::test]
async fn a_second_server_on_the_same_data_is_refused_and_so_is_an_audit() {
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().join("data");
    let server = Server::start(&data);
    let run = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_union3d"));
        command.args(arguments).output().unwrap()
    };
    let path = data.to_str().unwrap();
    for arguments in [
        &[
            "serve",
            "--http",
            "127.0.0.1:0",
            "--grpc",
            "127.0.0.1:0",
            "--data",
            path,
        ][..],
        &["audit", path],
    ] {
        let output = run(arguments);
        assert_eq!(output.status.code(), Some(1));
        let text = String::from_utf8(output.stderr).unwrap();
        assert!(text.contains("in use by another"), "{text}");
        assert!(output.stdout.is_empty());
    }
    let http = http_client();
    let settings = json!({"edge": 3, "steps_per_unit": 1});
    http.put(server.scene(""))
        .json(&settings)
        .send()
        .await
        .unwrap();
    http.post(server.scene("/changes"))
        .json(&change(Kind::Cubes, 1, 1))
        .send()
        .await
        .unwrap();
    server.kill();
    let output = run(&["audit", path]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{text}");
    assert!(text.contains("equal to the recount"), "{text}");
    let none = run(&["audit", directory.path().to_str().unwrap()]);
    assert_eq!(none.status.code(), Some(1));
    assert!(!directory.path().join("lock").exists());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_disk_is_told_with_its_cause_and_heals_when_there_is_space() {
    let directory = tempfile::tempdir().unwrap();
    let http = http_client();
    let server = Server::start_on_small_disk(directory.path(), 24);
    let settings = json!({"edge": 3, "steps_per_unit": 1});
    let made = http
        .put(server.scene(""))
        .json(&settings)
        .send()
        .await
        .unwrap();
    assert_eq!(made.status(), StatusCode::CREATED);
    let post = |generation: u64| {
        let url = server.scene("/changes");
        let sent = http
            .post(url)
            .json(&change(Kind::Cubes, 1, generation))
            .send();
        async move {
            let answer = sent.await.unwrap();
            (answer.status(), answer.json::<Value>().await.unwrap())
        }
    };
    let filler = server.path(&directory.path().join("filler"));
    let mut generation = 0;
    for round in 0..3 {
        for _ in 0..20 {
            let (status, body) = post(generation + 1).await;
            assert_eq!(status, StatusCode::OK, "{body}");
            generation += 1;
        }
        // Byte by byte to the very end: a page of anything is too much then.
        let mut file = std::fs::File::create(&filler).unwrap();
        let mut size = 1 << 20;
        while size > 0 {
            if file.write_all(&vec![1; size]).is_err() {
                size /= 2;
            }
        }
        // SQLite may have room left in its own files for a while.
        let deadline = Instant::now() + Duration::from_secs(60);
        let (status, problem) = loop {
            let (status, body) = post(generation + 1).await;
            if status != StatusCode::OK {
                break (status, body);
            }
            generation += 1;
            assert!(Instant::now() < deadline, "the disk is never full");
        };
        let refusals = [
            StatusCode::SERVICE_UNAVAILABLE,
            StatusCode::INSUFFICIENT_STORAGE,
        ];
        assert!(refusals.contains(&status), "{status}: {problem}");
        assert!(
            problem["detail"]
                .as_str()
                .unwrap()
                .contains("no space left"),
            "{problem}"
        );
        // Readers hear the same; the server itself is well.
        let read = http
            .get(server.scene("/mass-properties"))
            .send()
            .await
            .unwrap();
        assert!(refusals.contains(&read.status()), "{read:?}");
        let health = http
            .get(format!("{}/healthz", server.url))
            .send()
            .await
            .unwrap();
        assert_eq!(health.status(), StatusCode::OK);

        drop(file);
        std::fs::remove_file(&filler).unwrap();
        let deadline = Instant::now() + Duration::from_secs(60);
        let now: Value = loop {
            let read = http
                .get(server.scene("/mass-properties"))
                .send()
                .await
                .unwrap();
            if read.status() == StatusCode::OK {
                break read.json().await.unwrap();
            }
            assert!(
                Instant::now() < deadline,
                "round {round}: it never heals: {read:?}"
            );
            tokio::time::sleep(Duration::from_millis(20)).await;
        };
        let mut found = bodies(Kind::Cubes, &server, &http).await;
        let found = found.remove(&1).unwrap();
        let kept = [generation, generation + 1]
            .into_iter()
            .find(|&last| found == bodies_after(Kind::Cubes, 1, last));
        generation = kept.expect("the change that failed is there whole or not at all");
        assert_eq!(now["seq"], json!(generation));
        let audit: Value = http
            .post(server.scene("/audit"))
            .json(&json!({}))
            .send()
            .await
            .unwrap()
            .json()
            .await
            .unwrap();
        assert_eq!(audit["equal"], json!(true), "{audit}");
    }
    let (status, body) = post(generation + 1).await;
    assert_eq!(status, StatusCode::OK, "{body}");
}
