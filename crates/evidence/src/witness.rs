//! Witnesses: what an owner states about its chain and recorder is signed, countersigned by another party, and checked;
//! `witnesses/` of a bundle.

use authros_crypto::{CryptoError, Provider, SmKeyPair, domain, signer_id};
use authros_model::wire::WireError;
use authros_model::{
    Address, Countersignature, Digest, Domain, Hash, Position, Signature, SignedPosition, SignerId, Timestamp,
};
use serde::{Deserialize, Serialize};

use crate::BundleError;
use crate::time::{MOST_ROOTS, StampTree, StampedRoot, in_order};

/// The folder of countersignatures in a bundle.
const WITNESSES: &str = "witnesses";
/// The countersignature.
const MEMBER: &str = "countersignature.bin";
/// Roots with their paths.
const ROOTS: &str = "roots.json";
/// The format name in `roots.json`.
const FORMAT: &str = "authros-witnessed/1";
const STATED: &[u8] = b"AuthROS/position/1";
const COUNTERSIGNED: &[u8] = b"AuthROS/countersignature/1";

/// Why a countersignature is not accepted.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum WitnessError {
    /// It is malformed.
    #[error("it is not of its form: {0}")]
    Form(#[from] WireError),
    /// The statement is not signed by the key that it names.
    #[error("the statement is not signed by the key {0} that it names")]
    Stated(SignerId),
    /// The countersignature is not by the key that it names.
    #[error("it is not signed by the key {0} that it names as the witness's")]
    Countersigned(SignerId),
    /// It is over another statement than was sent.
    #[error("it is over another statement than the one that was sent")]
    OtherStatement,
    /// It is by another witness.
    #[error("it is by {found} with the key {key}, not by the witness that was asked")]
    OtherWitness {
        /// The account that it names.
        found: Address,
        /// Its key.
        key: SignerId,
    },
}

/// The network that a position is about.
pub fn network_of(position: &Position) -> Domain {
    domain(position.chain_id, &position.genesis, &position.contract)
}

fn stated_bytes(position: &Position) -> Vec<u8> {
    [STATED, &network_of(position).0, &position.encode()].concat()
}

fn countersigned_bytes(countersignature: &Countersignature) -> Vec<u8> {
    [COUNTERSIGNED, &network_of(&countersignature.stated.position).0, &countersignature.unsigned()].concat()
}

/// Signs a position; its key becomes the signer's.
///
/// # Errors
/// If the key cannot sign.
pub fn state(position: Position, signer: &SmKeyPair, provider: &dyn Provider) -> Result<SignedPosition, CryptoError> {
    let position = Position { key: signer.public, ..position };
    let signature = provider.sign(&signer.secret, &stated_bytes(&position))?;
    Ok(SignedPosition { position, signature })
}

/// Countersigns what was stated. The caller must have checked it.
///
/// # Errors
/// If the key cannot sign.
pub fn countersign(
    stated: SignedPosition,
    at: Timestamp,
    (witness, signer): (Address, &SmKeyPair),
    provider: &dyn Provider,
) -> Result<Countersignature, CryptoError> {
    let bare =
        Countersignature { stated, at, witness, key: signer.public, signature: Signature([0; Signature::LENGTH]) };
    let signature = provider.sign(&signer.secret, &countersigned_bytes(&bare))?;
    Ok(Countersignature { signature, ..bare })
}

/// Checks that a position is signed by the key that it names.
///
/// # Errors
/// [`WitnessError::Stated`].
pub fn check_position(stated: &SignedPosition, provider: &dyn Provider) -> Result<(), WitnessError> {
    let key = &stated.position.key;
    let signed = provider.verify(key, &stated_bytes(&stated.position), &stated.signature);
    signed.map_err(|_| WitnessError::Stated(signer_id(key)))
}

