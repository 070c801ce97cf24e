//! See `authros_fuzz::countersignature`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    authros_fuzz::countersignature::run(data);
});
