#![cfg_attr(fuzzing, no_main)]
//! Fuzzes `decode`.

#[path = "../targets.rs"]
mod targets;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| targets::target("decode")(bytes));
