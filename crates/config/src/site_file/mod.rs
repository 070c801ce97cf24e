//! A site as a single file that a repository can hold: its settings, its rules for topics, and its operator's decisions
//! from the ledger. It contains no secrets, and nothing specific to one machine.

mod differences;
mod entries;
#[cfg(test)]
mod tests;
mod text;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

pub use self::differences::Difference;
use super::lines::Lines;
use super::read::{FileValues, document, file_name, read_document};
use super::{Config, ConfigError, DEFINITIONS, Source, alerts};
use crate::model::{Address, ContactName, Publisher, TopicName, TopicRules, TypeName};

/// Settings about the machine that a site runs on: left out of a dump, and left alone where a file does not name them.
const OF_THE_MACHINE: [&str; 5] =
    ["ros.host", "ros.ros2_program", "ros.rosrust_program", "ros.definitions", "crypto.sm4_kernel"];
/// URLs of services that write the key they ask for into the path.
const KEY_IN_PATH: [&str; 2] = ["chain.url", "alerts.webhook"];
/// Paths of such URLs that are known to hold none.
const PLAIN_PATHS: [&str; 3] = ["", "/", "/api/v2/alerts"];

/// The most contacts of a home.
pub const MOST_CONTACTS: usize = 1_000;

/// Settings that differ from their defaults, by name.
pub type Settings = BTreeMap<&'static str, String>;

/// An account of the address book.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KnownAccount {
    /// Its address.
    pub address: Address,
    /// The fingerprint of its key, if a person gave it.
    pub fingerprint: Option<String>,
}

/// The operator's decisions stored in the ledger; a list that is `None` is not mentioned.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Decisions {
    /// Watched topics, and the type requested for each.
    pub watches: Option<BTreeMap<TopicName, Option<TypeName>>>,
    /// Publishers pinned by the operator.
    pub publishers: Option<BTreeSet<(TopicName, Publisher)>>,
    /// The address book.
    pub contacts: Option<BTreeMap<ContactName, KnownAccount>>,
    /// Who may use the gateway.
    pub admitted: Option<BTreeSet<Address>>,
}

/// The present state of a home, to compare with a file.
#[derive(Debug, Clone, Default)]
pub struct Here {
    /// Its operator's decisions.
    pub decisions: Decisions,
    /// Publishers pinned because they were seen first: each home learns its own.
    pub seen_first: BTreeSet<(TopicName, Publisher)>,
    /// Accounts of its profiles, which may always use its gateway.
    pub own: BTreeSet<Address>,
}

/// Everything that defines a site.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SiteFile {
    /// Its settings.
    pub settings: Settings,
    /// Rules for topics.
    pub rules: TopicRules,
    /// Its operator's decisions.
    pub decisions: Decisions,
}

/// Why a setting of a home is left out of a site file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stays {
    /// It concerns the machine.
    OfTheMachine,
    /// Its value holds a secret.
    Secret,
}

impl Stays {
    /// For display.
    pub fn reason(self) -> &'static str {
        match self {
            Self::OfTheMachine => "it applies to this machine only",
            Self::Secret => "its value holds a secret",
        }
    }
}

/// The content of a home's `config.toml`.
#[derive(Debug, Clone, Default)]
pub struct HomeSettings {
    /// What belongs in a site file.
    pub site: Settings,
    /// What does not, and why.
    pub stays: BTreeMap<&'static str, (String, Stays)>,
    /// Rules for topics.
    pub rules: TopicRules,
}

impl HomeSettings {
    /// Reads `config.toml`.
    ///
    /// # Errors
    /// [`ConfigError`], see [`Config::resolve`].
    pub fn read(path: &Path, text: &str) -> Result<Self, ConfigError> {
        let file = file_name(path);
        let (values, rules) = read_document(&file, document(&file, text)?, text)?;
        let mut home = Self { rules, ..Self::default() };
        for (name, value) in named(values) {
            match stays(name, &value) {
                Some(why) => drop(home.stays.insert(name, (value, why))),
                None => drop(home.site.insert(name, value)),
            }
        }
        Ok(home)
    }

    /// All settings as they are now.
    fn all(&self) -> Settings {
        let stays = self.stays.iter().map(|(name, (value, _))| (*name, value.clone()));
        self.site.iter().map(|(name, value)| (*name, value.clone())).chain(stays).collect()
    }

