//! Settings: flag over environment over `config.toml` over default, each with where it came from.

mod definitions;

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;
use std::str::FromStr;
use std::time::Duration;

use serde::Serialize;

pub use self::definitions::{DEFINITIONS, Definition};
use crate::crypto::ProviderName;
use crate::model::{Address, AnchorMode, Consensus, ErrorKind, ListedPublishers, PinMode, SignerId, clean};

/// Why the settings cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// The file is not TOML.
    #[error("{file} is not valid TOML: {what}; correct it, or move it away to use the defaults")]
    Syntax {
        /// The file.
        file: String,
        /// The parser's words, with the line.
        what: String,
    },
    /// A key that no setting has.
    #[error("{file} line {line} sets '{name}', which is no setting; `authros config show` lists them")]
    Unknown {
        /// The file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// The key.
        name: String,
    },
    /// A value that its setting does not take.
    #[error("{name} = '{value}' (from {source_name}) is not usable: {what}")]
    Value {
        /// The setting.
        name: &'static str,
        /// What was given.
        value: String,
        /// Where it was given.
        source_name: String,
        /// What it should be.
        what: String,
    },
}

impl ConfigError {
    /// Decides the exit code.
    pub fn kind(&self) -> ErrorKind {
        ErrorKind::Input
    }
}

/// Where a value came from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Source {
    /// Built in.
    Default,
    /// `config.toml`, with the line.
    File(usize),
    /// An environment variable.
    Environment(&'static str),
    /// A command-line flag.
    Flag,
}

impl fmt::Display for Source {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Default => formatter.write_str("default"),
            Self::File(line) => write!(formatter, "config.toml line {line}"),
            Self::Environment(name) => write!(formatter, "environment {name}"),
            Self::Flag => formatter.write_str("flag"),
        }
    }
}

/// Which topics' rates are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeterMode {
    /// Every topic of the graph.
    All,
    /// Only watched topics.
    Watched,
}

/// One setting as `config show` prints it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SettingView {
    /// Its name.
    pub name: &'static str,
    /// Its value.
    pub value: String,
    /// Where it came from.
    pub source: String,
    /// What it is.
    pub text: &'static str,
}

/// All settings in force.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Config {
    values: BTreeMap<&'static str, (String, Source)>,
    /// URI of a real ROS master.
    pub ros_master: Option<String>,
    /// How other ROS nodes reach this machine.
    pub ros_host: Option<String>,
    /// Which topics are measured.
    pub meter: MeterMode,
    /// How captured topics come to their pinned publishers.
    pub pin_mode: PinMode,
    /// Publishers that are pinned by the settings.
    pub publishers: ListedPublishers,
    /// Simulated robots; 0 with a real master.
    pub robots: u16,
    /// Node of a real chain.
    pub chain_url: Option<String>,
    /// The contract's address.
    pub contract: Option<Address>,
    /// The most wei per gas that a transaction may offer.
    pub max_fee: Option<u128>,
    /// Accounts that anchor side by side, the owner's included.
    pub lanes: u8,
    /// What the embedded chain's consensus must be; a new one is founded with it.
    pub consensus: Option<Consensus>,
    /// A real Redis.
    pub vault_url: Option<String>,
    /// Which SM implementation.
    pub provider: ProviderName,
    /// How digests go on the chain.
    pub anchor_mode: AnchorMode,
    /// How long a line of the audit log may wait until a head over it is anchored.
    pub audit_every: Duration,
    /// Blocks until confirmed.
    pub confirmations: u64,
    /// The gateway of the remote site that this one joins.
    pub site: Option<RemoteSite>,
}

/// A remote site as the settings name it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RemoteSite {
    /// HOST:PORT of its gateway.
    pub address: String,
    /// SM3 of its gateway's identity key.
    pub gateway_key: Option<SignerId>,
    /// Whether to pin whatever gateway answers first.
    pub trust_first: bool,
}

