//! The command line: every verb and flag, in the same terms as the console.

pub use super::capture::CaptureArguments;
pub use super::chain::ChainVerb;
pub use super::grants::{GrantArguments, GrantsVerb};
pub use super::identity::IdentityVerb;
pub use super::keys::KeysVerb;
pub use super::records::{ListArguments, SharedVerb, UploadsVerb};
pub use super::settings::ConfigVerb;
pub use super::topics::TopicsVerb;

use std::{ffi::OsString, net::SocketAddr, path::PathBuf};

use clap::{Args, CommandFactory as _, Parser, Subcommand, ValueEnum, builder::FalseyValueParser};

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

/// The verbs.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Create or show an identity
    #[command(subcommand)]
    Identity(IdentityVerb),
    /// Show, load, rotate or export keys
    #[command(subcommand)]
    Keys(KeysVerb),
    /// Register the identity on the chain
    Register,
    /// ROS topics: list, watch, unwatch, pin publishers
    #[command(subcommand)]
    Topics(TopicsVerb),
    /// Quarantined messages (their publisher is not pinned): list, release, discard
    #[command(subcommand)]
    Quarantine(super::quarantine::QuarantineVerb),
    /// Capture topics; ends when everything captured is verified
    Capture(CaptureArguments),
    /// Recordings (bag, MCAP): import
    #[command(subcommand)]
    Bag(super::recordings::BagVerb),
    /// Own records: list, show, export; import those of another home
    #[command(subcommand)]
    Uploads(UploadsVerb),
    /// Share records with an account
    Grant(GrantArguments),
    /// Stop sharing with an account (begins a new epoch)
    Revoke {
        /// Account: 0x and 40 hex digits, or a name from the address book
        address: String,
    },
    /// Grants given and received
    #[command(subcommand)]
    Grants(GrantsVerb),
    /// Records shared with this profile: list, check, open, export, play
    #[command(subcommand)]
    Shared(SharedVerb),
    /// Devices that may sign for this profile: authorise and revoke them, set topics and addresses, list
    #[command(subcommand)]
    Devices(super::robots::DevicesVerb),
    /// Robots without a chain: enrol one, or run the agent on it
    #[command(subcommand)]
    Agent(AgentVerb),
    /// Enrolled robots: list them, set what they capture, fetch what their rings keep
    #[command(subcommand)]
    Robots(super::robots::RobotsVerb),
    /// The chain
    #[command(subcommand)]
    Chain(ChainVerb),
    /// Address book: names for accounts, and their keys
    #[command(subcommand)]
    Contacts(super::parties::ContactsVerb),
    /// Check all records against proofs and chain; audit log: list, verify, export
    Audit(super::audit::AuditArguments),
    /// Incidents: records that retention must keep: open, list, show, note, close, remove
    #[command(subcommand)]
    Incident(super::incidents::IncidentVerb),
    /// Erase chosen records permanently; their proofs stay
    #[command(subcommand)]
    Retention(super::retention::RetentionVerb),
    /// Alerts: list active ones, send a test
    #[command(subcommand)]
    Alerts(super::status::AlertsVerb),
    /// Check everything a home depends on, and say what to fix
    Doctor,
    /// Evidence bundles that can be checked without trusting anyone: export, stamp
    #[command(subcommand)]
    Evidence(super::evidence::EvidenceVerb),
    /// Check a bundle of `evidence export` offline against --trust, or a folder of `uploads export` against the chain at
    /// --chain; without home or keys
    Verify {
        /// The bundle, unpacked or not, or the folder
        path: PathBuf,
        /// For a bundle: what you know about chain, signers and people from an independent source (docs/evidence.md)
        #[arg(long, value_name = "FILE", conflicts_with = "genesis")]
        trust: Option<PathBuf>,
        /// For the proof of a followed recording: the recorded file, to compare with the digests that the proof states
        #[arg(long, value_name = "FILE", conflicts_with = "genesis")]
        recording: Option<PathBuf>,
        /// Hash of the chain's block 0, from a source other than the folder
        #[arg(long, value_name = "HASH")]
        genesis: Option<String>,
        /// For a bundle: also list each record, by topic and time, with what its owner disclosed
        #[arg(long, conflicts_with = "genesis")]
        records: bool,
        /// For a bundle: as --records, with the reason of each level even where nothing is in doubt
        #[arg(long, conflicts_with = "genesis")]
        verbose: bool,
    },
    /// Write profiles, store and chain, settings and pins into one encrypted file
    Backup(BackupArguments),
    /// Restore a home from a backup, into an empty folder
    Restore {
        /// The file; type its own passphrase, or pass it as for a keyring
        file: PathBuf,
        /// Only test it: restore it into a temporary folder, audit all of it, and remove that folder
        #[arg(long)]
        check: bool,
    },
    /// List the profiles of this home
    Profiles,
    /// Settings: show, check
    #[command(subcommand)]
    Config(ConfigVerb),
    /// Health of the site's parts, and the states of this profile's records
    Status {
        /// Watch a running site and print changes; stop with Ctrl-C
        #[arg(long)]
        watch: bool,
    },
    /// Run the site without a console
    Serve(super::serve::ServeArguments),
    /// Gateway: serve robots and operators that have no chain client
    #[command(subcommand)]
    Gateway(GatewayVerb),
    /// The paper's crime-scene mission, from capture to refusal, on embedded parts
    Demo(DemoArguments),
    /// Walks you through the same mission in the console, with instructions at the bottom; five minutes
    Tour(TourArguments),
    /// The operator console (also without any command)
    Console(ConsoleArguments),
    /// Print the completion script for a shell
    Completions {
        /// The shell
        #[arg(value_enum)]
        shell: clap_complete::Shell,
    },
    /// Candidates for a word of a command line; used by the completion scripts
    #[command(hide = true)]
    Complete {
        /// Kind of word
        #[arg(value_enum)]
        what: super::complete::Word,
        /// First characters of the word
        #[arg(default_value = "", allow_hyphen_values = true)]
        begun: String,
    },
    /// Print the manual page, for `man -l -`
    Man,
}

