//! See `authros_fuzz::key_allocation`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    authros_fuzz::key_allocation::run(data);
});
