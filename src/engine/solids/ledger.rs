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
//! *size class* of the point, is the least with all coordinates below `2^k` in size, and above 1 one more, so that the unit is odd and no whole number a tie: beyond `k = 25`, `18`, `14` the fixed point follows
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
//! Division by an odd unit is one more operation on `V`, `V S` and `V Q`: at most `2 * (5.2, 27, 187)` more, within the bounds used.
//! A value in its unit is then below `2^86`, and its error at most `2^(14 - 102 + 74) = 2^-14` (the second moment of a far point); a
//! value closer than that to a tie is rounded again from the exact flag in big integers.
//! The `paranoid` feature compares every rounding with the exact one.
//!
//! # Two books
//! Where there is a stock all pieces lie in it, and their union `R` is what they remove. The stock's own boundary around an interval of an edge
//! of `R` is the same along the whole of it: whole space, a half-space or a wedge, by which of its facets hold the line. So what remains
//! there, the stock's wedge without the union's, is known from the same rays ([`Boundary::rest`]), and differs from the bare stock at such intervals
//! only. The second book adds up these differences, to length and area; volume and moments of what remains are the stock's less what is
//! removed.

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

use std::sync::Arc;

use ethnum::I256;
use rustc_hash::FxHashSet;
use smallvec::{SmallVec, smallvec};

use crate::geometry::EdgeKind;
use crate::geometry::convex::Plane;

use super::certify::{Near, Room};
use super::clip::Line;
use super::double::{Doubles, RELATIVE_ERROR, cross, dot};
use super::exact::{Flag, Homogeneous, Quantity, Unit};
use super::face::{Arithmetic, Place, Vertex};
use super::lanes::twice;
use super::lines::{Sink, touch_along};
use super::measures::{AREA_UNIT, ErrorMax, LENGTH_UNIT, Measures, VOLUME_UNIT};
use super::piece::Piece;
use super::sector::{Boundary, Sheet};
use super::vector::{LANES, Lanes, Plain, Vector};

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

/// The unit of a quantity at a point of a size class.
fn unit(quantity: Quantity, class: u8) -> Unit {
    let class = i32::from(class);
    let exponent = match quantity {
        Quantity::Length => LENGTH_UNIT,
        Quantity::Area => AREA_UNIT,
        Quantity::Volume => VOLUME_UNIT.max(3 * class - 80),
        Quantity::First(_) => VOLUME_UNIT.max(4 * class - 78),
        Quantity::Second(..) => VOLUME_UNIT.max(5 * class - 74),
    };
    if exponent < 1 {
        Unit {
            factor: 1,
            exponent,
        }
    } else {
        Unit {
            factor: (1 << exponent) + 1,
            exponent: 0,
        }
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
    let Unit { factor, exponent } = unit(quantity, class);
    let size = power_of_two(power * i32::from(class) + bits - exponent) / factor as f64;
    // Half an ulp of 1 for the last difference, and some for the rounding of this.
    RELATIVE_ERROR * size * (1.0 + power_of_two(-40)) + power_of_two(-52)
}

/// One over a unit, as a double-double.
fn reciprocal(Unit { factor, exponent }: Unit) -> (f64, f64) {
    if factor == 1 {
        return (power_of_two(-exponent), 0.0);
    }
    let (high, low) = double(I256::from(factor));
    let under = Doubles {
        high: Plain::splat(high),
        low: Plain::splat(low),
    };
    let quotient = Doubles::one().over(under);
    (quotient.high.lanes()[0], quotient.low.lanes()[0])
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
    /// The same as double-doubles.
    way: [(f64, f64); 3],
    /// 1 to the left of the line, -1 to the right.
    side: i8,
    weight: i8,
    kinds: [u8; BOOKS],
}

/// What is removed, or the union where there is no stock; and what remains of the stock.
const BOOKS: usize = 2;

/// Beside the kinds of edges: none, for a sheet that is not in a book.
const NOWHERE: u8 = 3;

/// Sheets of one kind in each book.
struct Sheets<'a> {
    list: SmallVec<[Sheet<'a>; 4]>,
    kinds: [u8; BOOKS],
    /// -1 for what is taken away.
    sign: i8,
}

impl<'a> Sheets<'a> {
    fn of(rays: Boundary<'_, 'a>, kinds: [u8; BOOKS], sign: i8) -> Self {
        Self {
            list: rays.sheets().collect(),
            kinds,
            sign,
        }
    }
}

/// What changes, or is there: of the union and of what remains of the stock.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(super) struct Books {
    /// Of the union; where there is a stock, of what it removes.
    pub(super) union: Measures,
    /// Of the rest of the stock; meaningless without a stock.
    pub(super) rest: Measures,
    /// Of the union in the planes that are watched: twice the area.
    pub(super) contact2: i128,
}

