pub(super) mod administration;
pub(super) mod connection;
pub(super) mod lanes;
pub(super) mod link;
#[cfg(test)]
mod tests;
