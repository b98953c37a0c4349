//! Floats and whole numbers of steps.

/// How far from a whole number of steps an edge, or under rounding that rejects a coordinate, may be. Units: steps.
pub(in crate::wire) const OFF_LATTICE_MAX: f64 = 1e-6;

/// The whole number nearest to `steps`, which was computed from `product`; halves away from zero.
///
/// The decimal 0.0145 times 1000 is a half in the client's eyes, though not in floats: what reading and multiplying can have lost is given
/// back. At 2^30 steps that is below a millionth of a step.
pub(in crate::wire) fn nearest(steps: f64, product: f64) -> f64 {
    let lost = product.abs() * 4.0 * f64::EPSILON;
    (steps.abs() + lost).round().copysign(steps)
}

/// The whole number that a float is; none for fractions, NaN, and beyond 2^53.
pub(in crate::wire) fn whole(number: f64) -> Option<i64> {
    const EXACT_MAX: f64 = 9_007_199_254_740_992.0;
    if !(number.abs() <= EXACT_MAX && number.fract() == 0.0) {
        return None;
    }
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a whole number of at most 2^53"
    )]
    let integer = number as i64;
    Some(integer)
}

/// The float nearest to an integer.
#[expect(
    clippy::cast_precision_loss,
    reason = "floats are for people; `exact` has the integers"
)]
pub(in crate::wire) fn float(integer: i128) -> f64 {
    integer as f64
}
