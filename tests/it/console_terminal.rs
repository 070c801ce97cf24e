//! The console and its terminal: signals, panic, hang-up, suspension, other terminals, sizes, colours, hostile text.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};

use authros::app::{Popup, Screen, Settings, State};
use authros::popups::record::state::Opening;
use authros::service::reply::{OpenedView, TopicRow};
use authros::term::encode::Depth;
use authros::term::renderer::Painter;
use authros::term::renderer::{Scene, Wish};
use authros::ui::Theme;
use support::figures::{self, Subject};
use support::hostile::{Hostile, foreign, foreign_in_lines};
use support::{Authros, Console, Home, Terminal, faulty, holds, list, long, poll, skipped, system_program, wait_until};

const TOPIC: &str = "/robot1/odom";

fn one_robot(home: &Home) -> Authros {
    home.authros().with(&["--robots", "1"])
}

fn words(words: &[&str]) -> Vec<String> {
    words.iter().map(|&word| word.to_owned()).collect()
}

#[test]
fn signals_end_it_with_their_code() {
    for (name, code) in [("TERM", 143), ("INT", 130), ("QUIT", 131), ("HUP", 129)] {
        let home = Home::new();
        let mut console = Console::open(&home.authros().with(&["--robots", "0"]));
        console.wait_for("Overview", 30);
        console.signal(name);
        assert_eq!(console.wait(30).exit_code(), code, "{name}:\n{}", console.shown());
        console.expect_restored();
    }
}

/// A serial console, or a shell within an editor: 0 by 0 is not a small terminal.
#[test]
fn a_terminal_without_a_size_shows_the_console_and_says_how_to_give_it_one() {
    for (terminal, variables, rows) in
        [(Terminal::of(80, 24), &[][..], 24), (Terminal::of(100, 30), &[("LINES", "30"), ("COLUMNS", "100")][..], 30)]
    {
        let home = Home::new();
        let mut authros = home.authros().with(&["--robots", "0"]);
        for (name, value) in variables {
            authros = authros.with_variable(name, value);
        }
        let program = authros.program().to_str().expect("UTF-8").to_owned();
        let start = "stty rows 0 cols 0; exec \"$0\" \"$@\"";
        let line = [words(&["sh", "-c", start, &program]), authros.arguments(&[])].concat();
        let mut console = Console::run(&terminal, &line, &authros.variables());
        console.wait_for("Overview", 30);
        let shown = console.wait_for("the terminal reports no size: stty rows 24 cols 80", 30);
        assert_eq!(shown.lines().count(), rows, "{shown}");
        console.signal("TERM");
        console.wait(30);
    }
}

#[test]
fn a_panic_of_the_drawing_thread_gives_the_terminal_back_and_says_where() {
    let Some(program) = faulty() else {
        skipped!("authros-faulty is not built; cargo test builds it with the examples");
    };
    let home = Home::new();
    let authros = one_robot(&home).with_program(&program).with_variable("AUTHROS_FAULT", "renderer");
    let mut console = Console::open(&authros);
    console.wait_for(TOPIC, 30);
    console.press("9");
    assert!(!console.wait(30).success());
    console.expect_restored();
    let said = console.wait_for("AUTHROS_FAULT", 30);
    assert!(said.contains("renderer.rs") && said.contains("AUTHROS_FAULT"), "{said}");
}

#[test]
fn a_lost_terminal_ends_it_with_129() {
    if system_program("script").is_none() || system_program("setsid").is_none() {
        skipped!("no script or setsid");
    }
    for hung_up in [true, false] {
        let home = Home::new();
        let authros = one_robot(&home);
        let directory = home.root().to_owned();
        let subject = Subject::of(home, &authros);
        let lost = figures::lost(&subject, &directory, hung_up);
        assert!(lost.ended_after.is_some(), "it stays, hung up: {hung_up}: {lost:?}");
        assert_eq!(lost.code, Some(129), "hung up: {hung_up}: {lost:?}");
        let dumped = std::fs::read_dir(&directory).expect("readable").flatten();
        assert!(!dumped.into_iter().any(|file| file.file_name().to_string_lossy().starts_with("core")));
    }
}