impl Books {
    /// Adds a difference, as an insertion does.
    pub(super) fn add(&mut self, difference: &Self) {
        self.union.add(&difference.union);
        self.rest.add(&difference.rest);
        self.contact2 += difference.contact2;
    }
}

/// Volume and moments: the quantities after length and area.
const BULK: usize = QUANTITIES.len() - 2;

/// What volume and moments of each size class add up to, lane by lane, in its units.
type Sums = [[Wholes; BULK]];

/// Groups of entries after which [`Sums`] are collected: each adds two values to a lane, and these fit 2^15 times.
const GROUPS: usize = 1 << 12;

/// By size class and quantity: units of 1, and the greatest distance from a whole number that is no tie.
#[derive(Debug)]
struct Tables {
    scales: [[(f64, f64); QUANTITIES.len()]; CLASSES],
    distances: [[f64; QUANTITIES.len()]; CLASSES],
}

/// Collects the sheets of one marginal and adds up their flags.
#[derive(Debug)]
pub(super) struct Ledger {
    arithmetic: Arithmetic,
    /// The stock, in which all pieces lie.
    stock: Option<Arc<Piece>>,
    /// The oriented planes in which area is contact.
    watched: FxHashSet<Plane>,
    near: Vec<u16>,
    entries: Vec<Entry>,
    points: Vec<Point>,
    tables: Box<Tables>,
    /// All 0 between groups of entries that are collected together.
    sums: Box<Sums>,
    flags: Flags,
    /// Those of the stock.
    flags_kept: Flags,
}

/// Flags rounded so far, and the greatest size class among their points.
#[derive(Clone, Copy, Debug, Default)]
struct Flags {
    count: u64,
    class_max: u8,
}

