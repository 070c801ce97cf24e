//! The gateway's answers, by Command.

use crate::model::wire::{Reader, WireError};
use crate::model::{Hash, PublicKey, Signature, Timestamp};

use super::query::{Entry, Page};
use super::relay::Relayed;
use super::{Command, ErasedRecord, ErasureOutcome};
use crate::error::Code;
use crate::gateway::receipt::Receipt;
use crate::gateway::standings::SignedStandings;

/// The longest proof, bytes.
pub const LONGEST_PROOF: usize = 64 * 1024;
/// The longest system-key list, bytes.
const LONGEST_LIST: usize = 1024;
/// What was fetched: a record,
const WHOLE: u8 = 0;
/// or what is left of one.
const ERASED: u8 = 1;

/// A record's standing at the gateway.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Standing {
    /// Not here, or not for this reader.
    Unknown = 0,
    /// On the gateway's disk.
    Acknowledged = 1,
    /// Its anchor is on the chain but not confirmed yet.
    Anchored = 2,
    /// Anchor confirmed, bytes and signature checked.
    Verified = 3,
    /// Its bytes differ from those anchored.
    Tampered = 4,
    /// Quarantined: its publisher was not the pinned one.
    Quarantined = 5,
}

impl Standing {
    const ALL: [Self; 6] =
        [Self::Unknown, Self::Acknowledged, Self::Anchored, Self::Verified, Self::Tampered, Self::Quarantined];

    /// The byte on the wire.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// From the byte on the wire.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|standing| standing.code() == code)
    }
}

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
        let length = usize::try_from(reader.u32("proof length")?).unwrap_or(usize::MAX);
        if length > LONGEST_PROOF {
            return Err(WireError::Value("proof length"));
        }
        let proof = reader.take(length, "proof")?.to_vec();
        let blob = reader.take(reader.rest().len(), "record")?.to_vec();
        Ok(Self { signer, signature, proof, blob })
    }
}

/// A gateway's message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answer {
    /// The list, as its gateway encoded it.
    SystemKeys(Vec<u8>),
    /// A receipt: for an allocation (SM3(CT)), for uploads (their digests), for a notice (SM3(body)).
    Receipt(Command, Receipt),
    /// The transaction of a registration (32).
    Registered(Hash),
    /// A page.
    Page(Page),
    /// The standings of the digests in the request, in order.
    Standings(Box<SignedStandings>),
    /// A record: 0 || record.
    Record(Box<Fetched>),
    /// What is left of a record that its owner had erased: 1 || record, whose blob is header and statement.
    Erased(Box<ErasedRecord>),
    /// The subscription, or its end, is confirmed.
    Done(Command),
    /// The gateway's time (8).
    Time(Timestamp),
    /// The chain's answer.
    Relayed(Relayed),
    /// What becomes of each erasure in the request, in order: count (2), a byte each.
    Erasures(Vec<ErasureOutcome>),
    /// A record of a subscription: entry || record.
    Event(Box<(Entry, Fetched)>),
    /// A subscription has ended: code (2).
    End(Code),
    /// A refusal: code (2).
    Refused(Code),
}

impl Answer {
    /// Its Command.
    pub fn command(&self) -> Command {
        match self {
            Self::SystemKeys(_) => Command::SystemKeys,
            Self::Receipt(command, _) | Self::Done(command) => *command,
            Self::Registered(_) => Command::Register,
            Self::Page(_) => Command::Query,
            Self::Standings(_) => Command::Check,
            Self::Record(_) | Self::Erased(_) => Command::Fetch,
            Self::Time(_) => Command::Ping,
            Self::Relayed(_) => Command::Relay,
            Self::Erasures(_) => Command::Erase,
            Self::Event(_) => Command::Event,
            Self::End(_) => Command::End,
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
            Self::Registered(transaction) => transaction.0.to_vec(),
            Self::Page(page) => page.encode(),
            Self::Standings(signed) => signed.encode(),
            Self::Record(record) => [vec![WHOLE], record.encode()].concat(),
            Self::Erased(erased) => [vec![ERASED], erased.clone().into_fetched().encode()].concat(),
            Self::Done(_) => Vec::new(),
            Self::Time(time) => time.0.to_be_bytes().to_vec(),
            Self::Relayed(relayed) => relayed.encode(),
            Self::Erasures(outcomes) => ErasureOutcome::encode_all(outcomes),
            Self::Event(event) => [event.0.encode(), event.1.encode()].concat(),
            Self::End(code) | Self::Refused(code) => code.number().to_be_bytes().to_vec(),
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
            Command::Register => Self::Registered(Hash(reader.array("transaction")?)),
            Command::Query => Self::Page(Page::read(&mut reader)?),
            Command::Check => Self::Standings(Box::new(SignedStandings::read(&mut reader)?)),
            Command::Fetch => read_fetched(&mut reader)?,
            Command::Subscribe | Command::Unsubscribe => Self::Done(command),
            Command::Erase => Self::Erasures(ErasureOutcome::read_all(&mut reader)?),
            Command::Ping => Self::Time(Timestamp(reader.u64("time")?)),
            Command::Relay => Self::Relayed(Relayed::read(&mut reader)?),
            Command::Event => Self::Event(Box::new((Entry::read(&mut reader)?, Fetched::read(&mut reader)?))),
            Command::End => Self::End(read_code(&mut reader)?),
            Command::Refuse => Self::Refused(read_code(&mut reader)?),
        };
        reader.end()?;
        Ok(answer)
    }
}

fn read_fetched(reader: &mut Reader<'_>) -> Result<Answer, WireError> {
    let (what, record) = (reader.u8("what was fetched")?, Fetched::read(reader)?);
    match what {
        WHOLE => Ok(Answer::Record(Box::new(record))),
        ERASED => Ok(Answer::Erased(Box::new(ErasedRecord::from_fetched(record)?))),
        _ => Err(WireError::Value("what was fetched")),
    }
}

pub(crate) fn read_code(reader: &mut Reader<'_>) -> Result<Code, WireError> {
    Code::from_number(reader.u16("code")?).ok_or(WireError::Value("code"))
}
