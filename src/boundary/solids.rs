//! The faces of a scene of solids, from the exact edges of its union.
//!
//! Edges come part by part, in an order in which neighbours are near each other; each goes to the faces of its planes, and a face is handed
//! out with the last part that can have an edge of it. So memory holds the faces at the front of that order, and those that reach far.

use std::collections::BTreeMap;
use std::ops::ControlFlow;

use ethnum::{I256, U256};
use rustc_hash::FxHashMap;

use crate::engine::solids::{Body, Edges, Homogeneous, Listed, Side, SolidId, Stock, Surface};
use crate::geometry::Bounds;
use crate::geometry::convex::Plane;

use super::face::{Face, FaceSink, NoStock, Region};

/// Lists the exposed faces of a region, each oriented plane once, in an order that the set of bodies alone decides. O(bodies), each in its
/// neighbourhood.
///
/// `within` keeps what lies in a closed box of lattice points and half a step around it, exactly cut there: no facet of a lattice solid is
/// half-way between lattice points, so that neighbouring boxes, such as 0 to 9 and 10 to 19, share out every face. The surface is open there.
/// `goes_on` is asked now and then; a listing that it or the sink ends is a break.
/// # Errors
/// [`NoStock`] for a region of the stock where there is none.
pub fn faces(
    bodies: impl Iterator<Item = (SolidId, Body)>,
    stock: Option<&Stock>,
    region: Region,
    within: Option<Bounds>,
    goes_on: &dyn Fn() -> bool,
    sink: &mut FaceSink,
) -> Result<ControlFlow<()>, NoStock> {
    let surface = match region {
        Region::Union => Surface::Union,
        Region::Removed => Surface::Removed(stock.ok_or(NoStock)?),
        Region::Remaining => Surface::Remaining(stock.ok_or(NoStock)?),
    };
    let Some(mut edges) = Edges::of(surface, within, bodies, goes_on) else {
        return Ok(ControlFlow::Break(()));
    };
    let mut open = Open::default();
    Ok(edges.each(&mut |listed| match listed {
        Listed::Edge(ends, sides) => {
            open.add(ends.map(|end| rounded(&end)), sides);
            ControlFlow::Continue(())
        }
        Listed::Part(_) if !goes_on() => ControlFlow::Break(()),
        Listed::Part(part) => open.hand_out(part, sink),
    }))
}

/// Faces that are not complete.
#[derive(Default)]
struct Open {
    faces: FxHashMap<Plane, Face>,
    /// By the part with which they are complete, in the order in which they came.
    due: BTreeMap<u32, Vec<Plane>>,
}

impl Open {
    /// Adds an edge to the faces that meet there.
    fn add(&mut self, [tail, head]: [[f64; 3]; 2], sides: &[Side]) {
        // So short an edge that it has no floats between its ends.
        if tail == head {
            return;
        }
        for side in sides {
            let face = self.faces.entry(side.plane).or_insert_with(|| {
                self.due.entry(side.last).or_default().push(side.plane);
                Face {
                    body: side.body,
                    normal: unit(side.plane.normal()),
                    edges: Vec::new(),
                }
            });
            face.body = match (face.body, side.body) {
                (Some(one), Some(other)) => Some(one.min(other)),
                (one, other) => one.or(other),
            };
            let edge = if side.is_left {
                [tail, head]
            } else {
                [head, tail]
            };
            face.edges.push(edge);
        }
    }

    /// Hands out the faces that are complete with a part.
    fn hand_out(&mut self, part: u32, sink: &mut FaceSink) -> ControlFlow<()> {
        while let Some(due) = self.due.first_entry()
            && *due.key() <= part
        {
            for plane in due.remove() {
                let face = self.faces.remove(&plane);
                sink(&face.expect("a plane that is due has a face"))?;
            }
        }
        ControlFlow::Continue(())
    }
}

/// A vector of length 1 along another.
#[expect(
    clippy::cast_precision_loss,
    reason = "components of a normal are below 2^45"
)]
fn unit(normal: [i64; 3]) -> [f64; 3] {
    let normal = normal.map(|component| component as f64);
    let length = normal.iter().map(|part| part * part).sum::<f64>().sqrt();
    normal.map(|part| part / length)
}

/// The point of floats nearest to a point.
fn rounded(point: &Homogeneous) -> [f64; 3] {
    point.x.map(|over| nearest(over, point.w))
}

/// The float nearest to a quotient, the even one of two. Range: the quotient below `2^32`, the denominator below `2^138`.
#[expect(
    clippy::cast_precision_loss,
    reason = "this is the one rounding: to the nearest float, with all that is below it in the last bit"
)]
fn nearest(over: I256, under: I256) -> f64 {
    let is_negative = (over < 0) != (under < 0);
    let (over, under) = (over.unsigned_abs(), under.unsigned_abs());
    if over == U256::ZERO {
        return 0.0;
    }
    // A quotient of 64 or 65 bits: more than two below those of a float.
    let shift = 64 + over.leading_zeros() - under.leading_zeros();
    let over = over << shift;
    let (quotient, rest) = (over / under, over % under);
    let quotient = quotient.as_u128() | u128::from(rest != U256::ZERO);
    let scale = f64::from_bits(u64::from(1023 - shift) << 52);
    let size = quotient as f64 * scale;
    if is_negative { -size } else { size }
}
