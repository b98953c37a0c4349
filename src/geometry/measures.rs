//! The measures of a union: sums over lattice points, exact, with the proof that they fit their types.

use ethnum::I256;

use super::lattice::{Bounds, COORDINATE_MAX, CUBES_MAX, EDGE_MAX};
use super::octants::{EdgeKind, OctantMask, VertexKind};
use super::weights::WEIGHTS;

/// All additive measures of a union of cubes, exact integers. Also the type of a difference between two unions.
///
/// Moments are about the lattice origin. The default is the empty union's.
/// # Source
/// W. R. Franklin, "Analysis of mass properties of the union of millions of polyhedra", 2004: local topological formulas.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Measures {
    /// Volume. Units: steps cubed. Range: below 2^93.
    pub volume: i128,
    /// Twice the integrals of x, y and z. Units: steps^4. Range: below 2^125.
    pub first_moments2: [i128; 3],
    /// Three times the integrals of x^2, y^2 and z^2. Units: steps^5. Range: below 2^157.
    pub second_moments3: [I256; 3],
    /// Four times the integrals of x*y, y*z and z*x. Units: steps^5. Range: below 2^157.
    pub product_moments4: [I256; 3],
    /// Area of the faces whose normal is along x, y and z. Units: steps squared. Range: below 2^83.
    pub area_by_axis: [i128; 3],
    /// Length of the edges along x, y and z (outer index), by [`EdgeKind`]. Units: steps.
    pub edge_length: [[i128; 3]; 3],
    /// Eight times the Euler characteristic of the closed set.
    pub euler8: i64,
    /// Number of vertices by [`VertexKind`].
    pub vertices: [i64; 4],
}

impl Measures {
    /// Adds a difference, as an insertion does.
    pub fn add(&mut self, difference: &Self) {
        self.combine(
            difference,
            i128::wrapping_add,
            I256::wrapping_add,
            i64::wrapping_add,
        );
    }

    /// Retracts a difference, as a deletion does.
    pub fn retract(&mut self, difference: &Self) {
        self.combine(
            difference,
            i128::wrapping_sub,
            I256::wrapping_sub,
            i64::wrapping_sub,
        );
    }

    /// Field by field, modulo two to the width: sums may wrap on the way (local sums may not be small), the true result fits.
    fn combine(
        &mut self,
        other: &Self,
        wide: impl Fn(i128, i128) -> i128,
        widest: impl Fn(I256, I256) -> I256,
        narrow: impl Fn(i64, i64) -> i64,
    ) {
        self.volume = wide(self.volume, other.volume);
        for axis in 0..3 {
            self.first_moments2[axis] = wide(self.first_moments2[axis], other.first_moments2[axis]);
            self.second_moments3[axis] =
                widest(self.second_moments3[axis], other.second_moments3[axis]);
            self.product_moments4[axis] =
                widest(self.product_moments4[axis], other.product_moments4[axis]);
            self.area_by_axis[axis] = wide(self.area_by_axis[axis], other.area_by_axis[axis]);
            for kind in 0..3 {
                self.edge_length[axis][kind] =
                    wide(self.edge_length[axis][kind], other.edge_length[axis][kind]);
            }
        }
        self.euler8 = narrow(self.euler8, other.euler8);
        for kind in 0..4 {
            self.vertices[kind] = narrow(self.vertices[kind], other.vertices[kind]);
        }
    }

    /// The measures of one box: of its eight corners.
    pub fn of_box(bounds: Bounds) -> Self {
        let mut sums = Self::default();
        for corner in 0..8 {
            let high = [0, 1, 2].map(|axis| corner >> axis & 1 == 1);
            let [x, y, z] = [0, 1, 2].map(|axis| {
                i128::from(if high[axis] {
                    bounds.max[axis]
                } else {
                    bounds.min[axis]
                })
            });
            // At its lower end along an axis the box fills the octants above, at its upper end those below.
            let filled = 7 - corner;
            sums.add_point(OctantMask(1 << filled), [x, y, z]);
        }
        sums
    }

    /// Adds what one lattice point contributes. The slow way: the engine's kernel does it for many points at once.
    fn add_point(&mut self, mask: OctantMask, at: [i128; 3]) {
        let weights = &WEIGHTS[usize::from(mask.0)];
        let volume = i128::from(weights.volume) * at[0] * at[1] * at[2];
        self.volume += volume;
        for axis in 0..3 {
            let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
            let wide = |number: i128| I256::from(number);
            self.first_moments2[axis] += volume * at[axis];
            self.second_moments3[axis] += wide(volume * at[axis]) * wide(at[axis]);
            self.product_moments4[axis] += wide(volume * at[axis]) * wide(at[next]);
            self.area_by_axis[axis] += i128::from(weights.area[axis]) * at[next] * at[last];
            for kind in 0..3 {
                self.edge_length[axis][kind] += i128::from(weights.edge[axis][kind]) * at[axis];
            }
        }
        self.euler8 += i64::from(weights.euler8);
        if let Some(kind) = weights.vertex {
            self.vertices[kind as usize] += 1;
        }
    }

    /// Surface area. Units: steps squared.
    pub fn area(&self) -> i128 {
        self.area_by_axis.iter().sum()
    }

    /// Length of all edges of one kind. Units: steps.
    pub fn edge_length_of(&self, kind: EdgeKind) -> i128 {
        self.edge_length
            .iter()
            .map(|axis| axis[kind as usize])
            .sum()
    }

    /// Length of all edges, each counted once as a set of points. Units: steps.
    pub fn edge_length_total(&self) -> i128 {
        self.edge_length.iter().flatten().sum()
    }

    /// Euler characteristic of the closed set: pieces minus tunnels plus cavities.
    pub fn euler_characteristic(&self) -> i64 {
        debug_assert!(
            self.euler8 % 8 == 0,
            "the points of a closed set add up to whole cells"
        );
        self.euler8 / 8
    }

    /// Number of vertices of one kind.
    pub fn vertices_of(&self, kind: VertexKind) -> i64 {
        self.vertices[kind as usize]
    }

    /// Number of vertices of every kind.
    pub fn vertices_total(&self) -> i64 {
        self.vertices.iter().sum()
    }
}

// The proof that the true values fit. A union lies in the box of side 2^31 around the origin.
const SIDE_BITS: u32 = (2 * COORDINATE_MAX as i64).ilog2();
const COORDINATE_BITS: u32 = COORDINATE_MAX.ilog2();
const _: () = assert!(SIDE_BITS == 31 && COORDINATE_BITS == 30);
// volume <= side^3
const _: () = assert!(3 * SIDE_BITS <= 93);
// twice a first moment <= 2 * |x| * volume
const _: () = assert!(1 + COORDINATE_BITS + 93 < 127);
// three or four times a second moment <= 4 * |x|^2 * volume
const _: () = assert!(2 + 2 * COORDINATE_BITS + 93 < 255);
// area <= six faces of every cube
const _: () = assert!((6 * CUBES_MAX as u128).ilog2() + 1 + 2 * EDGE_MAX.ilog2() <= 83);
// edge length of one direction <= every lattice line of the box
const _: () = assert!(3 * SIDE_BITS < 127);
// vertices: the union of n congruent axis-parallel cubes in space has O(n) of them (Boissonnat, Sharir, Tagansky, Yvinec,
// "Voronoi diagrams in higher dimensions under certain polyhedral distance functions", 1998); 2^30 for each cube is far
// beyond the constant
const _: () = assert!(CUBES_MAX.ilog2() + 30 < 63);
