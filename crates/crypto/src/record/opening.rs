//! Checking and opening of a stored record.

use subtle::ConstantTimeEq as _;
use zeroize::{Zeroize, ZeroizeOnDrop, Zeroizing};

use super::{Names, RecordKeys, is_length, record_info, signed_bytes};
use crate::compression::unpack;
use crate::kdf::{expanded, hmac_sm3};
use crate::kernel::LONG;
use crate::model::head::Compression;
use crate::model::wire::WireError;
use crate::model::{Address, Digest, Domain, Head, Header, PublicKey, RecorderId, Signature, TopicId, Verdict};
use crate::pool::{each, helpers_for};
use crate::{CryptoError, Provider, TopicKey, fault, signer_id};

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

// Checks several records at once: the digests of short ones side by side in the lanes of SM3, the signatures on
// several cores. The results are those of [`check`](super::check) for each record.

/// One record to check.
#[derive(Debug, Clone, Copy)]
pub struct Unchecked<'a> {
    /// Its stored bytes.
    pub blob: &'a [u8],
    /// Its signature.
    pub signature: &'a Signature,
    /// Who should have signed it.
    pub signer: &'a PublicKey,
    /// What the chain says about it.
    pub anchor: Anchor,
}

/// The result of checking a record.
pub type Checked = Result<(Header, Digest, Verdict), CryptoError>;

/// Checks each record like [`check`](super::check), in order, on as many cores as is worthwhile.
pub fn check_many(provider: &dyn Provider, records: &[Unchecked<'_>]) -> Vec<Checked> {
    let bytes = records.iter().map(|record| record.blob.len()).sum();
    check_by(provider, records, helpers_for(records.len(), bytes))
}

/// Like [`check_many`], on the caller's core alone: for callers that already have a thread for each core.
pub fn check_alone(provider: &dyn Provider, records: &[Unchecked<'_>]) -> Vec<Checked> {
    check_by(provider, records, 0)
}

fn check_by(provider: &dyn Provider, records: &[Unchecked<'_>], helpers: usize) -> Vec<Checked> {
    let short: Vec<&[u8]> = records.iter().map(|record| record.blob).filter(|blob| blob.len() < LONG).collect();
    let mut digests = provider.sm3_many(&short).into_iter().map(Digest);
    let hashed: Vec<_> =
        records.iter().map(|record| (record, if record.blob.len() < LONG { digests.next() } else { None })).collect();
    each(&hashed, helpers, |(record, digest)| {
        let digest_of = |blob: &[u8]| digest.unwrap_or_else(|| Digest(provider.sm3(&[blob])));
        let Unchecked { blob, signature, signer, anchor } = **record;
        let (parts, digest, verdict) = checked(provider, blob, signature, signer, anchor, digest_of, &mut |_| ())?;
        Ok((parts.header, digest, verdict))
    })
}

// Disclosure of one record: the 32 bytes from which its keys, and no others, are derived.
//
// They are HKDF's extract of topic key and salt, so nothing leads from them to the topic key or to another record. The
// record's commitment is expanded from the same bytes, so neither a wrong secret nor another message can be passed
// off.

/// The secret from which the keys of one record are derived.
#[derive(Clone, Zeroize, ZeroizeOnDrop)]
pub struct RecordSecret([u8; 32]);

impl std::fmt::Debug for RecordSecret {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("RecordSecret(secret)")
    }
}

impl RecordSecret {
    /// For the record with this header, sealed under this topic key.
    pub fn of(key: &TopicKey, header: &Header) -> Self {
        Self(hmac_sm3(&header.salt.0, &[key.expose()]))
    }

    /// From exactly 32 bytes: with other lengths, HMAC would take different texts for the same key.
    pub fn from_slice(bytes: &[u8]) -> Option<Self> {
        bytes.try_into().ok().map(Self)
    }

    /// The bytes. Anyone who has them can read this record, forever, and no other.
    pub fn expose(&self) -> &[u8; 32] {
        &self.0
    }

    fn keys(&self, header: &Header) -> RecordKeys {
        RecordKeys::of(&Zeroizing::new(expanded(&self.0, &record_info(header))))
    }
}

/// A record that its owner disclosed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Revealed {
    /// The public header.
    pub header: Header,
    /// What was sealed along with the message.
    pub head: Head,
    /// The message.
    pub body: Vec<u8>,
}

/// Opens a stored record with its own secret. Digest, signature and anchor are checked elsewhere.
///
/// # Errors
/// [`CryptoError::WrongKey`] if the record does not commit to this secret, otherwise as for opening.
pub fn open_revealed(provider: &dyn Provider, blob: &[u8], secret: &RecordSecret) -> Result<Revealed, CryptoError> {
    let mut budget = u64::MAX;
    open_revealed_within(provider, blob, secret, &mut budget)?.ok_or(CryptoError::Tampered("plain length"))
}

/// Like [`open_revealed`], for many untrusted records: the length of each message is subtracted from `budget`, in
/// bytes, before the message is allocated; `None` if the budget is too small.
///
/// # Errors
/// See [`open_revealed`].
pub fn open_revealed_within(
    provider: &dyn Provider,
    blob: &[u8],
    secret: &RecordSecret,
    budget: &mut u64,
) -> Result<Option<Revealed>, CryptoError> {
    let opened = open_by_keys(provider, blob, |header| secret.keys(header), budget)?;
    Ok(opened.map(|(header, head, body)| Revealed { header, head, body }))
}

/// The bytes an owner signs to disclose a record: label, domain, digest, secret.
pub fn reveal_bytes(domain: &Domain, digest: &Digest, secret: &RecordSecret) -> Zeroizing<Vec<u8>> {
    Zeroizing::new([&b"AuthROS/reveal/1"[..], &domain.0, &digest.0, secret.expose()].concat())
}

// The steps of sealing and opening a record, for measuring them.

/// The step just done. A step may be reported more than once for a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Head and header to bytes, or back, with all checks of their fields.
    Fields,
    /// The record's keys derived from the topic key, and a fresh salt drawn.
    Keys,
    /// SM4-GCM of head and body.
    Cipher,
    /// SM3 of the stored bytes.
    Digest,
    /// SM2: signing or verifying.
    Signature,
    /// The message decompressed.
    Restore,
}

