//! The state of a domain, and the effect of each frame of the program that reads it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::identity::{self, Descriptions, Held, Place};
use super::publisher::{Publisher, name};
use super::{Reading, Ros2Topic};
use crate::child::{Participant, other_version};
use crate::model::{Timestamp, TopicName, clean};
use crate::pipe::read::{Counts, Told, Wish, Writer};
use crate::{CaptureNotice, Message, Origin, model::topic::LONGEST_NAME, pipe::VERSION};

const MOST_PUBLISHERS: usize = 40_000;
/// The program must have found all present publishers again by then.
const FOUND_AGAIN: Duration = Duration::from_secs(10);
/// Time a gone publisher is remembered, for its last messages.
const REMEMBERED: Duration = Duration::from_secs(60);
/// Time for discovery after the start, and the time if somebody was found.
const LOOKED: Duration = Duration::from_secs(3);
const LOOKED_WITH_SOMEBODY: Duration = Duration::from_secs(1);
/// Bytes of messages that wait for their publishers' identity.
const MOST_HELD: usize = if cfg!(test) { 4 << 20 } else { 256 << 20 };
/// Overhead of one such message, bytes.
const HELD_OVERHEAD: usize = 256;
/// One, and its successor.
const MOST_PARTICIPANTS: usize = 2;
const LONGEST_REASON: usize = 400;

/// For the sink, in this order and without the state locked.
#[derive(Debug, Default)]
pub struct Outcome {
    pub notices: Vec<CaptureNotice>,
    pub wishes: Vec<Wish>,
    pub messages: Vec<Message>,
    /// Definitions that came after messages of theirs.
    pub definitions: Vec<Message>,
}

#[derive(Default)]
pub struct State {
    pub watched: BTreeSet<TopicName>,
    pub reading: Reading,
    pub counts: Counts,
    pub restarts: u64,
    /// Whether the program can open no file and no local socket; `None` before it says so.
    pub confined: Option<bool>,
    domain: u16,
    publishers: BTreeMap<String, Publisher>,
    descriptions: Descriptions,
    /// How often the program said hello.
    started: u64,
    hello: Option<Instant>,
    /// From here on the order in which publishers come is known.
    ordered: Option<Instant>,
    /// Bytes of waiting messages.
    held: usize,
    /// Of the program, for a farewell if it is killed.
    pub participants: Vec<Participant>,
}

impl State {
    pub fn new(domain: u16) -> Self {
        Self { domain, ..Self::default() }
    }

    pub fn take(&mut self, told: Told, payload: Vec<u8>, now: Instant) -> Result<Outcome, String> {
        let mut outcome = Outcome::default();
        match told {
            Told::Hello { version, domain, confined } => {
                self.greet(version, domain, now)?;
                self.confined = Some(confined);
            }
            Told::WriterHere(writer) => self.here(writer, now, &mut outcome),
            Told::Joined { participants } => {
                let named = participants.into_iter().take(MOST_PARTICIPANTS);
                self.participants = named.filter_map(|named| Participant::new(self.domain, named)).collect();
            }
            Told::WriterGone { id } => self.gone(&id, now, &mut outcome),
            Told::Sample { writer, number, sent, arrived } => {
                self.sample(&writer, (number, sent, arrived), payload, now, &mut outcome);
            }
            Told::Refused { topic, reason } => outcome.notices.push(CaptureNotice::Refused {
                topic: clean(&topic, LONGEST_NAME).into(),
                publisher: format!("ROS 2 domain {}", self.domain),
                reason: clean(&reason, LONGEST_REASON),
            }),
            Told::Described { node, type_name, type_hash, structured, reason: None } => {
                let (structure, own) = payload.split_at_checked(structured as usize).unwrap_or_default();
                self.described(&node, (type_name, type_hash), [own.to_vec(), structure.to_vec()], &mut outcome);
            }
            // Opening a message explains why it has no fields.
            Told::Described { .. } => {}
            Told::Alive(counts) => self.alive(counts, now, &mut outcome),
            Told::Failed { reason } => return Err(clean(&reason, LONGEST_REASON)),
        }
        Ok(outcome)
    }

    fn greet(&mut self, version: u32, domain: u16, now: Instant) -> Result<(), String> {
        if (version, domain) != (VERSION, self.domain) {
            return Err(other_version(version));
        }
        self.started += 1;
        self.hello = Some(now);
        self.ordered.get_or_insert(now + FOUND_AGAIN);
        self.descriptions.ask_again();
        self.reading = Reading::Looking;
        Ok(())
    }

