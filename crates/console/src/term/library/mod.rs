//! The library of screens: what an emulated terminal holds after a frame, for named situations at three sizes, and how
//! it looks in every theme. `tools/pictures.py` draws pictures from the looks.

use std::num::NonZeroU16;

use super::encode::Depth;
use super::renderer::{Painter, Scene, Wish};
use crate::app::completion::{Candidate, Found};
use crate::app::tests::{Robot, fixtures};
use crate::app::tour::Cast;
use crate::app::{Action, Effect, Feed, Key, Screen, Settings, State, Tag, Verb};
use crate::model::{Digest, ErrorKind, ProfileName, Timestamp};
use crate::ros::readable::{Plot, Raster, Readable};
use crate::service::reply::{
    CoveragePart, CoverageView, GatewayStatusView, HealthLevel, HeldUp, LifeLine, OpenedView, SiteView,
};
use crate::service::{Event, NoticeLevel, Part, Reply};
use crate::ui::Theme;
use vt100::{Cell, Color, Parser};

/// What the sanitiser puts in place of hostile characters. The emulator drops it, which no terminal does.
const REPLACED: &str = "\u{fffd}";
/// Its stand-in inside the emulator.
const STAND_IN: &str = "\u{e000}";

const SIZES: [(u16, u16); 3] = [(80, 24), (120, 40), (200, 50)];

/// Situations whose looks are kept: those drawn as pictures.
const PICTURES: [&str; 10] = [
    "overview",
    "topics",
    "records-chosen-columns",
    "provenance",
    "record-plot",
    "grant-asked",
    "readers",
    "in-trouble",
    "quit-asked",
    "incidents",
];

/// How a situation can look: name, theme, colours of the terminal, ASCII only.
const LOOKS: [(&str, &str, Depth, bool); 7] = [
    ("night", "night", Depth::True, false),
    ("day", "day", Depth::True, false),
    ("contrast", "contrast", Depth::True, false),
    ("mono", "mono", Depth::True, false),
    ("sixteen", "night", Depth::Sixteen, false),
    ("no-color", "mono", Depth::None, false),
    ("ascii", "night", Depth::True, true),
];

/// What a terminal holds after the frame.
fn emulated(state: State, theme: Theme, depth: Depth) -> Parser {
    let (columns, rows) = state.size;
    let mut painter = Painter::new(depth, state.size);
    let size = |cells| NonZeroU16::new(cells).expect("not zero");
    let mut terminal = Parser::new(size(rows), size(columns), 0);
    let mut scene =
        Scene { state, theme, wish: Wish::Now, anew: true, extra: String::new(), suspended: false, over: false };
    terminal.process(painter.paint(&mut scene).replace(REPLACED, STAND_IN).as_bytes());
    terminal
}

fn theme(name: &str, ascii: bool) -> Theme {
    Theme { ascii, ..Theme::named(name).expect("embedded") }
}

/// Its rows, each cell by `of`, without what is empty at their ends.
fn rows(terminal: &Parser, mut of: impl FnMut(&Cell) -> String) -> String {
    let (rows, columns) = terminal.screen().size();
    let cell = |row, column| terminal.screen().cell(row, column).filter(|cell| !cell.is_wide_continuation());
    let (rows, columns) = (rows.get(), columns.get());
    let mut line = |row| (0..columns).filter_map(|column| cell(row, column)).map(&mut of).collect::<String>();
    (0..rows).map(|row| line(row).trim_end().to_owned() + "\n").collect()
}

fn text(terminal: &Parser) -> String {
    let shown =
        |cell: &Cell| if cell.has_contents() { cell.contents().replace(STAND_IN, REPLACED) } else { " ".into() };
    rows(terminal, shown)
}

/// A letter for each style, none for plain cells; the styles come first.
fn letters(terminal: &Parser) -> String {
    let mut styles: Vec<String> = Vec::new();
    let grid = rows(terminal, |cell| {
        let style = style(cell);
        if style.is_empty() {
            return " ".to_owned();
        }
        let place = styles.iter().position(|other| *other == style).unwrap_or_else(|| {
            styles.push(style);
            styles.len() - 1
        });
        letter(place).to_string()
    });
    let legend = styles.iter().enumerate().map(|(place, style)| format!("# {} {style}\n", letter(place)));
    legend.collect::<String>() + &grid
}

