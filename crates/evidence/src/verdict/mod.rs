//! The verdict in sentences, for people: said by the rules of `sentences.json`, which every verifier prints from.

use std::{cmp::Reverse, collections::BTreeMap, sync::LazyLock};

use authros_model::{Address, SignerId, Timestamp, TopicId, clean, grouped};
use serde::Deserialize;
use strum::VariantArray as _;

use crate::report::{Outcome, RecordReport, Report, Standing, Stretch};

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

// What a verdict can speak of: counts, groups and spans of a report, by the names that `sentences.json` explains.

pub(super) type Fields = BTreeMap<&'static str, Fact>;

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Fact {
    Number(u64),
    Text(String),
}

impl Fact {
    pub(super) fn is_there(&self) -> bool {
        match self {
            Self::Number(number) => *number != 0,
            Self::Text(text) => !text.is_empty(),
        }
    }

    pub(super) fn number(&self) -> Option<u64> {
        match self {
            Self::Number(number) => Some(*number),
            Self::Text(_) => None,
        }
    }
}

#[derive(Debug, Default)]
pub(super) struct Facts {
    pub all: Fields,
    pub lists: BTreeMap<&'static str, Vec<Fields>>,
}

/// What the report does not say itself.
#[derive(Debug)]
pub(crate) struct Context {
    pub exporter: Address,
    pub person: Option<String>,
    pub trust_denies: bool,
    pub foreign_instructions: bool,
}

fn flag(is_so: bool) -> Fact {
    Fact::Number(u64::from(is_so))
}

fn count(number: usize) -> Fact {
    Fact::Number(number as u64)
}

/// How many records, the span of their capture times, and the latest time by which an authority's stamp has them.
#[derive(Debug, Default)]
struct Group {
    count: u64,
    span: Option<(Timestamp, Timestamp)>,
    stamped: Timestamp,
}

impl Group {
    fn add(&mut self, record: &RecordReport) {
        self.count += 1;
        self.stamped = record.existed_before.map_or(self.stamped, |before| before.to_whole_second().max(self.stamped));
        if let Some(at) = record.captured_at {
            let (first, last) = self.span.unwrap_or((at, at));
            self.span = Some((first.min(at), last.max(at)));
        }
    }

    fn span(&self) -> Fact {
        Fact::Text(self.span.map(|(first, last)| span(first, last)).unwrap_or_default())
    }
}

/// The largest first, and then by their keys.
fn groups<'a, Key: Ord>(records: impl IntoIterator<Item = (Key, &'a RecordReport)>) -> Vec<(Key, Group)> {
    let mut groups: BTreeMap<Key, Group> = BTreeMap::new();
    records.into_iter().for_each(|(key, record)| groups.entry(key).or_default().add(record));
    let mut groups: Vec<_> = groups.into_iter().collect();
    groups.sort_by_key(|(_, group)| Reverse(group.count));
    groups
}

fn date(time: Timestamp) -> String {
    Timestamp::from_seconds(time.seconds()).to_string().chars().take(10).collect()
}

pub(super) fn span(first: Timestamp, last: Timestamp) -> String {
    if first.seconds() == last.seconds() {
        return first.in_utc();
    }
    let day = if date(first) == date(last) { String::new() } else { format!("{} ", date(last)) };
    format!("{} {} to {day}{} UTC", date(first), first.clock(), last.clock())
}

/// The anchor's time, if a person could read it.
fn anchored_at(record: &RecordReport) -> Option<Timestamp> {
    let is_supported = matches!(record.anchor.standing, Standing::Proven | Standing::OwnChain);
    record.anchored_at.filter(|at| is_supported && i64::try_from(at.0).is_ok())
}

fn is_intact(record: &&RecordReport) -> bool {
    record.bytes.standing == Standing::Proven
}

/// What topics are called: by their own disclosed records, or by a label.
struct Names<'a> {
    wording: &'a Wording,
    known: BTreeMap<(SignerId, TopicId), &'a str>,
}

impl<'a> Names<'a> {
    fn of(wording: &'a Wording, report: &'a Report) -> Self {
        let mut known = BTreeMap::new();
        for record in &report.records {
            let id = record.signer.zip(record.topic_id);
            if let (Some(id), Some(disclosed)) = (id, &record.disclosed) {
                known.entry(id).or_insert(disclosed.topic.as_str());
            }
        }
        Self { wording, known }
    }

