//! The thread that keeps the subscriptions at the master: it registers each watched topic repeatedly, which finds new
//! publishers and survives a master's restart, and unregisters at the end.

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::CaptureNotice;
use super::node::{Shared, Threads};
use super::reader;
use super::topic::Topic;
use crate::model::{TopicName, clean};
use crate::ros::RosError;
use crate::ros::address::Endpoint;
use crate::ros::xmlrpc::{CallError, Value, call};

/// How often every topic is registered again.
const PERIOD: Duration = Duration::from_millis(500);

/// The pause between two rounds, as a multiple of a round's duration, however many topics there are.
const REST: u32 = 10;

/// The longest wait for an answer of the master.
const PATIENCE: Duration = Duration::from_secs(2);

/// The most publishers of one topic.
const MOST_PUBLISHERS: usize = 256;

/// The running thread.
pub(super) struct Registrar {
    thread: Threads,
}

impl Registrar {
    pub fn start(shared: Arc<Shared>, slave_uri: String) -> Result<Self, RosError> {
        let thread = Threads::default();
        let mut work = Work { shared, slave_uri, master_up: None };
        let spawned = thread.spawn("ros-registrar", move || work.run());
        spawned.map_err(|error| RosError::system("start a thread", &error))?;
        Ok(Self { thread })
    }

    /// Waits for the end, which the shared state already knows about.
    pub fn stop(&self, deadline: Instant) {
        self.thread.wait_until_none(deadline);
    }
}

struct Work {
    shared: Arc<Shared>,
    slave_uri: String,
    /// Whether the master answered last time.
    master_up: Option<bool>,
}

impl Work {
    fn run(&mut self) {
        let mut next_round = Instant::now();
        loop {
            let errands = self.shared.errands(next_round.saturating_duration_since(Instant::now()));
            if errands.stopping {
                return self.leave_all(errands.leaving);
            }
            self.unregister(&errands.leaving, Instant::now() + PATIENCE);
            if Instant::now() < next_round {
                let urgent = errands.urgent.iter().filter_map(|name| self.shared.topic(name.as_str())).collect();
                self.register(urgent);
            } else {
                let begun = Instant::now();
                let topics = self.shared.topics();
                // A newly watched topic is urgent: it does not wait for the round.
                let period = if topics.is_empty() { PATIENCE } else { PERIOD };
                self.register(topics);
                next_round = Instant::now() + period.max(begun.elapsed() * REST);
            }
        }
    }

    /// Registers each topic. One that becomes urgent meanwhile goes first, but only once: a flood of hints for one
    /// topic must not starve the others.
    fn register(&mut self, topics: Vec<Arc<Topic>>) {
        let mut queue: VecDeque<_> = topics.into();
        let mut hurried = BTreeSet::new();
        while let Some(topic) = queue.pop_front() {
            if !topic.has_ended() && !self.register_one(&topic) {
                return;
            }
            let errands = self.shared.errands(Duration::ZERO);
            if errands.stopping {
                return;
            }
            self.unregister(&errands.leaving, Instant::now() + PATIENCE);
            for name in errands.urgent {
                match self.shared.topic(name.as_str()) {
                    Some(topic) if hurried.insert(name) => queue.push_front(topic),
                    _ => {}
                }
            }
        }
    }

    /// Registers a topic and handles its publishers; returns whether the master answered.
    fn register_one(&mut self, topic: &Arc<Topic>) -> bool {
        // Taken first: only an answer requested later can contradict a claim.
        let claims = topic.take_claims();
        let asked_at = Instant::now();
        let answer = self.publishers(topic);
        self.master_is(answer.as_ref().map(drop).map_err(ToString::to_string));
        match answer {
            Ok(publishers) => {
                meet(&self.shared, topic, &publishers, asked_at);
                refute(&self.shared, topic, claims);
                true
            }
            Err(error) => {
                topic.give_back(claims);
                if matches!(error, CallError::Connect(_)) {
                    // Without a master nobody is registered.
                    topic.asked(asked_at);
                }
                false
            }
        }
    }

    fn publishers(&self, topic: &Topic) -> Result<Vec<String>, CallError> {
        let params = self.params(&[topic.name.as_str(), "*"]);
        let answer = call(&self.shared.master, "registerSubscriber", &params, Instant::now() + PATIENCE)?;
        Ok(answer.texts())
    }

    fn params(&self, middle: &[&str]) -> Vec<Value> {
        let mut params = vec![Value::text(&*self.shared.node_name)];
        params.extend(middle.iter().copied().map(Value::text));
        params.push(Value::text(&*self.slave_uri));
        params
    }

    fn master_is(&mut self, state: Result<(), String>) {
        if self.master_up.replace(state.is_ok()) == Some(state.is_ok()) {
            return;
        }
        self.shared.notice(match state {
            Ok(()) => CaptureNotice::MasterBack,
            Err(reason) => CaptureNotice::MasterLost { reason: clean(&reason, 200) },
        });
    }

    fn unregister(&self, names: &BTreeSet<TopicName>, deadline: Instant) {
        for name in names {
            let params = self.params(&[name.as_str()]);
            // A master that is gone has forgotten the subscription too.
            if call(&self.shared.master, "unregisterSubscriber", &params, deadline).is_err() {
                return;
            }
        }
    }

    fn leave_all(&self, mut names: BTreeSet<TopicName>) {
        names.extend(self.shared.topics().iter().map(|topic| topic.name.clone()));
        self.unregister(&names, Instant::now() + Duration::from_secs(1));
    }
}

/// Takes note of a topic's publishers and starts a reader for each new one.
fn meet(shared: &Arc<Shared>, topic: &Arc<Topic>, uris: &[String], asked_at: Instant) {
    let refuse = |publisher: &str, reason: &str| {
        if topic.first_complaint(publisher) {
            shared.notice(CaptureNotice::Refused {
                topic: Arc::clone(&topic.label),
                publisher: clean(publisher, 120),
                reason: reason.to_owned(),
            });
        }
    };
    let mut endpoints = Vec::new();
    for uri in uris {
        match Endpoint::parse(uri) {
            Some(_) if endpoints.len() >= MOST_PUBLISHERS => refuse("all others", "too many publishers"),
            Some(endpoint) => endpoints.push(endpoint),
            None => refuse(uri, "its address is not http://HOST:PORT"),
        }
    }
    for publisher in topic.list(&endpoints, asked_at) {
        if let Err(error) = reader::spawn(shared, topic, Arc::clone(&publisher)) {
            topic.forget(&publisher);
            refuse(&publisher.endpoint.to_string(), &format!("no thread to read it: {error}"));
        }
    }
}

/// Reports claimed publishers that the master's answer did not list. Nobody connects to them.
fn refute(shared: &Shared, topic: &Topic, claims: BTreeSet<String>) {
    for publisher in topic.unconfirmed(claims) {
        shared.notice(CaptureNotice::UnconfirmedPublisher { topic: Arc::clone(&topic.label), publisher });
    }
}
