//! The command line: every verb and flag, in the same terms as the console.

pub use super::capture::CaptureArguments;
pub use super::chain::ChainVerb;
pub use super::gateway::GatewayVerb;
pub use super::grants::GrantVerb;
pub use super::identity::IdentityVerb;
pub use super::keys::KeysVerb;
pub use super::records::{ListArguments, ReceivedVerb, RecordsVerb};
pub use super::robots::RobotVerb;
pub use super::settings::ConfigVerb;
pub use super::topics::TopicsVerb;

use std::{ffi::OsString, path::PathBuf};

use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand, ValueEnum, builder::FalseyValueParser};

use super::passphrase::program::Program;
use authros_output::Log;

/// Share robot data you can prove: messages sealed with SM4, signed with SM2, anchored by SM3 digest on a private
/// Ethereum network. Without a command it opens the operator console.
#[derive(Debug, Parser)]
#[command(
    name = "authros",
    version,
    max_term_width = 100,
    disable_help_subcommand = true,
    subcommand_precedence_over_arg = true
)]
pub struct Arguments {
    /// What applies to every command.
    #[command(flatten)]
    pub global: Global,
    /// What is printed instead of run.
    #[command(flatten)]
    pub print: PrintArguments,
    /// What to do; nothing = the console.
    #[command(subcommand)]
    pub verb: Option<Verb>,
}

/// Reads a command line; its errors and help are those of `help.rs`.
pub fn read(words: impl IntoIterator<Item = OsString>) -> Result<Arguments, clap::Error> {
    let mut command = super::help::command();
    let mut matches = command.try_get_matches_from_mut(with_values_joined(words))?;
    Arguments::from_arg_matches_mut(&mut matches).map_err(|error| error.format(&mut command))
}

/// Joins an option and a value that is named like a command by `=`. Otherwise clap takes the value for the command,
/// because commands go before values for the sake of `--ros2 topics list`.
pub fn with_values_joined(words: impl IntoIterator<Item = OsString>) -> Vec<OsString> {
    let command = Arguments::command();
    let is_command = |word: &OsString| command.find_subcommand(word).is_some();
    let takes_value = |word: &OsString| {
        let name = word.to_str().and_then(|word| word.strip_prefix("--"));
        let option = name.and_then(|name| command.get_arguments().find(|option| option.get_long() == Some(name)));
        option.is_some_and(|option| {
            option.get_action().takes_values() && option.get_num_args().is_none_or(|count| count.min_values() > 0)
        })
    };
    let mut words = words.into_iter().peekable();
    let mut joined: Vec<OsString> = words.next().into_iter().collect();
    while let Some(mut word) = words.next_if(|word| !is_command(word) && word != "--") {
        if takes_value(&word)
            && let Some(value) = words.next_if(is_command)
        {
            word.push("=");
            word.push(value);
        }
        joined.push(word);
    }
    joined.extend(words);
    joined
}

