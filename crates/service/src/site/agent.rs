//! The agent: a site without a chain, on a robot. It captures for its owner and forwards everything to a gateway.

mod policy;

use std::collections::{BTreeSet, HashSet};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde::Serialize;
use tokio::task::{JoinHandle, block_in_place};

use self::policy::{AgentPolicy, PolicyFigures, PolicyKeeper};
use crate::config::RingSettings;
use crate::crypto::{Enrolment, SealedEnrolment, random_bytes};
use crate::gateway::Context;
use crate::model::{
    Digest, ErrorKind, ProfileName, RecordState, RecorderPrefix, SignerId, TopicName, TopicPatterns, clean, counted,
    locked,
};
use crate::pipeline::disk_ring::{Brought, Pulls, SharedRing, Step};
use crate::pipeline::forwarder::{CopyKeeping, Forwarder, Link, Robot};
use crate::pipeline::notices::Notices;
use crate::pipeline::session::TopicFigures;
use crate::pipeline::{Author, CaptureSession, recorder_heads};
use crate::reply::{Failure, Result, internal, refused};
use crate::site::Site;
use crate::store::{DiskRing, RingFigures, StateCounts, TopicCounts};

const PATIENCE: Duration = Duration::from_secs(10);
const LOOK: Duration = Duration::from_millis(200);

#[derive(Debug, Clone, Default)]
pub struct AgentWishes {
    /// Empty = every topic of the enrolment.
    pub topics: Vec<TopicName>,
    pub tags: Vec<(String, String)>,
    pub count: Option<u64>,
    pub length: Option<Duration>,
}

/// Counts cover the whole outbox, over all runs, except `lost`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct AgentFigures {
    pub name: ProfileName,
    /// Sealed and fsynced on this machine.
    pub captured: u64,
    /// Signed for by the gateway.
    pub accepted: u64,
    pub verified: u64,
    /// Lost in transport, or dropped for lack of room or of a key, in this run.
    pub lost: u64,
    pub pending: u64,
    /// Damaged here, or altered at the gateway after it signed for them.
    pub tampered: u64,
    pub gateway: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ring: Option<RingFigures>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub policy: Option<PolicyFigures>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AgentEnd {
    Done,
    /// Everything is captured, but the gateway does not accept it from this robot.
    Refused,
    Told,
}

pub struct Agent {
    site: Arc<Site>,
    name: ProfileName,
    device: SignerId,
    author: Arc<Author>,
    /// The first covers the topics at the start; those added later together share another.
    sessions: Vec<Arc<CaptureSession>>,
    topics: Vec<String>,
    ring: Option<AgentRing>,
    policy: AgentPolicy,
    wishes: AgentWishes,
    link: tokio::sync::watch::Receiver<Link>,
    refused: Arc<Mutex<HashSet<Digest>>>,
    /// Messages in the outbox when this run began.
    before: u64,
    seen: Option<std::time::Instant>,
    forwarder: JoinHandle<()>,
}

impl Agent {
    /// Starts capturing and forwarding; a gateway or master that does not answer may come later.
    pub async fn start(site: &Arc<Site>, mut sealed: SealedEnrolment, wishes: AgentWishes) -> Result<Self> {
        let kept = SealedEnrolment::kept_in(site.parts.home.root());
        sealed.catch_up(&kept)?;
        let enrolment = &sealed.enrolment;
        let (owner, device) = (enrolment.owner, enrolment.device_id());
        let mut policy = block_in_place(|| {
            let keeper = PolicyKeeper::open(&site.plant.ledger.notes, enrolment.domain, owner, device)?;
            AgentPolicy::open(&site.plant.ledger.notes, keeper)
        })?;
        policy.rule(site, &wishes);
        let ring = policy.ring(&site.parts.config);
        let topics = match policy.watched() {
            Some(watched) => watched,
            None => topics(enrolment, &wishes.topics, ring.as_ref().map(|ring| &ring.topics))?,
        };
        site.parts.log.write(&enrolment.name, "agent", &device.to_string(), "begun").await?;
        let author = Arc::new(Author::new(owner));
        author.obey(enrolment);
        let (name, forwarder) = (enrolment.name.clone(), block_in_place(|| forwarder(site, enrolment))?);
        let (provider, observer) = (site.plant.provider, Arc::clone(&site.plant.observer));
        let keeper = Arc::clone(&policy.keeper) as _;
        let notices = Notices::new(provider, observer, Arc::clone(&author), sealed, kept, keeper);
        let ring = ring.map(|ring| AgentRing::begin(site, &author, ring)).transpose()?;
        policy.has_ring.store(ring.is_some(), Ordering::Release);
        let notices = notices.with_ring_while(site.plant.ledger.notes.clone(), &policy.has_ring);
        let named = notices.gateway();
        let forwarder = forwarder.with_errand(Box::new(notices)).following(named);
        let before = site.plant.ledger.counts.by_state(None)?.acknowledged;
        let (link, refused) = (forwarder.link(), forwarder.refused());
        site.gateway.passes_on(link.clone());
        let forwarder = Arc::new(tokio::sync::Mutex::new(forwarder));
        let forwarder = site.supervise("forwarder", move |site| forward(site, Arc::clone(&forwarder)));
        let mut agent = Self {
            site: Arc::clone(site),
            name,
            device,
            author,
            sessions: Vec::new(),
            topics: Vec::new(),
            ring,
            policy,
            wishes,
            link,
            refused,
            before,
            seen: None,
            forwarder,
        };
        agent.watch(&topics);
        if let Some(ring) = &mut agent.ring {
            ring.follow(&agent.topics);
        }
        Ok(agent)
    }

