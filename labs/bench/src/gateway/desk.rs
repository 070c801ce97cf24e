//! A gateway's desk that stores one sender's uploads, in a store like a site's, fsynced before the
//! receipt; it does nothing else.

use std::net::SocketAddr;
use std::path::Path;

use async_trait::async_trait;
use serde_json::Value;
use tokio::sync::watch;

use super::Sender;
use authros_chain::RelayError;
use authros_crypto::{TransportKey, signer_id};
use authros_gateway::desk::Account;
use authros_gateway::{
    Binding, Caller, Code, Credentials, Desk, Feed, FeedPage, Found, NetworkName, Notice, Received, Refusal,
};
use authros_model::header::TAG_LENGTH;
use authros_model::{Address, Digest, ProfileName, PublicKey, RecordState, SignerId, Timestamp, Token};
use authros_service::Failure;
use authros_service::reply::internal;
use authros_store::{Ciphertext, Foreign, Ledger, NewRecord};

/// The desk.
pub(super) struct BenchDesk {
    store: Ledger,
    name: ProfileName,
    binding: Binding,
    token: Token,
}

impl BenchDesk {
    /// With a new store in `directory`, and the sender's credentials.
    pub fn open(sender: &Sender, directory: &Path) -> Result<(Self, Credentials), Failure> {
        let name: ProfileName = "bench".parse().map_err(|_| internal("no name"))?;
        let key = TransportKey::generate()?;
        let credentials = Credentials { name: name.clone(), key: key.clone(), token: sender.token };
        let store = Ledger::open(&directory.join("ledger.db"))?;
        let (signing, envelope) = (sender.signing.public, sender.envelope.public);
        let binding = Binding { account: sender.address, key, signing, envelope, device: None };
        Ok((Self { store, name, binding, token: sender.token }, credentials))
    }

    /// How many records the store holds.
    pub fn kept(&self) -> Result<u64, Failure> {
        Ok(Ciphertext::of(&self.store).usage()?.entries)
    }
}

fn row(record: &Received) -> NewRecord {
    let header = &record.header;
    NewRecord {
        digest: record.digest,
        owner: header.owner,
        topic_id: header.topic_id,
        seq: header.seq,
        foreign: Some(Foreign { recorder: header.recorder, keeper: header.owner }),
        epoch: header.epoch,
        kind: header.kind,
        signer: header.signer,
        signature: record.signature,
        filters: header.filters.clone(),
        topic: String::new(),
        type_name: String::new(),
        bytes: header.body_length.saturating_sub(TAG_LENGTH as u64),
        captured_at: header.captured_at,
        simulated: true,
        state: RecordState::Stored,
        blob: Some(record.blob.clone()),
    }
}

fn keep(store: &Ledger, records: &[Received]) -> Result<Timestamp, Refusal> {
    store.records.append(records.iter().map(row).collect()).map_err(Refusal::because(Code::Internal))?;
    Ok(Timestamp::now())
}

fn not_measured<T>() -> Result<T, Refusal> {
    Err(Refusal::new(Code::NotHere, "only uploads are measured"))
}

#[async_trait]
impl Desk for BenchDesk {
    async fn account(&self, account: &Address, _: Option<&SignerId>) -> Result<Account, Refusal> {
        if *account != self.binding.account {
            return Err(Refusal::new(Code::NotRegistered, "another account"));
        }
        Ok(Account { signing: self.binding.signing, envelope: self.binding.envelope })
    }

    async fn admits(&self, account: &Address, token: Option<&Token>) -> Result<(), Refusal> {
        let is_known = token.is_none_or(|token| (account, token) == (&self.binding.account, &self.token));
        if is_known { Ok(()) } else { Err(Refusal::new(Code::Token, "another token")) }
    }

    async fn signer(&self, owner: &Address, signer: &SignerId) -> Result<Option<PublicKey>, Refusal> {
        let key = self.binding.signing;
        Ok((*owner == self.binding.account && *signer == signer_id(&key)).then_some(key))
    }

    async fn binding(&self, name: &ProfileName) -> Result<Option<Binding>, Refusal> {
        Ok((*name == self.name).then(|| self.binding.clone()))
    }

    async fn recalled(&self, _: &Binding) -> Result<Option<Timestamp>, Refusal> {
        Ok(None)
    }

    async fn successor(&self, _: &Address) -> Result<Option<Address>, Refusal> {
        not_measured()
    }

    async fn bind(&self, _: &ProfileName, _: Option<Address>, _: Binding) -> Result<(), Refusal> {
        not_measured()
    }

    async fn store(&self, _: &Caller, records: Vec<Received>) -> Result<Timestamp, Refusal> {
        let store = self.store.clone();
        let kept = tokio::task::spawn_blocking(move || keep(&store, &records)).await;
        kept.map_err(Refusal::because(Code::Internal))?
    }

    async fn feed(&self, _: &Caller, _: &Feed, _: bool) -> Result<FeedPage, Refusal> {
        not_measured()
    }

    fn changes(&self) -> watch::Receiver<u64> {
        watch::channel(0).1
    }

    async fn records(&self, _: &Caller, _: &[Digest], _: bool) -> Result<Vec<Found>, Refusal> {
        not_measured()
    }

    async fn notice(&self, _: &Caller, _: &Notice) -> Result<(), Refusal> {
        not_measured()
    }

    // The uploader gets the code, and the bench ends with it.
    async fn network_name(&self) -> Result<NetworkName, Refusal> {
        not_measured()
    }

    async fn relay(&self, _: Option<&Caller>, _: &str, _: &Value) -> Result<Value, RelayError> {
        Err(RelayError::NotAllowed)
    }

    fn refused(&self, _: SocketAddr, _: &Refusal) {}
}
