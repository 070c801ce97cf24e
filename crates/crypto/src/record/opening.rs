//! Checking and opening of a stored record.

use subtle::ConstantTimeEq as _;
use zeroize::Zeroizing;

use crate::crypto::compression::unpack;
use crate::crypto::{CryptoError, Provider, TopicKey, fault, signer_id};
use crate::model::head::Compression;
use crate::model::wire::WireError;
use crate::model::{Address, Digest, Domain, Head, Header, PublicKey, RecorderId, Signature, TopicId, Verdict};

use super::{Names, RecordKeys, Step, is_length, signed_bytes};

/// What was requested; a record that differs is not shown.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Expected {
    /// The network.
    pub domain: Domain,
    /// The owner.
    pub owner: Address,
    /// The recorder, if requested.
    pub recorder: Option<RecorderId>,
    /// The epoch, if requested.
    pub epoch: Option<u64>,
    /// The seq, if requested.
    pub seq: Option<u64>,
    /// The topic's pseudonym, if requested.
    pub topic_id: Option<TopicId>,
    /// What the names in the sealed head are compared with.
    pub names: Names,
}

impl Expected {
    /// Any record of `owner` whose names pass.
    pub fn any_of(domain: Domain, owner: Address, names: Names) -> Self {
        Self { domain, owner, recorder: None, epoch: None, seq: None, topic_id: None, names }
    }
}

/// What the chain says about a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Anchor {
    /// The digest that the chain confirms for this record.
    Chain(Digest),
    /// The digest that the chain confirmed earlier; it cannot be asked now.
    Remembered(Digest),
    /// Nothing, or nothing yet.
    Unanchored,
}

/// A record that passed every check.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenedRecord {
    /// The public header.
    pub header: Header,
    /// The part that only readers may see.
    pub head: Head,
    /// The message.
    pub body: Vec<u8>,
    /// SM3 of the stored bytes.
    pub digest: Digest,
    /// `Verified`, `NotChecked` or `Unanchored`, by the anchor.
    pub verdict: Verdict,
}

/// A blob split into its three parts.
pub(super) struct Parts<'a> {
    pub header: Header,
    prefix: &'a [u8],
    head: &'a [u8],
    body: &'a [u8],
}

fn parse(blob: &[u8]) -> Result<Parts<'_>, WireError> {
    let (header, length) = Header::parse(blob)?;
    let (prefix, rest) = blob.split_at_checked(length).ok_or(WireError::Short("header"))?;
    let head_length = usize::try_from(header.head_length).map_err(|_| WireError::Value("head length"))?;
    let body_length = usize::try_from(header.body_length).map_err(|_| WireError::Value("body length"))?;
    let (head, body) = rest.split_at_checked(head_length).ok_or(WireError::Short("sealed head"))?;
    if body.len() < body_length {
        return Err(WireError::Short("sealed body"));
    }
    if body.len() > body_length {
        return Err(WireError::Long(body.len() - body_length));
    }
    Ok(Parts { header, prefix, head, body })
}

/// The checks that need no key: bounded parse, digest against the anchor, signature.
///
/// # Errors
/// [`CryptoError::DamagedRecord`] or [`CryptoError::Tampered`].
pub fn check(
    provider: &dyn Provider,
    blob: &[u8],
    signature: &Signature,
    signer: &PublicKey,
    anchor: Anchor,
) -> Result<(Header, Digest, Verdict), CryptoError> {
    let digest_of = |blob: &[u8]| Digest(provider.sm3(&[blob]));
    let (parts, digest, verdict) = checked(provider, blob, signature, signer, anchor, digest_of, &mut |_| ())?;
    Ok((parts.header, digest, verdict))
}

/// Checks a record whose stored bytes retention has deleted: its public header is the signer's, and the signature
/// covers the digest that is left of it.
///
/// # Errors
/// [`CryptoError::DamagedRecord`] or [`CryptoError::Tampered`].
pub fn check_deleted(
    provider: &dyn Provider,
    header: &[u8],
    digest: Digest,
    signature: &Signature,
    signer: &PublicKey,
) -> Result<Header, CryptoError> {
    let (header, _) = Header::parse(header).map_err(CryptoError::DamagedRecord)?;
    let signed = header.signer == signer_id(signer)
        && provider.verify(signer, &signed_bytes(&header.domain, &digest), signature).is_ok();
    if signed { Ok(header) } else { Err(CryptoError::Tampered("signature")) }
}

