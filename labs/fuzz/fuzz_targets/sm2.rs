//! See `authros_fuzz::sm2`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    authros_fuzz::sm2::run(data);
});
