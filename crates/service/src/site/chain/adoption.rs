//! `chain adopt`: the operator decides to continue with the chain that is there now instead of the pinned one, or on
//! the pinned one with a contract of the newest revision.

use crate::config::Config;
use crate::paths::Home;
use crate::pipeline::Plant;
use crate::service::hub::Hub;
use crate::site::audit::Log;
use crate::site::chain::connection::Connection;
use crate::site::chain::lanes::Lanes;
use crate::site::chain::link::Link;
use crate::site::identity::Profiles;
use crate::site::identity::owners::Owners;
use crate::site::mirror::remote::Remote;
use crate::site::parts::Parts;
use crate::site::progress::{Run, Runs};
use std::sync::Arc;
use std::time::Duration;

use tokio::task::block_in_place;

use crate::chain::{Chain, ChainError, ChainOptions, Endpoint, Pin, Revision};
use crate::model::Timestamp;
use crate::pipeline::adoption::{self, Step};
use crate::pipeline::{Network, Owner, watcher};
use crate::service::event::{NoticeLevel, Part};
use crate::service::failure::{input, internal, refused};
use crate::service::reply::{Failure, TransactionView};
use crate::site::NetworkState;
use crate::store::StoreError;

/// How long the command waits for the adoption record's block.
const PATIENCE: Duration = Duration::from_secs(120);
/// How long the embedded chain may take to close its file.
const CLOSING: Duration = Duration::from_secs(5);
/// How long transactions on their way to the old contract may take to arrive.
const REST: Duration = Duration::from_secs(60);
/// How often in a row nothing must be on its way.
const QUIET: usize = 5;
/// The most contracts deployed until one has an address that is not taken.
const DEPLOYMENTS: usize = 4;

/// In so many steps another chain is gone over to.
const STEPS: u64 = 6;

/// Going over to another chain or contract.
pub(in crate::site) struct Adoption {
    home: Home,
    config: Arc<Config>,
    plant: Plant,
    hub: Arc<Hub>,
    log: Arc<Log>,
    owners: Arc<Owners>,
    link: Arc<Link>,
    lanes: Arc<Lanes>,
    connection: Arc<Connection>,
    profiles: Arc<Profiles>,
    remote: Option<Arc<Remote>>,
    runs: Runs,
}

impl Adoption {
    /// From the shared parts.
    pub fn new(
        parts: &Parts,
        lanes: &Arc<Lanes>,
        connection: &Arc<Connection>,
        profiles: &Arc<Profiles>,
        remote: Option<Arc<Remote>>,
    ) -> Self {
        let Parts { home, config, plant, hub, log, owners, link, runs, .. } = parts.clone();
        Self {
            home,
            config,
            plant,
            hub,
            log,
            owners,
            link,
            lanes: Arc::clone(lanes),
            connection: Arc::clone(connection),
            profiles: Arc::clone(profiles),
            remote,
            runs,
        }
    }
}

impl Adoption {
    /// Pins the chain that answers now, with its contract (deployed if there is none), registers the owner there, and
    /// anchors the owner's adoption record before anything else.
    pub(in crate::site) async fn adopt(self: &Arc<Self>, owner: &Arc<Owner>) -> Result<TransactionView, Failure> {
        let running = self.runs.begin(&owner.profile, "chain adopt", "reaching the chain", "steps");
        running.run.expect(STEPS);
        running.run.stage(1, "reaching the chain");
        // Until the first attempt to connect has ended, which needs the lock as well.
        let known = self.link.network().await;
        let one_at_a_time = self.connection.one_at_a_time().await;
        let (pinned, outgrown) = self.to_leave(known)?;
        let subject = format!("in place of {}", pinned.contract);
        let adopted = async {
            let left = self.move_over(owner, &running.run, pinned, outgrown).await;
            drop(one_at_a_time);
            self.settle_in(owner, &running.run, left?).await
        };
        self.log.deed(&owner.profile, "adopt chain", &subject, adopted).await
    }

    /// Leaves the pinned chain for the one that answers now. The caller holds the lock of the connection.
    async fn move_over(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        run: &Run,
        pinned: Pin,
        outgrown: Option<Network>,
    ) -> Result<Left, Failure> {
        let chain = match &outgrown {
            Some(network) => network.chain.apart(),
            None => self.chain_there().await?,
        };
        run.stage(2, "finding the contract, or deploying one");
        let pin = self.contract_there(&chain, owner, &pinned).await?;
        run.stage(3, "waiting for pending transactions to the earlier contract");
        let moved = match &outgrown {
            Some(network) => self.come_to_rest(network).await,
            None => Ok(()),
        };
        run.stage(4, "recording what stays and what is anchored again");
        let left = match moved {
            Ok(()) => self.leave(&chain, pinned, &pin).await,
            Err(failure) => Err(failure),
        };
        // If nothing was left behind, the contract in use stays in use.
        if let (Err(_), Some(network)) = (&left, outgrown) {
            self.link.set(NetworkState::Up(Box::new(network)));
        }
        let left = left?;
        self.connection.save_pin(&pin)?;
        self.connection.use_network(chain, &pin).await?;
        Ok(left)
    }

