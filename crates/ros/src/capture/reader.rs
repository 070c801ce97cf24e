//! One thread for each publisher: after a loss it tries again while the master lists the publisher.

use std::time::{Duration, Instant};
use std::{collections::BTreeSet, io, net::TcpStream, sync::Arc, sync::atomic::Ordering};

use super::topic::{Origin, Publisher, Sequence, Topic, header_seq, host_of};
use super::{CaptureNotice, Message, Shared};
use crate::graph::{Graph, Unreached};
use crate::message::Definition;
use crate::model::{Timestamp, TypeName, clean};
use crate::tcpros::{ConnectionHeader, FrameReader, LONGEST_HEADER, LONGEST_MESSAGE, Poll};
use crate::tcpros::{Endpoint, UNRESOLVED, connect};
use crate::xmlrpc::{CallError, Value, call};

/// Limit of each of requesting, connecting and shaking hands.
const PATIENCE: Duration = Duration::from_secs(2);

/// Interval between checks whether the topic has ended.
const TICK: Duration = Duration::from_millis(250);

/// Silence after which the publisher's host is checked for life.
const SILENCE: Duration = Duration::from_secs(30);

/// First and longest wait between attempts.
const RETRY: (Duration, Duration) = (Duration::from_millis(50), Duration::from_secs(2));

/// A connection that lasted this long was good.
const STEADY: Duration = Duration::from_secs(5);

const FLOOR: Duration = Duration::from_millis(20);

/// Wait after a failure that more attempts are unlikely to fix.
const RETRY_REFUSED: Duration = Duration::from_secs(10);

/// For example a publisher of UDPROS alone.
const NO_TCPROS: &str = "it offers no TCPROS";

/// Stands for a node whose name the master does not tell.
const UNNAMED: &str = "a publisher";

pub(super) fn spawn(shared: &Arc<Shared>, topic: &Arc<Topic>, publisher: Arc<Publisher>) -> io::Result<()> {
    let mut reader = Reader {
        shared: Arc::clone(shared),
        topic: Arc::clone(topic),
        publisher,
        sequence: Sequence::default(),
        failures: 0,
        told: false,
        node: None,
        contradicted: BTreeSet::new(),
    };
    shared.threads.spawn("ros-reader", move || reader.run())
}

struct Description {
    type_name: Arc<str>,
    md5sum: Arc<str>,
    definition: Arc<str>,
    caller_id: Arc<str>,
    latching: bool,
    contradiction: Option<String>,
    has_header: bool,
}

struct Link {
    frames: FrameReader<TcpStream>,
    from: Description,
    origin: Arc<Origin>,
}

enum Failure {
    Passing(String),
    Mismatch { caller_id: String, found: String },
    Refused(String),
}

struct Reader {
    shared: Arc<Shared>,
    topic: Arc<Topic>,
    publisher: Arc<Publisher>,
    sequence: Sequence,
    failures: u32,
    told: bool,
    /// Asked of the master once its publisher cannot be read.
    node: Option<String>,
    contradicted: BTreeSet<String>,
}

impl Reader {
    fn run(&mut self) {
        let mut patience = RETRY.0;
        loop {
            let begun = Instant::now();
            let wait = match self.attempt() {
                Ok(()) => {
                    patience = rest(patience, begun.elapsed());
                    self.failures = 0;
                    self.told = false;
                    patience
                }
                Err(failure) => {
                    self.note(&failure);
                    patience = (patience * 2).min(RETRY.1);
                    let wait = if matches!(failure, Failure::Passing(_)) { patience } else { RETRY_REFUSED };
                    self.complain(failure);
                    wait
                }
            };
            // Anyone can hint at a change: a flood of hints must not become a flood of attempts.
            std::thread::sleep(FLOOR);
            if !self.topic.wait_to_retry(&self.publisher, wait) {
                return;
            }
        }
    }

