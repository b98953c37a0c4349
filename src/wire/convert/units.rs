//! User units to lattice steps and back.
//!
//! ```text
//!   at ── * steps_per_unit ── - edge/2 when `at` is a centre ── round or refuse ── Place
//! ```

use super::numbers::{OFF_LATTICE_MAX, float, nearest, whole};
use super::settings::{Anchor, Rounding, Settings};
use crate::geometry::{COORDINATE_MAX, InvalidCube, Place};

/// Why a coordinate of `at` is refused.
#[derive(Clone, Copy, PartialEq, Debug, thiserror::Error)]
pub enum InvalidCoordinate {
    /// NaN or infinite.
    #[error("is not a finite number")]
    NotFinite,
    /// Between two steps, under [`Rounding::Reject`].
    #[error("puts the lower corner at {steps} steps, which is off the lattice")]
    OffLattice {
        /// Where the lower corner would be, in steps.
        steps: f64,
    },
    /// A corner of the cube would lie too far out.
    #[error("puts a corner of the cube outside -{limit} to {limit}")]
    OutOfRange {
        /// The farthest coordinate, in user units.
        limit: f64,
    },
}

impl Settings {
    /// The place of the cube that a client puts `at`, in user units.
    /// # Errors
    /// The first axis at fault, with what is wrong.
    pub fn place(&self, at: [f64; 3]) -> Result<Place, (usize, InvalidCoordinate)> {
        let mut corner = [0; 3];
        for axis in 0..3 {
            corner[axis] = self
                .corner_steps(at[axis])
                .map_err(|invalid| (axis, invalid))?;
        }
        Place::new(corner, self.edge)
            .map_err(|InvalidCube { axis, .. }| (axis, self.out_of_range()))
    }

    /// What is wrong with one coordinate of an `at`, if anything.
    pub fn coordinate_fault(&self, at: f64) -> Option<InvalidCoordinate> {
        match self.corner_steps(at) {
            Ok(steps) => match Place::new([steps, 0, 0], self.edge) {
                Ok(_) => None,
                Err(InvalidCube { .. }) => Some(self.out_of_range()),
            },
            Err(invalid) => Some(invalid),
        }
    }

    /// Where a client is told that a cube is. Units: user units.
    pub fn at(&self, place: Place) -> [f64; 3] {
        place.corner().map(|corner| match self.anchor {
            Anchor::Corner => self.user(i64::from(corner)),
            // Twice the centre is a whole number of steps, half of it may not be.
            Anchor::Center => self.user(2 * i64::from(corner) + i64::from(self.edge.steps())) / 2.0,
        })
    }

    /// The lattice point of a point in user units. Points beyond every cube are drawn in to just outside their range.
    /// # Errors
    /// The first axis at fault, with what is wrong.
    pub fn point(&self, at: [f64; 3]) -> Result<[i32; 3], (usize, InvalidCoordinate)> {
        let mut point = [0; 3];
        for axis in 0..3 {
            let far = f64::from(COORDINATE_MAX) + 1.0;
            let steps = (at[axis] * f64::from(self.steps_per_unit)).clamp(-far, far);
            let steps = self
                .round(steps, steps)
                .map_err(|invalid| (axis, invalid))?;
            point[axis] = i32::try_from(steps).expect("2^30 + 1 fits");
        }
        Ok(point)
    }

    /// A lattice point in user units.
    pub fn point_user(&self, point: [i32; 3]) -> [f64; 3] {
        point.map(|steps| self.user(i64::from(steps)))
    }

    /// The lower corner's coordinate for one coordinate of `at`. Units: steps. Its range is not checked yet.
    fn corner_steps(&self, at: f64) -> Result<i64, InvalidCoordinate> {
        let product = at * f64::from(self.steps_per_unit);
        let corner = match self.anchor {
            Anchor::Corner => product,
            Anchor::Center => product - f64::from(self.edge.steps()) / 2.0,
        };
        if product.is_finite() && corner.abs() > 4.0 * f64::from(COORDINATE_MAX) {
            return Err(self.out_of_range());
        }
        self.round(corner, product)
    }

    /// The whole number of steps for `steps`, which was computed from `product`.
    pub(super) fn round(&self, steps: f64, product: f64) -> Result<i64, InvalidCoordinate> {
        let rounded = nearest(steps, product);
        match self.rounding {
            Rounding::Reject if (steps - rounded).abs() > OFF_LATTICE_MAX => {
                Err(InvalidCoordinate::OffLattice { steps })
            }
            _ => whole(rounded).ok_or(InvalidCoordinate::NotFinite),
        }
    }

    fn out_of_range(&self) -> InvalidCoordinate {
        InvalidCoordinate::OutOfRange {
            limit: self.user(i64::from(COORDINATE_MAX)),
        }
    }

    /// A length in user units.
    pub(super) fn user(&self, steps: i64) -> f64 {
        float(i128::from(steps)) / f64::from(self.steps_per_unit)
    }

    /// `steps_per_unit` to a power: exact up to 2^53, else within a few units in the last place.
    pub(super) fn scale(&self, power: usize) -> f64 {
        std::iter::repeat_n(f64::from(self.steps_per_unit), power).product()
    }

    /// A volume in user units. Units of `steps3`: steps cubed.
    pub fn volume_user(&self, steps3: i128) -> f64 {
        float(steps3) / self.scale(3)
    }

    /// An area in user units. Units of `steps2`: steps squared.
    pub fn area_user(&self, steps2: i128) -> f64 {
        float(steps2) / self.scale(2)
    }
}
