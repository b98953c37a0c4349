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
use crate::service::{HistoryRow, ServiceError};
use crate::wire::calls::HistoryRows;
use crate::wire::convert::{MassProperties, Removal, Settings, mass_properties, removal};
use crate::wire::problem::Problem;

/// Changes of a page of JSON when no limit is given, and the most that it holds.
const PAGE_LIMIT: u64 = 1_000;
const PAGE_LIMIT_MAX: u64 = 10_000;

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
}

/// A column of CSV: its name, and the text of its cells.
type Column = (&'static str, fn(&HistoryEntry) -> String);

const COLUMNS: [Column; 17] = [
    ("seq", |row| maybe(row.totals.seq)),
    ("time", |row| row.time.clone()),
    ("move", |row| maybe(row.r#move)),
    ("duration", |row| maybe(row.duration)),
    ("inserted", |row| row.inserted.to_string()),
    ("deleted", |row| row.deleted.to_string()),
    ("cubes", |row| row.totals.cubes.to_string()),
    ("volume_removed", |row| row.volume_removed.to_string()),
    ("removal_rate", |row| maybe(row.removal_rate)),
    ("volume", |row| row.totals.user.volume.to_string()),
    ("area", |row| row.totals.user.area.to_string()),
    ("edge_length", |row| {
        row.totals.user.edge_length.total.to_string()
    }),
    ("euler_characteristic", |row| {
        row.totals.integers.euler_characteristic.to_string()
    }),
    ("removed", |row| {
        maybe(row.totals.removed.as_ref().map(|part| part.user.volume))
    }),
    ("remaining", |row| {
        maybe(row.totals.remaining.as_ref().map(|part| part.user.volume))
    }),
    ("volume_removed_exact", |row| {
        row.volume_removed_exact.clone()
    }),
    ("volume_exact", |row| {
        row.totals.integers.exact.volume.clone()
    }),
];

/// A cell that may be empty. Of a float the shortest text that reads back as the same number.
fn maybe(value: Option<impl ToString>) -> String {
    value.map(|value| value.to_string()).unwrap_or_default()
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
    let (scene, settings) = scenes::open(&app, &name)?;
    let mut rows = HistoryRows::new(scene, [from, to], [move_from, move_to], limit)?;
    if kind != BodyType::Json {
        return Ok(stream(rows, name, settings, kind));
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

/// All of them as lines, of CSV or of JSON. What fails on the way breaks the answer off: its status has been sent.
fn stream(
    mut rows: HistoryRows,
    name: String,
    settings: Arc<Settings>,
    kind: BodyType,
) -> Response {
    let body = async_stream::try_stream! {
        if kind == BodyType::Csv {
            yield csv_lines([COLUMNS.map(|(name, _)| name.to_owned())]);
        }
        while let Some(page) = rows.page().await? {
            let entries = page.iter().map(|row| HistoryEntry::new(&name, row, &settings));
            yield match kind {
                BodyType::Csv => csv_lines(entries.map(|entry| COLUMNS.map(|(_, cell)| cell(&entry)))),
                _ => json_lines(entries),
            };
        }
    };
    let body = Body::from_stream(body.map_err(|error: ServiceError| error));
    (VARY, [(header::CONTENT_TYPE, kind.value())], body).into_response()
}

fn csv_lines(records: impl IntoIterator<Item = [String; COLUMNS.len()]>) -> Bytes {
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
