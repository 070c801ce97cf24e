//! Takes messages from the capture threads and puts one item per interested author into the rings. Never waits.

use std::collections::{HashMap, HashSet};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};

use crate::losses::{Losses, Lost};
use crate::model::{
    Address, Doubt, LossReason, RecordKind, Sampling, Timestamp, TopicName, TopicRule, TopicRules, TypeName, WatchRule,
    WatchRules, clean, counted,
};
use crate::ring::{Rings, Weighted};
use crate::ros::{CaptureNotice, Message, MessageSink, Origin};
use crate::{Author, CaptureSession, Observer, Pins, pace::Sampler};

/// The most publishers of another type remembered; beyond that they are reported again.
const MOST_MISMATCHED: usize = 4096;

/// One message for one author, on its way to the sealer.
pub struct CapturedMessage {
    pub author: Arc<Author>,
    pub message: Arc<Message>,
    /// A captured message, what a recording holds beside its messages, or a definition alone.
    pub kind: RecordKind,
    pub simulated: bool,
    pub sessions: Vec<Arc<CaptureSession>>,
    /// Why it must be quarantined.
    pub doubt: Option<Doubt>,
    pub rule: Option<Arc<TopicRule>>,
    /// Goes into the ring on the disk, because nobody watches its topic.
    pub ring: bool,
}

impl Weighted for CapturedMessage {
    fn weight(&self) -> usize {
        self.message.body.len() + 512
    }
}

struct Interest {
    author: Arc<Author>,
    watched: bool,
    /// Messages that nobody wants go into the ring on the disk.
    ringed: bool,
    type_name: Option<TypeName>,
    sessions: Vec<Arc<CaptureSession>>,
    rule: Option<Arc<TopicRule>>,
    /// Of the watch; decides before the rule.
    sampling: Option<Sampling>,
    sampler: Mutex<Sampler>,
}

impl Interest {
    fn wanted(&self) -> Option<&TypeName> {
        let by_rule = self.rule.as_ref().and_then(|rule| rule.type_name.as_ref());
        self.type_name.as_ref().or(by_rule)
    }

    fn wants(&self, type_name: &str) -> bool {
        self.wanted().is_none_or(|wanted| wanted.as_str() == type_name)
    }

    fn item(&self, message: &Arc<Message>, kind: RecordKind, simulated: bool) -> CapturedMessage {
        let (author, message, rule) = (Arc::clone(&self.author), Arc::clone(message), self.rule.clone());
        CapturedMessage { author, message, kind, simulated, sessions: Vec::new(), doubt: None, rule, ring: false }
    }

    /// Whether this message of an undoubted publisher is among those kept.
    fn takes(&self, at: Timestamp) -> bool {
        let of_rule = || self.rule.as_ref().map(|rule| rule.sampling());
        let Some(sampling) = self.sampling.or_else(of_rule) else { return true };
        self.sampler.lock().unwrap_or_else(PoisonError::into_inner).takes(sampling, at)
    }

    fn sample(&mut self, sampling: Option<Sampling>) {
        if self.sampling != sampling {
            (self.sampling, self.sampler) = (sampling, Mutex::default());
        }
    }
}

pub struct Recorder {
    rings: Arc<Rings<CapturedMessage>>,
    losses: Arc<Losses>,
    interests: RwLock<HashMap<String, Vec<Interest>>>,
    /// Accounts that watch by patterns: topics are watched as they appear.
    watches: RwLock<HashMap<Address, (Arc<Author>, WatchRules)>>,
    meter: Meter,
    moved: AtomicBool,
    simulated: RwLock<Vec<String>>,
    observer: Arc<dyn Observer>,
    pins: Option<Arc<Pins>>,
    rules: RwLock<TopicRules>,
    /// Messages left out by the topics' rules, or of another type than requested.
    left_out: Mutex<HashMap<String, u64>>,
    /// Publishers of another type than requested, by their number and topic, already reported.
    mismatched: Mutex<HashSet<(u64, String)>>,
}

