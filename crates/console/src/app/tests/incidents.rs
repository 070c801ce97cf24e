//! Incidents: kept from the row under the cursor, looked at, noted, closed, removed and exported.

use super::{Robot, fixtures};
use crate::app::{Effect, Key, Popup, Purpose, Screen, Tag};
use crate::model::{ErrorKind, Timestamp};
use crate::popups::incidents::state::Deed;
use crate::service::command::{EvidenceWishes, IncidentCommand};
use crate::service::{Command, Reply};

const MINUTE: u64 = 60_000_000_000;

fn at_the_list() -> Robot {
    let mut robot = Robot::at_work(true);
    robot.types("3zi");
    robot.site_answers(true);
    assert!(matches!(robot.state.popups.last(), Some(Popup::Incidents(_))));
    robot
}

fn sent(robot: &Robot) -> &IncidentCommand {
    match robot.sent.last() {
        Some((Command::OfIncident(command), _)) => command,
        other => panic!("{other:?}"),
    }
}

fn copied(robot: &Robot) -> &str {
    match robot.effects.last() {
        Some(Effect::CopyText(text)) => text,
        other => panic!("{other:?}"),
    }
}

fn tag(deed: Deed, name: &str) -> Tag {
    Tag::Incident(deed, name.parse().expect("a name"))
}

#[test]
fn one_key_fills_the_form_from_an_old_record_and_six_more_keep_it() {
    let mut robot = Robot::at_work(true);
    // An hour later the record lies back.
    robot.state.now = Timestamp(fixtures::NOW.0 + 60 * MINUTE);
    robot.types("3");
    robot.site_answers(true);
    robot.presses(Key::Down);
    robot.types("I");
    robot.site_answers(true);
    robot.types("crash");
    (0..4).for_each(|_| robot.presses(Key::Enter));
    robot.types("hit the wall, bay 3?");
    robot.presses(Key::Enter);
    // Record 999 was captured 49.95 s after the beginning: ten whole minutes before and after it.
    let IncidentCommand::OpenIncident { name, since, until, topics, note, robots: _ } = sent(&robot) else { panic!() };
    assert_eq!(name.as_str(), "crash");
    assert_eq!(since.to_string(), "2023-11-14T22:04:09Z");
    assert_eq!(until.map(|until| until.to_string()).as_deref(), Some("2023-11-14T22:24:09Z"));
    assert_eq!(topics.iter().map(ToString::to_string).collect::<Vec<_>>(), ["/robot1/odom"]);
    assert_eq!(note.as_deref(), Some("hit the wall, bay 3?"));
    robot.is_answered(&tag(Deed::Open, "crash"), Ok(Reply::Incident(fixtures::incident("crash", true))));
    assert_eq!(robot.message(), "incident crash: 1,234 records kept so far (U: undo)");
    robot.types("U");
    assert!(matches!(sent(&robot), IncidentCommand::RemoveIncident { name } if name.as_str() == "crash"));
}

#[test]
fn a_pattern_goes_into_it_as_it_is_for_topics_that_come_later() {
    let mut robot = Robot::at_work(true);
    robot.types("2");
    robot.site_answers(true);
    robot.types("I");
    robot.site_answers(true);
    for text in ["fall", "10m", "", "/robot*/camera/**", ""] {
        robot.presses(Key::Control('u'));
        robot.pastes(text);
        robot.presses(Key::Enter);
    }
    let IncidentCommand::OpenIncident { topics, .. } = sent(&robot) else { panic!() };
    assert_eq!(topics.iter().map(ToString::to_string).collect::<Vec<_>>(), ["/robot*/camera/**"]);
}

#[test]
fn marked_topics_go_into_it_and_it_goes_on_until_it_is_closed() {
    let mut robot = Robot::at_work(true);
    robot.types("2");
    robot.presses(Key::Down);
    robot.types("  I");
    robot.site_answers(true);
    let Some(Popup::Form(Purpose::OpenIncident, form)) = robot.state.popups.last() else { panic!("no form") };
    assert_eq!(form.text(1), "10m");
    assert_eq!(form.text(2), "");
    assert_eq!(form.text(3).split(' ').count(), 2, "{}", form.text(3));
    let offered = form.text(0).to_owned();
    (0..5).for_each(|_| robot.presses(Key::Enter));
    let IncidentCommand::OpenIncident { name, since, until: None, topics, note: None, robots: _ } = sent(&robot) else {
        panic!()
    };
    assert!(name.as_str() == offered && offered.ends_with("-1114-2213"), "{offered}");
    assert_eq!((since.0, topics.len()), (fixtures::NOW.0 - 10 * MINUTE, 2));
}

