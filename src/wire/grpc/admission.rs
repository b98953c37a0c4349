//! Who is let in: the checks of [`crate::wire::access`] before every call. The scene stands in the message: [`permitted`] is the
//! first thing that a handler does.

use std::pin::Pin;
use std::task::{Context, Poll};

use axum::body::Body;
use axum::http::{HeaderMap, Request as HttpRequest, Response as HttpResponse};
use http_body::Frame;
use tonic::{Request, Status};
use tonic_types::StatusExt;
use tower::{Layer, Service};

use super::status::status;
use crate::wire::access::{Access, Held, Ticket, of_grpc};
use crate::wire::problem::{Code, Problem};
use crate::wire::proto::{
    ApplyChangeRequest, AuditSceneRequest, ContainsRequest, CreateSceneRequest, DefineShapeRequest,
    DeleteSceneRequest, GetCubeRequest, GetHistoryRequest, GetMassPropertiesRequest,
    GetSceneRequest, GetSolidRequest, ListCubesRequest, ListSolidsRequest, RevertSceneRequest,
    StreamOpening, WatchMassPropertiesRequest,
};

/// The layer that does it.
pub(super) fn layer<S>(access: Access) -> impl Layer<S, Service = Admitted<S>> + Clone {
    tower::layer::layer_fn(move |inner| Admitted {
        inner,
        access: access.clone(),
    })
}

#[derive(Clone)]
pub(super) struct Admitted<S> {
    inner: S,
    access: Access,
}

impl<S> Service<HttpRequest<Body>> for Admitted<S>
where
    S: Service<HttpRequest<Body>, Response = HttpResponse<Body>>,
    S::Future: Send + 'static,
    S::Error: Send + 'static,
{
    type Response = HttpResponse<Body>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Self::Response, S::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, mut request: HttpRequest<Body>) -> Self::Future {
        let ticket = match self.admit(&request) {
            Ok(ticket) => ticket,
            Err(problem) => {
                let refused = status(&problem, "").into_http();
                return Box::pin(std::future::ready(Ok(refused)));
            }
        };
        request.extensions_mut().insert(ticket.clone());
        let incoming = request.map(|body| {
            Body::new(Held::new(body, ticket.clone(), || {
                Err(axum::Error::new(taken_back()))
            }))
        });
        let answer = self.inner.call(incoming);
        Box::pin(async move {
            let answer = answer.await?;
            note(&ticket, &answer);
            let last = || {
                let mut trailers = HeaderMap::new();
                // A header that it cannot take is left out: the status itself stands.
                let _ = taken_back().add_header(&mut trailers);
                Ok(Frame::trailers(trailers))
            };
            Ok(answer.map(|body| Body::new(Held::new(body, ticket, last))))
        })
    }
}

impl<S> Admitted<S> {
    fn admit(&self, request: &HttpRequest<Body>) -> Result<Ticket, Problem> {
        let (uri, headers) = (request.uri(), request.headers());
        self.access.check_hosts(uri, headers)?;
        self.access.admit(of_grpc(uri.path()), headers)
    }
}

/// What ends the streams of a key that is not what it was.
fn taken_back() -> Status {
    status(
        &Problem::new(
            Code::Unauthenticated,
            "the key was taken back, or its rights have changed",
        ),
        "",
    )
}

/// Marks an answer that is a whole one: with it the call is done.
#[derive(Clone, Copy)]
pub(super) struct Whole;

/// Notes for the audit log what became of a call; of a stream that has begun the stream itself does.
fn note(ticket: &Ticket, answer: &HttpResponse<Body>) {
    if answer.extensions().get::<Whole>().is_some() {
        ticket.done();
    } else if let Some(status) = Status::from_header_map(answer.headers()) {
        match status.get_details_error_info() {
            Some(info) => ticket.failed(&info.reason),
            None => ticket.failed(status.code().description()),
        }
    }
}

/// A message that names a scene.
pub(super) trait NamesScene {
    fn scene(&self) -> &str;
}

macro_rules! names_scene {
    ($($message:ty),* $(,)?) => {
        $(impl NamesScene for $message {
            fn scene(&self) -> &str {
                &self.scene
            }
        })*
    };
}

names_scene!(
    ApplyChangeRequest,
    AuditSceneRequest,
    ContainsRequest,
    CreateSceneRequest,
    DefineShapeRequest,
    DeleteSceneRequest,
    GetCubeRequest,
    GetHistoryRequest,
    GetMassPropertiesRequest,
    GetSceneRequest,
    GetSolidRequest,
    ListCubesRequest,
    ListSolidsRequest,
    RevertSceneRequest,
    StreamOpening,
    WatchMassPropertiesRequest,
);

/// The message of a request whose sender may do this to the scene that it names.
pub(super) fn permitted<T: NamesScene>(request: Request<T>) -> Result<T, Status> {
    let ticket = ticket(&request);
    let message = request.into_inner();
    may(&ticket, &message)?;
    Ok(message)
}

/// The ticket of a request.
pub(super) fn ticket<T>(request: &Request<T>) -> Ticket {
    let ticket = request.extensions().get::<Ticket>();
    ticket
        .expect("the layer lets nobody in without one")
        .clone()
}

/// Whether the sender may do this to the scene that a message names.
pub(super) fn may(ticket: &Ticket, message: &impl NamesScene) -> Result<(), Status> {
    let permitted = ticket.permit(message.scene());
    permitted.map_err(|problem| status(&problem, ""))
}