/// `backup …`
#[derive(Debug, Args)]
pub struct BackupArguments {
    /// The file; type its own passphrase, or pass it as for a keyring
    #[arg(required_unless_present = "to")]
    pub file: Option<PathBuf>,
    /// Instead of a file: a folder to write one more backup to, named by the time
    #[arg(long, value_name = "DIR", conflicts_with = "file")]
    pub to: Option<PathBuf>,
    /// How many of the newest files in --to to keep; older backups there are removed
    #[arg(long, value_name = "N", requires = "to", value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=10_000))]
    pub keep: Option<usize>,
}

/// `demo …`
#[derive(Debug, Args)]
pub struct DemoArguments {
    /// Total capture time in seconds, 2 to 600
    #[arg(long, default_value_t = 10, value_name = "N", value_parser = clap::value_parser!(u64).range(2..=600))]
    pub seconds: u64,
}

/// `tour …`
#[derive(Debug, Default, Args)]
pub struct TourArguments {
    /// night, day, contrast or mono
    #[arg(long, value_name = "NAME")]
    pub theme: Option<String>,
    /// Plain ASCII glyphs
    #[arg(long)]
    pub ascii: bool,
}

/// What is printed instead of run: defaults to start your own files from.
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
    /// Node of a real chain: http://, https://, ws://, wss:// or IPC path
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

/// `agent …`
#[derive(Debug, Subcommand)]
pub enum AgentVerb {
    /// Enrol a robot as a device of this profile at a gateway; writes the robot's enrolment file
    Enrol(EnrolArguments),
    /// Capture on a robot and forward everything to its gateway, without a chain
    Run(RunArguments),
}

/// `agent enrol …`
#[derive(Debug, Args)]
#[command(group(clap::ArgGroup::new("trust").required(true)))]
pub struct EnrolArguments {
    /// The gateway; repeat it for further addresses of the same gateway: the robot uses the first that answers
    #[arg(long = "gateway", value_name = "HOST:PORT", required = true)]
    pub addresses: Vec<String>,
    /// The gateway's fingerprint (64 hex), as its operator shows it
    #[arg(long, value_name = "FINGERPRINT", group = "trust")]
    pub gateway_key: Option<String>,
    /// Pin whatever gateway answers; compare the fingerprint afterwards
    #[arg(long, group = "trust")]
    pub trust_first: bool,
    /// Name of the robot at the gateway
    #[arg(long, value_name = "NAME")]
    pub name: String,
    /// Topic the robot may record; repeatable
    #[arg(long = "topic", value_name = "TOPIC", conflicts_with = "all_topics")]
    pub topics: Vec<String>,
    /// Let it record every topic: it then holds the epoch's key and the index key, which a thief would get too
    #[arg(long)]
    pub all_topics: bool,
    /// End of the authorisation: 30d, 18:00, "tomorrow 18:00", "2026-11-27 18:00" or RFC 3339
    #[arg(long, value_name = "TIME")]
    pub until: Option<String>,
    /// Enrolment file to write; must not exist
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// File with the passphrase for the enrolment file [default: a random passphrase, written to FILE.passphrase]
    #[arg(long, value_name = "FILE")]
    pub robot_passphrase_file: Option<PathBuf>,
}

/// `agent run …`
#[derive(Debug, Args)]
pub struct RunArguments {
    /// The enrolment file
    #[arg(value_name = "ENROLMENT")]
    pub enrolment: PathBuf,
    /// Topic to capture; repeatable [default: those the enrolment is limited to]
    #[arg(long = "topic", value_name = "TOPIC")]
    pub topics: Vec<String>,
    /// Tag for every record, such as mission=harbour; repeatable
    #[arg(long = "tag", value_name = "KEY=VALUE")]
    pub tags: Vec<String>,
    /// Stop after this many messages per topic
    #[arg(long, value_name = "N")]
    pub count: Option<u64>,
    /// Stop after capturing for this long
    #[arg(long, value_name = "S", conflicts_with = "count")]
    pub seconds: Option<u64>,
}

