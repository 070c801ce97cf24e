//! Asks nodes for the definition of a type they publish, by ROS 2's service `~/get_type_description` (REP 2016), which
//! is two topics. Every length in an answer is checked against its bytes.
//!
//! `rmw_fastrtps` relates an answer by a sample identity beside it, `rmw_cyclonedds` by two numbers before the body.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use rustdds::no_key::{DataWriter, SimpleDataReader};
use rustdds::{
    DomainParticipant, Publisher, QosPolicies, RTPSEntity, SampleIdentity, SequenceNumber, Subscriber, TopicKind,
    WriteOptionsBuilder, bytes::Bytes,
};

use crate::graph::{self, Graph, Id};
use crate::quality::{self, Raw, RawAdapter, RawDecoder, Request as Quality};
use crate::{farewell::Departures, pipe::read::Told, publish::Encoded};

const REQUEST_TYPE: &str = "type_description_interfaces::srv::dds_::GetTypeDescription_Request_";
const ANSWER_TYPE: &str = "type_description_interfaces::srv::dds_::GetTypeDescription_Response_";
/// As ROS 2 keeps samples of a service's topics.
const DEPTH: usize = 10;
/// A request is repeated: it is lost if sent before both sides have found each other.
const REPEAT: Duration = Duration::from_secs(1);
/// Limit of an answer, discovery included.
const PATIENCE: Duration = Duration::from_secs(10);
/// Limits of the nodes asked at a time, and of the waiting questions.
const AT_ONCE: usize = 4;
const MOST_WAITING: usize = 1024;
/// Little-endian CDR of the first version.
const CDR: u16 = 1;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// By a sample identity beside it.
    Beside,
    /// By two numbers before the body.
    Before,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Question {
    /// `/namespace/name`
    pub node: String,
    /// `package/msg/Type`
    pub type_name: String,
    pub type_hash: String,
}

struct Asked {
    question: Question,
    form: Form,
    begun: Instant,
    sent: Option<Instant>,
    number: u64,
    reader: SimpleDataReader<Raw, RawAdapter>,
    writer: DataWriter<Bytes, Encoded<CDR>>,
}

pub type Parts<'a> = (&'a DomainParticipant, &'a Subscriber, &'a Publisher);

#[derive(Default)]
pub struct Describing {
    waiting: VecDeque<Question>,
    asked: Vec<Asked>,
    /// Readers that are leaving: a writer would wait for one that is gone.
    leaving: Vec<SimpleDataReader<Raw, RawAdapter>>,
}

impl Describing {
    /// Forgets excess questions; the site asks again when a publisher appears.
    pub fn ask(&mut self, question: Question) {
        let is_known = self.waiting.contains(&question) || self.asked.iter().any(|asked| asked.question == question);
        if !is_known && self.waiting.len() < MOST_WAITING {
            self.waiting.push_back(question);
        }
    }

    pub fn hand_on(&mut self) -> Self {
        Self { waiting: std::mem::take(&mut self.waiting), ..Self::default() }
    }

    pub fn is_idle(&self) -> bool {
        self.asked.is_empty() && self.leaving.is_empty()
    }

    /// Returns reports to the site, with their payloads.
    pub fn go_on(&mut self, parts: Parts<'_>, graph: &Graph, departures: &mut Departures) -> Vec<(Told, Vec<u8>)> {
        let mut told = Vec::new();
        for reader in std::mem::take(&mut self.leaving) {
            let id = reader.guid().to_bytes();
            if departures.is_telling(&id) {
                self.leaving.push(reader);
                continue;
            }
            drop(reader);
            // Once more: somebody may have heard of it only after it left.
            departures.tell(id);
        }
        while self.asked.len() < AT_ONCE {
            let Some(question) = self.waiting.pop_front() else { break };
            match Asked::begin(parts, &question, graph) {
                Ok(asked) => self.asked.push(asked),
                Err(reason) => told.push(tell(question, Err(reason))),
            }
        }
        for mut asked in std::mem::take(&mut self.asked) {
            match asked.go_on() {
                None => self.asked.push(asked),
                Some(answer) => {
                    let Asked { question, reader, writer, .. } = asked;
                    departures.tell(reader.guid().to_bytes());
                    departures.tell(writer.guid().to_bytes());
                    self.leaving.push(reader);
                    told.push(tell(question, answer));
                }
            }
        }
        told
    }
}

