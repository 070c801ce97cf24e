//! One publisher of a ROS 2 topic, and its messages.

use std::{sync::Arc, time::Instant};

use crate::model::{Timestamp, clean};
use crate::pipe::read::{Liveliness, Quality, Writer};
use crate::recording::{TYPE_HASH, tags};
use crate::ros2::identity::{Held, Pulse};
use crate::{CaptureNotice, Message, Origin, capture::next_number, ros2::state::Numbers};

/// MCAP's name for the QoS of a channel's publishers.
pub const QUALITY: &str = "offered_qos_profiles";
/// The publisher's id, 16 bytes as hex, in the channel's data.
pub const WRITER: &str = "writer_id";

pub struct Publisher {
    pub writer: Writer,
    pub origin: Arc<Origin>,
    pub numbers: Numbers,
    /// When it left; its last messages may still come.
    pub gone: Option<Instant>,
    /// The run of the program that reported it last.
    pub told_by: u64,
    pub connected: bool,
    /// The requested definition of its type; otherwise empty.
    pub definition: Arc<str>,
    /// Whether some of its messages went without a definition.
    undefined: bool,
    /// When it was first reported.
    pub came: Instant,
    pub pulse: Pulse,
    /// Earlier publishers of its name, by id; empty once their ends or their lives are known.
    pub elders: Vec<String>,
    pub settled: bool,
    pub held: Vec<Held>,
    topic: Arc<str>,
    type_name: Arc<str>,
    tags: Vec<(String, String)>,
}

pub fn name(writer: &Writer) -> String {
    let node = writer.node.as_deref().map(|node| clean(node, 255));
    node.unwrap_or_else(|| format!("/unnamed_{}", clean(&writer.vendor, 40)))
}

fn origin(writer: &Writer, domain: u16, listed_at: Instant) -> Origin {
    let hash = writer.type_hash.as_deref().and_then(|hash| hash.strip_prefix("RIHS01_")).unwrap_or("*");
    Origin {
        number: next_number(),
        caller_id: name(writer).into(),
        // rustdds does not tell where a participant runs.
        host: format!("domain{domain}"),
        uri: format!("dds://{domain}/{}", writer.id),
        type_name: writer.type_name.as_str().into(),
        md5sum: hash.into(),
        listed_at,
        rival: None,
        unnamed: writer.node.is_none() && writer.naming,
    }
}

fn tags_of(writer: &Writer) -> Vec<(String, String)> {
    let channel = |key: &str, value: String| (format!("{}{key}", tags::CHANNEL), value);
    let mut said = vec![
        (tags::ENCODING.to_owned(), "cdr".to_owned()),
        channel(WRITER, writer.id.clone()),
        channel(QUALITY, profile(writer.quality)),
    ];
    said.extend(writer.type_hash.clone().map(|hash| channel(TYPE_HASH, hash)));
    said
}

impl Publisher {
    pub fn new(writer: Writer, domain: u16, now: Instant) -> Self {
        let origin = origin(&writer, domain, now);
        Self {
            origin: Arc::new(origin),
            numbers: Numbers::default(),
            gone: None,
            told_by: 0,
            connected: false,
            definition: "".into(),
            undefined: false,
            came: now,
            pulse: Pulse::default(),
            elders: Vec::new(),
            settled: false,
            held: Vec::new(),
            topic: writer.topic.as_str().into(),
            type_name: writer.type_name.as_str().into(),
            tags: tags_of(&writer),
            writer,
        }
    }

    pub fn announce(&mut self, writer: Writer, domain: u16) {
        let Origin { number, listed_at, rival, .. } = &*self.origin;
        let origin = Origin { number: *number, rival: rival.clone(), ..origin(&writer, domain, *listed_at) };
        self.origin = Arc::new(origin);
        self.topic = writer.topic.as_str().into();
        self.type_name = writer.type_name.as_str().into();
        self.tags = tags_of(&writer);
        self.writer = writer;
    }

