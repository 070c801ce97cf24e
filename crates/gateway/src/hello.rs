//! The hello (every byte is in PROTOCOL.md): fresh keys, a transcript signed by the gateway, the client's name.

use zeroize::Zeroizing;

use crate::crypto::kdf::{Info, key_and_nonce};
use crate::crypto::{Ephemeral, Provider, SmKeyPair, TransportKey, domain, random_bytes, signer_id};
use crate::error::{Code, GatewayError, Refusal, Result};
use crate::model::wire::{Reader, Wire as _, WireError};
use crate::model::{Address, Digest, Domain, Hash, ProfileName, PublicKey, Signature, SignerId, layout};
use crate::session::{Session, SessionId, SessionKeys, Side};

pub const VERSION: u8 = 1;
/// SM4-GCM, SM3, SM2, HKDF-SM3.
pub const SUITE_SM: u8 = 1;

#[derive(Clone, Copy)]
pub struct Context {
    pub provider: &'static dyn Provider,
    pub domain: Domain,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Purpose {
    /// Without a transport key.
    Allocation = 0,
    /// Under a transport key.
    Transfer = 1,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Agreed {
    /// SM3 of the identity key.
    pub gateway: SignerId,
    /// The identity key: verifies lists and receipts.
    pub gateway_key: PublicKey,
    pub client_nonce: [u8; 32],
    pub gateway_nonce: [u8; 32],
    pub session: SessionId,
    pub list: ListSummary,
}

/// SM3 over label, domain and both messages, the answer without its signature.
fn transcript(context: &Context, hello: &Hello, answer: &Answer) -> Digest {
    let parts: [&[u8]; 4] = [b"AuthROS/transcript/1", &context.domain.0, &hello.encode(), &answer.unsigned()];
    Digest(context.provider.sm3(&parts))
}

/// Signed by the identity key.
fn signed_bytes(domain: &Domain, transcript: &Digest) -> Vec<u8> {
    [&b"AuthROS/hello/1"[..], &domain.0, &transcript.0].concat()
}

struct Shared {
    context: Context,
    secret: Zeroizing<[u8; 32]>,
    transcript: Digest,
    agreed: Agreed,
}

impl Shared {
    /// Key and iv that seal N.
    fn identify_key(&self) -> (Zeroizing<[u8; 16]>, [u8; 12]) {
        key_and_nonce(&*self.secret, &self.transcript.0, &Info::new("AuthROS/identify/1"))
    }

    fn identify_aad(&self) -> Vec<u8> {
        [&b"AuthROS/identify/1"[..], &self.agreed.session.0].concat()
    }

    /// Its keys are bound to the whole transcript, including N.
    fn session(self, side: Side, identify: &[u8], key: Option<&TransportKey>) -> Session {
        let parts: [&[u8]; 3] = [b"AuthROS/transcript/1", &self.transcript.0, identify];
        let salt = self.context.provider.sm3(&parts);
        let mut material = Zeroizing::new(Vec::with_capacity(64));
        material.extend_from_slice(&*self.secret);
        material.extend_from_slice(key.map_or(&[][..], |key| key.expose()));
        let keys = SessionKeys::derive(&material, &salt);
        Session::new(self.context.provider, self.agreed.session, side, keys)
    }
}

pub struct ClientHello {
    context: Context,
    hello: Hello,
    ephemeral: Ephemeral,
}

impl ClientHello {
    pub fn begin(context: Context) -> Result<Self, GatewayError> {
        let ephemeral = Ephemeral::generate(context.provider)?;
        Ok(Self::with(context, random_bytes()?, ephemeral))
    }

    /// For test vectors.
    pub(super) fn with(context: Context, nonce: [u8; 32], ephemeral: Ephemeral) -> Self {
        let hello = Hello { domain: context.domain, nonce, point: ephemeral.public() };
        Self { context, hello, ephemeral }
    }

    pub fn encode(&self) -> Vec<u8> {
        self.hello.encode()
    }

    /// Checks the answer. The caller must judge [`Agreed::gateway`] before it names itself.
    pub fn agree(self, payload: &[u8]) -> Result<ClientAgreed, GatewayError> {
        let answer = Answer::parse(payload).map_err(GatewayError::malformed("answer to the hello"))?;
        let transcript = transcript(&self.context, &self.hello, &answer);
        let signed = signed_bytes(&self.context.domain, &transcript);
        self.context.provider.verify(&answer.identity, &signed, &answer.signature)?;
        let secret = self.ephemeral.agree(&answer.point)?;
        let agreed = answer.agreed(self.hello.nonce);
        Ok(ClientAgreed(Shared { context: self.context, secret, transcript, agreed }))
    }
}

pub struct ClientAgreed(Shared);

impl ClientAgreed {
    pub fn agreed(&self) -> &Agreed {
        &self.0.agreed
    }

    /// The identify frame's payload, and the session; one for transfer needs the key.
    pub fn identify(self, name: &ProfileName, key: Option<&TransportKey>) -> Result<(Vec<u8>, Session), GatewayError> {
        let purpose = if key.is_some() { Purpose::Transfer } else { Purpose::Allocation };
        let mut sealed = encode_name(purpose, name);
        let (cipher_key, nonce) = self.0.identify_key();
        self.0.context.provider.gcm_seal(&cipher_key, &nonce, &self.0.identify_aad(), &mut sealed)?;
        let session = self.0.session(Side::Client, &sealed, key);
        Ok((sealed, session))
    }
}

pub struct GatewayHello(Shared);

impl GatewayHello {
    pub fn answer(
        context: Context,
        identity: &SmKeyPair,
        list: ListSummary,
        payload: &[u8],
    ) -> Result<(Vec<u8>, Self)> {
        let ephemeral = Ephemeral::generate(context.provider).map_err(Refusal::internal)?;
        let nonces =
            (random_bytes().map_err(Refusal::internal)?, SessionId(random_bytes().map_err(Refusal::internal)?));
        Self::answer_with(context, identity, list, payload, nonces, ephemeral)
    }

    /// For test vectors.
    pub(super) fn answer_with(
        context: Context,
        identity: &SmKeyPair,
        list: ListSummary,
        payload: &[u8],
        (nonce, session): ([u8; 32], SessionId),
        ephemeral: Ephemeral,
    ) -> Result<(Vec<u8>, Self)> {
        let hello = Hello::parse(payload)?;
        if hello.domain != context.domain {
            return Err(Refusal::new(Code::Network, format_args!("hello for domain {}", hello.domain)));
        }
        context.provider.check_public_key(&hello.point).map_err(Refusal::because(Code::Malformed))?;
        let point = ephemeral.public();
        let mut answer =
            Answer { nonce, point, session, list, identity: identity.public, signature: Signature([0; 64]) };
        let transcript = transcript(&context, &hello, &answer);
        let signed = signed_bytes(&context.domain, &transcript);
        answer.signature = context.provider.sign(&identity.secret, &signed).map_err(Refusal::internal)?;
        let secret = ephemeral.agree(&hello.point).map_err(Refusal::because(Code::Malformed))?;
        let agreed = answer.agreed(hello.nonce);
        Ok((answer.encode(), Self(Shared { context, secret, transcript, agreed })))
    }

    pub fn agreed(&self) -> &Agreed {
        &self.0.agreed
    }

    pub fn identified(self, payload: &[u8]) -> Result<Identified> {
        let (key, nonce) = self.0.identify_key();
        let opened = self.0.context.provider.gcm_open(&key, &nonce, &self.0.identify_aad(), payload);
        let plain = opened.map_err(Refusal::because(Code::Tag))?;
        let (purpose, name) = parse_name(&plain).map_err(Refusal::because(Code::Malformed))?;
        Ok(Identified { shared: self.0, identify: payload.to_vec(), purpose, name })
    }
}

/// The client's first frame must prove its name.
pub struct Identified {
    shared: Shared,
    identify: Vec<u8>,
    pub purpose: Purpose,
    pub name: ProfileName,
}

impl Identified {
    pub fn agreed(&self) -> Agreed {
        self.shared.agreed
    }

    /// Pass a random key for an unbound name: it fails like a wrong key, so names cannot be probed.
    pub fn session(self, key: Option<&TransportKey>) -> Session {
        self.shared.session(Side::Gateway, &self.identify, key)
    }
}

impl From<WireError> for Refusal {
    fn from(error: WireError) -> Self {
        Self::new(Code::Malformed, error)
    }
}

/// Shorter names are padded, so that the frame's length reveals nothing; bytes.
const NAME: usize = 32;

/// version (1) chain id (8) genesis hash (32) contract (20). In clear for anyone who sends the version (1); a wrong
/// answer leads to a hello that the gateway does not sign.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NetworkName {
    /// EIP-155.
    pub chain_id: u64,
    /// Block 0.
    pub genesis: Hash,
    pub contract: Address,
}

layout!(NetworkName { chain_id: "chain id", genesis: "genesis", contract: "contract" });

impl NetworkName {
    pub const INQUIRY: [u8; 1] = [VERSION];

