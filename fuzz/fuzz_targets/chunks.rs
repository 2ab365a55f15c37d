//! See `gatherlight_tests::fuzz`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| gatherlight_tests::fuzz::run("chunks", bytes));
