//! What is refused before anybody looks at a scene; and refusals that must arrive.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;
use union3d::log::LogError;
use union3d::service::FailPoint;
use union3d::wire::http::Limits;

use crate::server::{JSON, NDJSON, PATIENCE, Server, eventually, send};
use crate::stop::Stop;

#[tokio::test]
async fn what_the_router_refuses_is_a_problem() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    for path in [
        "/v1",
        "/assets/none.js",
        "/v1/scenes/",
        "/v1/scenes/s/volume",
        "/docs/none.js",
        "/problems/none",
    ] {
        server.get(path).await.problem(404, "no-such-path");
    }
    for (method, path, allow) in [
        ("POST", "/v1/scenes", "GET,HEAD"),
        ("PATCH", "/v1/scenes/s", "PUT,GET,HEAD,DELETE"),
        ("GET", "/v1/scenes/s/changes", "POST"),
        ("DELETE", "/v1/scenes/s/cubes", "GET,HEAD"),
        ("OPTIONS", "/healthz", "GET,HEAD"),
        ("BREW", "/v1/scenes/s/audit", "POST"),
    ] {
        let answer = server.send(method, path, JSON, "").await;
        answer.problem(405, "method-not-allowed");
        assert_eq!(answer.header("allow"), allow, "{method} {path}");
    }
    server
        .get("/v1/scenes/%ff")
        .await
        .problem(400, "bad-request");
    server
        .get("/v1/scenes/none/history")
        .await
        .problem(404, "no-such-scene");
    let head = send(server.request("HEAD", &format!("{scene}/mass-properties"))).await;
    assert_eq!((head.status, head.text.as_str()), (200, ""));
    assert_eq!(head.header("content-type"), JSON);
}

#[tokio::test]
async fn bodies_of_other_types_are_refused() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let changes = format!("{scene}/changes");
    for kind in [
        "text/plain",
        "application/x-www-form-urlencoded",
        "application/xml",
        "",
    ] {
        let answer = server.send("POST", &changes, kind, "{}").await;
        answer.problem(415, "unsupported-media-type");
    }
    let answer = send(server.request("POST", &changes).body("{}")).await;
    answer.problem(415, "unsupported-media-type");
    let answer = server.send("PUT", &scene, NDJSON, "{}").await;
    answer.problem(415, "unsupported-media-type");
    let request = server
        .request("POST", &changes)
        .header("content-encoding", "gzip");
    let answer = send(request.header("content-type", JSON).body("{}")).await;
    answer.problem(415, "unsupported-media-type");
    let answer = server
        .send("POST", &changes, "Application/JSON; charset=utf-8", "{}")
        .await;
    assert_eq!(answer.status, 200);
}

#[tokio::test]
async fn changes_above_the_limits_are_refused() {
    let limits = Limits {
        body_bytes_max: 1_000,
        change_cubes_max: 10,
        ..Limits::default()
    };
    let server = Server::limited(limits).await;
    let scene = server.scene("s", 2).await;
    let ids = |count: usize| json!({"delete": vec![1; count]}).to_string();
    assert_eq!(server.change(&scene, &ids(10)).await.status, 200);
    server
        .change(&scene, &ids(11))
        .await
        .problem(413, "too-large");
    let spaces = |count: usize| format!("{{{}}}", " ".repeat(count - 2));
    assert_eq!(server.change(&scene, &spaces(1_000)).await.status, 200);
    let large = server.change(&scene, &spaces(1_001)).await;
    large.problem(413, "too-large");
    // The same without a length in front.
    let pieces = (0..200).map(|_| Ok::<_, std::io::Error>("          "));
    let body = reqwest::Body::wrap_stream(futures_util::stream::iter(pieces));
    let request = server.request("POST", &format!("{scene}/changes"));
    let answer = send(request.header("content-type", JSON).body(body)).await;
    answer.problem(413, "too-large");
    // A stream as a whole has no limit.
    let lines = "{\"delete\":1}\n".repeat(1_000);
    assert_eq!(server.lines(&scene, &lines).await.ok()["unchanged"], 1_000);
}

/// Many clients send all before they listen. A server that closed early would reset them, and the answer would be lost.
#[tokio::test]
async fn a_client_that_sends_first_and_reads_later_gets_its_answer() {
    let limits = Limits {
        body_bytes_max: 1_000,
        ..Limits::default()
    };
    let server = Server::limited(limits).await;
    let scene = server.scene("s", 2).await;
    const SIZE: usize = 20 << 20;
    for (path, kind, status) in [
        (format!("{scene}/changes"), JSON, 413),
        (format!("{scene}/changes"), "text/plain", 415),
        (format!("{scene}/changes"), NDJSON, 413),
        ("/v1/scenes/none/changes".to_owned(), JSON, 404),
        ("/nowhere".to_owned(), JSON, 404),
        ("/healthz".to_owned(), JSON, 405),
    ] {
        let mut socket = TcpStream::connect(&server.address).await.unwrap();
        let head = format!(
            "POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: {kind}\r\ncontent-length: {SIZE}\r\n\r\n"
        );
        socket.write_all(head.as_bytes()).await.unwrap();
        let sent = timeout(PATIENCE, socket.write_all(&vec![b' '; SIZE])).await;
        sent.unwrap()
            .unwrap_or_else(|error| panic!("{path} {kind}: {error}"));
        let mut answer = vec![0; 1 << 12];
        let count = timeout(PATIENCE, socket.read(&mut answer)).await.unwrap();
        let answer = String::from_utf8_lossy(&answer[..count.unwrap()]).into_owned();
        assert!(
            answer.starts_with(&format!("HTTP/1.1 {status} ")),
            "{path} {kind}: {answer}"
        );
        assert!(answer.contains("application/problem+json"), "{answer}");
    }
    // A client that asks first sends nothing at all.
    let mut socket = TcpStream::connect(&server.address).await.unwrap();
    let head = format!(
        "POST {scene}/changes HTTP/1.1\r\nhost: localhost\r\nexpect: 100-continue\r\ncontent-type: {JSON}\r\ncontent-length: {SIZE}\r\n\r\n"
    );
    socket.write_all(head.as_bytes()).await.unwrap();
    let mut answer = vec![0; 1 << 12];
    let count = timeout(PATIENCE, socket.read(&mut answer)).await.unwrap();
    let answer = String::from_utf8_lossy(&answer[..count.unwrap()]).into_owned();
    assert!(answer.starts_with("HTTP/1.1 413 "), "{answer}");
}

