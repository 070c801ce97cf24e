//! The three messages of the hello, byte by byte.

use zeroize::Zeroizing;

use crate::crypto::domain;
use crate::model::wire::{Reader, WireError};
use crate::model::{Address, Digest, Domain, Hash, ProfileName, PublicKey, Signature};

use super::{Agreed, Purpose, SUITE_SM, VERSION, gateway_id};
use crate::gateway::code::{Code, Refusal};
use crate::gateway::session::SessionId;

/// The longest name, bytes; shorter ones are padded, so that the frame's length reveals nothing.
const NAME: usize = 32;

/// A gateway's network: version (1) chain id (8) genesis hash (32) contract (20). Sent in clear to anyone who sends the
/// version (1); a wrong answer leads to a hello that the gateway does not sign.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NetworkName {
    /// The EIP-155 chain id.
    pub chain_id: u64,
    /// Hash of block 0.
    pub genesis: Hash,
    /// The contract.
    pub contract: Address,
}

impl NetworkName {
    /// The request for it.
    pub const INQUIRY: [u8; 1] = [VERSION];

    /// The domain derived from it.
    pub fn domain(&self) -> Domain {
        domain(self.chain_id, &self.genesis, &self.contract)
    }

    /// The payload of the frame, 61 bytes.
    pub fn encode(&self) -> Vec<u8> {
        [&[VERSION], &self.chain_id.to_be_bytes()[..], &self.genesis.0, &self.contract.0].concat()
    }

    /// From the payload of a frame.
    ///
    /// # Errors
    /// [`WireError`] if it is not of this version.
    pub fn parse(payload: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(payload);
        if reader.u8("version")? != VERSION {
            return Err(WireError::Value("version"));
        }
        let network = Self {
            chain_id: reader.u64("chain id")?,
            genesis: Hash(reader.array("genesis")?),
            contract: Address(reader.array("contract")?),
        };
        reader.end()?;
        Ok(network)
    }
}

/// The client's first message: version (1) suite (1) domain (32) nonce (32) point (64).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hello {
    /// The network.
    pub domain: Domain,
    /// Random.
    pub nonce: [u8; 32],
    /// The client's ephemeral point.
    pub point: PublicKey,
}

impl Hello {
    /// The payload of the frame, 130 bytes.
    pub fn encode(&self) -> Vec<u8> {
        [&[VERSION, SUITE_SM][..], &self.domain.0, &self.nonce, &self.point.0].concat()
    }

    /// From the payload of a frame; the point is not checked yet.
    ///
    /// # Errors
    /// [`Refusal`] with `Version` or `Malformed`.
    pub fn parse(payload: &[u8]) -> Result<Self, Refusal> {
        let mut reader = Reader::new(payload);
        let (version, suite) = (reader.u8("version")?, reader.u8("suite")?);
        if (version, suite) != (VERSION, SUITE_SM) {
            return Err(Refusal::new(Code::Version, format_args!("version {version}, suite {suite}")));
        }
        let hello = Self {
            domain: Domain(reader.array("domain")?),
            nonce: reader.array("nonce")?,
            point: PublicKey(reader.array("point")?),
        };
        reader.end()?;
        Ok(hello)
    }
}

/// A gateway's current system-key list: a client never accepts an older one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ListSummary {
    /// Its version.
    pub version: u64,
    /// SM3 of its encoding.
    pub digest: Digest,
}

/// The gateway's answer: version (1) suite (1) nonce (32) point (64) session (16) list version (8)
/// list digest (32) identity key (64) signature (64).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Answer {
    /// Random.
    pub nonce: [u8; 32],
    /// The gateway's ephemeral point.
    pub point: PublicKey,
    /// Random; the session's id.
    pub session: SessionId,
    /// The current system-key list.
    pub list: ListSummary,
    /// The gateway's identity key.
    pub identity: PublicKey,
    /// Signature by the identity key over the transcript.
    pub signature: Signature,
}

impl Answer {
    /// The payload without the signature, 218 bytes: the gateway's part of the transcript.
    pub fn unsigned(&self) -> Vec<u8> {
        let version = self.list.version.to_be_bytes();
        let parts: [&[u8]; 7] = [
            &[VERSION, SUITE_SM],
            &self.nonce,
            &self.point.0,
            &self.session.0,
            &version,
            &self.list.digest.0,
            &self.identity.0,
        ];
        parts.concat()
    }

    /// The payload of the frame, 282 bytes.
    pub fn encode(&self) -> Vec<u8> {
        [&self.unsigned()[..], &self.signature.0].concat()
    }

    /// From the payload of a frame; neither point nor signature is checked yet.
    ///
    /// # Errors
    /// [`WireError`] if it is not an answer of this version.
    pub fn parse(payload: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(payload);
        if reader.array("version")? != [VERSION, SUITE_SM] {
            return Err(WireError::Value("version"));
        }
        let answer = Self {
            nonce: reader.array("nonce")?,
            point: PublicKey(reader.array("point")?),
            session: SessionId(reader.array("session")?),
            list: ListSummary { version: reader.u64("list version")?, digest: Digest(reader.array("list digest")?) },
            identity: PublicKey(reader.array("identity key")?),
            signature: Signature(reader.array("signature")?),
        };
        reader.end()?;
        Ok(answer)
    }

    pub(super) fn agreed(&self, client_nonce: [u8; 32]) -> Agreed {
        Agreed {
            gateway: gateway_id(&self.identity),
            gateway_key: self.identity,
            client_nonce,
            gateway_nonce: self.nonce,
            session: self.session,
            list: self.list,
        }
    }
}

/// Purpose (1) length of the name (1) name, padded with zeros to 32.
pub(super) fn encode_name(purpose: Purpose, name: &ProfileName) -> Vec<u8> {
    let bytes = name.as_str().as_bytes();
    // A profile name has at most 32 bytes.
    let bytes = &bytes[..bytes.len().min(NAME)];
    let mut out = vec![0; 2 + NAME];
    out[0] = purpose as u8;
    out[1] = u8::try_from(bytes.len()).unwrap_or(0);
    out[2..2 + bytes.len()].copy_from_slice(bytes);
    out
}

pub(super) fn parse_name(plain: &Zeroizing<Vec<u8>>) -> Result<(Purpose, ProfileName), WireError> {
    let mut reader = Reader::new(plain);
    let purpose = match reader.u8("purpose")? {
        0 => Purpose::Allocation,
        1 => Purpose::Transfer,
        _ => return Err(WireError::Value("purpose")),
    };
    let length = usize::from(reader.u8("name")?);
    let field = reader.take(NAME, "name")?;
    reader.end()?;
    let (name, padding) = field.split_at_checked(length).ok_or(WireError::Value("name"))?;
    if padding.iter().any(|byte| *byte != 0) {
        return Err(WireError::Value("name"));
    }
    let name = std::str::from_utf8(name).ok().and_then(|name| name.parse().ok()).ok_or(WireError::Value("name"))?;
    Ok((purpose, name))
}
