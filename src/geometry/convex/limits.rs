//! How large a solid may be, and the proof that all exact predicates fit their integers.

use super::super::lattice::COORDINATE_MAX;

/// Greatest extent of a solid along an axis, in steps (inclusive): `2^21`.
pub const EXTENT_MAX: i64 = 1 << 21;

/// Most vertices of a solid: 4,096.
pub const VERTICES_MAX: usize = 1 << 12;

// The magnitudes below are powers of two; a sum of three terms is below four times the greatest.
const COORDINATE_BITS: u32 = COORDINATE_MAX.ilog2();
const EXTENT_BITS: u32 = EXTENT_MAX.ilog2();
/// A component of a normal is a difference of two products of two extents.
const NORMAL_BITS: u32 = 2 * EXTENT_BITS + 1;
/// The offset of a plane is a sum of three products of a normal's component and a coordinate.
const OFFSET_BITS: u32 = NORMAL_BITS + COORDINATE_BITS + 2;
/// The triple product of three normals is a sum of six products.
const TRIPLE_BITS: u32 = 3 * NORMAL_BITS + 3;
/// The determinant of four planes is a sum of four products of an offset and a triple product.
const DETERMINANT_BITS: u32 = OFFSET_BITS + TRIPLE_BITS + 2;

const _: () = assert!(COORDINATE_BITS == 30 && COORDINATE_MAX == 1 << COORDINATE_BITS);
const _: () = assert!(EXTENT_MAX == 1 << EXTENT_BITS);
const _: () = assert!(NORMAL_BITS <= 45, "a normal's component fits an i64");
// A point's value in a plane is below twice the offset's bound.
const _: () = assert!(OFFSET_BITS < 77, "an offset fits an i128");
const _: () = assert!(TRIPLE_BITS <= 138, "a triple product needs 256 bits");
const _: () = assert!(DETERMINANT_BITS <= 217, "a determinant fits 256 bits");
// Facets and half-edges of a convex polyhedron with v vertices: at most 2v - 4 and 6v - 12.
const _: () = assert!(6 * VERTICES_MAX < u16::MAX as usize);
