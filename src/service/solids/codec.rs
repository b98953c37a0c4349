//! The bytes of solids and their totals.
//!
//! ```text
//! columns   ids  kinds    swept: from x y z  by x y z    hulls: vertices  x y z of all
//! kind      0 for a hull, else 1 + the number of the shape
//! by        how far the shape is carried
//! stock     a box: its corners, 24 bytes    any other: its vertices, as of a part of a shape, which never takes as many
//! ```

use ethnum::I256;

use super::shapes::{part, put_part};
use super::{Shapes, SolidTotals};
use crate::engine::solids::{Body, ErrorMax, Measures, Stock, Totals};
use crate::geometry::convex::{Point, Solid, VERTICES_MAX};
use crate::geometry::{Bounds, CubeId};
use crate::log::{
    COORDINATE_BYTES_MAX, ColumnReader, ColumnWriter, Malformed, Reader, put_bounds, put_signed,
    read_bounds,
};

/// The kind, and a hull of the most vertices.
pub(super) const BODY_BYTES_MAX: usize = 2 + 2 + VERTICES_MAX * 3 * COORDINATE_BYTES_MAX;
/// A kind or a count of vertices is below 2^16.
const NUMBER_BYTES_MAX: usize = 2;
const TOTALS_VERSION: u8 = 1;

/// The bytes of the corners of a box. Vertices take a byte or two and then 12 each, which is never as much.
const BOX_BYTES: usize = 24;

/// Whether a solid fills the box around it: a vertex of it is at each of the eight corners.
pub(super) fn is_box(solid: &Solid) -> bool {
    let Bounds { min, max } = solid.bounds();
    let mut vertices = solid.vertices().iter().map(|vertex| vertex.coordinates());
    solid.vertices().len() == 8
        && vertices.all(|at| (0..3).all(|axis| [min[axis], max[axis]].contains(&at[axis])))
}

pub(super) fn put_stock(to: &mut Vec<u8>, stock: &Stock) {
    let solid = stock.solid();
    if is_box(solid) {
        put_bounds(to, &solid.bounds());
    } else {
        put_part(to, solid);
    }
}

pub(super) fn read_stock(bytes: &[u8]) -> Result<Stock, Malformed> {
    let mut reader = Reader(bytes);
    let solid = if bytes.len() == BOX_BYTES {
        let Bounds { min, max } = read_bounds(&mut reader)?;
        let [min, max] = [min, max].map(|at| point(at.map(i64::from)));
        Solid::cuboid(min?, max?).map_err(|_| Malformed("a stock that is no box"))?
    } else {
        part(&mut reader)?
    };
    reader.finish()?;
    Stock::new(solid).map_err(|_| Malformed("a stock of too many vertices"))
}

/// A hull counts as its vertices do.
pub(super) fn weight(body: &Body) -> usize {
    body.hull().map_or(1, |hull| hull.vertices().len())
}

pub(super) fn put_bodies(
    bodies: &[(CubeId, Body)],
    shapes: &Shapes,
    columns: &mut ColumnWriter<'_>,
) {
    columns.put(bodies.iter().map(|(_, body)| {
        body.sweep().map_or(0, |(shape, ..)| {
            let number = shapes.number(shape);
            1 + number.expect("a shape is defined before a body is made of it") as u64
        })
    }));
    let swept: Vec<[[i64; 3]; 2]> = bodies
        .iter()
        .filter_map(|(_, body)| body.sweep())
        .map(|(_, from, to)| [from.wide(), to.wide()])
        .collect();
    if !swept.is_empty() {
        for axis in 0..3 {
            columns.put_differences(swept.iter().map(|[from, _]| from[axis]));
        }
        for axis in 0..3 {
            columns.put_differences(swept.iter().map(|[from, to]| to[axis] - from[axis]));
        }
    }
    let hulls = || bodies.iter().filter_map(|(_, body)| body.hull());
    if hulls().next().is_some() {
        columns.put(hulls().map(|hull| hull.vertices().len() as u64));
        for axis in 0..3 {
            let vertices = hulls().flat_map(Solid::vertices);
            columns.put_differences(vertices.map(|vertex| vertex.wide()[axis]));
        }
    }
}

pub(super) fn read_bodies(
    ids: Vec<CubeId>,
    shapes: &Shapes,
    columns: &mut ColumnReader<'_, '_>,
) -> Result<Vec<(CubeId, Body)>, Malformed> {
    let kinds: Vec<u64> = columns.read(ids.len(), NUMBER_BYTES_MAX)?.collect();
    let hull_count = kinds.iter().filter(|kind| **kind == 0).count();
    let swept_count = kinds.len() - hull_count;
    let mut swept = vec![[[0; 3]; 2]; swept_count];
    if swept_count > 0 {
        for end in 0..2 {
            for axis in 0..3 {
                let values = columns.read_differences(swept_count, COORDINATE_BYTES_MAX)?;
                for (ends, value) in swept.iter_mut().zip(values) {
                    ends[end][axis] = value;
                }
            }
        }
    }
    let mut hulls = read_hulls(hull_count, columns)?.into_iter();
    let mut swept = swept.into_iter();
    let body = |kind: u64| {
        let Some(number) = kind.checked_sub(1) else {
            return hulls.next().ok_or(Malformed("a hull is missing"));
        };
        let shape = usize::try_from(number)
            .ok()
            .and_then(|number| shapes.by_number(number))
            .ok_or(Malformed("a solid of a shape that is not defined"))?;
        let [from, by] = swept.next().ok_or(Malformed("a sweep is missing"))?;
        let to = [0, 1, 2].map(|axis: usize| from[axis].wrapping_add(by[axis]));
        Body::swept(shape, point(from)?, point(to)?)
            .map_err(|_| Malformed("a solid that cannot be where it is"))
    };
    let bodies: Vec<Body> = kinds.into_iter().map(body).collect::<Result<_, _>>()?;
    Ok(ids.into_iter().zip(bodies).collect())
}

