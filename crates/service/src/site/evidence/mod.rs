//! Bundles of evidence: own records with all their proofs.

mod page;
mod time;

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use authros_evidence::{Bundle, ClaimedChain, Packing, PackingError, Trust, pack, verify};
use tokio::task::block_in_place;

pub use self::page::definition_of;
pub(in crate::site) use self::time::TimeStamps;

use crate::command::{EvidenceWishes, UploadQuery};
use crate::crypto::private_file;
use crate::model::{Digest, RecordKind, RecordState, Timestamp, TopicPattern, TopicPatterns, clean, counted, locked};
use crate::pipeline::chain_proofs::{Collected, Rounds, collect};
use crate::pipeline::evidence::{MOST_RECORDS, gather};
use crate::pipeline::{Network, Owner, PipelineError, Reader};
use crate::reply::{DisclosedTopic, EvidenceView, HealthLevel, IncidentView, NoticeLevel, PartHealth, Result, input};
use crate::site::{Parts, Reading, incidents};
use crate::store::{RecordQuery, RecordRow};

const PAGE: usize = 1000;

pub(in crate::site) struct Evidence {
    parts: Parts,
    reading: Arc<Reading>,
    stamps: Arc<TimeStamps>,
}

impl Evidence {
    pub fn new(parts: &Parts, reading: &Arc<Reading>, stamps: &Arc<TimeStamps>) -> Self {
        Self { parts: parts.clone(), reading: Arc::clone(reading), stamps: Arc::clone(stamps) }
    }

    pub async fn export(&self, owner: &Owner, wishes: EvidenceWishes) -> Result<EvidenceView> {
        if wishes.file.symlink_metadata().is_ok() {
            return Err(input(format!("{} already exists; choose a new file", wishes.file.display())));
        }
        let network = self.reading.network_or_kept().await?;
        let (kept, wanted) = (&self.parts.plant.ledger.incidents, wishes.incident.as_ref());
        let about = wanted.map(|name| block_in_place(|| incidents::view(kept, owner.address, name))).transpose()?;
        // Robots' records arrive without topic names.
        self.reading.learn_own_names(&owner.profile).await?;
        let mut rows = self.chosen(owner, &wishes)?;
        let left_out = about.as_ref().map_or_else(Vec::new, |about| leave_out(&mut rows, about, &wishes.records));
        let named = wishes.reveal.iter().map(|id| self.reading.own_record(&owner.profile, id));
        let named = named.collect::<Result<Vec<RecordRow>>>()?;
        for row in &named {
            if !rows.iter().any(|known| known.digest == row.digest) {
                rows.push(row.clone());
            }
        }
        if rows.is_empty() {
            let none = "that selection contains none of your records; `authros records list` shows them".to_owned();
            return Err(input([vec![none], left_out].concat().join("; ")));
        }
        let of_topics = of_topics(&rows, &wishes)?;
        let reveal: BTreeSet<Digest> =
            named.iter().map(|row| row.digest).chain(of_topics.values().flatten().map(|row| row.digest)).collect();
        if !wishes.sure {
            let (records, revealed) = (rows.len() as u64, reveal.len() as u64);
            let file = wishes.file.display().to_string();
            let topics = disclosed_topics(&rows, &reveal);
            return Ok(EvidenceView { file, bytes: 0, records, revealed, topics, written: false, notes: left_out });
        }
        let file = clean(&wishes.file.display().to_string(), 300);
        let named = named.iter().map(|row| ("disclose record", row.id.clone()));
        let in_bulk = of_topics.iter().map(|(topic, rows)| ("disclose topic", self.bulk(topic, rows)));
        // A disclosure cannot be undone: logged before anything leaves.
        let deeds: Vec<(&str, String)> = named.chain(in_bulk).chain([("export evidence", file)]).collect();
        let written = Box::pin(self.write_evidence(owner, &network, (&rows, &reveal), about.as_ref(), &wishes.file));
        let mut view = self.parts.log.deeds(&owner.profile, &deeds, written).await?;
        view.notes.extend(left_out);
        Ok(view)
    }

    /// The audit log's words for records that are disclosed together; their digests can be compared with the file's.
    fn bulk(&self, topic: &str, rows: &[&RecordRow]) -> String {
        let digests: BTreeSet<Digest> = rows.iter().map(|row| row.digest).collect();
        let listed: Vec<&[u8]> = digests.iter().map(|digest| digest.0.as_slice()).collect();
        let times = || rows.iter().map(|row| row.captured_at);
        let (first, last) = (times().min().unwrap_or_default(), times().max().unwrap_or_default());
        let list = Digest(self.parts.plant.provider.sm3(&listed));
        let records = counted(rows.len() as u64, "record");
        format!("{}: {records} from {first} to {last}, SM3 of their digests {list}", clean(topic, 200))
    }

