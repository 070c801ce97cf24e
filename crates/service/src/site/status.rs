//! The site at a glance: health in words, records by state, the chain.

use std::sync::Arc;
use std::time::Instant;

use tokio::task::block_in_place;

use crate::chain::{Call, Chain, Priced, Shortfall, offered};
use crate::durability;
use crate::model::{Address, Hash, ProfileName, RecordState, Wei, clean, counted, without_secrets};
use crate::pipeline::LaneState;
use crate::pipeline::forwarder::Link as Line;
use crate::pipeline::stages::Milestone;
use crate::pipeline::watcher::foreign;
use crate::reply::{
    ChainView, GasView, HealthLevel, LifeLine, PartHealth, PricesView, QueueView, Result, SiteView, WaitingView,
};
use crate::site::chain::link::Pause;
use crate::site::{Administering, NetworkState, RosState, Site};
use crate::store::StateCounts;

const GAS_OVER: u64 = 100;
const WAITING_SHOWN: usize = 20;

impl Site {
    pub(super) async fn site_view(&self, profile: &ProfileName) -> Result<SiteView> {
        let robots = match &*self.ros.state() {
            RosState::Up(link) => link.robots,
            _ => 0,
        };
        let (alerts, alerts_over) = self.alerts.shown();
        Ok(SiteView {
            health: block_in_place(|| self.parts_health())?,
            life: block_in_place(|| self.life_line(profile))?,
            robots,
            profiles: self.parts.owners.all().iter().map(|owner| owner.profile.clone()).collect(),
            process: std::process::id(),
            tasks: self.parts.supervisor.views(),
            cache: self.plant.ciphertext.cache(),
            queue: self.queue_view(),
            verified_after: self.parts.hub.stages.spread(Milestone::Verified),
            alerts,
            alerts_over,
        })
    }

    /// The one source of health for status, figures and alerts.
    pub(super) fn parts_health(&self) -> Result<Vec<PartHealth>> {
        if let Some(original) = self.home().original() {
            let text = format!("{} is read-only: this is its last state, and nothing is running", original.display());
            return Ok(vec![
                PartHealth::new("home", HealthLevel::Absent, &text),
                self.chain_health(),
                self.store_health()?,
            ]);
        }
        let mut health = vec![self.ros_health(), self.chain_health(), self.store_health()?];
        health.extend(self.lease_health()?);
        health.extend(self.cache_health());
        health.push(self.gateway_health());
        health.extend(self.ros.second.health().map(|(level, text)| PartHealth::new("ros 2", level, &text)));
        health.extend(self.clock.health());
        health.extend(self.stamps.health()?);
        health.extend(self.chain_proofs.health()?);
        let found = foreign::recent(&self.plant)?;
        health.extend(found.map(|found| PartHealth {
            since: Some(found.noted),
            ..PartHealth::new("account", HealthLevel::Failed, &foreign::text(&found))
        }));
        health.extend(self.sharing.missing_text().map(|text| PartHealth::new("keys", HealthLevel::Failed, &text)));
        let faults = self.profiles.keyring_faults()?;
        health.extend(faults.iter().map(|(_, text)| PartHealth::new("keyring", HealthLevel::Failed, text)));
        health.extend(self.standstill.health());
        health.extend(self.devices.untold_text().map(|text| PartHealth::new("robots", HealthLevel::Failed, &text)));
        Ok(health)
    }

    pub(super) fn queue_view(&self) -> QueueView {
        let (messages, bytes) = self.rings.depth();
        let count = |number: usize| u64::try_from(number).unwrap_or(u64::MAX);
        QueueView { messages: count(messages), bytes: count(bytes), capacity: count(self.rings.capacity()) }
    }

