//! Puts the messages of a recording, or of another home, into the ring, as they were recorded. It waits for room and
//! leaves most of the ring to live capture; nothing is ever dropped here.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::model::header::{LARGEST_BODY, TAG_LENGTH};
use crate::model::{RecordKind, Timestamp, TopicName, TopicRule, TopicRules};
use crate::ros::recording::tags::{CHANNEL, PUBLISHED, SEQUENCE};
use crate::ros::recording::{Beside, Channel, Encoding, RecordedMessage, Sent, TOO_LARGE};
use crate::ros::{Message, Origin};
use crate::{Author, CaptureSession};
use crate::{model::topic::LONGEST_NAME, recorder::CapturedMessage, ring::Rings, session::TopicFigures};

pub use crate::ros::recording::tags::{ENCODING, FORMER, FORMER_RECORD, FORMER_SIGNER, MCAP};

/// Bytes of the ring that imports may fill.
const SHARE: usize = 32 * 1024 * 1024;

/// The most imported messages awaiting verification.
const MOST_IN_FLIGHT: u64 = 50_000;

/// How long to wait before checking again whether to continue.
const TICK: Duration = Duration::from_millis(100);

/// The longest md5sum accepted.
const LONGEST_MD5: usize = 64;

/// The tag of every imported message, and its value.
pub const SOURCE: (&str, &str) = ("source", "bag");
/// Tag of messages of a latching publisher.
pub const LATCHING: &str = "latching";
/// Tag of messages whose topic was recorded under a name that is not a graph name: that name.
pub const RECORDED_TOPIC: &str = "recorded_topic";

/// The words for encodings in records' tags; a record without one is of ROS 1.
const ENCODINGS: [(&str, Encoding); 4] = [
    ("cdr", Encoding::Cdr { idl: false }),
    ("cdr-idl", Encoding::Cdr { idl: true }),
    ("mcap-attachment", Encoding::Beside(Beside::Attachment)),
    ("mcap-metadata", Encoding::Beside(Beside::Metadata)),
];

/// The largest body that a record holds, bytes.
const LARGEST: u64 = LARGEST_BODY - TAG_LENGTH as u64;

/// What no record can hold must not reach the sealer, which tries again until it succeeds.
pub fn fault(message: &RecordedMessage) -> Option<&'static str> {
    let channel = &message.channel;
    if message.body.len() as u64 > LARGEST {
        return Some(TOO_LARGE);
    }
    let long = channel.type_name.len() > LONGEST_NAME || channel.caller_id.len() > LONGEST_NAME;
    if long || channel.md5sum.len() > LONGEST_MD5 {
        return Some("its type's name, md5sum or publisher's name is too long");
    }
    channel.type_name.is_empty().then_some("it has no type")
}

pub fn encoding(tags: &BTreeMap<String, String>) -> Encoding {
    let stated = tags.get(ENCODING).and_then(|word| ENCODINGS.iter().find(|(known, _)| known == word));
    stated.map_or(Encoding::Ros1, |(_, encoding)| *encoding)
}

pub fn about(tags: &BTreeMap<String, String>) -> BTreeMap<Arc<str>, Arc<str>> {
    let of_channel =
        |(key, value): (&String, &String)| Some((key.strip_prefix(CHANNEL)?.into(), value.as_str().into()));
    tags.iter().filter_map(of_channel).collect()
}

pub fn sent(tags: &BTreeMap<String, String>, recorded: Timestamp) -> Option<Sent> {
    let sequence = tags.get(SEQUENCE)?.parse().ok()?;
    let time = tags.get(PUBLISHED).and_then(|time| time.parse().ok()).map_or(recorded, Timestamp);
    Some(Sent { time, sequence })
}

pub fn kind_of(encoding: Encoding) -> RecordKind {
    match encoding {
        Encoding::Ros1 | Encoding::Cdr { .. } => RecordKind::Data,
        Encoding::Beside(_) => RecordKind::Attachment,
    }
}