    fn is_watched(&self, topic: &str) -> bool {
        self.watched.iter().any(|watched| watched.as_str() == topic)
    }

    fn here(&mut self, mut writer: Writer, now: Instant, outcome: &mut Outcome) {
        let usable = writer.topic.parse::<TopicName>().is_ok()
            && writer.id.len() <= 64
            && writer.type_name.len() <= LONGEST_NAME
            && writer.type_hash.as_ref().is_none_or(|hash| hash.len() <= 80);
        if !usable || self.publishers.len() >= MOST_PUBLISHERS && !self.publishers.contains_key(&writer.id) {
            return;
        }
        let (id, watched) = (writer.id.clone(), self.is_watched(&writer.topic));
        let mut known = self.publishers.remove(&id).unwrap_or_else(|| Publisher::new(writer.clone(), self.domain, now));
        // A node takes its name from its publishers before it removes them: they keep it.
        if known.writer.node.is_some() {
            (writer.node, writer.naming) = (known.writer.node.clone(), known.writer.naming);
        }
        writer.type_hash = writer.type_hash.or_else(|| known.writer.type_hash.clone());
        if watched {
            outcome.wishes.extend(self.descriptions.wanted(&writer));
        }
        if known.writer != writer {
            let is_named = known.writer.node != writer.node;
            let reason = if is_named { "its node's name is known now" } else { "it now offers something else" };
            outcome.notices.extend(known.disconnect(reason));
            known.announce(writer, self.domain);
        }
        (known.gone, known.told_by) = (None, self.started);
        let text = self.descriptions.text_of(&known.writer);
        match text.is_empty() {
            true => known.definition = text,
            false => outcome.definitions.extend(known.define(text)),
        }
        let topic = known.writer.topic.clone();
        self.publishers.insert(id.clone(), known);
        if watched {
            self.relate(&topic);
        }
        self.settle_one(&id, now, false, outcome);
        self.connect_new(watched, outcome);
    }

    fn relate(&mut self, topic: &str) {
        if let Some(ordered) = self.ordered {
            identity::relate(topic, ordered, &mut self.publishers);
        }
    }

    /// Settles open identities, and captures their messages; of topics that are `due`, by the present knowledge.
    pub fn settle(&mut self, now: Instant, due: impl Fn(&str) -> bool, outcome: &mut Outcome) {
        let open = self.publishers.iter().filter(|(_, known)| !known.settled || !known.elders.is_empty());
        let open: Vec<(String, bool)> = open.map(|(id, known)| (id.clone(), due(&known.writer.topic))).collect();
        open.iter().for_each(|(id, due)| self.settle_one(id, now, *due, outcome));
    }

    fn settle_one(&mut self, id: &str, now: Instant, due: bool, outcome: &mut Outcome) {
        let Some(publisher) = self.publishers.get(id) else { return };
        let place = identity::place(publisher, &self.publishers, now);
        if place == Place::Open && !due {
            return;
        }
        let watched = self.is_watched(&publisher.writer.topic);
        let there: Vec<String> =
            publisher.elders.iter().filter(|elder| self.publishers.contains_key(*elder)).cloned().collect();
        let Some(publisher) = self.publishers.get_mut(id) else { return };
        publisher.elders = there;
        if let Place::Beside(rival) = place {
            publisher.elders.clear();
            publisher.origin = Arc::new(Origin { rival: Some(rival), ..Origin::clone(&publisher.origin) });
        }
        publisher.settled = true;
        if watched {
            outcome.notices.extend(publisher.connect());
        }
        for held in std::mem::take(&mut publisher.held) {
            self.held = self.held.saturating_sub(held.body.len() + HELD_OVERHEAD);
            outcome.messages.push(publisher.message(held.sent, held.at, held.body));
        }
    }

    fn connect_new(&mut self, watched: bool, outcome: &mut Outcome) {
        if watched {
            let Self { watched, publishers, .. } = self;
            let is_watched = |topic: &str| watched.iter().any(|watched| watched.as_str() == topic);
            let wanted = publishers.values_mut().filter(|known| !known.connected && known.settled);
            let wanted = wanted.filter(|known| is_watched(&known.writer.topic));
            outcome.notices.extend(wanted.filter_map(Publisher::connect));
        }
    }

