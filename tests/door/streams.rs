//! A stream of small changes is slowed down by a slow disk, whatever the sizes of its frames, and takes no more memory than its window.

use std::sync::Arc;

use bytes::Bytes;
use h2::RecvStream;
use prost::Message;
use tokio::net::TcpStream;
use tokio::time::timeout;
use union3d::service::FailPoint;
use union3d::wire::proto::{
    Change, StreamChangesRequest, StreamChangesResponse, StreamOpening, StreamedChange,
    stream_changes_request as request, stream_changes_response as response,
};

use crate::server::{PATIENCE, Server, Setup, call, framed, http2};
use crate::stop::Stop;

/// Many times as many as the windows hold.
const CHANGES: u64 = 30_000;

fn opening() -> Vec<u8> {
    framed(&StreamChangesRequest {
        message: Some(request::Message::Opening(StreamOpening {
            scene: "a".to_owned(),
            ..StreamOpening::default()
        })),
    })
}

fn change(id: u64) -> Vec<u8> {
    let change = Change {
        insert_id: vec![id],
        x: vec![id as i32],
        y: vec![0],
        z: vec![0],
        ..Change::default()
    };
    framed(&StreamChangesRequest {
        message: Some(request::Message::Change(StreamedChange {
            tag: id,
            change: Some(change),
            ..StreamedChange::default()
        })),
    })
}

/// Sends bytes in frames of this size, as far as the server takes them; `stalled` is told when it takes no more for now.
async fn send(
    body: &mut h2::SendStream<Bytes>,
    bytes: Vec<u8>,
    size: usize,
    stalled: &mut impl FnMut(),
) {
    let mut bytes = Bytes::from(bytes);
    while !bytes.is_empty() {
        body.reserve_capacity(size.min(bytes.len()));
        while body.capacity() == 0 {
            let more = std::future::poll_fn(|context| {
                let polled = body.poll_capacity(context);
                if polled.is_pending() {
                    stalled();
                }
                polled
            });
            more.await.unwrap().unwrap();
        }
        let length = size.min(bytes.len()).min(body.capacity());
        body.send_data(bytes.split_to(length), false).unwrap();
    }
}

/// Reads acknowledgements up to that of the last change, in their order.
async fn acknowledged(mut body: RecvStream) {
    let (mut read, mut next) = (Vec::new(), 1);
    while next <= CHANGES {
        let data = body.data().await.expect("it goes on").unwrap();
        let _ = body.flow_control().release_capacity(data.len());
        read.extend_from_slice(&data);
        let mut at = 0;
        while let Some(prefix) = read.get(at..at + 5) {
            let length = u32::from_be_bytes(prefix[1..].try_into().unwrap()) as usize;
            let Some(message) = read.get(at + 5..at + 5 + length) else {
                break;
            };
            let message = StreamChangesResponse::decode(message).unwrap();
            if let Some(response::Message::Acknowledged(done)) = message.message {
                assert_eq!(done.tag, next);
                next += 1;
            }
            at += 5 + length;
        }
        read.drain(..at);
    }
}

async fn stream(size: usize) {
    let stop = Arc::new(Stop::default());
    let setup = Setup {
        faults: Some(stop.hook(FailPoint::Append)),
        ..Setup::default()
    };
    let server = Server::start(setup).await;
    server.scene("a").await;
    let (requests, _driven) = http2(TcpStream::connect(&server.grpc).await.unwrap()).await;
    let mut requests = requests.ready().await.unwrap();
    let call = call(&server.grpc, "/union3d.v1.UnionService/StreamChanges");
    let (answer, mut body) = requests.send_request(call, false).unwrap();
    send(&mut body, opening(), size, &mut || ()).await;
    let answer = answer.await.unwrap().into_body();
    // Nothing is committed until the client is held back.
    let mut closed = Some(stop.close());
    let mut held_back_at = None;
    let sending = async {
        for id in 1..=CHANGES {
            let mut stalled = || {
                held_back_at.get_or_insert(id);
                drop(closed.take());
            };
            send(&mut body, change(id), size, &mut stalled).await;
        }
    };
    let both = async { tokio::join!(sending, acknowledged(answer)) };
    timeout(PATIENCE, both).await.expect("all are acknowledged");
    let held_back_at = held_back_at.expect("the client was held back");
    assert!((3_000..20_000).contains(&held_back_at), "{held_back_at}");
}

#[tokio::test(flavor = "multi_thread")]
async fn whole_changes_in_frames() {
    stream(usize::MAX).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_byte_a_frame() {
    stream(1).await;
}
