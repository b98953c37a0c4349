//! The history: the totals after every change, what it removed and how fast.

use std::fmt::Write;
use std::sync::Arc;

use axum::Json;
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use futures_util::TryStreamExt;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::request::{BodyType, Parameters, Path, VARY, preferred};
use super::{App, scenes};
use crate::service::{HistoryRow, SceneOf, ServiceError};
use crate::wire::calls::HistoryRows;
use crate::wire::convert::{duration_user, removal_rate};
use crate::wire::kind::{
    Cell, HistoryChange, HistoryEntry, HistoryTotals, Opened, ShownKind, maybe,
};
use crate::wire::problem::Problem;

/// Changes of a page of JSON when no limit is given, and the most that it holds.
const PAGE_LIMIT: u64 = 1_000;
const PAGE_LIMIT_MAX: u64 = 10_000;

/// A row of the history, and the totals after it.
pub(in crate::wire) fn entry<K: ShownKind>(
    scene: &str,
    row: &HistoryRow<K>,
    settings: &K::Settings,
) -> (HistoryChange, K::Properties) {
    let duration = row.motion.duration_ns.map(duration_user);
    let volume = K::volume_user(row.volume_removed, settings);
    let change = HistoryChange {
        time: rfc3339(row.at_ms),
        r#move: row.motion.number,
        duration,
        inserted: row.inserted,
        deleted: row.deleted,
        volume_removed: volume,
        volume_removed_exact: row.volume_removed.to_string(),
        removal_rate: removal_rate(volume, duration),
    };
    let totals = K::properties(Some(scene), Some(row.seq.0), &row.totals, settings);
    (change, totals)
}

/// The cells of a line of CSV that tell of the change itself.
const CHANGE_CELLS: [Cell<HistoryChange>; 8] = [
    ("time", |change| change.time.clone()),
    ("move", |change| maybe(change.r#move)),
    ("duration", |change| maybe(change.duration)),
    ("inserted", |change| change.inserted.to_string()),
    ("deleted", |change| change.deleted.to_string()),
    ("volume_removed", |change| change.volume_removed.to_string()),
    ("removal_rate", |change| maybe(change.removal_rate)),
    ("volume_removed_exact", |change| {
        change.volume_removed_exact.clone()
    }),
];

/// The columns of CSV in their order. A kind of scene has those that it knows something about.
const COLUMNS: [&str; 18] = [
    "seq",
    "time",
    "move",
    "duration",
    "inserted",
    "deleted",
    "cubes",
    "solids",
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

/// The header of CSV.
pub(in crate::wire) fn csv_header<K: ShownKind>() -> Vec<String> {
    let knows = |column: &str| {
        CHANGE_CELLS.iter().any(|(name, _)| *name == column)
            || K::Properties::CELLS.iter().any(|(name, _)| *name == column)
    };
    let columns = COLUMNS.into_iter().filter(|column| knows(column));
    columns.map(str::to_owned).collect()
}

/// A line of CSV.
pub(in crate::wire) fn csv_line<K: ShownKind>(
    (change, totals): &(HistoryChange, K::Properties),
) -> Vec<String> {
    let cell = |column: &str| {
        let of_change = CHANGE_CELLS.iter().find(|(name, _)| *name == column);
        let of_totals = K::Properties::CELLS
            .iter()
            .find(|(name, _)| *name == column);
        let of_change = of_change.map(|(_, cell)| cell(change));
        of_change.or_else(|| of_totals.map(|(_, cell)| cell(totals)))
    };
    COLUMNS.into_iter().filter_map(cell).collect()
}

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
        ("limit" = Option<u64>, Query, minimum = 1, description = "Most changes in the answer. If left out 1,000 in JSON, of which a page holds at most 10,000; all as lines"),
    ),
    responses((status = 200, description = "Changes, oldest first", content(
        (History = "application/json"),
        (String = "text/csv"),
        (HistoryEntry = "application/x-ndjson"),
    )))
)]
pub(super) async fn get_history(
    State(app): State<App>,
    Path(name): Path<String>,
    parameters: Parameters,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let query = parameters.only(&["from", "to", "move_from", "move_to", "limit"])?;
    let kind = preferred(&headers, &[BodyType::Json, BodyType::Ndjson, BodyType::Csv]);
    let limit = query.limit(u64::MAX)?;
    let limit = match kind {
        BodyType::Json => limit.unwrap_or(PAGE_LIMIT).min(PAGE_LIMIT_MAX),
        _ => limit.unwrap_or(u64::MAX),
    };
    let (from, to) = (query.number("from")?, query.number("to")?);
    let (move_from, move_to) = (query.number("move_from")?, query.number("move_to")?);
    let asked = Asked {
        name,
        range: [from, to],
        moves: [move_from, move_to],
        limit,
        kind,
    };
    match scenes::open_any(&app, &asked.name)? {
        Opened::Cubes(scene, settings) => history(scene, settings, asked).await,
        Opened::Solids(scene, settings) => history(scene, settings, asked).await,
    }
}

