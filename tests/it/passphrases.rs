//! Passphrases: typed at a terminal, which never shows them and is as it was afterwards; given by a program; kept in no
//! file that nobody asked for. And a saved keyring that is brought back.
#![allow(clippy::expect_used, clippy::panic, reason = "a test fails by panicking")]

use crate::support;

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use support::authros::files_below;
use support::{Authros, Console, Home, Terminal, heavy, holds, text, wait_until};

const PASSPHRASE: &str = "correct horse battery";
const PATIENCE: u64 = 60;
const QUESTION: &str = "Passphrase of profile 'default'";
const INPUT: i32 = 3;
const REFUSED: i32 = 5;

/// Without a robot, and without a passphrase in a file or in the environment.
fn plain(home: &Home) -> Authros {
    home.authros().with(&["--robots", "0"]).storing_no_passphrase()
}

/// With a keyring that only its owner can open.
fn with_keyring(home: &Home) -> Authros {
    let authros = plain(home);
    let file = home.file("passphrase", PASSPHRASE, 0o600);
    authros.with(&["--passphrase-file", &file]).json(&["identity", "create"]);
    fs::remove_file(file).expect("removed");
    authros
}

fn asked(authros: &Authros, arguments: &[&str], question: &str) -> Console {
    let mut console = Console::open_in(&Terminal::of(100, 30), authros, arguments);
    console.wait_for(question, PATIENCE);
    console
}

/// It ends with this code; the terminal has its echo back, and has never shown any of these.
fn expect_end(mut console: Console, code: u32, typed: &[&str]) -> String {
    assert_eq!(console.wait(PATIENCE).exit_code(), code, "{}", console.shown());
    console.expect_restored();
    for words in typed {
        assert!(!holds(&console.raw(), words.as_bytes()), "'{words}' was shown:\n{}", console.shown());
    }
    console.shown()
}

fn is_in_no_file(home: &Home, words: &str) {
    for path in files_below(home.root()) {
        let bytes = fs::read(&path).unwrap_or_default();
        assert!(!holds(&bytes, words.as_bytes()), "in {}", path.display());
    }
}

#[test]
fn a_new_passphrase_is_typed_twice_and_written_nowhere() {
    let home = Home::new();
    let authros = plain(&home);
    let mut console = asked(&authros, &["identity", "create"], "New passphrase of profile 'default'");
    console.press("short\r");
    console.wait_for("Use at least 8 characters", PATIENCE);
    console.press(&format!("{PASSPHRASE}\r"));
    console.wait_for("Repeat it", PATIENCE);
    console.press("another horse battery\r");
    console.wait_for("do not match", PATIENCE);
    console.press(&format!("{PASSPHRASE}\r{PASSPHRASE}\r"));
    expect_end(console, 0, &[PASSPHRASE, "short", "another horse"]);
    assert!(!home.path().join("profiles/default/passphrase").exists());
    is_in_no_file(&home, PASSPHRASE);

    let mut console = asked(&authros, &["keys", "list"], QUESTION);
    console.press(&format!("{PASSPHRASE}\r"));
    let shown = expect_end(console, 0, &[PASSPHRASE]);
    assert!(shown.contains("SM2 signing"), "{shown}");
}

#[test]
fn without_a_terminal_a_passphrase_is_stored_only_if_this_was_asked_for() {
    let home = Home::new();
    let authros = plain(&home);
    for command in [&["identity", "create"][..], &["identity", "register"], &["serve"], &["gateway", "serve"]] {
        let refused = authros.fails(REFUSED, command);
        assert!(refused.contains("--passphrase-file") && refused.contains("--store-passphrase"), "{refused}");
    }
    assert!(!home.path().join("profiles/default/passphrase").exists());
    authros.json(&["identity", "create", "--store-passphrase"]);
    assert!(home.path().join("profiles/default/passphrase").exists());
    authros.json(&["keys", "list"]);
}

