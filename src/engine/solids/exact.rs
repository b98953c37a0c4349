//! Exact predicates and roundings in big integers: what floats cannot certify is decided here, and nothing is decided elsewhere.
//!
//! Knows planes, the points where three of them meet, and lines. Never knows floats.
//!
//! Ranges, from those of a plane (normal below `2^45`, offset below `2^77`): a product of two normals is below `2^91`, a triple product
//! below `2^138`, a homogeneous coordinate below `2^170`, the determinant of four planes below `2^217`.

use ethnum::I256;
use num_bigint::{BigInt, Sign};

use crate::geometry::convex::{Plane, dot};

/// The cross product of two normals. Range: below `2^91`.
pub(super) fn cross_wide(a: [i64; 3], b: [i64; 3]) -> [i128; 3] {
    let product = |i: usize, j: usize| i128::from(a[i]) * i128::from(b[j]);
    let component = |i, j| product(i, j) - product(j, i);
    [component(1, 2), component(2, 0), component(0, 1)]
}

fn product(a: i128, b: i128) -> I256 {
    I256::from(a) * I256::from(b)
}

/// A wide vector times a narrow one. Range: below `2^138` for a cross product and a normal.
pub(super) fn dot_wide(a: [i128; 3], b: [i64; 3]) -> I256 {
    let [x, y, z] = [0, 1, 2].map(|axis: usize| product(a[axis], i128::from(b[axis])));
    x + y + z
}

/// -1, 0 or 1.
pub(super) fn sign(value: I256) -> i32 {
    value.signum().as_i32()
}

/// Whether two planes are opposite: the same points, exchanged sides.
pub(super) fn opposite(a: &Plane, b: &Plane) -> bool {
    let (n, m) = (a.normal(), b.normal());
    n[0] == -m[0] && n[1] == -m[1] && n[2] == -m[2] && a.offset() == -b.offset()
}

/// Whether two normals lie in one line.
pub(super) fn parallel(a: &Plane, b: &Plane) -> bool {
    let (n, m) = (a.normal(), b.normal());
    n == m || (n[0] == -m[0] && n[1] == -m[1] && n[2] == -m[2])
}

/// A point in homogeneous coordinates: x, y, z over w. `w` is not 0, of either sign.
#[derive(Clone, Copy, Debug)]
pub(super) struct Homogeneous {
    pub(super) x: [I256; 3],
    pub(super) w: I256,
}

impl Homogeneous {
    /// A lattice point.
    pub(super) fn lattice(point: [i32; 3]) -> Self {
        Self {
            x: point.map(I256::from),
            w: I256::ONE,
        }
    }

    /// The point where three planes meet.
    pub(super) fn meeting([a, b, c]: [&Plane; 3]) -> Self {
        let ab = cross_wide(a.normal(), b.normal());
        let bc = cross_wide(b.normal(), c.normal());
        let ca = cross_wide(c.normal(), a.normal());
        let coordinate = |axis: usize| {
            -(product(a.offset(), bc[axis])
                + product(b.offset(), ca[axis])
                + product(c.offset(), ab[axis]))
        };
        Self {
            x: [coordinate(0), coordinate(1), coordinate(2)],
            w: dot_wide(ab, c.normal()),
        }
    }

    /// Whether it is this lattice point.
    pub(super) fn is_lattice(&self, point: [i32; 3]) -> bool {
        (0..3).all(|axis| self.x[axis] == self.w * I256::from(point[axis]))
    }

    /// The lattice point that it is, if it is one. Range: coordinates within an `i32`.
    pub(super) fn lattice_point(&self) -> Option<[i32; 3]> {
        let coordinate = |axis: usize| (self.x[axis] / self.w).as_i32();
        let point = [coordinate(0), coordinate(1), coordinate(2)];
        self.is_lattice(point).then_some(point)
    }

