//! What `--help` and `authros help` say: commands in groups, options of every command on a page of their own, topics.

use std::fmt::Write as _;

use clap::{Args as _, Command, CommandFactory as _};

use super::args::{Arguments, Global, PrintArguments};
use super::parse::usage;
use crate::model::clean;
use crate::service::Failure;

/// Every command, in the order in which a newcomer needs them.
const GROUPS: [(&str, &[&str]); 7] = [
    ("Start", &["tour", "console", "serve", "status", "doctor"]),
    ("Data", &["topics", "capture", "records", "bag"]),
    ("Sharing", &["identity", "keys", "grant", "received", "contacts"]),
    ("Robots", &["robot", "gateway"]),
    ("Evidence", &["incident", "evidence", "audit"]),
    ("Chain", &["chain"]),
    ("Upkeep", &["alerts", "backup", "config", "help"]),
];

struct Topic {
    name: &'static str,
    about: &'static str,
    text: &'static str,
}

static TOPICS: [Topic; 6] = [
    Topic {
        name: "grant",
        about: "How another account gets to read your records",
        text: "\
A grant lets another account read your records. It gives keys: one for each
epoch, the time between two changes of keys. A key opens its whole epoch.

  authros grant add bob                    all topics, since this epoch began
  authros grant add bob --from now         nothing older; begins a new epoch
  authros grant add bob --from start       everything you ever recorded
  authros grant add bob --topic '/robot1/**' --expires 'friday 18:00'
  authros grant add bob --from 1h --dry-run     what it would open, and its cost
  authros grant extend bob --expires 30d        a later end, the same records
  authros grant list                            yours and those you received
  authros grant end bob                         ends it and begins a new epoch

Name bob once: `authros contacts add bob 0xADDRESS`. Bob has to be registered
(`authros identity register`), finds your records with `authros received list`,
opens one with `authros records open ID`, and publishes them in a ROS graph of
his own with `authros received play`.

After the end your site refuses bob everything. What bob has copied by then
stays readable to bob.
",
    },
    Topic {
        name: "robot",
        about: "How a robot without a chain records for you",
        text: "\
A robot signs with keys of its own and sends sealed records to a gateway, which
anchors them.

  authros gateway serve --listen 0.0.0.0:7420     on the gateway; prints its key
  authros gateway allow 0xOWNER                   there: who may use it
  authros robot enrol --gateway HOST:7420 --gateway-key HEX --name scout-1 \\
          --topic /odom --out scout-1.enrolment   yours; writes the robot's file
  authros robot run scout-1.enrolment             on the robot
  authros robot list                              last seen, lag, losses, policy
  authros robot policy scout-1 --set scout.toml   what it captures
  authros robot topics add scout-1 /imu           keys of a further topic
  authros robot pull scout-1 --since 10m          unwatched data from its ring
  authros robot revoke scout-1                    it can no longer sign or read
",
    },
    Topic {
        name: "evidence",
        about: "How somebody checks records without trusting you",
        text: "\
  authros incident open crash --since 10m                keep these records
  authros evidence export crash.authros --incident crash --reveal-topic /odom
  authros evidence verify crash.authros --trust trust.toml      by the reader

The reader needs no home, no keys and no network, only a trust file with what
they know from another source: the chain, who seals it, and your account
(docs/evidence.md has an example). You disclose messages by topic or pattern
(--reveal-topic), one by one (--reveal ID), or all that are chosen (--reveal
all); of the others the bundle proves that they exist, not what they say.

  authros evidence timestamp                    stamps of the authorities, now
  authros records export ID --dir out           one record, for openssl
  authros evidence verify out --chain URL       the same against a chain
",
    },
    Topic {
        name: "times",
        about: "How times and lengths of time are written",
        text: "\
  10m  12h  30d  2w  40s  500ms       ago (--since), or from now (--expires)
  18:00  18:00:05.250                 the last one, or for an end the next one
  friday 18:00   tomorrow 18:00       a day and a clock; without one its first
  2026-11-27 18:00  2026-11-27        a date
  2026-11-27T18:00:00Z                RFC 3339, exact to the nanosecond
  now                                 this moment

A clock without a zone is in your time zone; add Z, UTC or an offset for another
(18:00Z, 18:00+01:00). --since is part of the span, --until is not. Unless the
text says all of it, the meaning is told on stderr.
",
    },
    Topic {
        name: "patterns",
        about: "How topics are named, and whole robots",
        text: "\
  /robot1/odom           that topic
  /robot*/odom           * is anything within one part
  /robot*/camera/**      ** is anything, across parts
  --robot robot1         the same as /robot1/**

Quote patterns, so that your shell leaves them alone. A watch by pattern also
covers topics that appear later:

  authros topics watch '/robot*/camera/**'
  authros topics watch --robot robot1
  authros capture --topic '/robot*/odom' --for 1m
  authros records list --topic '**/odom' --since 1h
",
    },
    Topic {
        name: "codes",
        about: "What the exit codes mean",
        text: "\
  0  done                      5  refused by a peer, the chain or a check
  1  a fault of the program    6  stored data was altered or is missing
  2  wrong arguments           7  the home is in use or cannot be written
  3  wrong input               8  incomplete: part of it was done
  4  a peer does not answer

With --json an error is a document on stdout too, with its kind and message.
",
    },
];