fn tell(question: Question, answer: Answer) -> (Told, Vec<u8>) {
    let Question { node, type_name, type_hash } = question;
    let (reason, (text, structure)) = match answer {
        Ok(texts) => (None, texts),
        Err(reason) => (Some(reason.chars().take(300).collect()), Default::default()),
    };
    let structured = u32::try_from(structure.len()).unwrap_or(0);
    (Told::Described { node, type_name, type_hash, structured, reason }, [structure, text].concat().into_bytes())
}

fn form(server: Id) -> Option<Form> {
    match graph::vendor(server).as_str() {
        "fastdds" => Some(Form::Beside),
        "cyclonedds" => Some(Form::Before),
        _ => None,
    }
}

impl Asked {
    fn begin(parts: Parts<'_>, question: &Question, graph: &Graph) -> Result<Self, String> {
        let (participant, subscriber, publisher) = parts;
        let Some((request, answer)) = graph::description_topics(&question.node) else {
            return Err("its name is not a valid node name".to_owned());
        };
        let Some(server) = graph.writer_of(&answer, ANSWER_TYPE) else {
            return Err("it does not offer get_type_description".to_owned());
        };
        let Some(form) = form(server) else {
            return Err(format!("services of {} are not supported", graph::vendor(server)));
        };
        let failed = |error: &dyn std::fmt::Debug| format!("it cannot be queried ({error:?})");
        let policies: QosPolicies = quality::policies(Quality { reliable: true, latched: false }, DEPTH);
        let topic = |name: String, type_name: &str| {
            let made = participant.create_topic(name, type_name.to_owned(), &policies, TopicKind::NoKey);
            made.map_err(|error| failed(&error))
        };
        let (request, answer) = (topic(request, REQUEST_TYPE)?, topic(answer, ANSWER_TYPE)?);
        let reader = subscriber.create_simple_datareader_no_key(&answer, Some(policies.clone()));
        let writer = publisher.create_datawriter_no_key(&request, Some(quality::plain(&policies)));
        Ok(Self {
            question: question.clone(),
            form,
            begun: Instant::now(),
            sent: None,
            number: 0,
            reader: reader.map_err(|error| failed(&error))?,
            writer: writer.map_err(|error| failed(&error))?,
        })
    }

    /// The end of the writer's id is unique to this asker.
    fn header(&self, number: u64) -> Option<Header> {
        let id = self.writer.guid().to_bytes();
        let client = id.last_chunk().map_or(0, |last| u64::from_le_bytes(*last));
        (self.form == Form::Before).then_some((client, number))
    }

    /// The answer, if it is there or will not come.
    fn go_on(&mut self) -> Option<Answer> {
        if let Some(answer) = self.take() {
            return Some(answer);
        }
        if self.begun.elapsed() >= PATIENCE {
            return Some(Err(format!("it did not answer within {} s", PATIENCE.as_secs())));
        }
        if self.sent.is_none_or(|sent| sent.elapsed() >= REPEAT) {
            self.number += 1;
            let Question { type_name, type_hash, .. } = &self.question;
            let body = request(self.header(self.number), type_name, type_hash);
            let options = match self.form {
                Form::Before => WriteOptionsBuilder::new(),
                Form::Beside => {
                    // As rmw_fastrtps does: the answer's destination; the number is the sample's own.
                    let wanted =
                        SampleIdentity { writer_guid: self.reader.guid(), sequence_number: SequenceNumber::UNKNOWN };
                    WriteOptionsBuilder::new().related_sample_identity(wanted)
                }
            };
            // An unsent request is sent the next time.
            drop(self.writer.write_with_options(Bytes::from(body), options.build()));
            self.sent = Some(Instant::now());
        }
        None
    }

