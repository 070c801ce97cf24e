//! What a robot gets from its owner: its own signing pair, its name and K_T at a gateway, and the keys to seal its
//! records with, for some topics or for all. It never holds d_C, K_C or the EOA key, so a stolen robot is not a stolen
//! identity; it holds IK only if it covers all topics. The file format is in `file`.

use zeroize::Zeroizing;

use crate::model::wire::{Reader, WireError, put_text};
use crate::model::{Address, Domain, ProfileName, PublicKey, RecorderId, SignerId, Timestamp, Token, TopicId};

use super::gateway_addresses::{encoded, read_addresses};
use super::{IndexKey, ProviderName, SmKeyPair, SmSecret, TopicKey, TransportKey, provider, signer_id};

mod file;
mod issue;
mod notice;

pub use file::SealedEnrolment;
pub use issue::{EpochIssue, IssuedKeys, IssuedTopic, SealingKey};
pub use notice::Notice;

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
        let keys = self.keys.encode();
        let places: usize = self.gateway.addresses.iter().map(|address| address.len() + 2).sum();
        let mut out = Zeroizing::new(Vec::with_capacity(512 + places + keys.len()));
        out.extend_from_slice(&self.domain.0);
        out.extend_from_slice(&self.chain_id.to_be_bytes());
        out.extend_from_slice(&encoded(&self.gateway.addresses));
        out.extend_from_slice(&self.gateway.fingerprint.0);
        out.extend_from_slice(self.gateway.transport.expose());
        put_text(&mut out, self.name.as_str());
        out.extend_from_slice(&self.owner.0);
        out.extend_from_slice(&self.owner_key.0);
        out.extend_from_slice(self.device.secret.expose());
        match &self.index {
            None => out.push(0),
            Some(index) => {
                out.push(1);
                out.extend_from_slice(index.expose());
            }
        }
        out.extend_from_slice(&self.notice_id.0);
        out.extend_from_slice(self.notice_key.expose());
        out.extend_from_slice(&self.token.0);
        match self.last_notice {
            None => out.push(0),
            Some(LastNotice { recorder, number, at }) => {
                out.push(1);
                out.extend_from_slice(&recorder.0);
                out.extend_from_slice(&number.to_be_bytes());
                out.extend_from_slice(&at.0.to_be_bytes());
            }
        }
        out.extend_from_slice(&keys);
        out
    }

    fn parse(plain: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(plain);
        let enrolment = Self::read(&mut reader)?;
        reader.end()?;
        // Without IK, the only pseudonyms are those that were issued.
        let IssuedKeys { now, next } = &enrolment.keys;
        let mut issues = std::iter::once(now).chain(next.as_ref().map(|(_, next)| next));
        if enrolment.index.is_none() && issues.any(|issue| matches!(issue.key, SealingKey::Epoch(_))) {
            return Err(WireError::Value("index key"));
        }
        Ok(enrolment)
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        Ok(Self {
            domain: Domain(reader.array("domain")?),
            chain_id: reader.u64("chain id")?,
            gateway: GatewayAccess {
                addresses: read_addresses(reader)?,
                fingerprint: SignerId(reader.array("fingerprint")?),
                transport: TransportKey::new(reader.array("transport key")?),
            },
            name: reader.text("name")?.parse().map_err(|_| WireError::Value("name"))?,
            owner: Address(reader.array("owner")?),
            owner_key: PublicKey(reader.array("owner key")?),
            device: read_device(reader)?,
            index: match reader.u8("index key")? {
                0 => None,
                1 => Some(IndexKey::new(reader.array("index key")?)),
                _ => return Err(WireError::Value("index key")),
            },
            notice_id: TopicId(reader.array("notice id")?),
            notice_key: TopicKey::new(reader.array("notice key")?),
            token: Token(reader.array("token")?),
            last_notice: match reader.u8("notice")? {
                0 => None,
                1 => Some(LastNotice {
                    recorder: RecorderId(reader.array("recorder")?),
                    number: reader.u64("number")?,
                    at: Timestamp(reader.u64("time")?),
                }),
                _ => return Err(WireError::Value("notice")),
            },
            keys: IssuedKeys::read(reader)?,
        })
    }
}

fn read_device(reader: &mut Reader<'_>) -> Result<SmKeyPair, WireError> {
    SmSecret::from_slice(reader.take(32, "device key")?)
        .and_then(|secret| SmKeyPair::from_secret(provider(ProviderName::RustCrypto), secret))
        .map_err(|_| WireError::Value("device key"))
}

#[cfg(test)]
mod tests;
