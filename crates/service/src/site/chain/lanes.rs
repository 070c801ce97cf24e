//! The accounts that anchor for each owner: the owner's own and extra ones.

use crate::site::chain::link;
use crate::site::parts::Parts;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::crypto::EoaSecret;
use crate::model::{Address, Domain};
use crate::pipeline::anchorer::{self, MOST_LANES};
use crate::pipeline::sender::LaneState;
use crate::pipeline::{Network, Owner};
use crate::service::failure::refused;
use crate::service::reply::Result;

const LOOK: Duration = Duration::from_secs(2);

type Derived = std::collections::HashMap<(Address, Domain), Arc<Vec<(Address, EoaSecret)>>>;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pause {
    pub text: String,
    /// Somebody has to do something about it.
    pub is_alarm: bool,
}

pub struct Lanes {
    parts: Parts,
    extra: Mutex<Derived>,
}

impl Lanes {
    pub fn new(parts: &Parts) -> Self {
        Self { parts: parts.clone(), extra: Mutex::default() }
    }

    fn extra(&self, owner: &Owner, network: &Network) -> Result<Arc<Vec<(Address, EoaSecret)>>> {
        let mut known = self.extra.lock().unwrap_or_else(PoisonError::into_inner);
        let key = (owner.address, network.domain);
        if let Some(found) = known.get(&key) {
            return Ok(Arc::clone(found));
        }
        let keys = anchorer::extra(&owner.eoa(), &network.domain, MOST_LANES)?;
        let found = Arc::new(keys.into_iter().map(|key| (key.address(), key)).collect::<Vec<_>>());
        known.insert(key, Arc::clone(&found));
        Ok(found)
    }

    pub fn of(&self, owner: &Owner, network: &Network) -> Result<Vec<EoaSecret>> {
        let mut lanes = vec![owner.eoa()];
        if self.parts.config.lanes > 1 {
            let wanted = usize::from(self.parts.config.lanes) - 1;
            let extra = self.extra(owner, network)?;
            let ready = extra.iter().take(wanted).filter(|(account, _)| network.directory.identity(*account).is_ok());
            lanes.extend(ready.map(|(_, key)| key.clone()));
        }
        Ok(lanes)
    }

    /// Also finds extra accounts that the settings no longer use; `None` = the owner's own.
    pub fn key(&self, owner: &Owner, network: &Network, account: Option<Address>) -> Result<EoaSecret> {
        let Some(account) = account.filter(|account| *account != owner.address) else { return Ok(owner.eoa()) };
        let extra = self.extra(owner, network)?;
        let found = extra.iter().find(|(other, _)| *other == account).map(|(_, key)| key.clone());
        found.ok_or_else(|| {
            refused(format!(
                "{account} does not anchor for {}; `authros chain status` lists the accounts that do",
                owner.profile
            ))
        })
    }

    pub fn lane_states(&self, owner: &Owner, network: &Network) -> Result<Vec<LaneState>> {
        let mut states = vec![self.parts.sender.state_of(owner.address)?];
        let wanted = usize::from(self.parts.config.lanes).saturating_sub(1);
        for (index, (account, _)) in self.extra(owner, network)?.iter().enumerate() {
            let state = self.parts.sender.state_of(*account)?;
            if index < wanted || state.open > 0 {
                states.push(state);
            }
        }
        Ok(states)
    }

    /// What pauses each open owner's lanes; the worst, if several are paused.
    pub fn pauses(&self, network: &Network) -> Vec<(Address, Option<Pause>)> {
        let pause = |owner: &Arc<Owner>| {
            let lanes = self.lane_states(owner, network).unwrap_or_default().into_iter();
            let paused = lanes.filter_map(|lane| {
                let reason = lane.paused?;
                Some(Pause { text: reason.text(lane.account), is_alarm: reason.is_alarm() })
            });
            (owner.address, paused.max_by_key(|pause| pause.is_alarm))
        };
        self.parts.owners.all().iter().map(pause).collect()
    }

    pub async fn tend(&self, network: &Network) {
        for owner in self.parts.owners.all() {
            if let Err(failure) = self.tend_lanes_of(&owner, network).await {
                let text = format!("transactions of {} are waiting: {}", owner.profile, failure.message);
                link::tell_trouble(&self.parts.hub, failure.kind, &text);
            }
        }
    }

    async fn tend_lanes_of(&self, owner: &Owner, network: &Network) -> Result<()> {
        let mut keys = vec![owner.eoa()];
        for (account, key) in self.extra(owner, network)?.iter() {
            // Includes those above a lowered setting.
            let state = self.parts.sender.state_of(*account)?;
            if state.open > 0 || state.paused.is_some() {
                keys.push(key.clone());
            }
        }
        for key in keys {
            for reason in self.parts.sender.tend(&network.chain, &key).await? {
                self.parts.hub.alarm(&format!("the contract rejected a transaction of {}: {reason}", owner.profile));
            }
        }
        Ok(())
    }

    pub async fn keep_extra(self: Arc<Self>, owner: Arc<Owner>) {
        while !self.parts.life.is_stopping() && self.parts.owners.is_open(&owner) {
            if let Some(network) = self.parts.link.network_now()
                && network.directory.identity(owner.address).is_ok()
                && let Err(failure) = self.ready_extra(&owner, &network).await
            {
                let text = format!("an extra anchoring account of {} is not ready: {}", owner.profile, failure.message);
                self.parts.hub.warn(&text);
            }
            if !self.parts.life.beat(LOOK).await {
                return;
            }
        }
    }

    async fn ready_extra(&self, owner: &Owner, network: &Network) -> Result<()> {
        let wanted = usize::from(self.parts.config.lanes) - 1;
        for (_, key) in self.extra(owner, network)?.iter().take(wanted) {
            anchorer::ensure_ready(&self.parts.plant, network, &self.parts.sender, owner, key).await?;
        }
        Ok(())
    }
}
