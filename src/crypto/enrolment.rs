//! What a robot gets from its owner: its own signing pair, K_T of its name at a gateway, and the keys that its
//! records are sealed under, of all topics or of some. It holds neither d_C, K_C nor the EOA: a stolen robot is
//! not a stolen identity. How it lies on disk is `file`.

use std::collections::BTreeMap;

use zeroize::Zeroizing;

use crate::model::wire::{Reader, WireError, put_text};
use crate::model::{Address, Domain, ProfileName, PublicKey, RecorderId, SignerId, Timestamp, Token};

use super::{EpochKey, IndexKey, ProviderName, SmKeyPair, SmSecret, TopicKey, TransportKey, provider, signer_id};

mod file;

pub use file::SealedEnrolment;

/// The most topics whose keys are issued at once.
pub const MOST_TOPICS: usize = 1024;
/// The longest address of a gateway, bytes.
pub const LONGEST_GATEWAY: usize = 255;

const EPOCH: u8 = 0;
const TOPICS: u8 = 1;

/// What an epoch's topic keys come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SealingKey {
    /// EK: any topic.
    Epoch(EpochKey),
    /// The keys of some topics, by name; others cannot be sealed.
    Topics(BTreeMap<String, TopicKey>),
}

impl SealingKey {
    /// The topics that it is limited to; `None` where it covers all.
    pub fn topics(&self) -> Option<Vec<String>> {
        match self {
            Self::Epoch(_) => None,
            Self::Topics(keys) => Some(keys.keys().cloned().collect()),
        }
    }
}

/// The keys of one epoch, as an owner gives them to a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EpochIssue {
    /// The epoch's number.
    pub epoch: u64,
    /// Its token.
    pub token: Token,
    /// When its earliest grant runs out: nothing captured from then on may be sealed under it.
    pub ends: Option<Timestamp>,
    /// Its keys.
    pub key: SealingKey,
}

/// What a device seals under now, and from a known moment on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IssuedKeys {
    /// Now.
    pub now: EpochIssue,
    /// From the moment on at which the earliest grant of the present epoch runs out.
    pub next: Option<(Timestamp, EpochIssue)>,
}

impl IssuedKeys {
    /// Its bytes, the body of a notice: issue || 0 or 1 || [moment (8) || issue]; an issue is epoch (8) ||
    /// token (32) || end (8, 0 for none) || 0 || EK (32), or instead of the last two 1 || count (2) || topic and
    /// key (32) each.
    pub fn encode(&self) -> Zeroizing<Vec<u8>> {
        let length = self.now.length() + self.next.as_ref().map_or(1, |(_, next)| 9 + next.length());
        // Reserved in one piece, tag included: growing would leave unwiped copies behind.
        let mut out = Zeroizing::new(Vec::with_capacity(length + 16));
        self.now.put(&mut out);
        match &self.next {
            None => out.push(0),
            Some((moment, next)) => {
                out.push(1);
                out.extend_from_slice(&moment.0.to_be_bytes());
                next.put(&mut out);
            }
        }
        out
    }

    /// From the body of a notice.
    ///
    /// # Errors
    /// [`WireError`] where it is none.
    pub fn parse(body: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(body);
        let issued = Self::read(&mut reader)?;
        reader.end()?;
        Ok(issued)
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let now = EpochIssue::read(reader)?;
        let next = match reader.u8("next epoch")? {
            0 => None,
            1 => Some((Timestamp(reader.u64("moment")?), EpochIssue::read(reader)?)),
            _ => return Err(WireError::Value("next epoch")),
        };
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
            SealingKey::Topics(keys) => 2 + keys.keys().map(|topic| topic.len() + 34).sum::<usize>(),
        }
    }

    fn put(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.epoch.to_be_bytes());
        out.extend_from_slice(&self.token.0);
        out.extend_from_slice(&self.ends.map_or(0, |ends| ends.0).to_be_bytes());
        match &self.key {
            SealingKey::Epoch(key) => {
                out.push(EPOCH);
                out.extend_from_slice(key.expose());
            }
            SealingKey::Topics(keys) => {
                out.push(TOPICS);
                let count = keys.len().min(MOST_TOPICS);
                out.extend_from_slice(&u16::try_from(count).unwrap_or(0).to_be_bytes());
                for (topic, key) in keys.iter().take(count) {
                    put_text(out, topic);
                    out.extend_from_slice(key.expose());
                }
            }
        }
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let (epoch, token) = (reader.u64("epoch")?, Token(reader.array("token")?));
        if epoch == 0 {
            return Err(WireError::Value("epoch"));
        }
        let ends = Some(Timestamp(reader.u64("end")?)).filter(|ends| ends.0 > 0);
        let key = match reader.u8("key")? {
            EPOCH => SealingKey::Epoch(EpochKey::new(reader.array("epoch key")?)),
            TOPICS => SealingKey::Topics(read_topics(reader)?),
            _ => return Err(WireError::Value("key")),
        };
        Ok(Self { epoch, token, ends, key })
    }
}

