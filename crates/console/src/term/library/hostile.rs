//! Hostile names on every screen, in every window, form and alert: no byte of them is a terminal's, each row is as wide
//! as the terminal, and no name moves its neighbours.

use std::collections::{BTreeMap, BTreeSet};

use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;
use unicode_width::UnicodeWidthStr;

use super::{Painter, Robot, Size, emulated, fixtures, rows, theme};
use crate::app::tests::infection;
use crate::app::tests::infection::names::{Hostile, foreign, harmless};
use crate::app::{Action, Feed, Field, Key, Popup, Purpose, Screen, State, Tag, VERBS, Verb};
use crate::model::ErrorKind;
use crate::popups;
use crate::screens::pane::follow::list_width;
use crate::service::reply::{AlertView, GrantRow, RecordView, RobotRow, SiteView, TopicRow};
use crate::service::{Event, NoticeLevel, Part, Reply};
use crate::term::encode::Depth;
use crate::term::renderer::{Scene, Wish};
use crate::ui::draw::draw;

static SIZES: [Size; 2] = [(80, 24), (200, 50)];
/// Names of an ordinary run's lists, and of the long one's.
const NAMES: (u64, u64) = (20_000, 1_000_000);
/// Rows of a list.
const ROWS: usize = 280;

fn is_long() -> bool {
    std::env::var_os("AUTHROS_LONG").is_some()
}

fn drawn(state: &State) -> Buffer {
    let (columns, rows) = state.size;
    let mut terminal = Terminal::new(TestBackend::new(columns, rows)).expect("a terminal");
    terminal.draw(|frame| drop(draw(frame, state, &theme("night", false)))).expect("drawn");
    terminal.backend().buffer().clone()
}

/// Marks that would pile up over other rows.
fn is_piled(character: char) -> bool {
    matches!(character, '\u{300}'..='\u{36f}' | '\u{64b}'..='\u{65f}' | '\u{e47}'..='\u{e4e}')
}

/// Every cell is clean; what a wide character hides is blank, and none reaches over the edge.
fn assert_whole(buffer: &Buffer, place: &str) {
    let (columns, rows) = (buffer.area().width, buffer.area().height);
    for row in 0..rows {
        let mut column = 0;
        while column < columns {
            let symbol = buffer[(column, row)].symbol();
            assert!(symbol.chars().all(harmless), "{place}: {symbol:?} in row {row}");
            assert!(symbol.chars().filter(|mark| is_piled(*mark)).count() <= 4, "{place}: {symbol:?} in row {row}");
            // A half-width voiced mark alone has a cell, though Unicode gives it no width.
            let width = u16::try_from(symbol.width().max(1)).expect("narrow");
            let hidden = column + 1..column + width;
            let is_blank = |hidden: u16| hidden < columns && buffer[(hidden, row)].symbol() == " ";
            assert!(hidden.clone().all(is_blank), "{place}: {symbol:?} at {column} in row {row} is half covered");
            column = hidden.end;
        }
        assert_eq!(column, columns, "{place}: row {row}");
    }
}

/// Which windows and forms were drawn. One that is forgotten here does not compile.
#[derive(Debug, Default)]
struct Seen {
    popups: BTreeSet<usize>,
    forms: BTreeSet<usize>,
}

const POPUPS: usize = 20;
const FORMS: usize = 16;

impl Seen {
    fn look(&mut self, state: &State, place: &str) {
        assert_whole(&drawn(state), place);
        let Some(popup) = state.popups.last() else { return };
        self.popups.insert(popup_number(popup));
        if let Popup::Form(purpose, _) = popup {
            self.forms.insert(form_number(*purpose));
        }
    }
}

#[deny(clippy::wildcard_enum_match_arm)]
fn popup_number(popup: &Popup) -> usize {
    match popup {
        Popup::Palette(_) => 0,
        Popup::Help(_) => 1,
        Popup::Confirm(_) => 2,
        Popup::Form(..) => 3,
        Popup::Provenance(_) => 4,
        Popup::Record(_) => 5,
        Popup::Chord(_) => 6,
        Popup::Themes(_) => 7,
        Popup::Columns(_) => 8,
        Popup::Publishers(_) => 9,
        Popup::Readers(_) => 10,
        Popup::Tasks => 11,
        Popup::Alerts(_) => 12,
        Popup::Unlocked => 13,
        Popup::Line(_) => 14,
        Popup::Browse(_) => 15,
        Popup::Contacts(_) => 16,
        Popup::Incidents(_) => 17,
        Popup::Robot(_) => 18,
        Popup::Quit(_) => 19,
    }
}

