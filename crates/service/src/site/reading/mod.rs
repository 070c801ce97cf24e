//! Records as shown to people, own and shared: listed, checked, opened and exported.

mod coverage;
mod opened;
mod own;
mod shared;
pub(super) mod view;

use std::collections::{BTreeSet, HashSet};
use std::sync::{Arc, Mutex};

use serde_json::{Value, json};
use tokio::task::block_in_place;

use super::contacts::Contacts;
use super::devices::enrolled;
use super::parts::Parts;
use crate::command::UploadQuery;
use crate::failure::input;
use crate::model::{
    Address, Digest, ErrorKind, GapReport, RecordKind, RetentionReport, SignerId, TopicPattern, TopicPatterns, clean,
    counted,
};
use crate::pipeline::columns::Heads;
use crate::pipeline::{Network, network_pin};
use crate::reply::{Failure, Result};
use crate::ros::recording::{Beside, BesideContent};
use crate::store::RecordQuery;
use crate::store::notes::Enrolled;

/// Fewest characters of an id.
const SHORTEST: usize = 8;

pub(in crate::site) struct Reading {
    parts: Parts,
    contacts: Arc<Contacts>,
    /// Heads of records opened for lists.
    heads: Heads,
    /// Records with no names to learn for a reader.
    nameless: Mutex<HashSet<(Address, Digest)>>,
}

impl Reading {
    pub fn new(parts: &Parts, contacts: &Arc<Contacts>) -> Self {
        let (parts, contacts) = (parts.clone(), Arc::clone(contacts));
        Self { parts, contacts, heads: Heads::default(), nameless: Mutex::default() }
    }

    /// The network; without its chain, what this home kept of it, to read own records by.
    pub async fn network_or_kept(&self) -> Result<Network> {
        let failure = match self.parts.link.network().await {
            Ok(_) if self.parts.link.is_silent() => {
                Failure::new(ErrorKind::Unreachable, "it did not answer the last request")
            }
            Ok(network) => return Ok(network),
            Err(failure) => failure,
        };
        let plant = &self.parts.plant;
        match block_in_place(|| network_pin(&plant.ledger.rights))? {
            Some(pin) => Ok(block_in_place(|| Network::kept(plant, pin, &clean(&failure.message, 400)))?),
            None => Err(failure),
        }
    }

    pub fn forget(&self) {
        self.heads.forget();
    }
}

impl Reading {
    /// Own records. A robot is one enrolled under its name, or else the first part of topics.
    pub(in crate::site) fn of_robot(&self, owners: &[Address], query: UploadQuery) -> Result<RecordQuery> {
        let Some(robot) = query.robot.clone() else { return Ok(view::record_query(query)) };
        let ledger = &self.parts.plant.ledger;
        let mut enrolled = Vec::new();
        for owner in owners {
            enrolled.extend(block_in_place(|| enrolled::of_account(&ledger.notes, *owner))?);
        }
        let unknown = match devices_of(&enrolled, &robot) {
            Ok(signers) => return Ok(RecordQuery { signers: Some(signers), ..view::record_query(query) }),
            Err(unknown) => unknown,
        };
        let Ok(under) = TopicPattern::of_robot(&robot) else { return Err(unknown) };
        for owner in owners {
            let counts = block_in_place(|| ledger.counts.by_state(Some(*owner)))?;
            if counts.topics.iter().any(|topic| under.matches(&topic.topic)) {
                return of_namespace(query);
            }
        }
        Err(unknown)
    }
}

impl Reading {
    /// What an enrolled robot may record, and what it has recorded.
    pub fn topics_of_robot(&self, owner: Address, robot: &str) -> Result<BTreeSet<String>, Failure> {
        let ledger = &self.parts.plant.ledger;
        let enrolled = block_in_place(|| enrolled::of_account(&ledger.notes, owner))?;
        let devices = devices_of(&enrolled, robot)?;
        let of_robot = enrolled.into_iter().filter(|one| devices.contains(&one.device) && !one.ended);
        let mut topics: BTreeSet<String> = of_robot.flat_map(|one| one.topics).collect();
        let recorded = block_in_place(|| ledger.counts.signer_topics(owner, None))?;
        let of_robot = recorded.into_iter().filter(|one| devices.contains(&one.signer));
        topics.extend(of_robot.map(|one| one.topic));
        Ok(topics)
    }
}

