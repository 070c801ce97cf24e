//! A site file as text: always in the same order, so that a repository shows only real changes.

use std::fmt::Write as _;

use super::{Decisions, KnownAccount, Settings, SiteFile};
use crate::DEFINITIONS;
use crate::model::{TopicRule, TopicRules, is_shown};

/// A text as TOML, with characters unsafe for terminals escaped.
pub(super) fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for character in text.chars() {
        match character {
            '"' | '\\' => quoted.extend(['\\', character]),
            shown if is_shown(shown) => quoted.push(shown),
            hidden => quoted.push_str(&format!("\\U{:08X}", u32::from(hidden))),
        }
    }
    quoted.push('"');
    quoted
}

/// The value of a setting: a number or a list unchanged, anything else as text.
fn value(text: &str) -> String {
    let plain = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit()) && text.parse::<i64>().is_ok();
    let read: Option<toml::Table> = format!("it = {text}").parse().ok();
    let words = read.as_ref().and_then(|table| table.get("it")).and_then(toml::Value::as_array);
    let words: Option<Vec<String>> =
        words.and_then(|words| words.iter().map(|word| word.as_str().map(quoted)).collect());
    match words {
        Some(words) => format!("[{}]", words.join(", ")),
        None if plain && !text.starts_with('0') || text == "0" => text.to_owned(),
        None => quoted(text),
    }
}

/// Writing to a string cannot fail.
fn line(text: &mut String, arguments: std::fmt::Arguments<'_>) {
    let _ = text.write_fmt(arguments);
    text.push('\n');
}

/// The settings that are set: first those without a table, then table by table. `lists` comes between.
fn settings(text: &mut String, settings: &Settings, lists: &str) {
    let set = |table: &str| {
        let of_table =
            DEFINITIONS.iter().map(|definition| definition.name.rsplit_once('.').unwrap_or(("", definition.name)));
        let set = of_table.filter(|(of, _)| *of == table).filter_map(|(of, key)| {
            let name = if of.is_empty() { key.to_owned() } else { format!("{of}.{key}") };
            Some(format!("{key} = {}\n", value(settings.get(name.as_str())?)))
        });
        set.collect::<String>()
    };
    text.push_str(&set(""));
    text.push_str(lists);
    let mut tables: Vec<&str> =
        DEFINITIONS.iter().filter_map(|definition| Some(definition.name.rsplit_once('.')?.0)).collect();
    tables.dedup();
    let mut written: Vec<&str> = Vec::new();
    for table in tables {
        let set = set(table);
        if !set.is_empty() && !written.contains(&table) {
            line(text, format_args!("\n[{table}]\n{}", set.trim_end()));
        }
        written.push(table);
    }
}

/// The terms of a rule, `key = value`. A new term that is missing here does not compile.
pub(super) fn terms(rule: &TopicRule) -> Vec<String> {
    let TopicRule { pattern, line: _, type_name, rate, every, tags, retention } = rule;
    let mut terms = vec![format!("match = {}", quoted(pattern.as_str()))];
    terms.extend(type_name.as_ref().map(|name| format!("type = {}", quoted(name.as_str()))));
    terms.extend(rate.map(|rate| match (rate / 1000, rate % 1000) {
        (whole, 0) => format!("rate = {whole}"),
        (whole, part) => format!("rate = {whole}.{part:03}"),
    }));
    terms.extend(every.map(|every| format!("every = {every}")));
    let tags: Vec<String> = tags.iter().map(|(key, value)| format!("{key} = {}", quoted(value))).collect();
    terms.extend((!tags.is_empty()).then(|| format!("tags = {{ {} }}", tags.join(", "))));
    terms.extend(retention.map(|seconds| format!("retention = \"{seconds}s\"")));
    terms
}

fn rules(text: &mut String, rules: &TopicRules) {
    for rule in &rules.0 {
        line(text, format_args!("\n[[topic]]\n{}", terms(rule).join("\n")));
    }
}

/// A list that is present but empty: it removes everything.
fn empty(decisions: &Decisions) -> String {
    let Decisions { watches, publishers, contacts, admitted } = decisions;
    let lists = [
        ("watch", watches.as_ref().map(|list| list.is_empty())),
        ("publisher", publishers.as_ref().map(|list| list.is_empty())),
        ("contact", contacts.as_ref().map(|list| list.is_empty())),
        ("admitted", admitted.as_ref().map(|list| list.is_empty())),
    ];
    lists.iter().filter(|(_, empty)| *empty == Some(true)).map(|(name, _)| format!("{name} = []\n")).collect()
}

fn entries(text: &mut String, decisions: &Decisions) {
    let Decisions { watches, publishers, contacts, admitted } = decisions;
    for (topic, type_name) in watches.iter().flatten() {
        line(text, format_args!("\n[[watch]]\ntopic = {}", quoted(topic.as_str())));
        if let Some(name) = type_name {
            line(text, format_args!("type = {}", quoted(name.as_str())));
        }
    }
    for (topic, publisher) in publishers.iter().flatten() {
        let publisher = quoted(&publisher.to_string());
        line(text, format_args!("\n[[publisher]]\ntopic = {}\npublisher = {publisher}", quoted(topic.as_str())));
    }
    for (name, KnownAccount { address, fingerprint }) in contacts.iter().flatten() {
        line(text, format_args!("\n[[contact]]\nname = {}\naddress = \"{address}\"", quoted(name.as_str())));
        if let Some(fingerprint) = fingerprint {
            line(text, format_args!("fingerprint = {}", quoted(fingerprint)));
        }
    }
    for owner in admitted.iter().flatten() {
        line(text, format_args!("\n[[admitted]]\nowner = \"{owner}\""));
    }
}

impl SiteFile {
    /// As a file; `head` is its initial comment, line by line.
    pub fn to_text(&self, head: &[String]) -> String {
        let Self { settings: set, rules: of_topics, decisions } = self;
        let mut text: String = head.iter().map(|line| format!("# {line}\n")).collect();
        settings(&mut text, set, &empty(decisions));
        rules(&mut text, of_topics);
        entries(&mut text, decisions);
        text
    }
}
