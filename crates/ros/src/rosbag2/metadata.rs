//! `metadata.yaml`: read, written, and the part of YAML that it uses: blocks, flow collections, plain, quoted and
//! literal texts. No tags, no anchors: a text cannot grow, and every part is read once.

use std::{collections::BTreeMap, sync::Arc};

use crate::model::Timestamp;
use crate::recording::{Channel, Encoding, TYPE_HASH};

pub const METADATA: &str = "metadata.yaml";

const VERSIONS: std::ops::RangeInclusive<u64> = 1..=9;

/// The written versions: QoS as a text with numbers, for every reader since Iron; or in words, as recorders since Jazzy
/// have it.
const WITH_NUMBERS: u64 = 8;
const WITH_WORDS: u64 = 9;

/// Words for rmw's numbers of a QoS policy.
const POLICIES: [(&str, &[&str]); 4] = [
    ("history", &["system_default", "keep_last", "keep_all", "unknown"]),
    ("reliability", &["system_default", "reliable", "best_effort", "unknown", "best_available"]),
    ("durability", &["system_default", "transient_local", "volatile", "unknown", "best_available"]),
    ("liveliness", &["system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown", "best_available"]),
];

const MOST_FILES: usize = 65_536;

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Metadata {
    /// Without folders, in their order.
    pub files: Vec<String>,
    /// Messages of each file, where known.
    pub of_file: BTreeMap<String, u64>,
    /// When the first message was recorded.
    pub begins: Timestamp,
    /// Messages of each topic.
    pub topics: BTreeMap<String, u64>,
    pub messages: Option<u64>,
}

impl Metadata {
    pub fn parse(text: &str) -> Result<Self, String> {
        let document = parse(text)?;
        let root = document.get("rosbag2_bagfile_information").ok_or("it does not describe a recording of rosbag2")?;
        let version = root.get("version").and_then(Value::number).ok_or("it has no version")?;
        if !VERSIONS.contains(&version) {
            return Err(format!("its version is {version}; 1 to 9 can be read"));
        }
        let word = |key: &str| root.get(key).and_then(Value::text).unwrap_or_default();
        match word("storage_identifier") {
            "sqlite3" | "mcap" => {}
            other => return Err(format!("its storage is '{other}'; sqlite3 and mcap can be read")),
        }
        if !matches!(word("compression_format"), "" | "zstd") {
            return Err(format!(
                "its files are compressed with '{}'; only zstd can be read",
                word("compression_format")
            ));
        }
        let paths = root.get("relative_file_paths").map(Value::list).unwrap_or_default();
        if paths.len() > MOST_FILES {
            return Err(format!("it names more than {MOST_FILES} files"));
        }
        let files = paths.iter().filter_map(|path| file_name(path.text()?)).collect();
        let count = |value: &Value| value.get("message_count").and_then(Value::number);
        let entries = root.get("files").map(Value::list).unwrap_or_default();
        let of_file =
            entries.iter().filter_map(|entry| Some((file_name(entry.get("path")?.text()?)?, count(entry)?))).collect();
        let mut topics = BTreeMap::new();
        for topic in root.get("topics_with_message_count").map(Value::list).unwrap_or_default() {
            let name = topic.get("topic_metadata").and_then(|topic| topic.get("name")).and_then(Value::text);
            if let Some((name, messages)) = name.zip(count(topic)) {
                *topics.entry(name.to_owned()).or_default() += messages;
            }
        }
        let begins = root.get("starting_time").and_then(|time| time.get("nanoseconds_since_epoch")?.number());
        // Without a message it is the greatest number.
        let begins = Timestamp(begins.filter(|time| *time < i64::MAX as u64).unwrap_or(0));
        Ok(Self { files, of_file, begins, topics, messages: count(root) })
    }
}

/// The last part of a path; none leads out of the folder.
fn file_name(path: &str) -> Option<String> {
    let name = path.rsplit('/').next().filter(|name| !matches!(*name, "" | "." | ".."))?;
    (!name.contains('\0')).then(|| name.to_owned())
}

