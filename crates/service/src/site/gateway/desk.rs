//! How the site's gateway handles each command.

use std::net::SocketAddr;
use std::sync::PoisonError;

use async_trait::async_trait;
use serde_json::{Value, json};
use tokio::sync::watch;

use super::GatewayDesk;
use super::erasing::not_taken;
use super::reading::LONGEST_SILENCE;
use super::{Standing as Access, subject};
use crate::chain::RelayError;
use crate::chain::relay::{Asker, Ground, Passed, examine};
use crate::crypto::{SmKeyPair, check_identity, open_transport_key, seal_transport_key, signer_id};
use crate::gateway::desk::Account;
use crate::gateway::{
    Binding, BoundDevice, Caller, Code, Desk, DeviceNotice, ErasureNotice, ErasureOutcome, Feed, FeedPage, Found,
    NetworkName, Notice, Received, Refusal, RevokeNotice,
};
use crate::model::{Address, Digest, Identity, ProfileName, PublicKey, RecordKind, SignerId, Timestamp, Token, locked};
use crate::pipeline::Network;
use crate::pipeline::authority::{self, Moment, SigningRight, may_sign};
use crate::pipeline::directory::kept;
use crate::pipeline::intake::accept_uploads;
use crate::reply::{NoticeLevel, Part, internal};
use crate::store::notes::AnnouncedRevoke;
use crate::store::{KeptBinding, Ledger};

/// Name prefix of an owner's site that brings notices to robots.
const COURIER: &str = "courier-";
const DIGITS: usize = 16;

pub(super) type Result<T, E = Refusal> = std::result::Result<T, E>;

impl GatewayDesk {
    /// Runs work that waits for disk or node, off the network's threads.
    pub async fn blocking<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Self) -> Result<T> + Send + 'static,
    ) -> Result<T> {
        let desk = self.clone();
        let joined = tokio::task::spawn_blocking(move || work(&desk)).await;
        joined.map_err(Refusal::internal)?
    }

    fn ledger(&self) -> &Ledger {
        &self.gateway.parts.plant.ledger
    }

    async fn audit(&self, caller: &Caller, action: &str, subject: &str) -> Result<()> {
        let (log, outcome) = (&self.gateway.parts.log, format!("asked by {} ({})", caller.name, caller.account));
        log.write(&self.place.keeper.profile, action, subject, &outcome).await.map_err(Refusal::internal)
    }

    /// Like [`Self::audit`], but once a minute for the same event of a caller; repetitions are counted.
    async fn audit_once(&self, caller: &Caller, action: &str, subject: &str) -> Result<()> {
        let (log, query) = (&self.gateway.parts.log, format!("{action} {subject}"));
        if !log.is_new_query(caller.name.as_str(), &query) {
            return Ok(());
        }
        let written = self.audit(caller, action, subject).await;
        if written.is_err() {
            log.forget_query(caller.name.as_str(), &query);
        }
        written
    }

    /// Obeys a revoke before it is on the chain.
    async fn revoked(&self, caller: &Caller, notice: &RevokeNotice) -> Result<()> {
        let (note, epoch) = (AnnouncedRevoke { owner: caller.account, reader: notice.grantee }, notice.epoch);
        self.blocking(move |desk| desk.ledger().notes.write(&note, &epoch).map_err(Refusal::internal)).await?;
        self.gateway.parts.hub.feed_changed();
        self.audit(caller, "revoke notice", &notice.grantee.to_string()).await
    }

    /// Binds the caller's name to a device.
    async fn named(&self, caller: &Caller, notice: &DeviceNotice) -> Result<()> {
        self.freshen().await?;
        let DeviceNotice { key, notices } = *notice;
        let device = signer_id(&key);
        if let Err(why) = self.may_sign_now(&caller.account, &device)? {
            return Err(Refusal::new(Code::Signature, why));
        }
        self.audit(caller, "device notice", &device.to_string()).await?;
        let (name, account) = (caller.name.to_string(), caller.account);
        self.blocking(move |desk| {
            let bindings = &desk.ledger().bindings;
            bindings.keep_signer(device, key).map_err(Refusal::internal)?;
            bindings.bind_device(&name, account, device, notices).map(drop).map_err(Refusal::internal)
        })
        .await
    }

    fn keep(&self, owner: &Address, records: Vec<Received>) -> Result<Timestamp> {
        let guest = self.standing_of(&self.known_network()?, owner)? == Access::Guest;
        // Counted records must be stored before anything else is counted.
        let _counting = guest.then(|| locked(&self.place.guests));
        if guest {
            self.check_quota(owner, &records)?;
        }
        let plant = &self.gateway.parts.plant;
        let has_notice = records.iter().any(|record| record.header.kind == RecordKind::Key);
        let accepted = accept_uploads(plant, self.place.keeper.address, records).map_err(Refusal::internal)?;
        accepted.map_err(|reason| not_taken(&reason, &reason))?;
        if has_notice {
            self.gateway.parts.hub.feed_changed();
        }
        self.gateway.parts.hub.stored.notify_waiters();
        self.gateway.parts.hub.changed(Part::Uploads);
        Ok(Timestamp::now())
    }

    /// A device's session is valid as long as its loan.
    pub fn check_loan(&self, network: &Network, caller: &Caller) -> Result<()> {
        let Some(device) = &caller.device else { return Ok(()) };
        let now = Moment::newest(network.directory.now());
        let right = may_sign(&network.directory, caller.account, device.id, now);
        right.map(drop).map_err(|why| Refusal::new(Code::NotAuthorised, format_args!("device {}: {why}", device.id)))
    }

    /// A transaction proves its own sender: without a transport key, admitted accounts may send one, and a newcomer its
    /// registration.
    fn check_sender(
        &self,
        network: &Network,
        sender: Address,
        registers: Option<Box<Identity>>,
    ) -> Result<(), RelayError> {
        if let Some(identity) = registers {
            return check_identity(self.gateway.parts.plant.provider, &self.place.domain, &sender, &identity)
                .map_err(|_| rejected("the identity being registered is not proven by its own keys"));
        }
        if self.may_send(network, &sender) {
            return Ok(());
        }
        Err(rejected(
            "a visitor may only send its registration; ask the gateway's operator to allow this account first",
        ))
    }

    fn may_send(&self, network: &Network, account: &Address) -> bool {
        let known =
            network.directory.account(*account).is_some() && !authority::is_suspended(&network.directory, *account);
        known && self.standing_of(network, account).is_ok()
    }
}

