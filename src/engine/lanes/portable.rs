//! The operations in plain loops over arrays, of which the compiler makes what vectors it can.

use std::array::from_fn;

use super::{Columns, Coordinate, LANES, Lanes, Task, WORDS};

/// The right to the instructions that everything is compiled for.
#[derive(Clone, Copy, Debug)]
pub(in crate::engine) struct Portable;

#[inline(always)]
fn zip<T: Copy, U, const N: usize>(
    one: [T; N],
    other: [T; N],
    operation: impl Fn(T, T) -> U,
) -> [U; N] {
    from_fn(|lane| operation(one[lane], other[lane]))
}

/// The lanes of `other` whose bits are set, those of `one` elsewhere.
#[inline(always)]
fn mix<T: Copy, const N: usize>(bits: i32, one: [T; N], other: [T; N]) -> [T; N] {
    from_fn(|lane| {
        if bits >> lane & 1 == 1 {
            other[lane]
        } else {
            one[lane]
        }
    })
}

#[inline(always)]
fn compress<T: Copy>(to: &mut [T], lanes: &[T], kept: u16) -> usize {
    let mut count = 0;
    for (lane, value) in lanes.iter().enumerate() {
        if kept >> lane & 1 == 1 {
            to[count] = *value;
            count += 1;
        }
    }
    count
}

#[inline(always)]
fn mask<C: Coordinate>(is_set: bool) -> C {
    if is_set { C::ONES } else { C::ZERO }
}

impl Lanes for Portable {
    type Rows = [u16; LANES];
    type Eight = [i32; WORDS];
    type Four = [i32; 4];
    type Long = [i64; 4];

    #[inline(never)]
    fn run<T: Task>(self, task: T) -> T::Output {
        task.run()
    }

    #[inline(always)]
    fn rows(self, rows: [u16; LANES]) -> Self::Rows {
        rows
    }

    #[inline(always)]
    fn rows_array(self, rows: Self::Rows) -> [u16; LANES] {
        rows
    }

    #[inline(always)]
    fn rows_words(self, rows: Self::Rows) -> [u64; LANES / 4] {
        from_fn(|word| {
            let row = |index: usize| u64::from(rows[4 * word + index]) << (16 * index);
            row(0) | row(1) | row(2) | row(3)
        })
    }

    #[inline(always)]
    fn every_row(self, row: u16) -> Self::Rows {
        [row; LANES]
    }

    #[inline(always)]
    fn and(self, one: Self::Rows, other: Self::Rows) -> Self::Rows {
        zip(one, other, |one, other| one & other)
    }

    #[inline(always)]
    fn or(self, one: Self::Rows, other: Self::Rows) -> Self::Rows {
        zip(one, other, |one, other| one | other)
    }

    #[inline(always)]
    fn xor(self, one: Self::Rows, other: Self::Rows) -> Self::Rows {
        zip(one, other, |one, other| one ^ other)
    }

    #[inline(always)]
    fn without(self, one: Self::Rows, other: Self::Rows) -> Self::Rows {
        zip(one, other, |one, other| one & !other)
    }

    #[inline(always)]
    fn is_empty(self, rows: Self::Rows) -> bool {
        rows.iter().fold(0, |all, row| all | row) == 0
    }

    #[inline(always)]
    fn next_row(self, rows: Self::Rows) -> Self::Rows {
        from_fn(|row| rows.get(row + 1).copied().unwrap_or(0))
    }

    #[inline(always)]
    fn next_column(self, rows: Self::Rows) -> Self::Rows {
        from_fn(|row| rows[row] >> 1)
    }

    #[inline(always)]
    fn eight(self, integers: &[i32; WORDS]) -> Self::Eight {
        *integers
    }

    #[inline(always)]
    fn eight_array(self, integers: Self::Eight) -> [i32; WORDS] {
        integers
    }

    #[inline(always)]
    fn every_eight(self, integer: i32) -> Self::Eight {
        [integer; WORDS]
    }

    #[inline(always)]
    fn mix_eight<const OTHER: i32>(self, one: Self::Eight, other: Self::Eight) -> Self::Eight {
        mix(OTHER, one, other)
    }

    #[inline(always)]
    fn plus_eight(self, one: Self::Eight, other: Self::Eight) -> Self::Eight {
        zip(one, other, i32::wrapping_add)
    }

    #[inline(always)]
    fn minus_eight(self, one: Self::Eight, other: Self::Eight) -> Self::Eight {
        zip(one, other, i32::wrapping_sub)
    }

