//! The client's requests, by Command; every count and length is bounded.

use crate::crypto::SealedRecord;
use crate::model::layout;
use crate::model::wire::{Reader, Wire, WireError, read_list};
use crate::model::{Address, Digest, Hash, PublicKey, Signature, Token, TopicId};

use super::relay::RelayCall;
use super::{Command, ErasureNotice, encode_erasures, list, read_erasures};
use crate::feed::Feed;
use crate::gateway::allocation::AllocationRequest;

pub const MOST_UPLOADS: usize = 1024;
pub const MOST_DIGESTS: usize = 1024;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Upload {
    /// The record's own (r, s).
    pub signature: Signature,
    /// CT1: header, sealed head, sealed body.
    pub blob: Vec<u8>,
}

impl From<&SealedRecord> for Upload {
    fn from(record: &SealedRecord) -> Self {
        Self { signature: record.signature, blob: record.blob.clone() }
    }
}

/// On its way to the chain: grantee (20) || epoch (8) || expiry (8) || transaction (32).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GrantNotice {
    pub grantee: Address,
    pub epoch: u64,
    /// Seconds since the Unix epoch; 0 for never.
    pub expiry: u64,
    pub transaction: Hash,
}

/// On its way to the chain: grantee (20) || new epoch (8) || new token (32) || transaction (32).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RevokeNotice {
    pub grantee: Address,
    /// The epoch that begins.
    pub epoch: u64,
    pub token: Token,
    pub transaction: Hash,
}

/// Gives the session's name to a lent device: its P (64) || the topic id of notices to it (16).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeviceNotice {
    pub key: PublicKey,
    pub notices: TopicId,
}

/// From an owner, signed by d_C.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Notice {
    Grant(GrantNotice),
    Revoke(RevokeNotice),
    Device(DeviceNotice),
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    SystemKeys,
    KeyAllocation(AllocationRequest),
    /// signature (64) || blob.
    Upload(Upload),
    /// count (2), then length of the blob (4) || signature (64) || blob each.
    UploadMany(Vec<Upload>),
    Notice(Notice),
    Ping,
    Relay(RelayCall),
    /// count (2), then length (4) and erasure each.
    Erase(Vec<ErasureNotice>),
    Feed(Feed),
    /// 1 with bytes, 0 for presence (1) || count (2), then 32 bytes each.
    Records(bool, Vec<Digest>),
}

impl Request {
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

    /// Cuts lists that are too long; their makers bound them.
    pub fn encode(&self) -> Vec<u8> {
        match self {
            Self::SystemKeys | Self::Ping => Vec::new(),
            Self::KeyAllocation(request) => request.encode(),
            Self::Upload(upload) => [&upload.signature.0[..], &upload.blob].concat(),
            Self::UploadMany(uploads) => list(uploads, MOST_UPLOADS),
            Self::Notice(Notice::Grant(notice)) => notice.encoded(),
            Self::Notice(Notice::Revoke(notice)) => notice.encoded(),
            Self::Notice(Notice::Device(notice)) => notice.encoded(),
            Self::Relay(call) => call.encode(),
            Self::Erase(erasures) => encode_erasures(erasures),
            Self::Feed(feed) => feed.encode(),
            Self::Records(bytes, digests) => [bytes.encoded(), list(digests, MOST_DIGESTS)].concat(),
        }
    }

    /// Refuses commands that no client may send.
    pub fn parse(command: Command, body: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(body);
        let request = match command {
            Command::SystemKeys => Self::SystemKeys,
            Command::KeyAllocation => return AllocationRequest::parse(body).map(Self::KeyAllocation),
            Command::Upload => Self::Upload(Upload {
                signature: Signature(reader.array("signature")?),
                blob: reader.take(reader.rest().len(), "record")?.to_vec(),
            }),
            Command::UploadMany => {
                Self::UploadMany(read_list::<u16, _>(&mut reader, 1..=MOST_UPLOADS, ("record count", "record"))?)
            }
            Command::GrantNotice => Self::Notice(Notice::Grant(Wire::read(&mut reader, "notice")?)),
            Command::RevokeNotice => Self::Notice(Notice::Revoke(Wire::read(&mut reader, "notice")?)),
            Command::DeviceNotice => Self::Notice(Notice::Device(Wire::read(&mut reader, "notice")?)),
            Command::Ping => Self::Ping,
            Command::Relay => Self::Relay(RelayCall::read(&mut reader)?),
            Command::Erase => Self::Erase(read_erasures(&mut reader)?),
            Command::Feed => Self::Feed(Feed::read(&mut reader)?),
            Command::Records => {
                let bytes = bool::read(&mut reader, "bytes")?;
                let digests = read_list::<u16, _>(&mut reader, 1..=MOST_DIGESTS, ("digest count", "digest"))?;
                Self::Records(bytes, digests)
            }
            Command::Refuse => return Err(WireError::Value("command")),
        };
        reader.end()?;
        Ok(request)
    }
}

layout!(GrantNotice { grantee: "grantee", epoch: "epoch", expiry: "expiry", transaction: "transaction" });
layout!(RevokeNotice { grantee: "grantee", epoch: "epoch", token: "token", transaction: "transaction" });
layout!(DeviceNotice { key: "device key", notices: "topic id" });

/// Length of the blob (4) || signature || blob.
impl Wire for Upload {
    fn put(&self, out: &mut Vec<u8>) {
        (u32::try_from(self.blob.len()).unwrap_or(u32::MAX), self.signature).put(out);
        out.extend_from_slice(&self.blob);
    }

    fn read(reader: &mut Reader<'_>, field: &'static str) -> Result<Self, WireError> {
        let length = usize::try_from(reader.u32("record length")?).map_err(|_| WireError::Value("record length"))?;
        let signature = Signature::read(reader, "signature")?;
        Ok(Self { signature, blob: reader.take(length, field)?.to_vec() })
    }
}
