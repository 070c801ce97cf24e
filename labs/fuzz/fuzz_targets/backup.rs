//! See `authros_fuzz::backup`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    authros_fuzz::backup::run(data);
});