    fn label(&self, name: &str, id: &str) -> String {
        let label = self.wording.labels.get(name).map(String::as_str).unwrap_or_default();
        filled(label, &[&Fields::from([("id", Fact::Text(id.to_owned()))])])
    }

    fn topic(&self, signer: SignerId, topic: TopicId) -> String {
        let short: String = topic.to_hex().chars().take(8).collect();
        let known = self.known.get(&(signer, topic)).map(|name| clean(name, self.wording.longest));
        known.unwrap_or_else(|| self.label("sealed", &short))
    }

    fn record(&self, record: &RecordReport) -> String {
        if record.is_statement() {
            return self.label("recorder", "");
        }
        match record.signer.zip(record.topic_id) {
            Some((signer, topic)) => self.topic(signer, topic),
            None => self.label("unreadable", ""),
        }
    }
}

fn facts(wording: &Wording, report: &Report, context: &Context) -> Facts {
    let names = Names::of(wording, report);
    let statements = report.records.iter().filter(|record| record.is_statement()).count();
    let is_readable = |record: &&RecordReport| record.disclosed.is_some() && !record.is_statement();
    let readable = report.records.iter().filter(is_readable).count();
    let intact = report.records.iter().filter(is_intact).count();
    let is_undated = |record: &&RecordReport| record.existed_before.is_none() && anchored_at(record).is_none();
    let late = report.records.iter().any(|record| record.seconds_to_anchor.is_some_and(|seconds| seconds < 0));
    let is_captured = |record: &&RecordReport| is_intact(record) && !record.is_statement();
    let captured = groups(report.records.iter().filter(is_captured).map(|record| ((), record)));
    let captured = captured.first().map_or(Fact::Text(String::new()), |((), group)| group.span());
    let exporter = report.exporter.standing;
    let person = context.person.as_ref().map(|name| clean(name, wording.longest)).unwrap_or_default();
    let whole = Standing::Proven;
    let all = Fields::from([
        ("holds", flag(report.outcome == Outcome::Holds)),
        ("refused", flag(report.outcome == Outcome::Refused)),
        ("trust", flag(report.pinned)),
        ("self_sealed", flag(report.outcome == Outcome::Incomplete && report.is_self_sealed())),
        ("unknown_exporter", flag(report.outcome == Outcome::Incomplete && report.pinned && report.is_proven())),
        ("records", count(report.records.len())),
        ("statements", count(statements)),
        ("intact", count(intact)),
        ("altered", count(report.records.len() - intact)),
        ("exporter", Fact::Text(context.exporter.to_string())),
        ("exporter_person", Fact::Text(person)),
        ("exporter_proven", flag(exporter == whole)),
        ("exporter_self_sealed", flag(exporter == Standing::OwnChain)),
        ("exporter_refused", flag(exporter == Standing::Refused)),
        ("undated", count(report.records.iter().filter(is_undated).count())),
        ("captured", captured),
        ("readable_count", count(readable)),
        ("sealed", count(report.records.len() - readable - statements)),
        ("complete", count(report.complete.iter().filter(|one| is_complete(one)).count())),
        ("gapless", count(report.complete.iter().filter(|one| is_gapless(one)).count())),
        ("unstated", count(report.complete.iter().filter(|one| is_unstated(one)).count())),
        ("rings", count(report.complete.iter().filter(|one| one.recorder.is_ring() && one.first.is_some()).count())),
        ("trust_denies", flag(context.trust_denies)),
        ("late_capture", flag(late)),
        ("foreign_instructions", flag(context.foreign_instructions)),
        ("levels", Fact::Text(levels(wording, report, true))),
        ("worst", Fact::Text(levels(wording, report, false))),
    ]);
    let readable = report.records.iter().filter(is_readable);
    let lists = BTreeMap::from([
        ("signed", signed(wording, report)),
        ("stamped", stamped(wording, report)),
        ("anchored", anchored(report)),
        ("readable", by_topic(&names, readable)),
        ("missing", missing(&names, report)),
        ("later", later(&names, report)),
        ("doubts", doubts(wording, &names, report)),
    ]);
    Facts { all, lists }
}

