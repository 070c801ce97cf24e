//! The gateway of a site (the paper's CR): stores what robots send, anchors it with its keeper's account, and answers
//! queries according to the chain's current grants.

#[cfg(test)]
mod admission_tests;
#[cfg(test)]
mod cut_off_tests;
pub(super) mod desk;
mod erasing;
mod reading;

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, OnceLock, PoisonError, RwLock};
use std::time::Duration;

use tokio::sync::{oneshot, watch};
use tokio::task::block_in_place;

use crate::command::{SecretBytes, SecretText};
use crate::crypto::join_file::SharedUse;
use crate::crypto::{CryptoError, Fingerprint, JoinFile, JoinKey, Passphrase, Provider, SmKeyPair, signer_id};
use crate::figures::GatewayFigures;
use crate::gateway::server::Sender;
use crate::gateway::system_keys::SystemKeyList;
use crate::gateway::{
    Cabinet, Code, Context, GatewayError, Kept, Limits, Received, Refusal, Schedule, Server, ServerWatch, Shelf,
};
use crate::model::{
    Address, AnchorMode, Domain, ErrorKind, Party, ProfileName, SignerId, Timestamp, hex, locked, natural, unhex,
};
use crate::paths::Home;
use crate::pipeline::forwarder::Link as Line;
use crate::pipeline::{Anchors, Network, Owner, network_pin};
use crate::reply::{
    AdmittedView, Failure, GatewayStatusView, GatewayView, NoticeLevel, Part, RefusedView, Result, SenderView,
    SystemKeyView, input, refused,
};
use crate::site::storage::check_all_accounts;
use crate::site::{Contacts, Parts, Remote, Sharing, leading};
use crate::store::notes::{AdmittedOwner, AdmittedOwners, HoldersSettings, SealedSystemKeys, SharedSystemKeys};
use crate::store::{BoundName, Notes, StoreError};

/// Longest wait for running requests when the gateway ends.
const FAREWELL: Duration = Duration::from_secs(3);

/// The keeper's envelope pairs, current first, which encrypt stored transport keys; kept because robots connect while
/// the keyring is locked.
pub(super) type KeptUnder = Arc<RwLock<Vec<SmKeyPair>>>;

#[derive(Clone)]
struct Place {
    /// Its account anchors; its SM2 key is, or was at the foundation, the gateway's identity.
    keeper: Arc<Owner>,
    under: KeptUnder,
    domain: Domain,
    address: SocketAddr,
    /// Also for owners not admitted, within quotas.
    open: bool,
    /// Accounts of the home's profiles when the gateway started.
    home_accounts: Arc<BTreeSet<Address>>,
    /// Held while a guest's records are counted and stored.
    guests: Arc<Mutex<()>>,
}

/// Serves with the existing server, or with a new one at the same address; returns early if it breaks.
async fn serve_until(gateway: Arc<Gateway>, place: Place, server: Option<Server>, mut over: watch::Receiver<bool>) {
    let server = match server {
        Some(server) => Ok(server),
        None => gateway.listen(&place).await,
    };
    let mut server = match server {
        Ok(server) => server,
        Err(failure) => return gateway.parts.hub.alarm(&failure.message),
    };
    tokio::select! {
        () = gateway.parts.life.stopped() => {}
        // A dropped sender means the same.
        _ = over.wait_for(|over| *over) => {}
        () = server.broken() => return,
    }
    server.stop(FAREWELL).await;
}

#[derive(Clone)]
pub(super) struct GatewayDesk {
    gateway: Arc<Gateway>,
    place: Place,
}

pub struct Gateway {
    pub parts: Parts,
    pub sharing: Arc<Sharing>,
    pub admissions: Arc<Admissions>,
    /// Confirmed anchors of records that their owners had erased.
    pub anchors: Anchors,
    pub serving: Mutex<Option<Serving>>,
    pub remote: Option<Arc<Remote>>,
    /// Connection of the agent that works here.
    pub passed_on: OnceLock<watch::Receiver<Line>>,
}

impl Gateway {
    pub fn served(&self) -> Option<GatewayView> {
        locked(&self.serving).as_ref().map(|serving| serving.view.clone())
    }

