//! Every command that a text names exists: messages, the manual, units, packages, scripts and tools. Tests run their own.

use std::fs;
use std::path::{Path, PathBuf};

use clap::CommandFactory as _;
use clap::error::ErrorKind;

use super::args::{self, Arguments};
use crate::chain::{ChainError, SEAL_ANEW};

/// Where commands are written.
const PLACES: [&str; 15] = [
    "src",
    "crates",
    "tests",
    "labs",
    "tools",
    "docs",
    "systemd",
    "packaging",
    "contracts/README.md",
    "contracts/genesis",
    "README.md",
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
];
/// Snapshots are drawn from the sources; corpora and pictures are bytes.
const LEFT_OUT: [&str; 4] = ["snapshots", "corpus", "pictures", "__pycache__"];

/// The words of a line, without its quotes.
pub fn words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    for letter in line.chars() {
        match (quote, letter) {
            (Some(open), _) if open == letter => quote = None,
            (None, '\'' | '"') => {
                quote = Some(letter);
                word.get_or_insert_default();
            }
            (None, _) if letter.is_whitespace() => words.extend(word.take()),
            _ => word.get_or_insert_default().push(letter),
        }
    }
    words.extend(word);
    words
}

fn texts(place: &Path, found: &mut Vec<(PathBuf, String)>) {
    let name = place.file_name().unwrap_or_default().to_string_lossy().into_owned();
    if LEFT_OUT.contains(&name.as_str()) {
        return;
    }
    if place.is_dir() {
        for entry in fs::read_dir(place).expect("a folder") {
            texts(&entry.expect("an entry").path(), found);
        }
    } else if let Ok(text) = fs::read_to_string(place) {
        // A text goes on after a backslash.
        found.push((place.to_owned(), text.replace("\\\n", " ")));
    }
}

fn everything() -> Vec<(PathBuf, String)> {
    let (root, mut found) = (Path::new(env!("CARGO_MANIFEST_DIR")), Vec::new());
    PLACES.iter().for_each(|place| texts(&root.join(place), &mut found));
    found
}

/// What stands between backticks and begins with the program's name. A quoted text ends with its line, so that an odd
/// backtick spoils no other line.
fn in_backticks(text: &str) -> Vec<String> {
    let named = text.lines().flat_map(|line| line.split('`').skip(1).step_by(2));
    named.filter(|quoted| quoted.starts_with("authros ")).map(alone).collect()
}

/// A command without what a shell does with it, and without its comment.
fn alone(line: &str) -> String {
    [" #", " | ", " > ", " & "].iter().fold(line, |line, end| line.split(end).next().unwrap_or_default()).to_owned()
}

/// Lines of scripts, units and of the manual's examples that begin with the program.
fn typed(text: &str) -> Vec<String> {
    let lines = text.lines().flat_map(|line| line.split(" && "));
    let begun = lines.map(str::trim_start).filter_map(|line| {
        let line = line.strip_prefix("$ ").or_else(|| line.strip_prefix("ExecStart=/usr/bin/")).unwrap_or(line);
        (line.starts_with("authros ") && !line.starts_with("authros  ") && !line.starts_with("authros ="))
            .then_some(line)
    });
    begun.map(alone).collect()
}

/// Why a command does not exist; values may be placeholders, and a noun may stand for all of its verbs.
fn unknown(command: &str) -> Option<String> {
    let words = words(command).into_iter().filter(|word| !["...", "…"].contains(&word.as_str()));
    // What a unit's own variable adds.
    let words = words.filter(|word| !word.starts_with('$') || word.contains('{'));
    let error = args::read(words.map(Into::into)).err()?;
    let exists = !matches!(error.kind(), ErrorKind::InvalidSubcommand | ErrorKind::UnknownArgument);
    if exists { None } else { Some(format!("`{command}`: {error}")) }
}

