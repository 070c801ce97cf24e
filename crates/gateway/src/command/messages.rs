//! The client's requests, by Command; every count and length is bounded.

use crate::command::{
    Command, ErasedRecord, ErasureNotice, ErasureOutcome, MOST_ERASURES, encode_erasures, list, read_erasures,
};
use crate::error::{Code, Refusal, Result};
use crate::feed::{Feed, FeedPage, read_proof};
use crate::model::wire::{Reader, Wire, WireError, put_text, read_list};
use crate::model::{Address, Digest, Hash, PublicKey, Signature, Timestamp, Token, TopicId, layout};
use crate::{allocation::AllocationRequest, crypto::SealedRecord, model::relay::RelayError, receipt::Receipt};

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

// The gateway's answers, by Command.

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

// A forwarded request to the chain, and the outcome. JSON stays text, so that each message has one encoding.

/// Bytes of JSON: a raw transaction of 32 KiB in hex, and a little more.
pub const LONGEST_PARAMETERS: usize = 72 * 1024;
/// Bytes of JSON.
pub const LONGEST_RESULT: usize = 32 * 1024 * 1024;
/// Bytes of JSON: more than any block's logs.
pub const LONGEST_FOR_VISITOR: usize = 8 * 1024 * 1024;
const LONGEST_METHOD: usize = 64;
const LONGEST_WORDS: usize = 2 * 1024;
/// Bytes of JSON.
const LONGEST_DATA: usize = 64 * 1024;
const RESULT: u8 = 0;
const FAULT: u8 = 1;

/// length of the method (1) || method || parameters, a JSON array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RelayCall {
    pub method: String,
    pub parameters: String,
}

impl RelayCall {
    pub(super) fn encode(&self) -> Vec<u8> {
        let method = self.method.as_bytes();
        let method = &method[..method.len().min(LONGEST_METHOD)];
        [&[u8::try_from(method.len()).unwrap_or(0)], method, self.parameters.as_bytes()].concat()
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        let length = usize::from(reader.u8("method")?);
        if !(1..=LONGEST_METHOD).contains(&length) {
            return Err(WireError::Value("method"));
        }
        let method = text(reader.take(length, "method")?, "method")?;
        if !method.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_') {
            return Err(WireError::Value("method"));
        }
        let parameters = rest(reader, LONGEST_PARAMETERS, "parameters")?;
        if parameters.is_empty() { Err(WireError::Value("parameters")) } else { Ok(Self { method, parameters }) }
    }
}

/// 0 (1) || result, or 1 (1) || code (8) || length of the words (2) || words || data.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Relayed {
    /// JSON.
    Result(String),
    Fault {
        code: i64,
        /// Cleaned.
        words: String,
        /// JSON; empty for none.
        data: String,
    },
}

impl Relayed {
    /// A result longer than `most` bytes becomes an error that asks for less. Refuses with `Method` a method that is
    /// not forwarded, with `Stale` a silent chain.
    pub fn of(outcome: Result<serde_json::Value, RelayError>, most: usize) -> Result<Self> {
        match outcome {
            Ok(result) => {
                let text = result.to_string();
                if text.len() > most {
                    let words = format!("the answer is longer than {most} bytes; request less");
                    return Ok(Self::Fault { code: -32005, words, data: String::new() });
                }
                Ok(Self::Result(text))
            }
            Err(RelayError::Answered { code, mut message, data }) => {
                message.truncate(message.floor_char_boundary(LONGEST_WORDS));
                let data = data.map(|data| data.to_string()).filter(|data| data.len() <= LONGEST_DATA);
                Ok(Self::Fault { code, words: message, data: data.unwrap_or_default() })
            }
            Err(error @ RelayError::NotAllowed) => Err(Refusal::new(Code::Method, error)),
            Err(RelayError::Silent(reason)) => Err(Refusal::new(Code::Stale, reason)),
        }
    }

    /// Approximate, in bytes.
    pub(super) fn length(&self) -> usize {
        match self {
            Self::Result(result) => result.len(),
            Self::Fault { words, data, .. } => words.len() + data.len(),
        }
    }

