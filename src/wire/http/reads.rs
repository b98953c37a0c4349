//! Reading: totals now, past and as they change; history; cubes; points; the recount.

use std::convert::Infallible;
use std::fmt::Write;
use std::sync::Arc;

use axum::Json;
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures_util::{Stream, TryStreamExt};
use serde::Serialize;
use utoipa::ToSchema;

use super::request::{Known, Parameters, Path, accepts, accepts_ndjson, whole};
use super::{App, scenes};
use crate::engine::{Cursor, Side};
use crate::geometry::{CubeId, Place};
use crate::service::{HistoryRow, Published, Scene, Seq, ServiceError};
use crate::wire::calls::{self, HistoryRows};
use crate::wire::convert::{
    MassProperties, PartProperties, Removal, Settings, mass_properties, removal, rfc3339,
};
use crate::wire::problem::{Fault, Problem};

const HISTORY_LIMIT: usize = 1_000;
const HISTORY_LIMIT_MAX: usize = 10_000;
const PAGE_LIMIT: usize = 1_000;
const PAGE_LIMIT_MAX: usize = 100_000;

/// Cubes that are turned into text at once when all are listed.
const LISTED_CUBES: usize = 1_024;

fn shown(scene: &Scene, settings: &Settings, published: &Published) -> MassProperties {
    let name = Some(scene.name().as_str());
    mass_properties(name, Some(published.seq.0), &published.totals, settings)
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
        (status = 200, description = "The totals", body = MassProperties,
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
    let (scene, settings) = scenes::open(&app, &name)?;
    let published = calls::published(&scene, at, wait, app.limits.wait_max).await?;
    let tag = entity_tag(&scene, published.seq);
    let tagged = [
        (header::ETAG, tag.clone()),
        (header::CACHE_CONTROL, NO_CACHE),
    ];
    if matches_tag(&headers, &tag) {
        return Ok((StatusCode::NOT_MODIFIED, tagged).into_response());
    }
    Ok((tagged, Json(shown(&scene, &settings, &published))).into_response())
}

const NO_CACHE: HeaderValue = HeaderValue::from_static("no-cache");

/// Weak: the same totals may be sent compressed or not.
fn entity_tag(scene: &Scene, seq: Seq) -> HeaderValue {
    let tag = format!("W/\"{}-{}\"", calls::incarnation(scene), seq.0);
    HeaderValue::try_from(tag).expect("hexadecimal and decimal digits")
}

/// Whether `If-None-Match` names this tag, by weak comparison.
fn matches_tag(headers: &HeaderMap, tag: &HeaderValue) -> bool {
    let opaque = |tag: &str| tag.trim().trim_start_matches("W/").to_owned();
    let Ok(tag) = tag.to_str().map(opaque) else {
        return false;
    };
    // Our tags have no comma, so a list can be cut at commas: a foreign tag with one matches nothing either way.
    headers
        .get_all(header::IF_NONE_MATCH)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .any(|one| one.trim() == "*" || opaque(one) == tag)
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
    let (scene, settings) = scenes::open(&app, &name)?;
    let events = Sse::new(events(scene, settings)?).keep_alive(KeepAlive::default());
    Ok(([(header::CACHE_CONTROL, NO_CACHE)], events).into_response())
}

fn events(
    scene: Arc<Scene>,
    settings: Settings,
) -> Result<impl Stream<Item = Result<Event, Infallible>>, Problem> {
    let mut newest = scene.subscribe()?;
    Ok(async_stream::stream! {
        loop {
            let published = *newest.borrow_and_update();
            let text = serde_json::to_string(&shown(&scene, &settings, &published))
                .expect("numbers and strings are JSON");
            yield Ok(Event::default().id(published.seq.0.to_string()).data(text));
            if newest.changed().await.is_err() {
                break;
            }
        }
    })
}

/// A change of the past.
#[derive(Serialize, ToSchema)]
pub(crate) struct HistoryEntry {
    /// When it was accepted: RFC 3339, UTC.
    #[schema(format = DateTime, example = "2026-03-01T12:00:00.000Z")]
    time: String,
    /// The sender's number of the move it belongs to; null when none was given.
    #[schema(example = 120)]
    r#move: Option<u64>,
    /// Machine time, in seconds; null when none was given.
    #[schema(example = 0.25)]
    duration: Option<f64>,
    /// Cubes that it inserted.
    inserted: u64,
    /// Cubes that it deleted.
    deleted: u64,
    /// Volume that it removed from the stock, or added to the union where there is no stock, in user units cubed. Negative when it
    /// gave some back.
    volume_removed: f64,
    /// The same in steps cubed, exact.
    #[schema(example = "216000000000")]
    volume_removed_exact: String,
    /// Volume removed in a second of machine time; null without a duration above 0.
    removal_rate: Option<f64>,
    /// The totals after it, with its seq.
    #[serde(flatten)]
    totals: MassProperties,
}

impl HistoryEntry {
    fn new(scene: &str, row: &HistoryRow, settings: &Settings) -> Self {
        let Removal {
            duration,
            volume,
            exact,
            rate,
        } = removal(row.motion.duration_ns, row.volume_removed, settings);
        Self {
            time: rfc3339(row.at_ms),
            r#move: row.motion.number,
            duration,
            inserted: row.inserted,
            deleted: row.deleted,
            volume_removed: volume,
            volume_removed_exact: exact,
            removal_rate: rate,
            totals: mass_properties(Some(scene), Some(row.seq.0), &row.totals, settings),
        }
    }

    /// The cells of a line of CSV, as [`CSV_HEADER`] names them.
    fn cells(&self) -> [String; 17] {
        // The shortest text that reads back as the same number.
        let number = |value: f64| value.to_string();
        let maybe = |value: Option<f64>| value.map(number).unwrap_or_default();
        let part = |part: &Option<PartProperties>| maybe(part.as_ref().map(|part| part.volume));
        let totals = &self.totals;
        [
            totals.seq.map(|seq| seq.to_string()).unwrap_or_default(),
            self.time.clone(),
            self.r#move
                .map(|number| number.to_string())
                .unwrap_or_default(),
            maybe(self.duration),
            self.inserted.to_string(),
            self.deleted.to_string(),
            totals.cubes.to_string(),
            number(self.volume_removed),
            maybe(self.removal_rate),
            number(totals.volume),
            number(totals.area),
            number(totals.edge_length.total),
            totals.euler_characteristic.to_string(),
            part(&totals.removed),
            part(&totals.remaining),
            self.volume_removed_exact.clone(),
            totals.exact.volume.clone(),
        ]
    }
}

const CSV_HEADER: [&str; 17] = [
    "seq",
    "time",
    "move",
    "duration",
    "inserted",
    "deleted",
    "cubes",
    "volume_removed",
    "removal_rate",
    "volume",
    "area",
    "edge_length",
    "euler_characteristic",
    "removed",
    "remaining",
    "volume_removed_exact",
    "volume_exact",
];

/// Changes of the past.
#[derive(Serialize, ToSchema)]
pub(crate) struct History {
    /// By seq.
    changes: Vec<HistoryEntry>,
    /// Where the next page is; null when this is the last.
    #[schema(example = "/v1/scenes/pocket/history?from=1001&to=2000&limit=1000")]
    next: Option<String>,
}

/// Get the history
///
/// The totals after every change, what it removed and how fast: the curve of volume against moves. Changes that are no longer kept
/// are left out. `Accept: text/csv` or `application/x-ndjson` streams all that are asked for, a line a change; JSON comes in pages.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/history", tag = "mass properties",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("from" = Option<u64>, Query, description = "First seq, 1 if left out"),
        ("to" = Option<u64>, Query, description = "Last seq, the newest if left out"),
        ("move_from" = Option<u64>, Query, description = "Least number of a move; changes without a move are left out"),
        ("move_to" = Option<u64>, Query, description = "Greatest number of a move; changes without a move are left out"),
        ("limit" = Option<usize>, Query, description = "Most changes in the answer. JSON: 1 to 10,000, 1,000 if left out. Lines: any, all if left out"),
    ),
    responses((status = 200, description = "Changes, oldest first", content(
        (History = "application/json"),
        (String = "text/csv"),
        (String = "application/x-ndjson"),
    )))
)]
pub(super) async fn get_history(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let query = parameters.only(&["from", "to", "move_from", "move_to", "limit"])?;
    let lines = if accepts(&headers, "text/csv") {
        Some(Lines::Csv)
    } else if accepts_ndjson(&headers) {
        Some(Lines::Json)
    } else {
        None
    };
    let limit = match lines {
        Some(_) => query.number("limit")?.unwrap_or(u64::MAX),
        None => query.limit(HISTORY_LIMIT, HISTORY_LIMIT_MAX)? as u64,
    };
    let (from, to) = (query.number("from")?, query.number("to")?);
    let (move_from, move_to) = (query.number("move_from")?, query.number("move_to")?);
    let (scene, settings) = scenes::open(&app, &name)?;
    let mut rows = HistoryRows::new(scene, [from, to], [move_from, move_to], limit)?;
    if let Some(lines) = lines {
        return Ok(stream(rows, name, settings, lines));
    }
    let mut changes = Vec::new();
    while let Some(page) = rows.page().await? {
        changes.extend(
            page.iter()
                .map(|row| HistoryEntry::new(&name, row, &settings)),
        );
    }
    let next = rows.next.map(|next| {
        let mut link = format!("/v1/scenes/{name}/history?from={next}&to={}", rows.to);
        for (parameter, number) in [("move_from", move_from), ("move_to", move_to)] {
            if let Some(number) = number {
                write!(link, "&{parameter}={number}").expect("a String takes everything");
            }
        }
        link + &format!("&limit={limit}")
    });
    Ok((VARY, Json(History { changes, next })).into_response())
}