/// The verbs; `help.rs` has them in groups.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Walk through the paper's mission, in five minutes
    Tour(TourArguments),
    /// The operator console (also without any command)
    Console(ConsoleArguments),
    /// Run the site without a console
    Serve(super::serve::ServeArguments),
    /// Health of the site's parts, and the states of the records
    Status {
        /// Watch a running site and print changes; stop with Ctrl-C
        #[arg(long)]
        watch: bool,
    },
    /// Check everything a home depends on, and say what to fix
    Doctor,
    /// ROS topics: list, watch, pin publishers, quarantine
    #[command(subcommand)]
    Topics(TopicsVerb),
    /// Capture topics; ends when everything captured is verified
    Capture(CaptureArguments),
    /// Records: list, show, open, check, export, import, erase
    #[command(subcommand)]
    Records(RecordsVerb),
    /// Recordings (bag, MCAP): import, follow, export
    #[command(subcommand)]
    Bag(super::recordings::BagVerb),
    /// Identities of this home: create, register, list, compare
    #[command(subcommand)]
    Identity(IdentityVerb),
    /// Keys: list, load, rotate, export, back up, restore, lock
    #[command(subcommand)]
    Keys(KeysVerb),
    /// Share records with an account: add, extend, end, list
    #[command(subcommand)]
    Grant(GrantVerb),
    /// Records that others share with you: list, play into ROS
    #[command(subcommand)]
    Received(ReceivedVerb),
    /// Address book: names for accounts, and their keys
    #[command(subcommand)]
    Contacts(super::parties::ContactsVerb),
    /// Robots: enrol, run one, set policies, pull data, revoke
    #[command(subcommand)]
    Robot(super::robots::RobotVerb),
    /// Gateway for robots and operators that have no chain
    #[command(subcommand)]
    Gateway(GatewayVerb),
    /// Incidents: records that retention must keep
    #[command(subcommand)]
    Incident(super::incidents::IncidentVerb),
    /// Bundles that anyone can check: export, verify, timestamp
    #[command(subcommand)]
    Evidence(super::evidence::EvidenceVerb),
    /// Check all records; read, verify or export the audit log
    Audit(super::audit::AuditArguments),
    /// The chain: status, deploy, serve, cancel, administer
    #[command(subcommand)]
    Chain(ChainVerb),
    /// Alerts: list active ones, send a test
    #[command(subcommand)]
    Alerts(super::status::AlertsVerb),
    /// The whole home in one encrypted file: create, check, restore
    #[command(subcommand)]
    Backup(super::backups::BackupVerb),
    /// Settings: show, check
    #[command(subcommand)]
    Config(ConfigVerb),
    /// Explain a topic, such as grant or options, or a command
    Help {
        /// A topic of `authros help`, or the words of a command
        words: Vec<String>,
    },
    /// Candidates for a word of a command line; used by the completion scripts
    #[command(hide = true)]
    Complete {
        /// Kind of word: topic, contact, record or profile
        what: crate::service::completing::Completed,
        /// First characters of the word
        #[arg(default_value = "", allow_hyphen_values = true)]
        begun: String,
    },
}

/// `tour …`
#[derive(Debug, Args)]
pub struct TourArguments {
    /// night, day, contrast or mono
    #[arg(long, value_name = "NAME", conflicts_with = "plain")]
    pub theme: Option<String>,
    /// Plain ASCII glyphs
    #[arg(long, conflicts_with = "plain")]
    pub ascii: bool,
    /// Run the mission without the console, from capture to refusal, and print its figures
    #[arg(long)]
    pub plain: bool,
    /// With --plain: total capture time in seconds, 2 to 600
    #[arg(long, default_value_t = 10, value_name = "N", requires = "plain", value_parser = clap::value_parser!(u64).range(2..=600))]
    pub seconds: u64,
}

/// What is printed instead of run: defaults to start your own files from, completions, the manual page.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Instead of a command")]
pub struct PrintArguments {
    /// Print every setting with its default, as a config.toml
    #[arg(long = "print-default-config", group = "printed")]
    pub default_config: bool,
    /// Print the console's keys, as a keymap.toml
    #[arg(long = "print-default-keymap", group = "printed")]
    pub default_keymap: bool,
    /// Print a theme of the console
    #[arg(long = "print-default-theme", value_name = "NAME", group = "printed", require_equals = true,
          num_args = 0..=1, default_missing_value = "night")]
    pub default_theme: Option<String>,
    /// Print the completion script for a shell
    #[arg(long = "print-completions", value_name = "SHELL", value_enum, group = "printed")]
    pub completions: Option<clap_complete::Shell>,
    /// Print the manual page, for `man -l -`
    #[arg(long = "print-manual", group = "printed")]
    pub manual: bool,
}

/// `console …`
#[derive(Debug, Default, Args)]
pub struct ConsoleArguments {
    /// night, day, contrast, mono, or one of your own
    #[arg(long, value_name = "NAME")]
    pub theme: Option<String>,
    /// Plain ASCII glyphs
    #[arg(long)]
    pub ascii: bool,
    /// Read-only: nothing can be changed
    #[arg(long)]
    pub read_only: bool,
}