fn tags_of(sent: Sent, recorded: Timestamp) -> Vec<(String, String)> {
    let mut tags = vec![(SEQUENCE.to_owned(), sent.sequence.to_string())];
    if sent.time != recorded {
        tags.push((PUBLISHED.to_owned(), sent.time.0.to_string()));
    }
    tags
}

pub struct Importer<'a> {
    rings: &'a Rings<CapturedMessage>,
    author: Arc<Author>,
    rules: &'a TopicRules,
    tags: Vec<(String, String)>,
    /// One session per channel: its tags are the channel's, and so are its figures.
    sessions: HashMap<Arc<Channel>, Stream>,
    offered: u64,
    /// Whether what becomes of its records is waited for.
    followed: bool,
}

struct Stream {
    session: Arc<CaptureSession>,
    origin: Arc<Origin>,
}

impl Stream {
    fn new(channel: &Channel, topic: &Arc<str>, tags: Vec<(String, String)>, followed: bool) -> Self {
        let begin = if followed { CaptureSession::new } else { CaptureSession::unfollowed };
        Self {
            session: Arc::new(begin(&[topic.to_string()], None, tags)),
            origin: Arc::new(Origin {
                number: 0,
                caller_id: Arc::clone(&channel.caller_id),
                host: String::new(),
                uri: String::new(),
                type_name: Arc::clone(&channel.type_name),
                md5sum: Arc::clone(&channel.md5sum),
                listed_at: Instant::now(),
                rival: None,
                unnamed: false,
            }),
        }
    }
}

fn channel_tags(channel: &Channel, topic: &Arc<str>) -> Vec<(String, String)> {
    let mut tags = vec![(SOURCE.0.to_owned(), SOURCE.1.to_owned())];
    let stated = ENCODINGS.iter().find(|(_, encoding)| *encoding == channel.encoding);
    tags.extend(stated.map(|(word, _)| (ENCODING.to_owned(), (*word).to_owned())));
    tags.extend(channel.about.iter().map(|(key, value)| (format!("{CHANNEL}{key}"), value.to_string())));
    if channel.topic != *topic {
        tags.push((RECORDED_TOPIC.to_owned(), channel.topic.to_string()));
    }
    tags
}

impl<'a> Importer<'a> {
    pub fn new(
        rings: &'a Rings<CapturedMessage>,
        author: Arc<Author>,
        rules: &'a TopicRules,
        tags: Vec<(String, String)>,
    ) -> Self {
        Self { rings, author, rules, tags, sessions: HashMap::new(), offered: 0, followed: true }
    }

    /// One that may last for days, and waits for no chain: [`Self::is_acknowledged`] says when all is stored.
    pub fn unfollowed(self) -> Self {
        Self { followed: false, ..self }
    }

    /// Waits for room; `false` if the import is to end.
    pub fn take(&mut self, message: RecordedMessage, topic: &Arc<str>, goes_on: &dyn Fn() -> bool) -> bool {
        if !self.sessions.contains_key(&message.channel) {
            let tags = [self.tags.clone(), channel_tags(&message.channel, topic)].concat();
            let stream = Stream::new(&message.channel, topic, tags, self.followed);
            self.sessions.insert(Arc::clone(&message.channel), stream);
        }
        let tags = message.sent.map(|sent| tags_of(sent, message.time)).unwrap_or_default();
        let has_rule = kind_of(message.channel.encoding) == RecordKind::Data;
        let rule = self.rules.of(topic).filter(|_| has_rule).cloned();
        self.offer(message, topic, (tags, rule), goes_on)
    }

