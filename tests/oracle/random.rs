//! Random numbers for tests and benchmarks.

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

    pub(crate) fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    /// A number below `bound`.
    pub(crate) fn below(&mut self, bound: u64) -> u64 {
        let scaled = (u128::from(self.next()) * u128::from(bound)) >> 64;
        u64::try_from(scaled).expect("it is less than the bound")
    }

    /// A number from `min` to `max`, both included.
    pub(crate) fn within(&mut self, min: i64, max: i64) -> i64 {
        let count = (max - min + 1).cast_unsigned();
        min + self.below(count).cast_signed()
    }
}
