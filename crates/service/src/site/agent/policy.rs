//! The policy of an agent, and the statement that reports it to the owner.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde::Serialize;
use tokio::sync::watch;
use tokio::task::block_in_place;

use super::AgentRing;
use crate::config::{Config, RingSettings, RingWish, RobotPolicy};
use crate::crypto::{LONGEST_POLICY, SignedPolicy};
use crate::model::{Address, Domain, PolicyReport, RecordKind, SignerId, TopicName, clean, counted, hex, locked};
use crate::pipeline::notices::PolicyTaker;
use crate::pipeline::statement::{self, Statement};
use crate::pipeline::{CaptureSession, PipelineError, recorder_heads};
use crate::reply::Result;
use crate::site::{Agent, AgentWishes, Site};
use crate::store::Notes;
use crate::store::notes::{PolicyHere, PolicyKept, PolicyTold};

const AGAIN: Duration = Duration::from_secs(10);

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PolicyFigures {
    /// 0 = the robot's own settings alone.
    pub version: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
    /// The robot's own settings that the policy overrides, in words.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub overruled: Vec<String>,
}

pub(super) struct AgentPolicy {
    pub keeper: Arc<PolicyKeeper>,
    changed: watch::Receiver<()>,
    kept: PolicyKept,
    /// The version in force before `kept`.
    before: u64,
    /// Why the ring differs from the policy, and when to retry.
    unapplied: Option<(String, Instant)>,
    policy: RobotPolicy,
    overruled: Vec<String>,
    told: Option<String>,
    pub has_ring: Arc<AtomicBool>,
}

impl AgentPolicy {
    pub fn open(notes: &Notes, keeper: PolicyKeeper) -> Result<Self> {
        let keeper = Arc::new(keeper);
        let (changed, told) = (keeper.changed.subscribe(), notes.read(&keeper.told())?);
        let mut policy = Self {
            keeper,
            changed,
            kept: PolicyKept::default(),
            before: 0,
            unapplied: None,
            policy: RobotPolicy::default(),
            overruled: Vec::new(),
            told,
            has_ring: Arc::new(AtomicBool::new(false)),
        };
        policy.read();
        Ok(policy)
    }

    /// Loads the kept policy; returns whether it decides anything differently.
    fn read(&mut self) -> bool {
        if self.unapplied.is_none() {
            self.before = self.kept.version;
        }
        self.kept = self.keeper.kept();
        let policy = match RobotPolicy::read(&self.kept.text) {
            Ok(policy) => policy,
            // A later version of this program accepted it.
            Err(error) => {
                self.kept.version = 0;
                self.kept.refused = Some(clean(&error.to_string(), WIDEST));
                RobotPolicy::default()
            }
        };
        let changed = policy != self.policy;
        self.policy = policy;
        changed
    }

    pub fn watched(&self) -> Option<Vec<String>> {
        self.policy.watched.as_ref().map(|topics| topics.iter().map(ToString::to_string).collect())
    }

    pub fn ring(&self, config: &Config) -> Option<RingSettings> {
        match &self.policy.ring {
            RingWish::Own => config.ring.clone(),
            RingWish::Off => None,
            RingWish::Keep(ring) => Some(ring.clone()),
        }
    }

    pub fn rule(&mut self, site: &Site, wishes: &AgentWishes) {
        let config = &site.parts.config;
        let rules = self.policy.rules.as_ref().unwrap_or(&config.topic_rules);
        site.recorder.set_rules(rules.clone());
        self.overruled = overruled(&self.policy, config, wishes);
        for text in &self.overruled {
            let version = self.kept.version;
            site.parts.hub.warn(&format!("policy {version} overrides this robot's own setting: {text}"));
        }
    }

    pub fn figures(&self) -> Option<PolicyFigures> {
        let PolicyReport { heard, running: version, refused, overruled } = self.report();
        (heard > 0).then_some(PolicyFigures { version, refused, overruled })
    }

    /// Records the outcome; returns whether the failure is a new one.
    fn ring_applied(&mut self, failure: Option<String>) -> bool {
        let why = failure.map(|failure| clean(&failure, WIDEST));
        let is_new = why.is_some() && why.as_ref() != self.unapplied.as_ref().map(|(why, _)| why);
        self.unapplied = why.map(|why| (why, Instant::now() + AGAIN));
        is_new
    }

