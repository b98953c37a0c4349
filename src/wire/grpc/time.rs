//! Time: how long a client may take to send a message that it has begun, and how long it waits for an answer itself.

use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody};
use axum::extract::{Request, State};
use axum::http::HeaderMap;
use axum::middleware::Next;
use axum::response::Response;
use hyper::body::Frame;
use tokio::time::{Instant, Sleep, sleep_until, timeout};
use tonic::Status;

use super::framing::{Framing, Mark};
use super::status;
use crate::wire::problem::{Code, Problem};

/// Middleware: messages that have begun arrive within this time, and an answer begins within the client's own.
pub(super) async fn in_time(
    State(time_max): State<Duration>,
    request: Request,
    next: Next,
) -> Response {
    let deadline = deadline(request.headers());
    let request = request.map(|body| Body::new(Timely::new(body, time_max)));
    let answer = next.run(request);
    let Some(deadline) = deadline else {
        return answer.await;
    };
    let answered = timeout(deadline, answer).await;
    answered.unwrap_or_else(|_| {
        let late = "there was no answer in the time that the client set";
        Status::deadline_exceeded(late).into_http()
    })
}

/// The header `grpc-timeout`, when it is there and well-formed. Source: gRPC over HTTP2, "Timeout".
fn deadline(headers: &HeaderMap) -> Option<Duration> {
    let text = headers.get("grpc-timeout")?.to_str().ok()?;
    let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
    let is_number =
        (1..=8).contains(&digits.len()) && digits.bytes().all(|byte| byte.is_ascii_digit());
    let count: u64 = digits.parse().ok().filter(|_| is_number)?;
    Some(match unit {
        "H" => Duration::from_secs(count * 3600),
        "M" => Duration::from_secs(count * 60),
        "S" => Duration::from_secs(count),
        "m" => Duration::from_millis(count),
        "u" => Duration::from_micros(count),
        "n" => Duration::from_nanos(count),
        _ => return None,
    })
}

/// A body whose messages, once they have begun, come to their end in time.
///
/// What counts is how long the server waited for the rest of a message. How long the client rests between messages, and how long the
/// server does not read, is no matter.
struct Timely {
    body: Body,
    time_max: Duration,
    framing: Framing,
    /// How long the rest of this message was waited for, up to when it was last waited for.
    waited: Duration,
    waiting: Option<(Instant, Pin<Box<Sleep>>)>,
    is_over: bool,
}

impl Timely {
    fn new(body: Body, time_max: Duration) -> Self {
        Self {
            body,
            time_max,
            framing: Framing::default(),
            waited: Duration::ZERO,
            waiting: None,
            is_over: false,
        }
    }
}

impl HttpBody for Timely {
    type Data = Bytes;
    type Error = Box<dyn std::error::Error + Send + Sync>;

    fn poll_frame(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Self::Error>>> {
        let this = self.get_mut();
        if this.is_over {
            return Poll::Ready(None);
        }
        if let Poll::Ready(frame) = Pin::new(&mut this.body).poll_frame(context) {
            if let Some((since, _)) = this.waiting.take() {
                this.waited += since.elapsed();
            }
            if let Some(Ok(frame)) = &frame
                && let Some(bytes) = frame.data_ref()
            {
                let waited = &mut this.waited;
                this.framing.follow(bytes, |mark| {
                    if mark == Mark::Begins {
                        *waited = Duration::ZERO;
                    }
                });
            }
            return Poll::Ready(frame.map(|frame| frame.map_err(Into::into)));
        }
        if !this.framing.is_within() {
            this.waiting = None;
            return Poll::Pending;
        }
        let left = this.time_max.saturating_sub(this.waited);
        let (_, sleep) = this.waiting.get_or_insert_with(|| {
            let now = Instant::now();
            (now, Box::pin(sleep_until(now + left)))
        });
        if sleep.as_mut().poll(context).is_pending() {
            return Poll::Pending;
        }
        this.is_over = true;
        let detail = format!(
            "the server waited {} s for the rest of a message",
            this.time_max.as_secs_f64()
        );
        let problem = Problem::new(Code::RequestTimeout, detail);
        Poll::Ready(Some(Err(status::status(&problem, "").into())))
    }

    fn is_end_stream(&self) -> bool {
        self.is_over || self.body.is_end_stream()
    }
}
