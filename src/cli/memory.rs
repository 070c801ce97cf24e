//! The memory of this process is nobody else's: keys lie in it.

use rustix::process::{DumpableBehavior, Resource, Rlimit, set_dumpable_behavior, setrlimit};

/// From now on no core file is written, and processes of the same user can neither attach to this one nor read its
/// memory; root can. Children that are started inherit the first alone.
pub fn keep_private() {
    // Where the system refuses either, the program is of use all the same.
    setrlimit(Resource::Core, Rlimit { current: Some(0), maximum: Some(0) }).ok();
    set_dumpable_behavior(DumpableBehavior::NotDumpable).ok();
}
