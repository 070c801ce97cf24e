//! Columns of a list: chosen in a window or by name, kept for the next start, never too many for the terminal.

use super::*;
use crate::app::kept::{kept, recall};
use crate::popups::columns::state::{ALWAYS, offered, wanted};

fn at(screen: &str, columns: u16) -> Robot {
    let mut robot = Robot::at_work(true);
    robot.act(Action::Resize { columns, rows: 24 });
    robot.types(screen);
    robot.site_answers(true);
    robot
}

fn shown(robot: &Robot) -> Vec<&'static str> {
    let table = robot.state.table().expect("a list");
    wanted(robot.state.screen, table, crate::screens::pane::follow::list_width(&robot.state))
}

#[test]
fn space_hides_a_column_and_shows_it_again_in_its_place() {
    let mut robot = at("3", 80);
    assert_eq!(shown(&robot), ["state", "topic", "seq", "size", "time"]);
    robot.types("C");
    robot.types(" ");
    assert_eq!(shown(&robot), ["topic", "seq", "size", "time"]);
    robot.types("jj ");
    assert_eq!(shown(&robot), ["topic", "type", "seq", "size", "time"]);
    robot.types("kk ");
    assert_eq!(shown(&robot), ["state", "topic", "type", "seq", "size", "time"]);
    robot.presses(Key::Enter);
    assert!(robot.state.popups.is_empty());
    assert_eq!(shown(&robot).len(), 6, "enter keeps it");
}

#[test]
fn the_topic_stays_a_column_moves_and_esc_takes_everything_back() {
    let mut robot = at("3", 80);
    robot.types("Cj ");
    assert!(shown(&robot).contains(&ALWAYS), "the cursor is on it");
    robot.types(">>");
    assert_eq!(shown(&robot), ["state", "seq", "size", "topic", "time"]);
    robot.types("<<<<");
    assert_eq!(shown(&robot), ["topic", "state", "seq", "size", "time"]);
    robot.presses(Key::Escape);
    assert_eq!(shown(&robot), ["state", "topic", "seq", "size", "time"]);
    assert!(robot.state.table().expect("a list").columns.is_empty(), "it follows the terminal's width again");
}

#[test]
fn columns_are_named_in_the_palette_and_an_unknown_name_is_answered_with_all() {
    let mut robot = at("4", 80);
    robot.types(":columns size,topic,digest");
    robot.presses(Key::Enter);
    assert_eq!(shown(&robot), ["size", "topic", "digest"]);
    robot.types(":columns owner hz");
    robot.presses(Key::Enter);
    assert!(robot.message().contains("'hz'") && robot.message().contains("transaction"), "{}", robot.message());
    assert_eq!(shown(&robot), ["size", "topic", "digest"], "nothing changed");
    robot.types(":columns usual");
    robot.presses(Key::Enter);
    assert!(robot.state.table().expect("a list").columns.is_empty());
}

#[test]
fn each_screen_keeps_its_own_for_the_next_start() {
    let mut robot = at("2", 80);
    robot.types(":columns hz");
    robot.presses(Key::Enter);
    assert_eq!(shown(&robot), [ALWAYS, "hz"]);
    robot.types("s");
    assert_eq!(robot.state.topics.table.sort, 1, "sorting goes on");
    robot.types("3");
    assert_eq!(shown(&robot).len(), 5, "another list has its own");
    let text = serde_json::to_string(&kept(&robot.state)).expect("json");
    let mut state = State::new(Settings::default());
    recall(&mut state, &serde_json::from_str(&text).expect("reads"));
    assert_eq!(state.topics.table.columns, [ALWAYS, "hz"]);
    assert!(state.records.table.columns.is_empty());
    // A file of another version, or one that was edited.
    let odd =
        r#"{"screen":"Topics","tables":[{"filter":"","sort":0,"columns":["hz","wheels"]},{"filter":"","sort":0}]}"#;
    recall(&mut state, &serde_json::from_str(odd).expect("reads"));
    assert!(state.topics.table.columns.is_empty(), "what it does not know is left out");
}

#[test]
fn lists_without_a_choice_say_so() {
    let mut robot = at("5", 80);
    robot.act(Action::Do(crate::app::Verb::Columns));
    assert!(robot.state.popups.is_empty() && robot.message().contains("columns: other screen"), "{}", robot.message());
    for screen in Screen::all() {
        let names: Vec<&str> = offered(screen).iter().map(|column| column.name).collect();
        assert!(names.is_empty() || names.contains(&ALWAYS), "{screen:?}");
    }
}
