//! Data by pull: only what is on screen, one request at a time, never an older answer.

use super::{Robot, fixtures};
use crate::app::{Feed, Tag};
use crate::model::ErrorKind;
use crate::service::{Command, Part, Reply};

fn topics_asked(robot: &Robot) -> usize {
    robot.sent.iter().filter(|(command, _)| matches!(command, Command::ListTopics)).count()
}

#[test]
fn however_often_a_part_changes_one_question_is_under_way() {
    let mut robot = Robot::at_work(true);
    for _ in 0..10 {
        robot.hears_of(Part::Topics);
    }
    assert_eq!(topics_asked(&robot), 1);
    robot.is_answered(&Tag::Feed(Feed::Topics, 0), Ok(Reply::Topics(fixtures::topics())));
    assert_eq!(topics_asked(&robot), 1, "asked once more for what changed meanwhile");
    robot.is_answered(&Tag::Feed(Feed::Topics, 0), Ok(Reply::Topics(fixtures::topics())));
    assert_eq!(topics_asked(&robot), 0);
}

#[test]
fn what_is_not_on_screen_is_asked_for_when_it_comes_on_screen() {
    let mut robot = Robot::at_work(true);
    robot.hears_of(Part::Chain);
    assert!(robot.sent.is_empty());
    robot.types("7");
    assert!(matches!(robot.sent[..], [(Command::ChainStatus, _)]));
}

#[test]
fn an_answer_to_an_older_question_is_dropped() {
    let mut robot = Robot::at_work(true);
    robot.types("3");
    let first = Tag::Feed(Feed::Records, robot.state.feeds.slot(Feed::Records).generation);
    robot.types("s");
    robot.is_answered(
        &first,
        Ok(Reply::Records(fixtures::page(&crate::service::UploadQuery { limit: 5, ..Default::default() }, None))),
    );
    assert!(robot.state.records.rows.is_empty());
    robot.site_answers(true);
    assert!(!robot.state.records.rows.is_empty());
}

#[test]
fn a_failed_question_is_asked_again_by_itself() {
    let mut robot = Robot::at_work(true);
    robot.hears_of(Part::Topics);
    robot.is_answered(&Tag::Feed(Feed::Topics, 0), Err(fixtures::failure(ErrorKind::Unreachable, "master is gone")));
    assert_eq!(topics_asked(&robot), 0);
    assert_eq!(robot.message(), "", "a list says so in its place, without a toast");
    assert!(robot.state.deadline().is_some());
    robot.waits(5);
    assert_eq!(topics_asked(&robot), 1);
}

#[test]
fn missed_events_make_everything_on_screen_asked_anew() {
    let mut robot = Robot::at_work(true);
    robot.act(crate::app::Action::Missed);
    assert_eq!(robot.sent.len(), 5);
}

#[test]
fn nothing_is_due_when_nothing_happens() {
    let mut robot = Robot::at_work(true);
    assert_eq!(robot.state.deadline(), None);
    robot.types("3");
    robot.site_answers(true);
    robot.types("y");
    assert!(robot.state.deadline().is_some(), "a toast goes by itself");
    robot.waits(3);
    // The topics' ages advance without news, only there.
    robot.types("1");
    assert_eq!(robot.state.deadline(), None);
}
