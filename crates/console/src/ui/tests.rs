//! Every screen and popup as text at operators' usual sizes, and hostile text on all of them.

mod graphs;
mod hostile;
mod rows;

use ratatui::Terminal;
use ratatui::backend::TestBackend;

use super::Theme;
use super::draw::draw;
use crate::app::tests::{Robot, fixtures};
use crate::app::{Action, Feed, Key, Screen, Settings, State, Tag};
use crate::model::ErrorKind;
use crate::service::reply::{HealthLevel, LifeLine, PartHealth, SiteView};
use crate::service::{Event, NoticeLevel, Part, Reply};

const SIZES: [(u16, u16); 3] = [(80, 24), (120, 40), (60, 18)];

/// The state drawn at its size, as text.
fn shown(state: &State, theme: &Theme) -> String {
    let (columns, rows) = state.size;
    let mut terminal = Terminal::new(TestBackend::new(columns, rows)).expect("a terminal");
    terminal.draw(|frame| drop(draw(frame, state, theme))).expect("drawn");
    let buffer = terminal.backend().buffer();
    let line = |row: u16| -> String { (0..columns).map(|column| buffer[(column, row)].symbol()).collect() };
    (0..rows).map(|row| line(row).trim_end().to_owned() + "\n").collect()
}

fn night() -> Theme {
    Theme::named("night").expect("embedded")
}

/// A console at work, with that size, on that screen.
fn at(screen: Screen, (columns, rows): (u16, u16)) -> Robot {
    let mut robot = Robot::at_work(true);
    robot.act(Action::Resize { columns, rows });
    robot.act(Action::Do(crate::app::Verb::Go(screen)));
    robot.site_answers(true);
    robot
}

fn compare(name: &str, text: &str) {
    let mut settings = insta::Settings::clone_current();
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    settings.set_snapshot_path("snapshots");
    settings.bind(|| insta::assert_snapshot!(name, text));
}

/// Who can read, who publishes, what is running, what is shared, and a question that requires a word. Takes the name of
/// a situation, its screen, and what brings it about.
type Situations<'a> = dyn FnMut(&'static str, Screen, &dyn Fn(&mut Robot)) + 'a;

fn situations(add: &mut Situations<'_>) {
    add("readers", Screen::Topics, &|robot| robot.types("i"));
    add("publishers", Screen::Topics, &|robot| {
        robot.presses(Key::Down);
        robot.presses(Key::Enter);
        let topic = robot.state.topics.selected().map(|row| row.topic.clone()).expect("a topic");
        robot.is_answered(&Tag::Publishers(topic.clone()), Ok(Reply::Pins(fixtures::pins(&topic))));
    });
    add("tasks", Screen::Chain, &|robot| {
        robot.types("t");
        robot.site_answers(true);
    });
    add("contacts", Screen::Grants, &|robot| {
        robot.types("c");
        robot.site_answers(true);
    });
    add("incident opened", Screen::Records, &|robot| {
        robot.presses(Key::Down);
        robot.types("I");
        robot.site_answers(true);
    });
    add("browse", Screen::Received, &|robot| robot.types("b"));
    add("suspend asked", Screen::Chain, &|robot| {
        robot.types(":suspend");
        robot.presses(Key::Enter);
        robot.types("0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed");
        robot.presses(Key::Enter);
    });
}

/// The remedy is readable where the trouble is shown, and enter shows all of it.
#[test]
fn what_to_do_about_a_lost_chain_is_not_cut_at_80_columns() {
    let remedy = "authros --home NEW records import OLD";
    let text = format!(
        "start the pinned chain, or `{remedy}` (seals all messages in a new home): the chain at http://127.0.0.1:27545 is \
         another one, its genesis block is 0x2a8339d8473486956bee9f…, not 0x3b8339d8473486956bee9f…; anchoring has stopped, \
         nothing is lost"
    );
    let mut robot = at(Screen::Overview, (80, 24));
    let mut site = fixtures::site();
    let chain = site.health.iter_mut().find(|part| part.part == "chain").expect("a chain");
    (chain.level, chain.text) = (HealthLevel::Failed, text);
    robot.hears_of(Part::Health);
    robot.is_answered(&Tag::Feed(Feed::Site, 0), Ok(Reply::Site(site)));
    let overview = shown(&robot.state, &night());
    let health = overview.lines().find(|line| line.starts_with("chain")).expect("a row");
    assert!(health.contains(remedy), "{overview}");
    robot.presses(Key::Enter);
    let popup = shown(&robot.state, &night());
    let inside = |line: &str| Some(line.split_once('│')?.1.rsplit_once('│')?.0.to_owned());
    let lines: Vec<String> = popup.lines().filter_map(inside).collect();
    let words = lines.join(" ").split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(words.contains(remedy) && words.contains("nothing is lost"), "{popup}");
}

