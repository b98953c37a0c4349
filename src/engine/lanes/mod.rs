//! Vector operations in which the engine's inner loops are written once, for whatever instructions the processor has.
//!
//! ```text
//!   loop      a [`Task`] over a small set of operations          kernel/, scan.rs
//!   Lanes     rows of bits, and integers of 32 and 64 bits       Portable, Avx2
//!   Columns   coordinates of 16 or of 32 bits                    Portable, Avx2
//! ```
//!
//! A value of [`Portable`] or [`Avx2`] is the right to use its operations: there is an `Avx2` only where the processor was found to
//! have its instructions. A loop becomes theirs by [`Lanes::run`]; everything below it must be inlined into it (`inline(always)`, plain
//! loops, no closures that do work), for what is left as a call is compiled for the least processor.
//!
//! There is none for AVX-512: a leaf's 16 rows of 16 bits are one register of AVX2, so wider ones would need wider leaves, which are
//! mostly empty; and no processor that this was written on has it, so that nothing could be measured.
//!
//! The portable implementation is always there, and is the reference that the tests compare the other with.
//! # Source
//! The shape is that of memchr's `Vector` and box2d's `b2FloatW`: one algorithm over a few operations.

#![expect(
    clippy::inline_always,
    reason = "what is inlined into a task is compiled for the task's instructions; left as a call it would not be"
)]

#[cfg(target_arch = "x86_64")]
mod avx2;
mod portable;

use std::fmt::Debug;
use std::ops::{BitAnd, BitOr, Not};

#[cfg(target_arch = "x86_64")]
pub(super) use avx2::Avx2;
use portable::Portable;

/// Lanes of a column, rows of bits, and bits of a row.
pub(super) const LANES: usize = 16;

/// Integers of 32 bits that are one register.
pub(super) const WORDS: usize = 8;

/// There are no such instructions: a type without a value.
#[cfg(not(target_arch = "x86_64"))]
#[derive(Clone, Copy, Debug)]
pub(super) enum Avx2 {}

/// The right to AVX2, where the processor has it.
pub(super) fn avx2() -> Option<Avx2> {
    #[cfg(target_arch = "x86_64")]
    return Avx2::detect();
    #[cfg(not(target_arch = "x86_64"))]
    None
}

/// A loop that is compiled once for each set of instructions.
pub(super) trait Task {
    type Output;

    /// Does it. To be marked `inline(always)`, and called by [`Lanes::run`] alone.
    fn run(self) -> Self::Output;
}

/// A loop that runs on whatever lanes there are.
pub(super) trait OnLanes {
    type Output;

    /// As [`Task::run`].
    fn run_on<L: Columns<i16> + Columns<i32>>(self, lanes: L) -> Self::Output;
}

/// Runs a loop on the best lanes that the processor is known to have.
#[inline(always)]
pub(super) fn run_on<T: OnLanes>(avx2: Option<Avx2>, task: T) -> T::Output {
    match avx2 {
        None => Portable.run(With(Portable, task)),
        #[cfg(target_arch = "x86_64")]
        Some(lanes) => lanes.run(With(lanes, task)),
        #[cfg(not(target_arch = "x86_64"))]
        Some(never) => match never {},
    }
}

/// A loop and its lanes.
struct With<L, T>(L, T);

impl<L: Columns<i16> + Columns<i32>, T: OnLanes> Task for With<L, T> {
    type Output = T::Output;

    #[inline(always)]
    fn run(self) -> T::Output {
        self.1.run_on(self.0)
    }
}