/// The check itself; `digest_of` computes the SM3 of the blob, `done` is called after each step.
pub(super) fn checked<'a>(
    provider: &dyn Provider,
    blob: &'a [u8],
    signature: &Signature,
    signer: &PublicKey,
    anchor: Anchor,
    digest_of: impl FnOnce(&[u8]) -> Digest,
    done: &mut impl FnMut(Step),
) -> Result<(Parts<'a>, Digest, Verdict), CryptoError> {
    let parts = parse(blob).map_err(CryptoError::DamagedRecord)?;
    done(Step::Fields);
    let digest = digest_of(blob);
    done(Step::Digest);
    let verdict = match anchor {
        Anchor::Chain(anchored) if anchored == digest || fault::is_off("digest") => Verdict::Verified,
        Anchor::Remembered(anchored) if anchored == digest => Verdict::NotChecked,
        Anchor::Chain(_) | Anchor::Remembered(_) => return Err(CryptoError::Tampered("digest")),
        Anchor::Unanchored => Verdict::Unanchored,
    };
    let signed = parts.header.signer == signer_id(signer)
        && provider.verify(signer, &signed_bytes(&parts.header.domain, &digest), signature).is_ok();
    if !signed && !fault::is_off("signature") {
        return Err(CryptoError::Tampered("signature"));
    }
    done(Step::Signature);
    Ok((parts, digest, verdict))
}

/// Checks and opens a record; no plaintext is returned unless every check passed.
///
/// # Errors
/// [`CryptoError::DamagedRecord`], [`CryptoError::Tampered`], [`CryptoError::WrongKey`],
/// [`CryptoError::NotAsked`] or [`CryptoError::FalseName`], from the first check that failed.
pub fn open(
    provider: &dyn Provider,
    blob: &[u8],
    signature: &Signature,
    signer: &PublicKey,
    anchor: Anchor,
    topic_key: &TopicKey,
    expected: &Expected,
) -> Result<OpenedRecord, CryptoError> {
    open_in_steps(provider, (blob, signature, signer), anchor, topic_key, expected, &mut |_| ())
}

/// Like [`open`] of (blob, signature, signer); `done` is called after each step.
///
/// # Errors
/// See [`open`].
pub fn open_in_steps(
    provider: &dyn Provider,
    (blob, signature, signer): (&[u8], &Signature, &PublicKey),
    anchor: Anchor,
    topic_key: &TopicKey,
    expected: &Expected,
    done: &mut impl FnMut(Step),
) -> Result<OpenedRecord, CryptoError> {
    let digest_of = |blob: &[u8]| Digest(provider.sm3(&[blob]));
    let (parts, digest, verdict) = checked(provider, blob, signature, signer, anchor, digest_of, done)?;
    let keys = RecordKeys::derive(topic_key, &parts.header);
    let committed = bool::from(keys.commit.ct_eq(&parts.header.commit.0));
    if !committed && !fault::is_off("commit") {
        return Err(CryptoError::WrongKey);
    }
    done(Step::Keys);
    let (head, body) = unseal(provider, &keys, &parts, done)?;
    compare(expected, &parts.header)?;
    expected.names.check(&parts.header, &head)?;
    done(Step::Fields);
    let body = restore(&head, body)?;
    done(Step::Restore);
    Ok(OpenedRecord { header: parts.header, head, body, digest, verdict })
}

/// Head and body, still compressed, opened with the record's own keys.
fn unseal(
    provider: &dyn Provider,
    keys: &RecordKeys,
    parts: &Parts<'_>,
    done: &mut impl FnMut(Step),
) -> Result<(Head, Vec<u8>), CryptoError> {
    let tampered = |what| move |_| CryptoError::Tampered(what);
    let head = provider
        .gcm_open(&keys.head_key, &keys.head_nonce, parts.prefix, parts.head)
        .map_err(tampered("sealed head"))?;
    let mut body = provider
        .gcm_open(&keys.body_key, &keys.body_nonce, parts.prefix, parts.body)
        .map_err(tampered("sealed body"))?;
    done(Step::Cipher);
    let head = Head::parse(&head).map_err(CryptoError::DamagedRecord)?;
    if !is_length(&head, &body) {
        return Err(CryptoError::Tampered("plain length"));
    }
    Ok((head, std::mem::take(&mut *body)))
}

