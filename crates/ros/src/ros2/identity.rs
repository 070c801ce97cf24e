//! Names of publishers, and definitions that nodes give on request. Messages wait here until their publisher has a name
//! and, beside a namesake of another participant, until it shows whether that one still runs: then the newcomer is a
//! rival, else a restart. A definition counts only with the hash that the publisher announced.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::publisher::Publisher;
use crate::model::{Timestamp, clean, pinned_name};
use crate::pipe::read::{Wish, Writer};
use crate::ros::Rival;
use crate::ros::message::{is_built_in, type_hash};

/// Wait for the name of a publisher whose participant announces names.
pub const NAMING: Duration = Duration::from_secs(30);
/// Where no names are announced; the announcement may itself be a moment late.
const UNNAMED: Duration = Duration::from_secs(1);
/// A dead publisher's messages may still arrive this long after its successor's discovery.
const GRACE: Duration = Duration::from_secs(1);
/// A publisher in full flow that is silent for this long, and for four of its own intervals, has ended.
const SILENCE: Duration = Duration::from_secs(3);
/// A participant still listed after this time is alive: Fast DDS and Cyclone DDS drop a silent one after 20 s and 10 s.
const LEASE: Duration = Duration::from_secs(30);
/// Characters of a writer's id that its participant's writers share.
const PARTICIPANT: usize = 24;

pub struct Held {
    /// The publisher's number for it, and its publishing time.
    pub sent: (i64, Option<u64>),
    pub at: Timestamp,
    pub body: Vec<u8>,
}

#[derive(Default)]
pub struct Pulse {
    last: Option<Instant>,
    /// The longest recent interval.
    interval: Option<Duration>,
}

impl Pulse {
    pub fn beat(&mut self, at: Instant) {
        if let Some(last) = self.last {
            let former = self.interval.map_or(Duration::ZERO, |interval| interval * 7 / 8);
            self.interval = Some(former.max(at.saturating_duration_since(last)));
        }
        self.last = Some(self.last.map_or(at, |last| last.max(at)));
    }

    /// The silence that shows its end, if it was in full flow then.
    fn telling(&self, at: Instant) -> Option<Duration> {
        let enough = SILENCE.max(self.interval? * 4);
        (at.saturating_duration_since(self.last?) < enough).then_some(enough)
    }
}

#[derive(Debug, PartialEq, Eq)]
pub enum Place {
    Open,
    /// The only one, or the successor of one that ended.
    Alone,
    /// It came while this one was there, which goes on.
    Beside(Rival),
}

/// Whether `elder` ran on after a newcomer's discovery; `None` if that is not clear yet.
fn lives_beside(elder: &Publisher, came: Instant, now: Instant) -> Option<bool> {
    if elder.pulse.last.is_some_and(|last| last > came + GRACE) {
        return Some(true);
    }
    if elder.gone.is_some() {
        return Some(false);
    }
    let quiet = now.saturating_duration_since(elder.pulse.last.map_or(came, |last| last.max(came)));
    if now.saturating_duration_since(came) >= LEASE {
        return Some(true);
    }
    elder.pulse.telling(came).is_some_and(|enough| quiet >= enough).then_some(false)
}

pub fn place(publisher: &Publisher, all: &BTreeMap<String, Publisher>, now: Instant) -> Place {
    let patience = if publisher.writer.naming { NAMING } else { UNNAMED };
    let waited = now.saturating_duration_since(publisher.came);
    if publisher.writer.node.is_none() && publisher.gone.is_none() && waited < patience {
        return Place::Open;
    }
    let mut place = Place::Alone;
    for elder in publisher.elders.iter().filter_map(|id| all.get(id)) {
        match lives_beside(elder, publisher.came, now) {
            Some(true) => {
                let uri = elder.origin.uri.clone();
                return Place::Beside(Rival { number: elder.origin.number, uri });
            }
            Some(false) => {}
            None => place = Place::Open,
        }
    }
    place
}

