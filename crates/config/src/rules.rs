//! `[[topic]]` tables of `config.toml`, in file order, and the policy that an owner sets for a robot.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use crate::model::topic_rule::{PatternError, SamplingError};
use crate::model::{Sampling, TopicName, TopicRule, TopicRules, TypeName, positive_span};
use crate::read::{Lines, Source, Values, document, read_document};
use crate::{ConfigError, RingSettings, ring};
use toml::Value;

/// What errors call the text.
const FILE: &str = "the policy";
/// As many as an enrolment can name.
const MOST_WATCHED: usize = 1023;
const WATCH: &str = "watch";
const SETTINGS: [&str; 2] = ["ring.keep", "ring.topics"];

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum RingWish {
    /// Nothing: the robot's own settings count.
    #[default]
    Own,
    Off,
    Keep(RingSettings),
}

/// Where it is silent, the robot's own settings count.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RobotPolicy {
    pub rules: Option<TopicRules>,
    pub ring: RingWish,
    pub watched: Option<Vec<TopicName>>,
}

impl RobotPolicy {
    pub fn read(text: &str) -> Result<Self, ConfigError> {
        let lines = Lines::of(FILE, text);
        let mut document = document(FILE, text)?;
        let watched = document.remove(WATCH).map(|tables| watched(&tables, &lines)).transpose()?;
        let has_rules = document.contains_key(TABLE);
        let no_such = |name: &str| {
            format!("a robot's policy has no '{name}'; it has [[topic]], [[watch]], ring.keep and ring.topics")
        };
        let (found, rules) = read_document(document, &lines).map_err(|error| match error {
            ConfigError::Unknown { file, line, name } => ConfigError::Entry { file, line, what: no_such(&name) },
            error => error,
        })?;
        if let Some(name) = found.keys().find(|name| !SETTINGS.contains(&name.as_str())) {
            return Err(lines.fault(name, &no_such(name)));
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
fn named(mut error: ConfigError) -> ConfigError {
    if let ConfigError::Value { source_name, .. } = &mut error {
        FILE.clone_into(source_name);
    }
    error
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

pub(super) const TABLE: &str = "topic";

const MOST_RULES: usize = 1000;
const MOST_TAGS: usize = 16;

pub(super) fn read(value: &toml::Value, lines: &Lines) -> Result<TopicRules, ConfigError> {
    let form = |place: &str| lines.fault(place, "write topic rules as [[topic]] tables");
    let tables = value.as_array().ok_or_else(|| form(TABLE))?;
    if tables.len() > MOST_RULES {
        return Err(lines.fault(TABLE, &format!("there are more than {MOST_RULES} rules")));
    }
    let rule = |(index, table): (usize, &toml::Value)| {
        let place = format!("{TABLE}.{index}");
        let table = table.as_table().ok_or_else(|| form(&place))?;
        let rule = rule(table, lines.line(&place));
        rule.map(Arc::new).map_err(|(key, what)| lines.fault(&format!("{place}.{key}"), &what))
    };
    tables.iter().enumerate().map(rule).collect::<Result<_, _>>().map(TopicRules)
}

type Wrong<'a> = (&'a str, String);

fn rule(table: &toml::Table, line: usize) -> Result<TopicRule, Wrong<'_>> {
    let known = ["match", "type", "rate", "every", "tags", "retention"];
    if let Some(key) = table.keys().find(|key| !known.contains(&key.as_str())) {
        return Err((key, format!("a rule has no key '{key}'; its keys are {}", known.join(", "))));
    }
    let pattern = table.get("match").and_then(toml::Value::as_str);
    let pattern =
        pattern.ok_or(("match", "a rule must say which topics it applies to: match = \"/robot*/odom\"".to_owned()))?;
    Ok(TopicRule {
        pattern: pattern.parse().map_err(|error: PatternError| ("match", error.to_string()))?,
        line,
        type_name: table.get("type").map(type_name).transpose()?,
        rate: table.get("rate").map(rate).transpose()?,
        every: table.get("every").map(every).transpose()?,
        tags: table.get("tags").map(tags).transpose()?.unwrap_or_default(),
        retention: table.get("retention").map(retention).transpose()?,
    })
}

fn type_name(value: &toml::Value) -> Result<TypeName, Wrong<'static>> {
    let wrong = |text: String| ("type", text);
    let text = value.as_str().ok_or_else(|| wrong("write type = \"package/Type\"".to_owned()))?;
    text.parse().map_err(|error: crate::model::topic::NameError| wrong(error.to_string()))
}

fn rate(value: &toml::Value) -> Result<u64, Wrong<'static>> {
    let rate =
        value.as_float().or_else(|| value.as_integer().and_then(|whole| i32::try_from(whole).ok()).map(f64::from));
    let wrong = || ("rate", SamplingError::Rate(value.to_string()).to_string());
    rate.and_then(Sampling::rate_of).ok_or_else(wrong)
}