    /// Works until everything requested is verified, or until `told`; calls `progress` at most once a second.
    pub async fn run(&mut self, told: impl Future, mut progress: impl FnMut(&AgentFigures)) -> Result<AgentEnd> {
        let time_is_up = tokio::time::sleep(self.wishes.length.unwrap_or(Duration::MAX));
        tokio::pin!(told, time_is_up);
        let (mut up, mut looks, mut shown) = (false, 0u32, None);
        loop {
            tokio::select! {
                _ = &mut told => return Ok(AgentEnd::Told),
                () = &mut time_is_up, if !up => {
                    up = true;
                    self.sessions.iter().for_each(|session| session.close());
                }
                () = tokio::time::sleep(LOOK) => {}
            }
            let counts = self.site.plant.ledger.counts.by_state(None)?;
            let figures = self.figures_of(&counts);
            if looks.is_multiple_of(5) && shown.as_ref() != Some(&figures) {
                progress(&figures);
                shown = Some(figures);
            }
            looks = looks.wrapping_add(1);
            if self.author.sealing().is_none() {
                self.site.parts.hub.alarm(
                    "this robot's epoch has ended and its owner has not sent the next key: nothing is captured until \
                     the notice arrives or the robot is enrolled again",
                );
            }
            self.follow_policy();
            self.follow_topics();
            if let Some(ring) = &mut self.ring {
                ring.follow(&self.topics);
                // They are in the outbox, but this run did not capture them.
                self.before += ring.work();
            }
            self.state_heads();
            if let Some(end) = self.end(&counts) {
                return Ok(end);
            }
        }
    }

    fn state_heads(&mut self) {
        let Some(keys) = self.author.sealing() else { return };
        let (plant, every) = (&self.site.plant, self.site.parts.config.audit_every);
        match block_in_place(|| recorder_heads::state(plant, self.author.address, &keys, every, &mut self.seen)) {
            Ok(Some(_)) => self.site.parts.hub.stored.notify_waiters(),
            Ok(None) => {}
            Err(error) => {
                self.site.parts.hub.alarm(&format!("the recorder's head could not be recorded: {error}"));
            }
        }
    }

    fn follow_topics(&mut self) {
        let is_chosen = !self.wishes.topics.is_empty() || self.policy.watched().is_some();
        if is_chosen || self.sessions.iter().all(|session| session.is_closed()) {
            return;
        }
        self.watch_new(&self.wanted().unwrap_or_default());
    }

    fn end(&self, counts: &StateCounts) -> Option<AgentEnd> {
        let taken: u64 = self.each_topic().map(|topic| topic.captured).sum();
        if !self.sessions.iter().all(|session| session.is_closed()) || counts.acknowledged < self.before + taken {
            return None;
        }
        let pending = counts.pending_of_any_kind();
        if pending == 0 {
            return Some(AgentEnd::Done);
        }
        let aside = locked(&self.refused).len();
        if pending <= aside as u64 {
            return Some(AgentEnd::Refused);
        }
        matches!(&*self.link.borrow(), Link::Refused(_)).then_some(AgentEnd::Refused)
    }

    pub fn figures(&self) -> Result<AgentFigures> {
        Ok(self.figures_of(&self.site.plant.ledger.counts.by_state(None)?))
    }

