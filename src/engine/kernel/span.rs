//! Boxes of lattice points or of space.

use crate::geometry::{Bounds, Place};

/// A box of lattice points, both ends included; or of space, as a closed box. Steps, local to a cube or in the scene.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(in crate::engine) struct Span {
    pub(in crate::engine) min: [i32; 3],
    pub(in crate::engine) max: [i32; 3],
}

impl Span {
    /// The closed cube at a corner.
    pub(in crate::engine) fn cube(corner: [i32; 3], edge: i32) -> Self {
        Self {
            min: corner,
            max: corner.map(|low| low + edge),
        }
    }

    /// Whether it has a volume.
    pub(in crate::engine) fn is_solid(&self) -> bool {
        (0..3).all(|axis| self.min[axis] < self.max[axis])
    }

    pub(in crate::engine) fn contains(&self, other: &Self) -> bool {
        (0..3).all(|axis| self.min[axis] <= other.min[axis] && other.max[axis] <= self.max[axis])
    }

    pub(in crate::engine) fn clamped(&self, to: &Self) -> Self {
        Self {
            min: std::array::from_fn(|axis| self.min[axis].max(to.min[axis])),
            max: std::array::from_fn(|axis| self.max[axis].min(to.max[axis])),
        }
    }

    /// The cells next to a box of points.
    pub(in crate::engine) fn grown(&self) -> Self {
        Self {
            min: self.min.map(|low| low - 1),
            max: self.max.map(|high| high + 1),
        }
    }

    pub(in crate::engine) fn moved(&self, by: [i32; 3]) -> Self {
        Self {
            min: std::array::from_fn(|axis| self.min[axis] + by[axis]),
            max: std::array::from_fn(|axis| self.max[axis] + by[axis]),
        }
    }

    /// The box around two boxes.
    pub(in crate::engine) fn joined(&self, other: &Self) -> Self {
        Self {
            min: std::array::from_fn(|axis| self.min[axis].min(other.min[axis])),
            max: std::array::from_fn(|axis| self.max[axis].max(other.max[axis])),
        }
    }

    /// Volume of the common part of two boxes.
    pub(in crate::engine) fn overlap(&self, other: &Self) -> u128 {
        let common = self.clamped(other);
        if !common.is_solid() {
            return 0;
        }
        (0..3)
            .map(|axis| u128::from(common.max[axis].abs_diff(common.min[axis])))
            .product()
    }

    /// A box in coordinates local to the cube at `place`; saturated far away, since only what is near the cube matters.
    pub(in crate::engine) fn local(bounds: &Bounds, place: Place) -> Self {
        let corner = place.corner();
        let local = |from: [i32; 3]| [0, 1, 2].map(|axis| from[axis].saturating_sub(corner[axis]));
        Self {
            min: local(bounds.min),
            max: local(bounds.max),
        }
    }
}
