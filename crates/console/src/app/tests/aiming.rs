//! A live list: the record under the cursor stays in place, the first row follows the newest.

use super::{Robot, fixtures};
use crate::app::{Key, Popup, Tag};
use crate::service::reply::RecordPage;
use crate::service::{Command, Part, Reply, UploadQuery};

fn at_records() -> Robot {
    let mut robot = Robot::at_work(true);
    robot.types("3");
    robot.site_answers(true);
    robot
}

fn asked(robot: &Robot) -> UploadQuery {
    let found = robot.sent.iter().rev().find_map(|(command, _)| match command {
        Command::ListUploads(query) => Some(query.clone()),
        _ => None,
    });
    found.expect("records are asked for")
}

/// The site has received this many further records, and answers as a ledger does.
fn records_come(robot: &mut Robot, further: u64) {
    robot.hears_of(Part::Uploads);
    let query = asked(robot);
    let newest = 1_000 + further;
    let rows = (0..8_000).map(|place| fixtures::record(newest - place % newest, "verified"));
    let before = |until| move |record: &crate::service::reply::RecordView| record.captured_at < until;
    let rows: Vec<_> = match query.until {
        Some(until) => rows.filter(before(until)).take(query.limit).collect(),
        None => rows.take(query.limit).collect(),
    };
    let place = robot.sent.iter().position(|(command, _)| matches!(command, Command::ListUploads(_)));
    let (_, tag) = robot.sent.remove(place.expect("asked"));
    let page = Reply::Records(RecordPage { records: rows, next: Some("more".to_owned()), arriving: None });
    robot.act(crate::app::Action::Answered { tag, result: Box::new(Ok(page)) });
}

#[test]
fn the_first_row_follows_the_newest_record() {
    let mut robot = at_records();
    records_come(&mut robot, 40);
    assert_eq!(robot.state.row_key(), Some(fixtures::record(1_040, "").id));
}

#[test]
fn a_record_that_was_aimed_at_stays_under_the_cursor_and_on_its_line() {
    let mut robot = at_records();
    robot.presses(Key::Down);
    robot.presses(Key::Down);
    let aimed = robot.state.row_key();
    assert_eq!(aimed, Some(fixtures::record(998, "").id));
    for further in [40, 80, 4_000] {
        records_come(&mut robot, further);
        assert_eq!(robot.state.row_key(), aimed, "after {further} more");
        assert_eq!(robot.state.row_keys().iter().position(|key| Some(key) == aimed.as_ref()), Some(2));
    }
    robot.presses(Key::Enter);
    let wanted = fixtures::record(998, "").id;
    assert!(matches!(robot.state.popups.last(), Some(Popup::Provenance(lookup)) if lookup.id == wanted));
    robot.presses(Key::Escape);
    robot.presses(Key::Home);
    assert_eq!(asked(&robot).until, None, "home is the newest again");
}

#[test]
fn paging_back_stands_by_itself_and_paging_up_leads_to_the_newest() {
    let mut robot = at_records();
    robot.presses(Key::PageDown);
    robot.presses(Key::PageDown);
    assert!(asked(&robot).until.is_some() && asked(&robot).after.is_some());
    robot.site_answers(true);
    robot.presses(Key::PageUp);
    robot.site_answers(true);
    robot.presses(Key::PageUp);
    assert_eq!((asked(&robot).until, asked(&robot).after), (None, None));
}

#[test]
fn n_and_p_lead_from_record_to_record_without_closing() {
    let mut robot = at_records();
    robot.presses(Key::Enter);
    robot.types("n");
    let second = fixtures::record(999, "").id;
    assert!(matches!(&robot.state.popups[..], [Popup::Provenance(lookup)] if lookup.id == second));
    assert!(robot.work().contains(&Tag::Show(second)));
    robot.types("pp");
    let first = fixtures::record(1_000, "").id;
    assert!(matches!(&robot.state.popups[..], [Popup::Provenance(lookup)] if lookup.id == first), "there it ends");
}

#[test]
fn a_search_begins_anew_where_the_last_console_left_a_filter() {
    let mut robot = at_records();
    robot.types("/state:verified");
    robot.presses(Key::Enter);
    let kept = crate::app::kept::kept(&robot.state);
    let mut robot = Robot::at_work(true);
    crate::app::kept::recall(&mut robot.state, &kept);
    robot.types("/topic:/robot1/odom");
    assert_eq!(robot.state.records.table.filter.text(), "topic:/robot1/odom");
    robot.presses(Key::Enter);
    robot.types("/");
    robot.presses(Key::Up);
    assert_eq!(robot.state.records.table.filter.text(), "state:verified", "it is among the earlier ones");
}

#[test]
fn words_search_all_of_the_ledger_and_ids_the_page() {
    let mut robot = at_records();
    robot.types("/camera compressed verified 00003e8");
    robot.presses(Key::Enter);
    let query = asked(&robot);
    // One topic of that name is published, so that the request can name it.
    assert_eq!(query.topic.map(|topic| topic.to_string()).as_deref(), Some("/robot1/camera/compressed"));
    assert!(query.state.is_some() && query.words.is_empty());
    robot.presses(Key::Escape);
    robot.types("/odom image");
    robot.presses(Key::Enter);
    assert_eq!(asked(&robot).words, ["odom", "image"], "two topics have it, and types are searched too");
}

#[test]
fn marks_outlive_what_is_done_with_them() {
    let mut robot = Robot::at_work(true);
    robot.types("2");
    robot.site_answers(true);
    robot.types("/robot2");
    robot.presses(Key::Enter);
    robot.types(" w");
    assert_eq!(robot.state.topics.table.marks.len(), 1, "the next act is about the same topics");
}

#[test]
fn an_order_is_turned_round_and_says_so() {
    let mut robot = Robot::at_work(true);
    robot.types("2");
    robot.site_answers(true);
    let before = robot.state.row_keys();
    robot.types("S");
    let after: Vec<String> = before.into_iter().rev().collect();
    assert_eq!(robot.state.row_keys(), after);
}