#[test]
fn every_screen_at_every_size() {
    for screen in Screen::all() {
        let pages = SIZES.map(|size| {
            let state = at(screen, size).state;
            format!("{}x{}\n{}", size.0, size.1, shown(&state, &night()))
        });
        compare(&screen.title().to_lowercase(), &pages.join("\n"));
    }
}

#[test]
fn a_click_on_a_screens_name_goes_there() {
    for size in SIZES.into_iter().filter(|size| size.0 >= 80) {
        for screen in Screen::all() {
            let mut robot = at(Screen::Overview, size);
            let shown = shown(&robot.state, &night());
            let bar = shown.lines().nth(1).expect("the names of the screens");
            let column = u16::try_from(bar.find(screen.title()).expect(bar)).expect("narrow");
            robot.act(Action::Click { column, row: 1 });
            assert_eq!(robot.state.screen, screen, "{size:?}: {bar}");
        }
    }
}

/// Lists with their pane, and the Overview with graphs of what flowed.
#[test]
fn the_bars_at_120_columns_say_what_is_used_most_and_are_not_cut() {
    let bars = |screen: Screen| {
        let shown = shown(&at(screen, (120, 30)).state, &night());
        let bar = shown.trim_end().lines().last().unwrap_or_default().trim_end().to_owned();
        assert!(bar.chars().count() <= 120 && !bar.contains('…'), "{bar}");
        assert!(bar.ends_with("? help  q quit"), "{}: {bar}", screen.title());
        format!("{}\n{bar}", screen.title())
    };
    let screens = [Screen::Overview, Screen::Topics, Screen::Records, Screen::Received, Screen::Grants];
    let others = [Screen::Keys, Screen::Chain, Screen::Robots, Screen::Log];
    let all: Vec<String> = screens.into_iter().chain(others).map(bars).collect();
    for (screen, words) in [(1, ["w watch", "g grant"]), (2, ["o open", "e export"]), (4, ["x revoke", "e extend"])] {
        assert!(words.iter().all(|word| all[screen].contains(word)), "{}", all[screen]);
    }
    compare("bars-120", &all.join("\n"));
}

#[test]
fn a_wide_terminal_is_used() {
    let size = (160, 40);
    let mut pages = Vec::new();
    let mut page = |robot: &Robot| {
        pages.push(format!("{}\n{}", robot.state.screen.title(), shown(&robot.state, &night())));
    };
    page(&flowing(size));
    for screen in [Screen::Topics, Screen::Grants, Screen::Log] {
        page(&at(screen, size));
    }
    let mut robot = at(Screen::Records, size);
    robot.presses(Key::Down);
    robot.waits(1);
    let tag = Tag::Beside(Screen::Records, fixtures::record(999, "").id);
    robot.is_answered(&tag, Ok(Reply::Provenance(fixtures::provenance(999))));
    page(&robot);
    for camera in [false, true] {
        let mut robot = at(Screen::Received, size);
        robot.presses(Key::Down);
        robot.waits(1);
        let tag = Tag::Beside(Screen::Received, fixtures::record(999, "").id);
        robot.is_answered(&tag, Ok(Reply::Opened(Box::new(fixtures::opened(999, camera)))));
        page(&robot);
    }
    compare("wide", &pages.join("\n"));
    compare("flow", &SIZES.map(|size| shown(&flowing(size).state, &night())).join("\n"));
}

/// Ten minutes at 44 records a second, then two in which nothing came.
fn flowing(size: (u16, u16)) -> Robot {
    let mut robot = at(Screen::Overview, size);
    robot.sees_records_flow(600);
    robot.waits(120);
    robot
}

#[test]
fn graphs_stand_still_when_nothing_is_left_in_them() {
    let mut robot = flowing(SIZES[0]);
    assert!(robot.state.deadline().is_some(), "the stop moves through the graph");
    robot.waits(3_600);
    assert_eq!(robot.state.deadline(), None);
    let text = shown(&robot.state, &night());
    assert!(text.contains("pending") && text.contains("none verified"), "what waits is still drawn: {text}");
}