    fn ros_health(&self) -> PartHealth {
        let (level, text) = match &*self.ros.state() {
            RosState::Off => (HealthLevel::Absent, "not running in this site".to_owned()),
            RosState::Starting => (HealthLevel::Waiting, "starting".to_owned()),
            RosState::Up(link) if link.embedded => (
                HealthLevel::Ok,
                format!("embedded master at {}, {}", link.uri, counted(link.robots.into(), "SIMULATED robot")),
            ),
            RosState::Up(link) => (HealthLevel::Ok, link.uri.clone()),
            RosState::Down { failure, .. } => (HealthLevel::Failed, failure.message.clone()),
        };
        PartHealth::new("ros", level, &text)
    }

    fn chain_health(&self) -> PartHealth {
        let name = match self.joined.chain_text() {
            Some(text) => text,
            None => self.parts.config.chain_url.as_deref().map_or_else(|| "embedded chain".to_owned(), without_secrets),
        };
        let silent = self.parts.link.is_silent();
        let (level, text) = match &*self.parts.link.state() {
            NetworkState::Off => (HealthLevel::Absent, "not running in this site".to_owned()),
            NetworkState::Connecting => (HealthLevel::Waiting, format!("connecting to {name}")),
            NetworkState::Bare(_) => (HealthLevel::Ok, format!("{name}, no contract yet")),
            NetworkState::Up(_) if silent => (HealthLevel::Waiting, format!("{name} does not answer, retry in 2 s")),
            NetworkState::Up(network) => return lanes_health(&self.lanes.pauses(network), &name),
            NetworkState::Swapped(failure) => (HealthLevel::Failed, failure.message.clone()),
            NetworkState::Down { failure, next } => {
                let left = next.saturating_duration_since(Instant::now());
                // A started second counts as one.
                let retry = left.as_millis().div_ceil(1_000).try_into().unwrap_or(u64::MAX).max(1);
                let text = format!("retry in {retry} s: {}", failure.message);
                return PartHealth { retry: Some(retry), ..PartHealth::new("chain", HealthLevel::Failed, &text) };
            }
        };
        PartHealth::new("chain", level, &text)
    }

    fn store_health(&self) -> Result<PartHealth> {
        Ok(match self.storage.fault()? {
            Some(text) => PartHealth::new("store", HealthLevel::Failed, &text),
            None => match self.plant.ledger.inspection.durability()? {
                Some(found) => {
                    let (level, text) = durability::worth(&found, self.parts.config.store_standbys);
                    PartHealth::new("store", level, &text)
                }
                None => PartHealth::new("store", HealthLevel::Ok, "rows and ciphertext in one file"),
            },
        })
    }

    /// A missing cache only costs time.
    fn cache_health(&self) -> Option<PartHealth> {
        let state = self.plant.ciphertext.cache()?;
        let (level, since) = match &state.away {
            Some(away) => (HealthLevel::Absent, Some(away.since)),
            None => (HealthLevel::Ok, None),
        };
        Some(PartHealth { since, ..PartHealth::new("cache", level, &state.line()) })
    }

    fn gateway_health(&self) -> PartHealth {
        match self.gateway.line() {
            Some(Line::Connecting) => return PartHealth::new("gateway", HealthLevel::Waiting, "connecting"),
            Some(Line::Up) => return PartHealth::new("gateway", HealthLevel::Ok, "connected"),
            Some(Line::InPlace(text)) => return PartHealth::new("gateway", HealthLevel::Ok, &text),
            Some(Line::Away(text)) => return PartHealth::new("gateway", HealthLevel::Waiting, &text),
            Some(Line::Refused(text)) => return PartHealth::new("gateway", HealthLevel::Failed, &text),
            None => {}
        }
        match self.gateway.served() {
            Some(view) => PartHealth::new(
                "gateway",
                HealthLevel::Ok,
                &format!("{}, fingerprint {}, anchors as {}", view.address, view.fingerprint, view.account),
            ),
            None => {
                PartHealth::new("gateway", HealthLevel::Absent, "not running; start one with `authros gateway serve`")
            }
        }
    }

