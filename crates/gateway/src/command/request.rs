//! The client's requests, by Command: encoded and decoded, every count and length bounded.

use crate::crypto::SealedRecord;
use crate::model::wire::{Reader, WireError};
use crate::model::{Address, Digest, Hash, PublicKey, Signature, Token, TopicId};

use super::relay::RelayCall;
use super::{Command, ErasureNotice, encode_erasures, read_erasures};
use crate::feed::Feed;
use crate::gateway::allocation::AllocationRequest;

/// The most records in one message.
pub const MOST_UPLOADS: usize = 1024;
/// The most records asked for at once.
pub const MOST_DIGESTS: usize = 1024;

/// A record as uploaded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Upload {
    /// (r, s): the record's own signature.
    pub signature: Signature,
    /// CT1: header, sealed head, sealed body.
    pub blob: Vec<u8>,
}

impl From<&SealedRecord> for Upload {
    fn from(record: &SealedRecord) -> Self {
        Self { signature: record.signature, blob: record.blob.clone() }
    }
}

/// A grant being sent to the chain: grantee (20) || epoch (8) || expiry (8) || transaction (32).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GrantNotice {
    /// The grantee.
    pub grantee: Address,
    /// The epoch granted.
    pub epoch: u64,
    /// Its expiry, seconds since the Unix epoch; 0 for never.
    pub expiry: u64,
    /// The transaction.
    pub transaction: Hash,
}

/// A revoke being sent to the chain: grantee (20) || new epoch (8) || new token (32) || transaction (32).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RevokeNotice {
    /// The grantee.
    pub grantee: Address,
    /// The epoch that begins.
    pub epoch: u64,
    /// Its token.
    pub token: Token,
    /// The transaction.
    pub transaction: Hash,
}

/// The device that the session's name belongs to from now on: P of a lent device (64) || the topic id of its notices (16).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeviceNotice {
    /// Its public key.
    pub key: PublicKey,
    /// Where its owner's notices to it are filed.
    pub notices: TopicId,
}

impl DeviceNotice {
    fn encode(&self) -> Vec<u8> {
        [&self.key.0[..], &self.notices.0].concat()
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        Ok(Self { key: PublicKey(reader.array("device key")?), notices: TopicId(reader.array("topic id")?) })
    }
}

/// What an owner tells her gateway, signed by d_C.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Notice {
    /// She shares.
    Grant(GrantNotice),
    /// She shares no longer.
    Revoke(RevokeNotice),
    /// This session's name belongs to a lent device.
    Device(DeviceNotice),
}

/// A client's message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    /// The list of system keys.
    SystemKeys,
    /// Key allocation.
    KeyAllocation(AllocationRequest),
    /// One record: signature (64) || blob.
    Upload(Upload),
    /// Several: count (2), then length of the blob (4) || signature (64) || blob each.
    UploadMany(Vec<Upload>),
    /// What its owner tells.
    Notice(Notice),
    /// Nothing.
    Ping,
    /// A request to the chain.
    Relay(RelayCall),
    /// Records that the session's owner had erased: count (2), then length (4) and erasure each.
    Erase(Vec<ErasureNotice>),
    /// What to tell next.
    Feed(Feed),
    /// Records: 1 with their bytes or 0 whether they are there (1) || count (2), then 32 bytes each.
    Records(bool, Vec<Digest>),
}

impl Request {
    /// Its Command.
    pub fn command(&self) -> Command {
        match self {
            Self::SystemKeys => Command::SystemKeys,
            Self::KeyAllocation(_) => Command::KeyAllocation,
            Self::Upload(_) => Command::Upload,
            Self::UploadMany(_) => Command::UploadMany,
            Self::Notice(Notice::Grant(_)) => Command::GrantNotice,
            Self::Notice(Notice::Revoke(_)) => Command::RevokeNotice,
            Self::Notice(Notice::Device(_)) => Command::DeviceNotice,
            Self::Ping => Command::Ping,
            Self::Relay(_) => Command::Relay,
            Self::Erase(_) => Command::Erase,
            Self::Feed(_) => Command::Feed,
            Self::Records(..) => Command::Records,
        }
    }

    /// The body. Lists that are too long are cut; their makers bound them.
    pub fn encode(&self) -> Vec<u8> {
        match self {
            Self::SystemKeys | Self::Ping => Vec::new(),
            Self::KeyAllocation(request) => request.encode(),
            Self::Upload(upload) => [&upload.signature.0[..], &upload.blob].concat(),
            Self::UploadMany(uploads) => encode_uploads(uploads),
            Self::Notice(Notice::Grant(notice)) => notice.encode(),
            Self::Notice(Notice::Revoke(notice)) => notice.encode(),
            Self::Notice(Notice::Device(notice)) => notice.encode(),
            Self::Relay(call) => call.encode(),
            Self::Erase(erasures) => encode_erasures(erasures),
            Self::Feed(feed) => feed.encode(),
            Self::Records(bytes, digests) => [vec![u8::from(*bytes)], encode_digests(digests)].concat(),
        }
    }

