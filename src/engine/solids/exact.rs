//! Exact predicates and roundings in big integers: what floats cannot certify is decided here, and nothing is decided elsewhere.
//!
//! Knows planes, the points where three of them meet, and lines. Never knows floats.
//!
//! Ranges, from those of a plane (normal below `2^45`, offset below `2^77`): a product of two normals is below `2^91`, a triple product
//! below `2^138`, a homogeneous coordinate below `2^170`, the determinant of four planes below `2^217`.

use ethnum::{I256, U256};
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

/// A point in homogeneous coordinates. Range: the numerators below `2^170`, the denominator below `2^138`.
#[derive(Clone, Copy, Debug)]
pub struct Homogeneous {
    /// The numerators of the coordinates. Units: steps.
    pub x: [I256; 3],
    /// Their denominator: not 0, of either sign.
    pub w: I256,
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
#[derive(Debug)]
pub(super) struct Flag<'a> {
    pub(super) point: Homogeneous,
    pub(super) direction: [i128; 3],
    pub(super) plane: &'a Plane,
}

fn big(value: I256) -> BigInt {
    BigInt::from_signed_bytes_le(&value.to_le_bytes())
}

/// Integers of one width, or of any.
trait Integer: Sized {
    fn of(value: I256) -> Self;
    fn plus(&self, other: &Self) -> Self;
    fn minus(&self, other: &Self) -> Self;
    fn times(&self, other: &Self) -> Self;
}

/// Implements [`Integer`] by the operators.
macro_rules! integer {
    ($name:ty, $of:expr) => {
        impl Integer for $name {
            fn of(value: I256) -> Self {
                $of(value)
            }

            fn plus(&self, other: &Self) -> Self {
                self + other
            }

            fn minus(&self, other: &Self) -> Self {
                self - other
            }

            fn times(&self, other: &Self) -> Self {
                self * other
            }
        }
    };
}

integer!(BigInt, big);
integer!(I256, I256::from);

fn dot_of<N: Integer>(a: &[N; 3], b: &[N; 3]) -> N {
    let [x, y, z] = [0, 1, 2].map(|axis: usize| a[axis].times(&b[axis]));
    x.plus(&y).plus(&z)
}

/// A quotient of integers.
struct Fraction<N> {
    over: N,
    under: N,
}

/// A flag's numbers as integers of one kind: its point, direction and normal, and their products.
struct Products<N> {
    x: [N; 3],
    w: N,
    t: [N; 3],
    n: [N; 3],
    tt: N,
    nn: N,
    xt: N,
    xm: N,
}

impl<N: Integer> Products<N> {
    fn of(flag: &Flag) -> Self {
        let x = flag.point.x.map(N::of);
        let t = flag.direction.map(|along| N::of(I256::from(along)));
        let n = flag.plane.normal().map(|along| N::of(I256::from(along)));
        let m = [(1, 2), (2, 0), (0, 1)]
            .map(|(i, j): (usize, usize)| n[i].times(&t[j]).minus(&n[j].times(&t[i])));
        Self {
            tt: dot_of(&t, &t),
            nn: dot_of(&n, &n),
            xt: dot_of(&x, &t),
            xm: dot_of(&x, &m),
            w: N::of(flag.point.w),
            x,
            t,
            n,
        }
    }

    /// Volume or a moment.
    fn fraction(&self, quantity: Quantity) -> Fraction<N> {
        let Self {
            x,
            w,
            t,
            n,
            tt,
            nn,
            xt,
            xm,
        } = self;
        let xn = dot_of(x, n);
        let volume = xt.times(xm).times(&xn);
        // The feet and the point, over one denominator: w T N.
        let squares = tt.times(nn);
        let unit = w.times(&squares);
        let under = w.times(w).times(&unit);
        let foot = |axis: usize| xn.times(&n[axis]).times(tt);
        let point = |axis: usize| x[axis].times(&squares);
        let on_line = |axis: usize| point(axis).minus(&xt.times(&t[axis]).times(nn));
        let sum = |axis: usize| foot(axis).plus(&on_line(axis)).plus(&point(axis));
        match quantity {
            Quantity::First(axis) => Fraction {
                over: volume.times(&sum(axis)),
                under: under.times(&unit),
            },
            Quantity::Second(i, j) => {
                let feet = foot(i).times(&foot(j)).plus(&on_line(i).times(&on_line(j)));
                let others = point(i).times(&point(j)).plus(&sum(i).times(&sum(j)));
                Fraction {
                    over: volume.times(&feet.plus(&others)),
                    under: under.times(&unit).times(&unit),
                }
            }
            _ => Fraction {
                over: volume,
                under,
            },
        }
    }
}

