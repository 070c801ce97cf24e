//! Asks nodes for the definition of a type that they publish: ROS 2's service `~/get_type_description`, which is two topics.
//!
//! A node's middleware decides how an answer names its request: `rmw_fastrtps` by the identity of a sample beside it,
//! `rmw_cyclonedds` by two numbers before the body. Others are not asked.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use rustdds::bytes::Bytes;
use rustdds::no_key::{DataWriter, SimpleDataReader};
use rustdds::{
    DomainParticipant, GUID, Publisher, QosPolicies, RTPSEntity, SampleIdentity, SequenceNumber, Subscriber, TopicKind,
    WriteOptionsBuilder,
};

use crate::description::{self, Answer, Header};
use crate::farewell::Departures;
use crate::graph::{Graph, Id};
use crate::names;
use crate::pipe::read::Told;
use crate::publish::Encoded;
use crate::quality::{self, Request as Quality};
use crate::raw::{Raw, RawAdapter, RawDecoder};

const REQUEST_TYPE: &str = "type_description_interfaces::srv::dds_::GetTypeDescription_Request_";
const ANSWER_TYPE: &str = "type_description_interfaces::srv::dds_::GetTypeDescription_Response_";
/// The kept samples of the service's topics, as ROS 2 has it.
const DEPTH: usize = 10;
/// A request is repeated: what is sent before both sides have found each other is lost.
const REPEAT: Duration = Duration::from_secs(1);
/// How long an answer is waited for, discovery included.
const PATIENCE: Duration = Duration::from_secs(10);
/// How many nodes are asked at once, and how many wait for that.
const AT_ONCE: usize = 4;
const MOST_WAITING: usize = 1024;
/// Little-endian CDR of the first version.
const CDR: u16 = 1;

/// How an answer names its request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// By the identity of a sample beside it.
    Beside,
    /// By two numbers before the body.
    Before,
}

/// A question of the site.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Question {
    /// The node, `/namespace/name`.
    pub node: String,
    /// The type, `package/msg/Type`.
    pub type_name: String,
    /// Its hash.
    pub type_hash: String,
}

/// A question under way.
struct Asked {
    question: Question,
    form: Form,
    begun: Instant,
    sent: Option<Instant>,
    /// Requests sent so far.
    number: u64,
    reader: SimpleDataReader<Raw, RawAdapter>,
    writer: DataWriter<Bytes, Encoded<CDR>>,
}

/// Where to ask.
pub type Parts<'a> = (&'a DomainParticipant, &'a Subscriber, &'a Publisher);

/// All questions.
#[derive(Default)]
pub struct Describing {
    waiting: VecDeque<Question>,
    asked: Vec<Asked>,
    /// Readers of answers that are leaving: a writer waits for one that is gone.
    leaving: Vec<SimpleDataReader<Raw, RawAdapter>>,
}

impl Describing {
    /// Takes a question; too many are forgotten, and the site asks again when a publisher appears.
    pub fn ask(&mut self, question: Question) {
        let is_known = self.waiting.contains(&question) || self.asked.iter().any(|asked| asked.question == question);
        if !is_known && self.waiting.len() < MOST_WAITING {
            self.waiting.push_back(question);
        }
    }

