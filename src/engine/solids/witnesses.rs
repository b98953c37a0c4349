//! Whether one piece dominates a feature of another whole.
//!
//! An edge is dominated when it lies in the closed piece, and where that touches it, its wedge there holds the edge's own. A facet is
//! dominated when it lies in the closed piece and no facet of that has the opposite side of its plane. Of two equal ones the one of lower
//! slot dominates, of nested ones the larger: so no two dominate each other, not even in a ring.

use smallvec::SmallVec;

use super::face::{Arithmetic, Place, Vertex, exact_side, side};
use super::features::Features;
use super::lanes::{LANES, Verdict, excluded, separate, separate_one};
use super::piece::Piece;

/// Where fewer features are asked for, all vertices are not compared with the other piece's box beforehand.
const MANY: usize = 8;

/// What is known of a vertex.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Vertices {
    Unknown = 0,
    Inside,
    Outside,
}

/// A piece and its slot.
#[derive(Clone, Copy)]
pub(super) struct Placed<'a> {
    pub(super) piece: &'a Piece,
    pub(super) slot: u32,
}

/// Finds witnesses, in memory that it keeps.
#[derive(Debug, Default)]
pub(super) struct Witnesses {
    vertices: Vec<u8>,
    near: Vec<u16>,
    bits: Vec<u8>,
}

impl Witnesses {
    /// Marks those of the given edges and facets of a piece that `other` dominates; false when there are none.
    pub(super) fn testify(
        &mut self,
        arithmetic: Arithmetic,
        own: Placed,
        features: &mut Features,
        (edges, facets): (&[u16], &[u16]),
        other: Placed,
    ) -> bool {
        let mut court = Court {
            arithmetic,
            own,
            other,
            vertices: std::mem::take(&mut self.vertices),
            near: std::mem::take(&mut self.near),
            first: 0,
        };
        court.vertices.clear();
        court
            .vertices
            .resize(LANES * own.piece.points.len(), Vertices::Unknown as u8);
        if edges.len() + facets.len() >= MANY {
            excluded(&own.piece.points, &other.piece.room, &mut self.bits);
            for (four, bits) in court.vertices.chunks_exact_mut(LANES).zip(&self.bits) {
                for (lane, vertex) in four.iter_mut().enumerate() {
                    *vertex = (bits >> lane & 1) * Vertices::Outside as u8;
                }
            }
        }
        let mut mark = None;
        for &edge in edges {
            if court.holds_edge(edge) && court.dominates_edge(edge) {
                mark = mark.or_else(|| features.mark_of(other.slot));
                let Some(mark) = mark else { break };
                features.set_edge(edge, mark);
            }
        }
        for &facet in facets {
            if court.holds_facet(facet) && court.dominates_facet(facet) {
                mark = mark.or_else(|| features.mark_of(other.slot));
                let Some(mark) = mark else { break };
                features.set_facet(facet, mark);
            }
        }
        self.vertices = court.vertices;
        self.near = court.near;
        mark.is_some()
    }
}

/// One piece's features before another piece.
struct Court<'a> {
    arithmetic: Arithmetic,
    own: Placed<'a>,
    other: Placed<'a>,
    vertices: Vec<u8>,
    near: Vec<u16>,
    /// The block of planes that separated last.
    first: usize,
}