    pub fn is_serving(&self) -> bool {
        locked(&self.serving).is_some()
    }

    pub fn figures(&self) -> Option<GatewayFigures> {
        let serving = locked(&self.serving);
        let watch = &serving.as_ref()?.watch;
        let connections = u64::try_from(watch.connections()).unwrap_or(u64::MAX);
        let refused = watch.refused().into_iter().map(|(code, count)| (code.number(), count)).collect();
        Some(GatewayFigures { connections, refused })
    }

    /// Takes the state of the connection through which this home's records are forwarded.
    pub fn passes_on(&self, line: watch::Receiver<Line>) {
        // A site has at most one agent.
        let _ = self.passed_on.set(line);
    }

    /// State of that connection, if there is one.
    pub fn line(&self) -> Option<Line> {
        self.passed_on.get().map(|line| line.borrow().clone())
    }

    pub async fn serve(
        self: &Arc<Self>,
        keeper: &Arc<Owner>,
        address: SocketAddr,
        open: bool,
        ended: oneshot::Receiver<()>,
    ) -> Result<GatewayView> {
        if self.parts.config.anchor_mode == AnchorMode::Each {
            let text = "a gateway anchors records of many owners, which requires batches; set anchor.mode = 'batch'";
            return Err(input(text));
        }
        let network = self.parts.link.network().await?;
        let registered = network.directory.identity(keeper.address)?;
        if registered.signing != keeper.signing().public {
            return Err(refused(format!(
                "the signing key of profile '{}' is not the registered one; run `authros identity register` first",
                keeper.profile
            )));
        }
        block_in_place(|| check_all_accounts(&self.parts))?;
        self.admissions.open()?;
        let under = Arc::new(RwLock::new(keeper.envelopes()));
        let place = Place {
            keeper: Arc::clone(keeper),
            under: Arc::clone(&under),
            domain: network.domain,
            address,
            open: open || self.parts.config.gateway.open,
            home_accounts: Arc::new(self.admissions.home_accounts()),
            guests: Arc::default(),
        };
        let server = self.listen(&place).await?;
        let view = GatewayView {
            address: server.address().to_string(),
            gateway: server.id(),
            fingerprint: Fingerprint::of(&keeper.gateway_identity().public).to_string(),
            account: keeper.address,
            domain: network.domain,
            addresses: self.parts.config.gateway_addresses.clone(),
        };
        self.parts.log.write(&keeper.profile, "gateway", &view.address, "serving").await?;
        self.parts.hub.inform(&format!("the gateway is listening at {}", view.address));
        *locked(&self.serving) = Some(Serving { view: view.clone(), watch: server.watch(), under });
        self.parts.hub.changed(Part::Health);
        self.keep_gateway(place, server, ended);
        Ok(view)
    }

    fn keep_gateway(self: &Arc<Self>, place: Place, server: Server, ended: oneshot::Receiver<()>) {
        let (over, is_over) = watch::channel(false);
        let gateway = Arc::clone(self);
        tokio::spawn(async move {
            // A dropped sender means the same.
            drop(ended.await);
            over.send_replace(true);
            *locked(&gateway.serving) = None;
            gateway.parts.hub.changed(Part::Health);
        });
        let (place, first) = (Place { address: server.address(), ..place }, Mutex::new(Some(server)));
        let over = is_over.clone();
        self.parts.supervisor.keep_while(
            "gateway",
            self,
            move |_| !*is_over.borrow(),
            move |gateway| {
                let first = locked(&first).take();
                serve_until(gateway, place.clone(), first, over.clone())
            },
        );
    }

    async fn listen(self: &Arc<Self>, place: &Place) -> Result<Server> {
        let Place { keeper, domain, address, .. } = place;
        let provider = self.parts.plant.provider;
        let context = Context { provider, domain: *domain };
        let cabinet = block_in_place(|| {
            let (identity, schedule, now) = (keeper.gateway_identity(), Schedule::default(), Timestamp::now());
            if !self.parts.is_on_server() {
                return Cabinet::open(&self.parts.home.gateway(), context, identity, schedule, now);
            }
            let (notes, home) = (self.parts.plant.ledger.notes.clone(), self.parts.home.clone());
            let gateway = signer_id(&identity.public);
            let shelf = SharedShelf { notes, home, provider, domain: *domain, gateway, seen: None };
            Cabinet::on(Box::new(shelf), context, identity, schedule, now)
        })?;
        let desk = Arc::new(GatewayDesk { gateway: Arc::clone(self), place: place.clone() });
        Server::start(*address, desk, context, cabinet, Limits::default())
            .await
            .map_err(|error| input(format!("the gateway cannot listen at {address}: {error}; choose another --listen")))
    }