    /// `Ok` if the connection was open.
    fn attempt(&mut self) -> Result<(), Failure> {
        let mut link = self.open()?;
        self.topic.note_trouble(&self.publisher, None);
        self.topic.set_type(&link.from.type_name);
        let caller_id = clean(&link.from.caller_id, 120);
        self.shared.notice(CaptureNotice::PublisherConnected {
            topic: Arc::clone(&self.topic.label),
            origin: Arc::clone(&link.origin),
        });
        if let Some(contradiction) =
            link.from.contradiction.take().filter(|text| self.contradicted.insert(text.clone()))
        {
            self.shared.notice(CaptureNotice::Contradiction {
                topic: Arc::clone(&self.topic.label),
                caller_id: caller_id.clone(),
                contradiction,
            });
        }
        let ended = self.read(&mut link);
        let is_left = self.topic.has_ended();
        let taken = !is_left && self.is_taken(&link.from.caller_id);
        self.topic.disconnected(&self.publisher, &link.from.caller_id, taken);
        // All end with the capture, which nobody is told one by one.
        if is_left && self.shared.topic(self.topic.name.as_str()).is_some_and(|listed| listed.has_ended()) {
            return Ok(());
        }
        if !is_left {
            // A publisher already listed had registered while this one was still there.
            self.shared.ask_about(&self.topic.name);
        }
        let (reason, result) = match ended {
            _ if is_left => (String::from("the topic is no longer captured"), Ok(())),
            Ok(reason) => (reason, Ok(())),
            Err(Failure::Refused(reason)) => (reason.clone(), Err(Failure::Refused(reason))),
            Err(failure) => (String::from("it failed"), Err(failure)),
        };
        let topic = Arc::clone(&self.topic.label);
        let number = self.publisher.number;
        self.shared.notice(CaptureNotice::PublisherLost { topic, caller_id, number, reason });
        result
    }

    fn open(&self) -> Result<Link, Failure> {
        let (host, port) = self.ask()?;
        let passing = |error: io::Error| Failure::Passing(error.to_string());
        let stream = connect(&host, port, Instant::now() + PATIENCE).map_err(passing)?;
        stream.set_read_timeout(Some(TICK)).map_err(passing)?;
        stream.set_write_timeout(Some(PATIENCE)).map_err(passing)?;
        // Any type, so that the answer says which one it is.
        let request = ConnectionHeader::new([
            ("callerid", self.shared.node_name.as_str()),
            ("topic", self.topic.name.as_str()),
            ("type", "*"),
            ("md5sum", "*"),
            ("message_definition", "*"),
            ("tcp_nodelay", "1"),
        ]);
        io::Write::write_all(&mut (&stream), &request.to_bytes()).map_err(passing)?;
        let peer = stream.peer_addr().ok();
        let mut frames = FrameReader::new(stream);
        let header = self.answer(&mut frames)?;
        let from = describe(&header, self.topic.wanted.as_ref())?;
        let publisher = &*self.publisher;
        let origin = Origin {
            number: publisher.number,
            caller_id: Arc::clone(&from.caller_id),
            host: host_of(&publisher.endpoint, peer, Instant::now() + PATIENCE),
            uri: publisher.endpoint.to_string(),
            type_name: Arc::clone(&from.type_name),
            md5sum: Arc::clone(&from.md5sum),
            listed_at: publisher.listed_at,
            rival: self.topic.connected(publisher, &from.caller_id),
            unnamed: false,
        };
        Ok(Link { frames, from, origin: Arc::new(origin) })
    }

    fn ask(&self) -> Result<(String, u16), Failure> {
        let protocols = Value::Array(vec![Value::Array(vec!["TCPROS".into()])]);
        let params = [self.shared.node_name.as_str().into(), self.topic.name.as_str().into(), protocols];
        let answer =
            call(&self.publisher.endpoint, "requestTopic", &params, Instant::now() + PATIENCE).map_err(not_offered)?;
        match answer.as_array() {
            Some([protocol, Value::Text(host), Value::Int(port), ..]) if protocol.as_text() == Some("TCPROS") => {
                let port = u16::try_from(*port).map_err(|_| Failure::Refused("its port is not a port".into()))?;
                Ok((host.clone(), port))
            }
            _ => Err(Failure::Refused(NO_TCPROS.into())),
        }
    }

