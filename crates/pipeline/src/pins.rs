//! Node forging: who may publish a watched topic, and the alarm about anyone else. All that is compared is claimed: ROS
//! 1 authenticates nobody. A publisher with the pinned one's claims is doubted only if both were there together.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::Instant;

use crate::model::{Address, Doubt, ListedPublishers, PinMode, Publisher, Timestamp, clean, pinned_name};
use crate::store::{AuditEntry, AuditLog, Ledger, Pins as KeptPins, StoreError};
use crate::{Observer, ros::Origin};

/// The most verdicts kept; beyond that they are recomputed.
const MOST_VERDICTS: usize = 4096;
/// The most publishers of a topic reported individually, in this process.
const MOST_ALARMS: usize = 64;

#[derive(Debug, Clone, Default)]
pub struct PinRules {
    pub mode: PinMode,
    pub listed: ListedPublishers,
}

pub struct Pins {
    kept: KeptPins,
    audit: AuditLog,
    observer: Arc<dyn Observer>,
    mode: PinMode,
    listed: BTreeMap<String, Vec<Publisher>>,
    names: RwLock<HashMap<Address, String>>,
    verdicts: RwLock<HashMap<(Address, u64), Verdict>>,
    topics: Mutex<HashMap<(Address, String), Known>>,
    live: Mutex<HashMap<u64, Live>>,
}

type Live = (Arc<str>, Arc<Origin>);

struct Judged(Option<Doubt>);

struct Verdict {
    topic: String,
    origin: Arc<Origin>,
    doubt: Option<Doubt>,
}

#[derive(Default)]
struct Known {
    pins: Vec<Publisher>,
    /// The topic had pins before: there is no second first use.
    used: bool,
    /// When the first publisher was pinned on first use, in this process.
    first_use: Option<Instant>,
    /// Pinned publishers that were replaced, as long as nobody has decided which is right.
    undecided: HashSet<String>,
    /// When the operator last accepted a publisher, in this process.
    accepted: HashMap<Publisher, Instant>,
    alarms: usize,
}

pub fn publisher_of(origin: &Origin) -> Publisher {
    Publisher {
        caller_id: pinned_name(&origin.caller_id).into_owned(),
        host: origin.host.clone(),
        type_name: origin.type_name.to_string(),
        md5sum: origin.md5sum.to_ascii_lowercase(),
    }
}

impl Pins {
    pub fn new(ledger: &Ledger, observer: Arc<dyn Observer>, rules: PinRules) -> Self {
        let mut listed: BTreeMap<String, Vec<Publisher>> = BTreeMap::new();
        for (topic, publisher) in rules.listed.0 {
            listed.entry(topic.to_string()).or_default().push(publisher);
        }
        Self {
            audit: ledger.audit.clone(),
            kept: ledger.pins.clone(),
            observer,
            mode: rules.mode,
            listed,
            names: RwLock::default(),
            verdicts: RwLock::default(),
            topics: Mutex::default(),
            live: Mutex::default(),
        }
    }

    pub fn introduce(&self, owner: Address, name: &str) {
        self.names.write().unwrap_or_else(PoisonError::into_inner).insert(owner, name.to_owned());
    }

    pub fn mode(&self) -> PinMode {
        self.mode
    }

    pub fn listed(&self, topic: &str) -> &[Publisher] {
        self.listed.get(topic).map_or(&[], Vec::as_slice)
    }

    pub fn all_listed(&self) -> impl Iterator<Item = (&String, &Publisher)> {
        self.listed.iter().flat_map(|(topic, publishers)| publishers.iter().map(move |one| (topic, one)))
    }

    pub fn connected(&self, topic: &Arc<str>, origin: &Arc<Origin>) {
        let mut live = self.live.lock().unwrap_or_else(PoisonError::into_inner);
        live.insert(origin.number, (Arc::clone(topic), Arc::clone(origin)));
    }

    pub fn lost(&self, number: u64) {
        self.live.lock().unwrap_or_else(PoisonError::into_inner).remove(&number);
    }

    /// Topics with publishers that are being read.
    pub fn live_topics(&self) -> BTreeSet<String> {
        let live = self.live.lock().unwrap_or_else(PoisonError::into_inner);
        live.values().map(|(topic, _)| topic.to_string()).collect()
    }

