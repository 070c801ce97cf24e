//! What a robot gets from its owner: its own signing pair, its name and K_T at a gateway, and the keys to seal its
//! records with, for some topics or for all. It never holds d_C, K_C or the EOA key, so a stolen robot is not a stolen
//! identity; it holds IK only if it covers all topics or was enrolled by version 1. The file format is in `file`.

use zeroize::Zeroizing;

use crate::model::wire::{Reader, WireError, put_text};
use crate::model::{Address, Domain, ProfileName, PublicKey, RecorderId, SignerId, Token, TopicId};

use super::gateway_addresses::{encoded, read_addresses};
use super::{
    IndexKey, ProviderName, SmKeyPair, SmSecret, TopicKey, TransportKey, notice_topic, provider, signer_id, topic_id,
};

mod file;
mod issue;
mod notice;

pub use file::{SealedEnrolment, version_of};
pub use issue::{EpochIssue, IssuedKeys, IssuedTopic, Pseudonyms, SealingKey};
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
    /// IK, if the device covers all topics or was enrolled by version 1.
    pub index: Option<IndexKey>,
    /// The topic under which the owner's notices to it are filed.
    pub notice_id: TopicId,
    /// The key that opens them.
    pub notice_key: TopicKey,
    /// A token registered on the chain, which the robot shows to the gateway.
    pub token: Token,
    /// The owner's recorder and the number of the newest notice applied.
    pub noticed: Option<(RecorderId, u64)>,
    /// The keys to seal with.
    pub keys: IssuedKeys,
    /// Format version: 1 (earlier versions) or 2.
    pub version: u8,
}

impl Enrolment {
    /// The version written for new robots.
    pub const NEWEST: u8 = 2;

    /// SM3 of the device's public key.
    pub fn device_id(&self) -> SignerId {
        signer_id(&self.device.public)
    }

    /// Its encoding, in its own version's format.
    fn encode(&self) -> Result<Zeroizing<Vec<u8>>, WireError> {
        let keys = self.keys.encode();
        let places: usize = self.gateway.addresses.iter().map(|address| address.len() + 2).sum();
        let mut out = Zeroizing::new(Vec::with_capacity(512 + places + keys.len()));
        out.extend_from_slice(&self.domain.0);
        out.extend_from_slice(&self.chain_id.to_be_bytes());
        match self.version {
            1 => self.put_secrets_1(&mut out)?,
            _ => self.put_secrets_2(&mut out),
        }
        match self.noticed {
            None => out.push(0),
            Some((recorder, number)) => {
                out.push(1);
                out.extend_from_slice(&recorder.0);
                out.extend_from_slice(&number.to_be_bytes());
            }
        }
        out.extend_from_slice(&keys);
        Ok(out)
    }

    /// Version 1: gateway || fingerprint (32) || N || owner (20) || P_C (64) || K_T (32) || device secret (32) ||
    /// IK (32) || notice key (32) || token (32); texts with their length (2) before them.
    fn put_secrets_1(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        let gateway = &self.gateway;
        put_text(out, gateway.addresses.first().map_or("", String::as_str));
        out.extend_from_slice(&gateway.fingerprint.0);
        put_text(out, self.name.as_str());
        out.extend_from_slice(&self.owner.0);
        out.extend_from_slice(&self.owner_key.0);
        out.extend_from_slice(gateway.transport.expose());
        out.extend_from_slice(self.device.secret.expose());
        out.extend_from_slice(self.index.as_ref().ok_or(WireError::Value("index key"))?.expose());
        out.extend_from_slice(self.notice_key.expose());
        out.extend_from_slice(&self.token.0);
        Ok(())
    }