/// The program's commands as a person reads them: each with its own options only.
pub fn command() -> Command {
    let hidden = Arguments::command()
        .mut_args(|option| if option.is_global_set() { option.hide(true) } else { option })
        .mut_subcommands(pointing);
    let help = overview(&hidden);
    hidden.override_help(help)
}

fn pointing(verb: Command) -> Command {
    verb.after_help("`authros help options` lists the options of every command.").mut_subcommands(pointing)
}

fn overview(command: &Command) -> String {
    let mut text = String::from(
        "Share robot data you can prove: sealed with SM4, signed with SM2, and anchored\n\
         by SM3 digest on a private Ethereum network.\n\n\
         Usage: authros [OPTIONS] [COMMAND]       without a command: the console\n",
    );
    for (group, names) in GROUPS {
        text.push('\n');
        let heads = std::iter::once(group).chain(std::iter::repeat(""));
        for (name, head) in names.iter().zip(heads) {
            let about = command.find_subcommand(name).and_then(Command::get_about).map(ToString::to_string);
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{head:<9} {name:<9} {}", about.unwrap_or_default());
        }
    }
    text + "\nauthros COMMAND -h: its options; authros help: topics; authros help options: all"
}

/// A topic, a command's help, or the list of topics.
pub fn page(words: &[String]) -> Result<String, Failure> {
    match words {
        [] => Ok(topics()),
        [name] if name == "options" => Ok(options()),
        [name] => {
            let topic = TOPICS.iter().find(|topic| topic.name == name);
            topic.map_or_else(|| of_command(words), |topic| Ok(explained(topic)))
        }
        words => of_command(words),
    }
}

fn topics() -> String {
    let mut text = String::from("authros help TOPIC explains:\n\n");
    for Topic { name, about, .. } in &TOPICS {
        let _ = writeln!(text, "  {name:<9} {about}");
    }
    text + "  options   The options of every command\n\nauthros help COMMAND shows its options, as authros COMMAND -h does.\n"
}

/// A topic named like a command ends with that command's verbs.
fn explained(topic: &Topic) -> String {
    let noun = format!("authros {}", topic.name);
    let of_command = command().find_subcommand(topic.name).is_some();
    let further = if of_command { format!("\n`{noun} -h` lists all its commands.\n") } else { String::new() };
    format!("{}\n\n{}{further}", topic.about, topic.text)
}

fn options() -> String {
    let bare = Command::new("authros").disable_help_flag(true).max_term_width(100).help_template("{all-args}");
    let mut every = Global::augment_args(PrintArguments::augment_args(bare));
    every.render_help().to_string()
}

