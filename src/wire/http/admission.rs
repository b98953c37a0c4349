//! Who is let in: the checks of [`crate::wire::access`] before every handler, and pages of other origins.

use std::time::Duration;

use axum::RequestExt;
use axum::body::Body;
use axum::extract::{MatchedPath, RawPathParams, Request, State};
use axum::http::{HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tower_http::cors::CorsLayer;

use crate::wire::access::{Access, Effect, Held, Origin};
use crate::wire::problem::Code;

/// How long a browser may keep that an origin may ask. Most browsers keep it for two hours at the most.
const PREFLIGHT_AGE_MAX: Duration = Duration::from_hours(2);

/// Middleware: refuses who asks for another server, or for a page of another origin that was not allowed.
pub(super) async fn known_hosts(
    State(access): State<Access>,
    request: Request,
    next: Next,
) -> Response {
    match access.check_hosts(request.uri(), request.headers()) {
        Ok(()) => next.run(request).await,
        Err(problem) => problem.into_response(),
    }
}

/// Middleware: lets in who may do what the call does, and gives the handler the ticket.
pub(super) async fn admit(
    State(access): State<Access>,
    mut request: Request,
    next: Next,
) -> Response {
    let route = request.extensions().get::<MatchedPath>().cloned();
    // A path that is no text is refused by the handler, if it is one of a scene at all.
    let parameters = request.extract_parts::<RawPathParams>().await.ok();
    let scene = parameters
        .iter()
        .flatten()
        .find(|(name, _)| *name == "scene");
    let admitted = access.admit_http(
        request.method(),
        route.as_ref().map(MatchedPath::as_str),
        scene.map(|(_, scene)| scene),
        request.headers(),
    );
    let ticket = match admitted {
        Ok(ticket) => ticket,
        Err(problem) => return problem.into_response(),
    };
    request.extensions_mut().insert(ticket.clone());
    let taken_back = || Err(axum::Error::new("the key was taken back"));
    let held = |body| Body::new(Held::new(body, ticket.clone(), taken_back));
    let response = next.run(request.map(held)).await;
    if let Some(effect) = response.extensions().get::<Effect>() {
        ticket.did(*effect);
    }
    match response.extensions().get::<Code>() {
        Some(code) => ticket.failed(code.kind().code),
        None if response.status().is_success() => ticket.done(),
        None => ticket.failed(response.status().as_str()),
    }
    response.map(held)
}

/// What pages of the allowed origins are told, if there are any: a browser keeps answers from pages that are not told.
pub(super) fn cross_origin(access: &Access) -> Option<CorsLayer> {
    let origins: Vec<HeaderValue> = access.hosts().origins().iter().map(Origin::value).collect();
    if origins.is_empty() {
        return None;
    }
    let layer = CorsLayer::new()
        .allow_origin(origins)
        .allow_methods([
            Method::GET,
            Method::HEAD,
            Method::PUT,
            Method::POST,
            Method::DELETE,
        ])
        .allow_headers([
            header::ACCEPT,
            header::AUTHORIZATION,
            header::CONTENT_TYPE,
            header::IF_NONE_MATCH,
            HeaderName::from_static("idempotency-key"),
            HeaderName::from_static("last-event-id"),
            HeaderName::from_static("x-request-id"),
        ])
        .expose_headers([
            header::ETAG,
            header::RETRY_AFTER,
            header::WWW_AUTHENTICATE,
            HeaderName::from_static("idempotency-replayed"),
            HeaderName::from_static("x-request-id"),
        ])
        .max_age(PREFLIGHT_AGE_MAX);
    Some(layer)
}

/// Middleware, around [`cross_origin`]: the question of a browser whether it may ask is answered, with nothing in the answer.
pub(super) async fn preflight(request: Request, next: Next) -> Response {
    let is_question = request.method() == Method::OPTIONS;
    let mut response = next.run(request).await;
    if is_question && response.status() == StatusCode::OK {
        *response.status_mut() = StatusCode::NO_CONTENT;
    }
    response
}
