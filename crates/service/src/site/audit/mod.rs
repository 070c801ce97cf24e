//! The audit log, and the audit of the records themselves.

pub(crate) mod log;

pub(crate) use log::Log;

use std::collections::{BTreeMap, HashMap};
use std::fmt::Display;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::runtime::Handle;

use super::blocking;
use super::parts::Parts;
use super::reading::view::OwnKeys;
use crate::model::{Address, OperatorName, ProfileName, Timestamp, clean};
use crate::pipeline::reader::Reader;
use crate::pipeline::record_audit::{self, RecordAudit, Scope, scrub_round};
use crate::pipeline::{Owner, audit_head, recorder_heads};
use crate::reply::{AuditCheck, Failure, Result};
use crate::store::Reserve;

/// A failure of one check does not hide the result of the other.
fn both<T>(log: Result<Option<T>>, recorder: Result<Option<T>>) -> Result<Option<T>> {
    match (log, recorder) {
        (Err(log), Err(recorder)) => Err(Failure::new(log.kind, format!("{}; {}", log.message, recorder.message))),
        (log, recorder) => Ok(recorder?.or(log?)),
    }
}

const LOOK: Duration = Duration::from_secs(1);
const REFILL: Duration = Duration::from_secs(60);

pub(super) struct Audit {
    parts: Parts,
    /// Space for a revoke on a full disk.
    reserve: Arc<Reserve>,
    seen: Mutex<BTreeMap<Address, Instant>>,
}

impl Audit {
    pub fn new(parts: &Parts, reserve: &Arc<Reserve>) -> Self {
        Self { parts: parts.clone(), reserve: Arc::clone(reserve), seen: Mutex::default() }
    }

    pub async fn keep(self: Arc<Self>) {
        let mut refill = Instant::now();
        while !self.parts.life.is_stopping() {
            if !self.parts.life.beat(LOOK).await {
                return;
            }
            self.parts.log.write_counted(Some(Timestamp::now())).await;
            if !self.reserve.is_held()
                && refill.elapsed() >= REFILL
                && self.parts.plant.ledger.records.takes_records().is_ok()
            {
                refill = Instant::now();
                drop(blocking(&self, |audit| Ok(audit.reserve.refill()?)).await);
            }
        }
    }

    /// States the heads of the log and of recorders for the chain.
    pub async fn keep_heads(self: Arc<Self>) {
        while self.parts.life.beat(LOOK).await {
            for owner in self.parts.owners.all() {
                self.anchor_heads(&owner).await;
            }
        }
    }

    async fn anchor_heads(self: &Arc<Self>, owner: &Arc<Owner>) {
        let Some(network) = self.parts.link.network_now() else { return };
        // Keys that are being changed must not sign.
        let Ok(_one_at_a_time) = owner.changes.try_lock() else { return };
        let (of, every) = (Arc::clone(owner), self.parts.config.audit_every);
        let stated = blocking(self, move |audit| {
            let log = audit_head::state_head(&audit.parts.plant, &network, audit.parts.log.lines(), &of, every);
            let keys = of.sealing().filter(|keys| keys.domain == network.domain);
            let recorder = keys.map_or(Ok(None), |keys| {
                let mut all = audit.seen.lock().unwrap_or_else(PoisonError::into_inner);
                let mut seen = all.get(&of.address).copied();
                let stated = recorder_heads::state(&audit.parts.plant, of.address, &keys, every, &mut seen);
                all.extend(seen.map(|seen| (of.address, seen)));
                stated
            });
            both(log.map_err(Failure::from), recorder.map_err(Failure::from))
        })
        .await;
        match stated {
            Ok(Some(_)) => self.parts.hub.stored.notify_waiters(),
            Ok(None) => {}
            Err(failure) => {
                let (profile, why) = (&owner.profile, failure.message);
                let text = format!("heads of the audit log and of the recorder are not anchored for {profile}: {why}");
                self.parts.hub.alarm(&text);
            }
        }
    }

