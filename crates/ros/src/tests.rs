//! The crate end to end, in one process: embedded master, robots, capture.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::*;

#[derive(Default)]
struct Kept {
    messages: Mutex<Vec<Message>>,
    notices: Mutex<Vec<CaptureNotice>>,
}

impl MessageSink for Kept {
    fn accept(&self, message: Message) {
        self.messages.lock().expect("lock").push(message);
    }

    fn notice(&self, notice: CaptureNotice) {
        self.notices.lock().expect("lock").push(notice);
    }
}

fn until(what: &str, condition: impl Fn() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(20);
    while !condition() {
        assert!(Instant::now() < deadline, "{what} did not come about");
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn capture(master: &EmbeddedMaster, kept: &Arc<Kept>) -> Capture {
    let options = CaptureOptions { master_uri: master.uri().into(), own_host: None, node_name: "/authros_test".into() };
    Capture::start(options, Arc::clone(kept) as _).expect("capture")
}

#[test]
fn every_message_between_two_marks_is_captured() {
    let master = EmbeddedMaster::start().expect("master");
    let kept = Arc::new(Kept::default());
    let capture = capture(&master, &kept);
    for robot in 1..=2 {
        for name in ["odom", "camera/compressed"] {
            capture.watch(format!("/robot{robot}/{name}").parse().expect("topic"), None);
        }
    }
    let fleet = Fleet::start(master.uri(), 2, FleetOptions { odometry_hz: 100.0, picture_hz: 10.0 }).expect("fleet");
    until("all topics", || capture.status().iter().all(|topic| topic.messages > 20));
    let graph = Graph::new(master.uri(), "/looker").expect("uri");
    let topics = graph.topics().expect("topics");
    let odometry = topics.iter().find(|topic| topic.name == "/robot1/odom").expect("published");
    assert_eq!((odometry.publishers.as_slice(), odometry.subscribers), (["/robot1_sim".to_owned()].as_slice(), 1));
    assert_eq!(odometry.type_name.as_deref(), Some("nav_msgs/Odometry"));
    let published: BTreeMap<String, u64> = fleet.stop().into_iter().collect();
    until("the last messages", || capture.status().iter().all(|topic| topic.publishers == 0));
    let status = capture.status();
    assert!(status.iter().all(|topic| topic.lost_in_transport == 0), "{status:?}");
    drop(capture);

    let messages = kept.messages.lock().expect("lock");
    assert_eq!(published.len(), 4);
    for (topic, count) in &published {
        let seen: Vec<u32> = messages.iter().filter(|m| *m.topic == **topic).filter_map(|m| m.header_seq).collect();
        let first = seen.first().copied().expect("some");
        let last = u32::try_from(*count).expect("small");
        assert_eq!(seen, (first..last).collect::<Vec<_>>(), "{topic}");
    }
    for message in messages.iter() {
        assert_eq!(md5sum(&message.type_name, &message.definition).as_deref(), Ok(&*message.md5sum));
    }
    let picture = messages.iter().rfind(|m| m.topic.ends_with("compressed")).expect("a picture");
    let definition = Definition::parse(&picture.type_name, &picture.definition).expect("definition");
    let found = definition.compressed_image(&picture.body).expect("picture");
    let decoded = crate::ros::readable::decode(&picture.body[found.data]).expect("a real JPEG");
    assert_eq!((found.format.as_str(), decoded.width), ("jpeg", 640));
    assert_eq!(&*picture.caller_id, if picture.topic.starts_with("/robot1") { "/robot1_sim" } else { "/robot2_sim" });
}

#[test]
fn another_type_is_told_and_not_captured_and_a_waiting_topic_waits() {
    let master = EmbeddedMaster::start().expect("master");
    let kept = Arc::new(Kept::default());
    let capture = capture(&master, &kept);
    let topic: crate::model::TopicName = "/robot1/odom".parse().expect("topic");
    capture.watch(topic.clone(), Some("sensor_msgs/Imu".parse().expect("type")));
    capture.watch("/nobody/here".parse().expect("topic"), None);
    let fleet = Fleet::start(master.uri(), 1, FleetOptions::default()).expect("fleet");
    let mismatch = |notice: &CaptureNotice| {
        matches!(notice, CaptureNotice::TypeMismatch { wanted, found, caller_id, .. }
            if wanted == "sensor_msgs/Imu" && found == "nav_msgs/Odometry" && caller_id == "/robot1_sim")
    };
    until("the mismatch", || kept.notices.lock().expect("lock").iter().any(mismatch));
    assert!(kept.messages.lock().expect("lock").is_empty());
    capture.unwatch(&topic);
    capture.watch(topic.clone(), Some("nav_msgs/Odometry".parse().expect("type")));
    until("the right type", || !kept.messages.lock().expect("lock").is_empty());
    assert_eq!(capture.watched().len(), 2);
    assert_eq!(capture.status()[0].publishers, 0);
    drop(fleet);
}

#[test]
fn losing_the_master_loses_no_message() {
    let first = EmbeddedMaster::start().expect("master");
    let kept = Arc::new(Kept::default());
    let capture = capture(&first, &kept);
    capture.watch("/robot1/odom".parse().expect("topic"), None);
    let fleet = Fleet::start(first.uri(), 1, FleetOptions { odometry_hz: 100.0, picture_hz: 1.0 }).expect("fleet");
    until("messages", || capture.status()[0].messages > 5);
    drop(first);
    // Longer than the interval between registrations, which fail now.
    std::thread::sleep(Duration::from_secs(2));
    let before = capture.status()[0].messages;
    until("messages without a master", || capture.status()[0].messages > before + 20);
    assert_eq!(capture.status()[0].lost_in_transport, 0);
    drop(fleet);
    until("the publisher's end", || capture.status()[0].publishers == 0);
}

#[test]
fn unwatching_unregisters_at_the_master() {
    let master = EmbeddedMaster::start().expect("master");
    let kept = Arc::new(Kept::default());
    let capture = capture(&master, &kept);
    let graph = Graph::new(master.uri(), "/looker").expect("uri");
    let topic: crate::model::TopicName = "/robot9/odom".parse().expect("topic");
    capture.watch(topic.clone(), None);
    until("the subscription", || graph.topics().is_ok_and(|topics| topics.len() == 1));
    capture.unwatch(&topic);
    until("the end of it", || graph.topics().is_ok_and(|topics| topics.is_empty()));
    capture.watch(topic, None);
    until("the subscription", || graph.topics().is_ok_and(|topics| topics.len() == 1));
    drop(capture);
    until("the end of it", || graph.topics().is_ok_and(|topics| topics.is_empty()));
}

#[test]
fn rates_and_numbers_of_robots_are_checked() {
    let uri = "http://127.0.0.1:9/";
    let rate = |odometry_hz| Fleet::start(uri, 1, FleetOptions { odometry_hz, picture_hz: 1.0 }).err();
    assert!(matches!(rate(0.0), Some(RosError::Rate(_))));
    assert!(matches!(rate(f64::NAN), Some(RosError::Rate(_))));
    assert!(matches!(Fleet::start(uri, 65, FleetOptions::default()), Err(RosError::Robots(65))));
    assert!(matches!(Fleet::start(uri, 1, FleetOptions::default()), Err(RosError::Unreachable { .. })));
    assert!(Fleet::start(uri, 0, FleetOptions::default()).is_ok());
}
