//! The operations in AVX2 and the bit instructions that came with it.

use std::arch::x86_64::{
    __m128i, __m256i, _mm_blend_epi32, _mm_blendv_epi8, _mm_cmpgt_epi16, _mm_cvtsi32_si128,
    _mm_loadl_epi64, _mm_max_epi16, _mm_max_epi32, _mm_min_epi16, _mm_min_epi32, _mm_movemask_epi8,
    _mm_mullo_epi32, _mm_packs_epi16, _mm_set1_epi16, _mm_set1_epi32, _mm_setzero_si128,
    _mm_shuffle_epi8, _mm_srli_si128, _mm_sub_epi16, _mm_sub_epi32, _mm_subs_epi16,
    _mm_testz_si128, _mm_unpackhi_epi32, _mm_unpackhi_epi64, _mm_unpacklo_epi16,
    _mm_unpacklo_epi32, _mm_unpacklo_epi64, _mm256_add_epi16, _mm256_add_epi32, _mm256_add_epi64,
    _mm256_alignr_epi8, _mm256_and_si256, _mm256_andnot_si256, _mm256_blend_epi32,
    _mm256_blendv_epi8, _mm256_broadcastsi128_si256, _mm256_castsi256_ps, _mm256_castsi256_si128,
    _mm256_cmpeq_epi32, _mm256_cmpgt_epi16, _mm256_cmpgt_epi32, _mm256_cvtepi32_epi64,
    _mm256_cvtepu8_epi32, _mm256_extracti128_si256, _mm256_max_epi16, _mm256_max_epi32,
    _mm256_min_epi16, _mm256_min_epi32, _mm256_min_epu32, _mm256_movemask_ps, _mm256_mul_epi32,
    _mm256_mulhi_epu16, _mm256_mullo_epi32, _mm256_or_si256, _mm256_packs_epi32,
    _mm256_permute2x128_si256, _mm256_permute4x64_epi64, _mm256_permutevar8x32_epi32,
    _mm256_set_m128i, _mm256_set1_epi16, _mm256_set1_epi32, _mm256_setzero_si256,
    _mm256_shuffle_epi8, _mm256_sll_epi16, _mm256_sll_epi32, _mm256_srli_epi16, _mm256_srli_epi32,
    _mm256_sub_epi16, _mm256_sub_epi32, _mm256_testz_si256, _mm256_unpackhi_epi16,
    _mm256_unpackhi_epi32, _mm256_unpacklo_epi16, _mm256_unpacklo_epi32, _mm256_xor_si256,
};
use std::mem::transmute;

use super::{Columns, LANES, Lanes, Task, WORDS};

/// The right to AVX2 and the bit instructions: there is a value only where the processor was found to have them.
#[derive(Clone, Copy, Debug)]
pub(in crate::engine) struct Avx2(());

/// What is detected, and what tasks are compiled for.
macro_rules! features {
    ($($feature:tt)*) => {
        impl Avx2 {
            /// The right, on a processor that has them.
            pub(in crate::engine) fn detect() -> Option<Self> {
                let found = $(is_x86_feature_detected!($feature))&&*;
                found.then_some(Self(()))
            }
        }

        $(#[target_feature(enable = $feature)])*
        fn compiled<T: Task>(task: T) -> T::Output {
            task.run()
        }
    };
}

features!("avx2" "bmi1" "bmi2" "lzcnt" "popcnt");

/// For each set of eight lanes their numbers, the set ones first, each as so many bytes of a lane.
#[expect(
    clippy::cast_possible_truncation,
    reason = "numbers of bytes in a register"
)]
const fn packed<const BYTES: usize, const SIZE: usize>() -> [[u8; SIZE]; 256] {
    let mut table = [[0; SIZE]; 256];
    let mut set = 0;
    while set < 256 {
        let (mut lane, mut to) = (0_u8, 0);
        while lane < 8 {
            if set >> lane & 1 == 1 {
                let mut byte = 0;
                while byte < BYTES {
                    table[set][to] = lane * BYTES as u8 + byte as u8;
                    to += 1;
                    byte += 1;
                }
            }
            lane += 1;
        }
        set += 1;
    }
    table
}

