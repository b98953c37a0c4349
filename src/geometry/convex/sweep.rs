//! What a convex solid sweeps along a straight segment: the hull of its first and its last position.
//!
//! Built from the *silhouette*, without a hull. Facets that look along the way stay at its end, those that look back at its start, and
//! those along it become the hull of both positions. Every edge between a facet that looks along and one that looks back sweeps a quadrangle
//! of its own: only the edge itself is extreme in the quadrangle's direction, so no two of them lie in one plane.
//!
//! ```text
//!        ___________________
//!       /   /           /   \      - looks back     + looks along
//!      <- - | edges between | + >
//!       \___\___________\___/
//! ```

use super::super::lattice::COORDINATE_MAX;
use super::builder::Builder;
use super::limits::{EXTENT_MAX, VERTICES_MAX};
use super::plane::Plane;
use super::point::Point;
use super::solid::{InvalidSolid, Solid};
use super::vector::{cross, difference, dot, reduced};

/// Why a solid cannot be carried along a segment.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
pub enum InvalidSweep {
    /// What is swept is no solid within the limits.
    #[error(transparent)]
    Solid(#[from] InvalidSolid),
    /// The solid would stand above the common top.
    #[error("it reaches up to z = {reached} steps, above the common top at {top}")]
    AboveTop {
        /// How high its top gets, in steps.
        reached: i64,
        /// The common top, in steps.
        top: i32,
    },
    /// The solid has no horizontal top facet with vertical walls around it.
    #[error(
        "its top is not a horizontal facet with vertical facets around it, so it cannot be extended upwards"
    )]
    NoTop,
}

impl Solid {
    /// What the solid sweeps when its origin is carried along the segment from `from` to `to`: the hull of its displaced copies there.
    /// O(size log size).
    /// # Errors
    /// [`InvalidSolid::TooLong`], [`InvalidSolid::OutOfRange`], [`InvalidSolid::TooManyVertices`].
    pub fn swept(&self, from: Point, to: Point) -> Result<Self, InvalidSolid> {
        if from == to {
            return self.displaced(from.wide());
        }
        let mut points = self.displaced_points(from)?;
        points.extend(self.displaced_points(to)?);
        self.between(points, from, to, None)
    }

    /// As [`Solid::swept`], with the top raised to the height `top` wherever the solid is, as if it reached up to there.
    ///
    /// The shanks of a tool then end in one plane along the whole path.
    /// # Errors
    /// [`InvalidSweep`]; [`InvalidSweep::NoTop`] for a solid that is not extensible ([`Solid::has_top`]).
    pub fn swept_to_top(&self, from: Point, to: Point, top: i32) -> Result<Self, InvalidSweep> {
        let own_top = self.top().ok_or(InvalidSweep::NoTop)?;
        let height = self.bounds().max[2];
        let reached = i64::from(height) + from.wide()[2].max(to.wide()[2]);
        if reached > i64::from(top) {
            return Err(InvalidSweep::AboveTop { reached, top });
        }
        let mut points = self.displaced_points(from)?;
        points.extend(self.displaced_points(to)?);
        let highest = self.facet(own_top).vertices;
        let raised = highest.iter().flat_map(|&vertex| {
            [
                usize::from(vertex),
                usize::from(vertex) + self.vertices().len(),
            ]
        });
        for index in raised {
            let [x, y, _] = points[index].wide();
            points[index] = Point::new([x, y, i64::from(top)]).map_err(InvalidSolid::from)?;
        }
        Ok(self.between(points, from, to, Some(own_top))?)
    }

    /// Whether [`Solid::swept`], or with a top [`Solid::swept_to_top`], certainly succeeds, by boxes and counts alone: where it may fail, trying
    /// it tells. O(facets).
    pub(crate) fn is_surely_swept(&self, from: Point, to: Point, top: Option<i32>) -> bool {
        let own = self.bounds();
        let (from, to) = (from.wide(), to.wide());
        let is_within = (0..3).all(|axis| {
            let least = i64::from(own.min[axis]) + from[axis].min(to[axis]);
            let most = i64::from(own.max[axis]) + from[axis].max(to[axis]);
            let highest = match top {
                Some(top) if axis == 2 => i64::from(top),
                _ => most,
            };
            -i64::from(COORDINATE_MAX) <= least
                && most <= highest
                && highest <= i64::from(COORDINATE_MAX)
                && highest - least <= EXTENT_MAX
        });
        is_within && 2 * self.vertices().len() <= VERTICES_MAX && (top.is_none() || self.has_top())
    }

    /// Whether the solid can be extended upwards: its highest points are a horizontal facet, and the facets around it are vertical.
    pub fn has_top(&self) -> bool {
        self.top().is_some()
    }

    /// The facet on top, when the solid can be extended upwards.
    fn top(&self) -> Option<usize> {
        let top = self
            .planes()
            .iter()
            .position(|plane| plane.normal() == [0, 0, 1])?;
        let walls = self.facet(top).across;
        let vertical = |&wall: &u16| self.planes()[usize::from(wall)].normal()[2] == 0;
        walls.iter().all(vertical).then_some(top)
    }

    fn displaced_points(&self, to: Point) -> Result<Vec<Point>, InvalidSolid> {
        let displaced = |vertex: &Point| Ok(vertex.displaced(to.wide())?);
        self.vertices().iter().map(displaced).collect()
    }

    /// The solid between two positions whose vertices are `points`, those at `from` first. The facet `top`, if there is one, is in the same
    /// plane at both.
    fn between(
        &self,
        points: Vec<Point>,
        from: Point,
        to: Point,
        top: Option<usize>,
    ) -> Result<Self, InvalidSolid> {
        let along = difference(to.wide(), from.wide());
        let count = self.vertices().len();
        let mut builder = Builder::new(points)?;
        let looks: Vec<i128> = (0..self.planes().len())
            .map(|facet| match top {
                Some(top) if top == facet => 0,
                _ => dot(self.planes()[facet].normal(), along).signum(),
            })
            .collect();
        for (facet, &look) in self.facets().zip(&looks) {
            let offset = if look > 0 { count } else { 0 };
            let vertices = facet.vertices.iter().map(|&vertex| usize::from(vertex));
            let through = builder.points()[usize::from(facet.vertices[0]) + offset];
            let plane = Plane::at_right_angles(facet.plane.normal(), through);
            if look == 0 {
                builder.add_hull(plane, vertices.flat_map(|vertex| [vertex, vertex + count]));
            } else {
                builder.add_loop(plane, vertices.map(|vertex| vertex + offset));
            }
        }
        for edge in self.edges() {
            let (left, right) = (
                looks[usize::from(edge.left)],
                looks[usize::from(edge.right)],
            );
            if left * right >= 0 {
                continue;
            }
            // Let `tail` and `head` run so that the facet that looks along is on the left.
            let (tail, head) = if left > 0 {
                (edge.tail, edge.head)
            } else {
                (edge.head, edge.tail)
            };
            let (tail, head) = (usize::from(tail), usize::from(head));
            let points = builder.points();
            let direction = difference(points[head].wide(), points[tail].wide());
            let plane = Plane::at_right_angles(reduced(cross(direction, along)), points[tail]);
            builder.add_loop(plane, [tail, head, head + count, tail + count].into_iter());
        }
        builder.finish()
    }
}
