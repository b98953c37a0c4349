//! The HTTP API: decode, ask the service, encode. One handler a call, one table of routes.
//!
//! ```text
//!   request ── id, trace, measure ── compress ── problems only ── panics ── drain ── hosts, origins ── keys ── bounded time ── handler
//! ```

mod admission;
mod backup;
mod batch;
mod changes;
mod contains;
mod cubes;
mod drain;
mod exposition;
mod history;
mod mesh;
mod ndjson;
mod openapi;
mod operate;
mod page;
mod problem;
mod reads;
mod request;
mod scenes;
mod slice;
mod solids;

use std::any::Any;
use std::time::{Duration, Instant};

use axum::Router;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderValue, Method, StatusCode, Uri, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, get, post, put};
use metrics_exporter_prometheus::PrometheusHandle;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use tower::ServiceBuilder;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::request_id::{MakeRequestUuid, PropagateRequestIdLayer, SetRequestIdLayer};
use tower_http::sensitive_headers::SetSensitiveRequestHeadersLayer;
use tower_http::trace::TraceLayer;
use utoipa_swagger_ui::SwaggerUi;

pub(in crate::wire) use self::changes::{Wanted, change_answer};
pub use self::exposition::{install_metrics, keep_metrics};
pub(in crate::wire) use self::history::{csv_header, csv_line, csv_lines, entry};
pub(in crate::wire) use self::reads::AuditDocument;
pub(in crate::wire) use self::request::Return;
use super::access::Access;
use super::calls::{self, within};
use super::door::{Door, Protocol};
use super::failures;
use super::problem::{Code, Problem};
use crate::service::Service;

/// What one request may take.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Size of a body, in bytes. Does not apply to streams.
    pub body_bytes_max: usize,
    /// Cubes of an atomic change, deletions and insertions together.
    pub change_cubes_max: usize,
    /// How long a body may take to arrive, and an answer to be made. Of a stream: how long it may pause.
    pub request_timeout: Duration,
    /// How long `?wait=` waits.
    pub wait_max: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            body_bytes_max: 64 << 20,
            change_cubes_max: 1_000_000,
            request_timeout: Duration::from_secs(30),
            wait_max: Duration::from_secs(10),
        }
    }
}

/// What handlers know.
#[derive(Clone, Debug)]
struct App {
    service: Service,
    limits: Limits,
    access: Access,
    metrics: PrometheusHandle,
}

type Route = (&'static str, MethodRouter<App>);

/// Calls that are answered soon or not at all.
fn bounded_routes() -> Vec<Route> {
    use contains::get_contains;
    use cubes::{get_cube, get_cubes};
    use exposition::get_metrics;
    use history::get_history;
    use openapi::get_openapi;
    use operate::{get_healthz, get_problem, get_problems, get_readyz};
    use reads::get_mass_properties;
    use scenes::{delete_scene, get_scene, get_scenes, put_scene};
    use solids::{get_solid, get_solids};
    vec![
        ("/v1/scenes", get(get_scenes)),
        (
            "/v1/scenes/{scene}",
            put(put_scene).get(get_scene).delete(delete_scene),
        ),
        (
            "/v1/scenes/{scene}/mass-properties",
            get(get_mass_properties),
        ),
        ("/v1/scenes/{scene}/history", get(get_history)),
        ("/v1/scenes/{scene}/cubes", get(get_cubes)),
        (
            "/v1/scenes/{scene}/cubes/{id}",
            get(get_cube).delete(changes::delete_cube),
        ),
        ("/v1/scenes/{scene}/contains", get(get_contains)),
        ("/v1/scenes/{scene}/solids", get(get_solids)),
        (
            "/v1/scenes/{scene}/solids/{id}",
            get(get_solid).delete(solids::delete_solid),
        ),
        ("/healthz", get(get_healthz)),
        ("/readyz", get(get_readyz)),
        ("/metrics", get(get_metrics)),
        ("/openapi.json", get(get_openapi)),
        ("/problems", get(get_problems)),
        ("/problems/{code}", get(get_problem)),
    ]
}

/// Calls that last as long as the client or the scene makes them. What is bounded in them they bound themselves.
fn unbounded_routes() -> Vec<Route> {
    vec![
        ("/v1/scenes/{scene}/changes", post(changes::post_changes)),
        ("/v1/scenes/{scene}/changes/batch", post(batch::post_batch)),
        ("/v1/scenes/{scene}/revert", post(changes::post_revert)),
        ("/v1/scenes/{scene}/shapes/{shape}", put(solids::put_shape)),
        (
            "/v1/scenes/{scene}/mass-properties/stream",
            get(reads::stream_mass_properties),
        ),
        ("/v1/scenes/{scene}/audit", post(reads::post_audit)),
        ("/v1/scenes/{scene}/mesh", get(mesh::get_mesh)),
        ("/v1/scenes/{scene}/backup", get(backup::get_backup)),
        ("/v1/scenes/{scene}/slice", get(slice::get_slice)),
        ("/v1/overlay", get(slice::get_overlay)),
    ]
}

/// The paths of the API, as the description has them.
pub fn paths() -> Vec<&'static str> {
    let routes = bounded_routes().into_iter().chain(unbounded_routes());
    routes.map(|(path, _)| path).collect()
}

