//! Key allocation (the paper's Initialization): the client seals K_T, P_C, P_E and Addr to a system key; d_C and the
//! EOA sign one transcript. Body: system key id (32) || length of CT (2) || CT || SM2 signature (64) || EOA signature
//! (65).

use zeroize::Zeroizing;

use crate::command::{Command, Notice, Request, Upload, signed_bytes};
use crate::crypto::{
    AccountSignature, Anchor, CryptoError, EoaSecret, Provider, SmKeyPair, SmSecret, TransportKey, TypedStructure,
    Unchecked, check_many, recover_account, sign_hash,
};
use crate::desk::{Account, Binding, Caller, Desk, Received};
use crate::error::{Code, Refusal, Result};
use crate::hello::{Agreed, Context, padded, read_padded};
use crate::model::wire::{Reader, WireError, put_text};
use crate::model::{Address, Digest, Domain, Header, ProfileName, PublicKey, RecordKind, Signature, SignerId};
use crate::{crypto::record::Checked, frame::Message, system_keys::SystemKey};

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

// A command's identity check before anything changes: token, signature, account.

/// More records or bytes are checked off the network threads.
const AT_ONCE: (usize, usize) = (8, 256 * 1024);

/// A registered, unsuspended account with the session's keys, or a device on loan. Refuses with `NotRegistered`,
/// `NotAuthorised` or the desk's code.
pub async fn check_account(desk: &dyn Desk, binding: &Binding) -> Result<()> {
    let device = binding.device.as_ref().map(|device| &device.id);
    let account = desk.account(&binding.account, device).await?;
    // A device is valid as long as its loan, whatever keys its owner has by now.
    if device.is_some() { Ok(()) } else { same_keys(&account, &binding.signing, &binding.envelope) }
}

/// A device may store records, ask what became of them, and read notices to it. Single records are up to the desk.
pub fn check_reach(caller: &Caller, request: &Request) -> Result<()> {
    let Some(device) = &caller.device else { return Ok(()) };
    let may = match request {
        // The desk decides whether devices of this owner signed them.
        Request::Feed(feed) => {
            let own = !feed.recorders.is_empty() && feed.places.iter().all(|place| place.owner == caller.account);
            own || device.asks_for_notices(&caller.account, feed)
        }
        // Only the owner erases.
        Request::Notice(Notice::Grant(_) | Notice::Revoke(_)) | Request::Relay(_) | Request::Erase(_) => false,
        Request::SystemKeys
        | Request::KeyAllocation(_)
        | Request::Upload(_)
        | Request::UploadMany(_)
        | Request::Notice(Notice::Device(_))
        | Request::Ping
        | Request::Records(..) => true,
    };
    if may {
        return Ok(());
    }
    let text = format_args!("device {} asks for something reserved to its owner ({:?})", device.id, request.command());
    Err(Refusal::new(Code::NotAuthorised, text))
}

fn same_keys(account: &Account, signing: &PublicKey, envelope: &PublicKey) -> Result<()> {
    if (&account.signing, &account.envelope) == (signing, envelope) {
        return Ok(());
    }
    Err(Refusal::new(Code::NotRegistered, "the chain has different keys for this account"))
}

/// d_C must have signed this very frame.
pub fn check_signed<C>(context: &Context, agreed: &Agreed, caller: &Caller, message: &Message<C>) -> Result<()> {
    let signature = message.signature.ok_or_else(|| Refusal::new(Code::Signature, "no signature"))?;
    let body = Digest(context.provider.sm3(&[&message.body]));
    let signed =
        signed_bytes(&context.domain, &agreed.gateway, &agreed.session, message.counter, message.command, &body);
    context.provider.verify(&caller.signing, &signed, &signature).map_err(Refusal::because(Code::Signature))
}

