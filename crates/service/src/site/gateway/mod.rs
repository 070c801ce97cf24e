//! The gateway of a site (the paper's CR): stores what robots send, anchors it with its keeper's account, and answers
//! queries according to the chain's current grants.

#[cfg(test)]
mod admission_tests;
pub(super) mod admissions;
#[cfg(test)]
mod cut_off_tests;
pub(super) mod desk;
mod erasing;
mod reading;
pub(crate) mod workers;

use crate::site::gateway::admissions::Admissions;
use crate::site::leading;
use crate::site::mirror::remote::Remote;
use crate::site::parts::Parts;
use crate::site::sharing::Sharing;
use crate::site::storage::check_all_accounts;
use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, RwLock};
use std::time::Duration;

use tokio::sync::{oneshot, watch};
use tokio::task::block_in_place;

use crate::crypto::{Fingerprint, SmKeyPair, signer_id};
use crate::gateway::server::Sender;
use crate::gateway::{Cabinet, Context, Limits, Schedule, Server, ServerWatch};
use crate::model::{Address, AnchorMode, Domain, ProfileName, SignerId, Timestamp, natural};
use crate::pipeline::Owner;
use crate::pipeline::forwarder::Link as Line;
use crate::pipeline::intake::Anchors;
use crate::service::event::Part;
use crate::service::failure::{input, refused};
use crate::service::figures::GatewayFigures;
use crate::service::reply::{GatewayStatusView, GatewayView, RefusedView, Result, SenderView, SystemKeyView};
use crate::store::BoundName;
use crate::store::notes::HoldersSettings;

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
    fn serving(&self) -> MutexGuard<'_, Option<Serving>> {
        self.serving.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn served(&self) -> Option<GatewayView> {
        self.serving().as_ref().map(|serving| serving.view.clone())
    }

    pub fn is_serving(&self) -> bool {
        self.serving().is_some()
    }

    pub fn figures(&self) -> Option<GatewayFigures> {
        let serving = self.serving();
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
        *self.serving() = Some(Serving { view: view.clone(), watch: server.watch(), under });
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
            *gateway.serving() = None;
            gateway.parts.hub.changed(Part::Health);
        });
        let (place, first) = (Place { address: server.address(), ..place }, Mutex::new(Some(server)));
        let over = is_over.clone();
        self.parts.supervisor.keep_while(
            "gateway",
            self,
            move |_| !*is_over.borrow(),
            move |gateway| {
                let first = first.lock().unwrap_or_else(PoisonError::into_inner).take();
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
            let shelf = workers::SharedShelf { notes, home, provider, domain: *domain, gateway, seen: None };
            Cabinet::on(Box::new(shelf), context, identity, schedule, now)
        })?;
        let desk = Arc::new(GatewayDesk { gateway: Arc::clone(self), place: place.clone() });
        Server::start(*address, desk, context, cabinet, Limits::default())
            .await
            .map_err(|error| input(format!("the gateway cannot listen at {address}: {error}; choose another --listen")))
    }

    /// The keys that encrypt the transport keys of this owner's gateway here.
    pub fn kept_under(&self, owner: &Owner) -> Option<KeptUnder> {
        let serving = self.serving();
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
        let serving = self.serving();
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