    fn report(&self) -> PolicyReport {
        let PolicyKept { version, heard, refused, .. } = self.kept.clone();
        let (running, refused) = match &self.unapplied {
            None => (version, refused),
            Some((why, _)) => (self.before, refused.or_else(|| Some(why.clone()))),
        };
        PolicyReport { heard, running, refused, overruled: self.overruled.clone() }
    }
}

fn overruled(policy: &RobotPolicy, config: &Config, wishes: &AgentWishes) -> Vec<String> {
    let own: Vec<&str> = wishes.topics.iter().map(TopicName::as_str).collect();
    let watched = policy.watched.as_ref().filter(|watched| !own.is_empty() && **watched != wishes.topics);
    let watched = watched.map(|topics| {
        format!("--topic {}, the policy watches {}", own.join(" "), counted(topics.len() as u64, "topic"))
    });
    let own = config.topic_rules.0.len();
    let rules = policy.rules.as_ref().filter(|rules| own > 0 && **rules != config.topic_rules);
    let rules = rules.map(|rules| format!("{own} [[topic]] rules, the policy has {}", rules.0.len()));
    let ring = match (&policy.ring, &config.ring) {
        (RingWish::Own, _) | (_, None) => None,
        (RingWish::Off, Some(own)) => Some((own, "no ring".to_owned())),
        (RingWish::Keep(ring), Some(own)) => {
            (ring != own).then(|| (own, format!("{} of {}", ring.limits, ring.topics)))
        }
    };
    let ring = ring.map(|(own, policy)| format!("ring {} of {}, the policy sets {policy}", own.limits, own.topics));
    [watched, rules, ring].into_iter().flatten().map(|text| clean(&text, WIDEST)).collect()
}

impl Agent {
    pub(super) fn follow_policy(&mut self) {
        if self.policy.changed.has_changed().unwrap_or(false) {
            self.policy.changed.mark_unchanged();
            if self.policy.read() {
                self.policy.rule(&self.site, &self.wishes);
                self.apply_policy();
            }
        }
        if self.policy.unapplied.as_ref().is_some_and(|(_, again)| *again <= Instant::now()) {
            self.apply_policy();
        }
        if let Err(failure) = self.tell_policy() {
            let text = format!("this robot's policy cannot be reported to the owner yet: {}", failure.message);
            self.site.parts.hub.alarm(&text);
        }
    }

    fn apply_policy(&mut self) {
        let wanted = self.policy.ring(&self.site.parts.config);
        let failure = self.change_ring(wanted).err();
        let failure = failure.map(|why| format!("the ring does not match the owner's policy yet: {}", why.message));
        if self.policy.ring_applied(failure.clone()) {
            self.site.parts.hub.alarm(&failure.unwrap_or_default());
        }
        let has_ring = self.ring.as_ref().is_some_and(|ring| ring.patterns.is_some());
        self.policy.has_ring.store(has_ring, Ordering::Release);
        self.watch_as_wanted();
    }

    fn change_ring(&mut self, wanted: Option<RingSettings>) -> Result<()> {
        if let Some(ring) = &mut self.ring {
            return ring.change(wanted);
        }
        if let Some(wanted) = wanted {
            self.ring = Some(AgentRing::begin(&self.site, &self.author, wanted)?);
        }
        Ok(())
    }

    /// The topics to watch; `None` while there is no key to tell.
    pub(super) fn wanted(&self) -> Option<Vec<String>> {
        if let Some(watched) = self.policy.watched() {
            return Some(watched);
        }
        if !self.wishes.topics.is_empty() {
            return Some(self.wishes.topics.iter().map(ToString::to_string).collect());
        }
        let covered = self.author.sealing()?.names().unwrap_or_default();
        let is_for_ring = |topic: &String| self.ring.as_ref().is_some_and(|ring| ring.takes(topic));
        let is_topic = |topic: &String| topic.parse::<TopicName>().is_ok();
        Some(covered.into_iter().filter(|topic| is_topic(topic) && !is_for_ring(topic)).collect())
    }