impl Recorder {
    pub fn new(rings: Arc<Rings<CapturedMessage>>, losses: Arc<Losses>, observer: Arc<dyn Observer>) -> Self {
        Self {
            rings,
            losses,
            interests: RwLock::default(),
            watches: RwLock::default(),
            meter: Meter::default(),
            moved: AtomicBool::new(false),
            simulated: RwLock::default(),
            observer,
            pins: None,
            rules: RwLock::default(),
            left_out: Mutex::default(),
            mismatched: Mutex::default(),
        }
    }

    pub fn with_rules(self, rules: TopicRules) -> Self {
        Self { rules: RwLock::new(rules), ..self }
    }

    /// Applies to topics that are already wanted too.
    pub fn set_rules(&self, rules: TopicRules) {
        let mut interests = self.interests.write().unwrap_or_else(PoisonError::into_inner);
        for (topic, list) in interests.iter_mut() {
            let rule = rules.of(topic);
            for interest in list.iter_mut().filter(|interest| interest.rule.as_ref() != rule) {
                interest.rule = rule.cloned();
                interest.sampler = Mutex::default();
            }
        }
        // While the interests are locked: a topic that is wanted next gets these.
        *self.rules.write().unwrap_or_else(PoisonError::into_inner) = rules;
    }

    /// Quarantines messages of publishers that are not pinned.
    pub fn with_pins(self, pins: Arc<Pins>) -> Self {
        Self { pins: Some(pins), ..self }
    }

    /// Whether a message arrived on any topic since the last call.
    pub fn meter_moved(&self) -> bool {
        self.moved.swap(false, Ordering::AcqRel)
    }

    pub fn meter(&self) -> &Meter {
        &self.meter
    }

    pub fn set_simulated(&self, nodes: Vec<String>) {
        *self.simulated.write().unwrap_or_else(PoisonError::into_inner) = nodes;
    }

    pub fn is_simulated(&self, caller_id: &str) -> bool {
        self.simulated.read().unwrap_or_else(PoisonError::into_inner).iter().any(|node| node == caller_id)
    }

    fn change(&self, topic: &str, author: &Arc<Author>, change: impl FnOnce(&mut Interest)) {
        self.losses.know(author);
        let mut interests = self.interests.write().unwrap_or_else(PoisonError::into_inner);
        let list = interests.entry(topic.to_owned()).or_default();
        if !list.iter().any(|interest| interest.author.address == author.address) {
            let rule = self.rules.read().unwrap_or_else(PoisonError::into_inner).of(topic).cloned();
            let (author, sessions, sampler) = (Arc::clone(author), Vec::new(), Mutex::default());
            let (watched, ringed, type_name, sampling) = (false, false, None, None);
            list.push(Interest { author, watched, ringed, type_name, sessions, rule, sampling, sampler });
        }
        if let Some(interest) = list.iter_mut().find(|interest| interest.author.address == author.address) {
            change(interest);
        }
        list.retain(|interest| interest.watched || interest.ringed || !interest.sessions.is_empty());
        if list.is_empty() {
            interests.remove(topic);
        }
    }

    /// Replaces what an account watches. Running sessions continue.
    pub fn set_watches(&self, author: &Arc<Author>, rules: WatchRules) {
        for topic in self.watched_by(author.address) {
            match rules.of(&topic) {
                Some(rule) => self.watch(&topic, author, rule),
                None => self.change(&topic, author, |interest| {
                    interest.watched = false;
                    interest.sample(None);
                }),
            }
        }
        rules.named().for_each(|rule| self.watch(rule.pattern.as_str(), author, rule));
        let mut watches = self.watches.write().unwrap_or_else(PoisonError::into_inner);
        if rules.has_patterns() {
            watches.insert(author.address, (Arc::clone(author), rules));
        } else {
            watches.remove(&author.address);
        }
    }

