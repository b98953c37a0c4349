//! Changes in JSON, whole or a line at a time, to operations.

use std::collections::{HashMap, HashSet};

use super::json;
use super::{Decoded, too_many};
use crate::engine::Op;
use crate::geometry::{CubeId, Place};
use crate::service::{Motion, Operations};
use crate::wire::convert::{self, Settings};
use crate::wire::documents::{Change, Cube, Id, LineOperation, NewCube};
use crate::wire::problem::{Code, Fault, Faults, Problem};

/// Reads an atomic change from JSON: `{"delete":[17],"insert":[{"id":18,"at":[0,0,2.5]}]}`, both members optional.
/// # Errors
/// [`Code::BadJson`], [`Code::TooLarge`] above `cubes_max`, or [`Code::Invalid`] with every fault.
pub fn change(body: &[u8], settings: &Settings, cubes_max: usize) -> Result<Decoded, Problem> {
    if commas_fit(body, cubes_max)
        && let Ok(change) = serde_json::from_slice::<Change>(body)
    {
        if cubes(&change) > cubes_max {
            return Err(too_many(cubes_max));
        }
        if let Some(decoded) = decoded(&change, settings) {
            return Ok(decoded);
        }
    }
    change_faults(body, settings, cubes_max)
}

/// Reads an atomic change once more, slowly, for its faults. An id at two places is one.
/// # Errors
/// As [`change`].
pub fn change_faults(
    body: &[u8],
    settings: &Settings,
    cubes_max: usize,
) -> Result<Decoded, Problem> {
    let body = json::text(body)?;
    let check = |change: &Change, faults: &mut Faults| check(change, settings, faults);
    let (change, faults) = json::examine(json::parse(&body)?, cubes_max.saturating_add(1), check);
    if change
        .as_ref()
        .is_some_and(|change| cubes(change) > cubes_max)
    {
        return Err(too_many(cubes_max));
    }
    let change = json::complete(change, faults)?;
    decoded(&change, settings)
        .ok_or_else(|| Problem::new(Code::Internal, "a change has neither faults nor meaning"))
}

/// Reads one line of a stream: `{"insert":{"id":1,"at":[0,0,0]}}` or `{"delete":1}`.
/// # Errors
/// [`Code::BadJson`] or [`Code::Invalid`]; the caller knows the line's number.
pub fn line(text: &[u8], settings: &Settings) -> Result<Op, Problem> {
    let operation = |line: &LineOperation<Cube>| match line {
        LineOperation::Delete(id) => Some(Op::Delete(id.id)),
        LineOperation::Insert(cube) => {
            let place = settings.place(cube.at).ok();
            place.map(|place| Op::Insert(cube.id.id, place))
        }
    };
    if let Ok(line) = serde_json::from_slice(text)
        && let Some(operation) = operation(&line)
    {
        return Ok(operation);
    }
    let text = json::text(text).map_err(json::on_one_line)?;
    let raw = json::parse(&text).map_err(json::on_one_line)?;
    let check = |line: &LineOperation<Cube>, faults: &mut Faults| {
        if let LineOperation::Insert(cube) = line {
            check_at(cube.at, "/insert/at", settings, faults);
        }
    };
    let (line, faults) = json::examine(raw, usize::MAX, check);
    let line = json::complete(line, faults)?;
    operation(&line)
        .ok_or_else(|| Problem::new(Code::Internal, "a line has neither faults nor meaning"))
}

/// Reads one line of a file of cubes: a line of a stream, whose cubes need no id, or a cube alone, `{"id":1,"at":[0,0,0]}`. What is at
/// fault with a place is not looked for.
/// # Errors
/// [`Code::BadJson`] or [`Code::Invalid`]; the caller knows the line's number.
pub fn file_line(text: &[u8]) -> Result<LineOperation<NewCube>, Problem> {
    // What can be read as one cannot be read as the other.
    if let Ok(cube) = serde_json::from_slice(text) {
        return Ok(LineOperation::Insert(cube));
    }
    if let Ok(line) = serde_json::from_slice(text) {
        return Ok(line);
    }
    let text = json::text(text).map_err(json::on_one_line)?;
    let raw = json::parse(&text).map_err(json::on_one_line)?;
    let (line, faults) = json::examine(raw, usize::MAX, |_: &LineOperation<NewCube>, _| ());
    // A cube alone is known by the members that it should have.
    let is_line = faults.is_empty() || ["/id", "/at"].iter().all(|name| !faults.cover(name));
    if is_line {
        return json::complete(line, faults);
    }
    let (cube, faults) = json::examine(raw, usize::MAX, |_: &NewCube, _| ());
    json::complete(cube.map(LineOperation::Insert), faults)
}