    fn watch_as_wanted(&mut self) {
        let Some(wanted) = self.wanted() else { return };
        if self.sessions.iter().all(|session| session.is_closed()) {
            return;
        }
        // Start first, then the ring, then stop, so that no message falls between them.
        self.watch_new(&wanted);
        if let Some(ring) = &mut self.ring {
            ring.follow(&wanted);
        }
        let before = std::mem::take(&mut self.topics).into_iter();
        let (kept, gone): (Vec<String>, Vec<String>) = before.partition(|topic| wanted.contains(topic));
        self.topics = kept;
        for topic in &gone {
            self.sessions.iter().for_each(|session| self.site.recorder.leave(topic, &self.author, session));
        }
        self.site.ros.wishes_changed();
    }

    pub(super) fn watch_new(&mut self, wanted: &[String]) {
        let new: Vec<String> = wanted.iter().filter(|topic| !self.topics.contains(topic)).cloned().collect();
        if !new.is_empty() {
            self.watch(&new);
        }
    }

    pub(super) fn watch(&mut self, topics: &[String]) {
        let session = Arc::new(CaptureSession::unfollowed(topics, self.wishes.count, self.wishes.tags.clone()));
        for topic in topics {
            self.site.recorder.join(topic, &self.author, None, &session);
            if self.author.sealing().is_some_and(|keys| keys.topic(topic).is_none()) {
                let name = &self.name;
                self.site.parts.hub.warn(&format!(
                    "there is no key for topic {topic}: its messages are dropped and counted until the owner adds it \
                     with `authros robot topics add {name} {topic}`"
                ));
            }
        }
        self.sessions.push(session);
        self.topics.extend_from_slice(topics);
        self.site.ros.wishes_changed();
    }

    fn tell_policy(&mut self) -> Result<()> {
        if self.policy.kept.heard == 0 {
            return Ok(());
        }
        let body = self.policy.report().encode();
        let told = hex(&body);
        if self.policy.told.as_ref() == Some(&told) {
            return Ok(());
        }
        let Some(keys) = self.author.sealing() else { return Ok(()) };
        let (kind, topic) = (RecordKind::Audit, recorder_heads::TOPIC);
        let statement = Statement { kind, topic, type_name: PolicyReport::TYPE, body: &body };
        let plant = &self.site.plant;
        if block_in_place(|| statement::state_to_be_found(plant, self.author.address, &keys, statement))?.is_some() {
            self.site.parts.hub.stored.notify_waiters();
        }
        plant.ledger.notes.write(&self.policy.keeper.told(), &told)?;
        self.policy.told = Some(told);
        Ok(())
    }
}

/// The widest text in a report to the owner, characters.
pub(super) const WIDEST: usize = 255;

pub(super) struct PolicyKeeper {
    notes: Notes,
    domain: Domain,
    owner: Address,
    device: SignerId,
    kept: Mutex<PolicyKept>,
    pub changed: watch::Sender<()>,
}

impl PolicyKeeper {
    pub fn open(notes: &Notes, domain: Domain, owner: Address, device: SignerId) -> Result<Self> {
        let kept = notes.read(&PolicyHere { owner, device })?.unwrap_or_default();
        let (notes, changed) = (notes.clone(), watch::channel(()).0);
        Ok(Self { notes, domain, owner, device, kept: Mutex::new(kept), changed })
    }

    pub fn kept(&self) -> PolicyKept {
        locked(&self.kept).clone()
    }

    pub fn told(&self) -> PolicyTold {
        PolicyTold { owner: self.owner, device: self.device }
    }

    fn judged(&self, policy: &SignedPolicy, kept: &PolicyKept) -> Result<String, String> {
        let unsigned = |_| "the owner's account did not sign it for this robot".to_owned();
        policy.check(&self.domain, &self.owner, &self.device).map_err(unsigned)?;
        let (version, runs) = (policy.version, kept.version);
        if version < runs || version == 0 {
            return Err(format!("its version {version} is lower than {runs}, which this robot uses"));
        }
        if policy.text.len() > LONGEST_POLICY {
            return Err(format!("it has {} bytes, and {LONGEST_POLICY} are allowed", policy.text.len()));
        }
        let text = std::str::from_utf8(&policy.text).map_err(|_| "it is not UTF-8".to_owned())?;
        if version == runs && text != kept.text {
            return Err(format!("another policy with the same version {version} is in force here"));
        }
        RobotPolicy::read(text).map(|_| text.to_owned()).map_err(|error| clean(&error.to_string(), WIDEST))
    }
}

