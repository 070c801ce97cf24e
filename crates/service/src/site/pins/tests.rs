//! The operator's decisions about publishers take effect, and are logged before.
#![allow(clippy::expect_used, reason = "a test fails by panicking")]

use std::time::Instant;

use super::*;
use crate::model::{Doubt, PinMode};
use crate::pipeline::PinRules;
use crate::ros::Origin;
use crate::site::testing::{Ground, profile};

const MD5: &str = "992ce8a1687cec8c8bd883ec73ca41d1";

fn publisher(caller_id: &str) -> Publisher {
    format!("{caller_id}@robot:std_msgs/String:{MD5}").parse().expect("a publisher")
}

fn origin(number: u64, caller_id: &str) -> Arc<Origin> {
    Arc::new(Origin {
        number,
        caller_id: caller_id.into(),
        host: "robot".into(),
        uri: format!("http://robot:{number}/"),
        type_name: "std_msgs/String".into(),
        md5sum: MD5.into(),
        listed_at: Instant::now(),
        rival: None,
        unnamed: false,
    })
}

fn pinning(ground: &Ground, mode: PinMode, listed: &str) -> Arc<Pinning> {
    let (ledger, hub) = (ground.parts.plant.ledger.clone(), ground.parts.hub.clone());
    let pins = Pins::new(&ledger, hub, PinRules { mode, listed: listed.parse().expect("a list") });
    Arc::new(Pinning { parts: ground.parts.clone(), pins: Arc::new(pins) })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn another_publisher_is_held_back_until_the_operator_pins_it_and_after_it_is_unpinned() {
    let ground = Ground::with(&[]);
    let (pinning, owner) = (pinning(&ground, PinMode::List, ""), ground.owner("alice"));
    let (alice, topic) = (profile("alice"), "/odom".parse().expect("a topic"));
    let view = pinning.pin(&alice, &topic, vec![publisher("/driver")]).await.expect("pinned");
    assert_eq!((view.pins.len(), view.pins.first().map(|pin| pin.source.as_str())), (1, Some("operator")));
    assert_eq!(pinning.pins.judge(owner.address, "/odom", &origin(1, "/driver")), None);
    assert_eq!(pinning.pins.judge(owner.address, "/odom", &origin(2, "/other")), Some(Doubt::New));

    pinning.pin(&alice, &topic, vec![publisher("/other")]).await.expect("pinned too");
    assert_eq!(pinning.pins.judge(owner.address, "/odom", &origin(3, "/other")), None);
    let left = pinning.unpin(&alice, &topic, "/other").await.expect("unpinned");
    assert_eq!(left.pins.iter().map(|pin| pin.publisher.caller_id.as_str()).collect::<Vec<_>>(), ["/driver"]);
    assert_eq!(pinning.pins.judge(owner.address, "/odom", &origin(4, "/other")), Some(Doubt::New));
    let pinned = ground.audited("pin");
    let words: Vec<&str> = pinned.iter().map(|(_, outcome)| outcome.as_str()).collect();
    assert_eq!(words, ["begun", "done", "begun", "done"], "before the deed and after it: {pinned:?}");
    let unpinned = ["begun", "done"].map(|outcome| ("/odom /other".to_owned(), outcome.to_owned()));
    assert_eq!(ground.audited("unpin"), unpinned);
    pinning.unpin(&alice, &topic, "/other").await.expect_err("pinned no longer");
    let failed = ground.audited("unpin").pop().expect("a line").1;
    assert!(failed.starts_with("failed: /other is not pinned to /odom"), "{failed}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pins_of_the_settings_are_shown_and_taken_back_only_there() {
    let ground = Ground::with(&[]);
    let listed = format!("/odom=/driver@robot:std_msgs/String:{MD5}");
    let pinning = pinning(&ground, PinMode::List, &listed);
    ground.owner("alice");
    let (alice, topic) = (profile("alice"), "/odom".parse().expect("a topic"));
    let view = pinning.view(&alice, None).await.expect("pins");
    assert_eq!(view.pins.iter().map(|pin| (pin.source.as_str(), pin.at)).collect::<Vec<_>>(), [("settings", None)]);
    let refused = pinning.unpin(&alice, &topic, "/driver").await.expect_err("not from here");
    assert!(refused.message.contains("ros.publishers"), "{}", refused.message);
    let unknown = pinning.unpin(&alice, &topic, "/nobody").await.expect_err("not pinned");
    assert!(unknown.message.contains("not pinned to /odom"), "{}", unknown.message);
    let nobody = pinning.pin(&alice, &topic, Vec::new()).await.expect_err("nobody is read");
    assert!(nobody.message.contains("no publisher of /odom"), "{}", nobody.message);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pins_survive_a_restart_and_are_one_profiles_alone() {
    let ground = Ground::with(&[]);
    let first = pinning(&ground, PinMode::List, "");
    let owner = ground.owner("alice");
    let topic = "/odom".parse().expect("a topic");
    first.pin(&profile("alice"), &topic, vec![publisher("/driver")]).await.expect("pinned");
    drop(first);
    let ground = ground.again();
    let pinning = pinning(&ground, PinMode::List, "");
    assert_eq!(pinning.pins.judge(owner.address, "/odom", &origin(1, "/driver")), None);
    assert_eq!(pinning.pinned_names(&profile("alice")).expect("names").len(), 1);
    ground.owner("bob");
    assert!(pinning.view(&profile("bob"), None).await.expect("pins").pins.is_empty());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_pattern_pins_and_unpins_what_is_read_on_every_topic_that_matches() {
    let ground = Ground::with(&[]);
    let (pinning, alice) = (pinning(&ground, PinMode::List, ""), profile("alice"));
    ground.owner("alice");
    for (number, topic) in (1..).zip(["/robot1/odom", "/robot2/odom", "/robot2/scan", "/tf"]) {
        pinning.pins.connected(&topic.into(), &origin(number, "/driver"));
    }
    let pattern = |text: &str| text.parse().expect("a pattern");
    let names = |view: &PinsView| view.pins.iter().map(|pin| pin.topic.clone()).collect::<Vec<_>>();
    let pinned = pinning.pin(&alice, &pattern("/robot*/odom"), Vec::new()).await.expect("pinned");
    assert_eq!(names(&pinned), ["/robot1/odom", "/robot2/odom"]);
    let of_robot = pinning.view(&alice, Some(&pattern("/robot2/**"))).await.expect("pins");
    assert_eq!(names(&of_robot), ["/robot2/odom"], "what is listed is what matches");
    let several = pinning.pin(&alice, &pattern("/robot*/odom"), vec![publisher("/other")]).await;
    assert!(several.expect_err("for one topic only").message.contains("name one topic"));

    pinning.unpin(&alice, &pattern("/robot2/**"), "/driver").await.expect("unpinned");
    assert_eq!(names(&pinning.view(&alice, None).await.expect("pins")), ["/robot1/odom"]);
    let again = pinning.unpin(&alice, &pattern("/robot2/**"), "/driver").await.expect_err("nothing is left");
    assert!(again.message.contains("not pinned to /robot2/**"), "{}", again.message);
}
