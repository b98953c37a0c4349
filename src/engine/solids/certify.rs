//! The filter: signs of planes at points in floats, certain or not at all.
//!
//! Knows rough positions and rough planes. One of the rooms that hold floats; no number leaves it but to come back: what it certifies
//! is a sign, and what it cannot certify is decided in `exact.rs`.
//!
//! # Proof
//! Let `u = 2^-53`, `C = 2^30` (the greatest coordinate), `M = 2 C` ([`REACH`]), `n` a normal (`|n|_1 < 2^47`, so exact in floats) and
//! `d` its offset, `|d| <= |n|_1 C` because the plane goes through a point of the scene. A [`Near`] stands for a true point whose
//! coordinates differ from it by at most its `slack`; both lie within `C + 1` of the origin.
//!
//! *Value.* `d` is rounded with an error of at most `u |n|_1 C`. The value is three products and three sums, every intermediate
//! result at most `|n|_1 M` but for terms in `u^2`, so that rounding adds at most `6 u |n|_1 M` (less where a product and a sum
//! are fused). The point itself adds at most `|n|_1 slack`. So the computed value differs from the true one by at most
//! `|n|_1 (slack + 6.5 u M)`, and `6.5 u < 2^-50` leaves a fifth for the rounding of the bound itself. That is [`Rough::bound`]
//! with [`GRAIN`]` = M 2^-50`: a value beyond it has the sign of the true one.
//!
//! *Meeting point.* A segment between true points `p`, `q` crosses the plane at `p + s (q - p)`, `s = a / (a - b)` for the true
//! values `a`, `b`, one positive and one negative. Computed: values `a'`, `b'`, each within `e` (the greater bound), `s'` the quotient clamped
//! to 0 .. 1. Then `|s' - s| <= (|a| + |b|) e / (|a' - b'| |a - b|) = e / |a' - b'|`, and never more than 1. The difference of the points is
//! `(1 - s)(p' - p) + s (q' - q) + (s' - s)(q' - p')`, so the new slack is the greater of both, plus the length (in the maximum norm) times
//! `min(1, 2 e / |a' - b'|)`, where the 2 is more than enough for the rounding of the quotient; the sums' and products' own
//! rounding, at most `7 u M`, is within another [`GRAIN`].
//!
//! *Turn.* `h . (n x t)` of two normals and a direction is computed in 14 operations on terms of at most `|h|_1 |n|_1 |t|_1`;
//! the direction is rounded once before. The error is below `16 u = 2^-49` of that bound; [`Rough::turn`] asks for `2^-48`.

#![expect(
    clippy::float_arithmetic,
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    reason = "floats certify signs and are never a result"
)]
#![expect(
    clippy::inline_always,
    reason = "they become part of the inner loops, with the instructions of those"
)]

use crate::geometry::convex::Plane;
use crate::geometry::{Bounds, COORDINATE_MAX};

/// Twice the greatest coordinate.
const REACH: f64 = 2.0 * COORDINATE_MAX as f64;

/// Bound of the rounding of a plane's value, for a normal of length 1 in the sum norm: `M 2^-50`.
pub(super) const GRAIN: f64 = REACH / (1_u64 << 50) as f64;

/// Half a step more than nothing: what a box is widened by, beyond its points' slack, before it is compared with a box of lattice points.
const HAIR: f64 = 1e-6;

/// A point is known too roughly to tell lattice points apart.
#[derive(Clone, Copy, Debug)]
pub(super) struct Blurred;

/// Roughly where a point is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Near {
    pub(super) at: [f64; 3],
    /// The true point's coordinates differ by no more.
    pub(super) slack: f64,
}

impl Near {
    /// A lattice point: exact.
    #[inline(always)]
    pub(super) fn lattice(point: [i32; 3]) -> Self {
        Self {
            at: point.map(f64::from),
            slack: 0.0,
        }
    }

    /// Whether the two may stand for one point.
    pub(super) fn may_be(&self, other: &Self) -> bool {
        let apart = |axis: usize| (self.at[axis] - other.at[axis]).abs();
        (0..3).all(|axis| apart(axis) <= self.slack + other.slack + GRAIN)
    }

    /// The one lattice point that it can be; none when it certainly is none.
    /// # Errors
    /// [`Blurred`] when several lattice points are within the slack.
    pub(super) fn nearest_lattice(&self) -> Result<Option<[i32; 3]>, Blurred> {
        if self.slack >= 0.25 {
            return Err(Blurred);
        }
        let is_near = |part: f64| (part - part.round()).abs() <= self.slack + GRAIN;
        let nearest = |part: f64| part.round() as i32;
        Ok(self
            .at
            .into_iter()
            .all(is_near)
            .then(|| self.at.map(nearest)))
    }

    /// Where the segment between two points crosses a plane; `values` are those of the plane at the two.
    #[inline]
    pub(super) fn crossing(ends: [&Self; 2], plane: &Rough, values: [Value; 2]) -> Self {
        let values = values.map(|Value(value)| value);
        let [p, q] = ends;
        let error = plane.bound(p.slack.max(q.slack));
        let span = (values[0] - values[1]).abs();
        let share = if span > 0.0 {
            (values[0] / (values[0] - values[1])).clamp(0.0, 1.0)
        } else {
            0.5
        };
        let way = [0, 1, 2].map(|axis: usize| q.at[axis] - p.at[axis]);
        let length = way[0].abs().max(way[1].abs()).max(way[2].abs());
        let unsure = if span > 2.0 * error {
            2.0 * error / span
        } else {
            1.0
        };
        Self {
            at: [0, 1, 2].map(|axis: usize| p.at[axis] + way[axis] * share),
            slack: p.slack.max(q.slack) + length * unsure + GRAIN,
        }
    }
}