    /// The keys that encrypt the transport keys of this owner's gateway here.
    pub fn kept_under(&self, owner: &Owner) -> Option<KeptUnder> {
        let serving = locked(&self.serving);
        let own = serving.as_ref().filter(|serving| serving.view.account == owner.address);
        own.map(|serving| Arc::clone(&serving.under))
    }

    /// A row for each bound name, without sessions.
    fn bound_senders(&self) -> Result<Vec<SenderView>> {
        let directory = self.parts.link.network_now().map(|network| network.directory);
        let is_revoked = |account: Address, device: Option<SignerId>| {
            let account = directory.as_ref().and_then(|directory| directory.account(account));
            device.zip(account).is_some_and(|(device, account)| account.recalled(device).is_some())
        };
        let bound = self.parts.plant.ledger.bindings.bound_names()?.into_iter();
        let row = |bound: BoundName| {
            let revoked = is_revoked(bound.account, bound.device);
            Some(SenderView { revoked, ..without_sessions(bound.name.parse().ok()?, bound.account) })
        };
        Ok(bound.filter_map(row).collect())
    }

    pub fn status(&self) -> Result<GatewayStatusView> {
        let bound = self.bound_senders()?;
        let ledger = &self.parts.plant.ledger;
        let mut lease = ledger.lease.state()?.map(leading::view);
        if let Some(lease) = &mut lease {
            lease.unlike = self.parts.config.unlike(&ledger.notes.read(&HoldersSettings {})?.unwrap_or_default());
        }
        let through = self.remote.as_ref().map(|remote| crate::model::clean(&remote.chain_text(), 300));
        let serving = locked(&self.serving);
        let Some(serving) = &*serving else {
            let senders = sender_rows(bound, Vec::new());
            return Ok(GatewayStatusView { through, senders, lease, ..GatewayStatusView::default() });
        };
        let (list, now) = (serving.watch.system_keys(), Timestamp::now());
        let keys = list.keys.iter().map(|key| SystemKeyView {
            id: key.id(),
            not_before: key.not_before,
            not_after: key.not_after,
            current: key.is_in_use(now),
        });
        let refused = serving.watch.refused().into_iter();
        let mut refused: Vec<RefusedView> = refused
            .map(|(code, count)| RefusedView { code: code.number(), text: code.text().to_owned(), count })
            .collect();
        refused.sort_by_key(|row| std::cmp::Reverse(row.count));
        Ok(GatewayStatusView {
            served: Some(serving.view.clone()),
            through,
            connections: u64::try_from(serving.watch.connections()).unwrap_or(u64::MAX),
            senders: sender_rows(bound, serving.watch.senders()),
            keys: keys.collect(),
            list_version: list.version,
            list_expires: Some(list.expires_at),
            refused,
            lease,
        })
    }
}

pub struct Serving {
    pub view: GatewayView,
    pub watch: ServerWatch,
    pub under: KeptUnder,
}

fn without_sessions(name: ProfileName, account: Address) -> SenderView {
    SenderView { name, account, revoked: false, sessions: 0, peer: None, since: None, last: None, frames: 0, bytes: 0 }
}

