//! The memory that messages take: calls are refused without it, streams wait for it, and it is given back.

use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::time::Duration;

use tonic::Code;
use tonic::transport::Endpoint;
use tonic_types::StatusExt;
use union3d::service::{Client as Holder, FailHook, FailPoint, ServiceConfig, Share};
use union3d::wire::http::Limits;
use union3d::wire::proto::union_service_client::UnionServiceClient;
use union3d::wire::proto::{ApplyChangeRequest, Change, OnRefusal};

use crate::server::{NONE, Server, eventually, refused, row};
use crate::stop::Stop;
use crate::streams::{acknowledged, next, opened, opening, stream, tagged};

/// All of it, in bytes. One client comes to half, which is a message of some 21,000.
const MEMORY_BYTES: u64 = 1 << 20;

/// What a byte of a message takes.
const WEIGHT: u64 = 24;

async fn start(limits: Limits, faults: Option<FailHook>) -> Server {
    let small = |mut config: ServiceConfig| {
        config.memory_bytes_max = MEMORY_BYTES;
        config
    };
    let server = Server::with(limits, small, faults).await;
    server.scene("part", 6).await;
    server
}

/// Somebody at this address holds so much.
fn hold(server: &Server, address: Ipv4Addr, bytes: u64) -> Share {
    let mut share = server
        .service
        .budget()
        .share(Holder::at(IpAddr::V4(address)));
    assert!(share.take(bytes));
    share
}

async fn holds(server: &Server, what: &str, expected: impl Fn(u64) -> bool) {
    eventually(what, async || expected(server.service.budget().held())).await;
}

/// Some 3,000 bytes.
fn change(number: u64) -> Change {
    let first = 1 + number * 500;
    row(first..first + 500)
}

#[tokio::test]
async fn a_message_that_never_fits_is_too_large() {
    let server = start(Limits::default(), None).await;
    let status = server.change("part", row(1..10_000)).await.unwrap_err();
    refused(&status, Code::ResourceExhausted, "too-large");
    let text = status.message();
    assert!(
        text.contains("21845 bytes") && text.contains("memory_bytes_max"),
        "{text}"
    );
    assert!(status.get_details_retry_info().is_none());
    // Nor does a stream wait for what never comes.
    let first = opening("part", OnRefusal::Stop, NONE);
    let (send, messages) = tokio::sync::mpsc::channel(2);
    send.send(first).await.unwrap();
    let messages = tokio_stream::wrappers::ReceiverStream::new(messages);
    let mut answers = stream(&mut server.client(), messages).await;
    opened(&mut answers).await;
    send.send(tagged(1, row(1..10_000))).await.unwrap();
    let status = next(&mut answers).await.unwrap().unwrap_err();
    refused(&status, Code::ResourceExhausted, "too-large");
    drop(answers);
    holds(&server, "all is given back", |held| held == 0).await;
    assert_eq!(server.totals("part").await.seq, 0);
}

/// A call is refused while its client holds its share, to be sent again; small ones never are, and others have theirs.
#[tokio::test]
async fn a_call_of_a_client_that_holds_its_share_is_refused() {
    let server = start(Limits::default(), None).await;
    let share = hold(&server, Ipv4Addr::LOCALHOST, MEMORY_BYTES / 2);
    let status = server.change("part", change(0)).await.unwrap_err();
    refused(&status, Code::ResourceExhausted, "memory-used");
    let retry = status.get_details_retry_info().unwrap();
    assert_eq!(retry.retry_delay, Some(Duration::from_secs(1)));
    assert_eq!(server.totals("part").await.seq, 0);
    server.change("part", row(1..2)).await.unwrap();
    let other = Endpoint::from_shared(server.grpc.clone()).unwrap();
    let other = other.local_address(Some(IpAddr::V4(Ipv4Addr::new(127, 0, 0, 2))));
    let mut other = UnionServiceClient::new(other.connect().await.unwrap());
    let request = ApplyChangeRequest {
        scene: "part".to_owned(),
        change: Some(change(0)),
        ..ApplyChangeRequest::default()
    };
    other.apply_change(request).await.unwrap();
    drop(share);
    server.change("part", change(1)).await.unwrap();
    assert_eq!(server.service.budget().held(), 0);
}

/// A stream with more than there is memory for goes through: what is queued holds its memory, and what comes behind it waits.
#[tokio::test]
async fn a_stream_waits_for_memory() {
    const CHANGES: u64 = 150;
    let stop = Arc::new(Stop::default());
    let server = start(Limits::default(), Some(stop.hook(FailPoint::Append))).await;
    let closed = stop.close();
    let first = opening("part", OnRefusal::Stop, NONE);
    let changes = (0..CHANGES).map(|number| tagged(number, change(number)));
    let all_bytes: usize = changes
        .clone()
        .map(|change| prost::Message::encoded_len(&change))
        .sum();
    assert!(WEIGHT * all_bytes as u64 > 4 * MEMORY_BYTES);
    let messages = tokio_stream::iter(std::iter::once(first).chain(changes));
    let mut answers = stream(&mut server.client(), messages).await;
    opened(&mut answers).await;
    let nearly = MEMORY_BYTES / 2 - WEIGHT * (16 << 10);
    holds(&server, "the stream holds its share", |held| held > nearly).await;
    // There is as much for another.
    drop(hold(&server, Ipv4Addr::new(127, 0, 0, 2), MEMORY_BYTES / 4));
    drop(closed);
    for number in 0..CHANGES {
        assert_eq!(acknowledged(&mut answers).await.tag, number);
    }
    assert!(next(&mut answers).await.is_none());
    drop(answers);
    holds(&server, "all is given back", |held| held == 0).await;
    assert_eq!(server.totals("part").await.seq, CHANGES);
}

/// A stream whose client holds its share elsewhere, for longer than any wait may take, is told so.
#[tokio::test]
async fn a_stream_does_not_wait_for_ever() {
    let limits = Limits {
        request_timeout: Duration::from_millis(200),
        ..Limits::default()
    };
    let server = start(limits, None).await;
    let first = opening("part", OnRefusal::Stop, NONE);
    let (send, messages) = tokio::sync::mpsc::channel(2);
    send.send(first).await.unwrap();
    let messages = tokio_stream::wrappers::ReceiverStream::new(messages);
    let mut answers = stream(&mut server.client(), messages).await;
    opened(&mut answers).await;
    let share = hold(&server, Ipv4Addr::LOCALHOST, MEMORY_BYTES / 2);
    send.send(tagged(1, change(1))).await.unwrap();
    let status = next(&mut answers).await.unwrap().unwrap_err();
    refused(&status, Code::ResourceExhausted, "memory-used");
    drop((share, answers));
    holds(&server, "all is given back", |held| held == 0).await;
}