fn of_command(words: &[String]) -> Result<String, Failure> {
    let mut all = command();
    all.build();
    let mut found = &mut all;
    for word in words {
        found = found.find_subcommand_mut(word).ok_or_else(|| {
            let what = clean(&words.join(" "), 60);
            usage(format!(
                "there is no command or topic '{what}'; `authros help` lists topics, `authros --help` commands"
            ))
        })?;
    }
    Ok(found.render_help().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a terminal that is common.
    const SCREEN: (usize, usize) = (80, 40);

    /// With a row left for the prompt; a terminal wraps what is wider.
    fn fits(what: &str, text: &str) {
        let rows: usize = text.lines().map(|line| line.chars().count().div_ceil(SCREEN.0).max(1)).sum();
        assert!(rows < SCREEN.1, "{what} has {rows} rows:\n{text}");
    }

    fn fits_unwrapped(what: &str, text: &str) {
        let wide: Vec<&str> = text.lines().filter(|line| line.chars().count() > SCREEN.0).collect();
        assert!(wide.is_empty(), "{what} is wider than {} columns: {wide:?}", SCREEN.0);
        fits(what, text);
    }

    fn verbs(command: &Command) -> impl Iterator<Item = &Command> {
        command.get_subcommands().filter(|verb| !verb.is_hide_set())
    }

    fn each(command: &mut Command, path: &str, look: &mut impl FnMut(&str, &mut Command)) {
        look(path, command);
        for verb in command.get_subcommands_mut() {
            let path = format!("{path} {}", verb.get_name());
            each(verb, &path, look);
        }
    }

    #[test]
    fn every_command_is_in_one_group_and_they_are_at_most_24() {
        let command = command();
        let mut names: Vec<&str> = verbs(&command).map(Command::get_name).collect();
        let mut grouped: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
        assert!(grouped.len() <= 24, "{grouped:?}");
        names.sort_unstable();
        grouped.sort_unstable();
        assert_eq!(grouped, names);
    }

    #[test]
    fn the_commands_are_one_screen() {
        let help = command().render_long_help().to_string();
        assert_eq!(help, command().render_help().to_string(), "the same with -h");
        fits_unwrapped("--help", &help);
        for (group, names) in GROUPS {
            assert!(names.iter().all(|name| help.contains(&format!(" {name} "))) && help.contains(group), "{help}");
        }
    }

    #[test]
    fn help_of_each_command_is_a_screen_without_the_options_of_every_command() {
        let mut all = command().term_width(SCREEN.0);
        all.build();
        let options = options();
        assert!(options.contains("--passphrase-file") && options.contains("--print-manual"), "{options}");
        let mut seen = 0;
        each(&mut all, "authros", &mut |path, command| {
            let help = command.render_help().to_string();
            assert!(!help.contains("--home") && !help.contains("--passphrase-file"), "{path}:\n{help}");
            fits(path, &help);
            seen += 1;
        });
        assert!(seen > 100, "{seen}");
    }

    #[test]
    fn topics_fit_a_screen_and_a_command_can_be_asked_for() {
        let word = |word: &str| page(&[word.to_owned()]).expect(word);
        fits_unwrapped("help", &page(&[]).expect("topics"));
        for topic in &TOPICS {
            fits_unwrapped(topic.name, &word(topic.name));
            assert!(topics().contains(topic.name) && word(topic.name).contains(topic.text));
        }
        assert!(word("grant").contains("authros grant end bob") && word("grant").contains("`authros grant -h`"));
        let extend = page(&["grant".to_owned(), "extend".to_owned()]).expect("a command");
        assert!(extend.contains("--expires") && extend.contains("authros grant extend"), "{extend}");
        let unknown = page(&["fly".to_owned()]).expect_err("no such");
        assert!(unknown.message.contains("'fly'") && unknown.message.contains("`authros help`"), "{unknown:?}");
    }

    /// Commands of a page begin with the program's name; what follows two spaces explains them.
    #[test]
    fn every_command_of_a_topic_parses() {
        let mut read = 0;
        for Topic { name, text, .. } in &TOPICS {
            for line in text.replace("\\\n          ", "").lines().filter_map(|line| line.strip_prefix("  authros ")) {
                let line = line.split("  ").next().unwrap_or_default();
                let words = super::super::quoted::words(&format!("authros {line}"));
                let parsed = super::super::args::read(words.into_iter().map(Into::into));
                assert!(parsed.is_ok(), "{name}: authros {line}: {}", parsed.expect_err("wrong"));
                read += 1;
            }
        }
        assert!(read > 25, "{read}");
    }
}