    #[inline(always)]
    fn times_eight(self, one: Self::Eight, other: Self::Eight) -> Self::Eight {
        zip(one, other, i32::wrapping_mul)
    }

    #[inline(always)]
    fn at_most(self, integers: [Self::Eight; 3], limits: [Self::Eight; 3]) -> u8 {
        let mut kept = [0; WORDS];
        for lane in 0..WORDS {
            let beyond = |axis: usize| {
                integers[axis][lane].cast_unsigned() > limits[axis][lane].cast_unsigned()
            };
            kept[lane] = u8::from(!(beyond(0) | beyond(1) | beyond(2))) << lane;
        }
        kept.iter().fold(0, |bits, bit| bits | bit)
    }

    #[inline(always)]
    fn compress_eight(self, to: &mut [i32; WORDS], integers: Self::Eight, kept: u8) {
        compress(to, &integers, kept.into());
    }

    #[inline(always)]
    fn four(self, integers: &[i32; 4]) -> Self::Four {
        *integers
    }

    #[inline(always)]
    fn every_four(self, integer: i32) -> Self::Four {
        [integer; 4]
    }

    #[inline(always)]
    fn mix_four<const OTHER: i32>(self, one: Self::Four, other: Self::Four) -> Self::Four {
        mix(OTHER, one, other)
    }

    #[inline(always)]
    fn minus_four(self, one: Self::Four, other: Self::Four) -> Self::Four {
        zip(one, other, i32::wrapping_sub)
    }

    #[inline(always)]
    fn times_four(self, one: Self::Four, other: Self::Four) -> Self::Four {
        zip(one, other, i32::wrapping_mul)
    }

    #[inline(always)]
    fn times_long(self, one: Self::Four, other: Self::Four) -> Self::Long {
        zip(one, other, |one, other| i64::from(one) * i64::from(other))
    }

    #[inline(always)]
    fn no_long(self) -> Self::Long {
        [0; 4]
    }

    #[inline(always)]
    fn plus_long(self, one: Self::Long, other: Self::Long) -> Self::Long {
        zip(one, other, i64::wrapping_add)
    }

    #[inline(always)]
    fn long_array(self, integers: Self::Long) -> [i64; 4] {
        integers
    }
}

impl<C: Coordinate> Columns<C> for Portable {
    type Column = [C; LANES];
    type Boxed = [C; 8];
    type Corner = [C; 4];

    #[inline(always)]
    fn column(self, coordinates: &[C; LANES]) -> Self::Column {
        *coordinates
    }

    #[inline(always)]
    fn column_array(self, coordinates: Self::Column) -> [C; LANES] {
        coordinates
    }

    #[inline(always)]
    fn every(self, coordinate: C) -> Self::Column {
        [coordinate; LANES]
    }

    #[inline(always)]
    fn plus(self, one: Self::Column, other: Self::Column) -> Self::Column {
        zip(one, other, C::plus)
    }

    #[inline(always)]
    fn minus(self, one: Self::Column, other: Self::Column) -> Self::Column {
        zip(one, other, C::minus)
    }

    #[inline(always)]
    fn lesser(self, one: Self::Column, other: Self::Column) -> Self::Column {
        zip(one, other, C::min)
    }

    #[inline(always)]
    fn greater(self, one: Self::Column, other: Self::Column) -> Self::Column {
        zip(one, other, C::max)
    }

    #[inline(always)]
    fn is_above(self, one: Self::Column, other: Self::Column) -> Self::Column {
        zip(one, other, |one, other| mask(one > other))
    }

    #[inline(always)]
    fn both(self, one: Self::Column, other: Self::Column) -> Self::Column {
        zip(one, other, |one, other| one & other)
    }

    #[inline(always)]
    fn but(self, mask: Self::Column, not: Self::Column) -> Self::Column {
        zip(mask, not, |mask, not| mask & !not)
    }

    #[inline(always)]
    fn select(self, mask: Self::Column, one: Self::Column, other: Self::Column) -> Self::Column {
        from_fn(|lane| one[lane] & mask[lane] | other[lane] & !mask[lane])
    }

    #[inline(always)]
    fn is_any(self, mask: Self::Column) -> bool {
        mask.iter().any(|lane| *lane != C::ZERO)
    }

    #[inline(always)]
    fn bits(self, mask: Self::Column) -> u16 {
        let mut bits = 0;
        for (lane, set) in mask.iter().enumerate() {
            bits |= u16::from(*set != C::ZERO) << lane;
        }
        bits
    }