/// Sheets along intervals, so many times; those that stay in an exchange need no flags.
impl<'a> Sink<'a> for Ledger {
    fn post(
        &mut self,
        line: &Line<'a>,
        ends: &[Vertex<'a>; 2],
        rays: Boundary<'_, 'a>,
        weight: i8,
    ) {
        let stock = self.stock.clone();
        let books = self.books(stock.as_deref(), line, ends, rays);
        self.enter(line, ends, &books, weight);
    }

    fn exchange(
        &mut self,
        line: &Line<'a>,
        ends: &[Vertex<'a>; 2],
        [before, after]: [Boundary<'_, 'a>; 2],
    ) {
        let stock = self.stock.clone();
        let mut before = self.books(stock.as_deref(), line, ends, before);
        let mut after = self.books(stock.as_deref(), line, ends, after);
        // What stays needs no flags. The stock, and so the number of lists, is the same before and after.
        for (before, after) in before.iter_mut().zip(&mut after) {
            if before.kinds != after.kinds {
                continue;
            }
            before.list.retain(|old| {
                let stays = after.list.iter().position(|new| new.same(old));
                if let Some(index) = stays {
                    after.list.remove(index);
                }
                stays.is_none()
            });
        }
        self.enter(line, ends, &before, -1);
        self.enter(line, ends, &after, 1);
    }
}

impl Ledger {
    pub(super) fn new(arithmetic: Arithmetic, stock: Option<Arc<Piece>>) -> Self {
        let mut tables = Box::new(Tables {
            scales: [[(0.0, 0.0); QUANTITIES.len()]; CLASSES],
            distances: [[0.0; QUANTITIES.len()]; CLASSES],
        });
        for class in 0..CLASSES {
            for (index, quantity) in QUANTITIES.into_iter().enumerate() {
                tables.scales[class][index] = reciprocal(unit(quantity, class as u8));
                tables.distances[class][index] = 0.5 - error(quantity, class as u8);
            }
        }
        Self {
            arithmetic,
            stock,
            watched: FxHashSet::default(),
            near: Vec::new(),
            entries: Vec::new(),
            points: Vec::new(),
            tables,
            sums: vec![[Wholes::default(); BULK]; CLASSES].into_boxed_slice(),
            flags: Flags::default(),
            flags_kept: Flags::default(),
        }
    }

    /// Watches these planes from now on, but for those of the stock.
    pub(super) fn watch(&mut self, planes: impl Iterator<Item = Plane>) {
        self.watched.clear();
        self.watched.extend(planes);
        if self.watched.is_empty() {
            return;
        }
        for face in self.stock.iter().flat_map(|stock| &stock.faces) {
            self.watched.remove(&face.plane);
        }
    }

    /// What rays around an interval are in each book.
    fn books<'a>(
        &mut self,
        stock: Option<&'a Piece>,
        line: &Line<'a>,
        ends: &[Vertex; 2],
        rays: Boundary<'_, 'a>,
    ) -> SmallVec<[Sheets<'a>; 1]> {
        let kind = rays.kind as u8;
        let Some(stock) = stock else {
            return smallvec![Sheets::of(rays, [kind, NOWHERE], 1)];
        };
        let Some(around) = touch_along(self.arithmetic, stock, ends, &mut self.near) else {
            // Within the stock: the same sheets, and convex becomes concave.
            let rest = match rays.kind {
                EdgeKind::Convex => EdgeKind::Concave,
                EdgeKind::Concave => EdgeKind::Convex,
                EdgeKind::Crossing => EdgeKind::Crossing,
            };
            return smallvec![Sheets::of(rays, [kind, rest as u8], 1)];
        };
        let own = around.rays(self.arithmetic, line);
        let rest = rays.rest(self.arithmetic, line, &own);
        let own = Boundary {
            rays: &own,
            kind: EdgeKind::Convex,
        };
        smallvec![
            Sheets::of(rays, [kind, NOWHERE], 1),
            Sheets::of(rest.view(), [NOWHERE, rest.kind as u8], 1),
            Sheets::of(own, [NOWHERE, own.kind as u8], -1),
        ]
    }

    /// Enters sheets along an interval, so many times.
    fn enter(&mut self, line: &Line, ends: &[Vertex; 2], books: &[Sheets], weight: i8) {
        if books.iter().all(|book| book.list.is_empty()) {
            return;
        }
        let tail = u32::try_from(self.points.len()).expect("far fewer than 2^32 points");
        self.points.extend(ends.map(|end| Point::of(&end)));
        let way = line.direction.map(exact_double);
        for book in books {
            self.entries.extend(book.list.iter().map(|sheet| Entry {
                tail,
                plane: sheet.face.plane,
                normal: sheet.face.rough.normal,
                direction: line.direction,
                way,
                side: sheet.side as i8,
                weight: weight * book.sign,
                kinds: book.kinds,
            }));
        }
    }

    /// A box around all that changes; none when nothing does.
    pub(super) fn room(&self) -> Option<Room> {
        let rooms = self.entries.iter().map(|entry| {
            let [tail, head] = [0, 1].map(|end: u32| &self.points[(entry.tail + end) as usize]);
            let near = |point: &Point| Near {
                at: point.high,
                slack: 0.0,
            };
            Room::around(&near(tail), &near(head))
        });
        rooms.reduce(|one, other| one.joined(&other))
    }

    /// Adds up everything posted, and forgets it.
    pub(super) fn settle(&mut self) -> Books {
        let mut books = Books::default();
        // By kind, and in a last place what is in another book only.
        let mut lengths = [[0; NOWHERE as usize + 1]; BOOKS];
        let mut areas = [0; BOOKS];
        self.flags.count += 2 * self.entries.len() as u64;
        let classes = self.points.iter().map(|point| point.class);
        self.flags.class_max = classes.fold(self.flags.class_max, u8::max);
        for part in self.entries.chunks(LANES * GROUPS) {
            let mut used = 0;
            for entries in part.chunks(LANES) {
                let group = Group::of(entries, &self.points);
                used |= group.classes_used();
                let mut ends = values(&group, &self.points, &self.tables, &mut self.sums);
                if ends.is_unsure
                    || self.arithmetic == Arithmetic::Exact
                    || cfg!(feature = "paranoid")
                {
                    let is_exact = self.arithmetic == Arithmetic::Exact;
                    correct(is_exact, &group, &self.points, &mut ends, &mut self.sums);
                }
                for (lane, entry) in entries.iter().enumerate() {
                    let both = |index: usize| {
                        ends.values[0][index].lane(lane) + ends.values[1][index].lane(lane)
                    };
                    let (length, area) = (both(0), both(1));
                    if entry.kinds[0] != NOWHERE && self.watched.contains(&entry.plane) {
                        books.contact2 += area;
                    }
                    for (book, kind) in entry.kinds.into_iter().enumerate() {
                        lengths[book][usize::from(kind)] += length;
                        areas[book] += if kind == NOWHERE { 0 } else { area };
                    }
                }
            }
            for class in (0..CLASSES as u8).filter(|class| used >> class & 1 == 1) {
                let sums = std::mem::take(&mut self.sums[usize::from(class)]);
                books.union.collect(class, &sums.map(|sum| sum.total()));
            }
        }
        // Volume and moments of the rest are what the union leaves.
        books.rest.retract(&books.union);
        for (book, to) in [&mut books.union, &mut books.rest].into_iter().enumerate() {
            to.area2 = areas[book];
            to.edge_length2.copy_from_slice(&lengths[book][..3]);
        }
        self.entries.clear();
        self.points.clear();
        books
    }

    /// Adds up what was posted in the watched planes alone, and forgets it all: none of it becomes a part of the totals.
    pub(super) fn settle_contact(&mut self) -> i128 {
        let flags = self.flags;
        let contact2 = self.settle().contact2;
        self.flags = flags;
        contact2
    }

    /// Counts the flags that another ledger rounded as its own, and no longer there.
    pub(super) fn take_flags(&mut self, other: &mut Self) {
        let Flags { count, class_max } = std::mem::take(&mut other.flags);
        self.flags.count += count;
        self.flags.class_max = self.flags.class_max.max(class_max);
    }

    /// Counts the flags that another ledger has rounded so far, instead of its own.
    pub(super) fn count_flags_of(&mut self, other: &Self) {
        self.flags = other.flags;
    }

    /// Counts the flags rounded so far for ever.
    pub(super) fn keep_flags(&mut self) {
        self.flags_kept = self.flags;
    }

    /// Forgets all flags but those kept: when what the others add up to is 0.
    pub(super) fn forget_flags(&mut self) {
        self.flags = self.flags_kept;
    }

    /// How far off all roundings so far can be together: half a unit for each flag, the units those of the farthest point.
    pub(super) fn error_max(&self) -> ErrorMax {
        let of = |quantity, fixed: i32| {
            let size = unit(quantity, self.flags.class_max).above(fixed);
            (u128::from(self.flags.count) * size).div_ceil(2)
        };
        ErrorMax {
            volume6: of(Quantity::Volume, VOLUME_UNIT),
            area2: of(Quantity::Area, AREA_UNIT),
            edge_length2: of(Quantity::Length, LENGTH_UNIT),
            first_moments24: of(Quantity::First(0), VOLUME_UNIT),
            second_moments120: of(Quantity::Second(0, 0), VOLUME_UNIT),
        }
    }
}

/// Puts exact values where floats are not sure, or everywhere, and what these differ by into the sums.
fn correct(is_exact: bool, group: &Group, points: &[Point], ends: &mut Ends, sums: &mut Sums) {
    for (end, values) in ends.values.iter_mut().enumerate() {
        for (index, value) in values.iter_mut().enumerate() {
            let unsure = ends.unsure[end][index];
            let all = is_exact || cfg!(feature = "paranoid");
            let mut lanes = if all { 0b1111 } else { unsure };
            while lanes != 0 {
                let lane = lanes.trailing_zeros() as usize;
                lanes &= lanes - 1;
                let sign = group.signs(index)[lane] * if end == 0 { 1.0 } else { -1.0 };
                if sign == 0.0 {
                    continue;
                }
                let entry = group.entries[lane];
                let flag = Flag {
                    point: points[entry.tail as usize + end].place,
                    direction: entry.direction,
                    plane: &entry.plane,
                };
                let (quantity, class) = (QUANTITIES[index], group.classes[end][lane]);
                let exact = flag.rounded(quantity, unit(quantity, class as u8)) * sign as i128;
                let difference = exact - value.lane(lane);
                #[cfg(feature = "paranoid")]
                assert!(
                    is_exact || difference == 0 || unsure >> lane & 1 == 1,
                    "the rounding's bound holds"
                );
                let difference =
                    i64::try_from(difference).expect("floats are off by a unit at most");
                value.low[lane] += difference;
                if let Some(bulk) = index.checked_sub(QUANTITIES.len() - BULK) {
                    sums[class][bulk].low[lane] += difference;
                }
            }
        }
    }
}

impl Measures {
    /// Adds what the points of a size class add up to.
    fn collect(&mut self, class: u8, sums: &[i128; BULK]) {
        let size = |quantity| {
            let size = unit(quantity, class).above(VOLUME_UNIT);
            i128::try_from(size).expect("a unit is below 2^90")
        };
        let volume = sums[0].wrapping_mul(size(Quantity::Volume));
        self.volume6 = self.volume6.wrapping_add(volume);
        let scaled = |sum: &i128, quantity| I256::from(*sum) * I256::from(size(quantity));
        for (moment, sum) in self.first_moments24.iter_mut().zip(&sums[1..4]) {
            *moment += scaled(sum, Quantity::First(0));
        }
        for (moment, sum) in self.second_moments120.iter_mut().zip(&sums[4..]) {
            *moment += scaled(sum, Quantity::Second(0, 0));
        }
    }
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
                    high: Plain::of(&[x.0, y.0, z.0, 0.0]),
                    low: Plain::of(&[x.1, y.1, z.1, 0.0]),
                };
                let under = Doubles {
                    high: Plain::splat(w_high),
                    low: Plain::splat(w_low),
                };
                let quotients = over.over(under);
                let [x, y, z, _] = quotients.high.lanes();
                let [x_low, y_low, z_low, _] = quotients.low.lanes();
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
#[inline(always)]
fn exact_double(value: i128) -> (f64, f64) {
    if let Ok(narrow) = i64::try_from(value)
        && narrow.unsigned_abs() < 1 << 53
    {
        return (narrow as f64, 0.0);
    }
    let high = value as f64;
    (high, (value - high as i128) as f64)
}

/// Whole numbers below `2^93` in size, one in each lane, in two parts: `high 2^45 + low`.
#[derive(Clone, Copy, Default, Debug)]
struct Wholes {
    high: [i64; LANES],
    low: [i64; LANES],
}

/// Where whole numbers are parted.
const SPLIT: i32 = 45;

impl Wholes {
    fn lane(&self, lane: usize) -> i128 {
        (i128::from(self.high[lane]) << SPLIT) + i128::from(self.low[lane])
    }