    /// From a Command and its body.
    ///
    /// # Errors
    /// [`WireError`] if the body does not match the Command, or a client may not send the Command.
    pub fn parse(command: Command, body: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(body);
        let request = match command {
            Command::SystemKeys => Self::SystemKeys,
            Command::KeyAllocation => return AllocationRequest::parse(body).map(Self::KeyAllocation),
            Command::Upload => Self::Upload(Upload {
                signature: Signature(reader.array("signature")?),
                blob: reader.take(reader.rest().len(), "record")?.to_vec(),
            }),
            Command::UploadMany => Self::UploadMany(read_uploads(&mut reader)?),
            Command::GrantNotice => Self::Notice(Notice::Grant(GrantNotice::read(&mut reader)?)),
            Command::RevokeNotice => Self::Notice(Notice::Revoke(RevokeNotice::read(&mut reader)?)),
            Command::DeviceNotice => Self::Notice(Notice::Device(DeviceNotice::read(&mut reader)?)),
            Command::Ping => Self::Ping,
            Command::Relay => Self::Relay(RelayCall::read(&mut reader)?),
            Command::Erase => Self::Erase(read_erasures(&mut reader)?),
            Command::Feed => Self::Feed(Feed::read(&mut reader)?),
            Command::Records => {
                let bytes = match reader.u8("bytes")? {
                    0 => false,
                    1 => true,
                    _ => return Err(WireError::Value("bytes")),
                };
                Self::Records(bytes, read_digests(&mut reader)?)
            }
            Command::Refuse => return Err(WireError::Value("command")),
        };
        reader.end()?;
        Ok(request)
    }
}

impl GrantNotice {
    fn encode(&self) -> Vec<u8> {
        let parts: [&[u8]; 4] =
            [&self.grantee.0, &self.epoch.to_be_bytes(), &self.expiry.to_be_bytes(), &self.transaction.0];
        parts.concat()
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        Ok(Self {
            grantee: Address(reader.array("grantee")?),
            epoch: reader.u64("epoch")?,
            expiry: reader.u64("expiry")?,
            transaction: Hash(reader.array("transaction")?),
        })
    }
}

impl RevokeNotice {
    fn encode(&self) -> Vec<u8> {
        let parts: [&[u8]; 4] = [&self.grantee.0, &self.epoch.to_be_bytes(), &self.token.0, &self.transaction.0];
        parts.concat()
    }

    fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        Ok(Self {
            grantee: Address(reader.array("grantee")?),
            epoch: reader.u64("epoch")?,
            token: Token(reader.array("token")?),
            transaction: Hash(reader.array("transaction")?),
        })
    }
}

fn count(length: usize, most: usize) -> [u8; 2] {
    u16::try_from(length.min(most)).unwrap_or(u16::MAX).to_be_bytes()
}

fn read_count(reader: &mut Reader<'_>, most: usize, field: &'static str) -> Result<usize, WireError> {
    let count = usize::from(reader.u16(field)?);
    if (1..=most).contains(&count) { Ok(count) } else { Err(WireError::Value(field)) }
}

fn encode_uploads(uploads: &[Upload]) -> Vec<u8> {
    let mut out = count(uploads.len(), MOST_UPLOADS).to_vec();
    for upload in uploads.iter().take(MOST_UPLOADS) {
        out.extend_from_slice(&u32::try_from(upload.blob.len()).unwrap_or(u32::MAX).to_be_bytes());
        out.extend_from_slice(&upload.signature.0);
        out.extend_from_slice(&upload.blob);
    }
    out
}

fn read_uploads(reader: &mut Reader<'_>) -> Result<Vec<Upload>, WireError> {
    let count = read_count(reader, MOST_UPLOADS, "record count")?;
    let mut uploads = Vec::new();
    for _ in 0..count {
        let length = usize::try_from(reader.u32("record length")?).map_err(|_| WireError::Value("record length"))?;
        let signature = Signature(reader.array("signature")?);
        uploads.push(Upload { signature, blob: reader.take(length, "record")?.to_vec() });
    }
    Ok(uploads)
}

fn encode_digests(digests: &[Digest]) -> Vec<u8> {
    let mut out = count(digests.len(), MOST_DIGESTS).to_vec();
    digests.iter().take(MOST_DIGESTS).for_each(|digest| out.extend_from_slice(&digest.0));
    out
}

fn read_digests(reader: &mut Reader<'_>) -> Result<Vec<Digest>, WireError> {
    let count = read_count(reader, MOST_DIGESTS, "digest count")?;
    (0..count).map(|_| reader.array("digest").map(Digest)).collect()
}
