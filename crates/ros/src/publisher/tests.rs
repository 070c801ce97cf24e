//! Our publisher received by our capture, with an embedded master.

use std::sync::{Arc, Mutex};

use super::*;
use crate::ros::{Capture, CaptureNotice, CaptureOptions, EmbeddedMaster, Graph, Message, MessageSink};

#[derive(Default)]
struct Kept(Mutex<Vec<Message>>);

impl MessageSink for Kept {
    fn accept(&self, message: Message) {
        self.0.lock().expect("lock").push(message);
    }

    fn notice(&self, _: CaptureNotice) {}
}

impl Kept {
    fn bodies(&self, topic: &str) -> Vec<Vec<u8>> {
        let messages = self.0.lock().expect("lock");
        messages.iter().filter(|message| *message.topic == *topic).map(|message| message.body.clone()).collect()
    }
}

fn until(what: &str, condition: impl Fn() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(30);
    while !condition() {
        assert!(Instant::now() < deadline, "{what} did not come about");
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn topic(name: &str, latching: bool) -> Advertised {
    Advertised {
        topic: name.into(),
        type_name: "std_msgs/String".into(),
        md5sum: "992ce8a1687cec8c8bd883ec73ca41d1".into(),
        definition: "string data\n".into(),
        latching,
    }
}

fn listener(master: &EmbeddedMaster, topics: &[&str]) -> (Capture, Arc<Kept>) {
    let kept = Arc::new(Kept::default());
    let options = CaptureOptions { master_uri: master.uri().into(), own_host: None, node_name: "/ear".into() };
    let capture = Capture::start(options, Arc::clone(&kept) as _).expect("capture");
    topics.iter().for_each(|topic| capture.watch(topic.parse().expect("topic"), None));
    (capture, kept)
}

#[test]
fn what_is_published_arrives_whole_in_order_and_as_it_was_described() {
    let master = EmbeddedMaster::start().expect("master");
    let (_capture, kept) = listener(&master, &["/words", "/more"]);
    let publisher = Publisher::start(master.uri(), None, "/mouth").expect("publisher");
    let ([words, more], graph) = ([topic("/words", false), topic("/more", false)], Graph::new(master.uri(), "/x"));
    for about in [&words, &more] {
        until("the subscriber's registration", || {
            graph
                .as_ref()
                .is_ok_and(|graph| graph.presence(&about.topic).is_ok_and(|nodes| nodes.subscribers == ["/ear"]))
        });
        assert_eq!(publisher.advertise(about), Ok(1), "the master knows the subscriber");
        until("the connection", || publisher.subscribers(&about.topic) == 1);
    }
    let bodies: Vec<Vec<u8>> = (0..500_u32).map(|number| number.to_le_bytes().repeat(3)).collect();
    for body in &bodies {
        assert!(publisher.publish("/words", 1, body) && publisher.publish("/more", 1, body));
    }
    assert!(!publisher.publish("/unknown", 1, &[]));
    publisher.leave();
    until("the end of the queues", || publisher.is_sent());
    assert_eq!(Box::new(publisher).end(), 0);
    until("all messages", || kept.bodies("/more").len() == 500 && kept.bodies("/words").len() == 500);
    assert_eq!((kept.bodies("/words"), kept.bodies("/more")), (bodies.clone(), bodies));
    let heard = kept.0.lock().expect("lock").first().cloned().expect("one");
    assert_eq!(
        (&*heard.type_name, &*heard.md5sum, &*heard.definition, &*heard.caller_id),
        (words.type_name.as_str(), words.md5sum.as_str(), words.definition.as_str(), "/mouth")
    );
    assert_eq!(graph.expect("uri").presence("/words").expect("asked").publishers, Vec::<String>::new());
}

#[test]
fn a_topic_that_is_cut_is_gone_from_the_graph_and_late_subscribers_get_nothing_of_it() {
    let master = EmbeddedMaster::start().expect("master");
    let mut publisher = Publisher::start(master.uri(), None, "/mouth").expect("publisher");
    for name in ["/kept", "/cut"] {
        publisher.advertise(&topic(name, true)).expect("advertised");
        publisher.publish(name, 1, b"last");
    }
    publisher.cut(&["/cut".into()]);
    let (_capture, kept) = listener(&master, &["/kept", "/cut"]);
    until("the latched message", || kept.bodies("/kept") == [b"last"]);
    assert_eq!(kept.bodies("/cut"), Vec::<Vec<u8>>::new());
    let graph = Graph::new(master.uri(), "/x").expect("uri");
    until("the master's hearing of it", || graph.presence("/cut").is_ok_and(|nodes| nodes.publishers.is_empty()));
    assert_eq!(graph.presence("/kept").expect("asked").publishers, ["/mouth"]);
}
