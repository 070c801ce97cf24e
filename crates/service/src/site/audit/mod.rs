//! The audit: the log of deeds, what is only counted, and the audit of the records themselves.

pub(in crate::site) mod acting;
pub(crate) mod log;
mod records;
mod refusals;
/// What both of two checks state; a failure of one does not hide what is wrong with the other.
fn both<T>(log: Result<Option<T>, Failure>, recorder: Result<Option<T>, Failure>) -> Result<Option<T>, Failure> {
    match (log, recorder) {
        (Err(log), Err(recorder)) => Err(Failure::new(log.kind, format!("{}; {}", log.message, recorder.message))),
        (log, recorder) => Ok(recorder?.or(log?)),
    }
}

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::blocking;
use super::chain::link::Link;
use super::identity::owners::Owners;
use super::lifetime::Lifetime;
use super::parts::Parts;
use super::progress::Runs;
use crate::config::Config;
use crate::model::{Address, Timestamp, clean};
use crate::pipeline::reader::Reader;
use crate::pipeline::{Owner, Plant, audit_head, recorder_heads};
use crate::service::event::NoticeLevel;
use crate::service::hub::Hub;
use crate::service::reply::{AuditCheck, Failure};
use crate::store::Reserve;

pub(crate) use log::Log;

/// How often to check whether something is to be written or anchored.
const LOOK: Duration = Duration::from_secs(1);
/// How often setting a lost reserve aside again is tried.
const REFILL: Duration = Duration::from_secs(60);

/// The audit of a site: of its log and of its records.
pub(super) struct Audit {
    config: Arc<Config>,
    plant: Plant,
    hub: Arc<Hub>,
    log: Arc<Log>,
    owners: Arc<Owners>,
    link: Arc<Link>,
    life: Arc<Lifetime>,
    runs: Runs,
    /// Space for a revoke on a full disk.
    reserve: Arc<Reserve>,
    /// When the numbers of an owner's topics were last looked at.
    seen: Mutex<BTreeMap<Address, Instant>>,
}

impl Audit {
    /// From the shared parts, and the space set aside for a revoke.
    pub fn new(parts: &Parts, reserve: &Arc<Reserve>) -> Self {
        let Parts { config, plant, hub, log, owners, link, life, runs, .. } = parts.clone();
        let (reserve, seen) = (Arc::clone(reserve), Mutex::default());
        Self { config, plant, hub, log, owners, link, life, runs, reserve, seen }
    }

    /// Writes the counters, anchors the heads of the log and of the recorder, sets a lost reserve aside again; until
    /// the site ends.
    pub(in crate::site) async fn keep(self: Arc<Self>) {
        let mut refill = Instant::now();
        while !self.life.is_stopping() {
            if !self.life.beat(LOOK).await {
                return;
            }
            self.log.write_counted(Some(Timestamp::now())).await;
            for owner in self.owners.all() {
                self.anchor_heads(&owner).await;
            }
            if !self.reserve.is_held() && refill.elapsed() >= REFILL && self.plant.ledger.takes_records().is_ok() {
                refill = Instant::now();
                // On a disk that is still full it is tried again.
                drop(blocking(&self, |audit| Ok(audit.reserve.refill()?)).await);
            }
        }
    }

    async fn anchor_heads(self: &Arc<Self>, owner: &Arc<Owner>) {
        let Some(network) = self.link.network_now() else { return };
        // Keys that are being changed must not sign now; the next look comes soon.
        let Ok(_one_at_a_time) = owner.changes.try_lock() else { return };
        let (of, every) = (Arc::clone(owner), self.config.audit_every);
        let stated = blocking(self, move |audit| {
            let log = audit_head::state_head(&audit.plant, &network, audit.log.lines(), &of, every);
            let keys = of.sealing().filter(|keys| keys.domain == network.domain);
            let recorder = keys.map_or(Ok(None), |keys| {
                let mut all = audit.seen.lock().unwrap_or_else(PoisonError::into_inner);
                let mut seen = all.get(&of.address).copied();
                let stated = recorder_heads::state(&audit.plant, of.address, &keys, every, &mut seen);
                all.extend(seen.map(|seen| (of.address, seen)));
                stated
            });
            both(log.map_err(Failure::from), recorder.map_err(Failure::from))
        })
        .await;
        match stated {
            Ok(Some(_)) => self.hub.stored.notify_waiters(),
            Ok(None) => {}
            Err(failure) => {
                let (profile, why) = (&owner.profile, failure.message);
                let text = format!("heads of the audit log and of the recorder are not anchored for {profile}: {why}");
                self.hub.notice(NoticeLevel::Error, &text);
            }
        }
    }

    /// Walks the whole log, and compares it with the heads that this owner anchored.
    pub(in crate::site) async fn verify(self: &Arc<Self>, owner: Option<Arc<Owner>>) -> Result<AuditCheck, Failure> {
        let walked = blocking(self, |audit| Ok(audit.log.lines().verify())).await?;
        let mut check = AuditCheck { ok: true, ..AuditCheck::default() };
        let mut broken = match walked {
            Ok(lines) => {
                check.lines = lines;
                None
            }
            Err(fault) => Some(fault),
        };
        if let Some(owner) = owner {
            let network = self.link.network().await?;
            let reader = Reader { plant: &self.plant, network: &network, reader: &owner };
            let heads = audit_head::heads(&reader).await?;
            check.heads = heads.good.len() as u64;
            check.anchored = heads.anchored as u64;
            check.unusable = heads.bad.iter().map(|(id, why)| format!("{id}: {}", clean(why, 200))).collect();
            match blocking(self, move |audit| Ok(audit.log.lines().compare(&heads.good))).await? {
                Ok(covered) => check.covered = covered,
                Err(fault) => broken = broken.filter(|walked| walked.line <= fault.line).or(Some(fault)),
            }
        }
        check.ok = broken.is_none() && check.unusable.is_empty();
        check.broken_line = broken.as_ref().map(|fault| fault.line);
        check.text = broken.map(|fault| clean(&fault.to_string(), 300));
        Ok(check)
    }
}