/// Records with the robot's name as the first part of their topics.
fn of_namespace(query: UploadQuery) -> Result<RecordQuery> {
    let under = query.robot.as_deref().map(TopicPattern::of_robot).transpose();
    let under = under.map_err(|error| input(error.to_string()))?;
    let mut query = view::record_query(query);
    query.topics.extend(under.map(|under| TopicPatterns(vec![under])));
    Ok(query)
}

/// Devices ever enrolled under a name (a re-enrolled robot has another key), or the one whose id begins so.
fn devices_of(enrolled: &[Enrolled], robot: &str) -> Result<BTreeSet<SignerId>> {
    let devices = |is_meant: &dyn Fn(&Enrolled) -> bool| -> BTreeSet<SignerId> {
        enrolled.iter().filter(|one| is_meant(one)).map(|one| one.device).collect()
    };
    let named = devices(&|one| one.name.as_str() == robot);
    if !named.is_empty() {
        return Ok(named);
    }
    let begin: String = robot.chars().filter(|character| !character.is_whitespace()).collect::<String>().to_lowercase();
    let begin = begin.trim_start_matches("0x");
    let known =
        devices(&|one| begin.len() >= SHORTEST && one.device.to_string().trim_start_matches("0x").starts_with(begin));
    if known.len() == 1 {
        return Ok(known);
    }
    Err(input(format!(
        "no robot of this profile is called '{}'; give the name that it was enrolled under, or at least {SHORTEST} \
         characters of its device's id; `authros robot list` shows them",
        clean(robot, 64)
    )))
}

const WIDEST: usize = 255;

const LONGEST_VALUE: usize = 64 * 1024;

/// A gap, retention or attachment record's body by field names; `None` for other kinds.
pub(in crate::site) fn view(kind: RecordKind, type_name: &str, body: &[u8]) -> Option<Value> {
    match kind {
        RecordKind::Gap => GapReport::parse(body).ok().map(|gap| {
            json!({
                "topic": clean(&gap.topic, WIDEST), "publisher": clean(&gap.publisher, WIDEST), "lost": gap.count,
                "reason": gap.reason.word(), "text": format!("{} messages {}", gap.count, gap.reason.text()),
                "first_number": gap.numbers.map(|(first, _)| first), "last_number": gap.numbers.map(|(_, last)| last),
                "first_at": gap.first_at, "last_at": gap.last_at,
            })
        }),
        RecordKind::Retention => RetentionReport::parse(body).ok().map(|report| {
            json!({
                "topic": clean(&report.topic, WIDEST), "rule": clean(&report.rule, WIDEST), "records": report.count,
                "bytes": report.bytes, "first_seq": report.first_seq, "last_seq": report.last_seq,
                "rolling": report.rolling,
                "text": format!("the ciphertext of {} was deleted", counted(report.count, "record")),
            })
        }),
        RecordKind::Attachment => beside(type_name, body),
        _ => None,
    }
}

fn beside(type_name: &str, body: &[u8]) -> Option<Value> {
    Some(match Beside::of_type(type_name)?.parse(body)? {
        BesideContent::File(file) => json!({
            "name": clean(&file.name, WIDEST), "media_type": clean(&file.media_type, WIDEST), "bytes": file.data.len(),
            "logged_at": file.logged_at, "created_at": file.created_at, "crc32": file.checksum,
        }),
        BesideContent::Metadata { name, entries } => {
            let entries: Vec<_> =
                entries.iter().map(|(key, value)| json!([clean(key, WIDEST), clean(value, LONGEST_VALUE)])).collect();
            json!({ "name": clean(&name, WIDEST), "entries": entries })
        }
    })
}

/// The attached file, or the bytes of metadata; `None` if it is neither.
pub(in crate::site) fn content<'a>(type_name: &str, body: &'a [u8]) -> Option<&'a [u8]> {
    Some(match Beside::of_type(type_name)?.parse(body)? {
        BesideContent::File(file) => file.data,
        BesideContent::Metadata { .. } => body,
    })
}

/// Names and values, for screens.
pub(in crate::site) fn fields(view: &Value) -> Vec<(String, String)> {
    let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    view.as_object().into_iter().flatten().map(|(name, value)| (name.clone(), text(value))).collect()
}