    fn chosen(&self, owner: &Owner, wishes: &EvidenceWishes) -> Result<Vec<RecordRow>> {
        let named = wishes.records.iter().map(|id| self.reading.own_record(&owner.profile, id));
        let mut rows = named.collect::<Result<Vec<_>>>()?;
        let in_time = wishes.since.is_some() || wishes.until.is_some() || wishes.incident.is_some();
        let narrowed = in_time || !wishes.topics.is_empty() || wishes.robot.is_some();
        let in_bulk = wishes.reveal_all || !wishes.reveal_topics.is_empty();
        let named = !wishes.records.is_empty() || (!wishes.reveal.is_empty() && !in_bulk);
        if named && !narrowed {
            return Ok(rows);
        }
        let ledger = &self.parts.plant.ledger;
        let of_robot = UploadQuery { robot: wishes.robot.clone(), limit: PAGE, ..UploadQuery::default() };
        let (owner_of, since, until) = (Some(owner.address), wishes.since, wishes.until);
        let query = self.reading.of_robot(&[owner.address], of_robot)?;
        let mut query = RecordQuery { owner: owner_of, kind: None, since, until, ..query };
        let topics = Some(TopicPatterns(wishes.topics.clone())).filter(|topics| !topics.0.is_empty());
        query.topics.extend(topics);
        block_in_place(|| {
            if let Some(name) = &wishes.incident {
                query = incidents::narrowed(&ledger.incidents, owner.address, name, query)?;
            }
            let is_away = |row: &RecordRow| {
                matches!(row.state, RecordState::Captured | RecordState::Quarantined | RecordState::Dropped)
            };
            // The notes of an incident name what is not stored yet.
            let is_awaited = |row: &RecordRow| wishes.incident.is_some() && is_early(row);
            for row in ledger.records.all(query) {
                rows.extend(Some(row?).filter(|row| !is_away(row) || is_awaited(row)));
                if rows.len() > MOST_RECORDS {
                    return Err(input(format!(
                        "that is more than {MOST_RECORDS} records; narrow it with --topic, --since and --until"
                    )));
                }
            }
            Ok(rows)
        })
    }

    /// Signed once to make the page from it, and again with the page.
    fn packed(
        &self,
        owner: &Owner,
        packing: Packing,
        claimed: &ClaimedChain,
        about: Option<&IncidentView>,
    ) -> Result<Vec<u8>, PackingError> {
        let provider = self.parts.plant.provider;
        let sign = |packing: Packing| packing.sign(claimed.clone(), owner.address, &owner.signing(), provider);
        let members = sign(packing)?;
        let bundle = Bundle::of_members(&members, provider)?;
        // The report uses the pins that the bundle suggests.
        let trust = bundle.suggested.as_ref().and_then(|text| Trust::parse(text.as_bytes()).ok());
        let page = page::page(&bundle, &verify(&bundle, trust.as_ref(), provider), about);
        let mut packing = Packing::from(members);
        packing.report(page);
        pack(&sign(packing)?)
    }

    async fn write_evidence(
        &self,
        owner: &Owner,
        network: &Network,
        (rows, reveal): (&[RecordRow], &BTreeSet<Digest>),
        about: Option<&IncidentView>,
        file: &Path,
    ) -> Result<EvidenceView> {
        let reader = Reader { plant: &self.parts.plant, network, reader: owner };
        let authorities = block_in_place(|| self.stamps.suggested());
        let gathered = gather(&reader, rows, reveal, authorities).await?;
        let chain = &network.chain;
        let pin = chain.pin().ok_or_else(|| PipelineError::from(crate::chain::ChainError::NoContract))?;
        let claimed = ClaimedChain { id: pin.chain_id, genesis: pin.genesis, contract: pin.contract };
        let bytes = block_in_place(|| self.packed(owner, gathered.packing, &claimed, about))
            .map_err(|error| input(error.to_string()))?;
        private_file::create_private(file, &bytes)?;
        Ok(EvidenceView {
            file: file.display().to_string(),
            bytes: bytes.len() as u64,
            records: gathered.records,
            revealed: gathered.revealed,
            topics: disclosed_topics(rows, reveal),
            written: true,
            notes: gathered.notes,
        })
    }
}

/// The chosen messages and definitions that are to be disclosed together. What a site says of itself never is: it names
/// all topics.
fn of_topics<'a>(rows: &'a [RecordRow], wishes: &EvidenceWishes) -> Result<BTreeMap<String, Vec<&'a RecordRow>>> {
    let mut found: BTreeMap<String, Vec<&RecordRow>> = BTreeMap::new();
    let is_content = |row: &&RecordRow| row.kind.is_content() || row.kind == RecordKind::Definition;
    for row in rows.iter().filter(is_content) {
        if wishes.reveal_all || wishes.reveal_topics.iter().any(|pattern| pattern.matches(&row.topic)) {
            found.entry(row.topic.clone()).or_default().push(row);
        }
    }
    let is_unmet = |pattern: &&TopicPattern| !found.keys().any(|topic| pattern.matches(topic));
    match wishes.reveal_topics.iter().find(is_unmet) {
        Some(pattern) => {
            Err(input(format!("no chosen message has a topic that matches {pattern}; nothing is disclosed")))
        }
        None => Ok(found),
    }
}

