//! Records and shared records: pages, filters, provenance, opening, checking, writing.

use super::{Robot, fixtures, record_shown};
use crate::app::{Effect, Key, Popup, Tag};
use crate::model::{Address, ErrorKind, RecordState, Timestamp, Verdict};
use crate::ros::readable::{Raster, Readable};
use crate::service::reply::{CheckView, ContractAnswer};
use crate::service::{Command, Part, Reply, UploadQuery};

fn at(screen: char) -> Robot {
    let mut robot = Robot::at_work(true);
    robot.presses(Key::Char(screen));
    robot.site_answers(true);
    robot
}

fn asked(robot: &Robot) -> &UploadQuery {
    let query = robot.sent.iter().rev().find_map(|(command, _)| match command {
        Command::ListUploads(query) | Command::ListShared(query) => Some(query),
        _ => None,
    });
    query.expect("records were asked for")
}

#[test]
fn only_as_many_records_are_asked_for_as_fit_the_screen() {
    let mut robot = Robot::at_work(true);
    robot.types("3");
    assert_eq!((asked(&robot).limit, asked(&robot).newest_first), (18, true));
    robot.site_answers(true);
    robot.act(crate::app::Action::Resize { columns: 200, rows: 50 });
    assert_eq!(asked(&robot).limit, 44);
    robot.site_answers(true);
    assert_eq!(robot.state.records.rows.len(), 44);
}

#[test]
fn moving_past_the_end_turns_the_page_and_back() {
    let mut robot = at('3');
    robot.presses(Key::End);
    robot.presses(Key::Down);
    assert_eq!(asked(&robot).after.as_deref(), Some("982"));
    robot.site_answers(true);
    assert_eq!(robot.state.records.rows[0].seq, 982);
    robot.presses(Key::Up);
    assert_eq!(asked(&robot).after, None);
    robot.site_answers(true);
    assert_eq!(robot.state.records.rows[0].seq, 1_000);
}

#[test]
fn a_filter_asks_the_site_for_states_and_topics_and_narrows_the_page_by_the_rest() {
    let mut robot = at('3');
    robot.types("/verified robot2 000003e");
    robot.presses(Key::Enter);
    let query = asked(&robot);
    assert_eq!(query.state, Some(RecordState::Verified));
    assert_eq!(query.topic.as_ref().map(ToString::to_string).as_deref(), Some("/robot2/odom"));
    robot.site_answers(true);
    let shown = robot.state.records.visible(&robot.state.topics.rows).len();
    assert!(shown > 0 && shown < robot.state.records.rows.len());
    robot.presses(Key::Escape);
    assert_eq!(asked(&robot).state, None, "esc takes the filter away");
}

#[test]
fn spans_of_a_filter_are_exact_and_stay_the_same_request() {
    let mut robot = at('3');
    robot.types("/since:1m until:40s");
    robot.presses(Key::Enter);
    let (now, query) = (robot.state.now.0, asked(&robot).clone());
    assert!(!now.is_multiple_of(60_000_000_000), "else the test shows nothing");
    assert_eq!(query.since, Some(Timestamp(now - 60_000_000_000)));
    assert_eq!(query.until, Some(Timestamp(now - 40_000_000_000)));
    robot.site_answers(true);
    robot.waits(30);
    robot.hears_of(Part::Uploads);
    assert_eq!(asked(&robot), &query, "counted from when it was typed");
}

#[test]
fn a_filter_that_cannot_be_read_says_so_and_asks_for_nothing() {
    let mut robot = at('3');
    for (filter, said) in [
        ("unti:40s", "did you mean 'until:'?"),
        ("state:foo", "'foo' is not a state"),
        ("since:soon", "'soon' is not a time"),
        ("topic:odom", "must start with /"),
        ("colour:red", "use one of owner: topic:"),
    ] {
        robot.types("/");
        robot.presses(Key::Control('u'));
        let before = robot.sent.len();
        robot.pastes(filter);
        robot.presses(Key::Enter);
        let wrong = robot.state.records.wanted(&robot.state.topics.rows).expect_err(filter);
        assert!(wrong.message.contains(said), "{wrong}");
        let lists = robot.sent[before..].iter().filter(|(command, _)| matches!(command, Command::ListUploads(_)));
        assert_eq!(lists.count(), 0, "{filter}");
        assert!(robot.state.records.visible(&robot.state.topics.rows).is_empty());
    }
    robot.presses(Key::Escape);
    assert!(robot.state.records.wanted(&[]).is_ok());
}

#[test]
fn a_filter_takes_patterns_and_times_of_two_words() {
    let mut robot = at('3');
    robot.types("/robot:robot2 topic:/robot*/camera/** since:2023-11-14 08:30 until:2023-11-14 09:00:00.250 UTC");
    robot.presses(Key::Enter);
    let query = asked(&robot);
    assert_eq!(query.topic.as_ref().map(ToString::to_string).as_deref(), Some("/robot*/camera/**"));
    assert_eq!(query.robot.as_deref(), Some("robot2"));
    // date -u -d '2023-11-14T08:30Z' +%s
    assert_eq!(query.since, Some(Timestamp::from_seconds(1_699_950_600)));
    assert_eq!(query.until, Some(Timestamp(1_699_952_400_250_000_000)));
    assert!(query.words.is_empty());
}

