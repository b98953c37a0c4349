//! Messages to operations of a scene of solids.

use std::collections::HashMap;
use std::sync::Arc;

use super::message::{decoded, motion, same_length};
use super::{Decoded, too_many};
use crate::engine::Op;
use crate::engine::solids::{Body, Shape};
use crate::geometry::CubeId;
use crate::geometry::convex::{Point, Solid};
use crate::service::{Operations, Shapes, Solids};
use crate::wire::problem::{Fault, Faults, Problem};
use crate::wire::proto;

/// Reads an atomic change of solids from a body that is a message `union3d.v1.Change`.
/// # Errors
/// [`Code::BadProtobuf`], [`Code::TooLarge`] above `solids_max`, or [`Code::Invalid`] with every fault.
///
/// [`Code::BadProtobuf`]: crate::wire::problem::Code::BadProtobuf
/// [`Code::TooLarge`]: crate::wire::problem::Code::TooLarge
/// [`Code::Invalid`]: crate::wire::problem::Code::Invalid
pub fn solid_message(
    body: &[u8],
    shapes: &Shapes,
    solids_max: usize,
) -> Result<Decoded<Solids>, Problem> {
    solid_change_message(&decoded(body)?, shapes, solids_max)
}

/// As [`solid_message`], of a message that has been decoded.
/// # Errors
/// As [`solid_message`].
pub fn solid_change_message(
    message: &proto::Change,
    shapes: &Shapes,
    solids_max: usize,
) -> Result<Decoded<Solids>, Problem> {
    let (swept, hulls) = (message.x.len(), message.hulls.len());
    let count = swept.saturating_add(hulls);
    if message.delete.len().saturating_add(count) > solids_max {
        return Err(too_many(solids_max));
    }
    let mut faults = Faults::default();
    check_columns(message, count, &mut faults);
    let used = used_shapes(message, shapes, &mut faults);
    let motion = motion(message, &mut faults);
    if !faults.is_empty() {
        return Err(faults.into_problem());
    }
    let mut bodies = Vec::with_capacity(count);
    let swept = (0..swept).map(|index| swept_body(message, index, &used));
    let hulls = message.hulls.iter().enumerate();
    let hulls = hulls.map(|(index, points)| hull(points, &format!("/hulls/{index}")));
    for body in swept.chain(hulls.map(|solid| solid.map(Body::solid))) {
        match body {
            Ok(body) => bodies.push(body),
            Err(fault) => faults.push(fault),
        }
        if faults.is_full() {
            break;
        }
    }
    if !faults.is_empty() {
        return Err(faults.into_problem());
    }
    let ids = message.insert_id.iter().copied().map(CubeId);
    let mut first: HashMap<CubeId, usize> = HashMap::new();
    for (index, id) in ids.clone().enumerate() {
        let before = *first.entry(id).or_insert(index);
        if bodies[before] != bodies[index] {
            faults.push(Fault {
                value: Some(id.0.into()),
                ..Fault::at(
                    format!("/insert_id/{index}"),
                    format!("is also the id of another solid of this change, at index {before}"),
                    None,
                )
            });
        }
    }
    if !faults.is_empty() {
        return Err(faults.into_problem());
    }
    let delete = message.delete.iter().copied().map(CubeId);
    Ok(Decoded {
        operations: if message.insert_id.is_empty() && count > 0 {
            Operations::Numbered {
                delete: delete.collect(),
                insert: bodies,
            }
        } else {
            let insert = ids.zip(bodies).map(|(id, body)| Op::Insert(id, body));
            Operations::Named(delete.map(Op::Delete).chain(insert).collect())
        },
        deletions: message.delete.len(),
        motion,
    })
}

