//! The site's ROS 2 side: one domain, read by a program without keys.

use std::collections::{BTreeSet, HashMap};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::config::Source;
use crate::model::{TopicName, clean};
use crate::pipeline::Recorder;
use crate::ros::ros2::{Reading, Ros2Capture, Ros2Topic};
use crate::ros::{CaptureNotice, MessageSink, TopicInfo, UNCONFINED};
use crate::service::event::{NoticeLevel, Part};
use crate::service::reply::{Failure, HealthLevel, Result};
use crate::site::parts::Parts;

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

fn locked<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
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