/// A set of instructions, and what they operate on whatever the width of the coordinates.
pub(super) trait Lanes: Copy + Debug + Send + Sync + 'static {
    /// Sixteen rows of sixteen bits: row `y` holds a bit for each `x`.
    type Rows: Copy;
    /// Eight integers of 32 bits. Arithmetic is modulo 2^32.
    type Eight: Copy;
    /// Four integers of 32 bits.
    type Four: Copy;
    /// Four integers of 64 bits. Arithmetic is modulo 2^64.
    type Long: Copy;

    /// Does a task in code compiled for these instructions.
    fn run<T: Task>(self, task: T) -> T::Output;

    fn rows(self, rows: [u16; LANES]) -> Self::Rows;
    fn rows_array(self, rows: Self::Rows) -> [u16; LANES];
    /// The rows four by four, the first in the lowest bits.
    fn rows_words(self, rows: Self::Rows) -> [u64; LANES / 4];
    /// The same row sixteen times.
    fn every_row(self, row: u16) -> Self::Rows;
    fn and(self, one: Self::Rows, other: Self::Rows) -> Self::Rows;
    fn or(self, one: Self::Rows, other: Self::Rows) -> Self::Rows;
    fn xor(self, one: Self::Rows, other: Self::Rows) -> Self::Rows;
    /// `one` without the bits of `other`.
    fn without(self, one: Self::Rows, other: Self::Rows) -> Self::Rows;
    fn is_empty(self, rows: Self::Rows) -> bool;
    /// Each row takes the one after it; the last is empty.
    fn next_row(self, rows: Self::Rows) -> Self::Rows;
    /// Each bit takes the one after it in its row; the last is empty.
    fn next_column(self, rows: Self::Rows) -> Self::Rows;

    fn eight(self, integers: &[i32; WORDS]) -> Self::Eight;
    fn eight_array(self, integers: Self::Eight) -> [i32; WORDS];
    fn every_eight(self, integer: i32) -> Self::Eight;
    /// The lanes of `other` whose bits are set in `OTHER`, and those of `one` elsewhere.
    fn mix_eight<const OTHER: i32>(self, one: Self::Eight, other: Self::Eight) -> Self::Eight;
    fn plus_eight(self, one: Self::Eight, other: Self::Eight) -> Self::Eight;
    fn minus_eight(self, one: Self::Eight, other: Self::Eight) -> Self::Eight;
    fn times_eight(self, one: Self::Eight, other: Self::Eight) -> Self::Eight;
    /// A bit for each lane in which no integer is above its limit, all of them read as unsigned.
    fn at_most(self, integers: [Self::Eight; 3], limits: [Self::Eight; 3]) -> u8;
    /// Writes the lanes whose bits are set one behind the other, and anything behind them.
    fn compress_eight(self, to: &mut [i32; WORDS], integers: Self::Eight, kept: u8);

    fn four(self, integers: &[i32; 4]) -> Self::Four;
    fn every_four(self, integer: i32) -> Self::Four;
    /// As [`Self::mix_eight`].
    fn mix_four<const OTHER: i32>(self, one: Self::Four, other: Self::Four) -> Self::Four;
    fn minus_four(self, one: Self::Four, other: Self::Four) -> Self::Four;
    fn times_four(self, one: Self::Four, other: Self::Four) -> Self::Four;
    /// Exact products.
    fn times_long(self, one: Self::Four, other: Self::Four) -> Self::Long;
    fn no_long(self) -> Self::Long;
    fn plus_long(self, one: Self::Long, other: Self::Long) -> Self::Long;
    fn long_array(self, integers: Self::Long) -> [i64; 4];
}

/// Operations on coordinates of one width. Masks are columns or boxes too: all bits of a lane are set or none is.
pub(super) trait Columns<C: Coordinate>: Lanes {
    /// Sixteen coordinates along one axis.
    type Column: Copy;
    /// A box: its lower ends x, y, z, 0, then its upper ends *negated*, -x, -y, -z, 0. So the common part of two boxes is the
    /// greater of each lane, and one box contains another when none of its lanes is greater.
    type Boxed: Copy + Debug + Send + Sync;
    /// x, y, z and a lane of no meaning.
    type Corner: Copy;

    fn column(self, coordinates: &[C; LANES]) -> Self::Column;
    fn column_array(self, coordinates: Self::Column) -> [C; LANES];
    fn every(self, coordinate: C) -> Self::Column;
    /// Modulo the width.
    fn plus(self, one: Self::Column, other: Self::Column) -> Self::Column;
    /// Modulo the width.
    fn minus(self, one: Self::Column, other: Self::Column) -> Self::Column;
    fn lesser(self, one: Self::Column, other: Self::Column) -> Self::Column;
    fn greater(self, one: Self::Column, other: Self::Column) -> Self::Column;
    /// A mask: where `one` is above `other`.
    fn is_above(self, one: Self::Column, other: Self::Column) -> Self::Column;
    fn both(self, one: Self::Column, other: Self::Column) -> Self::Column;
    /// Where `mask` is set and `not` is not.
    fn but(self, mask: Self::Column, not: Self::Column) -> Self::Column;
    /// `one` where the mask is set, `other` elsewhere.
    fn select(self, mask: Self::Column, one: Self::Column, other: Self::Column) -> Self::Column;
    fn is_any(self, mask: Self::Column) -> bool;
    /// A bit for each lane of a mask.
    fn bits(self, mask: Self::Column) -> u16;
    /// A row for each lane of a mask: full or empty.
    fn rows_of(self, mask: Self::Column) -> Self::Rows;
    /// Each lane takes the one after it, the last that of `last`.
    fn next(self, column: Self::Column, last: Self::Column) -> Self::Column;
    /// Writes the lanes whose bits are set to the front, and anything behind them, but no more than [`LANES`]; how many were set.
    fn compress(self, to: &mut [C], column: Self::Column, kept: u16) -> usize;