#[test]
fn three_wrong_passphrases_end_a_command_and_one_typed_ahead_counts() {
    let home = Home::new();
    let authros = with_keyring(&home);
    let keyring = home.path().join("profiles/default/keyring");
    let before = fs::read(&keyring).expect("a keyring");
    let wrong = ["the first guess", "a guess", "the last guess"];
    let mut console = asked(&authros, &["keys", "rotate"], QUESTION);
    // All at once: no echo comes back while the first is tried.
    console.press(&wrong.map(|guess| format!("{guess}\r")).concat());
    let shown = expect_end(console, 5, &wrong);
    assert!(shown.contains("three times"), "{shown}");
    assert_eq!(fs::read(&keyring).expect("a keyring"), before);

    let mut console = asked(&authros, &["keys", "list"], QUESTION);
    console.press(&format!("{}\r{PASSPHRASE}\r", wrong[0]));
    let shown = expect_end(console, 0, &[wrong[0], PASSPHRASE]);
    assert!(shown.contains("Wrong passphrase, try again.") && shown.contains("SM2 signing"), "{shown}");
}

#[test]
fn ctrl_c_and_an_empty_line_end_the_question_at_once() {
    let home = Home::new();
    let authros = with_keyring(&home);
    for keys in ["\u{3}", "half a secret\u{3}", "half a secret\u{4}", "\u{4}", "\r"] {
        let mut console = asked(&authros, &["keys", "list"], QUESTION);
        console.press(keys);
        let shown = expect_end(console, 5, &["half a secret"]);
        assert!(shown.contains("no passphrase was given; nothing was done"), "{keys:?}: {shown}");
    }
}

#[test]
fn a_signal_at_the_question_leaves_a_terminal_with_echo() {
    let home = Home::new();
    let authros = with_keyring(&home);
    for signal in ["INT", "TERM", "QUIT"] {
        let mut console = asked(&authros, &["keys", "list"], QUESTION);
        console.press("half a secret");
        console.signal(signal);
        assert!(!console.wait(PATIENCE).success(), "{signal}");
        console.expect_restored();
        assert!(!holds(&console.raw(), b"half a secret"), "{signal}");
    }
}

/// Runs a line of a shell in a terminal; `"$@"` is `authros keys list`.
fn in_shell(terminal: &Terminal, authros: &Authros, line: &str) -> Console {
    let program = authros.program().to_str().expect("UTF-8").to_owned();
    let words = ["/bin/sh", "-c", line, "sh", &program].map(str::to_owned).to_vec();
    Console::run(terminal, &[words, authros.arguments(&["keys", "list"])].concat(), &authros.variables())
}

#[test]
fn an_odd_terminal_hides_what_is_typed_and_stays_odd() {
    let home = Home::new();
    let authros = with_keyring(&home);
    let terminal = Terminal { name: "dumb", ..Terminal::of(100, 30) };
    let (before, after) = (home.root().join("before"), home.root().join("after"));
    let line = format!(
        "stty -icanon -icrnl; stty -g >{}; \"$@\"; echo ended $?; stty -g >{}",
        before.display(),
        after.display()
    );
    for (keys, code) in [(format!("{PASSPHRASE}\r"), 0), ("half a secret\u{3}".to_owned(), 5)] {
        let mut console = in_shell(&terminal, &authros, &line);
        console.wait_for(QUESTION, PATIENCE);
        console.press(&keys);
        console.wait_for(&format!("ended {code}"), PATIENCE);
        console.wait(PATIENCE);
        assert!(!holds(&console.raw(), PASSPHRASE.as_bytes()) && !holds(&console.raw(), b"half a secret"));
        let read = |path: &Path| fs::read_to_string(path).expect("stty ran");
        assert_eq!(read(&after), read(&before), "as stty sees it");
    }
}

#[test]
fn a_stopped_question_gives_the_terminal_back_and_is_asked_again() {
    let home = Home::new();
    let authros = with_keyring(&home);
    let [before, stopped, after] = ["before", "stopped", "after"].map(|name| home.root().join(name));
    let modes = |path: &Path| format!("stty -g >{}", path.display());
    let (begin, middle, end) = (modes(&before), modes(&stopped), modes(&after));
    let line = format!(
        "set -m; {begin}; \"$@\"; echo stopped $?; {middle}; read -r heard; echo \"the shell heard [$heard]\"; fg; \
         echo ended $?; {end}"
    );
    for (keys, code) in [(format!("{PASSPHRASE}\r"), 0), ("half a secret\u{3}".to_owned(), 5)] {
        let mut console = in_shell(&Terminal::of(100, 30), &authros, &line);
        console.wait_for(QUESTION, PATIENCE);
        console.press("half a secret\u{1a}");
        console.wait_for("stopped 14", PATIENCE);
        console.press("a line for the shell\r");
        console.wait_for("the shell heard [a line for the shell]", PATIENCE);
        let is_question = |bytes: &[u8]| bytes == QUESTION.as_bytes();
        wait_until(PATIENCE, "the question again", || {
            let times = console.raw().windows(QUESTION.len()).filter(|bytes| is_question(bytes)).count();
            (times >= 2).then_some(())
        });
        console.press(&keys);
        console.wait_for(&format!("ended {code}"), PATIENCE);
        console.wait(PATIENCE);
        assert!(!holds(&console.raw(), PASSPHRASE.as_bytes()) && !holds(&console.raw(), b"half a secret"));
        let read = |path: &Path| fs::read_to_string(path).expect("stty ran");
        assert_eq!((read(&stopped), read(&after)), (read(&before), read(&before)), "as stty sees it");
    }
}

