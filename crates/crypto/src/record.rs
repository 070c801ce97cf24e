//! Sealing and opening of records (docs/format.md, section 4). Opening checks in one fixed order and shows nothing
//! before the last check: parse, digest, signature, commitment, tags, what was requested,
//! names that belong to their pseudonyms. Where blobs come from and
//! whether a signer may sign for an owner is decided elsewhere.

mod opening;
#[cfg(test)]
pub(crate) mod tests;

use zeroize::{Zeroize as _, Zeroizing};

pub use self::opening::{
    Anchor, Checked, Expected, OpenedRecord, RecordSecret, Revealed, Step, Unchecked, check, check_alone,
    check_deleted, check_many, open, open_front, open_in_steps, open_revealed, open_revealed_within, reveal_bytes,
};

use crate::kdf::{Info, derived};
use crate::model::head::{Compression, MOST_TAGS};
use crate::model::header::{LARGEST_BODY, LARGEST_HEAD, LARGEST_SEQ, LARGEST_STORED, MOST_FILTERS, TAG_LENGTH};
use crate::model::{
    Address, Commit, Digest, Domain, FilterId, Head, Header, RecordKind, RecorderPrefix, Salt, Signature, Timestamp,
    TopicId, is_record_topic,
};
use crate::{
    CryptoError, IndexKey, Provider, SmKeyPair, TopicKey, filter_id, filter_key, random_bytes, signer_id,
    topic_filter_id, topic_id,
};

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

// Whether a record may bear the names in its sealed head. The holder of a topic key writes both the names and the
// pseudonyms of the header; a name counts only if the pseudonym is the one derived from it.

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
    ///
    /// # Errors
    /// [`CryptoError::FalseName`] with the first name that does not belong to its pseudonym.
    pub fn check(&self, header: &Header, head: &Head) -> Result<(), CryptoError> {
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

#[cfg(test)]
mod naming_tests {
    use super::tests::Sample;
    use super::*;
    use crate::model::ErrorKind;
    use crate::{ProviderName, provider};

    fn index() -> IndexKey {
        IndexKey::new([3; 32])
    }

    fn id(topic: &str) -> TopicId {
        topic_id(&index(), topic)
    }

    /// What a reader with IK says of a record under these pseudonyms whose head names a topic, a type, and mission=7.
    fn read(topic_id: TopicId, filters: Vec<FilterId>, topic: &str, type_name: &str) -> Result<(), CryptoError> {
        let provider = provider(ProviderName::RustCrypto);
        let sample = Sample::new(ProviderName::RustCrypto, b"");
        let request = sample.request();
        let head = Head { topic: topic.to_owned(), type_name: type_name.to_owned(), ..request.head.clone() };
        let sealed = seal(provider, &SealRequest { topic_id, filters, head: &head, ..sample.request() });
        let blob = sealed.expect("seals").blob;
        open_front(provider, &blob, request.topic_key, &Names::Derived(index())).map(drop)
    }

    #[test]
    fn a_name_is_read_only_under_the_pseudonym_derived_from_it() {
        let (odom, kind) = ("/robot1/odom", "nav_msgs/Odometry");
        let (of_type, of_tag) = (filter_id(&index(), "type", kind), filter_id(&index(), "tag", "mission=7"));
        let own = filter_key(&index(), &id(odom));
        let of_robot = vec![topic_filter_id(&own, "type", kind), topic_filter_id(&own, "tag", "mission=7")];
        for filters in [vec![], vec![of_type], vec![of_type, of_tag], of_robot] {
            assert!(read(id(odom), filters, odom, kind).is_ok());
        }
        let refused = |found: Result<(), CryptoError>, field: &str| {
            let error = found.expect_err("refused");
            assert!(matches!(error, CryptoError::FalseName(what) if what == field), "{field}: {error}");
            assert_eq!(error.kind(), ErrorKind::Refused);
        };
        refused(read(id(odom), vec![], "/emergency_stop_released", kind), "topic");
        refused(read(id(odom), vec![of_type], odom, "std_msgs/Bool"), "type");
        refused(read(id(odom), vec![of_tag], odom, kind), "type");
        let of_other = filter_id(&index(), "tag", "mission=8");
        refused(read(id(odom), vec![of_type, of_other], odom, kind), "tags");
        let of_other_topic = topic_filter_id(&filter_key(&index(), &id("/a")), "type", kind);
        refused(read(id(odom), vec![of_other_topic], odom, kind), "type");
        // The holder of IK can derive a pseudonym from any text; only graph names and statements name a topic.
        for text in ["/x;touch${IFS}y", "/odom\nverified", "", "odom", "authros/", "authros/a\tb"] {
            refused(read(id(text), vec![], text, kind), "topic");
        }
        assert!(read(id("authros/recorder"), vec![], "authros/recorder", kind).is_ok());
    }
}