    /// Version 2: addresses || fingerprint (32) || K_T (32) || N || owner (20) || P_C (64) || device secret (32) || 0, or 1 || IK (32), || topic id of the notices (16) || notice key (32) || token (32).
    fn put_secrets_2(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&encoded(&self.gateway.addresses));
        out.extend_from_slice(&self.gateway.fingerprint.0);
        out.extend_from_slice(self.gateway.transport.expose());
        put_text(out, self.name.as_str());
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
    }

    fn parse(plain: &[u8], version: u8) -> Result<Self, WireError> {
        let mut reader = Reader::new(plain);
        let (domain, chain_id) = (Domain(reader.array("domain")?), reader.u64("chain id")?);
        let mut enrolment = match version {
            1 => Self::read_1(&mut reader, domain, chain_id)?,
            2 => Self::read_2(&mut reader, domain, chain_id)?,
            _ => return Err(WireError::Value("version")),
        };
        enrolment.noticed = match reader.u8("notice")? {
            0 => None,
            1 => Some((RecorderId(reader.array("recorder")?), reader.u64("number")?)),
            _ => return Err(WireError::Value("notice")),
        };
        enrolment.keys = IssuedKeys::read(&mut reader)?;
        reader.end()?;
        // Without IK, the only pseudonyms are those that were issued.
        let issues = std::iter::once(&enrolment.keys.now).chain(enrolment.keys.next.as_ref().map(|(_, next)| next));
        if enrolment.index.is_none() && !issues.into_iter().all(EpochIssue::stands_alone) {
            return Err(WireError::Value("index key"));
        }
        Ok(enrolment)
    }

    fn read_1(reader: &mut Reader<'_>, domain: Domain, chain_id: u64) -> Result<Self, WireError> {
        let (address, fingerprint) = (reader.text("gateway")?, SignerId(reader.array("fingerprint")?));
        let (name, owner, owner_key) = read_owner(reader)?;
        let transport = TransportKey::new(reader.array("transport key")?);
        let device = read_device(reader)?;
        let index = IndexKey::new(reader.array("index key")?);
        let notice_id = topic_id(&index, &notice_topic(&signer_id(&device.public)));
        Ok(Self {
            domain,
            chain_id,
            gateway: GatewayAccess { addresses: vec![address], fingerprint, transport },
            name,
            owner,
            owner_key,
            device,
            index: Some(index),
            notice_id,
            notice_key: TopicKey::new(reader.array("notice key")?),
            token: Token(reader.array("token")?),
            noticed: None,
            keys: IssuedKeys::none(),
            version: 1,
        })
    }

    fn read_2(reader: &mut Reader<'_>, domain: Domain, chain_id: u64) -> Result<Self, WireError> {
        let gateway = GatewayAccess {
            addresses: read_addresses(reader)?,
            fingerprint: SignerId(reader.array("fingerprint")?),
            transport: TransportKey::new(reader.array("transport key")?),
        };
        let (name, owner, owner_key) = read_owner(reader)?;
        let device = read_device(reader)?;
        let index = match reader.u8("index key")? {
            0 => None,
            1 => Some(IndexKey::new(reader.array("index key")?)),
            _ => return Err(WireError::Value("index key")),
        };
        Ok(Self {
            domain,
            chain_id,
            gateway,
            name,
            owner,
            owner_key,
            device,
            index,
            notice_id: TopicId(reader.array("notice id")?),
            notice_key: TopicKey::new(reader.array("notice key")?),
            token: Token(reader.array("token")?),
            noticed: None,
            keys: IssuedKeys::none(),
            version: 2,
        })
    }
}

fn read_owner(reader: &mut Reader<'_>) -> Result<(ProfileName, Address, PublicKey), WireError> {
    let name = reader.text("name")?.parse().map_err(|_| WireError::Value("name"))?;
    Ok((name, Address(reader.array("owner")?), PublicKey(reader.array("owner key")?)))
}

fn read_device(reader: &mut Reader<'_>) -> Result<SmKeyPair, WireError> {
    SmSecret::from_slice(reader.take(32, "device key")?)
        .and_then(|secret| SmKeyPair::from_secret(provider(ProviderName::RustCrypto), secret))
        .map_err(|_| WireError::Value("device key"))
}

#[cfg(test)]
mod tests;
