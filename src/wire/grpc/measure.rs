//! Counts and times calls, and gives statuses that a library made the details that all others have.

use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Instant;

use axum::body::HttpBody;
use axum::http::{HeaderMap, Request, Response};
use http_body_util::BodyExt;
use tonic::body::Body;
use tonic::{Code, Status};
use tower::{Layer, Service};

use super::status::{self, foreign};
use crate::wire::access::of_grpc;

const STATUS: &str = "grpc-status";
const DETAILS: &str = "grpc-status-details-bin";

/// The layer that does it.
pub(super) fn layer<S>() -> impl Layer<S, Service = Measured<S>> + Clone {
    tower::layer::layer_fn(Measured)
}

#[derive(Clone)]
pub(super) struct Measured<S>(S);

impl<S, A, B> Service<Request<A>> for Measured<S>
where
    S: Service<Request<A>, Response = Response<B>>,
    S::Future: Send + 'static,
    B: HttpBody<Data = bytes::Bytes> + Send + 'static,
    B::Error: Into<Box<dyn std::error::Error + Send + Sync>>,
{
    type Response = Response<Body>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Self::Response, S::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.0.poll_ready(context)
    }

    fn call(&mut self, request: Request<A>) -> Self::Future {
        let mut call = Call {
            method: method(request.uri().path()),
            code: None,
        };
        let begun = Instant::now();
        let answer = self.0.call(request);
        Box::pin(async move {
            let (mut head, body) = answer.await?.into_parts();
            metrics::histogram!("union3d_grpc_request_duration_seconds", "method" => call.method)
                .record(begun.elapsed());
            describe(&mut head.headers);
            call.note(&head.headers);
            let body = body.map_frame(move |frame| {
                if let Some(trailers) = frame.trailers_ref() {
                    call.note(trailers);
                }
                frame
            });
            Ok(Response::from_parts(head, Body::new(body)))
        })
    }
}

/// A call that is counted when it is over, however it ends.
struct Call {
    method: &'static str,
    /// None until its status is known.
    code: Option<Code>,
}

impl Call {
    fn note(&mut self, headers: &HeaderMap) {
        if let Some(status) = headers.get(STATUS) {
            self.code = Some(Code::from_bytes(status.as_bytes()));
        }
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        // Who goes away before the end has cancelled the call.
        let code = format!("{:?}", self.code.unwrap_or(Code::Cancelled));
        metrics::counter!("union3d_grpc_requests_total", "method" => self.method, "code" => code)
            .increment(1);
    }
}

/// The name of a call: any path can be sent, but only known ones make a series.
fn method(path: &str) -> &'static str {
    of_grpc(path).name
}

/// Adds the details of a problem to a status that has none.
fn describe(headers: &mut HeaderMap) {
    if headers.contains_key(DETAILS) {
        return;
    }
    let Some(problem) = Status::from_header_map(headers).and_then(|status| foreign(&status)) else {
        return;
    };
    // A header that it cannot take is left out: the status itself stands.
    let _ = status::status(&problem, "").add_header(headers);
}

#[cfg(test)]
mod tests {
    use prost::Message;

    use super::*;
    use crate::wire::proto::FILE_DESCRIPTOR_SET;

    #[test]
    fn every_call_has_its_name() {
        let files = prost_types::FileDescriptorSet::decode(FILE_DESCRIPTOR_SET).unwrap();
        let services = files.file.iter().flat_map(|file| &file.service);
        let methods: Vec<_> = services.flat_map(|service| &service.method).collect();
        assert!(!methods.is_empty());
        for one in methods {
            let path = format!("/union3d.v1.UnionService/{}", one.name());
            assert_eq!(method(&path), one.name());
        }
        assert_eq!(method("/union3d.v1.UnionService/Nothing"), "other");
    }
}
