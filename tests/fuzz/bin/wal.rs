#![no_main]
//! Fuzzes `wal`.

#[path = "../targets.rs"]
mod targets;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| targets::TARGETS[2].1(bytes));
