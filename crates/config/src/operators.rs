//! Where operators connect, and what each of them may do.

use std::path::{Path, PathBuf};

use serde::Deserialize as _;

use super::error::ConfigError;
use super::read::{Source, Values, lines_of, source_of, value, wrong};
use crate::model::{OperatorName, OperatorRight, OperatorRights, clean};

const SOCKET: &str = "operators.socket";
const RIGHTS: &str = "operators.rights";
/// The most rules.
const MOST: usize = 256;
/// The form of the rules.
const FORM: &str = "use { NAME = [\"look\", \"grant\"], \"@GROUP\" = [\"capture\"] }, at most 256 of them";

/// Whom a rule is for, by the name in the user database.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Whom {
    /// One user.
    User(OperatorName),
    /// Everybody in a group.
    Group(OperatorName),
}

/// What a user or the users of a group may do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OperatorRule {
    /// Who.
    pub whom: Whom,
    /// What.
    pub rights: OperatorRights,
    /// Where this is written: file and line, or the variable.
    pub place: String,
}

/// What the settings say about operators.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct OperatorSettings {
    /// The socket they connect to; `None` = there are none.
    pub socket: Option<PathBuf>,
    /// Their rights.
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

/// A table in the file, the same text in a variable.
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
