//! STL files of one convex body each.

use std::collections::HashMap;
use std::io::Cursor;

use crate::engine::solids::Body;
use crate::geometry::convex::{InvalidSolid, Plane, Point, Solid, cross, dot};

use super::SolidFault;
use super::scale::Scale;
use crate::wire::convert::float;

/// How far inside the hull of a convex body the middle of a triangle may be because its corners were rounded. Units: steps.
const DEPTH_MAX: f64 = 2.0;

/// Bytes before the triangles of a binary file: a header of 80 without meaning, and their number.
const BINARY_HEADER_BYTES: usize = 84;
/// Bytes of a triangle in a binary file.
const BINARY_TRIANGLE_BYTES: usize = 50;

/// Why a file is no convex body.
#[derive(Debug, thiserror::Error)]
pub enum InvalidStl {
    /// It is no STL file.
    #[error("it is neither a text nor a binary STL file: {0}")]
    Unreadable(#[from] std::io::Error),
    /// A vertex is not on the lattice.
    #[error("triangle {triangle}: its vertex {fault}")]
    Vertex {
        /// Which triangle, from 1.
        triangle: usize,
        /// What is wrong.
        fault: SolidFault,
    },
    /// Its points make no solid.
    #[error(transparent)]
    Solid(#[from] InvalidSolid),
    /// The surface has a hole.
    #[error(
        "triangle {triangle}: one of its edges has no triangle on its other side, or one that is turned the other way, so the surface is not closed"
    )]
    Open {
        /// Which triangle, from 1.
        triangle: usize,
    },
    /// The triangles are the surface of nothing.
    #[error(
        "its triangles enclose less than half of their convex hull, so they are not the surface of a convex body"
    )]
    Hollow,
    /// The body is not convex.
    #[error(
        "triangle {triangle}: its middle is {depth:.1} steps inside the convex hull, so the body is not convex; cut it into convex ones"
    )]
    NotConvex {
        /// Which triangle, from 1.
        triangle: usize,
        /// How far its middle is inside the hull, in steps.
        depth: f64,
    },
}

/// The convex body whose surface is in an STL file, text or binary, its vertices rounded to the lattice.
///
/// Convex means: the middle of every triangle is within two steps of the surface of the hull, so that no point of the triangles is more
/// than six steps inside (the depth inside a hull is a concave function), and they enclose more than half of the hull, so that they go around
/// it and do not turn back somewhere.
/// # Errors
/// [`InvalidStl`] by variant.
pub fn stl_body(mut file: Vec<u8>, scale: Scale) -> Result<Body, InvalidStl> {
    if is_binary(&file) {
        // Some programs begin the header of a binary file as a text begins.
        file[..BINARY_HEADER_BYTES - 4].fill(0);
    }
    let mesh = stl_io::read_stl(&mut Cursor::new(file))?;
    let mut triangles = Vec::with_capacity(mesh.faces.len());
    for (face, triangle) in mesh.faces.iter().zip(1..) {
        let mut corners = [Point::ORIGIN; 3];
        for (corner, &vertex) in corners.iter_mut().zip(&face.vertices) {
            let at = mesh.vertices[vertex].0.map(f64::from);
            *corner = scale
                .point(at, "")
                .map_err(|fault| InvalidStl::Vertex { triangle, fault })?;
        }
        triangles.push(corners);
    }
    check_closed(&triangles)?;
    let solid = Solid::hull(triangles.as_flattened())?;
    check_convex(&triangles, &solid)?;
    Ok(Body::solid(solid))
}

/// Whether a file has the length that the number of triangles in a binary header gives it.
fn is_binary(file: &[u8]) -> bool {
    let Some((header, triangles)) = file.split_at_checked(BINARY_HEADER_BYTES) else {
        return false;
    };
    let count = header.last_chunk().map(|bytes| u32::from_le_bytes(*bytes));
    let count = count.and_then(|count| usize::try_from(count).ok());
    count.and_then(|count| count.checked_mul(BINARY_TRIANGLE_BYTES)) == Some(triangles.len())
}

/// Every edge is run along as often one way as the other. Triangles that have shrunk to lines do no harm.
fn check_closed(triangles: &[[Point; 3]]) -> Result<(), InvalidStl> {
    let mut balance: HashMap<[Point; 2], i64> = HashMap::new();
    let sides = |triangle: &[Point; 3]| {
        let [a, b, c] = *triangle;
        [[a, b], [b, c], [c, a]]
    };
    for [tail, head] in triangles.iter().flat_map(sides) {
        let (ends, way) = if tail < head {
            ([tail, head], 1)
        } else {
            ([head, tail], -1)
        };
        if tail != head {
            *balance.entry(ends).or_default() += way;
        }
    }
    for (triangle, number) in triangles.iter().zip(1..) {
        for [tail, head] in sides(triangle) {
            let ends = [tail.min(head), tail.max(head)];
            if balance.get(&ends).is_some_and(|&balance| balance != 0) {
                return Err(InvalidStl::Open { triangle: number });
            }
        }
    }
    Ok(())
}

/// The triangles are the surface of the hull but for the rounding of their corners.
fn check_convex(triangles: &[[Point; 3]], solid: &Solid) -> Result<(), InvalidStl> {
    // Most triangles lie in a facet of the hull that shares a vertex with the triangle before.
    let mut last = 0;
    for (triangle, number) in triangles.iter().zip(1..) {
        if depth(triangle, &solid.planes()[last]) <= DEPTH_MAX {
            continue;
        }
        let depths = solid.planes().iter().map(|plane| depth(triangle, plane));
        let nearest = depths.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
        let (plane, depth) = nearest.expect("a solid has facets");
        last = plane;
        if depth > DEPTH_MAX {
            return Err(InvalidStl::NotConvex {
                triangle: number,
                depth,
            });
        }
    }
    let origin = solid.vertices()[0].wide();
    let from_origin = |corner: Point| {
        let at = corner.wide();
        [0, 1, 2].map(|axis| at[axis] - origin[axis])
    };
    let volume6: i128 = triangles
        .iter()
        .map(|triangle| {
            let [a, b, c] = triangle.map(from_origin);
            dot(cross(a, b), c)
        })
        .sum();
    if 2 * volume6.abs() <= solid.volume6() {
        return Err(InvalidStl::Hollow);
    }
    Ok(())
}

/// How far the middle of a triangle is inside a plane. Units: steps.
fn depth(triangle: &[Point; 3], plane: &Plane) -> f64 {
    let sum: i128 = triangle.iter().map(|&corner| plane.at(corner)).sum();
    let normal = plane.normal();
    float(-sum) / 3.0 / float(dot(normal, normal)).sqrt()
}
