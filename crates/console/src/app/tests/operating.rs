//! Locking, undoing, deciding about the quarantine, browsing, acting on marked rows, resuming where one left.

use super::*;
use crate::app::Typed;
use crate::app::kept::{kept, recall};
use crate::model::Timestamp;
use crate::service::UploadQuery;
use crate::service::reply::TopicRow;

const MINUTE: u64 = 60_000_000_000;

fn guarded() -> Robot {
    let mut robot = Robot::opens(Settings { lock_after: Some(15 * MINUTE), ..Settings::default() });
    robot.site_answers(true);
    robot.waits(0);
    robot
}

/// Answers pulls with the fixtures, except that the identity is locked.
fn answers_locked(robot: &mut Robot) {
    robot.is_answered(&Tag::Lock, Ok(Reply::Identity(fixtures::identity(true, false, true))));
    let tag = robot.sent.iter().find(|(_, tag)| matches!(tag, Tag::Feed(crate::app::Feed::Identity, _)));
    let tag = tag.map(|(_, tag)| tag.clone()).expect("the identity is asked for anew");
    robot.is_answered(&tag, Ok(Reply::Identity(fixtures::identity(true, false, true))));
}

#[test]
fn a_quarter_of_an_hour_without_a_key_locks_and_takes_what_was_opened_off_the_screen() {
    let mut robot = guarded();
    robot.types("4");
    robot.site_answers(true);
    robot.types("o");
    let id = "00000000000003e8".to_owned();
    robot.is_answered(&Tag::Open(id), Ok(Reply::Opened(Box::new(fixtures::opened(1_000, false)))));
    assert!(record_shown(&robot.state).is_some());
    robot.waits(14 * 60);
    robot.presses(Key::Down);
    robot.waits(14 * 60);
    assert!(robot.work().is_empty(), "a key was pressed in time");
    robot.waits(61);
    assert_eq!(robot.work(), [Tag::Lock]);
    assert!(record_shown(&robot.state).is_none(), "nothing decrypted stays on the screen");
    answers_locked(&mut robot);
    assert!(robot.message().contains("capture"), "{}", robot.message());
    assert_eq!(crate::app::lock::due(&robot.state), None, "a locked keyring is not locked again");
    robot.presses(Key::Escape);
    robot.types("u");
    assert!(matches!(robot.state.popups.last(), Some(Popup::Form(..))), "it asks for the passphrase");
}

#[test]
fn a_clock_that_is_set_back_by_two_days_does_not_put_the_lock_off() {
    let mut robot = guarded();
    robot.act(Action::Tick(Timestamp(robot.state.now.0 - 48 * 60 * MINUTE)));
    robot.waits(15 * 60);
    assert_eq!(robot.work(), [Tag::Lock]);
    assert!(robot.message().contains("by this machine's clock"), "{}", robot.message());
}

#[test]
fn lock_is_a_command_of_the_palette_and_never_waits_for_its_key_to_be_pressed_twice() {
    let mut robot = guarded();
    robot.types(":lock");
    robot.presses(Key::Enter);
    assert!(matches!(robot.sent.last(), Some((Command::Lock, Tag::Lock))));
    robot.types("zx");
    assert_eq!(robot.work().len(), 1);
}

fn held() -> Robot {
    let mut robot = Robot::at_work(true);
    robot.types("2");
    robot.site_answers(true);
    robot.state.topics.set(vec![TopicRow { quarantined: 7, ..fixtures::topic("/robot1/odom", 20.0) }], fixtures::NOW);
    robot
}

#[test]
fn discarding_wants_the_topic_typed_and_releasing_a_y() {
    let mut robot = held();
    robot.types("D");
    robot.types("y");
    robot.presses(Key::Enter);
    assert!(robot.work().is_empty(), "y alone discards nothing");
    robot.presses(Key::Backspace);
    robot.types("/robot1/odom");
    robot.presses(Key::Enter);
    assert_eq!(robot.work(), [Tag::Discard("/robot1/odom".to_owned())]);
    let mut robot = held();
    robot.types("rr");
    assert!(robot.work().is_empty(), "the key that opened the question does not answer it");
    robot.types("ry");
    assert_eq!(robot.work(), [Tag::Release("/robot1/odom".to_owned())]);
    assert!(!Typed::new("word").is_done());
}

