//! From the JSON of a solid to its body.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::engine::solids::{Body, InvalidBody, Shape};
use crate::geometry::convex::Point;

use super::SolidFault;
use super::documents::SolidDocument;
use super::scale::Scale;
use super::shape::hull;

/// The shapes of a scene by their names.
pub type Shapes = BTreeMap<String, Arc<Shape>>;

/// The body of a solid.
/// # Errors
/// The first fault, with its place in the document.
pub fn body(document: &SolidDocument, shapes: &Shapes, scale: Scale) -> Result<Body, SolidFault> {
    body_of(document, |name| shapes.get(name), scale)
}

/// The same, with shapes from wherever they are found.
pub(super) fn body_of<'a>(
    document: &SolidDocument,
    shapes: impl Fn(&str) -> Option<&'a Arc<Shape>>,
    scale: Scale,
) -> Result<Body, SolidFault> {
    let SolidDocument {
        id: _,
        shape,
        at,
        from,
        to,
        hull: points,
    } = document;
    match (shape, at, from, to, points) {
        (Some(name), Some(at), None, None, None) => {
            let at = scale.point(*at, "/at")?;
            carried(name, shapes(name), at, at, "/at")
        }
        (Some(name), None, Some(from), Some(to), None) => {
            let (from, to) = (scale.point(*from, "/from")?, scale.point(*to, "/to")?);
            carried(name, shapes(name), from, to, "/to")
        }
        (None, None, None, None, Some(points)) => Ok(Body::solid(hull(points, scale, "/hull")?.0)),
        _ => Err(SolidFault::new(
            "",
            "is neither a shape with at, nor a shape with from and to, nor a hull",
        )),
    }
}

/// A shape carried along a segment; `pointer` is the place of its end.
fn carried(
    name: &str,
    shape: Option<&Arc<Shape>>,
    from: Point,
    to: Point,
    pointer: &str,
) -> Result<Body, SolidFault> {
    let shape = shape
        .ok_or_else(|| SolidFault::new("/shape", format!("= {name:?}: there is no such shape")))?;
    Body::swept(shape, from, to).map_err(|invalid: InvalidBody| {
        SolidFault::new(pointer, format!("is not possible: {invalid}"))
    })
}