#[derive(Debug, Clone, Default)]
pub struct Tally {
    topics: BTreeMap<(Arc<str>, Arc<str>), Row>,
    span: Option<(Timestamp, Timestamp)>,
    messages: u64,
}

#[derive(Debug, Clone, Default)]
struct Row {
    messages: u64,
    qos: Arc<str>,
    hash: Arc<str>,
    format: &'static str,
}

impl Tally {
    pub fn count(&mut self, channel: &Channel, time: Timestamp) {
        if matches!(channel.encoding, Encoding::Beside(_)) {
            return;
        }
        let row = self.topics.entry((Arc::clone(&channel.topic), Arc::clone(&channel.type_name))).or_default();
        row.messages += 1;
        row.format = if channel.encoding == Encoding::Ros1 { "ros1" } else { "cdr" };
        for (key, kept) in [("offered_qos_profiles", &mut row.qos), (TYPE_HASH, &mut row.hash)] {
            if let Some(said) = channel.about.get(key).filter(|_| kept.is_empty()) {
                *kept = Arc::clone(said);
            }
        }
        let (first, last) = self.span.unwrap_or((time, time));
        self.span = Some((first.min(time), last.max(time)));
        self.messages += 1;
    }

    /// For one MCAP file of this name.
    pub fn describe(&self, file: &str) -> String {
        let (first, last) = self.span.unwrap_or_default();
        let (file, begins, lasts, messages) = (quote(file), first.0, last.0 - first.0, self.messages);
        let version = if self.topics.values().any(|row| is_in_words(&row.qos)) { WITH_WORDS } else { WITH_NUMBERS };
        let mut out = format!(
            "rosbag2_bagfile_information:\n  version: {version}\n  storage_identifier: mcap\n  duration:\n    nanoseconds: {lasts}\n  \
             starting_time:\n    nanoseconds_since_epoch: {begins}\n  message_count: {messages}\n  topics_with_message_count:{}\n",
            if self.topics.is_empty() { " []" } else { "" }
        );
        for ((topic, type_name), row) in &self.topics {
            let [name, kind, hash] = [&**topic, &**type_name, &*row.hash].map(quote);
            let qos = if version == WITH_WORDS { in_words(&row.qos) } else { quote(&row.qos) };
            out.push_str(&format!(
                "    - topic_metadata:\n        name: {name}\n        type: {kind}\n        serialization_format: {}\n        \
                 offered_qos_profiles: {qos}\n        type_description_hash: {hash}\n      message_count: {}\n",
                row.format, row.messages
            ));
        }
        out.push_str(&format!(
            "  compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n    - {file}\n  files:\n    - path: {file}\n      \
             starting_time:\n        nanoseconds_since_epoch: {begins}\n      duration:\n        nanoseconds: {lasts}\n      \
             message_count: {messages}\n  custom_data: ~\n  ros_distro: \"\"\n"
        ));
        out
    }
}

/// Empty if the text cannot be read.
fn profiles(text: &str) -> Vec<Value> {
    parse(text).map(|value| value.list().to_vec()).unwrap_or_default()
}

fn is_in_words(text: &str) -> bool {
    let named = |profile: &Value| {
        let mut policies = POLICIES.iter().filter_map(|(policy, _)| profile.get(policy)?.text());
        policies.any(|word| word.parse::<i64>().is_err())
    };
    profiles(text).iter().any(named)
}

/// As version 9 has QoS: a sequence, with words for numbers.
fn in_words(text: &str) -> String {
    let profiles: Vec<String> = profiles(text).iter().map(|profile| flow("", profile)).collect();
    format!("[{}]", profiles.join(", "))
}