    /// Parts of a whole as fractions of sixteen bits, 1/2 and above where a part is the whole. No part is negative or above it.
    fn fractions(self, parts: Self::Column, whole: u32) -> Self::Column;
    /// Products of fractions.
    fn times_fractions(self, one: Self::Column, other: Self::Column) -> Self::Column;
    /// Fractions divided by `2^SHIFT`; from a shift of 1 on they compare as coordinates.
    fn shift_fractions<const SHIFT: i32>(self, fractions: Self::Column) -> Self::Column;

    fn boxed(self, lanes: &[C; 8]) -> Self::Boxed;
    fn box_array(self, boxed: Self::Boxed) -> [C; 8];
    fn common_box(self, one: Self::Boxed, other: Self::Boxed) -> Self::Boxed;
    /// Whether no lane of `outer` is above that of `inner`.
    fn contains(self, outer: Self::Boxed, inner: Self::Boxed) -> bool;
    fn box_is_above(self, one: Self::Boxed, other: Self::Boxed) -> Self::Boxed;
    fn box_minus(self, one: Self::Boxed, other: Self::Boxed) -> Self::Boxed;
    /// One lane in all lanes.
    fn spread<const LANE: usize>(self, boxed: Self::Boxed) -> Self::Column;
    /// The two halves of a box.
    fn halves(self, boxed: Self::Boxed) -> [Self::Corner; 2];
    fn joined(self, halves: [Self::Corner; 2]) -> Self::Boxed;

    fn every_corner(self, coordinate: C) -> Self::Corner;
    /// The nearest that fits in 16 bits; in 32 bits, from whose ends all coordinates are far, the difference itself.
    fn corner_minus(self, one: Self::Corner, other: Self::Corner) -> Self::Corner;
    fn lesser_corner(self, one: Self::Corner, other: Self::Corner) -> Self::Corner;
    fn greater_corner(self, one: Self::Corner, other: Self::Corner) -> Self::Corner;
    /// As [`Self::select`].
    fn select_corner(
        self,
        mask: Self::Corner,
        one: Self::Corner,
        other: Self::Corner,
    ) -> Self::Corner;
    /// Sixteen corners from a column an axis.
    fn corners(self, columns: [Self::Column; 3]) -> [Self::Corner; LANES];
    /// A column an axis from sixteen corners.
    fn columns(self, corners: &[Self::Corner; LANES]) -> [Self::Column; 3];
}

/// An integer as wide as the coordinates near one cube are.
pub(super) trait Coordinate:
    Copy
    + Debug
    + Ord
    + Send
    + Sync
    + 'static
    + Into<i32>
    + BitAnd<Output = Self>
    + BitOr<Output = Self>
    + Not<Output = Self>
{
    const ZERO: Self;
    /// All bits set.
    const ONES: Self;
    const MAX: Self;
    /// An offset that neither reaches nor covers anything, and has no core. One more than the least, so that one less than it fits.
    const FAR: Self;

    /// # Panics
    /// When it does not fit.
    fn of(coordinate: i32) -> Self;
    fn plus(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    /// The nearest that fits.
    fn minus_saturated(self, other: Self) -> Self;
    /// The low bits of an integer, as many as there are.
    fn of_low_bits(integer: i32) -> Self;
    fn of_fraction(fraction: u16) -> Self;
    fn fraction(self) -> u16;
}

macro_rules! coordinate {
    ($integer:ty, $of_low_bits:expr, $of_fraction:expr, $fraction:expr) => {
        impl Coordinate for $integer {
            const ZERO: Self = 0;
            const ONES: Self = -1;
            const MAX: Self = <$integer>::MAX;
            const FAR: Self = <$integer>::MIN + 1;

            #[inline(always)]
            fn of(coordinate: i32) -> Self {
                Self::try_from(coordinate).expect("everything near a cube of a small edge is small")
            }

            #[inline(always)]
            fn plus(self, other: Self) -> Self {
                self.wrapping_add(other)
            }

            #[inline(always)]
            fn minus(self, other: Self) -> Self {
                self.wrapping_sub(other)
            }

            #[inline(always)]
            fn minus_saturated(self, other: Self) -> Self {
                self.saturating_sub(other)
            }

            #[inline(always)]
            fn of_low_bits(integer: i32) -> Self {
                $of_low_bits(integer)
            }

            #[inline(always)]
            fn of_fraction(fraction: u16) -> Self {
                $of_fraction(fraction)
            }

            #[inline(always)]
            fn fraction(self) -> u16 {
                $fraction(self)
            }
        }
    };
}

coordinate!(
    i16,
    |integer: i32| {
        let [low, high, ..] = integer.to_le_bytes();
        i16::from_le_bytes([low, high])
    },
    u16::cast_signed,
    i16::cast_unsigned
);
coordinate!(i32, |integer| integer, i32::from, |fraction: i32| {
    u16::try_from(fraction).expect("a fraction has sixteen bits")
});
