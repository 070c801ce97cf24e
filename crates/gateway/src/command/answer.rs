//! The gateway's answers, by Command.

use crate::model::wire::{Reader, Wire, WireError, read_list};
use crate::model::{PublicKey, Signature, Timestamp};

use super::relay::Relayed;
use super::request::MOST_DIGESTS;
use super::{Command, ErasedRecord, ErasureOutcome, MOST_ERASURES, list};
use crate::error::Code;
use crate::feed::{FeedPage, read_proof};
use crate::gateway::receipt::Receipt;

pub const LONGEST_PROOF: usize = 64 * 1024;
const LONGEST_LIST: usize = 1024;
/// signer key (64) || signature (64) || proof length (4) || proof || blob.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fetched {
    /// The reader compares it with the chain.
    pub signer: PublicKey,
    pub signature: Signature,
    /// In the chain crate's form; empty until there is one.
    pub proof: Vec<u8>,
    pub blob: Vec<u8>,
}

impl Fetched {
    pub(super) fn encode(&self) -> Vec<u8> {
        let proof = &self.proof[..self.proof.len().min(LONGEST_PROOF)];
        let length = u32::try_from(proof.len()).unwrap_or(u32::MAX).to_be_bytes();
        let parts: [&[u8]; 5] = [&self.signer.0, &self.signature.0, &length, proof, &self.blob];
        parts.concat()
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let signer = PublicKey(reader.array("signer")?);
        let signature = Signature(reader.array("signature")?);
        let proof = read_proof(reader)?;
        let blob = reader.take(reader.rest().len(), "record")?.to_vec();
        Ok(Self { signer, signature, proof, blob })
    }
}

/// 0 || code (2); 1; 2 || length (4) || record; or 3 || length (4) || record, whose blob is header and statement.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Found {
    /// Nothing for this caller.
    Missing(Code),
    /// In reply to a request without bytes.
    Here,
    Held(Fetched),
    Erased(ErasedRecord),
}

impl Wire for Found {
    fn put(&self, out: &mut Vec<u8>) {
        match self {
            Self::Missing(code) => (0u8, *code).put(out),
            Self::Here => 1u8.put(out),
            Self::Held(record) => (2u8, record.encode()).put(out),
            Self::Erased(erased) => (3u8, erased.clone().into_fetched().encode()).put(out),
        }
    }

    fn read(reader: &mut Reader<'_>, field: &'static str) -> Result<Self, WireError> {
        let tag = reader.u8(field)?;
        match tag {
            0 => return Code::read(reader, "code").map(Self::Missing),
            1 => return Ok(Self::Here),
            2 | 3 => {}
            _ => return Err(WireError::Value(field)),
        }
        let record = Fetched::read(&mut Reader::new(&Vec::<u8>::read(reader, "record")?))?;
        if tag == 2 { Ok(Self::Held(record)) } else { ErasedRecord::from_fetched(record).map(Self::Erased) }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answer {
    /// In its gateway's encoding.
    SystemKeys(Vec<u8>),
    /// For an allocation (SM3(CT)), uploads (their digests), or a notice (SM3(body)).
    Receipt(Command, Receipt),
    /// 8 bytes.
    Time(Timestamp),
    Relayed(Relayed),
    /// For each erasure in order: count (2), a byte each.
    Erasures(Vec<ErasureOutcome>),
    Feed(Box<FeedPage>),
    /// For the first digests, at least one: count (2), then each.
    Records(Vec<Found>),
    /// Code (2).
    Refused(Code),
    /// Code 28 (2), and when (8).
    Recalled(Timestamp),
}

impl Answer {
    pub fn command(&self) -> Command {
        match self {
            Self::SystemKeys(_) => Command::SystemKeys,
            Self::Receipt(command, _) => *command,
            Self::Time(_) => Command::Ping,
            Self::Relayed(_) => Command::Relay,
            Self::Erasures(_) => Command::Erase,
            Self::Feed(_) => Command::Feed,
            Self::Records(_) => Command::Records,
            Self::Refused(_) | Self::Recalled(_) => Command::Refuse,
        }
    }

    /// Bytes from the chain.
    pub fn relayed_length(&self) -> usize {
        if let Self::Relayed(relayed) = self { relayed.length() } else { 0 }
    }

    pub fn encode(&self) -> Vec<u8> {
        match self {
            Self::SystemKeys(list) => list.clone(),
            Self::Receipt(_, receipt) => receipt.encode(),
            Self::Time(time) => time.encoded(),
            Self::Relayed(relayed) => relayed.encode(),
            Self::Erasures(outcomes) => list(outcomes, MOST_ERASURES),
            Self::Feed(page) => page.encode(),
            Self::Records(found) => list(found, MOST_DIGESTS),
            Self::Refused(code) => code.encoded(),
            Self::Recalled(at) => (Code::Recalled, *at).encoded(),
        }
    }

    pub fn parse(command: Command, body: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(body);
        let answer = match command {
            Command::SystemKeys if body.len() <= LONGEST_LIST => {
                Self::SystemKeys(reader.take(body.len(), "list")?.to_vec())
            }
            Command::SystemKeys => return Err(WireError::Value("list")),
            Command::KeyAllocation
            | Command::Upload
            | Command::UploadMany
            | Command::GrantNotice
            | Command::RevokeNotice
            | Command::DeviceNotice => Self::Receipt(command, Receipt::read(&mut reader)?),
            Command::Erase => {
                Self::Erasures(read_list::<u16, _>(&mut reader, 0..=MOST_ERASURES, ("outcome count", "outcome"))?)
            }
            Command::Feed => Self::Feed(Box::new(FeedPage::read(&mut reader)?)),
            Command::Records => {
                Self::Records(read_list::<u16, _>(&mut reader, 0..=MOST_DIGESTS, ("record count", "what was found"))?)
            }
            Command::Ping => Self::Time(Timestamp::read(&mut reader, "time")?),
            Command::Relay => Self::Relayed(Relayed::read(&mut reader)?),
            Command::Refuse => match Code::read(&mut reader, "code")? {
                Code::Recalled => Self::Recalled(Timestamp::read(&mut reader, "time")?),
                code => Self::Refused(code),
            },
        };
        reader.end()?;
        Ok(answer)
    }
}