    /// The sum over the lanes.
    fn total(&self) -> i128 {
        (0..LANES).map(|lane| self.lane(lane)).sum()
    }
}

/// Values in their units, with their signs.
struct Ends {
    values: [[Wholes; QUANTITIES.len()]; 2],
    /// Bits of the lanes where they may be wrong.
    unsure: [[u8; QUANTITIES.len()]; 2],
    /// Whether there are such lanes.
    is_unsure: bool,
}

/// Up to four entries that are evaluated side by side.
struct Group<'e> {
    /// Lanes without an entry repeat the first.
    entries: [&'e Entry; LANES],
    /// Size classes of the tails and of the heads.
    classes: [[usize; LANES]; 2],
    /// What values at the tails count; those at the heads count the opposite, for there the direction is. 0 without an entry.
    length: Lanes,
    area: Lanes,
    bulk: Lanes,
}

impl<'e> Group<'e> {
    fn of(entries: &'e [Entry], points: &[Point]) -> Self {
        let mut this = Self {
            entries: [&entries[0]; LANES],
            classes: [[0; LANES]; 2],
            length: [0.0; LANES],
            area: [0.0; LANES],
            bulk: [0.0; LANES],
        };
        for (lane, entry) in entries.iter().enumerate() {
            this.entries[lane] = entry;
            this.length[lane] = f64::from(-entry.weight);
            // A sheet to the right has its foot the other way.
            this.area[lane] = f64::from(entry.weight * entry.side);
            if entry.kinds[0] != NOWHERE {
                this.bulk[lane] = this.area[lane];
            }
        }
        for (end, classes) in this.classes.iter_mut().enumerate() {
            for (class, entry) in classes.iter_mut().zip(this.entries) {
                *class = usize::from(points[entry.tail as usize + end].class);
            }
        }
        this
    }