#[test]
fn what_is_refused_comes_back_as_it_was_filled_and_what_cannot_be_is_said_in_the_form() {
    let mut robot = at_the_list();
    robot.types("n");
    robot.types("crash-1114");
    (0..5).for_each(|_| robot.presses(Key::Enter));
    let error = robot.form_error().expect("the name is taken").to_owned();
    assert!(error.contains("crash-1114 already exists"), "{error}");
    for (field, text, word) in
        [(1, "2024-01-01", "in the future"), (2, "2h", "before it begins"), (3, "odom//", "odom")]
    {
        let mut robot = at_the_list();
        robot.types("nother");
        for _ in 0..field {
            robot.presses(Key::Enter);
        }
        robot.presses(Key::Control('u'));
        robot.pastes(text);
        for _ in field..5 {
            robot.presses(Key::Enter);
        }
        assert!(robot.form_error().is_some_and(|error| error.contains(word)), "{text}: {:?}", robot.form_error());
        assert!(robot.work().is_empty());
    }
    let mut robot = at_the_list();
    robot.types("nother");
    (0..5).for_each(|_| robot.presses(Key::Enter));
    robot.is_answered(&tag(Deed::Open, "other"), Err(fixtures::failure(ErrorKind::Input, "there are 200 incidents")));
    assert_eq!(robot.form_error(), Some("there are 200 incidents"));
    let Some(Popup::Form(Purpose::OpenIncident, form)) = robot.state.popups.last() else { panic!("no form") };
    assert_eq!(form.text(0), "other");
}

#[test]
fn a_note_is_added_and_stands_in_the_list() {
    let mut robot = at_the_list();
    robot.types("a");
    robot.types("the bumper was off");
    robot.presses(Key::Enter);
    let IncidentCommand::NoteIncident { name, text } = sent(&robot) else { panic!() };
    assert_eq!((name.as_str(), text.as_str()), ("crash-1114", "the bumper was off"));
    let mut view = fixtures::incident("crash-1114", true);
    let mut note = view.notes[0].clone();
    text.clone_into(&mut note.text);
    view.notes.push(note);
    robot.is_answered(&tag(Deed::Note, "crash-1114"), Ok(Reply::Incident(view)));
    assert!(matches!(robot.state.popups.last(), Some(Popup::Incidents(_))), "the list is there again");
    assert_eq!(robot.state.incidents.rows[0].notes[1].text, "the bumper was off");
}

#[test]
fn closing_and_removing_are_asked_about_and_a_closed_one_is_not_closed_again() {
    let mut robot = at_the_list();
    robot.types("c");
    robot.presses(Key::Escape);
    assert!(robot.work().is_empty(), "not closed without a y");
    robot.types("cY");
    assert_eq!(copied(&robot), "authros incident close crash-1114");
    robot.types("y");
    assert!(matches!(sent(&robot), IncidentCommand::CloseIncident { name } if name.as_str() == "crash-1114"));
    robot.is_answered(&tag(Deed::Close, "crash-1114"), Ok(Reply::Incident(fixtures::incident("crash-1114", false))));
    robot.types("c");
    assert!(matches!(robot.state.popups.last(), Some(Popup::Incidents(_))), "closed already");
    robot.types("xY");
    assert_eq!(copied(&robot), "authros incident remove crash-1114 --yes");
    robot.types("y");
    assert!(matches!(sent(&robot), IncidentCommand::RemoveIncident { name } if name.as_str() == "crash-1114"));
    robot.is_answered(&tag(Deed::Remove, "crash-1114"), Ok(Reply::Incidents(Vec::new())));
    assert!(robot.state.incidents.rows.is_empty());
}

#[test]
fn its_records_are_shown_and_its_commands_copied() {
    let mut robot = at_the_list();
    robot.types("jy");
    assert_eq!(copied(&robot), "authros incident show bump");
    robot.presses(Key::Enter);
    assert!(robot.state.popups.is_empty());
    assert_eq!(robot.state.screen, Screen::Records);
    let asked = robot.sent.iter().rev().find_map(|(command, _)| match command {
        Command::ListUploads(query) => query.incident.clone(),
        _ => None,
    });
    assert_eq!(asked.expect("asked by the incident").as_str(), "bump");
}

