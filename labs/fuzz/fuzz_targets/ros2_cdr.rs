//! See `authros_fuzz::ros2_cdr`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    authros_fuzz::ros2_cdr::run(data);
});
