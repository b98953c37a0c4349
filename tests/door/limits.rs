//! How much connections may take, and for how long they may do nothing.

use std::time::Duration;

use bytes::Bytes;
use tokio::io::AsyncWriteExt;
use union3d::wire::door::Settings;
use union3d::wire::http::Limits;

use crate::server::{PATIENCE, Server, Setup, call, eventually, http2, rest, status, until};

const HEALTH: &str = "GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n";

const SHORT: Duration = Duration::from_millis(200);

async fn with(door: Settings) -> Server {
    let setup = Setup {
        door,
        ..Setup::default()
    };
    Server::start(setup).await
}

#[tokio::test]
async fn connections_of_an_address_are_bounded() {
    let server = with(Settings {
        connections_per_address_max: 2,
        ..Settings::default()
    })
    .await;
    let mut first = server.connect().await;
    first.write_all(HEALTH.as_bytes()).await.unwrap();
    until(&mut first, "ok").await;
    // Of both listeners together.
    let stream = tokio::net::TcpStream::connect(&server.grpc).await.unwrap();
    let (requests, second) = http2(stream).await;
    let requests = requests.ready().await.unwrap();
    let mut third = server.connect().await;
    assert_eq!(rest(&mut third).await, "");
    // Those that are there do not notice.
    first.write_all(HEALTH.as_bytes()).await.unwrap();
    until(&mut first, "ok").await;
    drop(requests);
    let _ = second.await.unwrap();
    eventually("there is a place again", async || {
        server
            .ask(HEALTH.replace("\r\n\r\n", "\r\nConnection: close\r\n\r\n"))
            .await
            .contains("ok")
    })
    .await;
}

#[tokio::test]
async fn a_head_that_does_not_come_to_its_end_is_answered_so() {
    let server = with(Settings {
        head_timeout: SHORT,
        ..Settings::default()
    })
    .await;
    let answer = server
        .ask("GET /healthz HTTP/1.1\r\nHost: localhost\r\nX: y")
        .await;
    assert!(answer.starts_with("HTTP/1.1 408 "), "{answer}");
    assert!(answer.contains("/problems/request-timeout"), "{answer}");
    // The same after a request on the same connection.
    let answer = server
        .ask(format!("{HEALTH}GET /healthz HTTP/1.1\r\n"))
        .await;
    assert!(
        answer.contains("HTTP/1.1 200 ") && answer.contains("HTTP/1.1 408 "),
        "{answer}"
    );
    // Who says nothing at all is not answered.
    assert_eq!(server.ask("").await, "");
}

#[tokio::test]
async fn who_rests_is_closed_and_who_listens_is_not() {
    let server = with(Settings {
        idle_timeout: SHORT,
        ..Settings::default()
    })
    .await;
    server.scene("a").await;
    let mut events = server.connect().await;
    let listen = "GET /v1/scenes/a/mass-properties/stream HTTP/1.1\r\nHost: localhost\r\n\r\n";
    events.write_all(listen.as_bytes()).await.unwrap();
    until(&mut events, "\n\n").await;
    let stream = tokio::net::TcpStream::connect(&server.http).await.unwrap();
    let (requests, _driven) = http2(stream).await;
    let mut requests = requests.ready().await.unwrap();
    let request = axum::http::Request::get("http://localhost/v1/scenes/a/mass-properties/stream");
    let (answer, _) = requests
        .send_request(request.body(()).unwrap(), true)
        .unwrap();
    let mut body = answer.await.unwrap().into_body();
    let first = body.data().await.unwrap().unwrap();
    let _ = body.flow_control().release_capacity(first.len());
    // Connections that begin after them and rest: of HTTP/1 with a request and HTTP/2 with none.
    let answer = server.ask(HEALTH).await;
    assert!(answer.contains("200 OK"), "{answer}");
    let stream = tokio::net::TcpStream::connect(&server.grpc).await.unwrap();
    let (_requests, resting) = http2(stream).await;
    resting.await.unwrap().unwrap();
    let change = "POST /v1/scenes/a/changes HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Type: application/json\r\n";
    let body_text = "{\"insert\":[{\"id\":1,\"at\":[0,0,0]}]}";
    let change = format!(
        "{change}Content-Length: {}\r\n\r\n{body_text}",
        body_text.len()
    );
    assert!(server.ask(change).await.contains("200 OK"));
    until(&mut events, "\"seq\":1").await;
    let mut text = String::new();
    while !text.contains("\"seq\":1") {
        let piece = tokio::time::timeout(PATIENCE, body.data()).await.unwrap();
        let piece = piece.unwrap().unwrap();
        let _ = body.flow_control().release_capacity(piece.len());
        text += std::str::from_utf8(&piece).unwrap();
    }
}

