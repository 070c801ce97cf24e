//! Incidents: spans of time and topics of own records, exempt from retention while the incidents exist.

#[cfg(test)]
mod tests;

use tokio::task::block_in_place;

use crate::command::{self as ask, Ask, IncidentCommand};
use crate::model::{
    Address, IncidentName, ProfileName, Timestamp, TopicPattern, TopicPatterns, clean, clean_lines, counted,
};
use crate::reply::{Failure, IncidentView, Part, Reply, Result, input};
use crate::site::Parts;
use crate::store::{IncidentNote, IncidentRow, IncidentSpan, Incidents as KeptIncidents, RecordQuery, SpanCoverage};

const MOST: usize = 200;
const MOST_TOPICS: usize = 256;
const MOST_NOTES: usize = 200;
/// Characters.
const LONGEST_NOTE: usize = 2000;
const WIDEST: usize = 255;

pub(in crate::site) struct Incidents {
    pub parts: Parts,
}

struct Wanted {
    name: IncidentName,
    span: IncidentSpan,
    note: Option<String>,
}

impl Incidents {
    pub async fn answer(&self, profile: &ProfileName, command: IncidentCommand) -> Result<Reply> {
        let owner = self.parts.owners.address_of(profile)?;
        match command {
            IncidentCommand::OpenIncident { name, since, until, topics, note, robots: _ } => {
                let wanted = wanted(name, (since, until), topics, note.as_deref())?;
                self.open(profile, owner, wanted).await.map(ask::OpenIncident::told)
            }
            IncidentCommand::ListIncidents => self.list(owner).map(ask::ListIncidents::told),
            IncidentCommand::ShowIncident { name } => self.show(owner, &name).map(ask::ShowIncident::told),
            IncidentCommand::NoteIncident { name, text } => {
                self.note(profile, owner, &name, &text).await.map(ask::NoteIncident::told)
            }
            IncidentCommand::CloseIncident { name } => {
                self.close(profile, owner, &name).await.map(ask::CloseIncident::told)
            }
            IncidentCommand::RemoveIncident { name } => {
                self.remove(profile, owner, &name).await.map(ask::RemoveIncident::told)
            }
        }
    }

    async fn open(&self, profile: &ProfileName, owner: Address, wanted: Wanted) -> Result<IncidentView> {
        let Wanted { name, span, note } = wanted;
        let known = block_in_place(|| self.kept().list(owner))?;
        if known.iter().any(|row| row.name == name) {
            return Err(taken(&name));
        }
        if known.len() >= MOST {
            return Err(input(format!(
                "there are {MOST} incidents, the limit per profile; remove one with `authros incident remove NAME`"
            )));
        }
        let opened = async {
            let opened = block_in_place(|| self.kept().open(owner, &name, &span, note.as_deref()))?;
            if opened { Ok(()) } else { Err(taken(&name)) }
        };
        self.parts.log.deed(profile, "open incident", &subject(&name, &span), opened).await?;
        self.parts.hub.changed(Part::Uploads);
        self.show(owner, &name)
    }

    fn kept(&self) -> &KeptIncidents {
        &self.parts.plant.ledger.incidents
    }

    fn list(&self, owner: Address) -> Result<Vec<IncidentView>> {
        let covered = |row| covered(self.kept(), owner, row);
        block_in_place(|| self.kept().list(owner)?.into_iter().map(covered).collect())
    }

    fn show(&self, owner: Address, name: &IncidentName) -> Result<IncidentView> {
        block_in_place(|| view(self.kept(), owner, name))
    }

    async fn note(&self, by: &ProfileName, owner: Address, name: &IncidentName, text: &str) -> Result<IncidentView> {
        let text = note_text(text)?;
        if self.show(owner, name)?.notes.len() >= MOST_NOTES {
            return Err(input(format!("{name} has {MOST_NOTES} notes, the limit per incident")));
        }
        let noted = async { found(name, block_in_place(|| self.kept().note(owner, name, &text))?) };
        self.parts.log.deed(by, "note incident", name.as_str(), noted).await?;
        self.show(owner, name)
    }

    async fn close(&self, profile: &ProfileName, owner: Address, name: &IncidentName) -> Result<IncidentView> {
        if !self.show(owner, name)?.open {
            return Err(input(format!("{name} is already closed; its records are held until it is removed")));
        }
        let closed = async { found(name, block_in_place(|| self.kept().close(owner, name))?) };
        self.parts.log.deed(profile, "close incident", name.as_str(), closed).await?;
        self.parts.hub.changed(Part::Uploads);
        self.show(owner, name)
    }