    pub fn domain(&self) -> Domain {
        domain(self.chain_id, &self.genesis, &self.contract)
    }

    /// 61 bytes.
    pub fn encode(&self) -> Vec<u8> {
        self.behind(&[VERSION])
    }

    pub fn parse(payload: &[u8]) -> Result<Self, WireError> {
        Self::whole_behind(&[VERSION], "version", payload)
    }
}

/// version (1) suite (1) domain (32) nonce (32) point (64).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hello {
    pub domain: Domain,
    pub nonce: [u8; 32],
    pub point: PublicKey,
}

layout!(Hello { domain: "domain", nonce: "nonce", point: "point" });

impl Hello {
    /// 130 bytes.
    pub fn encode(&self) -> Vec<u8> {
        self.behind(&[VERSION, SUITE_SM])
    }

    /// Does not check the point.
    pub fn parse(payload: &[u8]) -> Result<Self> {
        let mut reader = Reader::new(payload);
        let (version, suite) = (reader.u8("version")?, reader.u8("suite")?);
        if (version, suite) != (VERSION, SUITE_SM) {
            return Err(Refusal::new(Code::Version, format_args!("version {version}, suite {suite}")));
        }
        Ok(Self::whole(reader.rest())?)
    }
}

/// Of system keys; a client never accepts an older list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ListSummary {
    pub version: u64,
    /// SM3 of its encoding.
    pub digest: Digest,
}