    pub fn live(&self, topic: &str) -> Vec<Publisher> {
        let live = self.live.lock().unwrap_or_else(PoisonError::into_inner);
        let mut found: Vec<_> =
            live.values().filter(|(name, _)| &**name == topic).map(|(_, origin)| publisher_of(origin)).collect();
        found.sort();
        found.dedup();
        found
    }

    /// Why this publisher's messages must be quarantined. The first doubt raises the alarm; a known verdict is cheap.
    pub fn judge(&self, owner: Address, topic: &str, origin: &Arc<Origin>) -> Option<Doubt> {
        if self.mode == PinMode::Off {
            return None;
        }
        if let Some(Judged(doubt)) = self.judged(owner, origin) {
            return doubt;
        }
        let mut topics = self.topics.lock().unwrap_or_else(PoisonError::into_inner);
        // Another thread may have judged it meanwhile.
        if let Some(Judged(doubt)) = self.judged(owner, origin) {
            return doubt;
        }
        match self.decide(&mut topics, owner, topic, origin) {
            Ok(doubt) => {
                self.keep(owner, topic, origin, doubt);
                doubt
            }
            Err(error) => {
                let text = format!("publishers of {topic} cannot be checked, so their messages are held back: {error}");
                self.observer.alert(true, text);
                Some(Doubt::New)
            }
        }
    }

    fn judged(&self, owner: Address, origin: &Arc<Origin>) -> Option<Judged> {
        let verdicts = self.verdicts.read().unwrap_or_else(PoisonError::into_inner);
        let verdict = verdicts.get(&(owner, origin.number))?;
        (Arc::ptr_eq(&verdict.origin, origin) || verdict.origin == *origin).then_some(Judged(verdict.doubt))
    }

    fn keep(&self, owner: Address, topic: &str, origin: &Arc<Origin>, doubt: Option<Doubt>) {
        let mut verdicts = self.verdicts.write().unwrap_or_else(PoisonError::into_inner);
        if verdicts.len() >= MOST_VERDICTS {
            verdicts.clear();
        }
        let verdict = Verdict { topic: topic.to_owned(), origin: Arc::clone(origin), doubt };
        verdicts.insert((owner, origin.number), verdict);
    }

    /// Whether an origin replaces one that was not doubted itself, without the operator having accepted it since. One
    /// that this owner never saw counts only with `unmet`, or while it is still there.
    fn replaces(&self, owner: Address, origin: &Origin, accepted: Option<&Instant>, unmet: bool) -> bool {
        let Some(rival) = &origin.rival else { return false };
        if accepted.is_some_and(|at| *at >= origin.listed_at) {
            return false;
        }
        let verdicts = self.verdicts.read().unwrap_or_else(PoisonError::into_inner);
        match verdicts.get(&(owner, rival.number)) {
            Some(verdict) => verdict.doubt.is_none(),
            None => unmet || self.live.lock().unwrap_or_else(PoisonError::into_inner).contains_key(&rival.number),
        }
    }

    fn decide(
        &self,
        topics: &mut HashMap<(Address, String), Known>,
        owner: Address,
        topic: &str,
        origin: &Origin,
    ) -> Result<Option<Doubt>, StoreError> {
        let known = self.known(topics, owner, topic)?;
        let publisher = publisher_of(origin);
        let claims = self.claims(known, topic, origin, &publisher);
        if claims == Some(Doubt::New)
            && let Some(former) = self.former_name(owner, origin)
        {
            self.rename(known, owner, topic, (&former, &publisher))?;
            return Ok(None);
        }
        let accepted = known.accepted.get(&publisher);
        let replaces = |unmet| self.replaces(owner, origin, accepted, unmet);
        let doubt = match claims {
            None if replaces(true) => Some(Doubt::Replaced),
            None if known.undecided.contains(&publisher.to_string()) => Some(Doubt::Undecided),
            Some(Doubt::New | Doubt::Type | Doubt::Host) if self.is_first(known, topic, origin) && !replaces(false) => {
                // Without a name it is no identity: whatever comes under its name later is the same publisher.
                if !origin.unnamed {
                    self.pin_first(known, owner, topic, &publisher)?;
                }
                None
            }
            other => other,
        };
        if let Some(doubt) = doubt {
            if doubt == Doubt::Replaced {
                known.undecided.insert(publisher.to_string());
            }
            self.alarm(known, owner, topic, &publisher.to_string(), doubt);
        }
        Ok(doubt)
    }