/// Bytes of lanes of 16 bits, and lanes of 32 bits.
static PACKED_BYTES: [[u8; 16]; 256] = packed::<2, 16>();
static PACKED_LANES: [[u8; 8]; 256] = packed::<1, 8>();

/// The bytes that spread one lane of 16 bits to all.
#[expect(
    clippy::cast_possible_truncation,
    reason = "numbers of bytes in a register"
)]
const fn spread_bytes(lane: usize) -> [u8; 16] {
    let mut bytes = [0; 16];
    let mut index = 0;
    while index < 16 {
        bytes[index] = (2 * lane + index % 2) as u8;
        index += 1;
    }
    bytes
}

/// A lane as an instruction names it.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    reason = "there are eight lanes"
)]
const fn lane_number(lane: usize) -> i32 {
    lane as i32
}

/// Methods whose bodies are instructions of AVX2, or registers read as arrays and back.
macro_rules! instructions {
    ($(fn $name:ident $(<const $constant:ident: $kind:ty>)? (
        $self:ident $(, $argument:tt: $type:ty)* $(,)?
    ) -> $result:ty $body:block)*) => {$(
        #[inline(always)]
        #[expect(unsafe_code, reason = "instructions that were detected, and registers as arrays")]
        fn $name $(<const $constant: $kind>)? ($self $(, $argument: $type)*) -> $result {
            // SAFETY: the receiver is the proof that the processor has the instructions; of integers every bit pattern is
            // valid, and `transmute` compares the sizes.
            unsafe { $body }
        }
    )*};
}

impl Avx2 {
    instructions! {
        /* eight lanes of 32 bits, those of the set first */
        fn pack_eight(self, integers: __m256i, kept: u8) -> __m256i {
            let lanes = _mm_loadl_epi64(PACKED_LANES[usize::from(kept)].as_ptr().cast());
            _mm256_permutevar8x32_epi32(integers, _mm256_cvtepu8_epi32(lanes))
        }
        /* eight lanes of 16 bits, those of the set first */
        fn pack_half(self, half: __m128i, kept: u8) -> [i16; 8] {
            let bytes = transmute::<[u8; 16], __m128i>(PACKED_BYTES[usize::from(kept)]);
            transmute(_mm_shuffle_epi8(half, bytes))
        }
        fn bits_of_eight(self, mask: __m256i) -> u8 {
            _mm256_movemask_ps(_mm256_castsi256_ps(mask)).to_le_bytes()[0]
        }
        /* four corners of 32 bits from and to three registers of x, y, z */
        fn turn(self, [a, b, c, d]: [__m128i; 4]) -> [__m128i; 4] {
            let (ab, cd) = (_mm_unpacklo_epi32(a, b), _mm_unpacklo_epi32(c, d));
            let (ab_high, cd_high) = (_mm_unpackhi_epi32(a, b), _mm_unpackhi_epi32(c, d));
            [
                _mm_unpacklo_epi64(ab, cd),
                _mm_unpackhi_epi64(ab, cd),
                _mm_unpacklo_epi64(ab_high, cd_high),
                _mm_unpackhi_epi64(ab_high, cd_high),
            ]
        }
    }
}

impl Lanes for Avx2 {
    type Rows = __m256i;
    type Eight = __m256i;
    type Four = __m128i;
    type Long = __m256i;

    #[inline(always)]
    fn run<T: Task>(self, task: T) -> T::Output {
        #[expect(unsafe_code, reason = "compiled for instructions that were detected")]
        // SAFETY: the receiver is the proof that the processor has all of them.
        unsafe {
            compiled(task)
        }
    }

