//! Records as people see them: a profile's own and those that others share, listed, checked, opened and handed out.

mod names;
mod opened;
mod own;
mod shared;
mod statements;
pub(super) mod view;
