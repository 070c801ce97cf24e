//! Evidence bundles: one file with sealed records, their signatures and the proof of when they were anchored, checked
//! offline by somebody who trusts neither the exporter nor a node.
#![doc = include_str!("../README.md")]

mod anchoring;
pub mod archive;
mod bundle;
mod committed;
mod completeness;
mod disclosure;
mod form;
mod header;
mod heights;
mod known;
mod manifest;
mod packing;
#[cfg(test)]
mod readme_tests;
pub mod recorded;
mod report;
mod signing;
mod stamping;
mod state;
#[cfg(test)]
mod tests;
pub mod time;
pub mod trie;
mod trust;
mod verify;

pub use bundle::{
    AnchorClaim, Anchoring, Bundle, BundleError, BundledRecord, Disclosure, MOST_RECORDS, READ_ME, REPORT, SUGGESTED,
};
pub use committed::{Committed, Flaw, Protocol, validators_in};
pub use header::{BlockHeader, LONGEST_HEADER, Seals, seals};
pub use heights::{Height, MOST_HEIGHTS};
pub use manifest::{ClaimedChain, Exporter, FORMAT, MEDIA_TYPE, Manifest, Member};
pub use packing::{Packing, PackingError, READ_ME_TEXT, disclose, pack};
pub use report::{Disclosed, HeadsClaim, Level, Outcome, RecordReport, Report, Standing, Stretch};
pub use state::{AnchorWord, KeysWord, LoanWord, Nodes, Slot, Storage, Unproven, Word};
pub use trust::{LONGEST_TRUST, Person, PinnedAuthority, PinnedChain, Trust, TrustError};
pub use verify::verify;
