//! Flags in and measures out: every flag's values rounded exactly, added up in integers.
//!
//! A *flag* is a vertex, a line through it and a side of a facet at the line. Its values (length, area, volume, moments: see
//! [`Flag::rounded`](super::exact::Flag::rounded)) are real numbers that depend on the point and the directions alone. They are
//! rounded to a unit half away from zero, so `r(-x) = -r(x)`.
//!
//! # Proof that totals are a function of the set
//! Let `e` be an interval of a line on which the union's boundary has one sheet. Its flags are `(A, t)` at the tail and `(B, -t)` at the
//! head. Every value is odd in `t`: the length is, and the others are the product of `P.t` with factors in which `t` appears to even
//! powers (`m` is turned towards the facet, whatever `t`). Cutting `e` at a point `C` adds the flags `(C, -t)` and `(C, t)`,
//! whose rounded values add up to 0, provided that both are rounded to the same unit: it depends on the point alone. So the sum
//! over the intervals of any subdivision is the sum over the maximal ones, and a difference of two unions, computed on the
//! intervals where they differ, is exactly the difference of their sums. Nothing else enters: no order, no history.
//!
//! # Units
//! Length `2^-20`, area `2^-16`. Volume and moments, of degree `g = 3, 4, 5`, have the unit `2^max(-4, g k - (80, 78, 74))`, where `k`, the
//! *size class* of the point, is the least with all coordinates below `2^k` in size: beyond `k = 25`, `18`, `14` the fixed point follows
//! the magnitude, so that a double-double still decides nearly always.
//!
//! # Proof of the bounds
//! Let `h = 2^-102` bound the relative error of an operation (`double.rs`), `B = 2^k` the coordinates, `|P| <= sqrt(3) B`. Terms in `h^2` are
//! far below the slack of each bound and left out. `t`, `n`, `d` are exact; the point is two conversions and a division: `3 h B`.
//! `T = t.t` is a sum of positive terms: `3 h`, `N = n.n`: `3 h`; `1/T`: `4 h`; `1/sqrt(N)`: `3.5 h`; `1/sqrt(T)`: `3.5 h`.
//! `P.t`: each term `(3 + 1) h B |t_i|`, two sums: `6 h B |t|_1 <= 11 h B |t|`. `m = n x t`: `2 h |n||t|` a component (Cauchy); `P.m`: by the same
//! count `(3 + 1 + 2) sqrt(3) + 3 * 2 <= 17 h B |m|`. With `a = P.t/|t|`, `b = P.m/|m|`, `c = P.n/|n|`, each at most `sqrt(3) B`:
//!
//! | value | error, in `h B^g` | bound used |
//! |---|---|---|
//! | length `a` | `11 + 1.74 (3.5 + 1) < 19` | `2^5` |
//! | area `a b` | `1.74 (11 + 17) + 3 (4 + 3.5 + 1 + 2) < 81` | `2^7` |
//! | volume `a b c` | `1.74^2 (11 + 17) + 5.2 (4 + 4 + 2 + 2) < 148` | `2^8` |
//! | foot on the plane `F` | `1.74 (4 + 2) < 11` | |
//! | foot on the line `G = P - (P.t) t / T` | `3 + 11 + 1.74 (4 + 2) + 2 * 1.74 < 28` | |
//! | `S = F + G + P`, at most `5.2 B` | `11 + 28 + 3 + 2 * 5.2 < 53` | |
//! | first moment `V S` | `5.2 * 148 + 5.2 * 53 + 27 < 1074` | `2^11` |
//! | `Q = FF + GG + PP + SS`, at most `36 B^2` | `2 (1.74 (11 + 28 + 3) + 5.2 * 53) + 4 * 36 < 842` | |
//! | second moment `V Q` | `36 * 148 + 5.2 * 842 + 187 < 9894` | `2^14` |
//!
//! A value in its unit is then below `2^86`, and its error at most `2^(14 - 102 + 74) = 2^-14` (the second moment of a far point); a
//! value closer than that to a tie is rounded again from the exact flag in big integers.
//! The `paranoid` feature compares every rounding with the exact one.