/// Every bound name with the sum of its sessions; connected ones first.
fn sender_rows(bound: Vec<SenderView>, connected: Vec<Sender>) -> Vec<SenderView> {
    let mut rows: BTreeMap<ProfileName, SenderView> = bound.into_iter().map(|row| (row.name.clone(), row)).collect();
    for sender in connected {
        let unbound = || without_sessions(sender.name.clone(), sender.account);
        let row = rows.entry(sender.name.clone()).or_insert_with(unbound);
        row.sessions += 1;
        row.peer = Some(sender.peer.to_string());
        row.since = Some(row.since.map_or(sender.since, |since| since.min(sender.since)));
        row.last = Some(row.last.map_or(sender.last, |last| last.max(sender.last)));
        row.frames += sender.frames;
        row.bytes = row.bytes.saturating_add(sender.bytes);
    }
    let mut rows: Vec<SenderView> = rows.into_values().collect();
    rows.sort_by(|one, other| natural(one.name.as_str(), other.name.as_str()));
    rows.sort_by_key(|row| row.sessions == 0);
    rows
}

const DAMAGED: &str = "the system keys in the database do not open under this home's join key: join again with a new file \
                       (`authros gateway join-file` at a worker that serves), or restore the database";

/// The system keys in the database of all workers.
pub(super) struct SharedShelf {
    pub notes: Notes,
    pub home: Home,
    pub provider: &'static dyn Provider,
    pub domain: Domain,
    pub gateway: SignerId,
    /// As last read; [`Shelf::write`] replaces nothing else.
    pub seen: Option<SealedSystemKeys>,
}

fn unshared(failure: Failure) -> GatewayError {
    GatewayError::Shelf { kind: failure.kind, text: failure.message }
}

impl Shelf for SharedShelf {
    fn read(&mut self) -> Result<Option<Kept>, GatewayError> {
        self.seen = self.notes.read(&SharedSystemKeys {}).map_err(|error| unshared(error.into()))?;
        let Some(sealed) = &self.seen else { return Ok(None) };
        let join = join_key(&self.home, sealed.join).map_err(unshared)?;
        let kept = opened(self.provider, (&self.domain, &self.gateway), &join, sealed).map_err(unshared)?;
        Ok(Some(kept))
    }

    fn write(&mut self, kept: &Kept) -> Result<bool, GatewayError> {
        let join = match &self.seen {
            Some(sealed) => join_key(&self.home, sealed.join).map_err(unshared)?,
            None => first_join_key(&self.home)?,
        };
        let sealed = sealed(self.provider, (&self.domain, &self.gateway), &join, kept)?;
        let replaced = self.notes.replace(&SharedSystemKeys {}, self.seen.as_ref(), &sealed);
        let replaced = replaced.map_err(|error| unshared(error.into()))?;
        if replaced {
            self.seen = Some(sealed);
        }
        Ok(replaced)
    }

    fn is_shared(&self) -> bool {
        true
    }
}

/// The first worker makes it, and keeps it before anything is sealed under it.
fn first_join_key(home: &Home) -> Result<JoinKey, CryptoError> {
    if let Some(made) = JoinKey::load(&home.gateway(), 1)? {
        return Ok(made);
    }
    let join = JoinKey::generate(1)?;
    join.save(&home.gateway())?;
    Ok(join)
}

pub(crate) fn join_key(home: &Home, number: u64) -> Result<JoinKey> {
    JoinKey::load(&home.gateway(), number)?.ok_or_else(|| {
        refused(format!(
            "the workers of this gateway have join key {number}, and {} does not have it: make a join file at another worker \
             (`authros gateway join-file --out FILE`), then run `authros gateway join FILE` here",
            home.root().display()
        ))
    })
}

pub(crate) fn sealed(
    provider: &dyn Provider,
    (domain, gateway): (&Domain, &SignerId),
    join: &JoinKey,
    kept: &Kept,
) -> Result<SealedSystemKeys, CryptoError> {
    let list = kept.list.encode();
    let secrets = join.seal(provider, SharedUse { domain, gateway, beside: &list }, kept.secrets())?;
    Ok(SealedSystemKeys { join: join.number, list: hex(&list), secrets: hex(&secrets) })
}

/// Refuses what another join key, gateway or network sealed, and what was altered.
pub(crate) fn opened(
    provider: &dyn Provider,
    (domain, gateway): (&Domain, &SignerId),
    join: &JoinKey,
    sealed: &SealedSystemKeys,
) -> Result<Kept> {
    let damaged = || Failure::new(ErrorKind::Tampered, DAMAGED);
    let (list, secrets) = unhex(&sealed.list).zip(unhex(&sealed.secrets)).ok_or_else(damaged)?;
    let plain = join.open(provider, SharedUse { domain, gateway, beside: &list }, &secrets).map_err(|_| damaged())?;
    Kept::parse(&list, &plain).map_err(|_| damaged())
}

