//! The site's ROS side: master (embedded or real), simulated robots, monitoring node.

use std::collections::{BTreeSet, HashMap};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::{Duration, Instant};

use tokio::sync::watch;
use tokio::task::{JoinHandle, block_in_place};

use crate::config::{MeterMode, PublishedBy, Source};
use crate::crypto::random_bytes;
use crate::model::{ErrorKind, TopicName, clean, hex, locked};
use crate::pipeline::Recorder;
use crate::reply::{Failure, HealthLevel, NoticeLevel, Part, Result, internal};
use crate::ros::graph::Unreached;
use crate::ros::ros2::{Reading, Ros2Capture, Ros2Topic};
use crate::ros::{
    Capture, CaptureNotice, CaptureOptions, EmbeddedMaster, Fleet, FleetOptions, Graph, LastLook, MessageSink,
    TopicInfo, UNCONFINED,
};
use crate::site::{Parts, blocking};

const LOOK: Duration = Duration::from_secs(1);
/// Subject of its notices: the health's part.
const ABOUT: &str = "ros";
/// Looks without a change after which they become half as frequent.
const CALM: u32 = 10;

/// The embedded master has no address to correct.
fn of_embedded(failure: Failure) -> Failure {
    if failure.kind != ErrorKind::Unreachable {
        return failure;
    }
    let text = "this machine is probably overloaded (see `top`): the embedded ROS master of this site does not answer in \
                time; the site asks again every few seconds";
    Failure::new(failure.kind, text)
}

/// The capture of a link that is down recovers without help.
#[derive(Clone)]
pub enum RosState {
    Off,
    Starting,
    Up(Arc<RosLink>),
    Down { failure: Failure, link: Option<Arc<RosLink>> },
}

pub struct RosLink {
    pub uri: String,
    pub embedded: bool,
    pub capture: Capture,
    _fleet: Option<Fleet>,
    pub robots: u16,
    graph: Graph,
    last_look: Mutex<LastLook>,
    topics: RwLock<Vec<TopicInfo>>,
    // Dropped last: nodes unregister on drop.
    master: Option<EmbeddedMaster>,
}

impl RosState {
    pub fn link(&self) -> Option<&Arc<RosLink>> {
        match self {
            Self::Up(link) | Self::Down { link: Some(link), .. } => Some(link),
            Self::Off | Self::Starting | Self::Down { link: None, .. } => None,
        }
    }
}

impl RosLink {
    pub fn topics(&self) -> Vec<TopicInfo> {
        self.topics.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn look(&self) -> Result<bool> {
        let mut last = locked(&self.last_look);
        let mut found = self.graph.topics_again(&mut last)?;
        found.sort_by(|one, other| one.name.cmp(&other.name));
        let mut topics = self.topics.write().unwrap_or_else(PoisonError::into_inner);
        let changed = *topics != found;
        *topics = found;
        Ok(changed)
    }
}

pub(in crate::site) struct RosSide {
    parts: Parts,
    recorder: Arc<Recorder>,
    state: watch::Sender<RosState>,
    pub(in crate::site) second: Second,
}

impl RosSide {
    pub fn new(parts: &Parts, recorder: &Arc<Recorder>, needed: bool) -> Self {
        Self {
            parts: parts.clone(),
            second: Second::new(parts, recorder),
            recorder: Arc::clone(recorder),
            state: watch::channel(if needed { RosState::Starting } else { RosState::Off }).0,
        }
    }

    pub fn state(&self) -> watch::Ref<'_, RosState> {
        self.state.borrow()
    }

    pub fn is_wanted(&self) -> bool {
        !matches!(*self.state.borrow(), RosState::Off)
    }

    fn is_measured(&self) -> bool {
        self.parts.config.meter == MeterMode::All
    }

    pub async fn leave(&self, task: Option<JoinHandle<()>>, patience: Duration) {
        self.state.send_replace(RosState::Off);
        if let Some(task) = task {
            drop(tokio::time::timeout(patience, task).await);
        }
    }

