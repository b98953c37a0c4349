//! Reading cubes: one, a page, all.

use std::sync::Arc;

use axum::Json;
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use headers::HeaderMapExt;
use serde::Serialize;
use utoipa::ToSchema;

use super::reads::entity_tag;
use super::request::{
    ABOUT_ID, ABOUT_IDS, BodyType, Known, Parameters, Path, VARY, preferred, whole,
};
use super::{App, scenes};
use crate::engine::Cursor;
use crate::geometry::CubeId;
use crate::service::{Reading, Scene, SceneKind, SceneOf, Seq, ServiceError};
use crate::wire::calls;
use crate::wire::convert::Settings;
use crate::wire::documents::{Cube, IdForm, LineOperation};
use crate::wire::problem::{Fault, Problem};

/// Cubes of a page when no limit is given, and the most that it holds.
const PAGE_LIMIT: u64 = 1_000;
const PAGE_LIMIT_MAX: u64 = 100_000;

/// Cubes that are turned into text at once when all are listed.
const LISTED_CUBES: usize = 1_024;

/// Get a cube
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/cubes/{id}", tag = "cubes",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("id" = u64, Path, description = ABOUT_ID, example = 18),
        ("ids" = inline(Option<IdForm>), Query, description = ABOUT_IDS, example = "text"),
    ),
    responses((status = 200, description = "The cube", body = Cube))
)]
pub(super) async fn get_cube(
    State(app): State<App>,
    Path((name, id)): Path<(String, String)>,
    parameters: Parameters,
) -> Result<Json<Cube>, Problem> {
    let ids = parameters.only(&["ids"])?.ids()?;
    let id = CubeId(whole("id", &id)?);
    let (scene, settings) = scenes::open(&app, &name)?;
    let place = calls::cube(&scene, id).await?;
    Ok(Json(Cube::new((id, place), ids, &settings)))
}

/// Some cubes of a scene.
#[derive(Serialize, ToSchema)]
pub(crate) struct CubePage {
    /// In an order that is fixed by their ids.
    cubes: Vec<Cube>,
    /// What to give as `after` for the next page; null when this is the last.
    next: Option<String>,
}

/// List the cubes
///
/// A page at a time, or with `Accept: application/x-ndjson` (and without `after` and `limit`) all as of one seq, each a line that can be
/// posted back. A cube that is
/// there during the whole listing is listed exactly once, whatever changes meanwhile.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/cubes", tag = "cubes",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("after" = Option<String>, Query, description = "`next` of the page before"),
        ("ids" = inline(Option<IdForm>), Query, description = ABOUT_IDS, example = "text"),
        ("limit" = Option<usize>, Query, minimum = 1, maximum = 100_000, description = "Most cubes in the answer, 1 to 100,000; 1,000 if left out"),
    ),
    responses((status = 200, description = "Cubes", content(
        (CubePage = "application/json"),
        (inline(LineOperation<Cube>) = "application/x-ndjson", example = json!({"insert": {"id": 1, "at": [0.0, 0.0, 2.5]}})),
    )))
)]
pub(super) async fn get_cubes(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    if preferred(&headers, &[BodyType::Json, BodyType::Ndjson]) == BodyType::Ndjson {
        let ids = parameters.only(&["ids"])?.ids()?;
        let (scene, settings) = scenes::open(&app, &name)?;
        return Ok((VARY, all_cubes(&scene, settings, ids).await?).into_response());
    }
    let query = parameters.only(&["after", "limit", "ids"])?;
    let ids = query.ids()?;
    let limit = query.limit(PAGE_LIMIT_MAX)?.unwrap_or(PAGE_LIMIT);
    let limit = usize::try_from(limit).expect("it is at most 100,000");
    let after = cursor(&query)?;
    let (scene, settings) = scenes::open(&app, &name)?;
    let (cubes, next) = scene.page(after, limit).await?;
    let cubes = cubes.into_iter();
    let page = CubePage {
        cubes: cubes.map(|cube| Cube::new(cube, ids, &settings)).collect(),
        next: next.map(|Cursor(position)| format!("{CURSOR_MARK}{position:016x}")),
    };
    Ok((VARY, Json(page)).into_response())
}

/// What our cursors begin with. Were their meaning to change, old ones would be refused by this letter.
pub(super) const CURSOR_MARK: &str = "a";

pub(super) fn cursor(query: &Known) -> Result<Option<Cursor>, Problem> {
    let Some(text) = query.text("after") else {
        return Ok(None);
    };
    let digits = text.strip_prefix(CURSOR_MARK).unwrap_or_default();
    match u64::from_str_radix(digits, 16) {
        Ok(position) if digits.len() == 16 => Ok(Some(Cursor(position))),
        _ => Err(Fault::in_parameter("after", "is not `next` of a page", text).into()),
    }
}

/// All cubes as lines that can be posted to `changes`.
async fn all_cubes(
    scene: &Arc<Scene>,
    settings: Arc<Settings>,
    ids: IdForm,
) -> Result<Response, Problem> {
    let reading = scene.read_all().await?;
    let headers = listing_headers(scene, reading.seq());
    let lines = listing(reading, LISTED_CUBES, move |cube| {
        LineOperation::Insert(Cube::new(*cube, ids, &settings))
    });
    Ok((headers, lines).into_response())
}

/// What is said of a listing as of one seq.
pub(super) fn listing_headers<K: SceneKind>(scene: &SceneOf<K>, seq: Seq) -> HeaderMap {
    let mut headers = HeaderMap::new();
    headers.insert(header::CONTENT_TYPE, BodyType::Ndjson.value());
    headers.typed_insert(entity_tag(scene, seq));
    headers
}

/// All bodies, a line each, so many at a time. What keeps it from coming to its end breaks it off, so that nobody takes a part of a
/// listing for all of it.
pub(super) fn listing<K: SceneKind, T: Serialize>(
    mut reading: Reading<K>,
    bodies_at_once: usize,
    line: impl Fn(&(CubeId, K::Body)) -> T + Send + 'static,
) -> Body {
    Body::from_stream(async_stream::stream! {
        loop {
            let bodies = match reading.next(bodies_at_once).await {
                Ok(bodies) if bodies.is_empty() => break,
                Ok(bodies) => bodies,
                Err(error) => {
                    yield Err(error);
                    break;
                }
            };
            let mut text = Vec::with_capacity(bodies.len() * 64);
            for body in &bodies {
                serde_json::to_writer(&mut text, &line(body)).expect("numbers and strings are JSON");
                text.push(b'\n');
            }
            yield Ok::<_, ServiceError>(Bytes::from(text));
        }
    })
}