    fn watch(&self, topic: &str, author: &Arc<Author>, rule: &WatchRule) {
        self.change(topic, author, |interest| {
            interest.watched = true;
            interest.type_name.clone_from(&rule.type_name);
            interest.sample(rule.sampling);
        });
    }

    /// Whether somebody watches by a pattern.
    pub fn has_patterns(&self) -> bool {
        !self.watches.read().unwrap_or_else(PoisonError::into_inner).is_empty()
    }

    /// Watches those of the graph's topics that a pattern covers.
    pub fn follow(&self, topics: &[TopicName]) {
        let watches = self.watches.read().unwrap_or_else(PoisonError::into_inner);
        for (author, rules) in watches.values() {
            let covered = topics.iter().filter_map(|topic| Some((topic.as_str(), rules.of(topic.as_str())?)));
            for (topic, rule) in covered.filter(|(topic, _)| !self.is_watched(topic, author.address)) {
                self.watch(topic, author, rule);
            }
        }
    }

    fn watched_by(&self, address: Address) -> Vec<String> {
        let interests = self.interests.read().unwrap_or_else(PoisonError::into_inner);
        let own = |interest: &Interest| interest.watched && interest.author.address == address;
        interests.iter().filter(|(_, list)| list.iter().any(own)).map(|(topic, _)| topic.clone()).collect()
    }

    /// Whether messages that nobody wants go into the ring on the disk.
    pub fn keep_in_ring(&self, topic: &str, author: &Arc<Author>, ringed: bool) {
        self.change(topic, author, |interest| interest.ringed = ringed);
    }

    pub fn is_watched(&self, topic: &str, address: Address) -> bool {
        let interests = self.interests.read().unwrap_or_else(PoisonError::into_inner);
        let own = |interest: &Interest| interest.watched && interest.author.address == address;
        interests.get(topic).is_some_and(|list| list.iter().any(own))
    }

    pub fn join(&self, topic: &str, author: &Arc<Author>, type_name: Option<TypeName>, session: &Arc<CaptureSession>) {
        self.change(topic, author, |interest| {
            if !interest.watched {
                interest.type_name = type_name;
            }
            interest.sessions.push(Arc::clone(session));
        });
    }

    pub fn leave(&self, topic: &str, author: &Arc<Author>, session: &Arc<CaptureSession>) {
        self.change(topic, author, |interest| interest.sessions.retain(|other| !Arc::ptr_eq(other, session)));
    }

    pub fn wanted(&self) -> Vec<String> {
        self.interests.read().unwrap_or_else(PoisonError::into_inner).keys().cloned().collect()
    }

    pub fn wanted_by(&self, author: &Author) -> Vec<String> {
        let interests = self.interests.read().unwrap_or_else(PoisonError::into_inner);
        let wants = |list: &Vec<Interest>| list.iter().any(|interest| interest.author.address == author.address);
        interests.iter().filter(|(_, list)| wants(list)).map(|(topic, _)| topic.clone()).collect()
    }

    /// Messages of a topic left out by its rule since the site started; they are not lost.
    pub fn left_out(&self, topic: &str) -> u64 {
        self.left_out.lock().unwrap_or_else(PoisonError::into_inner).get(topic).copied().unwrap_or_default()
    }

