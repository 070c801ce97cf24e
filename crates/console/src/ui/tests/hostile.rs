//! Hostile text in every place the site can put text: no foreign control character reaches a cell.

use proptest::prelude::*;
use ratatui::Terminal;
use ratatui::backend::TestBackend;

use crate::app::tests::{Robot, fixtures};
use crate::app::{Action, Key, Lookup, Popup, Tag};
use crate::model::{ErrorKind, Verdict};
use crate::service::reply::{AlertView, GrantRow, PartHealth, RecordView, RobotRow, SiteView, TopicRow};
use crate::service::{Event, NoticeLevel, Part, Reply};
use crate::ui::Theme;
use crate::ui::draw::draw;

fn assert_harmless(robot: &Robot) {
    let theme = Theme::named("night").expect("embedded");
    let (columns, rows) = robot.state.size;
    let mut terminal = Terminal::new(TestBackend::new(columns, rows)).expect("a terminal");
    terminal.draw(|frame| drop(draw(frame, &robot.state, &theme))).expect("drawn");
    for cell in terminal.backend().buffer().content() {
        for character in cell.symbol().chars() {
            let foreign = character.is_control()
                || matches!(character, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}');
            assert!(!foreign, "{character:?}");
        }
    }
}

fn topic(text: &str) -> TopicRow {
    let text = || text.to_owned();
    TopicRow { topic: text(), type_name: Some(text()), publishers: vec![text()], ..fixtures::topic("/a", 1.0) }
}

fn record(text: &str) -> RecordView {
    let text = || text.to_owned();
    RecordView { topic: text(), type_name: text(), id: text(), ..fixtures::record(1, "") }
}

/// Puts `text` wherever the site can.
fn infect(robot: &mut Robot, text: &str) {
    let failure = fixtures::failure(ErrorKind::Refused, text);
    let site = SiteView {
        health: vec![PartHealth { text: text.to_owned(), part: text.to_owned(), ..fixtures::site().health[0].clone() }],
        alerts: vec![AlertView { key: text.to_owned(), text: text.to_owned(), ..fixtures::site_alert() }],
        ..fixtures::site()
    };
    robot.state.site = Some(site);
    robot.state.topics.rows = vec![topic(text), topic("/robot1/odom")];
    robot.state.records.rows = vec![record(text)];
    robot.state.received.rows = vec![record(text)];
    let mut incident = fixtures::incident("bump", true);
    incident.topics = vec![text.to_owned()];
    incident.notes.iter_mut().for_each(|note| text.clone_into(&mut note.text));
    incident.coverage.iter_mut().for_each(|one| text.clone_into(&mut one.topic));
    robot.state.incidents.set(vec![incident], fixtures::NOW);
    let grant = fixtures::grant("given", fixtures::OTHER, "active", 1);
    robot.state.grants.rows = vec![GrantRow { topics: vec![text.to_owned()], ..grant }];
    let row = fixtures::robots::drifting("scout", 3, text, Some(2));
    robot.state.gateway.set_robots(vec![RobotRow { address: Some(text.to_owned()), ..row }], None, fixtures::NOW);
    robot.state.log.notice(fixtures::NOW, NoticeLevel::Error, text);
    if let Some(chain) = &mut robot.state.chain {
        chain.client = text.to_owned();
        chain.balance = text.to_owned();
    }
    robot.act(Action::Told(Event::Notice {
        at: fixtures::NOW,
        level: NoticeLevel::Error,
        text: text.to_owned(),
        about: None,
    }));
    robot.hears_of(Part::Health);
    robot.is_answered(&Tag::Feed(crate::app::Feed::Site, 0), Err(failure));
}

