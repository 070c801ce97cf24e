//! See `authros_fuzz::export_folder`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    authros_fuzz::export_folder::run(data);
});