/// `gateway …`
#[derive(Debug, Subcommand)]
pub enum GatewayVerb {
    /// Show this home's gateway: connections, system keys, refusals
    Status,
    /// Accept sealed records from robots, anchor them with this profile's account, answer operators' queries
    Serve {
        /// Address and port; port 0 = any free port
        #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:7420")]
        listen: SocketAddr,
        /// Also accept owners who are not on the allow list, each within the quotas in the settings
        #[arg(long)]
        open: bool,
    },
    /// Allow an owner to use this home's gateway: to register names, send records and read what is granted to it
    Admit {
        /// Account (0x and 40 hex digits), or a contact
        owner: String,
    },
    /// Deny an owner the use of this home's gateway; what it sent is kept
    Dismiss {
        /// Account (0x and 40 hex digits), or a contact
        owner: String,
    },
    /// List who may use the gateway besides this home's own profiles
    Admitted,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chain::{ChainError, SEAL_ANEW};
    use clap::error::ErrorKind;

    #[test]
    fn the_command_line_is_consistent() {
        Arguments::command().debug_assert();
    }

    /// What stands between backticks and begins with the program's name; a text goes on after a backslash.
    fn commands(text: &str) -> Vec<String> {
        let whole = text.replace("\\\n", " ");
        let named = whole.split('`').skip(1).step_by(2).filter(|quoted| quoted.starts_with("authros "));
        named.map(|quoted| quoted.split_whitespace().collect::<Vec<_>>().join(" ")).collect()
    }

    /// Why a command does not exist; values may be placeholders, and a noun may stand for all of its verbs.
    fn unknown(command: &str) -> Option<String> {
        let error = Arguments::try_parse_from(with_values_joined(command.split(' ').map(OsString::from))).err()?;
        let exists = !matches!(error.kind(), ErrorKind::InvalidSubcommand | ErrorKind::UnknownArgument);
        if exists { None } else { Some(format!("`{command}`: {error}")) }
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
            let [command] = commands(&text).try_into().expect("one command");
            assert!(text.contains(SEAL_ANEW), "{text}");
            assert!(Arguments::try_parse_from(command.split(' ')).is_ok(), "{command}");
        }
    }

    #[test]
    fn no_message_names_a_command_that_does_not_exist() {
        fn sources(folder: &std::path::Path, found: &mut Vec<PathBuf>) {
            for entry in std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path()) {
                if entry.is_dir() {
                    sources(&entry, found);
                } else if entry.extension().is_some_and(|ends| ends == "rs") {
                    found.push(entry);
                }
            }
        }
        let (root, mut found) = (std::path::Path::new(env!("CARGO_MANIFEST_DIR")), Vec::new());
        ["src", "crates"].iter().for_each(|folder| sources(&root.join(folder), &mut found));
        // A quoted text ends with its line unless a backslash continues it: an odd backtick spoils no other line.
        let lines = found.iter().map(|path| std::fs::read_to_string(path).expect("UTF-8").replace("\\\n", " "));
        let named: Vec<String> = lines.flat_map(|text| text.lines().flat_map(commands).collect::<Vec<_>>()).collect();
        assert!(named.len() > 100, "{named:?}");
        let wrong: Vec<String> = named.iter().filter_map(|command| unknown(command)).collect();
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
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
    fn a_commands_own_options_come_before_those_of_every_command() {
        let mut command = Arguments::command();
        command.build();
        let capture = command.find_subcommand_mut("capture").expect("a verb");
        let help = capture.render_help().to_string();
        let (own, every) = help.split_once("Options of every command:").expect("a heading");
        let own = own.split_once("\nOptions:").expect("its own").1;
        assert!(own.contains("--topic") && !own.contains("--home"), "{help}");
        assert!(every.contains("--home") && !every.contains("--topic"), "{help}");
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
        let read = parse("authros --json --home demo --profile serve --ros2 topics list");
        assert_eq!((read.global.home, read.global.profile), (Some("demo".into()), Some("serve".to_owned())));
        assert!(read.global.json && read.global.ros2.is_some() && matches!(read.verb, Some(Verb::Topics(_))));
        assert!(parse("authros --profile audit").verb.is_none(), "the console of that profile");
        let read = parse("authros contacts add --fingerprint chain grant bob");
        assert!(matches!(read.verb, Some(Verb::Contacts(_))), "behind the command nothing is joined");
    }

    #[test]
    fn one_key_at_a_time() {
        assert!(Arguments::try_parse_from(["authros", "keys", "load"]).is_err());
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
