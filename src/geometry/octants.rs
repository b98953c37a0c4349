//! The eight octants around one lattice point, as one byte.
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
