//! The gRPC API: the calls of HTTP as messages, and streams of changes. One handler a call; what lies between decoding and
//! answer is `calls` and `atomic`, as for HTTP.
//!
//! ```text
//!   request ── id, trace, measure ── panics ── deadlines ── hosts, keys ── memory ── handler ── service
//!   beside it: health (serving once every scene is replayed) and reflection
//! ```

mod admission;
mod framing;
mod mass_properties;
mod measure;
mod messages;
mod room;
mod service;
mod solids;
mod status;
mod stream;
mod time;

use std::any::Any;
use std::time::Duration;

use axum::http::header::AUTHORIZATION;
use axum::http::{Request, Response};
use axum::middleware;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use tonic::body::Body;
use tonic::service::Routes;
use tonic_health::ServingStatus;
use tonic_health::server::{HealthReporter, health_reporter};
use tower::ServiceBuilder;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::request_id::{MakeRequestUuid, PropagateRequestIdLayer, SetRequestIdLayer};
use tower_http::sensitive_headers::SetSensitiveRequestHeadersLayer;
use tower_http::trace::TraceLayer;

pub use self::mass_properties::Missing;
use self::service::Calls;
use super::access::Access;
use super::calls;
use super::door::{Door, Protocol};
use super::failures;
use super::http::Limits;
use super::problem::Problem;
use super::proto::FILE_DESCRIPTOR_SET;
use super::proto::union_service_server::{SERVICE_NAME, UnionServiceServer};
use crate::service::{Readiness, Service};

/// How often it is looked whether every scene is replayed.
const READINESS_PAUSE: Duration = Duration::from_millis(50);

/// Serves the gRPC API of a service until `draining` is cancelled and the calls that are under way then have ended; streams
/// that have no end of their own are ended.
pub async fn serve(
    door: Door,
    listener: TcpListener,
    service: Service,
    limits: Limits,
    access: Access,
    draining: CancellationToken,
) {
    let (reporter, health) = health_reporter();
    set_health(&reporter, ServingStatus::NotServing).await;
    let calls = Calls {
        service: service.clone(),
        limits,
        draining: draining.clone(),
    };
    let calls = UnionServiceServer::new(calls).max_decoding_message_size(limits.body_bytes_max);
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
            // What the details of a status are made of.
            .register_encoded_file_descriptor_set(tonic_types::pb::FILE_DESCRIPTOR_SET)
    };
    let well_formed = "the compiler of the messages wrote the descriptors";
    let calls = Routes::new(health)
        .add_service(reflection().build_v1().expect(well_formed))
        // Common tools still ask in the older way.
        .add_service(reflection().build_v1alpha().expect(well_formed))
        .add_service(calls);
    let room = room::Rooms {
        budget: service.budget().clone(),
        wait_max: limits.request_timeout,
    };
    let router = calls.prepare().into_axum_router().layer(
        ServiceBuilder::new()
            .layer(SetRequestIdLayer::x_request_id(MakeRequestUuid))
            .layer(SetSensitiveRequestHeadersLayer::new([AUTHORIZATION]))
            .layer(
                TraceLayer::new(failures::of_grpc())
                    .make_span_with(span)
                    .on_failure(failures::tell_grpc()),
            )
            .layer(PropagateRequestIdLayer::x_request_id())
            .layer(measure::layer())
            .layer(CatchPanicLayer::custom(panicked))
            .layer(middleware::from_fn_with_state(
                limits.request_timeout,
                time::in_time,
            ))
            .layer(admission::layer(access))
            .layer(middleware::from_fn_with_state(room, room::taken)),
    );
    let serving = door.serve(listener, Protocol::Grpc, router, draining.clone());
    let showing = show_health(&reporter, &service, &draining);
    tokio::join!(serving, showing);
}

/// Shows that the service serves, from when every scene is replayed until it drains.
async fn show_health(reporter: &HealthReporter, service: &Service, draining: &CancellationToken) {
    let ready = async {
        while let Readiness::Recovering { .. } = service.readiness() {
            tokio::time::sleep(READINESS_PAUSE).await;
        }
        set_health(reporter, ServingStatus::Serving).await;
        draining.cancelled().await;
    };
    draining.run_until_cancelled(ready).await;
    set_health(reporter, ServingStatus::NotServing).await;
}

async fn set_health(reporter: &HealthReporter, status: ServingStatus) {
    for name in ["", SERVICE_NAME] {
        reporter.set_service_status(name, status).await;
    }
}

/// The idempotency key of a request, if it has one.
fn idempotency_key(sent: Option<&str>) -> Result<Option<Box<str>>, Problem> {
    sent.map(|key| calls::idempotency_key(key.as_bytes()))
        .transpose()
}

#[expect(clippy::needless_pass_by_value, reason = "the layer's signature")]
fn panicked(cause: Box<dyn Any + Send + 'static>) -> Response<Body> {
    status::status(&calls::panicked(cause.as_ref()), "").into_http()
}

fn span<B>(request: &Request<B>) -> tracing::Span {
    let id = request
        .headers()
        .get("x-request-id")
        .and_then(|id| id.to_str().ok());
    let key = tracing::field::Empty;
    tracing::info_span!("grpc", path = request.uri().path(), id, key)
}