impl Step {
    /// All steps.
    pub const ALL: [Self; 6] = [Self::Fields, Self::Keys, Self::Cipher, Self::Digest, Self::Signature, Self::Restore];

    /// Its name where figures are shown.
    pub fn word(self) -> &'static str {
        match self {
            Self::Fields => "fields",
            Self::Keys => "keys",
            Self::Cipher => "SM4-GCM",
            Self::Digest => "SM3",
            Self::Signature => "SM2",
            Self::Restore => "restore",
        }
    }
}

#[cfg(test)]
mod many_tests {
    use super::*;
    use crate::record::tests::Sample;
    use crate::record::{SealedRecord, check};
    use crate::{ProviderName, SmKeyPair, provider};

    /// Records of many lengths, with each kind of damage among them.
    fn records(name: ProviderName) -> Vec<SealedRecord> {
        let lengths = [0, 1, 100, 700, 1024, 3000, 9000, LONG - 1, LONG, 40_000, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];
        let mut records: Vec<_> = lengths.iter().map(|length| Sample::new(name, &vec![7; *length]).seal()).collect();
        records[2].blob[0] ^= 1;
        records[4].blob.truncate(50);
        records[6].signature.0[10] ^= 1;
        records[9].blob[30_000] ^= 1;
        let last = records[12].blob.len() - 1;
        records[12].blob[last] ^= 1;
        records[14].digest.0[0] ^= 1;
        records
    }

    #[test]
    fn many_are_checked_as_each_by_itself() {
        for name in ProviderName::ALL {
            let (provider, records) = (provider(name), records(name));
            let own = Sample::new(name, b"").request().signer.public;
            let other = SmKeyPair::generate(provider).expect("pair").public;
            let anchor =
                |at: usize, digest| if at.is_multiple_of(5) { Anchor::Unanchored } else { Anchor::Chain(digest) };
            let all: Vec<_> = records
                .iter()
                .enumerate()
                .map(|(at, SealedRecord { blob, digest, signature, .. })| {
                    let signer = if at == 16 { &other } else { &own };
                    Unchecked { blob, signature, signer, anchor: anchor(at, *digest) }
                })
                .collect();
            let by_itself = |one: &Unchecked<'_>| check(provider, one.blob, one.signature, one.signer, one.anchor);
            let told = |checked: Vec<Checked>| checked.iter().map(|one| format!("{one:?}")).collect::<Vec<_>>();
            let expected = told(all.iter().map(by_itself).collect());
            assert_eq!(expected.iter().filter(|one| one.starts_with("Err")).count(), 7, "{expected:#?}");
            for helpers in [0, 1, 3] {
                assert_eq!(told(check_by(provider, &all, helpers)), expected, "{helpers} helpers");
            }
            assert_eq!(
                (told(check_many(provider, &all[..1])), check_many(provider, &[]).len()),
                (vec![expected[0].clone()], 0)
            );
        }
    }
}