impl Court<'_> {
    fn holds_edge(&mut self, edge: u16) -> bool {
        let edge = self.own.piece.edge(edge);
        !self.is_outside(edge.tail)
            && !self.is_outside(edge.head)
            && self.holds(edge.tail)
            && self.holds(edge.head)
    }

    fn holds_facet(&mut self, facet: u16) -> bool {
        let own = self.own.piece;
        let points = own.loop_of(facet);
        !points.iter().any(|&vertex| self.is_outside(vertex))
            && points.iter().all(|&vertex| self.holds(vertex))
    }

    /// Whether a vertex is known to be outside of the other piece.
    fn is_outside(&self, vertex: u16) -> bool {
        self.vertices[usize::from(vertex)] == Vertices::Outside as u8
    }

    /// Whether a vertex lies in the closed other piece.
    fn holds(&mut self, vertex: u16) -> bool {
        let known = self.vertices[usize::from(vertex)];
        if known != Vertices::Unknown as u8 {
            return known == Vertices::Inside as u8;
        }
        let holds = self.find(vertex);
        let found = if holds {
            Vertices::Inside
        } else {
            Vertices::Outside
        };
        self.vertices[usize::from(vertex)] = found as u8;
        holds
    }

    fn find(&mut self, vertex: u16) -> bool {
        let vertex = self.own.piece.vertex(vertex);
        if self.other.piece.room.excludes(&vertex.near) {
            return false;
        }
        self.list_near(&vertex) && {
            let near = std::mem::take(&mut self.near);
            let other = self.other.piece;
            let holds = near
                .iter()
                .all(|&facet| side(self.arithmetic, other.face(facet), &vertex).0 <= 0);
            self.near = near;
            holds
        }
    }

    /// Lists the facets of the other piece that may have a point not inside; false when one has it outside.
    fn list_near(&mut self, point: &Vertex) -> bool {
        let blocks = &self.other.piece.blocks;
        self.list(|first, near| separate_one(blocks, &point.near, first, near))
    }

    /// The same for the ends of an edge, one of which is not inside, or both outside.
    fn list_near_edge(&mut self, ends: [&Vertex; 2]) -> bool {
        let blocks = &self.other.piece.blocks;
        let ends = ends.map(|end| &end.near);
        self.list(|first, near| separate(blocks, ends, first, near))
    }

    fn list(&mut self, separate: impl FnOnce(usize, &mut Vec<u16>) -> Verdict) -> bool {
        let other = self.other.piece;
        if self.arithmetic == Arithmetic::Filtered {
            return match separate(self.first, &mut self.near) {
                Verdict::Undecided => true,
                Verdict::Apart(block) => {
                    self.first = block;
                    false
                }
            };
        }
        self.near.clear();
        let facets = u16::try_from(other.faces.len()).expect("fewer than 2^16 facets");
        self.near.extend(0..facets);
        true
    }

    /// Whether the other piece dominates an edge that lies in it.
    fn dominates_edge(&mut self, edge: u16) -> bool {
        let (own, other) = (self.own.piece, self.other.piece);
        let edge = own.edge(edge);
        let ends = [edge.tail, edge.head].map(|vertex| own.vertex(vertex));
        if !self.list_near_edge([&ends[0], &ends[1]]) {
            return false;
        }
        let mut holders: SmallVec<[u16; 2]> = SmallVec::new();
        let mut same = 0;
        for &facet in &self.near {
            let face = other.face(facet);
            if ends.iter().any(|end| exact_side(face, end) != 0) {
                continue;
            }
            holders.push(facet);
            for own_facet in [edge.left, edge.right] {
                if face.same(own.face(own_facet)) {
                    same += 1;
                    continue;
                }
                // A vertex of the facet off the edge shows on which side the facet lies.
                let points = own.loop_of(own_facet).iter();
                let off = points
                    .copied()
                    .find(|vertex| ![edge.tail, edge.head].contains(vertex));
                let off = off.expect("a facet has three vertices");
                if exact_side(face, &own.vertex(off)) > 0 {
                    return false;
                }
            }
        }
        if let [a, b] = holders[..]
            && same == 2
        {
            // The same wedge along an edge that is longer, or equal.
            let twin = other
                .edge_between(a, b)
                .expect("two facets that hold a line in the piece share an edge");
            let twin = other.edges[twin];
            let is_one = |vertex, twin| is_one_point(own, vertex, other, twin);
            let is_equal = (is_one(edge.tail, twin.tail) && is_one(edge.head, twin.head))
                || (is_one(edge.tail, twin.head) && is_one(edge.head, twin.tail));
            return !is_equal || self.other.slot < self.own.slot;
        }
        true
    }

    /// Whether the other piece dominates a facet that lies in it.
    fn dominates_facet(&mut self, facet: u16) -> bool {
        let (own, other) = (self.own.piece, self.other.piece);
        let face = own.face(facet);
        let points = own.loop_of(facet);
        let first = own.vertex(points[0]);
        if !self.list_near(&first) {
            return false;
        }
        for &near in &self.near {
            let holder = other.face(near);
            if holder.opposite(face) {
                return false;
            }
            if holder.same(face) {
                let theirs = other.loop_of(near);
                let is_theirs = |vertex: &u16| {
                    let is_one = |one: &u16| is_one_point(own, *vertex, other, *one);
                    theirs.iter().any(is_one)
                };
                let is_equal = points.len() == theirs.len() && points.iter().all(is_theirs);
                return !is_equal || self.other.slot < self.own.slot;
            }
        }
        true
    }
}

/// Whether vertices of two pieces are one point. A vertex at a lattice point is known as one, however it was found.
fn is_one_point(one: &Piece, vertex: u16, other: &Piece, other_vertex: u16) -> bool {
    let (one, other) = (one.vertex(vertex), other.vertex(other_vertex));
    match (one.place, other.place) {
        (Place::Lattice(a), Place::Lattice(b)) => a == b,
        (Place::Meeting(_), Place::Meeting(faces)) => {
            one.near.may_be(&other.near) && faces.iter().all(|face| exact_side(face, &one) == 0)
        }
        _ => false,
    }
}