#[test]
fn enter_shows_provenance_at_once_and_fills_it_when_it_comes() {
    let mut robot = at('3');
    robot.presses(Key::Enter);
    let Some(Popup::Provenance(lookup)) = robot.state.popups.last() else { panic!("no popup") };
    assert!(lookup.answer.is_none());
    let tag = Tag::Show("00000000000003e8".into());
    robot.is_answered(&tag, Ok(Reply::Provenance(fixtures::provenance(1_000))));
    let Some(Popup::Provenance(lookup)) = robot.state.popups.last() else { panic!("no popup") };
    assert_eq!(lookup.found().map(|found| found.steps.len()), Some(11));
    robot.hears_of(Part::Uploads);
    assert!(robot.work().is_empty(), "a verified record is not asked for again");
    robot.types("q");
    assert!(robot.state.popups.is_empty());
}

#[test]
fn an_answer_to_a_closed_popup_opens_nothing() {
    let mut robot = at('3');
    robot.presses(Key::Enter);
    robot.presses(Key::Escape);
    robot.is_answered(&Tag::Show("00000000000003e8".into()), Ok(Reply::Provenance(fixtures::provenance(1_000))));
    assert!(robot.state.popups.is_empty());
}

#[test]
fn a_shared_record_is_opened_and_its_picture_written() {
    let mut robot = at('4');
    robot.presses(Key::Enter);
    assert!(record_shown(&robot.state).is_some_and(|lookup| lookup.answer.is_none()));
    robot
        .is_answered(&Tag::Open("00000000000003e8".into()), Ok(Reply::Opened(Box::new(fixtures::opened(1_000, true)))));
    robot.types("W");
    let Some(Effect::WriteFiles { directory: None, files, .. }) = robot.effects.last() else {
        panic!("nothing written")
    };
    assert_eq!((files[0].name.as_str(), files[0].bytes.len()), ("robot1_camera_compressed-1000.jpg", 58_211));
}

#[test]
fn enter_gives_a_picture_the_whole_window_and_takes_it_back() {
    let mut robot = at('4');
    robot.presses(Key::Enter);
    let mut view = fixtures::opened(1_000, true);
    view.readable =
        Some(Readable { picture: Some(Raster { width: 1, height: 1, rgb: vec![0; 3] }), ..Readable::default() });
    robot.is_answered(&Tag::Open("00000000000003e8".into()), Ok(Reply::Opened(Box::new(view))));
    let alone = |robot: &Robot| match robot.state.popups.last() {
        Some(Popup::Record(opening)) => (opening.is_drawn(), opening.alone),
        other => panic!("no record, but {other:?}"),
    };
    assert_eq!(alone(&robot), (true, false));
    robot.presses(Key::Enter);
    assert_eq!(alone(&robot), (true, true));
    robot.presses(Key::Enter);
    assert_eq!(alone(&robot), (true, false));
    robot.presses(Key::Tab);
    robot.presses(Key::Enter);
    assert_eq!(alone(&robot), (false, false), "text stays below its heading");
}

#[test]
fn a_record_that_cannot_be_opened_says_why_in_its_place() {
    let mut robot = at('4');
    robot.presses(Key::Enter);
    let refusal = fixtures::failure(ErrorKind::Refused, "no grant covers this record");
    robot.is_answered(&Tag::Open("00000000000003e8".into()), Err(refusal));
    let lookup = record_shown(&robot.state).expect("open");
    assert!(matches!(&lookup.answer, Some(Err(failure)) if failure.message.contains("no grant")));
    robot.types("W");
    assert!(robot.effects.is_empty());
}

#[test]
fn a_check_that_finds_tampering_stays_until_seen() {
    let mut robot = at('4');
    robot.types("c");
    let tag = Tag::Check("00000000000003e8".into());
    let found = |verdict| CheckView {
        id: "3e8".into(),
        verdict,
        reason: None,
        digest: fixtures::record(1, "").digest,
        transaction: None,
        block: Some(7),
        contract: Some(ContractAnswer {
            reader: Address([1; 20]),
            owner: Address([2; 20]),
            authorised: verdict == Verdict::Verified,
            epoch: 3,
            count: 0,
            last: None,
        }),
    };
    robot.is_answered(&tag, Ok(Reply::Check(found(Verdict::Tampered))));
    robot.waits(100);
    assert!(robot.message().contains("tampered"));
    robot.presses(Key::Escape);
    robot.types("c");
    robot.is_answered(&tag, Ok(Reply::Check(found(Verdict::Verified))));
    assert!(robot.message().contains("verified, anchored in block 7, the contract lets you read epoch 3"));
    robot.waits(3);
    assert_eq!(robot.message(), "");
}
