//! Capture against publishers that misbehave: hung, too long, with gaps, restarted.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::*;
use crate::ros::tcpros::{BusLink, ConnectionHeader, Node, SlaveServer};
use crate::ros::xmlrpc::call;
use crate::ros::{EmbeddedMaster, MessageSink};

const TOPIC: &str = "/t";
const HEADER: &str = "Header header\n================================================================================\n\
    MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n";

/// A node whose slave API works; what its TCPROS port does is up to the test.
struct Publisher {
    port: u16,
}

impl Node for Publisher {
    fn master_uri(&self) -> String {
        String::new()
    }
    fn subscriptions(&self) -> Vec<(String, String)> {
        Vec::new()
    }
    fn publications(&self) -> Vec<(String, String)> {
        Vec::new()
    }
    fn links(&self) -> Vec<BusLink> {
        Vec::new()
    }
    fn publishers_changed(&self, _topic: &str, _publishers: &[&str]) {}
    fn outlet(&self, _topic: &str) -> Option<(String, u16)> {
        Some(("127.0.0.1".into(), self.port))
    }
    fn shutdown_asked(&self, _by: &str, _reason: &str) {}
}

/// Registers a publisher of [`TOPIC`] and returns its port to accept at.
fn publisher(master: &EmbeddedMaster, name: &str) -> (SlaveServer, TcpListener) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("bind");
    let port = listener.local_addr().expect("address").port();
    let slave = SlaveServer::start("127.0.0.1", Arc::new(Publisher { port })).expect("slave");
    let params = [name, TOPIC, "a/Stamped", &slave.uri].map(Into::into);
    let master = Endpoint::parse(master.uri()).expect("uri");
    call(&master, "registerPublisher", &params, Instant::now() + Duration::from_secs(5)).expect("registered");
    (slave, listener)
}

/// Accepts the capture and shakes hands.
fn welcome(listener: &TcpListener, name: &str) -> TcpStream {
    let (mut stream, _) = listener.accept().expect("accept");
    let mut length = [0; 4];
    stream.read_exact(&mut length).expect("length");
    let mut request = vec![0; usize::try_from(u32::from_le_bytes(length)).expect("small")];
    stream.read_exact(&mut request).expect("request");
    let request = ConnectionHeader::parse(&request).expect("header");
    assert_eq!(
        (request.get("topic"), request.get("md5sum"), request.get("tcp_nodelay")),
        (Some(TOPIC), Some("*"), Some("1"))
    );
    let md5sum = crate::ros::md5sum("a/Stamped", HEADER).expect("definition");
    let fields = [("callerid", name), ("type", "a/Stamped"), ("md5sum", &*md5sum), ("message_definition", HEADER)];
    stream.write_all(&ConnectionHeader::new(fields).to_bytes()).expect("header");
    stream
}

fn send(stream: &mut TcpStream, seq: u32) {
    let body = [seq.to_le_bytes().as_slice(), &[0; 12]].concat();
    stream.write_all(&[16u32.to_le_bytes().as_slice(), &body].concat()).expect("message");
}

#[derive(Default)]
struct Kept {
    seqs: Mutex<Vec<(String, u32)>>,
    notices: Mutex<Vec<CaptureNotice>>,
}

impl Kept {
    fn seqs(&self, of: &str) -> Vec<u32> {
        self.seqs.lock().expect("lock").iter().filter(|(name, _)| name == of).map(|(_, seq)| *seq).collect()
    }

    fn noticed(&self, wanted: impl Fn(&CaptureNotice) -> bool) -> usize {
        self.notices.lock().expect("lock").iter().filter(|notice| wanted(notice)).count()
    }
}

impl MessageSink for Kept {
    fn accept(&self, message: Message) {
        let seq = message.header_seq.expect("a header");
        self.seqs.lock().expect("lock").push((message.caller_id.to_string(), seq));
    }

    fn notice(&self, notice: CaptureNotice) {
        self.notices.lock().expect("lock").push(notice);
    }
}

