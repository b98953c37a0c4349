//! Convex polyhedra with lattice vertices.

use super::super::lattice::Bounds;
use super::limits::{EXTENT_MAX, VERTICES_MAX};
use super::plane::Plane;
use super::point::{InvalidPoint, Point};
use super::vector::{cross, difference, dot};

/// A closed convex polyhedron with a volume, whose vertices are lattice points.
///
/// At most [`VERTICES_MAX`] vertices; at most [`EXTENT_MAX`] steps along each axis. Facets and edges are maximal: no two facets lie in
/// one plane, no vertex lies between two others.
#[derive(Clone, Debug)]
pub struct Solid {
    pub(super) vertices: Vec<Point>,
    pub(super) planes: Vec<Plane>,
    /// Where the loop of each facet starts in `loops`, and the end of the last.
    pub(super) starts: Vec<u16>,
    /// The vertices of all facets, facet by facet.
    pub(super) loops: Vec<u16>,
    /// Beside each vertex of `loops`: the facet across the edge that starts there.
    pub(super) across: Vec<u16>,
    pub(super) edges: Vec<Edge>,
    pub(super) bounds: Bounds,
}

/// An edge of a [`Solid`], directed. Seen from outside, `left` lies to the left of the way from `tail` to `head`, and runs
/// along it in this direction; `right` runs along it the other way.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Edge {
    /// Index of the vertex where it starts.
    pub tail: u16,
    /// Index of the vertex where it ends.
    pub head: u16,
    /// Index of the facet on the left.
    pub left: u16,
    /// Index of the facet on the right.
    pub right: u16,
}

/// A facet of a [`Solid`].
#[derive(Clone, Copy, Debug)]
pub struct Facet<'solid> {
    /// Its plane; the normal points out of the solid.
    pub plane: &'solid Plane,
    /// Indices of its vertices, counterclockwise seen from outside; at least three.
    pub vertices: &'solid [u16],
    /// Beside each vertex, the index of the facet across the edge that starts there.
    pub across: &'solid [u16],
}

/// Why points do not make a [`Solid`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
pub enum InvalidSolid {
    /// There are no points.
    #[error("there are no points")]
    Empty,
    /// All points lie in one plane, in one line or at one place.
    #[error("the points lie in one plane, so there is no volume between them")]
    Flat,
    /// Too many vertices.
    #[error("there are {count} vertices; the most is {VERTICES_MAX}")]
    TooManyVertices {
        /// How many there are.
        count: usize,
    },
    /// Too long along an axis.
    #[error("it is {steps} steps long along {}; the most is {EXTENT_MAX}", ["x", "y", "z"][*axis])]
    TooLong {
        /// The axis at fault: 0 for x, 1 for y, 2 for z.
        axis: usize,
        /// Its extent.
        steps: i64,
    },
    /// A vertex lies too far out.
    #[error(transparent)]
    OutOfRange(#[from] InvalidPoint),
}

impl Solid {
    /// The box between two corners.
    /// # Errors
    /// [`InvalidSolid::Flat`] when it has no volume; [`InvalidSolid::TooLong`].
    pub fn cuboid(a: Point, b: Point) -> Result<Self, InvalidSolid> {
        let ends = [a.coordinates(), b.coordinates()];
        let corner = |number: usize| {
            Point::new([0, 1, 2].map(|axis| i64::from(ends[number >> axis & 1][axis])))
        };
        let mut corners = [a; 8];
        for (number, to) in corners.iter_mut().enumerate() {
            *to = corner(number)?;
        }
        Self::hull(&corners)
    }

    /// The solid displaced by a vector. O(size), without any geometry.
    /// # Errors
    /// [`InvalidSolid::OutOfRange`].
    pub fn displaced(&self, by: [i64; 3]) -> Result<Self, InvalidSolid> {
        let [min, max] = self.corners();
        let (min, max) = (min.displaced(by)?, max.displaced(by)?);
        let mut solid = self.clone();
        for vertex in &mut solid.vertices {
            *vertex = vertex.displaced(by)?;
        }
        for plane in &mut solid.planes {
            *plane = plane.displaced(by);
        }
        solid.bounds = Bounds {
            min: min.coordinates(),
            max: max.coordinates(),
        };
        Ok(solid)
    }

    /// The vertices, each once.
    pub fn vertices(&self) -> &[Point] {
        &self.vertices
    }

    /// The planes of the facets, each once; their normals point out of the solid.
    pub fn planes(&self) -> &[Plane] {
        &self.planes
    }

    /// The edges, each once.
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// The facets, in the order of [`Solid::planes`].
    pub fn facets(&self) -> impl ExactSizeIterator<Item = Facet<'_>> {
        (0..self.planes.len()).map(|index| self.facet(index))
    }

    /// The facet of an index below the number of planes.
    pub fn facet(&self, index: usize) -> Facet<'_> {
        let range = usize::from(self.starts[index])..usize::from(self.starts[index + 1]);
        Facet {
            plane: &self.planes[index],
            vertices: &self.loops[range.clone()],
            across: &self.across[range],
        }
    }

    /// The box around it.
    pub const fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// The least and the greatest corner of the box around it, which are lattice points of the same range.
    fn corners(&self) -> [Point; 2] {
        [self.bounds.min, self.bounds.max]
            .map(|corner| Point::new(corner.map(i64::from)).expect("coordinates of its vertices"))
    }

    /// Whether a point lies in the closed solid. O(facets).
    pub fn contains(&self, point: Point) -> bool {
        self.planes.iter().all(|plane| plane.at(point) <= 0)
    }

    /// Six times the volume. Units: steps cubed. Range: at most `6 * 2^63`. Exact. O(size).
    pub fn volume6(&self) -> i128 {
        let origin = self.vertices[0].wide();
        let at = |index: u16| difference(self.vertices[usize::from(index)].wide(), origin);
        let mut sum = 0;
        for facet in self.facets() {
            let apex = at(facet.vertices[0]);
            for pair in facet.vertices[1..].windows(2) {
                let (b, c) = (at(pair[0]), at(pair[1]));
                sum += dot(cross(difference(b, apex), difference(c, apex)), apex);
            }
        }
        sum
    }
}
