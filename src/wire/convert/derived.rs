//! Quantities that follow from the exact measures: centroid and inertia.
//!
//! Floats are made last: what cancels (the inertia of a small part far from the origin) cancels in integers.

use ethnum::I256;

use super::numbers::float;
use super::settings::Settings;
use crate::geometry::{COORDINATE_MAX, Measures};

/// Centre of mass of a set that is not empty, in user units.
pub(super) fn centroid(measures: &Measures, settings: &Settings) -> [f64; 3] {
    let volume2 = I256::from(2 * measures.volume);
    measures
        .first_moments2
        .map(|moment| ratio(I256::from(moment), volume2) / settings.scale(1))
}

// The proof that the integers of `inertia` fit I256: with |x| <= 2^30 and V <= 2^93, a second moment times three is at most
// 3 * 2^153 and twice a first moment at most 2^124, so that 4 V (B + B) and 3 (A A + A A) are each at most 24 * 2^246.
const _: () = assert!(COORDINATE_MAX.ilog2() == 30 && 246 + 24u32.ilog2() + 1 < 255);

/// Inertia tensor about the centroid, in mass times user units squared.
///
/// With V the volume, A twice the first, B three times the second and P four times the product moments, the central moments are
/// (4 V B - 3 A A) / 12 V and (V P - A A') / 4 V. The numerators are exact, so that a scene far from the origin loses nothing.
pub(super) fn inertia(measures: &Measures, settings: &Settings) -> [[f64; 3]; 3] {
    if measures.volume == 0 {
        return [[0.0; 3]; 3];
    }
    let volume = I256::from(measures.volume);
    let first = measures.first_moments2.map(I256::from);
    let second = measures.second_moments3;
    // The density comes last: a tiny one would leave nothing of the rest.
    let moment = |steps5: f64| steps5 / settings.scale(5) * settings.density;
    let mut tensor = [[0.0; 3]; 3];
    for axis in 0..3 {
        let (one, two) = ((axis + 1) % 3, (axis + 2) % 3);
        let around = 4 * volume * (second[one] + second[two])
            - 3 * (first[one] * first[one] + first[two] * first[two]);
        tensor[axis][axis] = moment(ratio(around, 12 * volume));
        // Products are kept in the order xy, yz, zx: that of `axis` and the next one. The sign is turned in integers: no -0.0.
        let product = first[axis] * first[one] - volume * measures.product_moments4[axis];
        let product = moment(ratio(product, 4 * volume));
        tensor[axis][one] = product;
        tensor[one][axis] = product;
    }
    tensor
}

/// The float nearest to an integer of 256 bits.
pub(in crate::wire) fn float256(integer: I256) -> f64 {
    const KEPT_BITS: u32 = 100;
    if let Ok(narrow) = i128::try_from(integer) {
        return float(narrow);
    }
    let magnitude = integer.unsigned_abs();
    let shift = 256 - magnitude.leading_zeros() - KEPT_BITS;
    let kept = magnitude >> shift;
    // A lost bit only matters for a tie, 47 bits further up: it is enough to know whether there was one.
    let lost = i128::from(kept << shift != magnitude);
    let kept = i128::try_from(kept).expect("100 bits fit") | lost;
    let size = float(kept) * 2f64.powi(shift.cast_signed());
    if integer < I256::ZERO { -size } else { size }
}

/// A quotient of integers as a float, right to the last place or two however large both are. The divisor is positive.
pub(super) fn ratio(dividend: I256, divisor: I256) -> f64 {
    float256(dividend / divisor) + float256(dividend % divisor) / float256(divisor)
}