    fn described(&mut self, node: &str, kind: (String, String), texts: [Vec<u8>; 2], outcome: &mut Outcome) {
        let of_kind = |writer: &Writer| writer.type_name == kind.0 && writer.type_hash.as_ref() == Some(&kind.1);
        let of_node = |writer: &Writer| of_kind(writer) && writer.node.as_deref() == Some(node);
        match self.descriptions.take(node, kind.clone(), texts) {
            Ok(false) => {}
            Ok(true) => {
                let publishers = self.publishers.values_mut().filter(|known| of_kind(&known.writer));
                let text = |publisher: &Publisher| self.descriptions.text_of(&publisher.writer);
                outcome.definitions.extend(publishers.filter_map(|publisher| publisher.define(text(publisher))));
            }
            Err(contradiction) => {
                let by = self.publishers.values().find(|known| of_node(&known.writer));
                outcome.notices.extend(by.map(|by| by.contradicts(contradiction)));
            }
        }
    }

    fn gone(&mut self, id: &str, now: Instant, outcome: &mut Outcome) {
        let Some(publisher) = self.publishers.get_mut(id) else { return };
        publisher.gone = Some(now);
        outcome.notices.extend(publisher.lost(now, false));
        outcome.notices.extend(publisher.disconnect("it left the domain"));
        self.settle_one(id, now, false, outcome);
    }

    fn sample(
        &mut self,
        id: &str,
        (number, sent, arrived): (i64, Option<u64>, u64),
        payload: Vec<u8>,
        now: Instant,
        outcome: &mut Outcome,
    ) {
        let Self { watched, publishers, .. } = self;
        let Some(publisher) = publishers.get_mut(id) else { return };
        if !publisher.connected && !watched.iter().any(|topic| topic.as_str() == publisher.writer.topic) {
            return;
        }
        let is_new = publisher.numbers.follow(number, now);
        outcome.notices.extend(publisher.lost(now, false));
        // A future or missing time is not believed.
        let own = Timestamp::now();
        let at = if arrived == 0 || arrived > own.0 { own } else { Timestamp(arrived) };
        let delay = Duration::from_nanos(own.0.saturating_sub(at.0));
        publisher.pulse.beat(now.checked_sub(delay).unwrap_or(now));
        if !is_new {
            return;
        }
        if publisher.settled {
            outcome.messages.push(publisher.message((number, sent), at, payload));
            return;
        }
        self.held += payload.len() + HELD_OVERHEAD;
        publisher.held.push(Held { sent: (number, sent), at, body: payload });
        if self.held > MOST_HELD {
            self.settle_one(id, now, true, outcome);
        }
    }

    fn alive(&mut self, counts: Counts, now: Instant, outcome: &mut Outcome) {
        self.counts = counts;
        let running = self.hello.map_or(Duration::ZERO, |hello| now.saturating_duration_since(hello));
        if running >= if counts.writers > 0 { LOOKED_WITH_SOMEBODY } else { LOOKED } {
            self.reading = Reading::Up;
        }
        if running >= FOUND_AGAIN {
            let started = self.started;
            for publisher in self.publishers.values_mut().filter(|known| known.told_by != started) {
                if publisher.gone.is_none() {
                    outcome.notices.extend(publisher.vanished(now));
                    outcome.notices.extend(publisher.disconnect("it could not be found again"));
                    publisher.gone = Some(now);
                }
            }
        }
        for publisher in self.publishers.values_mut() {
            outcome.notices.extend(publisher.lost(now, false));
        }
        self.settle(now, |_| false, outcome);
        self.publishers
            .retain(|_, known| known.gone.is_none_or(|gone| now.saturating_duration_since(gone) < REMEMBERED));
    }

    pub fn watch(&mut self, topic: &TopicName, outcome: &mut Outcome) -> bool {
        let new = self.watched.insert(topic.clone());
        self.relate(topic.as_str());
        self.connect_new(new, outcome);
        let Self { publishers, descriptions, .. } = self;
        let of_topic = publishers.values().filter(|known| known.gone.is_none() && known.writer.topic == topic.as_str());
        outcome.wishes.extend(of_topic.filter_map(|known| descriptions.wanted(&known.writer)));
        new
    }