/// One popup each, opened by keys.
fn popups() -> Vec<(&'static str, Robot)> {
    let size = SIZES[0];
    let mut popups = Vec::new();
    let mut add = |name, screen, open: &dyn Fn(&mut Robot)| {
        let mut robot = at(screen, size);
        open(&mut robot);
        popups.push((name, robot));
    };
    add("palette", Screen::Overview, &|robot| robot.types(":re"));
    add("help", Screen::Topics, &|robot| robot.types("?"));
    add("grant", Screen::Grants, &|robot| robot.types("g"));
    add("grant refused", Screen::Grants, &|robot| {
        robot.types("g0x12");
        for _ in 0..4 {
            robot.presses(Key::Enter);
        }
    });
    add("grant asked", Screen::Grants, &|robot| {
        robot.types("g0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed");
        for _ in 0..4 {
            robot.presses(Key::Enter);
        }
    });
    add("revoke asked", Screen::Grants, &|robot| robot.types("x"));
    add("load key", Screen::Keys, &|robot| robot.types("L"));
    add("rotation asked", Screen::Keys, &|robot| robot.types("r"));
    add("provenance", Screen::Records, &|robot| {
        robot.presses(Key::Enter);
        robot.is_answered(&Tag::Show("00000000000003e8".into()), Ok(Reply::Provenance(fixtures::provenance(1_000))));
    });
    situations(&mut add);
    for (name, camera) in [("odometry", false), ("picture", true)] {
        add(name, Screen::Received, &move |robot| {
            robot.presses(Key::Enter);
            let opened = fixtures::opened(1_000, camera);
            robot.is_answered(&Tag::Open("00000000000003e8".into()), Ok(Reply::Opened(Box::new(opened))));
        });
    }
    popups
}

#[test]
fn every_popup() {
    let pages: Vec<String> =
        popups().iter().map(|(name, robot)| format!("{name}\n{}", shown(&robot.state, &night()))).collect();
    compare("popups", &pages.join("\n"));
}

#[test]
fn incidents_at_every_size() {
    let pages = SIZES.into_iter().chain([(200, 50)]).map(|size| {
        let mut robot = at(Screen::Records, size);
        robot.types("zi");
        robot.site_answers(true);
        let list = shown(&robot.state, &night());
        robot.types("?");
        let help = shown(&robot.state, &night());
        assert!(help.contains("End its span now; its records stay"), "{help}");
        robot.types("?n");
        format!("{}x{}\n{list}\n{}", size.0, size.1, shown(&robot.state, &night()))
    });
    compare("incidents", &pages.collect::<Vec<_>>().join("\n"));
}

#[test]
fn before_during_and_in_trouble() {
    let mut pages = Vec::new();
    let mut page = |name: &str, state: &State| pages.push(format!("{name}\n{}", shown(state, &night())));
    let starting = Robot::opens(Settings::default());
    page("starting", &starting.state);
    let mut fresh = Robot::at_work(false);
    page("a new profile", &fresh.state);
    fresh.types("n");
    fresh.types("correct horse");
    page("its passphrase", &fresh.state);
    page("in trouble", &in_trouble().state);
    let mut leaving = in_trouble();
    leaving.types("fq");
    page("leaving, frozen", &leaving.state);
    let mut small = at(Screen::Topics, (59, 18));
    small.state.size = (59, 18);
    page("too small", &small.state);
    compare("states", &pages.join("\n"));
}

fn in_trouble() -> Robot {
    let mut robot = Robot::at_work(true);
    robot.hears_of(Part::Health);
    let mut site = SiteView {
        life: LifeLine {
            captured: 12_403,
            pending: 45,
            tampered: 1,
            dropped: 12,
            lost_in_transport: 3,
            ..fixtures::site().life
        },
        ..fixtures::site()
    };
    site.health[1].level = HealthLevel::Waiting;
    site.health[1].text = "retry in 4 s".to_owned();
    site.health[2].level = HealthLevel::Failed;
    site.health[2].text = "the disk of /srv/authros is full; free some space".to_owned();
    robot.is_answered(&Tag::Feed(Feed::Site, 0), Ok(Reply::Site(site)));
    let text = "chain: http://127.0.0.1:8545 does not answer, so nothing is anchored there; start the node again \
                and the chain goes on by itself, nothing sealed is lost meanwhile";
    let notice = Event::Notice { at: fixtures::NOW, level: NoticeLevel::Error, text: text.to_owned(), about: None };
    robot.act(Action::Told(notice));
    robot
}

#[test]
fn kept_proofs_are_in_the_first_line_when_they_are_not_well() {
    for (level, is_told) in [(HealthLevel::Ok, false), (HealthLevel::Waiting, true)] {
        let (mut robot, mut site) = (at(Screen::Topics, SIZES[0]), fixtures::site());
        let proofs =
            PartHealth { part: "proofs".to_owned(), level, text: "none kept yet".to_owned(), ..site.health[0].clone() };
        site.health.push(proofs);
        robot.hears_of(Part::Health);
        robot.is_answered(&Tag::Feed(Feed::Site, 0), Ok(Reply::Site(site)));
        let text = shown(&robot.state, &night());
        assert_eq!(text.lines().next().is_some_and(|line| line.contains("proofs")), is_told, "{text}");
    }
}

