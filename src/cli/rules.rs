//! `topics rules`: the rule of each topic.

use authros_output::table;

use super::show::or_dash;
use crate::model::{Sampling, TopicRule};
use crate::service::reply::{PolicyRow, PolicyView};

pub fn text(view: &PolicyView) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_are_told_in_the_largest_unit_that_is_whole() {
        let told = [20, 90, 120, 7_200, 172_800].map(span);
        assert_eq!(told, ["20 s", "90 s", "2 min", "2 h", "2 d"]);
    }
}
