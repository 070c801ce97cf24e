//! The port to what a gateway does with a command once its sender is known: the service implements it.
//! What reaches a desk has passed every check that frames, session and signatures allow.

use std::net::SocketAddr;

use async_trait::async_trait;
use serde_json::Value;
use tokio::sync::mpsc;

use crate::chain::RelayError;
use crate::crypto::{SealedRecord, TransportKey};
use crate::model::{
    Address, Digest, Hash, Header, ProfileName, PublicKey, RecordKind, Signature, SignerId, Timestamp, Token, TopicId,
};

use super::code::Refusal;
use super::command::{
    DeviceNotice, Entry, Fetched, GrantNotice, Page, Query, Registration, RevokeNotice, Selection, Standing,
};
use super::hello::NetworkName;
use super::standings::Stood;

/// What the chain says of an account.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Account {
    /// P_C as registered now, its proof checked.
    pub signing: PublicKey,
    /// P_E as registered now.
    pub envelope: PublicKey,
}

/// The device that a name belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoundDevice {
    /// SM3 of its public key.
    pub id: SignerId,
    /// Where its owner's notices to it are filed; `None` where the owner did not tell.
    pub notices: Option<TopicId>,
}

impl BoundDevice {
    /// Whether a selection is of nothing but `owner`'s notices to this device.
    pub fn hears(&self, owner: &Address, selection: &Selection) -> bool {
        let of_this = match (selection.topic_id, self.notices) {
            (Some(asked), Some(told)) => asked == told,
            (asked, None) => asked.is_some(),
            (None, Some(_)) => false,
        };
        of_this && selection.owner == *owner && selection.kind == Some(RecordKind::Key)
    }

    /// Whether a record is one of its owner's notices to this device.
    pub fn is_for(&self, kind: RecordKind, topic: TopicId) -> bool {
        kind == RecordKind::Key && self.notices.is_none_or(|told| told == topic)
    }
}

/// What a name stands for at this gateway.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Binding {
    /// Addr.
    pub account: Address,
    /// K_T.
    pub key: TransportKey,
    /// P_C when the key was allocated.
    pub signing: PublicKey,
    /// P_E when the key was allocated.
    pub envelope: PublicKey,
    /// Whose name it is, where it is a device's and not the account's own.
    pub device: Option<BoundDevice>,
}

/// Who asks: proven by K_T.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Caller {
    /// N.
    pub name: ProfileName,
    /// Addr.
    pub account: Address,
    /// P_C as registered when the session began.
    pub signing: PublicKey,
    /// The device that asks, where it is one: it reaches only what a device needs.
    pub device: Option<BoundDevice>,
    /// Where from.
    pub peer: SocketAddr,
}

/// A record whose header, network, owner and signature have been checked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Received {
    /// Its header.
    pub header: Header,
    /// D.
    pub digest: Digest,
    /// (r, s).
    pub signature: Signature,
    /// The key that verified it: the owner's or a lent one.
    pub signer: PublicKey,
    /// CT1.
    pub blob: Vec<u8>,
}

impl From<Received> for SealedRecord {
    fn from(received: Received) -> Self {
        let Received { header, digest, signature, blob, .. } = received;
        Self { header, blob, digest, signature }
    }
}

/// What a gateway does. Refusals go to the peer as their code.
#[async_trait]
pub trait Desk: Send + Sync + 'static {
    /// What the chain says of an account: `NotRegistered`, `Suspended` or `Stale` where it says no.
    async fn account(&self, account: &Address) -> Result<Account, Refusal>;

    /// Whether the account may use this gateway at this moment: `NotAuthorised` where its keeper did not admit it.
    async fn admits(&self, account: &Address) -> Result<(), Refusal>;

    /// Whether the account ever registered the token.
    async fn is_token(&self, account: &Address, token: &Token) -> Result<bool, Refusal>;

    /// Whether `owner` has lent this device, at this moment: `Stale` where the chain cannot tell.
    async fn is_lent(&self, owner: &Address, device: &SignerId) -> Result<bool, Refusal>;

    /// The public key of a signer id, where it is the owner's or lent by the owner now.
    async fn signer(&self, owner: &Address, signer: &SignerId) -> Result<Option<PublicKey>, Refusal>;

    /// What a name stands for; nothing where it was a device's that has been recalled.
    async fn binding(&self, name: &ProfileName) -> Result<Option<Binding>, Refusal>;

    /// Who continues for a lost account, as the administrator said on the chain.
    async fn successor(&self, lost: &Address) -> Result<Option<Address>, Refusal>;

    /// Binds a name, durably before it returns. Called one at a time, and only where the name is free, bound to the
    /// same account, or to one that this account continues for.
    async fn bind(&self, name: &ProfileName, binding: Binding) -> Result<(), Refusal>;

    /// Passes a registration to the chain: `Transaction` unless it is signed by the account and calls the
    /// contract with exactly this identity, whose proof has been checked. Gives the transaction's hash.
    async fn register(&self, registration: &Registration) -> Result<Hash, Refusal>;

    /// Keeps records, on disk before it returns; known ones are acknowledged again. Gives the time for the
    /// receipt.
    async fn store(&self, caller: &Caller, records: Vec<Received>) -> Result<Timestamp, Refusal>;

    /// A page of what the caller may see at this moment.
    async fn query(&self, caller: &Caller, query: &Query) -> Result<Page, Refusal>;

    /// How digests stand; `Unknown` for what the caller may not see.
    async fn check(&self, caller: &Caller, digests: &[Digest]) -> Result<Vec<Standing>, Refusal>;

    /// The same, each with the proof of its anchor where there is one.
    async fn prove(&self, caller: &Caller, digests: &[Digest]) -> Result<Vec<Stood>, Refusal>;

    /// A record that the caller may read at this moment, its bytes compared with the chain.
    async fn fetch(&self, caller: &Caller, digest: &Digest) -> Result<Fetched, Refusal>;

    /// Entries as they come. The server fetches each one at the moment it sends it, so that [`Self::fetch`]
    /// decides; closing the channel ends the subscription.
    async fn subscribe(&self, caller: &Caller, selection: &Selection) -> Result<mpsc::Receiver<Entry>, Refusal>;

    /// The caller's grant, signed by d_C.
    async fn grant(&self, caller: &Caller, notice: &GrantNotice) -> Result<(), Refusal>;

    /// The caller's revoke, signed by d_C: from now on the grantee is refused.
    async fn revoke(&self, caller: &Caller, notice: &RevokeNotice) -> Result<(), Refusal>;

    /// Which network it stands on, told to whoever asks: `Stale` before it is known.
    async fn network_name(&self) -> Result<NetworkName, Refusal>;

    /// Passes a JSON-RPC request on to the chain, of somebody proven or (`None`) of a visitor without a transport
    /// key. What may pass is the chain's to say ([`crate::chain::relay::examine`]).
    async fn relay(&self, caller: Option<&Caller>, method: &str, parameters: &Value) -> Result<Value, RelayError>;

    /// The caller's name is that of a device whose public key, a point of the curve, was signed by d_C: both kept
    /// durably, so that [`Self::signer`] can give the key as long as the device is lent, and the name ends with the
    /// loan. `Signature` where the chain has no such loan.
    async fn device(&self, caller: &Caller, notice: &DeviceNotice) -> Result<(), Refusal>;

    /// Something was refused: for the log, and counted by (peer, code, minute).
    fn refused(&self, peer: SocketAddr, refusal: &Refusal);
}