impl Config {
    /// Resolves flags, environment and file. `flags` and `environment` look a value up by
    /// setting and variable name; `file` is the text of `config.toml` where there is one.
    ///
    /// # Errors
    /// [`ConfigError`] names the file and line, variable or flag at fault.
    pub fn resolve(
        flags: &dyn Fn(&str) -> Option<String>,
        environment: &dyn Fn(&str) -> Option<String>,
        file: Option<(&Path, &str)>,
    ) -> Result<Self, ConfigError> {
        let from_file = file.map(|(path, text)| read_file(path, text)).transpose()?.unwrap_or_default();
        let mut values = BTreeMap::new();
        for definition in &DEFINITIONS {
            values.insert(definition.name, find(definition, flags, environment, &from_file));
        }
        Self::typed(values)
    }

    fn typed(values: BTreeMap<&'static str, (String, Source)>) -> Result<Self, ConfigError> {
        let text =
            |name: &'static str| values.get(name).map(|(value, _)| value.as_str()).filter(|value| !value.is_empty());
        let ros_master = url(&values, "ros.master", &["http://"])?;
        let meter = match (text("ros.meter"), &ros_master) {
            (Some("all"), _) | (Some("auto"), None) => MeterMode::All,
            (Some("watched"), _) | (Some("auto"), Some(_)) => MeterMode::Watched,
            _ => return Err(wrong(&values, "ros.meter", "write all, watched or auto")),
        };
        let robots = number(&values, "robots", 0, 32)?;
        Ok(Self {
            ros_host: text("ros.host").map(str::to_owned),
            meter,
            pin_mode: parsed(&values, "ros.pins")?.unwrap_or_default(),
            publishers: parsed(&values, "ros.publishers")?.unwrap_or_default(),
            robots: if ros_master.is_some() { 0 } else { u16::try_from(robots).unwrap_or(0) },
            ros_master,
            chain_url: url(&values, "chain.url", &["http://", "ws://", "ipc://", "/"])?,
            contract: parsed(&values, "chain.contract")?,
            max_fee: match text("chain.max_fee") {
                Some(_) => Some(u128::from(number(&values, "chain.max_fee", 0, 1_000_000_000)?) * 1_000_000_000),
                None => None,
            },
            lanes: u8::try_from(number(&values, "anchor.lanes", 1, 8)?).unwrap_or(1),
            consensus: parsed(&values, "chain.consensus")?,
            vault_url: url(&values, "vault.url", &["redis://", "redis+unix://", "unix://"])?,
            provider: parsed(&values, "crypto.provider")?.unwrap_or_default(),
            anchor_mode: parsed(&values, "anchor.mode")?.unwrap_or_default(),
            audit_every: Duration::from_secs(number(&values, "audit.anchor_every", 1, 86_400)?),
            confirmations: number(&values, "confirmations", 1, 1000)?,
            site: remote_site(&values)?,
            values,
        })
    }

    /// All settings for people, passwords in URLs hidden.
    pub fn show(&self) -> Vec<SettingView> {
        let view = |definition: &Definition| {
            let (value, source) = self.values.get(definition.name).cloned().unwrap_or((String::new(), Source::Default));
            SettingView {
                name: definition.name,
                value: clean(&without_password(&value), 200),
                source: source.to_string(),
                text: definition.text,
            }
        };
        DEFINITIONS.iter().map(view).collect()
    }

    /// Where a setting came from.
    pub fn source(&self, name: &str) -> Source {
        self.values.get(name).map_or(Source::Default, |(_, source)| source.clone())
    }
}

/// A URL with any `user:password@` hidden.
pub fn without_password(url: &str) -> String {
    match (url.split_once("://"), url.rsplit_once('@')) {
        (Some((scheme, _)), Some((_, rest))) => format!("{scheme}://…@{rest}"),
        _ => url.to_owned(),
    }
}

type FileValues = BTreeMap<String, (String, usize)>;

