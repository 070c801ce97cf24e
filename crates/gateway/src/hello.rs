//! The hello: both sides agree on fresh keys, the gateway signs the transcript, the client names itself. Pure state
//! machines; PROTOCOL.md has every byte. Nothing here is kept once the session's keys exist.

use zeroize::Zeroizing;

use crate::crypto::kdf::{Info, derived};
use crate::crypto::{Ephemeral, Provider, SmKeyPair, TransportKey, random_bytes, signer_id};
use crate::model::wire::WireError;
use crate::model::{Digest, Domain, ProfileName, PublicKey, Signature, SignerId};

use super::code::{Code, Refusal};
use super::error::GatewayError;
use super::session::{Session, SessionId, SessionKeys, Side};

mod messages;

pub use messages::{Answer, Hello, ListSummary, NetworkName};

/// The version of the protocol.
pub const VERSION: u8 = 1;
/// The suite SM4-GCM, SM3, SM2, HKDF-SM3.
pub const SUITE_SM: u8 = 1;

/// A peer's network and crypto provider.
#[derive(Clone, Copy)]
pub struct Context {
    /// Computes SM2, SM3 and SM4.
    pub provider: &'static dyn Provider,
    /// The network.
    pub domain: Domain,
}

/// The purpose of the session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Purpose {
    /// Key allocation: there is no transport key yet.
    Allocation = 0,
    /// Everything else, under a transport key.
    Transfer = 1,
}

/// What both sides know after the hello.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Agreed {
    /// SM3 of the gateway's identity key.
    pub gateway: SignerId,
    /// The gateway's identity key: verifies its lists and receipts.
    pub gateway_key: PublicKey,
    /// The client's nonce.
    pub client_nonce: [u8; 32],
    /// The gateway's nonce.
    pub gateway_nonce: [u8; 32],
    /// The session's id.
    pub session: SessionId,
    /// The gateway's current system-key list.
    pub list: ListSummary,
}

/// SM3 over label, domain and both messages, the answer without its signature.
fn transcript(context: &Context, hello: &Hello, answer: &Answer) -> Digest {
    let parts: [&[u8]; 4] = [b"AuthROS/transcript/1", &context.domain.0, &hello.encode(), &answer.unsigned()];
    Digest(context.provider.sm3(&parts))
}

/// The bytes that the gateway's identity key signs.
fn signed_bytes(domain: &Domain, transcript: &Digest) -> Vec<u8> {
    [&b"AuthROS/hello/1"[..], &domain.0, &transcript.0].concat()
}

/// The shared secret and the transcript so far.
struct Shared {
    context: Context,
    secret: Zeroizing<[u8; 32]>,
    transcript: Digest,
    agreed: Agreed,
}

impl Shared {
    /// Key and iv that seal N.
    fn identify_key(&self) -> Zeroizing<[u8; 28]> {
        Zeroizing::new(derived(&*self.secret, &self.transcript.0, &Info::new("AuthROS/identify/1")))
    }

    fn identify_aad(&self) -> Vec<u8> {
        [&b"AuthROS/identify/1"[..], &self.agreed.session.0].concat()
    }

    /// The session, its keys bound to the whole transcript, including N.
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

/// The client before the gateway's answer.
pub struct ClientHello {
    context: Context,
    hello: Hello,
    ephemeral: Ephemeral,
}

impl ClientHello {
    /// With fresh nonce and ephemeral key.
    ///
    /// # Errors
    /// [`GatewayError::Crypto`] if the random source fails.
    pub fn begin(context: Context) -> Result<Self, GatewayError> {
        let ephemeral = Ephemeral::generate(context.provider)?;
        Ok(Self::with(context, random_bytes()?, ephemeral))
    }

    /// With values drawn elsewhere; only test vectors need this.
    pub(super) fn with(context: Context, nonce: [u8; 32], ephemeral: Ephemeral) -> Self {
        let hello = Hello { domain: context.domain, nonce, point: ephemeral.public() };
        Self { context, hello, ephemeral }
    }

    /// The payload of the hello frame.
    pub fn encode(&self) -> Vec<u8> {
        self.hello.encode()
    }

    /// Processes the gateway's answer: its signature, its point. Whether it is the intended gateway is for the caller
    /// to judge by [`Agreed::gateway`] before naming itself.
    ///
    /// # Errors
    /// [`GatewayError::Malformed`], or [`GatewayError::Crypto`] if signature or point is not valid.
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

/// The client once keys are agreed, before it names itself.
pub struct ClientAgreed(Shared);

impl ClientAgreed {
    /// The terms agreed.
    pub fn agreed(&self) -> &Agreed {
        &self.0.agreed
    }