#[deny(clippy::wildcard_enum_match_arm)]
fn form_number(purpose: Purpose) -> usize {
    match purpose {
        Purpose::CreateIdentity => 0,
        Purpose::Unlock => 1,
        Purpose::Grant => 2,
        Purpose::Extend => 3,
        Purpose::LoadKey => 4,
        Purpose::ExportKey => 5,
        Purpose::Export => 6,
        Purpose::Administer(_) => 7,
        Purpose::AddContact => 8,
        Purpose::OpenIncident => 9,
        Purpose::NoteIncident => 10,
        Purpose::ExportEvidence => 11,
        Purpose::SetPolicy => 12,
        Purpose::Limit => 13,
        Purpose::Profile => 14,
        Purpose::Unpin => 15,
    }
}

/// The bytes of the whole frame, by the program's own encoder; and the rows of an emulated terminal that got them.
fn assert_sent_clean(state: State, place: &str) {
    let mut painter = Painter::new(Depth::True, state.size);
    let night = theme("night", false);
    let mut scene =
        Scene { state, theme: night, wish: Wish::Now, anew: true, extra: String::new(), suspended: false, over: false };
    assert_eq!(foreign(painter.paint(&mut scene).as_bytes()), None, "{place}");
    let columns = usize::from(scene.state.size.0);
    let terminal = emulated(scene.state, theme("night", false), Depth::True);
    for row in rows(&terminal, |cell| if cell.has_contents() { cell.contents().to_owned() } else { " ".into() }).lines()
    {
        assert!(row.width() <= columns, "{place}: {row:?}");
    }
}

#[test]
fn every_situation_with_hostile_names() {
    let mut seen = Seen::default();
    let rounds = if is_long() { 20 } else { 1 };
    for round in 0..rounds {
        for (name, begins) in super::all() {
            for size in SIZES {
                infection::begin(0x5eed + round);
                let robot = begins(size);
                let is_told = !["starting", "unlock-asked"].contains(&name);
                assert!(infection::end() > 0 || !is_told, "{name}: nothing was hostile");
                let place = format!("{name} at {}x{}, round {round}", size.0, size.1);
                seen.look(&robot.state, &place);
                assert_sent_clean(robot.state, &place);
            }
        }
    }
    assert!(seen.popups.len() > POPUPS / 2, "{seen:?}");
}

/// On that screen, with hostile answers to everything, and the cursor on a row.
fn at_work(screen: Screen, size: Size) -> Robot {
    let mut robot = super::sized(Robot::at_work(true), size);
    let name = || infection::name().expect("an infection");
    robot.hears_of(Part::Health);
    let alert = AlertView { key: name(), text: name(), ..fixtures::site_alert() };
    let site = SiteView { alerts: vec![alert], ..fixtures::site() };
    robot.is_answered(&Tag::Feed(Feed::Site, 0), Ok(Reply::Site(site)));
    fixtures::robots::at_the_gateway(&mut robot);
    robot.act(Action::Do(Verb::Go(screen)));
    robot.site_answers(true);
    let held = |row: TopicRow| TopicRow {
        watched: true,
        quarantined: 2,
        type_name: Some(name()),
        publishers: vec![name(), name()],
        unpinned: vec![name()],
        ..row
    };
    let now = robot.state.now;
    // Windows of a topic open for names of ROS alone.
    let topics = fixtures::topics().into_iter().filter(|row| row.simulated);
    robot.state.topics.set(topics.map(held).collect(), now);
    let (text, about) = (name(), Some(name()));
    robot.act(Action::Told(Event::Notice { at: now, level: NoticeLevel::Error, text, about }));
    match screen {
        Screen::Topics => robot.types("jj"),
        Screen::Records | Screen::Received | Screen::Robots | Screen::Log => robot.types("j"),
        Screen::Overview | Screen::Grants | Screen::Keys | Screen::Chain => {}
    }
    robot
}

