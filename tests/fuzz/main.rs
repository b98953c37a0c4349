//! Runs the fuzz targets over their corpora and over seeded mutations of them: a short smoke run on any toolchain. For a long one,
//! with coverage, `cargo +nightly fuzz run --fuzz-dir tests/fuzz TARGET` (in `bin/` is a program for each).
//!
//! Those programs are what runs here: only libFuzzer is another, the macro below, so that they compile wherever the tests do.
#![allow(
    clippy::duplicate_mod,
    reason = "each program in bin/ is one of its own, with its own targets"
)]

extern crate self as libfuzzer_sys;

use std::fs;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};

#[path = "bin/codec.rs"]
mod codec;
#[path = "bin/decode.rs"]
mod decode;
#[path = "bin/moves.rs"]
mod moves;
#[path = "../oracle/random.rs"]
mod random;
#[path = "bin/wal.rs"]
mod wal;

use random::Random;

/// In the place of libFuzzer's: what it would run becomes a function.
#[macro_export]
macro_rules! fuzz_target {
    (|$bytes:ident: &[u8]| $body:expr) => {
        pub(crate) fn fuzz($bytes: &[u8]) {
            $body;
        }
    };
}

/// What one of the programs does with an input.
type Target = fn(&[u8]);

const MUTATIONS_PER_TARGET: u64 = 4_000;
const INPUT_BYTES_MAX: usize = 20_000;

fn corpus(target: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let directory = root.join("tests/fuzz/corpus").join(target);
    let mut files: Vec<_> = fs::read_dir(&directory)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    assert!(!files.is_empty(), "{} is empty", directory.display());
    let read = |path: PathBuf| (path.clone(), fs::read(path).unwrap());
    files.into_iter().map(read).collect()
}

fn index(random: &mut Random, end: usize) -> usize {
    usize::try_from(random.below(end as u64)).unwrap()
}

/// Some bytes changed, taken out, doubled, or taken from another input.
fn mutate(bytes: &mut Vec<u8>, other: &[u8], random: &mut Random) {
    for _ in 0..=random.below(4) {
        let at = index(random, bytes.len() + 1);
        let rest = bytes.len() - at;
        let size = index(random, rest.min(64) + 1);
        match random.below(7) {
            0 if rest > 0 => bytes[at] ^= 1 << random.below(8),
            1 if rest > 0 => {
                bytes[at] = [0, 1, 0x7f, 0x80, 0xff, b'0', b'"', b'-', b'}'][index(random, 9)];
            }
            2 => bytes.truncate(at),
            3 => drop(bytes.drain(at..at + size)),
            4 => {
                let piece = bytes[at..at + size].to_vec();
                bytes.splice(at..at, piece);
            }
            5 => {
                let from = index(random, other.len() + 1);
                let piece = &other[from..other.len().min(from + 64)];
                bytes.splice(at..at + size, piece.iter().copied());
            }
            _ => bytes.insert(at, random.next().to_le_bytes()[0]),
        }
    }
    bytes.truncate(INPUT_BYTES_MAX);
}

/// Runs one input; when it fails it is left where it can be put into the corpus.
fn run(name: &str, target: Target, bytes: &[u8], origin: &str) {
    if catch_unwind(|| target(bytes)).is_err() {
        let path = std::env::temp_dir().join(format!("union3d-fuzz-{name}"));
        fs::write(&path, bytes).unwrap();
        panic!("{name} fails on {origin}, kept in {}", path.display());
    }
}

fn smoke(name: &str, target: Target) {
    let corpus = corpus(name);
    for (path, bytes) in &corpus {
        run(name, target, bytes, &path.display().to_string());
    }
    let mut random = Random::new(1);
    for mutation in 0..MUTATIONS_PER_TARGET {
        let (path, bytes) = &corpus[index(&mut random, corpus.len())];
        let (_, other) = &corpus[index(&mut random, corpus.len())];
        let mut bytes = bytes.clone();
        mutate(&mut bytes, other, &mut random);
        let origin = format!("mutation {mutation}, of {}", path.display());
        run(name, target, &bytes, &origin);
    }
}

#[test]
fn bodies_of_requests() {
    smoke("decode", decode::fuzz);
}

#[test]
fn packed_cubes_and_totals() {
    smoke("codec", codec::fuzz);
}

#[test]
fn write_ahead_files() {
    smoke("wal", wal::fuzz);
}

#[test]
fn programs_of_machines() {
    smoke("moves", moves::fuzz);
}
