//! `f`: the view stands still while capture goes on.

use super::{Robot, fixtures};
use crate::app::Tag;
use crate::app::feed::Feed;
use crate::service::{Command, Part, Reply};

#[test]
fn a_frozen_view_asks_for_nothing_and_catches_up_when_thawed() {
    let mut robot = Robot::at_work(true);
    robot.types("f");
    assert_eq!(robot.state.frozen, Some(fixtures::NOW), "and says since when");
    robot.hears_of(Part::Topics);
    assert!(robot.sent.is_empty());
    robot.types("f");
    assert!(matches!(robot.sent[..], [(Command::ListTopics, _)]));
}

#[test]
fn an_answer_under_way_does_not_move_a_frozen_view() {
    let mut robot = Robot::at_work(true);
    robot.hears_of(Part::Topics);
    robot.types("f");
    let before = robot.state.topics.rows.clone();
    robot.is_answered(&Tag::Feed(Feed::Topics, 0), Ok(Reply::Topics(vec![fixtures::topic("/new", 1.0)])));
    assert_eq!(robot.state.topics.rows, before);
    robot.types("f");
    assert!(matches!(robot.sent[..], [(Command::ListTopics, _)]), "it is asked for again");
}

#[test]
fn a_screen_never_seen_is_still_filled() {
    let mut robot = Robot::at_work(true);
    robot.types("f7");
    assert!(matches!(robot.sent[..], [(Command::ChainStatus, _)]));
}
