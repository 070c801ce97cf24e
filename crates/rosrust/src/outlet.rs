//! One published topic, and the ear that counts what left rosrust's queue.

use std::io::{self, BufReader, Read, Write};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use std::{collections::VecDeque, net::TcpStream, sync::Arc};

use rosrust::{Publisher, RawMessage, RawMessageDescription, api::Ros};
use xml_rpc::Value;

use crate::{pipe::write::Described, queue, told};

/// Limits of the messages that rosrust holds of one topic; a single one may have more bytes.
const MOST_AHEAD: usize = 64;
const MOST_AHEAD_BYTES: usize = 4 << 20;
/// Limit of the ear's handshake.
const PATIENCE: Duration = Duration::from_secs(2);
const EAR: &str = "/ear";

pub struct Outlet {
    pub topic: String,
    publisher: Publisher<RawMessage>,
    served: Served,
    ear: Ear,
    handed: u64,
    /// Sizes of the messages that have not come back.
    ahead: VecDeque<usize>,
    ahead_bytes: usize,
    is_outrun: bool,
    has_failed: bool,
    last: Last,
}

impl Outlet {
    pub fn begin(ros: &Ros, topic: &Described, definition: String) -> Result<Self, String> {
        let description = RawMessageDescription {
            msg_definition: definition,
            md5sum: topic.md5sum.clone(),
            msg_type: topic.type_name.clone(),
        };
        // Without rosrust's own limit, which would drop the oldest.
        let publisher = ros.publish_with_description::<RawMessage>(&topic.name, 0, description);
        let mut publisher = publisher.map_err(|error| told(&error))?;
        publisher.set_latching(topic.latched);
        let served = find(ros.uri(), &topic.name).map_err(|error| error.to_string())?;
        let ear = Ear::open(&served, EAR).map_err(|error| error.to_string())?;
        let begun = Instant::now();
        while !is_known(&publisher, EAR) {
            if begun.elapsed() >= PATIENCE {
                return Err("rosrust refuses the subscriber that counts its messages".to_owned());
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        let (topic, ahead) = (topic.name.clone(), VecDeque::new());
        let (handed, ahead_bytes, is_outrun, has_failed, last) = (0, 0, false, false, Last::default());
        Ok(Self { topic, publisher, served, ear, handed, ahead, ahead_bytes, is_outrun, has_failed, last })
    }

    pub fn subscribers(&self) -> Vec<String> {
        let mut names = self.publisher.subscriber_names();
        names.retain(|name| name != EAR && name != LAST);
        names
    }

    pub fn is_deaf(&self) -> bool {
        self.has_failed || self.ear.is_deaf()
    }

    /// Whether every subscriber has the last message: rosrust has let in one that came after it. False in doubt.
    pub fn is_sent(&mut self) -> bool {
        self.last.comes_in(&self.served) && is_known(&self.publisher, LAST)
    }

    /// Messages that came back leave room.
    fn make_room(&mut self) {
        let waiting = usize::try_from(self.handed.saturating_sub(self.ear.heard())).unwrap_or(usize::MAX);
        while self.ahead.len() > waiting {
            self.ahead_bytes -= self.ahead.pop_front().unwrap_or(0);
        }
    }
}

fn is_known(publisher: &Publisher<RawMessage>, name: &str) -> bool {
    publisher.subscriber_names().iter().any(|known| known == name)
}

impl queue::Outlet for Outlet {
    fn attempt(&mut self, message: Vec<u8>) -> Result<u64, Vec<u8>> {
        self.make_room();
        let size = message.len();
        let is_full = self.ahead.len() >= MOST_AHEAD || self.ahead_bytes + size > MOST_AHEAD_BYTES;
        if is_full && !self.ahead.is_empty() {
            return Err(message);
        }
        let message = RawMessage(message);
        // A message that cannot be sent never comes back.
        self.has_failed |= self.publisher.send(message).is_err();
        self.handed += 1;
        self.ahead.push_back(size);
        self.ahead_bytes += size;
        Ok(self.handed)
    }

    fn left(&self) -> u64 {
        self.ear.heard()
    }

    fn has_caught_up(&self) -> bool {
        self.ear.heard() >= self.handed
    }

    fn is_outrun(&self) -> bool {
        self.is_outrun
    }

    fn outrun(&mut self, is_outrun: bool) {
        self.is_outrun = is_outrun;
    }
}

// A subscriber of our own for each topic: rosrust does not tell which messages left its queue, so they are counted
// here.

/// Limit of one handshake step: a silent subscriber keeps rosrust's port busy.
const STEP: Duration = Duration::from_secs(2);
const LONGEST_HEADER: u32 = 64 << 20;
/// Bytes; the thread only counts.
const STACK: usize = 64 << 10;

/// Name of the subscriber that comes after the last message.
pub const LAST: &str = "/last_ear";

#[derive(Debug, Clone)]
pub struct Served {
    host: String,
    port: u16,
    topic: String,
}

pub struct Ear {
    heard: Arc<AtomicU64>,
    is_deaf: Arc<AtomicBool>,
}

impl Ear {
    pub fn open(served: &Served, name: &str) -> io::Result<Self> {
        let stream = shake_hands(served, name)?;
        stream.set_read_timeout(None)?;
        let (heard, is_deaf) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicBool::new(false)));
        let ear = Self { heard: Arc::clone(&heard), is_deaf: Arc::clone(&is_deaf) };
        let listen = move || {
            let mut stream = BufReader::with_capacity(256 << 10, stream);
            while skip_frame(&mut stream, u32::MAX).is_ok() {
                heard.fetch_add(1, Ordering::AcqRel);
            }
            is_deaf.store(true, Ordering::Release);
        };
        std::thread::Builder::new().name("ear".into()).stack_size(STACK).spawn(listen)?;
        Ok(ear)
    }

