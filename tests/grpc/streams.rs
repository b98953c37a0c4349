//! Streams of changes: order, refusals, and that nothing piles up on either side.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use tokio::sync::mpsc;
use tokio_stream::{Stream, StreamExt};
use tonic::{Code, Status, Streaming};
use union3d::log::LogError;
use union3d::service::{FailPoint, SceneState, ServiceConfig};
use union3d::wire::http::Limits;
use union3d::wire::proto::{
    Acknowledged, Change, OnRefusal, Opened, Refused, StreamChangesRequest, StreamChangesResponse,
    StreamOpening, StreamedChange, WatchMassPropertiesRequest, stream_changes_request as request,
    stream_changes_response as response,
};

use crate::server::{
    Client, NONE, PATIENCE, Server, VOLUME, deletion, eventually, refused, row, slow_client,
};
use crate::stop::Stop;

pub(crate) fn opening(scene: &str, on_refusal: OnRefusal, detail: i32) -> StreamChangesRequest {
    message(request::Message::Opening(StreamOpening {
        scene: scene.to_owned(),
        detail,
        on_refusal: on_refusal.into(),
    }))
}

fn message(message: request::Message) -> StreamChangesRequest {
    StreamChangesRequest {
        message: Some(message),
    }
}

pub(crate) fn tagged(tag: u64, change: Change) -> StreamChangesRequest {
    message(request::Message::Change(StreamedChange {
        tag,
        change: Some(change),
        idempotency_key: None,
    }))
}

pub(crate) async fn stream(
    client: &mut Client,
    messages: impl Stream<Item = StreamChangesRequest> + Send + 'static,
) -> Streaming<StreamChangesResponse> {
    client.stream_changes(messages).await.unwrap().into_inner()
}

pub(crate) async fn next(
    answers: &mut Streaming<StreamChangesResponse>,
) -> Option<Result<response::Message, Status>> {
    let answer = tokio::time::timeout(PATIENCE, answers.next())
        .await
        .expect("an answer in time");
    answer.map(|answer| answer.map(|answer| answer.message.unwrap()))
}

pub(crate) async fn opened(answers: &mut Streaming<StreamChangesResponse>) -> Opened {
    match next(answers).await {
        Some(Ok(response::Message::Opened(opened))) => opened,
        other => panic!("{other:?}"),
    }
}

pub(crate) async fn acknowledged(answers: &mut Streaming<StreamChangesResponse>) -> Acknowledged {
    match next(answers).await {
        Some(Ok(response::Message::Acknowledged(acknowledged))) => acknowledged,
        other => panic!("{other:?}"),
    }
}

#[tokio::test]
async fn changes_are_acknowledged_in_order_with_their_totals() {
    let server = Server::start().await;
    server.scene("part", 6).await;
    server.change("part", row(1..2)).await.unwrap();
    let first = opening("part", OnRefusal::Unspecified, VOLUME);
    let changes = (0..1_000_u64).map(|index| tagged(index * 7, row(index + 2..index + 3)));
    let messages = tokio_stream::iter(std::iter::once(first).chain(changes));
    let mut answers = stream(&mut server.client(), messages).await;
    let opened = opened(&mut answers).await;
    assert!(opened.window_changes_max > 1);
    assert_eq!(opened.scene.unwrap().seq, Some(1));
    for index in 0..1_000_u64 {
        let Acknowledged { tag, outcome } = acknowledged(&mut answers).await;
        let outcome = outcome.unwrap();
        assert_eq!(
            (tag, outcome.seq, outcome.inserted),
            (index * 7, index + 2, 1)
        );
        // A row of cubes of edge 6, each a step further.
        let volume = 36.0 * (6 + index + 1) as f64;
        assert_eq!(outcome.volumes.unwrap().union, volume);
    }
    assert!(
        next(&mut answers).await.is_none(),
        "the stream ends with OK"
    );
    assert_eq!(server.totals("part").await.seq, 1_001);
}

