//! Values with their sources and lines, parsed into their types.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use crate::model::{ByteSize, ErrorKind, TopicRules, address_without_secrets, clean, time_span, without_secrets};
use crate::{DATABASES, DEFINITIONS, Definition, rules};
use serde::Serialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A line that settings of a later version begin with.
const VERSION: &str = "version";
const FIRST: &str = "the settings of version 1 have no such line; remove it";
const LATER: &str = "settings of version 1 have no such line, so these are of a later version; use a newer authros, or remove \
                     what it added";

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Source {
    Default,
    /// `config.toml`, with the line.
    File(usize),
    Environment(&'static str),
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

/// As `config show` prints it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SettingView {
    pub name: &'static str,
    pub value: String,
    pub source: String,
    pub text: &'static str,
}

pub(super) type FileValues = BTreeMap<String, (String, usize)>;

pub(super) fn find(
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

pub(super) fn document(file: &str, text: &str) -> Result<toml::Table, ConfigError> {
    text.parse().map_err(|error: toml::de::Error| {
        // Its whole text repeats the line, which may have a password.
        let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
        let line = before.matches('\n').count() + 1;
        ConfigError::Syntax { file: file.to_owned(), what: clean(&format!("line {line}: {}", error.message()), 300) }
    })
}

pub(super) fn read_file(path: &Path, text: &str) -> Result<(FileValues, TopicRules), ConfigError> {
    let lines = lines_of(path, text);
    read_document(document(&lines.file, text)?, &lines)
}

pub(super) fn lines_of(path: &Path, text: &str) -> Lines {
    Lines::of(&clean(&path.display().to_string(), 200), text)
}

pub(super) fn read_document(mut document: toml::Table, lines: &Lines) -> Result<(FileValues, TopicRules), ConfigError> {
    if let Some(version) = document.get(VERSION) {
        return Err(lines.fault(VERSION, if version.as_integer() == Some(1) { FIRST } else { LATER }));
    }
    let rules = document.remove(rules::TABLE).map(|tables| rules::read(&tables, lines)).transpose()?;
    let mut values = FileValues::new();
    flatten("", &toml::Value::Table(document), &mut |name, value| {
        let line = lines.line(name);
        if !DEFINITIONS.iter().any(|definition| definition.name == name) {
            return Err(ConfigError::Unknown { file: lines.file.clone(), line, name: clean(name, 60) });
        }
        let value = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        values.insert(name.to_owned(), (value, line));
        Ok(())
    })?;
    Ok((values, rules.unwrap_or_default()))
}

fn flatten(
    prefix: &str,
    value: &toml::Value,
    each: &mut dyn FnMut(&str, &toml::Value) -> Result<(), ConfigError>,
) -> Result<(), ConfigError> {
    let toml::Value::Table(table) = value else { return each(prefix, value) };
    if DEFINITIONS.iter().any(|definition| definition.name == prefix) {
        return each(prefix, value);
    }
    for (key, inner) in table {
        let name = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
        flatten(&name, inner, each)?;
    }
    Ok(())
}

pub(super) type Values = BTreeMap<&'static str, (String, Source)>;

pub(super) fn wrong(values: &Values, name: &'static str, what: &str) -> ConfigError {
    let (value, source) = values.get(name).cloned().unwrap_or((String::new(), Source::Default));
    // What was meant as a server's URL may be all path, which may be a key.
    let shown: fn(&str) -> String = match name {
        // Words of another form may hold a password anywhere.
        "store.url" if !DATABASES.iter().any(|prefix| value.starts_with(prefix)) => |_: &str| "…".to_owned(),
        "chain.url" | "alerts.webhook" => address_without_secrets,
        _ => without_secrets,
    };
    let (value, source_name) = (clean(&shown(&value), 100), source.to_string());
    ConfigError::Value { name, value, source_name, what: what.to_owned() }
}

pub(super) fn source_of(values: &Values, name: &str) -> String {
    values.get(name).map_or(Source::Default, |(_, source)| source.clone()).to_string()
}

pub(super) fn value<'a>(values: &'a Values, name: &str) -> Option<&'a str> {
    values.get(name).map(|(value, _)| value.as_str()).filter(|value| !value.is_empty())
}

