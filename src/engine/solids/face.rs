//! Planes and points, each exact and rough, and on which side of a plane a point lies.

use crate::geometry::convex::Plane;

use super::certify::{self, Near, Rough, Value};
use super::exact::{self, Homogeneous};

/// A plane of a facet, exact and rough.
#[derive(Clone, Copy, Debug)]
pub(super) struct Face {
    pub(super) plane: Plane,
    pub(super) rough: Rough,
}

impl Face {
    pub(super) fn of(plane: &Plane) -> Self {
        Self {
            plane: *plane,
            rough: Rough::of(plane),
        }
    }

    /// Whether the two are one oriented plane.
    #[inline]
    pub(super) fn same(&self, other: &Self) -> bool {
        self.plane == other.plane
    }

    /// Whether the two are one plane with exchanged sides.
    #[inline]
    pub(super) fn opposite(&self, other: &Self) -> bool {
        exact::opposite(&self.plane, &other.plane)
    }

    /// Whether the two planes are parallel.
    #[inline]
    pub(super) fn parallel(&self, other: &Self) -> bool {
        exact::parallel(&self.plane, &other.plane)
    }
}

/// Where a vertex of a piece is.
#[derive(Clone, Copy, Debug)]
pub(super) enum Position {
    /// At a lattice point.
    Lattice([i32; 3]),
    /// Where three facets' planes meet.
    Meeting([u16; 3]),
}

/// A vertex of a piece.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corner {
    pub(super) near: Near,
    pub(super) position: Position,
}

/// Where a vertex of the union is, exactly.
#[derive(Clone, Copy, Debug)]
pub(super) enum Place<'a> {
    /// At a lattice point.
    Lattice([i32; 3]),
    /// Where three planes meet in one point.
    Meeting([&'a Face; 3]),
}

/// A point on a line: exact and rough.
#[derive(Clone, Copy, Debug)]
pub(super) struct Vertex<'a> {
    pub(super) near: Near,
    pub(super) place: Place<'a>,
}

impl<'a> Vertex<'a> {
    /// The face that a line was cut by, of a point that was found so.
    pub(super) fn crossing_face(&self) -> &'a Face {
        match self.place {
            Place::Meeting([_, _, face]) => face,
            Place::Lattice(_) => unreachable!("a cut is where planes meet"),
        }
    }

    /// Exactly where it is.
    pub(super) fn homogeneous(&self) -> Homogeneous {
        match self.place {
            Place::Lattice(point) => Homogeneous::lattice(point),
            Place::Meeting(faces) => Homogeneous::meeting(faces.map(|face| &face.plane)),
        }
    }
}

/// How signs are found.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Arithmetic {
    /// By the filter, and exactly where it is unsure.
    Filtered,
    /// Always exactly: the reference that the filter is compared with.
    Exact,
}

/// On which side of a face a vertex lies: -1 inside, 0 on it, 1 outside; and the rough value.
#[inline]
pub(super) fn side(arithmetic: Arithmetic, face: &Face, vertex: &Vertex) -> (i32, Value) {
    let value = face.rough.value(&vertex.near.at);
    if arithmetic == Arithmetic::Filtered
        && let Some(sign) = certify::certain(value, face.rough.bound(vertex.near.slack))
    {
        #[cfg(feature = "paranoid")]
        assert_eq!(sign, exact_side(face, vertex), "the filter's bound holds");
        return (sign, value);
    }
    (exact_side(face, vertex), value)
}

/// The same from exact integers.
pub(super) fn exact_side(face: &Face, vertex: &Vertex) -> i32 {
    match vertex.place {
        Place::Lattice(point) => exact::side_of_lattice(&face.plane, point),
        Place::Meeting(faces) => exact::side_of_meeting(&face.plane, faces.map(|face| &face.plane)),
    }
}
