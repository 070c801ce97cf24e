//! The interface to what a gateway does with a command once its sender is known; the service implements it. A command
//! that reaches a desk has passed every check that frames, session and signatures allow.

use std::net::SocketAddr;

use async_trait::async_trait;
use serde_json::Value;
use tokio::sync::watch;

use crate::crypto::{SealedRecord, TransportKey};
use crate::model::relay::RelayError;
use crate::model::{
    Address, Digest, Header, ProfileName, PublicKey, RecordKind, Signature, SignerId, Timestamp, Token, TopicId,
};

use super::command::{ErasureNotice, ErasureOutcome, Found, Notice};
use super::error::{Code, Refusal};
use super::feed::{Feed, FeedPage};
use super::hello::NetworkName;

/// The chain's view of an account.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Account {
    /// P_C as registered now, its proof checked.
    pub signing: PublicKey,
    /// P_E as registered now.
    pub envelope: PublicKey,
}

/// The device that owns a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoundDevice {
    /// SM3 of its public key.
    pub id: SignerId,
    /// Where its owner's notices to it are filed.
    pub notices: TopicId,
}

impl BoundDevice {
    /// Whether a request for the feed is for nothing but `owner`'s notices to this device.
    pub fn asks_for_notices(&self, owner: &Address, feed: &Feed) -> bool {
        let is_owners = feed.places.iter().all(|place| place.owner == *owner);
        is_owners && feed.topics == [self.notices] && feed.kind == Some(RecordKind::Key)
    }

    /// Whether a record is one of its owner's notices to this device.
    pub fn is_for(&self, kind: RecordKind, topic: TopicId) -> bool {
        kind == RecordKind::Key && topic == self.notices
    }
}

/// The binding of a name at this gateway.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Binding {
    pub account: Address,
    pub key: TransportKey,
    /// P_C when the key was allocated.
    pub signing: PublicKey,
    /// P_E when the key was allocated.
    pub envelope: PublicKey,
    /// The device that owns the name, if it is not the account's own.
    pub device: Option<BoundDevice>,
}

/// The caller, authenticated by K_T.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Caller {
    pub name: ProfileName,
    pub account: Address,
    /// P_C as registered when the session began.
    pub signing: PublicKey,
    /// The calling device, if it is one: it may use only what a device needs.
    pub device: Option<BoundDevice>,
    pub peer: SocketAddr,
}

/// A record whose header, network, owner and signature have been checked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Received {
    pub header: Header,
    pub digest: Digest,
    pub signature: Signature,
    /// The key that verified it: the owner's or a lent one.
    pub signer: PublicKey,
    pub blob: Vec<u8>,
}

impl From<Received> for SealedRecord {
    fn from(received: Received) -> Self {
        let Received { header, digest, signature, blob, .. } = received;
        Self { header, blob, digest, signature }
    }
}

/// The work of a gateway. Refusals go to the peer as their code.
#[async_trait]
pub trait Desk: Send + Sync + 'static {
    /// The chain's view of an account: `NotRegistered`, `Suspended` or `Stale` if it does not allow it, `NotAuthorised` if it is
    /// not lending this device now.
    async fn account(&self, account: &Address, device: Option<&SignerId>) -> Result<Account, Refusal>;

    /// Whether the account may use this gateway now: `Token` if it never registered this token, `NotAuthorised` if its keeper did
    /// not admit it.
    async fn admits(&self, account: &Address, token: Option<&Token>) -> Result<(), Refusal>;

    /// The public key of a signer id, if it is the owner's or lent by the owner now.
    async fn signer(&self, owner: &Address, signer: &SignerId) -> Result<Option<PublicKey>, Refusal>;

    /// A name's binding; nothing if it belonged to a device that has been recalled.
    async fn binding(&self, name: &ProfileName) -> Result<Option<Binding>, Refusal>;

    /// The successor of a lost account, as the administrator declared on the chain.
    async fn successor(&self, lost: &Address) -> Result<Option<Address>, Refusal>;

    /// Binds a name, durably before it returns. Called one at a time, and only if the name is free, bound to the same
    /// account, or to one that this account succeeds.
    async fn bind(&self, name: &ProfileName, binding: Binding) -> Result<(), Refusal>;

    /// Stores records, on disk before it returns; known ones are acknowledged again. Returns the time for the receipt.
    async fn store(&self, caller: &Caller, records: Vec<Received>) -> Result<Timestamp, Refusal>;

    /// The next page of the feed for the caller, from what is there now; `is_new` if this session did not ask for these owners
    /// before. Not signed yet.
    async fn feed(&self, caller: &Caller, asked: &Feed, is_new: bool) -> Result<FeedPage, Refusal>;

    /// Changes when [`Self::feed`] may have something else to say: there is more, or somebody's right changed.
    fn changes(&self) -> watch::Receiver<u64>;

    /// What there is for the caller of the first of these records, as many as fit into one answer and at least one: with
    /// their bytes, compared with the chain, or only whether they are there.
    async fn records(&self, caller: &Caller, digests: &[Digest], bytes: bool) -> Result<Vec<Found>, Refusal>;

    /// What the caller tells, signed by d_C. From a revoke on the grantee is refused. From a device's key on, a point of the curve,
    /// the caller's name belongs to that device: both are stored durably, so that [`Self::signer`] can return the key as long as
    /// the device is lent, and the name ends with the loan; `Signature` if the chain has no such loan.
    async fn notice(&self, caller: &Caller, notice: &Notice) -> Result<(), Refusal>;

    /// The network it is on, which anyone may ask: `Stale` before it is known.
    async fn network_name(&self) -> Result<NetworkName, Refusal>;

    /// Passes a JSON-RPC request on to the chain, for an authenticated caller or (`None`) for a visitor without a
    /// transport key. What may pass is decided by the chain's client.
    async fn relay(&self, caller: Option<&Caller>, method: &str, parameters: &Value) -> Result<Value, RelayError>;

    /// Erases here what the caller had erased at home; returns what becomes of each record, in order. `NotAuthorised` if one
    /// of them is somebody else's.
    async fn erase(&self, caller: &Caller, erasures: Vec<ErasureNotice>) -> Result<Vec<ErasureOutcome>, Refusal> {
        let _ = erasures;
        Err(Refusal::new(Code::NotHere, format_args!("nothing of {} is kept here", caller.account)))
    }

    /// Reports a refusal: for the log, counted by (peer, code, minute).
    fn refused(&self, peer: SocketAddr, refusal: &Refusal);
}
