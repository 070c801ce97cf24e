//! `manifest.json`: every member with its length and hashes, and the chain that the bundle claims to be of; and the
//! exporter's signature over it.

use authros_crypto::{Provider, pool, signature_from_der, signer_id};
use authros_model::{Address, Hash, PublicKey, SignerId, clean};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::BundleError;
use crate::archive::{MIMETYPE, Members};
use crate::form;

/// The form of a bundle.
pub const FORMAT: &str = "authros-evidence/1";
/// The content of `mimetype`, and the type that the exporter's signature is for.
pub const MEDIA_TYPE: &str = "application/vnd.authros.evidence+zip";
/// The manifest's name.
pub const MANIFEST: &str = "manifest.json";
/// The name of its signature, DER.
pub const SIGNATURE: &str = "manifest.der";
/// Members hashed side by side.
const AT_ONCE: usize = 64;
/// Members not in the manifest: itself, its signature, and those that are the same in each bundle.
const UNLISTED: [&str; 3] = [MIMETYPE, MANIFEST, SIGNATURE];

/// The manifest.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: String,
    /// The chain that it claims to be of.
    pub chain: ClaimedChain,
    /// Its exporter.
    pub exporter: Exporter,
    /// Every other member, by name.
    pub members: Vec<Member>,
}

/// A chain and its contract, as the exporter names them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClaimedChain {
    /// Its id (EIP-155).
    pub id: u64,
    /// Hash of block 0.
    pub genesis: Hash,
    /// The contract.
    pub contract: Address,
}

/// Who made a bundle.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exporter {
    /// The account.
    pub account: Address,
    /// SM3 of the key that signed the manifest; the key is among the members.
    pub key: SignerId,
}

/// One member.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Member {
    /// Its name.
    pub name: String,
    /// Its length.
    pub bytes: u64,
    /// SM3 of it.
    pub sm3: Hash,
    /// SHA-256 of it.
    pub sha256: Hash,
}

impl Member {
    fn of_each(members: &[(&String, &Vec<u8>)], provider: &dyn Provider) -> Vec<Self> {
        let texts: Vec<&[u8]> = members.iter().map(|(_, bytes)| bytes.as_slice()).collect();
        let of = |((name, bytes), sm3): (&(&String, &Vec<u8>), [u8; 32])| {
            let (sm3, sha256) = (Hash(sm3), Hash(Sha256::digest(bytes).into()));
            Self { name: (*name).clone(), bytes: bytes.len() as u64, sm3, sha256 }
        };
        members.iter().zip(provider.sm3_many(&texts)).map(of).collect()
    }
}

impl Manifest {
    /// Of these members.
    pub fn of(members: &Members, chain: ClaimedChain, exporter: Exporter, provider: &dyn Provider) -> Self {
        let listed: Vec<(&String, &Vec<u8>)> =
            members.iter().filter(|(name, _)| !UNLISTED.contains(&name.as_str())).collect();
        let bytes = listed.iter().map(|(_, bytes)| bytes.len()).fold(0, usize::saturating_add);
        let pieces: Vec<&[(&String, &Vec<u8>)]> = listed.chunks(AT_ONCE).collect();
        let hashed = |piece: &&[(&String, &Vec<u8>)]| Member::of_each(piece, provider);
        let members = pool::each(&pieces, pool::helpers_for(pieces.len(), bytes), hashed);
        let members = members.into_iter().flatten().collect();
        Self { format: FORMAT.to_owned(), chain, exporter, members }
    }

    /// From a bundle's members: it names each of them as it is, and no other.
    ///
    /// # Errors
    /// [`BundleError`] for the first that differs.
    pub fn read(members: &Members, provider: &dyn Provider) -> Result<Self, BundleError> {
        if members.get(MIMETYPE).is_none_or(|text| text != MEDIA_TYPE.as_bytes()) {
            return Err(BundleError::of(MIMETYPE, "does not say that this is an evidence bundle"));
        }
        let text = members.get(MANIFEST).ok_or_else(|| BundleError::of(MANIFEST, "is missing"))?;
        let manifest: Self = form::from_json(text).map_err(|error| BundleError::of(MANIFEST, &error))?;
        if manifest.format != FORMAT {
            let found = clean(&manifest.format, 40);
            return Err(BundleError::of(
                MANIFEST,
                &format!("has the format '{found}', but this program reads {FORMAT}"),
            ));
        }
        let expected = Self::of(members, manifest.chain.clone(), manifest.exporter.clone(), provider);
        let (mut named, mut there) = (manifest.members.iter(), expected.members.iter());
        loop {
            match (named.next(), there.next()) {
                (None, None) => return Ok(manifest),
                (Some(named), Some(there)) if named == there => {}
                (Some(named), Some(there)) if named.name == there.name => {
                    return Err(BundleError::of(&named.name, "does not match the manifest: its bytes were altered"));
                }
                (Some(named), there) if there.is_none_or(|there| named.name < there.name) => {
                    return Err(BundleError::of(&named.name, "is named in the manifest but missing"));
                }
                (_, Some(there)) => {
                    return Err(BundleError::of(&there.name, "is present but not named in the manifest"));
                }
                (Some(named), None) => {
                    return Err(BundleError::of(&named.name, "is named in the manifest but missing"));
                }
            }
        }
    }
}

/// The data signed by the exporter: DSSE's pre-authentication encoding of the manifest's bytes, so that no other text
/// has the same.
pub fn signed_bytes(manifest: &[u8]) -> Vec<u8> {
    let head = format!("DSSEv1 {} {MEDIA_TYPE} {} ", MEDIA_TYPE.len(), manifest.len());
    [head.as_bytes(), manifest].concat()
}

/// Whether the exporter's key signed the manifest.
pub fn is_signed(members: &Members, exporter: &Exporter, key: &PublicKey, provider: &dyn Provider) -> bool {
    let (Some(text), Some(signature)) = (members.get(MANIFEST), members.get(SIGNATURE)) else { return false };
    let Ok(signature) = signature_from_der(signature) else { return false };
    signer_id(key) == exporter.key && provider.verify(key, &signed_bytes(text), &signature).is_ok()
}
