//! How wide the integers of the kernel are, by the length of the edge: no wider than they need be, since narrow ones are faster.

use std::fmt::Debug;

use ethnum::I256;

use crate::engine::lanes::Coordinate;
use crate::geometry::{COORDINATE_MAX, EDGE_MAX};

/// A ring of integers modulo a power of two.
pub(super) trait Ring: Copy + Default + PartialEq + Debug + Send + Sync {
    fn plus(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;
}

macro_rules! ring {
    ($($integer:ty),*) => {$(
        impl Ring for $integer {
            #[inline(always)]
            fn plus(self, other: Self) -> Self {
                self.wrapping_add(other)
            }
            #[inline(always)]
            fn minus(self, other: Self) -> Self {
                self.wrapping_sub(other)
            }
            #[inline(always)]
            fn times(self, other: Self) -> Self {
                self.wrapping_mul(other)
            }
        }
    )*};
}

ring!(i64, i128, I256);

/// How wide the integers are that edges of up to some length need.
pub(super) trait Width: Copy + Debug + Default + Send + Sync + 'static {
    /// The greatest edge. Units: steps.
    const STEPS_MAX: i32;
    /// Coordinates near a cube, negated too.
    type Coordinate: Coordinate;
    /// Sums over the points of one plane across z.
    type Plane: Ring + From<i64>;
    /// Sums over the points of a cube.
    type Sum: Ring + From<i64> + From<Self::Plane> + Into<i128>;
    /// The same in the scene's coordinates.
    type Moved: Ring + From<i64> + From<Self::Sum> + Into<I256>;
    /// Few enough clips for a leaf: each has at most one plane an axis that is none of the cube's own, and those are two more.
    const LEAF_CLIPS: usize;
}

/// For edges of up to 6208 steps.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Narrow;

impl Width for Narrow {
    const STEPS_MAX: i32 = 6208;
    type Coordinate = i16;
    type Plane = i64;
    type Sum = i64;
    type Moved = i128;
    const LEAF_CLIPS: usize = 13;
}

/// For edges of up to 32766 steps.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Middle;

impl Width for Middle {
    const STEPS_MAX: i32 = 32_766;
    type Coordinate = i16;
    type Plane = i64;
    type Sum = i128;
    type Moved = i128;
    const LEAF_CLIPS: usize = 13;
}

/// For every edge.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Wide;

impl Width for Wide {
    const STEPS_MAX: i32 = EDGE_MAX.cast_signed();
    type Coordinate = i32;
    type Plane = i128;
    type Sum = i128;
    type Moved = I256;
    const LEAF_CLIPS: usize = 9;
}

/// What a width rests on.
const fn fits<W: Width>() {
    let edge = W::STEPS_MAX.cast_unsigned() as u128;
    let planes = W::LEAF_CLIPS as u128 + 2;
    // The frame of a cube, and the offset that is nowhere.
    assert!(edge + 1 < 1 << (bits::<W::Coordinate>() - 1));
    assert!(2 * edge.pow(4) < 1 << (bits::<W::Plane>() - 1));
    assert!(edge.pow(5) < 1 << (bits::<W::Sum>() - 1));
    // Volume times three or four squares of coordinates is the greatest term.
    assert!(3 * (edge.ilog2() + 1) + 2 * COORDINATE_MAX.ilog2() + 3 < bits::<W::Moved>());
    // Lengths of a leaf: on each line along an axis at most an edge of the cube, of each kind.
    assert!(planes.pow(2) * edge < 1 << 31);
    // A weight of area or volume times a coordinate.
    assert!(8 * (edge + 1) < 1 << 31);
    assert!(planes * edge.pow(2) < 1 << 63);
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "integers have a few hundred bits"
)]
const fn bits<Integer>() -> u32 {
    8 * size_of::<Integer>() as u32
}

const _: () = {
    fits::<Narrow>();
    fits::<Middle>();
    fits::<Wide>();
};