    pub async fn keep(self: Arc<Self>) {
        let ros = Arc::clone(&self);
        drop(tokio::task::spawn_blocking(move || ros.second.begin()).await);
        let link = loop {
            // After a failure, the restarted task finds the link still working.
            let kept = self.state.borrow().link().cloned();
            if let Some(link) = kept {
                break link;
            }
            match blocking(&self, Self::start).await {
                Ok(link) => break Arc::new(link),
                Err(failure) => self.lost(failure, None),
            }
            self.second.look();
            self.share_wishes(&[]);
            tokio::select! {
                () = tokio::time::sleep(Duration::from_secs(2)) => {}
                () = self.leaving() => return self.leave_second().await,
            }
        };
        self.state.send_replace(RosState::Up(Arc::clone(&link)));
        self.parts.hub.changed(Part::Health);
        self.parts.hub.changed(Part::Topics);
        let mut calm = 0_u32;
        loop {
            let pause = if calm < CALM { LOOK } else { LOOK * 2 };
            tokio::select! {
                _ = self.parts.life.beat(pause) => {}
                () = self.leaving() => break,
            }
            calm = if self.look_at_graph(&link).await { 0 } else { calm.saturating_add(1) };
            if link.master.as_ref().is_some_and(|master| !master.is_running()) {
                // Returning early restarts everything here, with another master.
                self.state.send_if_modified(|state| {
                    let ending = matches!(state, RosState::Off);
                    if !ending {
                        *state = RosState::Starting;
                    }
                    !ending
                });
                break;
            }
        }
        self.leave_second().await;
        // Nodes unregister and threads join: not on an async thread.
        drop(tokio::task::spawn_blocking(move || drop(link)).await);
    }

    async fn leave_second(self: &Arc<Self>) {
        if !self.is_wanted() {
            let ros = Arc::clone(self);
            drop(tokio::task::spawn_blocking(move || ros.second.end()).await);
        }
    }

    async fn leaving(&self) {
        let mut ros = self.state.subscribe();
        // An error means that the site is gone.
        drop(ros.wait_for(|state| matches!(state, RosState::Off)).await);
    }

    fn start(&self) -> Result<RosLink> {
        let config = &self.parts.config;
        let master = if config.ros_master.is_none() { Some(EmbeddedMaster::start()?) } else { None };
        let uri = master.as_ref().map(|master| master.uri().to_owned()).or_else(|| config.ros_master.clone());
        let uri = uri.ok_or_else(|| internal("no ROS master is configured"))?;
        let node_name = format!("/authros_{}", hex(&random_bytes::<4>()?));
        let graph = Graph::new(&uri, &node_name)?;
        graph.ping()?;
        let robots = if master.is_some() { config.robots } else { 0 };
        let (program, options) = (config.rosrust_program.as_deref(), FleetOptions::default());
        let fleet = match config.robots_by {
            _ if robots == 0 => None,
            PublishedBy::Own => Some(Fleet::start(&uri, robots, options)?),
            PublishedBy::Rosrust => Some(Fleet::by_rosrust(&uri, program, robots, options)?),
        };
        self.recorder.set_simulated((1..=robots).map(|number| format!("/robot{number}_sim")).collect());
        let options = CaptureOptions { master_uri: uri.clone(), own_host: config.ros_host.clone(), node_name };
        let capture = Capture::start(options, self.recorder.clone())?;
        let link = RosLink {
            uri,
            embedded: master.is_some(),
            capture,
            robots,
            _fleet: fleet,
            graph,
            last_look: Mutex::default(),
            topics: RwLock::default(),
            master,
        };
        link.look()?;
        self.follow_wishes(&link);
        Ok(link)
    }

    fn lost(&self, failure: Failure, link: Option<Arc<RosLink>>) {
        let failure = if self.parts.config.ros_master.is_none() { of_embedded(failure) } else { failure };
        self.parts.hub.notice_about(ABOUT, NoticeLevel::Error, &failure.message);
        self.state.send_replace(RosState::Down { failure, link });
        self.parts.hub.changed(Part::Health);
    }