    fn figures_of(&self, counts: &StateCounts) -> AgentFigures {
        let lost: u64 = self.each_topic().map(|topic| topic.lost).sum();
        let verified = counts.data_in(RecordState::Verified);
        let ring = self.ring.as_ref().map(|ring| &ring.ring);
        AgentFigures {
            name: self.name.clone(),
            captured: counts.acknowledged,
            accepted: verified + counts.data_in(RecordState::Submitted),
            verified,
            lost,
            pending: counts.pending(),
            tampered: counts.data_in(RecordState::Tampered),
            gateway: match &*self.link.borrow() {
                Link::Connecting => "connecting".to_owned(),
                Link::Up => "connected".to_owned(),
                Link::InPlace(text) | Link::Away(text) | Link::Refused(text) => clean(text, 300),
            },
            ring: ring.map(|ring| locked(ring).figures()),
            policy: self.policy.figures(),
        }
    }

    fn each_topic(&self) -> impl Iterator<Item = TopicFigures> {
        self.sessions.iter().flat_map(|session| session.figures())
    }

    pub fn topics(&self) -> Result<Vec<TopicCounts>> {
        Ok(self.site.plant.ledger.counts.by_state(None)?.topics)
    }

    pub async fn stop(&mut self) {
        for session in &self.sessions {
            session.close();
            for topic in &self.topics {
                self.site.recorder.leave(topic, &self.author, session);
            }
        }
        if let Some(ring) = &self.ring {
            ring.topics.iter().for_each(|topic| ring.keep(topic, false));
        }
        self.forwarder.abort();
        let log = &self.site.parts.log;
        if let Err(failure) = log.write(&self.name, "agent", &self.device.to_string(), "done").await {
            self.site.parts.hub.alarm(&failure.message);
        }
        Arc::clone(&self.site).stop().await;
    }
}

async fn forward(site: Arc<Site>, forwarder: Arc<tokio::sync::Mutex<Forwarder>>) {
    forwarder.lock().await.run(&site.parts.hub.stored).await;
}

fn forwarder(site: &Site, enrolment: &Enrolment) -> Result<Forwarder> {
    let robot = Robot {
        owner: enrolment.owner,
        context: Context { provider: site.plant.provider, domain: enrolment.domain },
        name: enrolment.name.clone(),
        token: enrolment.token,
        patience: PATIENCE,
        home: site.parts.home.root().to_owned(),
    };
    let forwarder = Forwarder::new(site.plant.clone(), robot, &enrolment.gateway)?;
    let config = &site.parts.config;
    let time = config.outbox_keep.unwrap_or(Duration::MAX);
    let forwarder = forwarder.keeping(CopyKeeping { time, reserve: config.disk_reserve });
    forwarder.tidy()?;
    Ok(forwarder)
}

/// Some requested topics may lack a key for now: their messages are refused and counted until it comes.
fn topics(enrolment: &Enrolment, asked: &[TopicName], ring: Option<&TopicPatterns>) -> Result<Vec<String>> {
    let covered = enrolment.keys.now.key.topics();
    if let (Some(covered), Some(strange)) = (&covered, asked.first())
        && !asked.iter().any(|topic| covered.iter().any(|name| name == topic.as_str()))
    {
        return Err(refused(format!(
            "this enrolment has no key for topic {strange}, only for {}; its owner adds it with `authros robot topics \
             add {} {strange}`",
            clean(&covered.join(", "), 300),
            enrolment.name
        )));
    }
    let topics: BTreeSet<String> = match covered {
        Some(covered) if asked.is_empty() => {
            covered.into_iter().filter(|topic| !ring.is_some_and(|ring| ring.matches(topic))).collect()
        }
        _ => asked.iter().map(ToString::to_string).collect(),
    };
    if topics.is_empty() && ring.is_none() {
        return Err(Failure::new(
            ErrorKind::Usage,
            "choose what to capture with --topic; this enrolment covers all topics",
        ));
    }
    if topics.iter().any(|topic| topic.parse::<TopicName>().is_err()) {
        return Err(internal("the enrolment contains an invalid topic; ask its owner to enrol the robot again"));
    }
    Ok(topics.into_iter().collect())
}

/// Time limit of one round of pulling.
const AT_WORK: Duration = Duration::from_millis(100);
const RING_LOOK: Duration = Duration::from_secs(1);