#[test]
fn a_watch_is_undone_truly_and_a_grant_only_by_another_transaction() {
    let mut robot = Robot::at_work(true);
    robot.types("2");
    robot.site_answers(true);
    robot.types("U");
    assert!(robot.message().contains("nothing to undo"));
    robot.types("w");
    let tag = robot.work().first().cloned().expect("something is watched or not");
    robot.is_answered(&tag, Ok(Reply::Done));
    robot.types("U");
    let (Tag::Watch(one) | Tag::Unwatch(one)) = &tag else { panic!("{tag:?}") };
    let back = robot.work();
    assert!(back == [Tag::Unwatch(one.clone())] || back == [Tag::Watch(one.clone())], "{back:?}");
    assert_ne!(back[0], tag);

    let mut robot = Robot::at_work(true);
    robot.state.undo = Some(crate::app::verb::Undo::Granted(fixtures::OTHER.to_string()));
    robot.types("U");
    let Some(Popup::Confirm(question)) = robot.state.popups.last() else { panic!("it asks") };
    assert!(question.lines.iter().any(|line| line.contains("cannot be taken back")));
}

#[test]
fn commands_act_on_the_marked_records() {
    let mut robot = Robot::at_work(true);
    robot.types("3");
    robot.site_answers(true);
    robot.types("  c");
    assert_eq!(robot.work().len(), 2, "two were marked");
    assert!(robot.work().iter().all(|tag| matches!(tag, Tag::Check(_))));
    assert_eq!(robot.state.records.table.marks.len(), 2, "and stay so");
}

fn asked(robot: &Robot) -> UploadQuery {
    let found = robot.sent.iter().rev().find_map(|(command, _)| match command {
        Command::ListShared(query) => Some(query.clone()),
        _ => None,
    });
    found.expect("the list is asked for")
}

#[test]
fn what_others_share_is_browsed_by_owner_type_tag_and_time() {
    let mut robot = Robot::at_work(true);
    robot.types("4");
    robot.site_answers(true);
    robot.types("b");
    robot.presses(Key::Down);
    robot.presses(Key::Enter);
    assert_eq!(asked(&robot).owner.and_then(|owner| owner.address()), Some(crate::model::Address([0xab; 20])));
    robot.types("/");
    robot.types(" type:nav_msgs/Odometry tag:mission=harbour since:2h");
    let query = asked(&robot);
    assert_eq!(query.type_name.map(|name| name.to_string()).as_deref(), Some("nav_msgs/Odometry"));
    assert_eq!(query.tags, [("mission".to_owned(), "harbour".to_owned())]);
    let since = query.since.expect("a time");
    assert_eq!(since, Timestamp(robot.state.now.0 - 120 * MINUTE), "to the moment, as on the command line");
    robot.site_answers(true);
    robot.waits(40);
    robot.hears_of(Part::Grants);
    assert_eq!(asked(&robot).since, Some(since), "and the same request for as long as the filter stays");
    robot.types(" until:40s");
    let query = asked(&robot);
    assert_eq!(query.until, Some(Timestamp(robot.state.now.0 - 40_000_000_000)));
    assert_eq!(
        query.since,
        Some(Timestamp(robot.state.now.0 - 120 * MINUTE)),
        "another filter counts from its own moment"
    );
}

#[test]
fn the_grant_form_says_from_which_moment_it_opens_records() {
    let mut robot = Robot::at_work(true);
    robot.types("2");
    robot.site_answers(true);
    robot.types("g");
    let Some(Popup::Form(_, form)) = robot.state.popups.last() else { panic!("a form") };
    let told = form.notes.join("\n");
    for line in [
        "now    from now on: a new key, nothing older",
        "epoch  since 2023-11-14 22:06:33 UTC, 8,505 records of all topics",
        "start  since 2023-11-10 22:13:20 UTC, 581,165 records of all topics",
    ] {
        assert!(told.contains(line), "{told}");
    }
    assert_eq!(form.text(3), "now", "the least is preset");
}