/// How many bits the size of the greatest of some numbers has.
fn bits(numbers: impl IntoIterator<Item = I256>) -> u32 {
    let sizes = numbers.into_iter().map(I256::unsigned_abs);
    let all = sizes.fold(U256::ZERO, |all, size| all | size);
    256 - all.leading_zeros()
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
        if matches!(quantity, Quantity::Length | Quantity::Area) {
            let Products {
                w, tt, nn, xt, xm, ..
            } = Products::<BigInt>::of(self);
            return match quantity {
                Quantity::Length => round(&xt, &w, &tt, unit),
                _ => round(&(xt * xm), &(&w * &w * tt), &nn, unit),
            };
        }
        if self.bits(quantity, unit) < 255 {
            let Fraction { over, under } = Products::<I256>::of(self).fraction(quantity);
            return round_narrow(over, under, unit);
        }
        let Fraction { over, under } = Products::<BigInt>::of(self).fraction(quantity);
        round_fraction(&over, &under, unit)
    }

    /// A bound of the bits of all that is computed of a volume or a moment. With `p`, `q`, `r`, `s` bits of the point's coordinates and its `w`,
    /// of the direction and of the normal: `P.t` has `p + r + 2`, `P.m` `p + r + s + 3`, `P.n` `p + s + 2`, `T N` `2 r + 2 s + 4`, each part of the
    /// sums over `w T N` at most `p + 2 r + 2 s + 5`, and `F + G + P` two more.
    fn bits(&self, quantity: Quantity, unit: Unit) -> u32 {
        let (p, q) = (bits(self.point.x), bits([self.point.w]));
        let both = bits(self.direction.map(I256::from)) + bits(self.plane.normal().map(I256::from));
        let (volume, sum, squares) = (3 * p + 2 * both + 7, p + 2 * both + 7, 2 * both + 4);
        let powers = match quantity {
            Quantity::Second(..) => 2,
            _ => 1,
        };
        // Four products of two parts are added up.
        let over = volume + powers * sum + 2 + 1 + unit.exponent.min(0).unsigned_abs();
        let factor = 128 - unit.factor.leading_zeros();
        let under = 3 * q + squares + powers * (q + squares) + factor;
        over.max(under + unit.exponent.max(0).unsigned_abs())
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

/// The same in integers that are wide enough for it.
fn round_narrow(over: I256, under: I256, unit: Unit) -> i128 {
    let shift = unit.exponent.unsigned_abs();
    let (over_shift, under_shift) = if unit.exponent < 0 {
        (shift, 0)
    } else {
        (0, shift)
    };
    let twice =
        (over.abs() << (over_shift + 1)) / ((under.abs() * I256::from(unit.factor)) << under_shift);
    let size = ((twice + I256::ONE) >> 1_u32).as_i128();
    if (over < I256::ZERO) == (under < I256::ZERO) {
        size
    } else {
        -size
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::convex::Point;
    use crate::random::Random;

    /// Three of a random box around the origin that lie in one plane.
    fn plane(random: &mut Random, reach: i64) -> Plane {
        loop {
            let mut at = || Point::new([(); 3].map(|()| random.within(-reach, reach))).unwrap();
            if let Some(plane) = Plane::through(at(), at(), at()) {
                return plane;
            }
        }
    }

    /// Wherever 256 bits are said to suffice they give what big integers give: near that bound, and where the value lies half-way between two
    /// units.
    #[test]
    fn narrow_integers_round_as_wide_ones_do() {
        let quantities = (0..3)
            .map(Quantity::First)
            .chain([(0, 0), (0, 1), (2, 1)].map(|(i, j)| Quantity::Second(i, j)))
            .chain([Quantity::Volume]);
        let quantities: Vec<Quantity> = quantities.collect();
        let mut random = Random::new(1);
        let (mut narrow, mut close, mut ties) = (0, 0, 0);
        for _ in 0..40_000 {
            let reach = match random.below(2) {
                0 => random.within(1, 3),
                _ => 1 << random.within(1, 12),
            };
            let planes = [(); 3].map(|()| plane(&mut random, reach));
            let [a, b, _] = &planes;
            let direction = cross_wide(a.normal(), b.normal());
            let meeting = Homogeneous::meeting([&planes[0], &planes[1], &planes[2]]);
            if direction == [0; 3] || meeting.w == I256::ZERO {
                continue;
            }
            let flag = Flag {
                point: match random.below(2) {
                    0 => meeting,
                    _ => Homogeneous {
                        x: [(); 3].map(|()| I256::from(random.within(-reach, reach))),
                        w: I256::from(1 << random.within(0, 3)),
                    },
                },
                direction,
                plane: a,
            };
            let unit = Unit {
                factor: match random.below(3) {
                    0 => 1,
                    _ => (1 << random.within(1, 20)) + 1,
                },
                exponent: i32::try_from(random.within(-4, 4)).unwrap(),
            };
            for &quantity in &quantities {
                let bits = flag.bits(quantity, unit);
                if bits >= 255 {
                    continue;
                }
                let Fraction { over, under } = Products::<BigInt>::of(&flag).fraction(quantity);
                let twice: BigInt = (&over << 9) / (&under * BigInt::from(unit.factor));
                if twice.bits() > 120 {
                    continue;
                }
                let expected = round_fraction(&over, &under, unit);
                assert_eq!(
                    flag.rounded(quantity, unit),
                    expected,
                    "{flag:?}, {quantity:?}, {unit:?}"
                );
                narrow += 1;
                close += u32::from(bits > 245);
                let (over, under) = match unit.exponent {
                    shift @ ..0 => (over << shift.unsigned_abs(), under),
                    shift => (over, under << shift),
                };
                let (double, under) = (over << 1, under * BigInt::from(unit.factor));
                let is_whole = &double % &under == BigInt::ZERO;
                ties += u32::from(is_whole && double / under % BigInt::from(2) != BigInt::ZERO);
            }
        }
        assert!(
            narrow > 10_000 && close > 100 && ties > 100,
            "{narrow} {close} {ties}"
        );
    }
}
