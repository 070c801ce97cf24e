//! `topics rules`: the rule of each topic, and a draft of rules learned from the live topics.

use std::collections::BTreeMap;

use authros_output::{Output, table};
use clap::Args;

use super::parse;
use super::show::{Question, or_dash};
use crate::model::{Sampling, TopicRule};
use crate::service::reply::{PolicyRow, PolicyView};
use crate::service::{Failure, command};

/// Bytes a second from which a rate is suggested.
const HEAVY: f64 = 500_000.0;
/// Messages a second from which sampling is suggested.
const FAST: f64 = 50.0;
/// The rate suggested for heavy topics, messages a second.
const CALM: f64 = 5.0;

/// `topics rules …`
#[derive(Debug, Args)]
pub struct RulesArguments {
    /// Observe the live topics and print draft rules for config.toml
    #[arg(long)]
    pub learn: bool,
    /// How long to observe: 5s, 1m
    #[arg(long = "for", value_name = "TIME", default_value = "5s", requires = "learn")]
    pub duration: String,
}

pub fn question(arguments: &RulesArguments) -> Result<Question, Failure> {
    let milliseconds = u64::try_from(parse::duration(&arguments.duration)?.as_millis()).unwrap_or(u64::MAX);
    Ok(if arguments.learn { command::LearnPolicy { milliseconds }.into() } else { command::ShowPolicy.into() })
}

pub fn show(view: &PolicyView, output: &Output) {
    if view.learned {
        let draft = draft(&view.topics);
        output.result(&serde_json::json!({ "draft": draft, "topics": view.topics }), || draft.clone());
    } else {
        output.result(view, || text(view));
    }
}

fn text(view: &PolicyView) -> String {
    let row = |row: &PolicyRow| {
        let rule = row.rule.as_ref();
        [
            row.topic.clone(),
            or_dash(rule.map(|rule| format!("{} (line {})", rule.pattern, rule.line))),
            terms(rule, row.sampling),
            if row.watched { "watched" } else { "" }.to_owned(),
            row.left_out.to_string(),
        ]
    };
    let mut text = table(&["topic", "rule", "kept", "", "skipped"], view.topics.iter().map(row));
    for rule in &view.idle {
        text.push_str(&format!("\nno topic now: {} (line {})", rule.pattern, rule.line));
    }
    text
}

fn terms(rule: Option<&TopicRule>, sampling: Sampling) -> String {
    let mut terms = Vec::new();
    terms.extend(rule.and_then(|rule| rule.type_name.as_ref()).map(|name| format!("only {name}")));
    terms.extend((!sampling.is_all()).then(|| sampling.to_string()));
    terms.extend(rule.iter().flat_map(|rule| &rule.tags).map(|(key, value)| format!("{key}={value}")));
    terms.extend(rule.and_then(|rule| rule.retention).map(|seconds| format!("kept {}", span(seconds))));
    if terms.is_empty() { "everything".to_owned() } else { terms.join(", ") }
}

fn span(seconds: u64) -> String {
    match seconds {
        whole if whole % 86_400 == 0 => format!("{} d", whole / 86_400),
        whole if whole % 3_600 == 0 => format!("{} h", whole / 3_600),
        whole if whole % 60 == 0 => format!("{} min", whole / 60),
        other => format!("{other} s"),
    }
}

/// Topics that differ only in numbers share a rule.
fn draft(topics: &[PolicyRow]) -> String {
    let mut groups: BTreeMap<(String, Option<&str>), Vec<&PolicyRow>> = BTreeMap::new();
    for row in topics {
        groups.entry((without_numbers(&row.topic), row.type_name.as_deref())).or_default().push(row);
    }
    let mut draft = String::from("# A draft, learned from the live topics: copy what you need into config.toml.\n");
    for ((pattern, type_name), rows) in groups {
        let pattern = if let [only] = rows[..] { &only.topic } else { &pattern };
        if pattern.parse::<crate::model::TopicPattern>().is_err() {
            continue;
        }
        draft.push('\n');
        rows.iter().for_each(|row| draft.push_str(&observed(row)));
        draft.push_str(&format!("[[topic]]\nmatch = \"{pattern}\"\n"));
        if let Some(name) = type_name.filter(|name| name.parse::<crate::model::TypeName>().is_ok()) {
            draft.push_str(&format!("type = \"{name}\"\n"));
        }
        draft.push_str(&suggestions(&rows));
    }
    draft
}

fn observed(row: &PolicyRow) -> String {
    let (Some(hz), Some(bytes)) = (row.hz, row.bytes_per_second) else {
        return format!("# {}: nothing arrived\n", row.topic);
    };
    let largest = or_dash(row.largest);
    format!("# {}: {hz:.1} messages/s, {:.1} KB/s, largest {largest} bytes\n", row.topic, bytes / 1000.0)
}

fn suggestions(rows: &[&PolicyRow]) -> String {
    let most = |each: fn(&PolicyRow) -> Option<f64>| rows.iter().filter_map(|row| each(row)).fold(0.0, f64::max);
    let (hz, bytes) = (most(|row| row.hz), most(|row| row.bytes_per_second));
    if bytes >= HEAVY && hz > CALM {
        format!("rate = {CALM:.1} # heavy\n")
    } else if hz >= FAST {
        format!("# every = {} # fast: about 10 messages/s would remain\n", (hz / 10.0).round().max(2.0))
    } else {
        String::new()
    }
}

fn without_numbers(topic: &str) -> String {
    let mut pattern = String::with_capacity(topic.len());
    for letter in topic.chars() {
        match letter {
            '0'..='9' if pattern.ends_with('*') => {}
            '0'..='9' => pattern.push('*'),
            other => pattern.push(other),
        }
    }
    pattern
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(topic: &str, hz: f64, bytes: f64) -> PolicyRow {
        PolicyRow {
            topic: topic.into(),
            type_name: Some("sensor_msgs/Imu".into()),
            watched: false,
            sampling: Sampling::default(),
            rule: None,
            left_out: 0,
            hz: Some(hz),
            bytes_per_second: Some(bytes),
            largest: Some(320),
        }
    }

    #[test]
    fn spans_are_told_in_the_largest_unit_that_is_whole() {
        let told = [20, 90, 120, 7_200, 172_800].map(span);
        assert_eq!(told, ["20 s", "90 s", "2 min", "2 h", "2 d"]);
    }

    #[test]
    fn a_draft_is_a_file_that_can_be_used() {
        let hostile = row("/evil\"\n[x]", 1.0, 1.0);
        let text = draft(&[row("/robot1/imu", 100.0, 30_000.0), row("/robot2/imu", 99.0, 30_000.0), hostile]);
        let text = format!("{text}{}", draft(&[row("/scan", 40.0, 900_000.0)]));
        let file = Some((std::path::Path::new("config.toml"), text.as_str()));
        let config = crate::config::Config::resolve(&|_| None, &|_| None, file).expect(&text);
        let rule = config.topic_rules.of("/robot7/imu").expect("a rule");
        assert_eq!((rule.pattern.as_str(), rule.rate), ("/robot*/imu", None));
        assert_eq!(config.topic_rules.of("/scan").expect("a rule").rate, Some(5_000));
        assert_eq!(config.topic_rules.0.len(), 2, "{text}");
    }
}
