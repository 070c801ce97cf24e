//! Keys typed ahead of the rows that they are for, as over a slow line.

use super::{Robot, fixtures};
use crate::app::{Action, Effect, Key, Popup, Tag};
use crate::model::ErrorKind;
use crate::service::reply::RecordPage;
use crate::service::{Command, Failure, Reply};

const BEFORE: &str = "00000000000003e8";

/// On Received, with a filter typed whose rows are not here yet.
fn filtered() -> Robot {
    let mut robot = Robot::at_work(true);
    robot.types("4");
    robot.site_answers(true);
    assert_eq!(robot.state.row_key().as_deref(), Some(BEFORE));
    robot.types("/camera");
    robot.presses(Key::Enter);
    robot
}

/// The newest request for the shared records is answered; those before it are, too.
fn rows_come(robot: &mut Robot, answer: &Result<u64, Failure>) {
    while let Some(place) = robot.sent.iter().position(|(command, _)| matches!(command, Command::ListShared(_))) {
        let (_, tag) = robot.sent.remove(place);
        let page =
            |seq: &u64| RecordPage { records: vec![fixtures::record(*seq, "verified")], next: None, arriving: None };
        let result = answer.as_ref().map(|seq| Reply::Records(page(seq))).map_err(Clone::clone);
        robot.act(Action::Answered { tag, result: Box::new(result) });
    }
}

fn opened(robot: &Robot) -> Vec<String> {
    let ids = robot.sent.iter().filter_map(|(_, tag)| match tag {
        Tag::Open(id) => Some(id.clone()),
        _ => None,
    });
    ids.collect()
}

fn said(robot: &Robot, text: &str) -> bool {
    robot.state.toasts.shown().is_some_and(|toast| toast.text.contains(text))
}

#[test]
fn a_record_is_opened_from_the_filtered_rows_and_never_from_those_before() {
    let mut robot = filtered();
    robot.types("o");
    assert!(opened(&robot).is_empty() && robot.state.popups.is_empty(), "the rows are not here");
    rows_come(&mut robot, &Ok(7));
    assert_eq!(opened(&robot), [fixtures::record(7, "").id]);
}

#[test]
fn the_keys_after_it_wait_too_and_come_in_their_order() {
    let mut robot = filtered();
    robot.types("oq5");
    assert_eq!(robot.state.screen.title(), "Received");
    rows_come(&mut robot, &Ok(7));
    assert_eq!(opened(&robot).len(), 1);
    assert!(robot.state.popups.is_empty(), "q closed what o opened");
    assert_eq!(robot.state.screen.title(), "Grants");
}

#[test]
fn a_second_filter_among_them_is_waited_for_as_well() {
    let mut robot = filtered();
    robot.types("o");
    robot.presses(Key::Escape);
    robot.types("o");
    robot.types("q/odom");
    robot.presses(Key::Enter);
    robot.types("o");
    rows_come(&mut robot, &Ok(7));
    assert_eq!(opened(&robot), [fixtures::record(7, "").id, fixtures::record(7, "").id]);
}

#[test]
fn what_waits_is_taken_back_and_ctrl_c_never_waits() {
    let mut robot = filtered();
    robot.types("o");
    robot.presses(Key::Escape);
    assert_eq!(robot.state.received.table.filter.text(), "camera", "esc takes back the key alone");
    rows_come(&mut robot, &Ok(7));
    assert!(opened(&robot).is_empty());

    let mut robot = filtered();
    robot.types("o");
    robot.presses(Key::Control('c'));
    let leaves = robot.effects.iter().any(|effect| matches!(effect, Effect::Quit));
    assert!(leaves || matches!(robot.state.popups.last(), Some(Popup::Quit(_))), "Ctrl-C leaves");
}

#[test]
fn rows_that_do_not_come_are_not_waited_for_without_end() {
    let mut robot = filtered();
    robot.types("o");
    robot.waits(2);
    assert!(!said(&robot, "not done"));
    robot.waits(2);
    assert!(said(&robot, "not done"));
    rows_come(&mut robot, &Ok(7));
    assert!(opened(&robot).is_empty());

    let mut robot = filtered();
    robot.types("o");
    rows_come(&mut robot, &Err(fixtures::failure(ErrorKind::Unreachable, "no answer")));
    assert!(opened(&robot).is_empty() && said(&robot, "not done"));
    robot.types("5");
    assert_eq!(robot.state.screen.title(), "Grants", "keys go on");
}

#[test]
fn the_first_rows_of_a_screen_are_waited_for() {
    let mut robot = Robot::at_work(true);
    robot.types("4o");
    assert!(opened(&robot).is_empty());
    rows_come(&mut robot, &Ok(7));
    assert_eq!(opened(&robot), [fixtures::record(7, "").id]);
}