#[test]
fn control_z_gives_the_terminal_to_the_shell_and_fg_brings_it_back() {
    let home = Home::new();
    let authros = one_robot(&home);
    let mut variables = authros.variables();
    variables.push(("PS1".to_owned(), "ready> ".to_owned()));
    let mut shell = Console::run(&Terminal::of(100, 30), &words(&["bash", "--norc", "--noprofile", "-i"]), &variables);
    shell.wait_for("ready>", 20);
    let program = authros.program().to_str().expect("UTF-8").to_owned();
    let line = [vec![program], authros.arguments(&[])].concat().join(" ");
    shell.press(&format!("{line}; echo code=$?\r"));
    shell.wait_for(TOPIC, 30);
    shell.press("\u{1a}");
    shell.wait_for("Stopped", 30);
    assert!(!shell.shown().contains("Overview"), "the shell has its screen:\n{}", shell.shown());
    shell.press("echo $((40+2))\r");
    shell.wait_for("42", 20);
    shell.press("fg\r");
    shell.wait_for("Overview", 30);
    shell.press("2");
    shell.wait_for("Pinned", 30);
    shell.press("q");
    shell.wait_for("ready>", 30);
    // Keys typed before the process has ended are its own.
    wait_until(30, "the shell reads again", || {
        shell.press("echo again=$((1+1))\r");
        poll(2, || Some(()).filter(|()| shell.shown().contains("again=2")))
    });
    shell.press("exit\r");
    shell.wait(30);
    assert!(shell.is_restored());
}

fn inside(name: &str, outer: &[&str], home: &Home, variables: &[(&str, String)]) {
    let authros = one_robot(home);
    let program = authros.program().to_str().expect("UTF-8").to_owned();
    let line: Vec<String> = [words(outer), vec![program], authros.arguments(&[])].concat();
    let mut environment = authros.variables();
    environment.extend(variables.iter().map(|(name, value)| ((*name).to_owned(), value.clone())));
    let mut console = Console::run(&Terminal::of(80, 24), &line, &environment);
    console.wait_for("captured", 60);
    console.press("2");
    console.wait_for(TOPIC, 60);
    console.resize(30, 100);
    console.wait_for("Pinned", 30);
    console.press("?");
    console.wait_for("Keys of the Topics screen", 30);
    console.press("\u{1b}");
    wait_until(30, "the help closes", || Some(()).filter(|()| !console.shown().contains("Keys of the")));
    console.press("q");
    console.wait(30);
    assert!(console.is_restored(), "{name}");
}

#[test]
fn it_works_in_tmux() {
    if system_program("tmux").is_none() {
        skipped!("no tmux");
    }
    let home = Home::new();
    let root = home.root().to_str().expect("UTF-8").to_owned();
    inside("tmux", &["tmux", "-L", "t", "-f", "/dev/null", "new-session"], &home, &[("TMUX_TMPDIR", root)]);
}

#[test]
fn it_works_in_screen() {
    if system_program("screen").is_none() {
        skipped!("no screen");
    }
    let home = Home::new();
    let sockets = home.root().join("screens");
    std::fs::create_dir(&sockets).expect("a directory");
    std::fs::set_permissions(&sockets, std::os::unix::fs::PermissionsExt::from_mode(0o700)).expect("its mode");
    let sockets = sockets.to_str().expect("UTF-8").to_owned();
    let settings = home.file("screenrc", "startup_message off\naltscreen on\n", 0o600);
    inside("screen", &["screen", "-U", "-c", &settings], &home, &[("SCREENDIR", sockets)]);
}

