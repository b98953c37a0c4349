//! Random numbers for tests: the generator of the benchmarks.

#[path = "../../src/cli/bench/random.rs"]
mod generator;

pub(crate) use generator::Random;