fn every(value: &toml::Value) -> Result<u64, Wrong<'static>> {
    let every = value.as_integer().and_then(|every| u64::try_from(every).ok());
    let wrong = || ("every", SamplingError::Every(value.to_string()).to_string());
    every.and_then(Sampling::every_of).ok_or_else(wrong)
}

fn tags(value: &toml::Value) -> Result<BTreeMap<String, String>, Wrong<'static>> {
    let wrong = || ("tags", "write tags = { mission = \"harbour\" }; keys are letters, digits, - and _".to_owned());
    let table = value.as_table().filter(|table| table.len() <= MOST_TAGS).ok_or_else(wrong)?;
    let usable = |key: &str| {
        !key.is_empty() && key.len() <= 64 && key.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-')
    };
    let tag = |(key, value): (&String, &toml::Value)| {
        let value = value.as_str().filter(|value| value.len() <= 1024 && usable(key)).ok_or_else(wrong)?;
        Ok((key.clone(), value.to_owned()))
    };
    table.iter().map(tag).collect()
}

fn retention(value: &toml::Value) -> Result<u64, Wrong<'static>> {
    let wrong = || ("retention", "give retention as a time, such as \"12h\" or \"30d\"".to_owned());
    let span = value.as_str().and_then(|text| positive_span(text).ok());
    span.map(|span| span.as_secs()).ok_or_else(wrong)
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
            ("ring.depth = 3\n", "line 1: a robot's policy has no 'ring.depth'; it has [[topic]]"),
            ("wach = 3\n", "line 1: a robot's policy has no 'wach'; it has [[topic]]"),
            ("[[", "not valid TOML"),
        ] {
            let error = RobotPolicy::read(text).expect_err(text).to_string();
            assert!(error.contains(told), "{text}: {error}");
        }
        let many: String = (0..1024).map(|number| format!("[[watch]]\ntopic = \"/t{number}\"\n")).collect();
        assert!(RobotPolicy::read(&many).is_err());
    }
}

#[cfg(test)]
mod topic_rules_tests {
    use super::*;

    fn rules(text: &str) -> Result<TopicRules, ConfigError> {
        let table: toml::Table = text.parse().expect("TOML");
        read(&table["topic"], &Lines::of("config.toml", text))
    }

    #[test]
    fn a_full_rule_and_the_first_that_fits() {
        let text = "robots = 1\n[[topic]]\nmatch = \"/robot*/camera/**\"\ntype = \"sensor_msgs/CompressedImage\"\n\
                    rate = 2.5\nevery = 3\ntags = { mission = \"harbour\" }\nretention = \"30d\"\n\n\
                    [[topic]]\nmatch = \"**\"\nrate = 10\n";
        let rules = rules(text).expect("rules");
        let camera = rules.of("/robot1/camera/image").expect("a rule");
        assert_eq!(
            (camera.line, camera.rate, camera.every, camera.retention),
            (2, Some(2500), Some(3), Some(2_592_000))
        );
        assert_eq!(camera.tags["mission"], "harbour");
        assert_eq!(rules.of("/odom").map(|rule| (rule.line, rule.rate)), Some((10, Some(10_000))));
    }

    #[test]
    fn faults_name_their_line() {
        let first = "[[topic]]\nmatch = \"/a\"\n\n";
        for (line, table) in [
            (6, "match = \"/b\"\nrate = -1\n"),
            (6, "match = \"/b\"\nrate = \"fast\"\n"),
            (6, "match = \"/b\"\nevery = 0\n"),
            (6, "match = \"/b\"\ntags = { \"a b\" = \"c\" }\n"),
            (6, "match = \"/b\"\nretention = \"soon\"\n"),
            (6, "match = \"/b\"\ntype = \"Odometry\"\n"),
            (6, "match = \"/b\"\nrates = 1\n"),
            (5, "match = \"b\"\n"),
            (4, "rate = 1\n"),
        ] {
            let error = rules(&format!("{first}[[topic]]\n{table}")).expect_err(table);
            assert!(matches!(error, ConfigError::Entry { line: at, .. } if at == line), "{table}: {error:?}");
        }
        assert!(rules("topic = 3\n").is_err());
    }
}
