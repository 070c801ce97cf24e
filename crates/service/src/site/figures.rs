//! Fills in and serves the site's figures. At most one look a second reads the ledger, however often anybody asks.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpListener;
use tokio::sync::{Mutex, Semaphore};

use crate::config::FiguresPlace;
use crate::crypto::signer_id;
use crate::figures::{BOUNDS, Figures, GrantFigures, Latency, OwnerFigures, RobotFigures, TopicFigures, short};
use crate::model::steady_clock::look;
use crate::model::{Address, Timestamp};
use crate::pipeline::stages::{Milestone, Stage};
use crate::pipeline::{LaneState, audit_head};
use crate::reply::{GrantState, HealthLevel, Result};
use crate::site::{Site, blocking};
use crate::store::StateCounts;
use crate::store::files::free_bytes;
use crate::{figures, socket};

const FRESH: Duration = Duration::from_secs(1);
const AGAIN: Duration = Duration::from_secs(5);
/// Most accounts, robots, topics and grants with figures of their own; grants given and received count separately.
const MOST_OWNERS: usize = 64;
const MOST_ROBOTS: usize = 256;
const MOST_TOPICS: usize = 200;
const MOST_GRANTS: usize = 64;

type Kept = Mutex<Option<(Instant, Arc<str>)>>;

impl Site {
    /// Starts what only a lasting site has: alerts, figures, and the operators' socket.
    pub fn oversee(self: &Arc<Self>) {
        self.parts.life.stay();
        self.watch_for_alerts();
        if self.config().metrics.listen.is_some() {
            drop(self.parts.supervisor.keep("metrics", self, Self::serve_figures));
        }
        if self.config().operators.socket.is_some() {
            drop(self.parts.supervisor.keep("operators", self, Self::serve_operators));
        }
    }

    /// Whether it stays, instead of ending with the command that it runs for.
    pub fn is_to_stay(&self) -> bool {
        self.parts.life.is_to_stay()
    }

    async fn serve_figures(self: Arc<Self>) {
        let Some(place) = self.config().metrics.listen.clone() else { return };
        while !self.parts.life.is_stopping() {
            let failed = match &place {
                FiguresPlace::Address { address, open } => match TcpListener::bind(address).await {
                    Ok(listener) => self.answer_readers(*open, || async { Ok(listener.accept().await?.0) }).await,
                    Err(error) => format!("{address}: {error}"),
                },
                FiguresPlace::Socket(path) => match socket::bind(path, 0o600) {
                    Ok(listener) => self.answer_readers(true, || async { Ok(listener.accept().await?.0) }).await,
                    Err(error) => format!("{}: {error}", path.display()),
                },
            };
            if self.parts.life.is_stopping() {
                return;
            }
            let text = format!("metrics cannot be served at {failed}; choose another metrics.listen, or free it");
            self.parts.hub.alarm(&text);
            self.parts.life.rest(AGAIN).await;
        }
    }

    /// Answers until the site ends, or accepting fails: then returns why.
    async fn answer_readers<S, Accepted>(self: &Arc<Self>, any_host: bool, accept: impl Fn() -> Accepted) -> String
    where
        S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
        Accepted: Future<Output = std::io::Result<S>>,
    {
        let (places, kept) = (Arc::new(Semaphore::new(figures::MOST)), Arc::new(Kept::default()));
        loop {
            // Without a free place, the next peer waits before it is accepted.
            let Ok(place) = Arc::clone(&places).acquire_owned().await else { return String::new() };
            let stream = tokio::select! {
                stream = accept() => stream,
                () = self.stopped() => return String::new(),
            };
            let stream = match stream {
                Ok(stream) => stream,
                Err(error) => return error.to_string(),
            };
            let (site, kept) = (Arc::clone(self), Arc::clone(&kept));
            tokio::spawn(async move {
                figures::answer(stream, any_host, || site.figures_text(kept)).await;
                drop(place);
            });
        }
    }

