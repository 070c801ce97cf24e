//! An incident's bundle of evidence, from its window: where to, what becomes readable, and the question that counts it.

use crate::app::{Confirm, Errand, Field, Form, Line, PathKind, Popup, Purpose, State, Tag, Typed, Wrong, completion};
use crate::model::{IncidentName, TopicPattern, counted, grouped, topic_rule::PatternError};
use crate::service::command::{EvidenceWishes, ExportEvidence};
use crate::service::reply::{EvidenceView, IncidentView, SpanCoverageView};

/// Discloses everything.
const ALL: &str = "all";

/// Typed to disclose.
const WORD: &str = "disclose";

const FILE: usize = 1;
const READABLE: usize = 2;

/// Topics that the question names.
const MOST_NAMED: usize = 8;

pub fn begin(state: &mut State, name: &IncidentName) {
    let lines = vec![
        Line::text("Incident", "name of an incident", Field::with(name.as_str())),
        Line::text("File", "such as crash.authros", Field::offering(&format!("{name}.authros"))).path(PathKind::File),
        Line::text("Readable", "empty = nothing; all, topics or patterns", Field::default()),
    ];
    let notes = vec![
        "One file with its records and everything that proves them, for `authros evidence verify`.".to_owned(),
        "Messages stay sealed unless you name their topics.".to_owned(),
    ];
    let mut form = Form::new("Export an incident as evidence", notes, lines);
    form.focus = FILE;
    state.popups.push(Popup::Form(Purpose::ExportEvidence, form));
}

pub fn complete(state: &State, form: &mut Form) -> bool {
    let names: Vec<String> = state.topics.rows.iter().map(|row| row.topic.clone()).collect();
    form.focus == READABLE && completion::complete_from(form, &names)
}

pub fn read(state: &State, form: &Form) -> Result<Confirm, Wrong> {
    let name: IncidentName = form.parsed(0)?;
    let row = state.incidents.rows.iter().find(|row| row.name == name);
    let row = row.ok_or_else(|| (0, format!("no incident is named {name}; press esc and choose one")))?;
    let file = completion::of_line(form, FILE, &state.settings);
    let file = file.ok_or((FILE, "enter the name of a new file, NAME.authros".to_owned()))?;
    let words: Vec<&str> = form.words(READABLE).collect();
    let reveal_all = words.contains(&ALL);
    let patterns = words.iter().filter(|word| **word != ALL).map(|word| word.parse());
    let reveal_topics: Vec<TopicPattern> =
        patterns.collect::<Result<_, _>>().map_err(|error: PatternError| (READABLE, error.to_string()))?;
    let held = |pattern: &TopicPattern| row.coverage.iter().any(|one| one.records > 0 && pattern.matches(&one.topic));
    if let Some(pattern) = reveal_topics.iter().find(|pattern| !held(pattern)) {
        return Err((READABLE, format!("the incident holds no record of a topic that matches {pattern}")));
    }
    let incident = Some(name);
    let wishes = EvidenceWishes { file, incident, reveal_topics, reveal_all, sure: true, ..EvidenceWishes::default() };
    Ok(question(row, wishes))
}

/// The topics that become readable, the largest first.
fn disclosed<'a>(row: &'a IncidentView, wishes: &EvidenceWishes) -> Vec<&'a SpanCoverageView> {
    let is_named = |one: &&SpanCoverageView| {
        wishes.reveal_all || wishes.reveal_topics.iter().any(|pattern| pattern.matches(&one.topic))
    };
    let mut found: Vec<_> = row.coverage.iter().filter(|one| one.records > 0).filter(is_named).collect();
    found.sort_by_key(|one| std::cmp::Reverse(one.records));
    found
}

fn question(row: &IncidentView, wishes: EvidenceWishes) -> Confirm {
    let topics = disclosed(row, &wishes);
    let mut lines = vec![
        format!("File     {}", wishes.file.display()),
        format!("Records  {} now, with everything that proves them", grouped(row.records)),
    ];
    let count: u64 = topics.iter().map(|one| one.records).sum();
    if topics.is_empty() {
        lines.push("Readable nothing: the messages stay sealed".to_owned());
    } else {
        let of = counted(topics.len() as u64, "topic");
        lines.push(format!("Readable {} of {of}, to everybody who gets the file:", counted(count, "message")));
        lines.extend(
            topics.iter().take(MOST_NAMED).map(|one| format!("         {} of {}", grouped(one.records), one.topic)),
        );
        let more = topics.len().saturating_sub(MOST_NAMED);
        lines.extend((more > 0).then(|| format!("         and {}", counted(more as u64, "more topic"))));
        lines.push("A disclosure cannot be undone.".to_owned());
    }
    let typed = (!topics.is_empty()).then(|| Typed::new(WORD));
    let title = format!("Export incident {} as evidence?", row.name);
    let errand = Errand { tag: Tag::Evidence(row.name.clone()), command: ExportEvidence(wishes).into() };
    Confirm { title, lines, yes: "write the file", typed, errand }
}

pub fn written(state: &mut State, view: &EvidenceView) {
    let (records, notes) = (counted(view.records, "record"), view.notes.len() as u64);
    let told = if notes == 0 { String::new() } else { format!("; {}: log", counted(notes, "note")) };
    state.inform(format!("{records}, {} of them readable, in {}{told}", view.revealed, view.file));
}
