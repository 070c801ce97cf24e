//! Key allocation (the paper's Initialization): the client seals K_T, P_C, P_E and Addr to a system key; d_C and the
//! EOA sign one transcript. Body: system key id (32) || length of CT (2) || CT || SM2 signature (64) || EOA signature
//! (65).

use zeroize::Zeroizing;

use crate::crypto::{
    AccountSignature, CryptoError, EoaSecret, Provider, SmKeyPair, SmSecret, TransportKey, TypedStructure,
    recover_account, sign_hash,
};
use crate::model::wire::{Reader, WireError, put_text};
use crate::model::{Address, Digest, Domain, ProfileName, PublicKey, Signature, SignerId};

use super::command::Command;
use super::error::{Code, Refusal, Result};
use super::hello::{Agreed, Context, padded, read_padded};
use super::system_keys::SystemKey;

/// Bytes; ours has 213 bytes of plaintext.
const LONGEST_CT: usize = 512;
/// The account signs this EIP-712 type.
const TYPE: &str = "KeyAllocation(bytes32 gateway,bytes32 systemKey,bytes32 clientNonce,bytes32 gatewayNonce,\
                    uint8 command,string name,bytes signingKey,address account,bytes32 ciphertext)";

#[derive(Debug)]
pub struct Applicant<'a> {
    pub name: &'a ProfileName,
    pub signing: &'a SmKeyPair,
    pub envelope: PublicKey,
    pub account: &'a EoaSecret,
}

/// Sealed to the system key: name length (1) name (32) K_T (32) P_C (64) P_E (64) Addr (20).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Allocation {
    pub name: ProfileName,
    pub key: TransportKey,
    pub signing: PublicKey,
    pub envelope: PublicKey,
    pub account: Address,
}

impl Allocation {
    fn encode(&self) -> Zeroizing<Vec<u8>> {
        let (name, mut out) = (padded(&self.name), Zeroizing::new(Vec::with_capacity(213)));
        for part in [&name[..], self.key.expose(), &self.signing.0, &self.envelope.0, &self.account.0] {
            out.extend_from_slice(part);
        }
        out
    }

    fn parse(plain: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(plain);
        let allocation = Self {
            name: read_padded(&mut reader)?,
            key: TransportKey::new(reader.array("transport key")?),
            signing: PublicKey(reader.array("signing key")?),
            envelope: PublicKey(reader.array("envelope key")?),
            account: Address(reader.array("account")?),
        };
        reader.end()?;
        Ok(allocation)
    }
}

/// Signed by both keys.
struct Transcript<'a> {
    domain: &'a Domain,
    agreed: &'a Agreed,
    system_key: &'a SignerId,
    allocation: &'a Allocation,
    ciphertext: Digest,
}

impl Transcript<'_> {
    /// label || domain || gateway || system key || client nonce || gateway nonce || Command || N || P_C || Addr ||
    /// SM3(CT); N behind its length.
    fn signed_bytes(&self) -> Vec<u8> {
        let mut out = [
            &b"AuthROS/allocation/1"[..],
            &self.domain.0,
            &self.agreed.gateway.0,
            &self.system_key.0,
            &self.agreed.client_nonce,
            &self.agreed.gateway_nonce,
            &[Command::KeyAllocation.number()],
        ]
        .concat();
        put_text(&mut out, self.allocation.name.as_str());
        out.extend_from_slice(&self.allocation.signing.0);
        out.extend_from_slice(&self.allocation.account.0);
        out.extend_from_slice(&self.ciphertext.0);
        out
    }

    fn account_hash(&self) -> [u8; 32] {
        TypedStructure::new(TYPE)
            .word(&self.agreed.gateway.0)
            .word(&self.system_key.0)
            .word(&self.agreed.client_nonce)
            .word(&self.agreed.gateway_nonce)
            .number(u64::from(Command::KeyAllocation.number()))
            .bytes(self.allocation.name.as_str().as_bytes())
            .bytes(&self.allocation.signing.0)
            .address(&self.allocation.account)
            .word(&self.ciphertext.0)
            .signing_hash(self.domain)
    }
}