    fn take(&mut self) -> Option<Answer> {
        self.reader.drain_read_notifications();
        while let Ok(Some(change)) = self.reader.try_take_one_with(RawDecoder) {
            let related = change.related_sample_identity().map(|related| related.writer_guid);
            let is_own = related.is_some_and(|id| id == self.reader.guid() || id == self.writer.guid());
            let message = change.into_value().0;
            let type_name = &self.question.type_name;
            let found = match self.form {
                Form::Beside if !is_own => None,
                Form::Beside => answer(&message, None, type_name),
                // An answer to an earlier request counts too.
                Form::Before => (1..=self.number).find_map(|number| answer(&message, self.header(number), type_name)),
            };
            if found.is_some() {
                return found;
            }
        }
        None
    }
}

pub const LONGEST_TEXT: usize = 1 << 20;
/// The least bytes of a field, a type and a source in an answer.
const FIELD: usize = 4;
const TYPE: usize = 4;
const SOURCE: usize = 4;

/// Numbers that relate an answer to its request, before the body (`rmw_cyclonedds`).
pub type Header = (u64, u64);

pub fn request(header: Option<Header>, type_name: &str, type_hash: &str) -> Vec<u8> {
    let mut body = Writer::default();
    if let Some((client, number)) = header {
        body.long(client);
        body.long(number);
    }
    body.text(type_name);
    body.text(type_hash);
    body.truth(true);
    body.0
}

/// The type with all its parts, as in MCAP's `ros2msg`, twice: the sources of its package, empty if they are not `.msg`;
/// and written from the structure. Otherwise the reason.
pub type Answer = Result<(String, String), String>;

pub fn answer(message: &[u8], header: Option<Header>, type_name: &str) -> Option<Answer> {
    let unreadable = || Err("its answer cannot be read".to_owned());
    let Some(mut reader) = Reader::of(message) else { return Some(unreadable()) };
    if let Some(own) = header {
        let theirs = reader.long().zip(reader.long());
        if theirs != Some(own) {
            return None;
        }
    }
    Some(read(&mut reader, type_name).unwrap_or_else(unreadable))
}

fn read(reader: &mut Reader<'_>, type_name: &str) -> Option<Answer> {
    let is_successful = reader.byte()? == 1;
    let reason = reader.text()?;
    if !is_successful {
        return Some(Err(format!("it refuses: {reason}")));
    }
    let mut types = vec![structure(reader)?];
    for _ in 0..reader.count(TYPE)? {
        types.push(structure(reader)?);
    }
    // rclpy's texts may be cut within a character; the structure does not depend on them.
    let sources = sources(reader).unwrap_or_default();
    let (text, structure) = (joined(&sources, type_name), whole_structure(&types, type_name));
    if text.is_empty() && structure.is_empty() {
        return Some(Err("its answer cannot be expressed as .msg, or is too long".to_owned()));
    }
    Some(Ok((text, structure)))
}

fn sources<'a>(reader: &mut Reader<'a>) -> Option<Vec<(&'a str, &'a str, &'a str)>> {
    (0..reader.count(SOURCE)?).map(|_| Some((reader.text()?, reader.text()?, reader.text()?))).collect()
}

fn structure<'a>(reader: &mut Reader<'a>) -> Option<(&'a str, Option<String>)> {
    let name = reader.text()?;
    let mut lines = Some(String::new());
    for _ in 0..reader.count(FIELD)? {
        let (field, number, capacity) = (reader.text()?, reader.byte()?, reader.long()?);
        let (bound, nested, _default) = (reader.long()?, reader.text()?, reader.text()?);
        // Stands for a type without fields.
        if field == "structure_needs_at_least_one_member" {
            continue;
        }
        let line = kind(number, capacity, bound, nested).map(|kind| format!("{kind} {field}\n"));
        lines = lines.zip(line).map(|(lines, line)| lines + &line);
    }
    Some((name, lines))
}