fn open_everything(robot: &mut Robot, text: &str) {
    let mut opened = fixtures::opened(1, true);
    opened.record = record(text);
    opened.verdict = Verdict::Unanchored;
    opened.caller_id = text.to_owned();
    opened.tags = vec![(text.to_owned(), text.to_owned())];
    opened.fields = vec![(text.to_owned(), text.to_owned()); 3];
    robot.types("4");
    robot.presses(Key::Enter);
    assert_harmless(robot);
    if let Some((_, tag)) = robot.sent.iter().find(|(_, tag)| matches!(tag, Tag::Open(_))).cloned() {
        robot.is_answered(&tag, Ok(Reply::Opened(Box::new(opened))));
        assert_harmless(robot);
        robot.presses(Key::Escape);
    }
    robot.types("8");
    assert_harmless(robot);
    let row = fixtures::robots::drifting("scout", 3, text, Some(2));
    let mut view = fixtures::robots::view(row);
    (view.policy, view.refused, view.overruled) = (text.to_owned(), Some(text.to_owned()), vec![text.to_owned()]);
    view.enrolled = vec![text.to_owned()];
    view.topics.iter_mut().for_each(|topic| text.clone_into(&mut topic.topic));
    view.gateway.iter_mut().flat_map(|gateway| &mut gateway.addresses).for_each(|address| text.clone_into(address));
    robot.state.popups.push(Popup::Robot(Lookup { answer: Some(Ok(Box::new(view))), ..Lookup::new("scout") }));
    assert_harmless(robot);
    robot.types("q");
    robot.types("3zi");
    assert_harmless(robot);
    robot.types("q");
    robot.types("2wg");
    assert_harmless(robot);
    robot.pastes(text);
    assert_harmless(robot);
}

/// Names drawn at once; with `AUTHROS_LONG=1` so many times that it is a million.
const AT_ONCE: u64 = 500;

/// A name of characters that a terminal may take for commands, of bidirectional marks, and of wide and plain letters.
fn hostile_name(random: &mut u64) -> String {
    let mut next = || {
        *random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        *random >> 33
    };
    let length = next() % 12 + 1;
    let character = |next: &mut dyn FnMut() -> u64| {
        let drawn = next();
        let point = match drawn % 6 {
            0 => next() % 0x20,
            1 => 0x7f + next() % 0x21,
            2 => 0x200b + next() % 5,
            3 => 0x2028 + next() % 0x48,
            4 => 0x673a,
            _ => 0x20 + next() % 0x5f,
        };
        u32::try_from(point).ok().and_then(char::from_u32).unwrap_or('x')
    };
    (0..length).map(|_| character(&mut next)).chain("\u{1b}]52;c;eA==\u{7}".chars()).collect()
}

#[test]
fn a_million_hostile_names_draw_no_control_character() {
    let rounds = if std::env::var_os("AUTHROS_LONG").is_some() { 1_000_000 / AT_ONCE } else { 2 };
    let mut random = 19;
    for _ in 0..rounds {
        let names: Vec<String> = (0..AT_ONCE).map(|_| hostile_name(&mut random)).collect();
        assert!(names.iter().all(|name| name.contains('\u{1b}')), "the names are hostile");
        let mut robot = Robot::at_work(true);
        robot.act(Action::Resize { columns: 100, rows: 540 });
        infect(&mut robot, &names[0]);
        robot.state.topics.rows = names.iter().map(|name| topic(name)).collect();
        robot.state.records.rows = names.iter().map(|name| record(name)).collect();
        robot.state.received.rows = names.iter().map(|name| record(name)).collect();
        let grant = |name: &String| {
            let row = fixtures::grant("given", fixtures::OTHER, "active", 1);
            GrantRow { topics: vec![name.clone()], ..row }
        };
        robot.state.grants.rows = names.iter().map(grant).collect();
        names.iter().for_each(|name| robot.state.log.notice(fixtures::NOW, NoticeLevel::Error, name));
        for screen in '1'..='9' {
            robot.presses(Key::Char(screen));
            assert_harmless(&robot);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]
    #[test]
    fn no_foreign_control_reaches_a_cell(text in "(\\PC|[\u{0}-\u{1f}\u{7f}-\u{9f}\u{200b}-\u{200f}\u{202a}-\u{202e}\u{2066}-\u{2069}\u{feff}]|机|é){0,60}") {
        let mut robot = Robot::at_work(true);
        for screen in '1'..='9' {
            robot.presses(Key::Char(screen));
            robot.site_answers(true);
        }
        infect(&mut robot, &text);
        for screen in '1'..='9' {
            robot.presses(Key::Char(screen));
            assert_harmless(&robot);
        }
        open_everything(&mut robot, &text);
    }
}
