//! The pane beside a list on a wide terminal: it follows the cursor, sends a request when that rests, and forgets what
//! is locked.

use super::{Robot, fixtures};
use crate::app::{Action, Key, Screen, Tag};
use crate::service::{Part, Reply};

fn wide(screen: char) -> Robot {
    let mut robot = Robot::at_work(true);
    robot.act(Action::Resize { columns: 200, rows: 50 });
    robot.types(&screen.to_string());
    robot.site_answers(true);
    robot
}

fn beside(robot: &Robot) -> Vec<Tag> {
    robot.work().into_iter().filter(|tag| matches!(tag, Tag::Beside(..))).collect()
}

#[test]
fn the_pane_asks_for_the_record_that_the_cursor_rests_on_and_for_no_other() {
    let mut robot = wide('3');
    robot.waits(5);
    assert!(beside(&robot).is_empty(), "the first row follows the newest: nothing is asked for each that comes");
    for _ in 0..5 {
        robot.presses(Key::Down);
    }
    assert!(beside(&robot).is_empty(), "the cursor is moving");
    robot.waits(1);
    let wanted = Tag::Beside(Screen::Records, fixtures::record(995, "").id);
    assert_eq!(beside(&robot), std::slice::from_ref(&wanted));
    robot.is_answered(&wanted, Ok(Reply::Provenance(fixtures::provenance(995))));
    assert!(robot.state.detail.steps.as_ref().is_some_and(|steps| steps.found().is_some()));
    robot.presses(Key::Down);
    assert!(robot.state.detail.steps.is_none(), "what it said is of another record");
}

#[test]
fn while_an_answer_is_awaited_nothing_is_due_and_nothing_more_is_asked() {
    let mut robot = wide('3');
    for _ in 0..3 {
        robot.presses(Key::Down);
    }
    robot.waits(1);
    let asked = beside(&robot);
    assert_eq!(asked.len(), 1);
    robot.presses(Key::Down);
    robot.waits(1);
    assert_eq!(beside(&robot), asked);
    assert!(robot.state.deadline().is_none_or(|due| due > robot.state.now), "a console that waits sleeps");
}

#[test]
fn a_narrow_terminal_asks_for_nothing() {
    let mut robot = Robot::at_work(true);
    robot.types("3");
    robot.site_answers(true);
    robot.presses(Key::Down);
    robot.waits(5);
    assert!(beside(&robot).is_empty());
}

#[test]
fn a_record_of_others_is_opened_beside_the_list_and_gone_when_the_keys_are_locked() {
    let mut robot = wide('4');
    robot.presses(Key::Down);
    robot.waits(1);
    let tag = beside(&robot).pop().expect("asked for");
    robot.is_answered(&tag, Ok(Reply::Opened(Box::new(fixtures::opened(999, false)))));
    assert!(robot.state.detail.opening.as_ref().is_some_and(|opening| opening.lookup.found().is_some()));
    robot.types("zx");
    assert!(robot.state.detail.opening.is_none());
}

#[test]
fn a_record_still_on_its_way_is_asked_for_again_when_records_go_on() {
    let mut robot = wide('3');
    robot.presses(Key::Down);
    robot.waits(1);
    let tag = beside(&robot).pop().expect("asked for");
    let mut view = fixtures::provenance(999);
    view.record = fixtures::record(999, "stored");
    robot.is_answered(&tag, Ok(Reply::Provenance(view)));
    robot.hears_of(Part::Uploads);
    robot.waits(1);
    assert_eq!(beside(&robot), [tag]);
}