/// Checks both signatures of a countersignature. Whose keys these are is for the caller to know.
///
/// # Errors
/// [`WitnessError::Countersigned`] or [`WitnessError::Stated`].
pub fn check_countersignature(found: &Countersignature, provider: &dyn Provider) -> Result<(), WitnessError> {
    let signed = provider.verify(&found.key, &countersigned_bytes(found), &found.signature);
    signed.map_err(|_| WitnessError::Countersigned(signer_id(&found.key)))?;
    check_position(&found.stated, provider)
}

/// Checks that a countersignature is by this witness, besides its signatures.
///
/// # Errors
/// [`WitnessError`].
pub fn check_witness(
    found: &Countersignature,
    (account, key): (Address, SignerId),
    provider: &dyn Provider,
) -> Result<(), WitnessError> {
    let by = signer_id(&found.key);
    if (found.witness, by) != (account, key) {
        return Err(WitnessError::OtherWitness { found: found.witness, key: by });
    }
    check_countersignature(found, provider)
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Listed {
    format: String,
    roots: Vec<StampedRoot>,
}

/// A countersignature in a bundle, and the roots of batches that are under it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BundledCountersignature {
    /// Not checked yet.
    pub countersignature: Countersignature,
    /// Those shown by the bundle, each once, in their order.
    pub roots: Vec<StampedRoot>,
}

impl BundledCountersignature {
    /// Whether a root's path leads to what was stated.
    pub(crate) fn leads(&self, place: &StampedRoot) -> bool {
        let Position { top, count, .. } = self.countersignature.stated.position;
        place.leads_to(&top, count)
    }
}

/// The members of one countersignature.
pub(crate) fn members(
    countersignature: &Countersignature,
    tree: &StampTree,
    wanted: &[Hash],
    provider: &dyn Provider,
) -> Result<[(String, Vec<u8>); 2], BundleError> {
    let listed = Listed { format: FORMAT.to_owned(), roots: tree.places(wanted) };
    let text = serde_json::to_vec_pretty(&listed).map_err(|error| BundleError::of(ROOTS, &error.to_string()))?;
    let bytes = countersignature.encode();
    let folder = format!("{WITNESSES}/{}", Digest(provider.sm3(&[&bytes])).to_hex());
    Ok([(format!("{folder}/{MEMBER}"), bytes), (format!("{folder}/{ROOTS}"), text)])
}

/// A countersignature whose files are read one by one.
#[derive(Default)]
pub(crate) struct DraftCountersignature {
    countersignature: Option<Countersignature>,
    roots: Option<Vec<StampedRoot>>,
}

impl DraftCountersignature {
    pub fn take(&mut self, name: &str, part: &str, bytes: &[u8]) -> Result<(), BundleError> {
        let wrong = |why: &str| BundleError::of(name, why);
        match part {
            MEMBER => {
                let found = Countersignature::parse(bytes).map_err(|error| wrong(&error.to_string()))?;
                self.countersignature = Some(found);
            }
            ROOTS => {
                let listed: Listed = serde_json::from_slice(bytes).map_err(|error| wrong(&error.to_string()))?;
                if listed.format != FORMAT {
                    return Err(wrong(&format!("its format is not {FORMAT}")));
                }
                if listed.roots.len() > MOST_ROOTS {
                    return Err(wrong(&format!("it has more than {MOST_ROOTS} roots")));
                }
                in_order(name, &listed.roots)?;
                self.roots = Some(listed.roots);
            }
            _ => return Err(wrong("does not belong to a countersignature")),
        }
        Ok(())
    }

    pub fn finish(self, hash: &Hash, provider: &dyn Provider) -> Result<BundledCountersignature, BundleError> {
        let folder = format!("{WITNESSES}/{}", hash.to_hex());
        let missing = |part: &str| BundleError::of(&format!("{folder}/{part}"), "is missing");
        let countersignature = self.countersignature.ok_or_else(|| missing(MEMBER))?;
        let roots = self.roots.ok_or_else(|| missing(ROOTS))?;
        if provider.sm3(&[&countersignature.encode()]) != hash.0 {
            return Err(BundleError::of(&folder, "is filed under another countersignature's name"));
        }
        Ok(BundledCountersignature { countersignature, roots })
    }
}
