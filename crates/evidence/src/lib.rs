//! Evidence bundles: one file with sealed records, their signatures and the proof of when they were anchored, checked
//! offline by somebody who trusts neither the exporter nor a node.
#![doc = include_str!("../README.md")]
#![warn(missing_docs, clippy::missing_errors_doc)]

pub mod archive;
mod bundle;
mod committed;
mod completeness;
mod manifest;
#[cfg(test)]
mod readme_tests;
pub mod recorded;
mod report;
mod state;
#[cfg(test)]
mod tests;
pub mod time;
pub mod trie;
mod trust;
mod verdict;
mod verify;

pub use bundle::{
    AnchorClaim, Anchoring, Bundle, BundleError, BundledRecord, Disclosure, MOST_RECORDS, Packing, PackingError,
    READ_ME, READ_ME_TEXT, REPORT, SUGGESTED, pack,
};
pub use committed::{BlockHeader, Committed, Flaw, LONGEST_HEADER, Protocol, Seals, seals, validators_in};
pub use completeness::{Height, MOST_HEIGHTS};
pub use manifest::{ClaimedChain, Exporter, FORMAT, MEDIA_TYPE, Manifest, Member, Suite, named_format};
pub use report::{Disclosed, HeadsClaim, Level, Outcome, Reason, RecordReport, Report, Standing, Stretch};
pub use state::{AnchorWord, KeysWord, LoanWord, Nodes, Slot, Storage, Unproven, Word};
pub use trust::{LONGEST_TRUST, Person, PinnedAuthority, PinnedChain, Trust, TrustError};
pub use verify::verify;
