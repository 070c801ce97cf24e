//! Many robots: their topics fold into one row each, and an action on that row applies to all of them.

use super::{Robot, fixtures};
use crate::app::feed::Feed;
use crate::app::{Key, Tag};
use crate::service::reply::TopicRow;
use crate::service::{Part, Reply};

fn fleet() -> Robot {
    let mut robot = Robot::at_work(true);
    robot.types("2");
    robot.hears_of(Part::Topics);
    let topics = ["/robot1/camera", "/robot1/odom", "/robot2/camera", "/robot2/odom", "/tf"];
    let rows = topics.map(|name| fixtures::topic(name, 10.0)).to_vec();
    robot.is_answered(&Tag::Feed(Feed::Topics, 0), Ok(Reply::Topics(rows)));
    robot
}

#[test]
fn h_folds_the_robot_under_the_cursor_and_unfolds_it() {
    let mut robot = fleet();
    robot.presses(Key::Down);
    robot.types("h");
    assert_eq!(robot.state.row_keys(), ["/robot1/", "/robot2/camera", "/robot2/odom", "/tf"]);
    assert_eq!(robot.state.row_key().as_deref(), Some("/robot1/"), "the cursor stays with the robot");
    robot.types("h");
    assert_eq!(robot.state.row_keys().len(), 5);
    robot.types("H");
    assert_eq!(robot.state.row_keys(), ["/robot1/", "/robot2/", "/tf"]);
    robot.types("H");
    assert_eq!(robot.state.row_keys().len(), 5);
}

#[test]
fn what_is_done_to_a_robot_is_done_to_its_topics_and_to_no_other() {
    let mut robot = fleet();
    robot.types("H");
    robot.presses(Key::Down);
    robot.types("w");
    assert_eq!(robot.work(), [Tag::Watch("/robot2/camera".into()), Tag::Watch("/robot2/odom".into())]);
    robot.types("p");
    assert_eq!(robot.message(), "pin: a robot, not a topic: h unfolds it");
}

#[test]
fn a_topic_that_is_named_as_a_row_of_a_robot_would_be_stands_for_itself() {
    let mut robot = fleet();
    robot.hears_of(Part::Topics);
    let rows: Vec<TopicRow> = ["/robot1/", "/robot1/odom"].map(|name| fixtures::topic(name, 1.0)).to_vec();
    robot.is_answered(&Tag::Feed(Feed::Topics, 0), Ok(Reply::Topics(rows)));
    let targets: Vec<&str> = robot.state.topics.targets().iter().map(|row| row.topic.as_str()).collect();
    assert_eq!(targets, ["/robot1/"]);
}
