//! A connection of HTTP/2: its requests side by side, each in a task of its own.
//!
//! ```text
//!   a turn: empty the frames that came (body) ── read a little more ── take new requests ── let others have their turn
//! ```
//! By the library h2 itself rather than by hyper over it: what bounds the memory of a connection is that frames are emptied between
//! two reads, and how much is read between, and neither can be had from there.

use std::future::{pending, poll_fn};
use std::pin::pin;
use std::sync::Arc;
use std::task::Poll;
use std::time::{Duration, SystemTime};

use axum::body::{Body, Bytes, HttpBody};
use axum::http::{HeaderValue, Request, Response, header};
use futures_util::StreamExt;
use futures_util::stream::FuturesUnordered;
use h2::server::SendResponse;
use h2::{Ping, PingPong, Reason, SendStream};
use http_body_util::BodyExt;
use tokio::time::{Instant, sleep, sleep_until, timeout};
use tokio_util::sync::CancellationToken;

use super::activity::{Activity, Overdue};
use super::body::pumped;
use super::frames::{Allowance, Frames};
use super::socket::Socket;
use super::{CLOSE_TIMEOUT, Closed, Desk, Settings};

/// Requests of one connection at a time; a client that needs more opens another connection.
const REQUESTS_MAX: u32 = 128;

/// Bytes of one request that may be on their way here before it is read further: flow control holds back a client that sends more.
const WINDOW_BYTES: u32 = 128 << 10;

/// The same of all requests of a connection together: one that is not read does not hold up the others.
const CONNECTION_WINDOW_BYTES: u32 = REQUESTS_MAX * WINDOW_BYTES;

/// Size of a request's head.
const HEAD_BYTES_MAX: u32 = 64 << 10;

/// Bytes of an answer that wait to be sent, before more of it is made.
const SEND_BYTES_MAX: usize = 64 << 10;

/// Bytes read in one turn. A frame takes 9 bytes and what is in it; so this bounds the frames that wait to be emptied.
const READ_BYTES_MAX: usize = 32 << 10;

/// What the library may charge for frames that wait: at most 255 for each, which it has read in a turn, and what was left in its
/// buffer from the turn before. With this a connection is never closed for the sizes of its frames.
const FRAME_BUDGET: usize = 2 * 255 * (READ_BYTES_MAX / 10);

/// A connection on which nothing comes for so long is asked whether it is still there, and closed when it does not answer.
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(30);
const KEEPALIVE_TIMEOUT: Duration = Duration::from_secs(20);

