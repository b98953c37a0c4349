//! The memory that requests share: what is held while bodies arrive, and what clients are told when it is used up.

use std::io::{Read, Write};
use std::net::TcpStream;

use union3d::wire::http::Limits;

use crate::server::{JSON, Server, eventually};

/// All of it, in bytes. One client comes to half, which is a body of JSON of a sixteenth.
const MEMORY_BYTES: u64 = 1 << 20;

async fn start() -> (Server, String) {
    let server = Server::with(
        Limits::default(),
        |mut config| {
            config.memory_bytes_max = MEMORY_BYTES;
            config
        },
        None,
    )
    .await;
    let scene = server.scene("s", 2).await;
    (server, scene)
}

/// A change whose body has this many bytes.
fn change(bytes: usize) -> String {
    let body = "{\"insert\":[{\"id\":1,\"at\":[0,0,0]}]}";
    format!("{body}{}", " ".repeat(bytes - body.len()))
}

/// Sends the head of a change and this much of its body.
fn begin(server: &Server, scene: &str, announced: usize, sent: &str) -> TcpStream {
    let mut stream = TcpStream::connect(&server.address).unwrap();
    write!(
        stream,
        "POST {scene}/changes HTTP/1.1\r\nHost: localhost\r\nContent-Type: {JSON}\r\nContent-Length: {announced}\r\nConnection: close\r\n\r\n{sent}"
    )
    .unwrap();
    stream
}

async fn holds(server: &Server, what: &str, expected: impl Fn(u64) -> bool) {
    eventually(what, || {
        let holds = expected(server.service.budget().held());
        async move { holds }
    })
    .await;
}

/// What many connections announce keeps nobody waiting: only bytes that have come count.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_announced_takes_nothing() {
    let (server, scene) = start().await;
    let announcing: Vec<_> = (0..50)
        .map(|_| begin(&server, &scene, 60_000, "{"))
        .collect();
    holds(&server, "the first bytes have come", |held| held == 50 * 8).await;
    let answer = server.change(&scene, &change(60_000)).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
    drop(announcing);
    holds(&server, "all is given back", |held| held == 0).await;
}

/// A client that holds its share is told so, and its bodies that are on their way are taken all the same.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_holds_its_share_is_asked_to_come_again() {
    let (server, scene) = start().await;
    let body = change(60_000);
    let mut first = begin(&server, &scene, body.len(), &body[..50_000]);
    holds(&server, "the first body comes", |held| held == 400_000).await;
    let answer = server.change(&scene, &body).await;
    answer.problem(429, "memory-used");
    assert_eq!(answer.header("retry-after"), "1");
    assert_eq!(server.totals(&scene).await["seq"], 0);
    first.write_all(&body.as_bytes()[50_000..]).unwrap();
    let mut told = String::new();
    first.read_to_string(&mut told).unwrap();
    assert!(told.starts_with("HTTP/1.1 200"), "{told}");
    holds(&server, "the first is answered", |held| held == 0).await;
    let answer = server.change(&scene, &body).await;
    assert_eq!(answer.status, 200, "{}", answer.text);
}

/// What can never fit is told apart from what does not fit now.
#[tokio::test]
async fn what_is_larger_than_a_share_is_too_large() {
    let (server, scene) = start().await;
    let answer = server.change(&scene, &change(140_000)).await;
    let document = answer.problem(413, "too-large");
    let detail = document["detail"].as_str().unwrap();
    assert!(
        detail.contains("65536") && detail.contains("memory_bytes_max"),
        "{detail}"
    );
    assert_eq!(server.service.budget().held(), 0);
}