/// Whether two publishers of different participants claim to be the same node on the same topic.
fn are_namesakes(one: &Publisher, other: &Publisher) -> bool {
    let participant = |publisher: &Publisher| publisher.writer.id.get(..PARTICIPANT).map(str::to_owned);
    one.writer.topic == other.writer.topic
        && one.writer.node.is_some()
        && other.writer.node.is_some()
        && pinned_name(&one.origin.caller_id) == pinned_name(&other.origin.caller_id)
        && participant(one) != participant(other)
}

pub fn relate(topic: &str, ordered: Instant, all: &mut BTreeMap<String, Publisher>) {
    let of_topic: Vec<&Publisher> = all.values().filter(|known| known.writer.topic == topic).collect();
    let mut elders = Vec::new();
    for younger in of_topic.iter().filter(|known| known.came >= ordered && known.origin.rival.is_none()) {
        let before = of_topic.iter().filter(|known| known.came < younger.came && are_namesakes(known, younger));
        let before: Vec<String> = before.map(|known| known.writer.id.clone()).collect();
        elders.push((younger.writer.id.clone(), before));
    }
    for (id, before) in elders {
        if let Some(publisher) = all.get_mut(&id) {
            publisher.elders = before;
        }
    }
}

const MOST_TYPES: usize = 4096;
const MOST_ASKED: usize = 16;

enum Description {
    /// Nodes asked, by the publisher that caused it: a restarted node is asked again.
    Asked(BTreeMap<String, String>),
    /// The text, with all its types.
    Known(Arc<str>),
    BuiltIn,
}

#[derive(Default)]
pub struct Descriptions(HashMap<(String, String), Description>);

fn key(writer: &Writer) -> Option<(String, String)> {
    Some((writer.type_name.clone(), writer.type_hash.clone()?))
}

impl Descriptions {
    pub fn wanted(&mut self, writer: &Writer) -> Option<Wish> {
        let (node, (type_name, hash)) = (writer.node.clone()?, key(writer)?);
        if self.0.len() >= MOST_TYPES && !self.0.contains_key(&(type_name.clone(), hash.clone())) {
            return None;
        }
        let first = || match is_built_in(&type_name, &hash) {
            true => Description::BuiltIn,
            false => Description::Asked(BTreeMap::new()),
        };
        let known = self.0.entry((type_name.clone(), hash.clone())).or_insert_with(first);
        let Description::Asked(asked) = known else { return None };
        let is_new = asked.len() < MOST_ASKED && asked.insert(writer.id.clone(), node.clone()).is_none();
        is_new.then_some(Wish::Describe { node, type_name, type_hash: hash })
    }

    /// Empty if there is none.
    pub fn text_of(&self, writer: &Writer) -> Arc<str> {
        match key(writer).and_then(|key| self.0.get(&key)) {
            Some(Description::Known(text)) => Arc::clone(text),
            _ => "".into(),
        }
    }

    /// Accepts the first text with the hash; whether the text is new.
    pub fn take(
        &mut self,
        node: &str,
        (type_name, hash): (String, String),
        texts: [Vec<u8>; 2],
    ) -> Result<bool, String> {
        let Some(Description::Asked(asked)) = self.0.get(&(type_name.clone(), hash.clone())) else { return Ok(false) };
        if !asked.values().any(|known| known == node) {
            return Ok(false);
        }
        let mut wrong = None;
        for text in texts.into_iter().filter(|text| !text.is_empty()) {
            match fitting(&type_name, &hash, text) {
                Ok(text) => {
                    self.0.insert((type_name, hash), Description::Known(text.into()));
                    return Ok(true);
                }
                Err(reason) => drop(wrong.get_or_insert(reason)),
            }
        }
        Err(wrong.unwrap_or_else(|| "the definition it sent is empty".to_owned()))
    }

    /// The reader was restarted: nodes without an answer are asked again.
    pub fn ask_again(&mut self) {
        self.0.retain(|_, known| !matches!(known, Description::Asked(_)));
    }
}

