//! What this process does with its memory: it keeps it private, for it holds keys, and lets the allocator keep little of it.

use rustix::process::{DumpableBehavior, Resource, Rlimit, set_dumpable_behavior, setrlimit};

/// From now on no core file is written, and processes of the same user can neither attach to this one nor read its
/// memory; root can. Child processes inherit only the first.
pub fn keep_private() {
    // If the system refuses either, the program is still useful.
    setrlimit(Resource::Core, Rlimit { current: Some(0), maximum: Some(0) }).ok();
    set_dumpable_behavior(DumpableBehavior::NotDumpable).ok();
}

/// The most arenas of the allocator.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const ARENAS: libc::c_int = 2;

/// Bounds the arenas of glibc's allocator, before the first thread starts. By default it makes up to eight for each core, and
/// every one keeps what its threads freed: with two cores, a site under load held three times the memory that it used
/// (`docs/decisions/072-few-arenas.md`). Somebody's own `MALLOC_ARENA_MAX` stays in force.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub fn keep_few_arenas() {
    if std::env::var_os("MALLOC_ARENA_MAX").is_none() {
        bound_arenas();
    }
}

/// Other allocators have no arenas to bound.
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