fn read_topics(reader: &mut Reader<'_>) -> Result<BTreeMap<String, TopicKey>, WireError> {
    let count = usize::from(reader.u16("topic count")?);
    if count > MOST_TOPICS {
        return Err(WireError::Value("topic count"));
    }
    let mut keys = BTreeMap::new();
    for _ in 0..count {
        let topic = reader.text("topic")?;
        // In the order of names, so that what parses has one encoding.
        if keys.last_key_value().is_some_and(|(last, _)| *last >= topic) {
            return Err(WireError::Value("topic"));
        }
        keys.insert(topic, TopicKey::new(reader.array("topic key")?));
    }
    Ok(keys)
}

/// All that a robot works with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Enrolment {
    /// The network.
    pub domain: Domain,
    /// Its chain id, for people.
    pub chain_id: u64,
    /// The gateway, host:port.
    pub gateway: String,
    /// SM3 of the gateway's identity key.
    pub fingerprint: SignerId,
    /// N: what the gateway knows the robot by.
    pub name: ProfileName,
    /// Whose records these are.
    pub owner: Address,
    /// P_C: signs the notices.
    pub owner_key: PublicKey,
    /// K_T.
    pub transport: TransportKey,
    /// The device's own pair, lent on chain: signs the records.
    pub device: SmKeyPair,
    /// IK.
    pub index: IndexKey,
    /// Opens the owner's notices to this device.
    pub notice_key: TopicKey,
    /// A token that the chain has: what the robot shows the gateway.
    pub token: Token,
    /// The owner's ledger and number of the newest notice that was taken.
    pub noticed: Option<(RecorderId, u64)>,
    /// What to seal under.
    pub keys: IssuedKeys,
}

impl Enrolment {
    /// SM3 of the device's public key.
    pub fn device_id(&self) -> SignerId {
        signer_id(&self.device.public)
    }

    /// Domain (32) || chain id (8) || gateway || fingerprint (32) || N || owner (20) || P_C (64) || K_T (32) ||
    /// device secret (32) || IK (32) || notice key (32) || token (32) || 0, or 1 || recorder (16) || number (8),
    /// || issued keys; texts with their length (2) before them.
    fn encode(&self) -> Zeroizing<Vec<u8>> {
        let keys = self.keys.encode();
        let mut out = Zeroizing::new(Vec::with_capacity(512 + self.gateway.len() + keys.len()));
        out.extend_from_slice(&self.domain.0);
        out.extend_from_slice(&self.chain_id.to_be_bytes());
        put_text(&mut out, &self.gateway);
        out.extend_from_slice(&self.fingerprint.0);
        put_text(&mut out, self.name.as_str());
        out.extend_from_slice(&self.owner.0);
        out.extend_from_slice(&self.owner_key.0);
        out.extend_from_slice(self.transport.expose());
        out.extend_from_slice(self.device.secret.expose());
        out.extend_from_slice(self.index.expose());
        out.extend_from_slice(self.notice_key.expose());
        out.extend_from_slice(&self.token.0);
        match self.noticed {
            None => out.push(0),
            Some((recorder, number)) => {
                out.push(1);
                out.extend_from_slice(&recorder.0);
                out.extend_from_slice(&number.to_be_bytes());
            }
        }
        out.extend_from_slice(&keys);
        out
    }

    fn parse(plain: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(plain);
        let enrolment = Self {
            domain: Domain(reader.array("domain")?),
            chain_id: reader.u64("chain id")?,
            gateway: reader.text("gateway")?,
            fingerprint: SignerId(reader.array("fingerprint")?),
            name: reader.text("name")?.parse().map_err(|_| WireError::Value("name"))?,
            owner: Address(reader.array("owner")?),
            owner_key: PublicKey(reader.array("owner key")?),
            transport: TransportKey::new(reader.array("transport key")?),
            device: SmSecret::from_slice(reader.take(32, "device key")?)
                .and_then(|secret| SmKeyPair::from_secret(provider(ProviderName::RustCrypto), secret))
                .map_err(|_| WireError::Value("device key"))?,
            index: IndexKey::new(reader.array("index key")?),
            notice_key: TopicKey::new(reader.array("notice key")?),
            token: Token(reader.array("token")?),
            noticed: match reader.u8("notice")? {
                0 => None,
                1 => Some((RecorderId(reader.array("recorder")?), reader.u64("number")?)),
                _ => return Err(WireError::Value("notice")),
            },
            keys: IssuedKeys::read(&mut reader)?,
        };
        reader.end()?;
        if enrolment.gateway.len() > LONGEST_GATEWAY {
            return Err(WireError::Value("gateway"));
        }
        Ok(enrolment)
    }
}

#[cfg(test)]
mod tests;
