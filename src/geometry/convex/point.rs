//! Points of the lattice.

use super::super::lattice::COORDINATE_MAX;

/// A point of the lattice. Units: steps. Range: every coordinate within `2^30` of 0.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Point([i32; 3]);

/// Why three numbers are not a [`Point`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{} = {coordinate} steps is outside -{COORDINATE_MAX} to {COORDINATE_MAX}", ["x", "y", "z"][*axis])]
pub struct InvalidPoint {
    /// The axis at fault: 0 for x, 1 for y, 2 for z.
    pub axis: usize,
    /// The coordinate that was offered.
    pub coordinate: i64,
}

impl Point {
    /// Where all coordinates are 0.
    pub const ORIGIN: Self = Self([0; 3]);

    /// The point of these coordinates.
    /// # Errors
    /// [`InvalidPoint`] names the first axis on which it is too far out.
    pub fn new(coordinates: [i64; 3]) -> Result<Self, InvalidPoint> {
        let mut point = [0; 3];
        for (axis, (&coordinate, to)) in coordinates.iter().zip(&mut point).enumerate() {
            *to = i32::try_from(coordinate)
                .ok()
                .filter(|inside| (-COORDINATE_MAX..=COORDINATE_MAX).contains(inside))
                .ok_or(InvalidPoint { axis, coordinate })?;
        }
        Ok(Self(point))
    }

    /// x, y and z.
    pub const fn coordinates(self) -> [i32; 3] {
        self.0
    }

    /// x, y and z, ready for products.
    pub fn wide(self) -> [i64; 3] {
        self.0.map(i64::from)
    }

    /// The point displaced by a vector.
    /// # Errors
    /// [`InvalidPoint`] when that is too far out.
    pub fn displaced(self, by: [i64; 3]) -> Result<Self, InvalidPoint> {
        let at = self.wide();
        Self::new([0, 1, 2].map(|axis| at[axis].saturating_add(by[axis])))
    }
}