    async fn look_at_graph(self: &Arc<Self>, link: &Arc<RosLink>) -> bool {
        let in_two = self.second.look();
        in_two
            | match block_in_place(|| link.look()) {
                Ok(changed) => {
                    self.follow_wishes(link);
                    let was_down = matches!(&*self.state.borrow(), RosState::Down { .. });
                    if was_down {
                        self.state.send_replace(RosState::Up(Arc::clone(link)));
                        self.parts.hub.changed(Part::Health);
                        self.parts.hub.notice_about(ABOUT, NoticeLevel::Info, "the ROS master answers again");
                    }
                    let moved = changed || self.recorder.meter_moved();
                    if moved {
                        self.parts.hub.changed(Part::Topics);
                    }
                    moved || was_down
                }
                Err(failure) if matches!(&*self.state.borrow(), RosState::Up(_)) => {
                    self.lost(failure, Some(Arc::clone(link)));
                    true
                }
                // Keeps the pace, to notice its return soon.
                Err(_) => true,
            }
    }

    fn follow_wishes(&self, link: &RosLink) {
        let mut wanted = self.share_wishes(&link.topics());
        if self.is_measured() {
            let read = link.topics().into_iter().filter(|info| self.second.graph_of(info) != GraphOf::Two);
            wanted.extend(read.filter_map(|info| info.name.parse::<TopicName>().ok()));
        }
        let watched: BTreeSet<TopicName> = link.capture.watched().into_iter().map(|(topic, _)| topic).collect();
        for topic in watched.difference(&wanted) {
            link.capture.unwatch(topic);
        }
        for topic in wanted.difference(&watched) {
            link.capture.watch(topic.clone(), None);
        }
    }

    /// Topics of both graphs, as far as they are known now.
    pub fn names(&self) -> Vec<TopicName> {
        let link = self.state().link().cloned();
        self.names_beside(&link.map(|link| link.topics()).unwrap_or_default())
    }

    /// Those of this graph, and those of ROS 2.
    fn names_beside(&self, graph: &[TopicInfo]) -> Vec<TopicName> {
        let of_two = self.second.topics();
        let names = graph.iter().map(|info| &info.name).chain(of_two.iter().map(|topic| &topic.name));
        names.filter_map(|name| name.parse().ok()).collect()
    }

    fn share_wishes(&self, graph: &[TopicInfo]) -> BTreeSet<TopicName> {
        if self.recorder.has_patterns() {
            self.recorder.follow(&self.names_beside(graph));
        }
        let wanted = self.recorder.wanted().iter().filter_map(|topic| topic.parse().ok()).collect();
        self.second.share(wanted, self.is_measured(), graph)
    }

    pub fn wishes_changed(&self) {
        if let Some(link) = self.state.borrow().link() {
            self.follow_wishes(link);
        } else if self.is_wanted() {
            self.share_wishes(&[]);
        }
        self.parts.hub.changed(Part::Topics);
    }

    pub fn unreached(&self) -> HashMap<String, Vec<Unreached>> {
        let status = match &*self.state() {
            RosState::Up(link) => link.capture.status(),
            _ => return HashMap::new(),
        };
        let status = status.into_iter().filter(|topic| !topic.unreached.is_empty());
        status.map(|topic| (topic.topic.to_string(), topic.unreached)).collect()
    }

    /// `None` if only ROS 2 is there; waits for its discovery.
    pub async fn any(&self) -> Result<Option<Arc<RosLink>>> {
        let link = self.any_now().await?;
        self.second.first_look().await;
        Ok(link)
    }

    pub async fn any_now(&self) -> Result<Option<Arc<RosLink>>> {
        match self.link().await {
            Ok(link) => Ok(Some(link)),
            Err(_) if self.second.capture().is_some() => Ok(None),
            Err(failure) => Err(failure),
        }
    }

    pub async fn uri(&self) -> Result<String> {
        Ok(self.link().await?.uri.clone())
    }

