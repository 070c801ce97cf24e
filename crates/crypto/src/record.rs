//! Sealing and opening of records (docs/format.md, section 4). Opening checks in one fixed order and shows nothing
//! before the last check: parse, digest, signature, commitment, tags, what was requested,
//! names that belong to their pseudonyms. Where blobs come from and
//! whether a signer may sign for an owner is decided elsewhere.

use zeroize::{Zeroize as _, Zeroizing};

use crate::model::head::{Compression, MOST_TAGS};
use crate::model::header::{LARGEST_BODY, LARGEST_HEAD, LARGEST_SEQ, LARGEST_STORED, MOST_FILTERS, TAG_LENGTH};
use crate::model::{
    Address, Commit, Digest, Domain, FilterId, Head, Header, RecordKind, RecorderPrefix, Salt, Signature, Timestamp,
    TopicId,
};

use super::kdf::{Info, derived};
use super::{CryptoError, Provider, SmKeyPair, TopicKey, random_bytes, signer_id};

mod many;
mod naming;
mod opening;
mod reveal;
mod steps;

pub use many::{Checked, Unchecked, check_alone, check_many};
pub use naming::Names;
pub use opening::{Anchor, Expected, OpenedRecord, check, check_deleted, open, open_front, open_in_steps};
pub use reveal::{RecordSecret, Revealed, open_revealed, open_revealed_within, reveal_bytes};
pub use steps::Step;

/// Everything that is sealed into one record.
#[derive(Debug)]
pub struct SealRequest<'a> {
    /// The network it belongs to.
    pub domain: Domain,
    /// The owner.
    pub owner: Address,
    /// The signer: the owner's d_C or a lent device.
    pub signer: &'a SmKeyPair,
    /// The epoch that `topic_key` belongs to, from 1.
    pub epoch: u64,
    /// The key it is sealed under.
    pub topic_key: &'a TopicKey,
    /// The ledger or ring that records it; with the signer it makes the recorder id.
    pub recorder: RecorderPrefix,
    /// From 1 to [`LARGEST_SEQ`], per owner, signer, recorder and topic.
    pub seq: u64,
    /// Pseudonym of the topic.
    pub topic_id: TopicId,
    /// The kind of record.
    pub kind: RecordKind,
    /// Pseudonyms of type and tags, at most four.
    pub filters: Vec<FilterId>,
    /// When the message was captured.
    pub captured_at: Timestamp,
    /// The part that only readers may see; its plain length is that of the message.
    pub head: &'a Head,
    /// The message, compressed as the head says.
    pub body: &'a [u8],
}

/// A record as it is stored and anchored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SealedRecord {
    /// Its public header, as at the start of `blob`.
    pub header: Header,
    /// Header, sealed head and sealed body.
    pub blob: Vec<u8>,
    /// SM3 of `blob`.
    pub digest: Digest,
    /// The signer's signature over label, domain and digest.
    pub signature: Signature,
}

/// Seals one record under a fresh random salt.
///
/// # Errors
/// [`CryptoError::Length`] or [`CryptoError::Inconsistent`] if a field is out of bounds, [`CryptoError::Random`] if the
/// random source fails.
pub fn seal(provider: &dyn Provider, request: &SealRequest<'_>) -> Result<SealedRecord, CryptoError> {
    seal_in_steps(provider, request, &mut |_| ())
}

/// Like [`seal`]; `done` is called after each step.
///
/// # Errors
/// See [`seal`].
pub fn seal_in_steps(
    provider: &dyn Provider,
    request: &SealRequest<'_>,
    done: &mut impl FnMut(Step),
) -> Result<SealedRecord, CryptoError> {
    let head = Zeroizing::new(request.head.encode());
    check_request(request, head.len())?;
    done(Step::Fields);
    let (header, keys) = header(request, head.len())?;
    done(Step::Keys);
    let prefix = header.encode();
    let mut blob = Vec::with_capacity(prefix.len() + head.len() + request.body.len() + 2 * TAG_LENGTH);
    blob.extend_from_slice(&prefix);
    done(Step::Fields);
    append(provider, (&keys.head_key, &keys.head_nonce), &prefix, &head, &mut blob)?;
    append(provider, (&keys.body_key, &keys.body_nonce), &prefix, request.body, &mut blob)?;
    done(Step::Cipher);
    let digest = Digest(provider.sm3(&[&blob]));
    done(Step::Digest);
    let signature = provider.sign(&request.signer.secret, &signed_bytes(&request.domain, &digest))?;
    done(Step::Signature);
    Ok(SealedRecord { header, blob, digest, signature })
}