fn fitting(type_name: &str, hash: &str, text: Vec<u8>) -> Result<String, String> {
    let text = String::from_utf8(text).map_err(|_| "the definition it sent is not text".to_owned())?;
    match type_hash(type_name, &text) {
        Ok(found) if found == hash => Ok(text),
        Ok(found) => Err(format!(
            "the definition it sent of {} has the hash {found}, its messages have {}; it is not used",
            clean(type_name, 255),
            clean(hash, 80)
        )),
        Err(error) => Err(format!("the definition it sent is not used: {}", clean(&error.to_string(), 300))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::TopicName;
    use crate::pipe::read::{Counts, Quality, Told, Writer};
    use crate::ros::ros2::state::{Outcome, State};
    use crate::ros::{CaptureNotice, Message};

    const TOPIC: &str = "/odom";

    /// A watched topic in a domain that has been read for long enough to know who came when.
    struct Domain {
        state: State,
        now: Instant,
        said: Outcome,
    }

    /// A writer of a participant; writers of one participant share its number.
    fn id(participant: u8, writer: u8) -> String {
        format!("{}{writer:02x}000103", format!("{participant:02x}").repeat(12))
    }

    impl Domain {
        fn new() -> Self {
            let (mut state, now) = (State::new(0), Instant::now());
            let hello = Told::Hello { version: crate::pipe::VERSION, domain: 0, confined: true };
            state.take(hello, Vec::new(), now).expect("taken");
            state.watch(&TOPIC.parse::<TopicName>().expect("a name"), &mut Outcome::default());
            let mut domain = Self { state, now, said: Outcome::default() };
            domain.pass(11_000);
            domain
        }

        fn tell(&mut self, told: Told, payload: &[u8]) {
            let outcome = self.state.take(told, payload.to_vec(), self.now).expect("taken");
            self.said.notices.extend(outcome.notices);
            self.said.messages.extend(outcome.messages);
        }

        /// Time passes, with a sign of life each half second.
        fn pass(&mut self, milliseconds: u64) {
            for _ in 0..milliseconds / 500 {
                self.now += Duration::from_millis(500);
                self.tell(Told::Alive(Counts::default()), &[]);
            }
        }

        fn here(&mut self, id: &str, node: Option<&str>, naming: bool) {
            let writer = Writer {
                id: id.to_owned(),
                topic: TOPIC.into(),
                type_name: "std_msgs/msg/String".into(),
                type_hash: None,
                quality: Quality { reliable: true, ..Quality::default() },
                node: node.map(str::to_owned),
                naming,
                vendor: "fastdds".into(),
            };
            self.tell(Told::WriterHere(writer), &[]);
        }

        fn gone(&mut self, id: &str) {
            self.tell(Told::WriterGone { id: id.to_owned() }, &[]);
        }

        fn sample(&mut self, id: &str, number: i64, bytes: usize) {
            let told = Told::Sample { writer: id.to_owned(), number, sent: None, arrived: 0 };
            self.tell(told, &vec![0; bytes]);
        }

        /// It publishes four times a second, from this number on.
        fn publish(&mut self, id: &str, numbers: std::ops::Range<i64>) {
            for number in numbers {
                self.sample(id, number, 1);
                self.now += Duration::from_millis(250);
                self.tell(Told::Alive(Counts::default()), &[]);
            }
        }

        fn messages(&mut self) -> Vec<Message> {
            std::mem::take(&mut self.said.messages)
        }

        fn connected(&mut self) -> Vec<String> {
            let notices = std::mem::take(&mut self.said.notices);
            let names = notices.into_iter().filter_map(|notice| match notice {
                CaptureNotice::PublisherConnected { origin, .. } => Some(origin.caller_id.to_string()),
                _ => None,
            });
            names.collect()
        }
    }

    fn names(messages: &[Message]) -> Vec<&str> {
        messages.iter().map(|message| &*message.caller_id).collect()
    }

    fn rivals(messages: &[Message]) -> usize {
        messages.iter().filter(|message| message.origin.rival.is_some()).count()
    }

    #[test]
    fn a_name_that_comes_late_is_the_name_of_the_first_message_too() {
        let (mut domain, id) = (Domain::new(), id(1, 1));
        domain.here(&id, None, true);
        domain.publish(&id, 1..21);
        assert!(domain.messages().is_empty() && domain.connected().is_empty());
        domain.here(&id, Some("/talker"), true);
        assert_eq!((names(&domain.messages()), domain.connected()), (vec!["/talker"; 20], vec!["/talker".to_owned()]));
        domain.sample(&id, 21, 1);
        assert_eq!(names(&domain.messages()), ["/talker"]);
    }

    #[test]
    fn a_node_that_takes_its_name_back_before_it_leaves_keeps_it() {
        let (mut domain, id) = (Domain::new(), id(1, 1));
        domain.here(&id, Some("/talker"), true);
        domain.sample(&id, 1, 1);
        let number = domain.messages()[0].origin.number;
        assert_eq!(domain.connected(), ["/talker"]);
        domain.here(&id, None, true);
        domain.here(&id, None, false);
        domain.sample(&id, 2, 1);
        let last = domain.messages();
        assert_eq!((names(&last), last[0].origin.number), (vec!["/talker"], number));
        domain.gone(&id);
        assert!(domain.connected().is_empty());
    }

    #[test]
    fn a_name_that_never_comes_is_waited_for_and_one_that_comes_after_all_is_the_same_publishers() {
        let (mut domain, id) = (Domain::new(), id(1, 1));
        domain.here(&id, None, true);
        domain.sample(&id, 1, 1);
        domain.pass(29_000);
        assert!(domain.messages().is_empty());
        domain.pass(1_500);
        let before = domain.messages();
        assert_eq!((names(&before), before[0].origin.unnamed), (vec!["/unnamed_fastdds"], true));
        domain.here(&id, Some("/talker"), true);
        domain.sample(&id, 2, 1);
        let after = domain.messages();
        assert_eq!((names(&after), after[0].origin.unnamed), (vec!["/talker"], false));
        assert_eq!(after[0].origin.number, before[0].origin.number);
    }

    #[test]
    fn without_names_there_is_little_to_wait_for_and_an_end_ends_the_wait() {
        let mut domain = Domain::new();
        domain.here(&id(1, 1), None, false);
        domain.sample(&id(1, 1), 1, 1);
        domain.pass(1_500);
        let messages = domain.messages();
        assert_eq!((names(&messages), messages[0].origin.unnamed), (vec!["/unnamed_fastdds"], false));
        // It left before it was named, and the operator wants no more of the topic.
        domain.here(&id(2, 1), None, true);
        domain.sample(&id(2, 1), 1, 1);
        domain.gone(&id(2, 1));
        assert!(domain.messages()[0].origin.unnamed);
        domain.here(&id(3, 1), None, true);
        domain.sample(&id(3, 1), 1, 1);
        let mut outcome = Outcome::default();
        assert!(domain.state.unwatch(&TOPIC.parse().expect("a name"), domain.now, &mut outcome));
        assert_eq!(outcome.messages.len(), 1);
    }

    #[test]
    fn what_waits_is_bounded_and_nothing_is_lost() {
        let (mut domain, id) = (Domain::new(), id(1, 1));
        domain.here(&id, None, true);
        (1..=300).for_each(|number| domain.sample(&id, number, 1 << 15));
        assert_eq!(domain.messages().len(), 300, "it is captured as it is");
    }

    #[test]
    fn a_node_that_dies_and_returns_is_a_restart_when_it_falls_silent_and_when_it_is_given_up() {
        for silent in [true, false] {
            let (mut domain, before, after) = (Domain::new(), id(1, 1), id(2, 1));
            domain.here(&before, Some("/talker"), true);
            // One that is in full flow, and one that spoke once.
            domain.publish(&before, 1..if silent { 21 } else { 2 });
            domain.messages();
            domain.here(&after, Some("/talker"), true);
            domain.publish(&after, 1..9);
            assert!(domain.messages().is_empty(), "who knows");
            if silent {
                domain.pass(1_500);
            } else {
                domain.pass(15_000);
                assert!(domain.messages().is_empty());
                domain.gone(&before);
                domain.pass(500);
            }
            let messages = domain.messages();
            assert_eq!((messages.len(), rivals(&messages)), (8, 0), "{silent}");
            domain.gone(&before);
            domain.pass(60_000);
            domain.sample(&after, 9, 1);
            assert_eq!(rivals(&domain.messages()), 0);
        }
    }

    #[test]
    fn a_stranger_under_the_name_of_one_that_goes_on_is_a_rival() {
        let (mut domain, robot, stranger) = (Domain::new(), id(1, 1), id(2, 1));
        domain.here(&robot, Some("/talker"), true);
        domain.publish(&robot, 1..21);
        domain.messages();
        domain.here(&stranger, Some("/talker"), true);
        domain.sample(&stranger, 1, 1);
        // Even if he is gone before it shows.
        domain.gone(&stranger);
        domain.publish(&robot, 21..31);
        let messages = domain.messages();
        assert_eq!((messages.len(), rivals(&messages)), (11, 1));
        let his = messages.iter().find(|message| message.origin.rival.is_some()).expect("his");
        let robots = messages.iter().find(|message| message.origin.rival.is_none()).expect("the robot's");
        assert_eq!(his.origin.rival.as_ref().expect("a rival").number, robots.origin.number);
        assert!(his.origin.uri.contains(&stranger));
    }

    #[test]
    fn a_rival_of_one_that_rarely_speaks_or_spoke_again_shows_later() {
        let (mut domain, robot, stranger) = (Domain::new(), id(1, 1), id(2, 1));
        domain.here(&robot, Some("/talker"), true);
        domain.sample(&robot, 1, 1);
        domain.pass(10_000);
        domain.messages();
        domain.here(&stranger, Some("/talker"), true);
        domain.sample(&stranger, 1, 1);
        domain.pass(LEASE.as_millis().try_into().expect("short"));
        assert_eq!(rivals(&domain.messages()), 1, "the robot is still listed");
        // One that was stopped for a while: the newcomer passed for its successor until it spoke again.
        let (mut domain, robot, stranger) = (Domain::new(), id(1, 1), id(2, 1));
        domain.here(&robot, Some("/talker"), true);
        domain.publish(&robot, 1..21);
        domain.here(&stranger, Some("/talker"), true);
        domain.publish(&stranger, 1..21);
        assert_eq!(rivals(&domain.messages()), 0);
        domain.publish(&robot, 21..23);
        domain.sample(&stranger, 21, 1);
        assert_eq!(rivals(&domain.messages()), 1);
    }

    #[test]
    fn who_came_first_is_known_whatever_name_came_first() {
        let (mut domain, robot, stranger) = (Domain::new(), id(1, 1), id(2, 1));
        domain.here(&robot, None, true);
        domain.publish(&robot, 1..5);
        domain.here(&stranger, Some("/talker"), true);
        domain.publish(&stranger, 1..2);
        domain.here(&robot, Some("/talker"), true);
        domain.publish(&robot, 5..15);
        domain.messages();
        domain.sample(&stranger, 2, 1);
        domain.sample(&robot, 15, 1);
        assert_eq!(domain.messages().iter().map(|one| one.origin.rival.is_some()).collect::<Vec<_>>(), [true, false]);
    }

    #[test]
    fn publishers_of_one_participant_and_those_there_from_the_start_are_nobodys_rivals() {
        let mut domain = Domain::new();
        for writer in 1..3 {
            domain.here(&id(1, writer), Some("/talker"), true);
            domain.publish(&id(1, writer), 1..5);
        }
        assert_eq!((domain.said.messages.len(), rivals(&domain.messages())), (8, 0));
        let mut domain = Domain::new();
        domain.state = State::new(0);
        domain.state.watch(&TOPIC.parse().expect("a name"), &mut Outcome::default());
        domain.tell(Told::Hello { version: crate::pipe::VERSION, domain: 0, confined: true }, &[]);
        for participant in 1..3 {
            domain.pass(1_000);
            domain.here(&id(participant, 1), Some("/talker"), true);
        }
        domain.publish(&id(1, 1), 1..9);
        domain.publish(&id(2, 1), 1..9);
        assert_eq!((domain.said.messages.len(), rivals(&domain.messages())), (16, 0));
    }
}

#[cfg(test)]
mod descriptions_tests {
    use super::*;
    use crate::pipe::read::Quality;

    /// By rosbags 0.11.9, of the text below.
    const GRIP: &str = "RIHS01_3e789e2509f81d797131bc8cbc2e060199fd1af28e8d4a51b73e5e6adc25b74d";
    const TEXT: &str = "std_msgs/Header header\nfloat64 force\nstring<=16 label\n";

    fn writer(node: &str, type_name: &str, hash: Option<&str>) -> Writer {
        Writer {
            id: format!("0110 of {node}"),
            topic: "/grip".into(),
            type_name: type_name.into(),
            type_hash: hash.map(str::to_owned),
            quality: Quality::default(),
            node: Some(node.into()),
            naming: false,
            vendor: "fastdds".into(),
        }
    }

    fn whole() -> String {
        let rule = "=".repeat(80);
        format!(
            "{TEXT}{rule}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n{rule}\n\
             MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
        )
    }

    #[test]
    fn a_text_counts_if_its_hash_is_the_announced_one_and_it_was_asked_for() {
        let mut descriptions = Descriptions::default();
        let grip = writer("/hand", "rig_msgs/msg/Grip", Some(GRIP));
        let asked = || ("rig_msgs/msg/Grip".to_owned(), GRIP.to_owned());
        let own = |text: Vec<u8>| [text, Vec::new()];
        assert_eq!(descriptions.take("/hand", asked(), own(whole().into_bytes())), Ok(false), "nobody asked");
        let (type_name, type_hash) = asked();
        let wish = Wish::Describe { node: "/hand".into(), type_name, type_hash };
        assert_eq!((descriptions.wanted(&grip), descriptions.wanted(&grip)), (Some(wish), None), "once");
        assert_eq!(descriptions.take("/other", asked(), own(whole().into_bytes())), Ok(false), "another was asked");
        let lie = whole().replace("float64 force", "float64 power");
        let refused = descriptions.take("/hand", asked(), own(lie.clone().into_bytes())).expect_err("a lie");
        assert!(refused.contains("not used") && refused.contains(GRIP), "{refused}");
        assert!(descriptions.take("/hand", asked(), own(vec![0xff])).is_err());
        assert!(descriptions.take("/hand", asked(), own(b"no text at all".to_vec())).is_err());
        assert_eq!(&*descriptions.text_of(&grip), "");
        assert!(descriptions.wanted(&writer("/other", "rig_msgs/msg/Grip", Some(GRIP))).is_some(), "the next is asked");
        // As rclpy gives it: escaped, and cut.
        let cut = whole().replace("force\n", "force # 10\\xc2\\xb0\n").into_bytes();
        let cut = cut.get(..cut.len() - 12).expect("long").to_vec();
        assert_eq!(descriptions.take("/other", asked(), [cut, whole().into_bytes()]), Ok(true));
        assert_eq!(&*descriptions.text_of(&grip), whole());
        assert_eq!(descriptions.wanted(&writer("/third", "rig_msgs/msg/Grip", Some(GRIP))), None);
    }

    #[test]
    fn nobody_is_asked_for_what_is_built_in_or_cannot_be_compared() {
        const STRING: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
        let mut descriptions = Descriptions::default();
        assert_eq!(descriptions.wanted(&writer("/a", "std_msgs/msg/String", Some(STRING))), None);
        assert_eq!(descriptions.wanted(&writer("/a", "rig_msgs/msg/Grip", None)), None);
        // Another release's: its hash differs.
        assert!(descriptions.wanted(&writer("/a", "std_msgs/msg/String", Some(GRIP))).is_some());
        descriptions.ask_again();
        assert!(descriptions.wanted(&writer("/a", "std_msgs/msg/String", Some(GRIP))).is_some());
    }
}
