//! `chain adopt`: the operator decides to go on with the chain that is there now instead of the pinned one.

use std::sync::Arc;
use std::time::Duration;

use tokio::task::block_in_place;

use super::{NetworkState, Site};
use crate::chain::{Chain, ChainError, ChainOptions, Endpoint, Pin};
use crate::model::Timestamp;
use crate::pipeline::adoption::{self, Step};
use crate::pipeline::{Network, Owner};
use crate::service::event::{NoticeLevel, Part};
use crate::service::failure::{input, internal, refused};
use crate::service::reply::{Failure, TransactionView};
use crate::store::StoreError;

/// How long the command waits for the adoption record's block.
const PATIENCE: Duration = Duration::from_secs(120);
/// How long the embedded chain's file may take to be closed.
const CLOSING: Duration = Duration::from_secs(5);
/// How many contracts are deployed at most until one has an address of its own.
const DEPLOYMENTS: usize = 4;

impl Site {
    /// Pins the chain that answers now, with its contract (deployed where there is none), registers the owner
    /// there, and anchors the owner's adoption record before anything else.
    pub(super) async fn adopt_chain(self: &Arc<Self>, owner: &Arc<Owner>) -> Result<TransactionView, Failure> {
        // Until the first attempt to connect has ended, which needs the lock as well.
        let known = self.network().await;
        let left = {
            let _one_at_a_time = self.deploying.lock().await;
            let pinned = self.pinned_elsewhere(known)?;
            self.audit_first(owner, "adopt chain", &format!("in place of {}", pinned.contract)).await?;
            let chain = self.chain_there().await?;
            let pin = self.contract_there(&chain, owner, &pinned).await?;
            let left = self.leave(pinned, &pin)?;
            self.save_pin(&pin)?;
            self.use_network(chain, &pin).await?;
            left
        };
        self.changed(Part::Uploads);
        self.register(owner).await?;
        for other in self.all_owners().iter().filter(|other| !Arc::ptr_eq(other, owner)) {
            if let Err(failure) = self.register(other).await {
                let profile = &other.profile;
                let text = format!("profile {profile} is not registered on the adopted chain yet: {}", failure.message);
                self.hub.notice(NoticeLevel::Error, &text);
            }
        }
        let network = self.network().await?;
        self.wait_for_word(owner, &network).await?;
        self.record_audit(&owner.profile, "adopt chain", &network.domain.to_string(), "done").await?;
        let (kept, anew) = (left.kept, left.anew);
        let text = format!(
            "chain {} with contract {} is used from now on; {kept} verified records keep their anchors on the earlier \
             chain, where they can no longer be checked from here, {anew} others are anchored here; grants are to be \
             given again",
            network.chain.chain_id(),
            network.chain.pin().map_or_else(String::new, |pin| pin.contract.to_string()),
        );
        self.hub.notice(NoticeLevel::Info, &text);
        let epoch = network.directory.epoch(owner.address);
        Ok(TransactionView { transaction: None, block: None, epoch, text })
    }

    /// The home's pin, where another chain than the pinned one answers.
    fn pinned_elsewhere(&self, known: Result<Network, Failure>) -> Result<Pin, Failure> {
        let swapped = matches!(*self.network.borrow(), NetworkState::Swapped(_));
        let pin = self.pin()?;
        match pin {
            Some(pin) if swapped => Ok(pin),
            Some(_) => {
                known?;
                Err(refused("the chain is the pinned one, so there is nothing to adopt; see `authros chain status`"))
            }
            None => {
                Err(input("this home is bound to no chain yet; `authros register` binds it to the one that is there"))
            }
        }
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
                // The attempt before may still be closing the embedded chain's file.
                Err(ChainError::File { .. }) if tokio::time::Instant::now() < deadline => {
                    tokio::time::sleep(Duration::from_millis(50)).await;
                }
                answer => return Ok(answer?),
            }
        }
    }

    /// The contract to use there: the configured one, one that this home used on that chain before, the one at the
    /// pinned address, or a new one. Its domain must not be one that records are bound to already, unless it is
    /// the very same chain.
    async fn contract_there(self: &Arc<Self>, chain: &Chain, owner: &Owner, left: &Pin) -> Result<Pin, Failure> {
        if let Some(contract) = self.config.contract {
            let pin = chain.use_contract(contract).await?;
            if adoption::domain_of(&pin) == adoption::domain_of(left) {
                return Err(refused(format!(
                    "contract {contract} has the same address on a chain with the same id and genesis block as the \
                     one that was lost, so old and new records could not be told apart; deploy another and set \
                     chain.contract"
                )));
            }
            return Ok(pin);
        }
        for known in self.known_contracts(chain, left)? {
            match chain.use_contract(known).await {
                Ok(pin) if adoption::domain_of(&pin) != adoption::domain_of(left) => return Ok(pin),
                Ok(_) | Err(ChainError::NotTheContract(_)) => {}
                Err(error) => return Err(error.into()),
            }
        }
        self.fund(chain, owner).await?;
        for _ in 0..DEPLOYMENTS {
            let pin = chain.deploy(&owner.eoa()).await?;
            if adoption::domain_of(&pin) != adoption::domain_of(left) {
                self.record_audit(&owner.profile, "deploy", &pin.contract.to_string(), "done").await?;
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

    fn leave(&self, from: Pin, to: &Pin) -> Result<crate::store::Left, Failure> {
        block_in_place(|| {
            let mut steps = adoption::steps(&self.plant.ledger)?;
            let domain = adoption::domain_of(&from);
            steps.push(Step { from, to: to.clone(), at: Timestamp::now() });
            let text = serde_json::to_string(&steps).map_err(|error| internal(error.to_string()))?;
            Ok::<_, Failure>(self.plant.ledger.leave_chain(domain, adoption::STEPS, &text)?)
        })
    }

    /// Waits until the owner's adoption record stands in a block; the owner's anchoring task puts it there.
    async fn wait_for_word(&self, owner: &Owner, network: &Network) -> Result<(), Failure> {
        let deadline = tokio::time::Instant::now() + PATIENCE;
        loop {
            if block_in_place(|| adoption::is_given(&self.plant, network, owner))? {
                return Ok(());
            }
            if tokio::time::Instant::now() > deadline {
                return Err(refused(
                    "the chain is adopted, but the adoption record is not in a block yet; it is kept and anchored \
                     before everything else, look at `authros chain status`",
                ));
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }

    /// The network with everything bound to it, and what this home was bound to before.
    pub(super) fn network_of(&self, chain: Chain, pin: &Pin) -> Result<Network, StoreError> {
        let domain = adoption::domain_of(pin);
        let directory = Arc::new(crate::pipeline::Directory::new(domain, self.plant.provider));
        let earlier = Arc::new(block_in_place(|| adoption::earlier(&self.plant.ledger, domain))?);
        Ok(Network { chain, domain, directory, earlier, confirmations: self.config.confirmations })
    }
}