    pub async fn link(&self) -> Result<Arc<RosLink>> {
        let mut state = self.state.subscribe();
        let settled = state.wait_for(|state| !matches!(state, RosState::Starting)).await;
        let settled = settled.map_err(|_| internal("the site is ending"))?.clone();
        match settled {
            RosState::Up(link) | RosState::Down { link: Some(link), .. } => Ok(link),
            RosState::Down { failure, link: None } => Err(failure),
            _ => Err(internal(
                "the running site has no ROS (a gateway never has); stop it, or run the command again once it has ended",
            )),
        }
    }
}

const FIRST_LOOK: Duration = Duration::from_secs(6);
const TICK: Duration = Duration::from_millis(50);
/// Fast DDS delivers a latched message up to 3.2 s after a subscriber appears.
const LATCHED: Duration = Duration::from_secs(4);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::site) enum GraphOf {
    One,
    Two,
    /// Nobody publishes it yet: both are waited for.
    Open,
}

pub(in crate::site) struct Second {
    parts: Parts,
    recorder: Arc<Recorder>,
    /// `None` = off; a failure = its program is missing.
    state: Mutex<Option<Result<Arc<Ros2Capture>>>>,
    decided: Mutex<HashMap<TopicName, GraphOf>>,
    told: Mutex<Told>,
}

#[derive(Default)]
struct Told {
    standing: Option<String>,
    first_look: bool,
    topics: Vec<Ros2Topic>,
    refused: BTreeSet<TopicName>,
}

impl Second {
    pub fn new(parts: &Parts, recorder: &Arc<Recorder>) -> Self {
        Self {
            parts: parts.clone(),
            recorder: Arc::clone(recorder),
            state: Mutex::default(),
            decided: Mutex::default(),
            told: Mutex::default(),
        }
    }

    pub fn begin(&self) {
        let Some(domain) = self.parts.config.ros_domain else { return };
        if self.capture().is_some() {
            return;
        }
        let started = Ros2Capture::start(domain, self.parts.config.ros2_program.as_deref(), self.recorder.clone());
        let started = started.map(Arc::new).map_err(Failure::from);
        if let Err(failure) = &started {
            self.parts.hub.alarm(&failure.message);
        }
        *locked(&self.state) = Some(started);
        self.parts.hub.changed(Part::Health);
    }

    pub fn end(&self) {
        let state = locked(&self.state).take();
        drop(state);
    }

    pub fn capture(&self) -> Option<Arc<Ros2Capture>> {
        locked(&self.state).as_ref()?.as_ref().ok().cloned()
    }

    /// Captures messages that still wait for their publisher's identity, before their topic is unwatched.
    pub fn settle(&self, topic: Option<&str>) {
        if let Some(capture) = self.capture() {
            tokio::task::block_in_place(|| capture.settle(topic));
        }
    }

    pub fn topics(&self) -> Vec<Ros2Topic> {
        self.capture().map(|capture| capture.topics()).unwrap_or_default()
    }

    pub async fn first_look(&self) {
        let begun = Instant::now();
        while begun.elapsed() < FIRST_LOOK
            && self.capture().is_some_and(|capture| capture.standing().reading == Reading::Looking)
        {
            tokio::time::sleep(TICK).await;
        }
    }

    pub fn least(&self, topics: &[TopicName]) -> Duration {
        let latched =
            |topic: &Ros2Topic| topic.quality.latched && topics.iter().any(|name| name.as_str() == topic.name);
        if self.topics().iter().any(latched) { LATCHED } else { Duration::ZERO }
    }

    pub fn health(&self) -> Option<(HealthLevel, String)> {
        let standing = match locked(&self.state).as_ref()? {
            Err(failure) => return Some((HealthLevel::Failed, failure.message.clone())),
            Ok(capture) => capture.standing(),
        };
        let level = match &standing.reading {
            Reading::Down { .. } => HealthLevel::Failed,
            Reading::Up if !standing.is_empty() => HealthLevel::Ok,
            Reading::Looking | Reading::Up => HealthLevel::Waiting,
        };
        Some((level, clean(&standing.text(), 400)))
    }

