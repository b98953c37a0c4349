//! How user units and lattice steps correspond in a scene of solids.

use crate::geometry::COORDINATE_MAX;
use crate::geometry::convex::{Deviation, EXTENT_MAX, Point};
use crate::wire::convert::{OFF_LATTICE_MAX, Rounding, STEPS_PER_UNIT_MAX, float, nearest, whole};

use super::SolidFault;

/// Millionths in a degree.
const PARTS_OF_DEGREE: f64 = 1e6;

/// How many lattice steps a user unit has, and what becomes of a coordinate between two steps.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Scale {
    steps_per_unit: u32,
    rounding: Rounding,
}

/// `steps_per_unit` is no whole number in range.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("steps_per_unit is not a whole number from 1 to {STEPS_PER_UNIT_MAX}")]
pub struct InvalidScale;

impl Scale {
    /// So many steps in a user unit; coordinates are rounded to the nearest step.
    /// # Errors
    /// [`InvalidScale`] outside 1 to [`STEPS_PER_UNIT_MAX`].
    pub fn new(steps_per_unit: u32) -> Result<Self, InvalidScale> {
        match steps_per_unit {
            1..=STEPS_PER_UNIT_MAX => Ok(Self {
                steps_per_unit,
                rounding: Rounding::Nearest,
            }),
            _ => Err(InvalidScale),
        }
    }

    /// The same with another rule for coordinates between two steps.
    #[must_use]
    pub fn with_rounding(self, rounding: Rounding) -> Self {
        Self { rounding, ..self }
    }

    /// Lattice steps in a user unit.
    pub fn steps_per_unit(self) -> u32 {
        self.steps_per_unit
    }

    /// The lattice point nearest to a position in user units, halves away from zero. Where coordinates between two steps are rejected it is
    /// within a millionth of a step.
    /// # Errors
    /// The first coordinate at fault; `pointer` is the position's.
    pub fn point(self, at: [f64; 3], pointer: &str) -> Result<Point, SolidFault> {
        let mut steps = [0; 3];
        for axis in 0..3 {
            let product = at[axis] * f64::from(self.steps_per_unit);
            let rounded = nearest(product, product);
            let is_off = (product - rounded).abs() > OFF_LATTICE_MAX;
            if self.rounding == Rounding::Reject && is_off {
                let what = format!(
                    "= {} is {product} steps, which is off the lattice",
                    at[axis]
                );
                return Err(SolidFault::new(format!("{pointer}/{axis}"), what));
            }
            steps[axis] = whole(rounded)
                .filter(|steps| steps.abs() <= i64::from(COORDINATE_MAX))
                .ok_or_else(|| {
                    let what = if at[axis].is_finite() {
                        let limit = self.user(i64::from(COORDINATE_MAX).into());
                        format!("= {} is outside -{limit} to {limit}", at[axis])
                    } else {
                        "is not a finite number".to_owned()
                    };
                    SolidFault::new(format!("{pointer}/{axis}"), what)
                })?;
        }
        Ok(Point::new(steps).expect("every coordinate was checked"))
    }

    /// The whole number of steps that a length has.
    /// # Errors
    /// What is wrong with it: not above 0, too long, or not a whole number of steps.
    pub(super) fn length(self, length: f64) -> Result<u32, String> {
        let steps = length * f64::from(self.steps_per_unit);
        let rounded = steps.round();
        if !length.is_finite() {
            return Err("is not a finite number".to_owned());
        }
        if (steps - rounded).abs() > OFF_LATTICE_MAX {
            let per_unit = self.steps_per_unit;
            return Err(format!(
                "= {length} is {steps} steps of 1/{per_unit} unit, which is not a whole number"
            ));
        }
        whole(rounded)
            .filter(|steps| (1..=EXTENT_MAX).contains(steps))
            .and_then(|steps| u32::try_from(steps).ok())
            .ok_or_else(|| {
                let limit = self.user(EXTENT_MAX.into());
                format!("= {length} is not above 0 and at most {limit}")
            })
    }

    /// A length of a [`Deviation`] in user units.
    pub fn deviation(self, length: u64) -> f64 {
        self.user(length.into()) / float(Deviation::STEP.into())
    }

    /// A lattice point in user units.
    pub fn position(self, point: Point) -> [f64; 3] {
        point.coordinates().map(|steps| self.user(steps.into()))
    }

    /// A length in user units.
    pub(super) fn user(self, steps: i128) -> f64 {
        float(steps) / f64::from(self.steps_per_unit)
    }

    /// `steps_per_unit` to a power: exact up to 2^53, else within a few units in the last place.
    pub(super) fn power(self, power: usize) -> f64 {
        std::iter::repeat_n(f64::from(self.steps_per_unit), power).product()
    }
}

/// An angle in degrees as millionths of a degree, rounded.
/// # Errors
/// What is wrong with it.
pub(super) fn angle(degrees: f64, below: f64) -> Result<u32, String> {
    let parts = (degrees * PARTS_OF_DEGREE).round();
    whole(parts)
        .filter(|_| degrees < below)
        .and_then(|parts| u32::try_from(parts).ok())
        .filter(|&parts| parts > 0)
        .ok_or_else(|| format!("= {degrees} degrees is not above 0 and below {below}"))
}