/// Appends `plain` to the blob, the only copy made, and seals it in place.
fn append(
    provider: &dyn Provider,
    (key, nonce): (&[u8; 16], &[u8; 12]),
    aad: &[u8],
    plain: &[u8],
    blob: &mut Vec<u8>,
) -> Result<(), CryptoError> {
    let start = blob.len();
    blob.extend_from_slice(plain);
    let sealed = provider.gcm_seal_in_place(key, nonce, aad, &mut blob[start..]);
    let tag = sealed.inspect_err(|_| blob.zeroize())?;
    blob.extend_from_slice(&tag);
    Ok(())
}

fn header(request: &SealRequest<'_>, head_length: usize) -> Result<(Header, RecordKeys), CryptoError> {
    let long = |what| CryptoError::Length { what, found: usize::MAX, allowed: "far less" };
    let signer = signer_id(&request.signer.public);
    let mut header = Header {
        kind: request.kind,
        domain: request.domain,
        owner: request.owner,
        signer,
        epoch: request.epoch,
        recorder: request.recorder.of_signer(&signer),
        seq: request.seq,
        topic_id: request.topic_id,
        filters: request.filters.clone(),
        captured_at: request.captured_at,
        head_length: u32::try_from(head_length + TAG_LENGTH).map_err(|_| long("record head"))?,
        body_length: u64::try_from(request.body.len() + TAG_LENGTH).map_err(|_| long("record body"))?,
        salt: Salt(random_bytes()?),
        commit: Commit([0; 32]),
    };
    let keys = RecordKeys::derive(request.topic_key, &header);
    header.commit = Commit(keys.commit);
    Ok((header, keys))
}

fn check_request(request: &SealRequest<'_>, head: usize) -> Result<(), CryptoError> {
    let largest_head = usize::try_from(LARGEST_HEAD).unwrap_or(usize::MAX) - TAG_LENGTH;
    let largest_body = usize::try_from(LARGEST_BODY).unwrap_or(usize::MAX) - TAG_LENGTH;
    let body = request.body.len();
    if head > largest_head {
        return Err(CryptoError::Length { what: "record head", found: head, allowed: "at most 65,520" });
    }
    if body > largest_body {
        return Err(CryptoError::Length { what: "record body", found: body, allowed: "at most 67,108,864" });
    }
    if request.filters.len() > MOST_FILTERS || request.head.tags.len() > MOST_TAGS {
        return Err(CryptoError::Inconsistent("number of filters or tags"));
    }
    if request.captured_at.0 > LARGEST_STORED {
        return Err(CryptoError::Inconsistent("capture time"));
    }
    if !(1..=LARGEST_STORED).contains(&request.epoch) || !(1..=LARGEST_SEQ).contains(&request.seq) {
        return Err(CryptoError::Inconsistent("epoch, which begins at 1, or seq, which is 1 to 2^40,"));
    }
    if is_length(request.head, request.body) { Ok(()) } else { Err(CryptoError::Inconsistent("plain length")) }
}

/// Whether a body of that many bytes can match the head; a message is never longer than a record may be.
fn is_length(head: &Head, body: &[u8]) -> bool {
    let length = u64::try_from(body.len()).unwrap_or(u64::MAX);
    match head.compression {
        Compression::None => length == head.plain_length,
        Compression::Lz4 | Compression::Matrix => {
            length < head.plain_length && head.plain_length <= LARGEST_BODY - TAG_LENGTH as u64
        }
    }
}

/// The bytes that a record's signature covers.
pub fn signed_bytes(domain: &Domain, digest: &Digest) -> Vec<u8> {
    [&b"AuthROS/signature/1"[..], &domain.0, &digest.0].concat()
}

/// The working keys of one record.
struct RecordKeys {
    body_key: Zeroizing<[u8; 16]>,
    body_nonce: [u8; 12],
    head_key: Zeroizing<[u8; 16]>,
    head_nonce: [u8; 12],
    commit: [u8; 32],
}

impl RecordKeys {
    /// From the topic key, and the header's salt and names.
    fn derive(key: &TopicKey, header: &Header) -> Self {
        Self::of(&Zeroizing::new(derived::<88>(key.expose(), &header.salt.0, &record_info(header))))
    }

    fn of(bytes: &[u8; 88]) -> Self {
        Self {
            body_key: Zeroizing::new(part(bytes, 0)),
            body_nonce: part(bytes, 16),
            head_key: Zeroizing::new(part(bytes, 28)),
            head_nonce: part(bytes, 44),
            commit: part(bytes, 56),
        }
    }
}

/// What binds the keys of a record, besides its salt.
fn record_info(header: &Header) -> Info {
    Info::new("AuthROS/record/1")
        .fixed(&header.domain.0)
        .fixed(&header.owner.0)
        .fixed(&header.recorder.0)
        .number(header.epoch)
        .number(header.seq)
}

fn part<const N: usize>(bytes: &[u8; 88], start: usize) -> [u8; N] {
    std::array::from_fn(|index| bytes[start + index])
}

#[cfg(test)]
pub(crate) mod tests;