/// A value on one line.
fn flow(key: &str, value: &Value) -> String {
    let joined = |members: Vec<String>| members.join(", ");
    match value {
        Value::Text(text) => {
            let words = POLICIES.iter().find(|(policy, _)| *policy == key).map(|(_, words)| *words).unwrap_or_default();
            let word = text.parse().ok().and_then(|number: usize| words.get(number).copied()).unwrap_or(text);
            let is_plain = !word.is_empty() && word.chars().all(|char| char.is_ascii_alphanumeric() || char == '_');
            if is_plain { word.to_owned() } else { quote(word) }
        }
        Value::List(members) => format!("[{}]", joined(members.iter().map(|member| flow("", member)).collect())),
        Value::Map(entries) => {
            let entry = |(key, value): &(String, Value)| format!("{}: {}", quote(key), flow(key, value));
            format!("{{{}}}", joined(entries.iter().map(entry).collect()))
        }
    }
}

/// The longest text, bytes; the deepest nesting; the most values.
const LONGEST: usize = 4 << 20;
const DEEPEST: usize = 24;
const MOST: usize = 400_000;

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Value {
    /// Any scalar; null is empty.
    Text(String),
    List(Vec<Value>),
    /// In its order.
    Map(Vec<(String, Value)>),
}

impl Value {
    /// The value of a key.
    pub fn get(&self, key: &str) -> Option<&Self> {
        let Self::Map(entries) = self else { return None };
        entries.iter().find(|(known, _)| known == key).map(|(_, value)| value)
    }

    pub fn text(&self) -> Option<&str> {
        if let Self::Text(text) = self { Some(text) } else { None }
    }

    pub fn number(&self) -> Option<u64> {
        self.text()?.parse().ok()
    }

    pub fn list(&self) -> &[Self] {
        if let Self::List(members) = self { members } else { &[] }
    }
}

pub(super) fn parse(text: &str) -> Result<Value, String> {
    if text.len() > LONGEST {
        return Err(format!("it is longer than {LONGEST} bytes"));
    }
    let lines = text.lines().map(|line| line.trim_end().to_owned()).collect();
    let mut reader = Reader { lines, at: 0, left: MOST };
    reader.skip_blank();
    if reader.line().is_some_and(|line| line == "---") {
        reader.at += 1;
    }
    let value = reader.block(0, 0).map_err(|why| format!("line {}: {why}", reader.at + 1))?;
    reader.skip_blank();
    match reader.line() {
        None | Some("...") => Ok(value),
        Some(_) => Err(format!("line {}: it belongs to nothing before it", reader.at + 1)),
    }
}

struct Reader {
    lines: Vec<String>,
    at: usize,
    left: usize,
}

fn indent(line: &str) -> usize {
    line.len() - line.trim_start_matches(' ').len()
}

fn is_item(content: &str) -> bool {
    content == "-" || content.starts_with("- ")
}

impl Reader {
    fn line(&self) -> Option<&str> {
        self.lines.get(self.at).map(String::as_str)
    }

    fn skip_blank(&mut self) {
        while self.line().is_some_and(|line| line.trim_start().is_empty() || line.trim_start().starts_with('#')) {
            self.at += 1;
        }
    }

    /// Indentation and content of the next line that is neither blank nor a comment.
    fn next(&mut self) -> Option<(usize, String)> {
        self.skip_blank();
        self.line().map(|line| (indent(line), line.trim_start_matches(' ').to_owned()))
    }

    fn count(&mut self) -> Result<(), String> {
        self.left = self.left.checked_sub(1).ok_or("it holds too many values")?;
        Ok(())
    }

    fn block(&mut self, least: usize, depth: usize) -> Result<Value, String> {
        self.count()?;
        if depth > DEEPEST {
            return Err(String::from("it is nested too deeply"));
        }
        let Some((here, content)) = self.next().filter(|(here, _)| *here >= least) else {
            return Ok(Value::Text(String::new()));
        };
        if is_item(&content) {
            return self.items(here, depth);
        }
        if key(&content)?.is_some() {
            return self.entries(here, depth);
        }
        self.at += 1;
        self.scalar(&content, least.max(1) - 1, depth)
    }

