//! Double-double arithmetic in four lanes: a number is the unevaluated sum of two floats, about 106 bits.
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
    clippy::float_arithmetic,
    reason = "floats certify roundings and are never a result"
)]
#![expect(
    clippy::inline_always,
    reason = "they become part of the caller, with its instructions"
)]

/// Greatest relative error of one operation: `2^-102`.
#[cfg(test)]
const RELATIVE_ERROR: f64 = 1.0 / (1_u128 << 102) as f64;

/// Numbers computed at once.
pub(super) const LANES: usize = 4;

/// One float in each lane.
type Lanes = [f64; LANES];

#[inline(always)]
fn each(of: impl Fn(usize) -> f64) -> Lanes {
    [of(0), of(1), of(2), of(3)]
}

/// Four double-doubles.
#[derive(Clone, Copy, Debug)]
pub(super) struct Doubles {
    /// The numbers, rounded.
    pub(super) high: Lanes,
    /// What is missing: at most half a unit in the last place of `high`.
    pub(super) low: Lanes,
}

impl Doubles {
    /// Numbers that are single floats.
    #[inline(always)]
    pub(super) fn single(high: Lanes) -> Self {
        let low = [0.0; LANES];
        Self { high, low }
    }

    /// One in each lane.
    #[inline(always)]
    pub(super) fn one() -> Self {
        Self::single([1.0; LANES])
    }

    /// The rounded sum of two lanes and what rounding took away.
    #[inline(always)]
    fn two_sum(a: Lanes, b: Lanes) -> Self {
        let high = each(|lane| a[lane] + b[lane]);
        let back = each(|lane| high[lane] - a[lane]);
        let low = each(|lane| (a[lane] - (high[lane] - back[lane])) + (b[lane] - back[lane]));
        Self { high, low }
    }

    /// The same where no lane of `b` is greater than that of `a`.
    #[inline(always)]
    fn fast_two_sum(a: Lanes, b: Lanes) -> Self {
        let high = each(|lane| a[lane] + b[lane]);
        let low = each(|lane| b[lane] - (high[lane] - a[lane]));
        Self { high, low }
    }

    #[inline(always)]
    pub(super) fn plus(self, other: Self) -> Self {
        let high = Self::two_sum(self.high, other.high);
        let low = Self::two_sum(self.low, other.low);
        let carry = each(|lane| high.low[lane] + low.high[lane]);
        let sum = Self::fast_two_sum(high.high, carry);
        let rest = each(|lane| low.low[lane] + sum.low[lane]);
        Self::fast_two_sum(sum.high, rest)
    }

    #[inline(always)]
    pub(super) fn negative(self) -> Self {
        Self {
            high: self.high.map(|value| -value),
            low: self.low.map(|value| -value),
        }
    }

    #[inline(always)]
    pub(super) fn minus(self, other: Self) -> Self {
        self.plus(other.negative())
    }

    #[inline(always)]
    pub(super) fn times(self, other: Self) -> Self {
        let (a, b) = (self, other);
        let high = each(|lane| a.high[lane] * b.high[lane]);
        let rest = each(|lane| a.high[lane].mul_add(b.high[lane], -high[lane]));
        let across = each(|lane| a.high[lane] * b.low[lane]);
        let across = each(|lane| a.low[lane].mul_add(b.high[lane], across[lane]));
        Self::fast_two_sum(high, each(|lane| rest[lane] + across[lane]))
    }

    #[inline(always)]
    pub(super) fn over(self, other: Self) -> Self {
        let quotient = each(|lane| self.high[lane] / other.high[lane]);
        let product = other.times(Self::single(quotient));
        let rest = self.minus(product);
        let more = each(|lane| rest.high[lane] / other.high[lane]);
        Self::fast_two_sum(quotient, more)
    }

    /// The square root of positive numbers.
    #[inline(always)]
    pub(super) fn root(self) -> Self {
        let root = each(|lane| self.high[lane].sqrt());
        let square = Self::single(root).times(Self::single(root));
        let rest = self.minus(square);
        let more = each(|lane| rest.high[lane] / (2.0 * root[lane]));
        Self::fast_two_sum(root, more)
    }
}

/// The dot product of two vectors.
#[inline(always)]
pub(super) fn dot(a: &[Doubles; 3], b: &[Doubles; 3]) -> Doubles {
    let [x, y, z] = [0, 1, 2].map(|axis: usize| a[axis].times(b[axis]));
    x.plus(y).plus(z)
}

/// The cross product of two vectors.
#[inline(always)]
pub(super) fn cross(a: &[Doubles; 3], b: &[Doubles; 3]) -> [Doubles; 3] {
    let component = |i: usize, j: usize| a[i].times(b[j]).minus(a[j].times(b[i]));
    [component(1, 2), component(2, 0), component(0, 1)]
}