#[async_trait]
impl Desk for GatewayDesk {
    async fn account(&self, account: &Address, device: Option<&SignerId>) -> Result<Account> {
        let network = self.known_network()?;
        let identity = network.directory.identity(*account).map_err(Refusal::because(Code::NotRegistered))?;
        if authority::is_suspended(&network.directory, *account) {
            return Err(Refusal::new(Code::Suspended, format_args!("{account} is suspended")));
        }
        if let Some(device) = device
            && self.may_sign_now(account, device)?.is_err()
        {
            let text = format_args!("device {device} of {account} is no longer authorised");
            return Err(Refusal::new(Code::NotAuthorised, text));
        }
        Ok(Account { signing: identity.signing, envelope: identity.envelope })
    }

    async fn admits(&self, account: &Address, token: Option<&Token>) -> Result<()> {
        if let Some(token) = token {
            let (account, token) = (*account, *token);
            let is_known = self.blocking(move |desk| {
                let directory = desk.known_network()?.directory;
                let known = kept::has_token(&desk.ledger().rights, &directory, account, token);
                known.map_err(Refusal::internal)
            });
            if !is_known.await? {
                return Err(Refusal::new(Code::Token, format_args!("{account} does not have token {token}")));
            }
        }
        self.standing_of(&self.known_network()?, account).map(drop)
    }

    async fn signer(&self, owner: &Address, signer: &SignerId) -> Result<Option<PublicKey>> {
        match self.may_sign_now(owner, signer)? {
            Ok(SigningRight::Owner(key)) => return Ok(Some(key)),
            Ok(SigningRight::Device(_)) => {}
            Err(_) => return Ok(None),
        }
        let signer = *signer;
        self.blocking(move |desk| {
            let key = desk.ledger().bindings.signer(signer).map_err(Refusal::internal)?;
            Ok(key.filter(|key| signer_id(key) == signer))
        })
        .await
    }