#[test]
fn while_it_is_looked_at_an_open_one_is_asked_for_again_and_nothing_else_is() {
    let mut robot = at_the_list();
    robot.waits(9);
    assert!(robot.sent.is_empty(), "{:?}", robot.sent);
    robot.waits(2);
    assert!(matches!(sent(&robot), IncidentCommand::ListIncidents));
    robot.site_answers(true);
    robot.types("q");
    robot.waits(30);
    assert!(!robot.sent.iter().any(|(command, _)| matches!(command, Command::OfIncident(_))));
}

#[test]
fn read_only_looks_at_them_and_changes_nothing() {
    let mut robot = at_the_list();
    robot.state.settings.read_only = true;
    for key in "nacx".chars() {
        robot.presses(Key::Char(key));
        assert!(matches!(robot.state.popups.last(), Some(Popup::Incidents(_))), "{key}");
    }
    robot.types("qI");
    assert!(robot.state.popups.is_empty());
    assert!(robot.message().contains("read-only"), "{}", robot.message());
}

fn question(robot: &Robot) -> String {
    let Some(Popup::Confirm(confirm)) = robot.state.popups.last() else { panic!("no question") };
    confirm.lines.join("\n")
}

fn exported(robot: &Robot) -> &EvidenceWishes {
    match robot.sent.last() {
        Some((Command::ExportEvidence(wishes), _)) => wishes,
        other => panic!("{other:?}"),
    }
}

#[test]
fn what_becomes_readable_is_counted_by_topic_and_typed_before_the_file_is_written() {
    let mut robot = at_the_list();
    robot.types("e");
    robot.presses(Key::Enter);
    robot.types("/robot?/odom");
    robot.presses(Key::Enter);
    let asked = question(&robot);
    assert!(asked.contains("Readable 1,234 messages of 1 topic, to everybody who gets the file:"), "{asked}");
    assert!(asked.contains("1,234 of /robot1/odom") && asked.contains("cannot be undone"), "{asked}");
    assert!(!asked.contains("/robot1/odm"), "a topic without records: {asked}");
    robot.types("y");
    robot.presses(Key::Enter);
    assert!(robot.work().is_empty(), "a y is not enough");
    robot.presses(Key::Control('u'));
    robot.presses(Key::Control('y'));
    let line = copied(&robot).to_owned();
    assert!(line.ends_with("crash-1114.authros --incident crash-1114 --reveal-topic '/robot?/odom' --yes"), "{line}");
    robot.types("disclose");
    robot.presses(Key::Enter);
    let wishes = exported(&robot);
    assert!(wishes.sure && !wishes.reveal_all && wishes.file.ends_with("crash-1114.authros"), "{wishes:?}");
    assert_eq!(wishes.incident.as_ref().map(|name| name.as_str()), Some("crash-1114"));
    assert_eq!(wishes.reveal_topics.iter().map(|one| one.as_str()).collect::<Vec<_>>(), ["/robot?/odom"]);
}

#[test]
fn an_export_that_discloses_nothing_is_a_y_and_a_topic_that_it_does_not_hold_is_refused() {
    let mut robot = at_the_list();
    robot.types("e");
    robot.presses(Key::Enter);
    robot.types("/robot2/*");
    robot.presses(Key::Enter);
    assert!(robot.form_error().is_some_and(|error| error.contains("holds no record of a topic that matches")));
    robot.presses(Key::Control('u'));
    robot.presses(Key::Enter);
    assert!(question(&robot).contains("Readable nothing: the messages stay sealed"), "{}", question(&robot));
    robot.types("y");
    let wishes = exported(&robot);
    assert!(!wishes.reveal_all && wishes.reveal_topics.is_empty() && wishes.reveal.is_empty(), "{wishes:?}");
    let mut robot = at_the_list();
    robot.types("e");
    robot.presses(Key::Enter);
    robot.types("all");
    robot.presses(Key::Enter);
    assert!(question(&robot).contains("1,234 of /robot1/odom"), "{}", question(&robot));
    robot.types("disclose");
    robot.presses(Key::Enter);
    assert!(exported(&robot).reveal_all);
}