    /// What values of a quantity count.
    #[inline(always)]
    fn signs(&self, index: usize) -> &Lanes {
        match index {
            0 => &self.length,
            1 => &self.area,
            _ => &self.bulk,
        }
    }

    /// Bits of the size classes.
    fn classes_used(&self) -> u32 {
        let classes = self.classes.iter().flatten();
        classes.fold(0, |used, class| used | 1 << class)
    }
}

twice! {
    /// The values of a group at its tails and at its heads; adds volume and moments to the sums.
    values, values_wide, values_body, (group: &Group, points: &[Point], tables: &Tables, sums: &mut Sums) -> Ends
}

/// Loads double-doubles lane by lane.
macro_rules! load {
    ($entries:ident, |$entry:ident| $value:expr) => {{
        let mut high = [0.0; LANES];
        let mut low = [0.0; LANES];
        for (lane, $entry) in $entries.iter().enumerate() {
            (high[lane], low[lane]) = $value;
        }
        Doubles {
            high: V::of(&high),
            low: V::of(&low),
        }
    }};
}

#[inline(always)]
fn values_body<V: Vector>(
    group: &Group,
    points: &[Point],
    tables: &Tables,
    sums: &mut Sums,
) -> Ends {
    let entries = &group.entries;
    let n = [
        load!(entries, |entry| (entry.normal[0], 0.0)),
        load!(entries, |entry| (entry.normal[1], 0.0)),
        load!(entries, |entry| (entry.normal[2], 0.0)),
    ];
    let t = [
        load!(entries, |entry| entry.way[0]),
        load!(entries, |entry| entry.way[1]),
        load!(entries, |entry| entry.way[2]),
    ];
    // P.n = -d, whatever P.
    let pn = load!(entries, |entry| exact_double(-entry.plane.offset()));
    let m = cross(&n, &t);
    let one = Doubles::<V>::one();
    let per_tt = one.over(dot(&t, &t));
    let per_t = per_tt.root();
    let per_nn = one.over(dot(&n, &n));
    let for_area = per_tt.times(per_nn.root());
    let height = pn.times(per_nn);
    let for_volume = per_tt.times(height);
    let foot = [n[0].times(height), n[1].times(height), n[2].times(height)];
    let mut signs = [V::of(&group.length), V::of(&group.area), V::of(&group.bulk)];
    let mut ends = Ends {
        values: [[Wholes::default(); QUANTITIES.len()]; 2],
        unsure: [[0; QUANTITIES.len()]; 2],
        is_unsure: false,
    };
    for end in 0..2 {
        let at = |entry: &Entry| &points[entry.tail as usize + end];
        let p = [
            load!(entries, |entry| (at(entry).high[0], at(entry).low[0])),
            load!(entries, |entry| (at(entry).high[1], at(entry).low[1])),
            load!(entries, |entry| (at(entry).high[2], at(entry).low[2])),
        ];
        let (pt, pm) = (dot(&p, &t), dot(&p, &m));
        let both = pt.times(pm);
        let volume = both.times(for_volume);
        let along = pt.times(per_tt);
        let (mut line, mut sum) = (p, p);
        for axis in 0..3 {
            line[axis] = p[axis].minus(along.times(t[axis]));
            sum[axis] = foot[axis].plus(line[axis]).plus(p[axis]);
        }
        let mut values = [volume; QUANTITIES.len()];
        values[0] = pt.times(per_t);
        values[1] = both.times(for_area);
        for axis in 0..3 {
            values[3 + axis] = volume.times(sum[axis]);
        }
        for (index, (i, j)) in [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)]
            .into_iter()
            .enumerate()
        {
            let products = foot[i].times(foot[j]).plus(line[i].times(line[j]));
            let products = products.plus(p[i].times(p[j])).plus(sum[i].times(sum[j]));
            values[6 + index] = volume.times(products);
        }
        let classes = &group.classes[end];
        for (index, value) in values.into_iter().enumerate() {
            let (wholes, unsure) = rounded(value, signs[index.min(2)], index, classes, tables);
            ends.values[end][index] = wholes;
            ends.unsure[end][index] = unsure;
            ends.is_unsure |= unsure != 0;
            if let Some(bulk) = index.checked_sub(QUANTITIES.len() - BULK) {
                add_bulk(bulk, classes, &wholes, sums);
            }
        }
        for sign in &mut signs {
            *sign = sign.negative();
        }
    }
    ends
}