impl PolicyTaker for PolicyKeeper {
    fn take(&self, policy: &SignedPolicy) -> Result<String, PipelineError> {
        let mut kept = locked(&self.kept);
        let (next, told) = match self.judged(policy, &kept) {
            Ok(text) => {
                let version = policy.version;
                let told = format!("the owner's policy {version} is now in force");
                (PolicyKept { version, text, heard: version, refused: None }, told)
            }
            Err(why) => {
                let told = format!("the owner's policy {} is not applied: {why}", policy.version);
                (PolicyKept { heard: policy.version, refused: Some(why), ..kept.clone() }, told)
            }
        };
        self.notes.write(&PolicyHere { owner: self.owner, device: self.device }, &next)?;
        *kept = next;
        self.changed.send_replace(());
        Ok(told)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crypto::{EoaSecret, SignedPolicy};
    use crate::model::{Domain, SignerId};
    use crate::store::Ledger;

    #[test]
    fn a_policy_whose_ring_could_not_be_made_is_not_told_as_in_force() {
        let home = tempfile::tempdir().expect("a folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("a ledger");
        let (domain, device) = (Domain([1; 32]), SignerId([9; 32]));
        let account = EoaSecret::generate().expect("generates");
        let keeper = PolicyKeeper::open(&ledger.notes, domain, account.address(), device).expect("opens");
        let mut policy = AgentPolicy::open(&ledger.notes, keeper).expect("opens");
        let take = |policy: &mut AgentPolicy, version, text: &str| {
            let signed = SignedPolicy::sign(&domain, &account, device, version, text).expect("signs");
            policy.keeper.take(&signed).expect("kept");
            policy.read()
        };
        let told = |policy: &AgentPolicy| (policy.report().heard, policy.report().running, policy.report().refused);
        let ring = |keep: &str| format!("ring.keep = \"{keep}\"\nring.topics = [\"/a\"]\n");
        assert!(take(&mut policy, 1, "[[watch]]\ntopic = \"/odom\"\n"));
        assert_eq!(told(&policy), (1, 1, None));
        assert!(take(&mut policy, 2, &ring("5m, 64MiB")));
        assert!(policy.ring_applied(Some("the disk is full".to_owned())), "the operator is told");
        assert!(!policy.ring_applied(Some("the disk is full".to_owned())), "once");
        assert_eq!(told(&policy), (2, 1, Some("the disk is full".to_owned())));
        assert!(take(&mut policy, 3, &ring("9m, 64MiB")));
        assert!(!policy.ring_applied(Some("the disk is full".to_owned())));
        assert_eq!(told(&policy), (3, 1, Some("the disk is full".to_owned())), "the first is still the last that was");
        assert!(!policy.ring_applied(None));
        assert_eq!(told(&policy), (3, 3, None));
    }

    #[test]
    fn what_a_robots_own_settings_say_otherwise_is_named() {
        let file = "ring.keep = \"5m, 64MiB\"\nring.topics = [\"/a\"]\n[[topic]]\nmatch = \"/b\"\nrate = 2\n";
        let place = std::path::Path::new("config.toml");
        let config = Config::resolve(&|_| None, &|_| None, Some((place, file))).expect("settings");
        let wishes = AgentWishes { topics: vec!["/b".parse().expect("a name")], ..AgentWishes::default() };
        let of = |text: &str| overruled(&RobotPolicy::read(text).expect(text), &config, &wishes);
        assert!(of("").is_empty() && of(file).is_empty() && of("[[watch]]\ntopic = \"/b\"\n").is_empty());
        let all = of("ring.keep = \"\"\nring.topics = \"\"\n[[watch]]\ntopic = \"/c\"\n[[topic]]\nmatch = \"/b\"\n");
        let told: Vec<bool> = ["--topic /b", "1 [[topic]] rules", "sets no ring"]
            .iter()
            .map(|words| all.iter().any(|text| text.contains(words)))
            .collect();
        assert_eq!((told, all.len()), (vec![true; 3], 3), "{all:?}");
    }
}

#[cfg(test)]
mod kept_policy_tests {
    use super::*;
    use crate::crypto::EoaSecret;
    use crate::store::Ledger;

    const DOMAIN: Domain = Domain([1; 32]);
    const DEVICE: SignerId = SignerId([9; 32]);
    const WATCH: &str = "[[watch]]\ntopic = \"/odom\"\n";

    #[test]
    fn a_policy_is_taken_up_signed_newer_and_valid_and_is_there_after_a_restart() {
        let home = tempfile::tempdir().expect("a folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("a ledger");
        let (account, thief) = (EoaSecret::generate().expect("generates"), EoaSecret::generate().expect("generates"));
        let open = || PolicyKeeper::open(&ledger.notes, DOMAIN, account.address(), DEVICE).expect("opens");
        let keeper = open();
        let signed = |by: &EoaSecret, version, text: &str| {
            SignedPolicy::sign(&DOMAIN, by, DEVICE, version, text).expect("signs")
        };
        let state = |keeper: &PolicyKeeper| {
            let PolicyKept { version, text, heard, refused } = keeper.kept();
            (version, text, heard, refused.unwrap_or_default())
        };
        keeper.take(&signed(&account, 2, WATCH)).expect("kept");
        assert_eq!(state(&keeper), (2, WATCH.to_owned(), 2, String::new()));

        let other_robot = SignedPolicy::sign(&DOMAIN, &account, SignerId([8; 32]), 9, WATCH).expect("signs");
        let not_text = SignedPolicy { text: vec![0xff; 4], ..signed(&account, 3, "") };
        for (policy, told) in [
            (signed(&thief, 3, ""), "did not sign"),
            (other_robot, "did not sign"),
            (not_text, "did not sign"),
            (signed(&account, 1, WATCH), "lower than 2"),
            (signed(&account, 2, ""), "same version 2"),
            (signed(&account, 3, "cache.url = \"redis://evil\"\n"), "no 'cache.url'"),
            (signed(&account, 4, "ring.keep = \"much\"\nring.topics = [\"/a\"]\n"), "ring.keep"),
            (signed(&account, 5, "[["), "not valid TOML"),
        ] {
            let heard = policy.version;
            keeper.take(&policy).expect("kept");
            let (version, text, known, refused) = state(&keeper);
            assert_eq!((version, text.as_str(), known), (2, WATCH, heard), "what runs goes on");
            assert!(refused.contains(told), "{told}: {refused}");
        }
        assert_eq!(state(&open()), state(&keeper), "after a restart");
        keeper.take(&signed(&account, 2, WATCH)).expect("kept");
        assert_eq!(state(&keeper), (2, WATCH.to_owned(), 2, String::new()), "heard once more");
        keeper.take(&signed(&account, 6, "")).expect("kept");
        assert_eq!(state(&open()), (6, String::new(), 6, String::new()), "cleared");
    }

    #[test]
    fn each_enrolment_in_a_home_has_its_own_policy() {
        let home = tempfile::tempdir().expect("a folder");
        let ledger = Ledger::open(&home.path().join("ledger.db")).expect("a ledger");
        let account = EoaSecret::generate().expect("generates");
        let open = |device| PolicyKeeper::open(&ledger.notes, DOMAIN, account.address(), device).expect("opens");
        open(DEVICE).take(&SignedPolicy::sign(&DOMAIN, &account, DEVICE, 5, WATCH).expect("signs")).expect("kept");
        let earlier = PolicyKept { version: 5, text: WATCH.to_owned(), heard: 5, refused: None };
        assert_eq!(open(DEVICE).kept(), earlier);
        let other = SignerId([8; 32]);
        let keeper = open(other);
        assert_eq!(keeper.kept(), PolicyKept::default(), "the policy of the device before is not in force");
        assert_ne!(keeper.told(), open(DEVICE).told());
        let first = SignedPolicy::sign(&DOMAIN, &account, other, 1, "").expect("signs");
        keeper.take(&first).expect("kept");
        assert_eq!((keeper.kept().version, keeper.kept().refused), (1, None), "the first one is taken up");
        assert_eq!((open(other).kept().version, open(DEVICE).kept()), (1, earlier));
    }
}
