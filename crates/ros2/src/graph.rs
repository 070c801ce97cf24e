//! Participants and writers of the domain, and each writer's node as ROS 2 publishes it (`rmw_dds_common`'s
//! `ParticipantEntitiesInfo`; an id takes 24 bytes up to Humble, then 16). And names of ROS 2 in DDS.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use rustdds::discovery::DiscoveredWriterData;

use crate::pipe::read::{Counts, Quality, Told, Writer};
use crate::{describing::Reader, quality};

const MOST_WRITERS: usize = 20_000;

pub type Id = [u8; 16];
pub type Prefix = [u8; 12];

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    pub dds_topic: String,
    pub dds_type: String,
    /// Whether its type has a key.
    pub keyed: bool,
    pub quality: Quality,
    pub told: Option<Writer>,
}

/// Participants of this program that are recognised: the last ones.
const MOST_OWN: usize = 4;

#[derive(Default)]
pub struct Graph {
    own: Vec<Prefix>,
    pub writers: BTreeMap<Id, Found>,
    /// Ids known to the site, also of writers that are gone.
    pub known: HashSet<Id>,
}

/// Length of the prefix shared by one program's participants: its own, and its heralds.
pub const PROGRAM: usize = 8;

pub fn prefix(id: &Id) -> Prefix {
    id.first_chunk().copied().unwrap_or_default()
}

impl Graph {
    pub fn joined(&mut self, own: Prefix) {
        self.own.insert(0, own);
        self.own.truncate(MOST_OWN);
    }

    pub fn is_own(&self, participant: &Prefix) -> bool {
        self.own.iter().any(|own| own.get(..PROGRAM) == participant.get(..PROGRAM))
    }

    pub fn is_of_any(&self, writer: &Id, topics: &BTreeSet<String>) -> bool {
        self.writers.get(writer).is_some_and(|found| topics.contains(&found.dds_topic))
    }

    pub fn of_topic<'a>(&'a self, dds_topic: &'a str) -> impl Iterator<Item = &'a Found> {
        self.writers.values().filter(move |found| found.dds_topic == dds_topic)
    }

    pub fn writer_of(&self, dds_topic: &str, dds_type: &str) -> Option<Id> {
        let is_it = |found: &Found| found.dds_topic == dds_topic && found.dds_type == dds_type;
        self.writers.iter().find_map(|(id, found)| is_it(found).then_some(*id))
    }

    /// Takes the present writers of others; returns the reports.
    pub fn look(&mut self, now: &[DiscoveredWriterData], nodes: &Nodes) -> Vec<Told> {
        let mut told = Vec::new();
        let mut there = BTreeMap::new();
        let is_naming = |writer: &&DiscoveredWriterData| writer.publication_topic_data.topic_name == NODES;
        let naming = now.iter().filter(is_naming);
        let naming: BTreeSet<Prefix> =
            naming.map(|writer| prefix(&writer.publication_topic_data.key.to_bytes())).collect();
        for writer in now.iter().take(MOST_WRITERS) {
            let id = writer.publication_topic_data.key.to_bytes();
            let mut found = found(id, writer, nodes);
            if let Some(told) = &mut found.told {
                told.naming = naming.contains(&prefix(&id));
            }
            if self.writers.get(&id) != Some(&found)
                && let Some(writer) = &found.told
            {
                self.know(id);
                told.push(Told::WriterHere(writer.clone()));
            }
            there.insert(id, found);
        }
        let gone = self.writers.iter().filter(|(id, found)| found.told.is_some() && !there.contains_key(*id));
        told.extend(gone.map(|(id, _)| Told::WriterGone { id: hex(id) }));
        self.writers = there;
        told
    }

    /// A writer known only from its samples; the rest will be announced.
    pub fn by_sample(&mut self, id: Id, dds_topic: &str, dds_type: &str) -> Option<Told> {
        let quality = Quality::default();
        let writer = writer(id, dds_topic, dds_type, (None, quality), None)?;
        self.know(id);
        Some(Told::WriterHere(Writer { naming: true, ..writer }))
    }

    fn know(&mut self, id: Id) {
        if self.known.len() >= 2 * MOST_WRITERS {
            let writers = &self.writers;
            self.known.retain(|id| writers.contains_key(id));
        }
        self.known.insert(id);
    }

