//! The memory that messages take of the budget that all share: as their bytes arrive, whatever they announce, until they are handled.
//!
//! ```text
//!   pieces of a body ── take ── messages ──┬── a call: held until its answer begins; refused when the client holds its share
//!                                          └── a stream of changes: parted, one share a change, until it is judged;
//!                                              nothing is read while the client holds its share
//! ```

use std::collections::VecDeque;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody};
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::Response;
use hyper::body::Frame;
use parking_lot::Mutex;
use tokio::time::{Instant, Sleep, sleep_until};

use super::framing::{Framing, Mark, PREFIX_BYTES};
use super::status::status;
use crate::service::{Budget, Share};
use crate::wire::problem::Problem;
use crate::wire::room::{MESSAGE_WEIGHT, client, share_used, too_large, weighed};

/// The end of the path of the call whose messages are handed over one by one.
const STREAM: &str = "/StreamChanges";

/// So many bytes of a call that is no stream are not counted: who asks takes no less otherwise, and a client whose stream has its share
/// reads all the same.
const UNCOUNTED_BYTES_MAX: usize = 1024;

/// So many bytes are taken at once: what has come together is parted, so that it fits a small share, too.
const PIECE_BYTES_MAX: usize = 4096;

/// A wait that is looked at so much later than it ended was not looked at meanwhile, as nobody read the answers of the stream.
const LATE: Duration = Duration::from_secs(1);

/// What rooms are made of.
#[derive(Clone)]
pub(super) struct Rooms {
    pub(super) budget: Budget,
    /// How long a stream waits for memory without getting any.
    pub(super) wait_max: Duration,
}

/// Middleware: the messages of a call take memory.
pub(super) async fn taken(
    State(rooms): State<Rooms>,
    mut request: Request,
    next: Next,
) -> Response {
    let share = rooms.budget.share(client(request.extensions()));
    let room = Room(Arc::new(Mutex::new(Held {
        share,
        lengths: VecDeque::new(),
    })));
    let is_stream = request.uri().path().ends_with(STREAM);
    request.extensions_mut().insert(room.clone());
    let wait_max = rooms.wait_max;
    let request = request.map(|body| {
        Body::new(Weighed {
            body,
            room: room.clone(),
            is_stream,
            framing: Framing::default(),
            rest: Bytes::new(),
            bytes: 0,
            wait_max,
            waiting: None,
            is_over: false,
        })
    });
    let answer = next.run(request).await;
    // Not before: of a call that is no stream its one message is handled now.
    drop(room);
    answer
}

/// What the messages of one call hold.
#[derive(Clone)]
pub(super) struct Room(Arc<Mutex<Held>>);

struct Held {
    /// For what has arrived and was not handed over.
    share: Share,
    /// Of a stream: how long each message is that has begun and was not handed over, with its prefix.
    lengths: VecDeque<usize>,
}

/// The room of a call.
pub(super) fn of<T>(request: &tonic::Request<T>) -> Room {
    let room = request.extensions().get::<Room>();
    room.expect("the layer gives every call its room").clone()
}

impl Room {
    /// The share of the message that was handed over just now.
    pub(super) fn of_next_message(&self) -> Share {
        let mut held = self.0.lock();
        let length = held.lengths.pop_front();
        let length = length.expect("a message that is whole has begun");
        held.share.part(weighed(length, MESSAGE_WEIGHT))
    }
}

/// A body whose bytes take memory.
struct Weighed {
    body: Body,
    room: Room,
    /// Whether it is a stream, which waits for memory.
    is_stream: bool,
    framing: Framing,
    /// What has come and was not looked at.
    rest: Bytes,
    /// How much was looked at.
    bytes: usize,
    wait_max: Duration,
    waiting: Option<Waiting>,
    is_over: bool,
}

/// A piece that waits for memory.
struct Waiting {
    piece: Bytes,
    taken: Pin<Box<dyn Future<Output = Share> + Send>>,
    end: Pin<Box<Sleep>>,
}

