//! The ring of an agent: which topics go into it, and what its owner asks of it.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::task::block_in_place;

use crate::config::RingSettings;
use crate::crypto::random_bytes;
use crate::model::{RecorderPrefix, TopicName, TopicPatterns, clean};
use crate::pipeline::disk_ring::{Brought, Pulls, SharedRing, Step};
use crate::pipeline::{Author, Observer as _};
use crate::service::reply::Failure;
use crate::site::Site;
use crate::site::capture::ros::RosState;
use crate::store::{DiskRing, RingFigures};

/// The longest that one look brings records in.
const AT_WORK: Duration = Duration::from_millis(100);
/// Between two looks at what falls out by its age, and at new topics of the graph.
const LOOK: Duration = Duration::from_secs(1);

/// A ring at work.
pub(super) struct AgentRing {
    ring: SharedRing,
    pulls: Pulls,
    /// None = it is off; what is in it falls out by its age.
    patterns: Option<TopicPatterns>,
    /// Topics that go into it.
    topics: BTreeSet<String>,
    looked: Option<Instant>,
    /// Whether the last attempt failed, and it was told.
    failed: bool,
}

impl AgentRing {
    /// Opens the ring of this home; from now on the sealer fills it.
    ///
    /// # Errors
    /// If its folder cannot be used.
    pub fn begin(site: &Site, author: &Author, settings: RingSettings) -> Result<Self, Failure> {
        let RingSettings { limits, topics } = settings;
        let recorder = RecorderPrefix::ring(random_bytes()?);
        let ring = block_in_place(|| DiskRing::open(&site.parts.home.ring(), limits, recorder))?;
        let ring: SharedRing = Arc::new(Mutex::new(ring));
        site.sealer.fill(&ring);
        let pulls = Pulls::new(site.plant.clone(), Arc::clone(&ring), author.address);
        Ok(Self { ring, pulls, patterns: Some(topics), topics: BTreeSet::new(), looked: None, failed: false })
    }

    /// From now on it keeps this, or nothing more.
    ///
    /// # Errors
    /// If what is too much cannot be removed.
    pub fn change(&mut self, site: &Site, author: &Arc<Author>, settings: Option<RingSettings>) -> Result<(), Failure> {
        let (limits, patterns) = settings.map(|settings| (settings.limits, settings.topics)).unzip();
        self.patterns = patterns;
        let before = std::mem::take(&mut self.topics);
        let (kept, gone): (BTreeSet<String>, BTreeSet<String>) =
            before.into_iter().partition(|topic| self.takes(topic));
        self.topics = kept;
        gone.iter().for_each(|topic| site.recorder.keep_in_ring(topic, author, false));
        self.looked = None;
        if let Some(limits) = limits {
            let mut ring = self.ring.lock().unwrap_or_else(PoisonError::into_inner);
            block_in_place(|| ring.set_limits(limits))?;
        }
        Ok(())
    }

    /// Whether it is on.
    pub fn is_on(&self) -> bool {
        self.patterns.is_some()
    }

    /// Whether a topic is for the ring, unless it is watched.
    pub fn takes(&self, topic: &str) -> bool {
        self.patterns.as_ref().is_some_and(|patterns| patterns.matches(topic))
    }

    /// What falls out falls out, and topics that are new are taken in, unless they are watched.
    pub fn follow(&mut self, site: &Site, author: &Arc<Author>, watched: &[String]) {
        if self.looked.is_some_and(|at| at.elapsed() < LOOK) {
            return;
        }
        self.looked = Some(Instant::now());
        let mut ring = self.ring.lock().unwrap_or_else(PoisonError::into_inner);
        let now = ring.now();
        let tended = block_in_place(|| ring.tend(now));
        drop(ring);
        if let Err(error) = tended {
            self.tell(site, &format!("what is too old for the ring is still in it: {error}"));
        }
        let new: Vec<String> = possible(site, author)
            .into_iter()
            .filter(|topic| self.takes(topic) && !self.topics.contains(topic) && !watched.contains(topic))
            .filter(|topic| topic.parse::<TopicName>().is_ok())
            .collect();
        if new.is_empty() {
            return;
        }
        for topic in new {
            site.recorder.keep_in_ring(&topic, author, true);
            self.topics.insert(topic);
        }
        site.ros.wishes_changed();
    }

    /// Brings in what the owner asks for, for a moment; returns how many records are in the outbox now that were not.
    pub fn work(&mut self, site: &Site) -> u64 {
        let (begun, mut moved) = (Instant::now(), 0);
        while begun.elapsed() < AT_WORK {
            match block_in_place(|| self.pulls.step()) {
                Ok(Step::Idle) => break,
                Ok(Step::Moved(count)) => moved += count,
                Ok(Step::Done(_, brought)) => {
                    self.failed = false;
                    site.parts.hub.alert(false, words(&brought));
                }
                Err(error) => {
                    self.tell(site, &format!("what the owner asks of the ring is not in the outbox yet: {error}"));
                    break;
                }
            }
        }
        if moved > 0 {
            site.parts.hub.stored.notify_waiters();
        }
        moved
    }

    /// What it holds.
    pub fn figures(&self) -> RingFigures {
        self.ring.lock().unwrap_or_else(PoisonError::into_inner).figures()
    }

    /// No further message goes into it.
    pub fn end(&self, site: &Site, author: &Arc<Author>) {
        self.topics.iter().for_each(|topic| site.recorder.keep_in_ring(topic, author, false));
    }

    fn tell(&mut self, site: &Site, text: &str) {
        if !self.failed {
            site.parts.hub.alert(true, text.to_owned());
        }
        self.failed = true;
    }
}

/// The topics that can be sealed at all: those with keys, or with keys for all those of the graph.
fn possible(site: &Site, author: &Author) -> Vec<String> {
    let Some(keys) = author.sealing() else { return Vec::new() };
    if let Some(covered) = keys.names() {
        return covered;
    }
    let link = match &*site.ros.state() {
        RosState::Up(link) | RosState::Down { link: Some(link), .. } => Some(Arc::clone(link)),
        RosState::Off | RosState::Starting | RosState::Down { link: None, .. } => None,
    };
    let of_one = link.map(|link| link.topics()).unwrap_or_default().into_iter().map(|info| info.name);
    of_one.chain(site.ros.second.topics().into_iter().map(|topic| topic.name)).collect()
}

fn words(brought: &Brought) -> String {
    if brought.messages == 0 {
        return "the ring has nothing of what the owner asked for that was not in the outbox before".to_owned();
    }
    let topics: Vec<&str> = brought.topics.iter().map(String::as_str).collect();
    format!("{} messages of {} went from the ring into the outbox", brought.messages, clean(&topics.join(", "), 200))
}