fn until(what: &str, condition: impl Fn() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(20);
    while !condition() {
        assert!(Instant::now() < deadline, "{what} did not come about");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn start(master: &EmbeddedMaster) -> (Capture, Arc<Kept>) {
    let kept = Arc::new(Kept::default());
    let options = CaptureOptions { master_uri: master.uri().into(), own_host: None, node_name: "/capture_test".into() };
    let capture = Capture::start(options, Arc::clone(&kept) as _).expect("capture");
    capture.watch(TOPIC.parse().expect("topic"), None);
    (capture, kept)
}

#[test]
fn a_hung_publisher_starves_nobody() {
    let master = EmbeddedMaster::start().expect("master");
    let (_hung_slave, hung) = publisher(&master, "/hung");
    let (_slave, listener) = publisher(&master, "/sound");
    let (capture, kept) = start(&master);
    // The hung one accepts the connection and never sends a word.
    let _silent = hung.accept().expect("accept");
    let mut stream = welcome(&listener, "/sound");
    for seq in 0..100 {
        send(&mut stream, seq);
    }
    until("all messages", || kept.seqs("/sound") == (0..100).collect::<Vec<_>>());
    let begun = Instant::now();
    drop(capture);
    assert!(begun.elapsed() < Duration::from_secs(5));
}

#[test]
fn gaps_are_counted_across_a_reconnection_and_restarts_are_not() {
    let master = EmbeddedMaster::start().expect("master");
    let (_slave, listener) = publisher(&master, "/p");
    let (capture, kept) = start(&master);
    let mut stream = welcome(&listener, "/p");
    for seq in [5, 6, 9, 9, 10] {
        send(&mut stream, seq);
    }
    drop(stream);
    let mut stream = welcome(&listener, "/p");
    for seq in [12, 0, 1] {
        send(&mut stream, seq);
    }
    until("all messages", || capture.status()[0].messages == 8);
    assert_eq!(kept.seqs("/p"), [5, 6, 9, 9, 10, 12, 0, 1]);
    assert_eq!(capture.status()[0].lost_in_transport, 3);
    assert_eq!(kept.noticed(|notice| matches!(notice, CaptureNotice::LostInTransport { .. })), 2);
    assert_eq!(kept.noticed(|notice| matches!(notice, CaptureNotice::PublisherLost { .. })), 1);
}

#[test]
fn publishers_of_a_topic_that_is_no_longer_captured_are_told_as_lost() {
    let master = EmbeddedMaster::start().expect("master");
    let (_slave, listener) = publisher(&master, "/p");
    let (capture, kept) = start(&master);
    let lost = || kept.noticed(|notice| matches!(notice, CaptureNotice::PublisherLost { .. }));
    let _stream = welcome(&listener, "/p");
    until("it is read", || origins(&kept).len() == 1);
    capture.unwatch(&TOPIC.parse().expect("topic"));
    until("its end", || lost() == 1);
    capture.watch(TOPIC.parse().expect("topic"), None);
    let _stream = welcome(&listener, "/p");
    until("it is read again", || origins(&kept).len() == 2);
    drop(capture);
    assert_eq!(lost(), 1, "with the capture all end");
}

#[test]
fn a_message_cut_short_is_none_and_one_too_long_is_refused() {
    let master = EmbeddedMaster::start().expect("master");
    let (_slave, listener) = publisher(&master, "/p");
    let (capture, kept) = start(&master);
    let mut stream = welcome(&listener, "/p");
    send(&mut stream, 1);
    stream.write_all(&[16, 0, 0, 0, 2, 0, 0, 0]).expect("half a message");
    drop(stream);
    let mut stream = welcome(&listener, "/p");
    send(&mut stream, 2);
    stream.write_all(&u32::MAX.to_le_bytes()).expect("a claim");
    let refused = |notice: &CaptureNotice| matches!(notice, CaptureNotice::Refused { reason, .. } if reason.contains("4294967295"));
    until("the refusal", || kept.noticed(refused) == 1);
    assert_eq!(kept.seqs("/p"), [1, 2]);
    assert_eq!((capture.status()[0].messages, capture.status()[0].lost_in_transport), (2, 0));
}

#[test]
fn a_broken_connection_header_is_refused() {
    for answer in [
        ConnectionHeader::new([("error", "go \u{1b}away")]).to_bytes(),
        ConnectionHeader::new([("type", "not a type"), ("md5sum", "*")]).to_bytes(),
        ConnectionHeader::new([("type", "a/B"), ("md5sum", "*")]).to_bytes(),
        vec![3, 0, 0, 0, 9, 9, 9],
        vec![255, 255, 255, 255],
    ] {
        let master = EmbeddedMaster::start().expect("master");
        let (_slave, listener) = publisher(&master, "/p");
        let (capture, kept) = start(&master);
        let (mut stream, _) = listener.accept().expect("accept");
        stream.write_all(&answer).expect("answer");
        until("the refusal", || kept.noticed(|notice| matches!(notice, CaptureNotice::Refused { .. })) == 1);
        let controls = |notice: &CaptureNotice| matches!(notice, CaptureNotice::Refused { reason, .. } if reason.contains('\u{1b}'));
        assert_eq!(kept.noticed(controls), 0);
        assert_eq!(capture.status()[0].messages, 0);
    }
}

/// Tells a capture which publishers it has, like the master, without being the master.
fn tell(capture: &Capture, uris: &[&str]) {
    let slave = Endpoint::parse(capture.uri()).expect("uri");
    let uris = crate::ros::xmlrpc::Value::Array(uris.iter().map(|uri| (*uri).into()).collect());
    let params = ["/master".into(), TOPIC.into(), uris];
    call(&slave, "publisherUpdate", &params, Instant::now() + Duration::from_secs(5)).expect("told");
}

#[test]
fn an_unconfirmed_publisher_is_told_of_once_and_never_connected_to() {
    let master = EmbeddedMaster::start().expect("master");
    let (listed, listener) = publisher(&master, "/p");
    let (capture, kept) = start(&master);
    let mut stream = welcome(&listener, "/p");
    // Somebody's node, with a slave API and a port that would serve the topic.
    let trap = TcpListener::bind("127.0.0.1:0").expect("bind");
    let port = trap.local_addr().expect("address").port();
    let forged = SlaveServer::start("127.0.0.1", Arc::new(Publisher { port })).expect("slave");
    for _ in 0..3 {
        tell(&capture, &[&listed.uri, &forged.uri, "no uri\u{1b}"]);
    }
    let unconfirmed = |notice: &CaptureNotice| matches!(notice, CaptureNotice::UnconfirmedPublisher { .. });
    until("the alarms", || kept.noticed(unconfirmed) == 2);
    tell(&capture, &[&forged.uri]);
    send(&mut stream, 1);
    until("the message of the listed one", || kept.seqs("/p") == [1]);
    let raw = |notice: &CaptureNotice| matches!(notice, CaptureNotice::UnconfirmedPublisher { publisher, .. } if publisher.contains('\u{1b}'));
    assert_eq!((kept.noticed(unconfirmed), kept.noticed(raw)), (2, 0));
    trap.set_nonblocking(true).expect("set");
    assert_eq!(trap.accept().err().map(|error| error.kind()), Some(std::io::ErrorKind::WouldBlock), "nobody came");
}

/// Listed publishers that cannot be read are told by name, with the reason, until they can be.
#[test]
fn a_publisher_that_cannot_be_reached_is_told_by_name_and_reason() {
    let master = EmbeddedMaster::start().expect("master");
    let (_slave, listener) = publisher(&master, "/good");
    // A port where nothing listens, and a name that nobody knows.
    let closed = TcpListener::bind("127.0.0.1:0").expect("bind").local_addr().expect("address");
    let endpoint = Endpoint::parse(master.uri()).expect("uri");
    for (name, uri) in [("/dead", format!("http://{closed}/")), ("/ghost", "http://no-such-robot.invalid:4001/".into())]
    {
        let params = [name, TOPIC, "a/Stamped", &uri].map(Into::into);
        call(&endpoint, "registerPublisher", &params, Instant::now() + Duration::from_secs(5)).expect("registered");
    }
    let (capture, _kept) = start(&master);
    let _stream = welcome(&listener, "/good");
    until("both are told of", || capture.status()[0].unreached.len() == 2 && capture.status()[0].publishers == 1);
    let unreached = capture.status()[0].unreached.clone();
    assert_eq!((unreached[0].node.as_str(), unreached[0].place.as_str()), ("/dead", &*closed.to_string()));
    assert!(unreached[0].reason.contains("nothing listens there"), "{unreached:?}");
    assert_eq!((unreached[1].node.as_str(), unreached[1].place.as_str()), ("/ghost", "no-such-robot.invalid:4001"));
    assert!(unreached[1].reason.contains("resolve"), "{unreached:?}");
    // One that is no longer listed is no longer told of.
    let params = ["/dead", TOPIC, &format!("http://{closed}/")].map(Into::into);
    call(&endpoint, "unregisterPublisher", &params, Instant::now() + Duration::from_secs(5)).expect("unregistered");
    until("one is left", || capture.status()[0].unreached.len() == 1);
}

/// The origins of the connections so far, in order.
fn origins(kept: &Kept) -> Vec<Arc<Origin>> {
    let notices = kept.notices.lock().expect("lock");
    let origin = |notice: &CaptureNotice| match notice {
        CaptureNotice::PublisherConnected { origin, .. } => Some(Arc::clone(origin)),
        _ => None,
    };
    notices.iter().filter_map(origin).collect()
}

fn unregister(master: &EmbeddedMaster, name: &str, slave: &SlaveServer) {
    let master = Endpoint::parse(master.uri()).expect("uri");
    let params = [name, TOPIC, &slave.uri].map(Into::into);
    call(&master, "unregisterPublisher", &params, Instant::now() + Duration::from_secs(5)).expect("unregistered");
}

/// Two runs of an anonymous node of roscpp.
const RUNS: [&str; 2] = ["/p_1609459200123456789", "/p_1609459300123456789"];

#[test]
fn of_two_runs_of_an_anonymous_node_that_are_there_at_once_the_later_is_a_rival() {
    let master = EmbeddedMaster::start().expect("master");
    let (slave, listener) = publisher(&master, RUNS[0]);
    let (_capture, kept) = start(&master);
    let stream = welcome(&listener, RUNS[0]);
    until("the first", || origins(&kept).len() == 1);
    let (_second, other) = publisher(&master, RUNS[1]);
    let _other = welcome(&other, RUNS[1]);
    until("the second", || origins(&kept).len() == 2);
    let met = origins(&kept);
    assert_eq!(met[1].rival.as_ref().map(|rival| rival.number), Some(met[0].number), "{met:?}");
    drop((stream, listener, slave));
}

#[test]
fn a_restarted_anonymous_node_is_nobodys_rival() {
    let master = EmbeddedMaster::start().expect("master");
    let (slave, listener) = publisher(&master, RUNS[0]);
    let (_capture, kept) = start(&master);
    let stream = welcome(&listener, RUNS[0]);
    until("the first", || origins(&kept).len() == 1);
    drop((stream, listener, slave));
    until("its end", || kept.noticed(|notice| matches!(notice, CaptureNotice::PublisherLost { .. })) == 1);
    let (_slave, listener) = publisher(&master, RUNS[1]);
    let _stream = welcome(&listener, RUNS[1]);
    until("the second", || origins(&kept).len() == 2);
    assert!(origins(&kept).iter().all(|origin| origin.rival.is_none()));
}

#[test]
fn a_restarted_node_is_nobodys_rival() {
    let master = EmbeddedMaster::start().expect("master");
    let (slave, listener) = publisher(&master, "/p");
    let (_capture, kept) = start(&master);
    let stream = welcome(&listener, "/p");
    until("the first", || origins(&kept).len() == 1);
    unregister(&master, "/p", &slave);
    drop((stream, listener, slave));
    until("its end", || kept.noticed(|notice| matches!(notice, CaptureNotice::PublisherLost { .. })) == 1);
    // The query after the end finds nobody; the new process comes later.
    std::thread::sleep(Duration::from_millis(700));
    let (_slave, listener) = publisher(&master, "/p");
    let _stream = welcome(&listener, "/p");
    until("the second", || origins(&kept).len() == 2);
    let met = origins(&kept);
    assert!(met.iter().all(|origin| origin.rival.is_none()), "{met:?}");
    assert!(met[0].number != met[1].number && met[0].host == "127.0.0.1");
}

#[test]
fn one_that_registers_while_its_namesake_is_read_is_its_rival_whether_that_one_ends_or_not() {
    for ends in [false, true] {
        let master = EmbeddedMaster::start().expect("master");
        let (_slave, listener) = publisher(&master, "/p");
        let (_capture, kept) = start(&master);
        let stream = welcome(&listener, "/p");
        until("the first", || origins(&kept).len() == 1);
        let (_second, forged) = publisher(&master, "/p");
        if ends {
            // Like a node shut down by the master: it ends a moment after the other one has registered.
            drop((stream, listener));
        }
        let _stream = welcome(&forged, "/p");
        until("the second", || origins(&kept).len() == 2);
        let met = origins(&kept);
        assert_eq!(met[0].rival, None);
        assert_eq!(met[1].rival.as_ref().map(|rival| rival.number), Some(met[0].number), "{ends} {met:?}");
    }
}