fn disclosed_topics(rows: &[RecordRow], reveal: &BTreeSet<Digest>) -> Vec<DisclosedTopic> {
    let mut counts: BTreeMap<String, u64> = BTreeMap::new();
    for row in rows.iter().filter(|row| reveal.contains(&row.digest)) {
        *counts.entry(clean(&row.topic, 255)).or_default() += 1;
    }
    let mut topics: Vec<_> = counts.into_iter().map(|(topic, records)| DisclosedTopic { topic, records }).collect();
    topics.sort_by_key(|one| Reverse(one.records));
    topics
}

/// Drops what proves nothing in an incident's bundle unless named; says how many.
fn leave_out(rows: &mut Vec<RecordRow>, about: &IncidentView, named: &[String]) -> Vec<String> {
    let mut notes = Vec::new();
    let mut take_out = |is_out: fn(&RecordRow) -> bool, why: &str| {
        let before = rows.len();
        rows.retain(|row| !is_out(row) || named.contains(&row.id));
        let out = before - rows.len();
        notes.extend((out > 0).then(|| format!("{} of the incident left out: {why}", counted(out as u64, "record"))));
    };
    take_out(|row| row.deleted_at.is_some(), "retention had already deleted the bytes");
    take_out(is_early, "not stored yet; export it again later");
    if about.open {
        let is_unanchored = |row: &RecordRow| row.block.is_none() && row.state.is_before_block();
        take_out(is_unanchored, "not anchored yet; it is still open, export it again later");
    }
    notes
}

fn is_early(row: &RecordRow) -> bool {
    row.state == RecordState::Captured
}

const LOOK: Duration = Duration::from_secs(2);
const ABOUT: &str = "chain proofs";

pub(in crate::site) struct ChainProofs {
    parts: Parts,
    trouble: Mutex<Option<(Timestamp, String)>>,
}

impl ChainProofs {
    pub fn new(parts: &Parts) -> Self {
        Self { parts: parts.clone(), trouble: Mutex::default() }
    }

    pub async fn keep(self: Arc<Self>) {
        let mut rounds = Rounds::default();
        while self.parts.life.beat(LOOK).await {
            let Some(network) = self.parts.link.network_now() else { continue };
            let result = collect(&self.parts.plant, &network, &mut rounds).await;
            self.told(result);
        }
    }

    fn told(&self, result: Result<Collected, PipelineError>) {
        let (missed, problem) = match result {
            Ok(collected) => (collected.missed, collected.problem),
            Err(error) => (0, Some(error.to_string())),
        };
        let problem = problem.map(|why| clean(&why, 200));
        if let (1.., Some(why)) = (missed, &problem) {
            let text = format!("the chain's proofs of {} could not be kept: {why}", counted(missed, "batch"));
            self.parts.hub.notice_about(ABOUT, NoticeLevel::Warning, &text);
        }
        let mut trouble = locked(&self.trouble);
        let since = trouble.as_ref().map_or_else(Timestamp::now, |(since, _)| *since);
        *trouble = problem.map(|why| (since, why));
    }

    pub fn health(&self) -> Result<Option<PartHealth>> {
        let counts = self.parts.plant.ledger.proofs.chain_proof_counts()?;
        let trouble = locked(&self.trouble).clone();
        // The chain's own part reports a node that is away.
        let answers = !self.parts.link.is_silent() && self.parts.link.network_now().is_some();
        let trouble = trouble.filter(|_| answers);
        if counts.newest.is_none() && counts.missed == 0 && trouble.is_none() {
            return Ok(None);
        }
        let kept =
            counts.newest.map_or_else(|| "no proofs kept yet".to_owned(), |block| format!("kept up to block {block}"));
        let missed = match counts.missed {
            0 => String::new(),
            missed => format!("; without one, so that bundles ask the node: {}", counted(missed, "batch")),
        };
        Ok(Some(waiting_part("proofs", &format!("{kept}{missed}"), trouble)))
    }
}

/// A part that waits since its trouble began, if there is any.
fn waiting_part(part: &str, told: &str, trouble: Option<(Timestamp, String)>) -> PartHealth {
    let (level, since, text) = match trouble {
        Some((since, why)) => (HealthLevel::Waiting, Some(since), format!("{told}; {why}")),
        None => (HealthLevel::Ok, None, told.to_owned()),
    };
    PartHealth { since, ..PartHealth::new(part, level, &clean(&text, 300)) }
}

#[cfg(test)]
mod tests;
