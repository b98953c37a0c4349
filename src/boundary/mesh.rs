//! Triangles of faces: no vertex is added, every vertex is used, those in a straight line, too. So edges of neighbours pair up.
//!
//! ```text
//!   face ── edges by vertices ── loops, the sharpest left turn where several meet
//!     ├─ short loops, no holes ── ears
//!     ├─ else ── constrained Delaunay triangulation
//!     └─ where neither fits, since rounded coordinates may cross ── fans, whose edges pair up all the same
//! ```

use robust::{Coord, orient2d};
use rustc_hash::FxHashMap;
use spade::{ConstrainedDelaunayTriangulation, Point2, Triangulation};

use super::face::Face;

/// Up to so many edges, equal vertices are found by comparing all.
const FEW_EDGES: usize = 24;

/// Longest loop whose ears are cut off: the time that takes grows with the cube of the length.
const EARS_MAX: usize = 64;

/// The corners of a triangle, counterclockwise as seen from outside. Units: those of the face.
pub type Triangle = [[f64; 3]; 3];

/// Makes triangles of faces.
#[derive(Debug, Default)]
pub struct Triangulator {
    vertices: Vec<[f64; 3]>,
    /// The same in the plane: the outward normal points to who looks at it.
    flat: Vec<Coord<f64>>,
    edges: Vec<[usize; 2]>,
    /// Edges by the vertex that they begin at: where those of a vertex begin, and which they are.
    first: Vec<usize>,
    leaving: Vec<usize>,
    is_used: Vec<bool>,
    loops: Vec<Vec<usize>>,
    index: FxHashMap<[u64; 3], usize>,
    ears: Vec<[usize; 3]>,
}

impl Triangulator {
    /// The triangles of a face, one by one. An edge of the face is one of a triangle as often as of the face, and every other edge of a
    /// triangle is there in the other direction, too. Where floats allow it no two of them overlap.
    pub fn each(&mut self, face: &Face, sink: &mut dyn FnMut(Triangle)) {
        self.read(face);
        self.find_loops();
        self.ears.clear();
        let is_simple = self
            .loops
            .iter()
            .all(|ring| ring.len() <= EARS_MAX && is_counterclockwise(ring, &self.flat));
        let begun = self.ears.len();
        let is_done = if is_simple {
            let Self {
                loops, flat, ears, ..
            } = self;
            loops.iter_mut().all(|ring| cut_ears(ring, flat, ears))
        } else {
            false
        };
        if !is_done {
            self.ears.truncate(begun);
            if !self.divide() {
                self.ears.truncate(begun);
                self.fan();
            }
        }
        for triangle in &self.ears {
            sink(triangle.map(|vertex| self.vertices[vertex]));
        }
    }

    /// Numbers the vertices.
    fn read(&mut self, face: &Face) {
        let Self {
            vertices,
            flat,
            edges,
            index,
            ..
        } = self;
        vertices.clear();
        edges.clear();
        index.clear();
        let is_small = face.edges.len() <= FEW_EDGES;
        for ends in &face.edges {
            // Zero has two signs and is one place.
            let ends = ends.map(|end| end.map(|coordinate| coordinate + 0.0));
            edges.push(ends.map(|end| {
                if is_small {
                    let found = vertices
                        .iter()
                        .position(|other| other.map(f64::to_bits) == end.map(f64::to_bits));
                    found.unwrap_or_else(|| {
                        vertices.push(end);
                        vertices.len() - 1
                    })
                } else {
                    *index.entry(end.map(f64::to_bits)).or_insert_with(|| {
                        vertices.push(end);
                        vertices.len() - 1
                    })
                }
            }));
        }
        let size = face.normal.map(f64::abs);
        let axis = (0..3).fold(
            0,
            |best, axis| {
                if size[axis] > size[best] { axis } else { best }
            },
        );
        let (one, other) = ((axis + 1) % 3, (axis + 2) % 3);
        let is_upward = face.normal[axis] > 0.0;
        flat.clear();
        flat.extend(vertices.iter().map(|vertex| {
            let (x, y) = (vertex[one], vertex[other]);
            if is_upward {
                Coord { x, y }
            } else {
                Coord { x: y, y: x }
            }
        }));
    }

    fn find_loops(&mut self) {
        let Self {
            flat,
            edges,
            first,
            leaving,
            is_used,
            loops,
            ..
        } = self;
        first.clear();
        first.resize(flat.len() + 1, 0);
        for [tail, _] in edges.iter() {
            first[tail + 1] += 1;
        }
        for vertex in 0..flat.len() {
            first[vertex + 1] += first[vertex];
        }
        leaving.clear();
        leaving.resize(edges.len(), 0);
        // Filled from the end of each vertex's part, which so becomes its beginning.
        let mut next: Vec<usize> = first[..flat.len()].to_vec();
        for (which, [tail, _]) in edges.iter().enumerate() {
            leaving[next[*tail]] = which;
            next[*tail] += 1;
        }
        is_used.clear();
        is_used.resize(edges.len(), false);
        loops.clear();
        for begun in 0..edges.len() {
            if is_used[begun] {
                continue;
            }
            let mut ring = Vec::new();
            let mut edge = begun;
            loop {
                is_used[edge] = true;
                let [tail, head] = edges[edge];
                ring.push(tail);
                let free = leaving[first[head]..first[head + 1]].iter().copied();
                // The first edge may end the loop, though it is used.
                let free = free.filter(|&next| next == begun || !is_used[next]);
                let chosen = free.reduce(|best, next| {
                    let (best_head, next_head) = (edges[best][1], edges[next][1]);
                    if is_sharper(flat, [tail, head], next_head, best_head) {
                        next
                    } else {
                        best
                    }
                });
                match chosen {
                    Some(next) if next != begun => edge = next,
                    _ => break,
                }
            }
            loops.push(ring);
        }
    }

