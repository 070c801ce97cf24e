//! The only place that decides who may sign and who may read.
//!
//! A right to sign is judged at the block that anchors a record: by the state after all events of that block, at that
//! block's own time. A right to read is judged at the moment of reading, by a named policy. Both answers give the
//! right, or say in words why there is none.

mod contract;
mod reading;
mod signers;
mod signing;
#[cfg(test)]
mod tests;
mod waiting;

pub use contract::ask_contract;
pub use reading::{Policy, ReadRefused, ReadingRight, may_read, shared_with, standing_grant, standing_grants};
pub use signers::Signers;
pub use signing::{Moment, NoRight, SigningRight, is_lent, is_suspended, key_of, may_sign, right_of, signer_of};
pub use waiting::settle_waiting;