    fn life_line(&self, profile: &ProfileName) -> Result<LifeLine> {
        let owner = match self.parts.owners.address_of(profile) {
            Ok(owner) => Some(owner),
            // Where its keyring cannot be read, the store knows whose records these are.
            Err(_) => self.profiles.known_accounts()?.get(profile).and_then(|accounts| accounts.last().copied()),
        };
        let Some(owner) = owner else { return Ok(LifeLine { conserved: true, ..LifeLine::default() }) };
        self.life_line_of(owner, &self.losses.counts(&self.plant, owner)?)
    }

    /// An account's records by state, from its counts.
    pub(super) fn life_line_of(&self, owner: Address, counts: &StateCounts) -> Result<LifeLine> {
        let (waiting, _) = self.rings.depth();
        let at_least = |least: RecordState| -> u64 {
            let states =
                RecordState::ALL.iter().copied().filter(|state| *state >= least && *state <= RecordState::Verified);
            states.map(|state| counts.data_in(state)).sum()
        };
        let tampered = counts.data_in(RecordState::Tampered);
        let right_ended = counts.data_in(RecordState::RightEnded);
        let dropped = counts.data_in(RecordState::Dropped);
        Ok(LifeLine {
            captured: counts.captured(),
            stored: at_least(RecordState::Stored) + tampered + right_ended,
            anchored: at_least(RecordState::Mined) + tampered,
            confirmed: at_least(RecordState::Confirmed) + tampered,
            verified: counts.data_in(RecordState::Verified),
            pending: counts.pending(),
            right_ended,
            quarantined: counts.data_in(RecordState::Quarantined),
            dropped,
            lost_in_recorder: counts.lost_in_recorder,
            discarded: dropped.saturating_sub(counts.lost_in_recorder),
            tampered,
            lost_in_transport: counts.lost_in_transport,
            waiting: waiting as u64,
            deleted: self.plant.ledger.retention.given_up(owner)?,
            conserved: counts.is_conserved(),
        })
    }

    pub(super) async fn chain_view(self: &Arc<Self>, profile: &ProfileName) -> Result<ChainView> {
        let chain = self.parts.link.chain().await?;
        let path = self.parts.home.keyring(profile);
        let address = match self.parts.owners.get(profile) {
            Some(owner) => Some(owner.address),
            None if path.exists() => Some(block_in_place(|| crate::crypto::read_public(&path))?.address),
            None => None,
        };
        let status = chain.status(address).await?;
        let network = self.parts.link.network_now();
        let lanes = match (self.parts.owners.get(profile), &network, address) {
            (Some(owner), Some(network), _) => self.lanes.lane_states(&owner, network)?,
            (_, _, Some(address)) => vec![self.parts.sender.state_of(address)?],
            (_, _, None) => Vec::new(),
        };
        // Rows already in a block, but not examined yet, no longer wait.
        let open = address.map(|address| self.plant.ledger.lanes.open_lane(address)).transpose()?;
        let (names, limits) = (self.contacts.names()?, self.parts.sender.limits());
        let nonce = status.nonce.unwrap_or(0);
        let pending = open.iter().flatten().filter(|row| row.nonce >= nonce).count() as u64;
        Ok(ChainView {
            kind: status.kind,
            consensus: status.consensus,
            chain_id: status.chain_id,
            genesis: status.genesis,
            block: status.block,
            contract: status.contract,
            balance: status.balance.unwrap_or_else(|| "0".to_owned()),
            nonce,
            pending,
            gas: block_in_place(|| self.gas_of(&lanes))?,
            waiting: block_in_place(|| self.waiting_in(&lanes))?,
            lacks: match address {
                Some(address) => self.lacks(&chain, address).await,
                None => None,
            },
            prices: PricesView { min_price: Wei(limits.floor), max_fee: limits.cap.map(Wei) },
            lanes,
            client: clean(&status.client, 100),
            through: self.joined.chain_text().map(|text| clean(&text, 300)),
            administration: network.map(|network| Administering::view(&network, address, &names)).unwrap_or_default(),
            sealing: chain.sealing().await?,
        })
    }