/// Records must be of this network, the caller's, and signed by the owner or a lent device; in a device's session, by
/// that device. `Malformed`, `NotYours`, `Signature` or the desk's code for one bad record refuses all.
pub async fn check_records(
    context: Context,
    desk: &dyn Desk,
    caller: &Caller,
    uploads: Vec<Upload>,
) -> Result<Vec<Received>> {
    let mut signers: Vec<PublicKey> = Vec::with_capacity(uploads.len());
    let mut last: Option<(Header, PublicKey)> = None;
    for upload in &uploads {
        let (header, _) = Header::parse(&upload.blob)?;
        if header.domain != context.domain || header.owner != caller.account {
            return Err(Refusal::new(Code::NotYours, format_args!("a record of {}", header.owner)));
        }
        let signer = match &last {
            Some((before, key)) if before.signer == header.signer => *key,
            _ => desk
                .signer(&caller.account, &header.signer)
                .await?
                .ok_or_else(|| Refusal::new(Code::Signature, format_args!("signer {} may not sign", header.signer)))?,
        };
        signers.push(signer);
        last = Some((header, signer));
    }
    let bytes: usize = uploads.iter().map(|upload| upload.blob.len()).sum();
    let few = uploads.len() <= AT_ONCE.0 && bytes <= AT_ONCE.1;
    let verify = move || verify_all(context, uploads, &signers);
    let received = match few {
        true => verify()?,
        false => tokio::task::spawn_blocking(verify).await.map_err(Refusal::internal)??,
    };
    check_own(caller, &received)?;
    Ok(received)
}

/// A device's session adds only to the device's own numbers, and no notices: those are its owner's.
fn check_own(caller: &Caller, received: &[Received]) -> Result<()> {
    let Some(device) = &caller.device else { return Ok(()) };
    let is_own = |header: &Header| header.signer == device.id && header.kind != RecordKind::Key;
    match received.iter().find(|record| !is_own(&record.header)) {
        Some(other) => {
            let (id, kind, signer) = (device.id, other.header.kind.word(), other.header.signer);
            Err(Refusal::new(Code::NotYours, format_args!("device {id} sends a {kind} record that {signer} signed")))
        }
        None => Ok(()),
    }
}

/// Checks each record by the key beside it, in one go.
pub fn verify_all(context: Context, uploads: Vec<Upload>, signers: &[PublicKey]) -> Result<Vec<Received>> {
    let mut records = Vec::with_capacity(uploads.len());
    for (upload, signer) in uploads.iter().zip(signers) {
        let Upload { blob, signature, .. } = upload;
        records.push(Unchecked { blob, signature, signer, anchor: Anchor::Unanchored });
    }
    let checked = check_many(context.provider, &records);
    let one = |((upload, signer), checked): ((Upload, &PublicKey), Checked)| {
        let (header, digest, _) = checked.map_err(Refusal::because(Code::Signature))?;
        Ok(Received { header, digest, signature: upload.signature, signer: *signer, blob: upload.blob })
    };
    uploads.into_iter().zip(signers).zip(checked).map(one).collect()
}

/// Checks both signatures, the chain's registration and the name's owner, then binds the name. The caller must prevent
/// other bindings meanwhile.
pub async fn allocate(
    context: &Context,
    desk: &dyn Desk,
    agreed: &Agreed,
    name: &ProfileName,
    request: &AllocationRequest,
    secret: Option<&SmSecret>,
) -> Result<Digest> {
    let allocation = examine(context, agreed, name, request, secret)?;
    let account = desk.account(&allocation.account, None).await?;
    same_keys(&account, &allocation.signing, &allocation.envelope)?;
    desk.admits(&allocation.account, None).await?;
    let bound = desk.binding(name).await?;
    if let Some(bound) = &bound
        && bound.account != allocation.account
        && desk.recalled(bound).await?.is_none()
        && desk.successor(&bound.account).await? != Some(allocation.account)
    {
        return Err(Refusal::new(Code::NameBound, format_args!("{name} belongs to {}", bound.account)));
    }
    let Allocation { account, key, signing, envelope, .. } = allocation;
    let before = bound.map(|bound| bound.account);
    desk.bind(name, before, Binding { account, key, signing, envelope, device: None }).await?;
    Ok(request.digest(context.provider))
}

#[cfg(test)]
mod tests;