    #[inline(always)]
    fn rows_of(self, mask: Self::Column) -> Self::Rows {
        from_fn(|lane| if mask[lane] == C::ZERO { 0 } else { u16::MAX })
    }

    #[inline(always)]
    fn next(self, column: Self::Column, last: Self::Column) -> Self::Column {
        from_fn(|lane| column.get(lane + 1).copied().unwrap_or(last[0]))
    }

    #[inline(always)]
    fn compress(self, to: &mut [C], column: Self::Column, kept: u16) -> usize {
        compress(to, &column, kept)
    }

    #[inline(always)]
    fn fractions(self, parts: Self::Column, whole: u32) -> Self::Column {
        let shift = whole.leading_zeros();
        from_fn(|lane| {
            let part: i32 = parts[lane].into();
            let fraction = part.cast_unsigned() << shift >> 16;
            C::of_fraction(u16::try_from(fraction).expect("sixteen bits are left"))
        })
    }

    #[inline(always)]
    fn times_fractions(self, one: Self::Column, other: Self::Column) -> Self::Column {
        zip(one, other, |one, other| {
            let product = u32::from(one.fraction()) * u32::from(other.fraction());
            C::of_fraction(u16::try_from(product >> 16).expect("sixteen bits are left"))
        })
    }

    #[inline(always)]
    fn shift_fractions<const SHIFT: i32>(self, fractions: Self::Column) -> Self::Column {
        from_fn(|lane| C::of_fraction(fractions[lane].fraction() >> SHIFT))
    }

    #[inline(always)]
    fn boxed(self, lanes: &[C; 8]) -> Self::Boxed {
        *lanes
    }

    #[inline(always)]
    fn box_array(self, boxed: Self::Boxed) -> [C; 8] {
        boxed
    }

    #[inline(always)]
    fn common_box(self, one: Self::Boxed, other: Self::Boxed) -> Self::Boxed {
        zip(one, other, C::max)
    }

    #[inline(always)]
    fn contains(self, outer: Self::Boxed, inner: Self::Boxed) -> bool {
        outer
            .iter()
            .zip(&inner)
            .all(|(outer, inner)| outer <= inner)
    }

    #[inline(always)]
    fn box_is_above(self, one: Self::Boxed, other: Self::Boxed) -> Self::Boxed {
        zip(one, other, |one, other| mask(one > other))
    }

    #[inline(always)]
    fn box_minus(self, one: Self::Boxed, other: Self::Boxed) -> Self::Boxed {
        zip(one, other, C::minus)
    }

    #[inline(always)]
    fn spread<const LANE: usize>(self, boxed: Self::Boxed) -> Self::Column {
        [boxed[LANE]; LANES]
    }

    #[inline(always)]
    fn halves(self, boxed: Self::Boxed) -> [Self::Corner; 2] {
        [from_fn(|lane| boxed[lane]), from_fn(|lane| boxed[4 + lane])]
    }

    #[inline(always)]
    fn joined(self, [low, high]: [Self::Corner; 2]) -> Self::Boxed {
        from_fn(|lane| if lane < 4 { low[lane] } else { high[lane - 4] })
    }

    #[inline(always)]
    fn every_corner(self, coordinate: C) -> Self::Corner {
        [coordinate; 4]
    }

    #[inline(always)]
    fn corner_minus(self, one: Self::Corner, other: Self::Corner) -> Self::Corner {
        zip(one, other, C::minus_saturated)
    }

    #[inline(always)]
    fn lesser_corner(self, one: Self::Corner, other: Self::Corner) -> Self::Corner {
        zip(one, other, C::min)
    }

    #[inline(always)]
    fn greater_corner(self, one: Self::Corner, other: Self::Corner) -> Self::Corner {
        zip(one, other, C::max)
    }

    #[inline(always)]
    fn select_corner(
        self,
        mask: Self::Corner,
        one: Self::Corner,
        other: Self::Corner,
    ) -> Self::Corner {
        from_fn(|lane| one[lane] & mask[lane] | other[lane] & !mask[lane])
    }

    #[inline(always)]
    fn corners(self, [x, y, z]: [Self::Column; 3]) -> [Self::Corner; LANES] {
        from_fn(|lane| [x[lane], y[lane], z[lane], C::ZERO])
    }

    #[inline(always)]
    fn columns(self, corners: &[Self::Corner; LANES]) -> [Self::Column; 3] {
        from_fn(|axis| from_fn(|lane| corners[lane][axis]))
    }
}
