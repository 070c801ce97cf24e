//! The connection to the chain, its contract, and the pin of the home.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::oneshot;
use tokio::task::block_in_place;

use crate::chain::{
    Chain, ChainError, ChainOptions, DEFAULT_DELAY, Endpoint, LONGEST_DELAY, Pin, SHORTEST_DELAY, serve,
};
use crate::config::Config;
use crate::model::ProfileName;
use crate::paths::Home;
use crate::pipeline::{Network, Owner, PipelineError, network_pin, network_pin_in, watcher};
use crate::reply::{DeployedView, Failure, NoticeLevel, Result, ServedView, input, refused};
use crate::site::chain::link::ABOUT;
use crate::site::{NetworkState, Parts, Remote};

/// Seconds between attempts: the longest wait for a node that is back.
const LONGEST_PAUSE: u64 = 5;

pub struct Connection {
    parts: Parts,
    remote: Option<Arc<Remote>>,
    deploying: tokio::sync::Mutex<()>,
}

impl Connection {
    pub fn new(parts: &Parts, remote: Option<Arc<Remote>>) -> Self {
        Self { parts: parts.clone(), remote, deploying: tokio::sync::Mutex::default() }
    }

    pub fn pin(&self) -> Result<Option<Pin>> {
        Ok(block_in_place(|| network_pin(&self.parts.plant.ledger.rights))?)
    }

    pub async fn keep_connected(self: Arc<Self>) {
        let mut pause = 1;
        while !self.parts.life.is_stopping() {
            use NetworkState::{Connecting, Down, Off, Swapped};
            let is_lost = |state: &NetworkState| matches!(state, Connecting | Swapped(_) | Down { .. });
            let mut state = self.parts.link.follow();
            if !is_lost(&state.borrow()) {
                pause = 1;
                // An error means that the site is gone.
                drop(state.wait_for(|state| is_lost(state) || matches!(state, Off)).await);
                continue;
            }
            match self.connect().await {
                Ok(()) => {
                    if pause > 1 {
                        self.parts.hub.notice_about(ABOUT, NoticeLevel::Info, "the chain answers again");
                    }
                    continue;
                }
                Err(Lost::Swapped(failure)) => self.parts.link.lose_chain(failure),
                Err(Lost::Other(failure)) => {
                    self.parts.hub.notice_about(ABOUT, NoticeLevel::Error, &failure.message);
                    self.parts.link.lost(Down { failure, next: Instant::now() + Duration::from_secs(pause) });
                }
            }
            tokio::select! {
                () = tokio::time::sleep(Duration::from_secs(pause)) => {}
                () = self.parts.life.stopped() => return,
            }
            pause = (pause * 2).min(LONGEST_PAUSE);
        }
    }

    async fn connect(&self) -> Result<(), Lost> {
        // A deployment connects as well.
        let _one_at_a_time = self.deploying.lock().await;
        if matches!(*self.parts.link.state(), NetworkState::Up(_) | NetworkState::Bare(_) | NetworkState::Off) {
            return Ok(());
        }
        let chain = self.reach_chain().await?;
        if let Some(pin) = chain.pin() {
            return self.use_network(chain, &pin).await;
        }
        self.parts.link.set(NetworkState::Bare(chain));
        Ok(())
    }

    async fn reach_chain(&self) -> Result<Chain, Lost> {
        let config = &self.parts.config;
        let (pinned, contract) = (self.pin()?, config.contract);
        if let Some(remote) = &self.remote {
            return remote.chain((&self.parts.home, &self.parts.owners), pinned, contract).await;
        }
        let endpoint = match &config.chain_url {
            Some(url) => Endpoint::Node { url: url.clone(), roots: config.chain_roots.clone() },
            None => Endpoint::Embedded { directory: self.parts.home.chain(), consensus: config.consensus },
        };
        Ok(Chain::connect(ChainOptions { endpoint, contract, pinned }).await?)
    }

    pub async fn use_network(&self, chain: Chain, pin: &Pin) -> Result<(), Lost> {
        let network = Network::new(chain, pin, self.parts.plant.provider, self.parts.config.confirmations);
        let plant = &self.parts.plant;
        let head = if plant.ledger.lease.held().is_some() {
            block_in_place(|| watcher::restore(plant, &network))?;
            Some(watcher::watch_round(plant, &network).await?)
        } else {
            watcher::Follower::default().round(plant, &network).await?
        };
        head.into_iter().for_each(|head| self.parts.link.has_scanned(head.number));
        self.parts.link.set(NetworkState::Up(Box::new(network)));
        Ok(())
    }

    pub async fn network_or_deploy(&self, owner: &Owner) -> Result<Network> {
        self.network_or_deploy_with(owner, DEFAULT_DELAY, false).await
    }

    async fn network_or_deploy_with(&self, owner: &Owner, delay: Duration, anew: bool) -> Result<Network> {
        // The first attempt needs the lock as well.
        self.parts.link.settled().await?;
        let _one_at_a_time = self.deploying.lock().await;
        let NetworkState::Bare(chain) = self.parts.link.settled().await? else {
            return self.parts.link.network().await;
        };
        self.parts.plant.ledger.lease.require()?;
        let eoa = owner.eoa();
        if !anew {
            is_new_here(&chain, owner).await?;
        }
        self.fund(&chain, owner).await?;
        let mut deployed = chain.deploy_with(&eoa, delay, self.parts.sender.policy()).await?;
        // A refounded chain gives a contract the address of the lost one, which would mix their records. Each further
        // deployment has another address.
        while !owner.epochs(deployed.pin.domain()).is_empty() {
            deployed = chain.deploy_with(&eoa, delay, self.parts.sender.policy()).await?;
        }
        deployed.raised.into_iter().for_each(|price| self.parts.sender.note_needed(price));
        let pin = deployed.pin;
        self.use_network(chain, &pin).await?;
        self.parts.log.write(&owner.profile, "deploy", &pin.contract.to_string(), "done").await?;
        self.parts.hub.inform(&format!("contract {} deployed; {} administers it", pin.contract, owner.address));
        self.parts.link.network().await
    }

