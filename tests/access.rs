//! Who gets in, as the program has it: keys, addresses, pages, the audit log, and who can read the files.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

#[path = "door/certificates.rs"]
#[allow(dead_code, reason = "the door's tests connect by themselves")]
mod certificates;

use std::collections::BTreeSet;
use std::fs::{self, File, Permissions};
use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use reqwest::{Client, RequestBuilder, StatusCode};
use serde_json::{Value, json};
use tempfile::TempDir;
use union3d::geometry::Edge;
use union3d::service::{SceneName, Service, ServiceConfig};

const PROGRAM: &str = "T1 M6 G90 G21 G0 X0 Y0 Z5 F600\nG1 Z-2\nG1 X30\nG1 Y20\nM30\n";
const CHANGE: &str = r#"{"insert":[{"id":1,"at":[0,0,0]},{"id":2,"at":[9,0,0]}],"delete":[7]}"#;

fn union3d() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_union3d"));
    command.env_remove("UNION3D_KEY").stdin(Stdio::null());
    command
}

/// A server of the program, ended with the test; what it logs goes to a file.
struct Server {
    child: Child,
    http: String,
    grpc: String,
    log: PathBuf,
    _directory: TempDir,
}

impl Server {
    fn start(arguments: &[&str]) -> Self {
        union3d::wire::trust::install_provider();
        let directory = tempfile::tempdir().unwrap();
        let log = directory.path().join("log");
        let mut command = union3d();
        command.args(["serve", "--log-format", "json", "--data"]);
        command.arg(directory.path().join("data")).args(arguments);
        for protocol in ["--http", "--grpc"] {
            if !arguments.contains(&protocol) {
                command.args([protocol, "127.0.0.1:0"]);
            }
        }
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(File::create(&log).unwrap())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        out.read_line(&mut line).unwrap();
        let addresses: Vec<&str> = line.split_whitespace().skip(1).collect();
        let [http, grpc] = addresses[..] else {
            panic!(
                "it did not start: {line}{}",
                fs::read_to_string(&log).unwrap()
            );
        };
        Self {
            http: http.to_owned(),
            grpc: grpc.to_owned(),
            child,
            log,
            _directory: directory,
        }
    }

    fn log(&self) -> String {
        fs::read_to_string(&self.log).unwrap()
    }