    fn answer(&self, frames: &mut FrameReader<TcpStream>) -> Result<ConnectionHeader, Failure> {
        let deadline = Instant::now() + PATIENCE;
        while Instant::now() < deadline && !self.topic.has_ended() {
            match frames.poll(LONGEST_HEADER) {
                Ok(Poll::Frame(bytes)) => {
                    return ConnectionHeader::parse(&bytes)
                        .map_err(|reason| Failure::Refused(format!("its connection header is malformed: {reason}")));
                }
                Ok(Poll::Pending) => {}
                Ok(Poll::Closed(_)) => return Err(Failure::Passing("it closed the connection immediately".into())),
                Ok(Poll::TooLong(length)) => {
                    return Err(Failure::Refused(format!("its connection header claims {length} bytes")));
                }
                Err(error) => return Err(Failure::Passing(error.to_string())),
            }
        }
        Err(Failure::Passing("it sent no connection header in time".into()))
    }

    fn read(&mut self, link: &mut Link) -> Result<String, Failure> {
        let mut heard = Instant::now();
        loop {
            match link.frames.poll(LONGEST_MESSAGE) {
                Ok(Poll::Frame(_)) if self.topic.has_ended() => return Ok(String::new()),
                Ok(Poll::Frame(body)) => {
                    self.take(body, &link.from, &link.origin);
                    heard = Instant::now();
                }
                Ok(Poll::Pending) if heard.elapsed() > SILENCE => {
                    if !self.host_lives() {
                        return Ok(String::from("its host no longer answers"));
                    }
                    heard = Instant::now();
                }
                Ok(Poll::Pending) => {}
                Ok(Poll::Closed(true)) => return Ok(String::from("it closed the connection")),
                Ok(Poll::Closed(false)) => return Ok(String::from("it closed the connection inside a message")),
                Ok(Poll::TooLong(length)) => {
                    return Err(Failure::Refused(format!(
                        "a message of {length} bytes exceeds the limit of {LONGEST_MESSAGE}"
                    )));
                }
                Err(error) => return Ok(error.to_string()),
            }
            if self.topic.has_ended() {
                return Ok(String::new());
            }
        }
    }

    fn take(&mut self, body: Vec<u8>, from: &Description, origin: &Arc<Origin>) {
        let captured_at = Timestamp::now();
        let header_seq = from.has_header.then(|| header_seq(&body)).flatten();
        let missing = header_seq.map_or(0, |next| self.sequence.follow(next));
        if let (1.., Some(next)) = (missing, header_seq) {
            let first = next.wrapping_sub(u32::try_from(missing).unwrap_or(u32::MAX));
            self.topic.lost.fetch_add(missing, Ordering::Relaxed);
            self.shared.notice(CaptureNotice::LostInTransport {
                topic: Arc::clone(&self.topic.label),
                caller_id: clean(&from.caller_id, 120),
                count: missing,
                numbers: (first, next.wrapping_sub(1)),
            });
        }
        let bytes = body.len();
        self.shared.sink.accept(Message {
            topic: Arc::clone(&self.topic.label),
            type_name: Arc::clone(&from.type_name),
            md5sum: Arc::clone(&from.md5sum),
            definition: Arc::clone(&from.definition),
            caller_id: Arc::clone(&from.caller_id),
            origin: Arc::clone(origin),
            latching: from.latching,
            captured_at,
            header_seq,
            tags: Vec::new(),
            body,
        });
        self.topic.count_message(bytes, captured_at);
    }

