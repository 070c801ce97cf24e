//! The chain's proofs of each anchored batch, fetched as soon as it is confirmed: most nodes keep the states of the
//! newest blocks only. Nothing waits for them.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::model::{Timestamp, clean};
use crate::pipeline::chain_proofs::{Collected, Rounds, collect};
use crate::pipeline::{PipelineError, Plant};
use crate::service::event::NoticeLevel;
use crate::service::hub::Hub;
use crate::service::reply::{Failure, HealthLevel, PartHealth};
use crate::site::chain::link::Link;
use crate::site::lifetime::Lifetime;
use crate::site::parts::Parts;

/// How often to look for batches without a proof.
const LOOK: Duration = Duration::from_secs(2);
/// The subject of notices.
const ABOUT: &str = "chain proofs";

/// The chain proofs of a site.
pub(in crate::site) struct ChainProofs {
    plant: Plant,
    hub: Arc<Hub>,
    life: Arc<Lifetime>,
    link: Arc<Link>,
    /// Why the last round failed, and since when rounds do.
    trouble: Mutex<Option<(Timestamp, String)>>,
}

impl ChainProofs {
    /// From the shared parts.
    pub fn new(parts: &Parts) -> Self {
        let Parts { plant, hub, life, link, .. } = parts.clone();
        Self { plant, hub, life, link, trouble: Mutex::default() }
    }

    /// Collects proofs until the site ends.
    pub async fn keep(self: Arc<Self>) {
        let mut rounds = Rounds::default();
        while self.life.beat(LOOK).await {
            let Some(network) = self.link.network_now() else { continue };
            let result = collect(&self.plant, &network, &mut rounds).await;
            self.told(result);
        }
    }

    fn told(&self, result: Result<Collected, PipelineError>) {
        let (missed, problem) = match result {
            Ok(collected) => (collected.missed, collected.problem),
            Err(error) => (0, Some(error.to_string())),
        };
        let problem = problem.map(|why| clean(&why, 200));
        if let (1.., Some(why)) = (missed, &problem) {
            let text = format!("the chain's proofs of {missed} batches could not be kept: {why}");
            self.hub.notice_about(ABOUT, NoticeLevel::Warning, &text);
        }
        let mut trouble = self.trouble.lock().unwrap_or_else(PoisonError::into_inner);
        let since = trouble.as_ref().map_or_else(Timestamp::now, |(since, _)| *since);
        *trouble = problem.map(|why| (since, why));
    }

    /// The state of the proofs, if there are any or should be.
    pub fn health(&self) -> Result<Option<PartHealth>, Failure> {
        let counts = self.plant.ledger.chain_proof_counts()?;
        let trouble = self.trouble.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if counts.newest.is_none() && counts.missed == 0 && trouble.is_none() {
            return Ok(None);
        }
        let kept =
            counts.newest.map_or_else(|| "none kept yet".to_owned(), |block| format!("kept up to block {block}"));
        let missed = match counts.missed {
            0 => String::new(),
            missed => format!("; {missed} batches have none, bundles of them ask the node"),
        };
        let (level, since, why) = match trouble {
            Some((since, why)) => (HealthLevel::Waiting, Some(since), format!("; {why}")),
            None => (HealthLevel::Ok, None, String::new()),
        };
        let text = clean(&format!("{kept}{missed}{why}"), 300);
        Ok(Some(PartHealth { part: "proofs".to_owned(), level, text, since, retry: None }))
    }
}