/// A frame of its own for each small change, as most clients send them, while the disk stands still: an HTTP/2 library that counts
/// unread small frames as an attack ended such a connection after some 2,300 of them, with nothing acknowledged.
#[tokio::test]
async fn small_changes_wait_for_a_slow_disk_however_many_they_are() {
    const CHANGES: u64 = 4_000;
    let stop = Arc::new(Stop::default());
    let server = Server::with(
        Limits::default(),
        |config| config,
        Some(stop.hook(FailPoint::Append)),
    )
    .await;
    server.scene("part", 6).await;
    let closed = stop.close();
    let sent = Arc::new(AtomicU64::new(0));
    let count = Arc::clone(&sent);
    let messages = async_stream::stream! {
        yield opening("part", OnRefusal::Stop, NONE);
        for id in 1..=CHANGES {
            count.store(id, Ordering::Release);
            yield tagged(id, row(id..id + 1));
            // Otherwise the client would put many of them into one frame.
            tokio::task::yield_now().await;
        }
    };
    let mut answers = stream(&mut server.client(), messages).await;
    opened(&mut answers).await;
    eventually("all are on their way", async || {
        sent.load(Ordering::Acquire) == CHANGES
    })
    .await;
    drop(closed);
    for tag in 1..=CHANGES {
        assert_eq!(acknowledged(&mut answers).await.tag, tag);
    }
    assert!(next(&mut answers).await.is_none());
}

/// What is in flight behind a refused change is not applied, however far ahead it was sent.
#[tokio::test]
async fn nothing_after_a_refused_change_is_applied() {
    let stop = Arc::new(Stop::default());
    let server = Server::with(
        Limits::default(),
        |config| config,
        Some(stop.hook(FailPoint::Append)),
    )
    .await;
    // A conflict is found by the scene, a far corner before; both while changes before and after are in flight.
    for (name, bad) in [("conflict", 9_999), ("far", i32::MAX)] {
        server.scene(name, 6).await;
        let wrong = Change {
            x: vec![bad],
            ..row(1..2)
        };
        let first = opening(name, OnRefusal::Unspecified, NONE);
        let before = (1..=20).map(|id| tagged(id, row(id..id + 1)));
        let after = (22..=60).map(|id| tagged(id, row(id..id + 1)));
        let messages = std::iter::once(first)
            .chain(before)
            .chain([tagged(21, wrong)])
            .chain(after);
        let closed = stop.close();
        let messages = tokio_stream::iter(messages.collect::<Vec<_>>());
        let mut answers = stream(&mut server.client(), messages).await;
        opened(&mut answers).await;
        drop(closed);
        for tag in 1..=20 {
            assert_eq!(acknowledged(&mut answers).await.tag, tag);
        }
        let (code, reason) = match name {
            "conflict" => (Code::AlreadyExists, "id-conflict"),
            _ => (Code::InvalidArgument, "invalid"),
        };
        match next(&mut answers).await {
            Some(Ok(response::Message::Refused(Refused { tag: 21, problem }))) => {
                assert_eq!(problem.unwrap().code, reason);
            }
            other => panic!("{other:?}"),
        }
        let end = next(&mut answers).await.unwrap().unwrap_err();
        assert_eq!(refused(&end, code, reason).len(), 1);
        assert!(next(&mut answers).await.is_none());
        // Whoever comes later finds exactly the changes before the refused one, also after all that waited was judged.
        let later = server.change(name, row(100..101)).await.unwrap();
        assert_eq!((later.seq, later.mass_properties.unwrap().cubes), (21, 21));
    }
}

