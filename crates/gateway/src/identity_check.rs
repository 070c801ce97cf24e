//! A command's identity check before anything changes: token, signature, account.

use crate::crypto::record::Checked;
use crate::crypto::{Anchor, SmSecret, Unchecked, check_many};
use crate::model::{Digest, Header, ProfileName, PublicKey, RecordKind};

use super::allocation::{Allocation, AllocationRequest, examine};
use super::command::{Notice, Request, Upload, signed_bytes};
use super::desk::{Account, Binding, Caller, Desk, Received};
use super::error::{Code, Refusal, Result};
use super::frame::Message;
use super::hello::{Agreed, Context};

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
