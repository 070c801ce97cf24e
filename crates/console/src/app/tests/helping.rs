//! `?` helps everywhere, and never leaves by accident.

use super::Robot;
use crate::app::{Key, Popup};
use crate::popups::state::Help;

fn help(robot: &Robot) -> &Help {
    match robot.state.popups.last() {
        Some(Popup::Help(help)) => help,
        other => panic!("no help, but {other:?}"),
    }
}

#[test]
fn in_a_window_it_tells_the_keys_of_that_window_and_q_leads_back_to_it() {
    let openings = [("3", "\r"), ("2", "i"), ("7", "t"), ("4", "b"), ("5", "x"), ("1", "T")];
    for (screen, key) in openings {
        let mut robot = Robot::at_work(true);
        robot.types(screen);
        robot.site_answers(true);
        if key == "\r" {
            robot.presses(Key::Enter)
        } else {
            robot.types(key)
        }
        assert_eq!(robot.state.popups.len(), 1, "{key}");
        robot.types("?");
        assert!(help(&robot).window.as_ref().is_some_and(|keys| !keys.is_empty()), "{key}");
        robot.types("?");
        assert_eq!(robot.state.popups.len(), 1, "{key}: the window is still there");
        robot.types("?q");
        assert_eq!(robot.state.popups.len(), 1, "{key}: q closes the help alone");
        assert!(robot.work().iter().all(|tag| !tag.is_work()), "{key}");
    }
}

#[test]
fn a_letter_of_another_screen_says_where_it_works_and_one_of_no_screen_says_nothing() {
    let mut robot = Robot::at_work(true);
    robot.types("3");
    robot.types("L");
    assert!(robot.message().starts_with("L works on ") && robot.message().contains("Keys (6)"), "{}", robot.message());
    let mut robot = Robot::at_work(true);
    robot.types("3%");
    assert_eq!(robot.message(), "");
}

#[test]
fn where_text_is_typed_a_question_mark_is_text() {
    let mut robot = Robot::at_work(false);
    robot.types("n?");
    let Some(Popup::Form(_, form)) = robot.state.popups.last() else { panic!("a form") };
    assert_eq!(form.text(0), "?", "a passphrase may begin with it");
    let mut robot = Robot::at_work(true);
    robot.types("g?");
    assert!(help(&robot).window.is_some(), "no address begins with it");
}

#[test]
fn help_is_filtered_by_words_and_esc_takes_the_filter_first() {
    let mut robot = Robot::at_work(true);
    robot.types("2?/watch");
    assert!(help(&robot).filtering && help(&robot).filter.text() == "watch");
    robot.presses(Key::Enter);
    robot.presses(Key::Down);
    assert_eq!(help(&robot).scroll, 1);
    robot.presses(Key::Escape);
    assert_eq!(help(&robot).filter.text(), "");
    robot.presses(Key::Escape);
    assert!(robot.state.popups.is_empty() && robot.effects.is_empty());
}
