//! What a robot gets from its owner: a signing pair, its name and K_T at a gateway, and keys to seal with. It never
//! holds d_C, K_C or the EOA key, so a stolen robot is not a stolen identity; it holds IK only if it covers all topics.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use zeroize::Zeroizing;

use crate::error::shown;
use crate::gateway_addresses::{put_addresses, read_addresses};
use crate::keystore::{FileKey, SaveKeys, of_version};
use crate::model::wire::{Reader, Wire, WireError};
use crate::model::{
    Address, Domain, ProfileName, PublicKey, RecorderId, RingSpan, SignerId, Timestamp, Token, TopicId, layout,
};
use crate::private_file::{create_private, read_private, write_private};
use crate::sealed_file::{FileKind, LARGEST, SealedFile};
use crate::{
    CryptoError, EpochKey, FilterKey, GatewayAddresses, IndexKey, OwnerKeyChange, Passphrase, Result, SignedPolicy,
    SmKeyPair, TopicKey, TransportKey, signer_id,
};

/// The most topics whose keys are issued at once, including those for statements.
pub const MOST_TOPICS: usize = 1024;
/// The longest address of a gateway, bytes.
pub const LONGEST_ADDRESS: usize = 255;
/// The most addresses of a gateway.
pub const MOST_ADDRESSES: usize = 8;

/// The gateway that knows the robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GatewayAccess {
    /// Host:port each, at least one, in the order in which they are tried.
    pub addresses: Vec<String>,
    /// SM3 of its identity key.
    pub fingerprint: SignerId,
    /// K_T there.
    pub transport: TransportKey,
}

/// Where an owner's notice stands among all of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LastNotice {
    /// The owner's recorder.
    pub recorder: RecorderId,
    /// Its number there.
    pub number: u64,
    /// When it was sealed.
    pub at: Timestamp,
}

/// Everything a robot works with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Enrolment {
    /// The network.
    pub domain: Domain,
    /// Its chain id, shown to people.
    pub chain_id: u64,
    /// The gateway.
    pub gateway: GatewayAccess,
    /// N: the name by which the gateway knows the robot.
    pub name: ProfileName,
    /// The owner of the records.
    pub owner: Address,
    /// P_C: verifies the notices.
    pub owner_key: PublicKey,
    /// The device's own pair, lent to it on chain: signs the records.
    pub device: SmKeyPair,
    /// IK, if the device covers all topics.
    pub index: Option<IndexKey>,
    /// The topic under which the owner's notices to it are filed.
    pub notice_id: TopicId,
    /// The key that opens them.
    pub notice_key: TopicKey,
    /// A token registered on the chain, which the robot shows to the gateway.
    pub token: Token,
    /// The newest notice applied.
    pub last_notice: Option<LastNotice>,
    /// The keys to seal with.
    pub keys: IssuedKeys,
}

impl Enrolment {
    /// SM3 of the device's public key.
    pub fn device_id(&self) -> SignerId {
        signer_id(&self.device.public)
    }

    /// domain (32) || chain id (8) || addresses of the gateway || its fingerprint (32) || K_T (32) || N || owner (20) ||
    /// P_C (64) || device secret (32) || 0, or 1 || IK (32), || topic id of the notices (16) || notice key (32) || token
    /// (32) || 0, or 1 || recorder (16) || number (8) || time (8), || keys; texts with their length (2) before them.
    fn encode(&self) -> Zeroizing<Vec<u8>> {
        let places: usize = self.gateway.addresses.iter().map(|address| address.len() + 2).sum();
        // Reserved in one piece, tag included: growing the buffer would leave unwiped copies behind.
        let mut out = Zeroizing::new(Vec::with_capacity(512 + places + self.keys.length()));
        self.put(&mut out);
        out
    }

    fn parse(plain: &[u8]) -> Result<Self, WireError> {
        let enrolment = Self::whole(plain)?;
        // Without IK, the only pseudonyms are those that were issued.
        let IssuedKeys { now, next } = &enrolment.keys;
        let mut issues = std::iter::once(now).chain(next.as_ref().map(|(_, next)| next));
        if enrolment.index.is_none() && issues.any(|issue| matches!(issue.key, SealingKey::Epoch(_))) {
            return Err(WireError::Value("index key"));
        }
        Ok(enrolment)
    }
}

