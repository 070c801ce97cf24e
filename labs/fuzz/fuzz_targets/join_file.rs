//! See `authros_fuzz::join_file`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    authros_fuzz::join_file::run(data);
});
