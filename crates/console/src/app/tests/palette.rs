//! The palette and the help: every command by name, unavailable ones with the reason.

use super::Robot;
use crate::app::available::available;
use crate::app::{Key, Popup, Screen, VERBS, Verb};
use crate::popups::state::Palette;

fn names(robot: &Robot) -> Vec<&'static str> {
    match robot.state.popups.last() {
        Some(Popup::Palette(palette)) => palette.matches(&robot.state).iter().map(|entry| entry.name).collect(),
        _ => Vec::new(),
    }
}

#[test]
fn a_few_letters_find_a_command_and_enter_does_it() {
    let mut robot = Robot::at_work(true);
    robot.types(":gochain");
    assert_eq!(names(&robot)[0], "go-chain");
    robot.presses(Key::Enter);
    assert_eq!(robot.state.screen, Screen::Chain);
    assert!(robot.state.popups.is_empty());
}

#[test]
fn what_cannot_be_done_comes_last_and_says_why() {
    let mut robot = Robot::at_work(true);
    robot.types(":re");
    let found = names(&robot);
    let place = |name| found.iter().position(|other| *other == name).expect("listed");
    assert!(place("redraw") < place("revoke"));
    assert_eq!(available(&robot.state, Verb::Revoke), Err("other screen"));
}

#[test]
fn every_verb_can_be_tried_on_every_screen_without_harm() {
    for screen in Screen::all() {
        for entry in VERBS {
            for exists in [false, true] {
                let mut robot = Robot::at_work(exists);
                robot.act(crate::app::Action::Do(Verb::Go(screen)));
                robot.site_answers(exists);
                robot.act(crate::app::Action::Do(entry.verb));
                robot.presses(Key::Escape);
            }
        }
    }
}

#[test]
fn read_only_hides_what_changes_something() {
    let mut robot = Robot::at_work(true);
    robot.state.settings.read_only = true;
    let found = Palette::default().matches(&robot.state);
    assert!(!found.is_empty() && found.iter().all(|entry| !entry.changes));
}

#[test]
fn up_in_an_empty_palette_brings_back_what_was_typed_before() {
    let mut robot = Robot::at_work(true);
    let typed = |robot: &Robot| match robot.state.popups.last() {
        Some(Popup::Palette(palette)) => palette.field.text().to_owned(),
        other => panic!("no palette, but {other:?}"),
    };
    robot.types(":");
    robot.presses(Key::Up);
    assert_eq!(typed(&robot), "", "there is none yet");
    robot.presses(Key::Escape);
    for command in [":go-topics", ":columns hz", ":go-topics"] {
        robot.types(command);
        robot.presses(Key::Enter);
    }
    robot.types(":");
    let mut seen = Vec::new();
    for key in [Key::Up, Key::Up, Key::Up, Key::Down, Key::Down] {
        robot.presses(key);
        seen.push(typed(&robot));
    }
    assert_eq!(seen, ["go-topics", "columns hz", "columns hz", "go-topics", ""]);
    robot.types("re");
    robot.presses(Key::Down);
    assert_eq!(typed(&robot), "re", "what is typed is never replaced");
}