/// What of a history is asked for, and how.
struct Asked {
    name: String,
    range: [Option<u64>; 2],
    moves: [Option<u64>; 2],
    limit: u64,
    kind: BodyType,
}

async fn history<K: ShownKind>(
    scene: Arc<SceneOf<K>>,
    settings: Arc<K::Settings>,
    asked: Asked,
) -> Result<Response, Problem> {
    let Asked {
        name,
        range,
        moves,
        limit,
        kind,
    } = asked;
    let mut rows = HistoryRows::new(scene, range, moves, limit)?;
    if kind != BodyType::Json {
        return Ok(stream(rows, name, settings, kind));
    }
    let mut changes = Vec::new();
    while let Some(page) = rows.page().await? {
        changes.extend(page.iter().map(|row| {
            let (change, totals) = entry(&name, row, &settings);
            K::entry(change, totals)
        }));
    }
    let next = rows.next.map(|next| {
        let mut link = format!("/v1/scenes/{name}/history?from={next}&to={}", rows.to);
        for (parameter, number) in ["move_from", "move_to"].into_iter().zip(moves) {
            if let Some(number) = number {
                write!(link, "&{parameter}={number}").expect("a String takes everything");
            }
        }
        link + &format!("&limit={limit}")
    });
    Ok((VARY, Json(History { changes, next })).into_response())
}

/// All of them as lines, of CSV or of JSON. What fails on the way breaks the answer off: its status has been sent.
fn stream<K: ShownKind>(
    mut rows: HistoryRows<K>,
    name: String,
    settings: Arc<K::Settings>,
    kind: BodyType,
) -> Response {
    let body = async_stream::try_stream! {
        if kind == BodyType::Csv {
            yield csv_lines([csv_header::<K>()]);
        }
        while let Some(page) = rows.page().await? {
            let entries = page.iter().map(|row| entry(&name, row, &settings));
            yield match kind {
                BodyType::Csv => csv_lines(entries.map(|entry| csv_line::<K>(&entry))),
                _ => json_lines(entries.map(|(change, totals)| K::entry(change, totals))),
            };
        }
    };
    let body = Body::from_stream(body.map_err(|error: ServiceError| error));
    (VARY, [(header::CONTENT_TYPE, kind.value())], body).into_response()
}

/// Lines of CSV.
pub(in crate::wire) fn csv_lines(records: impl IntoIterator<Item = Vec<String>>) -> Bytes {
    let mut csv = csv::Writer::from_writer(Vec::new());
    for record in records {
        csv.write_record(record).expect("memory takes everything");
    }
    let text = csv.into_inner().expect("memory takes everything");
    text.into()
}

fn json_lines(entries: impl Iterator<Item = HistoryEntry>) -> Bytes {
    let mut text = Vec::new();
    for entry in entries {
        serde_json::to_writer(&mut text, &entry).expect("numbers and strings are JSON");
        text.push(b'\n');
    }
    text.into()
}

/// A time in ms since 1970 as RFC 3339 writes it, in UTC. What lies beyond the year 9999 is shown as its last millisecond.
fn rfc3339(at_ms: u64) -> String {
    let time = i64::try_from(at_ms).ok().map(Timestamp::from_millisecond);
    let time = time.and_then(Result::ok).unwrap_or(Timestamp::MAX);
    format!("{time:.3}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_written_as_rfc_3339() {
        for (at_ms, text) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_782_399_999, "2000-02-28T23:59:59.999Z"),
            (951_782_400_000, "2000-02-29T00:00:00.000Z"),
            (951_868_800_000, "2000-03-01T00:00:00.000Z"),
            (1_735_689_599_000, "2024-12-31T23:59:59.000Z"),
            (4_102_444_800_007, "2100-01-01T00:00:00.007Z"),
            (4_107_542_400_000, "2100-03-01T00:00:00.000Z"),
        ] {
            assert_eq!(rfc3339(at_ms), text);
        }
    }
}
