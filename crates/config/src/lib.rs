//! Settings: flags override the environment, that overrides `config.toml`, that overrides defaults.

use authros_crypto as crypto;
use authros_model as model;

mod alerts;
mod definitions;
pub mod paths;
mod read;
mod rules;
mod sections;
#[cfg(test)]
mod tests;
mod workers;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

pub use self::alerts::{AlertForm, AlertLimits, AlertPlace, AlertSettings, command_words};
pub use self::definitions::{DEFINITIONS, Definition};
use self::read::{
    Values, bytes, certificates, choice, find, number, parsed, read_file, span, switch, url, value, wrong,
};
use crate::crypto::{Kernel, ProviderName};
use crate::model::{
    Address, AnchorMode, Consensus, Keeping, ListedPublishers, PinMode, RetentionRules, RingLimits, SignerId,
    TopicPatterns, TopicRules, clean, without_secrets,
};
pub use read::{ConfigError, SettingView, Source};
pub use rules::{RingWish, RobotPolicy};
pub use sections::{
    ConsoleSettings, FiguresPlace, MetricsSettings, OperatorRule, OperatorSettings, Pictures, TimeAuthority, Whom,
};

/// Prefixes of a database's URL.
const DATABASES: &[&str] = &["postgres://", "postgresql://"];

