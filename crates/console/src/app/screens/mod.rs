//! The state of the screens that have one: rows, cursor, filter and order.

pub mod gateway;
pub mod grants;
pub mod log;
pub mod records;
pub mod topics;
