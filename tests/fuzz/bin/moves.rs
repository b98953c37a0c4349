#![no_main]
//! Fuzzes `moves`.

#[path = "../targets.rs"]
mod targets;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| targets::TARGETS[3].1(bytes));