    /// Whether the master has another process under this caller id. A process that takes over a name registers before
    /// the master shuts down the older one; a restarted one registers after the older one's end.
    fn is_taken(&self, caller_id: &str) -> bool {
        let params = [self.shared.node_name.as_str().into(), caller_id.into()];
        let found = call(&self.shared.master, "lookupNode", &params, Instant::now() + PATIENCE).ok();
        let found = found.as_ref().and_then(Value::as_text).and_then(Endpoint::parse);
        found.is_some_and(|found| found != self.publisher.endpoint)
    }

    /// A peer without power is as silent as one without news; a hung one is still alive.
    fn host_lives(&self) -> bool {
        let params = [self.shared.node_name.as_str().into()];
        let answer = call(&self.publisher.endpoint, "getPid", &params, Instant::now() + PATIENCE);
        !matches!(answer, Err(CallError::Connect(_)))
    }

    fn note(&mut self, failure: &Failure) {
        if self.node.is_none() && (self.failures == 0 || self.failures.is_power_of_two()) {
            let graph = Graph::of(self.shared.master.clone(), &self.shared.node_name);
            self.node = graph.node_at(self.topic.name.as_str(), &self.publisher.endpoint);
        }
        let reason = match failure {
            Failure::Passing(reason) => advised(reason),
            Failure::Refused(reason) => reason.clone(),
            Failure::Mismatch { found, .. } => format!("it sends {found}, which was not asked for"),
        };
        let node = self.node.clone().unwrap_or_else(|| UNNAMED.to_owned());
        let (node, reason) = (clean(&node, 120), clean(&reason, 200));
        let place = clean(&self.publisher.endpoint.authority(), 120);
        self.topic.note_trouble(&self.publisher, Some(Unreached { node, place, reason }));
    }

    fn complain(&mut self, failure: Failure) {
        self.failures = self.failures.saturating_add(1);
        // A publisher shutting down may be queried in vain once or twice before the master stops listing it.
        let lasting = self.failures > 3 || !matches!(failure, Failure::Passing(_));
        if self.told || !lasting || self.topic.has_ended() {
            return;
        }
        self.told = true;
        let topic = Arc::clone(&self.topic.label);
        let publisher = self.publisher.endpoint.to_string();
        self.shared.notice(match failure {
            Failure::Passing(reason) => {
                CaptureNotice::PublisherUnreachable { topic, publisher, reason: clean(&advised(&reason), 200) }
            }
            Failure::Refused(reason) => CaptureNotice::Refused { topic, publisher, reason: clean(&reason, 200) },
            Failure::Mismatch { caller_id, found } => {
                let wanted = self.topic.wanted.as_ref().map(TypeName::to_string).unwrap_or_default();
                CaptureNotice::TypeMismatch {
                    topic,
                    caller_id: clean(&caller_id, 120),
                    wanted,
                    found: clean(&found, 120),
                }
            }
        });
    }
}

/// Adds a remedy, if one is known.
fn advised(reason: &str) -> String {
    let advice = if reason.contains(UNRESOLVED) {
        "set ROS_IP there"
    } else if reason.contains("refused") {
        "nothing listens there; start its node again"
    } else if reason.contains("in time") || reason.contains("timed out") {
        "check the network to it and its firewall"
    } else {
        return reason.to_owned();
    };
    format!("{reason}; {advice}")
}

/// A publisher without TCPROS says so in its own words.
fn not_offered(error: CallError) -> Failure {
    match error {
        CallError::Refused(words) if words.to_lowercase().contains("protocol") => {
            Failure::Refused(format!("{NO_TCPROS} ({words})"))
        }
        error => Failure::Passing(error.to_string()),
    }
}

fn rest(before: Duration, lasted: Duration) -> Duration {
    if lasted < STEADY { (before * 2).min(RETRY.1) } else { RETRY.0 }
}