/// Everything that was asked for; what has no fixture fails for a hostile reason.
fn answer_all(robot: &mut Robot) {
    robot.site_answers(true);
    for _ in 0..20 {
        let Some(tag) = robot.work().first().cloned() else { return };
        let result = match &tag {
            Tag::Show(_) | Tag::Beside(Screen::Records, _) => Ok(Reply::Provenance(fixtures::provenance(1_000))),
            Tag::Open(_) | Tag::Beside(Screen::Received, _) => {
                Ok(Reply::Opened(Box::new(fixtures::opened(1_000, false))))
            }
            Tag::Beside(Screen::Topics, topic) => Ok(Reply::Coverage(vec![super::coverage(topic)])),
            Tag::Publishers(topic) => Ok(Reply::Pins(fixtures::pins(topic))),
            Tag::Robot(_) => {
                let row = fixtures::robots::drifting("scout", 3, "refused", Some(2));
                Ok(Reply::Robot(fixtures::robots::view(row)))
            }
            _ => Err(fixtures::failure(ErrorKind::Refused, "refused")),
        };
        robot.is_answered(&tag, result);
        robot.site_answers(true);
    }
}

/// Nothing is open but what the verb opens.
fn begin(robot: &mut Robot, screen: Screen, verb: Verb) {
    robot.state.popups.clear();
    // One for each message, filter and mark.
    (0..12).for_each(|_| robot.presses(Key::Escape));
    robot.state.popups.clear();
    robot.state.go(screen);
    if let Some(table) = robot.state.table_mut() {
        (table.filter, table.filtering) = (Field::default(), false);
    }
    robot.act(Action::Do(verb));
    answer_all(robot);
}

/// Keys of one letter that the window in view names.
fn keys(state: &State) -> Vec<char> {
    let hints = state.popups.last().map(|popup| popups::hints(state, popup)).unwrap_or_default();
    let letters = hints.iter().flat_map(|(keys, _)| keys.split(' ')).filter_map(|key| {
        let mut letters = key.chars();
        letters.next().filter(|_| letters.next().is_none())
    });
    letters.filter(|letter| *letter != 'q').collect()
}

/// Opens what the verb opens, presses each of its keys, and types a hostile name into it.
fn walk(robot: &mut Robot, screen: Screen, verb: Verb, seen: &mut Seen) {
    let place = format!("{verb:?} on {screen:?} at {:?}", robot.state.size);
    begin(robot, screen, verb);
    seen.look(&robot.state, &place);
    for key in keys(&robot.state) {
        begin(robot, screen, verb);
        robot.presses(Key::Char(key));
        answer_all(robot);
        seen.look(&robot.state, &format!("{place}, then {key}"));
    }
    begin(robot, screen, verb);
    let name = infection::name().expect("an infection");
    robot.pastes(&name);
    seen.look(&robot.state, &format!("{place}, with {name:?}"));
    for _ in 0..4 {
        robot.presses(Key::Enter);
    }
    answer_all(robot);
    seen.look(&robot.state, &format!("{place}, entered with {name:?}"));
}

/// They change the screen, or what all others do.
fn is_walked(verb: Verb) -> bool {
    !matches!(verb, Verb::Go(_) | Verb::NextScreen | Verb::PreviousScreen | Verb::Lock | Verb::Freeze | Verb::EndTour)
}

#[test]
fn every_window_and_form_that_a_verb_opens_with_hostile_names() {
    let mut seen = Seen::default();
    infection::begin(0xbad);
    for (index, screen) in Screen::all().enumerate() {
        let sizes = if is_long() { &SIZES[..] } else { std::slice::from_ref(&SIZES[index % 2]) };
        for size in sizes {
            let mut robot = at_work(screen, *size);
            for entry in VERBS.iter().filter(|entry| is_walked(entry.verb)) {
                let is_here = entry.on.contains(&screen) || entry.on.is_empty() && index == 0;
                if is_here {
                    walk(&mut robot, screen, entry.verb, &mut seen);
                }
            }
            robot.state.popups.push(Popup::Alerts(0));
            seen.look(&robot.state, &format!("alerts on {screen:?}"));
            robot.state.popups.push(Popup::Chord(vec![Key::Char('z')]));
            seen.look(&robot.state, &format!("a chord on {screen:?}"));
            robot.state.popups.push(Popup::Unlocked);
            seen.look(&robot.state, &format!("an open keyring on {screen:?}"));
        }
    }
    for (name, begins) in super::all() {
        seen.look(&begins(SIZES[0]).state, name);
    }
    println!("{} hostile names in windows and forms", infection::end());
    let all = ((0..POPUPS).collect(), (0..FORMS).collect());
    assert_eq!((seen.popups, seen.forms), all, "each window and each form was drawn");
}

