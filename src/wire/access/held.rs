//! Bodies that end when the key of the call is taken back, or its line in the file changes: a stream may have no other end.

use std::pin::Pin;
use std::task::{Context, Poll, ready};

use axum::body::{Bytes, HttpBody};
use http_body::{Frame, SizeHint};

use super::Ticket;

/// A body on its way in or out of a call that was let in.
pub(in crate::wire) struct Held<B: HttpBody> {
    body: B,
    ticket: Ticket,
    /// What comes in place of the rest.
    last: fn() -> Result<Frame<Bytes>, B::Error>,
    is_over: bool,
}

impl<B: HttpBody<Data = Bytes> + Unpin> Held<B> {
    pub(in crate::wire) fn new(
        body: B,
        ticket: Ticket,
        last: fn() -> Result<Frame<Bytes>, B::Error>,
    ) -> Self {
        Self {
            body,
            ticket,
            last,
            is_over: false,
        }
    }
}

impl<B: HttpBody<Data = Bytes> + Unpin> HttpBody for Held<B> {
    type Data = Bytes;
    type Error = B::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, B::Error>>> {
        if self.is_over {
            return Poll::Ready(None);
        }
        // Asked for after the wait: what comes when the key is gone is not told any more.
        let frame = ready!(Pin::new(&mut self.body).poll_frame(context));
        if frame.is_none() || self.ticket.still_holds() {
            return Poll::Ready(frame);
        }
        self.is_over = true;
        Poll::Ready(Some((self.last)()))
    }

    fn is_end_stream(&self) -> bool {
        self.is_over || self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
