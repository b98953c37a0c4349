//! Where a plane cuts one convex body: a convex polygon on a fine grid of integers.
//!
//! The grid has `2^30` steps in each lattice step. Lattice points are points of it, so that the section of a box is exact; where the plane
//! cuts an oblique edge, the exact rational point is rounded to the nearest point of the grid. Equal points are rounded equally, so bodies
//! that touch still do.
//!
//! # Claim: a section is the limit from the greater side
//! A body counts from its least coordinate on, and no longer at its greatest: what lies in the plane itself belongs to what is above it. So
//! slices at faces are no special case: the one at a bottom is the bottom, and the one at a top is empty.

use i_overlay::i_float::int::point::IntPoint;

use crate::geometry::convex::{Point, Solid};
use crate::geometry::{Bounds, COORDINATE_MAX};

/// Grid steps in a lattice step, as a power of two.
pub const GRID_BITS: u32 = 30;

/// A point of the plane. Units: grid steps. Range: within `2^60` of 0, and within `2^61` between scenes of different scales.
pub type GridPoint = IntPoint<i64>;

/// A ring without its first point again at the end.
pub type Polygon = Vec<GridPoint>;

// i_overlay keeps all products of coordinates below 2^62 exact.
const _: () = assert!((COORDINATE_MAX as i64) << GRID_BITS <= 1 << 60);

/// A plane at right angles to an axis.
///
/// Points in it have the two coordinates that follow the axis: y and z for x, z and x for y, x and y for z. So counterclockwise is meant as
/// seen from the greater side.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Cut {
    /// 0 for x, 1 for y, 2 for z.
    pub axis: usize,
    /// Where it meets the axis. Units: grid steps. Range: within `2^61` of 0.
    pub at: i64,
}

const fn grid(steps: i32) -> i64 {
    (steps as i64) << GRID_BITS
}

impl Cut {
    /// The axes of the two coordinates of points in the plane.
    pub const fn across(self) -> [usize; 2] {
        [(self.axis + 1) % 3, (self.axis + 2) % 3]
    }

    /// Whether a body in this box has a section that may have an area.
    pub fn meets(self, bounds: &Bounds) -> bool {
        grid(bounds.min[self.axis]) <= self.at && self.at < grid(bounds.max[self.axis])
    }

    /// The section of a box; none when there is none.
    pub fn of_box(self, bounds: &Bounds) -> Option<Polygon> {
        let [u, v] = self.across();
        let corner = |at_u: [i32; 3], at_v: [i32; 3]| GridPoint::new(grid(at_u[u]), grid(at_v[v]));
        let Bounds { min, max } = *bounds;
        let rectangle = || {
            vec![
                corner(min, min),
                corner(max, min),
                corner(max, max),
                corner(min, max),
            ]
        };
        self.meets(bounds).then(rectangle)
    }

    /// The section of a convex solid, counterclockwise; none when it has no area. O(size, and a sorting of the section).
    pub fn of_solid(self, solid: &Solid) -> Option<Polygon> {
        if !self.meets(&solid.bounds()) {
            return None;
        }
        let side = |point: Point| grid(point.coordinates()[self.axis]).cmp(&self.at);
        let mut points = Vec::new();
        let vertices = solid.vertices();
        for &vertex in vertices.iter().filter(|&&vertex| side(vertex).is_eq()) {
            let [u, v] = self.across().map(|axis| grid(vertex.coordinates()[axis]));
            points.push(GridPoint::new(u, v));
        }
        for edge in solid.edges() {
            let ends = [edge.tail, edge.head].map(|end| vertices[usize::from(end)]);
            match ends.map(side).map(std::cmp::Ordering::is_lt) {
                [true, false] if side(ends[1]).is_gt() => points.push(self.crossing(ends)),
                [false, true] if side(ends[0]).is_gt() => {
                    points.push(self.crossing([ends[1], ends[0]]));
                }
                _ => {}
            }
        }
        hull(points)
    }

    /// Where an edge that begins below the plane and ends above it goes through, rounded to the nearest point of the grid.
    fn crossing(self, ends: [Point; 2]) -> GridPoint {
        let [below, above] = ends.map(Point::coordinates);
        let along = i128::from(above[self.axis]) - i128::from(below[self.axis]);
        let way = i128::from(self.at - grid(below[self.axis]));
        let [u, v] = self.across().map(|axis| {
            let across = i128::from(above[axis]) - i128::from(below[axis]);
            // Half-way up: the same for every edge through the same point.
            let moved = (2 * across * way + along).div_euclid(2 * along);
            grid(below[axis]) + i64::try_from(moved).expect("it is on the edge")
        });
        GridPoint::new(u, v)
    }
}

/// The convex hull, counterclockwise, without points between others; none when it has no area. Andrew's monotone chain.
fn hull(mut points: Polygon) -> Option<Polygon> {
    points.sort_unstable_by_key(|point| (point.x, point.y));
    points.dedup();
    let mut chain: Polygon = Vec::with_capacity(points.len() + 1);
    let extend = |chain: &mut Polygon, base: usize, point: GridPoint| {
        while chain.len() >= base + 2
            && turn(chain[chain.len() - 2], chain[chain.len() - 1], point) <= 0
        {
            chain.pop();
        }
        chain.push(point);
    };
    for &point in &points {
        extend(&mut chain, 0, point);
    }
    let base = chain.len().saturating_sub(1);
    for &point in points.iter().rev().skip(1) {
        extend(&mut chain, base, point);
    }
    chain.pop();
    (chain.len() >= 3).then_some(chain)
}

/// Twice the area of a triangle, positive when it is counterclockwise. A solid's extent keeps it below `2^105`.
fn turn(a: GridPoint, b: GridPoint, c: GridPoint) -> i128 {
    let to = |point: GridPoint| {
        [
            i128::from(point.x) - i128::from(a.x),
            i128::from(point.y) - i128::from(a.y),
        ]
    };
    let ([ux, uy], [vx, vy]) = (to(b), to(c));
    ux * vy - uy * vx
}
