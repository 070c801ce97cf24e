//! See `authros_fuzz::recording`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    authros_fuzz::recording::mcap(data);
});