#[test]
fn a_new_console_begins_where_the_last_was_left() {
    let mut robot = Robot::at_work(true);
    robot.types("2");
    robot.site_answers(true);
    robot.types("s/robot1");
    robot.presses(Key::Enter);
    robot.types("zl");
    let left = kept(&robot.state);
    let text = serde_json::to_string(&left).expect("json");
    let mut state = State::new(Settings::default());
    recall(&mut state, &serde_json::from_str(&text).expect("reads"));
    assert_eq!((state.screen, state.topics.table.sort, state.local_time), (Screen::Topics, 1, true));
    assert_eq!(state.topics.table.filter.text(), "robot1");
    recall(
        &mut state,
        &serde_json::from_str(r#"{"screen":"Nowhere","tables":[{"filter":"x","sort":99}]}"#).expect("reads"),
    );
    assert_eq!((state.screen, state.topics.table.sort), (Screen::Topics, 0), "what makes no sense is left out");
    assert_eq!(state.clock(Timestamp::from_seconds(0)), "00:00:00", "without a zone UTC stands alone");
}

#[test]
fn an_age_goes_on_where_nothing_arrives_any_more() {
    let mut robot = Robot::at_work(true);
    robot.types("2");
    robot.site_answers(true);
    robot.waits(5);
    let second = 1_000_000_000;
    assert!(robot.state.deadline().is_some_and(|at| at.0 <= robot.state.now.0 + second), "each second at first");
    robot.waits(600);
    assert!(robot.state.deadline().is_some_and(|at| at.0 > robot.state.now.0), "then each minute");
    robot.types("7");
    robot.site_answers(true);
    robot.waits(10);
    assert_eq!(robot.state.deadline(), None, "and on other screens never");
}

#[test]
fn read_only_hides_and_refuses_what_changes() {
    let mut robot = Robot::opens(Settings { read_only: true, ..Settings::default() });
    robot.site_answers(true);
    robot.types("2");
    robot.site_answers(true);
    robot.types("pPrDw");
    assert!(robot.work().is_empty() && robot.state.popups.is_empty());
    robot.types(":suspend");
    let Some(Popup::Palette(palette)) = robot.state.popups.last() else { panic!("no palette") };
    assert!(!palette.matches(&robot.state).iter().any(|entry| entry.changes));
}

/// What was given to the clipboard last.
fn copied(robot: &Robot) -> Option<&str> {
    robot.effects.iter().rev().find_map(|effect| match effect {
        Effect::CopyText(text) => Some(text.as_str()),
        _ => None,
    })
}

#[test]
fn the_last_act_is_copied_as_a_command_line_whichever_it_was() {
    let mut robot = Robot::at_work(true);
    robot.types("zy");
    assert!(copied(&robot).is_none() && robot.message().contains("nothing was done yet"), "{}", robot.message());
    robot.types("2");
    robot.site_answers(true);
    robot.presses(Key::Down);
    robot.types("w");
    let [Tag::Watch(_) | Tag::Unwatch(_)] = &robot.work()[..] else { panic!("{:?}", robot.work()) };
    let topic = robot.state.topics.selected().map(|row| row.topic.clone()).expect("a topic");
    robot.types("zy");
    let line = copied(&robot).expect("copied").to_owned();
    assert!(line.starts_with("authros topics ") && line.ends_with(&format!("watch {topic}")), "{line}");
}

#[test]
fn a_question_that_wants_a_word_copies_its_command_without_being_answered() {
    let mut robot = held();
    robot.types("D");
    robot.presses(Key::Control('y'));
    assert_eq!(copied(&robot), Some("authros topics quarantine discard --topic /robot1/odom --yes"));
    assert!(robot.work().is_empty() && matches!(robot.state.popups.last(), Some(Popup::Confirm(_))));
}