layout!(LastNotice { recorder: "recorder", number: "number", at: "time" });
layout!(Enrolment {
    domain: "domain",
    chain_id: "chain id",
    gateway: "gateway",
    name: "name",
    owner: "owner",
    owner_key: "owner key",
    device: "device key",
    index: "index key",
    notice_id: "notice id",
    notice_key: "notice key",
    token: "token",
    last_notice: "notice",
    keys: "keys",
});

impl Wire for GatewayAccess {
    fn put(&self, out: &mut Vec<u8>) {
        put_addresses(out, &self.addresses);
        self.fingerprint.put(out);
        self.transport.put(out);
    }

    fn read(reader: &mut Reader<'_>, _: &'static str) -> Result<Self, WireError> {
        let (addresses, fingerprint) = (read_addresses(reader)?, Wire::read(reader, "fingerprint")?);
        Ok(Self { addresses, fingerprint, transport: Wire::read(reader, "transport key")? })
    }
}

const KIND: FileKind = FileKind { magic: *b"\x89AuthEnr", label: "AuthROS/enrolment/1", what: "enrolment" };

fn split<'a>(path: &Path, bytes: &'a [u8]) -> Result<SealedFile<'a>> {
    KIND.split(bytes).map_err(|why| of_version(path, "an enrolment", bytes, why).unwrap_or_else(|| damaged(path)))
}

fn open(keys: &SaveKeys, file: &SealedFile<'_>) -> Option<Enrolment> {
    Enrolment::parse(&file.open(keys)?).ok()
}

fn damaged(path: &Path) -> CryptoError {
    let found = "it is damaged or not an enrolment; ask its owner to enrol the robot again".to_owned();
    CryptoError::NotAKey { path: shown(path), wanted: "an enrolment", found }
}

/// An enrolment in memory with its file's key, so that later saves need no derivation.
pub struct SealedEnrolment {
    /// The enrolment; call [`Self::save`] after changing it.
    pub enrolment: Enrolment,
    key: FileKey,
}

impl SealedEnrolment {
    /// A new enrolment; derives the passphrase's key (about 0.3 s).
    /// # Errors
    /// [`CryptoError::Random`].
    pub fn new(enrolment: Enrolment, passphrase: &Passphrase) -> Result<Self> {
        Ok(Self { enrolment, key: FileKey::new(passphrase)? })
    }

    /// The bytes of the file.
    /// # Errors
    /// [`CryptoError::Length`] if it is too large, [`CryptoError::Random`].
    pub fn seal(&self) -> Result<Vec<u8>> {
        KIND.seal(&self.key, self.enrolment.encode())
    }

    /// Reads and opens a file (about 0.3 s).
    /// # Errors
    /// [`CryptoError::NotAKey`], [`CryptoError::Version`], [`CryptoError::WrongPassphrase`], or as [`read_private`].
    pub fn open(path: &Path, passphrase: &Passphrase) -> Result<Self> {
        let bytes = read_private(path, LARGEST)?;
        let file = split(path, &bytes)?;
        let key = FileKey::with(passphrase, file.head.work, file.head.salt)?;
        let keys = KIND.keys(&file, &key).ok_or_else(|| CryptoError::WrongPassphrase(shown(path)))?;
        let enrolment = open(&keys, &file).ok_or_else(|| damaged(path))?;
        Ok(Self { enrolment, key })
    }

    /// Takes over a later save of the same enrolment, if there is one; needs no derivation.
    /// # Errors
    /// [`CryptoError::Read`], [`CryptoError::OpenToOthers`].
    pub fn catch_up(&mut self, path: &Path) -> Result<()> {
        if !path.exists() {
            return Ok(());
        }
        let bytes = read_private(path, LARGEST)?;
        let Ok(file) = split(path, &bytes) else { return Ok(()) };
        let keys = KIND.keys(&file, &self.key).filter(|_| file.head.salt == self.key.salt);
        if let Some(later) = keys.and_then(|keys| open(&keys, &file))
            && later.device_id() == self.enrolment.device_id()
            && later.keys.now.epoch >= self.enrolment.keys.now.epoch
        {
            self.enrolment = later;
        }
        Ok(())
    }

    /// Writes a new file, never over one that is there.
    /// # Errors
    /// [`CryptoError::Write`], also if the file exists.
    pub fn create(&self, path: &Path) -> Result<()> {
        create_private(path, &self.seal()?)
    }