/// Two words in backticks of which the first is a command: the second has to be one of its verbs.
fn verbless(text: &str) -> Vec<String> {
    let all = Arguments::command();
    let is_wrong = |quoted: &&str| {
        let mut words = quoted.split(' ');
        let (Some(noun), Some(verb)) = (words.next(), words.next()) else { return false };
        let is_word = verb.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'-') && !verb.starts_with('-');
        let of_noun = all.find_subcommand(noun).filter(|command| command.has_subcommands());
        is_word && of_noun.is_some_and(|command| command.find_subcommand(verb).is_none())
    };
    let named = text.lines().flat_map(|line| line.split('`').skip(1).step_by(2));
    named.filter(is_wrong).map(str::to_owned).collect()
}

/// Words that a script of Python gives to the program.
fn run_by_python(text: &str) -> Vec<Vec<String>> {
    let calls = text.split("run(").skip(1).filter_map(|call| call.split([')', '\n']).next());
    calls.map(|call| call.split('"').skip(1).step_by(2).map(str::to_owned).collect()).collect()
}

#[test]
fn what_is_advised_where_a_chain_is_lost_parses() {
    let (url, what, path) = (String::from("http://node:8545"), "genesis block", PathBuf::from("chain.db"));
    let lost = [
        ChainError::Swapped { url, what, pinned: "a".to_owned(), found: "b".to_owned() },
        ChainError::Gone { path: path.clone() },
        ChainError::Tampered { path, block: 7, what: "its hash".to_owned() },
    ];
    for error in lost {
        let text = error.to_string();
        let [command] = in_backticks(&text).try_into().expect("one command");
        assert!(text.contains(SEAL_ANEW), "{text}");
        assert!(args::read(words(&command).into_iter().map(Into::into)).is_ok(), "{command}");
    }
}

#[test]
fn no_text_names_a_command_that_does_not_exist() {
    let (mut named, mut wrong) = (0, Vec::new());
    for (path, text) in everything() {
        let is_code = path.extension().is_some_and(|ends| ends == "rs" || ends == "py");
        let typed = if is_code { Vec::new() } else { typed(&text) };
        for command in in_backticks(&text).into_iter().chain(typed) {
            named += 1;
            wrong.extend(unknown(&command).map(|why| format!("{}: {why}", path.display())));
        }
        // In code, two words in backticks may be anything.
        let verbless = if is_code { Vec::new() } else { verbless(&text) };
        wrong.extend(verbless.iter().map(|quoted| format!("{}: `{quoted}`", path.display())));
    }
    assert!(named > 300, "{named}");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_tools_run_commands_that_exist() {
    let all = Arguments::command();
    let mut seen = 0;
    for (path, text) in everything() {
        if path.extension().is_none_or(|ends| ends != "py") {
            continue;
        }
        for words in run_by_python(&text) {
            let Some(at) = words.iter().position(|word| all.find_subcommand(word).is_some()) else { continue };
            let noun = all.find_subcommand(&words[at]).expect("a command");
            seen += 1;
            let verb = words.get(at + 1).filter(|_| noun.has_subcommands() && noun.get_name() != "audit");
            assert!(verb.is_none_or(|verb| noun.find_subcommand(verb).is_some()), "{}: {words:?}", path.display());
        }
    }
    assert!(seen > 5, "{seen}");
}

#[test]
fn commands_are_found_and_divided() {
    assert_eq!(words("authros a --to 'x y' \"friday 18:00\" ''"), ["authros", "a", "--to", "x y", "friday 18:00", ""]);
    let lines = "$ authros a b # why\nExecStart=/usr/bin/authros c\nx && authros d | e\nauthros = 1";
    assert_eq!(typed(lines), ["authros a b", "authros c", "authros d"]);
    assert!(unknown("authros uploads list").is_some() && unknown("authros records list --newest").is_some());
    assert_eq!(unknown("authros records show"), None, "a value may be missing");
    assert_eq!(verbless("see `records fly` and `records list --oldest`, `records`"), ["records fly"]);
}