impl Gateway {
    /// The file that makes another machine a worker; with `renew` under a new join key, which older files do not have.
    pub async fn join_file(&self, profile: &ProfileName, secret: &SecretText, renew: bool) -> Result<SecretBytes> {
        let passphrase = Passphrase::new(secret.expose().to_owned())?;
        let make = || -> Result<Vec<u8>> { Ok(self.made_join_file(profile, renew)?.seal(&passphrase)?) };
        let made = async { block_in_place(make) };
        let act = if renew { "renew join key" } else { "make join file" };
        self.parts.log.deed(profile, act, "gateway", made).await.map(SecretBytes::new)
    }

    fn made_join_file(&self, profile: &ProfileName, renew: bool) -> Result<JoinFile> {
        let config = &self.parts.config;
        if config.store_url.is_none() {
            let text = "a gateway whose records are in a file of its home has no further workers; one on PostgreSQL has \
                        (store.url)";
            return Err(refused(text));
        }
        if config.chain_url.is_none() {
            let text = "the chain is in this home, where no other worker reaches it; serve it with `authros chain serve` in a \
                        home of its own, and set chain.url to what that prints";
            return Err(refused(text));
        }
        let notes = &self.parts.plant.ledger.notes;
        let unserved =
            || input("this gateway was never served; run `authros gateway serve` once, then make the join file");
        let pin = network_pin(&self.parts.plant.ledger.rights)?.ok_or_else(unserved)?;
        let (keyring, home) = (self.parts.home.keyring(profile), &self.parts.home);
        if !keyring.exists() {
            let text =
                format!("profile '{profile}' has no keyring here; name the one that keeps the gateway with --profile");
            return Err(input(text));
        }
        let seen = notes.read(&SharedSystemKeys {})?.ok_or_else(unserved)?;
        let list = unhex(&seen.list).and_then(|list| SystemKeyList::parse(&list).ok());
        let gateway = list.ok_or_else(|| Failure::new(ErrorKind::Tampered, DAMAGED))?.gateway;
        let join = if renew {
            let (notes, home, provider) = (notes.clone(), home.clone(), self.parts.plant.provider);
            SharedShelf { notes, home, provider, domain: pin.domain(), gateway, seen: None }.renewed()?
        } else {
            join_key(home, seen.join)?
        };
        let mut file = JoinFile::new(pin.domain(), pin.chain_id, gateway, profile.clone(), join);
        file.keyring = std::fs::read(&keyring).map_err(CryptoError::read(&keyring))?;
        file.settings = config.of_workers();
        Ok(file)
    }
}

/// Times that other workers may write first.
const ATTEMPTS: usize = 10;

impl SharedShelf {
    /// A new join key, kept here before the secrets are sealed under it.
    fn renewed(&mut self) -> Result<JoinKey> {
        let folder = self.home.gateway();
        for _ in 0..ATTEMPTS {
            let kept = self.read()?.ok_or_else(|| refused("this gateway has no system keys yet; serve it once"))?;
            let number = self.seen.as_ref().map_or(0, |seen| seen.join) + 1;
            let next = JoinKey::generate(number)?;
            next.save(&folder)?;
            let sealed = sealed(self.provider, (&self.domain, &self.gateway), &next, &kept)?;
            // After an error it may be in use, so it stays; so do older ones, for a database restored to an earlier moment.
            if self.notes.replace(&SharedSystemKeys {}, self.seen.as_ref(), &sealed)? {
                return Ok(next);
            }
            next.forget(&folder)?;
        }
        Err(refused("other workers keep changing the gateway's system keys; try again"))
    }
}

const MOST: usize = 10_000;
/// Subject of notices about an account that asks to be allowed.
pub fn subject(account: Address) -> String {
    format!("allow {account}")
}

pub struct Admissions {
    parts: Parts,
    contacts: Arc<Contacts>,
    admitted: RwLock<BTreeSet<Address>>,
    changing: tokio::sync::Mutex<()>,
}