#[test]
fn nobody_is_asked_where_standard_input_is_a_pipe() {
    let home = Home::new();
    let authros = with_keyring(&home);
    let file = home.file("piped", PASSPHRASE, 0o600);
    let mut console = in_shell(&Terminal::of(100, 30), &authros, &format!("cat {file} | \"$@\"; echo ended $?"));
    let shown = console.wait_for("ended 5", PATIENCE);
    assert!(shown.contains("is locked; pass --passphrase-file"), "{shown}");
    expect_end(console, 0, &[PASSPHRASE, QUESTION]);
}

#[test]
fn a_backup_asks_for_a_passphrase_of_its_own() {
    let home = Home::new();
    let authros = with_keyring(&home);
    let file = home.root().join("b.backup");
    let file = file.to_str().expect("UTF-8");
    let own = "the words of the backup";
    let mut console = asked(&authros, &["backup", "create", file], "New passphrase of this backup");
    console.press(&format!("{own}\r"));
    console.wait_for("Repeat it", PATIENCE);
    console.press(&format!("{own}\r"));
    expect_end(console, 0, &[own]);

    let elsewhere = Home::new();
    let mut console = asked(&plain(&elsewhere), &["backup", "restore", file], "Passphrase of the backup");
    console.press(&format!("{own}\r"));
    expect_end(console, 0, &[own]);
    assert!(elsewhere.path().join("profiles/default/keyring").exists());
}

#[test]
fn a_site_in_the_background_gets_the_passphrase_that_was_typed() {
    let _alone = heavy();
    let home = Home::new();
    let authros = with_keyring(&home);
    let mut console = asked(&authros, &["serve", "--detach"], QUESTION);
    console.press(&format!("{PASSPHRASE}\r"));
    let shown = expect_end(console, 0, &[PASSPHRASE]);
    let process = shown.split("kill -INT ").nth(1).and_then(|rest| rest.split_whitespace().next()).expect("a process");
    let listed = authros.run(&["keys", "list"]);
    support::process::signal("INT", process);
    wait_until(PATIENCE, "the site to end", || Some(()).filter(|()| home.socket().is_none()));
    listed.expect_code(0);
}

