//! Granting and revoking: forms, questions with default no, honest words.

use super::{Robot, fixtures};
use crate::app::popup::{Confirm, Popup};
use crate::app::{Key, Tag};
use crate::model::Timestamp;
use crate::service::{Command, Epochs};

const READER: &str = "0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed";

fn at_grants() -> Robot {
    let mut robot = Robot::at_work(true);
    robot.types("5");
    robot.site_answers(true);
    robot
}

fn question(robot: &Robot) -> &Confirm {
    match robot.state.popups.last() {
        Some(Popup::Confirm(confirm)) => confirm,
        other => panic!("no question, but {other:?}"),
    }
}

fn fills_in(robot: &mut Robot, fields: [&str; 3]) {
    for field in fields {
        robot.pastes(field);
        robot.presses(Key::Enter);
    }
    robot.presses(Key::Enter);
}

#[test]
fn g_asks_the_terms_then_shows_who_reads_already_then_sends_on_y() {
    let mut robot = at_grants();
    robot.types("g");
    fills_in(&mut robot, [READER, "/robot1/odom /robot2/odom", "30d"]);
    let text = question(&robot).lines.join("\n");
    assert!(text.contains(READER) && text.contains("2023-12-14 22:13 UTC"), "{text}");
    assert!(text.contains(&fixtures::OTHER.to_string()), "who can read this now:\n{text}");
    robot.types("y");
    let (command, _) = robot.sent.last().expect("sent");
    let Command::Grant { grantee, topics, epochs, expires } = command else { panic!("{command:?}") };
    assert_eq!((grantee.to_string().as_str(), topics.len(), *epochs), (READER, 2, Epochs::Current));
    assert_eq!(*expires, Some(Timestamp(fixtures::NOW.0 + 30 * 86_400 * 1_000_000_000)));
    assert!(robot.state.popups.is_empty());
}

#[test]
fn anything_but_y_is_no_and_leads_back_to_the_form() {
    for key in [Key::Enter, Key::Char('n'), Key::Char('g'), Key::Escape, Key::Control('c')] {
        let mut robot = at_grants();
        robot.types("g");
        fills_in(&mut robot, [READER, "", ""]);
        robot.presses(key);
        assert!(robot.work().is_empty(), "{key:?}");
        assert!(matches!(robot.state.popups[..], [Popup::Form(..)]), "{key:?}");
        robot.presses(Key::Escape);
        assert!(robot.state.popups.is_empty());
    }
}

#[test]
fn a_wrong_field_is_named_and_gets_the_focus() {
    let own = fixtures::OWN.to_string();
    let cases = [
        (["0x12", "", ""], "40 hex"),
        (["0x5aAeb6053F3E94C9b9A09f33669435E7Ef1Beaed", "", ""], "checksum"),
        ([own.as_str(), "", ""], "your own address"),
        ([READER, "robot1", ""], "not a topic name"),
        ([READER, "", "soon"], "30d"),
    ];
    for (fields, wanted) in cases {
        let mut robot = at_grants();
        robot.types("g");
        fills_in(&mut robot, fields);
        assert!(robot.form_error().is_some_and(|error| error.contains(wanted)), "{fields:?}: {:?}", robot.form_error());
    }
}

#[test]
fn marked_topics_are_the_scope_of_a_grant() {
    let mut robot = Robot::at_work(true);
    robot.types("2");
    robot.site_answers(true);
    robot.types("/robot2");
    robot.presses(Key::Enter);
    robot.types(" g");
    let Some(Popup::Form(_, form)) = robot.state.popups.last() else { panic!("a form") };
    assert_eq!(form.text(1), "/robot2/odom");
}

#[test]
fn x_says_plainly_what_a_revoke_cannot_do() {
    let mut robot = at_grants();
    robot.types("x");
    let text = question(&robot).lines.join("\n");
    assert!(text.contains("already read cannot be recalled"), "{text}");
    assert!(text.contains("nobody but you"), "{text}");
    robot.types("x");
    assert!(robot.work().is_empty() && robot.state.popups.is_empty(), "the key that opened it is no yes");
    robot.types("xy");
    assert_eq!(robot.work(), [Tag::Revoke(fixtures::OTHER)]);
}

#[test]
fn only_an_active_grant_of_ones_own_can_be_revoked() {
    let mut robot = at_grants();
    robot.types("/revoked");
    robot.presses(Key::Enter);
    robot.types("x");
    assert_eq!(robot.message(), "revoke: not active");
    robot.presses(Key::Escape);
    robot.presses(Key::Escape);
    robot.types("/received");
    robot.presses(Key::Enter);
    robot.types("x");
    assert_eq!(robot.message(), "revoke: not given by you");
}