    /// What an accepted publisher was called before it was named.
    fn former_name(&self, owner: Address, origin: &Origin) -> Option<Publisher> {
        let verdicts = self.verdicts.read().unwrap_or_else(PoisonError::into_inner);
        let former = verdicts.get(&(owner, origin.number)).filter(|verdict| verdict.doubt.is_none())?;
        (former.origin.caller_id != origin.caller_id).then(|| publisher_of(&former.origin))
    }

    /// An accepted publisher got its name: the pin goes with it, unless others have the former one, too.
    fn rename(
        &self,
        known: &mut Known,
        owner: Address,
        topic: &str,
        (former, publisher): (&Publisher, &Publisher),
    ) -> Result<(), StoreError> {
        if self.mode != PinMode::First {
            return Ok(());
        }
        self.pin_first(known, owner, topic, publisher)?;
        if known.pins.contains(former) && !self.live(topic).contains(former) {
            self.kept.unpin(owner, topic, &former.caller_id)?;
            known.pins.retain(|pin| pin.caller_id != former.caller_id);
        }
        Ok(())
    }

    fn claims(&self, known: &Known, topic: &str, origin: &Origin, publisher: &Publisher) -> Option<Doubt> {
        let allowed = || known.pins.iter().chain(self.listed(topic));
        if allowed().any(|pin| pin == publisher) {
            return None;
        }
        let namesakes = || allowed().filter(|pin| pin.caller_id == publisher.caller_id);
        Some(match namesakes().count() {
            0 => Doubt::New,
            _ if namesakes().any(|pin| pin.host == origin.host) => Doubt::Type,
            _ => Doubt::Host,
        })
    }

    /// Whether a publisher belongs to the first set: the topic has no pins yet, or got them while this one was there.
    fn is_first(&self, known: &Known, topic: &str, origin: &Origin) -> bool {
        let begins = !known.used && known.pins.is_empty() && self.listed(topic).is_empty();
        let belongs = known.first_use.is_some_and(|at| origin.listed_at <= at);
        self.mode == PinMode::First && (begins || belongs)
    }