#![expect(
    clippy::float_arithmetic,
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    reason = "floats certify roundings and are never a result"
)]
#![expect(
    clippy::inline_always,
    reason = "a body is compiled into each of its two callers, with their instructions"
)]

use ethnum::I256;

use crate::geometry::convex::Plane;

use super::clip::{Arithmetic, Line, Place, Vertex};
use super::double::{Doubles, LANES, cross, dot};
use super::exact::{Flag, Homogeneous, Quantity};
use super::lanes::twice;
use super::measures::{AREA_UNIT, ErrorMax, LENGTH_UNIT, Measures, VOLUME_UNIT};
use super::sector::Sheets;

/// Relative error of one operation: `2^-102`.
const OPERATION: f64 = 1.0 / (1_u128 << 102) as f64;

/// Size classes: coordinates below `2^0` to `2^31`.
const CLASSES: usize = 32;

/// The quantities of a flag, in the order in which they are kept.
const QUANTITIES: [Quantity; 12] = [
    Quantity::Length,
    Quantity::Area,
    Quantity::Volume,
    Quantity::First(0),
    Quantity::First(1),
    Quantity::First(2),
    Quantity::Second(0, 0),
    Quantity::Second(1, 1),
    Quantity::Second(2, 2),
    Quantity::Second(0, 1),
    Quantity::Second(1, 2),
    Quantity::Second(2, 0),
];

/// Exponent of the unit of a quantity at a point of a size class.
fn unit(quantity: Quantity, class: u8) -> i32 {
    let class = i32::from(class);
    match quantity {
        Quantity::Length => LENGTH_UNIT,
        Quantity::Area => AREA_UNIT,
        Quantity::Volume => VOLUME_UNIT.max(3 * class - 80),
        Quantity::First(_) => VOLUME_UNIT.max(4 * class - 78),
        Quantity::Second(..) => VOLUME_UNIT.max(5 * class - 74),
    }
}

/// Bound of the error of a quantity in its unit, at a point of a size class.
fn error(quantity: Quantity, class: u8) -> f64 {
    let (power, bits) = match quantity {
        Quantity::Length => (1, 5),
        Quantity::Area => (2, 7),
        Quantity::Volume => (3, 8),
        Quantity::First(_) => (4, 11),
        Quantity::Second(..) => (5, 14),
    };
    let exponent = power * i32::from(class) + bits - unit(quantity, class);
    // Half an ulp of 1 for the last difference.
    OPERATION * power_of_two(exponent) + power_of_two(-52)
}

/// `2^exponent` for a normal float.
#[inline(always)]
const fn power_of_two(exponent: i32) -> f64 {
    f64::from_bits(((1023 + exponent).cast_unsigned() as u64) << 52)
}

/// A point, ready for flags.
#[derive(Clone, Copy, Debug)]
struct Point {
    place: Homogeneous,
    high: [f64; 3],
    low: [f64; 3],
    class: u8,
}

/// A sheet along an interval: two flags.
#[derive(Clone, Copy, Debug)]
struct Entry {
    /// Index of the tail; the head is the next.
    tail: u32,
    plane: Plane,
    normal: [f64; 3],
    direction: [i128; 3],
    /// 1 to the left of the line, -1 to the right.
    side: i8,
    weight: i8,
    kind: u8,
}

/// What each size class adds up to, in its units.
type Sums = [[i128; QUANTITIES.len() - 2]; CLASSES];

/// Collects the sheets of one marginal and adds up their flags.
#[derive(Debug)]
pub(super) struct Ledger {
    arithmetic: Arithmetic,
    entries: Vec<Entry>,
    points: Vec<Point>,
    errors: [[f64; QUANTITIES.len()]; CLASSES],
    scales: [[f64; QUANTITIES.len()]; CLASSES],
    /// Flags rounded so far, and the greatest size class among their points.
    flags: u64,
    class_max: u8,
}