    /// What is missing of the topic until now will not come.
    pub fn unwatch(&mut self, topic: &TopicName, now: Instant, outcome: &mut Outcome) -> bool {
        if !self.watched.contains(topic) {
            return false;
        }
        self.settle(now, |name| name == topic.as_str(), outcome);
        self.watched.remove(topic);
        for publisher in self.publishers.values_mut().filter(|known| known.writer.topic == topic.as_str()) {
            outcome.notices.extend(publisher.lost(now, true));
            outcome.notices.extend(publisher.disconnect("the topic is no longer captured"));
            publisher.numbers = Numbers::default();
        }
        true
    }

    pub fn topics(&self) -> Vec<Ros2Topic> {
        let mut topics: BTreeMap<&str, Ros2Topic> = BTreeMap::new();
        for Publisher { writer, settled, .. } in self.publishers.values().filter(|known| known.gone.is_none()) {
            let topic = topics.entry(&writer.topic).or_insert_with(|| Ros2Topic {
                name: writer.topic.clone(),
                type_name: writer.type_name.clone(),
                type_hash: writer.type_hash.clone(),
                quality: writer.quality,
                publishers: Vec::new(),
            });
            topic.quality.reliable &= writer.quality.reliable;
            topic.quality.latched &= writer.quality.latched;
            topic.type_hash = topic.type_hash.take().or_else(|| writer.type_hash.clone());
            // A publisher about to be named is not shown unnamed: nobody pinned has that name.
            if writer.node.is_some() || *settled {
                topic.publishers.push(name(writer));
            }
        }
        topics.into_values().collect()
    }
}

/// Time in which a missing number may still arrive.
const SETTLE: Duration = Duration::from_millis(250);
const MOST_GAPS: usize = 256;
/// No loss explains a longer step: counting starts again.
const LONGEST_STEP: i64 = 1 << 31;

/// The first and the last number of messages that never arrived.
pub type Gap = (i64, i64);

/// Follows one publisher, across restarts of the reader.
#[derive(Debug, Default)]
pub struct Numbers {
    pub last: Option<i64>,
    /// By their first number: the last, and when they were found missing.
    missing: BTreeMap<i64, (i64, Instant)>,
}

impl Numbers {
    /// Takes the next message's number.
    /// Whether the message was not seen before.
    pub fn follow(&mut self, number: i64, now: Instant) -> bool {
        let Some(last) = self.last.filter(|last| number.saturating_sub(*last) < LONGEST_STEP) else {
            self.last = Some(number);
            return true;
        };
        if number > last {
            if number > last + 1 {
                self.missing.insert(last + 1, (number - 1, now));
            }
            self.last = Some(number);
            return true;
        }
        let Some((&first, &(end, since))) = self.missing.range(..=number).next_back() else { return false };
        if number > end {
            return false;
        }
        self.missing.remove(&first);
        if first < number {
            self.missing.insert(first, (number - 1, since));
        }
        if number < end {
            self.missing.insert(number + 1, (end, since));
        }
        true
    }