    async fn figures_text(self: Arc<Self>, kept: Arc<Kept>) -> Option<Arc<str>> {
        // Held while reading: simultaneous callers share one look.
        let mut kept = kept.lock().await;
        if let Some((_, text)) = kept.as_ref().filter(|(at, _)| at.elapsed() < FRESH) {
            return Some(Arc::clone(text));
        }
        let text: Arc<str> = blocking(&self, |site| Ok(figures::text(&site.figures()?))).await.ok()?.into();
        *kept = Some((Instant::now(), Arc::clone(&text)));
        Some(text)
    }

    pub(super) fn figures(&self) -> Result<Figures> {
        let (ledger, head) = (&self.plant.ledger, self.parts.link.newest_head());
        Ok(Figures {
            now: Timestamp::now(),
            owners: self.owner_figures()?,
            robots: self.robot_figures()?,
            parts: self.parts_health()?.into_iter().filter(|part| part.level != HealthLevel::Absent).collect(),
            tasks: self.parts.supervisor.views(),
            queue: self.queue_view(),
            lanes: self.lane_states()?,
            block: head.map(|head| (head.number, Timestamp::from_seconds(head.timestamp))),
            grants: self.grant_figures(),
            disk: free_bytes(self.home().root()).ok().map(|free| (free, self.config().disk_reserve)),
            cache: self.plant.ciphertext.cache(),
            untold_gaps: ledger.losses.untold()?,
            audit_lines: self.parts.log.lines().head()?.0,
            audit_locked: self.parts.owners.all().is_empty(),
            clock_ahead: look().ahead(),
            gateway: self.gateway.figures(),
            lease: ledger.lease.state()?,
            alerts: self.alerts.by_rule(),
            deliveries: self.alerts.deliveries(),
            latencies: Milestone::ALL.map(|milestone| self.latency(milestone)).into(),
            busy: Stage::ALL.map(|stage| (stage.word(), self.parts.hub.stages.busy(stage).as_secs_f64())).into(),
        })
    }

    fn owner_figures(&self) -> Result<Vec<OwnerFigures>> {
        let mut owners: Vec<Address> = self.parts.owners.all().iter().map(|owner| owner.address).collect();
        owners.extend(self.plant.ledger.counts.owners(MOST_OWNERS)?);
        let mut known = std::collections::HashSet::new();
        owners.retain(|owner| known.insert(*owner));
        owners.truncate(MOST_OWNERS);
        owners.into_iter().map(|owner| self.figures_of(owner)).collect()
    }

    fn figures_of(&self, owner: Address) -> Result<OwnerFigures> {
        let counts = self.losses.counts(&self.plant, owner)?;
        Ok(OwnerFigures {
            owner: short(&owner.to_string()),
            life: self.life_line_of(owner, &counts)?,
            oldest_unanchored: self.plant.ledger.counts.oldest_unanchored(owner)?,
            audit_unanchored: self.audit_unanchored(owner)?,
            topics: if self.config().metrics.topics { topics(&counts) } else { Vec::new() },
        })
    }

    fn robot_figures(&self) -> Result<Vec<RobotFigures>> {
        let own: Vec<_> = self.parts.owners.all().iter().map(|owner| signer_id(&owner.signing().public)).collect();
        let seen =
            self.plant.ledger.counts.last_seen(MOST_ROBOTS)?.into_iter().filter(|row| !own.contains(&row.signer));
        Ok(seen.map(|row| RobotFigures { robot: short(&row.signer.to_string()), last_seen: row.at }).collect())
    }

    fn lane_states(&self) -> Result<Vec<LaneState>> {
        let Some(network) = self.parts.link.network_now() else { return Ok(Vec::new()) };
        let mut lanes = Vec::new();
        for owner in self.parts.owners.all() {
            lanes.extend(self.lanes.lane_states(&owner, &network)?);
        }
        Ok(lanes)
    }

