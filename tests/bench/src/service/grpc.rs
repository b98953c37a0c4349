//! Clients that stream changes over gRPC, some ahead of their acknowledgements.

use std::cell::Cell;
use std::collections::VecDeque;
use std::net::SocketAddr;
use std::rc::Rc;
use std::time::{Duration, Instant};

use tokio::sync::mpsc;
use tokio::task::LocalSet;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::{Channel, Endpoint};
use union3d::wire::proto::union_service_client::UnionServiceClient;
use union3d::wire::proto::{
    Change, Detail, StreamChangesRequest, StreamOpening, StreamedChange,
    stream_changes_request as request, stream_changes_response as response,
};

use super::load::Done;
use crate::failure::Failure;
use crate::figures::Latencies;

/// Fewest and most changes that a client has on their way: the most is the server's, of small changes.
pub(super) const WINDOW: [usize; 2] = [16, 256];

/// So many bodies a client has on their way between the two.
const BODIES_IN_FLIGHT: usize = 1 << 16;

/// Has `clients` stream the changes into a scene, each over a connection of its own, until time is over or nothing is left to
/// send. What is under way then is waited for, and counts.
pub(super) async fn run(
    server: SocketAddr,
    scene: &str,
    clients: usize,
    changes: Rc<Vec<Change>>,
    time: Duration,
) -> Result<Done, Failure> {
    let mut channels = Vec::new();
    for _ in 0..clients {
        let endpoint = Endpoint::from_shared(format!("http://{server}"))?;
        channels.push(endpoint.connect().await?);
    }
    let next = Rc::new(Cell::new(0));
    let started = Instant::now();
    let tasks_here = LocalSet::new();
    let tasks: Vec<_> = channels
        .into_iter()
        .map(|channel| {
            let (changes, next, scene) = (Rc::clone(&changes), Rc::clone(&next), scene.to_owned());
            let take = move || {
                let index = next.replace(next.get() + 1);
                let over = started.elapsed() >= time;
                changes.get(index).filter(|_| !over).cloned()
            };
            tasks_here.spawn_local(async move {
                let streamed = stream(channel, scene, take).await;
                streamed.map_err(|error| error.to_string())
            })
        })
        .collect();
    tasks_here.await;
    let mut done = Done {
        time: started.elapsed(),
        ..Done::default()
    };
    for task in tasks {
        let latencies = task.await??;
        done.requests += latencies.len();
        done.latencies.extend(&latencies);
    }
    Ok(done)
}

/// One stream: sends what `take` gives until it gives nothing, and reads every acknowledgement.
async fn stream(
    channel: Channel,
    scene: String,
    take: impl Fn() -> Option<Change>,
) -> Result<Latencies, Failure> {
    let (to, requests) = mpsc::channel(WINDOW[1] + 1);
    let message = |message| StreamChangesRequest {
        message: Some(message),
    };
    let opening = StreamOpening {
        scene,
        detail: Detail::None.into(),
        ..StreamOpening::default()
    };
    to.send(message(request::Message::Opening(opening))).await?;
    let mut client = UnionServiceClient::new(channel);
    let answers = client.stream_changes(ReceiverStream::new(requests)).await?;
    let mut answers = answers.into_inner();
    let mut to = Some(to);
    let mut in_flight = VecDeque::new();
    let mut window = WINDOW[0];
    let mut latencies = Latencies::default();
    let mut tag = 0;
    loop {
        while let Some(sender) = to.as_ref().filter(|_| in_flight.len() < window) {
            let Some(change) = take() else {
                // Closing this side ends the stream when all is acknowledged.
                to = None;
                break;
            };
            tag += 1;
            let [fewest, most] = WINDOW;
            let bodies = change.insert_id.len().max(1);
            window = (BODIES_IN_FLIGHT / bodies).clamp(fewest, most);
            let change = StreamedChange {
                tag,
                change: Some(change),
                ..StreamedChange::default()
            };
            in_flight.push_back(Instant::now());
            sender
                .send(message(request::Message::Change(change)))
                .await?;
        }
        let Some(answer) = answers.message().await? else {
            break;
        };
        match answer.message {
            Some(response::Message::Acknowledged(_)) => {
                let since = in_flight
                    .pop_front()
                    .ok_or("the server acknowledges more than was sent")?;
                latencies.push(since.elapsed());
            }
            Some(response::Message::Refused(refused)) => {
                let problem = refused.problem.unwrap_or_default();
                return Err(format!("a change is refused: {}", problem.detail).into());
            }
            Some(response::Message::Opened(_)) | None => {}
        }
    }
    if in_flight.is_empty() {
        Ok(latencies)
    } else {
        Err("the server ended the stream without acknowledging everything".into())
    }
}
