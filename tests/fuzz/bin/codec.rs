#![cfg_attr(fuzzing, no_main)]
//! Fuzzes `codec`.

#[path = "../targets.rs"]
mod targets;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| targets::target("codec")(bytes));