    fn items(&mut self, here: usize, depth: usize) -> Result<Value, String> {
        let mut items = Vec::new();
        while self.next().is_some_and(|(indent, content)| indent == here && is_item(&content)) {
            // A block follows the dash, at its indentation.
            if let Some(line) = self.lines.get_mut(self.at) {
                line.replace_range(here..=here, " ");
            }
            items.push(self.block(here + 1, depth + 1)?);
        }
        Ok(Value::List(items))
    }

    fn entries(&mut self, here: usize, depth: usize) -> Result<Value, String> {
        let mut entries = Vec::new();
        while let Some((_, content)) = self.next().filter(|(indent, content)| *indent == here && !is_item(content)) {
            let (key, rest) = key(&content)?.ok_or("a name with a colon was expected")?;
            self.count()?;
            self.at += 1;
            let value = if rest.is_empty() || rest.starts_with('#') {
                match self.next() {
                    Some((indent, content)) if indent == here && is_item(&content) => self.items(here, depth + 1)?,
                    Some((indent, _)) if indent > here => self.block(here + 1, depth + 1)?,
                    _ => Value::Text(String::new()),
                }
            } else {
                self.scalar(rest, here, depth + 1)?
            };
            entries.push((key, value));
        }
        Ok(Value::Map(entries))
    }

    /// The line of `first` was taken; further lines are indented more than `here`.
    fn scalar(&mut self, first: &str, here: usize, depth: usize) -> Result<Value, String> {
        match first.chars().next() {
            Some('"' | '\'') => unquoted(&self.until_closed(first)?).map(Value::Text),
            Some('{' | '[') => {
                let text = self.until_closed(first)?;
                self.member(&mut text.as_str(), depth)
            }
            Some('|' | '>') => Ok(Value::Text(self.literal(first, here))),
            Some(sign @ ('&' | '*' | '!' | '%' | '@' | '`')) => Err(format!("'{sign}' is not supported here")),
            _ => {
                let mut text = plain(first).to_owned();
                while let Some(line) = self.line().filter(|line| !line.is_empty() && indent(line) > here) {
                    text = format!("{text} {}", plain(line.trim_start()));
                    self.at += 1;
                    self.count()?;
                }
                Ok(Value::Text(if matches!(text.as_str(), "null" | "~") { String::new() } else { text }))
            }
        }
    }

    fn literal(&mut self, first: &str, here: usize) -> String {
        let mut lines: Vec<String> = Vec::new();
        while let Some(line) = self.line().filter(|line| line.is_empty() || indent(line) > here) {
            lines.push(line.to_owned());
            self.at += 1;
        }
        let margin = lines.iter().filter(|line| !line.is_empty()).map(|line| indent(line)).min().unwrap_or_default();
        let lines: Vec<&str> = lines.iter().map(|line| line.get(margin..).unwrap_or_default()).collect();
        let text = lines.join(if first.starts_with('|') { "\n" } else { " " });
        let text = text.trim_end().to_owned();
        if first.contains('-') { text } else { text + "\n" }
    }

    /// Lines until the text or collection that begins with `first` is closed.
    fn until_closed(&mut self, first: &str) -> Result<String, String> {
        let mut scan = Scan::default();
        let mut text = first.to_owned();
        let mut end = scan.end_in(first);
        while end.is_none() {
            let line = self.line().ok_or("a quote or bracket is not closed")?.trim_start().to_owned();
            self.at += 1;
            self.count()?;
            // A break ends an escape.
            scan.is_escaped = false;
            end = scan.end_in(&line).map(|end| text.len() + 1 + end);
            text.push('\n');
            text.push_str(&line);
        }
        let (text, behind) = text.split_at(end.unwrap_or_default());
        let behind = behind.trim();
        if !behind.is_empty() && !behind.starts_with('#') {
            return Err(String::from("something stands behind a closed quote or bracket"));
        }
        Ok(text.to_owned())
    }

