//! Sealing and opening of records (docs/format.md, section 4). Opening shows nothing before the last check: parse,
//! digest, signature, commitment, tags, what was requested, names that belong to their pseudonyms.

use crate::compression::unpack;
use crate::kdf::{Info, derived, expanded, hmac_sm3};
use crate::kernel::LONG;
use crate::model::head::{Compression, MOST_TAGS};
use crate::model::header::{LARGEST_BODY, LARGEST_HEAD, LARGEST_SEQ, LARGEST_STORED, MOST_FILTERS, TAG_LENGTH};
use crate::model::wire::WireError;
use crate::model::{
    Address, Commit, Digest, Domain, FilterId, Head, Header, PublicKey, RecordKind, RecorderId, RecorderPrefix, Salt,
    Signature, Timestamp, TopicId, Verdict, is_record_topic,
};
use crate::pool::{each, helpers_for};
use crate::{
    CryptoError, IndexKey, Provider, Result, SmKeyPair, TopicKey, fault, filter_id, filter_key, random_bytes,
    signer_id, topic_filter_id, topic_id,
};
use subtle::ConstantTimeEq as _;
use zeroize::{Zeroize as _, Zeroizing};

pub use crate::secret::RecordSecret;

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
/// # Errors
/// [`CryptoError::Length`] or [`CryptoError::Inconsistent`] if a field is out of bounds, [`CryptoError::Random`].
pub fn seal(provider: &dyn Provider, request: &SealRequest<'_>) -> Result<SealedRecord> {
    let head = Zeroizing::new(request.head.encode());
    check_request(request, head.len())?;
    let (header, keys) = header(request, head.len())?;
    let prefix = header.encode();
    let mut blob = Vec::with_capacity(prefix.len() + head.len() + request.body.len() + 2 * TAG_LENGTH);
    blob.extend_from_slice(&prefix);
    append(provider, (&keys.head_key, &keys.head_nonce), &prefix, &head, &mut blob)?;
    append(provider, (&keys.body_key, &keys.body_nonce), &prefix, request.body, &mut blob)?;
    let digest = Digest(provider.sm3(&[&blob]));
    let signature = provider.sign(&request.signer.secret, &signed_bytes(&request.domain, &digest))?;
    Ok(SealedRecord { header, blob, digest, signature })
}

/// Appends `plain` to the blob, the only copy made, and seals it in place.
fn append(
    provider: &dyn Provider,
    (key, nonce): (&[u8; 16], &[u8; 12]),
    aad: &[u8],
    plain: &[u8],
    blob: &mut Vec<u8>,
) -> Result<()> {
    let start = blob.len();
    blob.extend_from_slice(plain);
    let sealed = provider.gcm_seal_in_place(key, nonce, aad, &mut blob[start..]);
    let tag = sealed.inspect_err(|_| blob.zeroize())?;
    blob.extend_from_slice(&tag);
    Ok(())
}

