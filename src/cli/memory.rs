//! Keeps this process's memory private: it holds keys.

use rustix::process::{DumpableBehavior, Resource, Rlimit, set_dumpable_behavior, setrlimit};

/// From now on no core file is written, and processes of the same user can neither attach to this one nor read its
/// memory; root can. Child processes inherit only the first.
pub fn keep_private() {
    // If the system refuses either, the program is still useful.
    setrlimit(Resource::Core, Rlimit { current: Some(0), maximum: Some(0) }).ok();
    set_dumpable_behavior(DumpableBehavior::NotDumpable).ok();
}
