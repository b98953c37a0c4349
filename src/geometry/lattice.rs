//! Coordinates, edges and cubes: where bytes become types, checked once.
//!
//! Everything is counted in *lattice steps*. What a step is in millimetres is the business of `wire`.

/// Largest absolute coordinate of any corner of a cube, in steps (inclusive): `2^30`.
/// # Source
/// The ranges of the measures are proved from this, [`EDGE_MAX`] and [`CUBES_MAX`] in `measures.rs`.
pub const COORDINATE_MAX: i32 = 1 << 30;

/// Largest edge of a cube, in steps (inclusive): `2^24`.
pub const EDGE_MAX: u32 = 1 << 24;

/// Most cubes a scene can hold: `2^31`.
pub const CUBES_MAX: u64 = 1 << 31;

/// A far corner is a sum of a coordinate and an edge; both must fit an `i32` on the way.
const _: () = assert!(COORDINATE_MAX as i64 + 2 * EDGE_MAX as i64 <= i32::MAX as i64);

/// Edge length of every cube of a scene. Units: steps. Range: 1 to [`EDGE_MAX`].
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Edge(u32);

/// Why a number is not an [`Edge`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("edge of {steps} steps is outside 1 to {EDGE_MAX}")]
pub struct InvalidEdge {
    /// The number that was offered.
    pub steps: i64,
}

impl Edge {
    /// The edge of `steps` steps.
    /// # Errors
    /// [`InvalidEdge`] outside 1 to [`EDGE_MAX`].
    pub fn new(steps: i64) -> Result<Self, InvalidEdge> {
        match u32::try_from(steps) {
            Ok(edge @ 1..=EDGE_MAX) => Ok(Self(edge)),
            _ => Err(InvalidEdge { steps }),
        }
    }

    /// The edge as a signed number of steps, ready to be added to a coordinate.
    pub const fn steps(self) -> i32 {
        self.0.cast_signed()
    }
}

/// The client's own name of a cube, unique in its scene.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct CubeId(pub u64);

/// Lower corner of a cube: the corner with the least x, y and z. Units: steps.
///
/// Both it and the far corner lie within [`COORDINATE_MAX`] of the origin on every axis.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct Place([i32; 3]);

/// Why three numbers are not the [`Place`] of a cube.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{} = {coordinate} steps puts a corner of the cube outside -{COORDINATE_MAX} to {COORDINATE_MAX}", ["x", "y", "z"][*axis])]
pub struct InvalidCube {
    /// The axis at fault: 0 for x, 1 for y, 2 for z.
    pub axis: usize,
    /// The coordinate of the lower corner that was offered.
    pub coordinate: i64,
}

impl Place {
    /// The place whose lower corner is `corner`, for cubes of `edge`.
    /// # Errors
    /// [`InvalidCube`] names the first axis on which a corner lies more than [`COORDINATE_MAX`] from the origin.
    pub fn new(corner: [i64; 3], edge: Edge) -> Result<Self, InvalidCube> {
        let mut place = [0; 3];
        for (axis, (&coordinate, to)) in corner.iter().zip(&mut place).enumerate() {
            let lowest = -i64::from(COORDINATE_MAX);
            let highest = i64::from(COORDINATE_MAX - edge.steps());
            *to = match i32::try_from(coordinate) {
                Ok(inside) if (lowest..=highest).contains(&coordinate) => inside,
                _ => return Err(InvalidCube { axis, coordinate }),
            };
        }
        Ok(Self(place))
    }

    /// The place of a corner that came from a `Place` of the same edge: for storage that keeps coordinates in columns.
    pub(crate) const fn from_checked(corner: [i32; 3]) -> Self {
        Self(corner)
    }

    /// The lower corner: x, y, z in steps.
    pub const fn corner(self) -> [i32; 3] {
        self.0
    }
}

/// Axis-aligned closed box around all cubes of a scene. Units: steps.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Bounds {
    /// Least corner.
    pub min: [i32; 3],
    /// Greatest corner.
    pub max: [i32; 3],
}

impl Bounds {
    /// The box around both.
    #[must_use]
    pub fn union(&self, other: &Self) -> Self {
        Self {
            min: [0, 1, 2].map(|axis: usize| self.min[axis].min(other.min[axis])),
            max: [0, 1, 2].map(|axis: usize| self.max[axis].max(other.max[axis])),
        }
    }
}

/// A block of material that the cubes are cut from: an axis-aligned closed box with a volume. Units: steps.
///
/// Its corners lie within [`COORDINATE_MAX`] of the origin on every axis.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Stock(Bounds);

/// Why a box is not a [`Stock`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
pub enum InvalidStock {
    /// A corner lies too far out.
    #[error("{} = {coordinate} steps is outside -{COORDINATE_MAX} to {COORDINATE_MAX}", ["x", "y", "z"][*axis])]
    OutOfRange {
        /// The axis at fault: 0 for x, 1 for y, 2 for z.
        axis: usize,
        /// The coordinate that was offered.
        coordinate: i64,
    },
    /// The box has no extent along an axis.
    #[error("the greatest {} is not above the least", ["x", "y", "z"][*axis])]
    Flat {
        /// The axis at fault: 0 for x, 1 for y, 2 for z.
        axis: usize,
    },
}

impl Stock {
    /// The box between two corners.
    /// # Errors
    /// [`InvalidStock`] names the first axis at fault.
    pub fn new(min: [i64; 3], max: [i64; 3]) -> Result<Self, InvalidStock> {
        let corner = |from: [i64; 3]| -> Result<[i32; 3], InvalidStock> {
            let mut corner = [0; 3];
            for axis in 0..3 {
                let coordinate = from[axis];
                corner[axis] = i32::try_from(coordinate)
                    .ok()
                    .filter(|inside| inside.abs_diff(0) <= COORDINATE_MAX.cast_unsigned())
                    .ok_or(InvalidStock::OutOfRange { axis, coordinate })?;
            }
            Ok(corner)
        };
        let (min, max) = (corner(min)?, corner(max)?);
        match (0..3).find(|&axis| min[axis] >= max[axis]) {
            Some(axis) => Err(InvalidStock::Flat { axis }),
            None => Ok(Self(Bounds { min, max })),
        }
    }

    /// The box.
    pub const fn bounds(&self) -> Bounds {
        self.0
    }
}