impl Weighed {
    /// Sees what a piece of a body begins.
    fn follow(&mut self, piece: &[u8]) -> Result<(), Problem> {
        let mut held = self.room.0.lock();
        if !self.is_stream && !self.framing.is_within() {
            // What came before in it is handled: other calls have one message, or wait for each answer.
            held.share.keep(0);
        }
        let bytes_max = held.share.budget().share_max() / MESSAGE_WEIGHT;
        let mut fits = true;
        self.framing.follow(piece, |mark| {
            let Mark::Announces(length) = mark else {
                return;
            };
            let length = length.saturating_add(PREFIX_BYTES);
            fits &= u64::try_from(length).is_ok_and(|length| length <= bytes_max);
            if self.is_stream {
                held.lengths.push_back(length);
            }
        });
        // It would never come to its end.
        fits.then_some(()).ok_or_else(|| too_large(bytes_max))
    }

    /// Takes what a piece weighs; nothing when it has to be waited for.
    fn take(&mut self, piece: Bytes) -> Option<Result<Bytes, Problem>> {
        self.bytes = self.bytes.saturating_add(piece.len());
        if !self.is_stream && self.bytes <= UNCOUNTED_BYTES_MAX {
            return Some(Ok(piece));
        }
        let weight = weighed(piece.len(), MESSAGE_WEIGHT);
        let mut held = self.room.0.lock();
        if held.share.take(weight) {
            return Some(Ok(piece));
        }
        if !self.is_stream {
            return Some(Err(share_used()));
        }
        let mut share = held.share.part(0);
        self.waiting = Some(Waiting {
            piece,
            taken: Box::pin(async move {
                share.take_when_free(weight).await;
                share
            }),
            end: Box::pin(sleep_until(Instant::now() + self.wait_max)),
        });
        None
    }

    /// The piece that waits, when there is one, as soon as there is memory for it.
    fn poll_waiting(&mut self, context: &mut Context<'_>) -> Poll<Option<Result<Bytes, Problem>>> {
        let Some(Waiting { taken, end, .. }) = &mut self.waiting else {
            return Poll::Ready(None);
        };
        if let Poll::Ready(share) = taken.as_mut().poll(context) {
            self.room.0.lock().share.join(share);
            let piece = self.waiting.take().map(|waiting| Ok(waiting.piece));
            return Poll::Ready(piece);
        }
        ready!(end.as_mut().poll(context));
        while end.deadline().elapsed() > LATE {
            end.as_mut().reset(Instant::now() + self.wait_max);
            ready!(end.as_mut().poll(context));
        }
        Poll::Ready(Some(Err(share_used())))
    }

    fn poll_piece(
        &mut self,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Error>>> {
        let refused = |problem: &Problem| Some(Err(status(problem, "").into()));
        loop {
            match ready!(self.poll_waiting(context)) {
                Some(Ok(piece)) => return Poll::Ready(Some(Ok(Frame::data(piece)))),
                Some(Err(problem)) => return Poll::Ready(refused(&problem)),
                None => {}
            }
            if self.rest.is_empty() {
                let Some(frame) = ready!(Pin::new(&mut self.body).poll_frame(context)) else {
                    return Poll::Ready(None);
                };
                match frame.map(Frame::into_data) {
                    Ok(Ok(bytes)) => self.rest = bytes,
                    Ok(Err(trailers)) => return Poll::Ready(Some(Ok(trailers))),
                    Err(error) => return Poll::Ready(Some(Err(error.into()))),
                }
            }
            let piece = self.rest.split_to(self.rest.len().min(PIECE_BYTES_MAX));
            if let Err(problem) = self.follow(&piece) {
                return Poll::Ready(refused(&problem));
            }
            match self.take(piece) {
                Some(Ok(piece)) => return Poll::Ready(Some(Ok(Frame::data(piece)))),
                Some(Err(problem)) => return Poll::Ready(refused(&problem)),
                None => {}
            }
        }
    }
}

type Error = Box<dyn std::error::Error + Send + Sync>;

impl HttpBody for Weighed {
    type Data = Bytes;
    type Error = Error;

    fn poll_frame(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Error>>> {
        let this = self.get_mut();
        if this.is_over {
            return Poll::Ready(None);
        }
        let frame = ready!(this.poll_piece(context));
        this.is_over = !matches!(frame, Some(Ok(_)));
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        let nothing_waits = self.waiting.is_none() && self.rest.is_empty();
        self.is_over || (nothing_waits && self.body.is_end_stream())
    }
}