#[tokio::test]
async fn a_body_that_does_not_arrive_is_given_up() {
    let limits = Limits {
        request_timeout: Duration::from_millis(300),
        ..Limits::default()
    };
    let server = Server::limited(limits).await;
    let scene = server.scene("s", 2).await;
    let mut socket = TcpStream::connect(&server.address).await.unwrap();
    let head = format!(
        "POST {scene}/changes HTTP/1.1\r\nhost: localhost\r\ncontent-type: {JSON}\r\ncontent-length: 100\r\n\r\n{{"
    );
    socket.write_all(head.as_bytes()).await.unwrap();
    let mut answer = vec![0; 1 << 12];
    let count = timeout(PATIENCE, socket.read(&mut answer)).await.unwrap();
    let answer = String::from_utf8_lossy(&answer[..count.unwrap()]).into_owned();
    assert!(answer.starts_with("HTTP/1.1 408 "), "{answer}");
    assert!(answer.contains("/problems/request-timeout"), "{answer}");
}

#[tokio::test]
async fn a_slow_disk_is_a_timeout_and_the_change_still_counts() {
    let stop = Arc::new(Stop::default());
    let limits = Limits {
        request_timeout: Duration::from_millis(300),
        ..Limits::default()
    };
    let server = Server::with(limits, |config| config, Some(stop.hook(FailPoint::Append))).await;
    let scene = server.scene("s", 2).await;
    let closed = stop.close();
    let body = r#"{"insert":[{"id":1,"at":[0,0,0]}]}"#;
    let slow = server.change(&scene, body).await;
    slow.problem(503, "answer-timeout");
    drop(closed);
    eventually("the change is there", || async {
        server.totals(&scene).await["cubes"] == 1
    })
    .await;
    assert_eq!(server.change(&scene, body).await.ok()["unchanged"], 1);
}

#[tokio::test]
async fn a_full_disk_says_so_and_heals() {
    let full = Arc::new(AtomicBool::new(false));
    let fails = Arc::clone(&full);
    let faults = move |_| {
        fails.load(Ordering::Acquire).then(|| LogError::Full {
            path: "/data/s".into(),
        })
    };
    let server = Server::with(
        Limits::default(),
        |mut config| {
            config.probe_interval = Duration::from_millis(20);
            config
        },
        Some(Arc::new(faults)),
    )
    .await;
    let scene = server.scene("s", 2).await;
    full.store(true, Ordering::Release);
    let body = r#"{"insert":[{"id":1,"at":[0,0,0]}]}"#;
    let problem = server.change(&scene, body).await.problem(507, "disk-full");
    assert!(
        problem["cause"].as_str().unwrap().contains("no space"),
        "{problem}"
    );
    let lines = server.lines(&scene, "\n{\"delete\":1}\n").await;
    let problem = lines.problem(507, "disk-full");
    assert_eq!(
        (&problem["line"], &problem["committed_lines"]),
        (&json!(2), &json!(1))
    );
    let stopped = server.get(&scene).await.ok();
    assert_eq!(
        (&stopped["state"], &stopped["cubes"]),
        (&json!("stopped"), &json!(null))
    );
    assert_eq!(stopped["edge"], 2.0);
    let ready = server.get("/readyz").await.ok();
    assert_eq!(ready["troubled"][0]["scene"], "s");
    full.store(false, Ordering::Release);
    eventually("the scene is back", || async {
        server.change(&scene, body).await.status == 200
    })
    .await;
    assert_eq!(server.totals(&scene).await["cubes"], 1);
}

/// What a client made up is repeated so far that it is recognised, however long it is.
#[tokio::test]
async fn long_names_are_repeated_cut() {
    let server = Server::start().await;
    let scene = server.scene("s", 2).await;
    let long = "x".repeat(10_000_000);
    let body = format!("{{\"insert\":[{{\"id\":1,\"at\":[0,0,0],\"{long}\":1}}],\"{long}\":1}}");
    let answer = server.change(&scene, &body).await;
    assert_eq!(answer.places().len(), 2);
    assert!(answer.text.len() < 5_000, "{} bytes", answer.text.len());
    let line = format!("{{\"{}\":1}}\n", &long[..60_000]);
    let answer = server.lines(&scene, &line).await;
    assert_eq!(answer.status, 422);
    assert!(answer.text.len() < 5_000, "{} bytes", answer.text.len());
    for path in [
        format!("/{}", &long[..30_000]),
        format!("/v1/scenes/{}", &long[..30_000]),
        format!("/v1/scenes?{}=1", &long[..30_000]),
    ] {
        let answer = server.get(&path).await;
        assert!(answer.status == 404 || answer.status == 422);
        assert!(answer.text.len() < 5_000, "{} bytes", answer.text.len());
    }
}
