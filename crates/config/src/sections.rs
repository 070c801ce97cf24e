//! Settings of one part of a site each: console, figures, operators, time stamp authorities.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use crate::model::{OperatorName, OperatorRight, OperatorRights, clean};
use crate::read::{ConfigError, Source, Values, choice, lines_of, number, source_of, switch, value, wrong};
use serde::Deserialize as _;

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Pictures {
    #[default]
    HalfBlocks,
    /// Pixels drawn by the terminal.
    Sixel,
    Kitty,
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ConsoleSettings {
    /// `None` = chosen to match the terminal's colours.
    pub theme: Option<String>,
    /// `None` = decided by the locale.
    pub ascii: Option<bool>,
    pub mouse: bool,
    /// For redraws caused by new data.
    pub bytes_per_second: Option<u32>,
    pub pictures: Pictures,
    /// Nanoseconds without a key after which the keyring locks; `None` = never.
    pub lock_after: Option<u64>,
}

impl ConsoleSettings {
    pub(super) fn read(values: &Values) -> Result<Self, ConfigError> {
        let ascii = [("yes", Some(true)), ("no", Some(false)), ("auto", None), ("", None)];
        let bytes_per_second = match value(values, "console.bytes_per_second") {
            Some(_) => u32::try_from(number(values, "console.bytes_per_second", 500, 100_000_000)?).ok(),
            None => None,
        };
        let (blocks, sixel, kitty) = (Pictures::HalfBlocks, Pictures::Sixel, Pictures::Kitty);
        let pictures = [("half-blocks", blocks), ("sixel", sixel), ("kitty", kitty), ("", blocks)];
        let minutes = number(values, "console.lock_after", 0, 10_080)?;
        let lock_after = (minutes > 0).then(|| minutes * 60_000_000_000);
        Ok(Self {
            lock_after,
            theme: value(values, "console.theme").map(str::to_owned),
            ascii: choice(values, "console.ascii", ascii)?,
            mouse: switch(values, "console.mouse", ("yes", "no"))?,
            bytes_per_second,
            pictures: choice(values, "console.pictures", pictures)?,
        })
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FiguresPlace {
    /// On this machine only, unless `open`.
    Address { address: SocketAddr, open: bool },
    /// A socket in the file system, protected by its folder's permissions.
    Socket(PathBuf),
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct MetricsSettings {
    /// `None` = nowhere.
    pub listen: Option<FiguresPlace>,
    /// Whether topics have figures under their names.
    pub topics: bool,
}

impl MetricsSettings {
    pub(super) fn read(values: &Values) -> Result<Self, ConfigError> {
        let open = switch(values, "metrics.open", ("yes", "no"))?;
        let topics = switch(values, "metrics.topics", ("yes", "no"))?;
        let listen = value(values, "metrics.listen").map(|text| place(values, text, open)).transpose()?;
        Ok(Self { listen, topics })
    }
}

fn place(values: &Values, text: &str, open: bool) -> Result<FiguresPlace, ConfigError> {
    if text.starts_with('/') {
        return Ok(FiguresPlace::Socket(text.into()));
    }
    let wrong = |what| wrong(values, "metrics.listen", what);
    let address: SocketAddr =
        text.parse().map_err(|_| wrong("use 127.0.0.1:PORT, or an absolute path for a socket"))?;
    if !open && !address.ip().is_loopback() {
        return Err(wrong("other machines can reach this address; use 127.0.0.1, or also set metrics.open = 'yes'"));
    }
    Ok(FiguresPlace::Address { address, open })
}

const SOCKET: &str = "operators.socket";
const RIGHTS: &str = "operators.rights";
const MOST: usize = 256;
const FORM: &str = "use { NAME = [\"look\", \"grant\"], \"@GROUP\" = [\"capture\"] }, at most 256 of them";

/// By name in the user database.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Whom {
    User(OperatorName),
    Group(OperatorName),
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OperatorRule {
    pub whom: Whom,
    pub rights: OperatorRights,
    /// Where this is written: file and line, or the variable.
    pub place: String,
}

#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct OperatorSettings {
    /// `None` = there are none.
    pub socket: Option<PathBuf>,
    pub rules: Vec<OperatorRule>,
}

impl OperatorSettings {
    pub(super) fn read(values: &Values, file: Option<(&Path, &str)>) -> Result<Self, ConfigError> {
        let socket = socket(values)?;
        let rules = rules(values, file)?;
        if socket.is_some() && rules.is_empty() {
            return Err(wrong(values, SOCKET, "also say in [operators.rights] what each operator may do"));
        }
        Ok(Self { socket, rules })
    }
}

fn socket(values: &Values) -> Result<Option<PathBuf>, ConfigError> {
    let Some(path) = value(values, SOCKET).map(PathBuf::from) else { return Ok(None) };
    if !path.is_absolute() || path.file_name().is_none() {
        return Err(wrong(values, SOCKET, "give an absolute path outside the home: /run/authros/operators.sock"));
    }
    Ok(Some(path))
}

fn rules(values: &Values, file: Option<(&Path, &str)>) -> Result<Vec<OperatorRule>, ConfigError> {
    let Some(text) = value(values, RIGHTS) else { return Ok(Vec::new()) };
    let form = || wrong(values, RIGHTS, FORM);
    let mut document: toml::Table = format!("rights = {text}").parse().map_err(|_| form())?;
    let Some(toml::Value::Table(entries)) = document.remove("rights") else { return Err(form()) };
    if entries.len() > MOST {
        return Err(form());
    }
    let from_file = matches!(values.get(RIGHTS), Some((_, Source::File(_))));
    let lines = file.filter(|_| from_file).map(|(path, text)| lines_of(path, text));
    let place = |key: &str| match &lines {
        Some(lines) => format!("{} line {}", lines.file, lines.line(&format!("{RIGHTS}.{key}"))),
        None => source_of(values, RIGHTS),
    };
    let rule = |(key, rights): (String, toml::Value)| {
        let place = place(&key);
        let invalid = |what: String| ConfigError::Value {
            name: RIGHTS,
            value: clean(&format!("{key} = {rights}"), 100),
            source_name: place.clone(),
            what,
        };
        let whom = whom(&key).map_err(invalid)?;
        let rights = rights_of(&rights).map_err(invalid)?;
        Ok(OperatorRule { whom, rights, place })
    };
    entries.into_iter().map(rule).collect()
}

fn whom(key: &str) -> Result<Whom, String> {
    let named = |text: &str| text.parse().map_err(|error| format!("{error}"));
    match key.strip_prefix('@') {
        Some(group) => named(group).map(Whom::Group),
        None => named(key).map(Whom::User),
    }
}

fn rights_of(value: &toml::Value) -> Result<OperatorRights, String> {
    let rights = Vec::<OperatorRight>::deserialize(value.clone()).ok();
    let rights = rights.map(OperatorRights::from_iter).filter(|rights| !rights.is_empty());
    rights.ok_or_else(|| "give a list of rights: look, capture, grant".to_owned())
}

const MOST_AUTHORITIES: usize = 4;
const AUTHORITY_FORM: &str =
    "use [{ name = \"NAME\", url = \"http://HOST/PATH\", certificate = \"/PATH/OF.pem\" }], at most four of them";

/// A time stamp authority (RFC 3161).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TimeAuthority {
    /// Its name; the host of its URL unless a name was set.
    pub name: String,
    pub url: String,
    /// The file with its certificate, or that of its issuer, PEM.
    pub certificate: PathBuf,
}

pub(super) fn authorities(values: &Values) -> Result<Vec<TimeAuthority>, ConfigError> {
    let Some(text) = value(values, "time.authorities") else { return Ok(Vec::new()) };
    let wrong = |what: &str| wrong(values, "time.authorities", what);
    let table: toml::Table = format!("authorities = {text}").parse().map_err(|_| wrong(AUTHORITY_FORM))?;
    let list = table.get("authorities").and_then(|list| list.as_array()).ok_or_else(|| wrong(AUTHORITY_FORM))?;
    if list.len() > MOST_AUTHORITIES {
        return Err(wrong(AUTHORITY_FORM));
    }
    let mut found: Vec<TimeAuthority> = Vec::new();
    for entry in list {
        let authority = entry.as_table().and_then(authority).ok_or_else(|| wrong(AUTHORITY_FORM))?;
        if found.iter().any(|known| known.name == authority.name) {
            return Err(wrong("two authorities share a name; give each its own"));
        }
        if !authority.certificate.is_absolute() || !authority.certificate.is_file() {
            return Err(wrong("certificate must be the absolute path of a PEM file"));
        }
        found.push(authority);
    }
    Ok(found)
}

fn authority(table: &toml::Table) -> Option<TimeAuthority> {
    if table.keys().any(|key| !["name", "url", "certificate"].contains(&key.as_str())) {
        return None;
    }
    let text = |key: &str| table.get(key).and_then(|value| value.as_str()).filter(|text| !text.is_empty());
    let url = text("url").filter(|url| url.len() <= 500 && url.bytes().all(|byte| byte.is_ascii_graphic()))?;
    let rest = url.strip_prefix("http://").or_else(|| url.strip_prefix("https://"))?;
    let host = rest.split('/').next().filter(|host| !host.is_empty() && !host.contains('@'))?;
    let name = match table.get("name") {
        Some(_) => text("name").filter(|name| name.len() <= 80 && clean(name, 80) == **name)?,
        None => host,
    };
    let (name, url) = (name.to_owned(), url.to_owned());
    Some(TimeAuthority { name, url, certificate: PathBuf::from(text("certificate")?) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Config;

    const SOME: &str = "[operators]\nsocket = \"/run/authros/operators.sock\"\n\n[operators.rights]\n\
                        alice = [\"look\", \"grant\"]\n# the lab\n\"@robotics\" = [\"capture\"]\n";

    fn read(text: &str) -> Result<OperatorSettings, String> {
        let none = |_: &str| None;
        let config = Config::resolve(&none, &none, Some((Path::new("/etc/config.toml"), text)));
        config.map(|config| config.operators).map_err(|error| error.to_string())
    }

    #[test]
    fn rights_are_a_table_of_users_and_groups() {
        let settings = read(SOME).expect("usable");
        assert_eq!(settings.socket.as_deref(), Some(Path::new("/run/authros/operators.sock")));
        let told = |rule: &OperatorRule| match &rule.whom {
            Whom::User(name) => format!("{name}: {} ({})", rule.rights, rule.place),
            Whom::Group(name) => format!("group {name}: {} ({})", rule.rights, rule.place),
        };
        let mut rules: Vec<String> = settings.rules.iter().map(told).collect();
        rules.sort();
        let expected =
            ["alice: look,grant (/etc/config.toml line 5)", "group robotics: capture (/etc/config.toml line 7)"];
        assert_eq!(rules, expected);
        assert_eq!(read(""), Ok(OperatorSettings::default()), "nobody, unless somebody is named");
        let inline = "operators.socket = \"/s\"\noperators.rights = { bob = [\"look\"] }";
        assert_eq!(read(inline).expect("usable").rules.len(), 1);
        let variable = |name: &str| (name == "AUTHROS_OPERATORS_RIGHTS").then(|| "{ bob = [\"look\"] }".to_owned());
        let config = Config::resolve(&|_| None, &variable, None).expect("usable");
        assert_eq!(config.operators.rules[0].place, "environment AUTHROS_OPERATORS_RIGHTS");
    }

    #[test]
    fn what_is_wrong_is_named_with_file_and_line() {
        for (from, to, line) in [
            ("\"grant\"", "\"read\"", "line 5"),
            ("[\"capture\"]", "[]", "line 7"),
            ("[\"capture\"]", "\"capture\"", "line 7"),
            ("\"@robotics\"", "\"@ro botics\"", "line 7"),
            ("alice", "\"alice/bob\"", "line 5"),
            ("alice", "\"\"", "line 5"),
        ] {
            let error = read(&SOME.replacen(from, to, 1)).expect_err(to);
            assert!(error.contains("/etc/config.toml") && error.contains(line), "{to}: {error}");
        }
        assert!(read(&SOME.replace("/run/authros/", "")).expect_err("relative").contains("absolute path"));
        assert!(read("operators.socket = \"/s\"").expect_err("nobody").contains("[operators.rights]"));
        assert!(read("operators.rights = 3").is_err() && read("operators.rights = [\"look\"]").is_err());
        assert!(read("[operators]\nsockets = \"/s\"").expect_err("unknown").contains("line 2"));
    }
}

#[cfg(test)]
mod time_tests {
    use super::*;
    use crate::Config;

    fn read(text: &str) -> Result<Vec<TimeAuthority>, String> {
        let path = std::path::Path::new("config.toml");
        let none = |_: &str| None;
        let config = Config::resolve(&none, &none, Some((path, text)));
        config.map(|config| config.time_authorities).map_err(|error| error.to_string())
    }

    #[test]
    fn authorities_are_a_list_of_tables() {
        let file = tempfile::NamedTempFile::new().expect("a file");
        let path = file.path().display();
        let one = format!("[[time.authorities]]\nurl = \"http://127.0.0.1:9/tsa\"\ncertificate = \"{path}\"\n");
        let two =
            format!("{one}[[time.authorities]]\nname = \"Two\"\nurl = \"https://h/\"\ncertificate = \"{path}\"\n");
        let found = read(&two).expect("usable");
        let told: Vec<(&str, &str)> = found.iter().map(|one| (one.name.as_str(), one.url.as_str())).collect();
        assert_eq!(told, [("127.0.0.1:9", "http://127.0.0.1:9/tsa"), ("Two", "https://h/")]);
        assert_eq!(found[0].certificate, file.path());
        assert_eq!(read(""), Ok(Vec::new()));
        assert!(read(&format!("{one}{one}")).expect_err("twice").contains("share a name"));
        assert!(read(&one.repeat(5)).is_err());
        for (from, to) in [
            ("http://", "ftp://"),
            ("http://127", "http://a@127"),
            ("url", "uri"),
            ("certificate = \"/", "certificate = \""),
        ] {
            assert!(read(&one.replacen(from, to, 1)).is_err(), "{from}");
        }
        assert!(read("[time]\nauthorities = \"http://h/\"").is_err());
    }
}
