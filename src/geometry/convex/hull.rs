//! The convex hull of lattice points: incremental, exact, for any degeneracy.
//!
//! Quickhull: a closed surface of triangles grows by the farthest point outside one of them. A triangle is *visible* from a point
//! that lies strictly outside its plane; the visible ones are replaced by a fan from the point to their rim (the *horizon*).
//! Points in the plane of a triangle do not see it, so coplanar triangles are visible all or none, and the fan has no degenerate
//! triangle: a point in one line with an edge of the horizon would lie in the planes of both its triangles and see neither. Coplanar triangles
//! are joined at the end, where points between others vanish.
//! # Source
//! C. B. Barber, D. P. Dobkin, H. Huhdanpaa, "The quickhull algorithm for convex hulls", ACM TOMS 22(4), 1996. A point that was outside a
//! replaced triangle and is outside no triangle of the fan is inside the new hull: the way to it from the replaced triangle could leave the
//! new hull through the fan only.

use super::builder::Builder;
use super::plane::Plane;
use super::point::Point;
use super::solid::{InvalidSolid, Solid};
use super::vector::{cross, difference, dot, reduced};

impl Solid {
    /// The convex hull of points, in any order and with any repetition.
    /// O(n log n) for points of which most become vertices, O(n^2) at worst; a few milliseconds for 4,096 points of a sphere.
    /// # Errors
    /// [`InvalidSolid::Empty`], [`InvalidSolid::Flat`], [`InvalidSolid::TooLong`], and [`InvalidSolid::TooManyVertices`] when more
    /// than [`VERTICES_MAX`](super::VERTICES_MAX) of the points are vertices of the hull.
    pub fn hull(points: &[Point]) -> Result<Self, InvalidSolid> {
        let mut points = points.to_vec();
        points.sort_unstable();
        points.dedup();
        let builder = Builder::new(points)?;
        let mut surface = Surface::around_tetrahedron(&builder).ok_or(InvalidSolid::Flat)?;
        surface.grow();
        surface.join(builder)
    }
}

/// Stands for "no triangle" and "no point".
const NONE: usize = usize::MAX;

/// A triangle of the surface; its vertices are counterclockwise seen from outside.
#[derive(Debug)]
struct Triangle {
    vertices: [usize; 3],
    /// The triangle across the edge that starts at the vertex of the same index.
    across: [usize; 3],
    normal: [i64; 3],
    /// The dot product of the normal and a point of the plane. Range: below `2^66`.
    level: i128,
    /// Points strictly outside its plane that are listed here, each at one triangle: their greatest comes first.
    outside: Vec<usize>,
    /// Replaced by others.
    gone: bool,
    /// The last point that was asked whether it sees this triangle.
    asked_by: usize,
}

/// A closed convex surface around some of the points.
#[derive(Debug)]
struct Surface {
    /// All points, relative to the least corner of the box around them: coordinates from 0 to `2^21`.
    points: Vec<[i64; 3]>,
    triangles: Vec<Triangle>,
    /// Beside each point, the triangle of the newest fan whose edge of the horizon starts there.
    fan_at: Vec<usize>,
}

impl Surface {
    /// The surface of a tetrahedron between four of the points that are far apart, all other points listed; none when all lie in a plane.
    fn around_tetrahedron(builder: &Builder) -> Option<Self> {
        let corner = builder.bounds().min.map(i64::from);
        let local = |point: &Point| difference(point.wide(), corner);
        let points: Vec<_> = builder.points().iter().map(local).collect();
        let a = 0;
        let b = points.len() - 1;
        let from_a = |index: usize| difference(points[index], points[a]);
        let spread = |index: usize| {
            let normal = cross(from_a(b), from_a(index));
            normal.map(i64::abs).iter().sum::<i64>()
        };
        let c = (0..points.len()).max_by_key(|&index| spread(index))?;
        if spread(c) == 0 {
            return None;
        }
        let normal = cross(from_a(b), from_a(c));
        let height = |index: usize| dot(normal, from_a(index));
        let d = (0..points.len()).max_by_key(|&index| height(index).abs())?;
        let (b, c) = match height(d) {
            0 => return None,
            1.. => (c, b),
            _ => (b, c),
        };
        // Seen from d, a, b and c are now clockwise: d is on the inner side of the triangle a b c.
        let mut surface = Self {
            fan_at: vec![NONE; points.len()],
            points,
            triangles: Vec::new(),
        };
        for (vertices, across) in [
            ([a, b, c], [3, 1, 2]),
            ([c, b, d], [0, 3, 2]),
            ([a, c, d], [0, 1, 3]),
            ([b, a, d], [0, 2, 1]),
        ] {
            let triangle = surface.triangle(vertices, across);
            surface.triangles.push(triangle);
        }
        let others = (0..surface.points.len()).collect();
        surface.list(others, 0);
        Some(surface)
    }