    pub fn heard(&self) -> u64 {
        self.heard.load(Ordering::Acquire)
    }

    /// Whether no more messages come.
    pub fn is_deaf(&self) -> bool {
        self.is_deaf.load(Ordering::Acquire)
    }
}

/// The subscriber that comes after the last message. It reads the latched message that rosrust sends before listing it:
/// rosrust would wait for that.
#[derive(Default)]
pub struct Last(Option<Ear>);

impl Last {
    pub fn comes_in(&mut self, served: &Served) -> bool {
        if self.0.is_none() {
            self.0 = Ear::open(served, LAST).ok();
        }
        self.0.is_some()
    }
}

/// Asks a node where it serves a topic.
pub fn find(node_uri: &str, topic: &str) -> io::Result<Served> {
    let wrong = |what: &str| io::Error::other(format!("rosrust does not report where it serves the topic: {what}"));
    let uri: xml_rpc::Url = node_uri.parse().map_err(|_| wrong("its own address is not a URL"))?;
    let protocols = Value::Array(vec![Value::Array(vec![Value::String("TCPROS".into())])]);
    let about = vec![Value::String("/ear".into()), Value::String(topic.into()), protocols];
    let answer = xml_rpc::call_value(&uri, "requestTopic", about);
    let answer = answer.map_err(|error| wrong(&error.to_string()))?.map_err(|fault| wrong(&fault.message))?;
    let served = answer.into_iter().next().and_then(|answer| place(answer, topic));
    served.ok_or_else(|| wrong("no TCPROS"))
}

fn place(answer: Value, topic: &str) -> Option<Served> {
    let Value::Array(answer) = answer else { return None };
    let Some(Value::Array(place)) = answer.into_iter().nth(2) else { return None };
    let [Value::String(_), Value::String(host), Value::Int(port)] = place.as_slice() else { return None };
    Some(Served { host: host.clone(), port: u16::try_from(*port).ok()?, topic: topic.to_owned() })
}

