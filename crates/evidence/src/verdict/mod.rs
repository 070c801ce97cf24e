//! The verdict in sentences, for people: said by the rules of `sentences.json`, which every verifier prints from.

mod facts;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::LazyLock;

use authros_model::grouped;
use serde::Deserialize;

pub(crate) use self::facts::Context;
use self::facts::{Fact, Facts, Fields, facts};
use crate::report::Report;

/// What begins the further lines of a sentence.
const INDENT: &str = "  ";

#[derive(Debug, Default, Deserialize)]
struct Wording {
    width: usize,
    lines: usize,
    most: usize,
    longest: usize,
    labels: BTreeMap<String, String>,
    levels: BTreeMap<char, String>,
    reasons: BTreeMap<String, String>,
    sentences: Vec<Sentence>,
}

#[derive(Debug, Deserialize)]
struct Sentence {
    #[serde(default)]
    each: Option<String>,
    /// Conditions and texts: the first whose condition holds is said.
    say: Vec<(String, String)>,
    #[serde(default)]
    more: String,
    #[serde(default)]
    spare: bool,
    /// What it says if the verdict is still too long without what can be spared.
    #[serde(default)]
    short: Option<String>,
}

/// Empty only if the list cannot be read, which a test rules out.
static WORDING: LazyLock<Wording> =
    LazyLock::new(|| serde_json::from_str(include_str!("sentences.json")).unwrap_or_default());

/// The sentences about a report, the outcome first.
pub(crate) fn verdict(report: &Report, context: &Context) -> Vec<String> {
    sentences(&WORDING, &facts(&WORDING, report, context))
}

/// Shortens lists, then leaves out what can be spared, and at last shortens sentences, until the verdict fits its lines.
fn sentences(wording: &Wording, facts: &Facts) -> Vec<String> {
    let told = |most: usize| -> Vec<(&Sentence, String)> {
        let all = wording.sentences.iter();
        all.flat_map(|one| said(one, facts, most).into_iter().map(move |text| (one, text))).collect()
    };
    let is_long = |told: &[(&Sentence, String)]| {
        told.iter().map(|(_, text)| wrapped(text, wording.width).len()).sum::<usize>() > wording.lines
    };
    let mut most = wording.most;
    let mut all = told(most);
    while most > 0 && is_long(&all) {
        most -= 1;
        all = told(most);
    }
    while is_long(&all) {
        let Some(place) = all.iter().rposition(|(one, _)| one.spare) else { break };
        all.remove(place);
    }
    if is_long(&all) {
        let short = all.iter_mut().filter_map(|(one, text)| Some((one.short.as_ref()?, text)));
        short.for_each(|(short, text)| *text = filled(short, &[&facts.all]));
    }
    all.into_iter().map(|(_, text)| text).collect()
}

fn said(sentence: &Sentence, facts: &Facts, most: usize) -> Vec<String> {
    let first = |fields: &[&Fields]| {
        let (_, text) = sentence.say.iter().find(|(condition, _)| holds(condition, fields))?;
        (!text.is_empty()).then(|| filled(text, fields))
    };
    let Some(list) = &sentence.each else { return first(&[&facts.all]).into_iter().collect() };
    let items = facts.lists.get(list.as_str()).map(Vec::as_slice).unwrap_or_default();
    let (shown, left) = items.split_at(items.len().min(most));
    let mut texts: Vec<String> = shown.iter().filter_map(|item| first(&[item, &facts.all])).collect();
    if !left.is_empty() {
        let counts = left.iter().filter_map(|item| item.get("count")?.number());
        let count = counts.fold(0, u64::saturating_add);
        let rest = Fields::from([("groups", Fact::Number(left.len() as u64)), ("count", Fact::Number(count))]);
        texts.push(filled(&sentence.more, &[&rest, &facts.all]));
    }
    texts
}

fn look_up<'a>(fields: &[&'a Fields], name: &str) -> Option<&'a Fact> {
    fields.iter().find_map(|some| some.get(name))
}

fn holds(condition: &str, fields: &[&Fields]) -> bool {
    let is_there = |name: &str| look_up(fields, name).is_some_and(Fact::is_there);
    condition
        .split_whitespace()
        .all(|word| word.strip_prefix('!').map_or_else(|| is_there(word), |name| !is_there(name)))
}

fn filled(text: &str, fields: &[&Fields]) -> String {
    let mut out = String::new();
    for (place, part) in text.split(['{', '}']).enumerate() {
        if place % 2 == 0 {
            out.push_str(part);
            continue;
        }
        let mut words = part.split('|');
        let fact = words.next().and_then(|name| look_up(fields, name));
        match (fact, words.next(), words.next()) {
            (Some(Fact::Number(number)), Some(one), Some(many)) => {
                let word = if *number == 1 { one } else { many };
                out.push_str(&format!("{} {word}", grouped(*number)));
            }
            (Some(Fact::Number(number)), ..) => out.push_str(&grouped(*number)),
            (Some(Fact::Text(text)), ..) => out.push_str(text),
            (None, ..) => {}
        }
    }
    out
}

impl Report {
    /// The verdict in lines of 80 characters.
    pub fn lines(&self) -> Vec<String> {
        self.verdict.iter().flat_map(|sentence| wrapped(sentence, WORDING.width)).collect()
    }
}

fn wrapped(sentence: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in sentence.split(' ') {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            Some(_) => lines.push([INDENT, word].concat()),
            None => lines.push(word.to_owned()),
        }
    }
    lines
}