    fn offer(&self, interest: &Interest, message: &Arc<Message>, simulated: bool) {
        if !interest.wants(&message.type_name) {
            return self.leave_out(interest, message);
        }
        let doubt = self.doubt(interest, &message.topic, &message.origin);
        // A doubted publisher does not use up what the rule leaves to the others, nor is any of its messages left out.
        if doubt.is_none() && !interest.takes(message.captured_at) {
            self.count_left_out(&message.topic);
            return;
        }
        let takes = |session: &&Arc<CaptureSession>| match doubt {
            None => session.take(&message.topic, &message.type_name),
            Some(_) => session.hold(&message.topic),
        };
        let sessions: Vec<_> = interest.sessions.iter().filter(takes).cloned().collect();
        let watched = interest.watched || !sessions.is_empty();
        // What a publisher that is not the pinned one sends is quarantined, watched or not.
        if !watched && !interest.ringed {
            return;
        }
        let ring = !watched && doubt.is_none();
        let item = interest.item(message, RecordKind::Data, simulated);
        let item = CapturedMessage { sessions, doubt, ring, ..item };
        if let Err(refused) = self.rings.push(&message.topic, item) {
            self.losses.note(&refused.author, Lost::message(message), self.losses.cause());
            refused.sessions.iter().for_each(|session| session.dropped(&message.topic, refused.doubt.is_some()));
        }
    }

    /// For messages that were sealed without it; a publisher that comes later has it with each message.
    fn offer_definition(&self, interest: &Interest, message: &Arc<Message>, simulated: bool) {
        let is_wanted = interest.watched || !interest.sessions.is_empty();
        if !is_wanted || !interest.wants(&message.type_name) {
            return;
        }
        let doubt = self.doubt(interest, &message.topic, &message.origin);
        let item = CapturedMessage { doubt, ..interest.item(message, RecordKind::Definition, simulated) };
        // Without it the messages are shown as bytes, and nothing is lost: what does not fit is no loss.
        drop(self.rings.push(&message.topic, item));
    }

    /// A message of another type than requested: counted, and reported once per publisher.
    fn leave_out(&self, interest: &Interest, message: &Message) {
        self.count_left_out(&message.topic);
        interest.sessions.iter().for_each(|session| session.skip(&message.topic));
        let (topic, found) = (&message.topic, clean(&message.type_name, 120));
        let publisher = (message.origin.number, topic.to_string());
        if !self.is_first_mismatch(publisher) {
            return;
        }
        let wanted = interest.wanted().map(ToString::to_string).unwrap_or_default();
        let caller_id = clean(&message.caller_id, 120);
        let notice = CaptureNotice::TypeMismatch { topic: Arc::clone(topic), caller_id, wanted, found };
        if let Some((urgent, text)) = words(&notice) {
            self.observer.alert(urgent, text);
        }
    }

    fn is_first_mismatch(&self, publisher: (u64, String)) -> bool {
        let mut mismatched = self.mismatched.lock().unwrap_or_else(PoisonError::into_inner);
        if mismatched.len() >= MOST_MISMATCHED && !mismatched.contains(&publisher) {
            mismatched.clear();
        }
        mismatched.insert(publisher)
    }

    fn count_left_out(&self, topic: &str) {
        let mut left_out = self.left_out.lock().unwrap_or_else(PoisonError::into_inner);
        *left_out.entry(topic.to_owned()).or_default() += 1;
    }

    fn doubt(&self, interest: &Interest, topic: &str, origin: &Arc<Origin>) -> Option<Doubt> {
        self.pins.as_ref().and_then(|pins| pins.judge(interest.author.address, topic, origin))
    }

    /// Publishers are judged as soon as they appear, not only by what they send.
    fn look_at_publishers(&self, notice: &CaptureNotice) {
        let Some(pins) = &self.pins else { return };
        let interests = self.interests.read().unwrap_or_else(PoisonError::into_inner);
        let owners = |topic: &str| interests.get(topic).into_iter().flatten();
        match notice {
            CaptureNotice::PublisherConnected { topic, origin, .. } => {
                pins.connected(topic, origin);
                // Nothing of another type than requested is captured, so it does not count as a first publisher either.
                for interest in owners(topic).filter(|interest| interest.wants(&origin.type_name)) {
                    pins.judge(interest.author.address, topic, origin);
                }
            }
            CaptureNotice::PublisherLost { number, .. } => pins.lost(*number),
            CaptureNotice::UnconfirmedPublisher { topic, publisher } => {
                owners(topic).for_each(|interest| pins.unconfirmed(interest.author.address, topic, publisher));
            }
            _ => {}
        }
    }
}