#[test]
fn the_smallest_terminal_shows_every_screen_and_a_smaller_one_says_so() {
    let home = Home::new();
    let mut console = Console::open_in(&Terminal::of(60, 18), &one_robot(&home), &[]);
    console.wait_for("Overview", 30);
    for screen in Screen::all() {
        console.press(&(screen.index() + 1).to_string());
        console.wait_for(screen.title(), 30);
    }
    console.resize(17, 60);
    let shown = console.wait_for("need 60x18", 30);
    assert_eq!(shown.lines().filter(|line| !line.trim().is_empty()).count(), 1, "{shown}");
    console.resize(18, 60);
    console.wait_for("Log", 30);
    console.press("q");
    assert!(console.wait(30).success());
}

/// All bytes of a console that shows two screens and quits.
fn bytes_in(terminal: &Terminal, variables: &[(&str, &str)]) -> Vec<u8> {
    let home = Home::new();
    let authros = one_robot(&home);
    let authros = variables.iter().fold(authros, |authros, (name, value)| authros.with_variable(name, value));
    let mut console = Console::open_in(terminal, &authros, &[]);
    console.wait_for(TOPIC, 30);
    console.press("2");
    console.wait_for("Watched", 30);
    console.press("q");
    assert!(console.wait(30).success());
    console.expect_restored();
    console.raw()
}

#[test]
fn colours_are_those_that_the_terminal_has() {
    let xterm = Terminal { name: "xterm", ..Terminal::of(80, 24) };
    let many = Terminal::of(80, 24);
    let has = |bytes: &[u8], code: &str| holds(bytes, code.as_bytes());
    let sixteen = bytes_in(&xterm, &[]);
    assert!(!has(&sixteen, ";38;") && !has(&sixteen, ";48;"), "only the sixteen");
    assert!((90..98).chain(30..38).any(|colour| has(&sixteen, &format!(";{colour}m"))), "some colour");
    let indexed = bytes_in(&many, &[]);
    assert!(has(&indexed, ";38;5;") && !has(&indexed, ";38;2;"));
    let whole = bytes_in(&many, &[("COLORTERM", "truecolor")]);
    assert!(has(&whole, ";38;2;") && !has(&whole, ";38;5;"));
    let none = bytes_in(&many, &[("NO_COLOR", "1")]);
    for colour in
        [";38;", ";48;"].map(str::to_owned).into_iter().chain((30..48).chain(90..108).map(|c| format!(";{c}m")))
    {
        assert!(!has(&none, &colour), "{colour}");
    }
    for bytes in [sixteen, indexed, whole, none] {
        assert!(!has(&bytes, "\u{1b}]11"), "it does not ask for the background");
        assert_eq!(foreign(&bytes), None);
    }
}

#[test]
fn keys_and_theme_of_ones_own_and_errors_by_line() {
    let home = Home::new();
    std::fs::create_dir_all(home.path().join("themes")).expect("a home");
    std::fs::set_permissions(home.path(), std::os::unix::fs::PermissionsExt::from_mode(0o700)).expect("its mode");
    let keymap = home.path().join("keymap.toml");
    std::fs::write(&keymap, "[everywhere]\nkeys = [\n  { on = [\"z\", \"x\"], run = \"quit\", desc = \"Away\" },\n]\n")
        .expect("written");
    std::fs::write(home.path().join("themes/sea.toml"), "name = \"sea\"\n[roles]\ntitle = { fg = \"#0000ff\" }\n")
        .expect("written");
    let authros = one_robot(&home).with_variable("COLORTERM", "truecolor").with_variable("AUTHROS_THEME", "sea");
    let mut console = Console::open(&authros);
    console.wait_for(TOPIC, 30);
    assert!(holds(&console.raw(), b";38;2;0;0;255"), "the own theme's colour");
    console.press("T");
    console.wait_for("contrast", 30);
    console.press("\u{1b}");
    console.press("z");
    console.wait_for("Away", 30);
    console.press("x");
    assert!(console.wait(30).success());
    console.expect_restored();
    std::fs::write(&keymap, "[topics]\nkeys = [\n  { on = \"v\", run = \"wacth\" },\n]\n").expect("written");
    let mut console = Console::open(&one_robot(&home));
    assert!(!console.wait(30).success());
    let whole = |console: &Console| console.shown().replace('\n', "");
    support::poll(30, || whole(&console).contains("wacth").then_some(()));
    let said = whole(&console);
    assert!(said.contains("keymap.toml") && said.contains("line 3") && said.contains("wacth"), "{said}");
}