fn describe(header: &ConnectionHeader, wanted: Option<&TypeName>) -> Result<Description, Failure> {
    let caller_id = header.get("callerid").unwrap_or("unnamed");
    let found = header.get("type").unwrap_or_default();
    if let Some(reason) = header.get("error") {
        return Err(Failure::Refused(format!("it refuses: {reason}")));
    }
    if found.parse::<TypeName>().is_err() {
        return Err(Failure::Refused(format!("'{}' is not a message type", clean(found, 80))));
    }
    if wanted.is_some_and(|wanted| wanted.as_str() != found) {
        return Err(Failure::Mismatch { caller_id: caller_id.to_owned(), found: found.to_owned() });
    }
    let md5sum = header.get("md5sum").unwrap_or_default();
    if md5sum.len() != 32 || !md5sum.bytes().all(|b| b.is_ascii_hexdigit()) {
        return Err(Failure::Refused(format!("'{}' is not an md5sum", clean(md5sum, 80))));
    }
    let definition = header.get("message_definition").unwrap_or_default();
    let parsed = Definition::parse(found, definition).ok();
    Ok(Description {
        type_name: found.into(),
        md5sum: md5sum.into(),
        definition: definition.into(),
        caller_id: caller_id.chars().take(255).collect::<String>().into(),
        contradiction: contradiction(found, md5sum, definition, parsed.as_ref()),
        latching: header.get("latching") == Some("1"),
        has_header: parsed.is_some_and(|definition| definition.begins_with_header()),
    })
}

/// Inconsistencies between type, md5sum and definition. Such messages are captured as sent.
fn contradiction(type_name: &str, md5sum: &str, text: &str, definition: Option<&Definition>) -> Option<String> {
    if text.is_empty() && type_name != "std_msgs/Empty" {
        return Some(format!(
            "it sends no definition of {}: its messages are captured but not decoded",
            clean(type_name, 80)
        ));
    }
    let computed = definition?.md5sum();
    (!computed.eq_ignore_ascii_case(md5sum)).then(|| {
        let (name, told) = (clean(type_name, 80), clean(md5sum, 40));
        format!(
            "its definition of {name} has md5sum {computed}, but it announces {told}: messages may be decoded \
                 incorrectly"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_publisher_that_lets_go_again_and_again_is_asked_less_often() {
        let waits = (0..8).scan(RETRY.0, |wait, _| {
            *wait = rest(*wait, Duration::from_millis(30));
            Some(*wait)
        });
        // 45 s of it used to be 549 attempts.
        assert!(waits.sum::<Duration>() > Duration::from_secs(5));
        assert_eq!(rest(RETRY.1, Duration::from_secs(60)), RETRY.0);
    }

    #[test]
    fn reasons_say_what_to_do() {
        assert_eq!(advised(UNRESOLVED), "its name does not resolve; set ROS_IP there");
        assert!(advised("Connection refused (os error 111)").ends_with("start its node again"));
        assert!(advised("no answer in time").ends_with("its firewall"));
        assert_eq!(advised("something else"), "something else");
        let udp = not_offered(CallError::Refused("no supported protocol implementations".into()));
        assert!(matches!(udp, Failure::Refused(words) if words.starts_with("it offers no TCPROS (no supported")));
        assert!(matches!(not_offered(CallError::Refused("not published here".into())), Failure::Passing(_)));
    }

    #[test]
    fn words_that_do_not_fit_together_are_noticed() {
        let of = |md5sum: &str, text: &str| {
            contradiction("std_msgs/String", md5sum, text, Definition::parse("std_msgs/String", text).ok().as_ref())
        };
        assert_eq!(of("992ce8a1687cec8c8bd883ec73ca41d1", "string data\n"), None);
        assert_eq!(of("992CE8A1687CEC8C8BD883EC73CA41D1", "# words\nstring data"), None);
        assert!(of("ffffffffffffffffffffffffffffffff", "string data").is_some_and(|text| text.contains("992ce8a1")));
        assert!(of("992ce8a1687cec8c8bd883ec73ca41d1", "int64 data").is_some());
        assert!(of("992ce8a1687cec8c8bd883ec73ca41d1", "").is_some_and(|text| text.contains("no definition")));
        assert_eq!(contradiction("std_msgs/Empty", "d41d8cd98f00b204e9800998ecf8427e", "", None), None);
    }
}