#[tokio::test]
async fn an_answer_that_nobody_reads_does_not_stay() {
    let server = with(Settings {
        unread_timeout: SHORT,
        ..Settings::default()
    })
    .await;
    // The description is some hundred kilobytes; so many of them fill what the system keeps for a connection.
    let mut stream = server.connect().await;
    let requests = "GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n".repeat(1000);
    stream.write_all(requests.as_bytes()).await.unwrap();
    eventually("the connection is closed", async || {
        stream.writable().await.unwrap();
        stream
            .try_write(b" ")
            .is_err_and(|error| error.kind() != std::io::ErrorKind::WouldBlock)
    })
    .await;
}

#[tokio::test]
async fn a_message_that_does_not_come_to_its_end_is_not_waited_for() {
    let setup = Setup {
        limits: Limits {
            request_timeout: SHORT,
            ..Limits::default()
        },
        ..Setup::default()
    };
    let server = Server::start(setup).await;
    for path in ["ApplyChange", "StreamChanges"] {
        let stream = tokio::net::TcpStream::connect(&server.grpc).await.unwrap();
        let (requests, _driven) = http2(stream).await;
        let mut requests = requests.ready().await.unwrap();
        let call = call(&server.grpc, &format!("/union3d.v1.UnionService/{path}"));
        let (answer, mut body) = requests.send_request(call, false).unwrap();
        // A message of 100 bytes, of which one comes.
        let begun = Bytes::from_static(&[0, 0, 0, 0, 100, 10]);
        body.send_data(begun, false).unwrap();
        assert_eq!(status(answer.await.unwrap()).await, "4", "{path}");
    }
}

#[tokio::test]
async fn a_call_ends_when_its_client_does_not_wait_any_longer() {
    let server = with(Settings::default()).await;
    server.scene("a").await;
    let stream = tokio::net::TcpStream::connect(&server.grpc).await.unwrap();
    let (requests, _driven) = http2(stream).await;
    let mut requests = requests.ready().await.unwrap();
    let mut call = call(&server.grpc, "/union3d.v1.UnionService/StreamChanges");
    call.headers_mut()
        .insert("grpc-timeout", "50m".parse().unwrap());
    let (answer, _body) = requests.send_request(call, false).unwrap();
    assert_eq!(status(answer.await.unwrap()).await, "4");
}

#[tokio::test]
async fn a_server_that_ends_answers_what_it_was_asked() {
    let server = with(Settings::default()).await;
    server.scene("a").await;
    // One rests, one has said nothing yet, and one is sending.
    let mut resting = server.connect().await;
    resting.write_all(HEALTH.as_bytes()).await.unwrap();
    until(&mut resting, "ok").await;
    let mut silent = server.connect().await;
    let stream = tokio::net::TcpStream::connect(&server.grpc).await.unwrap();
    let (requests, resting_too) = http2(stream).await;
    let _requests = requests.ready().await.unwrap();
    let mut changing = server.connect().await;
    let head = "POST /v1/scenes/a/changes HTTP/1.1\r\nHost: localhost\r\nExpect: 100-continue\r\nContent-Type: application/json\r\n";
    let body = "{\"insert\":[{\"id\":1,\"at\":[0,0,0]}]}";
    let head = format!("{head}Content-Length: {}\r\n\r\n", body.len());
    changing.write_all(head.as_bytes()).await.unwrap();
    // The server is asked for the body, so the change is under way.
    until(&mut changing, "100 Continue").await;
    eventually("all are there", async || {
        server.metric("union3d_connections ").await >= 5.0
    })
    .await;
    server.draining.cancel();
    assert_eq!(rest(&mut resting).await, "");
    assert_eq!(rest(&mut silent).await, "");
    resting_too.await.unwrap().unwrap();
    changing.write_all(body.as_bytes()).await.unwrap();
    let answer = rest(&mut changing).await;
    assert!(answer.starts_with("HTTP/1.1 200 "), "{answer}");
    assert!(tokio::net::TcpStream::connect(&server.http).await.is_err());
}
