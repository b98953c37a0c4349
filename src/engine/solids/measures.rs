//! What is measured of a union of solids, in fixed-point integers.

use std::collections::BTreeMap;

use ethnum::I256;

use crate::geometry::Bounds;

/// Exponent of the unit of twice the edge length: `2^-20` steps.
pub const LENGTH_UNIT: i32 = -20;
/// Exponent of the unit of twice the area: `2^-16` steps squared.
pub const AREA_UNIT: i32 = -16;
/// Exponent of the unit of six times the volume, of 24 times the first and 120 times the second moments: `2^-4` steps to their power.
pub const VOLUME_UNIT: i32 = -4;

/// All additive measures of a union of solids, in fixed-point integers. Also the type of a difference between two unions.
///
/// Each is a sum over the *flags* of the union's boundary (a vertex, an edge there, a facet there) of a real number that depends on the flag
/// alone, rounded half away from zero. So the measures are a function of the set, whatever its history, and the default is
/// the empty union's. How far rounding can be off: [`ErrorMax`]. Moments are about the lattice origin.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Measures {
    /// Six times the volume. Units: `2^-4` steps cubed.
    pub volume6: i128,
    /// Twice the surface area. Units: `2^-16` steps squared.
    pub area2: i128,
    /// Twice the edge length, by kind: convex, concave, and crossing, where more than two sheets meet. A sheet is a side of a facet at an
    /// edge, and each counts half, unless the same oriented plane goes on across the edge: an ordinary edge counts once, one
    /// where two solids touch twice. Units: `2^-20` steps.
    pub edge_length2: [i128; 3],
    /// 24 times the integrals of x, y and z. Units: `2^-4` steps^4.
    pub first_moments24: [I256; 3],
    /// 120 times the integrals of xx, yy, zz, xy, yz and zx. Units: `2^-4` steps^5.
    pub second_moments120: [I256; 6],
}

impl Measures {
    /// Adds a difference, as an insertion does.
    pub fn add(&mut self, difference: &Self) {
        self.combine(difference, i128::wrapping_add, I256::wrapping_add);
    }

    /// Retracts a difference, as a deletion does.
    pub fn retract(&mut self, difference: &Self) {
        self.combine(difference, i128::wrapping_sub, I256::wrapping_sub);
    }

    /// Field by field, modulo two to the width: sums may wrap on the way, the true result fits.
    fn combine(
        &mut self,
        other: &Self,
        wide: impl Fn(i128, i128) -> i128,
        widest: impl Fn(I256, I256) -> I256,
    ) {
        self.volume6 = wide(self.volume6, other.volume6);
        self.area2 = wide(self.area2, other.area2);
        for (length, other) in self.edge_length2.iter_mut().zip(other.edge_length2) {
            *length = wide(*length, other);
        }
        for (moment, other) in self.first_moments24.iter_mut().zip(other.first_moments24) {
            *moment = widest(*moment, other);
        }
        for (moment, other) in self
            .second_moments120
            .iter_mut()
            .zip(other.second_moments120)
        {
            *moment = widest(*moment, other);
        }
    }

    /// Twice the length of all edges. Units: `2^-20` steps.
    pub fn edge_length2_total(&self) -> i128 {
        self.edge_length2.iter().sum()
    }
}

/// The state of a scene's measures at one moment: a pure function of its set of bodies.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Totals {
    /// How many bodies.
    pub solids: u64,
    /// The measures of their union; where there is a stock, of what that union removes from it.
    pub measures: Measures,
    /// The measures of what remains of the stock; none without a stock. Its volume and moments and those of what is removed add up to the
    /// stock's, to the last unit.
    pub remaining: Option<Measures>,
    /// The box around them, whatever the stock; none when there are none.
    pub bounds: Option<Bounds>,
}

impl Totals {
    /// The totals when a body has come that lies in `bounds`, and changes the union and what remains so much.
    pub(super) fn with(mut self, bounds: &Bounds, union: &Measures, rest: &Measures) -> Self {
        self.solids += 1;
        self.measures.add(union);
        if let Some(remaining) = &mut self.remaining {
            remaining.add(rest);
        }
        let around = self.bounds.map_or(*bounds, |all| all.union(bounds));
        self.bounds = Some(around);
        self
    }
}

/// How far rounding can be off in [`Measures`], at most: each in the unit of the measure.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct ErrorMax {
    /// Of six times the volume.
    pub volume6: u128,
    /// Of twice the area.
    pub area2: u128,
    /// Of twice the edge length, of one kind or of all.
    pub edge_length2: u128,
    /// Of 24 times a first moment.
    pub first_moments24: u128,
    /// Of 120 times a second moment.
    pub second_moments120: u128,
}

/// The coordinates of the ends of boxes, counted: so that their common box is known when some go.
#[derive(Debug, Default)]
pub(super) struct Extents {
    min: [BTreeMap<i32, u32>; 3],
    max: [BTreeMap<i32, u32>; 3],
}

impl Extents {
    pub(super) fn insert(&mut self, bounds: Bounds) {
        for axis in 0..3 {
            *self.min[axis].entry(bounds.min[axis]).or_default() += 1;
            *self.max[axis].entry(bounds.max[axis]).or_default() += 1;
        }
    }

    pub(super) fn remove(&mut self, bounds: Bounds) {
        let remove = |ends: &mut BTreeMap<i32, u32>, end: i32| {
            let count = ends.get_mut(&end).expect("it was counted when it came");
            *count -= 1;
            if *count == 0 {
                ends.remove(&end);
            }
        };
        for axis in 0..3 {
            remove(&mut self.min[axis], bounds.min[axis]);
            remove(&mut self.max[axis], bounds.max[axis]);
        }
    }

    /// The common box when some have gone that were there, and others have come. O(those that go, log all).
    pub(super) fn bounds_after(
        &self,
        gone: impl Iterator<Item = Bounds>,
        come: impl Iterator<Item = Bounds>,
    ) -> Option<Bounds> {
        let (mut without, mut with) = (Self::default(), Self::default());
        gone.for_each(|bounds| without.insert(bounds));
        come.for_each(|bounds| with.insert(bounds));
        let stays = |(end, count): (&i32, &u32), gone: &BTreeMap<i32, u32>| {
            (gone.get(end) != Some(count)).then_some(*end)
        };
        let least = |axis: usize| {
            let mut here = self.min[axis].iter();
            let here = here.find_map(|end| stays(end, &without.min[axis]));
            let come = with.min[axis].first_key_value().map(|(end, _)| *end);
            here.into_iter().chain(come).min()
        };
        let greatest = |axis: usize| {
            let mut here = self.max[axis].iter().rev();
            let here = here.find_map(|end| stays(end, &without.max[axis]));
            let come = with.max[axis].last_key_value().map(|(end, _)| *end);
            here.into_iter().chain(come).max()
        };
        Some(Bounds {
            min: [least(0)?, least(1)?, least(2)?],
            max: [greatest(0)?, greatest(1)?, greatest(2)?],
        })
    }

    /// The common box; none without any.
    pub(super) fn bounds(&self) -> Option<Bounds> {
        let least = |axis: usize| self.min[axis].first_key_value().map(|(end, _)| *end);
        let greatest = |axis: usize| self.max[axis].last_key_value().map(|(end, _)| *end);
        Some(Bounds {
            min: [least(0)?, least(1)?, least(2)?],
            max: [greatest(0)?, greatest(1)?, greatest(2)?],
        })
    }
}