    /// Imports a message that was a record before, with all its tags.
    pub fn take_again(
        &mut self,
        message: RecordedMessage,
        tags: Vec<(String, String)>,
        goes_on: &dyn Fn() -> bool,
    ) -> bool {
        let topic = Arc::clone(&message.channel.topic);
        if !self.sessions.contains_key(&message.channel) {
            let stream = Stream::new(&message.channel, &topic, self.tags.clone(), self.followed);
            self.sessions.insert(Arc::clone(&message.channel), stream);
        }
        self.offer(message, &topic, (tags, None), goes_on)
    }

    fn offer(
        &mut self,
        message: RecordedMessage,
        topic: &Arc<str>,
        (tags, rule): (Vec<(String, String)>, Option<Arc<TopicRule>>),
        goes_on: &dyn Fn() -> bool,
    ) -> bool {
        if self.followed && self.offered.is_multiple_of(1024) && !self.wait_for_the_chain(goes_on) {
            return false;
        }
        let RecordedMessage { channel, time, body, .. } = message;
        let author = Arc::clone(&self.author);
        let Some(stream) = self.sessions.get(&channel) else { return false };
        let (session, origin) = (Arc::clone(&stream.session), Arc::clone(&stream.origin));
        session.take(topic, &channel.type_name);
        let message = Message {
            topic: Arc::clone(topic),
            type_name: Arc::clone(&channel.type_name),
            md5sum: Arc::clone(&channel.md5sum),
            definition: Arc::clone(&channel.definition),
            caller_id: Arc::clone(&channel.caller_id),
            origin,
            latching: channel.latching,
            captured_at: time,
            header_seq: None,
            tags,
            body,
        };
        let message = Arc::new(message);
        let mut item = CapturedMessage {
            author,
            message,
            kind: kind_of(channel.encoding),
            simulated: false,
            sessions: vec![session],
            doubt: None,
            rule,
            ring: false,
        };
        let share = SHARE.min(self.rings.capacity() / 4);
        loop {
            match self.rings.push_within(topic, item, share, TICK) {
                Ok(()) => break,
                Err(refused) if !self.rings.is_closed() && goes_on() => item = refused,
                Err(refused) => {
                    refused.sessions.iter().for_each(|session| session.dropped(topic, false));
                    return false;
                }
            }
        }
        self.offered += 1;
        true
    }

    /// A message not verified yet takes little memory, but some.
    fn wait_for_the_chain(&self, goes_on: &dyn Fn() -> bool) -> bool {
        loop {
            let settled: u64 = self.figures().iter().map(|topic| topic.verified + topic.tampered).sum();
            if self.offered.saturating_sub(settled) < MOST_IN_FLIGHT {
                return goes_on();
            }
            if !goes_on() {
                return false;
            }
            std::thread::sleep(TICK);
        }
    }

    pub fn offered(&self) -> u64 {
        self.offered
    }

    /// Whether every message passed to the sealer is stored and acknowledged, or lost and counted.
    pub fn is_acknowledged(&self) -> bool {
        self.sessions.values().all(|stream| stream.session.is_acknowledged())
    }

    /// Messages given up, because their profile has no keys in force.
    pub fn lost(&self) -> u64 {
        self.figures().iter().map(|topic| topic.lost).sum()
    }

    fn figures(&self) -> Vec<TopicFigures> {
        self.sessions.values().flat_map(|stream| stream.session.figures()).collect()
    }

    /// No further messages: the closed sessions, whose end is still to come.
    pub fn finish(self) -> Vec<Arc<CaptureSession>> {
        let sessions: Vec<_> = self.sessions.into_values().map(|stream| stream.session).collect();
        sessions.iter().for_each(|session| session.close());
        sessions
    }
}

// Topic names of recordings, resolved: `rosbag` records whatever a publisher called its topic, while a record's topic
// is a graph name. The recorded name is stored as well, for export.

/// The names of one recording; the same file gives the same names each time.
#[derive(Debug, Default)]
pub struct RecordedNames {
    resolved: HashMap<Arc<str>, Result<Arc<str>, &'static str>>,
    /// The owner of a name, and whether it is that name except for a leading slash: only such names share one.
    taken: HashMap<Arc<str>, (Arc<str>, bool)>,
}

