//! The log: complete lines, by source, and that an operator's own mistake is not an alert.

use super::{Robot, fixtures};
use crate::app::{Action, Effect, Key, Popup, Tag};
use crate::model::ErrorKind;
use crate::screens::log::state::Source;
use crate::service::{Event, NoticeLevel, Reply};

fn alerts(robot: &Robot) -> Vec<String> {
    robot.state.alerts.shown().into_iter().map(|alert| alert.text.clone()).collect()
}

fn tells(robot: &mut Robot, text: &str) {
    let notice = Event::Notice { at: robot.state.now, level: NoticeLevel::Error, text: text.to_owned(), about: None };
    robot.act(Action::Told(notice));
}

#[test]
fn an_act_that_failed_is_in_the_log_and_is_no_alert_and_its_success_takes_the_message_away() {
    let mut robot = Robot::at_work(true);
    robot.types("2/robot2");
    robot.presses(Key::Enter);
    robot.types("w");
    let tag = robot.work().pop().expect("sent");
    robot.is_answered(&tag, Err(fixtures::failure(ErrorKind::Refused, "the master refuses")));
    assert!(robot.message().contains("the master refuses"));
    assert!(alerts(&robot).is_empty(), "{:?}", alerts(&robot));
    assert!(robot.state.log.visible().iter().any(|line| line.text.contains("the master refuses")));

    robot.types("w");
    let Tag::Watch(topic) = &tag else { panic!("{tag:?}") };
    robot.is_answered(&tag, Ok(Reply::Done));
    assert_eq!(robot.message(), format!("now watching {topic}"), "the newest result is on top");
    robot.waits(3);
    assert_eq!(robot.message(), "", "what failed before at the same is over");
    let done = format!("watching {topic}: done");
    assert!(robot.state.log.visible().iter().any(|line| line.text == done && line.source == Source::Console));
}

#[test]
fn what_the_site_tells_is_an_alert_with_its_count_until_it_is_seen() {
    let mut robot = Robot::at_work(true);
    tells(&mut robot, "a task ended");
    robot.waits(60);
    tells(&mut robot, "a task ended");
    let alert = robot.state.alerts.shown()[0].clone();
    assert_eq!((alert.text.as_str(), alert.count, alert.since), ("a task ended", 2, fixtures::NOW));
    robot.presses(Key::Escape);
    assert!(alerts(&robot).is_empty());
}

#[test]
fn enter_shows_the_whole_line_and_o_goes_through_the_sources() {
    let mut robot = Robot::at_work(true);
    robot.types("9");
    robot.site_answers(true);
    let long = format!("the store says {}", "no and ".repeat(40));
    tells(&mut robot, &long);
    robot.presses(Key::Home);
    robot.presses(Key::Enter);
    assert!(matches!(robot.state.popups.last(), Some(Popup::Line(line)) if line.text.contains("no and no and")));
    robot.types("y");
    assert!(matches!(robot.effects.last(), Some(Effect::CopyText(text)) if text.contains("error notice")));
    robot.types("q");
    for source in Source::ALL {
        robot.types("o");
        assert!(robot.state.log.visible().iter().all(|line| line.source == source), "{source:?}");
    }
    assert!(robot.state.log.source.is_some());
    robot.types("o");
    assert!(robot.state.log.source.is_none());
}

#[test]
fn n_goes_to_the_next_match_and_an_empty_filter_recalls_earlier_ones() {
    let mut robot = Robot::at_work(true);
    robot.types("2n");
    assert_eq!(robot.message(), "next-match: no filter; / sets one");
    robot.types("/odom");
    robot.presses(Key::Enter);
    let first = robot.state.row_key();
    robot.types("n");
    assert_ne!(robot.state.row_key(), first);
    robot.types("N");
    assert_eq!(robot.state.row_key(), first);
    robot.presses(Key::Escape);
    robot.presses(Key::Escape);
    robot.types("/");
    robot.presses(Key::Up);
    assert_eq!(robot.state.topics.table.filter.text(), "odom");
}