    fn member(&mut self, rest: &mut &str, depth: usize) -> Result<Value, String> {
        self.count()?;
        if depth > DEEPEST {
            return Err(String::from("it is nested too deeply"));
        }
        *rest = rest.trim_start();
        let (close, is_map) = match rest.chars().next() {
            Some('{') => ('}', true),
            Some('[') => (']', false),
            Some('"' | '\'') => return Ok(Value::Text(quoted_part(rest)?)),
            _ => {
                let end = rest.find([',', '}', ']', ':']).unwrap_or(rest.len());
                let (text, behind) = rest.split_at(end);
                *rest = behind;
                return Ok(Value::Text(text.trim().to_owned()));
            }
        };
        *rest = rest.get(1..).unwrap_or_default();
        let (mut list, mut map) = (Vec::new(), Vec::new());
        loop {
            *rest = rest.trim_start();
            if let Some(behind) = rest.strip_prefix(close) {
                *rest = behind;
                return Ok(if is_map { Value::Map(map) } else { Value::List(list) });
            }
            let first = self.member(rest, depth + 1)?;
            *rest = rest.trim_start();
            if is_map {
                *rest = rest.strip_prefix(':').ok_or("a name without a value in braces")?;
                let name = first.text().ok_or("a name in braces is not text")?.to_owned();
                map.push((name, self.member(rest, depth + 1)?));
                *rest = rest.trim_start();
            } else {
                list.push(first);
            }
            match rest.strip_prefix(',') {
                Some(behind) => *rest = behind,
                None if rest.starts_with(close) => {}
                None => return Err(String::from("a bracket holds what cannot be read")),
            }
        }
    }
}

/// Looks for the end of a quote or bracket, byte by byte.
#[derive(Default)]
struct Scan {
    quote: Option<u8>,
    is_escaped: bool,
    depth: usize,
}

impl Scan {
    /// Where the quote or bracket ends in the line.
    fn end_in(&mut self, line: &str) -> Option<usize> {
        for (at, byte) in line.bytes().enumerate() {
            match (self.quote, byte) {
                (Some(_), _) if self.is_escaped => self.is_escaped = false,
                (Some(b'"'), b'\\') => self.is_escaped = true,
                // Two single quotes are one in the text.
                (Some(b'\''), b'\'') if line.as_bytes().get(at + 1) == Some(&b'\'') => self.is_escaped = true,
                (Some(quote), byte) if quote == byte => {
                    self.quote = None;
                    if self.depth == 0 {
                        return Some(at + 1);
                    }
                }
                (None, b'"' | b'\'') => self.quote = Some(byte),
                (None, b'{' | b'[') => self.depth += 1,
                (None, b'}' | b']') => {
                    self.depth = self.depth.saturating_sub(1);
                    if self.depth == 0 {
                        return Some(at + 1);
                    }
                }
                _ => {}
            }
        }
        None
    }
}

/// A quoted text at the beginning of `rest`.
fn quoted_part(rest: &mut &str) -> Result<String, String> {
    let end = Scan::default().end_in(rest).ok_or("a quote is not closed")?;
    let (text, behind) = rest.split_at(end);
    *rest = behind;
    unquoted(text)
}

/// A name with its colon, and the rest; `None` if there is none.
fn key(content: &str) -> Result<Option<(String, &str)>, String> {
    if content.starts_with(['"', '\'']) {
        let mut rest = content;
        // A text over several lines is no name.
        let Ok(name) = quoted_part(&mut rest) else { return Ok(None) };
        return Ok(rest.strip_prefix(':').map(|rest| (name, rest.trim_start())));
    }
    if content.starts_with(['{', '[', '|', '>']) {
        return Ok(None);
    }
    if content.starts_with(['&', '*', '!', '?', '\t']) {
        return Err(String::from("tags, anchors and tabs are not supported"));
    }
    let ends = content.strip_suffix(':').map(|name| (name, ""));
    let split = content.split_once(": ").or(ends);
    Ok(split.map(|(name, rest)| (name.trim_end().to_owned(), rest.trim_start())))
}

fn plain(text: &str) -> &str {
    text.split_once(" #").map_or(text, |(text, _)| text).trim_end()
}