fn is_counted(stretch: &Stretch) -> bool {
    let is_believed = matches!(stretch.standing, Standing::Proven | Standing::OwnChain);
    is_believed && stretch.first.is_some() && !stretch.own_statements && !stretch.recorder.is_ring()
}

fn has_heads(stretch: &Stretch) -> bool {
    stretch.heads.zip(stretch.first).is_some_and(|(heads, first)| heads.number >= first)
}

fn is_complete(stretch: &Stretch) -> bool {
    is_counted(stretch) && has_heads(stretch) && stretch.missing == 0
}

fn is_gapless(stretch: &Stretch) -> bool {
    is_counted(stretch) && has_heads(stretch) && beyond(stretch) > 0 && between(stretch) == 0
}

/// How many numbers the newest head names above the last one here.
fn beyond(stretch: &Stretch) -> u64 {
    stretch.heads.zip(stretch.last).map_or(0, |(heads, last)| heads.number.saturating_sub(last))
}

/// How many are missing between the first and the last.
fn between(stretch: &Stretch) -> u64 {
    stretch.missing.saturating_sub(beyond(stretch))
}

fn is_unstated(stretch: &Stretch) -> bool {
    is_counted(stretch) && !has_heads(stretch)
}

/// `(a) bytes: proven; (b) signer: 8 self-sealed chain, 3 not proven`, or only the last of each.
fn levels(wording: &Wording, report: &Report, counted: bool) -> String {
    let mut found: BTreeMap<char, Vec<Standing>> = BTreeMap::new();
    for (letter, level) in report.records.iter().flat_map(RecordReport::levels) {
        found.entry(letter).or_default().push(level.standing);
    }
    if !report.complete.is_empty() {
        found.insert('f', report.complete.iter().map(|stretch| stretch.standing).collect());
    }
    let told = |(letter, standings): (&char, &Vec<Standing>)| {
        let number = |standing: Standing| standings.iter().filter(|one| **one == standing).count();
        let counts = Standing::VARIANTS.iter().map(|one| (number(*one), one.word())).filter(|(number, _)| *number > 0);
        let several = counts.clone().count() > 1;
        let words = counts.map(|(number, word)| match several && counted {
            true => format!("{} {word}", grouped(number as u64)),
            false => word.to_owned(),
        });
        let words: Vec<String> = words.collect();
        let said = if counted { words.join(", ") } else { words.last().cloned().unwrap_or_default() };
        let name = wording.levels.get(letter).map(String::as_str).unwrap_or_default();
        format!("({letter}) {name}: {said}")
    };
    found.iter().map(told).collect::<Vec<_>>().join("; ")
}

fn signed(wording: &Wording, report: &Report) -> Vec<Fields> {
    let keyed = report.records.iter().filter(is_intact).filter_map(|record| {
        let class = match record.key.standing {
            Standing::Proven => 0,
            Standing::OwnChain => 1,
            Standing::Unproven | Standing::Absent | Standing::Refused => 2,
        };
        let person = record.person.as_ref().map(|name| clean(name, wording.longest)).unwrap_or_default();
        Some(((record.owner?, class, person), record))
    });
    let item = |((owner, class, person), group): ((Address, u8, String), Group)| {
        Fields::from([
            ("account", Fact::Text(owner.to_string())),
            ("person", Fact::Text(person)),
            ("proven", flag(class == 0)),
            ("self_sealed", flag(class == 1)),
            ("count", Fact::Number(group.count)),
        ])
    };
    groups(keyed).into_iter().map(item).collect()
}

fn stamped(wording: &Wording, report: &Report) -> Vec<Fields> {
    let name = |record: &RecordReport| Some(clean(record.authority.as_ref()?, wording.longest));
    let keyed = report.records.iter().filter_map(|record| Some((name(record)?, record)));
    let item = |(authority, group): (String, Group)| {
        let time = Fact::Text(group.stamped.in_utc());
        Fields::from([("authority", Fact::Text(authority)), ("time", time), ("count", Fact::Number(group.count))])
    };
    groups(keyed).into_iter().map(item).collect()
}