impl MessageSink for Recorder {
    fn accept(&self, message: Message) {
        self.meter.count(&message.topic, message.body.len(), Timestamp::now());
        self.moved.store(true, Ordering::Release);
        let interests = self.interests.read().unwrap_or_else(PoisonError::into_inner);
        let Some(list) = interests.get(&*message.topic) else { return };
        let simulated = self.is_simulated(&message.caller_id);
        let message = Arc::new(message);
        for interest in list {
            self.offer(interest, &message, simulated);
        }
    }

    fn define(&self, message: Message) {
        let interests = self.interests.read().unwrap_or_else(PoisonError::into_inner);
        let simulated = self.is_simulated(&message.caller_id);
        let message = Arc::new(message);
        for interest in interests.get(&*message.topic).into_iter().flatten() {
            self.offer_definition(interest, &message, simulated);
        }
    }

    fn notice(&self, notice: CaptureNotice) {
        self.look_at_publishers(&notice);
        if let CaptureNotice::LostInTransport { topic, caller_id, count, numbers } = &notice {
            let lost = Lost { topic, publisher: caller_id, count: *count, numbers: Some(*numbers) };
            let interests = self.interests.read().unwrap_or_else(PoisonError::into_inner);
            for interest in interests.get(&**topic).into_iter().flatten() {
                self.losses.note(&interest.author, lost, LossReason::Transport);
                interest.sessions.iter().for_each(|session| session.lost_in_transport(topic, *count));
            }
        }
        if let Some((urgent, text)) = words(&notice) {
            self.observer.alert(urgent, text);
        }
    }
}

/// A notice for the operator; `None` for what is reported elsewhere.
fn words(notice: &CaptureNotice) -> Option<(bool, String)> {
    let told = match notice {
        CaptureNotice::PublisherConnected { .. } | CaptureNotice::UnconfirmedPublisher { .. } => return None,
        CaptureNotice::PublisherLost { topic, caller_id, reason, .. } => {
            (false, format!("{caller_id} on {topic} is no longer read: {reason}"))
        }
        CaptureNotice::PublisherUnreachable { topic, publisher, reason } => {
            (true, format!("{publisher} publishes {topic} but cannot be read; retrying: {reason}"))
        }
        CaptureNotice::Contradiction { topic, caller_id, contradiction } => {
            (true, format!("{caller_id} on {topic}: {contradiction}"))
        }
        CaptureNotice::TypeMismatch { topic, caller_id, wanted, found } => {
            (true, format!("{caller_id} sends {found} on {topic}, not {wanted}: not captured"))
        }
        CaptureNotice::LostInTransport { topic, caller_id, count, .. } => {
            let messages = counted(*count, "message");
            (true, format!("{messages} of {caller_id} on {topic} never arrived: counted as lost in transport"))
        }
        CaptureNotice::ReadingBroken { reason } => (
            true,
            format!("reading ROS 2 broke off and is being restarted; missing messages will be counted: {reason}"),
        ),
        CaptureNotice::EndUnknown { topic, caller_id, at_least } => {
            let text = "vanished while ROS 2 was not read: the end is unknown; missing at least";
            (true, format!("{caller_id} on {topic} {text} {}", counted(*at_least, "message")))
        }
        CaptureNotice::Refused { topic, publisher, reason } => {
            (true, format!("{publisher} on {topic} was refused: {reason}"))
        }
        CaptureNotice::ShutdownAsked { by, reason } => {
            (true, format!("{by} asked this node to shut down ({reason}); it continues"))
        }
    };
    Some((told.0, clean(&told.1, 300)))
}

// Rates of topics over a sliding window, in constant memory.

const WINDOW: u64 = 5;