/// Serves the HTTP API of a service, for those who may, until `draining` is cancelled and the requests that are under way then are answered.
pub async fn serve(
    door: Door,
    listener: TcpListener,
    service: Service,
    limits: Limits,
    access: Access,
    draining: CancellationToken,
) {
    let router = router(service, limits, access);
    door.serve(listener, Protocol::Http, router, draining).await;
}

/// The HTTP API of a service, for those who may: for a program that asks it without a connection.
pub fn router(service: Service, limits: Limits, access: Access) -> Router {
    let app = App {
        service,
        limits,
        access: access.clone(),
        metrics: install_metrics(),
    };
    let add = |router: Router<App>, (path, methods): Route| router.route(path, methods);
    let bounded = bounded_routes().into_iter().fold(Router::new(), add);
    let bounded = bounded.route_layer(middleware::from_fn_with_state(limits, bounded_time));
    let unbounded = unbounded_routes().into_iter().fold(Router::new(), add);
    let page = page::routes().into_iter().fold(Router::new(), add);
    let description = utoipa_swagger_ui::Config::new(["/openapi.json"]);
    bounded
        .merge(unbounded)
        .merge(page)
        .merge(page::described(
            SwaggerUi::new("/docs").config(description).into(),
        ))
        .fallback(async |uri: Uri| no_such_path(uri.path()))
        .method_not_allowed_fallback(method_not_allowed)
        .layer(
            ServiceBuilder::new()
                .layer(SetRequestIdLayer::x_request_id(MakeRequestUuid))
                .layer(SetSensitiveRequestHeadersLayer::new([
                    header::AUTHORIZATION,
                ]))
                .layer(
                    TraceLayer::new_for_http()
                        .make_span_with(span)
                        .on_failure(failures::tell_http()),
                )
                .layer(PropagateRequestIdLayer::x_request_id())
                .layer(middleware::from_fn(measure))
                .layer(CompressionLayer::new())
                .layer(middleware::from_fn(problems_only))
                .layer(CatchPanicLayer::custom(panicked))
                .layer(middleware::from_fn_with_state(
                    limits.request_timeout,
                    drain::drain_body,
                ))
                .layer(middleware::from_fn_with_state(
                    access.clone(),
                    admission::known_hosts,
                ))
                .layer(middleware::from_fn(admission::preflight))
                .option_layer(admission::cross_origin(&access))
                .layer(middleware::from_fn_with_state(access, admission::admit)),
        )
        .with_state(app)
}

fn no_such_path(path: &str) -> Problem {
    Problem::new(Code::NoSuchPath, format!("there is nothing at {path}"))
}

async fn method_not_allowed(method: Method, uri: Uri) -> Problem {
    let detail = format!("{} does not take {method}", uri.path());
    Problem::new(Code::MethodNotAllowed, detail)
}

/// Middleware: an answer in bounded time. A body may take its own time before, and a wait is bounded by itself.
async fn bounded_time(State(limits): State<Limits>, request: Request, next: Next) -> Response {
    let time = limits.request_timeout * 2 + limits.wait_max;
    let answer = within(time, async { Ok(next.run(request).await) }).await;
    answer.into_response()
}

/// Middleware: counts and times requests, and sets the headers that every answer has.
async fn measure(request: Request, next: Next) -> Response {
    let route = request.extensions().get::<MatchedPath>().cloned();
    let method = request.method().clone();
    let begun = Instant::now();
    let mut response = next.run(request).await;
    // The path itself would make as many series as there are scenes; and any method name can be sent.
    let route = route.map_or("none".to_owned(), |route| route.as_str().to_owned());
    let method = match method {
        Method::GET => "GET",
        Method::HEAD => "HEAD",
        Method::POST => "POST",
        Method::PUT => "PUT",
        Method::DELETE => "DELETE",
        _ => "other",
    };
    let status = response.status().as_str().to_owned();
    metrics::counter!("union3d_http_requests_total", "method" => method, "route" => route.clone(), "status" => status)
        .increment(1);
    metrics::histogram!("union3d_http_request_duration_seconds", "method" => method, "route" => route)
        .record(begun.elapsed());
    let headers = response.headers_mut();
    headers.insert(
        header::X_CONTENT_TYPE_OPTIONS,
        HeaderValue::from_static("nosniff"),
    );
    headers.insert(header::X_FRAME_OPTIONS, HeaderValue::from_static("DENY"));
    response
}

/// Middleware: errors that some library answered become problems, too.
async fn problems_only(request: Request, next: Next) -> Response {
    let path = request.uri().path().to_owned();
    let response = next.run(request).await;
    let status = response.status();
    let fails = status.is_client_error() || status.is_server_error();
    let kind = response.headers().get(header::CONTENT_TYPE);
    if !fails || kind.is_some_and(|kind| kind == "application/problem+json") {
        return response;
    }
    match status {
        StatusCode::NOT_FOUND => no_such_path(&path),
        status if status.is_client_error() => Problem::new(Code::BadRequest, status.to_string()),
        status => Problem::new(Code::Internal, status.to_string()),
    }
    .into_response()
}

#[expect(clippy::needless_pass_by_value, reason = "the layer's signature")]
fn panicked(cause: Box<dyn Any + Send + 'static>) -> Response {
    calls::panicked(cause.as_ref()).into_response()
}

fn span<B>(request: &axum::http::Request<B>) -> tracing::Span {
    let id = request
        .headers()
        .get("x-request-id")
        .and_then(|id| id.to_str().ok());
    let key = tracing::field::Empty;
    tracing::info_span!("http", method = %request.method(), path = request.uri().path(), id, key)
}
