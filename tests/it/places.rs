//! Where files are: data, settings and console memory each in the user's folder for them, and a backup restores all of
//! it.

use std::fs;
use std::path::Path;

use crate::support::console::Console;
use crate::support::{Authros, Home, list, text};

const INPUT: i32 = 3;
const REFUSED: i32 = 5;
const SETTINGS: &str = "robots = 0\n";
const DATA: &str = ".local/share/authros";
const CONFIG: &str = ".config/authros";
const STATE: &str = ".local/state/authros";

fn write(user: &Home, path: &str, text: &str) {
    let path = user.root().join(path);
    fs::create_dir_all(path.parent().expect("a folder")).expect("made");
    fs::write(path, text).expect("written");
}

fn is_there(user: &Home, path: &str) -> bool {
    user.root().join(path).exists()
}

/// Where the number of robots comes from.
fn source_of_robots(authros: &Authros) -> String {
    let settings = list(&authros.json(&["config", "show"]), "settings");
    text(settings.iter().find(|setting| setting["name"] == "robots").expect("a setting"), "source")
}

#[test]
fn the_ledger_lies_with_the_data_and_settings_lie_apart() {
    let user = Home::new();
    write(&user, &format!("{CONFIG}/config.toml"), SETTINGS);
    let authros = Authros::bare(user.root());
    assert_eq!(source_of_robots(&authros), "config.toml line 1");
    authros.run(&["identity", "create"]).expect_code(0);
    assert!(is_there(&user, &format!("{DATA}/ledger.db")) && !is_there(&user, &format!("{DATA}/config.toml")));
    // Each variable moves only its folder.
    write(&user, "c/authros/config.toml", "\nrobots = 0\n");
    let place = |name: &str| user.root().join(name).to_str().expect("UTF-8").to_owned();
    let moved = authros.with_variable("XDG_CONFIG_HOME", &place("c"));
    assert_eq!(source_of_robots(&moved), "config.toml line 2");
    moved.with_variable("XDG_DATA_HOME", &place("d")).run(&["identity", "create"]).expect_code(0);
    assert!(is_there(&user, "d/authros/ledger.db"));
    // One folder has all of it.
    write(&user, "one/config.toml", "\n\nrobots = 0\n");
    for one in [authros.with(&["--home", &place("one")]), authros.with_variable("AUTHROS_HOME", &place("one"))] {
        assert_eq!(source_of_robots(&one), "config.toml line 3");
    }
    let message = authros.with_variable("XDG_DATA_HOME", "d").fails(INPUT, &["config", "show"]);
    assert!(message.contains("XDG_DATA_HOME") && message.contains("absolute"), "{message}");
}

#[test]
fn without_a_user_home_the_program_says_where_it_puts_things() {
    let user = Home::new();
    let authros = Authros::bare(user.root()).with_variable("HOME", "").with(&["--robots", "0"]);
    let told = authros.run(&["identity", "create"]).expect_code(0);
    assert!(told.stderr.contains("HOME is not set") && told.stderr.contains("authros-home"), "{told}");
    assert!(is_there(&user, "authros-home/ledger.db"));
    let data = user.root().join("d").to_str().expect("UTF-8").to_owned();
    let told = authros.with_variable("XDG_DATA_HOME", &data).run(&["identity", "create"]).expect_code(0);
    assert!(told.stderr.contains("d/authros") && is_there(&user, "d/authros/ledger.db"), "{told}");
    let told = authros.with(&["--home", &data]).run(&["config", "show"]).expect_code(0);
    assert!(!told.stderr.contains("HOME"), "{told}");
}

#[test]
fn what_a_console_remembers_lies_with_the_states() {
    let user = Home::new();
    let mut console = Console::open(&Authros::bare(user.root()).with(&["--robots", "1"]));
    console.wait_for("/robot1/odom", 30);
    console.press("q");
    assert!(console.wait(30).success());
    assert!(is_there(&user, &format!("{STATE}/console/default.json")));
    assert!(!is_there(&user, &format!("{DATA}/console")));
}

#[test]
fn a_back_up_takes_both_and_a_restore_puts_them_back() {
    let (user, theme, memory) = (Home::new(), "name = \"sea\"\n", "{\"screen\":\"Grants\"}");
    write(&user, "dotfiles/config.toml", SETTINGS);
    write(&user, &format!("{CONFIG}/themes/sea.toml"), theme);
    std::os::unix::fs::symlink(user.root().join("dotfiles/config.toml"), user.root().join(CONFIG).join("config.toml"))
        .expect("linked");
    write(&user, &format!("{STATE}/console/default.json"), memory);
    let authros = Authros::bare(user.root());
    authros.run(&["identity", "create"]).expect_code(0);
    let secret = user.file("secret", "a passphrase of its own\n", 0o600);
    let inside = user.root().join(CONFIG).join("themes/x").to_str().expect("UTF-8").to_owned();
    authros.fails(INPUT, &["backup", "create", &inside, "--passphrase-file", &secret]);
    let file = user.root().join("backup").to_str().expect("UTF-8").to_owned();
    authros.run(&["backup", "create", &file, "--passphrase-file", &secret]).expect_code(0);

    let restore = ["backup", "restore", &file, "--passphrase-file", &secret];
    let holds = |folder: &Path, name: &str, text: &str| {
        assert_eq!(fs::read_to_string(folder.join(name)).expect("there"), text, "{name}");
    };
    let other = Home::new();
    Authros::bare(other.root()).run(&restore).expect_code(0);
    holds(&other.root().join(CONFIG), "config.toml", SETTINGS);
    holds(&other.root().join(CONFIG), "themes/sea.toml", theme);
    holds(&other.root().join(STATE), "console/default.json", memory);
    assert!(is_there(&other, &format!("{DATA}/ledger.db")) && !is_there(&other, &format!("{DATA}/config.toml")));
    let shown = |authros: &Authros| authros.json(&["identity", "show"])["address"].clone();
    assert_eq!(shown(&Authros::bare(other.root())), shown(&authros));
    assert_eq!(source_of_robots(&Authros::bare(other.root())), "config.toml line 1");

    other.authros().run(&restore).expect_code(0);
    holds(&other.path(), "config.toml", SETTINGS);
    holds(&other.path(), "console/default.json", memory);

    let taken = Home::new();
    write(&taken, &format!("{CONFIG}/config.toml"), "robots = 1\n");
    let message = Authros::bare(taken.root()).fails(REFUSED, &restore);
    assert!(message.contains("config.toml") && !is_there(&taken, DATA), "{message}");
    holds(&taken.root().join(CONFIG), "config.toml", "robots = 1\n");
}