    async fn remove(&self, profile: &ProfileName, owner: Address, name: &IncidentName) -> Result<Vec<IncidentView>> {
        let told = format!("{name}: held {}", counted(self.show(owner, name)?.records, "record"));
        let removed = async { found(name, block_in_place(|| self.kept().remove(owner, name))?) };
        self.parts.log.deed(profile, "remove incident", &told, removed).await?;
        self.parts.hub.changed(Part::Uploads);
        self.list(owner)
    }
}

/// Checks bounds and cleans foreign text before anything is written.
fn wanted(
    name: IncidentName,
    (since, until): (Timestamp, Option<Timestamp>),
    topics: Vec<TopicPattern>,
    note: Option<&str>,
) -> Result<Wanted> {
    if since > Timestamp::now() {
        return Err(input(format!(
            "{name} would begin at {since}, which is in the future; watched topics are captured anyway, so open the \
             incident then"
        )));
    }
    if until.is_some_and(|until| until <= since) {
        return Err(input(format!("{name} would end before it begins; --until must be later than --since")));
    }
    if topics.len() > MOST_TOPICS {
        return Err(input(format!("an incident can name at most {MOST_TOPICS} topics; name none to cover all")));
    }
    let span = IncidentSpan { since, until, topics: TopicPatterns(topics) };
    Ok(Wanted { name, span, note: note.map(note_text).transpose()? })
}

fn note_text(text: &str) -> Result<String> {
    let length = text.chars().count();
    if length > LONGEST_NOTE {
        return Err(input(format!("the note has {length} characters, the limit is {LONGEST_NOTE}; shorten it")));
    }
    let text = clean_lines(text, LONGEST_NOTE);
    if text.trim().is_empty() { Err(input("the note is empty")) } else { Ok(text) }
}

fn taken(name: &IncidentName) -> Failure {
    input(format!("an incident {name} already exists; `authros incident show {name}` shows it"))
}

fn unknown(name: &IncidentName) -> Failure {
    input(format!("there is no incident {name}; `authros incident list` shows all"))
}

fn found(name: &IncidentName, done: bool) -> Result<()> {
    if done { Ok(()) } else { Err(unknown(name)) }
}

fn known(kept: &KeptIncidents, owner: Address, name: &IncidentName) -> Result<IncidentRow> {
    kept.find(owner, name)?.ok_or_else(|| unknown(name))
}

fn subject(name: &IncidentName, span: &IncidentSpan) -> String {
    let until = span.until.map_or_else(|| "until it is closed".to_owned(), |until| format!("until {until}"));
    let topics = if span.topics.0.is_empty() { "all topics".to_owned() } else { span.topics.to_string() };
    clean(&format!("{name}: since {} {until}, {topics}", span.since), 400)
}

/// Narrows a query to an incident of the owner; `Input` if there is none of this name.
pub(super) fn narrowed(
    kept: &KeptIncidents,
    owner: Address,
    name: &IncidentName,
    query: RecordQuery,
) -> Result<RecordQuery> {
    let IncidentSpan { since, until, topics: about } = known(kept, owner, name)?.span;
    let until = [query.until, until].into_iter().flatten().min();
    let mut topics = query.topics;
    topics.extend(Some(about).filter(|about| !about.0.is_empty()));
    Ok(RecordQuery { since: query.since.max(Some(since)), until, topics, ..query })
}

pub(super) fn view(kept: &KeptIncidents, owner: Address, name: &IncidentName) -> Result<IncidentView> {
    covered(kept, owner, known(kept, owner, name)?)
}

fn covered(kept: &KeptIncidents, owner: Address, row: IncidentRow) -> Result<IncidentView> {
    let clean_topic = |one: SpanCoverage| SpanCoverage { topic: clean(&one.topic, WIDEST), ..one };
    let coverage: Vec<SpanCoverage> = kept.span_coverage(owner, &row.span)?.into_iter().map(clean_topic).collect();
    let note = |note: IncidentNote| IncidentNote { text: clean_lines(&note.text, LONGEST_NOTE), ..note };
    Ok(IncidentView {
        name: row.name,
        open: row.closed_at.is_none(),
        since: row.span.since,
        until: row.span.until,
        opened_at: row.opened_at,
        closed_at: row.closed_at,
        topics: row.span.topics.0.iter().map(ToString::to_string).collect(),
        notes: row.notes.into_iter().map(note).collect(),
        records: coverage.iter().map(|one| one.records).sum(),
        bytes: coverage.iter().map(|one| one.bytes).sum(),
        coverage,
    })
}