fn scene(state: State) -> Scene {
    let theme = Theme::named("night").expect("embedded");
    Scene { state, theme, wish: Wish::Now, anew: false, extra: String::new(), suspended: false, over: false }
}

fn topic(hostile: &mut Hostile) -> TopicRow {
    serde_json::from_value(serde_json::json!({
        "topic": hostile.text(), "type": hostile.text(), "publishers": [hostile.text()], "watched": true, "simulated": false,
        "hz": 1.0, "bytes_per_second": 2.0, "messages": 1, "lost_in_transport": 0, "lost_in_recorder": 0, "last_message": null,
        "ros": 1, "left_out": 0, "pins": 0, "unpinned": [hostile.text()], "quarantined": 0, "alarm": false,
        "unreached": [{ "node": hostile.text(), "place": hostile.text(), "reason": hostile.text() }],
    }))
    .expect("a row")
}

fn opened(hostile: &mut Hostile) -> OpenedView {
    let fields: Vec<(String, String)> = (0..30).map(|_| (hostile.text(), hostile.text())).collect();
    serde_json::from_value(serde_json::json!({
        "id": "00000000000003e8", "seq": 1, "topic": hostile.text(), "type": hostile.text(), "kind": "data",
        "state": "stored", "digest": "00".repeat(32), "bytes": 7, "captured_at": "2026-01-01T00:00:00Z", "epoch": 1,
        "simulated": false, "transaction": null, "block": null, "verdict": "unanchored", "caller_id": hostile.text(),
        "tags": [[hostile.text(), hostile.text()]], "fields": fields, "message": null,
        "compression": "none", "stored": 7, "compared": "head",
    }))
    .expect("an opened record")
}

#[test]
fn of_a_million_hostile_strings_no_control_byte_reaches_the_terminal() {
    let wanted = if long() { 1_000_000 } else { 20_000 };
    let mut hostile = Hostile::new(0x5eed);
    let mut state = State::new(Settings::default());
    state.size = (200, 50);
    let mut scene = scene(state);
    let mut painter = Painter::new(Depth::Indexed, scene.state.size);
    let mut strings = 0;
    while strings < wanted {
        scene.state.popups.clear();
        scene.state.screen = Screen::Topics;
        let now = scene.state.now;
        scene.state.topics.set((0..44).map(|_| topic(&mut hostile)).collect(), now);
        strings += 44 * 3;
        let frame = painter.paint(&mut scene);
        assert!(frame.len() > 2_000, "the names are drawn: {}", frame.len());
        assert_eq!(foreign(frame.as_bytes()), None);
        let view = opened(&mut hostile);
        strings += 30 * 2 + 5;
        let mut opening = Opening::new(&hostile.text());
        opening.lookup.answer = Some(Ok(Box::new(view)));
        scene.state.popups.push(Popup::Record(opening));
        scene.state.complain(hostile.text());
        let frame = painter.paint(&mut scene);
        assert!(!frame.is_empty());
        assert_eq!(foreign(frame.as_bytes()), None);
    }
}

