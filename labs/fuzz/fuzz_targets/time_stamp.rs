//! See `authros_fuzz::time_stamp`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    authros_fuzz::time_stamp::run(data);
});