    pub(super) fn encode(&self) -> Vec<u8> {
        match self {
            Self::Result(result) => [&[RESULT], result.as_bytes()].concat(),
            Self::Fault { code, words, data } => {
                let mut out = vec![FAULT];
                out.extend_from_slice(&code.to_be_bytes());
                put_text(&mut out, words);
                out.extend_from_slice(data.as_bytes());
                out
            }
        }
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Result<Self, WireError> {
        match reader.u8("outcome")? {
            RESULT => {
                let result = rest(reader, LONGEST_RESULT, "result")?;
                if result.is_empty() { Err(WireError::Value("result")) } else { Ok(Self::Result(result)) }
            }
            FAULT => {
                let code = i64::from_be_bytes(reader.array("fault")?);
                let words = reader.text("fault")?;
                if words.len() > LONGEST_WORDS {
                    return Err(WireError::Value("fault"));
                }
                Ok(Self::Fault { code, words, data: rest(reader, LONGEST_DATA, "fault")? })
            }
            _ => Err(WireError::Value("outcome")),
        }
    }
}

fn text(bytes: &[u8], field: &'static str) -> Result<String, WireError> {
    String::from_utf8(bytes.to_vec()).map_err(|_| WireError::Value(field))
}

fn rest(reader: &mut Reader<'_>, most: usize, field: &'static str) -> Result<String, WireError> {
    let length = reader.rest().len();
    if length > most {
        return Err(WireError::Value(field));
    }
    text(reader.take(length, field)?, field)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde_json::json;

    proptest! {
        #[test]
        fn calls_and_answers_come_back_as_they_went(
            method in "[a-zA-Z0-9_]{1,64}", parameters in ".{1,300}", code: i64, words in ".{0,400}", data in ".{0,300}"
        ) {
            let call = RelayCall { method, parameters: parameters.clone() };
            let bytes = call.encode();
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(RelayCall::read(&mut reader), Ok(call));
            for relayed in [Relayed::Result(parameters), Relayed::Fault { code, words, data }] {
                let bytes = relayed.encode();
                prop_assert_eq!(Relayed::read(&mut Reader::new(&bytes)), Ok(relayed));
            }
        }

        #[test]
        fn garbage_never_panics_and_has_one_encoding(noise in proptest::collection::vec(any::<u8>(), 0..200)) {
            if let Ok(call) = RelayCall::read(&mut Reader::new(&noise)) {
                prop_assert_eq!(call.encode(), noise.clone());
            }
            if let Ok(relayed) = Relayed::read(&mut Reader::new(&noise)) {
                prop_assert_eq!(relayed.encode(), noise);
            }
        }
    }

    #[test]
    fn every_length_is_bounded() {
        let call = |method: &str, parameters: usize| {
            let method = [&[u8::try_from(method.len()).expect("short")], method.as_bytes()].concat();
            RelayCall::read(&mut Reader::new(&[method, vec![b'['; parameters]].concat()))
        };
        assert!(call("eth_call", 1).is_ok() && call("eth_call", LONGEST_PARAMETERS).is_ok());
        for (method, parameters) in [("", 1), ("eth_call", 0), ("eth_call", LONGEST_PARAMETERS + 1), ("eth call", 1)] {
            assert!(call(method, parameters).is_err(), "{method} {parameters}");
        }
        assert!(call(&"x".repeat(65), 1).is_err());
        assert!(Relayed::read(&mut Reader::new(&[RESULT])).is_err());
        assert!(Relayed::read(&mut Reader::new(&[2, b'1'])).is_err());
    }

    #[test]
    fn what_a_node_says_is_passed_on_and_the_rest_is_a_code() {
        let of = |outcome| Relayed::of(outcome, LONGEST_RESULT);
        let Ok(Relayed::Fault { code: -32005, .. }) = Relayed::of(Ok(json!("four")), 5) else { panic!("too long") };
        assert_eq!(of(Ok(json!({"a": 1}))), Ok(Relayed::Result("{\"a\":1}".into())));
        let reverted = RelayError::Answered { code: 3, message: "reverted".into(), data: Some(json!("0x08")) };
        let fault = Relayed::Fault { code: 3, words: "reverted".into(), data: "\"0x08\"".into() };
        assert_eq!(of(Err(reverted)), Ok(fault));
        assert_eq!(of(Err(RelayError::NotAllowed)).expect_err("refused").code, Code::Method);
        assert_eq!(of(Err(RelayError::Silent("x".into()))).expect_err("refused").code, Code::Stale);
        let long = RelayError::Answered { code: 3, message: "ä".repeat(3000), data: None };
        let Ok(Relayed::Fault { words, .. }) = of(Err(long)) else { panic!("a fault") };
        assert!(words.len() <= LONGEST_WORDS && words.ends_with('ä'));
    }
}