    fn triangle(&self, vertices: [usize; 3], across: [usize; 3]) -> Triangle {
        let [a, b, c] = vertices.map(|vertex| self.points[vertex]);
        let normal = cross(difference(b, a), difference(c, a));
        Triangle {
            vertices,
            across,
            normal,
            level: dot(normal, a),
            outside: Vec::new(),
            gone: false,
            asked_by: NONE,
        }
    }

    /// How far a point is outside the plane of a triangle, in units that only compare points at one triangle.
    fn height(&self, triangle: usize, point: usize) -> i128 {
        let triangle = &self.triangles[triangle];
        dot(triangle.normal, self.points[point]) - triangle.level
    }

    /// Lists points at the first triangle, from `first` on, that they are outside of; those inside all are forgotten.
    fn list(&mut self, points: Vec<usize>, first: usize) {
        for point in points {
            for index in first..self.triangles.len() {
                if self.height(index, point) > 0 {
                    self.triangles[index].outside.push(point);
                    break;
                }
            }
        }
    }

    /// Grows until no point is outside.
    fn grow(&mut self) {
        let mut waiting: Vec<usize> = (0..self.triangles.len()).collect();
        while let Some(index) = waiting.pop() {
            if self.triangles[index].gone || self.triangles[index].outside.is_empty() {
                continue;
            }
            let outside = &self.triangles[index].outside;
            let farthest = outside
                .iter()
                .copied()
                .max_by_key(|&point| self.height(index, point))
                .expect("there are some");
            let first = self.triangles.len();
            self.add(farthest, index);
            waiting.extend(first..self.triangles.len());
        }
    }

    /// Adds a point that sees a triangle.
    fn add(&mut self, point: usize, seen: usize) {
        let first = self.triangles.len();
        let mut visible = vec![seen];
        let mut last = NONE;
        self.triangles[seen].asked_by = point;
        self.triangles[seen].gone = true;
        let mut orphans = Vec::new();
        while let Some(index) = visible.pop() {
            orphans.append(&mut self.triangles[index].outside);
            let (vertices, across) = (self.triangles[index].vertices, self.triangles[index].across);
            for side in 0..3 {
                let (tail, head) = (vertices[side], vertices[(side + 1) % 3]);
                let beyond = across[side];
                if self.triangles[beyond].asked_by != point {
                    self.triangles[beyond].asked_by = point;
                    if self.height(beyond, point) > 0 {
                        self.triangles[beyond].gone = true;
                        visible.push(beyond);
                    }
                }
                if self.triangles[beyond].gone {
                    continue;
                }
                // An edge of the horizon: the fan keeps its direction.
                last = self.triangles.len();
                let triangle = self.triangle([tail, head, point], [beyond, NONE, NONE]);
                self.triangles.push(triangle);
                self.fan_at[tail] = last;
                let back = self.triangles[beyond]
                    .vertices
                    .iter()
                    .position(|&vertex| vertex == head)
                    .expect("neighbours share an edge");
                self.triangles[beyond].across[back] = last;
            }
        }
        // Around the fan: each triangle's second edge is the third of the one whose horizon edge starts where its own ends.
        for index in first..=last {
            let next = self.fan_at[self.triangles[index].vertices[1]];
            self.triangles[index].across[1] = next;
            self.triangles[next].across[2] = index;
        }
        self.list(orphans, first);
    }

    /// The solid: coplanar triangles become one facet.
    fn join(self, mut builder: Builder) -> Result<Solid, InvalidSolid> {
        let mut pieces: Vec<(Plane, [usize; 3])> = self
            .triangles
            .iter()
            .filter(|triangle| !triangle.gone)
            .map(|triangle| {
                let through = builder.points()[triangle.vertices[0]];
                let plane = Plane::at_right_angles(reduced(triangle.normal), through);
                (plane, triangle.vertices)
            })
            .collect();
        pieces.sort_unstable();
        for facet in pieces.chunk_by(|a, b| a.0 == b.0) {
            let vertices = facet.iter().flat_map(|piece| piece.1);
            builder.add_hull(facet[0].0, vertices);
        }
        builder.finish()
    }
}