    /// Replaces the file in one step.
    /// # Errors
    /// [`CryptoError::Write`]; the old file is then still intact.
    pub fn save(&self, path: &Path) -> Result<()> {
        write_private(path, &self.seal()?)
    }

    /// The file in the robot's directory that keeps what it has learnt since enrolment.
    pub fn kept_in(directory: &Path) -> PathBuf {
        directory.join("enrolment")
    }
}

const EPOCH: u8 = 0;
const TOPICS: u8 = 1;
/// Prefix of topic names that are not ROS topics: statements are filed under them.
const STATEMENTS: &str = "authros/";

/// What a device needs to seal one topic's records in an epoch; it need not hold IK.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IssuedTopic {
    /// The topic's pseudonym.
    pub id: TopicId,
    /// The filter key for the pseudonyms of its types and tags.
    pub filters: FilterKey,
    /// Its key.
    pub key: TopicKey,
}

/// The source of an epoch's topic keys.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SealingKey {
    /// EK, for any topic.
    Epoch(EpochKey),
    /// Keys for some topics, by name; other topics cannot be sealed.
    Topics(BTreeMap<String, IssuedTopic>),
}

impl SealingKey {
    /// The topics it is limited to, without those that statements are filed under; `None` if it covers all topics.
    pub fn topics(&self) -> Option<Vec<String>> {
        match self {
            Self::Epoch(_) => None,
            Self::Topics(keys) => Some(keys.keys().filter(|name| !name.starts_with(STATEMENTS)).cloned().collect()),
        }
    }
}

/// The keys of one epoch, as an owner issues them to a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EpochIssue {
    /// The epoch's number.
    pub epoch: u64,
    /// Its token.
    pub token: Token,
    /// When its earliest grant expires: nothing captured from then on may be sealed under it.
    pub ends: Option<Timestamp>,
    /// Its keys.
    pub key: SealingKey,
}

/// The keys a device seals with now, and those from a known moment on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IssuedKeys {
    /// Now.
    pub now: EpochIssue,
    /// The keys from the moment the earliest grant of the present epoch expires.
    pub next: Option<(Timestamp, EpochIssue)>,
}

impl IssuedKeys {
    /// Its encoding, the body of a notice: issue || 0 or 1 || [moment (8) || issue]. An issue is epoch (8) || token
    /// (32) || end (8, 0 for none) || 0 || EK (32), or instead of the last two 1 || count (2) || topic, topic id (16),
    /// filter key (32) and key (32) each.
    pub fn encode(&self) -> Zeroizing<Vec<u8>> {
        // Reserved in one piece, tag included: growing the buffer would leave unwiped copies behind.
        let mut out = Zeroizing::new(Vec::with_capacity(self.length() + 16));
        self.put(&mut out);
        out
    }

    fn length(&self) -> usize {
        self.now.length() + self.next.as_ref().map_or(1, |(_, next)| 9 + next.length())
    }

    /// From the body of a notice.
    /// # Errors
    /// [`WireError`] if it is malformed.
    pub fn parse(body: &[u8]) -> Result<Self, WireError> {
        Self::whole(body)
    }
}

impl Wire for IssuedKeys {
    fn put(&self, out: &mut Vec<u8>) {
        self.now.put(out);
        self.next.put(out);
    }

    fn read(reader: &mut Reader<'_>, _: &'static str) -> Result<Self, WireError> {
        let now = EpochIssue::read(reader, "keys")?;
        let next: Option<(Timestamp, EpochIssue)> = Wire::read(reader, "next epoch")?;
        if next.as_ref().is_some_and(|(_, next)| next.epoch <= now.epoch) {
            return Err(WireError::Value("next epoch"));
        }
        Ok(Self { now, next })
    }
}

impl EpochIssue {
    fn length(&self) -> usize {
        49 + match &self.key {
            SealingKey::Epoch(_) => 32,
            SealingKey::Topics(keys) => 2 + keys.keys().map(|topic| topic.len() + 82).sum::<usize>(),
        }
    }
}

layout!(IssuedTopic { id: "topic id", filters: "filter key", key: "topic key" });