    async fn binding(&self, name: &ProfileName) -> Result<Option<Binding>> {
        let name = name.clone();
        self.blocking(move |desk| {
            let kept = desk.ledger().bindings.binding(&name).map_err(Refusal::internal)?;
            let Some(kept) = kept else { return Ok(None) };
            let provider = desk.gateway.parts.plant.provider;
            let under = desk.place.under.read().unwrap_or_else(PoisonError::into_inner);
            let open =
                |pair: &SmKeyPair| open_transport_key(provider, &pair.secret, name.as_str(), &kept.sealed_key).ok();
            let key = under.iter().find_map(open);
            let key = key.ok_or_else(|| Refusal::new(Code::Tag, "the transport key at rest does not open"))?;
            drop(under);
            let KeptBinding { account, signing, envelope, device, .. } = kept;
            let device = device.map(|(id, notices)| BoundDevice { id, notices });
            Ok(Some(Binding { account, key, signing, envelope, device }))
        })
        .await
    }

    async fn recalled(&self, binding: &Binding) -> Result<Option<Timestamp>> {
        let Some(device) = &binding.device else { return Ok(None) };
        let network = self.known_network()?;
        let account = network.directory.account(binding.account);
        let Some(block) = account.and_then(|account| account.recalled(device.id)) else { return Ok(None) };
        network.ask_time(block).await.map(Some).map_err(Refusal::because(Code::Stale))
    }

    async fn successor(&self, lost: &Address) -> Result<Option<Address>> {
        Ok(self.known_network()?.directory.successor(*lost))
    }

    async fn bind(&self, name: &ProfileName, before: Option<Address>, binding: Binding) -> Result<()> {
        let subject = format!("{name} for {}", binding.account);
        let (asked, account) = (name.clone(), binding.account);
        self.blocking(move |desk| desk.check_name(&desk.known_network()?, &account, &asked)).await?;
        let (log, keeper) = (&self.gateway.parts.log, &self.place.keeper.profile);
        log.write(keeper, "allocate key", &subject, "begun").await.map_err(Refusal::internal)?;
        let name = name.clone();
        let bound = self.blocking(move |desk| {
            // Held until it is stored: a change of the keeper's pair re-encrypts what is there.
            let under = desk.place.under.read().unwrap_or_else(PoisonError::into_inner);
            let pair =
                under.first().ok_or_else(|| Refusal::new(Code::Internal, "no key to keep transport keys under"))?;
            let sealed_key =
                seal_transport_key(desk.gateway.parts.plant.provider, &pair.secret, name.as_str(), &binding.key);
            let sealed_key = sealed_key.map_err(Refusal::internal)?;
            let Binding { account, signing, envelope, .. } = binding;
            let kept = KeptBinding { account, signing, envelope, sealed_key, device: None };
            if desk.ledger().bindings.bind(&name, before, kept).map_err(Refusal::internal)? {
                return Ok(());
            }
            Err(Refusal::new(Code::NameBound, format_args!("another worker gave {name} to another account meanwhile")))
        });
        let bound = bound.await;
        let told = bound.as_ref().copied().map_err(|refusal| internal(refusal.detail.clone()));
        let ended = log.ended(keeper, "allocate key", &subject, told).await;
        bound.and_then(|()| ended.map_err(Refusal::internal))
    }

    async fn store(&self, caller: &Caller, records: Vec<Received>) -> Result<Timestamp> {
        let account = caller.account;
        self.blocking(move |desk| desk.keep(&account, records)).await
    }

    async fn feed(&self, caller: &Caller, asked: &Feed, is_new: bool) -> Result<FeedPage> {
        // A robot may always ask about its own records: a recall need not hide those.
        if caller.device.is_none() || asked.recorders.is_empty() {
            self.freshen().await?;
        }
        if is_new && caller.device.is_none() {
            let (reader, asked) = (caller.account, asked.clone());
            let followed = self.blocking(move |desk| desk.followed(&reader, &asked)).await?;
            for owner in followed {
                self.audit_once(caller, "query", &format!("records of {owner}")).await?;
            }
        }
        let (caller, asked) = (caller.clone(), asked.clone());
        self.blocking(move |desk| desk.page_of_feed(&caller, &asked)).await
    }

    fn changes(&self) -> watch::Receiver<u64> {
        self.gateway.parts.hub.feed.subscribe()
    }

    async fn records(&self, caller: &Caller, digests: &[Digest], bytes: bool) -> Result<Vec<Found>> {
        if caller.device.is_none() || bytes {
            self.freshen().await?;
        }
        let (caller, digests) = (caller.clone(), digests.to_vec());
        self.blocking(move |desk| desk.found(&caller, &digests, bytes)).await
    }

