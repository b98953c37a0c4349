//! Frames of HTTP/2 that cost work and ask for nothing.

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

use crate::server::{PATIENCE, Server, Setup};

const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

const HEADERS: u8 = 1;
const PRIORITY: u8 = 2;
const RST_STREAM: u8 = 3;
const SETTINGS: u8 = 4;
const PING: u8 = 6;
const GOAWAY: u8 = 7;
const WINDOW_UPDATE: u8 = 8;

const END_STREAM: u8 = 1;
const END_HEADERS: u8 = 4;

/// Far more than any client needs.
const FLOOD: u32 = 100_000;

fn frame(kind: u8, flags: u8, stream: u32, payload: &[u8]) -> Vec<u8> {
    let length = u32::try_from(payload.len()).unwrap().to_be_bytes();
    let mut bytes = vec![length[1], length[2], length[3], kind, flags];
    bytes.extend_from_slice(&stream.to_be_bytes());
    bytes.extend_from_slice(payload);
    bytes
}

/// `GET /healthz` as HPACK has it: indexed fields, and literals that are not indexed.
fn get(stream: u32) -> Vec<u8> {
    let mut block = vec![0x82, 0x86];
    block.extend_from_slice(&[0x04, 8]);
    block.extend_from_slice(b"/healthz");
    block.extend_from_slice(&[0x01, 9]);
    block.extend_from_slice(b"localhost");
    frame(HEADERS, END_STREAM | END_HEADERS, stream, &block)
}

/// What is answered to frames, up to the end of the connection: the kinds of the frames, and the code of the GOAWAY.
struct Answered {
    kinds: Vec<u8>,
    goaway: Option<u32>,
}

async fn read(stream: &mut (impl AsyncReadExt + Unpin)) -> Answered {
    let (mut kinds, mut goaway) = (Vec::new(), None);
    loop {
        let mut head = [0; 9];
        if stream.read_exact(&mut head).await.is_err() {
            return Answered { kinds, goaway };
        }
        let length = u32::from_be_bytes([0, head[0], head[1], head[2]]);
        let mut payload = vec![0; length as usize];
        if stream.read_exact(&mut payload).await.is_err() {
            return Answered { kinds, goaway };
        }
        if head[3] == GOAWAY {
            goaway = Some(u32::from_be_bytes(payload[4..8].try_into().unwrap()));
        }
        kinds.push(head[3]);
    }
}

/// Sends frames, made one by one, until they are all sent or the server closes.
async fn flood(server: &Server, frames: impl Fn(u32) -> Vec<u8>) -> Answered {
    let stream = TcpStream::connect(&server.grpc).await.unwrap();
    let (mut from, mut to) = stream.into_split();
    let mut begun = PREFACE.to_vec();
    begun.extend(frame(SETTINGS, 0, 0, &[]));
    to.write_all(&begun).await.unwrap();
    let writing = async {
        for from in (0..FLOOD).step_by(100) {
            let some: Vec<u8> = (from..from + 100).flat_map(&frames).collect();
            if to.write_all(&some).await.is_err() {
                break;
            }
        }
    };
    let both = async { tokio::join!(writing, read(&mut from)).1 };
    timeout(PATIENCE, both).await.expect("it is closed")
}

#[tokio::test]
async fn floods_are_closed() {
    let server = Server::start(Setup::default()).await;
    let odd = |index: u32| 2 * index + 1;
    type Made = Box<dyn Fn(u32) -> Vec<u8>>;
    let floods: [(&str, Made); 6] = [
        ("PING", Box::new(|_| frame(PING, 0, 0, &[0; 8]))),
        ("PING, answered", Box::new(|_| frame(PING, 1, 0, &[0; 8]))),
        ("SETTINGS", Box::new(|_| frame(SETTINGS, 0, 0, &[]))),
        (
            "RST_STREAM",
            Box::new(move |index| {
                let reset = frame(RST_STREAM, 0, odd(index), &[0, 0, 0, 8]);
                [get(odd(index)), reset].concat()
            }),
        ),
        (
            "PRIORITY",
            Box::new(|_| frame(PRIORITY, 0, 1, &[0, 0, 0, 3, 1])),
        ),
        (
            "WINDOW_UPDATE",
            Box::new(|_| frame(WINDOW_UPDATE, 0, 0, &[0, 0, 0, 1])),
        ),
    ];
    for (name, frames) in floods {
        let answered = flood(&server, frames).await;
        let pings = answered.kinds.iter().filter(|kind| **kind == PING).count();
        assert!(pings < 10_000, "{name}: {pings} PINGs were answered");
        // When the system still holds unread frames, the end of the connection may overtake the last frame.
        assert!(
            matches!(answered.goaway, None | Some(11)),
            "{name}: {:?}",
            answered.goaway
        );
    }
    assert!(
        server
            .metric("union3d_connections_closed_total{reason=\"flood\"}")
            .await
            >= 5.0
    );
}

#[tokio::test]
async fn a_client_that_is_answered_may_ask_whether_the_server_is_there() {
    let server = Server::start(Setup::default()).await;
    let stream = TcpStream::connect(&server.http).await.unwrap();
    let (mut from, mut to) = stream.into_split();
    let mut begun = PREFACE.to_vec();
    begun.extend(frame(SETTINGS, 0, 0, &[]));
    begun.extend(frame(SETTINGS, 1, 0, &[]));
    to.write_all(&begun).await.unwrap();
    const REQUESTS: u32 = 3_000;
    let writing = async {
        for index in 0..REQUESTS {
            let id = 2 * index + 1;
            let mut some = get(id);
            some.extend(frame(PING, 0, 0, &[0; 8]));
            some.extend(frame(PING, 0, 0, &[0; 8]));
            some.extend(frame(WINDOW_UPDATE, 0, 0, &[0, 0, 1, 0]));
            to.write_all(&some).await.unwrap();
            // No more at a time than the server takes.
            let mut head = [0; 9];
            let mut is_answered = false;
            while !is_answered {
                from.read_exact(&mut head).await.unwrap();
                let length = u32::from_be_bytes([0, head[0], head[1], head[2]]);
                let mut payload = vec![0; length as usize];
                from.read_exact(&mut payload).await.unwrap();
                assert!(head[3] != GOAWAY && head[3] != RST_STREAM, "{head:?}");
                is_answered = head[3] == 0 && head[4] & END_STREAM != 0;
            }
        }
    };
    timeout(PATIENCE, writing).await.expect("all are answered");
}
