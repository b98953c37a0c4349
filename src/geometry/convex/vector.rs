//! Products of vectors of integers.

/// The cross product of two differences of points of a solid. Units: steps squared. Range: `|component| <= 2^43`.
pub fn cross(a: [i64; 3], b: [i64; 3]) -> [i64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// The dot product of two vectors of any 64-bit integers, exact while its terms are below `2^125`.
pub fn dot(a: [i64; 3], b: [i64; 3]) -> i128 {
    let product = |axis: usize| i128::from(a[axis]) * i128::from(b[axis]);
    product(0) + product(1) + product(2)
}

/// The vector between two points given as vectors: `a - b`.
pub(super) fn difference(a: [i64; 3], b: [i64; 3]) -> [i64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// The vector divided by the greatest common divisor of its components.
pub(super) fn reduced(vector: [i64; 3]) -> [i64; 3] {
    let [x, y, z] = vector.map(i64::unsigned_abs);
    match i64::try_from(greatest_common_divisor(greatest_common_divisor(x, y), z)) {
        Ok(0 | 1) | Err(_) => vector,
        Ok(divisor) => vector.map(|component| component / divisor),
    }
}

/// Stein's binary algorithm.
fn greatest_common_divisor(mut a: u64, mut b: u64) -> u64 {
    if a == 0 || b == 0 {
        return a | b;
    }
    let shift = (a | b).trailing_zeros();
    a >>= a.trailing_zeros();
    while b != 0 {
        b >>= b.trailing_zeros();
        (a, b) = (a.min(b), a.abs_diff(b));
    }
    a << shift
}
