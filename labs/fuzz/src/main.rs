//! libFuzzer over the target that `AUTHROS_FUZZ` names.
#![no_main]

use std::sync::OnceLock;

use authros_fuzz::TARGETS;

static TARGET: OnceLock<fn(&[u8]) -> bool> = OnceLock::new();

/// The work of the named target; without one the program ends and lists them.
fn target() -> fn(&[u8]) -> bool {
    let wanted = std::env::var("AUTHROS_FUZZ").unwrap_or_default();
    let Some(target) = TARGETS.iter().find(|target| target.name == wanted) else {
        let names: Vec<&str> = TARGETS.iter().map(|target| target.name).collect();
        eprintln!("set AUTHROS_FUZZ to one of: {}", names.join(" "));
        std::process::exit(2);
    };
    target.run
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    TARGET.get_or_init(target)(data);
});