    /// What the account lacks for its next anchor; if the node does not say, sending will.
    async fn lacks(&self, chain: &Chain, account: Address) -> Option<Shortfall> {
        let anchor = Call::Anchor { root: Hash([0; 32]), count: 1, previous: Hash([0; 32]) };
        let market = chain.market().await.ok()?;
        let Priced::At(price) = self.parts.sender.limits().fresh(&market) else { return None };
        let shortfall = chain.shortfall(account, &anchor, price).await.ok()?;
        Some(shortfall).filter(|shortfall| shortfall.held < shortfall.needed)
    }

    fn waiting_in(&self, lanes: &[LaneState]) -> Result<Vec<WaitingView>> {
        let mut views = Vec::new();
        for lane in lanes {
            let left = WAITING_SHOWN.saturating_sub(views.len());
            for row in self.plant.ledger.lanes.open_lane(lane.account)?.into_iter().take(left) {
                let raw = self.plant.ledger.lanes.raw_transaction(row.hash)?.unwrap_or_default();
                let price = Wei(offered(&raw).map_or(0, |offer| offer.price));
                let (account, nonce, purpose) = (lane.account, row.nonce, row.purpose);
                views.push(WaitingView { account, nonce, purpose, price });
            }
        }
        Ok(views)
    }

    fn gas_of(&self, lanes: &[LaneState]) -> Result<GasView> {
        let mut view = GasView::default();
        for lane in lanes {
            let left = GAS_OVER.saturating_sub(view.transactions);
            let (transactions, gas, records) = self.plant.ledger.lanes.anchoring_gas(lane.account, left)?;
            view.transactions += transactions;
            view.gas += gas;
            view.records += records;
        }
        Ok(view)
    }
}

/// All alarms, or else what is waited for; and the accounts that go on meanwhile.
fn lanes_health(pauses: &[(Address, Option<Pause>)], name: &str) -> PartHealth {
    let paused: Vec<&Pause> = pauses.iter().filter_map(|(_, pause)| pause.as_ref()).collect();
    let is_alarm = paused.iter().any(|pause| pause.is_alarm);
    let texts: Vec<&str> =
        paused.iter().filter(|pause| pause.is_alarm == is_alarm).map(|pause| pause.text.as_str()).collect();
    let (level, text) = match (texts.is_empty(), is_alarm) {
        (true, _) => return PartHealth::new("chain", HealthLevel::Ok, name),
        (false, true) => (HealthLevel::Failed, texts.join("; ")),
        (false, false) => (HealthLevel::Waiting, texts.join("; ")),
    };
    let unaffected = pauses.iter().filter(|(_, pause)| pause.is_none()).map(|(account, _)| *account).collect();
    PartHealth { unaffected, ..PartHealth::new("chain", level, &text) }
}

#[cfg(test)]
mod lanes_tests {
    use super::*;

    #[test]
    fn every_paused_account_is_named_and_those_that_go_on_are_listed() {
        let pause = |text: &str, is_alarm| Some(Pause { text: text.to_owned(), is_alarm });
        let [one, two, three] = [1, 2, 3].map(|number| Address([number; 20]));
        let view = |first, second| {
            let part = lanes_health(&[(one, first), (two, second), (three, None)], "a node");
            (part.level, part.text, part.unaffected)
        };
        assert_eq!(view(None, None), (HealthLevel::Ok, "a node".to_owned(), Vec::new()));
        let both = view(pause("no ether", true), pause("refused", true));
        assert_eq!(both, (HealthLevel::Failed, "no ether; refused".to_owned(), vec![three]));
        let worse = view(pause("catching up", false), pause("refused", true));
        assert_eq!(worse, (HealthLevel::Failed, "refused".to_owned(), vec![three]), "the wait hides no alarm");
        let waits = view(pause("catching up", false), None);
        assert_eq!(waits, (HealthLevel::Waiting, "catching up".to_owned(), vec![two, three]));
    }
}