/// A plane in floats.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rough {
    pub(super) normal: [f64; 3],
    pub(super) offset: f64,
    /// The sum of the sizes of the normal's components.
    pub(super) length: f64,
}

impl Rough {
    pub(super) fn of(plane: &Plane) -> Self {
        let normal = plane.normal().map(|component| component as f64);
        Self {
            normal,
            offset: rounded(plane.offset()),
            length: normal[0].abs() + normal[1].abs() + normal[2].abs(),
        }
    }

    /// The value at a point.
    #[inline(always)]
    pub(super) fn value(&self, at: &[f64; 3]) -> Value {
        let [x, y, z] = self.normal;
        Value(x * at[0] + (y * at[1] + (z * at[2] + self.offset)))
    }

    /// How far a value may be from the true one, at a point with this slack.
    #[inline(always)]
    pub(super) fn bound(&self, slack: f64) -> f64 {
        self.length * (slack + GRAIN)
    }

    /// The sign of the value at a point, if it is certain.
    #[inline]
    pub(super) fn side(&self, near: &Near) -> Option<i32> {
        certain(self.value(&near.at), self.bound(near.slack))
    }

    /// The sign of `self . (other x t)`, if it is certain.
    #[inline]
    pub(super) fn turn(&self, other: &Self, t: &Way) -> Option<i32> {
        let (n, d) = (&other.normal, &t.direction);
        let cross = |i: usize, j: usize| n[i] * d[j] - n[j] * d[i];
        let [x, y, z] = self.normal;
        let value = x * cross(1, 2) + y * cross(2, 0) + z * cross(0, 1);
        certain(
            Value(value),
            self.length * other.length * t.length / (1_u64 << 48) as f64,
        )
    }
}

/// The computed value of a plane at a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Value(f64);

/// A direction in floats.
#[derive(Clone, Copy, Debug)]
pub(super) struct Way {
    direction: [f64; 3],
    length: f64,
}

impl Way {
    pub(super) fn of(direction: [i128; 3]) -> Self {
        let direction = direction.map(rounded);
        Self {
            direction,
            length: direction[0].abs() + direction[1].abs() + direction[2].abs(),
        }
    }
}

/// The nearest float, without the detour for wide integers where it is short.
#[inline]
fn rounded(value: i128) -> f64 {
    i64::try_from(value).map_or(value as f64, |value| value as f64)
}

/// The sign of a value, if it is beyond its bound.
#[inline(always)]
pub(super) fn certain(Value(value): Value, bound: f64) -> Option<i32> {
    if value > bound {
        Some(1)
    } else if value < -bound {
        Some(-1)
    } else {
        None
    }
}

/// A closed box: least and greatest corner.
#[derive(Clone, Copy, Debug)]
pub(super) struct Room {
    pub(super) min: [f64; 3],
    pub(super) max: [f64; 3],
}

impl Room {
    /// Around two points, wide enough for what they stand for.
    #[inline]
    pub(super) fn around(a: &Near, b: &Near) -> Self {
        let widen = a.slack.max(b.slack) + HAIR;
        Self {
            min: [0, 1, 2].map(|axis: usize| a.at[axis].min(b.at[axis]) - widen),
            max: [0, 1, 2].map(|axis: usize| a.at[axis].max(b.at[axis]) + widen),
        }
    }

    /// A box of lattice points.
    pub(super) fn of(bounds: &Bounds) -> Self {
        Self {
            min: bounds.min.map(f64::from),
            max: bounds.max.map(f64::from),
        }
    }

    /// The least box of lattice points around it. Range: the box itself within that of the coordinates, and a step.
    pub(super) fn bounds(&self) -> Bounds {
        Bounds {
            min: self.min.map(|end| end.floor() as i32),
            max: self.max.map(|end| end.ceil() as i32),
        }
    }

    /// No box: it grows with every point.
    pub(super) fn empty() -> Self {
        Self {
            min: [f64::INFINITY; 3],
            max: [f64::NEG_INFINITY; 3],
        }
    }

    /// Takes in a point and its slack.
    pub(super) fn include(&mut self, point: &Near) {
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(point.at[axis] - point.slack);
            self.max[axis] = self.max[axis].max(point.at[axis] + point.slack);
        }
    }

    /// The least box around both.
    pub(super) fn joined(&self, other: &Self) -> Self {
        Self {
            min: [0, 1, 2].map(|axis: usize| self.min[axis].min(other.min[axis])),
            max: [0, 1, 2].map(|axis: usize| self.max[axis].max(other.max[axis])),
        }
    }

    /// Whether it holds the other box.
    pub(super) fn holds(&self, other: &Self) -> bool {
        (0..3).all(|axis| self.min[axis] <= other.min[axis] && other.max[axis] <= self.max[axis])
    }

    /// Whether a point is certainly outside.
    #[inline]
    pub(super) fn excludes(&self, point: &Near) -> bool {
        let slack = point.slack;
        (0..3).any(|axis| {
            point.at[axis] + slack < self.min[axis] || point.at[axis] - slack > self.max[axis]
        })
    }

    /// Whether the two have a point in common.
    #[inline(always)]
    pub(super) fn meets(&self, other: &Self) -> bool {
        (0..3).all(|axis| self.min[axis] <= other.max[axis] && other.min[axis] <= self.max[axis])
    }
}