const VARY: [(header::HeaderName, HeaderValue); 1] =
    [(header::VARY, HeaderValue::from_static("accept"))];

/// How lines are written.
#[derive(Clone, Copy)]
enum Lines {
    Csv,
    Json,
}

/// All of them as lines. What fails on the way breaks the answer off: its status has been sent.
fn stream(mut rows: HistoryRows, name: String, settings: Settings, lines: Lines) -> Response {
    let kind = match lines {
        Lines::Csv => "text/csv; charset=utf-8",
        Lines::Json => "application/x-ndjson",
    };
    let body = async_stream::try_stream! {
        if matches!(lines, Lines::Csv) {
            yield Bytes::from(CSV_HEADER.join(",") + "\n");
        }
        while let Some(page) = rows.page().await? {
            let mut text = String::with_capacity(page.len() * 512);
            for row in &page {
                let entry = HistoryEntry::new(&name, row, &settings);
                match lines {
                    Lines::Csv => text += &entry.cells().join(","),
                    Lines::Json => text += &serde_json::to_string(&entry).expect("numbers and strings are JSON"),
                }
                text.push('\n');
            }
            yield Bytes::from(text);
        }
    };
    let body = Body::from_stream(body.map_err(|error: ServiceError| error));
    (
        VARY,
        [(header::CONTENT_TYPE, HeaderValue::from_static(kind))],
        body,
    )
        .into_response()
}

