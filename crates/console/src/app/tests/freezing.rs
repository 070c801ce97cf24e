//! `f`: the view is frozen while capture goes on.

use super::{Robot, fixtures};
use crate::app::{Feed, Tag};
use crate::service::{Command, Part, Reply};

#[test]
fn a_frozen_view_asks_for_nothing_and_catches_up_when_thawed() {
    let mut robot = Robot::at_work(true);
    robot.types("f");
    assert_eq!(robot.state.frozen, Some(fixtures::NOW), "and says since when");
    robot.site_answers(true);
    robot.hears_of(Part::Topics);
    robot.types("2345678");
    assert!(robot.sent.is_empty(), "every screen stands at the moment of the freeze: {:?}", robot.sent);
    robot.types("2f");
    assert!(robot.sent.iter().any(|(command, _)| matches!(command, Command::ListTopics)));
}

#[test]
fn an_answer_under_way_does_not_move_a_frozen_view() {
    let mut robot = Robot::at_work(true);
    robot.hears_of(Part::Topics);
    robot.types("f");
    let before = robot.state.topics.rows.clone();
    robot.is_answered(&Tag::Feed(Feed::Topics, 0), Ok(Reply::Topics(vec![fixtures::topic("/new", 1.0)])));
    assert_eq!(robot.state.topics.rows, before);
    robot.sent.clear();
    robot.types("f");
    assert!(robot.sent.iter().any(|(command, _)| matches!(command, Command::ListTopics)), "it is asked for again");
}

#[test]
fn a_screen_never_seen_is_still_filled() {
    let mut robot = Robot::at_work(true);
    robot.types("f7");
    assert!(robot.sent.iter().any(|(command, _)| matches!(command, Command::ChainStatus)));
}

#[test]
fn a_frozen_view_turns_the_pages_of_its_moment() {
    let mut robot = Robot::at_work(true);
    robot.types("3");
    robot.site_answers(true);
    robot.types("f");
    let asked = |robot: &Robot| {
        let questions = robot.sent.iter().rev();
        questions.clone().find_map(|(command, _)| match command {
            Command::ListUploads(query) => Some((query.until, query.after.clone())),
            _ => None,
        })
    };
    let moment = Some(crate::model::Timestamp(fixtures::NOW.0 + 1));
    assert_eq!(asked(&robot), Some((moment, None)));
    robot.site_answers(true);
    robot.presses(crate::app::Key::End);
    robot.presses(crate::app::Key::Down);
    assert_eq!(asked(&robot), Some((moment, Some("982".to_owned()))), "the page behind, of the same moment");
    robot.site_answers(true);
    assert_eq!(robot.state.records.rows[0].seq, 982);
    robot.waits(60);
    robot.hears_of(Part::Uploads);
    assert_eq!(asked(&robot), None, "and what comes later is not asked for");
}