    /// Whether some coordinate is at least `2^bits` in size. `bits` is at most 31.
    pub(super) fn reaches(&self, bits: u32) -> bool {
        let bound = self.w.abs() << bits;
        self.x.iter().any(|coordinate| coordinate.abs() >= bound)
    }
}

/// On which side of `plane` the point lies where three planes meet: -1 inside, 0 on it, 1 outside.
pub(super) fn side_of_meeting(plane: &Plane, [a, b, c]: [&Plane; 3]) -> i32 {
    if [a, b, c]
        .iter()
        .any(|one| *one == plane || opposite(one, plane))
    {
        return 0;
    }
    let ab = cross_wide(a.normal(), b.normal());
    let bc = cross_wide(b.normal(), c.normal());
    let ca = cross_wide(c.normal(), a.normal());
    let w = dot_wide(ab, c.normal());
    let n = plane.normal();
    let value = I256::from(plane.offset()) * w
        - I256::from(a.offset()) * dot_wide(bc, n)
        - I256::from(b.offset()) * dot_wide(ca, n)
        - I256::from(c.offset()) * dot_wide(ab, n);
    if w < I256::ZERO {
        -sign(value)
    } else {
        sign(value)
    }
}

/// Sign of the triple product of two normals and a direction: `(a x b) . t`.
pub(super) fn turn(a: &Plane, b: &Plane, t: [i128; 3]) -> i32 {
    let m = cross_wide(a.normal(), b.normal());
    let [x, y, z] = [0, 1, 2].map(|axis: usize| product(m[axis], t[axis]));
    sign(x + y + z)
}

/// What a flag contributes to.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Quantity {
    /// Twice the edge length of a sheet.
    Length,
    /// Twice the area.
    Area,
    /// Six times the volume.
    Volume,
    /// 24 times a first moment: along this axis.
    First(usize),
    /// 120 times a second moment: along these axes.
    Second(usize, usize),
}

/// The unit that a value is rounded to: `factor 2^exponent`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Unit {
    pub(super) factor: u128,
    pub(super) exponent: i32,
}

impl Unit {
    /// How many units of `2^exponent` it is; none is smaller.
    pub(super) fn above(self, exponent: i32) -> u128 {
        self.factor << (self.exponent - exponent).unsigned_abs()
    }
}

/// A flag in whole numbers: a point, a line through it, a plane through the line.
pub(super) struct Flag<'a> {
    pub(super) point: Homogeneous,
    pub(super) direction: [i128; 3],
    pub(super) plane: &'a Plane,
}

fn big(value: I256) -> BigInt {
    BigInt::from_signed_bytes_le(&value.to_le_bytes())
}

fn dot_big(a: &[BigInt; 3], b: &[BigInt; 3]) -> BigInt {
    &a[0] * &b[0] + &a[1] * &b[1] + &a[2] * &b[2]
}

/// A quotient of big integers.
struct Fraction {
    over: BigInt,
    under: BigInt,
}

impl Fraction {
    fn times(&self, other: &Self) -> Self {
        Self {
            over: &self.over * &other.over,
            under: &self.under * &other.under,
        }
    }
}