    pub fn counts(&self, participants: usize) -> Counts {
        let count = |number: usize| u32::try_from(number).unwrap_or(u32::MAX);
        let own = self.writers.values().filter(|found| found.told.is_some()).count();
        let foreign =
            self.writers.values().filter(|found| found.told.is_none() && is_foreign(&found.dds_topic)).count();
        Counts { participants: count(participants), writers: count(own), foreign: count(foreign) }
    }
}

/// Services and ROS 2's own topics are not foreign, although users do not name them.
fn is_foreign(dds_topic: &str) -> bool {
    !["rt/", "rq/", "rr/", "rs/", "ra/"].iter().any(|own| dds_topic.starts_with(own)) && dds_topic != NODES
}

fn found(id: Id, writer_data: &DiscoveredWriterData, nodes: &Nodes) -> Found {
    let data = &writer_data.publication_topic_data;
    let quality = quality::offered(data);
    let hash = type_hash(&writer_data.user_data);
    let told = writer(id, &data.topic_name, &data.type_name, (hash, quality), nodes.of(&id));
    let (dds_topic, dds_type) = (data.topic_name.clone(), data.type_name.clone());
    // The last byte gives the kind of endpoint: of writers, 2 has a key, 3 none.
    let keyed = id[15] & 0x3f == 2;
    Found { dds_topic, dds_type, keyed, quality, told }
}

fn writer(
    id: Id,
    dds_topic: &str,
    dds_type: &str,
    (type_hash, quality): (Option<String>, Quality),
    node: Option<&str>,
) -> Option<Writer> {
    Some(Writer {
        id: hex(&id),
        topic: topic(dds_topic)?,
        type_name: type_name(dds_type)?,
        type_hash,
        quality,
        node: node.map(str::to_owned),
        naming: false,
        vendor: vendor(id),
    })
}

const MOST: usize = 20_000;

#[derive(Default)]
pub struct Nodes {
    by_participant: HashMap<Id, Vec<(Id, String)>>,
    kept: usize,
}

impl Nodes {
    /// Ignores unreadable messages, and claims about another participant.
    pub fn take(&mut self, sender: &Id, message: &[u8]) {
        let Some((participant, writers)) = [16, 24].into_iter().find_map(|length| parse(message, length)) else {
            return;
        };
        if participant[..12] != sender[..12] {
            return;
        }
        self.forget(&participant);
        if self.kept + writers.len() <= MOST {
            self.kept += writers.len();
            self.by_participant.insert(participant, writers);
        }
    }

    fn forget(&mut self, participant: &Id) {
        self.kept -= self.by_participant.remove(participant).map_or(0, |writers| writers.len());
    }

    /// An id's first twelve bytes are its participant's.
    pub fn keep(&mut self, is_there: impl Fn(&[u8]) -> bool) {
        let gone: Vec<Id> = self.by_participant.keys().filter(|id| !is_there(&id[..12])).copied().collect();
        gone.iter().for_each(|id| self.forget(id));
    }

    pub fn of(&self, writer: &Id) -> Option<&str> {
        let lists = self.by_participant.iter().filter(|(id, _)| id[..12] == writer[..12]);
        lists.flat_map(|(_, writers)| writers).find(|(id, _)| id == writer).map(|(_, node)| node.as_str())
    }
}

/// `None` if the message does not end with ids of this length.
fn parse(message: &[u8], id: usize) -> Option<(Id, Vec<(Id, String)>)> {
    let mut reader = Reader::of(message)?;
    let participant = reader.id(id)?;
    let mut writers = Vec::new();
    // Each list is bounded by the bytes left.
    for _ in 0..reader.count(8)? {
        let (namespace, name) = (reader.text()?, reader.text()?);
        let node = match namespace {
            "/" | "" => format!("/{name}"),
            _ => format!("{namespace}/{name}"),
        };
        for _ in 0..reader.count(id)? {
            reader.id(id)?;
        }
        for _ in 0..reader.count(id)? {
            let writer = reader.id(id)?;
            let fits = node.len() <= LONGEST && !node.chars().any(char::is_control);
            writers.extend(fits.then(|| (writer, node.clone())));
        }
    }
    // Up to three bytes of padding.
    (reader.left() < 4).then_some((participant, writers))
}

/// Longest accepted name, of a node with its namespace.
const LONGEST: usize = 255;