pub(super) fn number(values: &Values, name: &'static str, least: u64, most: u64) -> Result<u64, ConfigError> {
    let parsed =
        value(values, name).and_then(|text| text.parse().ok()).filter(|number| (least..=most).contains(number));
    parsed.ok_or_else(|| wrong(values, name, &format!("give a whole number from {least} to {most}")))
}

pub(super) fn bytes(values: &Values, name: &'static str, least: u64) -> Result<u64, ConfigError> {
    let size = parsed::<ByteSize>(values, name)?.filter(|size| size.0 >= least);
    size.map(|size| size.0).ok_or_else(|| wrong(values, name, &format!("give a size of at least {}", ByteSize(least))))
}

/// One of two words; the first means yes.
pub(super) fn switch(values: &Values, name: &'static str, words: (&str, &str)) -> Result<bool, ConfigError> {
    choice(values, name, [(words.0, true), (words.1, false)])
}

/// The value of the chosen word; "" also stands for a missing one.
pub(super) fn choice<T: Copy, const N: usize>(
    values: &Values,
    name: &'static str,
    choices: [(&str, T); N],
) -> Result<T, ConfigError> {
    let text = value(values, name).unwrap_or_default();
    let chosen = choices.iter().find(|(word, _)| *word == text);
    chosen.map(|(_, chosen)| *chosen).ok_or_else(|| {
        let words: Vec<&str> = choices.iter().map(|(word, _)| *word).filter(|word| !word.is_empty()).collect();
        let (last, first) = words.split_last().unwrap_or((&"", &[]));
        wrong(values, name, &format!("choose {} or {last}", first.join(", ")))
    })
}

/// `None` = the word `endless`.
pub(super) fn span(values: &Values, name: &'static str, endless: &str) -> Result<Option<Duration>, ConfigError> {
    match value(values, name) {
        Some(text) if text == endless => Ok(None),
        text => {
            let wrong = || wrong(values, name, &format!("give {endless}, or a time such as 0s, 12h, 30d"));
            text.and_then(|text| time_span(text).ok()).map(Some).ok_or_else(wrong)
        }
    }
}

pub(super) fn parsed<T: FromStr<Err: fmt::Display>>(
    values: &Values,
    name: &'static str,
) -> Result<Option<T>, ConfigError> {
    let text = value(values, name);
    text.map(str::parse).transpose().map_err(|error: T::Err| wrong(values, name, &error.to_string()))
}

pub(super) fn url(values: &Values, name: &'static str, schemes: &[&str]) -> Result<Option<String>, ConfigError> {
    let Some(text) = value(values, name) else { return Ok(None) };
    let usable = text.len() <= 500
        && !text.chars().any(char::is_control)
        && schemes.iter().any(|scheme| text.starts_with(scheme));
    if usable || Path::new(text).extension().is_some_and(|end| end == "ipc") && schemes.contains(&"ipc://") {
        return Ok(Some(text.to_owned()));
    }
    let mut refused = wrong(values, name, &format!("it must start with {}", schemes.join(", ")));
    if let ConfigError::Value { value, .. } = &mut refused {
        *value = without_path(value);
    }
    Err(refused)
}

/// Cut after the host: a provider's path is as secret as a password.
fn without_path(url: &str) -> String {
    let Some((scheme, rest)) = url.split_once("://") else { return url.to_owned() };
    match rest.split_once(['/', '?', '#']) {
        Some((host, further)) if !further.is_empty() => format!("{scheme}://{host}/…"),
        _ => url.to_owned(),
    }
}

/// Whether it has certificates is checked on use.
pub(super) fn certificates(values: &Values, name: &'static str) -> Result<Option<PathBuf>, ConfigError> {
    let Some(path) = value(values, name).map(PathBuf::from) else { return Ok(None) };
    if !path.is_absolute() || !path.is_file() {
        return Err(wrong(values, name, "give the absolute path of a file with PEM certificates"));
    }
    Ok(Some(path))
}