struct AgentRing {
    site: Arc<Site>,
    author: Arc<Author>,
    ring: SharedRing,
    pulls: Pulls,
    /// `None` = off; its content expires by age.
    patterns: Option<TopicPatterns>,
    topics: BTreeSet<String>,
    looked: Option<Instant>,
    failed: bool,
}

impl AgentRing {
    pub fn begin(site: &Arc<Site>, author: &Arc<Author>, settings: RingSettings) -> Result<Self> {
        let RingSettings { limits, topics } = settings;
        let recorder = RecorderPrefix::ring(random_bytes()?);
        let ring = block_in_place(|| DiskRing::open(&site.parts.home.ring(), limits, recorder))?;
        let ring: SharedRing = Arc::new(Mutex::new(ring));
        site.sealer.fill(&ring);
        let pulls = Pulls::new(site.plant.clone(), Arc::clone(&ring), author.address);
        let (site, author, patterns) = (Arc::clone(site), Arc::clone(author), Some(topics));
        Ok(Self { site, author, ring, pulls, patterns, topics: BTreeSet::new(), looked: None, failed: false })
    }

    pub fn change(&mut self, settings: Option<RingSettings>) -> Result<()> {
        let (limits, patterns) = settings.map(|settings| (settings.limits, settings.topics)).unzip();
        self.patterns = patterns;
        let (kept, gone) = std::mem::take(&mut self.topics).into_iter().partition(|topic| self.takes(topic));
        self.topics = kept;
        gone.iter().for_each(|topic| self.keep(topic, false));
        self.looked = None;
        if let Some(limits) = limits {
            let mut ring = locked(&self.ring);
            block_in_place(|| ring.set_limits(limits))?;
        }
        Ok(())
    }

    pub fn takes(&self, topic: &str) -> bool {
        self.patterns.as_ref().is_some_and(|patterns| patterns.matches(topic))
    }

    fn keep(&self, topic: &str, keep: bool) {
        self.site.recorder.keep_in_ring(topic, &self.author, keep);
    }

    pub fn follow(&mut self, watched: &[String]) {
        if self.looked.is_some_and(|at| at.elapsed() < RING_LOOK) {
            return;
        }
        self.looked = Some(Instant::now());
        let mut ring = locked(&self.ring);
        let now = ring.now();
        let tended = block_in_place(|| ring.tend(now));
        drop(ring);
        if let Err(error) = tended {
            self.tell(&format!("the ring still holds expired records: {error}"));
        }
        let new: Vec<String> = possible(&self.site, &self.author)
            .into_iter()
            .filter(|topic| self.takes(topic) && !self.topics.contains(topic) && !watched.contains(topic))
            .filter(|topic| topic.parse::<TopicName>().is_ok())
            .collect();
        if !new.is_empty() {
            new.iter().for_each(|topic| self.keep(topic, true));
            self.topics.extend(new);
            self.site.ros.wishes_changed();
        }
    }

    /// Serves pulls for a moment; returns how many records are new in the outbox.
    pub fn work(&mut self) -> u64 {
        let (begun, mut moved) = (Instant::now(), 0);
        while begun.elapsed() < AT_WORK {
            match block_in_place(|| self.pulls.step()) {
                Ok(Step::Idle) => break,
                Ok(Step::Moved(count)) => moved += count,
                Ok(Step::Done(_, brought)) => {
                    self.failed = false;
                    self.site.parts.hub.inform(&words(&brought));
                }
                Err(error) => {
                    self.tell(&format!("the ring data that the owner requested is not in the outbox yet: {error}"));
                    break;
                }
            }
        }
        if moved > 0 {
            self.site.parts.hub.stored.notify_waiters();
        }
        moved
    }

    fn tell(&mut self, text: &str) {
        if !self.failed {
            self.site.parts.hub.alarm(text);
        }
        self.failed = true;
    }
}

fn possible(site: &Site, author: &Author) -> Vec<String> {
    let Some(keys) = author.sealing() else { return Vec::new() };
    if let Some(covered) = keys.names() {
        return covered;
    }
    site.ros.names().iter().map(ToString::to_string).collect()
}

fn words(brought: &Brought) -> String {
    if brought.messages == 0 {
        return "the ring has nothing new of what the owner requested".to_owned();
    }
    let topics: Vec<&str> = brought.topics.iter().map(String::as_str).collect();
    format!(
        "moved from the ring to the outbox: {} of {}",
        counted(brought.messages, "message"),
        clean(&topics.join(", "), 200)
    )
}