    async fn notice(&self, caller: &Caller, notice: &Notice) -> Result<()> {
        match notice {
            // The chain's own event decides; the notice is only logged.
            Notice::Grant(notice) => self.audit(caller, "grant notice", &notice.grantee.to_string()).await,
            Notice::Revoke(notice) => self.revoked(caller, notice).await,
            Notice::Device(notice) => self.named(caller, notice).await,
        }
    }

    async fn network_name(&self) -> Result<NetworkName> {
        let pin = self.known_network()?.chain.pin().ok_or_else(|| Refusal::new(Code::Stale, "no contract"))?;
        Ok(NetworkName { chain_id: pin.chain_id, genesis: pin.genesis, contract: pin.contract })
    }

    async fn relay(&self, caller: Option<&Caller>, method: &str, parameters: &Value) -> Result<Value, RelayError> {
        let network = self.known_network().map_err(|refusal| RelayError::Silent(refusal.to_string()))?;
        let (Some(pin), Some(head)) = (network.chain.pin(), self.gateway.parts.link.fresh_head(LONGEST_SILENCE)) else {
            return Err(RelayError::Silent("no recent block from the chain".to_owned()));
        };
        let asker = if caller.is_some() { Asker::Registered } else { Asker::Visitor };
        match examine(Ground { pin: &pin, head: head.number }, asker, method, parameters)? {
            Passed::Read(parameters) => network.chain.relay(method, &parameters).await,
            Passed::NoLogs => Ok(json!([])),
            Passed::Estimate { from, registers } => {
                let known = || from.is_some_and(|from| self.may_send(&network, &from));
                if caller.is_none() && registers.is_none() && !known() {
                    return Err(RelayError::NotAllowed);
                }
                network.chain.relay(method, parameters).await
            }
            Passed::Transaction { sender, registers } => {
                if caller.is_none() {
                    self.check_sender(&network, sender, registers)?;
                }
                network.chain.relay(method, parameters).await
            }
        }
    }

    async fn erase(&self, caller: &Caller, erasures: Vec<ErasureNotice>) -> Result<Vec<ErasureOutcome>> {
        self.freshen().await?;
        self.erase_for(caller, erasures).await
    }

    fn refused(&self, peer: SocketAddr, refusal: &Refusal) {
        // One line per peer, code and minute: a persistent peer cannot fill either log.
        if self.gateway.parts.log.refused(&peer.ip().to_string(), &format!("{:?}", refusal.code)) {
            let (hub, text) =
                (&self.gateway.parts.hub, format!("the gateway refused {}: {}", peer.ip(), refusal.detail));
            match refusal.account {
                // The keeper can change this.
                Some(account) => hub.notice_about(&subject(account), NoticeLevel::Warning, &text),
                None => hub.inform(&format!("the gateway refused {}: {refusal}", peer.ip())),
            }
        }
    }
}

pub fn courier_of(account: &Address) -> String {
    let digits: String = account.to_string().chars().filter(char::is_ascii_hexdigit).skip(1).take(DIGITS).collect();
    format!("{COURIER}{}", digits.to_lowercase())
}

/// Whether no robot may have this name: `courier-0123456789abcdef`.
pub fn is_reserved(name: &ProfileName) -> bool {
    let digits = name.as_str().strip_prefix(COURIER);
    digits.is_some_and(|digits| digits.len() == DIGITS && digits.bytes().all(|byte| byte.is_ascii_hexdigit()))
}

pub fn check(name: &ProfileName, account: &Address) -> Result<()> {
    if !is_reserved(name) || name.as_str() == courier_of(account) {
        return Ok(());
    }
    Err(Refusal::new(Code::NameBound, format_args!("{name} is the name of another account's own site")))
}

fn rejected(words: &str) -> RelayError {
    RelayError::Answered { code: -32003, message: words.to_owned(), data: None }
}

#[cfg(test)]
mod reserved_tests {
    use super::*;

    #[test]
    fn the_name_of_a_courier_is_its_accounts_own() {
        let (alice, eve) = (Address([0xab; 20]), Address([0xcd; 20]));
        let may = |name: &str, account| {
            let name: ProfileName = name.parse().expect("a name");
            check(&name, account).map_err(|refusal| refusal.code)
        };
        assert_eq!(courier_of(&alice), "courier-abababababababab");
        assert_eq!(may("courier-abababababababab", &alice), Ok(()));
        assert_eq!(may("courier-abababababababab", &eve), Err(Code::NameBound));
        for free in ["courier-1", "scout-1", "courier-abababababababax"] {
            assert_eq!(may(free, &eve), Ok(()), "{free}");
        }
    }
}