fn header(request: &SealRequest<'_>, head_length: usize) -> Result<(Header, RecordKeys)> {
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

fn check_request(request: &SealRequest<'_>, head: usize) -> Result<()> {
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

struct RecordKeys {
    body_key: Zeroizing<[u8; 16]>,
    body_nonce: [u8; 12],
    head_key: Zeroizing<[u8; 16]>,
    head_nonce: [u8; 12],
    commit: [u8; 32],
}

impl RecordKeys {
    fn derive(key: &TopicKey, header: &Header) -> Self {
        Self::of(&Zeroizing::new(derived::<88>(key.expose(), &header.salt.0, &record_info(header))))
    }

    /// These, if they are those that the header commits to.
    fn committed(self, header: &Header) -> Result<Self> {
        let is_committed = bool::from(self.commit.ct_eq(&header.commit.0));
        if is_committed || fault::is_off("commit") { Ok(self) } else { Err(CryptoError::WrongKey) }
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

// The holder of a topic key writes both names and pseudonyms: a name counts only if its pseudonym is derived from it.

/// What a reader compares the names in a sealed head with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Names {
    /// The pseudonyms in the header, derived with IK of the record's owner.
    Derived(IndexKey),
    /// The topic's name as the owner gave it together with the topic key. Without IK, types and tags cannot be derived:
    /// they are the signer's claim about this one record.
    Given(String),
}

impl Names {
    /// Compares the names in a head with the header that it is sealed under.
    /// # Errors
    /// [`CryptoError::FalseName`] with the first name that does not belong to its pseudonym.
    pub fn check(&self, header: &Header, head: &Head) -> Result<()> {
        let false_name = match self {
            Self::Given(topic) => (head.topic != *topic).then_some("topic"),
            Self::Derived(index) => false_name(index, header, head),
        };
        false_name.map_or(Ok(()), |what| Err(CryptoError::FalseName(what)))
    }
}

fn false_name(index: &IndexKey, header: &Header, head: &Head) -> Option<&'static str> {
    if !is_record_topic(&head.topic) || topic_id(index, &head.topic) != header.topic_id {
        return Some("topic");
    }
    // A record without filter ids is found by no type and no tag; its names are about itself alone.
    let (of_type, of_tags) = header.filters.split_first()?;
    let own = filter_key(index, &header.topic_id);
    let is = |id: &FilterId, kind: &str, text: &str| {
        *id == filter_id(index, kind, text) || *id == topic_filter_id(&own, kind, text)
    };
    if !is(of_type, "type", &head.type_name) {
        return Some("type");
    }
    let tags: Vec<String> = head.tags.iter().map(|(name, value)| format!("{name}={value}")).collect();
    let is_tag = |id: &FilterId| tags.iter().any(|tag| is(id, "tag", tag));
    (!of_tags.iter().all(is_tag)).then_some("tags")
}

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

struct Parts<'a> {
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
/// # Errors
/// [`CryptoError::DamagedRecord`] or [`CryptoError::Tampered`].
pub fn check(
    provider: &dyn Provider,
    blob: &[u8],
    signature: &Signature,
    signer: &PublicKey,
    anchor: Anchor,
) -> Checked {
    check_one(provider, Unchecked { blob, signature, signer, anchor }, None)
}

fn check_one(provider: &dyn Provider, record: Unchecked<'_>, digest: Option<Digest>) -> Checked {
    let (parts, digest, verdict) = checked(provider, record, digest)?;
    Ok((parts.header, digest, verdict))
}

/// Checks a record whose stored bytes were deleted: the signature covers its digest, the public header is the signer's.
/// # Errors
/// [`CryptoError::DamagedRecord`] or [`CryptoError::Tampered`].
pub fn check_deleted(
    provider: &dyn Provider,
    header: &[u8],
    digest: Digest,
    signature: &Signature,
    signer: &PublicKey,
) -> Result<Header> {
    let (header, _) = Header::parse(header).map_err(CryptoError::DamagedRecord)?;
    let signed = header.signer == signer_id(signer)
        && provider.verify(signer, &signed_bytes(&header.domain, &digest), signature).is_ok();
    if signed { Ok(header) } else { Err(CryptoError::Tampered("signature")) }
}

/// The check itself; `digest` is the SM3 of the blob, if it is computed already.
fn checked<'a>(
    provider: &dyn Provider,
    Unchecked { blob, signature, signer, anchor }: Unchecked<'a>,
    digest: Option<Digest>,
) -> Result<(Parts<'a>, Digest, Verdict)> {
    let parts = parse(blob).map_err(CryptoError::DamagedRecord)?;
    let digest = digest.unwrap_or_else(|| Digest(provider.sm3(&[blob])));
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
    Ok((parts, digest, verdict))
}

/// Checks and opens a record; no plaintext is returned unless every check passed.
/// # Errors
/// From the first check that failed: `DamagedRecord`, `Tampered`, `WrongKey`, `NotAsked` or [`CryptoError::FalseName`].
pub fn open(
    provider: &dyn Provider,
    blob: &[u8],
    signature: &Signature,
    signer: &PublicKey,
    anchor: Anchor,
    topic_key: &TopicKey,
    expected: &Expected,
) -> Result<OpenedRecord> {
    let (parts, digest, verdict) = checked(provider, Unchecked { blob, signature, signer, anchor }, None)?;
    let keys = RecordKeys::derive(topic_key, &parts.header).committed(&parts.header)?;
    let (head, body) = unseal(provider, &keys, &parts)?;
    compare(expected, &parts.header)?;
    expected.names.check(&parts.header, &head)?;
    let body = restore(&head, body)?;
    Ok(OpenedRecord { header: parts.header, head, body, digest, verdict })
}

fn unseal(provider: &dyn Provider, keys: &RecordKeys, parts: &Parts<'_>) -> Result<(Head, Vec<u8>)> {
    let tampered = |what| move |_| CryptoError::Tampered(what);
    let head = provider
        .gcm_open(&keys.head_key, &keys.head_nonce, parts.prefix, parts.head)
        .map_err(tampered("sealed head"))?;
    let mut body = provider
        .gcm_open(&keys.body_key, &keys.body_nonce, parts.prefix, parts.body)
        .map_err(tampered("sealed body"))?;
    let head = Head::parse(&head).map_err(CryptoError::DamagedRecord)?;
    if !is_length(&head, &body) {
        return Err(CryptoError::Tampered("plain length"));
    }
    Ok((head, std::mem::take(&mut *body)))
}

/// Header and head from a record's first bytes, as the holder of the topic key wrote them. The rest is not checked.
/// # Errors
/// [`CryptoError::DamagedRecord`], [`CryptoError::WrongKey`], [`CryptoError::Tampered`] or [`CryptoError::FalseName`].
pub fn open_front(
    provider: &dyn Provider,
    front: &[u8],
    topic_key: &TopicKey,
    names: &Names,
) -> Result<(Header, Head)> {
    let (header, length) = Header::parse(front).map_err(CryptoError::DamagedRecord)?;
    let short = || CryptoError::DamagedRecord(WireError::Short("sealed head"));
    let (prefix, rest) = front.split_at_checked(length).ok_or_else(short)?;
    let sealed = usize::try_from(header.head_length).ok().and_then(|length| rest.get(..length)).ok_or_else(short)?;
    let keys = RecordKeys::derive(topic_key, &header).committed(&header)?;
    let head = provider
        .gcm_open(&keys.head_key, &keys.head_nonce, prefix, sealed)
        .map_err(|_| CryptoError::Tampered("sealed head"))?;
    let head = Head::parse(&head).map_err(CryptoError::DamagedRecord)?;
    names.check(&header, &head)?;
    Ok((header, head))
}

/// The message as it was captured; the head's plain length bounds the decompression.
fn restore(head: &Head, body: Vec<u8>) -> Result<Vec<u8>> {
    if head.compression == Compression::None {
        return Ok(body);
    }
    let packed = Zeroizing::new(body);
    let length = usize::try_from(head.plain_length).unwrap_or(usize::MAX);
    unpack(head.compression, &packed, length).map_err(CryptoError::DamagedRecord)
}

fn compare(expected: &Expected, header: &Header) -> Result<()> {
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

// Like [`check`], with the digests of short records side by side in the lanes of SM3, and signatures on several cores.

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
pub type Checked = Result<(Header, Digest, Verdict)>;

/// Checks each record like [`check`], in order, on as many cores as is worthwhile.
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
    each(&hashed, helpers, |(record, digest)| check_one(provider, **record, *digest))
}

// A record is disclosed by HKDF's extract of topic key and salt, from which neither the topic key nor another record's
// keys follow. The commitment is expanded from it, so neither a wrong secret nor another message can be passed off.

impl RecordSecret {
    /// For the record with this header, sealed under this topic key.
    pub fn of(key: &TopicKey, header: &Header) -> Self {
        Self::new(hmac_sm3(&header.salt.0, &[key.expose()]))
    }

    fn keys(&self, header: &Header) -> RecordKeys {
        RecordKeys::of(&Zeroizing::new(expanded(self.expose(), &record_info(header))))
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
/// # Errors
/// [`CryptoError::WrongKey`] if the record does not commit to this secret, otherwise as for opening.
pub fn open_revealed(provider: &dyn Provider, blob: &[u8], secret: &RecordSecret) -> Result<Revealed> {
    let mut budget = u64::MAX;
    open_revealed_within(provider, blob, secret, &mut budget)?.ok_or(CryptoError::Tampered("plain length"))
}

/// For many untrusted records: takes each message's length from `budget` (bytes) first; `None` if that is too small.
/// # Errors
/// See [`open_revealed`].
pub fn open_revealed_within(
    provider: &dyn Provider,
    blob: &[u8],
    secret: &RecordSecret,
    budget: &mut u64,
) -> Result<Option<Revealed>> {
    let parts = parse(blob).map_err(CryptoError::DamagedRecord)?;
    let keys = secret.keys(&parts.header).committed(&parts.header)?;
    let (head, body) = unseal(provider, &keys, &parts)?;
    let Some(left) = budget.checked_sub(head.plain_length) else { return Ok(None) };
    *budget = left;
    let body = restore(&head, body)?;
    Ok(Some(Revealed { header: parts.header, head, body }))
}

/// The bytes an owner signs to disclose records: label, domain, SM3 of the list of digests and secrets.
pub fn reveal_bytes(domain: &Domain, list: &Digest) -> Vec<u8> {
    [&b"AuthROS/reveal/3"[..], &domain.0, &list.0].concat()
}

#[cfg(test)]
mod naming_tests;

#[cfg(test)]
mod many_tests {
    use super::tests::Sample;
    use super::*;
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

#[cfg(test)]
pub(crate) mod tests;
