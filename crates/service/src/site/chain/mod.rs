//! The chain: the link to it, the accounts that anchor, its administration, and the move to another one.

pub(super) mod administration;
pub(super) mod connection;
pub(super) mod lanes;
pub(super) mod link;
#[cfg(test)]
mod tests;