    pub async fn verify(self: &Arc<Self>, owner: Option<Arc<Owner>>) -> Result<AuditCheck> {
        let walked = blocking(self, |audit| Ok(audit.parts.log.lines().verify())).await?;
        let (lines, mut broken) = walked.map_or_else(|fault| (0, Some(fault)), |lines| (lines, None));
        let mut check = AuditCheck { lines, ..AuditCheck::default() };
        if let Some(owner) = owner {
            let network = self.parts.link.network().await?;
            let reader = Reader { plant: &self.parts.plant, network: &network, reader: &owner };
            let heads = audit_head::heads(&reader).await?;
            check.heads = heads.good.len() as u64;
            check.anchored = heads.anchored as u64;
            check.unusable = heads.bad.iter().map(|(id, why)| format!("{id}: {}", clean(why, 200))).collect();
            match blocking(self, move |audit| Ok(audit.parts.log.lines().compare(&heads.good))).await? {
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

tokio::task_local! {
    static OPERATOR: OperatorName;
}

pub async fn acting_as<Work: Future>(operator: OperatorName, work: Work) -> Work::Output {
    OPERATOR.scope(operator, work).await
}

pub fn is_operator() -> bool {
    OPERATOR.try_with(|_| ()).is_ok()
}

/// The profile, or `profile/operator`, as the log names it.
fn doer(profile: &str) -> String {
    OPERATOR.try_with(|operator| by(profile, operator)).unwrap_or_else(|_| profile.to_owned())
}

pub fn by(profile: impl Display, operator: &OperatorName) -> String {
    format!("{profile}/{operator}")
}

const SHARE_EVERY: Duration = Duration::from_secs(5);
const MOST_AT_ONCE: usize = 256;

impl Audit {
    pub async fn records(
        self: &Arc<Self>,
        profile: &ProfileName,
        is_pinned: bool,
        deep: bool,
        since: Option<Timestamp>,
    ) -> Result<RecordAudit> {
        let network = if is_pinned { Some(self.parts.link.network().await) } else { None };
        let runtime = Handle::current();
        let running = self.parts.runs.begin(profile, "this home", "auditing", "records");
        blocking(self, move |audit| {
            let keys = Arc::new(OwnKeys::of(&audit.parts.owners));
            running.run.expect(if since.is_none() { audit.parts.plant.ledger.inspection.size()? } else { 0 });
            let (since, looked_at) = (since.unwrap_or_default(), running.run.counter());
            let scope = Scope { deep, since, accounts: audit.parts.owners.accounts(), keys, looked_at };
            let chain = network.as_ref().map(|network| network.as_ref().map_err(|failure| failure.message.clone()));
            Ok(record_audit::audit(&audit.parts.plant, chain, audit.parts.log.lines(), &scope, &runtime)?)
        })
        .await
    }

    pub async fn keep_scrubbing(self: Arc<Self>) {
        let percent = self.parts.config.scrub_percent;
        let mut due = 0.0_f64;
        while percent > 0 && self.parts.life.beat(SHARE_EVERY).await {
            let Some(network) = self.parts.link.network_now() else { continue };
            let Ok(records) = blocking(&self, |audit| Ok(audit.parts.plant.ledger.inspection.size()?)).await else {
                continue;
            };
            #[expect(clippy::cast_precision_loss, reason = "a share of them")]
            let (records, percent) = (records as f64, percent as f64);
            due = (due + records * percent / 100.0 * SHARE_EVERY.as_secs_f64() / 3600.0).min(records);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small and not negative")]
            let mut share = due as usize;
            while share > 0 && !self.parts.life.is_stopping() {
                let (most, network) = (share.min(MOST_AT_ONCE), network.clone());
                let done = blocking(&self, move |audit| Ok(scrub_round(&audit.parts.plant, &network, most)?)).await;
                if let Err(failure) = done {
                    self.parts.hub.warn(&format!("the scrubber waits: {}", failure.message));
                    break;
                }
                share -= most;
                #[expect(clippy::cast_precision_loss, reason = "at most a few hundred")]
                let most = most as f64;
                due -= most;
            }
        }
    }
}

/// The most counters; beyond it, refusals count under [`OTHERS`].
const MOST: usize = 1024;
/// The most queries remembered; beyond it, each gets a line of its own.
const MOST_QUERIES: usize = 256;
pub const OTHERS: &str = "other peers";

const MINUTE: u64 = 60_000_000_000;

/// The minute since 1970, the peer, and the constant code.
pub type Refusal = (u64, String, String);

#[derive(Debug, Default)]
pub struct Refusals {
    counts: Mutex<BTreeMap<Refusal, u64>>,
    asked: Mutex<HashMap<(String, String), (Timestamp, u64)>>,
}

impl Refusals {
    fn counts(&self) -> MutexGuard<'_, BTreeMap<Refusal, u64>> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn asked(&self) -> MutexGuard<'_, HashMap<(String, String), (Timestamp, u64)>> {
        self.asked.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn add(&self, at: Timestamp, peer: &str, code: &str) -> bool {
        let mut counts = self.counts();
        let (peer, code) = (clean(peer, 100), clean(code, 60));
        let mut key = (at.0 / MINUTE, peer, code);
        if counts.len() >= MOST && !counts.contains_key(&key) {
            OTHERS.clone_into(&mut key.1);
        }
        if counts.len() >= 2 * MOST && !counts.contains_key(&key) {
            // Codes are constants of the program: reached only after many minutes without a ledger.
            "refused".clone_into(&mut key.2);
        }
        let count = counts.entry(key).or_default();
        *count += 1;
        *count == 1
    }

    pub fn take(&self, now: Option<Timestamp>) -> Vec<(Refusal, u64)> {
        let mut counts = self.counts();
        let running = match now {
            Some(now) => counts.split_off(&(now.0 / MINUTE, String::new(), String::new())),
            None => BTreeMap::new(),
        };
        std::mem::replace(&mut *counts, running).into_iter().collect()
    }

    pub fn put_back(&self, refusals: Vec<(Refusal, u64)>) {
        let mut counts = self.counts();
        for (key, count) in refusals {
            *counts.entry(key).or_default() += count;
        }
    }

    pub fn is_new_query(&self, at: Timestamp, profile: &str, query: &str) -> bool {
        let mut asked = self.asked();
        let key = (profile.to_owned(), query.to_owned());
        if let Some((_, times)) = asked.get_mut(&key).filter(|(first, _)| at.0.saturating_sub(first.0) < MINUTE) {
            *times += 1;
            return false;
        }
        if asked.len() < MOST_QUERIES {
            asked.entry(key).or_insert((at, 0));
        }
        true
    }

    pub fn forget_query(&self, profile: &str, query: &str) {
        self.asked().remove(&(profile.to_owned(), query.to_owned()));
    }

    pub fn repeated(&self, now: Option<Timestamp>) -> Vec<((String, String), u64)> {
        let mut asked = self.asked();
        let ended = |first: &Timestamp| now.is_none_or(|now| now.0.saturating_sub(first.0) >= MINUTE);
        let taken = asked.extract_if(|_, (first, _)| ended(first));
        let mut again: Vec<_> =
            taken.map(|(query, (_, times))| (query, times)).filter(|(_, times)| *times > 0).collect();
        again.sort();
        again
    }
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod refusals_tests {
    use super::*;

    #[test]
    fn refusals_are_counted_per_peer_code_and_minute() {
        let refusals = Refusals::default();
        let second = |second: u64| Timestamp::from_seconds(second);
        for at in [60, 61, 119] {
            refusals.add(second(at), "10.0.0.1", "not_granted");
        }
        refusals.add(second(61), "10.0.0.1", "bad_tag");
        refusals.add(second(120), "10.0.0.1", "not_granted");
        assert!(refusals.take(Some(second(119))).is_empty(), "the minute runs");
        let taken = refusals.take(Some(second(120)));
        let told: Vec<_> = taken.iter().map(|((minute, _, code), count)| (*minute, code.as_str(), *count)).collect();
        assert_eq!(told, [(1, "bad_tag", 1), (1, "not_granted", 3)]);
        refusals.put_back(taken);
        assert_eq!(refusals.take(None).len(), 3, "and at the end everything");
        assert!(refusals.take(None).is_empty());
    }

    #[test]
    fn a_crowd_of_peers_takes_bounded_memory_and_none_is_lost() {
        let refusals = Refusals::default();
        for peer in 0..5_000 {
            refusals.add(Timestamp(0), &format!("peer {peer}"), "throttled");
        }
        let taken = refusals.take(None);
        assert_eq!((taken.len(), taken.iter().map(|(_, count)| count).sum::<u64>()), (MOST + 1, 5_000));
        assert!(taken.iter().any(|((_, peer, _), count)| peer == OTHERS && *count == 5_000 - MOST as u64));
    }

    #[test]
    fn an_identical_query_is_a_line_once_a_minute() {
        let refusals = Refusals::default();
        let at = Timestamp::from_seconds;
        assert!(refusals.is_new_query(at(1), "a", "all"));
        assert!(refusals.is_new_query(at(2), "b", "all") && refusals.is_new_query(at(2), "a", "page 2"));
        assert!(!refusals.is_new_query(at(3), "a", "all") && !refusals.is_new_query(at(60), "a", "all"));
        assert!(refusals.repeated(Some(at(60))).is_empty());
        let again = refusals.repeated(Some(at(62)));
        assert_eq!(again, [(("a".to_owned(), "all".to_owned()), 2)]);
        assert!(refusals.is_new_query(at(62), "a", "all"));
        refusals.forget_query("a", "all");
        assert!(refusals.is_new_query(at(62), "a", "all"), "its line was not written");
        for number in 0..1_000 {
            assert!(refusals.is_new_query(at(63), "c", &number.to_string()));
        }
        assert!(refusals.is_new_query(at(63), "c", "999"), "beyond what is remembered each is a line");
    }
}
