//! The body of a request over HTTP/2, taken out of the library's hands as it comes.
//!
//! ```text
//!   connection ── frames ──> Pump ── bytes, in one piece ──> Arriving ── the handler
//!        ▲                                                      │
//!        └──────────── the window grows by what is taken ◄──────┘
//! ```
//! The library keeps a record of some 300 bytes for each frame that is not read yet, however few bytes are in it, and closes the
//! connection when there are many of them. A client that sends small changes as fast as it can must be slowed down instead. So
//! frames are emptied here at once, by the task of the connection and before it reads on; what is kept is bytes, at most those
//! of the call's window. That window does not grow until the handler takes them.

use std::pin::{Pin, pin};
use std::sync::Arc;
use std::task::{Context, Poll, Waker};

use axum::body::{Body, Bytes, HttpBody};
use bytes::BytesMut;
use h2::{FlowControl, RecvStream};
use hyper::body::Frame;
use parking_lot::Mutex;

/// What has arrived and nobody has taken.
#[derive(Default)]
struct Arrived {
    bytes: BytesMut,
    /// How the body ended, once it has.
    end: Option<Result<(), h2::Error>>,
    /// Whether nobody wants the rest.
    is_unwanted: bool,
    /// Who waits for more.
    reader: Option<Waker>,
    /// Who waits to hear that the rest is not wanted.
    pump: Option<Waker>,
}

/// Empties the frames of one body; done when it has ended or nobody wants the rest.
pub(super) struct Pump {
    stream: RecvStream,
    arrived: Arc<Mutex<Arrived>>,
}

/// The body as the handler reads it.
struct Arriving {
    window: FlowControl,
    arrived: Arc<Mutex<Arrived>>,
}

/// The body of a request, and what fills it.
pub(super) fn pumped(mut stream: RecvStream) -> (Option<Pump>, Body) {
    if stream.is_end_stream() {
        return (None, Body::empty());
    }
    let arrived = Arc::<Mutex<Arrived>>::default();
    let arriving = Arriving {
        window: stream.flow_control().clone(),
        arrived: arrived.clone(),
    };
    (Some(Pump { stream, arrived }), Body::new(arriving))
}

impl Future for Pump {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<()> {
        let Self { stream, arrived } = &mut *self;
        let mut arrived = arrived.lock();
        if arrived.is_unwanted {
            return Poll::Ready(());
        }
        arrived.pump = Some(context.waker().clone());
        let mut is_news = false;
        while let Poll::Ready(next) = pin!(stream.data()).poll(context) {
            is_news = true;
            match next {
                Some(Ok(bytes)) => arrived.bytes.extend_from_slice(&bytes),
                Some(Err(error)) => arrived.end = Some(Err(error)),
                None => arrived.end = Some(Ok(())),
            }
            if arrived.end.is_some() {
                break;
            }
        }
        if is_news && let Some(reader) = arrived.reader.take() {
            reader.wake();
        }
        match arrived.end {
            Some(_) => Poll::Ready(()),
            None => Poll::Pending,
        }
    }
}

impl HttpBody for Arriving {
    type Data = Bytes;
    type Error = h2::Error;

    fn poll_frame(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, h2::Error>>> {
        let this = self.get_mut();
        let mut arrived = this.arrived.lock();
        if !arrived.bytes.is_empty() {
            let bytes = arrived.bytes.split().freeze();
            drop(arrived);
            // Of a stream that is closed by now there is no window to grow.
            let _ = this.window.release_capacity(bytes.len());
            return Poll::Ready(Some(Ok(Frame::data(bytes))));
        }
        match arrived.end.take() {
            Some(Ok(())) => {
                arrived.end = Some(Ok(()));
                Poll::Ready(None)
            }
            Some(Err(error)) => {
                arrived.end = Some(Ok(()));
                Poll::Ready(Some(Err(error)))
            }
            None => {
                arrived.reader = Some(context.waker().clone());
                Poll::Pending
            }
        }
    }

    fn is_end_stream(&self) -> bool {
        let arrived = self.arrived.lock();
        arrived.bytes.is_empty() && matches!(arrived.end, Some(Ok(())))
    }
}

impl Drop for Arriving {
    fn drop(&mut self) {
        let mut arrived = self.arrived.lock();
        arrived.is_unwanted = true;
        let left = std::mem::take(&mut arrived.bytes).len();
        let pump = arrived.pump.take();
        drop(arrived);
        // The other calls of the connection need the room.
        let _ = self.window.release_capacity(left);
        if let Some(pump) = pump {
            pump.wake();
        }
    }
}
