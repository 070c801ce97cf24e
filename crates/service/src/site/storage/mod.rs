//! What lies on the disk: room for it, how long it is kept, and whether it is sound after a crash.

mod integrity;
mod retention;
pub(super) mod room;
