//! Random numbers for all tests and benchmarks.
#![allow(dead_code, reason = "not everybody needs every kind of number")]

/// A small deterministic generator (xorshift64*): the same numbers on every machine and in every version, so that a seed is
/// enough to see the same again, and recorded figures and golden hashes keep their meaning. The generators of the `rand` crate
/// may change their numbers from version to version.
#[derive(Clone, Debug)]
pub(crate) struct Random(u64);

impl Random {
    /// In a test the seed is printed: the harness shows the last one, which is the one at fault, when the test fails.
    pub(crate) fn new(seed: u64) -> Self {
        if cfg!(test) {
            println!("random numbers from seed {seed}");
        }
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    /// Any number.
    pub(crate) fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    /// A number below `bound`, which is more than 0, as the same type.
    pub(crate) fn below<Number: TryInto<u64> + TryFrom<u64>>(&mut self, bound: Number) -> Number {
        let bound: Option<u64> = bound.try_into().ok();
        let bound =
            bound.expect("a bound is not negative, and no random number is longer than 64 bits");
        let scaled = (u128::from(self.next()) * u128::from(bound)) >> 64;
        let scaled = u64::try_from(scaled).expect("it is less than the bound");
        Number::try_from(scaled)
            .ok()
            .expect("it is less than the bound")
    }

    /// A number from `min` to `max`, both included.
    pub(crate) fn within(&mut self, min: i64, max: i64) -> i64 {
        min + self.below(max - min + 1)
    }
}
