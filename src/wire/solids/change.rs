//! Changes of a scene of solids in JSON, and the solids as they are answered.

use std::collections::HashMap;

use serde::Deserialize;
use serde::de::Deserializer;
use utoipa::ToSchema;

use super::body::body_of;
use super::documents::SolidDocument;
use super::scale::Scale;
use crate::engine::Op;
use crate::engine::solids::Body;
use crate::geometry::CubeId;
use crate::service::{Motion, Operations, Shapes, Solids};
use crate::wire::convert;
use crate::wire::decoded::Decoded;
use crate::wire::documents::{Id, IdForm, LineOperation};
use crate::wire::objects::{not_null, objects_only};
use crate::wire::problem::{Fault, Faults};

/// An atomic change of solids: deletions first, then insertions; all of it, or nothing.
#[derive(Clone, PartialEq, Debug, Deserialize, ToSchema)]
#[serde(remote = "Self", deny_unknown_fields)]
pub struct SolidChange {
    /// Ids of the solids to delete.
    #[serde(default)]
    pub delete: Vec<Id>,
    /// Solids to insert.
    #[serde(default)]
    pub insert: Vec<SolidDocument>,
    /// The sender's own number of the move or program line that the change belongs to.
    #[serde(default, deserialize_with = "not_null")]
    #[schema(nullable = false, example = 120)]
    pub r#move: Option<u64>,
    /// Machine time of the change. Units: seconds.
    #[serde(default, deserialize_with = "not_null")]
    #[schema(nullable = false, minimum = 0, maximum = 1_000_000_000, example = 0.25)]
    pub duration: Option<f64>,
}

objects_only!(SolidChange);

impl SolidDocument {
    /// A solid of a scene, as it is answered and can be inserted again.
    pub(in crate::wire) fn of(
        (id, body): &(CubeId, Body),
        form: IdForm,
        shapes: &Shapes,
        scale: Scale,
    ) -> Self {
        let mut shown = Self {
            id: Some(Id { id: *id, form }),
            shape: None,
            at: None,
            from: None,
            to: None,
            hull: None,
        };
        if let Some((shape, from, to)) = body.sweep() {
            shown.shape = shapes.of(shape).map(|named| named.name.clone());
            if from == to {
                shown.at = Some(scale.position(from));
            } else {
                (shown.from, shown.to) = (Some(scale.position(from)), Some(scale.position(to)));
            }
        }
        shown.hull = body.hull().map(|hull| {
            let vertices = hull.vertices().iter();
            vertices.map(|vertex| scale.position(*vertex)).collect()
        });
        shown
    }
}

/// Notes what is wrong with a change that can be read; none then, else what it does.
pub(in crate::wire) fn decoded(
    change: &SolidChange,
    shapes: &Shapes,
    scale: Scale,
    faults: &mut Faults,
) -> Option<Decoded<Solids>> {
    let duration_ns = change.duration.map(convert::duration_ns).transpose();
    if let Err(detail) = duration_ns
        && !faults.cover("/duration")
    {
        faults.push(Fault::at("/duration".to_owned(), detail, None));
    }
    let named = change
        .insert
        .first()
        .is_some_and(|solid| solid.id.is_some());
    let mut first: HashMap<CubeId, usize> = HashMap::new();
    let mut bodies = Vec::with_capacity(change.insert.len());
    for (index, solid) in change.insert.iter().enumerate() {
        if faults.is_full() {
            break;
        }
        let pointer = format!("/insert/{index}");
        if faults.cover(&pointer) {
            continue;
        }
        if solid.id.is_some() != named {
            let detail = "differs from those before it: give an id to every solid or to none";
            faults.push(Fault::at(pointer.clone(), detail, None));
        }
        match body_of(
            solid,
            |name| shapes.get(name).map(|named| &named.shape),
            scale,
        ) {
            Ok(body) => bodies.push(body),
            Err(fault) => {
                let pointer = format!("{pointer}{}", fault.pointer);
                faults.push(Fault::at(pointer, fault.what, None));
                continue;
            }
        }
        if let Some(id) = solid.id
            && let Some(before) = first.insert(id.id, bodies.len() - 1)
            && bodies[before] != bodies[bodies.len() - 1]
        {
            let detail = "is also the id of another solid of this change";
            faults.push(Fault::at(pointer + "/id", detail, None));
        }
    }
    if !faults.is_empty() {
        return None;
    }
    let delete = change.delete.iter().map(|id| id.id);
    let operations = if named || bodies.is_empty() {
        let ids = change.insert.iter().filter_map(|solid| solid.id);
        let insert = ids.zip(bodies).map(|(id, body)| Op::Insert(id.id, body));
        Operations::Named(delete.map(Op::Delete).chain(insert).collect())
    } else {
        Operations::Numbered {
            delete: delete.collect(),
            insert: bodies,
        }
    };
    Some(Decoded {
        operations,
        deletions: change.delete.len(),
        motion: Motion {
            number: change.r#move,
            duration_ns: duration_ns.ok().flatten(),
        },
    })
}

/// Notes what is wrong with a line that can be read; none then, else its operation.
pub(in crate::wire) fn operation(
    line: &LineOperation<SolidDocument>,
    shapes: &Shapes,
    scale: Scale,
    faults: &mut Faults,
) -> Option<Op<Body>> {
    let solid = match line {
        LineOperation::Delete(id) => return Some(Op::Delete(id.id)),
        LineOperation::Insert(solid) => solid,
    };
    if solid.id.is_none() && !faults.cover("/insert/id") {
        let detail = "is missing: a line names its id, which makes a retry safe";
        faults.push(Fault::at("/insert/id".to_owned(), detail, None));
    }
    let named = |name: &str| shapes.get(name).map(|named| &named.shape);
    match body_of(solid, named, scale) {
        Ok(body) => Some(Op::Insert(solid.id?.id, body)),
        Err(fault) => {
            let pointer = format!("/insert{}", fault.pointer);
            if !faults.cover(&pointer) {
                faults.push(Fault::at(pointer, fault.what, None));
            }
            None
        }
    }
}