/// Prefixes of a cache's URL.
const CACHES: &[&str] = &[
    "redis://",
    "rediss://",
    "redis+unix://",
    "unix://",
    "redis+cluster://",
    "rediss+cluster://",
    "redis+sentinel://",
    "rediss+sentinel://",
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeterMode {
    All,
    Watched,
}

/// What publishes in a graph of ROS 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PublishedBy {
    /// Our own publisher, in the site's process.
    Own,
    /// rosrust, in the program `authros-rosrust`.
    Rosrust,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Config {
    values: BTreeMap<&'static str, (String, Source)>,
    pub ros_master: Option<String>,
    /// The address at which other ROS nodes reach this machine.
    pub ros_host: Option<String>,
    pub meter: MeterMode,
    pub pin_mode: PinMode,
    pub publishers: ListedPublishers,
    /// Where ROS 2 is installed: prefixes, as in `AMENT_PREFIX_PATH`; empty = nowhere.
    pub definitions: String,
    /// `None` = no ROS 2.
    pub ros_domain: Option<u16>,
    pub ros2_program: Option<PathBuf>,
    /// What publishes shared records in a graph of ROS 1.
    pub publisher: PublishedBy,
    pub robots_by: PublishedBy,
    pub rosrust_program: Option<PathBuf>,
    /// Simulated robots; 0 with a real master.
    pub robots: u16,
    pub chain_url: Option<String>,
    /// PEM file with the authorities to accept for a node behind TLS; `None` = those of this machine.
    pub chain_roots: Option<PathBuf>,
    pub contract: Option<Address>,
    /// In wei per gas.
    pub max_fee: Option<u128>,
    /// In wei per gas.
    pub min_price: u128,
    pub lanes: u8,
    /// Required of the embedded chain; a new one is founded with it.
    pub consensus: Option<Consensus>,
    /// Memory for captured messages waiting to be stored, bytes.
    pub capture_memory: u64,
    /// The PostgreSQL database of a gateway's home; may hold a password.
    pub store_url: Option<String>,
    pub store_roots: Option<PathBuf>,
    /// That the database must wait for.
    pub store_standbys: u64,
    /// Redis as a cache in front of the store.
    pub cache_url: Option<String>,
    pub cache_roots: Option<PathBuf>,
    /// How long a robot keeps ciphertext that its gateway has proven to hold; `None` = for ever.
    pub outbox_keep: Option<Duration>,
    /// What a robot keeps of topics that nobody watches.
    pub ring: Option<RingSettings>,
    /// The retention setting; see [`Config::keeping`].
    pub retention: RetentionRules,
    /// Disk space that records must leave free, bytes.
    pub disk_reserve: u64,
    /// Whether messages are compressed before they are sealed.
    pub compression: bool,
    pub provider: ProviderName,
    /// The SM4 kernel, if not the fastest.
    pub sm4_kernel: Option<Kernel>,
    pub anchor_mode: AnchorMode,
    pub audit_every: Duration,
    /// Per cent of the stored records that a running site re-hashes per hour.
    pub scrub_percent: u64,
    pub operators: OperatorSettings,
    pub metrics: MetricsSettings,
    pub time_authorities: Vec<TimeAuthority>,
    pub alerts: AlertSettings,
    pub confirmations: u64,
    pub gateway: GatewayRules,
    /// HOST:PORT each, where this home's gateway and its other workers are reached; may be empty.
    pub gateway_addresses: Vec<String>,
    pub site: Option<RemoteSite>,
    /// Rules for topics (`[[topic]]` tables of the file).
    pub topic_rules: TopicRules,
    pub console: ConsoleSettings,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RingSettings {
    pub limits: RingLimits,
    pub topics: TopicPatterns,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GatewayRules {
    /// Also owners that were not admitted, within the following quotas.
    pub open: bool,
    pub bytes: u64,
    pub names: u64,
    /// Streams of such an owner: combinations of recorder, topic, kind, type and signer.
    pub streams: u64,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RemoteSite {
    /// HOST:PORT, in the order tried; at least one.
    pub addresses: Vec<String>,
    /// SM3 of its gateway's identity key.
    pub gateway_key: Option<SignerId>,
    /// Pin the first gateway that answers.
    pub trust_first: bool,
}

impl Config {
    /// `flags` and `environment` look up a value by setting and variable name; `file` is `config.toml`, if it exists.
    pub fn resolve(
        flags: &dyn Fn(&str) -> Option<String>,
        environment: &dyn Fn(&str) -> Option<String>,
        file: Option<(&Path, &str)>,
    ) -> Result<Self, ConfigError> {
        let (from_file, topic_rules) = file.map(|(path, text)| read_file(path, text)).transpose()?.unwrap_or_default();
        let mut values = BTreeMap::new();
        for definition in DEFINITIONS {
            values.insert(definition.name, find(definition, flags, environment, &from_file));
        }
        alerts::check_hands(&values, file.map(|(path, _)| path))?;
        let operators = OperatorSettings::read(&values, file)?;
        Ok(Self { operators, topic_rules, ..Self::typed(values)? })
    }

    fn typed(values: BTreeMap<&'static str, (String, Source)>) -> Result<Self, ConfigError> {
        let text = |name| value(&values, name);
        let ros_master = url(&values, "ros.master", &["http://"])?;
        let meter = match (text("ros.meter"), &ros_master) {
            (Some("all"), _) | (Some("auto"), None) => MeterMode::All,
            (Some("watched"), _) | (Some("auto"), Some(_)) => MeterMode::Watched,
            _ => return Err(wrong(&values, "ros.meter", "choose all, watched or auto")),
        };
        let ros_domain = match text("ros.domain") {
            Some(_) => u16::try_from(number(&values, "ros.domain", 0, 232)?).ok(),
            None => None,
        };
        let gwei = |name| Ok::<_, ConfigError>(u128::from(number(&values, name, 0, 1_000_000_000)?) * 1_000_000_000);
        let max_fee = text("chain.max_fee").map(|_| gwei("chain.max_fee")).transpose()?;
        let min_price = gwei("chain.min_price")?;
        if max_fee.is_some_and(|most| min_price > most) {
            return Err(wrong(&values, "chain.min_price", "choose at most chain.max_fee"));
        }
        let robots = number(&values, "robots", 0, 32)?;
        // With real robots, simulated ones run only on request.
        let unasked = values.get("robots").is_some_and(|(_, source)| *source == Source::Default);
        let without_robots = ros_master.is_some() || ros_domain.is_some() && unasked;
        Ok(Self {
            ros_host: text("ros.host").map(str::to_owned),
            meter,
            pin_mode: parsed(&values, "ros.pins")?.unwrap_or_default(),
            publishers: parsed(&values, "ros.publishers")?.unwrap_or_default(),
            definitions: text("ros.definitions").unwrap_or_default().to_owned(),
            ros_domain,
            ros2_program: text("ros.ros2_program").map(PathBuf::from),
            publisher: published_by(&values, "ros.publisher")?,
            robots_by: published_by(&values, "ros.robots_by")?,
            rosrust_program: text("ros.rosrust_program").map(PathBuf::from),
            robots: if without_robots { 0 } else { u16::try_from(robots).unwrap_or(0) },
            ros_master,
            chain_url: url(&values, "chain.url", &["http://", "https://", "ws://", "wss://", "ipc://", "/"])?,
            chain_roots: certificates(&values, "chain.roots")?,
            contract: parsed(&values, "chain.contract")?,
            max_fee,
            min_price,
            lanes: u8::try_from(number(&values, "anchor.lanes", 1, 8)?).unwrap_or(1),
            consensus: parsed(&values, "chain.consensus")?,
            capture_memory: bytes(&values, "capture.memory", 1 << 20)?,
            store_url: store(&values)?,
            store_roots: certificates(&values, "store.roots")?,
            store_standbys: number(&values, "store.standbys", 0, 16)?,
            cache_url: url(&values, "cache.url", CACHES)?,
            cache_roots: certificates(&values, "cache.roots")?,
            outbox_keep: span(&values, "outbox.keep", "always")?,
            ring: ring(&values)?,
            retention: parsed(&values, "retention")?.unwrap_or_default(),
            disk_reserve: bytes(&values, "disk.reserve", 0)?,
            compression: switch(&values, "record.compression", ("auto", "off"))?,
            provider: parsed(&values, "crypto.provider")?.unwrap_or_default(),
            sm4_kernel: parsed(&values, "crypto.sm4_kernel")?,
            anchor_mode: parsed(&values, "anchor.mode")?.unwrap_or_default(),
            audit_every: Duration::from_secs(number(&values, "audit.anchor_every", 1, 86_400)?),
            scrub_percent: number(&values, "audit.scrub", 0, 1_000_000)?,
            operators: OperatorSettings::default(),
            metrics: MetricsSettings::read(&values)?,
            time_authorities: sections::authorities(&values)?,
            alerts: AlertSettings::read(&values)?,
            confirmations: number(&values, "confirmations", 1, 1000)?,
            gateway: GatewayRules {
                open: switch(&values, "gateway.admission", ("open", "closed"))?,
                bytes: bytes(&values, "gateway.quota_bytes", 0)?,
                names: number(&values, "gateway.quota_names", 1, 10_000)?,
                streams: number(&values, "gateway.quota_streams", 1, 1_000_000)?,
            },
            gateway_addresses: addresses(&values, "gateway.addresses")?,
            site: remote_site(&values)?,
            topic_rules: TopicRules::default(),
            console: ConsoleSettings::read(&values)?,
            values,
        })
    }

    pub fn keeping(&self) -> Keeping {
        Keeping { topics: self.topic_rules.clone(), setting: self.retention.clone() }
    }

    /// Passwords and paths in URLs are hidden.
    pub fn show(&self) -> Vec<SettingView> {
        let view = |definition: &Definition| {
            let Definition { name, text, .. } = *definition;
            let (value, source) = self.values.get(name).cloned().unwrap_or((String::new(), Source::Default));
            SettingView { name, value: clean(&without_secrets(&value), 200), source: source.to_string(), text }
        };
        DEFINITIONS.iter().map(view).collect()
    }

    pub fn source(&self, name: &str) -> Source {
        self.values.get(name).map_or(Source::Default, |(_, source)| source.clone())
    }
}

/// Of a gateway's home, so not of one that joins a gateway.
fn store(values: &Values) -> Result<Option<String>, ConfigError> {
    let url = url(values, "store.url", DATABASES)?;
    if url.is_some() && value(values, "site.address").is_some() {
        let advice = "leave it empty in a home that joins a gateway (site.address): the database is the gateway's";
        return Err(wrong(values, "store.url", advice));
    }
    Ok(url)
}

fn published_by(values: &Values, name: &'static str) -> Result<PublishedBy, ConfigError> {
    choice(values, name, [("own", PublishedBy::Own), ("rosrust", PublishedBy::Rosrust)])
}

const MOST_ADDRESSES: usize = 8;
const PLACES: &str = "use HOST:PORT, or up to eight of them separated by commas";

/// Half of a key's.
const FINGERPRINT_DIGITS: usize = 32;

fn ring(values: &Values) -> Result<Option<RingSettings>, ConfigError> {
    let topics: TopicPatterns = parsed(values, "ring.topics")?.unwrap_or_default();
    match parsed(values, "ring.keep")? {
        Some(_) if topics.0.is_empty() => {
            Err(wrong(values, "ring.topics", "with ring.keep, write which topics: [\"/camera/**\"]"))
        }
        Some(limits) => Ok(Some(RingSettings { limits, topics })),
        None if topics.0.is_empty() => Ok(None),
        None => Err(wrong(values, "ring.keep", "with ring.topics, write how much: \"5m, 500MiB\"")),
    }
}

fn remote_site(values: &Values) -> Result<Option<RemoteSite>, ConfigError> {
    let digits = |text: &str| text.chars().filter(char::is_ascii_hexdigit).count();
    if value(values, "site.gateway_key").is_some_and(|text| digits(text) == FINGERPRINT_DIGITS) {
        let advice = "this is the fingerprint; give the 64-digit hex key that the gateway prints before it";
        return Err(wrong(values, "site.gateway_key", advice));
    }
    let gateway_key = parsed(values, "site.gateway_key")?;
    let trust_first = choice(values, "site.trust_first", [("yes", true), ("no", false), ("", false)])?;
    let Some(text) = value(values, "site.address") else { return Ok(None) };
    if text.contains('=') {
        let advice = "a site has one gateway: list only its addresses, HOST:PORT separated by commas, and give its key in \
                      site.gateway_key";
        return Err(wrong(values, "site.address", advice));
    }
    let addresses = addresses(values, "site.address")?;
    if value(values, "chain.url").is_some() {
        let advice = "leave it empty while site.address is set: that site supplies the chain";
        return Err(wrong(values, "chain.url", advice));
    }
    Ok(Some(RemoteSite { addresses, gateway_key, trust_first }))
}

fn addresses(values: &Values, name: &'static str) -> Result<Vec<String>, ConfigError> {
    let text = value(values, name).unwrap_or_default();
    let listed: Vec<String> = text.split(',').map(|part| part.trim().to_owned()).filter(|_| !text.is_empty()).collect();
    if listed.len() > MOST_ADDRESSES || !listed.iter().all(|address| is_place(address)) {
        return Err(wrong(values, name, PLACES));
    }
    Ok(listed)
}

fn is_place(address: &str) -> bool {
    let parts = address.rsplit_once(':').filter(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok());
    parts.is_some() && address.len() <= 260 && address.bytes().all(|byte| byte.is_ascii_graphic() && byte != b'/')
}