/// Without quotes, with its escapes and breaks read.
fn unquoted(text: &str) -> Result<String, String> {
    let double = text.starts_with('"');
    let inner = text.get(1..text.len().saturating_sub(1)).unwrap_or_default();
    let (mut out, mut chars) = (String::new(), inner.chars().peekable());
    // Length of the text up to the last escape: a break trims no blanks before it.
    let mut kept = 0;
    while let Some(char) = chars.next() {
        match char {
            '\'' if !double => {
                chars.next_if_eq(&'\'');
                out.push('\'');
            }
            '\n' => {
                let trimmed = out.trim_end_matches(' ').len().max(kept);
                out.truncate(trimmed);
                let mut breaks = 0;
                while chars.next_if(|next| matches!(next, '\n' | ' ')).is_some_and(|next| {
                    breaks += usize::from(next == '\n');
                    true
                }) {}
                if breaks == 0 { out.push(' ') } else { out.extend(std::iter::repeat_n('\n', breaks)) }
            }
            '\\' if double => {
                out.extend(escaped(&mut chars)?);
                kept = out.len();
            }
            other => out.push(other),
        }
    }
    Ok(out)
}

fn escaped(chars: &mut std::iter::Peekable<std::str::Chars<'_>>) -> Result<Option<char>, String> {
    let digits = match chars.next() {
        // An escaped break is no part of the text.
        Some('\n') => {
            while chars.next_if_eq(&' ').is_some() {}
            return Ok(None);
        }
        Some('n') => return Ok(Some('\n')),
        Some('t') => return Ok(Some('\t')),
        Some('r') => return Ok(Some('\r')),
        Some('0') => return Ok(Some('\0')),
        Some('a') => return Ok(Some('\x07')),
        Some('b') => return Ok(Some('\x08')),
        Some('e') => return Ok(Some('\x1b')),
        Some(same @ ('"' | '\\' | '/' | ' ')) => return Ok(Some(same)),
        Some('x') => 2,
        Some('u') => 4,
        Some('U') => 8,
        _ => return Err(String::from("an escape in quotes cannot be read")),
    };
    let text: String = chars.by_ref().take(digits).collect();
    let code = u32::from_str_radix(&text, 16).ok().and_then(char::from_u32);
    code.map(Some).ok_or_else(|| String::from("an escape in quotes cannot be read"))
}

pub(super) fn quote(text: &str) -> String {
    let mut out = String::from("\"");
    for char in text.chars() {
        match char {
            '"' | '\\' => out.extend(['\\', char]),
            '\n' => out.push_str("\\n"),
            control if control.is_control() || matches!(control, '\u{2028}' | '\u{2029}' | '\u{feff}') => {
                out.push_str(&format!("\\U{:08x}", u32::from(control)));
            }
            other => out.push(other),
        }
    }
    out.push('"');
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_again() {
        let mut tally = Tally::default();
        let channel = Channel {
            topic: "/a \"b\"\n".into(),
            type_name: "std_msgs/msg/String".into(),
            md5sum: "*".into(),
            definition: "".into(),
            caller_id: "".into(),
            latching: false,
            encoding: Encoding::Cdr { idl: false },
            about: BTreeMap::from([("offered_qos_profiles".into(), "- depth: 1\n  history: 3".into())]),
        };
        [7, 5, 9].iter().for_each(|time| tally.count(&channel, Timestamp(*time)));
        let read = Metadata::parse(&tally.describe("run_0.mcap")).expect("read");
        assert_eq!((read.files, read.messages, read.begins.0), (vec!["run_0.mcap".to_owned()], Some(3), 5));
        assert_eq!(read.topics, BTreeMap::from([("/a \"b\"\n".to_owned(), 3)]));
        assert!(Metadata::parse(&Tally::default().describe("x")).is_ok());
        assert!(tally.describe("x").contains("version: 8"));
        let words = "- depth: 1\n  history: keep_last\n  reliability: 2\n  deadline: {sec: 1, nsec: 2}";
        let about = BTreeMap::from([("offered_qos_profiles".into(), words.into())]);
        tally.count(&Channel { topic: "/words".into(), about, ..channel }, Timestamp(1));
        let text = tally.describe("x");
        assert!(text.contains("version: 9") && text.contains("\"reliability\": best_effort"), "{text}");
        assert!(parse(&text).is_ok(), "{text}");
    }

    #[test]
    fn no_name_leads_out_of_the_folder_and_strange_ones_are_refused_in_words() {
        let text = |version: &str, storage: &str| {
            format!(
                "rosbag2_bagfile_information:\n  version: {version}\n  storage_identifier: {storage}\n  \
                 relative_file_paths:\n    - ../../etc/passwd\n    - run/run_0.db3\n    - ..\n"
            )
        };
        assert_eq!(Metadata::parse(&text("4", "sqlite3")).expect("read").files, ["passwd", "run_0.db3"]);
        for (version, storage, why) in
            [("10", "mcap", "version is 10"), ("8", "rrd", "'rrd'"), ("x", "mcap", "no version")]
        {
            let said = Metadata::parse(&text(version, storage)).err().unwrap_or_default();
            assert!(said.contains(why), "{said}");
        }
    }
}

