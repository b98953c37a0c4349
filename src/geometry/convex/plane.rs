//! Oriented planes with integer coefficients, in lowest terms.

use super::point::Point;
use super::vector::{cross, difference, dot, reduced};

/// An oriented plane: the points where `normal . x + offset` is 0. It is negative on the inner side.
///
/// The normal is in lowest terms, and the offset is a multiple of nothing else: the plane goes through a lattice point. So two planes
/// are the same exactly when they are equal, and opposite exactly when one equals the other's [`Plane::opposite`].
/// Range: components of the normal within `2^43`, the offset below `2^75`.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Plane {
    normal: [i64; 3],
    offset: i128,
}

impl Plane {
    /// The plane through three points that are counterclockwise seen from outside; none when they lie in one line.
    pub fn through(a: Point, b: Point, c: Point) -> Option<Self> {
        let at = a.wide();
        let normal = cross(difference(b.wide(), at), difference(c.wide(), at));
        (normal != [0; 3]).then(|| Self::at_right_angles(reduced(normal), a))
    }

    /// The plane through a point whose normal, in lowest terms, points outside.
    pub(super) fn at_right_angles(normal: [i64; 3], through: Point) -> Self {
        Self {
            normal,
            offset: -dot(normal, through.wide()),
        }
    }

    /// The plane at right angles to an axis, half a step beyond a coordinate in the direction of `outward`, which is 1 or -1: the one kind
    /// that no lattice point is on, and so in no solid's boundary. Its normal has the length 2.
    pub fn half_step_beyond(axis: usize, coordinate: i32, outward: i64) -> Self {
        let mut normal = [0; 3];
        normal[axis] = 2 * outward;
        let offset = -(2 * i128::from(outward) * i128::from(coordinate) + 1);
        Self { normal, offset }
    }

    /// The outward normal in lowest terms: integers without a common divisor.
    pub const fn normal(&self) -> [i64; 3] {
        self.normal
    }

    /// The offset: minus the dot product of the normal and any point of the plane.
    pub const fn offset(&self) -> i128 {
        self.offset
    }

    /// The value at a point: negative inside, 0 on the plane, positive outside. Units: distance times the normal's length.
    pub fn at(&self, point: Point) -> i128 {
        dot(self.normal, point.wide()) + self.offset
    }

    /// The same points with inside and outside exchanged.
    #[must_use]
    pub fn opposite(&self) -> Self {
        Self {
            normal: self.normal.map(|component| -component),
            offset: -self.offset,
        }
    }

    /// The plane displaced by a vector.
    pub(super) fn displaced(&self, by: [i64; 3]) -> Self {
        Self {
            normal: self.normal,
            offset: self.offset - dot(self.normal, by),
        }
    }
}
