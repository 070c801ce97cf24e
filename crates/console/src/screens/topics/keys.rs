//! Acts on topics: watching, and decisions about publishers.

use crate::app::{
    Confirm, Errand, Field, Form, Line, Lookup, Need, Popup, Purpose, Screen, State, Tag, Typed, Wrong, identity_path,
    verb::watch_errand,
};
use crate::model::{TopicName, TopicPattern, counted};
use crate::screens::pane;
use crate::service::{Command, command::Held, reply::TopicRow};

pub fn watch(state: &mut State) {
    if state.screen == Screen::Overview {
        state.go(Screen::Topics);
        return state.inform("select a topic (arrows, or space to mark several), then press w");
    }
    let targets: Vec<(String, bool)> =
        state.topics.targets().into_iter().map(|row| (row.topic.clone(), row.watched)).collect();
    let watches = targets.iter().any(|(_, watched)| !watched);
    let mut errands = Vec::new();
    for (topic, _) in targets.into_iter().filter(|(_, watched)| *watched != watches) {
        match topic.parse::<TopicName>() {
            Ok(topic) => errands.push(watch_errand(topic.into(), watches)),
            Err(error) => state.complain(error.to_string()),
        }
    }
    send_watches(state, watches, errands);
}

fn send_watches(state: &mut State, watches: bool, errands: Vec<Errand>) {
    if watches {
        return identity_path::run(state, Need::Registered, errands);
    }
    errands.into_iter().for_each(|errand| state.send(errand));
}

/// `watch /robot*/camera/**` of the palette: also what appears later.
pub fn spoken_watch(state: &mut State, topics: &[&str], watches: bool) {
    let read: Result<Vec<TopicPattern>, _> = topics.iter().map(|topic| topic.parse()).collect();
    match read {
        Ok(topics) => {
            let errands = topics.into_iter().map(|topic| watch_errand(topic, watches)).collect();
            send_watches(state, watches, errands);
        }
        Err(error) => state.complain(error.to_string()),
    }
}

fn selected_topic(state: &mut State) -> Option<(TopicRow, TopicName)> {
    let row = state.topics.selected()?.clone();
    match row.topic.parse() {
        Ok(topic) => Some((row, topic)),
        Err(error) => {
            state.complain(format!("{error}"));
            None
        }
    }
}

pub fn publishers(state: &mut State) {
    let Some((_, topic)) = selected_topic(state) else { return };
    let name = topic.to_string();
    state.popups.push(Popup::Publishers(Lookup::new(&name)));
    let coverage = pane::follow::coverage_of(&topic);
    state.send(Errand { command: Command::ListPins { topic: Some(topic.into()) }, tag: Tag::Publishers(name) });
    state.send_new(coverage);
}

pub fn ask_about(state: &mut State, question: fn(&TopicRow, TopicName) -> Confirm) {
    let Some((row, topic)) = selected_topic(state) else { return };
    state.popups.push(Popup::Confirm(question(&row, topic)));
}

pub fn unpin(state: &mut State) {
    let Some((row, topic)) = selected_topic(state) else { return };
    let publisher = row.unpinned.first().or(row.publishers.first()).cloned().unwrap_or_default();
    state.popups.push(Popup::Form(Purpose::Unpin, unpin_form(topic.as_str(), &publisher)));
}

pub fn readers(state: &mut State) {
    let topics = match state.screen {
        Screen::Topics => state.topics.targets().into_iter().map(|row| row.topic.clone()).collect(),
        Screen::Records => {
            let key = state.row_key();
            let rows = state.records.rows.iter();
            rows.filter(|row| Some(&row.id) == key.as_ref()).map(|row| row.topic.clone()).collect()
        }
        Screen::Grants => state.grants.selected().map(|row| row.topics.clone()).unwrap_or_default(),
        Screen::Overview | Screen::Received | Screen::Keys | Screen::Chain | Screen::Robots | Screen::Log => Vec::new(),
    };
    state.popups.push(Popup::Readers(topics));
}

pub fn pin(row: &TopicRow, topic: TopicName) -> Confirm {
    let publishers = if row.publishers.is_empty() { "nobody".to_owned() } else { row.publishers.join(" ") };
    let lines = vec![
        format!("Topic       {topic}"),
        format!("Publishers  {publishers}"),
        "Accepted are those who publish when you confirm; messages of others are quarantined.".to_owned(),
        "Check host and type first: enter shows them (a name alone can be forged).".to_owned(),
    ];
    let tag = Tag::Pin(topic.to_string());
    let errand = Errand { command: Command::PinTopic { topic: topic.into(), publishers: Vec::new() }, tag };
    Confirm { title: "Accept these publishers?".to_owned(), lines, yes: "pin", typed: None, errand }
}

pub fn decide(row: &TopicRow, topic: TopicName, discard: bool) -> Confirm {
    let held = Held { topic: Some(topic.clone().into()), ids: Vec::new() };
    let held_now = format!("Held   {}, and what comes until you confirm", counted(row.quarantined, "message"));
    let mut lines = vec![format!("Topic  {topic}"), held_now];
    let name = topic.to_string();
    if discard {
        lines.push("Their ciphertext is deleted. Quarantine records on the chain count them, so that".to_owned());
        lines.push("nobody can cherry-pick evidence; the messages themselves cannot be restored.".to_owned());
        let errand = Errand { command: Command::DiscardHeld { held }, tag: Tag::Discard(name.clone()) };
        let typed = Some(Typed::new(&name));
        return Confirm { title: "Discard quarantined messages?".to_owned(), lines, yes: "discard", typed, errand };
    }
    lines.push("They are anchored like others and keep a tag saying that they were quarantined.".to_owned());
    let errand = Errand { command: Command::ReleaseHeld { held }, tag: Tag::Release(name) };
    Confirm { title: "Release quarantined messages?".to_owned(), lines, yes: "release", typed: None, errand }
}

pub fn unpin_form(topic: &str, publisher: &str) -> Form {
    let lines = vec![
        Line::text("Topic", "such as /robot1/odom, /robot*/odom", Field::with(topic)),
        Line::text("Node", "caller id, such as /driver", Field::with(publisher)),
    ];
    Form::new("Unpin a publisher", vec!["Its messages are quarantined from then on.".to_owned()], lines)
}

pub fn read_unpin(form: &Form) -> Result<Errand, Wrong> {
    let topic: TopicPattern = form.parsed(0)?;
    let missing = || (1, "enter the node's name; enter on the topic lists pinned publishers".to_owned());
    let caller_id = form.typed(1).ok_or_else(missing)?.to_owned();
    let tag = Tag::Unpin(topic.to_string());
    Ok(Errand { command: Command::UnpinTopic { topic, caller_id }, tag })
}
