//! The gateways of the same fleet, as the keeper named them by fingerprint, and how reconciling with each goes. The list
//! is stored in the ledger; the rest is what this run has seen.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use tokio::task::block_in_place;

use crate::crypto::signer_id;
use crate::gateway::Code;
use crate::model::{Address, ProfileName, SignerId, Timestamp, clean};
use crate::pipeline::{Network, Plant};
use crate::service::event::{NoticeLevel, Part};
use crate::service::failure::{input, internal, refused};
use crate::service::figures::{FellowFigures, short};
use crate::service::hub::Hub;
use crate::service::reply::{Failure, FellowView, HealthLevel, PartHealth, RefusedView};
use crate::site::audit::Log;
use crate::site::parts::Parts;

/// Where the list is stored in the ledger.
const LIST: &str = "fleet";
/// The most gateways on it.
const MOST: usize = 32;
/// The subject of notices, and the part's name.
const ABOUT: &str = "fleet";
/// The pause while one of both waits for the chain, which ends by itself.
const WAITING: Duration = Duration::from_secs(1);
/// The shortest pause after a failure, and the longest.
const PAUSES: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(30));
/// The same after lies.
const LONG_PAUSES: (Duration, Duration) = (Duration::from_secs(30), Duration::from_secs(1800));
/// Characters of the beginning of a key that tell it apart.
const LEAST_KEY: usize = 8;

/// A gateway of the same fleet.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Fellow {
    /// SM3 of its identity key.
    pub key: SignerId,
    /// HOST:PORT.
    pub address: String,
    /// When it was named.
    pub added_at: Timestamp,
}

/// Why nothing came from a gateway.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fault {
    /// It waits for the chain, or this gateway does.
    Waits,
    /// It does not answer, or refuses.
    Fails,
    /// What it says does not hold.
    Lies,
}

impl Fault {
    /// The pause after it, where the one before was `last`.
    fn pause(self, last: Duration) -> Duration {
        match self {
            Self::Waits => WAITING,
            Self::Fails => (last * 2).clamp(PAUSES.0, PAUSES.1),
            Self::Lies => (last * 2).clamp(LONG_PAUSES.0, LONG_PAUSES.1),
        }
    }
}

/// How reconciling with a gateway goes.
#[derive(Debug, Default)]
pub(super) struct Progress {
    /// Whether all of its holdings were read.
    pub complete: bool,
    /// When it last told what it holds.
    pub heard: Option<Timestamp>,
    /// The same by a clock that nobody sets, or when it was first asked.
    last_there: Option<Instant>,
    /// Records taken from it.
    pub taken: u64,
    /// Records erased here at its word.
    pub erased: u64,
    /// Those lacking as of then, and how many owners may not use this gateway.
    pub lacking: u64,
    pub passed_over: u64,
    /// Those anchored by both.
    pub twice: u64,
    /// What it sent and was refused.
    pub refused: BTreeMap<Code, u64>,
    /// What is wrong, since when, and whether it lied.
    trouble: Option<(Timestamp, String, bool)>,
    again: Option<Instant>,
    pause: Duration,
}

/// The gateways of the same fleet.
pub(super) struct Fellows {
    plant: Plant,
    hub: Arc<Hub>,
    log: Arc<Log>,
    list: RwLock<Option<Arc<[Fellow]>>>,
    progress: Mutex<BTreeMap<SignerId, Progress>>,
    /// Changes are made one at a time.
    changing: tokio::sync::Mutex<()>,
}

impl Fellows {
    /// From the shared parts.
    pub fn new(parts: &Parts) -> Self {
        let Parts { plant, hub, log, .. } = parts.clone();
        let (list, progress, changing) = (RwLock::default(), Mutex::default(), tokio::sync::Mutex::default());
        Self { plant, hub, log, list, progress, changing }
    }

