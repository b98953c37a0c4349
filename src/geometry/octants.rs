//! The eight octants around one lattice point, as one byte, and how a union looks there.
//!
//! ```text
//!   bit sx + 2*sy + 4*sz is set when the octant on side s (0 = below, 1 = above, per axis) is inside the union
//! ```

/// Which of the eight octants around a lattice point lie inside the union.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct OctantMask(pub u8);

impl OctantMask {
    /// Whether the octant on `side` (0 below, 1 above, per axis) is filled.
    pub const fn filled(self, side: [usize; 3]) -> bool {
        self.0 >> (side[0] + 2 * side[1] + 4 * side[2]) & 1 == 1
    }

    /// Whether the mask changes along `axis` (0 x, 1 y, 2 z): some octant differs from the one across.
    pub const fn varies_along(self, axis: usize) -> bool {
        let shift = 1 << axis;
        let below = [0b0101_0101, 0b0011_0011, 0b0000_1111][axis];
        (self.0 ^ (self.0 >> shift)) & below != 0
    }
}

/// How the union looks along an edge, by the four octants around it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(usize)]
pub enum EdgeKind {
    /// One octant filled.
    Convex,
    /// Three octants filled.
    Concave,
    /// Two filled, diagonally: two solids meet along the edge (non-manifold).
    Crossing,
}

/// How the union looks at a vertex.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[repr(usize)]
pub enum VertexKind {
    /// One octant filled: a cube's own corner.
    Corner,
    /// Five filled: the edge of a cube goes through a face of another.
    EdgeFace,
    /// Seven filled: three faces of three cubes meet.
    ThreeFace,
    /// Everything else: where features coincide.
    Degenerate,
}
