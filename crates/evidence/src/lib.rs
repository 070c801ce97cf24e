//! Evidence bundles: one file with sealed records, their signatures, and the proof of when an Ethereum contract anchored
//! them; checked offline by somebody who trusts neither the exporter nor a node.
//!
//! A bundle (`NAME.authros`) is a ZIP archive that any program opens. [`Bundle::read`] takes it apart, strictly and within
//! bounds; [`verify()`] holds it against a [`Trust`] that its reader wrote down by another way: chain, contract and its
//! code, the signers of blocks and how many of them are enough, who is behind an account. The answer is a [`Report`] in
//! levels, never one tick:
//!
//! * (a) the bytes are intact, and signed by a key;
//! * (b) the key was its owner's, or a device's lent by him, at the anchoring block, and he was not suspended;
//! * (c) the record was anchored in a block, sealed by so many of the pinned signers, or by the exporter's own chain,
//!   which proves nothing against him;
//! * (d) an outside authority's time: this version has none;
//! * (e) the message, where its owner disclosed the record;
//! * (f) which numbers of a topic are there, and which are missing.
//!
//! ```
//! use authros_crypto::{ProviderName, provider};
//! use authros_evidence::{Bundle, Outcome, Packing, Trust, pack, verify};
//! # use authros_crypto::SmKeyPair;
//! # use authros_evidence::ClaimedChain;
//! # use authros_model::{Address, Hash};
//!
//! let provider = provider(ProviderName::default());
//! # let chain = ClaimedChain { id: 7, genesis: Hash([1; 32]), contract: Address([2; 20]) };
//! # let key = SmKeyPair::generate(provider)?;
//! # let file = pack(&Packing::default().sign(chain, Address([3; 20]), &key, provider)?)?;
//! let trust = Trust::parse(
//!     br#"
//!     [chain]
//!     id = 7
//!     genesis = "0x0101010101010101010101010101010101010101010101010101010101010101"
//!     contract = "0x0202020202020202020202020202020202020202"
//!     code_hash = "0x0303030303030303030303030303030303030303030303030303030303030303"
//!     signers = ["0x0404040404040404040404040404040404040404"]
//! "#,
//! )?;
//! let bundle = Bundle::parse(&file, provider)?;
//! let report = verify(&bundle, Some(&trust), provider);
//! for record in &report.records {
//!     for (letter, level) in record.levels() {
//!         println!("{} ({letter}) {}: {}", record.digest, level.standing.word(), level.text);
//!     }
//! }
//! // There is no record in it, so nothing is proven.
//! assert_eq!(report.outcome, Outcome::Incomplete);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! There is no network, no database and no asynchronous code in this crate. SM2, SM3 and SM4 are `authros-crypto`'s,
//! Keccak-256 and secp256k1 are of `sha3` and `k256`, RLP of `rlp`.

mod anchoring;
pub mod archive;
mod bundle;
mod completeness;
mod header;
mod manifest;
mod packing;
mod report;
mod signing;
mod state;
#[cfg(test)]
mod tests;
pub mod trie;
mod trust;
mod verify;

pub use bundle::{
    AnchorClaim, Anchoring, Bundle, BundleError, BundledRecord, Disclosure, MOST_RECORDS, READ_ME, SUGGESTED,
};
pub use header::{BlockHeader, LONGEST_HEADER, Seals, seals};
pub use manifest::{ClaimedChain, Exporter, FORMAT, MEDIA_TYPE, Manifest, Member};
pub use packing::{Packing, PackingError, disclose, pack};
pub use report::{Disclosed, Level, Outcome, RecordReport, Report, Standing, Stretch};
pub use state::{AnchorWord, KeysWord, LoanWord, Nodes, Slot, Storage, Unproven, Word};
pub use trust::{LONGEST_TRUST, Person, PinnedChain, Trust, TrustError};
pub use verify::verify;