    /// Goes on with all of them; returns what is to be told to the site, with its payload.
    pub fn go_on(&mut self, parts: Parts<'_>, graph: &Graph, departures: &mut Departures) -> Vec<(Told, Vec<u8>)> {
        let mut told = Vec::new();
        for reader in std::mem::take(&mut self.leaving) {
            let id = reader.guid().to_bytes();
            if departures.is_telling(&id) {
                self.leaving.push(reader);
                continue;
            }
            drop(reader);
            // Once more: somebody may have heard of it only after that it leaves.
            departures.tell(id);
        }
        while self.asked.len() < AT_ONCE {
            let Some(question) = self.waiting.pop_front() else { break };
            match Asked::begin(parts, &question, graph) {
                Ok(asked) => self.asked.push(asked),
                Err(reason) => told.push(tell(question, Answer::Refused(reason))),
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
    let (reason, text, structure) = match answer {
        Answer::Texts(text, structure) => (None, text, structure),
        Answer::Refused(reason) => (Some(reason.chars().take(300).collect()), String::new(), String::new()),
    };
    let structured = u32::try_from(structure.len()).unwrap_or(0);
    (Told::Described { node, type_name, type_hash, structured, reason }, [structure, text].concat().into_bytes())
}

/// By the maker of a node's middleware.
fn form(server: Id) -> Option<Form> {
    match names::vendor(server).as_str() {
        "fastdds" => Some(Form::Beside),
        "cyclonedds" => Some(Form::Before),
        _ => None,
    }
}

impl Asked {
    fn begin(
        (participant, subscriber, publisher): Parts<'_>,
        question: &Question,
        graph: &Graph,
    ) -> Result<Self, String> {
        let Some((request, answer)) = names::description_topics(&question.node) else {
            return Err("its name is no name of a node".to_owned());
        };
        let Some(server) = graph.writer_of(&answer, ANSWER_TYPE) else {
            return Err("it does not offer get_type_description".to_owned());
        };
        let Some(form) = form(server) else {
            return Err(format!("services of {} are not spoken here", names::vendor(server)));
        };
        let failed = |error: &dyn std::fmt::Debug| format!("it cannot be asked ({error:?})");
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

    /// A number for this asker, where the form needs one: the end of its writer's id.
    fn client(&self) -> u64 {
        let id = self.writer.guid().to_bytes();
        id.last_chunk().map_or(0, |last| u64::from_le_bytes(*last))
    }

    fn header(&self, number: u64) -> Option<Header> {
        (self.form == Form::Before).then(|| (self.client(), number))
    }

    /// The answer, if it is there or will not come.
    fn go_on(&mut self) -> Option<Answer> {
        if let Some(answer) = self.take() {
            return Some(answer);
        }
        if self.begun.elapsed() >= PATIENCE {
            return Some(Answer::Refused(format!("it did not answer within {} s", PATIENCE.as_secs())));
        }
        if self.sent.is_none_or(|sent| sent.elapsed() >= REPEAT) {
            self.number += 1;
            let Question { type_name, type_hash, .. } = &self.question;
            let body = description::request(self.header(self.number), type_name, type_hash);
            let options = match self.form {
                Form::Before => WriteOptionsBuilder::new(),
                Form::Beside => {
                    // As rmw_fastrtps has it: where the answer is wanted; the number is the sample's own.
                    let wanted =
                        SampleIdentity { writer_guid: self.reader.guid(), sequence_number: SequenceNumber::UNKNOWN };
                    WriteOptionsBuilder::new().related_sample_identity(wanted)
                }
            };
            // What cannot be sent now is sent the next time.
            drop(self.writer.write_with_options(Bytes::from(body), options.build()));
            self.sent = Some(Instant::now());
        }
        None
    }

    fn take(&mut self) -> Option<Answer> {
        self.reader.drain_read_notifications();
        while let Ok(Some(change)) = self.reader.try_take_one_with(RawDecoder) {
            let related = change.related_sample_identity().map(|related| related.writer_guid);
            let message = change.into_value().0;
            let type_name = &self.question.type_name;
            let found = match self.form {
                Form::Beside if !related.is_some_and(|id| self.is_own(id)) => None,
                Form::Beside => description::answer(&message, None, type_name),
                // An answer to a former request is as good.
                Form::Before => {
                    (1..=self.number).find_map(|number| description::answer(&message, self.header(number), type_name))
                }
            };
            if found.is_some() {
                return found;
            }
        }
        None
    }

    fn is_own(&self, id: GUID) -> bool {
        id == self.reader.guid() || id == self.writer.guid()
    }
}