impl Ledger {
    pub(super) fn new(arithmetic: Arithmetic) -> Self {
        let mut errors = [[0.0; QUANTITIES.len()]; CLASSES];
        let mut scales = errors;
        for class in 0..CLASSES {
            for (index, quantity) in QUANTITIES.into_iter().enumerate() {
                errors[class][index] = error(quantity, class as u8);
                scales[class][index] = power_of_two(-unit(quantity, class as u8));
            }
        }
        Self {
            arithmetic,
            entries: Vec::new(),
            points: Vec::new(),
            errors,
            scales,
            flags: 0,
            class_max: 0,
        }
    }

    /// Whether nothing was posted that changes the union.
    pub(super) fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Adds the sheets along an interval, so many times.
    pub(super) fn post(&mut self, line: &Line, ends: &[Vertex; 2], sheets: &Sheets, weight: i8) {
        if sheets.sheets.is_empty() {
            return;
        }
        let tail = u32::try_from(self.points.len()).expect("far fewer than 2^32 points");
        self.points.extend(ends.map(|end| Point::of(&end)));
        for sheet in &sheets.sheets {
            self.entries.push(Entry {
                tail,
                plane: sheet.face.plane,
                normal: sheet.face.rough.normal,
                direction: line.direction,
                side: sheet.side as i8,
                weight,
                kind: sheets.kind as u8,
            });
        }
    }

    /// Takes some sheets away and adds others along one interval.
    pub(super) fn exchange(
        &mut self,
        line: &Line,
        ends: &[Vertex; 2],
        mut before: Sheets,
        mut after: Sheets,
    ) {
        if before.kind == after.kind {
            // What stays needs no flags.
            before.sheets.retain(|old| {
                let stays = after.sheets.iter().position(|new| new.same(old));
                if let Some(index) = stays {
                    after.sheets.remove(index);
                }
                stays.is_none()
            });
        }
        self.post(line, ends, &before, -1);
        self.post(line, ends, &after, 1);
    }

    /// Adds up everything posted, and forgets it.
    pub(super) fn settle(&mut self) -> Measures {
        let mut measures = Measures::default();
        let mut sums: Box<Sums> = Box::new([[0; QUANTITIES.len() - 2]; CLASSES]);
        self.flags += 2 * self.entries.len() as u64;
        let classes = self.points.iter().map(|point| point.class);
        self.class_max = classes.fold(self.class_max, u8::max);
        for entries in self.entries.chunks(LANES) {
            // Missing lanes repeat the first entry.
            let lane = |index: usize| entries.get(index).unwrap_or(&entries[0]);
            let four = [lane(0), lane(1), lane(2), lane(3)];
            let ends = values(&four, &self.points);
            for (end, values) in ends.iter().enumerate() {
                for (lane, entry) in entries.iter().enumerate() {
                    let point = &self.points[entry.tail as usize + end];
                    let mut rounded = [0; QUANTITIES.len()];
                    for (index, value) in values.iter().enumerate() {
                        rounded[index] =
                            self.round(entry, point, index, value.high[lane], value.low[lane]);
                    }
                    // The head's direction is the opposite one, and a sheet to the right has its foot the other way.
                    let sign = if end == 0 { 1 } else { -1 } * i128::from(entry.weight);
                    measures.edge_length2[usize::from(entry.kind)] -= sign * rounded[0];
                    let sign = sign * i128::from(entry.side);
                    measures.area2 += sign * rounded[1];
                    let sums = &mut sums[usize::from(point.class)];
                    for (sum, rounded) in sums.iter_mut().zip(&rounded[2..]) {
                        *sum += sign * rounded;
                    }
                }
            }
        }
        for (class, sums) in (0_u8..).zip(sums.iter()) {
            if sums.iter().any(|sum| *sum != 0) {
                measures.collect(class, sums);
            }
        }
        self.entries.clear();
        self.points.clear();
        measures
    }

    /// How far off all roundings so far can be together: half a unit for each flag, the units those of the farthest point.
    pub(super) fn error_max(&self) -> ErrorMax {
        let of = |quantity, fixed: i32| {
            let shift = (unit(quantity, self.class_max) - fixed).unsigned_abs();
            (u128::from(self.flags) << shift).div_ceil(2)
        };
        ErrorMax {
            volume6: of(Quantity::Volume, VOLUME_UNIT),
            area2: of(Quantity::Area, AREA_UNIT),
            edge_length2: of(Quantity::Length, LENGTH_UNIT),
            first_moments24: of(Quantity::First(0), VOLUME_UNIT),
            second_moments120: of(Quantity::Second(0, 0), VOLUME_UNIT),
        }
    }

