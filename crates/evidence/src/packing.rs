//! The exporter's side: parts are collected into a bundle's members, and those into its file.

use authros_crypto::record::reveal_bytes;
use authros_crypto::{CryptoError, Provider, SmKeyPair, keyfile, signature_der, signer_id};
use authros_model::{Address, Digest, Domain, Hash, Identity, PublicKey};

use crate::archive::{self, MIMETYPE, Members};
use crate::bundle::{BundleError, BundledRecord, NODES, READ_ME, REPORT, SUGGESTED};
use crate::heights::{self, HEIGHTS, Height};
use crate::manifest::{ClaimedChain, Exporter, MANIFEST, MEDIA_TYPE, Manifest, SIGNATURE, signed_bytes};
use crate::state::Nodes;
use crate::time::{self, StampTree};
use crate::trust::Trust;

/// The text of `VERIFY.txt`, for somebody who finds the file without the program.
pub const READ_ME_TEXT: &str = include_str!("VERIFY.txt");

/// A bundle being assembled.
#[derive(Debug, Default)]
pub struct Packing {
    members: Members,
}

impl From<Members> for Packing {
    /// Signed members, to which something is to be added before they are signed again.
    fn from(members: Members) -> Self {
        Self { members }
    }
}

/// Why a bundle cannot be assembled.
#[derive(Debug, thiserror::Error)]
pub enum PackingError {
    /// It would be too large.
    #[error(transparent)]
    Bundle(#[from] BundleError),
    /// A key cannot be used.
    #[error(transparent)]
    Crypto(#[from] CryptoError),
}

impl Packing {
    /// Adds a record.
    ///
    /// # Errors
    /// None, except for a fault of this program.
    pub fn record(&mut self, digest: Digest, record: BundledRecord) -> Result<(), PackingError> {
        let mut put = |part: &str, bytes: Vec<u8>| {
            self.members.insert(format!("records/{}/{part}", digest.to_hex()), bytes);
        };
        if let Some(anchor) = &record.anchor {
            let text = serde_json::to_vec_pretty(anchor);
            put("anchor.json", text.map_err(|error| BundleError::of("anchor.json", &error.to_string()))?);
        }
        if let Some(disclosure) = &record.disclosure {
            put("reveal.bin", disclosure.secret.expose().to_vec());
            put("reveal.der", signature_der(&disclosure.signature));
        }
        put("signature.der", signature_der(&record.signature));
        put("record.bin", record.record);
        Ok(())
    }

    /// Adds a signer's key.
    ///
    /// # Errors
    /// If it is not a point on the curve.
    pub fn key(&mut self, key: &PublicKey) -> Result<(), PackingError> {
        let pem = keyfile::sm2_public_pem(key)?;
        self.members.insert(format!("keys/{}.pem", signer_id(key).to_hex()), pem.into_bytes());
        Ok(())
    }

    /// Adds an identity as on the chain.
    pub fn identity(&mut self, identity: &Identity) {
        let bytes = identity.encode();
        let hash = Hash(authros_crypto::keccak256(&[&bytes]));
        self.members.insert(format!("identities/{}.bin", hash.to_hex()), bytes);
    }

    /// Adds a block's header, RLP.
    pub fn header(&mut self, number: u64, bytes: Vec<u8>) {
        self.members.insert(format!("chain/{number}.rlp"), bytes);
    }

    /// The nodes of the states that the headers name.
    pub fn nodes(&mut self, nodes: &Nodes) {
        self.members.insert(NODES.to_owned(), nodes.encode());
    }

    /// Adds the text of a message definition.
    pub fn definition(&mut self, text: &str, provider: &dyn Provider) {
        let digest = Digest(provider.sm3(&[text.as_bytes()]));
        self.members.insert(format!("definitions/{}.txt", digest.to_hex()), text.as_bytes().to_vec());
    }

    /// Adds the paths from heads of recorders to the highest numbers of topics.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn heights(&mut self, heights: Vec<Height>) -> Result<(), PackingError> {
        self.members.insert(HEIGHTS.to_owned(), heights::to_text(heights)?);
        Ok(())
    }

    /// Adds an authority's stamps over these roots; all of them were stamped together.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn stamps(&mut self, tree: &StampTree, wanted: &[Hash], tokens: &[Vec<u8>]) -> Result<(), PackingError> {
        if !tokens.is_empty() {
            self.members.extend(time::members(tree, wanted, tokens)?);
        }
        Ok(())
    }

    /// Adds the page for people, which proves nothing.
    pub fn report(&mut self, page: String) {
        self.members.insert(REPORT.to_owned(), page.into_bytes());
    }

    /// Suggests what to pin.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn suggest(&mut self, trust: &Trust) -> Result<(), PackingError> {
        let text = trust.to_text().map_err(|error| BundleError::of(SUGGESTED, &error.to_string()))?;
        let note = "# What the exporter says. Compare each line with what you know from an independent source, then \
                    keep your own copy.\n";
        self.members.insert(SUGGESTED.to_owned(), [note, &text].concat().into_bytes());
        Ok(())
    }

    /// The members with the manifest, signed by its exporter.
    ///
    /// # Errors
    /// If the key cannot sign.
    pub fn sign(
        mut self,
        chain: ClaimedChain,
        account: Address,
        signer: &SmKeyPair,
        provider: &dyn Provider,
    ) -> Result<Members, PackingError> {
        self.key(&signer.public)?;
        self.members.insert(MIMETYPE.to_owned(), MEDIA_TYPE.as_bytes().to_vec());
        self.members.insert(READ_ME.to_owned(), READ_ME_TEXT.as_bytes().to_vec());
        let exporter = Exporter { account, key: signer_id(&signer.public) };
        let manifest = Manifest::of(&self.members, chain, exporter, provider);
        let mut text =
            serde_json::to_vec_pretty(&manifest).map_err(|error| BundleError::of(MANIFEST, &error.to_string()))?;
        text.push(b'\n');
        let signature = provider.sign(&signer.secret, &signed_bytes(&text))?;
        self.members.insert(SIGNATURE.to_owned(), signature_der(&signature));
        self.members.insert(MANIFEST.to_owned(), text);
        Ok(self.members)
    }
}

/// The file of these members.
///
/// # Errors
/// If it would be too large.
pub fn pack(members: &Members) -> Result<Vec<u8>, PackingError> {
    Ok(archive::write(members)?)
}

/// An owner's signature under the disclosure of a record.
///
/// # Errors
/// If the key cannot sign.
pub fn disclose(
    secret: authros_crypto::record::RecordSecret,
    (domain, digest): (&Domain, &Digest),
    signer: &SmKeyPair,
    provider: &dyn Provider,
) -> Result<crate::bundle::Disclosure, PackingError> {
    let signature = provider.sign(&signer.secret, &reveal_bytes(domain, digest, &secret))?;
    Ok(crate::bundle::Disclosure { secret, signature })
}