#[tokio::test]
async fn a_stream_goes_on_after_a_refused_change_when_it_is_told_to() {
    let server = Server::start().await;
    server.scene("part", 6).await;
    let wrong = Change {
        x: vec![77],
        ..row(1..2)
    };
    let messages = [
        opening("part", OnRefusal::Continue, NONE),
        tagged(1, row(1..2)),
        tagged(2, wrong),
        tagged(3, row(3..4)),
        tagged(
            4,
            Change {
                y: vec![],
                ..row(4..5)
            },
        ),
        tagged(5, row(5..6)),
    ];
    let mut answers = stream(&mut server.client(), tokio_stream::iter(messages)).await;
    opened(&mut answers).await;
    let mut seen = vec![];
    while let Some(answer) = next(&mut answers).await {
        seen.push(match answer.unwrap() {
            response::Message::Acknowledged(one) => {
                format!("{} {}", one.tag, one.outcome.unwrap().seq)
            }
            response::Message::Refused(one) => format!("{} {}", one.tag, one.problem.unwrap().code),
            response::Message::Opened(_) => panic!("it was opened already"),
        });
    }
    assert_eq!(seen, ["1 1", "2 id-conflict", "3 2", "4 invalid", "5 3"]);
}

#[tokio::test]
async fn a_stream_is_opened_once_and_of_a_scene() {
    let server = Server::start().await;
    server.scene("part", 6).await;
    let mut client = server.client();
    let nowhere = opening("nowhere", OnRefusal::Stop, NONE);
    let refusal = client
        .stream_changes(tokio_stream::once(nowhere))
        .await
        .unwrap_err();
    refused(&refusal, Code::NotFound, "no-such-scene");
    let unopened = client
        .stream_changes(tokio_stream::once(tagged(1, row(1..2))))
        .await
        .unwrap_err();
    assert_eq!(
        refused(&unopened, Code::InvalidArgument, "invalid"),
        ["opening"]
    );
    let twice = [
        opening("part", OnRefusal::Stop, NONE),
        tagged(1, row(1..2)),
        opening("part", OnRefusal::Stop, NONE),
    ];
    let mut answers = stream(&mut client, tokio_stream::iter(twice)).await;
    opened(&mut answers).await;
    assert_eq!(acknowledged(&mut answers).await.tag, 1);
    let end = next(&mut answers).await.unwrap().unwrap_err();
    assert_eq!(refused(&end, Code::InvalidArgument, "invalid"), ["change"]);
}

/// Changes without end, counted as they are taken off the client's hands. Each is some ten kilobytes and changes nothing.
fn endless(
    scene: &str,
    count: &Arc<AtomicU64>,
) -> impl Stream<Item = StreamChangesRequest> + Send + 'static {
    let count = Arc::clone(count);
    let first = opening(scene, OnRefusal::Stop, 0);
    let idle = deletion((1..1_000).map(|id| u64::MAX - id));
    let changes = (0..).map(move |tag| {
        count.store(tag + 1, Ordering::Release);
        tagged(tag, idle.clone())
    });
    tokio_stream::iter(std::iter::once(first).chain(changes))
}

/// What a connection holds by itself (flow control windows and buffers of both sides), in changes of ten kilobytes.
const ON_THE_WAY: u64 = 700;

/// How many changes are sent until no more are, however often the server answers others meanwhile. Looks no further than this many.
async fn stalled(server: &Server, count: &AtomicU64, most: u64) -> u64 {
    loop {
        let before = count.load(Ordering::Acquire);
        for _ in 0..100 {
            // Over HTTP: a connection whose window the changes have filled takes no call.
            assert_eq!(server.get("/v1/scenes/part").await.0, 200);
        }
        let sent = count.load(Ordering::Acquire);
        if sent == before || sent >= most {
            return sent;
        }
    }
}

#[tokio::test]
async fn a_fast_sender_is_slowed_down_and_not_refused() {
    // By the window, and by a queue that is shorter than the window.
    for queue_changes_max in [1024, 16] {
        slowed_down(queue_changes_max).await;
    }
}

