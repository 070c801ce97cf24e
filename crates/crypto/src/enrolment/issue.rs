//! The keys of an epoch as an owner issues them to a device, and their encoding.

use std::collections::BTreeMap;

use zeroize::Zeroizing;

use crate::crypto::{EpochKey, FilterKey, TopicKey};
use crate::model::wire::{Reader, WireError, put_text};
use crate::model::{Timestamp, Token, TopicId};

/// The most topics whose keys are issued at once, including those for statements.
const MOST_ISSUED: usize = super::MOST_TOPICS;

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
        let length = self.now.length() + self.next.as_ref().map_or(1, |(_, next)| 9 + next.length());
        // Reserved in one piece, tag included: growing the buffer would leave unwiped copies behind.
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
    /// [`WireError`] if it is malformed.
    pub fn parse(body: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(body);
        let issued = Self::read(&mut reader)?;
        reader.end()?;
        Ok(issued)
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
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
            SealingKey::Topics(keys) => 2 + keys.keys().map(|topic| topic.len() + 82).sum::<usize>(),
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
                let count = keys.len().min(MOST_ISSUED);
                out.extend_from_slice(&u16::try_from(count).unwrap_or(0).to_be_bytes());
                for (topic, issued) in keys.iter().take(count) {
                    put_text(out, topic);
                    out.extend_from_slice(&issued.id.0);
                    out.extend_from_slice(issued.filters.expose());
                    out.extend_from_slice(issued.key.expose());
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

fn read_topics(reader: &mut Reader<'_>) -> Result<BTreeMap<String, IssuedTopic>, WireError> {
    let count = usize::from(reader.u16("topic count")?);
    if count > MOST_ISSUED {
        return Err(WireError::Value("topic count"));
    }
    let mut keys = BTreeMap::new();
    for _ in 0..count {
        let topic = reader.text("topic")?;
        // Sorted by name, so that every value has exactly one encoding.
        if keys.last_key_value().is_some_and(|(last, _)| *last >= topic) {
            return Err(WireError::Value("topic"));
        }
        let issued = IssuedTopic {
            id: TopicId(reader.array("topic id")?),
            filters: FilterKey::new(reader.array("filter key")?),
            key: TopicKey::new(reader.array("topic key")?),
        };
        keys.insert(topic, issued);
    }
    Ok(keys)
}