/// Serves a connection to its end.
/// # Errors
/// Why it was ended before the client wanted it.
pub(super) async fn serve(
    socket: Socket,
    activity: Arc<Activity>,
    desk: Desk,
    settings: &Settings,
    draining: CancellationToken,
) -> Result<(), Closed> {
    let allowance = Arc::new(Allowance::default());
    allowance.renew(READ_BYTES_MAX);
    let handshake = h2::server::Builder::new()
        .max_concurrent_streams(REQUESTS_MAX)
        .initial_window_size(WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
        .max_header_list_size(HEAD_BYTES_MAX)
        .max_send_buffer_size(SEND_BYTES_MAX)
        .data_frame_budget(FRAME_BUDGET)
        .handshake::<_, Bytes>(Frames::new(socket, allowance.clone()));
    let mut connection = timeout(settings.head_timeout, handshake)
        .await
        .map_err(|_| Overdue::Head)??;
    let pings = connection.ping_pong().expect("nobody has taken it");
    let mut silence = pin!(silence(pings, &activity));
    let mut pumps = FuturesUnordered::new();
    let mut is_ending = false;
    // Whether a turn goes on: it lasts until there is no further request in what was read.
    let mut is_turn = false;
    loop {
        let turn = poll_fn(|context| {
            while let Poll::Ready(Some(())) = pumps.poll_next_unpin(context) {}
            if !is_turn {
                allowance.renew(READ_BYTES_MAX);
            }
            let polled = pin!(connection.accept()).poll(context);
            is_turn = polled.is_ready();
            if allowance.is_flooded() {
                return Poll::Ready(Err(Closed::Flood));
            }
            polled.map(Ok)
        });
        let accepted = tokio::select! {
            biased;
            accepted = turn => accepted,
            () = draining.cancelled(), if !is_ending => {
                is_ending = true;
                connection.graceful_shutdown();
                continue;
            }
            overdue = activity.overdue(settings) => {
                if overdue == Overdue::Idle {
                    connection.graceful_shutdown();
                    close(connection).await;
                }
                return Err(overdue.into());
            }
            overdue = &mut silence => return Err(overdue.into()),
        };
        let accepted = match accepted {
            Ok(Some(accepted)) => accepted,
            Ok(None) => return Ok(()),
            Err(flood) => {
                connection.abrupt_shutdown(Reason::ENHANCE_YOUR_CALM);
                close(connection).await;
                return Err(flood);
            }
        };
        let (request, respond) = accepted?;
        let (head, stream) = request.into_parts();
        let (pump, body) = pumped(stream);
        pumps.extend(pump);
        let underway = activity.begin();
        let answering = Answering {
            desk: desk.clone(),
            allowance: allowance.clone(),
            unread_timeout: settings.unread_timeout,
        };
        tokio::spawn(async move {
            let request = Request::from_parts(head, body);
            if let Err(error) = answering.answer(request, respond).await {
                tracing::debug!("an answer did not get through: {error}");
            }
            drop(underway);
        });
    }
}

/// Lets the client hear that the connection ends.
async fn close(mut connection: h2::server::Connection<Frames, Bytes>) {
    let closed = poll_fn(|context| connection.poll_closed(context));
    // One that does not listen, or does not close its end, is not waited for longer.
    let _ = timeout(CLOSE_TIMEOUT, closed).await;
}

/// Waits until the client has said nothing for a while, and does not answer a PING either.
async fn silence(mut pings: PingPong, activity: &Activity) -> Overdue {
    loop {
        let quiet_at = activity.read_at() + KEEPALIVE_INTERVAL;
        if Instant::now() < quiet_at {
            sleep_until(quiet_at).await;
            continue;
        }
        let mut answered = pin!(pings.ping(Ping::opaque()));
        loop {
            tokio::select! {
                answered = &mut answered => match answered {
                    Ok(_) => break,
                    // The connection has ended; whoever drives it says so.
                    Err(_) => pending().await,
                },
                () = sleep(KEEPALIVE_TIMEOUT) => {
                    if activity.read_at().elapsed() >= KEEPALIVE_TIMEOUT {
                        return Overdue::Silent;
                    }
                }
            }
        }
    }
}

/// How one request is answered.
struct Answering {
    desk: Desk,
    allowance: Arc<Allowance>,
    unread_timeout: Duration,
}

impl Answering {
    /// Has a request answered, as far as the client wants it.
    async fn answer(
        self,
        request: Request<Body>,
        mut respond: SendResponse<Bytes>,
    ) -> Result<(), h2::Error> {
        let answer = tokio::select! {
            biased;
            reset = poll_fn(|context| respond.poll_reset(context)) => return reset.map(drop),
            answer = self.desk.clone().answer(request) => answer,
        };
        let (mut head, body) = answer.into_parts();
        let length = body.size_hint().exact();
        let is_empty = body.is_end_stream();
        if let Some(length) = length.filter(|_| !is_empty) {
            let headers = &mut head.headers;
            headers
                .entry(header::CONTENT_LENGTH)
                .or_insert(length.into());
        }
        let now = httpdate::fmt_http_date(SystemTime::now());
        let now = HeaderValue::try_from(now).expect("a date is text");
        head.headers.entry(header::DATE).or_insert(now);
        let stream = respond.send_response(Response::from_parts(head, ()), is_empty)?;
        self.allowance.credit(0);
        if is_empty {
            return Ok(());
        }
        // What is made as the client reads it may wait for as long as the client is there; what is there as a whole may not.
        let unread_timeout = length.map(|_| self.unread_timeout);
        self.send(body, stream, unread_timeout).await
    }

    /// Sends a body, each piece of it made when the client has room for one.
    async fn send(
        &self,
        mut body: Body,
        mut stream: SendStream<Bytes>,
        unread_timeout: Option<Duration>,
    ) -> Result<(), h2::Error> {
        loop {
            if !room(&mut stream, 1, unread_timeout).await? {
                return Ok(());
            }
            let frame = tokio::select! {
                biased;
                reset = poll_fn(|context| stream.poll_reset(context)) => return reset.map(drop),
                frame = body.frame() => frame,
            };
            let frame = match frame {
                Some(Ok(frame)) => frame,
                Some(Err(error)) => {
                    tracing::debug!("an answer broke off: {error}");
                    stream.send_reset(Reason::INTERNAL_ERROR);
                    return Ok(());
                }
                None => return stream.send_data(Bytes::new(), true),
            };
            self.allowance
                .credit(frame.data_ref().map_or(0, Bytes::len));
            match frame.into_data() {
                Ok(mut bytes) => {
                    let is_last = body.is_end_stream();
                    if is_last && bytes.is_empty() {
                        return stream.send_data(bytes, true);
                    }
                    while !bytes.is_empty() {
                        if !room(&mut stream, bytes.len(), unread_timeout).await? {
                            return Ok(());
                        }
                        let piece = bytes.split_to(stream.capacity().min(bytes.len()));
                        stream.send_data(piece, is_last && bytes.is_empty())?;
                    }
                    if is_last {
                        return Ok(());
                    }
                }
                Err(frame) => {
                    if let Ok(trailers) = frame.into_trailers() {
                        return stream.send_trailers(trailers);
                    }
                }
            }
        }
    }
}

/// Waits until the client has room for some of so many bytes; false when it wants no more, or has had none for too long.
async fn room(
    stream: &mut SendStream<Bytes>,
    bytes: usize,
    unread_timeout: Option<Duration>,
) -> Result<bool, h2::Error> {
    stream.reserve_capacity(bytes);
    while stream.capacity() == 0 {
        let more = poll_fn(|context| match stream.poll_reset(context) {
            Poll::Ready(reset) => Poll::Ready(reset.map(|_| None).transpose()),
            Poll::Pending => stream.poll_capacity(context),
        });
        let more = match unread_timeout {
            None => Ok(more.await),
            Some(time) => timeout(time, more).await,
        };
        let Ok(more) = more else {
            stream.send_reset(Reason::CANCEL);
            return Ok(false);
        };
        match more {
            Some(more) => drop(more?),
            None => return Ok(false),
        }
    }
    Ok(true)
}