async fn slowed_down(queue_changes_max: usize) {
    let stop = Arc::new(Stop::default());
    let config = move |mut config: union3d::service::ServiceConfig| {
        config.queue_changes_max = queue_changes_max;
        config
    };
    let server = Server::with(
        Limits::default(),
        config,
        Some(stop.hook(FailPoint::Append)),
    )
    .await;
    server.scene("part", 6).await;
    let count = Arc::new(AtomicU64::new(0));
    let (go, gate) = tokio::sync::oneshot::channel::<()>();
    let messages = endless("part", &count);
    let messages = async_stream::stream! {
        let mut messages = std::pin::pin!(messages);
        yield messages.next().await.unwrap();
        gate.await.unwrap();
        while let Some(message) = messages.next().await {
            yield message;
        }
    };
    let mut answers = stream(&mut server.client(), messages).await;
    let window = u64::from(opened(&mut answers).await.window_changes_max);
    // One that does change something holds the writer at the disk.
    let closed = stop.close();
    let change = tokio::spawn({
        let mut client = server.client();
        let request = union3d::wire::proto::ApplyChangeRequest {
            scene: "part".to_owned(),
            change: Some(row(1..2)),
            ..Default::default()
        };
        async move { client.apply_change(request).await.unwrap() }
    });
    eventually("the writer is held", async || stop.held() == 1).await;
    go.send(()).unwrap();
    let sent = stalled(&server, &count, window + ON_THE_WAY).await;
    assert!(sent < window + ON_THE_WAY, "{sent} changes were taken in");
    drop(closed);
    for tag in 0..3_000 {
        assert_eq!(acknowledged(&mut answers).await.tag, tag);
        let ahead = count.load(Ordering::Acquire) - tag;
        assert!(ahead < 2 * (window + ON_THE_WAY), "{ahead} ahead");
    }
    change.await.unwrap();
}

#[tokio::test]
async fn who_does_not_read_acknowledgements_is_not_read_either() {
    let server = Server::start().await;
    server.scene("part", 6).await;
    let count = Arc::new(AtomicU64::new(0));
    let mut client = slow_client(&server.grpc).await;
    let mut answers = stream(&mut client, endless("part", &count)).await;
    let window = u64::from(opened(&mut answers).await.window_changes_max);
    let sent = stalled(&server, &count, window + ON_THE_WAY).await;
    assert!(sent < window + ON_THE_WAY, "{sent} changes were taken in");
    for tag in 0..2 * sent {
        assert_eq!(acknowledged(&mut answers).await.tag, tag);
    }
}

/// A reader that sleeps through ten thousand changes is shown a few old states and then the newest.
#[tokio::test]
async fn a_slow_watcher_skips_to_the_newest() {
    const CHANGES: u64 = 10_000;
    let server = Server::start().await;
    server.scene("part", 6).await;
    let mut client = slow_client(&server.grpc).await;
    let watch = WatchMassPropertiesRequest {
        scene: "part".to_owned(),
    };
    let mut watch = client
        .watch_mass_properties(watch)
        .await
        .unwrap()
        .into_inner();
    let first = opening("part", OnRefusal::Stop, NONE);
    let changes = (0..CHANGES).map(|tag| tagged(tag, row(tag..tag + 1)));
    let messages = tokio_stream::iter(std::iter::once(first).chain(changes));
    let mut answers = stream(&mut server.client(), messages).await;
    opened(&mut answers).await;
    for tag in 0..CHANGES {
        assert_eq!(acknowledged(&mut answers).await.tag, tag);
    }
    let (mut states, mut seq) = (0, None);
    while seq != Some(CHANGES) {
        let shown = tokio::time::timeout(PATIENCE, watch.next()).await.unwrap();
        let shown = shown.unwrap().unwrap().mass_properties.unwrap();
        assert!(seq < Some(shown.seq), "{} after {seq:?}", shown.seq);
        seq = Some(shown.seq);
        states += 1;
    }
    assert!(states < 1_000, "{states} states were kept for it");
}