    /// The lines of the audit log, without times and spans.
    fn audited(&self) -> Vec<Value> {
        let lines = self.log();
        let lines = lines
            .lines()
            .map(|line| serde_json::from_str(line).unwrap());
        let lines = lines.filter(|line: &Value| line["target"] == "audit");
        lines.map(|mut line| line["fields"].take()).collect()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

/// Makes a key with the program, its line added to the file: the key.
fn key(file: &Path, name: &str, rights: &str, scenes: &str) -> String {
    let made = union3d()
        .args([
            "key", "new", "--name", name, "--rights", rights, "--scenes", scenes,
        ])
        .output()
        .unwrap();
    assert!(made.status.success(), "{made:?}");
    let (line, key) = (text(&made.stdout), text(&made.stderr));
    assert_eq!((line.lines().count(), key.lines().count()), (1, 1));
    let before = fs::read_to_string(file).unwrap_or_default();
    fs::write(file, before + &line).unwrap();
    key.trim().to_owned()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

async fn send(request: RequestBuilder) -> (StatusCode, Value) {
    let answer = request.send().await.unwrap();
    (answer.status(), answer.json().await.unwrap_or_default())
}

/// The program's clients believe a server by its certificate, and by nothing else.
#[test]
fn the_programs_clients_speak_tls() {
    let authority = certificates::Authority::new();
    let files = authority.files();
    let server = Server::start(&[
        "--tls-certificate",
        files.certificate.to_str().unwrap(),
        "--tls-key",
        files.key.to_str().unwrap(),
    ]);
    assert!(server.http.starts_with("https://") && server.grpc.starts_with("grpcs://"));
    let program = authority.path().join("part.nc");
    fs::write(&program, PROGRAM).unwrap();
    let ca = authority.path().join("ca.pem");
    for (scene, address) in [
        ("part-1", ["--server", &*server.http]),
        ("part-2", ["--grpc", &*server.grpc]),
    ] {
        let stranger = mill(&program, address, scene, |_| ());
        assert!(!stranger.status.success());
        let told = text(&stranger.stderr);
        assert!(
            told.contains("certificate") && told.contains("--ca FILE"),
            "{told}"
        );
        let known = mill(&program, address, scene, |mill| {
            mill.arg("--ca").arg(&ca);
        });
        assert!(known.status.success(), "{known:?}");
    }
    let copies = authority.path().join("copies");
    let mut backup = union3d();
    backup
        .args(["backup", "--server", &server.http, "--to"])
        .arg(&copies);
    let copied = backup.arg("--ca").arg(&ca).output().unwrap();
    assert!(copied.status.success(), "{copied:?}");
    assert_eq!(fs::read_dir(&copies).unwrap().count(), 2);
    let none = mill(&program, ["--server", &server.http], "part-3", |mill| {
        mill.arg("--ca").arg(&program);
    });
    let told = text(&none.stderr);
    assert!(told.contains("--ca") && told.contains("part.nc"), "{told}");
}

/// Runs `mill` into a server.
fn mill(program: &Path, server: [&str; 2], scene: &str, more: impl FnOnce(&mut Command)) -> Output {
    let mut command = union3d();
    command.arg("mill").arg(program).args(server).args([
        "--scene",
        scene,
        "--tool",
        "T1=flat:6,length=22",
        "--stock",
        "0,0,-10:40,30,0",
    ]);
    more(&mut command);
    command.output().unwrap()
}

#[tokio::test]
async fn the_programs_clients_show_their_key_and_the_audit_log_tells_whose_it_was() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("keys.toml");
    let admin = key(&file, "boss", "admin", "part-*");
    let reader = key(&file, "reader", "read", "*");
    let server = Server::start(&["--keys", file.to_str().unwrap(), "--log-filter", "trace"]);
    let program = directory.path().join("part.nc");
    fs::write(&program, PROGRAM).unwrap();
    let key_file = directory.path().join("boss.key");
    fs::write(&key_file, format!("{admin}\n")).unwrap();

    for server in [["--server", &*server.http], ["--grpc", &*server.grpc]] {
        let without = mill(&program, server, "part-0", |_| ());
        assert!(!without.status.success());
        assert!(text(&without.stderr).contains("--key-file"), "{without:?}");
        let reads = mill(&program, server, "part-0", |mill| {
            mill.env("UNION3D_KEY", &reader);
        });
        assert!(text(&reads.stderr).contains("reader"), "{reads:?}");
    }
    let over_http = mill(&program, ["--server", &server.http], "part-1", |mill| {
        mill.arg("--key-file").arg(&key_file);
    });
    assert!(over_http.status.success(), "{over_http:?}");
    let over_grpc = mill(&program, ["--grpc", &server.grpc], "part-2", |mill| {
        mill.env("UNION3D_KEY", &admin);
    });
    assert!(over_grpc.status.success(), "{over_grpc:?}");
    let replaced = mill(&program, ["--grpc", &server.grpc], "part-2", |mill| {
        mill.arg("--replace").arg("--key-file").arg(&key_file);
    });
    assert!(replaced.status.success(), "{replaced:?}");
    let nobody = mill(&program, ["--server", &server.http], "part-1", |mill| {
        mill.arg("--key-file").arg(directory.path().join("none"));
    });
    assert!(text(&nobody.stderr).contains("--key-file"), "{nobody:?}");

    let http = Client::new();
    let scene = format!("{}/v1/scenes/part-3", server.http);
    let settings = json!({"edge": 2});
    assert_eq!(
        send(http.put(&scene).bearer_auth(&admin).json(&settings))
            .await
            .0,
        201
    );
    let change = |query: &str, key: &str| {
        let request = http
            .post(format!("{scene}/changes{query}"))
            .bearer_auth(key);
        request
            .header("content-type", "application/json")
            .body(CHANGE)
    };
    assert_eq!(send(change("?dry_run=true", &admin)).await.0, 200);
    assert_eq!(send(change("", &admin)).await.0, 200);
    assert_eq!(send(change("", &reader)).await.0, 403);
    assert_eq!(send(change("?x=y", &admin)).await.0, 422);
    let lines = "{\"delete\":1}\n{\"insert\":{\"id\":5,\"at\":[0,0,0]}}\nno line\n";
    let stream = http.post(format!("{scene}/changes")).bearer_auth(&admin);
    let stopped = send(
        stream
            .header("content-type", "application/x-ndjson")
            .body(lines),
    )
    .await;
    assert_eq!(
        (stopped.0, &stopped.1["committed_lines"]),
        (StatusCode::BAD_REQUEST, &json!(2))
    );
    assert_eq!(
        send(http.delete(format!("{scene}/cubes/2")).bearer_auth(&admin))
            .await
            .0,
        200
    );
    let revert = http.post(format!("{scene}/revert")).bearer_auth(&admin);
    assert_eq!(send(revert.json(&json!({"to": 1}))).await.0, 200);
    assert_eq!(send(http.delete(&scene).bearer_auth(&admin)).await.0, 204);
    assert_eq!(
        send(
            http.get(format!("{}/v1/scenes", server.http))
                .bearer_auth(&reader)
        )
        .await
        .0,
        200
    );

    let audited = server.audited();
    let of = |scene: &str| -> Vec<Value> {
        let lines = audited.iter().filter(|line| line["scene"] == scene);
        lines.cloned().collect()
    };
    let line = |call: &str, key: &str, seq: Option<u64>, counts: [u64; 3], outcome: &str| {
        let [inserted, deleted, unchanged] = counts;
        let mut line = json!({"call": call, "key": key, "scene": "part-3", "inserted": inserted, "deleted": deleted, "unchanged": unchanged, "outcome": outcome});
        if let Some(seq) = seq {
            line["seq"] = seq.into();
        }
        line
    };
    let expected = [
        line("CreateScene", "boss", None, [0, 0, 0], "done"),
        line("ApplyChange", "boss", Some(0), [2, 0, 1], "dry-run"),
        line("ApplyChange", "boss", Some(1), [2, 0, 1], "done"),
        line("ApplyChange", "reader", None, [0, 0, 0], "forbidden"),
        line("ApplyChange", "boss", None, [0, 0, 0], "invalid"),
        line("ApplyChange", "boss", Some(2), [1, 1, 0], "bad-json"),
        line("DeleteCube", "boss", Some(3), [0, 1, 0], "done"),
        line("RevertScene", "boss", Some(4), [2, 1, 0], "done"),
        line("DeleteScene", "boss", None, [0, 0, 0], "done"),
    ];
    assert_eq!(of("part-3"), expected);
    // Of a stream one line, with the number of its changes, however many they are.
    let streams: Vec<Value> = of("part-2")
        .into_iter()
        .filter(|line| line["call"] == "StreamChanges" && line["changes"].is_u64())
        .collect();
    assert_eq!(streams.len(), 1, "{streams:?}");
    assert_eq!(streams[0]["key"], "boss");
    assert_eq!(streams[0]["outcome"], "done", "{streams:?}");
    assert!(
        streams[0]["changes"].as_u64().unwrap() >= 3
            && streams[0]["inserted"].as_u64().unwrap() >= 3,
        "{streams:?}"
    );
    let refused: BTreeSet<String> = of("part-0")
        .iter()
        .map(|line| format!("{} {} {}", line["call"], line["key"], line["outcome"]))
        .collect();
    assert_eq!(
        refused,
        BTreeSet::from(["\"CreateScene\" \"reader\" \"forbidden\"".to_owned()])
    );
    for key in [&admin, &reader] {
        let secret = &key["u3d_".len()..];
        assert!(!server.log().contains(secret), "a key is in the log");
    }
}

/// A changed file is taken up by a server that runs.
#[tokio::test]
async fn a_new_key_is_let_in_without_a_restart() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("keys.toml");
    key(&file, "first", "read", "*");
    let server = Server::start(&["--keys", file.to_str().unwrap()]);
    let second = key(&file, "second", "read", "*");
    let http = Client::new();
    while send(
        http.get(format!("{}/v1/scenes", server.http))
            .bearer_auth(&second),
    )
    .await
    .0 != 200
    {
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    assert!(server.log().contains("keys.toml"));
}

#[test]
fn keys_that_cannot_be_are_refused_with_what_is_wrong() {
    for (arguments, told) in [
        (
            ["--name", "a b", "--rights", "read", "--scenes", "*"],
            "\"a b\"",
        ),
        (["--name", "a", "--rights", "all", "--scenes", "*"], "all"),
        (
            ["--name", "a", "--rights", "read", "--scenes", "p-*,No"],
            "\"No\"",
        ),
    ] {
        let refused = union3d()
            .args(["key", "new"])
            .args(arguments)
            .output()
            .unwrap();
        assert!(!refused.status.success());
        assert!(
            refused.stdout.is_empty() && text(&refused.stderr).contains(told),
            "{refused:?}"
        );
    }
}

/// What a server says that does not start.
fn refused(arguments: &[&str], environment: &[(&str, &str)]) -> String {
    let directory = tempfile::tempdir().unwrap();
    let output = union3d()
        .args(["serve", "--data"])
        .arg(directory.path().join("data"))
        .args(arguments)
        .envs(environment.iter().copied())
        .output()
        .unwrap();
    assert!(!output.status.success(), "{arguments:?} is not refused");
    assert!(
        !directory.path().join("data").exists(),
        "a refused start leaves something behind"
    );
    text(&output.stderr)
}

#[tokio::test]
async fn an_address_that_others_reach_needs_keys_and_tls_or_the_word_insecure() {
    const LOOPBACK: [&str; 2] = ["--grpc", "127.0.0.1:0"];
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("keys.toml");
    let known = key(&file, "known", "read", "*");
    for address in ["0.0.0.0:0", ":0"] {
        let said = refused(&[&["--http", address], &LOOPBACK[..]].concat(), &[]);
        assert!(
            said.contains("--keys") && said.contains("--insecure"),
            "{said}"
        );
    }
    let said = refused(
        &[
            "--http",
            "127.0.0.1:0",
            "--grpc",
            "0.0.0.0:0",
            "--keys",
            file.to_str().unwrap(),
        ],
        &[],
    );
    assert!(!said.contains("--keys") && said.contains("TLS"), "{said}");
    let said = refused(
        &[
            "--http",
            "127.0.0.1:0",
            "--grpc",
            "127.0.0.1:0",
            "--keys",
            "/nowhere/keys.toml",
        ],
        &[],
    );
    assert!(said.contains("/nowhere/keys.toml"), "{said}");

    let server = Server::start(&[
        "--http",
        "0.0.0.0:0",
        "--insecure",
        "--keys",
        file.to_str().unwrap(),
    ]);
    assert!(
        server.log().contains("insecure: 0.0.0.0"),
        "{}",
        server.log()
    );
    let here = server.http.replace("0.0.0.0", "127.0.0.1");
    let (_, ready) = send(Client::new().get(format!("{here}/readyz"))).await;
    assert!(
        ready["warnings"][0]
            .as_str()
            .unwrap()
            .starts_with("insecure: "),
        "{ready}"
    );
    assert_eq!(
        send(Client::new().get(format!("{here}/v1/scenes"))).await.0,
        401
    );
    assert_eq!(
        send(
            Client::new()
                .get(format!("{here}/v1/scenes"))
                .bearer_auth(known)
        )
        .await
        .0,
        200
    );
    let closed = Server::start(&[]);
    assert_eq!(
        send(Client::new().get(format!("{}/readyz", closed.http)))
            .await
            .1["warnings"],
        json!([])
    );
}

#[tokio::test]
async fn names_are_addresses() {
    let server = Server::start(&["--http", "localhost:0", "--grpc", "localhost:0"]);
    for address in [&server.http, &server.grpc] {
        assert!(
            address.contains("://127.0.0.1:") || address.contains("://[::1]:"),
            "{address}"
        );
    }
    let (status, _) = send(Client::new().get(format!("{}/healthz", server.http))).await;
    assert_eq!(status, 200);
    let said = refused(&["--http", "localhost"], &[]);
    assert!(said.contains("localhost:7373"), "{said}");
    let said = refused(&["--http", "no-such-host.invalid:0"], &[]);
    assert!(said.contains("no-such-host.invalid:0"), "{said}");
}

/// The flags for pages of other origins and for names, to the end.
#[tokio::test]
async fn the_flags_say_who_may_ask() {
    let page = "http://localhost:3000";
    let server = Server::start(&["--allow-origin", page, "--allowed-host", "union3d.example"]);
    let http = Client::new();
    let question = http
        .request(
            reqwest::Method::OPTIONS,
            format!("{}/v1/scenes/part", server.http),
        )
        .header("origin", page)
        .header("access-control-request-method", "POST");
    let answer = question.send().await.unwrap();
    assert_eq!(answer.status(), 204);
    assert_eq!(answer.headers()["access-control-allow-origin"], page);
    let scenes = || http.get(format!("{}/v1/scenes", server.http));
    assert_eq!(
        send(scenes().header("host", "union3d.example:80")).await.0,
        200
    );
    assert_eq!(send(scenes().header("host", "evil.example")).await.0, 421);
    for arguments in [["--allow-origin", "*"], ["--allowed-host", "a:80"]] {
        let said = refused(&arguments, &[]);
        assert!(said.contains(arguments[1]), "{said}");
    }
}

#[test]
fn a_misspelt_setting_is_named_with_its_place() {
    let said = refused(&[], &[("UNION3D_HTPP", "127.0.0.1:0")]);
    assert!(said.contains("UNION3D_HTPP"), "{said}");
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("union3d.toml");
    fs::write(
        &file,
        "# settings\nhttp = '127.0.0.1:0'\nkyes = 'keys.toml'\n",
    )
    .unwrap();
    let said = refused(&["--config", file.to_str().unwrap()], &[]);
    assert!(said.contains("union3d.toml, line 3: kyes"), "{said}");
}

/// Who reads the beginning only, as `head` does, has not done anything wrong.
#[test]
fn an_output_that_nobody_reads_ends_quietly() {
    let directory = tempfile::tempdir().unwrap();
    let program = directory.path().join("part.nc");
    fs::write(&program, PROGRAM).unwrap();
    let cubes = directory.path().join("cubes.csv");
    fs::write(&cubes, "0,0,0\n").unwrap();
    let (program, cubes) = (program.to_str().unwrap(), cubes.to_str().unwrap());
    for arguments in [
        vec![
            "mill",
            program,
            "--tool",
            "T1=flat:6,length=22",
            "--stock",
            "0,0,-10:40,30,0",
        ],
        vec![
            "mill",
            program,
            "--tool",
            "T1=flat:6,length=22",
            "--stock",
            "0,0,-10:40,30,0",
            "--json",
        ],
        vec!["mill", program, "--edge", "6", "--stock", "0,0,-10:40,30,0"],
        vec!["path", program],
        vec!["path", program, "--format", "ndjson"],
        vec!["measure", cubes, "--edge", "1"],
    ] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let output = union3d().args(&arguments).stdout(writer).output().unwrap();
        assert_eq!(output.status.code(), Some(141), "{arguments:?}: {output:?}");
        assert_eq!(text(&output.stderr), "", "{arguments:?}");
    }
}

/// What is in a scene is its owner's: nobody else can read a file of it, nor look into its directory. Also of one that an earlier version
/// left open.
#[tokio::test]
async fn files_are_for_their_owner_alone() {
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().join("new/data");
    let scene = data.join("scenes/s");
    let files = || -> Vec<PathBuf> {
        let entries = fs::read_dir(&scene).unwrap();
        entries.map(|entry| entry.unwrap().path()).collect()
    };
    let check = || {
        for directory in [&*scene, &data.join("scenes")] {
            assert_eq!(mode(directory), 0o700, "{}", directory.display());
        }
        let all = files();
        for file in all.iter().chain([&data.join("lock")]) {
            assert_eq!(mode(file), 0o600, "{}", file.display());
        }
        let names: Vec<&str> = all
            .iter()
            .map(|file| file.file_name().unwrap().to_str().unwrap())
            .collect();
        for name in [
            "scene.sqlite",
            "scene.sqlite-wal",
            "scene.sqlite-shm",
            "acknowledged",
        ] {
            assert!(names.contains(&name), "no {name} in {names:?}");
        }
    };
    let service = Service::start(ServiceConfig::new(&data)).unwrap();
    let name = SceneName::new("s").unwrap();
    service
        .create(&name, Edge::new(2).unwrap(), None, "{}")
        .await
        .unwrap();
    assert_eq!(mode(&data), 0o700);
    check();
    service.shutdown().await;
    for path in files().iter().chain([&scene, &data.join("scenes")]) {
        let open = if path.is_dir() { 0o755 } else { 0o644 };
        fs::set_permissions(path, Permissions::from_mode(open)).unwrap();
    }
    let service = Service::start(ServiceConfig::new(&data)).unwrap();
    while service
        .scene("s")
        .and_then(|scene| scene.published())
        .is_err()
    {
        tokio::task::yield_now().await;
    }
    check();
}