impl Admissions {
    pub fn new(parts: &Parts, contacts: &Arc<Contacts>) -> Self {
        let (contacts, changing) = (Arc::clone(contacts), tokio::sync::Mutex::default());
        Self { parts: parts.clone(), contacts, admitted: RwLock::default(), changing }
    }

    fn list(&self) -> Result<Vec<AdmittedOwner>> {
        Ok(self.parts.plant.ledger.notes.read(&AdmittedOwners {})?.unwrap_or_default())
    }

    /// Another process of the store may change it, too.
    fn change(&self, change: impl FnOnce(&mut Vec<AdmittedOwner>)) -> Result<()> {
        let changed = |list: &mut Vec<AdmittedOwner>| {
            change(list);
            Ok::<_, StoreError>(list.clone())
        };
        self.take_over(&self.parts.plant.ledger.notes.change(&AdmittedOwners {}, changed)?);
        self.parts.hub.changed(Part::Health);
        Ok(())
    }

    fn take_over(&self, list: &[AdmittedOwner]) {
        let owners = list.iter().map(|admitted| admitted.owner).collect();
        *self.admitted.write().unwrap_or_else(PoisonError::into_inner) = owners;
    }

    /// Reads the list for [`Self::is_on_list`].
    pub fn open(&self) -> Result<()> {
        self.take_over(&self.list()?);
        Ok(())
    }

    pub fn listed(&self) -> BTreeSet<Address> {
        self.admitted.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub fn is_on_list(&self, owner: &Address) -> bool {
        self.admitted.read().unwrap_or_else(PoisonError::into_inner).contains(owner)
    }

    pub async fn admit(&self, profile: &ProfileName, owner: &Party) -> Result<Vec<AdmittedView>> {
        let owner = self.contacts.resolve(owner)?;
        {
            let _one_at_a_time = self.changing.lock().await;
            let list = self.list()?;
            if !list.iter().any(|admitted| admitted.owner == owner) {
                if list.len() >= MOST {
                    return Err(refused(format!(
                        "a gateway can allow at most {MOST} owners; remove one with `authros \
                                                gateway deny` first"
                    )));
                }
                let row = AdmittedOwner { owner, since: Timestamp::now(), by: profile.to_string() };
                let admitted = async { self.change(|list| list.push(row)) };
                self.parts.log.deed(profile, "gateway allow", &owner.to_string(), admitted).await?;
                let text = format!("the gateway allows {owner} now");
                self.parts.hub.notice_about(&subject(owner), NoticeLevel::Info, &text);
            }
        }
        self.rows()
    }

    /// Refuses the owner from the next Command on; what it sent is kept and anchored.
    pub async fn dismiss(&self, profile: &ProfileName, owner: &Party) -> Result<Vec<AdmittedView>> {
        let owner = self.contacts.resolve(owner)?;
        if self.home_accounts().contains(&owner) {
            return Err(refused(format!("{owner} is a profile of this home and may always use its gateway")));
        }
        {
            let _one_at_a_time = self.changing.lock().await;
            if !self.list()?.iter().any(|admitted| admitted.owner == owner) {
                let advice = match self.parts.config.gateway.open {
                    true => {
                        "and an open gateway serves it as a guest; set gateway.admission = \"closed\" to shut it out"
                    }
                    false => "so it is not served; `authros gateway allowed` shows the list",
                };
                return Err(input(format!("{owner} is not on this gateway's allow list, {advice}")));
            }
            let denied = async { self.change(|list| list.retain(|admitted| admitted.owner != owner)) };
            self.parts.log.deed(profile, "gateway deny", &owner.to_string(), denied).await?;
        }
        self.rows()
    }

    pub fn rows(&self) -> Result<Vec<AdmittedView>> {
        let (names, list) = (self.contacts.names()?, self.list()?);
        let row = |admitted: AdmittedOwner| AdmittedView {
            owner: admitted.owner,
            name: names.get(&admitted.owner).cloned(),
            since: admitted.since,
            by: admitted.by,
        };
        Ok(list.into_iter().map(row).collect())
    }

    /// Including profiles that are not open.
    pub fn home_accounts(&self) -> BTreeSet<Address> {
        let open = self.parts.owners.all().iter().map(|owner| owner.address).collect::<BTreeSet<_>>();
        let kept = self.parts.home.profiles().into_iter().filter_map(|profile| {
            let public = block_in_place(|| crate::crypto::read_public(&self.parts.home.keyring(&profile)));
            // An unreadable keyring is reported where it is opened.
            public.ok().map(|public| public.address)
        });
        open.into_iter().chain(kept).collect()
    }
}

const MOST_GUESTS: usize = 256;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// A profile of this home, or on the list.
    Admitted,
    /// Not admitted; the gateway is open.
    Guest,
}

