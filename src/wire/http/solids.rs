//! Scenes of solids: their shapes, and the solids themselves.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::changes::{self, Answered, ChangeAnswer};
use super::cubes::{CURSOR_MARK, cursor, listing, listing_headers};
use super::request::{
    self, ABOUT_ID, ABOUT_IDS, BodyType, Parameters, Path, Return, Room, VARY, body_type,
    preferred, whole,
};
use super::{App, scenes};
use crate::engine::Cursor;
use crate::geometry::CubeId;
use crate::wire::calls;
use crate::wire::decode;
use crate::wire::documents::{IdForm, LineOperation};
use crate::wire::problem::Problem;
use crate::wire::solids::{DefinedShape, ShapeDocument, SolidDocument};

/// Solids of a page when no limit is given, and the most that it holds.
const PAGE_LIMIT: u64 = 1_000;
const PAGE_LIMIT_MAX: u64 = 100_000;

/// Solids that are turned into text at once when all are listed.
const LISTED_SOLIDS: usize = 1_024;

/// Define a shape
///
/// One of `flat`, `ball`, `bull`, `vee`, `drill`, `tapered`, `box`, `hull` and `parts`, as in the settings of a scene of solids. A shape never
/// changes: sent again it is answered again, and another one of the same name is refused.
#[utoipa::path(
    put, path = "/v1/scenes/{scene}/shapes/{shape}", tag = "solids",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "milled"),
        ("shape" = String, Path, description = "Name of the shape", example = "t2"),
    ),
    request_body(content = ShapeDocument, content_type = "application/json",
        example = json!({"ball": {"diameter": 4, "length": 20}})),
    responses((status = 200, description = "The shape, durable", body = DefinedShape))
)]
pub(super) async fn put_shape(
    State(app): State<App>,
    Path((name, shape)): Path<(String, String)>,
    parameters: Parameters,
    headers: HeaderMap,
    room: Room,
    body: Body,
) -> Result<Json<DefinedShape>, Problem> {
    parameters.only(&[])?;
    let (scene, settings) = scenes::open_solids(&app, &name)?;
    body_type(&headers, &[BodyType::Json])?;
    let body = request::read(&headers, body, &app.limits, room).await?;
    let shape = decode::shape(&body.bytes, &shape, settings.scale())?;
    Ok(Json(calls::define(&scene, shape).await?))
}

/// Get a solid
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/solids/{id}", tag = "solids",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "milled"),
        ("id" = u64, Path, description = ABOUT_ID, example = 1),
        ("ids" = inline(Option<IdForm>), Query, description = ABOUT_IDS, example = "text"),
    ),
    responses((status = 200, description = "The solid", body = SolidDocument))
)]
pub(super) async fn get_solid(
    State(app): State<App>,
    Path((name, id)): Path<(String, String)>,
    parameters: Parameters,
) -> Result<Json<SolidDocument>, Problem> {
    let ids = parameters.only(&["ids"])?.ids()?;
    let id = CubeId(whole("id", &id)?);
    let (scene, settings) = scenes::open_solids(&app, &name)?;
    let body = calls::solid(&scene, id).await?;
    let shapes = scene.context()?;
    let shown = SolidDocument::of(&(id, body), ids, &shapes, settings.scale());
    Ok(Json(shown))
}

/// Some solids of a scene.
#[derive(Serialize, ToSchema)]
pub(crate) struct SolidPage {
    /// In an order that is fixed by their ids.
    solids: Vec<SolidDocument>,
    /// What to give as `after` for the next page; null when this is the last.
    next: Option<String>,
}

/// List the solids
///
/// A page at a time, or with `Accept: application/x-ndjson` (and without `after` and `limit`) all as of one seq, each a line
/// `{"insert": {..}}`.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/solids", tag = "solids",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "milled"),
        ("after" = Option<String>, Query, description = "`next` of the page before"),
        ("ids" = inline(Option<IdForm>), Query, description = ABOUT_IDS, example = "text"),
        ("limit" = Option<usize>, Query, minimum = 1, maximum = 100_000, description = "Most solids in the answer, 1 to 100,000; 1,000 if left out"),
    ),
    responses((status = 200, description = "Solids", content(
        (SolidPage = "application/json"),
        (inline(LineOperation<SolidDocument>) = "application/x-ndjson"),
    )))
)]
pub(super) async fn get_solids(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let all = preferred(&headers, &[BodyType::Json, BodyType::Ndjson]) == BodyType::Ndjson;
    let known: &[&str] = if all {
        &["ids"]
    } else {
        &["after", "limit", "ids"]
    };
    let query = parameters.only(known)?;
    let ids = query.ids()?;
    let (scene, settings) = scenes::open_solids(&app, &name)?;
    let scale = settings.scale();
    if all {
        let reading = scene.read_all().await?;
        let shapes = scene.context()?;
        let headers = listing_headers(&scene, reading.seq());
        let lines = listing(reading, LISTED_SOLIDS, move |solid| {
            LineOperation::Insert(SolidDocument::of(solid, ids, &shapes, scale))
        });
        return Ok((VARY, headers, lines).into_response());
    }
    let limit = query.limit(PAGE_LIMIT_MAX)?.unwrap_or(PAGE_LIMIT);
    let limit = usize::try_from(limit).expect("it is at most 100,000");
    let (solids, next) = scene.page(cursor(&query)?, limit).await?;
    let shapes = scene.context()?;
    let solids = solids.iter();
    let page = SolidPage {
        solids: solids
            .map(|solid| SolidDocument::of(solid, ids, &shapes, scale))
            .collect(),
        next: next.map(|Cursor(position)| format!("{CURSOR_MARK}{position:016x}")),
    };
    Ok((VARY, Json(page)).into_response())
}

/// Delete one solid
///
/// Counts as `unchanged` when there is no such solid, so a retry is safe.
#[utoipa::path(
    delete, path = "/v1/scenes/{scene}/solids/{id}", tag = "changes",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "milled"),
        ("id" = u64, Path, description = ABOUT_ID, example = 17),
        ("return" = inline(Option<Return>), Query, description = "`minimal` leaves `mass_properties` out", example = "minimal"),
        ("ids" = inline(Option<IdForm>), Query, description = ABOUT_IDS, example = "text"),
    ),
    responses((status = 200, description = "Durable", body = ChangeAnswer))
)]
pub(super) async fn delete_solid(
    State(app): State<App>,
    Path((name, id)): Path<(String, String)>,
    parameters: Parameters,
) -> Result<Answered, Problem> {
    let (scene, settings) = scenes::open_solids(&app, &name)?;
    changes::delete(&scene, &settings, &id, parameters).await
}
