//! Answers that come before the request has arrived.
//!
//! A server that answers and closes while the client is still sending makes the client's system throw the answer away: the
//! client sees a reset. So what is left of a body that nobody wants is read and dropped, within a bound, beside the answer.

use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, BodyDataStream, Bytes};
use axum::extract::{Request, State};
use axum::http::header;
use axum::middleware::Next;
use axum::response::Response;
use futures_util::{Stream, StreamExt};

/// Middleware: what handlers leave of the body is drained for at most this time.
pub(super) async fn drain_body(
    State(time_max): State<Duration>,
    request: Request,
    next: Next,
) -> Response {
    // A client that waits for "100 Continue" sends nothing unless it is asked to.
    let waits = request.headers().contains_key(header::EXPECT);
    let request = request.map(|body| {
        Body::from_stream(Drained {
            body: Some(body.into_data_stream()),
            begun: !waits,
            time_max,
        })
    });
    next.run(request).await
}

struct Drained {
    /// None once it has ended.
    body: Option<BodyDataStream>,
    /// Whether the client sends it.
    begun: bool,
    time_max: Duration,
}

impl Stream for Drained {
    type Item = Result<Bytes, axum::Error>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        self.begun = true;
        let Some(body) = &mut self.body else {
            return Poll::Ready(None);
        };
        let polled = body.poll_next_unpin(context);
        if let Poll::Ready(None | Some(Err(_))) = polled {
            self.body = None;
        }
        polled
    }
}

impl Drop for Drained {
    fn drop(&mut self) {
        let Some(mut body) = self.body.take().filter(|_| self.begun) else {
            return;
        };
        // Outside a runtime there is no connection left to save.
        if let Ok(runtime) = tokio::runtime::Handle::try_current() {
            let time_max = self.time_max;
            runtime.spawn(async move {
                let rest = async { while let Some(Ok(_)) = body.next().await {} };
                // Past the bound the connection is closed: that client is not listening.
                let _ = tokio::time::timeout(time_max, rest).await;
            });
        }
    }
}