    #[inline]
    fn round(&self, entry: &Entry, point: &Point, index: usize, high: f64, low: f64) -> i128 {
        let class = usize::from(point.class);
        let scale = self.scales[class][index];
        let rounded = nearest(high * scale, low * scale, self.errors[class][index]);
        let exactly = || {
            let flag = Flag {
                point: point.place,
                direction: entry.direction,
                plane: &entry.plane,
            };
            flag.rounded(QUANTITIES[index], unit(QUANTITIES[index], point.class))
        };
        match rounded {
            Some(rounded) if self.arithmetic == Arithmetic::Filtered => {
                #[cfg(feature = "paranoid")]
                assert_eq!(rounded, exactly(), "the rounding's bound holds");
                rounded
            }
            _ => exactly(),
        }
    }
}

impl Measures {
    /// Adds what the points of a size class add up to.
    fn collect(&mut self, class: u8, sums: &[i128; QUANTITIES.len() - 2]) {
        let shift = |quantity| (unit(quantity, class) - VOLUME_UNIT).unsigned_abs();
        let volume = sums[0] << shift(Quantity::Volume);
        self.volume6 = self.volume6.wrapping_add(volume);
        for (moment, sum) in self.first_moments24.iter_mut().zip(&sums[1..4]) {
            *moment += I256::from(*sum) << shift(Quantity::First(0));
        }
        for (moment, sum) in self.second_moments120.iter_mut().zip(&sums[4..]) {
            *moment += I256::from(*sum) << shift(Quantity::Second(0, 0));
        }
    }
}

/// The nearest integer to `high + low`, unless a tie is within the error. Range: below `2^93`.
#[inline]
fn nearest(high: f64, low: f64, error: f64) -> Option<i128> {
    let whole = high.round_ties_even();
    // Exact where `high` has a fraction, and 0 where it has none.
    let rest = (high - whole) + low;
    let more = rest.round_ties_even();
    if (rest - more).abs() >= 0.5 - error {
        return None;
    }
    Some(integer(whole) + i128::from(more as i64))
}

/// A whole float as an integer. Range: below `2^93`.
#[inline]
fn integer(whole: f64) -> i128 {
    const SPLIT: i32 = 45;
    if whole.abs() < power_of_two(62) {
        return i128::from(whole as i64);
    }
    let top = (whole * power_of_two(-SPLIT)) as i64;
    let rest = whole - top as f64 * power_of_two(SPLIT);
    (i128::from(top) << SPLIT) + i128::from(rest as i64)
}

impl Point {
    fn of(vertex: &Vertex) -> Self {
        match vertex.place {
            Place::Lattice(point) => {
                let size = point.map(i32::unsigned_abs).into_iter().max();
                let bits = u32::BITS - size.expect("there are three").leading_zeros();
                Self {
                    place: Homogeneous::lattice(point),
                    high: point.map(f64::from),
                    low: [0.0; 3],
                    class: bits as u8,
                }
            }
            Place::Meeting(_) => {
                let place = vertex.homogeneous();
                let [x, y, z] = place.x.map(double);
                let (w_high, w_low) = double(place.w);
                let over = Doubles {
                    high: [x.0, y.0, z.0, 0.0],
                    low: [x.1, y.1, z.1, 0.0],
                };
                let under = Doubles {
                    high: [w_high; LANES],
                    low: [w_low; LANES],
                };
                let [x, y, z, _] = over.over(under).high;
                let [x_low, y_low, z_low, _] = over.over(under).low;
                let size = x.abs().max(y.abs()).max(z.abs());
                Self {
                    place,
                    high: [x, y, z],
                    low: [x_low, y_low, z_low],
                    class: class_of(size, &place),
                }
            }
        }
    }
}

