//! Keeps this process's memory private, because it holds keys, and the allocator's share of it small.

use rustix::process::{DumpableBehavior, Resource, Rlimit, set_dumpable_behavior, setrlimit};

/// Forbids core files, and debuggers of the same user; children inherit only the former.
pub fn keep_private() {
    // The program is useful even if the system refuses.
    setrlimit(Resource::Core, Rlimit { current: Some(0), maximum: Some(0) }).ok();
    set_dumpable_behavior(DumpableBehavior::NotDumpable).ok();
}

#[cfg(all(target_os = "linux", target_env = "gnu"))]
const ARENAS: libc::c_int = 2;

/// Bounds glibc's arenas before the first thread starts: with the default, a site held three times the memory that it
/// used (`docs/decisions/026-platform-and-packages.md`). `MALLOC_ARENA_MAX` stays in force.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub fn keep_few_arenas() {
    if std::env::var_os("MALLOC_ARENA_MAX").is_none() {
        bound_arenas();
    }
}

#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub fn keep_few_arenas() {}

#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[allow(unsafe_code, reason = "no library offers this setting")]
fn bound_arenas() {
    // SAFETY: mallopt takes two numbers and no pointer; there is one thread yet. If it refuses, all is as before.
    unsafe {
        libc::mallopt(libc::M_ARENA_MAX, ARENAS);
    }
}