impl Wire for EpochIssue {
    fn put(&self, out: &mut Vec<u8>) {
        (self.epoch, self.token).put(out);
        self.ends.unwrap_or_default().put(out);
        match &self.key {
            SealingKey::Epoch(key) => {
                EPOCH.put(out);
                key.put(out);
            }
            SealingKey::Topics(keys) => {
                TOPICS.put(out);
                let count = keys.len().min(MOST_TOPICS);
                u16::try_from(count).unwrap_or(0).put(out);
                for (topic, issued) in keys.iter().take(count) {
                    topic.put(out);
                    issued.put(out);
                }
            }
        }
    }

    fn read(reader: &mut Reader<'_>, _: &'static str) -> Result<Self, WireError> {
        let (epoch, token) = (reader.u64("epoch")?, Wire::read(reader, "token")?);
        if epoch == 0 {
            return Err(WireError::Value("epoch"));
        }
        let ends = Some(Timestamp(reader.u64("end")?)).filter(|ends| ends.0 > 0);
        let key = match reader.u8("key")? {
            EPOCH => SealingKey::Epoch(Wire::read(reader, "epoch key")?),
            TOPICS => SealingKey::Topics(read_topics(reader)?),
            _ => return Err(WireError::Value("key")),
        };
        Ok(Self { epoch, token, ends, key })
    }
}

fn read_topics(reader: &mut Reader<'_>) -> Result<BTreeMap<String, IssuedTopic>, WireError> {
    let count = usize::from(reader.u16("topic count")?);
    if count > MOST_TOPICS {
        return Err(WireError::Value("topic count"));
    }
    let mut keys = BTreeMap::new();
    for _ in 0..count {
        let topic = reader.text("topic")?;
        // Sorted by name, so that every value has exactly one encoding.
        if keys.last_key_value().is_some_and(|(last, _)| *last >= topic) {
            return Err(WireError::Value("topic"));
        }
        keys.insert(topic, IssuedTopic::read(reader, "topic key")?);
    }
    Ok(keys)
}

// A notice begins with its kind. 0 (keys) is the first byte of an epoch, which is far below 2^56.

/// What an owner tells a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Notice {
    /// The keys to seal with from now on.
    Keys(IssuedKeys),
    /// The key the owner signs with from now on.
    OwnerKey(OwnerKeyChange),
    /// The addresses of its gateway from now on.
    Addresses(GatewayAddresses),
    /// A span of its ring is to be sent like other records.
    Pull(RingSpan),
    /// The policy to work by from now on.
    Policy(SignedPolicy),
    /// A kind that this version does not know, by its number; it is ignored.
    Unknown(u8),
}

impl Notice {
    const KEYS: u8 = 0;
    const OWNER_KEY: u8 = 1;
    const ADDRESSES: u8 = 2;
    const PULL: u8 = 3;
    const POLICY: u8 = 4;

    /// Its encoding, the body of the record.
    pub fn encode(&self) -> Zeroizing<Vec<u8>> {
        match self {
            Self::Keys(keys) => keys.encode(),
            Self::OwnerKey(change) => Zeroizing::new([&[Self::OWNER_KEY], &change.encode()[..]].concat()),
            Self::Addresses(list) => Zeroizing::new([&[Self::ADDRESSES], &list.encode()[..]].concat()),
            Self::Pull(span) => Zeroizing::new([&[Self::PULL], &span.encode()[..]].concat()),
            Self::Policy(policy) => Zeroizing::new([&[Self::POLICY], &policy.encode()[..]].concat()),
            Self::Unknown(kind) => Zeroizing::new(vec![*kind]),
        }
    }

    /// From the body of a record.
    /// # Errors
    /// [`WireError`] if it is malformed.
    pub fn parse(body: &[u8]) -> Result<Self, WireError> {
        match body.split_first() {
            Some((&Self::KEYS, _)) | None => IssuedKeys::parse(body).map(Self::Keys),
            Some((&Self::OWNER_KEY, change)) => OwnerKeyChange::parse(change).map(Self::OwnerKey),
            Some((&Self::ADDRESSES, list)) => GatewayAddresses::parse(list).map(Self::Addresses),
            Some((&Self::PULL, span)) => RingSpan::parse(span).map(Self::Pull),
            Some((&Self::POLICY, policy)) => SignedPolicy::parse(policy).map(Self::Policy),
            Some((kind, _)) => Ok(Self::Unknown(*kind)),
        }
    }
}