#[test]
fn a_failed_list_says_why_in_its_place() {
    let mut robot = Robot::at_work(true);
    robot.types("7");
    let tag = Tag::Feed(Feed::Chain, 0);
    robot.is_answered(&tag, Err(fixtures::failure(ErrorKind::Unreachable, "http://127.0.0.1:8545 does not answer")));
    assert!(shown(&robot.state, &night()).contains("127.0.0.1:8545 does not answer"));
}

#[test]
fn every_theme_shows_the_same_words_and_ascii_only_ascii() {
    let screens = Screen::all().map(|screen| ("", at(screen, SIZES[0])));
    for (_, robot) in screens.chain(popups()) {
        let text = shown(&robot.state, &night());
        for name in ["day", "contrast", "mono"] {
            assert_eq!(shown(&robot.state, &Theme::named(name).expect("embedded")), text, "{name}");
        }
        let ascii = shown(&robot.state, &Theme { ascii: true, ..night() });
        assert!(ascii.is_ascii());
        assert_eq!(ascii.len(), text.chars().count(), "nothing moves");
    }
}

/// Where a theme's roles are on a screen: a letter for each cell that is not plain.
fn looks(state: &State, theme: &Theme) -> String {
    let (columns, rows) = state.size;
    let mut terminal = Terminal::new(TestBackend::new(columns, rows)).expect("a terminal");
    terminal.draw(|frame| drop(draw(frame, state, theme))).expect("drawn");
    let buffer = terminal.backend().buffer();
    let mut styles: Vec<(String, String)> = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            let cell = &buffer[(column, row)];
            let style = format!("{:?} {:?} {:?}", cell.fg, cell.bg, cell.modifier);
            match styles.last_mut() {
                Some((last, text)) if *last == style => text.push_str(cell.symbol()),
                _ => styles.push((style, cell.symbol().to_owned())),
            }
        }
    }
    let words = styles.into_iter().filter(|(_, text)| !text.trim().is_empty());
    words.map(|(style, text)| format!("{style}: {}\n", text.split_whitespace().collect::<Vec<_>>().join(" "))).collect()
}

#[test]
fn one_pass_each_in_day_mono_and_ascii() {
    let mut themes = ["day", "mono"].map(|name| (name, Theme::named(name).expect("embedded"), String::new()));
    let mut ascii = String::new();
    for screen in Screen::all() {
        for size in SIZES {
            let state = at(screen, size).state;
            let plain = shown(&state, &Theme { ascii: true, ..night() });
            assert!(plain.is_ascii(), "{screen:?} {size:?}");
            if size == SIZES[2] {
                ascii.push_str(&format!("{}\n{plain}\n", screen.title()));
            }
            for (_, theme, pages) in &mut themes {
                assert_eq!(shown(&state, theme), shown(&state, &night()));
                if size == SIZES[0] && matches!(screen, Screen::Overview | Screen::Topics | Screen::Records) {
                    pages.push_str(&format!("{}\n{}\n", screen.title(), looks(&state, theme)));
                }
            }
        }
    }
    compare("ascii", &ascii);
    for (name, _, pages) in themes {
        compare(&format!("looks_{name}"), &pages);
    }
}

#[test]
fn the_busiest_topics_are_on_the_first_screen_by_their_full_names() {
    let robot = Robot::at_work(false);
    let text = shown(&robot.state, &night());
    let place = |name| text.find(name).expect(name);
    assert!(place("/robot1/odom") < place("/robot1/camera/compressed"));
    assert!(text.contains("SIMULATED"));
}

#[test]
fn no_screen_breaks_at_any_size() {
    for columns in (0..140).step_by(7) {
        for rows in 0..40 {
            let mut robot = Robot::at_work(true);
            robot.act(Action::Resize { columns, rows });
            for keys in ["1", "2", "3", "4", "5", "6", "7", "8", "9", ":", "\u{1b}g"] {
                for key in keys.chars() {
                    robot.presses(if key == '\u{1b}' { Key::Escape } else { Key::Char(key) });
                }
                robot.site_answers(true);
                shown(&robot.state, &night());
            }
        }
    }
}

#[test]
fn an_operator_is_named_on_top() {
    let mut robot = at(Screen::Topics, SIZES[0]);
    assert!(!shown(&robot.state, &night()).contains("OPERATOR"));
    robot.state.settings.operator = Some("bob".to_owned());
    let text = shown(&robot.state, &night());
    assert!(text.lines().next().is_some_and(|first| first.ends_with(" OPERATOR bob")), "{text}");
}
