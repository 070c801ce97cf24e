//! What the site's gateway does with each command.

use std::net::SocketAddr;
use std::sync::Arc;

use async_trait::async_trait;
use serde_json::Value;
use tokio::sync::mpsc;

use super::GatewayDesk;
use super::live::Watch;
use super::reading::announced_key;
use crate::chain::{Call, RelayError};
use crate::crypto::{open_transport_key, seal_transport_key, signer_id};
use crate::gateway::desk::Account;
use crate::gateway::{
    Binding, Caller, Code, Desk, Entry, Fetched, GrantNotice, NetworkName, Page, Query, Received, Refusal,
    Registration, RevokeNotice, Selection, Standing,
};
use crate::model::bytes::hex;
use crate::model::header::TAG_LENGTH;
use crate::model::{Address, Digest, Hash, ProfileName, PublicKey, RecordState, SignerId, Timestamp, Token};
use crate::service::event::NoticeLevel;
use crate::store::{Foreign, KeptBinding, NewRecord, StoreError};

impl GatewayDesk {
    /// Does work that waits for disk or node, off the network's threads.
    async fn blocking<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Self) -> Result<T, Refusal> + Send + 'static,
    ) -> Result<T, Refusal> {
        let desk = self.share();
        let joined = tokio::task::spawn_blocking(move || work(&desk)).await;
        joined.map_err(Refusal::because(Code::Internal))?
    }

    pub(super) fn share(&self) -> Arc<Self> {
        let (site, keeper) = (Arc::clone(&self.site), Arc::clone(&self.keeper));
        Arc::new(Self { site, keeper, envelope: self.envelope.clone(), domain: self.domain })
    }

    async fn audit(&self, caller: &Caller, action: &str, subject: &str) -> Result<(), Refusal> {
        let outcome = format!("asked by {} ({})", caller.name, caller.account);
        let written = self.site.record_audit(&self.keeper.profile, action, subject, &outcome).await;
        written.map_err(|failure| Refusal::new(Code::Internal, failure.message))
    }

    fn row(&self, record: &Received) -> NewRecord {
        let header = &record.header;
        let durable = self.site.plant.vault.durable();
        NewRecord {
            digest: record.digest,
            owner: header.owner,
            topic_id: header.topic_id,
            seq: header.seq,
            foreign: Some(Foreign { recorder: header.recorder, keeper: self.keeper.address }),
            epoch: header.epoch,
            kind: header.kind,
            signer: header.signer,
            signature: record.signature,
            filters: header.filters.clone(),
            topic: String::new(),
            // The first filter id is the type's.
            type_name: header.filters.first().map(|id| hex(&id.0)).unwrap_or_default(),
            bytes: header.body_length.saturating_sub(TAG_LENGTH as u64),
            captured_at: header.captured_at,
            simulated: false,
            state: if durable { RecordState::Stored } else { RecordState::Sealed },
            local_copy: (!durable).then(|| record.blob.clone()),
        }
    }

    fn keep(&self, records: &[Received]) -> Result<Timestamp, Refusal> {
        let plant = &self.site.plant;
        plant.ledger.takes_records().map_err(Refusal::because(Code::Internal))?;
        if plant.vault.durable() {
            let entries: Vec<_> = records.iter().map(|record| (record.digest, record.blob.as_slice())).collect();
            plant.vault.put(&entries).map_err(Refusal::because(Code::Internal))?;
        }
        plant.ledger.append(records.iter().map(|record| self.row(record)).collect()).map_err(|error| match error {
            StoreError::Conflict { .. } => {
                let text = format!("a sender gave two records the same number: {error}");
                self.site.hub.notice(NoticeLevel::Error, &text);
                Refusal::new(Code::Malformed, error)
            }
            error => Refusal::new(Code::Internal, error),
        })?;
        self.site.hub.stored.notify_waiters();
        self.site.changed(crate::service::event::Part::Uploads);
        Ok(Timestamp::now())
    }
}

#[async_trait]
impl Desk for GatewayDesk {
    async fn account(&self, account: &Address) -> Result<Account, Refusal> {
        let network = self.fresh_network()?;
        let identity = network.directory.identity(*account).map_err(Refusal::because(Code::NotRegistered))?;
        if network.directory.account(*account).is_some_and(|account| account.suspended) {
            return Err(Refusal::new(Code::Suspended, format_args!("{account} is suspended")));
        }
        Ok(Account { signing: identity.signing, envelope: identity.envelope })
    }

    async fn is_token(&self, account: &Address, token: &Token) -> Result<bool, Refusal> {
        Ok(self.fresh_network()?.directory.has_token(*account, *token))
    }

    async fn signer(&self, owner: &Address, signer: &SignerId) -> Result<Option<PublicKey>, Refusal> {
        let network = self.fresh_network()?;
        let own = network.directory.signing_key(*owner, *signer, None);
        if own.is_some() || !network.directory.is_lent(*owner, *signer, None, Timestamp::now()) {
            return Ok(own);
        }
        let signer = *signer;
        self.blocking(move |desk| {
            let key = desk.site.plant.ledger.signer(signer).map_err(Refusal::because(Code::Internal))?;
            Ok(key.filter(|key| signer_id(key) == signer))
        })
        .await
    }

    async fn binding(&self, name: &ProfileName) -> Result<Option<Binding>, Refusal> {
        let name = name.clone();
        self.blocking(move |desk| {
            let internal = Refusal::because(Code::Internal);
            let Some(kept) = desk.site.plant.ledger.binding(&name).map_err(&internal)? else { return Ok(None) };
            let (provider, keeper) = (desk.site.plant.provider, desk.envelope.secret.clone());
            let key = open_transport_key(provider, &keeper, name.as_str(), &kept.sealed_key);
            let key = key.map_err(Refusal::because(Code::Internal))?;
            Ok(Some(Binding { account: kept.account, key, signing: kept.signing, envelope: kept.envelope }))
        })
        .await
    }