/// Notes columns that are too short or too long.
fn check_columns(message: &proto::Change, count: usize, faults: &mut Faults) {
    same_length(
        message,
        [("y", message.y.len()), ("z", message.z.len())],
        faults,
    );
    let ends = [&message.to_x, &message.to_y, &message.to_z].map(Vec::len);
    if ends != [0; 3] {
        let [x, y, z] = ends;
        same_length(message, [("to_x", x), ("to_y", y), ("to_z", z)], faults);
    }
    if !message.shape.is_empty() {
        same_length(message, [("shape", message.shape.len())], faults);
    }
    if !message.insert_id.is_empty() && message.insert_id.len() != count {
        let detail = format!(
            "has {} values for {count} solids: give an id to every one, or to none",
            message.insert_id.len()
        );
        faults.push(Fault::at("/insert_id".to_owned(), detail, None));
    }
    if message.shapes.is_empty() && !message.x.is_empty() {
        let detail = "names no shape, and there are positions";
        faults.push(Fault::at("/shapes".to_owned(), detail, None));
    }
}

/// The shapes that a change names; those that the scene does not have are noted.
fn used_shapes<'a>(
    message: &proto::Change,
    shapes: &'a Shapes,
    faults: &mut Faults,
) -> Vec<&'a Arc<Shape>> {
    let mut used = Vec::with_capacity(message.shapes.len());
    for (index, name) in message.shapes.iter().enumerate() {
        match shapes.get(name) {
            Some(named) => used.push(&named.shape),
            None => faults.push(Fault {
                value: Some(name.as_str().into()),
                ..Fault::at(
                    format!("/shapes/{index}"),
                    "is not the name of a shape of the scene",
                    None,
                )
            }),
        }
    }
    used
}

fn swept_body(message: &proto::Change, index: usize, used: &[&Arc<Shape>]) -> Result<Body, Fault> {
    let number = message.shape.get(index).copied().unwrap_or(0);
    let shape = usize::try_from(number).ok().and_then(|at| used.get(at));
    let shape = shape.ok_or_else(|| Fault {
        value: Some(number.into()),
        ..Fault::at(
            format!("/shape/{index}"),
            format!("is not below {}, the number of shapes", used.len()),
            None,
        )
    })?;
    let at = [message.x[index], message.y[index], message.z[index]];
    let from = point(at, |axis| format!("/{}/{index}", ["x", "y", "z"][axis]))?;
    let place = |axis: usize| format!("/{}/{index}", ["to_x", "to_y", "to_z"][axis]);
    let to = if message.to_x.is_empty() {
        from
    } else {
        let at = [
            message.to_x[index],
            message.to_y[index],
            message.to_z[index],
        ];
        point(at, place)?
    };
    Body::swept(shape, from, to).map_err(|invalid| {
        let at = if message.to_x.is_empty() {
            format!("/x/{index}")
        } else {
            place(0)
        };
        Fault::at(at, format!("is not possible: {invalid}"), None)
    })
}

/// The hull of points in lattice steps.
fn hull(hull: &proto::Hull, pointer: &str) -> Result<Solid, Fault> {
    for (name, len) in [("y", hull.y.len()), ("z", hull.z.len())] {
        if len != hull.x.len() {
            let detail = format!("has {len} values, x has {}", hull.x.len());
            return Err(Fault::at(format!("{pointer}/{name}"), detail, None));
        }
    }
    let columns = hull.x.iter().zip(&hull.y).zip(&hull.z);
    let points: Result<Vec<Point>, Fault> = columns
        .enumerate()
        .map(|(index, ((x, y), z))| {
            let place = |axis: usize| format!("{pointer}/{}/{index}", ["x", "y", "z"][axis]);
            point([*x, *y, *z], place)
        })
        .collect();
    Solid::hull(&points?)
        .map_err(|invalid| Fault::at(pointer.to_owned(), format!("is no solid: {invalid}"), None))
}

/// A point on the lattice; `place` is that of a coordinate by its axis.
fn point(at: [i32; 3], place: impl Fn(usize) -> String) -> Result<Point, Fault> {
    Point::new(at.map(i64::from)).map_err(|invalid| Fault {
        value: Some(invalid.coordinate.into()),
        ..Fault::at(place(invalid.axis), invalid.to_string(), None)
    })
}