/// Whether a body may be read at once: a good change has at most four commas a cube, and three more. So what is read before the cubes can
/// be counted is never much more than a change of `cubes_max`, however large the body.
pub(super) fn commas_fit(body: &[u8], cubes_max: usize) -> bool {
    let commas_max = cubes_max.saturating_mul(4).saturating_add(3);
    body.len() <= commas_max || memchr::memchr_iter(b',', body).count() <= commas_max
}

/// Cubes that a change names.
fn cubes(change: &Change) -> usize {
    change.delete.len() + change.insert.len()
}

/// What a change does; none when it has a fault.
pub(super) fn decoded(change: &Change, settings: &Settings) -> Option<Decoded> {
    let Change {
        delete,
        insert,
        r#move,
        duration,
    } = change;
    let duration_ns = duration.map(convert::duration_ns).transpose().ok()?;
    let deletions = delete.len();
    let numbered = !insert.is_empty() && insert.iter().all(|cube| cube.id.is_none());
    let operations = if numbered {
        let mut places = Vec::with_capacity(insert.len());
        for cube in insert {
            places.push(settings.place(cube.at).ok()?);
        }
        Operations::Numbered {
            delete: delete.iter().map(|id| id.id).collect(),
            insert: places,
        }
    } else {
        let mut operations = Vec::with_capacity(deletions + insert.len());
        operations.extend(delete.iter().map(|id| Op::Delete(id.id)));
        for NewCube { id, at } in insert {
            operations.push(Op::Insert((*id)?.id, settings.place(*at).ok()?));
        }
        Operations::Named(operations)
    };
    Some(Decoded {
        operations,
        deletions,
        motion: Motion {
            number: *r#move,
            duration_ns,
        },
    })
}

/// Notes what breaks a rule in a change that can be read, or has stand-ins where the faults say so.
fn check(change: &Change, settings: &Settings, faults: &mut Faults) {
    if let Some(Err(detail)) = change.duration.map(convert::duration_ns)
        && !faults.cover("/duration")
    {
        faults.push(Fault::at("/duration".to_owned(), detail, None));
    }
    let unread = rows_at_fault(faults);
    // Where each id is inserted first.
    let mut seen: HashMap<CubeId, (usize, Place)> = HashMap::new();
    // Whether the first cube has an id.
    let mut first_named = None;
    for (index, NewCube { id, at }) in change.insert.iter().enumerate() {
        if faults.is_full() {
            return;
        }
        let pointer = || format!("/insert/{index}");
        let readable = !unread.contains(&index);
        if readable
            || !faults
                .as_slice()
                .iter()
                .any(|fault| fault.pointer == Some(pointer()))
        {
            let named = id.is_some();
            if *first_named.get_or_insert(named) != named {
                let detail = if named {
                    "has an id, though cubes before it have none: give an id to every cube or to none"
                } else {
                    "has no id, though cubes before it have one: give an id to every cube or to none"
                };
                faults.push(Fault::at(pointer(), detail, None));
            }
        }
        let place = settings.place(*at).ok();
        if place.is_none() || !readable {
            check_at(*at, &(pointer() + "/at"), settings, faults);
        }
        if let (true, Some(Id { id, .. }), Some(place)) = (readable, id, place) {
            let (first, there) = *seen.entry(*id).or_insert((index, place));
            if there != place {
                let detail = format!("is also at another place, in /insert/{first}");
                faults.push(Fault::at(pointer() + "/id", detail, None));
            }
        }
    }
}

/// Cubes to insert that cannot be read in whole.
fn rows_at_fault(faults: &Faults) -> HashSet<usize> {
    let row = |fault: &Fault| {
        let steps = fault.pointer.as_deref()?.strip_prefix("/insert/")?;
        steps.split('/').next()?.parse().ok()
    };
    faults.as_slice().iter().filter_map(row).collect()
}

/// Notes what is wrong with the coordinates that can be read.
fn check_at(at: [f64; 3], pointer: &str, settings: &Settings, faults: &mut Faults) {
    for (axis, coordinate) in at.into_iter().enumerate() {
        if let Some(fault) = settings.coordinate_fault(coordinate) {
            let pointer = format!("{pointer}/{axis}");
            if !faults.cover(&pointer) {
                faults.push(Fault::at(pointer, fault.to_string(), None));
            }
        }
    }
}
