//! The audit: the log of deeds, what is only counted, and the audit of the records themselves.

mod log;
mod records;
pub(super) mod refusals;