#[tokio::test]
async fn draining_acknowledges_what_is_in_flight() {
    let stop = Arc::new(Stop::default());
    let server = Server::with(
        Limits::default(),
        |config| config,
        Some(stop.hook(FailPoint::Append)),
    )
    .await;
    server.scene("part", 6).await;
    let (send, receive) = mpsc::channel(16);
    let messages = tokio_stream::wrappers::ReceiverStream::new(receive);
    send.send(opening("part", OnRefusal::Stop, NONE))
        .await
        .unwrap();
    let mut answers = stream(&mut server.client(), messages).await;
    opened(&mut answers).await;
    send.send(tagged(1, row(1..2))).await.unwrap();
    assert_eq!(acknowledged(&mut answers).await.tag, 1);
    server.draining.cancel();
    // The client's side stays open; the server ends it all the same.
    let end = next(&mut answers).await.unwrap().unwrap_err();
    refused(&end, Code::Unavailable, "shutting-down");
    tokio::time::timeout(PATIENCE, server.serving)
        .await
        .unwrap()
        .unwrap();
    drop(send);
}

/// When the disk fails it is not known whether a change was kept, so nothing is said about it: the stream ends, and the change can
/// be sent again.
#[tokio::test]
async fn a_failed_disk_is_no_refusal() {
    let fails = Arc::new(AtomicBool::new(false));
    let asked = fails.clone();
    let faults = move |step| {
        let fails = step == FailPoint::Appended && asked.swap(false, Ordering::AcqRel);
        fails.then(|| LogError::Failed {
            path: "log".into(),
            cause: "the disk was pulled".to_owned(),
        })
    };
    let config = |config| ServiceConfig {
        probe_interval: Duration::from_millis(5),
        ..config
    };
    let server = Server::with(Limits::default(), config, Some(Arc::new(faults))).await;
    server.scene("part", 6).await;
    for policy in [OnRefusal::Stop, OnRefusal::Continue] {
        fails.store(policy == OnRefusal::Stop, Ordering::Release);
        let change = Change {
            r#move: Some(7),
            ..row(1..2)
        };
        let messages = [opening("part", policy, NONE), tagged(1, change)];
        let messages = tokio_stream::iter(messages);
        let mut answers = stream(&mut server.client(), messages).await;
        opened(&mut answers).await;
        if policy == OnRefusal::Stop {
            let end = next(&mut answers).await.unwrap().unwrap_err();
            refused(&end, Code::Unavailable, "scene-stopped");
            eventually("the scene is back", async || {
                let back = server.service.scene("part");
                back.is_ok_and(|scene| scene.state() == SceneState::Running)
            })
            .await;
        } else {
            // It had been kept: sent again it is there already, and the same move is not counted twice.
            let outcome = acknowledged(&mut answers).await.outcome.unwrap();
            assert_eq!((outcome.seq, outcome.unchanged), (1, 1));
        }
    }
}

/// After a broken connection the scene's seq and the client's own ids tell where to go on: sending again is safe.
#[tokio::test]
async fn a_client_that_comes_back_goes_on_where_it_was() {
    let server = Server::start().await;
    server.scene("part", 6).await;
    let with_motion = |id| Change {
        r#move: Some(id),
        duration: Some(0.5),
        ..row(id..id + 1)
    };
    let all: Vec<_> = (1..=500_u64)
        .map(|id| tagged(id, with_motion(id)))
        .collect();
    let mut acknowledged_to = 0;
    // Broken off in mid-flight four times, then to the end.
    for reads in [0, 3, 50, 1, usize::MAX] {
        let from = usize::try_from(acknowledged_to).unwrap();
        let messages = std::iter::once(opening("part", OnRefusal::Stop, NONE));
        let messages = messages.chain(all[from..].iter().cloned());
        let mut client = slow_client(&server.grpc).await;
        let messages = tokio_stream::iter(messages.collect::<Vec<_>>());
        let mut answers = stream(&mut client, messages).await;
        let there = opened(&mut answers).await.scene.unwrap();
        assert!(there.seq.unwrap() >= acknowledged_to);
        for _ in 0..reads {
            match next(&mut answers).await {
                Some(Ok(response::Message::Acknowledged(one))) => {
                    assert_eq!(one.tag, acknowledged_to + 1);
                    acknowledged_to = one.tag;
                }
                None => break,
                other => panic!("{other:?}"),
            }
        }
    }
    assert_eq!(acknowledged_to, 500);
    let totals = server.totals("part").await;
    assert_eq!((totals.cubes, totals.seq), (500, 500));
}