/// `None` for a type that only IDL has.
fn kind(number: u8, capacity: u64, bound: u64, nested: &str) -> Option<String> {
    const PLAIN: [&str; 10] =
        ["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"];
    let element = match number % 48 {
        1 => short(nested),
        plain @ 2..=11 => PLAIN.get(usize::from(plain - 2)).map(|name| (*name).to_owned())?,
        15 => "bool".to_owned(),
        16 => "byte".to_owned(),
        17 => "string".to_owned(),
        18 => "wstring".to_owned(),
        21 => format!("string<={bound}"),
        22 => format!("wstring<={bound}"),
        _ => return None,
    };
    Some(match number / 48 {
        0 => element,
        1 => format!("{element}[{capacity}]"),
        2 => format!("{element}[<={capacity}]"),
        3 => format!("{element}[]"),
        _ => return None,
    })
}

fn short(name: &str) -> String {
    name.replacen("/msg/", "/", 1)
}

/// Empty if a part is missing or not expressible, or the whole is too long.
fn whole_structure(types: &[(&str, Option<String>)], type_name: &str) -> String {
    let parts: Option<Vec<_>> = types.iter().map(|(name, lines)| Some((*name, lines.as_deref()?))).collect();
    let text = parts.map(|parts| whole(&parts, type_name)).unwrap_or_default();
    if text.is_empty() { text } else { format!("{WRITTEN}{text}") }
}

const WRITTEN: &str =
    "# From the structure that the publishing node told: without comments, constants and default values.\n";

/// Empty if the type's own source is missing, one is not `.msg`, or the whole is too long.
fn joined(sources: &[(&str, &str, &str)], type_name: &str) -> String {
    let parts = sources.iter().map(|(name, encoding, lines)| (*encoding == "msg").then_some((*name, *lines)));
    parts.collect::<Option<Vec<_>>>().map(|parts| whole(&parts, type_name)).unwrap_or_default()
}

fn whole(parts: &[(&str, &str)], type_name: &str) -> String {
    let Some((_, own)) = parts.iter().find(|(name, _)| *name == type_name) else { return String::new() };
    let mut text = format!("{}\n", own.trim_end());
    for (name, lines) in parts.iter().filter(|(name, _)| *name != type_name) {
        text.push_str(&format!("{}\nMSG: {}\n{}\n", "=".repeat(80), short(name), lines.trim_end()));
    }
    if text.len() > LONGEST_TEXT { String::new() } else { text }
}

/// Numbers are aligned by their size.
pub struct Reader<'a> {
    body: &'a [u8],
    at: usize,
    little: bool,
}

impl<'a> Reader<'a> {
    pub fn of(message: &'a [u8]) -> Option<Self> {
        let (header, body) = message.split_at_checked(4)?;
        (header[0] == 0 && header[1] <= 1).then_some(Self { body, at: 0, little: header[1] == 1 })
    }

    /// The bytes left.
    pub fn left(&self) -> usize {
        self.body.len() - self.at.min(self.body.len())
    }

    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let end = self.at.checked_add(length)?;
        let found = self.body.get(self.at..end)?;
        self.at = end;
        Some(found)
    }

    fn aligned<const LENGTH: usize>(&mut self) -> Option<[u8; LENGTH]> {
        self.at = self.at.next_multiple_of(LENGTH);
        let mut bytes: [u8; LENGTH] = self.take(LENGTH)?.try_into().ok()?;
        if !self.little {
            bytes.reverse();
        }
        Some(bytes)
    }

    pub fn byte(&mut self) -> Option<u8> {
        self.aligned::<1>().map(|[byte]| byte)
    }

    pub fn number(&mut self) -> Option<u32> {
        self.aligned().map(u32::from_le_bytes)
    }

    pub fn long(&mut self) -> Option<u64> {
        self.aligned().map(u64::from_le_bytes)
    }

    /// Length of a list whose elements take at least `least` bytes each.
    pub fn count(&mut self, least: usize) -> Option<usize> {
        let count = self.number()? as usize;
        (count <= self.left() / least).then_some(count)
    }

    pub fn text(&mut self) -> Option<&'a str> {
        let length = self.number()? as usize;
        let bytes = self.take(length)?;
        std::str::from_utf8(bytes.strip_suffix(&[0]).unwrap_or(bytes)).ok()
    }

    /// An id of 16 bytes in a field of this length.
    pub fn id(&mut self, length: usize) -> Option<[u8; 16]> {
        self.take(length)?.first_chunk().copied()
    }
}

