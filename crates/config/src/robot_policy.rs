//! The policy that an owner sets for a robot: the keys of the robot's own settings that decide what it captures.

use std::collections::BTreeSet;

use toml::Value;

use crate::ConfigError;
use crate::lines::Lines;
use crate::model::{TopicName, TopicRules};
use crate::read::{Source, Values, document, read_document};
use crate::{RingSettings, ring, topic_rules};

/// What errors call the text.
const FILE: &str = "the policy";
/// The most watched topics, as many as an enrolment can name.
const MOST_WATCHED: usize = 1023;
/// The tables of watched topics.
const WATCH: &str = "watch";
/// The settings beside the tables.
const SETTINGS: [&str; 2] = ["ring.keep", "ring.topics"];

/// What a policy says of a robot's ring.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum RingWish {
    /// Nothing: the robot's own settings count.
    #[default]
    Own,
    /// There is to be none.
    Off,
    /// This one.
    Keep(RingSettings),
}

/// A policy; what it does not say is decided by the robot's own settings.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RobotPolicy {
    /// The rules for topics (`[[topic]]` tables).
    pub rules: Option<TopicRules>,
    /// The ring (`ring.keep`, `ring.topics`).
    pub ring: RingWish,
    /// The watched topics (`[[watch]]` tables), in order.
    pub watched: Option<Vec<TopicName>>,
}

impl RobotPolicy {
    /// Reads a policy; an empty one says nothing.
    ///
    /// # Errors
    /// [`ConfigError`] for the first thing that is not valid.
    pub fn read(text: &str) -> Result<Self, ConfigError> {
        let lines = Lines::of(FILE, text);
        let mut document = document(FILE, text)?;
        let watched = document.remove(WATCH).map(|tables| watched(&tables, &lines)).transpose()?;
        let has_rules = document.contains_key(topic_rules::TABLE);
        let (found, rules) = read_document(document, &lines)?;
        if let Some(name) = found.keys().find(|name| !SETTINGS.contains(&name.as_str())) {
            let what =
                format!("a robot's policy has no '{name}'; it has [[topic]], [[watch]], ring.keep and ring.topics");
            return Err(lines.fault(name, &what));
        }
        let mut values = Values::new();
        for name in SETTINGS {
            let (value, line) = found.get(name).cloned().unwrap_or((String::new(), 1));
            values.insert(name, (value, Source::File(line)));
        }
        let ring = match ring(&values).map_err(named)? {
            Some(ring) => RingWish::Keep(ring),
            None if found.is_empty() => RingWish::Own,
            None => RingWish::Off,
        };
        Ok(Self { rules: has_rules.then_some(rules), ring, watched })
    }
}

/// A setting's error names the policy, not the file of settings.
fn named(error: ConfigError) -> ConfigError {
    match error {
        ConfigError::Value { name, value, what, .. } => {
            ConfigError::Value { name, value, source_name: FILE.to_owned(), what }
        }
        other => other,
    }
}

fn watched(tables: &Value, lines: &Lines) -> Result<Vec<TopicName>, ConfigError> {
    let form = |place: &str| lines.fault(place, "write [[watch]] tables, each with topic = \"/robot1/odom\"");
    let tables = tables.as_array().ok_or_else(|| form(WATCH))?;
    if tables.len() > MOST_WATCHED {
        return Err(lines.fault(WATCH, &format!("there are more than {MOST_WATCHED} [[watch]] tables")));
    }
    let mut topics = BTreeSet::new();
    for (index, table) in tables.iter().enumerate() {
        let place = format!("{WATCH}.{index}");
        let table = table.as_table().ok_or_else(|| form(&place))?;
        if let Some(key) = table.keys().find(|key| *key != "topic") {
            let what =
                format!("[[watch]] of a policy has no key '{key}', only topic; types and rates are for [[topic]]");
            return Err(lines.fault(&format!("{place}.{key}"), &what));
        }
        let topic = table.get("topic").and_then(Value::as_str).ok_or_else(|| form(&place))?;
        let topic = topic.parse::<TopicName>().map_err(|error| lines.fault(&place, &error.to_string()))?;
        if !topics.insert(topic) {
            return Err(lines.fault(&place, "this topic is watched twice; remove one of them"));
        }
    }
    Ok(topics.into_iter().collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_has_the_keys_of_a_robots_settings_and_no_others() {
        let text = "[[watch]]\ntopic = \"/odom\"\n[[watch]]\ntopic = \"/imu\"\n\
                    [[topic]]\nmatch = \"/imu\"\nrate = 5\n[ring]\nkeep = \"5m, 64MiB\"\ntopics = [\"/camera/**\"]\n";
        let policy = RobotPolicy::read(text).expect("a policy");
        let watched: Vec<String> = policy.watched.expect("watched").iter().map(ToString::to_string).collect();
        assert_eq!(watched, ["/imu", "/odom"]);
        assert_eq!(policy.rules.expect("rules").of("/imu").expect("a rule").rate, Some(5000));
        let RingWish::Keep(ring) = policy.ring else { panic!("a ring") };
        assert!(ring.topics.matches("/camera/front/image") && ring.limits.bytes == 64 << 20);

        assert_eq!(RobotPolicy::read("").expect("empty"), RobotPolicy::default());
        let off = RobotPolicy::read("ring.keep = \"\"\nring.topics = \"\"\n").expect("no ring");
        assert_eq!((off.ring, off.watched, off.rules), (RingWish::Off, None, None));
        assert_eq!(RobotPolicy::read("watch = []\n").expect("nothing").watched, Some(Vec::new()));
    }

    #[test]
    fn what_is_not_valid_is_refused_with_its_line() {
        for (text, told) in [
            ("cache.url = \"redis://evil\"\n", "line 1: a robot's policy has no 'cache.url'"),
            ("\n[[watch]]\ntopic = \"odom odom\"\n", "line 2"),
            ("[[watch]]\ntopic = \"/a\"\ntype = \"x/Y\"\n", "line 3"),
            ("[[watch]]\ntopic = \"/a\"\n[[watch]]\ntopic = \"/a\"\n", "line 3"),
            ("watch = 3\n", "[[watch]]"),
            ("[[topic]]\nmatch = \"/a\"\nrate = -1\n", "line 3"),
            ("ring.keep = \"soon\"\nring.topics = [\"/a\"]\n", "the policy"),
            ("ring.topics = [\"/a\"]\n", "ring.keep"),
            ("ring.depth = 3\n", "unknown setting"),
            ("[[", "not valid TOML"),
        ] {
            let error = RobotPolicy::read(text).expect_err(text).to_string();
            assert!(error.contains(told), "{text}: {error}");
        }
        let many: String = (0..1024).map(|number| format!("[[watch]]\ntopic = \"/t{number}\"\n")).collect();
        assert!(RobotPolicy::read(&many).is_err());
    }
}
