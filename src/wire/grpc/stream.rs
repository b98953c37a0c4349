//! A stream of changes: a window of them in flight, each acknowledged in its order.
//!
//! ```text
//!   messages ── one at a time: decode, queue ── in flight, at most WINDOW_CHANGES_MAX ── in order ── acknowledgements
//!                          ▲                                                                  │
//!                          └──── nothing is read while nobody reads what comes out ◄──────────┘
//! ```
//! The memory of a change is taken while it arrives, and given back when it is judged; while there is none, nothing is read.
//! All of it is one stream of answers, which runs only as far as the client reads it: there is no task and no queue besides the
//! scene's own. A window rather than one chunk in flight, as lines of JSON have it: here each change has its own answer, and the
//! chain keeps what follows a refused change from being applied.

use std::future::ready;
use std::pin::Pin;
use std::sync::Arc;

use futures_util::future::BoxFuture;
use futures_util::{Stream, StreamExt, stream};
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;
use tonic::{Status, Streaming};

use super::admission::may;
use super::messages::{self, Detail, MessageKind, unknown};
use super::room::Room;
use super::status::{self, foreign};
use crate::service::{
    Applied, Chain, Counting, Motion, Operations, SceneOf, ServiceError, Share, Submission,
};
use crate::wire::access::{Effect, Ticket};
use crate::wire::atomic::{Atomic, Sent};
use crate::wire::calls;
use crate::wire::http::Limits;
use crate::wire::kind;
use crate::wire::open::OpenStream;
use crate::wire::problem::{Code, Fault, Problem};
use crate::wire::proto::{
    Acknowledged, OnRefusal, Opened, Refused, StreamChangesRequest, StreamChangesResponse,
    StreamOpening, StreamedChange, stream_changes_request as request,
    stream_changes_response as response,
};

/// Changes of one stream that may be in flight: enough that those which wait together fill a commit, and a part only of what the
/// scene's queue holds, so that others still find room.
pub(super) const WINDOW_CHANGES_MAX: u32 = 256;

/// Where in a request the places of faults are.
const BODY: &str = "change";

/// The answers of a stream.
pub(super) type Answers = Pin<Box<dyn Stream<Item = Result<StreamChangesResponse, Status>> + Send>>;

/// The messages of a stream, each with the memory that was taken for it.
pub(super) struct Inbound {
    messages: Streaming<StreamChangesRequest>,
    room: Room,
}

impl Inbound {
    pub(super) fn new(messages: Streaming<StreamChangesRequest>, room: Room) -> Self {
        Self { messages, room }
    }

    /// The next message. Safe to be cancelled.
    async fn message(&mut self) -> Result<Option<(StreamChangesRequest, Share)>, Status> {
        let message = self.messages.message().await?;
        Ok(message.map(|message| (message, self.room.of_next_message())))
    }
}

/// What has come of one message.
enum Done<K: MessageKind> {
    /// A change, with the client's number of it.
    Judged(u64, Result<Box<Applied<K>>, Problem>),
    /// The end: nothing more is read.
    Ended(Status),
}

/// Reads a stream's opening, and gives the answers to all that follows.
pub(super) async fn open(
    service: &crate::service::Service,
    limits: Limits,
    draining: CancellationToken,
    ticket: Ticket,
    mut inbound: Inbound,
) -> Result<Answers, Status> {
    let opening = timeout(limits.request_timeout, inbound.message()).await;
    let opening = opening
        .map_err(|_| Problem::new(Code::RequestTimeout, "the stream was never opened"))
        .map_err(|problem| status::status(&problem, ""))?
        .map_err(|broken| end(&broken))?;
    let opening = opening.and_then(|(first, _)| first.message);
    let Some(request::Message::Opening(opening)) = opening else {
        let fault = Fault::in_parameter("opening", "is not the first message of the stream", "");
        return Err(status::status(&fault.into(), ""));
    };
    let problem = |problem: Problem| status::status(&problem, "opening");
    may(&ticket, &opening)?;
    let StreamOpening {
        scene,
        detail,
        on_refusal,
    } = opening;
    let detail = Detail::of(detail).map_err(problem)?;
    let stops = match OnRefusal::try_from(on_refusal) {
        Ok(OnRefusal::Unspecified | OnRefusal::Stop) => true,
        Ok(OnRefusal::Continue) => false,
        Err(_) => return Err(problem(unknown("on_refusal", on_refusal))),
    };
    let opening = Opening {
        inbound,
        detail,
        stops,
        limits,
        draining,
        ticket,
    };
    match calls::open_any(service, &scene).map_err(problem)? {
        kind::Opened::Cubes(scene, settings) => opening.open(scene, settings).await,
        kind::Opened::Solids(scene, settings) => opening.open(scene, settings).await,
    }
}

/// A stream whose first message was read.
struct Opening {
    inbound: Inbound,
    detail: Detail,
    /// Whether nothing is applied after a refused change.
    stops: bool,
    limits: Limits,
    draining: CancellationToken,
    /// Kept by the answers, so that the audit log has its line when the stream is over.
    ticket: Ticket,
}