/// Makes K_T and the command's body.
pub fn apply(
    context: &Context,
    agreed: &Agreed,
    system_key: &SystemKey,
    applicant: &Applicant<'_>,
) -> Result<(TransportKey, Vec<u8>), CryptoError> {
    let (name, key, signing) = (applicant.name.clone(), TransportKey::generate()?, applicant.signing.public);
    let (envelope, account) = (applicant.envelope, applicant.account.address());
    let allocation = Allocation { name, key, signing, envelope, account };
    let ciphertext = context.provider.encrypt(&system_key.public, &allocation.encode())?;
    let id = system_key.id();
    let digest = Digest(context.provider.sm3(&[&ciphertext]));
    let transcript =
        Transcript { domain: &context.domain, agreed, system_key: &id, allocation: &allocation, ciphertext: digest };
    let signature = context.provider.sign(&applicant.signing.secret, &transcript.signed_bytes())?;
    let account_signature = sign_hash(applicant.account, &transcript.account_hash())?;
    let request = AllocationRequest { system_key: id, ciphertext, signature, account_signature };
    Ok((allocation.key, request.encode()))
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AllocationRequest {
    pub system_key: SignerId,
    pub ciphertext: Vec<u8>,
    pub signature: Signature,
    /// By the EOA.
    pub account_signature: AccountSignature,
}

impl AllocationRequest {
    pub fn encode(&self) -> Vec<u8> {
        let length = u16::try_from(self.ciphertext.len()).unwrap_or(u16::MAX).to_be_bytes();
        let parts: [&[u8]; 5] =
            [&self.system_key.0, &length, &self.ciphertext, &self.signature.0, &self.account_signature.0];
        parts.concat()
    }

    pub fn parse(body: &[u8]) -> Result<Self, WireError> {
        let mut reader = Reader::new(body);
        let system_key = SignerId(reader.array("system key")?);
        let length = usize::from(reader.u16("ciphertext")?);
        if length > LONGEST_CT {
            return Err(WireError::Value("ciphertext"));
        }
        let request = Self {
            system_key,
            ciphertext: reader.take(length, "ciphertext")?.to_vec(),
            signature: Signature(reader.array("signature")?),
            account_signature: AccountSignature(reader.array("account signature")?),
        };
        reader.end()?;
        Ok(request)
    }

    /// SM3(CT), which the receipt names.
    pub fn digest(&self, provider: &dyn Provider) -> Digest {
        Digest(provider.sm3(&[&self.ciphertext]))
    }
}

/// The gateway's checks without the chain: CT, N, the SM2 signature, the account's. `secret`: d_S of the request's
/// system key; `None` if not in use.
pub fn examine(
    context: &Context,
    agreed: &Agreed,
    name: &ProfileName,
    request: &AllocationRequest,
    secret: Option<&SmSecret>,
) -> Result<Allocation> {
    let secret = secret.ok_or_else(|| Refusal::new(Code::SystemKey, format_args!("key {}", request.system_key)))?;
    let provider = context.provider;
    // One code both for a CT that does not open and for a text that does not parse: no decryption oracle.
    let plain = provider.decrypt(secret, &request.ciphertext).map_err(Refusal::because(Code::Malformed))?;
    let allocation = Allocation::parse(&plain).map_err(Refusal::because(Code::Malformed))?;
    if allocation.name != *name {
        return Err(Refusal::new(Code::Malformed, "the allocation names a different profile than the hello"));
    }
    let (domain, system_key, ciphertext) = (&context.domain, &request.system_key, request.digest(provider));
    let transcript = Transcript { domain, agreed, system_key, allocation: &allocation, ciphertext };
    provider
        .verify(&allocation.signing, &transcript.signed_bytes(), &request.signature)
        .map_err(Refusal::because(Code::Signature))?;
    let account = recover_account(&transcript.account_hash(), &request.account_signature)
        .map_err(Refusal::because(Code::Account))?;
    if account != allocation.account {
        return Err(Refusal::new(Code::Account, format_args!("signed by {account}")));
    }
    Ok(allocation)
}

#[cfg(test)]
mod tests;