/// A program of the user's own.
fn script(home: &Home, name: &str, lines: &str) -> String {
    let path = home.file(name, format!("#!/bin/sh\n{lines}\n"), 0o700);
    format!(r#"["{path}", "an argument"]"#)
}

#[test]
fn a_program_gives_the_passphrase() {
    let home = Home::new();
    let program = script(&home, "gives", &format!("[ \"$1\" = 'an argument' ] && printf '{PASSPHRASE}\\nmore\\n'"));
    let authros = plain(&home).with(&["--passphrase-command", &program]);
    authros.json(&["identity", "create"]);
    authros.json(&["keys", "list"]);
    assert!(!home.path().join("profiles/default/passphrase").exists());
    let file = home.file("passphrase", PASSPHRASE, 0o600);
    plain(&home).json(&["keys", "list", "--passphrase-file", &file]);
    let both = authros.run(&["keys", "list", "--passphrase-file", &file]).expect_code(2);
    assert!(both.stderr.contains("cannot be used with"), "{both}");
    let no_list = plain(&home).run(&["keys", "list", "--passphrase-command", "pass show authros"]).expect_code(2);
    assert!(no_list.stderr.contains("give the program and its arguments as"), "{no_list}");
}

#[test]
fn a_program_that_gives_no_passphrase_ends_the_command_with_the_reason() {
    let home = Home::new();
    let authros = with_keyring(&home);
    let bad = [
        ("fails", format!("echo '{PASSPHRASE}'; exit 7"), "failed (exit status: 7)"),
        ("silent", "true".to_owned(), "empty first line"),
        ("long", "head -c 1048576 /dev/zero | tr '\\0' 'x'".to_owned(), "more than 4096 bytes"),
        ("hangs", format!("echo '{PASSPHRASE}'; exec sleep 1000"), "still running after 30 s"),
    ];
    for (name, lines, reason) in &bad {
        let program = script(&home, name, lines);
        let told = authros.fails(INPUT, &["keys", "list", "--passphrase-command", &program]);
        assert!(told.contains(reason) && told.contains(name), "{told}");
        assert!(!told.contains(PASSPHRASE), "{told}");
    }
}

#[test]
fn a_saved_keyring_is_brought_back_and_never_over_another() {
    let home = Home::new();
    let right = home.file("right", PASSPHRASE, 0o600);
    let wrong = home.file("wrong", "correct horse bakery", 0o600);
    let authros = plain(&home).with(&["--passphrase-file", &right]);
    let address = text(&authros.json(&["identity", "create"]), "address");
    let saved = home.root().join("saved.keyring");
    let saved = saved.to_str().expect("UTF-8");
    authros.run(&["keys", "backup", "--out", saved]).expect_code(0);
    let bytes = fs::read(saved).expect("saved");

    let keyring = home.path().join("profiles/default/keyring");
    let over = authros.fails(REFUSED, &["keys", "restore", saved]);
    assert!(over.contains("none is overwritten"), "{over}");
    fs::rename(&keyring, home.root().join("moved")).expect("moved away");
    let gone = authros.fails(REFUSED, &["identity", "create"]);
    assert!(gone.contains("keys restore FILE"), "{gone}");
    plain(&home).with(&["--passphrase-file", &wrong]).fails(REFUSED, &["keys", "restore", saved]);
    assert!(!keyring.exists(), "a wrong passphrase brings nothing back");
    let other = plain(&home).with(&["--profile", "spare", "--passphrase-file", &right]);
    let misplaced = other.fails(REFUSED, &["keys", "restore", saved]);
    assert!(misplaced.contains("authros --profile default keys restore"), "{misplaced}");

    // Another account's is refused, whatever opens it.
    let bob = plain(&home).with(&["--profile", "bob", "--passphrase-file", &right]);
    bob.json(&["identity", "create"]);
    let foreign = home.root().join("bob.keyring");
    let foreign = foreign.to_str().expect("UTF-8");
    bob.run(&["keys", "backup", "--out", foreign]).expect_code(0);
    let refused = authros.fails(REFUSED, &["keys", "restore", foreign]);
    assert!(refused.contains("is the keyring of account") && !keyring.exists(), "{refused}");

    // Typed at a terminal.
    let mut console = asked(&plain(&home), &["keys", "restore", saved], "Passphrase of the saved keyring");
    console.press(&format!("{PASSPHRASE}\r"));
    let shown = expect_end(console, 0, &[PASSPHRASE]);
    assert!(shown.contains(&address), "{shown}");
    assert_eq!(fs::read(&keyring).expect("back"), bytes);
    assert_eq!(fs::metadata(&keyring).expect("back").permissions().mode() & 0o777, 0o600);
    authros.json(&["keys", "list"]);

    // On another machine; it is no backup of a home.
    let elsewhere = Home::new();
    let whole = plain(&elsewhere).with(&["--passphrase-file", &right]);
    let backup = whole.fails(INPUT, &["backup", "restore", saved]);
    assert!(backup.contains("authros keys restore"), "{backup}");
    assert_eq!(text(&whole.json(&["keys", "restore", saved]), "address"), address);
}

#[test]
fn a_passphrase_given_to_a_list_opens_the_keyring_for_it_without_a_site() {
    let home = Home::new();
    let authros = home.authros().with(&["--robots", "1"]).storing_no_passphrase();
    let file = home.file("passphrase", PASSPHRASE, 0o600);
    let with = authros.with(&["--passphrase-file", &file]);
    with.json(&["identity", "create"]);
    with.capture(&["/robot1/odom"], 2);
    let states = |authros: &Authros| -> Vec<String> {
        authros.records(&["records", "list", "--oldest"]).iter().map(|record| text(record, "state")).collect()
    };
    assert_eq!(states(&authros), ["verified, names unchecked"; 2]);
    assert_eq!(states(&with), ["verified"; 2]);
    let wrong = home.file("wrong", "not the passphrase", 0o600);
    authros.with(&["--passphrase-file", &wrong]).fails(REFUSED, &["records", "list", "--oldest"]);
}