#[derive(Default)]
pub struct Writer(pub Vec<u8>);

impl Writer {
    fn aligned(&mut self, bytes: &[u8]) {
        self.0.resize(self.0.len().next_multiple_of(bytes.len()), 0);
        self.0.extend_from_slice(bytes);
    }

    pub fn long(&mut self, number: u64) {
        self.aligned(&number.to_le_bytes());
    }

    /// A text too long for a 32-bit length is written as empty.
    pub fn text(&mut self, text: &str) {
        let (text, length) = u32::try_from(text.len() + 1).map_or(("", 1), |length| (text, length));
        self.aligned(&length.to_le_bytes());
        self.0.extend(text.bytes().chain([0]));
    }

    pub fn truth(&mut self, truth: bool) {
        self.0.push(u8::from(truth));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: one type of one field, one other type, and these sources.
    fn reply(header: Option<Header>, sources: &[(&str, &str, &str)]) -> Vec<u8> {
        let mut body = Writer::default();
        if let Some((client, number)) = header {
            body.long(client);
            body.long(number);
        }
        body.truth(true);
        body.text("");
        let put_number = |body: &mut Writer, number: u32| {
            body.0.resize(body.0.len().next_multiple_of(4), 0);
            body.0.extend(number.to_le_bytes());
        };
        let put_type = |body: &mut Writer, name: &str| {
            body.text(name);
            put_number(body, 1);
            body.text("force");
            body.0.push(11);
            body.long(0);
            body.long(0);
            body.text("");
            body.text("");
        };
        put_type(&mut body, "rig_msgs/msg/Grip");
        put_number(&mut body, 1);
        put_type(&mut body, "rig_msgs/msg/Jaw");
        put_number(&mut body, u32::try_from(sources.len()).expect("few"));
        for (name, encoding, text) in sources {
            body.text(name);
            body.text(encoding);
            body.text(text);
        }
        put_number(&mut body, 0);
        [vec![0, 1, 0, 0], body.0].concat()
    }

    const GRIP: (&str, &str, &str) = ("rig_msgs/msg/Grip", "msg", "Jaw left # the left one\n\n");
    const JAW: (&str, &str, &str) = ("rig_msgs/msg/Jaw", "msg", "float64 force\n");

    #[test]
    fn the_text_of_a_type_is_put_together_in_mcap_s_form() {
        let expected = format!("Jaw left # the left one\n{}\nMSG: rig_msgs/Jaw\nfloat64 force\n", "=".repeat(80));
        for header in [None, Some((7, 9))] {
            let found = answer(&reply(header, &[JAW, GRIP]), header, GRIP.0);
            assert_eq!(found, Some(Ok((expected.clone(), written()))), "{header:?}");
        }
        assert_eq!(answer(&reply(Some((7, 9)), &[GRIP]), Some((7, 8)), GRIP.0), None, "another's");
    }

    fn written() -> String {
        format!("{WRITTEN}float64 force\n{}\nMSG: rig_msgs/Jaw\nfloat64 force\n", "=".repeat(80))
    }

    #[test]
    fn the_structure_is_told_where_the_texts_help_nobody() {
        let long = "x".repeat(LONGEST_TEXT);
        let cut = (JAW.0, "msg", "float64 force # 10\u{b0}");
        for sources in [&[JAW][..], &[], &[GRIP, (JAW.0, "idl", "module x {};")], &[(GRIP.0, "msg", &long)]] {
            let found = answer(&reply(None, sources), None, GRIP.0);
            assert_eq!(found, Some(Ok((String::new(), written()))), "{sources:?}");
        }
        // A text that ends within a character.
        let mut spoilt = reply(None, &[GRIP, cut]);
        let place = spoilt.windows(2).position(|pair| pair == "\u{b0}".as_bytes()).expect("there");
        spoilt[place + 1] = b' ';
        assert_eq!(answer(&spoilt, None, GRIP.0), Some(Ok((String::new(), written()))));
    }

    #[test]
    fn every_kind_of_field_is_written_as_in_msg_or_not_at_all() {
        let cases = [
            ((2, 0, 0, ""), Some("int8")),
            ((58, 36, 0, ""), Some("float32[36]")),
            ((11 + 96, 3, 0, ""), Some("float64[<=3]")),
            ((17 + 144, 0, 0, ""), Some("string[]")),
            ((22 + 96, 4, 3, ""), Some("wstring<=3[<=4]")),
            ((21, 0, 10, ""), Some("string<=10")),
            ((1 + 144, 0, 0, "a/msg/B"), Some("a/B[]")),
            ((1, 0, 0, "a/srv/B_Request"), Some("a/srv/B_Request")),
            ((15, 0, 0, ""), Some("bool")),
            ((16, 0, 0, ""), Some("byte")),
            // A long double, a char of IDL, a text of fixed length, and none.
            ((12, 0, 0, ""), None),
            ((13, 0, 0, ""), None),
            ((19, 0, 0, ""), None),
            ((0, 0, 0, ""), None),
            ((48 * 4 + 2, 0, 0, ""), None),
        ];
        for ((number, capacity, bound, nested), expected) in cases {
            assert_eq!(kind(number, capacity, bound, nested).as_deref(), expected, "{number}");
        }
    }

    #[test]
    fn what_helps_nobody_is_refused_with_a_reason() {
        let whole = reply(None, &[GRIP, JAW]);
        let second = whole.windows(JAW.0.len()).position(|part| part == JAW.0.as_bytes()).expect("there") + 40;
        for end in 0..second {
            assert!(matches!(answer(&whole[..end], None, GRIP.0), Some(Err(_))), "{end}");
        }
        assert!(matches!(answer(&whole, None, "rig_msgs/msg/Other"), Some(Err(_))), "of another type");
        // No byte makes it take what is not there.
        for place in 4..whole.len() {
            for byte in [0, 1, 0x7f, 0xff] {
                let mut spoilt = whole.clone();
                spoilt[place] = byte;
                assert!(answer(&spoilt, None, GRIP.0).is_some(), "{place} {byte}");
            }
        }
        let mut refusal = Writer::default();
        refusal.truth(false);
        refusal.text("not mine");
        let refusal = [vec![0, 1, 0, 0], refusal.0].concat();
        assert_eq!(answer(&refusal, None, GRIP.0), Some(Err("it refuses: not mine".into())));
    }

    #[test]
    fn a_request_is_aligned_and_begins_with_its_numbers_where_they_are_wanted() {
        let plain = request(None, "a/msg/B", "RIHS01_0");
        let expected = [8, 0, 0, 0]
            .into_iter()
            .chain(*b"a/msg/B\0")
            .chain([9, 0, 0, 0])
            .chain(*b"RIHS01_0\0")
            .chain([1])
            .collect::<Vec<u8>>();
        assert_eq!(plain, expected);
        let related = request(Some((2, 3)), "a/msg/B", "RIHS01_0");
        assert_eq!(related[..16], [2, 0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(related[16..], expected);
    }
}