/// The line of each key of a file, from 1; the second table of `[[watch]]` is `watch.1`, its topic `watch.1.topic`.
#[derive(Debug)]
pub(super) struct Lines {
    /// Its name in messages.
    pub file: String,
    lines: BTreeMap<String, usize>,
}

impl Lines {
    /// Empty for invalid TOML.
    pub fn of(file: &str, text: &str) -> Self {
        let ends: Vec<usize> = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n').map(|(at, _)| at).collect();
        let line = |at: usize| ends.partition_point(|end| *end < at) + 1;
        let mut lines = Self { file: file.to_owned(), lines: BTreeMap::new() };
        if let Ok(document) = DeTable::parse(text) {
            lines.table("", document.get_ref(), &line);
        }
        lines
    }

    /// The line of a key, else of what contains it, else 1.
    pub fn line(&self, name: &str) -> usize {
        let mut name = name;
        loop {
            match (self.lines.get(name), name.rsplit_once('.')) {
                (Some(line), _) => return *line,
                (None, Some((outer, _))) => name = outer,
                (None, None) => return 1,
            }
        }
    }

    pub fn fault(&self, name: &str, what: &str) -> ConfigError {
        ConfigError::Entry { file: self.file.clone(), line: self.line(name), what: clean(what, 300) }
    }

    fn table(&mut self, prefix: &str, table: &DeTable<'_>, line: &impl Fn(usize) -> usize) {
        for (key, value) in table {
            let name =
                if prefix.is_empty() { key.get_ref().to_string() } else { format!("{prefix}.{}", key.get_ref()) };
            self.value(name, line(key.span().start), value, line);
        }
    }

    fn value(&mut self, name: String, at: usize, value: &Spanned<DeValue<'_>>, line: &impl Fn(usize) -> usize) {
        if let DeValue::Table(inner) = value.get_ref() {
            self.table(&name, inner, line);
        }
        if let DeValue::Array(parts) = value.get_ref() {
            for (index, part) in parts.iter().enumerate() {
                self.value(format!("{name}.{index}"), line(part.span().start), part, line);
            }
        }
        self.lines.insert(name, at);
    }
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    #[error("{file} is not valid TOML: {what}; correct it, or move it away to use the defaults")]
    Syntax { file: String, what: String },
    /// A key that is not a setting; lines count from 1.
    #[error("{file} line {line}: unknown setting '{name}'; `authros config show` lists all settings")]
    Unknown { file: String, line: usize, name: String },
    /// An invalid `[[topic]]` or `[[watch]]` table, or a key that does not belong in this file.
    #[error("{file} line {line}: {what}")]
    Entry { file: String, line: usize, what: String },
    #[error("{name} = '{value}' (from {source_name}) is invalid: {what}")]
    Value { name: &'static str, value: String, source_name: String, what: String },
}

impl ConfigError {
    pub fn kind(&self) -> ErrorKind {
        ErrorKind::Input
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_of_the_same_name_are_told_apart() {
        let text = "robots = 1\n[chain]\nurl = \"a\"\n\n[cache]\nurl = \"b\"\n[[watch]]\ntopic = \"/a\"\n\n[[watch]]\n# c\n\
                    type = \"x\"\ndisk.reserve = \"1\"\n";
        let lines = Lines::of("f", text);
        let line = |name: &str| lines.line(name);
        assert_eq!((line("robots"), line("chain.url"), line("cache.url"), line("watch.0.topic")), (1, 3, 6, 8));
        assert_eq!((line("watch.1.type"), line("watch.1.disk.reserve")), (12, 13));
        assert_eq!((line("watch.1.topic"), line("nothing")), (10, 1), "what is not there is where it would stand");
        assert_eq!(Lines::of("f", "a = ").line("a"), 1);
    }
}