/// The least `k` with all coordinates below `2^k` in size, given roughly the greatest.
fn class_of(size: f64, place: &Homogeneous) -> u8 {
    let margin = 1.0 + power_of_two(-40);
    let least =
        (0..CLASSES as u32 - 1).find(|bits| size < power_of_two(bits.cast_signed()) * margin);
    let least = least.unwrap_or(CLASSES as u32 - 1);
    let is_sure = size * margin < power_of_two(least.cast_signed());
    let class = if is_sure || !place.reaches(least) {
        least
    } else {
        least + 1
    };
    class as u8
}

/// A wide integer as a double-double, with a relative error of `2^-105` at most.
fn double(value: I256) -> (f64, f64) {
    let size = value.unsigned_abs();
    let bits = 256 - size.leading_zeros();
    let shift = bits.saturating_sub(106);
    let top = (size >> shift).as_u128();
    let scale = power_of_two(shift.cast_signed());
    let high = (top >> 53) as f64 * power_of_two(53);
    let low = (top & ((1 << 53) - 1)) as f64;
    let sum = high + low;
    let rest = low - (sum - high);
    let sign = if value < I256::ZERO { -1.0 } else { 1.0 };
    (sum * scale * sign, rest * scale * sign)
}

/// A direction's component, exactly. Range: below `2^106`.
#[inline]
fn double_of_direction(component: i128) -> (f64, f64) {
    let high = component as f64;
    let low = (component - high as i128) as f64;
    (high, low)
}

/// The values of the quantities, at one end of four entries.
type Values = [Doubles; QUANTITIES.len()];

twice! {
    /// The values of four entries at their tails and at their heads, as if all were to the left of lines that begin there.
    values, values_wide, values_body, (entries: &[&Entry; LANES], points: &[Point]) -> [Values; 2]
}

#[inline(always)]
fn values_body(entries: &[&Entry; LANES], points: &[Point]) -> [Values; 2] {
    let vector = |of: &dyn Fn(&Entry, usize) -> (f64, f64)| {
        [0, 1, 2].map(|axis: usize| {
            let [a, b, c, d] = entries.map(|entry| of(entry, axis));
            Doubles {
                high: [a.0, b.0, c.0, d.0],
                low: [a.1, b.1, c.1, d.1],
            }
        })
    };
    let n = vector(&|entry, axis| (entry.normal[axis], 0.0));
    let t = vector(&|entry, axis| double_of_direction(entry.direction[axis]));
    // P.n = -d, whatever P.
    let [pn, ..] = vector(&|entry, _| double_of_direction(-entry.plane.offset()));
    let m = cross(&n, &t);
    let one = Doubles::one();
    let per_tt = one.over(dot(&t, &t));
    let per_t = per_tt.root();
    let per_nn = one.over(dot(&n, &n));
    let per_n = per_nn.root();
    let for_area = per_tt.times(per_n);
    let height = pn.times(per_nn);
    let for_volume = per_tt.times(height);
    let foot = n.map(|component| component.times(height));
    [0, 1].map(|end: u32| {
        let p = vector(&|entry, axis| {
            let point = &points[(entry.tail + end) as usize];
            (point.high[axis], point.low[axis])
        });
        let (pt, pm) = (dot(&p, &t), dot(&p, &m));
        let both = pt.times(pm);
        let volume = both.times(for_volume);
        let along = pt.times(per_tt);
        let on_line = [0, 1, 2].map(|axis: usize| p[axis].minus(along.times(t[axis])));
        let sum = [0, 1, 2].map(|axis: usize| foot[axis].plus(on_line[axis]).plus(p[axis]));
        let first = |axis: usize| volume.times(sum[axis]);
        let second = |i: usize, j: usize| {
            let products = foot[i].times(foot[j]);
            let products = products.plus(on_line[i].times(on_line[j]));
            let products = products.plus(p[i].times(p[j]));
            volume.times(products.plus(sum[i].times(sum[j])))
        };
        [
            pt.times(per_t),
            both.times(for_area),
            volume,
            first(0),
            first(1),
            first(2),
            second(0, 0),
            second(1, 1),
            second(2, 2),
            second(0, 1),
            second(1, 2),
            second(2, 0),
        ]
    })
}