    /// The steps of the key agreement, for test vectors.
    #[cfg(test)]
    pub(super) fn steps(&self) -> Vec<(&'static str, Vec<u8>)> {
        vec![
            ("shared secret", self.0.secret.to_vec()),
            ("transcript digest", self.0.transcript.0.to_vec()),
            ("identify key and nonce", self.0.identify_key().to_vec()),
        ]
    }

    /// The payload of the identify frame, and the session. A session for transfer needs the transport key.
    ///
    /// # Errors
    /// [`GatewayError::Crypto`] if sealing fails.
    pub fn identify(self, name: &ProfileName, key: Option<&TransportKey>) -> Result<(Vec<u8>, Session), GatewayError> {
        let purpose = if key.is_some() { Purpose::Transfer } else { Purpose::Allocation };
        let mut sealed = messages::encode_name(purpose, name);
        let (cipher_key, nonce) = halves(&self.0.identify_key());
        self.0.context.provider.gcm_seal(&cipher_key, &nonce, &self.0.identify_aad(), &mut sealed)?;
        let session = self.0.session(Side::Client, &sealed, key);
        Ok((sealed, session))
    }
}

/// The gateway after its answer.
pub struct GatewayHello(Shared);

impl GatewayHello {
    /// Answers a hello: the payload to send, and the next state.
    ///
    /// # Errors
    /// [`Refusal`] with `Malformed`, `Version`, `Network` or `Internal`.
    pub fn answer(
        context: Context,
        identity: &SmKeyPair,
        list: ListSummary,
        payload: &[u8],
    ) -> Result<(Vec<u8>, Self), Refusal> {
        let internal = Refusal::because(Code::Internal);
        let ephemeral = Ephemeral::generate(context.provider).map_err(&internal)?;
        let nonces = (random_bytes().map_err(&internal)?, SessionId(random_bytes().map_err(&internal)?));
        Self::answer_with(context, identity, list, payload, nonces, ephemeral)
    }

    /// With values drawn elsewhere; only test vectors need this.
    pub(super) fn answer_with(
        context: Context,
        identity: &SmKeyPair,
        list: ListSummary,
        payload: &[u8],
        (nonce, session): ([u8; 32], SessionId),
        ephemeral: Ephemeral,
    ) -> Result<(Vec<u8>, Self), Refusal> {
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
        answer.signature =
            context.provider.sign(&identity.secret, &signed).map_err(Refusal::because(Code::Internal))?;
        let secret = ephemeral.agree(&hello.point).map_err(Refusal::because(Code::Malformed))?;
        let agreed = answer.agreed(hello.nonce);
        Ok((answer.encode(), Self(Shared { context, secret, transcript, agreed })))
    }

    /// The terms agreed.
    pub fn agreed(&self) -> &Agreed {
        &self.0.agreed
    }

    /// Opens the identify frame.
    ///
    /// # Errors
    /// [`Refusal`] with `Tag` or `Malformed`.
    pub fn identified(self, payload: &[u8]) -> Result<Identified, Refusal> {
        let (key, nonce) = halves(&self.0.identify_key());
        let opened = self.0.context.provider.gcm_open(&key, &nonce, &self.0.identify_aad(), payload);
        let plain = opened.map_err(Refusal::because(Code::Tag))?;
        let (purpose, name) = messages::parse_name(&plain).map_err(Refusal::because(Code::Malformed))?;
        Ok(Identified { shared: self.0, identify: payload.to_vec(), purpose, name })
    }
}

/// The gateway once the client has named itself; the client's first frame proves it.
pub struct Identified {
    shared: Shared,
    identify: Vec<u8>,
    purpose: Purpose,
    name: ProfileName,
}

impl Identified {
    /// The name the client gave.
    pub fn name(&self) -> &ProfileName {
        &self.name
    }

    /// The purpose of the session.
    pub fn purpose(&self) -> Purpose {
        self.purpose
    }

    /// The terms agreed.
    pub fn agreed(&self) -> Agreed {
        self.shared.agreed
    }

    /// The session. For an unbound name pass a random key: the first frame then fails as it does for a wrong key, so
    /// names cannot be probed.
    pub fn session(self, key: Option<&TransportKey>) -> Session {
        self.shared.session(Side::Gateway, &self.identify, key)
    }
}

fn halves(bytes: &[u8; 28]) -> (Zeroizing<[u8; 16]>, [u8; 12]) {
    (Zeroizing::new(std::array::from_fn(|index| bytes[index])), std::array::from_fn(|index| bytes[16 + index]))
}

/// SM3 of an identity key: the fingerprint that is pinned, registered and compared.
pub fn gateway_id(key: &PublicKey) -> SignerId {
    signer_id(key)
}

impl From<WireError> for Refusal {
    fn from(error: WireError) -> Self {
        Self::new(Code::Malformed, error)
    }
}

#[cfg(test)]
mod tests;