/// The ROS 2 topic that maps writers to nodes.
pub const NODES: &str = "ros_discovery_info";

/// `/robot1/odom` for `rt/robot1/odom`; `None` for other names (services have other prefixes).
pub fn topic(dds: &str) -> Option<String> {
    let name = dds.strip_prefix("rt").filter(|name| name.len() <= LONGEST)?;
    let is_part = |part: &str| {
        part.bytes().next().is_some_and(|byte| byte.is_ascii_alphabetic() || byte == b'_')
            && part.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
    };
    name.strip_prefix('/')?.split('/').all(is_part).then(|| name.to_owned())
}

pub fn dds_topic(topic: &str) -> String {
    format!("rt{topic}")
}

/// Topics that carry a node's requests for type descriptions, and its answers; `None` if this is no node's name.
pub fn description_topics(node: &str) -> Option<(String, String)> {
    topic(&dds_topic(node))?;
    Some((format!("rq{node}/get_type_descriptionRequest"), format!("rr{node}/get_type_descriptionReply")))
}

/// `nav_msgs/msg/Odometry` for `nav_msgs::msg::dds_::Odometry_`.
pub fn type_name(dds: &str) -> Option<String> {
    let parts: Vec<&str> = dds.split("::").collect();
    let [package, kind, "dds_", name] = parts[..] else { return None };
    let name = name.strip_suffix('_')?;
    let is_word =
        |part: &str| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
    let known = [package, kind, name].into_iter().all(is_word) && dds.len() <= LONGEST;
    known.then(|| format!("{package}/{kind}/{name}"))
}

/// `nav_msgs::msg::dds_::Odometry_` for `nav_msgs/msg/Odometry`.
pub fn dds_type(type_name: &str) -> Option<String> {
    let parts: Vec<&str> = type_name.split('/').collect();
    let [package, kind, name] = parts[..] else { return None };
    let dds = format!("{package}::{kind}::dds_::{name}_");
    self::type_name(&dds).is_some_and(|back| back == type_name).then_some(dds)
}

/// From a writer's user data: `key=value;` after a length, padded.
pub fn type_hash(user_data: &[u8]) -> Option<String> {
    const KEY: &[u8] = b"typehash=";
    let begin = user_data.windows(KEY.len()).position(|window| window == KEY)? + KEY.len();
    let value = user_data[begin..].split(|byte| *byte == b';' || *byte == 0).next()?;
    let text = std::str::from_utf8(value).ok()?;
    let digits = text.strip_prefix("RIHS01_")?;
    (digits.len() == 64 && digits.bytes().all(|byte| byte.is_ascii_hexdigit())).then(|| text.to_owned())
}

/// From the first bytes of the id.
pub fn vendor(id: [u8; 16]) -> String {
    match id[..2] {
        [1, 1] => "connext".to_owned(),
        [1, 3] => "opendds".to_owned(),
        [1, 15] => "fastdds".to_owned(),
        [1, 16] => "cyclonedds".to_owned(),
        [1, 17] => "gurumdds".to_owned(),
        [1, 18] => "rustdds".to_owned(),
        [1, 20] => "dustdds".to_owned(),
        [one, two] => format!("vendor_{one:02x}{two:02x}"),
        _ => "unknown".to_owned(),
    }
}

pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As written by a node of Jazzy (16) or Humble (24).
    fn message(id: usize, namespace: &str, name: &str) -> Vec<u8> {
        let mut bytes = vec![0, 1, 0, 0];
        let put_text = |bytes: &mut Vec<u8>, text: &str| {
            while !(bytes.len() - 4).is_multiple_of(4) {
                bytes.push(0);
            }
            bytes.extend(u32::try_from(text.len() + 1).expect("short").to_le_bytes());
            bytes.extend(text.bytes().chain([0]));
        };
        let put_ids = |bytes: &mut Vec<u8>, ids: &[u8]| {
            while !(bytes.len() - 4).is_multiple_of(4) {
                bytes.push(0);
            }
            bytes.extend(u32::try_from(ids.len()).expect("few").to_le_bytes());
            for last in ids {
                let mut own = vec![7; 16];
                own[15] = *last;
                own.resize(id, 0);
                bytes.extend(own);
            }
        };
        let mut participant = vec![7; 16];
        participant.resize(id, 0);
        bytes.extend(participant);
        bytes.extend(1_u32.to_le_bytes());
        put_text(&mut bytes, namespace);
        put_text(&mut bytes, name);
        put_ids(&mut bytes, &[1]);
        put_ids(&mut bytes, &[2, 3]);
        bytes
    }

    #[test]
    fn writers_belong_to_nodes_in_both_lengths_of_ids() {
        for length in [16, 24] {
            let mut nodes = Nodes::default();
            nodes.take(&[7; 16], &message(length, "/robot1", "driver"));
            let mut id = [7; 16];
            for (last, node) in [(2, Some("/robot1/driver")), (3, Some("/robot1/driver")), (1, None), (9, None)] {
                id[15] = last;
                assert_eq!(nodes.of(&id), node, "{length} {last}");
            }
            nodes.keep(|prefix| prefix != [7; 12]);
            id[15] = 2;
            assert_eq!((nodes.of(&id), nodes.kept), (None, 0));
        }
        let mut nodes = Nodes::default();
        nodes.take(&[7; 16], &message(16, "/", "driver"));
        assert_eq!(nodes.of(&[[7; 15].as_slice(), &[2]].concat().try_into().expect("16")), Some("/driver"));
    }

    #[test]
    fn nobody_names_the_writers_of_another_participant() {
        let mut nodes = Nodes::default();
        nodes.take(&[8; 16], &message(16, "/", "driver"));
        assert_eq!(nodes.kept, 0);
    }

    #[test]
    fn hostile_messages_are_left_out() {
        let whole = message(16, "/", "x");
        let mut nodes = Nodes::default();
        for end in 0..whole.len() - 3 {
            nodes.take(&[7; 16], &whole[..end]);
        }
        let mut claim = whole.clone();
        claim[20..24].copy_from_slice(&u32::MAX.to_le_bytes());
        nodes.take(&[7; 16], &claim);
        nodes.take(&[7; 16], &message(16, "/", "x\u{1b}[2J"));
        assert_eq!(nodes.kept, 0);
    }
}

#[cfg(test)]
mod names_tests {
    use super::*;

    #[test]
    fn names_of_dds_and_of_people() {
        assert_eq!(topic("rt/robot1/odom").as_deref(), Some("/robot1/odom"));
        for none in ["rq/x", "rt", "rt/", "rtx/y", "rt//x", "rt/1x", "rt/a\u{1b}b", "Square"] {
            assert_eq!(topic(none), None, "{none}");
        }
        assert_eq!(type_name("nav_msgs::msg::dds_::Odometry_").as_deref(), Some("nav_msgs/msg/Odometry"));
        assert_eq!(dds_type("nav_msgs/msg/Odometry").as_deref(), Some("nav_msgs::msg::dds_::Odometry_"));
        for none in ["nav_msgs/Odometry", "a/b/c/d", "a//b", "a/msg/b::c", "a/msg/b c", ""] {
            assert_eq!(dds_type(none), None, "{none}");
        }
        for none in ["ShapeType", "a::msg::dds_::B", "a::msg::B_", "::msg::dds_::B_", "a::msg::dds_::B\u{7}_"] {
            assert_eq!(type_name(none), None, "{none}");
        }
    }

    #[test]
    fn a_node_is_asked_under_its_own_name() {
        let topics = description_topics("/robot1/driver").expect("a name");
        assert_eq!(topics.0, "rq/robot1/driver/get_type_descriptionRequest");
        assert_eq!(topics.1, "rr/robot1/driver/get_type_descriptionReply");
        for none in ["", "/", "driver", "/a//b", "/a b"] {
            assert_eq!(description_topics(none), None, "{none}");
        }
    }

    #[test]
    fn the_hash_is_found_behind_its_length_and_before_the_padding() {
        let digits = "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
        let data = [b"Q\0\0\0".as_slice(), format!("typehash=RIHS01_{digits};\0\0\0").as_bytes()].concat();
        assert_eq!(type_hash(&data), Some(format!("RIHS01_{digits}")));
        assert_eq!(type_hash(b"\x0a\0\0\0typehash=RIHS01_12;"), None);
        assert_eq!(type_hash(b""), None);
        assert_eq!(type_hash(format!("typehash=RIHS01_{}\u{1b};", &digits[1..]).as_bytes()), None);
    }
}
