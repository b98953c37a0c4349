//! Double-double arithmetic in lanes: a number is the unevaluated sum of two floats, about 106 bits.
//!
//! Knows nothing of geometry. One of the rooms that hold floats: nothing here is ever a result, only the flags' first attempt
//! at a rounding, which `flags.rs` certifies or gives up.
//!
//! # Proof
//! With round to nearest and `u = 2^-53`, and far from overflow and underflow, every operation returns a number whose relative error
//! is at most [`RELATIVE_ERROR`]` = 2^-102 = 16 u^2`:
//!
//! | operation | algorithm of the source | bound proved there |
//! |---|---|---|
//! | `plus`, `minus` | 6, `AccurateDWPlusDW` | `3 u^2 + 13 u^3` |
//! | `times` | 11, `DWTimesDW2` | `5 u^2` (improved there; 6 in the first print) |
//! | `over` | 17, `DWDivDW2` | `15 u^2 + 56 u^3` |
//! | `root` | one Newton step from the rounded root | see below |
//!
//! A fused multiply-add is correctly rounded wherever it runs, so the lanes do not depend on the processor.
//!
//! The root: let `s = sqrt(a) (1 + e)` with `|e| <= u + u^2` (rounding of the high part's root, and its neglected low part).
//! `a - s^2` is formed as the double-double `a` minus the exact square of `s`, with a relative error of the difference of `3 u^2 a`
//! at most; divided by `2 s` it corrects `s` up to `e^2 / 2` from Newton's formula, `3 u^2 / 2` from the difference and `3 u` of a
//! correction below `2 u`, from the two roundings. Together at most `(1/2 + 3/2 + 6) u^2 < 9 u^2`.
//! # Source
//! M. Joldes, J.-M. Muller, V. Popescu, "Tight and rigorous error bounds for basic building blocks of double-word arithmetic",
//! ACM Transactions on Mathematical Software 44(2), 2017.

#![expect(
    clippy::cast_precision_loss,
    reason = "floats certify roundings and are never a result"
)]
#![expect(
    clippy::inline_always,
    reason = "they become part of the caller, with its instructions"
)]

use super::vector::Vector;

/// Greatest relative error of one operation: `2^-102`.
pub(super) const RELATIVE_ERROR: f64 = 1.0 / (1_u128 << 102) as f64;

/// Double-doubles, one in each lane.
#[derive(Clone, Copy, Debug)]
pub(super) struct Doubles<V> {
    /// The numbers, rounded.
    pub(super) high: V,
    /// What is missing: at most half a unit in the last place of `high`.
    pub(super) low: V,
}

impl<V: Vector> Doubles<V> {
    /// Numbers that are single floats.
    #[inline(always)]
    pub(super) fn single(high: V) -> Self {
        let low = V::splat(0.0);
        Self { high, low }
    }

    /// One in each lane.
    #[inline(always)]
    pub(super) fn one() -> Self {
        Self::single(V::splat(1.0))
    }

    /// The rounded sums and what rounding took away.
    #[inline(always)]
    fn two_sum(a: V, b: V) -> Self {
        let high = a.plus(b);
        let back = high.minus(a);
        let low = a.minus(high.minus(back)).plus(b.minus(back));
        Self { high, low }
    }

    /// The same where no lane of `b` is greater than that of `a`.
    #[inline(always)]
    fn fast_two_sum(a: V, b: V) -> Self {
        let high = a.plus(b);
        let low = b.minus(high.minus(a));
        Self { high, low }
    }

    #[inline(always)]
    pub(super) fn plus(self, other: Self) -> Self {
        let high = Self::two_sum(self.high, other.high);
        let low = Self::two_sum(self.low, other.low);
        let sum = Self::fast_two_sum(high.high, high.low.plus(low.high));
        Self::fast_two_sum(sum.high, low.low.plus(sum.low))
    }

    #[inline(always)]
    pub(super) fn negative(self) -> Self {
        Self {
            high: self.high.negative(),
            low: self.low.negative(),
        }
    }

    #[inline(always)]
    pub(super) fn minus(self, other: Self) -> Self {
        self.plus(other.negative())
    }

    #[inline(always)]
    pub(super) fn times(self, other: Self) -> Self {
        let (a, b) = (self, other);
        let high = a.high.times(b.high);
        let rest = a.high.times_plus(b.high, high.negative());
        let across = a.low.times_plus(b.high, a.high.times(b.low));
        Self::fast_two_sum(high, rest.plus(across))
    }

    #[inline(always)]
    pub(super) fn over(self, other: Self) -> Self {
        let quotient = self.high.over(other.high);
        let rest = self.minus(other.times(Self::single(quotient)));
        Self::fast_two_sum(quotient, rest.high.over(other.high))
    }

    /// The square root of positive numbers.
    #[inline(always)]
    pub(super) fn root(self) -> Self {
        let root = self.high.root();
        let square = Self::single(root).times(Self::single(root));
        let rest = self.minus(square);
        Self::fast_two_sum(root, rest.high.over(root.plus(root)))
    }
}

/// The dot product of two vectors.
#[inline(always)]
pub(super) fn dot<V: Vector>(a: &[Doubles<V>; 3], b: &[Doubles<V>; 3]) -> Doubles<V> {
    let (x, y, z) = (a[0].times(b[0]), a[1].times(b[1]), a[2].times(b[2]));
    x.plus(y).plus(z)
}

/// The cross product of two vectors.
#[inline(always)]
pub(super) fn cross<V: Vector>(a: &[Doubles<V>; 3], b: &[Doubles<V>; 3]) -> [Doubles<V>; 3] {
    [
        a[1].times(b[2]).minus(a[2].times(b[1])),
        a[2].times(b[0]).minus(a[0].times(b[2])),
        a[0].times(b[1]).minus(a[1].times(b[0])),
    ]
}
