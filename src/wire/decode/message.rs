//! Messages to operations and settings.

use std::collections::HashMap;

use prost::Message;

use super::{Decoded, note_settings, too_many};
use crate::engine::Op;
use crate::geometry::{CubeId, Place};
use crate::service::{Motion, Operations};
use crate::wire::convert::{self, Anchor, Rounding, Settings, SettingsDocument, StockDocument};
use crate::wire::problem::{Code, Fault, Faults, Problem};
use crate::wire::proto;

/// Reads an atomic change from a body that is a message `union3d.v1.Change`.
/// # Errors
/// [`Code::BadProtobuf`], [`Code::TooLarge`] above `cubes_max`, or [`Code::Invalid`] with every fault.
pub fn message(body: &[u8], settings: &Settings, cubes_max: usize) -> Result<Decoded, Problem> {
    change_message(&decoded(body)?, settings, cubes_max)
}

/// As [`message`], of a message that has been decoded.
/// # Errors
/// As [`message`].
pub fn change_message(
    message: &proto::Change,
    settings: &Settings,
    cubes_max: usize,
) -> Result<Decoded, Problem> {
    let count = message.x.len();
    if message.delete.len().saturating_add(count) > cubes_max {
        return Err(too_many(cubes_max));
    }
    let mut faults = Faults::default();
    same_length(
        message,
        [("y", message.y.len()), ("z", message.z.len())],
        &mut faults,
    );
    if !message.insert_id.is_empty() && message.insert_id.len() != count {
        faults.push(Fault::at(
            "/insert_id".to_owned(),
            format!(
                "has {} values, x has {count}: give an id to every cube or to none",
                message.insert_id.len()
            ),
            None,
        ));
    }
    for (name, len) in [
        ("shapes", message.shapes.len()),
        ("shape", message.shape.len()),
        ("to_x", message.to_x.len()),
        ("to_y", message.to_y.len()),
        ("to_z", message.to_z.len()),
        ("hulls", message.hulls.len()),
    ] {
        if len > 0 {
            let detail = format!("has {len} values, and the scene is one of cubes");
            faults.push(Fault::at(format!("/{name}"), detail, None));
        }
    }
    if !faults.is_empty() {
        return Err(faults.into_problem());
    }
    let motion = motion(message, &mut faults);
    let mut places = Vec::with_capacity(count);
    for index in 0..count {
        let corner = [message.x[index], message.y[index], message.z[index]];
        match Place::new(corner.map(i64::from), settings.edge()) {
            Ok(place) => places.push(place),
            Err(invalid) => faults.push(Fault {
                value: Some(invalid.coordinate.into()),
                ..Fault::at(
                    format!("/{}/{index}", ["x", "y", "z"][invalid.axis]),
                    invalid.to_string(),
                    None,
                )
            }),
        }
    }
    if !faults.is_empty() {
        return Err(faults.into_problem());
    }
    let delete = message.delete.iter().copied().map(CubeId);
    let ids = message.insert_id.iter().copied().map(CubeId);
    Ok(Decoded {
        operations: if message.insert_id.is_empty() && count > 0 {
            Operations::Numbered {
                delete: delete.collect(),
                insert: places,
            }
        } else {
            let insert = ids.zip(places).map(|(id, place)| Op::Insert(id, place));
            Operations::Named(delete.map(Op::Delete).chain(insert).collect())
        },
        deletions: message.delete.len(),
        motion,
    })
}

/// Notes columns that are not as long as that of x.
pub(super) fn same_length<const N: usize>(
    message: &proto::Change,
    columns: [(&str, usize); N],
    faults: &mut Faults,
) {
    let count = message.x.len();
    for (name, len) in columns {
        if len != count {
            let detail = format!("has {len} values, x has {count}");
            faults.push(Fault::at(format!("/{name}"), detail, None));
        }
    }
}

