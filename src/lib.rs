//! AuthROS: robot data shared under proof. See ARCHITECTURE.md for the rooms.

pub mod model;