    /// Registers the profiles on the adopted chain, and waits for the adoption record.
    async fn settle_in(
        self: &Arc<Self>,
        owner: &Arc<Owner>,
        run: &Run,
        left: Left,
    ) -> Result<TransactionView, Failure> {
        self.hub.changed(Part::Uploads);
        run.stage(5, "registering the profiles");
        self.profiles.register(owner).await?;
        for other in self.owners.all().iter().filter(|other| !Arc::ptr_eq(other, owner)) {
            if let Err(failure) = self.profiles.register(other).await {
                let profile = &other.profile;
                let text = format!("profile {profile} is not registered on the adopted chain yet: {}", failure.message);
                self.hub.notice(NoticeLevel::Error, &text);
            }
        }
        let network = self.link.network().await?;
        run.stage(6, "waiting until the adoption record is in a block");
        self.wait_for_word(owner, &network).await?;
        self.log.write(&owner.profile, "adopt chain", &network.domain.to_string(), "done").await?;
        let (kept, anew) = (left.kept, left.anew);
        let stays = if left.is_same_chain {
            "stay anchored in the earlier contract and are verified there"
        } else {
            "keep their anchors on the earlier chain, where they can no longer be checked from here"
        };
        let text = format!(
            "chain {} with contract {} is used from now on; {kept} {} {stays}, {anew} others are anchored here; give \
             grants and loans again",
            network.chain.chain_id(),
            network.chain.pin().map_or_else(String::new, |pin| pin.contract.to_string()),
            if left.is_same_chain { "records" } else { "verified records" },
        );
        self.hub.notice(NoticeLevel::Info, &text);
        let epoch = network.directory.epoch(owner.address);
        Ok(TransactionView { transaction: None, block: None, epoch, text })
    }

    /// The home's pin, if another chain or contract than the pinned one answers, or the contract is outdated: then with
    /// the network in use.
    fn to_leave(&self, known: Result<Network, Failure>) -> Result<(Pin, Option<Network>), Failure> {
        let swapped = matches!(*self.link.state(), NetworkState::Swapped(_));
        let pin = self.connection.pin()?;
        match pin {
            Some(pin) if swapped => Ok((pin, None)),
            Some(pin) => {
                let network = known?;
                if network.chain.revision()? < Revision::NEWEST && self.config.contract.is_none() {
                    return Ok((pin, Some(network)));
                }
                let advice = if network.chain.revision()? < Revision::NEWEST {
                    "; chain.contract names a contract of an earlier revision, leave it empty or set a newer one"
                } else {
                    ""
                };
                Err(refused(format!(
                    "the chain is the pinned one, so there is nothing to adopt{advice}; see `authros chain status`"
                )))
            }
            None => Err(input("this home is not bound to a chain yet; `authros register` binds it to the current one")),
        }
    }