/// Values of a quantity rounded to their units, times their signs; and bits of the lanes where they may be wrong.
#[inline(always)]
fn rounded<V: Vector>(
    value: Doubles<V>,
    sign: V,
    index: usize,
    classes: &[usize; LANES],
    tables: &Tables,
) -> (Wholes, u8) {
    let (mut scale_high, mut scale_low) = ([0.0; LANES], [0.0; LANES]);
    let mut distance = [0.0; LANES];
    for lane in 0..LANES {
        (scale_high[lane], scale_low[lane]) = tables.scales[classes[lane]][index];
        distance[lane] = tables.distances[classes[lane]][index];
    }
    let Doubles { high, low } = value.times(Doubles {
        high: V::of(&scale_high),
        low: V::of(&scale_low),
    });
    let whole = high.nearest();
    // Exact where `high` has a fraction, and `low` alone where it has none.
    let rest = high.minus(whole).plus(low);
    let more = rest.nearest();
    let sure = V::of(&distance).greater(rest.minus(more).size());
    let high = whole.times(V::splat(power_of_two(-SPLIT))).nearest();
    let low = whole
        .minus(high.times(V::splat(power_of_two(SPLIT))))
        .plus(more);
    let wholes = Wholes {
        high: high.times(sign).integers(),
        low: low.times(sign).integers(),
    };
    (wholes, !sure & 0b1111)
}

/// Adds to the sums of the points' size classes.
#[inline(always)]
fn add_bulk(bulk: usize, classes: &[usize; LANES], wholes: &Wholes, sums: &mut Sums) {
    if classes[1..] == [classes[0]; LANES - 1] {
        let sum = &mut sums[classes[0]][bulk];
        for lane in 0..LANES {
            sum.high[lane] += wholes.high[lane];
            sum.low[lane] += wholes.low[lane];
        }
    } else {
        for (lane, class) in classes.iter().enumerate() {
            let sum = &mut sums[*class][bulk];
            sum.high[lane] += wholes.high[lane];
            sum.low[lane] += wholes.low[lane];
        }
    }
}