impl Flag<'_> {
    /// The flag's value of a quantity in a unit, rounded half away from zero from the exact value.
    ///
    /// With `t` the direction, `n` the normal and `m = n x t`, all as they are, `T = t.t` and `N = n.n`, so that `m.m = N T`:
    ///
    /// ```text
    ///   length   P.t / sqrt(T)                      foot on the plane  F = (P.n) n / N
    ///   area     (P.t)(P.m) / (T sqrt(N))           foot on the line   G = P - (P.t) t / T
    ///   volume   (P.t)(P.m)(P.n) / (T N) = v        first moment       v (F + G + P)
    ///            second moment   v (F F + G G + P P + (F + G + P)(F + G + P))
    /// ```
    /// The moments are those of the orthoscheme with corners at the origin, F, G and P, times 24 and 120.
    pub(super) fn rounded(&self, quantity: Quantity, unit: Unit) -> i128 {
        let x = self.point.x.map(big);
        let w = big(self.point.w);
        let t = self.direction.map(BigInt::from);
        let n = self.plane.normal().map(BigInt::from);
        let m =
            [(1, 2), (2, 0), (0, 1)].map(|(i, j): (usize, usize)| &n[i] * &t[j] - &n[j] * &t[i]);
        let (tt, nn) = (dot_big(&t, &t), dot_big(&n, &n));
        let (xt, xm) = (dot_big(&x, &t), dot_big(&x, &m));
        let one = BigInt::from(1);
        match quantity {
            Quantity::Length => round(&xt, &w, &tt, unit),
            Quantity::Area => round(&(xt * xm), &(&w * &w * tt), &nn, unit),
            _ => {
                let xn = dot_big(&x, &n);
                let volume = Fraction {
                    over: &xt * xm * &xn,
                    under: &w * &w * &w * &tt * &nn,
                };
                // The feet and the point, over one denominator: w T N.
                let under = &w * &tt * &nn;
                let foot = |axis: usize| &xn * &n[axis] * &tt;
                let point = |axis: usize| &x[axis] * &tt * &nn;
                let on_line = |axis: usize| point(axis) - &xt * &t[axis] * &nn;
                let sum = |axis: usize| foot(axis) + on_line(axis) + point(axis);
                let factor = match quantity {
                    Quantity::First(axis) => Fraction {
                        over: sum(axis),
                        under,
                    },
                    Quantity::Second(i, j) => Fraction {
                        over: foot(i) * foot(j)
                            + on_line(i) * on_line(j)
                            + point(i) * point(j)
                            + sum(i) * sum(j),
                        under: &under * &under,
                    },
                    _ => Fraction {
                        over: one.clone(),
                        under: one.clone(),
                    },
                };
                let value = volume.times(&factor);
                round_fraction(&value.over, &value.under, unit)
            }
        }
    }
}

/// `over / (under * sqrt(radicand))` in a unit, rounded half away from zero.
fn round(over: &BigInt, under: &BigInt, radicand: &BigInt, unit: Unit) -> i128 {
    // Twice the value, rounded down: the greatest q with q^2 <= 4 over^2 / (under^2 radicand).
    round_half(over, under, unit, |over, under| {
        (BigInt::from(4) * &over * &over / (&under * &under * radicand)).sqrt()
    })
}

/// `over / under` in a unit, rounded half away from zero.
fn round_fraction(over: &BigInt, under: &BigInt, unit: Unit) -> i128 {
    round_half(over, under, unit, |over, under| (over << 1) / under)
}

/// A value in a unit, rounded half away from zero; `twice` rounds twice the value down, of the positive quotient in units.
fn round_half(
    over: &BigInt,
    under: &BigInt,
    unit: Unit,
    twice: impl FnOnce(BigInt, BigInt) -> BigInt,
) -> i128 {
    let negative = (over.sign() == Sign::Minus) != (under.sign() == Sign::Minus);
    let (over, under) = (
        BigInt::from(over.magnitude().clone()),
        BigInt::from(under.magnitude().clone()),
    );
    let under = under * BigInt::from(unit.factor);
    let shift = unit.exponent.unsigned_abs();
    let (over, under) = if unit.exponent < 0 {
        (over << shift, under)
    } else {
        (over, under << shift)
    };
    let size: BigInt = (twice(over, under) + 1) >> 1;
    let size = i128::try_from(size).expect("a flag in its unit is below 2^93");
    if negative { -size } else { size }
}

/// The exact value of a plane at a lattice point.
pub(super) fn side_of_lattice(plane: &Plane, point: [i32; 3]) -> i32 {
    let value = dot(plane.normal(), point.map(i64::from)) + plane.offset();
    i32::from(value.signum() as i8)
}
