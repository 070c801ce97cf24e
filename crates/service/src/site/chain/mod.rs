//! The link to the chain, the anchoring accounts, the administration.

pub(super) mod administration;
pub(super) mod connection;
pub(super) mod link;
#[cfg(test)]
mod tests;
