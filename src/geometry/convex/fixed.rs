//! Sines, cosines and roots in fixed point, so that a cutter has the same vertices on every machine.

/// Bits after the point of [`cosine_and_sine`].
const TURN_BITS: u32 = 60;

/// The ratio of a circle's circumference to its diameter. Units: `2^-60`, rounded.
pub(super) const PI: i128 = 3_622_009_729_038_561_421;

/// One, in the units of [`cosine_and_sine`].
pub(super) const ONE: i128 = 1 << TURN_BITS;

/// The product of two numbers in units of `2^-60`.
pub(super) const fn product(a: i128, b: i128) -> i128 {
    (a * b) >> TURN_BITS
}

/// Cosine and sine of `part / whole` of a turn, `0 <= part <= whole < 2^60`. Units: `2^-60`; the error is below `2^-54`.
///
/// Symmetric: the eight angles that mirror one another at the axes and their bisectors give the same two magnitudes.
pub(super) fn cosine_and_sine(part: u64, whole: u64) -> [i128; 2] {
    let eighths = 8 * (u128::from(part) % u128::from(whole));
    let octant = eighths / u128::from(whole);
    let rest = i128::try_from(eighths % u128::from(whole)).expect("below 2^60");
    let whole = i128::from(whole);
    let first = |part: i128| {
        let angle = PI / 4 * part / whole;
        [series(ONE, angle, 0), series(angle, angle, 1)]
    };
    let ([cosine, sine], [mirrored_cosine, mirrored_sine]) = (first(rest), first(whole - rest));
    match octant {
        0 => [cosine, sine],
        1 => [mirrored_sine, mirrored_cosine],
        2 => [-sine, cosine],
        3 => [-mirrored_cosine, mirrored_sine],
        4 => [-cosine, -sine],
        5 => [-mirrored_sine, -mirrored_cosine],
        6 => [sine, -cosine],
        _ => [mirrored_cosine, -mirrored_sine],
    }
}

/// Taylor's series from a first term of a power of an angle up to a quarter of pi, every second power with a changed sign.
fn series(first: i128, angle: i128, first_power: i128) -> i128 {
    let square = product(angle, angle);
    let (mut sum, mut term, mut power) = (first, first, first_power);
    while term != 0 {
        term = -product(term, square) / ((power + 1) * (power + 2));
        power += 2;
        sum += term;
    }
    sum
}

/// The square root of `number / 2^60`, in the same units, rounded down. Range: from 0 to below `2^66`.
pub(super) fn root(number: i128) -> i128 {
    (number << TURN_BITS).isqrt()
}
