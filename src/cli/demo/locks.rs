//! Each check of the opening order proved on its own: a forgery that only this check can refuse.

use crate::crypto::{
    Anchor, CryptoError, Expected, Names, Provider, SealRequest, SmKeyPair, TopicKey, open, record, seal,
};
use crate::model::head::Compression;
use crate::model::{Digest, Head, Signature};
use crate::pipeline::reader::Reader;
use crate::pipeline::{Network, Owner, Plant};
use crate::service::Failure;
use crate::store::RecordRow;

/// A genuine record with everything that opens it.
pub struct Genuine {
    pub(super) row: RecordRow,
    blob: Vec<u8>,
    key: TopicKey,
    pair: SmKeyPair,
    expected: Expected,
}

impl Genuine {
    /// Takes a record of `owner` from the vault.
    ///
    /// # Errors
    /// If it is not there.
    pub fn take(plant: &Plant, network: &Network, owner: &Owner, row: RecordRow) -> Result<Self, Failure> {
        let missing = || crate::pipeline::PipelineError::Missing(row.id.clone());
        let blob = plant.vault.get(row.digest)?.ok_or_else(missing)?;
        let key = Reader { plant, network, reader: owner }.topic_key(&row)?;
        let expected = Expected::any_of(network.domain, owner.address, Names::Derived(owner.index()));
        Ok(Self { blob, key, pair: owner.signing(), expected, row })
    }

    fn open(
        &self,
        provider: &dyn Provider,
        blob: &[u8],
        signature: &Signature,
        anchor: Anchor,
    ) -> Result<(), CryptoError> {
        open(provider, blob, signature, &self.pair.public, anchor, &self.key, &self.expected).map(drop)
    }

    /// A bit of the body flipped, then signed again by the owner and anchored: only the tag can tell.
    fn resigned(&self, provider: &dyn Provider) -> Result<(Vec<u8>, Signature, Digest), Failure> {
        let mut blob = self.blob.clone();
        if let Some(byte) = blob.last_mut() {
            *byte ^= 1;
        }
        let digest = Digest(provider.sm3(&[&blob]));
        let signature = provider.sign(&self.pair.secret, &record::signed_bytes(&self.expected.domain, &digest))?;
        Ok((blob, signature, digest))
    }
}

/// Names of the checks that let their forgery pass; empty = all checks work.
///
/// # Errors
/// If a forgery cannot even be made.
pub fn broken(provider: &dyn Provider, one: &Genuine, other: &Genuine) -> Result<Vec<&'static str>, Failure> {
    let mut broken = Vec::new();
    // Another genuine record in its place: only the comparison with the chain can tell.
    if one.open(provider, &other.blob, &other.row.signature, Anchor::Chain(one.row.digest)).is_ok() {
        broken.push("digest");
    }
    let stranger = SmKeyPair::generate(provider)?;
    let forged = provider.sign(&stranger.secret, &record::signed_bytes(&one.expected.domain, &one.row.digest))?;
    if one.open(provider, &one.blob, &forged, Anchor::Chain(one.row.digest)).is_ok() {
        broken.push("signature");
    }
    let wrong = TopicKey::generate()?;
    let opened = open(
        provider,
        &one.blob,
        &one.row.signature,
        &one.pair.public,
        Anchor::Chain(one.row.digest),
        &wrong,
        &one.expected,
    );
    if !matches!(opened, Err(CryptoError::WrongKey)) {
        broken.push("commit");
    }
    let (blob, signature, digest) = one.resigned(provider)?;
    if one.open(provider, &blob, &signature, Anchor::Chain(digest)).is_ok() {
        broken.push("tag");
    }
    Ok(broken)
}

/// A record sealed and signed by the owner that was never anchored, as a row that claims it was.
///
/// # Errors
/// If it cannot be sealed.
pub fn never_anchored(plant: &Plant, one: &Genuine) -> Result<(RecordRow, Vec<u8>), Failure> {
    let (header, _) =
        crate::model::Header::parse(&one.blob).map_err(|error| crate::service::failure::internal(error.to_string()))?;
    let opened = open(
        plant.provider,
        &one.blob,
        &one.row.signature,
        &one.pair.public,
        Anchor::Unanchored,
        &one.key,
        &one.expected,
    )?;
    let head = Head { compression: Compression::None, ..opened.head.clone() };
    let request = SealRequest {
        domain: header.domain,
        owner: header.owner,
        signer: &one.pair,
        epoch: header.epoch,
        topic_key: &one.key,
        recorder: header.recorder.prefix(),
        seq: header.seq,
        topic_id: header.topic_id,
        kind: header.kind,
        filters: header.filters,
        captured_at: header.captured_at,
        head: &head,
        body: &opened.body,
    };
    let sealed = seal(plant.provider, &request)?;
    let row = RecordRow { digest: sealed.digest, signature: sealed.signature, ..one.row.clone() };
    Ok((row, sealed.blob))
}
