//! A convex solid prepared for the kernel: its exact planes and vertices, and beside them what the filter reads.
//!
//! ```text
//!   face      exact plane + rough plane          block   four rough planes side by side
//!   corner    exact position + rough position    slabs   the extents along ten diagonals
//! ```

use crate::geometry::Bounds;
use crate::geometry::convex::{Edge, Plane, Solid};

use super::certify::{Near, Room};
use super::face::{Arithmetic, Corner, Face, Place, Position, Vertex, side};
use super::lanes::{Block, Points, Slabs};

/// A closed convex polyhedron, ready to be measured.
#[derive(Clone, Debug)]
pub(super) struct Piece {
    pub(super) corners: Vec<Corner>,
    /// The corners again, roughly, four by four.
    pub(super) points: Vec<Points>,
    pub(super) faces: Vec<Face>,
    pub(super) edges: Vec<Edge>,
    /// Where the loop of each facet starts in `loops`, and the end of the last.
    starts: Vec<u16>,
    loops: Vec<u16>,
    across: Vec<u16>,
    /// The box of each facet.
    pub(super) rooms: Vec<Room>,
    pub(super) room: Room,
    bounds: Bounds,
    pub(super) blocks: Vec<Block>,
    pub(super) slabs: Slabs,
}

/// The parts of a piece that are found from outside.
pub(super) struct Parts {
    pub(super) corners: Vec<Corner>,
    pub(super) planes: Vec<Plane>,
    pub(super) edges: Vec<Edge>,
    pub(super) starts: Vec<u16>,
    pub(super) loops: Vec<u16>,
    pub(super) across: Vec<u16>,
    /// A box around it.
    pub(super) bounds: Bounds,
}

impl Piece {
    /// Prepares a solid.
    pub(super) fn of(solid: &Solid) -> Self {
        let corner = |point: [i32; 3]| Corner {
            near: Near::lattice(point),
            position: Position::Lattice(point),
        };
        let corners = solid.vertices().iter();
        let corners = corners.map(|point| corner(point.coordinates())).collect();
        let mut starts = Vec::with_capacity(solid.planes().len() + 1);
        let mut loops = Vec::with_capacity(2 * solid.edges().len());
        let mut across = Vec::with_capacity(loops.capacity());
        let end = |loops: &Vec<u16>| {
            u16::try_from(loops.len()).expect("a solid has fewer than 2^16 half-edges")
        };
        for facet in solid.facets() {
            starts.push(end(&loops));
            loops.extend_from_slice(facet.vertices);
            across.extend_from_slice(facet.across);
        }
        starts.push(end(&loops));
        Self::from_parts(Parts {
            corners,
            planes: solid.planes().to_vec(),
            edges: solid.edges().to_vec(),
            starts,
            loops,
            across,
            bounds: solid.bounds(),
        })
    }

    /// A vertex, exact and rough.
    #[inline]
    pub(super) fn vertex(&self, vertex: u16) -> Vertex<'_> {
        let corner = &self.corners[usize::from(vertex)];
        let place = match corner.position {
            Position::Lattice(point) => Place::Lattice(point),
            Position::Meeting(faces) => Place::Meeting(faces.map(|face| self.face(face))),
        };
        Vertex {
            near: corner.near,
            place,
        }
    }

    /// Prepares what is given in parts: facets counterclockwise from outside, their normals outwards.
    pub(super) fn from_parts(parts: Parts) -> Self {
        let faces: Vec<Face> = parts.planes.iter().map(Face::of).collect();
        let mut room = Room::empty();
        for corner in &parts.corners {
            room.include(&corner.near);
        }
        let facet_room = |ends: &[u16]| {
            let mut room = Room::empty();
            for &vertex in &parts.loops[usize::from(ends[0])..usize::from(ends[1])] {
                room.include(&parts.corners[usize::from(vertex)].near);
            }
            room
        };
        Self {
            rooms: parts.starts.windows(2).map(facet_room).collect(),
            room,
            bounds: parts.bounds,
            blocks: Block::of_faces(&faces),
            slabs: Slabs::around(&parts.corners),
            points: Points::of_corners(&parts.corners),
            corners: parts.corners,
            faces,
            edges: parts.edges,
            starts: parts.starts,
            loops: parts.loops,
            across: parts.across,
        }
    }

    fn range(&self, facet: u16) -> std::ops::Range<usize> {
        let facet = usize::from(facet);
        usize::from(self.starts[facet])..usize::from(self.starts[facet + 1])
    }

    /// The vertices of a facet, counterclockwise from outside.
    #[inline]
    pub(super) fn loop_of(&self, facet: u16) -> &[u16] {
        &self.loops[self.range(facet)]
    }

    /// Beside each vertex of a facet, the facet across the edge that starts there.
    #[inline]
    pub(super) fn across(&self, facet: u16) -> &[u16] {
        &self.across[self.range(facet)]
    }

    #[inline]
    pub(super) fn face(&self, facet: u16) -> &Face {
        &self.faces[usize::from(facet)]
    }

    #[inline]
    pub(super) fn edge(&self, edge: u16) -> Edge {
        self.edges[usize::from(edge)]
    }

    /// The edge between two facets.
    pub(super) fn edge_between(&self, a: u16, b: u16) -> Option<usize> {
        self.edges.iter().position(|edge| {
            (edge.left == a && edge.right == b) || (edge.left == b && edge.right == a)
        })
    }

    /// Whether the two can have no point in common, by their boxes and the extents along ten diagonals.
    #[inline]
    pub(super) fn is_apart(&self, other: &Self) -> bool {
        !self.room.meets(&other.room) || self.slabs.is_apart(&other.slabs)
    }

    /// A box around it, with lattice corners.
    pub(super) fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Whether another piece lies in this closed one.
    pub(super) fn holds(&self, other: &Self, arithmetic: Arithmetic) -> bool {
        self.room.holds(&other.room)
            && (0..other.corners.len()).all(|vertex| {
                let vertex = u16::try_from(vertex).expect("a solid has fewer than 2^16 vertices");
                let vertex = other.vertex(vertex);
                self.faces
                    .iter()
                    .all(|face| side(arithmetic, face, &vertex).0 <= 0)
            })
    }

    /// Bytes that it takes.
    pub(super) fn size(&self) -> usize {
        size_of::<Self>()
            + size_of_val(&*self.corners)
            + size_of_val(&*self.points)
            + size_of_val(&*self.faces)
            + size_of_val(&*self.edges)
            + size_of_val(&*self.starts)
            + size_of_val(&*self.loops)
            + size_of_val(&*self.across)
            + size_of_val(&*self.rooms)
            + size_of_val(&*self.blocks)
    }
}