    /// Sends nothing new to the old contract, and waits until transactions on their way there are in a block, as long
    /// as that is to be expected.
    async fn come_to_rest(self: &Arc<Self>, network: &Network) -> Result<(), Failure> {
        self.link.set(NetworkState::Connecting);
        let deadline = tokio::time::Instant::now() + REST;
        let mut quiet = 0usize;
        while quiet < QUIET && tokio::time::Instant::now() < deadline {
            self.lanes.tend(network).await;
            watcher::watch_round(&self.plant, network).await?;
            let mut open = 0;
            for owner in self.owners.all() {
                open += self.lanes.lane_states(&owner, network)?.iter().map(|lane| lane.open).sum::<u64>();
            }
            quiet = if open == 0 { quiet + 1 } else { 0 };
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
        Ok(())
    }

    /// A connection to whatever answers.
    async fn chain_there(&self) -> Result<Chain, Failure> {
        if let Some(remote) = &self.remote {
            return Ok(remote.chain(None, None, self.config.confirmations).await?);
        }
        let endpoint = match &self.config.chain_url {
            Some(url) => Endpoint::Node { url: url.clone() },
            None => Endpoint::Embedded { directory: self.home.chain(), consensus: self.config.consensus },
        };
        let confirmations = self.config.confirmations;
        let options = ChainOptions { endpoint, contract: None, pinned: None, confirmations };
        let deadline = tokio::time::Instant::now() + CLOSING;
        loop {
            match Chain::connect(options.clone()).await {
                // The previous attempt may still be closing the embedded chain's file.
                Err(ChainError::File { .. }) if tokio::time::Instant::now() < deadline => {
                    tokio::time::sleep(Duration::from_millis(50)).await;
                }
                answer => return Ok(answer?),
            }
        }
    }

    /// The contract to use there: the configured one, one that this home used on that chain before, the one at the
    /// pinned address, or a new one. Records must not be bound to its domain already, unless it is the very same chain.
    async fn contract_there(self: &Arc<Self>, chain: &Chain, owner: &Owner, left: &Pin) -> Result<Pin, Failure> {
        if let Some(contract) = self.config.contract {
            let pin = chain.use_contract(contract).await?;
            if adoption::domain_of(&pin) == adoption::domain_of(left) {
                return Err(refused(format!(
                    "contract {contract} has the same address on a chain with the same id and genesis block as the \
                     lost one, so old and new records could not be told apart; deploy another and set chain.contract"
                )));
            }
            return Ok(pin);
        }
        for known in self.known_contracts(chain, left)? {
            match chain.use_contract(known).await {
                // Back to a contract of an earlier revision only on a chain without anything newer of this home's.
                Ok(pin)
                    if adoption::domain_of(&pin) != adoption::domain_of(left) && !self.is_outgrown(chain, left)? =>
                {
                    return Ok(pin);
                }
                Ok(_) | Err(ChainError::NotTheContract(_)) => {}
                Err(error) => return Err(error.into()),
            }
        }
        self.connection.fund(chain, owner).await?;
        for _ in 0..DEPLOYMENTS {
            let pin = chain.deploy(&owner.eoa()).await?;
            if adoption::domain_of(&pin) != adoption::domain_of(left) {
                self.log.write(&owner.profile, "deploy", &pin.contract.to_string(), "done").await?;
                return Ok(pin);
            }
        }
        Err(internal("every new contract has the address of the lost one; please report it"))
    }

    fn known_contracts(&self, chain: &Chain, left: &Pin) -> Result<Vec<crate::model::Address>, Failure> {
        let steps = block_in_place(|| adoption::steps(&self.plant.ledger))?;
        let here = |pin: &&Pin| pin.chain_id == chain.chain_id() && pin.genesis == chain.genesis();
        let used = steps.iter().rev().flat_map(|step| [&step.to, &step.from]).filter(here);
        Ok(used.chain([left]).map(|pin| pin.contract).collect())
    }

    /// Whether the old contract is on this chain and of an earlier revision than the newest: only a newer one is worth
    /// a move.
    fn is_outgrown(&self, chain: &Chain, left: &Pin) -> Result<bool, Failure> {
        let here = (left.chain_id, left.genesis) == (chain.chain_id(), chain.genesis());
        Ok(here && self.config.contract.is_none() && chain.revision()? < Revision::NEWEST)
    }

    /// Notes that the contract, or the whole chain, was left behind: on the same chain records keep their blocks.
    async fn leave(&self, chain: &Chain, from: Pin, to: &Pin) -> Result<Left, Failure> {
        let ledger = &self.plant.ledger;
        let seen = block_in_place(|| Ok::<_, StoreError>(ledger.trail_end()?.max(ledger.cursor(watcher::CURSOR)?)))?;
        let is_same_chain = to.contract != from.contract && chain.still_has(&from, seen).await?;
        let until = if is_same_chain { Some(chain.head().await?.number) } else { None };
        block_in_place(|| {
            let mut steps = adoption::steps(ledger)?;
            let domain = adoption::domain_of(&from);
            steps.push(Step { from, to: to.clone(), at: Timestamp::now(), until });
            let text = serde_json::to_string(&steps).map_err(|error| internal(error.to_string()))?;
            let left = if is_same_chain {
                ledger.leave_contract(domain, adoption::STEPS, &text)?
            } else {
                ledger.leave_chain(domain, adoption::STEPS, &text)?
            };
            Ok::<_, Failure>(Left { kept: left.kept, anew: left.anew, is_same_chain })
        })
    }

    /// Waits until the owner's adoption record is in a block; the owner's anchoring task puts it there.
    async fn wait_for_word(&self, owner: &Owner, network: &Network) -> Result<(), Failure> {
        let deadline = tokio::time::Instant::now() + PATIENCE;
        loop {
            if block_in_place(|| adoption::is_given(&self.plant, network, owner))? {
                return Ok(());
            }
            if tokio::time::Instant::now() > deadline {
                return Err(refused(
                    "the chain is adopted, but the adoption record is not in a block yet; it is stored and anchored \
                     before anything else, see `authros chain status`",
                ));
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }
}

/// The result of the move.
struct Left {
    kept: u64,
    anew: u64,
    is_same_chain: bool,
}