/// How lines beside the result are written.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum LogForm {
    /// For people
    #[default]
    Text,
    /// One JSON object per line: time, level, source, message
    Json,
}

impl From<LogForm> for Log {
    fn from(form: LogForm) -> Self {
        match form {
            LogForm::Text => Self::Text,
            LogForm::Json => Self::Json,
        }
    }
}

/// Flags of every command, listed behind a command's own.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Options of every command")]
pub struct Global {
    /// Directory of this site, including settings [default: $XDG_DATA_HOME/authros or ~/.local/share/authros]
    #[arg(long, global = true, value_name = "DIR", env = "AUTHROS_HOME")]
    pub home: Option<PathBuf>,
    /// Profile (identity on this machine) [default: default]
    #[arg(long, global = true, value_name = "NAME", env = "AUTHROS_PROFILE")]
    pub profile: Option<String>,
    /// Print the result as one JSON document on stdout (streams: one per line)
    #[arg(long, global = true)]
    pub json: bool,
    /// Format of lines on stderr
    #[arg(long, global = true, value_enum, value_name = "FORM", default_value = "text")]
    pub log: LogForm,
    /// File with the keyring's passphrase (first line)
    #[arg(long, global = true, value_name = "FILE", conflicts_with_all = ["passphrase_fd", "passphrase_command"])]
    pub passphrase_file: Option<PathBuf>,
    /// File descriptor to read the keyring's passphrase from
    #[arg(long, global = true, value_name = "N", conflicts_with = "passphrase_command")]
    pub passphrase_fd: Option<u32>,
    /// Program that prints the keyring's passphrase, such as `["/usr/bin/pass", "show", "authros"]`; no shell reads it
    #[arg(long, global = true, value_name = "LIST")]
    pub passphrase_command: Option<Program>,
    /// Where a new keyring gets no passphrase: write a random one beside it, for use without a terminal
    #[arg(long, global = true, env = "AUTHROS_STORE_PASSPHRASE", value_parser = FalseyValueParser::new())]
    pub store_passphrase: bool,
    /// Join somebody else's running site as an operator, at the socket that its owner named in operators.socket
    #[arg(
        long,
        global = true,
        value_name = "PATH",
        env = "AUTHROS_SITE_SOCKET",
        conflicts_with_all = ["passphrase_file", "passphrase_fd", "passphrase_command"]
    )]
    pub site_socket: Option<PathBuf>,
    /// Real ROS master, such as http://host:11311
    #[arg(long, global = true, value_name = "URI")]
    pub ros_master: Option<String>,
    /// Also capture ROS 2 in this domain [without a number: $ROS_DOMAIN_ID, else 0]
    #[arg(long, global = true, value_name = "DOMAIN", num_args = 0..=1, require_equals = false, default_missing_value = "")]
    pub ros2: Option<String>,
    /// Node of a real chain: http://, https:// or IPC path
    #[arg(long, global = true, value_name = "URL")]
    pub chain: Option<String>,
    /// Address of the `AuthROS` contract on that chain
    #[arg(long, global = true, value_name = "ADDRESS")]
    pub contract: Option<String>,
    /// How the embedded chain seals: poa, poa:SIGNERS:PERIOD_MS, pow or pow:DIFFICULTY
    #[arg(long, global = true, value_name = "NAME")]
    pub consensus: Option<String>,
    /// Redis as a cache in front of the store, such as redis://host:6379
    #[arg(long, global = true, value_name = "URL")]
    pub cache: Option<String>,
    /// Simulated robots on the embedded master, 0 to 32
    #[arg(long, global = true, value_name = "N")]
    pub robots: Option<String>,
    /// Kind of simulated robots: own (nodes of this process) or rosrust (each a process of the program authros-rosrust)
    #[arg(long, global = true, value_name = "NAME")]
    pub robots_by: Option<String>,
    /// Number of blocks until an anchor counts as confirmed
    #[arg(long, global = true, value_name = "N")]
    pub confirmations: Option<String>,
    /// authros (its own kernels), rustcrypto or libsm
    #[arg(long, global = true, value_name = "NAME")]
    pub crypto_provider: Option<String>,
    /// Join a remote site through its gateway, which supplies records and chain; further addresses of the same gateway
    /// may follow, each after another --site
    #[arg(long, global = true, value_name = "HOST:PORT")]
    pub site: Vec<String>,
    /// That gateway's identity key, 64 hex digits, from its operator (not the eight-group fingerprint printed beside
    /// it)
    #[arg(long, global = true, value_name = "KEY", conflicts_with = "trust_first")]
    pub gateway_key: Option<String>,
    /// Pin the first gateway that answers
    #[arg(long, global = true)]
    pub trust_first: bool,
    /// batch (Merkle roots) or each (one transaction per record)
    #[arg(long, global = true, value_name = "MODE")]
    pub anchor_mode: Option<String>,
}