/// version (1) suite (1) nonce (32) point (64) session (16) list version (8) list digest (32) identity key (64)
/// signature (64).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Answer {
    pub nonce: [u8; 32],
    pub point: PublicKey,
    /// Random.
    pub session: SessionId,
    pub list: ListSummary,
    pub identity: PublicKey,
    /// By the identity key over the transcript.
    pub signature: Signature,
}

layout!(ListSummary { version: "list version", digest: "list digest" });
layout!(Answer {
    nonce: "nonce",
    point: "point",
    session: "session",
    list: "list",
    identity: "identity key",
    signature: "signature",
});

impl Answer {
    /// 218 bytes: the gateway's part of the transcript.
    pub fn unsigned(&self) -> Vec<u8> {
        let mut out = self.encode();
        out.truncate(out.len() - Signature::LENGTH);
        out
    }

    /// 282 bytes.
    pub fn encode(&self) -> Vec<u8> {
        self.behind(&[VERSION, SUITE_SM])
    }

    /// Checks neither point nor signature.
    pub fn parse(payload: &[u8]) -> Result<Self, WireError> {
        Self::whole_behind(&[VERSION, SUITE_SM], "version", payload)
    }

    fn agreed(&self, client_nonce: [u8; 32]) -> Agreed {
        let (gateway, gateway_key, gateway_nonce) = (signer_id(&self.identity), self.identity, self.nonce);
        Agreed { gateway, gateway_key, client_nonce, gateway_nonce, session: self.session, list: self.list }
    }
}

/// Purpose (1) length of the name (1) name, padded with zeros to 32.
fn encode_name(purpose: Purpose, name: &ProfileName) -> Vec<u8> {
    [&[purpose as u8][..], &padded(name)].concat()
}

/// Length of the name (1) name, padded with zeros to 32.
pub(super) fn padded(name: &ProfileName) -> [u8; 1 + NAME] {
    let bytes = name.as_str().as_bytes();
    let bytes = &bytes[..bytes.len().min(NAME)];
    let mut out = [0; 1 + NAME];
    out[0] = u8::try_from(bytes.len()).unwrap_or(0);
    out[1..=bytes.len()].copy_from_slice(bytes);
    out
}

pub(super) fn read_padded(reader: &mut Reader<'_>) -> Result<ProfileName, WireError> {
    let length = usize::from(reader.u8("name")?);
    let (name, padding) = reader.take(NAME, "name")?.split_at_checked(length).ok_or(WireError::Value("name"))?;
    if padding.iter().any(|byte| *byte != 0) {
        return Err(WireError::Value("name"));
    }
    std::str::from_utf8(name).ok().and_then(|name| name.parse().ok()).ok_or(WireError::Value("name"))
}

fn parse_name(plain: &Zeroizing<Vec<u8>>) -> Result<(Purpose, ProfileName), WireError> {
    let mut reader = Reader::new(plain);
    let purpose = match reader.u8("purpose")? {
        0 => Purpose::Allocation,
        1 => Purpose::Transfer,
        _ => return Err(WireError::Value("purpose")),
    };
    let name = read_padded(&mut reader)?;
    reader.end()?;
    Ok((purpose, name))
}

#[cfg(test)]
mod tests;
