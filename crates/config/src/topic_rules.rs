//! `[[topic]]` tables of `config.toml`: rules for topics that match a pattern, in file order.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::ConfigError;
use super::lines::Lines;
use crate::model::{TopicRule, TopicRules, TypeName, positive_span};

/// The name of the tables.
pub(super) const TABLE: &str = "topic";

/// The most rules.
const MOST_RULES: usize = 1000;
/// The most tags of a rule.
const MOST_TAGS: usize = 16;
/// The highest rate that limits anything, messages a second.
const FASTEST: f64 = 100_000.0;

/// Reads the rules from the value of `topic`.
///
/// # Errors
/// [`ConfigError`] for the first invalid rule.
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
        pattern: pattern
            .parse()
            .map_err(|error: crate::model::topic_rule::PatternError| ("match", error.to_string()))?,
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
    let usable = rate.filter(|rate| (0.001..=FASTEST).contains(rate));
    let rate = usable.ok_or(("rate", format!("give rate in messages per second, 0.001 to {FASTEST}")))?;
    let in_thousand_seconds = (rate * 1000.0).round();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 1 and 10^8")]
    Ok(in_thousand_seconds as u64)
}

fn every(value: &toml::Value) -> Result<u64, Wrong<'static>> {
    let every =
        value.as_integer().and_then(|every| u64::try_from(every).ok()).filter(|every| (1..=1 << 32).contains(every));
    every.ok_or(("every", "give every as a whole number: 10 keeps one message in ten".to_owned()))
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

/// A number and `s`, `m`, `h`, `d` or `w`, as in the setting.
fn retention(value: &toml::Value) -> Result<u64, Wrong<'static>> {
    let wrong = || ("retention", "give retention as a time, such as \"12h\" or \"30d\"".to_owned());
    let span = value.as_str().and_then(|text| positive_span(text).ok());
    span.map(|span| span.as_secs()).ok_or_else(wrong)
}

#[cfg(test)]
mod tests {
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