impl Opening {
    async fn open<K: MessageKind>(
        self,
        scene: Arc<SceneOf<K>>,
        settings: Arc<K::Settings>,
    ) -> Result<Answers, Status> {
        let problem = |problem: Problem| status::status(&problem, "opening");
        let Self {
            inbound,
            detail,
            stops,
            limits,
            draining,
            ticket,
        } = self;
        // What an earlier stream of the client has queued is done before: so the seq in the answer is after it.
        let nothing = Submission {
            operations: Operations::Named(Vec::new()),
            counting: Counting::Net,
            motion: Motion::default(),
            key: None,
        };
        let queued = scene.submit(nothing, None).await;
        let done = queued.map_err(|error| problem(error.into()))?.await;
        done.map_err(|error| problem(error.into()))?;
        let reader = Reader {
            inbound,
            scene: scene.clone(),
            settings: settings.clone(),
            chain: stops.then(Chain::default),
            cubes_max: limits.change_cubes_max,
            draining,
            over: false,
        };
        let window = usize::try_from(WINDOW_CHANGES_MAX).expect("a window is small");
        let open = OpenStream::grpc();
        Ok(Box::pin(async_stream::stream! {
            // Counted as long as there are answers to come.
            let _open = open;
            yield Ok(answer(response::Message::Opened(Opened {
                scene: Some(messages::scene(&K::any(scene.clone()))),
                window_changes_max: WINDOW_CHANGES_MAX,
            })));
            let mut effect = Effect::default();
            let mut done = std::pin::pin!(stream::unfold(reader, Reader::next).buffered(window));
            while let Some(done) = done.next().await {
                let (tag, problem) = match done {
                    Done::Judged(tag, Ok(applied)) => {
                        effect.add(&applied);
                        ticket.did(effect);
                        let outcome = Some(messages::outcome(detail, &scene, &settings, &applied));
                        yield Ok(answer(response::Message::Acknowledged(Acknowledged { tag, outcome })));
                        continue;
                    }
                    Done::Judged(tag, Err(problem)) => (tag, problem),
                    Done::Ended(status) => {
                        ticket.failed(status.code().description());
                        yield Err(status);
                        break;
                    }
                };
                // Of another failure it is not known whether the change was kept: the stream ends without a word about it.
                let concerns_it = concerns_the_change(problem.code());
                if concerns_it {
                    let refused = Refused {
                        tag,
                        problem: Some(status::message(&problem, BODY).1),
                    };
                    yield Ok(answer(response::Message::Refused(refused)));
                }
                if stops || !concerns_it {
                    ticket.failed(problem.code().kind().code);
                    yield Err(status::status(&problem, BODY));
                    break;
                }
            }
            ticket.done();
        }))
    }
}

fn answer(message: response::Message) -> StreamChangesResponse {
    StreamChangesResponse {
        message: Some(message),
    }
}

/// Whether another change may fare better.
fn concerns_the_change(code: Code) -> bool {
    matches!(
        code,
        Code::Invalid | Code::TooLarge | Code::IdConflict | Code::SceneFull | Code::KeyReused
    )
}

/// The status of a stream that cannot be read on.
fn end(broken: &Status) -> Status {
    match foreign(broken) {
        Some(problem) => status::status(&problem, ""),
        None => broken.clone(),
    }
}

/// Takes messages and queues the changes in them, one after the other.
struct Reader<K: MessageKind> {
    inbound: Inbound,
    scene: Arc<SceneOf<K>>,
    settings: Arc<K::Settings>,
    /// There when nothing may be applied after a refused change.
    chain: Option<Chain>,
    cubes_max: usize,
    draining: CancellationToken,
    /// Whether nothing more is read.
    over: bool,
}

impl<K: MessageKind> Reader<K> {
    async fn next(mut self) -> Option<(BoxFuture<'static, Done<K>>, Self)> {
        let broken = self.chain.as_ref().is_some_and(Chain::is_broken);
        if self.over || broken {
            return None;
        }
        let message = tokio::select! {
            biased;
            () = self.draining.cancelled() => {
                let problem = ServiceError::ShuttingDown.into();
                return Some(self.ended(status::status(&problem, "")));
            }
            message = self.inbound.message() => message,
        };
        let (change, share) = match message {
            Ok(None) => return None,
            Ok(Some((
                StreamChangesRequest {
                    message: Some(request::Message::Change(change)),
                },
                share,
            ))) => (change, share),
            Ok(Some(_)) => {
                let detail = "is missing: after the first message each has a change";
                let problem = Fault::in_parameter(BODY, detail, "").into();
                return Some(self.ended(status::status(&problem, "")));
            }
            Err(broken) => {
                let status = end(&broken);
                return Some(self.ended(status));
            }
        };
        let tag = change.tag;
        match self.queue(change).await {
            Ok(judged) => {
                let done = async move {
                    let judged = judged.await.map(Box::new);
                    drop(share);
                    Done::Judged(tag, judged)
                };
                Some((Box::pin(done), self))
            }
            Err(problem) => {
                // It never came into the chain, so it does not break it: what was queued before it stands.
                self.over = self.chain.is_some();
                Some((Box::pin(ready(Done::Judged(tag, Err(problem)))), self))
            }
        }
    }

    fn ended(mut self, status: Status) -> (BoxFuture<'static, Done<K>>, Self) {
        self.over = true;
        (Box::pin(ready(Done::Ended(status))), self)
    }

    /// Queues a change, as soon as there is room; what this gives waits until it is durable.
    async fn queue(
        &self,
        change: StreamedChange,
    ) -> Result<impl Future<Output = Result<Applied<K>, Problem>> + Send + use<K>, Problem> {
        let key = super::idempotency_key(change.idempotency_key.as_deref())?;
        let sent = Sent::Message(Box::new(change.change.unwrap_or_default()));
        let atomic = Atomic::new(
            self.scene.clone(),
            self.settings.clone(),
            sent,
            self.cubes_max,
        );
        atomic.queued(key, self.chain.clone()).await
    }
}