fn find(
    definition: &Definition,
    flags: &dyn Fn(&str) -> Option<String>,
    environment: &dyn Fn(&str) -> Option<String>,
    file: &FileValues,
) -> (String, Source) {
    if let Some(value) = flags(definition.name) {
        return (value, Source::Flag);
    }
    let variables: &[&'static str] =
        if definition.name == "ros.host" { &["ROS_HOSTNAME", "ROS_IP"] } else { &[definition.variable] };
    for variable in variables {
        if let Some(value) = environment(variable).filter(|value| !value.is_empty()) {
            return (value, Source::Environment(variable));
        }
    }
    file.get(definition.name).map_or_else(
        || (definition.default.to_owned(), Source::Default),
        |(value, line)| (value.clone(), Source::File(*line)),
    )
}

fn read_file(path: &Path, text: &str) -> Result<FileValues, ConfigError> {
    let file = clean(&path.display().to_string(), 200);
    let document: toml::Table = text.parse().map_err(|error: toml::de::Error| ConfigError::Syntax {
        file: file.clone(),
        what: clean(&error.to_string().replace('\n', " "), 300),
    })?;
    let mut values = FileValues::new();
    flatten("", &toml::Value::Table(document), &mut |name, value| {
        let line = line_of(text, name);
        if !DEFINITIONS.iter().any(|definition| definition.name == name) {
            return Err(ConfigError::Unknown { file: file.clone(), line, name: clean(name, 60) });
        }
        let value = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        values.insert(name.to_owned(), (value, line));
        Ok(())
    })?;
    Ok(values)
}

fn flatten(
    prefix: &str,
    value: &toml::Value,
    each: &mut dyn FnMut(&str, &toml::Value) -> Result<(), ConfigError>,
) -> Result<(), ConfigError> {
    let toml::Value::Table(table) = value else { return each(prefix, value) };
    for (key, inner) in table {
        let name = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
        flatten(&name, inner, each)?;
    }
    Ok(())
}

fn line_of(text: &str, name: &str) -> usize {
    let key = name.rsplit('.').next().unwrap_or(name);
    let found =
        text.lines().position(|line| line.trim_start().trim_start_matches('"').starts_with(key) || line.contains(name));
    found.map_or(1, |index| index + 1)
}

type Values = BTreeMap<&'static str, (String, Source)>;

fn wrong(values: &Values, name: &'static str, what: &str) -> ConfigError {
    let (value, source) = values.get(name).cloned().unwrap_or((String::new(), Source::Default));
    ConfigError::Value {
        name,
        value: clean(&without_password(&value), 100),
        source_name: source.to_string(),
        what: what.to_owned(),
    }
}

fn value<'a>(values: &'a Values, name: &str) -> Option<&'a str> {
    values.get(name).map(|(value, _)| value.as_str()).filter(|value| !value.is_empty())
}

fn number(values: &Values, name: &'static str, least: u64, most: u64) -> Result<u64, ConfigError> {
    let parsed =
        value(values, name).and_then(|text| text.parse().ok()).filter(|number| (least..=most).contains(number));
    parsed.ok_or_else(|| wrong(values, name, &format!("write a whole number from {least} to {most}")))
}

fn parsed<T: FromStr<Err: fmt::Display>>(values: &Values, name: &'static str) -> Result<Option<T>, ConfigError> {
    let text = value(values, name);
    text.map(str::parse).transpose().map_err(|error: T::Err| wrong(values, name, &error.to_string()))
}

fn remote_site(values: &Values) -> Result<Option<RemoteSite>, ConfigError> {
    let gateway_key = parsed(values, "site.gateway_key")?;
    let trust_first = match value(values, "site.trust_first") {
        Some("yes") => true,
        Some("no") | None => false,
        Some(_) => return Err(wrong(values, "site.trust_first", "write yes or no")),
    };
    let Some(address) = value(values, "site.address") else { return Ok(None) };
    let parts = address.rsplit_once(':').filter(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok());
    let plain = address.len() <= 260 && address.bytes().all(|byte| byte.is_ascii_graphic() && byte != b'/');
    if parts.is_none() || !plain {
        return Err(wrong(values, "site.address", "write HOST:PORT"));
    }
    if value(values, "chain.url").is_some() {
        return Err(wrong(values, "chain.url", "leave it empty where site.address is set: the chain comes through it"));
    }
    Ok(Some(RemoteSite { address: address.to_owned(), gateway_key, trust_first }))
}

