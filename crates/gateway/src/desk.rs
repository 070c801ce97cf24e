//! The service's side of a gateway. Commands arrive here after every check of frame, session and signatures.

use std::net::SocketAddr;

use async_trait::async_trait;
use serde_json::Value;
use tokio::sync::watch;

use crate::command::{ErasureNotice, ErasureOutcome, Found, Notice};
use crate::crypto::{SealedRecord, TransportKey};
use crate::error::{Code, Refusal, Result};
use crate::feed::{Feed, FeedPage};
use crate::model::{
    Address, Digest, Header, ProfileName, PublicKey, RecordKind, Signature, SignerId, Timestamp, Token, TopicId,
};
use crate::{hello::NetworkName, model::relay::RelayError};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Account {
    /// P_C as registered, its proof checked.
    pub signing: PublicKey,
    /// P_E as registered.
    pub envelope: PublicKey,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoundDevice {
    /// SM3 of its public key.
    pub id: SignerId,
    /// Topic of its owner's notices.
    pub notices: TopicId,
}

impl BoundDevice {
    /// Asks for nothing but `owner`'s notices to this device.
    pub fn asks_for_notices(&self, owner: &Address, feed: &Feed) -> bool {
        let is_owners = feed.places.iter().all(|place| place.owner == *owner);
        is_owners && feed.topics == [self.notices] && feed.kind == Some(RecordKind::Key)
    }

    pub fn is_for(&self, kind: RecordKind, topic: TopicId) -> bool {
        kind == RecordKind::Key && topic == self.notices
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Binding {
    pub account: Address,
    pub key: TransportKey,
    /// P_C at the allocation.
    pub signing: PublicKey,
    /// P_E at the allocation.
    pub envelope: PublicKey,
    /// `None` for the account's own name.
    pub device: Option<BoundDevice>,
}

/// Authenticated by K_T.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Caller {
    pub name: ProfileName,
    pub account: Address,
    /// P_C as registered when the session began.
    pub signing: PublicKey,
    /// A device may use only what it needs.
    pub device: Option<BoundDevice>,
    pub peer: SocketAddr,
}

/// Header, network, owner and signature are checked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Received {
    pub header: Header,
    pub digest: Digest,
    pub signature: Signature,
    /// The owner's key, or a lent one.
    pub signer: PublicKey,
    pub blob: Vec<u8>,
}

impl From<Received> for SealedRecord {
    fn from(received: Received) -> Self {
        let Received { header, digest, signature, blob, .. } = received;
        Self { header, blob, digest, signature }
    }
}

/// Refusals go to the peer as their code.
#[async_trait]
pub trait Desk: Send + Sync + 'static {
    /// `NotRegistered`, `Suspended` or `Stale` unless the chain allows the account, `NotAuthorised` unless it lends
    /// this device.
    async fn account(&self, account: &Address, device: Option<&SignerId>) -> Result<Account>;

    /// `Token` for one that the account never registered, `NotAdmitted` unless the keeper admitted the account.
    async fn admits(&self, account: &Address, token: Option<&Token>) -> Result<()>;

    /// `None` unless it is the owner's key, or lent by the owner now.
    async fn signer(&self, owner: &Address, signer: &SignerId) -> Result<Option<PublicKey>>;

    /// Also of a recalled device. Asks nothing of the chain: a stranger, who knows only the name, must see no difference.
    /// `Tag` if the key at rest does not open.
    async fn binding(&self, name: &ProfileName) -> Result<Option<Binding>>;

    /// When the chain recalled the device that has the name, which is free for others from then on; `Stale` if the chain
    /// does not say. For a caller that proved its key.
    async fn recalled(&self, binding: &Binding) -> Result<Option<Timestamp>>;

    /// Declared on the chain by the administrator.
    async fn successor(&self, lost: &Address) -> Result<Option<Address>>;

    /// Durable on return. Called one at a time, for a name that is free, the account's, or of one that it succeeds. `before`: the
    /// account that had it; `NameBound` if another has it by now.
    async fn bind(&self, name: &ProfileName, before: Option<Address>, binding: Binding) -> Result<()>;

    /// Durable on return; acknowledges known records again. Returns the receipt's time.
    async fn store(&self, caller: &Caller, records: Vec<Received>) -> Result<Timestamp>;

    /// Not signed. `is_new`: the session asks for some of these owners for the first time.
    async fn feed(&self, caller: &Caller, asked: &Feed, is_new: bool) -> Result<FeedPage>;

    /// Changes when [`Self::feed`] may differ: more rows, or another right.
    fn changes(&self) -> watch::Receiver<u64>;

    /// For the first digests, at least one, as many as fit into an answer; `bytes`: compared with the chain.
    async fn records(&self, caller: &Caller, digests: &[Digest], bytes: bool) -> Result<Vec<Found>>;

    /// Signed by d_C. A revoke applies from now on. A device's key, a point of the curve, is durable and takes the name
    /// while the loan lasts; `Signature` without a loan on the chain.
    async fn notice(&self, caller: &Caller, notice: &Notice) -> Result<()>;

    /// For anyone; `Stale` before it is known.
    async fn network_name(&self) -> Result<NetworkName>;

    /// For a caller, or a visitor without a transport key. The chain's client decides what may pass.
    async fn relay(&self, caller: Option<&Caller>, method: &str, parameters: &Value) -> Result<Value, RelayError>;

    /// Returns each record's outcome, in order; `NotAuthorised` for another owner's record.
    async fn erase(&self, caller: &Caller, erasures: Vec<ErasureNotice>) -> Result<Vec<ErasureOutcome>> {
        let _ = erasures;
        Err(Refusal::new(Code::NotHere, format_args!("nothing of {} is kept here", caller.account)))
    }

    /// For the log, counted by (peer, code, minute).
    fn refused(&self, peer: SocketAddr, refusal: &Refusal);
}