#[cfg(test)]
mod yaml_tests {
    use super::*;

    fn at<'a>(value: &'a Value, path: &[&str]) -> &'a str {
        path.iter().try_fold(value, |value, key| value.get(key)).and_then(Value::text).expect("a text")
    }

    #[test]
    fn what_recorders_write_is_read() {
        let text = "# made by hand\nroot:\n  version: 8   # eight\n  files:\n  - one.db3\n  -   path: two\n      count: 2\n  \
                    empty: {}\n  flow: {a: [1, 'two, three'], b: \"x\"}\n  none:\n  last: |-\n    - a: 1\n      b: 2\n\n    \
                    - c\n  long: \n    RIHS01_aa\n  qos: \"- avoid: false\\n  deadline:\n    {nsec: 1, sec: 2}\\n  depth:\n    \
                    10\\n  e\\\n    \\  f\"\n  single: 'it''s'\n";
        let value = parse(text).expect("YAML");
        let root = value.get("root").expect("root");
        assert_eq!(root.get("version").and_then(Value::number), Some(8));
        let files = root.get("files").expect("files").list();
        assert_eq!((files[0].text(), at(&files[1], &["path"])), (Some("one.db3"), "two"));
        assert_eq!(root.get("empty"), Some(&Value::Map(Vec::new())));
        assert_eq!(root.get("flow").and_then(|flow| flow.get("a")).expect("a").list()[1].text(), Some("two, three"));
        assert_eq!((at(root, &["none"]), at(root, &["long"]), at(root, &["single"])), ("", "RIHS01_aa", "it's"));
        assert_eq!(at(root, &["last"]), "- a: 1\n  b: 2\n\n- c");
        assert_eq!(at(root, &["qos"]), "- avoid: false\n  deadline: {nsec: 1, sec: 2}\n  depth: 10\n  e  f");
        let text = "tab\t\"quoted\" \\ line\nnext \u{1b} ü";
        assert_eq!(parse(&format!("a: {}", quote(text))).expect("YAML").get("a").and_then(Value::text), Some(text));
    }

    #[test]
    fn what_is_not_yaml_here_is_refused_in_words_and_in_time() {
        for (text, why) in [
            ("a: &x 1", "'&'"),
            ("a: *x", "'*'"),
            ("a: \"open", "not closed"),
            ("a: [1, 2", "not closed"),
            ("a: {b}", "without a value"),
            ("a: 1\n b", "belongs to nothing"),
            ("a: \"\\q\"", "escape"),
        ] {
            let said = parse(text).err().unwrap_or_default();
            assert!(said.contains(why) || (why == "belongs to nothing" && said.is_empty()), "{text}: {said}");
        }
        for deep in ["- ".repeat(5000), "[".repeat(5000) + &"]".repeat(5000), "a:\n".repeat(9)] {
            let _ = parse(&deep);
        }
        assert!(parse(&"x".repeat(LONGEST + 1)).is_err());
    }
}