fn url(values: &Values, name: &'static str, schemes: &[&str]) -> Result<Option<String>, ConfigError> {
    let Some(text) = value(values, name) else { return Ok(None) };
    let usable = text.len() <= 500
        && !text.chars().any(char::is_control)
        && schemes.iter().any(|scheme| text.starts_with(scheme));
    if usable || Path::new(text).extension().is_some_and(|end| end == "ipc") && schemes.contains(&"ipc://") {
        return Ok(Some(text.to_owned()));
    }
    Err(wrong(values, name, &format!("it begins with {}", schemes.join(", "))))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn none(_: &str) -> Option<String> {
        None
    }

    fn with_file(text: &str) -> Result<Config, ConfigError> {
        Config::resolve(&none, &none, Some((Path::new("config.toml"), text)))
    }

    #[test]
    fn nothing_set_is_all_embedded() {
        let config = Config::resolve(&none, &none, None).expect("defaults");
        assert_eq!((config.ros_master, config.chain_url, config.vault_url), (None, None, None));
        assert_eq!((config.robots, config.confirmations, config.meter), (4, 1, MeterMode::All));
    }

    #[test]
    fn flag_beats_environment_beats_file() {
        let file = "robots = 1\n[chain]\nurl = \"http://file\"\n";
        let environment = |name: &str| {
            (name == "AUTHROS_ROBOTS" || name == "AUTHROS_CHAIN")
                .then(|| if name == "AUTHROS_ROBOTS" { "2".to_owned() } else { "http://env".to_owned() })
        };
        let flags = |name: &str| (name == "robots").then(|| "3".to_owned());
        let config = Config::resolve(&flags, &environment, Some((Path::new("c"), file))).expect("resolves");
        assert_eq!((config.robots, config.chain_url.as_deref()), (3, Some("http://env")));
        assert_eq!(config.source("robots"), Source::Flag);
        assert_eq!(with_file(file).expect("file").source("chain.url"), Source::File(3));
    }

    #[test]
    fn a_real_master_means_no_robots() {
        let config = with_file("[ros]\nmaster = \"http://127.0.0.1:11311\"\n").expect("file");
        assert_eq!((config.robots, config.meter), (0, MeterMode::Watched));
    }

    #[test]
    fn unknown_keys_and_bad_values_name_the_place() {
        let error = with_file("robots = 1\n[ros]\nmastr = \"x\"\n").expect_err("unknown");
        assert_eq!(error, ConfigError::Unknown { file: "config.toml".into(), line: 3, name: "ros.mastr".into() });
        assert!(with_file("robots = 99").expect_err("range").to_string().contains("config.toml line 1"));
        assert!(matches!(with_file("robots = "), Err(ConfigError::Syntax { .. })));
        assert!(with_file("[vault]\nurl = \"ftp://x\"").is_err());
        assert!(with_file("[chain]\ncontract = \"0x12\"").is_err());
    }

    #[test]
    fn a_remote_site_is_an_address_and_whom_to_trust() {
        let site = |text: &str| with_file(text).map(|config| config.site);
        assert_eq!(site(""), Ok(None));
        let key = "ab".repeat(32);
        let text = format!("[site]\naddress = \"gate.example:4222\"\ngateway_key = \"{key}\"\n");
        let named = site(&text).expect("file").expect("a site");
        assert_eq!((named.address.as_str(), named.trust_first), ("gate.example:4222", false));
        assert_eq!(named.gateway_key, Some(SignerId([0xab; 32])));
        assert!(site("[site]\naddress = \"[::1]:4222\"\ntrust_first = \"yes\"").expect("file").is_some());
        for bad in ["host", ":1", "host:", "host:70000", "ho st:1", "http://host:1"] {
            assert!(site(&format!("[site]\naddress = \"{bad}\"")).is_err(), "{bad}");
        }
        assert!(site("[site]\naddress = \"h:1\"\ngateway_key = \"ab\"").is_err());
        assert!(site("[site]\naddress = \"h:1\"\ntrust_first = \"maybe\"").is_err());
        let error = site("[chain]\nurl = \"http://node\"\n[site]\naddress = \"h:1\"").expect_err("both");
        assert!(error.to_string().contains("chain.url"), "{error}");
    }

    #[test]
    fn passwords_are_hidden() {
        let config = with_file("[vault]\nurl = \"redis://u:secret@127.0.0.1:1\"").expect("file");
        let shown = serde_json::to_string(&config.show()).expect("json");
        assert!(!shown.contains("secret") && shown.contains("127.0.0.1:1"));
    }
}
