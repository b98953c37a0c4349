//! Requests that somebody else might read in another way.

use tokio::io::AsyncWriteExt;

use crate::server::{Server, Setup, rest, until};

const GOOD: &str = "GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n";

#[tokio::test]
async fn what_can_be_read_in_two_ways_is_refused_and_nothing_after_it_is_read() {
    let server = Server::start(Setup::default()).await;
    for (refused, reason) in [
        ("GET /healthz HTTP/1.1\r\n\r\n", "Host"),
        ("GET /healthz HTTP/1.0\r\n\r\n", "Host"),
        (
            "GET /healthz HTTP/1.1\r\nHost: localhost\r\nHost: localhost\r\n\r\n",
            "Host",
        ),
        (
            "GET /healthz HTTP/1.1\nHost: localhost\n\n",
            "line feed alone",
        ),
        (
            "GET /healthz HTTP/1.1\r\nHost: localhost\nX: y\r\n\r\n",
            "line feed alone",
        ),
        (
            "POST /v1/scenes/a/changes HTTP/1.1\r\nHost: localhost\r\nContent-Length: 4\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
            "both",
        ),
        (
            "POST /v1/scenes/a/changes HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\nContent-Length: 4\r\n\r\n0\r\n\r\n",
            "both",
        ),
        (
            "POST /v1/scenes/a/changes HTTP/1.1\r\nHost: localhost\r\nContent-Length: 4\r\nContent-Length: 5\r\n\r\nabcde",
            "Content-Length",
        ),
    ] {
        let answer = server.ask(format!("{refused}{GOOD}")).await;
        assert!(answer.starts_with("HTTP/1.1 400 "), "{refused:?}: {answer}");
        assert!(answer.contains("application/problem+json"), "{answer}");
        assert!(answer.contains("/problems/bad-request"), "{answer}");
        assert!(answer.contains(reason), "{refused:?}: {answer}");
        assert_eq!(
            answer.matches("HTTP/1.1").count(),
            1,
            "{refused:?}: {answer}"
        );
    }
}

#[tokio::test]
async fn what_came_before_it_is_answered() {
    let server = Server::start(Setup::default()).await;
    let answer = server
        .ask(format!("{GOOD}{GOOD}GET /healthz HTTP/1.1\r\n\r\n{GOOD}"))
        .await;
    assert_eq!(answer.matches("HTTP/1.1 200 ").count(), 2, "{answer}");
    assert_eq!(answer.matches("HTTP/1.1 400 ").count(), 1, "{answer}");
}

#[tokio::test]
async fn requests_follow_each_other_on_a_connection() {
    let server = Server::start(Setup::default()).await;
    server.scene("a").await;
    let mut stream = server.connect().await;
    let body = "{\"insert\":{\"id\":1,\"at\":[0,0,0]}}\n";
    let (first, second) = body.split_at(7);
    let head = "POST /v1/scenes/a/changes HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/x-ndjson\r\n";
    let chunks = format!(
        "{:x}\r\n{first}\r\n{:x};a=b\r\n{second}\r\n0\r\n\r\n",
        first.len(),
        second.len()
    );
    for _ in 0..2 {
        let text = format!("{head}Transfer-Encoding: chunked\r\n\r\n{chunks}");
        stream.write_all(text.as_bytes()).await.unwrap();
        assert!(
            until(&mut stream, "mass_properties")
                .await
                .contains("200 OK")
        );
        let text = format!("{head}Content-Length: {}\r\n\r\n{body}", body.len());
        stream.write_all(text.as_bytes()).await.unwrap();
        assert!(
            until(&mut stream, "mass_properties")
                .await
                .contains("200 OK")
        );
    }
    let last = "GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    stream.write_all(last.as_bytes()).await.unwrap();
    assert!(rest(&mut stream).await.contains("200 OK"));
}