fn shake_hands(served: &Served, name: &str) -> io::Result<TcpStream> {
    let mut stream = TcpStream::connect((served.host.as_str(), served.port))?;
    stream.set_read_timeout(Some(STEP))?;
    stream.set_write_timeout(Some(STEP))?;
    stream.write_all(&header(&[
        ("callerid", name),
        ("topic", &served.topic),
        ("type", "*"),
        ("md5sum", "*"),
        ("tcp_nodelay", "1"),
    ]))?;
    skip_frame(&mut stream, LONGEST_HEADER)?;
    Ok(stream)
}

fn header(fields: &[(&str, &str)]) -> Vec<u8> {
    let mut body = Vec::new();
    for (name, value) in fields {
        let field = format!("{name}={value}");
        body.extend_from_slice(&u32::try_from(field.len()).unwrap_or(0).to_le_bytes());
        body.extend_from_slice(field.as_bytes());
    }
    [u32::try_from(body.len()).unwrap_or(0).to_le_bytes().as_slice(), &body].concat()
}

/// Skips one frame: a length and its bytes.
fn skip_frame(from: &mut impl Read, longest: u32) -> io::Result<()> {
    let mut length = [0; 4];
    from.read_exact(&mut length)?;
    let length = u32::from_le_bytes(length);
    if length > longest {
        return Err(io::Error::other("it is longer than any header"));
    }
    let skipped = io::copy(&mut from.take(u64::from(length)), &mut io::sink())?;
    if skipped == u64::from(length) { Ok(()) } else { Err(io::ErrorKind::UnexpectedEof.into()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_is_lengths_and_fields() {
        // As in the ROS wiki's description of TCPROS, written by hand.
        assert_eq!(header(&[("a", "bc"), ("d", "")]), b"\x0e\0\0\0\x04\0\0\0a=bc\x02\0\0\0d=");
    }

    #[test]
    fn frames_are_read_over_one_by_one_and_a_cut_one_is_an_end() {
        let mut bytes: &[u8] = b"\x02\0\0\0ab\0\0\0\0\x05\0\0\0abc";
        assert!(skip_frame(&mut bytes, 9).is_ok() && skip_frame(&mut bytes, 9).is_ok());
        assert!(skip_frame(&mut bytes, 9).is_err());
        let mut long: &[u8] = b"\x0a\0\0\0abcdefghij";
        assert!(skip_frame(&mut long, 9).is_err());
    }

    #[test]
    fn the_place_of_a_topic_is_the_third_part_of_the_answer() {
        let text = |text: &str| Value::String(text.into());
        let place_of = |port| {
            let place = Value::Array(vec![text("TCPROS"), text("127.0.0.1"), Value::Int(port)]);
            super::place(Value::Array(vec![Value::Int(1), text("ready"), place]), "/a")
        };
        let served = place_of(4321).expect("a place");
        assert_eq!((served.host.as_str(), served.port, served.topic.as_str()), ("127.0.0.1", 4321, "/a"));
        assert!(place_of(70_000).is_none());
        assert!(place(Value::Array(vec![Value::Int(0), text("no such topic"), Value::Int(0)]), "/a").is_none());
    }

    #[test]
    fn the_last_subscriber_has_come_in_only_if_it_was_let_in_and_reads_what_it_is_sent() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
        let port = listener.local_addr().expect("its address").port();
        let served = |port| Served { host: "127.0.0.1".into(), port, topic: "/map".into() };
        // Far more than any socket's buffers hold.
        let latched = 64_u32 << 20;
        let publisher = std::thread::spawn(move || {
            let (mut stream, _) = listener.accept()?;
            skip_frame(&mut stream, LONGEST_HEADER)?;
            stream.set_write_timeout(Some(Duration::from_secs(60)))?;
            stream.write_all(&header(&[("callerid", "/a")]))?;
            stream.write_all(&latched.to_le_bytes())?;
            let piece = vec![7; 1 << 20];
            (0..64).try_for_each(|_| stream.write_all(&piece))
        });
        let mut last = Last::default();
        assert!(last.comes_in(&served(port)));
        publisher.join().expect("no panic").expect("all of it is read");
        // Nobody listens there any more.
        assert!(!Last::default().comes_in(&served(port)));
    }
}
