//! How many messages of watched topics are kept: the form, and what it sends.

use crate::app::{Errand, Field, Form, Line, Need, Popup, Purpose, State, Tag, Wrong, identity_path};
use crate::model::{Sampling, counted, topic_rule::SamplingError};
use crate::service::{Command, reply::TopicRow};

const RATE: usize = 0;
const EVERY: usize = 1;

pub fn begin(state: &mut State) {
    let form = match state.topics.watched_targets().as_slice() {
        [] => return,
        [one] => form(&format!("Limit {}", one.topic), one),
        [first, more @ ..] => form(&format!("Limit {}", counted(more.len() as u64 + 1, "topic")), first),
    };
    state.popups.push(Popup::Form(Purpose::Limit, form));
}

/// Filled in as it is for this topic.
fn form(title: &str, row: &TopicRow) -> Form {
    let rate = row.sampling.rate_text().unwrap_or_default();
    let every = row.sampling.every.map(|every| every.to_string()).unwrap_or_default();
    let lines = vec![
        Line::text("Rate", "5; 0.5; empty = no limit", Field::offering(&rate)),
        Line::text("Every", "10; empty = every message", Field::offering(&every)),
    ];
    let mut notes = vec![
        "Rate: messages a second at most. Every: 10 keeps one message in ten.".to_owned(),
        "Both empty: as the settings say. Messages left out are counted as such, not as lost.".to_owned(),
    ];
    notes.extend(row.watched_by.iter().map(|pattern| {
        format!("It is watched by {pattern}, whose rule stays for the other topics and for later ones.")
    }));
    Form::new(title, notes, lines)
}

pub fn submit(state: &mut State, form: &Form) -> Result<(), Wrong> {
    let line = |error: &SamplingError| match error {
        SamplingError::Rate(_) => RATE,
        SamplingError::Every(_) => EVERY,
    };
    let sampling =
        Sampling::read(form.typed(RATE), form.typed(EVERY)).map_err(|error| (line(&error), error.to_string()))?;
    let errand = |row: &TopicRow| {
        let (topic, type_name) = (row.topic.parse().ok()?, row.watched_type.clone());
        let command = Command::WatchTopic { topic, type_name, sampling };
        Some(Errand { command, tag: Tag::Limit(row.topic.clone()) })
    };
    let errands: Vec<Errand> = state.topics.watched_targets().into_iter().filter_map(errand).collect();
    identity_path::run(state, Need::Registered, errands);
    Ok(())
}