fn read_hulls(count: usize, columns: &mut ColumnReader<'_, '_>) -> Result<Vec<Body>, Malformed> {
    if count == 0 {
        return Ok(Vec::new());
    }
    let mut sizes = Vec::with_capacity(count);
    for size in columns.read(count, NUMBER_BYTES_MAX)? {
        let size = usize::try_from(size).ok();
        let size = size.filter(|size| *size <= VERTICES_MAX);
        sizes.push(size.ok_or(Malformed("a hull of too many vertices"))?);
    }
    let all: usize = sizes.iter().sum();
    let mut vertices = Vec::new();
    for axis in 0..3 {
        let values = columns.read_differences(all, COORDINATE_BYTES_MAX)?;
        if axis == 0 {
            vertices = values.map(|x| [x, 0, 0]).collect();
        } else {
            for (vertex, value) in vertices.iter_mut().zip(values) {
                vertex[axis] = value;
            }
        }
    }
    let mut rest = &vertices[..];
    let mut hulls = Vec::with_capacity(count);
    for size in sizes {
        let (own, after) = rest.split_at(size);
        rest = after;
        let points: Vec<Point> = own.iter().map(|at| point(*at)).collect::<Result<_, _>>()?;
        let solid = Solid::hull(&points).map_err(|_| Malformed("a hull that is no solid"))?;
        hulls.push(Body::solid(solid));
    }
    Ok(hulls)
}

fn point(at: [i64; 3]) -> Result<Point, Malformed> {
    Point::new(at).map_err(|_| Malformed("a point outside the lattice"))
}

/// Layout: as of the totals of cubes.
pub(super) fn put_totals(to: &mut Vec<u8>, totals: &SolidTotals) {
    let SolidTotals { union, error_max } = totals;
    to.push(TOTALS_VERSION);
    put_signed(to, &i128::from(union.solids).to_le_bytes());
    put_measures(to, &union.measures);
    if let Some(remaining) = &union.remaining {
        to.push(1);
        put_measures(to, remaining);
    } else {
        to.push(0);
    }
    for bound in errors(*error_max) {
        put_signed(to, &I256::from(bound).to_le_bytes());
    }
    if let Some(bounds) = &union.bounds {
        to.push(1);
        put_bounds(to, bounds);
    } else {
        to.push(0);
    }
}

fn put_measures(to: &mut Vec<u8>, measures: &Measures) {
    for number in [measures.volume6, measures.area2]
        .iter()
        .chain(&measures.edge_length2)
    {
        put_signed(to, &number.to_le_bytes());
    }
    for moment in measures
        .first_moments24
        .iter()
        .chain(&measures.second_moments120)
    {
        put_signed(to, &moment.to_le_bytes());
    }
}

fn errors(error_max: ErrorMax) -> [u128; 5] {
    let ErrorMax {
        volume6,
        area2,
        edge_length2,
        first_moments24,
        second_moments120,
    } = error_max;
    [
        volume6,
        area2,
        edge_length2,
        first_moments24,
        second_moments120,
    ]
}

pub(super) fn read_totals(reader: &mut Reader<'_>) -> Result<SolidTotals, Malformed> {
    if reader.byte()? != TOTALS_VERSION {
        return Err(Malformed("totals of an unknown version"));
    }
    let solids = u64::try_from(reader.i128()?).map_err(|_| Malformed("a negative count"))?;
    let measures = read_measures(reader)?;
    let remaining = match reader.byte()? {
        0 => None,
        1 => Some(read_measures(reader)?),
        _ => return Err(Malformed("a remainder that is neither there nor not")),
    };
    let mut bounds = [0; 5];
    for bound in &mut bounds {
        *bound = u128::try_from(I256::from_le_bytes(reader.signed()?))
            .map_err(|_| Malformed("an error bound that is none"))?;
    }
    let [
        volume6,
        area2,
        edge_length2,
        first_moments24,
        second_moments120,
    ] = bounds;
    let bounds = match reader.byte()? {
        0 => None,
        1 => Some(read_bounds(reader)?),
        _ => return Err(Malformed("bounds that are neither there nor not")),
    };
    Ok(SolidTotals {
        union: Totals {
            solids,
            measures,
            remaining,
            bounds,
        },
        error_max: ErrorMax {
            volume6,
            area2,
            edge_length2,
            first_moments24,
            second_moments120,
        },
    })
}

fn read_measures(reader: &mut Reader<'_>) -> Result<Measures, Malformed> {
    let mut measures = Measures {
        volume6: reader.i128()?,
        area2: reader.i128()?,
        ..Measures::default()
    };
    for length in &mut measures.edge_length2 {
        *length = reader.i128()?;
    }
    for moment in measures
        .first_moments24
        .iter_mut()
        .chain(&mut measures.second_moments120)
    {
        *moment = I256::from_le_bytes(reader.signed()?);
    }
    Ok(measures)
}