/// A cube.
#[derive(Serialize, ToSchema)]
pub(crate) struct CubeDocument {
    /// Its id.
    #[schema(example = 18)]
    id: u64,
    /// Where it is, in user units, as the scene's anchor says.
    #[schema(example = json!([0.0, 0.0, 2.5]))]
    at: [f64; 3],
}

fn cube_document((id, place): (CubeId, Place), settings: &Settings) -> CubeDocument {
    CubeDocument {
        id: id.0,
        at: settings.at(place),
    }
}

/// Get a cube
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/cubes/{id}", tag = "cubes",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("id" = u64, Path, description = "The cube's id", example = 18),
    ),
    responses((status = 200, description = "The cube", body = CubeDocument))
)]
pub(super) async fn get_cube(
    State(app): State<App>,
    Path((name, id)): Path<(String, String)>,
    parameters: Parameters,
) -> Result<Json<CubeDocument>, Problem> {
    parameters.only(&[])?;
    let id = CubeId(whole("id", &id)?);
    let (scene, settings) = scenes::open(&app, &name)?;
    let place = calls::cube(&scene, id).await?;
    Ok(Json(cube_document((id, place), &settings)))
}

/// Some cubes of a scene.
#[derive(Serialize, ToSchema)]
pub(crate) struct CubePage {
    /// In an order that is fixed by their ids.
    cubes: Vec<CubeDocument>,
    /// What to give as `after` for the next page; null when this is the last.
    next: Option<String>,
}

/// List the cubes
///
/// A page at a time, or with `Accept: application/x-ndjson` all as of one seq, each a line that can be posted back. A cube that is
/// there during the whole listing is listed exactly once, whatever changes meanwhile.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/cubes", tag = "cubes",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("after" = Option<String>, Query, description = "`next` of the page before"),
        ("limit" = Option<usize>, Query, description = "Most cubes in the answer, 1 to 100,000; 1,000 if left out"),
        ("Accept" = Option<String>, Header, description = "`application/x-ndjson` for all cubes as lines; then without `after` and `limit`"),
    ),
    responses((status = 200, description = "Cubes", content(
        (CubePage = "application/json"),
        (inline(crate::wire::openapi::LineWanted) = "application/x-ndjson", example = json!({"insert": {"id": 1, "at": [0.0, 0.0, 2.5]}})),
    )))
)]
pub(super) async fn get_cubes(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    if accepts_ndjson(&headers) {
        parameters.only(&[])?;
        let (scene, settings) = scenes::open(&app, &name)?;
        return Ok((VARY, all_cubes(&scene, settings).await?).into_response());
    }
    let query = parameters.only(&["after", "limit"])?;
    let limit = query.limit(PAGE_LIMIT, PAGE_LIMIT_MAX)?;
    let after = cursor(&query)?;
    let (scene, settings) = scenes::open(&app, &name)?;
    let (cubes, next) = scene.page(after, limit).await?;
    let cubes = cubes.into_iter();
    let page = CubePage {
        cubes: cubes.map(|cube| cube_document(cube, &settings)).collect(),
        next: next.map(|Cursor(position)| format!("{CURSOR_MARK}{position:016x}")),
    };
    Ok((VARY, Json(page)).into_response())
}