    instructions! {
        fn rows(self, rows: [u16; LANES]) -> __m256i { transmute(rows) }
        fn rows_array(self, rows: __m256i) -> [u16; LANES] { transmute(rows) }
        fn rows_words(self, rows: __m256i) -> [u64; LANES / 4] { transmute(rows) }
        fn every_row(self, row: u16) -> __m256i { _mm256_set1_epi16(row.cast_signed()) }
        fn and(self, one: __m256i, other: __m256i) -> __m256i { _mm256_and_si256(one, other) }
        fn or(self, one: __m256i, other: __m256i) -> __m256i { _mm256_or_si256(one, other) }
        fn xor(self, one: __m256i, other: __m256i) -> __m256i { _mm256_xor_si256(one, other) }
        fn without(self, one: __m256i, other: __m256i) -> __m256i { _mm256_andnot_si256(other, one) }
        fn is_empty(self, rows: __m256i) -> bool { _mm256_testz_si256(rows, rows) == 1 }
        fn next_row(self, rows: __m256i) -> __m256i {
            let above = _mm256_permute2x128_si256::<0x81>(rows, rows);
            _mm256_alignr_epi8::<2>(above, rows)
        }
        fn next_column(self, rows: __m256i) -> __m256i { _mm256_srli_epi16::<1>(rows) }

        fn eight(self, integers: &[i32; WORDS]) -> __m256i { transmute(*integers) }
        fn eight_array(self, integers: __m256i) -> [i32; WORDS] { transmute(integers) }
        fn every_eight(self, integer: i32) -> __m256i { _mm256_set1_epi32(integer) }
        fn mix_eight<const OTHER: i32>(self, one: __m256i, other: __m256i) -> __m256i {
            _mm256_blend_epi32::<OTHER>(one, other)
        }
        fn plus_eight(self, one: __m256i, other: __m256i) -> __m256i { _mm256_add_epi32(one, other) }
        fn minus_eight(self, one: __m256i, other: __m256i) -> __m256i { _mm256_sub_epi32(one, other) }
        fn times_eight(self, one: __m256i, other: __m256i) -> __m256i { _mm256_mullo_epi32(one, other) }
        fn at_most(self, [x, y, z]: [__m256i; 3], [x_limit, y_limit, z_limit]: [__m256i; 3]) -> u8 {
            let x = _mm256_cmpeq_epi32(_mm256_min_epu32(x, x_limit), x);
            let y = _mm256_cmpeq_epi32(_mm256_min_epu32(y, y_limit), y);
            let z = _mm256_cmpeq_epi32(_mm256_min_epu32(z, z_limit), z);
            let all = _mm256_and_si256(_mm256_and_si256(x, y), z);
            _mm256_movemask_ps(_mm256_castsi256_ps(all)).to_le_bytes()[0]
        }
        fn compress_eight(self, to: &mut [i32; WORDS], integers: __m256i, kept: u8) -> () {
            *to = transmute::<__m256i, [i32; WORDS]>(self.pack_eight(integers, kept));
        }

        fn four(self, integers: &[i32; 4]) -> __m128i { transmute(*integers) }
        fn every_four(self, integer: i32) -> __m128i { _mm_set1_epi32(integer) }
        fn mix_four<const OTHER: i32>(self, one: __m128i, other: __m128i) -> __m128i {
            _mm_blend_epi32::<OTHER>(one, other)
        }
        fn minus_four(self, one: __m128i, other: __m128i) -> __m128i { _mm_sub_epi32(one, other) }
        fn times_four(self, one: __m128i, other: __m128i) -> __m128i { _mm_mullo_epi32(one, other) }
        fn times_long(self, one: __m128i, other: __m128i) -> __m256i {
            _mm256_mul_epi32(_mm256_cvtepi32_epi64(one), _mm256_cvtepi32_epi64(other))
        }
        fn no_long(self) -> __m256i { _mm256_setzero_si256() }
        fn plus_long(self, one: __m256i, other: __m256i) -> __m256i { _mm256_add_epi64(one, other) }
        fn long_array(self, integers: __m256i) -> [i64; 4] { transmute(integers) }
    }
}

impl Columns<i16> for Avx2 {
    type Column = __m256i;
    type Boxed = __m128i;
    type Corner = __m128i;

    #[inline(always)]
    fn rows_of(self, mask: __m256i) -> __m256i {
        mask
    }

