//! See `authros_fuzz::state_proof`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    authros_fuzz::state_proof::run(data);
});