    fn known<'a>(
        &self,
        topics: &'a mut HashMap<(Address, String), Known>,
        owner: Address,
        topic: &str,
    ) -> Result<&'a mut Known, StoreError> {
        let key = (owner, topic.to_owned());
        if !topics.contains_key(&key) {
            let replaced = |alarm: &crate::store::AlarmRow| alarm.reason == Doubt::Replaced.word();
            let alarms = self.kept.alarms(owner, Some(topic))?;
            let known = Known {
                pins: self.kept.list(owner, Some(topic))?.into_iter().map(|row| row.publisher).collect(),
                used: self.kept.was_pinned(owner, topic)?,
                undecided: alarms.into_iter().filter(replaced).map(|alarm| alarm.publisher).collect(),
                ..Known::default()
            };
            topics.insert(key.clone(), known);
        }
        Ok(topics.entry(key).or_default())
    }

    fn pin_first(&self, known: &mut Known, owner: Address, topic: &str, found: &Publisher) -> Result<(), StoreError> {
        self.kept.pin(owner, topic, std::slice::from_ref(found), "first")?;
        known.pins.push(found.clone());
        known.used = true;
        known.first_use.get_or_insert_with(Instant::now);
        let name = clean(&found.to_string(), 200);
        self.note(owner, "pin on first use", &format!("{topic} {name}"), "done")?;
        let (caller, host) = (clean(&found.caller_id, 100), clean(&found.host, 100));
        let number = if caller.ends_with('#') { " (# is any number: it draws one at each start)" } else { "" };
        let text =
            format!("{topic}: pinned {caller} on {host}{number} (first seen): messages from others are quarantined");
        self.observer.alert(false, text);
        Ok(())
    }

    /// Somebody announced a publisher of the topic that the master does not list.
    pub fn unconfirmed(&self, owner: Address, topic: &str, uri: &str) {
        if self.mode == PinMode::Off {
            return;
        }
        let mut topics = self.topics.lock().unwrap_or_else(PoisonError::into_inner);
        if let Ok(known) = self.known(&mut topics, owner, topic) {
            self.alarm(known, owner, topic, uri, Doubt::Unconfirmed);
        }
    }

    /// Reports a doubted publisher, once, even if it cannot be written.
    fn alarm(&self, known: &mut Known, owner: Address, topic: &str, publisher: &str, doubt: Doubt) {
        // A flood of names must not become a flood of messages or rows.
        if known.alarms > MOST_ALARMS {
            return;
        }
        let name = clean(publisher, 200);
        match self.kept.raise_alarm(owner, topic, publisher, doubt.word()) {
            Ok(false) => return,
            Ok(true) => {
                if let Err(error) = self.note(owner, "node forging", &format!("{topic} {name}"), doubt.word()) {
                    self.observer.alert(true, format!("the alarm about {topic} is not in the audit log: {error}"));
                }
            }
            Err(error) => self.observer.alert(true, format!("the alarm about {topic} cannot be kept: {error}")),
        }
        known.alarms += 1;
        let advice = match doubt {
            Doubt::Unconfirmed => "check who can reach this machine",
            _ => {
                "its messages are quarantined: see `authros topics quarantine list`, or accept it with `authros topics pin`"
            }
        };
        let text = match known.alarms {
            ..=MOST_ALARMS => format!("NODE FORGING? {name} on {topic}: {}; {advice}", doubt.text()),
            _ => {
                format!(
                    "NODE FORGING? more than {MOST_ALARMS} alarms on {topic}: further publishers are quarantined \
                     without an alarm"
                )
            }
        };
        self.observer.alert(true, text);
        self.observer.publishers_doubted();
    }

    fn note(&self, owner: Address, action: &str, subject: &str, outcome: &str) -> Result<(), StoreError> {
        let names = self.names.read().unwrap_or_else(PoisonError::into_inner);
        let profile = names.get(&owner).cloned().unwrap_or_else(|| owner.to_string());
        drop(names);
        let (action, outcome) = (action.to_owned(), outcome.to_owned());
        self.audit.append(AuditEntry { at: Timestamp::now(), profile, action, subject: clean(subject, 200), outcome })
    }

    pub fn pin(&self, owner: Address, topic: &str, publishers: &[Publisher]) -> Result<(), StoreError> {
        let mut topics = self.topics.lock().unwrap_or_else(PoisonError::into_inner);
        self.kept.pin(owner, topic, publishers, "operator")?;
        let accepted = topics.get(&(owner, topic.to_owned())).map(|known| known.accepted.clone()).unwrap_or_default();
        topics.remove(&(owner, topic.to_owned()));
        let known = self.known(&mut topics, owner, topic)?;
        known.accepted = accepted;
        known.accepted.extend(publishers.iter().map(|publisher| (publisher.clone(), Instant::now())));
        self.judge_anew(owner, topic, |verdict| verdict.doubt.is_some());
        Ok(())
    }

    /// Returns how many pins are gone.
    pub fn unpin(&self, owner: Address, topic: &str, caller_id: &str) -> Result<u64, StoreError> {
        let mut topics = self.topics.lock().unwrap_or_else(PoisonError::into_inner);
        let name = pinned_name(caller_id);
        let gone = self.kept.unpin(owner, topic, &name)?;
        topics.remove(&(owner, topic.to_owned()));
        self.judge_anew(owner, topic, |verdict| pinned_name(&verdict.origin.caller_id) == name);
        Ok(gone)
    }

    /// Drops verdicts that no longer follow from the pins.
    fn judge_anew(&self, owner: Address, topic: &str, changed: impl Fn(&Verdict) -> bool) {
        let mut verdicts = self.verdicts.write().unwrap_or_else(PoisonError::into_inner);
        verdicts.retain(|(of, _), verdict| *of != owner || verdict.topic != topic || !changed(verdict));
    }
}

#[cfg(test)]
mod tests;
