//! `metadata.yaml`: what it says of a folder, and writing it for one.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::yaml::{Value, parse, quote};
use crate::model::Timestamp;
use crate::ros::recording::{Channel, Encoding, TYPE_HASH};

/// The name of the file in a folder of rosbag2.
pub const METADATA: &str = "metadata.yaml";

/// The versions that are read.
const VERSIONS: std::ops::RangeInclusive<u64> = 1..=9;

/// The versions that are written: QoS as a text with numbers, which every reader since Iron takes; or in words, as recorders
/// since Jazzy have it.
const WITH_NUMBERS: u64 = 8;
const WITH_WORDS: u64 = 9;

/// The words of the numbers that stand for a QoS policy, as rmw counts them.
const POLICIES: [(&str, &[&str]); 4] = [
    ("history", &["system_default", "keep_last", "keep_all", "unknown"]),
    ("reliability", &["system_default", "reliable", "best_effort", "unknown", "best_available"]),
    ("durability", &["system_default", "transient_local", "volatile", "unknown", "best_available"]),
    ("liveliness", &["system_default", "automatic", "manual_by_node", "manual_by_topic", "unknown", "best_available"]),
];

/// The most files of a recording.
const MOST_FILES: usize = 65_536;

/// What `metadata.yaml` says of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Metadata {
    /// The names of its files, without folders, in their order.
    pub files: Vec<String>,
    /// How many messages each of them has, where that is said.
    pub of_file: BTreeMap<String, u64>,
    /// When the first message was recorded.
    pub begins: Timestamp,
    /// How many messages each topic has.
    pub topics: BTreeMap<String, u64>,
    /// How many all have.
    pub messages: Option<u64>,
}

impl Metadata {
    /// Reads the text of the file.
    ///
    /// # Errors
    /// What is wrong with it.
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
        let begins =
            root.get("starting_time").and_then(|time| time.get("nanoseconds_since_epoch")).and_then(Value::number);
        // Without a message it is the greatest number.
        let begins =
            Timestamp(begins.filter(|time| i64::try_from(*time).is_ok_and(|time| time < i64::MAX)).unwrap_or(0));
        Ok(Self { files, of_file, begins, topics, messages: count(root) })
    }
}

/// The last part of a path; none leads out of the folder.
fn file_name(path: &str) -> Option<String> {
    let name = path.rsplit('/').next().filter(|name| !matches!(*name, "" | "." | ".."))?;
    (!name.contains('\0')).then(|| name.to_owned())
}

/// Counts what is written, for the `metadata.yaml` beside it.
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
    /// Counts one message.
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

    /// The text of `metadata.yaml` for one MCAP file of this name.
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

/// The profiles of a QoS text; none if it cannot be read.
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

/// A QoS text as version 9 has it: a sequence, with words for numbers.
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