impl RecordedNames {
    /// The graph name for a recorded one: itself if it is valid, with `/` in front if it is relative, with `_` for
    /// every character not allowed in a graph name.
    pub fn resolve(&mut self, recorded: &Arc<str>) -> Result<Arc<str>, &'static str> {
        if let Some(known) = self.resolved.get(recorded) {
            return known.clone();
        }
        let found = self.find(recorded);
        self.resolved.insert(Arc::clone(recorded), found.clone());
        found
    }

    fn find(&mut self, recorded: &Arc<str>) -> Result<Arc<str>, &'static str> {
        if recorded.len() > LONGEST_NAME {
            return Err("its topic name is longer than 255 bytes");
        }
        let parts: Vec<String> = recorded.split('/').filter(|part| !part.is_empty()).map(graph_part).collect();
        if parts.is_empty() {
            return Err("its topic has no name");
        }
        let name = format!("/{}", parts.join("/"));
        // `odom` and `/odom` are one topic; `a-b` and `a_b` are two.
        let exact = recorded.trim_start_matches('/') == name.trim_start_matches('/');
        let mut candidate: Arc<str> = name.as_str().into();
        for number in 2.. {
            let free = self.taken.get(&candidate).is_none_or(|(_, same)| exact && *same && number == 2);
            if candidate.parse::<TopicName>().is_err() {
                return Err("its topic name is too long for a graph name");
            }
            if free {
                break;
            }
            candidate = format!("{name}_{number}").into();
        }
        self.taken.entry(Arc::clone(&candidate)).or_insert_with(|| (Arc::clone(recorded), exact));
        Ok(candidate)
    }
}

fn graph_part(part: &str) -> String {
    let allowed = |character: char| if character.is_ascii_alphanumeric() { character } else { '_' };
    let clean: String = part.chars().map(allowed).collect();
    if clean.starts_with(|first: char| first.is_ascii_digit()) { format!("_{clean}") } else { clean }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn resolved(names: &[&str]) -> Vec<String> {
        let mut known = RecordedNames::default();
        names
            .iter()
            .map(|&name| known.resolve(&name.into()).map_or_else(str::to_owned, |name| name.to_string()))
            .collect()
    }

    #[test]
    fn names_legal_to_rosbag_get_a_graph_name() {
        let given = ["/odom", "foo", "foo/bar", "ORB-SLAM", "/1num", "/ünï", "/a//b/", "~own"];
        let expected = ["/odom", "/foo", "/foo/bar", "/ORB_SLAM", "/_1num", "/_n_", "/a/b", "/_own"];
        assert_eq!(resolved(&given), expected);
        assert_eq!(resolved(&["", "///"]), ["its topic has no name"; 2]);
        assert_eq!(resolved(&[&"a".repeat(300)]), ["its topic name is longer than 255 bytes"]);
    }

    #[test]
    fn relative_names_join_their_topic_and_others_stay_apart() {
        assert_eq!(resolved(&["odom", "/odom"]), ["/odom", "/odom"]);
        assert_eq!(resolved(&["/a_b", "a-b", "a.b", "a-b"]), ["/a_b", "/a_b_2", "/a_b_3", "/a_b_2"]);
        assert_eq!(resolved(&["a-b", "a_b", "/a_b"]), ["/a_b", "/a_b_2", "/a_b_3"], "met later, they stay apart");
    }

    proptest! {
        #[test]
        fn every_name_given_is_a_graph_name(names in proptest::collection::vec(".{0,300}", 1..20)) {
            let mut known = RecordedNames::default();
            for name in names {
                let name: Arc<str> = name.into();
                if let Ok(resolved) = known.resolve(&name) {
                    prop_assert!(resolved.parse::<TopicName>().is_ok());
                    prop_assert_eq!(known.resolve(&name), Ok(resolved));
                }
            }
        }
    }
}