    /// The list. Waits for the ledger the first time.
    pub(super) fn all(&self) -> Result<Arc<[Fellow]>, Failure> {
        if let Some(list) = &*self.list.read().unwrap_or_else(PoisonError::into_inner) {
            return Ok(Arc::clone(list));
        }
        let list: Vec<Fellow> = match self.plant.ledger.setting(LIST)? {
            None => Vec::new(),
            Some(text) => serde_json::from_str(&text).map_err(|_| {
                input("the list of the fleet's gateways in the ledger cannot be read; restore a backup")
            })?,
        };
        let list: Arc<[Fellow]> = list.into();
        *self.list.write().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&list));
        Ok(list)
    }

    fn write(&self, list: &[Fellow]) -> Result<(), Failure> {
        let text = serde_json::to_string(list).map_err(|error| internal(error.to_string()))?;
        block_in_place(|| self.plant.ledger.put_setting(LIST, &text))?;
        *self.list.write().unwrap_or_else(PoisonError::into_inner) = Some(list.into());
        self.hub.changed(Part::Health);
        Ok(())
    }

    /// Whether a gateway is named still, at this address.
    pub(super) fn has(&self, fellow: &Fellow) -> bool {
        self.all().is_ok_and(|list| list.contains(fellow))
    }

    /// Whether an account registered the key of a named gateway. Waits for the ledger the first time.
    pub(super) fn is_keeper(&self, network: &Network, account: &Address) -> bool {
        let Ok(list) = self.all() else { return false };
        if list.is_empty() {
            return false;
        }
        let known = network.directory.account(*account).map(|account| account.identities).unwrap_or_default();
        let keys = known.iter().filter(|identity| identity.proven).map(|identity| signer_id(&identity.signing));
        keys.into_iter().any(|key| list.iter().any(|fellow| fellow.key == key))
    }

    /// Names a gateway, or writes down its new address. `own` is the key of the gateway that runs here.
    pub(super) async fn add(
        &self,
        profile: &ProfileName,
        (address, key): (&str, SignerId),
        own: Option<SignerId>,
    ) -> Result<(), Failure> {
        let address = checked_address(address)?;
        if own == Some(key) {
            return Err(input("that is the key of the gateway of this home; name the other ones"));
        }
        let _one_at_a_time = self.changing.lock().await;
        let mut list = block_in_place(|| self.all())?.to_vec();
        list.retain(|fellow| fellow.key != key);
        if list.len() >= MOST {
            return Err(refused(format!("a fleet has at most {MOST} other gateways; remove one first")));
        }
        let subject = format!("{address} (key {key})");
        list.push(Fellow { key, address, added_at: Timestamp::now() });
        let named = async {
            self.with(|all| all.remove(&key));
            self.write(&list)
        };
        self.log.deed(profile, "fleet add", &subject, named).await
    }

    /// Names a gateway no more.
    pub(super) async fn remove(&self, profile: &ProfileName, gateway: &str) -> Result<(), Failure> {
        let _one_at_a_time = self.changing.lock().await;
        let mut list = block_in_place(|| self.all())?.to_vec();
        let is_it = |fellow: &Fellow| {
            fellow.address == gateway || gateway.len() >= LEAST_KEY && fellow.key.to_hex().starts_with(gateway)
        };
        let found: Vec<Fellow> = list.iter().filter(|fellow| is_it(fellow)).cloned().collect();
        let [fellow] = found.as_slice() else {
            let what = if found.is_empty() { "no gateway" } else { "more than one gateway" };
            let gateway = clean(gateway, 100);
            return Err(input(format!(
                "{what} of the fleet is '{gateway}'; `authros fleet list` shows them with their keys"
            )));
        };
        let subject = format!("{} (key {})", fellow.address, fellow.key);
        list.retain(|other| other != fellow);
        let removed = async {
            self.with(|all| all.remove(&fellow.key));
            self.write(&list)
        };
        self.log.deed(profile, "fleet remove", &subject, removed).await
    }

    /// The keys of those that told what they hold within this time; one that was just named, or that this site has only
    /// begun to ask, counts as there for as long.
    pub(super) fn there(&self, within: Duration) -> Vec<SignerId> {
        let list = self.all().unwrap_or_default();
        self.with(|all| {
            let is_there = |fellow: &&Fellow| {
                let one = all.entry(fellow.key).or_default();
                one.last_there.get_or_insert_with(Instant::now).elapsed() < within
            };
            list.iter().filter(is_there).map(|fellow| fellow.key).collect()
        })
    }

    /// The gateways with what is known of each.
    pub(super) fn rows(&self, network: Option<&Network>) -> Result<Vec<FellowView>, Failure> {
        let list = block_in_place(|| self.all())?;
        Ok(self.with(|all| list.iter().map(|fellow| view(fellow, all, network)).collect()))
    }

    /// The state of the fleet, if there is one.
    pub fn health(&self) -> Result<Option<PartHealth>, Failure> {
        let list = self.all()?;
        if list.is_empty() {
            return Ok(None);
        }
        let (unheard, lacking, worst) = self.with(|all| {
            let of = |fellow: &Fellow| all.get(&fellow.key);
            let unheard = list.iter().filter(|fellow| of(fellow).is_none_or(|one| one.heard.is_none())).count();
            let lacking: u64 = list.iter().filter_map(of).map(|one| one.lacking).sum();
            let troubles = list.iter().filter_map(|fellow| Some((fellow, of(fellow)?.trouble.as_ref()?)));
            let worst = troubles.max_by_key(|(_, (_, _, lied))| *lied);
            (unheard, lacking, worst.map(|(fellow, trouble)| (fellow.address.clone(), trouble.clone())))
        });
        let others = if list.len() == 1 { "gateway" } else { "gateways" };
        let told = format!("{} other {others}, {unheard} not heard yet, {lacking} records lacking", list.len());
        let (level, since, text) = match worst {
            None if unheard == 0 && lacking == 0 => (HealthLevel::Ok, None, told),
            None => (HealthLevel::Waiting, None, told),
            Some((address, (since, why, lied))) => {
                let level = if lied { HealthLevel::Failed } else { HealthLevel::Waiting };
                (level, Some(since), format!("{told}; {address}: {why}"))
            }
        };
        Ok(Some(PartHealth { part: ABOUT.to_owned(), level, text: clean(&text, 300), since, retry: None }))
    }

    /// The figures of each gateway.
    pub fn figures(&self) -> Result<Vec<FellowFigures>, Failure> {
        let list = self.all()?;
        let none = Progress::default();
        Ok(self.with(|all| {
            let figures = |fellow: &Fellow| {
                let one = all.get(&fellow.key).unwrap_or(&none);
                FellowFigures {
                    fellow: short(&fellow.key.to_string()),
                    heard: one.heard,
                    lacking: one.lacking,
                    taken: one.taken,
                    erased: one.erased,
                    twice: one.twice,
                    refused: one.refused.iter().map(|(code, count)| (code.number(), *count)).collect(),
                }
            };
            list.iter().map(figures).collect()
        }))
    }

    fn with<Told>(&self, work: impl FnOnce(&mut BTreeMap<SignerId, Progress>) -> Told) -> Told {
        work(&mut self.progress.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Reads or changes how it goes with one gateway.
    pub(super) fn of<Told>(&self, key: SignerId, work: impl FnOnce(&mut Progress) -> Told) -> Told {
        self.with(|all| work(all.entry(key).or_default()))
    }

    /// Whether it is time to ask a gateway.
    pub(super) fn is_due(&self, key: SignerId) -> bool {
        self.of(key, |one| one.again.is_none_or(|again| again <= Instant::now()))
    }

    /// A round was done.
    pub(super) fn succeeded(&self, fellow: &Fellow) {
        let before = self.of(fellow.key, |one| {
            (one.again, one.pause, one.last_there) = (None, Duration::ZERO, Some(Instant::now()));
            one.trouble.take()
        });
        if before.is_some() {
            let text = format!("the gateway {} of the fleet answers again", clean(&fellow.address, 255));
            self.hub.notice_about(ABOUT, NoticeLevel::Info, &text);
            self.hub.changed(Part::Health);
        }
    }

    /// A round ended early; it is told once. `share` of 256 is how much of the pause is left out, so that gateways that
    /// lost one together do not come back together.
    pub(super) fn failed(&self, fellow: &Fellow, why: &str, fault: Fault, share: u8) {
        let lied = fault == Fault::Lies;
        let is_new = self.of(fellow.key, |one| {
            let is_new = one.trouble.as_ref().is_none_or(|(.., before)| lied && !before);
            let since = one.trouble.as_ref().map_or_else(Timestamp::now, |(since, ..)| *since);
            one.trouble = Some((since, clean(why, 300), lied));
            one.pause = fault.pause(one.pause);
            let pause = one.pause.saturating_sub(one.pause / 512 * u32::from(share));
            one.again = Some(Instant::now() + pause);
            is_new
        });
        if is_new {
            let (address, level) =
                (clean(&fellow.address, 255), if lied { NoticeLevel::Error } else { NoticeLevel::Warning });
            let what = if lied { "sends what does not hold, nothing of it is taken" } else { "does not reconcile" };
            let text =
                format!("the gateway {address} of the fleet {what}, it is asked again later: {}", clean(why, 300));
            self.hub.notice_about(ABOUT, level, &text);
            self.hub.changed(Part::Health);
        }
    }
}

fn view(fellow: &Fellow, all: &BTreeMap<SignerId, Progress>, network: Option<&Network>) -> FellowView {
    let (none, Fellow { key, address, added_at }) = (Progress::default(), fellow.clone());
    let one = all.get(&key).unwrap_or(&none);
    let refused = one.refused.iter();
    FellowView {
        account: network.and_then(|network| network.directory.registered_as(key)),
        address,
        key,
        added_at,
        heard: one.heard,
        reconciled: one.heard.is_some() && one.lacking == 0 && one.trouble.is_none() && one.complete,
        lacking: one.lacking,
        taken: one.taken,
        erased: one.erased,
        passed_over: one.passed_over,
        anchored_twice: one.twice,
        refused: refused
            .map(|(code, count)| RefusedView { code: code.number(), text: code.text().to_owned(), count: *count })
            .collect(),
        problem: one.trouble.as_ref().map(|(_, why, _)| why.clone()),
        away: false,
    }
}

fn checked_address(address: &str) -> Result<String, Failure> {
    let parts = address.rsplit_once(':').filter(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok());
    let plain = address.len() <= 255 && address.bytes().all(|byte| byte.is_ascii_graphic());
    match parts.filter(|_| plain) {
        Some(_) => Ok(address.to_owned()),
        None => Err(input(format!("'{}' is no gateway; write HOST:PORT", clean(address, 100)))),
    }
}

#[cfg(test)]
#[allow(clippy::expect_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;
    use crate::site::testing::{Ground, profile};

    const ONE: SignerId = SignerId([0x11; 32]);
    const TWO: SignerId = SignerId([0x22; 32]);

    fn keys(fellows: &Fellows) -> Vec<(String, SignerId)> {
        fellows.rows(None).expect("rows").into_iter().map(|row| (row.address, row.key)).collect()
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn who_was_named_is_known_after_a_restart_until_it_is_removed() {
        let ground = Ground::with(&[]);
        let (keeper, fellows) = (profile("keeper"), Fellows::new(&ground.parts));
        assert_eq!(fellows.health().expect("told"), None, "a home without a fleet does not speak of one");
        fellows.add(&keeper, ("b:7420", ONE), Some(TWO)).await.expect("named");
        fellows.add(&keeper, ("c:7420", TWO), None).await.expect("named");
        fellows.add(&keeper, ("b:7421", ONE), Some(SignerId([9; 32]))).await.expect("moved");
        let itself = fellows.add(&keeper, ("d:1", TWO), Some(TWO)).await.expect_err("its own key");
        assert!(itself.message.contains("of this home"), "{}", itself.message);
        for address in ["b", ":1", "b:x", "b :1"] {
            assert!(fellows.add(&keeper, (address, ONE), None).await.is_err(), "{address}");
        }
        assert_eq!(ground.audited("fleet add").len(), 6, "begun and done");
        drop(fellows);

        let ground = ground.again();
        let fellows = Fellows::new(&ground.parts);
        assert_eq!(keys(&fellows), [("c:7420".to_owned(), TWO), ("b:7421".to_owned(), ONE)]);
        assert!(fellows.remove(&keeper, "1111").await.is_err(), "too little of a key");
        fellows.remove(&keeper, "11111111").await.expect("removed");
        assert!(fellows.remove(&keeper, "b:7421").await.is_err(), "it is gone");
        assert_eq!(keys(&fellows), [("c:7420".to_owned(), TWO)]);
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn one_that_lies_is_told_of_once_and_asked_ever_less_often() {
        let ground = Ground::with(&[]);
        let (keeper, fellows) = (profile("keeper"), Fellows::new(&ground.parts));
        fellows.add(&keeper, ("b:7420", ONE), None).await.expect("named");
        let fellow = fellows.all().expect("read")[0].clone();
        let mut events = ground.parts.hub.events().subscribe();
        assert!(fellows.is_due(ONE));
        for _ in 0..20 {
            fellows.failed(&fellow, "a forged record", Fault::Lies, 0);
        }
        assert!(!fellows.is_due(ONE));
        let told = std::iter::from_fn(|| events.try_recv().ok());
        let about = |event: &crate::service::event::Event| format!("{event:?}").contains("a forged record");
        assert_eq!(told.filter(about).count(), 1);
        let pause = fellows.of(ONE, |one| one.pause);
        assert_eq!(pause, LONG_PAUSES.1);
        let health = fellows.health().expect("told").expect("a part");
        assert!(health.level == HealthLevel::Failed && health.text.contains("b:7420: a forged record"), "{health:?}");
        fellows.succeeded(&fellow);
        assert!(fellows.is_due(ONE) && fellows.rows(None).expect("rows")[0].problem.is_none());
    }

    #[test]
    fn who_waits_for_the_chain_is_asked_again_soon_and_a_liar_rarely() {
        let after = |fault: Fault| (0..20).fold(Duration::ZERO, |pause, _| fault.pause(pause));
        assert_eq!((after(Fault::Waits), after(Fault::Fails), after(Fault::Lies)), (WAITING, PAUSES.1, LONG_PAUSES.1));
        assert_eq!(Fault::Fails.pause(Duration::ZERO), PAUSES.0);
        assert_eq!(Fault::Waits.pause(LONG_PAUSES.1), WAITING);
    }
}