#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rate {
    pub hz: f64,
    pub bytes_per_second: f64,
    pub messages: u64,
    pub last: Option<Timestamp>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Bucket {
    second: u64,
    messages: u32,
    bytes: u64,
}

#[derive(Debug, Default)]
struct Track {
    buckets: [Bucket; 8],
    first_second: u64,
    messages: u64,
    last: Option<Timestamp>,
}

#[derive(Debug, Default)]
pub struct Meter {
    tracks: Mutex<HashMap<String, Track>>,
}

impl Meter {
    pub fn count(&self, topic: &str, bytes: usize, at: Timestamp) {
        let mut tracks = self.tracks.lock().unwrap_or_else(PoisonError::into_inner);
        let second = at.seconds();
        if !tracks.contains_key(topic) {
            tracks.insert(topic.to_owned(), Track { first_second: second, ..Track::default() });
        }
        let Some(track) = tracks.get_mut(topic) else { return };
        let slot = &mut track.buckets[usize::try_from(second % 8).unwrap_or(0)];
        if slot.second != second {
            *slot = Bucket { second, ..Bucket::default() };
        }
        slot.messages += 1;
        slot.bytes += bytes as u64;
        track.messages += 1;
        track.last = Some(at);
    }

    /// The rate of `topic` over the whole seconds before `now`; `None` if it was never seen.
    pub fn rate(&self, topic: &str, now: Timestamp) -> Option<Rate> {
        let tracks = self.tracks.lock().unwrap_or_else(PoisonError::into_inner);
        let track = tracks.get(topic)?;
        let now = now.seconds();
        let span = now.saturating_sub(track.first_second).clamp(1, WINDOW);
        let current = |bucket: &&Bucket| bucket.second < now.max(1) && bucket.second + span >= now;
        let started = now == track.first_second;
        let (mut messages, mut bytes) = (0_u64, 0_u64);
        for bucket in track.buckets.iter().filter(|bucket| current(bucket) || started && bucket.second == now) {
            messages += u64::from(bucket.messages);
            bytes += bucket.bytes;
        }
        let seconds = u32::try_from(span).map_or(1.0, f64::from);
        let per_second = |total: u64| u32::try_from(total).map_or(f64::from(u32::MAX), f64::from) / seconds;
        Some(Rate {
            hz: per_second(messages),
            bytes_per_second: per_second(bytes),
            messages: track.messages,
            last: track.last,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::fixture::Notes;

    #[test]
    fn publishers_of_another_type_are_reported_once_and_not_remembered_without_end() {
        let recorder = Recorder::new(Arc::new(Rings::new(1)), Arc::default(), Arc::new(Notes::default()));
        let is_first = |number: usize| recorder.is_first_mismatch((number as u64, "/a".to_owned()));
        assert!((0..MOST_MISMATCHED).all(is_first));
        assert!(!is_first(0));
        assert!(is_first(MOST_MISMATCHED));
        assert_eq!(recorder.mismatched.lock().expect("whole").len(), 1);
    }
}

#[cfg(test)]
mod meter_tests {
    use super::*;

    #[test]
    fn a_steady_topic_shows_its_rate_and_an_ended_one_falls_to_zero() {
        let meter = Meter::default();
        for tick in 0..200_u64 {
            meter.count("/odom", 100, Timestamp(100_000_000_000 + tick * 50_000_000));
        }
        let rate = meter.rate("/odom", Timestamp::from_seconds(110)).expect("seen");
        assert!((rate.hz - 20.0).abs() < 1e-9, "{rate:?}");
        assert!((rate.bytes_per_second - 2000.0).abs() < 1e-9);
        assert_eq!(rate.messages, 200);
        let later = meter.rate("/odom", Timestamp::from_seconds(200)).expect("seen");
        assert!(later.hz.abs() < 1e-9);
        assert_eq!(meter.rate("/other", Timestamp::now()), None);
    }
}