    pub fn look(&self) -> bool {
        let Some(capture) = self.capture() else { return false };
        let (standing, topics) = (capture.standing(), capture.topics());
        let mut told = locked(&self.told);
        if !told.first_look && standing.reading == Reading::Up {
            told.first_look = true;
            let level = if standing.is_empty() { NoticeLevel::Warning } else { NoticeLevel::Info };
            self.parts.hub.notice(level, &standing.text());
            if standing.confined == Some(false) {
                self.parts.hub.warn(UNCONFINED);
            }
        }
        let text = Some(standing.text());
        let (stands, lists) = (told.standing == text, told.topics == topics);
        (told.standing, told.topics) = (text, topics);
        if !stands {
            self.parts.hub.changed(Part::Health);
        }
        if !lists {
            self.parts.hub.changed(Part::Topics);
        }
        !stands || !lists
    }

    /// Requests the domain's topics; returns those of ROS 1.
    pub fn share(&self, wanted: BTreeSet<TopicName>, all: bool, graph: &[TopicInfo]) -> BTreeSet<TopicName> {
        let Some(capture) = self.capture() else { return wanted };
        let topics = capture.topics();
        let decide = |topic: &TopicName| self.decide(topic, graph, &topics);
        let mut of_two: BTreeSet<TopicName> =
            wanted.iter().filter(|topic| decide(topic) != GraphOf::One).cloned().collect();
        let one = wanted.iter().filter(|topic| decide(topic) != GraphOf::Two).cloned().collect();
        // Reading everything costs network traffic, so only an explicit setting does it.
        if all && self.parts.config.source("ros.meter") != Source::Default {
            let names = topics.iter().filter_map(|topic| topic.name.parse::<TopicName>().ok());
            of_two.extend(names.filter(|topic| !is_published(topic, graph)));
        }
        locked(&self.decided).retain(|topic, _| wanted.contains(topic));
        let watched: BTreeSet<TopicName> = capture.watched().into_iter().collect();
        watched.difference(&of_two).for_each(|topic| capture.unwatch(topic));
        of_two.difference(&watched).for_each(|topic| capture.watch(topic));
        one
    }

    pub fn graph_of(&self, info: &TopicInfo) -> GraphOf {
        let decided = locked(&self.decided);
        let known = decided.iter().find(|(topic, _)| topic.as_str() == info.name).map(|(_, graph)| *graph);
        known.unwrap_or(if info.publishers.is_empty() { GraphOf::Two } else { GraphOf::One })
    }

    fn decide(&self, topic: &TopicName, graph: &[TopicInfo], topics: &[Ros2Topic]) -> GraphOf {
        let two = topics.iter().any(|other| other.name == topic.as_str());
        let one = is_published(topic, graph);
        let mut decided = locked(&self.decided);
        let known = decided.get(topic).copied();
        let found = match (one, two, known) {
            (true, true, Some(known)) => known,
            (true, _, _) => GraphOf::One,
            (false, true, _) => GraphOf::Two,
            (false, false, _) => known.unwrap_or(GraphOf::Open),
        };
        if found != GraphOf::Open {
            decided.insert(topic.clone(), found);
        }
        drop(decided);
        if one && two && locked(&self.told).refused.insert(topic.clone()) {
            self.refuse(topic, found);
        }
        found
    }

    fn refuse(&self, topic: &TopicName, taken: GraphOf) {
        let (taken, other) = if taken == GraphOf::Two { (2, 1) } else { (1, 2) };
        let reason = format!(
            "the name exists in ROS 1 and in ROS 2, but records are filed by name: it is captured from ROS {taken}; to \
             capture both, start the other publisher with a prefix, such as {topic}:=/ros{other}{topic}"
        );
        let publisher = format!("its publisher in ROS {other}");
        let topic = topic.as_str().into();
        self.recorder.notice(CaptureNotice::Refused { topic, publisher, reason });
    }
}

fn is_published(topic: &TopicName, graph: &[TopicInfo]) -> bool {
    graph.iter().any(|info| info.name == topic.as_str() && !info.publishers.is_empty())
}