/// What the change belongs to.
pub(super) fn motion(message: &proto::Change, faults: &mut Faults) -> Motion {
    let mut motion = Motion {
        number: message.r#move,
        duration_ns: None,
    };
    match message.duration.map(convert::duration_ns).transpose() {
        Ok(duration) => motion.duration_ns = duration,
        Err(detail) => faults.push(Fault {
            value: message.duration.map(Into::into),
            ..Fault::at("/duration".to_owned(), detail, None)
        }),
    }
    motion
}

/// Looks for ids that stand at two places of a message.
/// # Errors
/// [`Code::Invalid`] with all of them.
pub fn change_message_duplicates(message: &proto::Change) -> Result<(), Problem> {
    let mut faults = Faults::default();
    let mut seen = HashMap::new();
    let corners = message.x.iter().zip(&message.y).zip(&message.z);
    for (index, (id, ((x, y), z))) in message.insert_id.iter().zip(corners).enumerate() {
        let (first, corner) = *seen.entry(*id).or_insert((index, (x, y, z)));
        if corner != (x, y, z) {
            faults.push(Fault {
                value: Some((*id).into()),
                ..Fault::at(
                    format!("/insert_id/{index}"),
                    format!("is also at another place, at index {first}"),
                    None,
                )
            });
        }
    }
    if faults.is_empty() {
        return Ok(());
    }
    Err(faults.into_problem())
}

/// As [`change_message_duplicates`], of a body.
/// # Errors
/// As [`change_message_duplicates`].
pub fn message_duplicates(body: &[u8]) -> Result<(), Problem> {
    change_message_duplicates(&decoded(body)?)
}

pub(super) fn decoded(body: &[u8]) -> Result<proto::Change, Problem> {
    proto::Change::decode(body).map_err(|error| Problem::new(Code::BadProtobuf, error.to_string()))
}

/// Reads the settings of a scene from a message.
/// # Errors
/// [`Code::Invalid`] with every fault.
pub fn settings_message(message: &proto::SceneSettings) -> Result<Settings, Problem> {
    let mut faults = Faults::default();
    let mut unknown = |name: &str, value: i32| {
        let fault = Fault::at(
            format!("/{name}"),
            "is not a value that is known here",
            None,
        );
        faults.push(Fault {
            value: Some(value.into()),
            ..fault
        });
    };
    let mut wanted = SettingsDocument::with_edge(message.edge);
    wanted.steps_per_unit = message
        .steps_per_unit
        .map_or(wanted.steps_per_unit, f64::from);
    wanted.unit = message.unit.clone().unwrap_or(wanted.unit);
    wanted.density = message.density.unwrap_or(wanted.density);
    match proto::Anchor::try_from(message.anchor) {
        Ok(proto::Anchor::Unspecified) => {}
        Ok(proto::Anchor::Corner) => wanted.anchor = Anchor::Corner,
        Ok(proto::Anchor::Center) => wanted.anchor = Anchor::Center,
        Err(_) => unknown("anchor", message.anchor),
    }
    match proto::Rounding::try_from(message.rounding) {
        Ok(proto::Rounding::Unspecified) => {}
        Ok(proto::Rounding::Nearest) => wanted.rounding = Rounding::Nearest,
        Ok(proto::Rounding::Reject) => wanted.rounding = Rounding::Reject,
        Err(_) => unknown("rounding", message.rounding),
    }
    if let Some(stock) = &message.stock {
        let mut corner = |name: &str, corner: Option<proto::Vector>| {
            if corner.is_none() {
                let place = format!("/stock/{name}");
                faults.push(Fault::at(place, "is missing", None));
            }
            corner.map(|corner| [corner.x, corner.y, corner.z])
        };
        let (min, max) = (corner("min", stock.min), corner("max", stock.max));
        wanted.stock = min.zip(max).map(|(min, max)| StockDocument { min, max });
    }
    match Settings::check(&wanted) {
        Ok(settings) if faults.is_empty() => return Ok(settings),
        Ok(_) => {}
        Err(invalid) => note_settings(&invalid, &mut faults),
    }
    Err(faults.into_problem())
}