/// What our cursors begin with. Were their meaning to change, old ones would be refused by this letter.
const CURSOR_MARK: &str = "a";

fn cursor(query: &Known) -> Result<Option<Cursor>, Problem> {
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
async fn all_cubes(scene: &Scene, settings: Settings) -> Result<Response, Problem> {
    let (seq, cubes) = scene.cubes().await?;
    let lines = async_stream::stream! {
        for cubes in cubes.chunks(LISTED_CUBES) {
            let mut text = String::with_capacity(cubes.len() * 64);
            for (CubeId(id), place) in cubes {
                let [x, y, z] = settings.at(*place);
                writeln!(text, "{{\"insert\":{{\"id\":{id},\"at\":[{x:?},{y:?},{z:?}]}}}}")
                    .expect("a String takes everything");
            }
            yield Ok::<_, Infallible>(Bytes::from(text));
        }
    };
    let headers = [
        (
            header::CONTENT_TYPE,
            HeaderValue::from_static("application/x-ndjson"),
        ),
        (header::ETAG, entity_tag(scene, seq)),
    ];
    Ok((headers, Body::from_stream(lines)).into_response())
}

/// Where a point lies.
#[derive(Serialize, ToSchema)]
pub(crate) struct Containment {
    /// The change that this is as of.
    seq: u64,
    /// Where the point lies.
    side: SideName,
    /// A cube that holds it, its faces included; null when there is none.
    cube: Option<CubeDocument>,
    /// The lattice point that was asked about, in user units.
    point: [f64; 3],
}

/// Where a point lies.
#[derive(Serialize, ToSchema)]
#[schema(as = Side)]
#[serde(rename_all = "lowercase")]
enum SideName {
    /// In the interior of the union.
    Inside,
    /// On its boundary.
    Boundary,
    /// Outside.
    Outside,
}

/// Ask where a point lies
///
/// The point is rounded to the lattice as the scene's settings say.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/contains", tag = "cubes",
    params(
        ("scene" = String, Path, description = "Name of the scene", example = "pocket"),
        ("at" = String, Query, description = "`x,y,z` in user units", example = "1.5,2,0"),
    ),
    responses((status = 200, description = "Where it lies", body = Containment))
)]
pub(super) async fn get_contains(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
) -> Result<Json<Containment>, Problem> {
    let query = parameters.only(&["at"])?;
    let (scene, settings) = scenes::open(&app, &name)?;
    let point = point(query.text("at"), &settings)?;
    let (seq, side, cube) = scene.contains(point).await?;
    Ok(Json(Containment {
        seq: seq.0,
        side: match side {
            Side::Inside => SideName::Inside,
            Side::Boundary => SideName::Boundary,
            Side::Outside => SideName::Outside,
        },
        cube: cube.map(|cube| cube_document(cube, &settings)),
        point: settings.point_user(point),
    }))
}

/// The lattice point of `x,y,z`.
fn point(text: Option<&str>, settings: &Settings) -> Result<[i32; 3], Problem> {
    let text = text.unwrap_or_default();
    let numbers = text.split(',').map(|number| number.trim().parse().ok());
    let numbers: Option<Vec<f64>> = numbers.collect();
    match numbers.and_then(|numbers| <[f64; 3]>::try_from(numbers).ok()) {
        Some(at) => calls::point(at, text, settings),
        None => Err(Fault::in_parameter("at", calls::NO_POINT, text).into()),
    }
}

/// A recount that agrees.
#[derive(Serialize, ToSchema)]
pub(crate) struct AuditDocument {
    /// The change that it is as of.
    seq: u64,
    /// Number of cubes recounted.
    cubes: u64,
    /// Always true: a difference is a problem.
    equal: bool,
}

/// Recount everything
///
/// Counts all measures again from the cubes alone and compares. Changes go on meanwhile. Takes as long as inserting all cubes.
#[utoipa::path(
    post, path = "/v1/scenes/{scene}/audit", tag = "mass properties",
    params(("scene" = String, Path, description = "Name of the scene", example = "pocket")),
    responses((status = 200, description = "The totals are those of the cubes", body = AuditDocument))
)]
pub(super) async fn post_audit(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
) -> Result<Json<AuditDocument>, Problem> {
    parameters.only(&[])?;
    let (scene, settings) = scenes::open(&app, &name)?;
    let (seq, cubes) = calls::audit(&scene, &settings).await?;
    Ok(Json(AuditDocument {
        seq: seq.0,
        cubes,
        equal: true,
    }))
}