impl Global {
    /// Flags with a value, each with its setting. The exhaustive pattern makes a forgotten flag a compile error.
    pub fn valued(&self) -> [(&'static str, &'static str, Option<&str>); 12] {
        let Self {
            home: _,
            profile: _,
            json: _,
            log: _,
            passphrase_file: _,
            passphrase_fd: _,
            passphrase_command: _,
            store_passphrase: _,
            site_socket: _,
            ros_master,
            ros2,
            chain,
            contract,
            consensus,
            cache,
            robots,
            robots_by,
            confirmations,
            crypto_provider,
            site: _,
            gateway_key,
            trust_first: _,
            anchor_mode,
        } = self;
        [
            ("--ros-master", "ros.master", ros_master.as_deref()),
            ("--ros2", "ros.domain", ros2.as_deref()),
            ("--chain", "chain.url", chain.as_deref()),
            ("--contract", "chain.contract", contract.as_deref()),
            ("--consensus", "chain.consensus", consensus.as_deref()),
            ("--cache", "cache.url", cache.as_deref()),
            ("--robots", "robots", robots.as_deref()),
            ("--robots-by", "ros.robots_by", robots_by.as_deref()),
            ("--confirmations", "confirmations", confirmations.as_deref()),
            ("--crypto-provider", "crypto.provider", crypto_provider.as_deref()),
            ("--gateway-key", "site.gateway_key", gateway_key.as_deref()),
            ("--anchor-mode", "anchor.mode", anchor_mode.as_deref()),
        ]
    }

    pub fn setting(&self, name: &str) -> Option<String> {
        let valued = || self.valued().into_iter().find(|(_, setting, _)| *setting == name)?.2.map(str::to_owned);
        match name {
            "ros.domain" => valued().map(domain),
            "site.address" => (!self.site.is_empty()).then(|| self.site.join(",")),
            "site.trust_first" => self.trust_first.then(|| "yes".to_owned()),
            _ => valued(),
        }
    }
}