    /// Triangles of a constrained Delaunay triangulation; false when the edges do not fit together.
    fn divide(&mut self) -> bool {
        let points: Vec<Point2<f64>> = self
            .flat
            .iter()
            .map(|point| Point2::new(point.x, point.y))
            .collect();
        let count = points.len();
        let mut fits = true;
        let divided = ConstrainedDelaunayTriangulation::<Point2<f64>>::try_bulk_load_cdt(
            points,
            self.edges.clone(),
            |_| fits = false,
        );
        let Ok(divided) = divided else {
            return false;
        };
        if !fits || divided.num_vertices() != count {
            return false;
        }
        // From the left of every edge, inwards.
        let mut is_inside = vec![false; divided.num_all_faces()];
        let mut open = Vec::new();
        let handle = spade::handles::FixedVertexHandle::from_index;
        let mut sides = Vec::with_capacity(self.edges.len());
        for &[tail, head] in &self.edges {
            let Some(edge) = divided.get_edge_from_neighbors(handle(tail), handle(head)) else {
                return false;
            };
            let (left, right) = (edge.face(), edge.rev().face());
            sides.push((left.fix().index(), right.fix().index()));
            let Some(left) = left.as_inner() else {
                return false;
            };
            if !std::mem::replace(&mut is_inside[left.fix().index()], true) {
                open.push(left.fix());
            }
        }
        while let Some(face) = open.pop() {
            let face = divided.face(face);
            self.ears.push(face.vertices().map(|one| one.fix().index()));
            for edge in face.adjacent_edges() {
                if edge.is_constraint_edge() {
                    continue;
                }
                let Some(beyond) = edge.rev().face().as_inner() else {
                    return false;
                };
                if !std::mem::replace(&mut is_inside[beyond.fix().index()], true) {
                    open.push(beyond.fix());
                }
            }
        }
        sides.iter().all(|&(_, right)| !is_inside[right])
    }

    /// Triangles between the first vertex of each loop and its edges: what lies outside is covered twice, in both directions.
    fn fan(&mut self) {
        self.find_loops();
        for ring in &self.loops {
            for pair in ring[1..].windows(2) {
                self.ears.push([ring[0], pair[0], pair[1]]);
            }
        }
    }
}

/// Whether, after the edge from `tail` to `head`, the way to `one` turns more sharply to the left than that to `other`: what lies to the left
/// of both edges is then one wedge.
fn is_sharper(flat: &[Coord<f64>], [tail, head]: [usize; 2], one: usize, other: usize) -> bool {
    let at = flat[head];
    let half = |to: usize| {
        let turn = orient2d(at, flat[tail], flat[to]);
        if turn < 0.0 {
            0
        } else if turn > 0.0 || to != tail {
            1
        } else {
            2
        }
    };
    let (one_half, other_half) = (half(one), half(other));
    one_half < other_half || one_half == other_half && orient2d(at, flat[one], flat[other]) < 0.0
}

/// Whether a loop runs around what lies to its left, by its area: where rounding misjudges that, no ears are found in it.
fn is_counterclockwise(ring: &[usize], flat: &[Coord<f64>]) -> bool {
    let origin = flat[ring[0]];
    let area: f64 = ring
        .iter()
        .zip(ring.iter().cycle().skip(1))
        .map(|(&one, &other)| {
            let (one, other) = (flat[one], flat[other]);
            (one.x - origin.x) * (other.y - origin.y) - (other.x - origin.x) * (one.y - origin.y)
        })
        .sum();
    area > 0.0
}

/// Cuts off triangles until none is left; false when there is none to be cut off.
fn cut_ears(ring: &mut Vec<usize>, flat: &[Coord<f64>], ears: &mut Vec<[usize; 3]>) -> bool {
    if ring.len() < 3 {
        return false;
    }
    let mut at = 0;
    let mut refused = 0;
    while ring.len() > 3 {
        let count = ring.len();
        if refused == count {
            return false;
        }
        at %= count;
        let ear = [ring[at], ring[(at + 1) % count], ring[(at + 2) % count]];
        if is_ear(ear, ring, flat) {
            ears.push(ear);
            ring.remove((at + 1) % count);
            refused = 0;
            // Not at the same corner again, which would make a fan of thin triangles.
            at += usize::from(at + 1 < count);
        } else {
            refused += 1;
            at += 1;
        }
    }
    let last = [ring[0], ring[1], ring[2]];
    let [a, b, c] = last.map(|vertex| flat[vertex]);
    ears.push(last);
    orient2d(a, b, c) > 0.0
}

/// Whether a corner is convex, and no other vertex lies in its triangle or on its sides.
fn is_ear(ear: [usize; 3], ring: &[usize], flat: &[Coord<f64>]) -> bool {
    let [a, b, c] = ear.map(|vertex| flat[vertex]);
    if orient2d(a, b, c) <= 0.0 {
        return false;
    }
    let (low_x, high_x) = (a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x));
    let (low_y, high_y) = (a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y));
    !ring.iter().any(|vertex| {
        let point = flat[*vertex];
        let is_near =
            point.x >= low_x && point.x <= high_x && point.y >= low_y && point.y <= high_y;
        is_near
            && !ear.contains(vertex)
            && orient2d(a, b, point) >= 0.0
            && orient2d(b, c, point) >= 0.0
            && orient2d(c, a, point) >= 0.0
    })
}