    pub async fn fund(&self, chain: &Chain, owner: &Owner) -> Result<()> {
        if self.parts.config.chain_url.is_some() && chain.fund_from_node(owner.address).await? {
            self.parts.hub.inform(&format!("the development node gave {} ether for gas", owner.address));
        }
        Ok(())
    }
}

/// Also `true` if nobody can tell: a gateway's database is not asked for it.
pub fn is_bound(home: &Home, config: &Config) -> bool {
    config.store_url.is_some() || !matches!(block_in_place(|| network_pin_in(&home.ledger())), Ok(None))
}

const MOST_COMPARED: u64 = 10_000;

/// A home that lost its ledger must not hide its first contract behind a second one.
async fn is_new_here(chain: &Chain, owner: &Owner) -> Result<()> {
    let domains = owner.domains();
    let sent = if domains.is_empty() { 0 } else { chain.nonce(owner.address, false).await? };
    if sent == 0 {
        return Ok(());
    }
    let mut contracts = (0..sent.min(MOST_COMPARED)).map(|nonce| chain.created_by(owner.address, nonce));
    let Some(contract) = contracts.find(|contract| domains.contains(&chain.domain_of(*contract))) else {
        return Ok(());
    };
    if !chain.has_contract(contract).await? {
        return Ok(());
    }
    Err(refused(format!(
        "the account of '{}' has used a contract on this chain before, and this home does not know it any more: restore \
         the last backup of the home, or name the contract with --contract (or chain.contract): {contract}; nothing was \
         deployed (`authros chain deploy` deploys a new one all the same)",
        owner.profile
    )))
}

pub enum Lost {
    /// Another chain answers, or the embedded one lost its file.
    Swapped(Failure),
    Other(Failure),
}

impl From<ChainError> for Lost {
    fn from(error: ChainError) -> Self {
        PipelineError::from(error).into()
    }
}

impl From<PipelineError> for Lost {
    fn from(error: PipelineError) -> Self {
        let is_swapped = matches!(error, PipelineError::Chain(ChainError::Swapped { .. } | ChainError::Gone { .. }));
        if is_swapped { Self::Swapped(error.into()) } else { Self::Other(error.into()) }
    }
}

impl From<Lost> for Failure {
    fn from(lost: Lost) -> Self {
        match lost {
            Lost::Swapped(failure) | Lost::Other(failure) => failure,
        }
    }
}

impl From<Failure> for Lost {
    fn from(failure: Failure) -> Self {
        Self::Other(failure)
    }
}

impl Connection {
    pub async fn deploy_contract(&self, owner: &Owner, delay: Option<u64>) -> Result<DeployedView> {
        let delay = delay.map_or(DEFAULT_DELAY, Duration::from_secs);
        if !(SHORTEST_DELAY..=LONGEST_DELAY).contains(&delay) {
            return Err(input("the succession delay must be between 1 and 365 days; give another --delay"));
        }
        self.parts.link.chain().await?;
        if let NetworkState::Up(network) = &*self.parts.link.state() {
            let contract = network.chain.pin().map_or_else(|| "a contract".to_owned(), |pin| pin.contract.to_string());
            return Err(input(format!(
                "{contract} is already pinned for this home, nothing was deployed; use another --home for another one"
            )));
        }
        let network = self.network_or_deploy_with(owner, delay, true).await?;
        let pin = network.chain.pin().ok_or_else(|| input("the chain has stopped; run the command again"))?;
        Ok(DeployedView { pin, administrator: owner.address })
    }

    pub async fn serve_chain(
        self: &Arc<Self>,
        profile: &ProfileName,
        address: SocketAddr,
        ended: oneshot::Receiver<()>,
    ) -> Result<ServedView> {
        let chain = self.parts.link.chain().await?;
        if self.parts.config.chain_url.is_some() {
            return Err(input(format!("this site uses the node at {}; point other tools there", chain.url())));
        }
        let listener = serve::listen(address).await?;
        let (by, subject) = (profile.clone(), address.to_string());
        self.parts.log.write(profile, "serve chain", &subject, "begun").await?;
        let address = listener.local_addr().map_err(|error| input(format!("no address to listen on: {error}")))?;
        let view = ServedView {
            url: format!("http://{address}"),
            chain_id: chain.chain_id(),
            contract: chain.pin().map(|pin| pin.contract),
        };
        self.parts.hub.inform(&format!("the chain is available to tools on this machine at {}", view.url));
        let connection = Arc::clone(self);
        tokio::spawn(async move {
            let stop = async {
                tokio::select! {
                    () = connection.parts.life.stopped() => {}
                    _ = ended => {}
                }
            };
            let served = chain.serve(listener, stop).await.map_err(Failure::from);
            if let Err(failure) = connection.parts.log.ended(&by, "serve chain", &subject, served).await {
                connection.parts.hub.alarm(&failure.message);
            }
        });
        Ok(view)
    }
}