    async fn successor(&self, lost: &Address) -> Result<Option<Address>, Refusal> {
        Ok(self.fresh_network()?.directory.successor(*lost))
    }

    async fn bind(&self, name: &ProfileName, binding: Binding) -> Result<(), Refusal> {
        let subject = format!("{name} for {}", binding.account);
        let audited = self.site.record_audit(&self.keeper.profile, "allocate key", &subject, "begun").await;
        audited.map_err(|failure| Refusal::new(Code::Internal, failure.message))?;
        let name = name.clone();
        self.blocking(move |desk| {
            let (provider, keeper) = (desk.site.plant.provider, desk.envelope.secret.clone());
            let sealed_key = seal_transport_key(provider, &keeper, name.as_str(), &binding.key);
            let sealed_key = sealed_key.map_err(Refusal::because(Code::Internal))?;
            let Binding { account, signing, envelope, .. } = binding;
            let kept = KeptBinding { account, signing, envelope, sealed_key };
            desk.site.plant.ledger.bind(&name, kept).map_err(Refusal::because(Code::Internal))
        })
        .await
    }

    async fn register(&self, registration: &Registration) -> Result<Hash, Refusal> {
        let network = self.fresh_network()?;
        let call = Call::Register { identity: registration.identity };
        let transaction = network.chain.expect_call(&registration.transaction, registration.account, &call);
        let transaction = transaction.map_err(Refusal::because(Code::Transaction))?;
        let account = registration.account.to_string();
        let audited = self.site.record_audit(&self.keeper.profile, "pass registration", &account, "begun").await;
        audited.map_err(|failure| Refusal::new(Code::Internal, failure.message))?;
        let sent = network.chain.broadcast(&registration.transaction).await;
        sent.map_err(Refusal::because(Code::Transaction))?;
        Ok(transaction)
    }

    async fn store(&self, _: &Caller, records: Vec<Received>) -> Result<Timestamp, Refusal> {
        self.blocking(move |desk| desk.keep(&records)).await
    }

    async fn query(&self, caller: &Caller, query: &Query) -> Result<Page, Refusal> {
        self.audit(caller, "query", &format!("records of {}", query.selection.owner)).await?;
        let (caller, query) = (caller.clone(), query.clone());
        self.blocking(move |desk| desk.page(&caller, &query)).await
    }

    async fn check(&self, caller: &Caller, digests: &[Digest]) -> Result<Vec<Standing>, Refusal> {
        let (caller, digests) = (caller.clone(), digests.to_vec());
        self.blocking(move |desk| desk.standings(&caller, &digests)).await
    }

    async fn fetch(&self, caller: &Caller, digest: &Digest) -> Result<Fetched, Refusal> {
        let (caller, digest) = (caller.clone(), *digest);
        self.blocking(move |desk| desk.record(&caller, &digest)).await
    }

    async fn subscribe(&self, caller: &Caller, selection: &Selection) -> Result<mpsc::Receiver<Entry>, Refusal> {
        self.audit(caller, "subscribe", &format!("records of {}", selection.owner)).await?;
        let watch = Watch { desk: self.share(), caller: caller.clone(), selection: selection.clone() };
        tokio::task::block_in_place(|| watch.begin())
    }

    async fn grant(&self, caller: &Caller, notice: &GrantNotice) -> Result<(), Refusal> {
        // The chain's own event opens; the notice is only written down.
        self.audit(caller, "grant notice", &notice.grantee.to_string()).await
    }

    async fn revoke(&self, caller: &Caller, notice: &RevokeNotice) -> Result<(), Refusal> {
        let (key, epoch) = (announced_key(&caller.account, &notice.grantee), notice.epoch.to_string());
        self.blocking(move |desk| {
            desk.site.plant.ledger.put_setting(&key, &epoch).map_err(Refusal::because(Code::Internal))
        })
        .await?;
        self.site.hub.authority.send_modify(|count| *count += 1);
        self.audit(caller, "revoke notice", &notice.grantee.to_string()).await
    }

    async fn network_name(&self) -> Result<NetworkName, Refusal> {
        let pin = self.fresh_network()?.chain.pin().ok_or_else(|| Refusal::new(Code::Stale, "no contract"))?;
        Ok(NetworkName { chain_id: pin.chain_id, genesis: pin.genesis, contract: pin.contract })
    }

    async fn relay(&self, _: Option<&Caller>, method: &str, parameters: &Value) -> Result<Value, RelayError> {
        let silent = |refusal: Refusal| RelayError::Silent(refusal.to_string());
        self.fresh_network().map_err(silent)?.chain.relay(method, parameters).await
    }

    async fn device(&self, caller: &Caller, key: &PublicKey) -> Result<(), Refusal> {
        let (key, device) = (*key, signer_id(key));
        if !self.fresh_network()?.directory.is_lent(caller.account, device, None, Timestamp::now()) {
            return Err(Refusal::new(Code::Signature, format_args!("device {device} is not lent")));
        }
        self.audit(caller, "device notice", &device.to_string()).await?;
        self.blocking(move |desk| {
            desk.site.plant.ledger.keep_signer(device, key).map_err(Refusal::because(Code::Internal))
        })
        .await
    }

    fn refused(&self, peer: SocketAddr, refusal: &Refusal) {
        // A line per peer, code and minute: whoever is refused again and again cannot fill the log.
        self.site.refused(&peer.ip().to_string(), &format!("{:?}", refusal.code));
        let text = format!("the gateway refused {}: {refusal}", peer.ip());
        self.site.hub.notice(NoticeLevel::Info, &text);
    }
}