fn anchored(report: &Report) -> Vec<Fields> {
    let of = |standing: Standing| {
        let records = report.records.iter().filter(|record| record.anchor.standing == standing);
        let times: Vec<Timestamp> = records.filter_map(anchored_at).collect();
        let latest = times.iter().max()?;
        Some(Fields::from([
            ("proven", flag(standing == Standing::Proven)),
            ("self_sealed", flag(standing == Standing::OwnChain)),
            ("time", Fact::Text(latest.in_utc())),
            ("count", count(times.len())),
        ]))
    };
    [Standing::Proven, Standing::OwnChain].into_iter().filter_map(of).collect()
}

fn by_topic<'a>(names: &Names<'_>, records: impl Iterator<Item = &'a RecordReport>) -> Vec<Fields> {
    let name = |record: &RecordReport| Some(clean(&record.disclosed.as_ref()?.topic, names.wording.longest));
    let keyed = records.filter_map(|record| Some((name(record)?, record)));
    let item = |(topic, group): (String, Group)| {
        Fields::from([("topic", Fact::Text(topic)), ("span", group.span()), ("count", Fact::Number(group.count))])
    };
    groups(keyed).into_iter().map(item).collect()
}

/// The topics with such a number of numbers, the largest first: topic, that number, its first number here, and the end.
fn numbered(
    names: &Names<'_>,
    report: &Report,
    number: fn(&Stretch) -> u64,
    end: fn(&Stretch) -> Option<u64>,
) -> Vec<Fields> {
    let mut found: Vec<_> = report
        .complete
        .iter()
        .filter(|stretch| number(stretch) > 0)
        .filter_map(|stretch| {
            let topic = names.topic(stretch.signer, stretch.topic_id);
            Some((Reverse(number(stretch)), topic, stretch.first?, end(stretch)?))
        })
        .collect();
    found.sort();
    let item = |(Reverse(count), topic, from, to): (Reverse<u64>, String, u64, u64)| {
        Fields::from([
            ("topic", Fact::Text(topic)),
            ("from", Fact::Number(from)),
            ("to", Fact::Number(to)),
            ("count", Fact::Number(count)),
        ])
    };
    found.into_iter().map(item).collect()
}

fn missing(names: &Names<'_>, report: &Report) -> Vec<Fields> {
    numbered(names, report, between, |stretch| stretch.last)
}

fn later(names: &Names<'_>, report: &Report) -> Vec<Fields> {
    numbered(names, report, beyond, |stretch| stretch.heads.map(|heads| heads.number))
}

/// Level, whether it is refused, topic, and the name of the reason.
type Doubt = (bool, char, String, &'static str);

fn doubts(wording: &Wording, names: &Names<'_>, report: &Report) -> Vec<Fields> {
    let of_records = report.records.iter().flat_map(|record| {
        // What follows from altered bytes is not said again.
        let most = if is_intact(&record) { usize::MAX } else { 1 };
        record.levels().into_iter().take(most).filter_map(move |(letter, level)| {
            let accepted = level.standing != Standing::Refused;
            Some(((accepted, letter, names.record(record), level.reason?.name()), record))
        })
    });
    let mut lanes = BTreeMap::<_, Vec<&RecordReport>>::new();
    for record in report.records.iter().filter(is_intact) {
        lanes.entry((record.owner, record.signer, record.recorder, record.topic_id)).or_default().push(record);
    }
    let of_numbers = report.complete.iter().filter_map(|stretch| Some((stretch, stretch.reason?.name())));
    let of_numbers = of_numbers.flat_map(|(stretch, reason)| {
        let lane = (Some(stretch.owner), Some(stretch.signer), Some(stretch.recorder), Some(stretch.topic_id));
        let topic = names.topic(stretch.signer, stretch.topic_id);
        let records = lanes.get(&lane).into_iter().flatten();
        records.map(move |record| ((false, 'f', topic.clone(), reason), *record))
    });
    let mut groups: Vec<(Doubt, Group)> = groups(of_records.chain(of_numbers));
    groups.sort_by_key(|((accepted, letter, ..), _)| (*accepted, *letter));
    let item = |((accepted, _, topic, reason), group): (Doubt, Group)| {
        let why = wording.reasons.get(reason).cloned().unwrap_or_default();
        Fields::from([
            ("topic", Fact::Text(topic)),
            ("span", group.span()),
            ("why", Fact::Text(why)),
            ("refused", flag(!accepted)),
            ("count", Fact::Number(group.count)),
        ])
    };
    groups.into_iter().map(item).collect()
}

#[cfg(test)]
mod tests;