/// Lists of `ROWS` rows, each name by `name`.
fn lists(name: &mut dyn FnMut() -> String, size: Size) -> Robot {
    let mut robot = Robot::at_work(true);
    robot.act(Action::Resize { columns: size.0, rows: size.1 });
    fixtures::robots::at_the_gateway(&mut robot);
    robot.act(Action::Do(Verb::Go(Screen::Overview)));
    let mut topics = Vec::new();
    let (mut records, mut received, mut grants, mut robots) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for number in 0..ROWS {
        let base = fixtures::topic("/a", 20.1);
        topics.push(TopicRow { topic: name(), type_name: Some(name()), publishers: vec![name()], ..base });
        let base = fixtures::record(number as u64 + 1, "verified");
        records.push(RecordView { topic: name(), type_name: name(), ..base.clone() });
        received.push(RecordView { topic: name(), type_name: name(), owner: Some(fixtures::OTHER), ..base });
        let base = fixtures::grant("given", fixtures::OTHER, "active", 44);
        grants.push(GrantRow { topics: vec![name(), name()], ..base });
        let base = fixtures::robots::robot(&format!("robot-{number}"), u8::try_from(number % 200).expect("small"));
        robots.push(RobotRow { standing: name(), address: Some(name()), ..base });
        robot.state.log.notice(fixtures::NOW, NoticeLevel::Error, &name());
    }
    robot.state.topics.set(topics, fixtures::NOW);
    robot.state.records.rows = records;
    robot.state.received.rows = received;
    robot.state.grants.rows = grants;
    robot.state.gateway.set_robots(robots, None, fixtures::NOW);
    robot
}

/// What has the same place in every row of these lists, whatever the names are.
const FIXED: [&str; 5] = ["SIM", "20.1", "active", "22:13:", "728 B"];

/// The columns at which each of them begins in the list.
fn places(buffer: &Buffer, columns: u16) -> BTreeMap<&'static str, BTreeSet<u16>> {
    let mut places = BTreeMap::new();
    let symbol = |column: u16, row: u16| buffer.cell((column, row)).map_or("", |cell| cell.symbol());
    for word in FIXED {
        let is_here = |column: u16, row: u16| {
            (column..).zip(word.chars()).all(|(column, letter)| symbol(column, row).chars().eq([letter]))
        };
        // Below the bars and the heads of the columns, above messages and keys.
        let rows = 4..buffer.area().height.saturating_sub(5);
        let found = rows.flat_map(|row| (0..columns).filter(move |column| is_here(*column, row)));
        places.insert(word, found.collect::<BTreeSet<u16>>());
    }
    places
}

/// The screens of this robot, each with the places of what has to stay in place.
fn screens(robot: &mut Robot, names: &str) -> Vec<BTreeMap<&'static str, BTreeSet<u16>>> {
    let mut all = Vec::new();
    for screen in Screen::all() {
        robot.act(Action::Do(Verb::Go(screen)));
        let buffer = drawn(&robot.state);
        assert_whole(&buffer, &format!("{names} on {screen:?} at {:?}", robot.state.size));
        all.push(if screen.has_table() { places(&buffer, list_width(&robot.state)) } else { BTreeMap::new() });
    }
    all
}

#[test]
fn no_name_of_a_list_moves_its_neighbours() {
    let wanted = if is_long() { NAMES.1 } else { NAMES.0 };
    let sizes = SIZES.map(|(columns, _)| (columns, 300));
    let mut hostile = Hostile::new(19);
    let expected = sizes.map(|size| {
        let mut number = 0;
        let mut plain = || {
            number += 1;
            format!("plain{number}")
        };
        screens(&mut lists(&mut plain, size), "plain names")
    });
    for (size, expected) in sizes.iter().zip(&expected) {
        let shown: BTreeSet<&str> =
            expected.iter().flatten().filter(|(_, places)| !places.is_empty()).map(|(word, _)| *word).collect();
        assert_eq!(shown, BTreeSet::from(FIXED), "each is in some list at {size:?}");
    }
    while hostile.names < wanted {
        for (size, expected) in sizes.iter().zip(&expected) {
            let found = screens(&mut lists(&mut || hostile.name(), *size), "hostile names");
            for ((screen, found), expected) in Screen::all().zip(&found).zip(expected) {
                assert_eq!(found, expected, "{screen:?} at {size:?}");
            }
        }
    }
    println!("{} hostile names in lists", hostile.names);
}
