//! Four floats at once: one algorithm over a small set of operations, for any processor and for those with AVX2 and FMA.
//!
//! One of the rooms that hold floats. Every operation is correctly rounded in each lane, so both kinds of lanes hold the same numbers.

#![expect(
    clippy::float_arithmetic,
    reason = "floats certify signs and roundings and are never a result"
)]
#![expect(
    clippy::inline_always,
    reason = "they become part of the caller, with its instructions"
)]

/// Numbers in a vector.
pub(super) const LANES: usize = 4;

/// One float in each lane, as it is stored.
pub(super) type Lanes = [f64; LANES];

/// Operations lane by lane.
pub(super) trait Vector: Copy {
    fn of(lanes: &Lanes) -> Self;
    fn lanes(self) -> Lanes;
    fn plus(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;
    fn over(self, other: Self) -> Self;
    /// The fused `self * factor + summand`.
    fn times_plus(self, factor: Self, summand: Self) -> Self;
    fn root(self) -> Self;
    /// The nearest whole number, the even one of two.
    fn nearest(self) -> Self;
    fn least(self, other: Self) -> Self;
    fn most(self, other: Self) -> Self;
    /// Bits of the lanes where this is greater.
    fn greater(self, other: Self) -> u8;
    /// Whole numbers below `2^51` in size as integers.
    fn integers(self) -> [i64; LANES];

    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self::of(&[value; LANES])
    }

    #[inline(always)]
    fn negative(self) -> Self {
        Self::splat(0.0).minus(self)
    }

    #[inline(always)]
    fn size(self) -> Self {
        self.most(self.negative())
    }
}

/// Lanes of any processor.
#[derive(Clone, Copy)]
pub(super) struct Plain(Lanes);

impl Plain {
    #[inline(always)]
    fn each(of: impl Fn(usize) -> f64) -> Self {
        Self([of(0), of(1), of(2), of(3)])
    }
}

impl Vector for Plain {
    #[inline(always)]
    fn of(lanes: &Lanes) -> Self {
        Self(*lanes)
    }

    #[inline(always)]
    fn lanes(self) -> Lanes {
        self.0
    }

    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        Self::each(|lane| self.0[lane] + other.0[lane])
    }

    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        Self::each(|lane| self.0[lane] - other.0[lane])
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        Self::each(|lane| self.0[lane] * other.0[lane])
    }

    #[inline(always)]
    fn over(self, other: Self) -> Self {
        Self::each(|lane| self.0[lane] / other.0[lane])
    }

    #[inline(always)]
    fn times_plus(self, factor: Self, summand: Self) -> Self {
        Self::each(|lane| self.0[lane].mul_add(factor.0[lane], summand.0[lane]))
    }

    #[inline(always)]
    fn root(self) -> Self {
        Self::each(|lane| self.0[lane].sqrt())
    }

    #[inline(always)]
    fn nearest(self) -> Self {
        Self::each(|lane| self.0[lane].round_ties_even())
    }

    #[inline(always)]
    fn least(self, other: Self) -> Self {
        Self::each(|lane| self.0[lane].min(other.0[lane]))
    }

    #[inline(always)]
    fn most(self, other: Self) -> Self {
        Self::each(|lane| self.0[lane].max(other.0[lane]))
    }

    #[inline(always)]
    fn greater(self, other: Self) -> u8 {
        let bit = |lane: usize| u8::from(self.0[lane] > other.0[lane]) << lane;
        bit(0) | bit(1) | bit(2) | bit(3)
    }

    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "whole numbers below 2^51")]
    fn integers(self) -> [i64; LANES] {
        self.0.map(|whole| whole as i64)
    }
}

#[cfg(target_arch = "x86_64")]
pub(super) use wide::Wide;

#[cfg(target_arch = "x86_64")]
mod wide {
    #![expect(
        unsafe_code,
        reason = "instructions that were detected; a whole register is read and written"
    )]

    use std::arch::x86_64::{
        __m256d, _CMP_GT_OQ, _MM_FROUND_NO_EXC, _MM_FROUND_TO_NEAREST_INT, _mm256_add_pd,
        _mm256_castpd_si256, _mm256_cmp_pd, _mm256_div_pd, _mm256_fmadd_pd, _mm256_loadu_pd,
        _mm256_max_pd, _mm256_min_pd, _mm256_movemask_pd, _mm256_mul_pd, _mm256_round_pd,
        _mm256_set1_pd, _mm256_sqrt_pd, _mm256_storeu_pd, _mm256_storeu_si256, _mm256_sub_epi64,
        _mm256_sub_pd,
    };

    use super::{LANES, Lanes, Vector};

    /// A register. Only functions that have AVX2 and FMA enabled use it: see `twice!`.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Wide(__m256d);

    /// Declares operations that are one instruction each.
    macro_rules! instructions {
        ($($name:ident($($argument:ident),*) = $instruction:expr;)*) => {
            $(
                #[inline(always)]
                fn $name(self, $($argument: Self),*) -> Self {
                    // SAFETY: the caller has the instructions.
                    unsafe { Self($instruction(self.0, $($argument.0),*)) }
                }
            )*
        };
    }

    impl Vector for Wide {
        instructions! {
            plus(other) = _mm256_add_pd;
            minus(other) = _mm256_sub_pd;
            times(other) = _mm256_mul_pd;
            over(other) = _mm256_div_pd;
            times_plus(factor, summand) = _mm256_fmadd_pd;
            root() = _mm256_sqrt_pd;
            nearest() = _mm256_round_pd::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>;
            least(other) = _mm256_min_pd;
            most(other) = _mm256_max_pd;
        }

        #[inline(always)]
        fn of(lanes: &Lanes) -> Self {
            // SAFETY: the caller has the instruction, and reads four floats.
            unsafe { Self(_mm256_loadu_pd(lanes.as_ptr())) }
        }

        #[inline(always)]
        fn lanes(self) -> Lanes {
            let mut lanes = [0.0; LANES];
            // SAFETY: the caller has the instruction, and writes four floats.
            unsafe { _mm256_storeu_pd(lanes.as_mut_ptr(), self.0) };
            lanes
        }

        #[inline(always)]
        fn splat(value: f64) -> Self {
            // SAFETY: the caller has the instruction.
            unsafe { Self(_mm256_set1_pd(value)) }
        }

        #[inline(always)]
        fn greater(self, other: Self) -> u8 {
            // SAFETY: the caller has the instructions.
            let bits = unsafe { _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_GT_OQ>(self.0, other.0)) };
            bits.to_le_bytes()[0]
        }

        #[inline(always)]
        fn integers(self) -> [i64; LANES] {
            // Added to 1.5 times 2^52 they are the last bits of the sum.
            let zero = Self::splat(6_755_399_441_055_744.0);
            let mut integers = [0; LANES];
            // SAFETY: the caller has the instructions, and writes four integers.
            unsafe {
                let bits = _mm256_castpd_si256(self.plus(zero).0);
                let bits = _mm256_sub_epi64(bits, _mm256_castpd_si256(zero.0));
                _mm256_storeu_si256(integers.as_mut_ptr().cast(), bits);
            }
            integers
        }
    }
}