fn letter(place: usize) -> char {
    ('a'..='z').chain('A'..='Z').nth(place).expect("few styles")
}

fn style(cell: &Cell) -> String {
    let colour = |name: &str, colour: Color| match colour {
        Color::Default => None,
        Color::Idx(index) => Some(format!("{name}={index}")),
        Color::Rgb(red, green, blue) => Some(format!("{name}=#{red:02x}{green:02x}{blue:02x}")),
    };
    let is = |word: &str, on: bool| on.then(|| word.to_owned());
    // An empty cell shows its background and its line only.
    let ink = cell.has_contents() && cell.contents() != " " || cell.inverse();
    let parts = [
        colour("fg", cell.fgcolor()).filter(|_| ink),
        colour("bg", cell.bgcolor()),
        is("bold", cell.bold() && ink),
        is("dim", cell.dim() && ink),
        is("underlined", cell.underline()),
        is("reversed", cell.inverse()),
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join(" ")
}

fn compare(name: &str, text: &str) {
    let mut settings = insta::Settings::clone_current();
    settings.set_prepend_module_to_snapshot(false);
    settings.set_omit_expression(true);
    settings.set_snapshot_path("snapshots");
    settings.bind(|| insta::assert_snapshot!(name, text));
}

#[test]
fn forty_situations_at_three_sizes() {
    let all = all();
    assert!(all.len() >= 40, "{}", all.len());
    for (name, begins) in all {
        let pages = SIZES.map(|size| {
            let terminal = emulated(begins(size).state, theme("night", false), Depth::True);
            format!("{}x{}\n{}", size.0, size.1, text(&terminal))
        });
        compare(name, &pages.join("\n"));
    }
}

#[test]
fn ten_of_them_in_every_theme_without_colours_and_in_ascii() {
    for name in PICTURES {
        let (_, begins) = all().into_iter().find(|(other, _)| *other == name).expect(name);
        let plain = text(&emulated(begins(SIZES[0]).state, theme("night", false), Depth::True));
        let mut pages = format!("== text\n{plain}");
        for (look, theme_name, depth, ascii) in LOOKS {
            let terminal = emulated(begins(SIZES[0]).state, theme(theme_name, ascii), depth);
            if ascii {
                let shown = text(&terminal);
                assert!(shown.is_ascii(), "{name}");
                pages.push_str(&format!("== {look} text\n{shown}"));
            } else {
                assert_eq!(text(&terminal), plain, "{name}: nothing depends on colour in {look}");
            }
            pages.push_str(&format!("== {look}\n{}", letters(&terminal)));
        }
        compare(&format!("looks-{name}"), &format!("{pages}== end\n"));
    }
}

#[test]
fn without_colours_no_colour_is_sent() {
    for name in PICTURES {
        let (_, begins) = all().into_iter().find(|(other, _)| *other == name).expect(name);
        for theme_name in ["night", "day", "contrast", "mono"] {
            let terminal = emulated(begins(SIZES[0]).state, theme(theme_name, false), Depth::None);
            let grid = letters(&terminal);
            assert!(!grid.contains("fg=") && !grid.contains("bg="), "{name} {theme_name}");
        }
    }
}

type Size = (u16, u16);
/// A situation: its name, and how it comes about.
type Situation = (&'static str, fn(Size) -> Robot);

const MINUTE: u64 = 60_000_000_000;
const ODOMETRY: &str = "/robot1/odom";

pub fn all() -> Vec<Situation> {
    [SCREENS, STATES, GRANTS, RECORDS, WINDOWS].concat()
}

const SCREENS: &[Situation] = &[
    ("overview", |size| flowing(size, 0)),
    ("overview-after-a-stop", |size| flowing(size, 120)),
    ("topics", |size| covered(size, Screen::Topics)),
    ("topics-folded", |size| pressed(at(Screen::Topics, size), "H")),
    ("topics-searched", |size| pressed(at(Screen::Topics, size), "/odom")),
    ("records", |size| at(Screen::Records, size)),
    ("received", |size| at(Screen::Received, size)),
    ("grants", |size| at(Screen::Grants, size)),
    ("keys", |size| at(Screen::Keys, size)),
    ("chain", |size| at(Screen::Chain, size)),
    ("gateway", |size| at(Screen::Robots, size)),
    ("gateway-with-robots", with_robots),
    ("gateway-of-an-owner", of_an_owner),
    ("overview-with-drift", |size| {
        let mut robot = with_robots(size);
        robot.types("1");
        robot
    }),
    ("log", |size| at(Screen::Log, size)),
];

const STATES: &[Situation] = &[
    ("starting", |size| sized(Robot::opens(Settings::default()), size)),
    ("new-profile", |size| sized(Robot::at_work(false), size)),
    ("passphrase-of-a-new-identity", |size| pressed(sized(Robot::at_work(false), size), "ncorrect horse")),
    ("unlock-asked", |size| locked(size, true)),
    ("topics-that-wait-for-the-key", |size| locked(size, false)),
    ("in-trouble", in_trouble),
    ("frozen", |size| pressed(at(Screen::Records, size), "f")),
    ("quit-asked", quit_asked),
    ("read-only", |size| {
        let mut robot = at(Screen::Grants, size);
        robot.state.settings.read_only = true;
        robot
    }),
    ("tour", on_tour),
    ("list-that-failed", |size| {
        let mut robot = sized(Robot::at_work(true), size);
        robot.types("7");
        let failure = fixtures::failure(ErrorKind::Unreachable, "http://127.0.0.1:8545 does not answer");
        robot.is_answered(&Tag::Feed(Feed::Chain, 0), Err(failure));
        robot
    }),
];

const GRANTS: &[Situation] = &[
    ("grant", |size| pressed(at(Screen::Topics, size), "jjg")),
    ("grant-refused", |size| submitted(pressed(at(Screen::Grants, size), "g0x12"))),
    ("grant-asked", |size| submitted(pressed(at(Screen::Grants, size), "g0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed"))),
    ("revoke-asked", |size| pressed(at(Screen::Grants, size), "x")),
    ("readers", |size| pressed(at(Screen::Topics, size), "jji")),
    ("contacts", |size| pressed(at(Screen::Grants, size), "c")),
];

const RECORDS: &[Situation] = &[
    ("records-searched", |size| {
        let mut robot = pressed(at(Screen::Records, size), "/odom state:verified since:2h");
        robot.presses(Key::Enter);
        robot.site_answers(true);
        robot
    }),
    ("records-page-of-the-past", |size| {
        let mut robot = at(Screen::Records, size);
        robot.presses(Key::PageDown);
        robot.presses(Key::PageDown);
        robot.site_answers(true);
        robot
    }),
    ("records-chosen-columns", |size| {
        let mut robot = pressed(at(Screen::Records, size), ":columns topic,time,size,digest,state");
        robot.presses(Key::Enter);
        for row in &mut robot.state.records.rows {
            let mixed = row.seq.wrapping_mul(0x9e37_79b9_7f4a_7c15).to_be_bytes();
            row.digest = Digest([mixed; 4].concat().try_into().expect("32 bytes"));
        }
        robot
    }),
    ("columns", |size| pressed(at(Screen::Records, size), "Cjjjj ")),
    ("columns-without-room", |size| {
        let mut robot = pressed(at(Screen::Received, size), ":columns topic,id,digest,transaction,type,owner");
        robot.presses(Key::Enter);
        pressed(robot, "C")
    }),
    ("provenance", |size| {
        let mut robot = at(Screen::Records, size);
        robot.presses(Key::Enter);
        let id = fixtures::record(1_000, "").id;
        robot.is_answered(&Tag::Show(id), Ok(Reply::Provenance(fixtures::provenance(1_000))));
        robot
    }),
    ("record-values", |size| opened(size, 0, false)),
    ("record-plot", |size| opened(size, 1, false)),
    ("record-fields", |size| opened(size, 2, false)),
    ("record-bytes", |size| opened(size, 3, false)),
    ("record-picture", |size| opened(size, 0, true)),
    ("record-picture-alone", |size| {
        let mut robot = opened(size, 0, true);
        robot.presses(Key::Enter);
        robot
    }),
    ("browse", |size| pressed(at(Screen::Received, size), "b")),
];

const WINDOWS: &[Situation] = &[
    ("palette", |size| pressed(sized(Robot::at_work(true), size), ":re")),
    ("help", |size| pressed(at(Screen::Topics, size), "?")),
    ("help-of-a-window", |size| pressed(at(Screen::Records, size), "zi?")),
    ("chord", |size| pressed(at(Screen::Chain, size), "z")),
    ("publishers", publishers),
    ("tasks", |size| pressed(at(Screen::Chain, size), "t")),
    ("load-key-with-listed-paths", listed),
    ("export-records", |size| pressed(at(Screen::Records, size), "  e")),
    ("rotation-asked", |size| pressed(at(Screen::Keys, size), "r")),
    ("suspend-asked", |size| {
        let mut robot = pressed(at(Screen::Chain, size), ":suspend");
        robot.presses(Key::Enter);
        submitted(pressed(robot, "0x5aAeb6053F3E94C9b9A09f33669435E7Ef1BeAed"))
    }),
    ("incident-opened", |size| pressed(at(Screen::Records, size), "jI")),
    ("incidents", |size| pressed(at(Screen::Records, size), "zi")),
    ("robot-details", robot_in_full),
    ("robot-policy", |size| pressed(at_the_scout(size), "p")),
    ("robot-policy-refused", |size| policy_read(size, "[[watch]]\ntopic = \"odom odom\"\n")),
    ("robot-policy-asked", |size| {
        let ring = "[ring]\nkeep = \"5m, 500MiB\"\ntopics = [\"/camera/**\"]\n";
        policy_read(size, &format!("{ring}[[watch]]\ntopic = \"/odom\"\n[[topic]]\nmatch = \"/odom\"\nevery = 10\n"))
    }),
    ("log-line", |size| {
        let mut robot = at(Screen::Log, size);
        robot.presses(Key::Enter);
        robot
    }),
];

fn sized(mut robot: Robot, (columns, rows): Size) -> Robot {
    robot.act(Action::Resize { columns, rows });
    robot
}

/// A console at work, on that screen.
fn at(screen: Screen, size: Size) -> Robot {
    let mut robot = sized(Robot::at_work(true), size);
    robot.act(Action::Do(Verb::Go(screen)));
    robot.site_answers(true);
    robot
}

/// The same after these keys, and the answers to what they request.
fn pressed(mut robot: Robot, keys: &str) -> Robot {
    robot.types(keys);
    robot.site_answers(true);
    robot
}

/// A form after enter on each of its lines.
fn submitted(mut robot: Robot) -> Robot {
    (0..4).for_each(|_| robot.presses(Key::Enter));
    robot.site_answers(true);
    robot
}

/// Ten minutes at 44 records a second, then a number of seconds in which nothing came; the README's picture.
fn flowing(size: Size, after: u64) -> Robot {
    let mut robot = at(Screen::Overview, size);
    robot.state.topics.rows.retain(|row| row.simulated);
    robot.sees_records_flow(590);
    robot.waits(after);
    robot
}

/// With the coverage of the topic under the cursor, which a wide terminal asks for.
fn covered(size: Size, screen: Screen) -> Robot {
    let mut robot = at(screen, size);
    robot.types("jj");
    robot.waits(1);
    let tag = Tag::Beside(Screen::Topics, robot.state.row_key().unwrap_or_default());
    if robot.work().contains(&tag) {
        let topic = robot.state.row_key().unwrap_or_default();
        robot.is_answered(&tag, Ok(Reply::Coverage(coverage(&topic))));
    }
    robot
}

/// A day in 60 parts, with a gap and a loss.
fn coverage(topic: &str) -> CoverageView {
    let length = 24 * MINUTE;
    let since = Timestamp(fixtures::NOW.0 - 60 * length);
    let part = |place: u64| CoveragePart {
        at: Timestamp(since.0 + place * length),
        data: !(14..19).contains(&place),
        quarantined: place == 50,
        tampered: false,
        lost: if place == 30 { 7 } else { 0 },
    };
    let parts = (0..60).map(part).collect();
    let topic = topic.parse().expect("a topic");
    let (first, last) = (Some(since), Some(fixtures::NOW));
    CoverageView { topic, robot: None, robots: Vec::new(), since, until: fixtures::NOW, first, last, parts }
}

/// The gateway of a profile that has robots of all kinds.
fn with_robots(size: Size) -> Robot {
    let mut robot = sized(Robot::at_work(true), size);
    fixtures::robots::at_the_gateway(&mut robot);
    robot
}

/// The robots of an owner whose site has joined another one.
fn of_an_owner(size: Size) -> Robot {
    let mut robot = sized(Robot::at_work(true), size);
    fixtures::robots::at_the_gateway(&mut robot);
    let through = Some("as reported by the gateway 192.0.2.1:7420".to_owned());
    robot.state.gateway.set(GatewayStatusView { through, ..GatewayStatusView::default() });
    robot
}

/// With the cursor on the robot that refused its policy.
fn at_the_scout(size: Size) -> Robot {
    let mut robot = with_robots(size);
    robot.types("/scout");
    robot.presses(Key::Enter);
    robot
}

fn robot_in_full(size: Size) -> Robot {
    let mut robot = at_the_scout(size);
    robot.presses(Key::Enter);
    let row = robot.state.gateway.robots.iter().find(|row| row.name.as_str() == "scout").cloned().expect("a robot");
    let view = fixtures::robots::view(row);
    robot.is_answered(&Tag::Robot("scout".to_owned()), Ok(Reply::Robot(view)));
    robot
}

/// The form of a policy after this text was read.
fn policy_read(size: Size, text: &str) -> Robot {
    let mut robot = pressed(at_the_scout(size), "p/home/operator/scout.toml");
    robot.presses(Key::Enter);
    let Some(Effect::ReadText(path)) = robot.effects.pop() else { panic!("no file is read") };
    robot.act(Action::TextRead(path, Ok(text.to_owned())));
    robot
}

fn locked(size: Size, asks_passphrase: bool) -> Robot {
    let mut robot = sized(Robot::opens(Settings { asks_passphrase, ..Settings::default() }), size);
    let identity = || Reply::Identity(fixtures::identity(true, false, true));
    robot.is_answered(&Tag::Feed(Feed::Identity, 0), Ok(identity()));
    if !asks_passphrase {
        robot.types("2");
        let mut rows = fixtures::topics();
        for row in &mut rows {
            row.held_up = row.watched.then_some(HeldUp::WaitsForKey);
        }
        let tag = robot.sent.iter().find(|(_, tag)| matches!(tag, Tag::Feed(Feed::Topics, _)));
        let tag = tag.map(|(_, tag)| tag.clone()).expect("asked for");
        robot.is_answered(&tag, Ok(Reply::Topics(rows)));
    }
    robot
}

fn troubled(mut robot: Robot) -> Robot {
    robot.hears_of(Part::Health);
    let life = LifeLine {
        captured: 12_403,
        pending: 45,
        tampered: 1,
        dropped: 12,
        lost_in_transport: 3,
        ..fixtures::site().life
    };
    let mut site = SiteView { life, alerts: vec![fixtures::site_alert()], ..fixtures::site() };
    site.health[1].level = HealthLevel::Waiting;
    site.health[1].text = "retry in 4 s".to_owned();
    site.health[2].level = HealthLevel::Failed;
    site.health[2].text = "the disk of /srv/authros is full".to_owned();
    robot.is_answered(&Tag::Feed(Feed::Site, 0), Ok(Reply::Site(site)));
    robot
}

fn in_trouble(size: Size) -> Robot {
    let mut robot = troubled(sized(Robot::at_work(true), size));
    let text = "Chain unreachable: 45 records wait on disk".to_owned();
    robot.act(Action::Told(Event::Notice { at: fixtures::NOW, level: NoticeLevel::Error, text, about: None }));
    robot
}

fn quit_asked(size: Size) -> Robot {
    let mut robot = troubled(sized(Robot::at_work(true), size));
    robot.types("q");
    robot
}

fn on_tour(size: Size) -> Robot {
    let reader: ProfileName = "cura-b".parse().expect("a name");
    let tour = Some(Cast { owner: ProfileName::default(), reader });
    let mut robot = sized(Robot::opens(Settings { tour, ..Settings::default() }), size);
    robot.site_answers(false);
    robot
}

/// A message in readable form: odometry with its path, or a picture of a slope under a sun.
fn readable(camera: bool) -> Readable {
    if camera {
        let (width, height) = (96_usize, 72_usize);
        let pixel = |place: usize| {
            let (x, y) = (place % width, place / width);
            let sun = (x.abs_diff(72)).pow(2) + (y.abs_diff(16)).pow(2) < 100;
            let slope = y > 60 - x / 3;
            match (sun, slope) {
                (true, _) => [250, 220, 90],
                (_, true) => [60, 110, 60],
                (false, false) => [120, 170, 220],
            }
        };
        let rgb = (0..width * height).flat_map(pixel).collect();
        return Readable { picture: Some(Raster { width, height, rgb }), ..Readable::default() };
    }
    let line = |(label, value): (&str, &str)| (label.to_owned(), value.to_owned());
    let lines = [
        ("Frame", "odom to base_link"),
        ("Position, m", "1.25  -0.50  0.00"),
        ("Orientation", "yaw 45.0°"),
        ("Linear velocity, m/s", "0.40  0.00  0.00"),
        ("Angular velocity, rad/s", "0.00  0.00  0.10"),
        ("Stamp (UTC)", "2023-11-14T22:13:20.123Z (1700000000.123456789)"),
    ];
    let turn = |step: u32| {
        let angle = f64::from(step) / 12.0;
        (angle.cos() * angle / 2.0, angle.sin() * angle / 2.0)
    };
    let points: Vec<(f64, f64)> = (0..80).map(turn).collect();
    let (here, axes) = (points.last().copied(), ("x, m".to_owned(), "y, m".to_owned()));
    let plot = Plot { title: "Path over 80 records".to_owned(), axes, points, path: true, here };
    Readable { lines: lines.map(line).to_vec(), plot: Some(plot), ..Readable::default() }
}

fn opened(size: Size, tabs: usize, camera: bool) -> Robot {
    let mut robot = at(Screen::Received, size);
    robot.presses(Key::Enter);
    let view = OpenedView { readable: Some(readable(camera)), ..fixtures::opened(1_000, camera) };
    robot.is_answered(&Tag::Open(view.record.id.clone()), Ok(Reply::Opened(Box::new(view))));
    (0..tabs).for_each(|_| robot.presses(Key::Tab));
    robot
}

fn publishers(size: Size) -> Robot {
    let mut robot = at(Screen::Topics, size);
    robot.types("jj");
    robot.presses(Key::Enter);
    let topic = robot.state.row_key().unwrap_or_else(|| ODOMETRY.to_owned());
    robot.is_answered(&Tag::Publishers(topic.clone()), Ok(Reply::Pins(fixtures::pins(&topic))));
    let beside = Tag::Beside(Screen::Topics, topic.clone());
    if robot.work().contains(&beside) {
        robot.is_answered(&beside, Ok(Reply::Coverage(coverage(&topic))));
    }
    robot
}

/// The form of a key file after tab was pressed twice.
fn listed(size: Size) -> Robot {
    let mut robot = at(Screen::Keys, size);
    robot.state.settings.directory = "/home/operator".into();
    robot.types("L");
    robot.presses(Key::Enter);
    robot.types("keys/");
    let candidate = |name: &str, folder| Candidate { name: name.to_owned(), folder };
    let names = vec![
        candidate("2025", true),
        candidate("evil\u{1b}[2J\u{202e}.pem", false),
        candidate("k_c.hex", false),
        candidate("sm2.pem", false),
        candidate("wallet.json", false),
    ];
    for _ in 0..2 {
        robot.presses(Key::Tab);
        let Some(Effect::FindPaths(sought)) = robot.effects.pop() else { panic!("no path is looked for") };
        robot.act(Action::PathsFound(sought, Ok(Found { names: names.clone(), more: false })));
    }
    robot
}