    instructions! {
        fn column(self, coordinates: &[i16; LANES]) -> __m256i { transmute(*coordinates) }
        fn column_array(self, coordinates: __m256i) -> [i16; LANES] { transmute(coordinates) }
        fn every(self, coordinate: i16) -> __m256i { _mm256_set1_epi16(coordinate) }
        fn plus(self, one: __m256i, other: __m256i) -> __m256i { _mm256_add_epi16(one, other) }
        fn minus(self, one: __m256i, other: __m256i) -> __m256i { _mm256_sub_epi16(one, other) }
        fn lesser(self, one: __m256i, other: __m256i) -> __m256i { _mm256_min_epi16(one, other) }
        fn greater(self, one: __m256i, other: __m256i) -> __m256i { _mm256_max_epi16(one, other) }
        fn is_above(self, one: __m256i, other: __m256i) -> __m256i { _mm256_cmpgt_epi16(one, other) }
        fn both(self, one: __m256i, other: __m256i) -> __m256i { _mm256_and_si256(one, other) }
        fn but(self, mask: __m256i, not: __m256i) -> __m256i { _mm256_andnot_si256(not, mask) }
        fn select(self, mask: __m256i, one: __m256i, other: __m256i) -> __m256i {
            _mm256_blendv_epi8(other, one, mask)
        }
        fn is_any(self, mask: __m256i) -> bool { _mm256_testz_si256(mask, mask) == 0 }
        fn bits(self, mask: __m256i) -> u16 {
            let (low, high) = (_mm256_castsi256_si128(mask), _mm256_extracti128_si256::<1>(mask));
            let [low, high, ..] = _mm_movemask_epi8(_mm_packs_epi16(low, high)).to_le_bytes();
            u16::from_le_bytes([low, high])
        }
        fn next(self, column: __m256i, last: __m256i) -> __m256i {
            let above = _mm256_permute2x128_si256::<0x21>(column, last);
            _mm256_alignr_epi8::<2>(above, column)
        }
        fn compress(self, to: &mut [i16], column: __m256i, kept: u16) -> usize {
            let [low, high] = kept.to_le_bytes();
            let middle = low.count_ones() as usize;
            let first = self.pack_half(_mm256_castsi256_si128(column), low);
            let second = self.pack_half(_mm256_extracti128_si256::<1>(column), high);
            to[..8].copy_from_slice(&first);
            to[middle..middle + 8].copy_from_slice(&second);
            middle + high.count_ones() as usize
        }

        fn fractions(self, parts: __m256i, whole: u32) -> __m256i {
            let shift = whole.leading_zeros().cast_signed() - 16;
            _mm256_sll_epi16(parts, _mm_cvtsi32_si128(shift))
        }
        fn times_fractions(self, one: __m256i, other: __m256i) -> __m256i { _mm256_mulhi_epu16(one, other) }
        fn shift_fractions<const SHIFT: i32>(self, fractions: __m256i) -> __m256i {
            _mm256_srli_epi16::<SHIFT>(fractions)
        }

        fn boxed(self, lanes: &[i16; 8]) -> __m128i { transmute(*lanes) }
        fn box_array(self, boxed: __m128i) -> [i16; 8] { transmute(boxed) }
        fn common_box(self, one: __m128i, other: __m128i) -> __m128i { _mm_max_epi16(one, other) }
        fn contains(self, outer: __m128i, inner: __m128i) -> bool {
            let beyond = _mm_cmpgt_epi16(outer, inner);
            _mm_testz_si128(beyond, beyond) == 1
        }
        fn box_is_above(self, one: __m128i, other: __m128i) -> __m128i { _mm_cmpgt_epi16(one, other) }
        fn box_minus(self, one: __m128i, other: __m128i) -> __m128i { _mm_sub_epi16(one, other) }
        fn spread<const LANE: usize>(self, boxed: __m128i) -> __m256i {
            let bytes = transmute::<[u8; 16], __m128i>(const { spread_bytes(LANE) });
            _mm256_shuffle_epi8(_mm256_broadcastsi128_si256(boxed), _mm256_broadcastsi128_si256(bytes))
        }
        fn halves(self, boxed: __m128i) -> [__m128i; 2] { [boxed, _mm_srli_si128::<8>(boxed)] }
        fn joined(self, [low, high]: [__m128i; 2]) -> __m128i { _mm_unpacklo_epi64(low, high) }

        fn every_corner(self, coordinate: i16) -> __m128i { _mm_set1_epi16(coordinate) }
        fn corner_minus(self, one: __m128i, other: __m128i) -> __m128i { _mm_subs_epi16(one, other) }
        fn lesser_corner(self, one: __m128i, other: __m128i) -> __m128i { _mm_min_epi16(one, other) }
        fn greater_corner(self, one: __m128i, other: __m128i) -> __m128i { _mm_max_epi16(one, other) }
        fn select_corner(self, mask: __m128i, one: __m128i, other: __m128i) -> __m128i {
            _mm_blendv_epi8(other, one, mask)
        }
        fn corners(self, [x, y, z]: [__m256i; 3]) -> [__m128i; LANES] {
            let zero = _mm256_setzero_si256();
            let (xy, z0) = (_mm256_unpacklo_epi16(x, y), _mm256_unpacklo_epi16(z, zero));
            let (xy_high, z0_high) = (_mm256_unpackhi_epi16(x, y), _mm256_unpackhi_epi16(z, zero));
            // Two corners in each half: 0 1 | 8 9, then 2 3 | 10 11, and so on.
            let pairs = [
                _mm256_unpacklo_epi32(xy, z0),
                _mm256_unpackhi_epi32(xy, z0),
                _mm256_unpacklo_epi32(xy_high, z0_high),
                _mm256_unpackhi_epi32(xy_high, z0_high),
            ];
            let mut corners = [_mm_setzero_si128(); LANES];
            let mut number = 0;
            while number < 4 {
                let (low, high) = (
                    _mm256_castsi256_si128(pairs[number]),
                    _mm256_extracti128_si256::<1>(pairs[number]),
                );
                corners[2 * number] = low;
                corners[2 * number + 1] = _mm_unpackhi_epi64(low, low);
                corners[2 * number + 8] = high;
                corners[2 * number + 9] = _mm_unpackhi_epi64(high, high);
                number += 1;
            }
            corners
        }
        fn columns(self, corners: &[__m128i; LANES]) -> [__m256i; 3] {
            let mut eights = [[_mm_setzero_si128(); 3]; 2];
            let mut number = 0;
            while number < 2 {
                let mut fours = [[_mm_setzero_si128(); 2]; 2];
                let mut four = 0;
                while four < 2 {
                    let first = 8 * number + 4 * four;
                    let one = _mm_unpacklo_epi16(corners[first], corners[first + 1]);
                    let other = _mm_unpacklo_epi16(corners[first + 2], corners[first + 3]);
                    // x x x x y y y y, and z z z z
                    fours[four] = [_mm_unpacklo_epi32(one, other), _mm_unpackhi_epi32(one, other)];
                    four += 1;
                }
                eights[number] = [
                    _mm_unpacklo_epi64(fours[0][0], fours[1][0]),
                    _mm_unpackhi_epi64(fours[0][0], fours[1][0]),
                    _mm_unpacklo_epi64(fours[0][1], fours[1][1]),
                ];
                number += 1;
            }
            [
                _mm256_set_m128i(eights[1][0], eights[0][0]),
                _mm256_set_m128i(eights[1][1], eights[0][1]),
                _mm256_set_m128i(eights[1][2], eights[0][2]),
            ]
        }
    }
}