/// Head and message of a stored record, opened with its own keys, which must be those that its header commits to. The
/// message's length is subtracted from `budget` before it is allocated; `None` if the budget is too small.
pub(super) fn open_by_keys(
    provider: &dyn Provider,
    blob: &[u8],
    keys_of: impl FnOnce(&Header) -> RecordKeys,
    budget: &mut u64,
) -> Result<Option<(Header, Head, Vec<u8>)>, CryptoError> {
    let parts = parse(blob).map_err(CryptoError::DamagedRecord)?;
    let keys = keys_of(&parts.header);
    if !bool::from(keys.commit.ct_eq(&parts.header.commit.0)) {
        return Err(CryptoError::WrongKey);
    }
    let (head, body) = unseal(provider, &keys, &parts, &mut |_| ())?;
    let Some(left) = budget.checked_sub(head.plain_length) else { return Ok(None) };
    *budget = left;
    let body = restore(&head, body)?;
    Ok(Some((parts.header, head, body)))
}

/// Public header and sealed head of a record, from its first bytes. The seal of the head covers the header: both are as
/// the holder of the topic key wrote them. Body, digest and signature are not checked.
///
/// # Errors
/// [`CryptoError::DamagedRecord`], [`CryptoError::WrongKey`], [`CryptoError::Tampered`] or [`CryptoError::FalseName`].
pub fn open_front(
    provider: &dyn Provider,
    front: &[u8],
    topic_key: &TopicKey,
    names: &Names,
) -> Result<(Header, Head), CryptoError> {
    let (header, length) = Header::parse(front).map_err(CryptoError::DamagedRecord)?;
    let short = || CryptoError::DamagedRecord(WireError::Short("sealed head"));
    let (prefix, rest) = front.split_at_checked(length).ok_or_else(short)?;
    let sealed = usize::try_from(header.head_length).ok().and_then(|length| rest.get(..length)).ok_or_else(short)?;
    let keys = RecordKeys::derive(topic_key, &header);
    if !bool::from(keys.commit.ct_eq(&header.commit.0)) {
        return Err(CryptoError::WrongKey);
    }
    let head = provider
        .gcm_open(&keys.head_key, &keys.head_nonce, prefix, sealed)
        .map_err(|_| CryptoError::Tampered("sealed head"))?;
    let head = Head::parse(&head).map_err(CryptoError::DamagedRecord)?;
    names.check(&header, &head)?;
    Ok((header, head))
}

/// The message as it was captured; the head's plain length bounds the decompression.
fn restore(head: &Head, body: Vec<u8>) -> Result<Vec<u8>, CryptoError> {
    if head.compression == Compression::None {
        return Ok(body);
    }
    let packed = Zeroizing::new(body);
    let length = usize::try_from(head.plain_length).unwrap_or(usize::MAX);
    unpack(head.compression, &packed, length).map_err(CryptoError::DamagedRecord)
}

fn compare(expected: &Expected, header: &Header) -> Result<(), CryptoError> {
    let differs = |wanted: Option<u64>, found| wanted.is_some_and(|wanted| wanted != found);
    let fields = [
        ("domain", expected.domain != header.domain),
        ("owner", expected.owner != header.owner),
        ("epoch", differs(expected.epoch, header.epoch)),
        ("recorder", expected.recorder.is_some_and(|wanted| wanted != header.recorder)),
        ("seq", differs(expected.seq, header.seq)),
        ("topic id", expected.topic_id.is_some_and(|wanted| wanted != header.topic_id)),
    ];
    fields.into_iter().find(|(_, differs)| *differs).map_or(Ok(()), |(name, _)| Err(CryptoError::NotAsked(name)))
}