impl GatewayDesk {
    pub fn standing_of(&self, network: &Network, account: &Address) -> Result<Standing, Refusal> {
        let gateway = &self.gateway;
        let own = || gateway.parts.owners.all().iter().any(|owner| owner.address == *account);
        if self.place.home_accounts.contains(account) || gateway.admissions.is_on_list(account) || own() {
            return Ok(Standing::Admitted);
        }
        // The successor of a lost account replaces it.
        if gateway.admissions.listed().iter().any(|lost| network.directory.successor(*lost) == Some(*account)) {
            return Ok(Standing::Admitted);
        }
        if self.place.open {
            return Ok(Standing::Guest);
        }
        let detail = format!("{account} is not allowed at this gateway; `authros gateway allow {account}` allows it");
        Err(Refusal { account: Some(*account), ..Refusal::new(Code::NotAdmitted, detail) })
    }

    /// Whether an account may have one more name here.
    pub fn check_name(&self, network: &Network, account: &Address, name: &ProfileName) -> Result<(), Refusal> {
        desk::check(name, account)?;
        if self.standing_of(network, account)? == Standing::Admitted {
            return Ok(());
        }
        let bound = self.gateway.parts.plant.ledger.bindings.bound_names().map_err(Refusal::internal)?;
        let own = bound.iter().filter(|bound| bound.account == *account).count();
        let known = bound.iter().any(|bound| bound.account == *account && bound.name == name.as_str());
        let most = self.gateway.parts.config.gateway.names;
        if !known && own as u64 >= most {
            return Err(self.over(account, format_args!("{most} names")));
        }
        let guests: BTreeSet<&Address> = bound
            .iter()
            .map(|bound| &bound.account)
            .filter(|owner| !self.gateway.admissions.is_on_list(owner))
            .collect();
        if own == 0 && guests.len() >= MOST_GUESTS {
            return Err(self.over(account, format_args!("{MOST_GUESTS} owners who are not on the allow list")));
        }
        Ok(())
    }

    /// Whether a guest's records fit its quotas. The caller holds off other guests' records meanwhile.
    pub fn check_quota(&self, account: &Address, records: &[Received]) -> Result<(), Refusal> {
        let (ledger, rules) = (&self.gateway.parts.plant.ledger, &self.gateway.parts.config.gateway);
        let usage = ledger.counts.usage(*account).map_err(Refusal::internal)?;
        let bytes: u64 = records.iter().map(|record| record.blob.len() as u64).sum();
        if usage.bytes.saturating_add(bytes) > rules.bytes {
            return Err(self.over(account, format_args!("{} bytes", rules.bytes)));
        }
        let mut fresh = BTreeSet::new();
        for record in records {
            let header = &record.header;
            let type_name = header.filters.first().map(|id| hex(&id.0)).unwrap_or_default();
            let place = (header.recorder, header.topic_id);
            let known = ledger.counts.has_stream(*account, place, (header.kind, &type_name, header.signer));
            if !known.map_err(Refusal::internal)? {
                fresh.insert((place.0.0, place.1.0, header.kind.code(), type_name, header.signer.0));
            }
        }
        if usage.streams.saturating_add(fresh.len() as u64) > rules.streams {
            return Err(self.over(account, format_args!("{} streams", rules.streams)));
        }
        Ok(())
    }

    fn over(&self, account: &Address, what: std::fmt::Arguments<'_>) -> Refusal {
        let how = "lifts its guest quota";
        Refusal::new(
            Code::Quota,
            format_args!("{account} has reached its quota of {what}; `authros gateway allow {account}` {how}"),
        )
    }
}