/// A flag without a number means $ROS_DOMAIN_ID, else 0.
fn domain(written: String) -> String {
    let of_environment = || std::env::var("ROS_DOMAIN_ID").ok().filter(|value| !value.is_empty());
    Some(written).filter(|written| !written.is_empty()).or_else(of_environment).unwrap_or_else(|| "0".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }

    /// clap takes such a pair for one option: it panics where it reads the other's type, and a place without a name hides the
    /// option.
    #[test]
    fn an_option_named_as_one_of_every_command_is_that_option() {
        fn look(command: &clap::Command, every: &[&clap::Arg], path: &str) {
            for verb in command.get_subcommands() {
                let path = format!("{path} {}", verb.get_name());
                for own in verb.get_arguments().filter(|argument| !argument.is_global_set()) {
                    let twin = every.iter().find(|global| global.get_id() == own.get_id());
                    let same = twin.is_none_or(|twin| {
                        let types = [*twin, own].map(|argument| argument.get_value_parser().type_id());
                        types[0] == types[1] && twin.get_long() == own.get_long()
                    });
                    assert!(same, "{path} --{}", own.get_id());
                }
                look(verb, every, &path);
            }
        }
        let command = Arguments::command();
        let every: Vec<&clap::Arg> = command.get_arguments().filter(|argument| argument.is_global_set()).collect();
        assert!(every.iter().any(|argument| argument.get_id() == "robots"), "they are found");
        look(&command, &every, "authros");
    }

    #[test]
    fn flags_may_stand_behind_the_verb() {
        let parsed = Arguments::try_parse_from([
            "authros", "capture", "--topic", "/a", "--count", "3", "--json", "--home", "/x",
        ]);
        let arguments = parsed.expect("parses");
        assert!(arguments.global.json);
        assert!(matches!(arguments.verb, Some(Verb::Capture(capture)) if capture.count == Some(3)));
    }

    #[test]
    fn a_value_may_be_named_like_a_command() {
        let parse = |line: &str| {
            Arguments::try_parse_from(with_values_joined(line.split(' ').map(OsString::from)))
                .unwrap_or_else(|error| panic!("{line}: {error}"))
        };
        for line in
            ["authros --profile audit status", "authros --profile=audit status", "authros status --profile audit"]
        {
            let read = parse(line);
            assert_eq!(read.global.profile.as_deref(), Some("audit"), "{line}");
            assert!(matches!(read.verb, Some(Verb::Status { watch: false })), "{line}");
        }
        let read = parse("authros --json --home tour --profile serve --ros2 topics list");
        assert_eq!((read.global.home, read.global.profile), (Some("tour".into()), Some("serve".to_owned())));
        assert!(read.global.json && read.global.ros2.is_some() && matches!(read.verb, Some(Verb::Topics(_))));
        assert!(parse("authros --profile audit").verb.is_none(), "the console of that profile");
        let read = parse("authros contacts add --fingerprint chain grant bob");
        assert!(matches!(read.verb, Some(Verb::Contacts(_))), "behind the command nothing is joined");
    }

    #[test]
    fn one_key_at_a_time() {
        assert!(Arguments::try_parse_from(["authros", "keys", "load"]).is_err());
        for act in
            [&["gateway", "join-file"][..], &["keys", "backup"], &["keys", "export", "eoa"], &["records", "open", "a"]]
        {
            let line = |file| ["authros"].into_iter().chain(act.iter().copied()).chain(["--out", file]);
            assert!(Arguments::try_parse_from(line("file")).is_ok(), "{act:?}");
            let refused = Arguments::try_parse_from(line("-")).expect_err("no file").to_string();
            assert!(refused.contains("name a file"), "{refused}");
        }
        assert!(Arguments::try_parse_from(["authros", "keys", "load", "--sm4", "a", "--eoa", "b"]).is_err());
    }
}

#[cfg(test)]
mod global_tests {
    use crate::cli::args::Arguments;
    use clap::Parser;

    fn domain(arguments: &[&str]) -> Option<String> {
        let read = Arguments::try_parse_from(["authros"].iter().chain(arguments)).expect("arguments");
        read.global.setting("ros.domain")
    }

    #[test]
    fn the_domain_may_be_left_out_and_takes_no_command_for_a_number() {
        assert_eq!(domain(&["--ros2", "7"]).as_deref(), Some("7"));
        assert_eq!(domain(&["topics", "list", "--ros2", "7"]).as_deref(), Some("7"));
        assert_eq!(domain(&["topics", "list"]), None);
        for without in [&["--ros2"][..], &["--ros2", "topics", "list"], &["doctor", "--ros2"]] {
            assert!(domain(without).is_some_and(|domain| domain.parse::<u16>().is_ok()), "{without:?}");
        }
    }
}
