//! The gateway's answers, by Command.

use crate::model::wire::{Reader, WireError};
use crate::model::{PublicKey, Signature, Timestamp};

use super::relay::Relayed;
use super::request::MOST_DIGESTS;
use super::{Command, ErasedRecord, ErasureOutcome};
use crate::error::Code;
use crate::feed::{FeedPage, read_proof};
use crate::gateway::receipt::Receipt;

/// The longest proof, bytes.
pub const LONGEST_PROOF: usize = 64 * 1024;
/// The longest system-key list, bytes.
const LONGEST_LIST: usize = 1024;
/// A record as sent to a reader: signer key (64) || signature (64) || proof length (4) || proof || blob.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fetched {
    /// The signer's key; the reader compares it with the chain.
    pub signer: PublicKey,
    /// (r, s).
    pub signature: Signature,
    /// Proof of the anchor, as written by the chain crate; empty until there is one.
    pub proof: Vec<u8>,
    /// CT1.
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

/// What a gateway has of a record that was asked for: 0 || code (2); 1; 2 || length (4) || record; or 3 || length (4) || record, whose
/// blob is header and statement.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Found {
    /// Nothing for this caller.
    Missing(Code),
    /// It is there; its bytes were not asked for.
    Here,
    /// The record.
    Held(Fetched),
    /// What is left of one that its owner had erased.
    Erased(ErasedRecord),
}

impl Found {
    fn encode(&self, out: &mut Vec<u8>) {
        let record = match self {
            Self::Missing(code) => {
                out.push(0);
                return out.extend_from_slice(&code.number().to_be_bytes());
            }
            Self::Here => return out.push(1),
            Self::Held(record) => {
                out.push(2);
                record.encode()
            }
            Self::Erased(erased) => {
                out.push(3);
                erased.clone().into_fetched().encode()
            }
        };
        out.extend_from_slice(&u32::try_from(record.len()).unwrap_or(u32::MAX).to_be_bytes());
        out.extend_from_slice(&record);
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let tag = reader.u8("what was found")?;
        match tag {
            0 => return Ok(Self::Missing(read_code(reader)?)),
            1 => return Ok(Self::Here),
            2 | 3 => {}
            _ => return Err(WireError::Value("what was found")),
        }
        let length = usize::try_from(reader.u32("record length")?).unwrap_or(usize::MAX);
        let mut one = Reader::new(reader.take(length, "record")?);
        let record = Fetched::read(&mut one)?;
        if tag == 2 { Ok(Self::Held(record)) } else { ErasedRecord::from_fetched(record).map(Self::Erased) }
    }

    fn encode_all(all: &[Self]) -> Vec<u8> {
        let all = &all[..all.len().min(MOST_DIGESTS)];
        let mut out = u16::try_from(all.len()).unwrap_or(0).to_be_bytes().to_vec();
        all.iter().for_each(|found| found.encode(&mut out));
        out
    }

    fn read_all(reader: &mut Reader<'_>) -> Result<Vec<Self>, WireError> {
        let count = usize::from(reader.u16("record count")?);
        if count > MOST_DIGESTS {
            return Err(WireError::Value("record count"));
        }
        (0..count).map(|_| Self::read(reader)).collect()
    }
}

/// A gateway's message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answer {
    /// The list, as its gateway encoded it.
    SystemKeys(Vec<u8>),
    /// A receipt: for an allocation (SM3(CT)), for uploads (their digests), for a notice (SM3(body)).
    Receipt(Command, Receipt),
    /// The gateway's time (8).
    Time(Timestamp),
    /// The chain's answer.
    Relayed(Relayed),
    /// What becomes of each erasure in the request, in order: count (2), a byte each.
    Erasures(Vec<ErasureOutcome>),
    /// A page of the feed.
    Feed(Box<FeedPage>),
    /// What there is of the first of the records asked for: count (2), then each; at least one.
    Records(Vec<Found>),
    /// A refusal: code (2).
    Refused(Code),
}

impl Answer {
    /// Its Command.
    pub fn command(&self) -> Command {
        match self {
            Self::SystemKeys(_) => Command::SystemKeys,
            Self::Receipt(command, _) => *command,
            Self::Time(_) => Command::Ping,
            Self::Relayed(_) => Command::Relay,
            Self::Erasures(_) => Command::Erase,
            Self::Feed(_) => Command::Feed,
            Self::Records(_) => Command::Records,
            Self::Refused(_) => Command::Refuse,
        }
    }

    /// Length of its part from the chain, bytes; 0 if it has none.
    pub fn relayed_length(&self) -> usize {
        if let Self::Relayed(relayed) = self { relayed.length() } else { 0 }
    }

    /// The body.
    pub fn encode(&self) -> Vec<u8> {
        match self {
            Self::SystemKeys(list) => list.clone(),
            Self::Receipt(_, receipt) => receipt.encode(),
            Self::Time(time) => time.0.to_be_bytes().to_vec(),
            Self::Relayed(relayed) => relayed.encode(),
            Self::Erasures(outcomes) => ErasureOutcome::encode_all(outcomes),
            Self::Feed(page) => page.encode(),
            Self::Records(found) => Found::encode_all(found),
            Self::Refused(code) => code.number().to_be_bytes().to_vec(),
        }
    }

    /// From a Command and its body.
    ///
    /// # Errors
    /// [`WireError`] if the body does not match the Command.
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
            Command::Erase => Self::Erasures(ErasureOutcome::read_all(&mut reader)?),
            Command::Feed => Self::Feed(Box::new(FeedPage::read(&mut reader)?)),
            Command::Records => Self::Records(Found::read_all(&mut reader)?),
            Command::Ping => Self::Time(Timestamp(reader.u64("time")?)),
            Command::Relay => Self::Relayed(Relayed::read(&mut reader)?),
            Command::Refuse => Self::Refused(read_code(&mut reader)?),
        };
        reader.end()?;
        Ok(answer)
    }
}

pub(crate) fn read_code(reader: &mut Reader<'_>) -> Result<Code, WireError> {
    Code::from_number(reader.u16("code")?).ok_or(WireError::Value("code"))
}