    pub fn message(&mut self, (number, sent): (i64, Option<u64>), captured_at: Timestamp, body: Vec<u8>) -> Message {
        self.undefined |= self.definition.is_empty();
        let mut said = self.tags.clone();
        // MCAP has 32 bits for it.
        said.push((tags::SEQUENCE.to_owned(), low(number).to_string()));
        said.extend(sent.map(|sent| (tags::PUBLISHED.to_owned(), sent.to_string())));
        self.carrying(said, captured_at, body)
    }

    /// A message without a body that carries the definition, if some went without it.
    pub fn define(&mut self, definition: Arc<str>) -> Option<Message> {
        self.definition = definition;
        let is_due = std::mem::take(&mut self.undefined);
        is_due.then(|| self.carrying(self.tags.clone(), Timestamp::now(), Vec::new()))
    }

    fn carrying(&self, said: Vec<(String, String)>, captured_at: Timestamp, body: Vec<u8>) -> Message {
        Message {
            topic: Arc::clone(&self.topic),
            type_name: Arc::clone(&self.type_name),
            md5sum: "*".into(),
            definition: Arc::clone(&self.definition),
            caller_id: Arc::clone(&self.origin.caller_id),
            origin: Arc::clone(&self.origin),
            latching: self.writer.quality.latched,
            captured_at,
            header_seq: None,
            tags: said,
            body,
        }
    }

    fn caller_id(&self) -> String {
        clean(&self.origin.caller_id, 120)
    }

    pub fn connect(&mut self) -> Option<CaptureNotice> {
        let told = std::mem::replace(&mut self.connected, true);
        (!told && self.gone.is_none()).then(|| CaptureNotice::PublisherConnected {
            topic: Arc::clone(&self.topic),
            origin: Arc::clone(&self.origin),
        })
    }

    pub fn disconnect(&mut self, reason: &str) -> Option<CaptureNotice> {
        std::mem::take(&mut self.connected).then(|| CaptureNotice::PublisherLost {
            topic: Arc::clone(&self.topic),
            caller_id: self.caller_id(),
            number: self.origin.number,
            reason: reason.to_owned(),
        })
    }

    /// It contradicts itself about its messages.
    pub fn contradicts(&self, contradiction: String) -> CaptureNotice {
        CaptureNotice::Contradiction { topic: Arc::clone(&self.topic), caller_id: self.caller_id(), contradiction }
    }

    /// Messages that never arrived; of a reliable one nothing arrives late, and `all` waits for nobody.
    pub fn lost(&mut self, now: Instant, all: bool) -> Vec<CaptureNotice> {
        let gaps = self.numbers.settled(now, all || self.writer.quality.reliable);
        let notice = |(first, last): (i64, i64)| CaptureNotice::LostInTransport {
            topic: Arc::clone(&self.topic),
            caller_id: self.caller_id(),
            count: u64::try_from(last - first).unwrap_or(0) + 1,
            numbers: (low(first), low(last)),
        };
        gaps.into_iter().map(notice).collect()
    }

    /// It did not return after the reader was restarted.
    pub fn vanished(&mut self, now: Instant) -> Vec<CaptureNotice> {
        let mut notices = self.lost(now, true);
        let count = |notice: &CaptureNotice| match notice {
            CaptureNotice::LostInTransport { count, .. } => *count,
            _ => 0,
        };
        let at_least = notices.iter().map(count).sum();
        if self.connected && self.numbers.last.is_some() {
            let (topic, caller_id) = (Arc::clone(&self.topic), self.caller_id());
            notices.push(CaptureNotice::EndUnknown { topic, caller_id, at_least });
        }
        notices
    }
}

fn low(number: i64) -> u32 {
    u32::try_from(number & i64::from(u32::MAX)).unwrap_or(0)
}