impl Columns<i32> for Avx2 {
    /// The first eight lanes, then the last.
    type Column = [__m256i; 2];
    type Boxed = __m256i;
    type Corner = __m128i;

    #[inline(always)]
    fn bits(self, [low, high]: [__m256i; 2]) -> u16 {
        u16::from_le_bytes([self.bits_of_eight(low), self.bits_of_eight(high)])
    }

    instructions! {
        fn column(self, coordinates: &[i32; LANES]) -> [__m256i; 2] { transmute(*coordinates) }
        fn column_array(self, coordinates: [__m256i; 2]) -> [i32; LANES] { transmute(coordinates) }
        fn every(self, coordinate: i32) -> [__m256i; 2] { [_mm256_set1_epi32(coordinate); 2] }
        fn plus(self, [a, b]: [__m256i; 2], [c, d]: [__m256i; 2]) -> [__m256i; 2] {
            [_mm256_add_epi32(a, c), _mm256_add_epi32(b, d)]
        }
        fn minus(self, [a, b]: [__m256i; 2], [c, d]: [__m256i; 2]) -> [__m256i; 2] {
            [_mm256_sub_epi32(a, c), _mm256_sub_epi32(b, d)]
        }
        fn lesser(self, [a, b]: [__m256i; 2], [c, d]: [__m256i; 2]) -> [__m256i; 2] {
            [_mm256_min_epi32(a, c), _mm256_min_epi32(b, d)]
        }
        fn greater(self, [a, b]: [__m256i; 2], [c, d]: [__m256i; 2]) -> [__m256i; 2] {
            [_mm256_max_epi32(a, c), _mm256_max_epi32(b, d)]
        }
        fn is_above(self, [a, b]: [__m256i; 2], [c, d]: [__m256i; 2]) -> [__m256i; 2] {
            [_mm256_cmpgt_epi32(a, c), _mm256_cmpgt_epi32(b, d)]
        }
        fn both(self, [a, b]: [__m256i; 2], [c, d]: [__m256i; 2]) -> [__m256i; 2] {
            [_mm256_and_si256(a, c), _mm256_and_si256(b, d)]
        }
        fn but(self, [a, b]: [__m256i; 2], [c, d]: [__m256i; 2]) -> [__m256i; 2] {
            [_mm256_andnot_si256(c, a), _mm256_andnot_si256(d, b)]
        }
        fn select(self, mask: [__m256i; 2], one: [__m256i; 2], other: [__m256i; 2]) -> [__m256i; 2] {
            [
                _mm256_blendv_epi8(other[0], one[0], mask[0]),
                _mm256_blendv_epi8(other[1], one[1], mask[1]),
            ]
        }
        fn is_any(self, [a, b]: [__m256i; 2]) -> bool {
            let any = _mm256_or_si256(a, b);
            _mm256_testz_si256(any, any) == 0
        }
        fn rows_of(self, [a, b]: [__m256i; 2]) -> __m256i {
            _mm256_permute4x64_epi64::<0b11_01_10_00>(_mm256_packs_epi32(a, b))
        }
        fn next(self, [a, b]: [__m256i; 2], [last, _]: [__m256i; 2]) -> [__m256i; 2] {
            [
                _mm256_alignr_epi8::<4>(_mm256_permute2x128_si256::<0x21>(a, b), a),
                _mm256_alignr_epi8::<4>(_mm256_permute2x128_si256::<0x21>(b, last), b),
            ]
        }
        fn compress(self, to: &mut [i32], [a, b]: [__m256i; 2], kept: u16) -> usize {
            let [low, high] = kept.to_le_bytes();
            let middle = low.count_ones() as usize;
            let first = transmute::<__m256i, [i32; 8]>(self.pack_eight(a, low));
            let second = transmute::<__m256i, [i32; 8]>(self.pack_eight(b, high));
            to[..8].copy_from_slice(&first);
            to[middle..middle + 8].copy_from_slice(&second);
            middle + high.count_ones() as usize
        }

        fn fractions(self, [a, b]: [__m256i; 2], whole: u32) -> [__m256i; 2] {
            let shift = _mm_cvtsi32_si128(whole.leading_zeros().cast_signed());
            [
                _mm256_srli_epi32::<16>(_mm256_sll_epi32(a, shift)),
                _mm256_srli_epi32::<16>(_mm256_sll_epi32(b, shift)),
            ]
        }
        fn times_fractions(self, [a, b]: [__m256i; 2], [c, d]: [__m256i; 2]) -> [__m256i; 2] {
            [
                _mm256_srli_epi32::<16>(_mm256_mullo_epi32(a, c)),
                _mm256_srli_epi32::<16>(_mm256_mullo_epi32(b, d)),
            ]
        }
        fn shift_fractions<const SHIFT: i32>(self, [a, b]: [__m256i; 2]) -> [__m256i; 2] {
            [_mm256_srli_epi32::<SHIFT>(a), _mm256_srli_epi32::<SHIFT>(b)]
        }

        fn boxed(self, lanes: &[i32; 8]) -> __m256i { transmute(*lanes) }
        fn box_array(self, boxed: __m256i) -> [i32; 8] { transmute(boxed) }
        fn common_box(self, one: __m256i, other: __m256i) -> __m256i { _mm256_max_epi32(one, other) }
        fn contains(self, outer: __m256i, inner: __m256i) -> bool {
            let beyond = _mm256_cmpgt_epi32(outer, inner);
            _mm256_testz_si256(beyond, beyond) == 1
        }
        fn box_is_above(self, one: __m256i, other: __m256i) -> __m256i { _mm256_cmpgt_epi32(one, other) }
        fn box_minus(self, one: __m256i, other: __m256i) -> __m256i { _mm256_sub_epi32(one, other) }
        fn spread<const LANE: usize>(self, boxed: __m256i) -> [__m256i; 2] {
            let lane = transmute::<[i32; WORDS], __m256i>(const { [lane_number(LANE); WORDS] });
            [_mm256_permutevar8x32_epi32(boxed, lane); 2]
        }
        fn halves(self, boxed: __m256i) -> [__m128i; 2] {
            [_mm256_castsi256_si128(boxed), _mm256_extracti128_si256::<1>(boxed)]
        }
        fn joined(self, [low, high]: [__m128i; 2]) -> __m256i { _mm256_set_m128i(high, low) }

        fn every_corner(self, coordinate: i32) -> __m128i { _mm_set1_epi32(coordinate) }
        // All coordinates are far from the ends of 32 bits.
        fn corner_minus(self, one: __m128i, other: __m128i) -> __m128i { _mm_sub_epi32(one, other) }
        fn lesser_corner(self, one: __m128i, other: __m128i) -> __m128i { _mm_min_epi32(one, other) }
        fn greater_corner(self, one: __m128i, other: __m128i) -> __m128i { _mm_max_epi32(one, other) }
        fn select_corner(self, mask: __m128i, one: __m128i, other: __m128i) -> __m128i {
            _mm_blendv_epi8(other, one, mask)
        }
        fn corners(self, [x, y, z]: [[__m256i; 2]; 3]) -> [__m128i; LANES] {
            let [x, y, z] = [
                transmute::<[__m256i; 2], [__m128i; 4]>(x),
                transmute::<[__m256i; 2], [__m128i; 4]>(y),
                transmute::<[__m256i; 2], [__m128i; 4]>(z),
            ];
            let zero = _mm_setzero_si128();
            transmute::<[[__m128i; 4]; 4], [__m128i; LANES]>([
                self.turn([x[0], y[0], z[0], zero]),
                self.turn([x[1], y[1], z[1], zero]),
                self.turn([x[2], y[2], z[2], zero]),
                self.turn([x[3], y[3], z[3], zero]),
            ])
        }
        fn columns(self, corners: &[__m128i; LANES]) -> [[__m256i; 2]; 3] {
            let fours = transmute::<[__m128i; LANES], [[__m128i; 4]; 4]>(*corners);
            let fours = [
                self.turn(fours[0]),
                self.turn(fours[1]),
                self.turn(fours[2]),
                self.turn(fours[3]),
            ];
            let mut columns = [[_mm256_setzero_si256(); 2]; 3];
            let mut axis = 0;
            while axis < 3 {
                columns[axis] = [
                    _mm256_set_m128i(fours[1][axis], fours[0][axis]),
                    _mm256_set_m128i(fours[3][axis], fours[2][axis]),
                ];
                axis += 1;
            }
            columns
        }
    }
}