/// A master that lists hostile nodes, topics and types; it answers until the test ends.
fn hostile_master(count: usize) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let uri = format!("http://{}", listener.local_addr().expect("its address"));
    let mut hostile = Hostile::new(99);
    let escape = |text: &str| -> String {
        let plain = |character: char| {
            if character.is_ascii_alphanumeric() {
                character.to_string()
            } else {
                format!("&#{};", u32::from(character))
            }
        };
        text.chars().map(plain).collect()
    };
    let string = |text: &str| format!("<value><string>{}</string></value>", escape(text));
    let array = |items: &[String]| format!("<value><array><data>{}</data></array></value>", items.concat());
    let names: Vec<(String, String, String)> =
        (0..count).map(|index| (format!("/t{index}{}", hostile.text()), hostile.text(), hostile.text())).collect();
    let publishers: Vec<String> =
        names.iter().map(|(topic, _, caller)| array(&[string(topic), array(&[string(caller)])])).collect();
    let types: Vec<String> =
        names.iter().map(|(topic, type_name, _)| array(&[string(topic), string(type_name)])).collect();
    let (empty, publishers, types) = (array(&[]), array(&publishers), array(&types));
    let state = array(&[publishers, empty.clone(), empty.clone()]);
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let (state, types, empty) = (state.clone(), types.clone(), empty.clone());
            std::thread::spawn(move || answer(stream, &state, &types, &empty));
        }
    });
    uri
}

fn answer(mut stream: TcpStream, state: &str, types: &str, empty: &str) -> Option<()> {
    let mut request = Vec::new();
    let mut buffer = [0; 4096];
    while !holds(&request, b"</methodCall>") {
        let length = stream.read(&mut buffer).ok().filter(|length| *length > 0)?;
        request.extend_from_slice(&buffer[..length]);
    }
    let asked = |name: &str| holds(&request, name.as_bytes());
    let value = if asked("getSystemState") {
        state
    } else if asked("getTopicTypes") {
        types
    } else {
        empty
    };
    let body = format!(
        "<?xml version=\"1.0\"?><methodResponse><params><param><value><array><data><value><int>1</int></value>\
         <value><string>ok</string></value>{value}</data></array></value></param></params></methodResponse>"
    );
    let head = format!(
        "HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(body.as_bytes())).ok()
}

#[test]
fn hostile_names_of_a_ros_graph_reach_neither_terminal_nor_json_nor_log() {
    let home = Home::new();
    let uri = hostile_master(if long() { 2_000 } else { 300 });
    let authros = home.authros().with(&["--ros-master", &uri]);
    authros.json(&["identity", "create"]);
    let told = authros.with(&["--json"]).run(&["topics", "list"]).expect_code(0);
    assert!(list(&told.document(), "topics").len() > 50, "the graph is seen: {told}");
    let lines = authros.run(&["topics", "list"]).expect_code(0);
    for text in [&told.stdout, &told.stderr, &lines.stdout, &lines.stderr] {
        assert_eq!(foreign_in_lines(text), None);
    }
    let mut console = Console::open_in(&Terminal::of(200, 50), &authros, &[]);
    console.wait_for("Overview", 30);
    console.press("2");
    console.wait_for("/t1", 30);
    for key in ["\u{1b}[6~", "a", "w", "\u{1b}", "\u{1b}", "9", "1"] {
        console.press(key);
        poll(2, || None::<()>);
    }
    console.signal("TERM");
    console.wait(30);
    assert_eq!(foreign(&console.raw()), None);
}

#[test]
fn it_costs_no_byte_while_nothing_changes_and_few_for_a_key() {
    let quiet = Subject::authros(0);
    let idle = figures::idle(
        &quiet,
        &Terminal::of(80, 24),
        std::time::Duration::from_secs(6),
        std::time::Duration::from_secs(3),
    );
    assert!(idle.bytes < 1.0, "{idle:?}");
    let robots = Subject::authros(4);
    let key = figures::bytes_per_key(&robots, &["2", "f"], &["j", "k"], 8);
    assert!(key > 0.0 && key <= 200.0, "{key} bytes per key");
    let first = figures::first_frame(&quiet);
    assert!(first.bytes <= 6_000, "{first:?}");
}