    /// All settings as the site file would make them.
    pub fn wanted(&self, file: &SiteFile) -> Settings {
        let mut wanted: Settings = self.stays.iter().map(|(name, (value, _))| (*name, value.clone())).collect();
        wanted.extend(file.settings.iter().map(|(name, value)| (*name, value.clone())));
        wanted
    }
}

impl SiteFile {
    /// Reads the file from a repository.
    ///
    /// # Errors
    /// [`ConfigError`] with the line: invalid TOML, an unknown key, a secret, an invalid value.
    pub fn read(path: &Path, text: &str) -> Result<Self, ConfigError> {
        let file = file_name(path);
        let mut document = document(&file, text)?;
        let lines = Lines::of(text);
        let decisions = entries::read(&mut document, &file, &lines)?;
        let (values, rules) = read_document(&file, document, text)?;
        for (name, (value, line)) in &values {
            refuse_secret(&file, *line, name, value)?;
        }
        // The settings themselves say what a value must be, with the line in this file.
        let given = |name: &str| values.get(name).map(|(value, _)| value.clone());
        let usable = Config::resolve(&given, &|_| None, None).and_then(|_| {
            let from_file = |(value, line): &(String, usize)| (value.clone(), Source::File(*line));
            let command = values.get("alerts.command").map(from_file);
            alerts::check_hands(&command.map(|command| ("alerts.command", command)).into_iter().collect(), Some(path))
        });
        usable.map_err(|error| at_line(error, &file, &lines))?;
        Ok(Self { settings: named(values).collect(), rules, decisions })
    }
}

/// An invalid value, with its line.
fn at_line(error: ConfigError, file: &str, lines: &Lines) -> ConfigError {
    match error {
        ConfigError::Value { name, value, source_name: _, what } => {
            ConfigError::Value { name, value, source_name: format!("{file} line {}", lines.line(name)), what }
        }
        error @ (ConfigError::Syntax { .. }
        | ConfigError::Unknown { .. }
        | ConfigError::Rule { .. }
        | ConfigError::Secret { .. }
        | ConfigError::Entry { .. }) => error,
    }
}

/// With the names from the definitions.
fn named(values: FileValues) -> impl Iterator<Item = (&'static str, String)> {
    let known = |name: &str| DEFINITIONS.iter().find(|definition| definition.name == name);
    values.into_iter().filter_map(move |(name, (value, _))| Some((known(&name)?.name, value)))
}

fn stays(name: &str, value: &str) -> Option<Stays> {
    if OF_THE_MACHINE.contains(&name) {
        return Some(Stays::OfTheMachine);
    }
    holds_secret(name, value).then_some(Stays::Secret)
}

/// Whether the value of a setting holds, or may hold, something nobody else may read: credentials in a URL, its query,
/// its path at services that put keys there, a key in PEM.
fn holds_secret(name: &str, value: &str) -> bool {
    let in_url = |(scheme, rest): (&str, &str)| {
        // ipc:// is followed by a file on the machine.
        let may_hold_key = KEY_IN_PATH.contains(&name) && scheme != "ipc";
        let path = rest.find(['/', '#']).and_then(|at| rest.get(at..)).unwrap_or_default();
        rest.contains(['@', '?']) || may_hold_key && !PLAIN_PATHS.contains(&path)
    };
    value.contains("-----BEGIN") || value.split_once("://").is_some_and(in_url)
}

fn refuse_secret(file: &str, line: usize, name: &str, value: &str) -> Result<(), ConfigError> {
    let instead = match name {
        // It should be a path, but may be the secret itself.
        "alerts.secret" if !value.starts_with('/') => "give the path of the file that holds it",
        _ if holds_secret(name, value) && KEY_IN_PATH.contains(&name) => {
            "anything in its URL beyond host and port may be a secret: set it in each home's config.toml or in the \
             environment, which this file leaves alone"
        }
        _ if holds_secret(name, value) => {
            "set it in each home's config.toml or in the environment, which this file leaves alone"
        }
        _ => return Ok(()),
    };
    Err(ConfigError::Secret { file: file.to_owned(), line, name: name.to_owned(), instead })
}
