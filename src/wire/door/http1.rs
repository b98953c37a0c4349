//! A connection of HTTP/1: its requests one after the other, by hyper.

use std::convert::Infallible;
use std::future::poll_fn;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody};
use axum::http::Request;
use axum::response::IntoResponse;
use http_body_util::BodyExt;
use hyper::body::{Frame, Incoming, SizeHint};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::TokioIo;
use tokio::io::{AsyncWriteExt, sink};
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

use super::activity::{Activity, Overdue, Underway};
use super::heads::Heads;
use super::socket::Socket;
use super::{Closed, Desk, Settings};
use crate::wire::problem::{Code, Problem};

/// What the library keeps of a connection: of what arrives and of what is answered.
const BUFFER_BYTES_MAX: usize = 128 << 10;

/// How long what a client still sends is read after it was refused, so that it sees the answer rather than a reset.
const LINGER: Duration = Duration::from_secs(1);

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
    let service = service_fn(|request: Request<Incoming>| {
        let underway = activity.begin();
        let desk = desk.clone();
        Box::pin(async move {
            let answer = desk.answer(request.map(Body::new)).await;
            Ok::<_, Infallible>(answer.map(|body| Answer {
                body,
                _underway: underway,
            }))
        })
    });
    let heads = Heads::new(socket, activity.clone());
    // How long a head takes is watched here: the library does not tell it from a connection that rests.
    let mut connection = http1::Builder::new()
        .header_read_timeout(None)
        .max_buf_size(BUFFER_BYTES_MAX)
        .serve_connection(TokioIo::new(heads), service);
    let mut is_ending = false;
    let overdue = loop {
        tokio::select! {
            ended = poll_fn(|context| connection.poll_without_shutdown(context)) => {
                ended?;
                break None;
            }
            overdue = activity.overdue(settings) => break Some(overdue),
            () = draining.cancelled(), if !is_ending => {
                is_ending = true;
                Pin::new(&mut connection).graceful_shutdown();
            }
        }
    };
    let (mut socket, refused) = connection.into_parts().io.into_inner().into_parts();
    let problem = match (overdue, refused) {
        (Some(Overdue::Head), _) => {
            let detail = format!(
                "the server waited {} s for the head",
                settings.head_timeout.as_secs_f64()
            );
            Some(Problem::new(Code::RequestTimeout, detail))
        }
        (Some(_), _) => None,
        (None, refused) => refused.map(|refusal| Problem::new(Code::BadRequest, refusal)),
    };
    let end = async {
        if let Some(problem) = problem {
            socket.write_all(&written(problem).await).await?;
            socket.shutdown().await?;
            tokio::io::copy(&mut socket, &mut sink()).await?;
            return Ok(());
        }
        socket.shutdown().await
    };
    // Whoever does not read it has broken off: there is nobody to tell.
    let _: Result<std::io::Result<()>, _> = timeout(LINGER, end).await;
    match (overdue, refused) {
        (Some(overdue), _) => Err(overdue.into()),
        (None, Some(refusal)) => Err(Closed::Refused(refusal)),
        (None, None) => Ok(()),
    }
}

/// An answer, as the last of a connection.
async fn written(problem: Problem) -> Vec<u8> {
    let (head, body) = problem.into_response().into_parts();
    let body = body
        .collect()
        .await
        .map(http_body_util::Collected::to_bytes)
        .unwrap_or_default();
    let reason = head.status.canonical_reason().unwrap_or_default();
    let mut text = format!("HTTP/1.1 {} {reason}\r\n", head.status.as_u16()).into_bytes();
    for (name, value) in &head.headers {
        text.extend_from_slice(name.as_str().as_bytes());
        text.extend_from_slice(b": ");
        text.extend_from_slice(value.as_bytes());
        text.extend_from_slice(b"\r\n");
    }
    text.extend_from_slice(
        format!(
            "content-length: {}\r\nconnection: close\r\n\r\n",
            body.len()
        )
        .as_bytes(),
    );
    text.extend_from_slice(&body);
    text
}

/// The body of an answer, whose request is under way as long as it is there.
struct Answer {
    body: Body,
    _underway: Underway,
}

impl HttpBody for Answer {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