    fn grant_figures(&self) -> Option<Vec<GrantFigures>> {
        // A silent chain would be asked for the times of blocks in vain.
        let network = self.parts.link.network_now().filter(|_| !self.parts.link.is_silent())?;
        // Also profiles that are not open: a grant ends regardless.
        let owners = &self.parts.owners;
        let open = owners.all().into_iter().map(|owner| owner.address);
        let own: BTreeSet<Address> = open.chain(owners.accounts()).collect();
        let mut ending = BTreeMap::new();
        for account in &own {
            let grants = network.directory.grants_of(*account).into_iter();
            for grant in grants.chain(network.directory.grants_to(*account)) {
                let ends = grant.expiry().filter(|_| grant.state(network.directory.now()) == GrantState::Active);
                let Some(ends) = ends else { continue };
                let begun = grant.extended.map_or(grant.block, |extension| extension.block);
                ending.insert((ends, grant.terms.owner, grant.terms.grantee), begun);
            }
        }
        let contacts = self.contacts.names().ok()?;
        let time_of = |block| network.time_of(block).ok();
        Some(told_of(ending, &own, |owner| contacts.contains_key(&owner), time_of))
    }

    /// The time of the oldest line of the audit log that no head of this open owner covers.
    fn audit_unanchored(&self, owner: Address) -> Result<Option<Timestamp>> {
        if !self.parts.owners.all().iter().any(|open| open.address == owner) {
            return Ok(None);
        }
        let anchored = audit_head::noted(&self.plant.ledger.notes, owner)?.map_or(0, |(line, _)| line);
        Ok(self.parts.log.lines().written_after(anchored)?)
    }

    fn latency(&self, milestone: Milestone) -> Latency {
        let (within, count, seconds) = self.parts.hub.stages.within_powers(milestone, &BOUNDS);
        Latency { milestone: milestone.word(), within, count, seconds }
    }
}

/// The end of a grant, its owner and its reader.
type Ending = (Timestamp, Address, Address);

/// Grants to report, by their ends, each with the block in which it began or was extended. Received ones only from
/// contacts: a stranger's unasked grants must not displace what counts.
fn told_of(
    ending: BTreeMap<Ending, u64>,
    own: &BTreeSet<Address>,
    is_contact: impl Fn(Address) -> bool,
    time_of: impl Fn(u64) -> Option<Timestamp>,
) -> Vec<GrantFigures> {
    let (given, mut received): (Vec<_>, Vec<_>) =
        ending.into_iter().partition(|((_, owner, _), _)| own.contains(owner));
    received.retain(|((_, owner, _), _)| is_contact(*owner));
    let mut told: Vec<_> =
        [given, received].into_iter().flat_map(|grants| grants.into_iter().take(MOST_GRANTS)).collect();
    told.sort_unstable();
    let figures = told.into_iter().map(|((ends, owner, reader), block)| GrantFigures {
        owner: short(&owner.to_string()),
        reader: short(&reader.to_string()),
        given: own.contains(&owner),
        begun: time_of(block),
        ends,
    });
    figures.collect()
}

fn topics(counts: &StateCounts) -> Vec<TopicFigures> {
    let figures = |row: &crate::store::TopicCounts| TopicFigures {
        topic: crate::model::clean(&row.topic, 256),
        captured: row.captured,
        verified: row.verified,
        missed: row.missed,
    };
    counts.topics.iter().take(MOST_TOPICS).map(figures).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn account(number: u8) -> Address {
        Address([number; 20])
    }

    #[test]
    fn grants_of_strangers_are_not_told_of_and_push_out_none_that_was_given() {
        let own = BTreeSet::from([account(1)]);
        let stranger = |second: u64| (Timestamp(second), Address([second.to_le_bytes()[0]; 20]), account(1));
        let own_ones = [(Timestamp(900), account(1), account(7)), (Timestamp(800), account(9), account(1))];
        let ending: BTreeMap<_, _> = (100..200).map(stranger).chain(own_ones).map(|end| (end, 7)).collect();
        let told = told_of(ending.clone(), &own, |owner| owner == account(9), |_| None);
        let told: Vec<_> = told.iter().map(|grant| (grant.owner.as_str(), grant.given, grant.ends)).collect();
        assert_eq!(told, [("09090909", false, Timestamp(800)), ("01010101", true, Timestamp(900))]);
        let all = told_of(ending, &own, |_| true, |_| None);
        assert_eq!(all.iter().filter(|grant| !grant.given).count(), MOST_GRANTS, "contacts have their own places");
        assert!(all.iter().any(|grant| grant.given && grant.ends == Timestamp(900)));
        assert!(all.is_sorted_by_key(|grant| grant.ends));
    }
}