/// A QoS profile in the words of `ros2 bag`, which cannot read one that lacks an entry: `unknown` where it has no word.
/// Publishers do not announce history and depth.
fn profile(quality: Quality) -> String {
    const ENDLESS: u64 = i64::MAX as u64;
    let word = |yes, one: &'static str, other| if yes { one } else { other };
    let time = |nanoseconds: Option<u64>| {
        let whole = nanoseconds.unwrap_or(ENDLESS);
        format!("\n    sec: {}\n    nsec: {}", whole / 1_000_000_000, whole % 1_000_000_000)
    };
    format!(
        "- history: unknown\n  depth: 0\n  reliability: {}\n  durability: {}\n  deadline:{}\n  lifespan:{}\n  \
         liveliness: {}\n  liveliness_lease_duration:{}\n  avoid_ros_namespace_conventions: false",
        word(quality.reliable, "reliable", "best_effort"),
        word(quality.latched, "transient_local", "volatile"),
        time(quality.deadline),
        time(quality.lifespan),
        match quality.liveliness {
            Liveliness::Automatic => "automatic",
            Liveliness::ManualByParticipant => "unknown",
            Liveliness::ManualByTopic => "manual_by_topic",
        },
        time(quality.lease),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn writer() -> Writer {
        Writer {
            id: "0110aa".into(),
            topic: "/robot1/odom".into(),
            type_name: "nav_msgs/msg/Odometry".into(),
            type_hash: Some(format!("RIHS01_{}", "ab".repeat(32))),
            quality: Quality {
                latched: true,
                lifespan: Some(1_500_000_000),
                liveliness: Liveliness::ManualByTopic,
                lease: Some(2_000_000_000),
                ..Quality::default()
            },
            node: None,
            naming: false,
            vendor: "cyclonedds".into(),
        }
    }

    #[test]
    fn what_is_told_of_a_publisher_goes_beside_its_messages() {
        let mut publisher = Publisher::new(writer(), 7, Instant::now());
        let message = publisher.message(((1 << 32) + 5, Some(9)), Timestamp(10), vec![0, 1, 0, 0]);
        let tag = |name: &str| message.tags.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str());
        assert_eq!(tag("encoding"), Some("cdr"));
        assert_eq!(tag("mcap.sequence"), Some("5"));
        assert_eq!(tag("mcap.publish_time"), Some("9"));
        assert_eq!(tag("mcap.channel.writer_id"), Some("0110aa"));
        assert_eq!(tag("mcap.channel.topic_type_hash"), publisher.writer.type_hash.as_deref());
        let profile = tag("mcap.channel.offered_qos_profiles").expect("a profile");
        assert!(profile.contains("reliability: best_effort\n  durability: transient_local\n"), "{profile}");
        assert!(profile.contains("lifespan:\n    sec: 1\n    nsec: 500000000\n"), "{profile}");
        let lively = "liveliness: manual_by_topic\n  liveliness_lease_duration:\n    sec: 2\n    nsec: 0\n";
        assert!(profile.contains(lively), "{profile}");
        assert!(profile.contains("deadline:\n    sec: 9223372036\n    nsec: 854775807\n"), "{profile}");
        assert_eq!((&*message.caller_id, message.latching), ("/unnamed_cyclonedds", true));
        assert_eq!((publisher.origin.host.as_str(), publisher.origin.md5sum.len()), ("domain7", 64));
    }

    #[test]
    fn a_publisher_that_vanishes_while_nobody_reads_leaves_an_unknown_end() {
        let now = Instant::now();
        let mut publisher = Publisher::new(writer(), 0, now);
        assert!(publisher.vanished(now).is_empty(), "nothing was read of it");
        assert!(publisher.connect().is_some() && publisher.connect().is_none());
        publisher.numbers.follow(1, now);
        publisher.numbers.follow(5, now);
        let notices = publisher.vanished(now);
        assert!(
            matches!(
                notices[..],
                [
                    CaptureNotice::LostInTransport { count: 3, numbers: (2, 4), .. },
                    CaptureNotice::EndUnknown { at_least: 3, .. }
                ]
            ),
            "{notices:?}"
        );
        assert!(publisher.disconnect("gone").is_some() && publisher.disconnect("gone").is_none());
    }
}