    /// Gaps that will not be filled; `all` = everything missing.
    pub fn settled(&mut self, now: Instant, all: bool) -> Vec<Gap> {
        let mut beyond = self.missing.len().saturating_sub(MOST_GAPS);
        let is_settled = |_: &i64, (_, since): &mut (i64, Instant)| {
            let is_beyond = beyond > 0;
            beyond = beyond.saturating_sub(1);
            is_beyond || all || now.saturating_duration_since(*since) >= SETTLE
        };
        self.missing.extract_if(.., is_settled).map(|(first, (last, _))| (first, last)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipe::read::Quality;

    fn writer(id: &str, topic: &str, reliable: bool) -> Told {
        Told::WriterHere(Writer {
            id: id.into(),
            topic: topic.into(),
            type_name: "std_msgs/msg/String".into(),
            type_hash: None,
            quality: Quality { reliable, ..Quality::default() },
            node: Some("/talker".into()),
            naming: true,
            vendor: "fastdds".into(),
        })
    }

    fn hello() -> Told {
        Told::Hello { version: crate::pipe::VERSION, domain: 0, confined: true }
    }

    fn sample(id: &str, number: i64) -> Told {
        Told::Sample { writer: id.into(), number, sent: None, arrived: 5 }
    }

    fn lost(notices: &[CaptureNotice]) -> u64 {
        let count = |notice: &CaptureNotice| match notice {
            CaptureNotice::LostInTransport { count, .. } => *count,
            _ => 0,
        };
        notices.iter().map(count).sum()
    }

    #[test]
    fn a_program_may_have_two_participants_to_be_buried_while_one_replaces_the_other() {
        let (mut state, now) = (State::new(3), Instant::now());
        let mut joined = |prefixes: &[&str]| {
            let participants = prefixes.iter().map(|prefix| prefix.repeat(12)).collect();
            state.take(Told::Joined { participants }, Vec::new(), now).expect("taken");
            state.participants.clone()
        };
        let named = |prefix: &str| Participant::new(3, prefix.repeat(12)).expect("a name");
        assert_eq!(joined(&["01"]), [named("01")]);
        assert_eq!(joined(&["01", "ab"]), [named("01"), named("ab")]);
        assert_eq!(joined(&["ab"]), [named("ab")]);
        assert_eq!(joined(&["no", "01", "02"]), [named("01")]);
    }

    #[test]
    fn a_gap_over_a_restart_is_counted_exactly_and_repeats_are_not_captured_twice() {
        let (mut state, now) = (State::new(0), Instant::now());
        let mut take = |told, at| state.take(told, vec![1], at).expect("taken");
        take(hello(), now);
        take(writer("aa", "/chatter", true), now);
        assert!(take(sample("aa", 1), now).messages.is_empty(), "nobody wants it");
        let mut outcome = Outcome::default();
        assert!(state.watch(&"/chatter".parse().expect("a name"), &mut outcome));
        assert!(matches!(outcome.notices[..], [CaptureNotice::PublisherConnected { .. }]));
        let mut take = |told, at| state.take(told, vec![1], at).expect("taken");
        assert_eq!(take(sample("aa", 2), now).messages.len(), 1);
        // It dies, is restarted, and finds the publisher again.
        take(hello(), now);
        assert!(take(writer("aa", "/chatter", true), now).notices.is_empty());
        assert!(take(sample("aa", 2), now).messages.is_empty());
        let outcome = take(sample("aa", 9), now);
        assert_eq!((lost(&outcome.notices), outcome.messages.len()), (6, 1));
        let late = take(Told::Alive(Counts::default()), now + FOUND_AGAIN);
        assert!(late.notices.is_empty(), "{late:?}");
    }

    #[test]
    fn a_publisher_that_is_not_found_again_is_reported_with_an_unknown_end() {
        let (mut state, now) = (State::new(0), Instant::now());
        state.watch(&"/chatter".parse().expect("a name"), &mut Outcome::default());
        let mut take = |told, at| state.take(told, vec![1], at).expect("taken");
        take(hello(), now);
        take(writer("aa", "/chatter", false), now);
        take(sample("aa", 1), now);
        take(sample("aa", 4), now);
        take(hello(), now);
        assert!(take(Told::Alive(Counts::default()), now).notices.is_empty());
        let outcome = take(Told::Alive(Counts::default()), now + FOUND_AGAIN);
        assert_eq!(lost(&outcome.notices), 2);
        let told = |notice: &CaptureNotice| matches!(notice, CaptureNotice::EndUnknown { at_least: 2, .. });
        assert!(outcome.notices.iter().any(told), "{outcome:?}");
        assert!(outcome.notices.iter().any(|notice| matches!(notice, CaptureNotice::PublisherLost { .. })));
        assert!(state.topics().is_empty());
    }

    #[test]
    fn the_definition_of_a_captured_type_is_asked_for_and_goes_with_later_messages() {
        const HASH: &str = "RIHS01_3e789e2509f81d797131bc8cbc2e060199fd1af28e8d4a51b73e5e6adc25b74d";
        const TEXT: &str = "std_msgs/Header header\nfloat64 force\nstring<=16 label\n====================\n\
            MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n====================\n\
            MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n";
        let mut grip = writer("aa", "/grip", true);
        if let Told::WriterHere(writer) = &mut grip {
            (writer.type_name, writer.type_hash) = ("rig_msgs/msg/Grip".into(), Some(HASH.into()));
        }
        let (mut state, now) = (State::new(0), Instant::now());
        let take = |state: &mut State, told, payload: &[u8]| state.take(told, payload.to_vec(), now).expect("taken");
        take(&mut state, hello(), &[]);
        assert!(take(&mut state, grip.clone(), &[]).wishes.is_empty(), "nobody wants its messages");
        let mut outcome = Outcome::default();
        state.watch(&"/grip".parse().expect("a name"), &mut outcome);
        let asked =
            |text: &[Wish]| text.len() == 1 && matches!(&text[0], Wish::Describe { node, .. } if node == "/talker");
        assert!(asked(&outcome.wishes), "{outcome:?}");
        assert_eq!(&*take(&mut state, sample("aa", 1), &[1]).messages[0].definition, "");
        // Another run of the program is asked again.
        take(&mut state, hello(), &[]);
        assert!(asked(&take(&mut state, grip, &[]).wishes));
        let (node, type_name) = ("/talker".to_owned(), "rig_msgs/msg/Grip".to_owned());
        let described = Told::Described { node, type_name, type_hash: HASH.into(), structured: 0, reason: None };
        let lie = take(&mut state, described.clone(), b"float64 force\n");
        assert!(matches!(lie.notices[..], [CaptureNotice::Contradiction { .. }]), "{lie:?}");
        assert!(lie.definitions.is_empty());
        // A message went without it, and may have been the last.
        let told = take(&mut state, described.clone(), TEXT.as_bytes());
        let carried: Vec<_> = told.definitions.iter().map(|one| (&*one.definition, one.body.len())).collect();
        assert_eq!((carried, told.notices.len()), (vec![(TEXT, 0)], 0));
        assert_eq!(&*take(&mut state, sample("aa", 2), &[1]).messages[0].definition, TEXT);
        assert!(take(&mut state, described, TEXT.as_bytes()).definitions.is_empty(), "once");
    }

    #[test]
    fn another_release_and_impossible_names_are_refused() {
        let (mut state, now) = (State::new(0), Instant::now());
        for version in [0, 2, 255] {
            let error = state.take(Told::Hello { version, domain: 0, confined: true }, Vec::new(), now);
            let error = error.expect_err("another release");
            assert!(error.contains(&format!("version {version}, but 1")) && error.contains("same release"), "{error}");
        }
        state.take(writer("aa", "/bad name", true), Vec::new(), now).expect("taken");
        state.take(writer(&"a".repeat(65), "/good", true), Vec::new(), now).expect("taken");
        assert!(state.topics().is_empty());
        state.take(writer("aa", "/good", true), Vec::new(), now).expect("taken");
        state.take(writer("bb", "/good", false), Vec::new(), now).expect("taken");
        let topics = state.topics();
        assert_eq!(topics.len(), 1);
        assert_eq!((topics[0].quality_text().as_str(), topics[0].publishers.len()), ("best_effort volatile", 2));
    }
}

#[cfg(test)]
mod numbers_tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    #[test]
    fn a_restart_goes_on_where_it_was_and_repeats_count_once() {
        let (now, mut numbers) = (Instant::now(), Numbers::default());
        assert!(numbers.follow(100, now));
        assert!(numbers.follow(101, now));
        assert!(!numbers.follow(101, now));
        assert!(!numbers.follow(50, now));
        assert!(numbers.follow(2100, now));
        assert!(numbers.settled(now, false).is_empty(), "it may still come");
        assert_eq!(numbers.settled(now + SETTLE, false), [(102, 2099)]);
        assert!(numbers.settled(now + SETTLE, true).is_empty(), "told once");
        // An implausible number is not a loss of billions.
        assert!(numbers.follow(i64::MAX, now));
        assert!(numbers.settled(now, true).is_empty());
        assert!(!numbers.follow(i64::MIN, now));
    }

    #[test]
    fn gaps_are_bounded() {
        let (now, mut numbers) = (Instant::now(), Numbers::default());
        for number in 0..2 * 300 {
            numbers.follow(2 * number, now);
        }
        let told = numbers.settled(now, false).len();
        assert_eq!(told, 599 - MOST_GAPS);
        assert_eq!(numbers.missing.len(), MOST_GAPS);
    }

    proptest! {
        #[test]
        fn missing_is_what_never_came(arrivals in prop::collection::vec(0..60_i64, 1..120)) {
            let (now, mut numbers) = (Instant::now(), Numbers::default());
            let mut seen = BTreeSet::new();
            let first = arrivals[0];
            for number in &arrivals {
                let arrival = numbers.follow(*number, now);
                // Numbers before the first one seen were never promised.
                prop_assert_eq!(arrival, *number >= first && seen.insert(*number));
            }
            let missed: Vec<i64> = numbers.settled(now, true).into_iter().flat_map(|(from, to)| from..=to).collect();
            let last = seen.last().copied().unwrap_or(first);
            let expected: Vec<i64> = (first..last).filter(|number| !seen.contains(number)).collect();
            prop_assert_eq!(missed, expected);
        }
    }
}
