//! Reading totals: now, past, and as they change; the recount.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use headers::{ETag, HeaderMapExt, IfNoneMatch};
use serde::Serialize;
use utoipa::ToSchema;

use super::request::{self, BodyType, Parameters, Path, Room, body_type};
use super::{App, scenes};
use crate::service::{Published, SceneKind, SceneOf, Seq};
use crate::wire::calls;
use crate::wire::decode;
use crate::wire::documents::AuditRequest;
use crate::wire::kind::{Opened, Properties, ShownKind};
use crate::wire::problem::Problem;

fn shown<K: ShownKind>(
    scene: &SceneOf<K>,
    settings: &K::Settings,
    published: &Published<K>,
) -> Properties {
    let name = Some(scene.name().as_str());
    let seq = Some(published.seq.0);
    K::shown(K::properties(name, seq, &published.totals, settings))
}

/// Get the mass properties
///
/// Current ones, or as of a past change with `at`, or with `wait` not before a change is visible. `ETag` is the scene's incarnation
/// and seq.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/mass-properties", tag = "mass properties",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("at" = Option<u64>, Query, description = "Seq of a past change"),
        ("wait" = Option<u64>, Query, description = "Seq to wait for, at most ten seconds. Not together with `at`"),
        ("If-None-Match" = Option<String>, Header, description = "An `ETag` that was answered before"),
    ),
    responses(
        (status = 200, description = "The totals", body = Properties,
            headers(("ETag" = String, description = "Incarnation and seq: `W/\"6f1d3c0a9b2e4d57-5\"`"))),
        (status = 304, description = "They are those of `If-None-Match`"),
    )
)]
pub(super) async fn get_mass_properties(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let query = parameters.only(&["at", "wait"])?;
    let (at, wait) = (query.number("at")?, query.number("wait")?);
    let question = (at, wait, app.limits.wait_max);
    match scenes::open_any(&app, &name)? {
        Opened::Cubes(scene, settings) => {
            mass_properties(&scene, &settings, question, &headers).await
        }
        Opened::Solids(scene, settings) => {
            mass_properties(&scene, &settings, question, &headers).await
        }
    }
}

async fn mass_properties<K: ShownKind>(
    scene: &SceneOf<K>,
    settings: &K::Settings,
    (at, wait, wait_max): (Option<u64>, Option<u64>, Duration),
    headers: &HeaderMap,
) -> Result<Response, Problem> {
    let published = calls::published(scene, at, wait, wait_max).await?;
    let tag = entity_tag(scene, published.seq);
    let known: Option<IfNoneMatch> = headers.typed_get();
    let mut tagged = HeaderMap::new();
    tagged.typed_insert(tag.clone());
    tagged.insert(header::CACHE_CONTROL, NO_CACHE);
    if known.is_some_and(|known| !known.precondition_passes(&tag)) {
        return Ok((StatusCode::NOT_MODIFIED, tagged).into_response());
    }
    Ok((tagged, Json(shown(scene, settings, &published))).into_response())
}

/// Kept, but asked for again each time.
pub(super) const NO_CACHE: HeaderValue = HeaderValue::from_static("no-cache");

/// Weak: the same totals may be sent compressed or not.
pub(super) fn entity_tag<K: SceneKind>(scene: &SceneOf<K>, seq: Seq) -> ETag {
    let tag = format!(
        "W/\"{}-{}\"",
        calls::incarnation(scene.incarnation()),
        seq.0
    );
    tag.parse().expect("hexadecimal and decimal digits")
}

/// Watch the mass properties
///
/// Server-sent events: the current totals at once, then whenever they change. The event's id is the seq. A slow reader skips to the
/// newest. The stream ends when the scene is dropped or stopped, or the server shuts down.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/mass-properties/stream", tag = "mass properties",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("Last-Event-ID" = Option<String>, Header, description = "Taken, without effect: the first event is the current state"),
    ),
    responses((status = 200, description = "Events; `data` is a `MassProperties` object", body = String, content_type = "text/event-stream"))
)]
pub(super) async fn stream_mass_properties(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
) -> Result<Response, Problem> {
    parameters.only(&[])?;
    match scenes::open_any(&app, &name)? {
        Opened::Cubes(scene, settings) => events(scene, settings),
        Opened::Solids(scene, settings) => events(scene, settings),
    }
}

fn events<K: ShownKind>(
    scene: Arc<SceneOf<K>>,
    settings: Arc<K::Settings>,
) -> Result<Response, Problem> {
    let mut newest = scene.subscribe()?;
    let events = async_stream::stream! {
        loop {
            let published = *newest.borrow_and_update();
            let text = serde_json::to_string(&shown(&scene, &settings, &published))
                .expect("numbers and strings are JSON");
            yield Ok::<_, Infallible>(Event::default().id(published.seq.0.to_string()).data(text));
            if newest.changed().await.is_err() {
                break;
            }
        }
    };
    let events = Sse::new(events).keep_alive(KeepAlive::default());
    Ok(([(header::CACHE_CONTROL, NO_CACHE)], events).into_response())
}

/// A recount that agrees.
#[derive(Serialize, ToSchema)]
pub(in crate::wire) struct AuditDocument {
    /// The change that it is as of.
    seq: u64,
    /// Number of cubes recounted; of a scene of cubes.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    cubes: Option<u64>,
    /// Number of solids recounted; of a scene of solids.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    solids: Option<u64>,
    /// Always true: a difference is a problem.
    equal: bool,
}

/// Recount everything
///
/// Counts all measures again from the cubes or solids alone and compares. Changes go on meanwhile. Takes as long as inserting all cubes.
/// The body may be left out, its type may not: so no form of a page of another origin can ask for it.
#[utoipa::path(
    post, path = "/v1/scenes/{scene}/audit", tag = "mass properties",
    params(("scene" = String, Path, description = "Name of the scene", example = "pocket")),
    request_body(content((AuditRequest = "application/json", example = json!({})))),
    responses((status = 200, description = "The totals are those of the cubes", body = AuditDocument))
)]
pub(super) async fn post_audit(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
    headers: HeaderMap,
    room: Room,
    body: Body,
) -> Result<Json<AuditDocument>, Problem> {
    parameters.only(&[])?;
    body_type(&headers, &[BodyType::Json])?;
    let body = request::read(&headers, body, &app.limits, room).await?;
    decode::audit(&body.bytes)?;
    Ok(Json(match scenes::open_any(&app, &name)? {
        Opened::Cubes(scene, settings) => {
            AuditDocument::of_cubes(calls::audit(&scene, &settings).await?)
        }
        Opened::Solids(scene, settings) => {
            AuditDocument::of_solids(calls::audit(&scene, &settings).await?)
        }
    }))
}

impl AuditDocument {
    pub(in crate::wire) fn of_cubes((seq, cubes): (Seq, u64)) -> Self {
        Self {
            seq: seq.0,
            cubes: Some(cubes),
            solids: None,
            equal: true,
        }
    }

    pub(in crate::wire) fn of_solids((seq, solids): (Seq, u64)) -> Self {
        Self {
            seq: seq.0,
            cubes: None,
            solids: Some(solids),
            equal: true,
        }
    }
}
