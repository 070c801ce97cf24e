//! Records as shown to people, own and shared: listed, checked, opened and exported.

mod opened;
pub(super) mod own;

use std::collections::{BTreeSet, HashSet};
use std::sync::{Arc, Mutex};

use serde_json::{Value, json};
use tokio::task::block_in_place;

use super::devices::enrolled;
use crate::command::UploadQuery;
use crate::model::{
    Address, Digest, ErrorKind, GapReport, ProfileName, RecordKind, RetentionReport, SignerId, Timestamp, TopicName,
    TopicPattern, TopicPatterns, clean, counted, natural,
};
use crate::pipeline::columns::Heads;
use crate::pipeline::{Network, network_pin};
use crate::reply::{CoverageView, Failure, Result, input};
use crate::ros::recording::{Beside, BesideContent};
use crate::site::{Contacts, Parts};
use crate::store::notes::Enrolled;
use crate::store::{Coverage, CoverageQuery, RecordQuery};

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
        let Some(robot) = query.robot.clone() else { return Ok(own::record_query(query)) };
        let ledger = &self.parts.plant.ledger;
        let mut enrolled = Vec::new();
        for owner in owners {
            enrolled.extend(block_in_place(|| enrolled::of_account(&ledger.notes, *owner))?);
        }
        let unknown = match devices_of(&enrolled, &robot) {
            Ok(signers) => return Ok(RecordQuery { signers: Some(signers), ..own::record_query(query) }),
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
    let mut query = own::record_query(query);
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

const MOST_PARTS: usize = 1_000;
/// Parts of all strips of one answer.
const MOST_IN_ALL: usize = 100_000;

impl Reading {
    /// According to the ledger; needs no passphrase.
    pub async fn coverage(
        &self,
        profile: &ProfileName,
        (topic, robot): (Option<TopicPattern>, Option<String>),
        (since, until): (Option<Timestamp>, Option<Timestamp>),
        parts: usize,
    ) -> Result<Vec<CoverageView>> {
        let owner = self.parts.owners.address_of(profile)?;
        let until = until.unwrap_or_else(Timestamp::now);
        if since.is_some_and(|since| since >= until) {
            return Err(input("the span ends before it begins; --since must be earlier than --until"));
        }
        if !(1..=MOST_PARTS).contains(&parts) {
            return Err(input(format!("a span can have 1 to {MOST_PARTS} parts, not {parts}")));
        }
        // Robots' records arrive without topic names.
        self.learn_own_names(profile).await?;
        let asked = UploadQuery { topic: topic.clone(), robot: robot.clone(), ..UploadQuery::default() };
        let chosen = self.of_robot(&[owner], asked)?;
        let names = block_in_place(|| self.covered(owner, topic.as_ref(), &chosen))?;
        if names.len().saturating_mul(parts) > MOST_IN_ALL {
            let most = MOST_IN_ALL / names.len().max(1);
            return Err(input(format!(
                "{} matched, too many for --parts {parts}; use --parts {most} or a narrower pattern",
                counted(names.len() as u64, "topic")
            )));
        }
        let enrolled = block_in_place(|| enrolled::of_account(&self.parts.plant.ledger.notes, owner))?;
        let view = |(topic, found): (TopicName, Coverage)| CoverageView {
            topic,
            robot: robot.as_ref().map(|robot| clean(robot, 64)),
            robots: robots_of(&enrolled, &found.signers),
            since: found.since,
            until,
            first: found.first,
            last: found.last,
            parts: found.parts,
        };
        let topics = names.iter().map(ToString::to_string).collect();
        let query = CoverageQuery { owner, topics, signers: chosen.signers, since, until, parts };
        let found = block_in_place(|| self.parts.plant.ledger.counts.coverage(&query))?;
        Ok(names.into_iter().zip(found).map(view).collect())
    }

    /// Topics with records that match; a topic named in full also without.
    fn covered(&self, owner: Address, topic: Option<&TopicPattern>, chosen: &RecordQuery) -> Result<Vec<TopicName>> {
        let is_chosen = |name: &str| chosen.topics.iter().all(|patterns| patterns.matches(name));
        if let Some(name) = topic.and_then(TopicPattern::name).filter(|name| is_chosen(name.as_str())) {
            return Ok(vec![name]);
        }
        let is_signed = |signer: &SignerId| chosen.signers.as_ref().is_none_or(|signers| signers.contains(signer));
        let recorded = self.parts.plant.ledger.counts.signer_topics(owner, None)?;
        let recorded = recorded.into_iter().filter(|one| is_signed(&one.signer) && is_chosen(&one.topic));
        let names: BTreeSet<TopicName> = recorded.filter_map(|one| one.topic.parse().ok()).collect();
        if names.is_empty() {
            let what = "no message of yours has that topic and robot; `authros records list` shows yours";
            return Err(input(format!("nothing matches: {what}")));
        }
        let mut names = Vec::from_iter(names);
        names.sort_by(|one, other| natural(one.as_str(), other.as_str()));
        Ok(names)
    }
}

fn robots_of(enrolled: &[Enrolled], signers: &BTreeSet<SignerId>) -> Vec<String> {
    let robots = enrolled.iter().filter(|robot| signers.contains(&robot.device));
    let names: BTreeSet<&str> = robots.map(|robot| robot.name.as_str()).collect();
    let mut names: Vec<String> = names.into_iter().map(str::to_owned).collect();
    names.sort_by(|one, other| natural(one, other));
    names
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test fails by panicking")]

    use std::sync::Arc;

    use super::*;
    use crate::crypto::{SmKeyPair, signer_id};
    use crate::model::ErrorKind;
    use crate::site::contacts::Contacts;
    use crate::site::devices::enrolled::Enrolments;
    use crate::site::testing::{Ground, profile};

    /// Topic and strip of each view.
    fn strips(views: &[CoverageView]) -> Vec<(String, String)> {
        views.iter().map(|view| (view.topic.to_string(), view.strip())).collect()
    }

    fn rows(expected: &[(&str, &str)]) -> Vec<(String, String)> {
        expected.iter().map(|(topic, strip)| ((*topic).to_owned(), (*strip).to_owned())).collect()
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_pattern_and_a_robot_cover_the_topics_that_records_lists_have() {
        let ground = Ground::with(&[]);
        let alice = ground.owner("alice");
        let key = SmKeyPair::generate(ground.parts.plant.provider).expect("a pair").public;
        let (own, scout) = (SignerId([1; 32]), signer_id(&key));
        for (signer, topic, second) in [
            (own, "/robot1/odom", 100),
            (own, "/robot1/camera/front", 310),
            (own, "/robot2/odom", 210),
            (scout, "/shed/odom", 399),
            (scout, "/robot1/odom", 220),
        ] {
            ground.capture(alice.address, signer, topic, second);
        }
        let enrolled =
            Enrolled { name: profile("scout"), device: scout, topics: Vec::new(), ended: false, key, gateway: None };
        Enrolments::new(&ground.parts).add(&alice, enrolled).expect("noted");
        let reading = Reading::new(&ground.parts, &Arc::new(Contacts::new(&ground.parts)));
        let covered = async |topic: Option<&str>, robot: Option<&str>| {
            let asked = (topic.map(|topic| topic.parse().expect("a pattern")), robot.map(str::to_owned));
            let until = Some(Timestamp::from_seconds(500));
            reading.coverage(&profile("alice"), asked, (None, until), 4).await
        };
        // All over the span of the earliest, 100 to 500 s.
        let found = covered(Some("/robot*/odom"), None).await.expect("found");
        assert_eq!(strips(&found), rows(&[("/robot1/odom", "██··"), ("/robot2/odom", "·█··")]));
        assert!(found.iter().all(|view| view.since == Timestamp::from_seconds(100)), "{found:?}");
        assert_eq!((&found[0].robots, &found[1].robots), (&vec!["scout".to_owned()], &Vec::new()));
        let found = covered(Some("**"), None).await.expect("found");
        let all = [
            ("/robot1/camera/front", "··█·"),
            ("/robot1/odom", "██··"),
            ("/robot2/odom", "·█··"),
            ("/shed/odom", "··█·"),
        ];
        assert_eq!(strips(&found), rows(&all));

        // A robot is the one enrolled under that name, whatever its topics are called, or else their first part.
        let found = covered(None, Some("scout")).await.expect("found");
        let span = (Timestamp::from_seconds(220), Timestamp::from_seconds(500));
        assert!(found.iter().all(|view| (view.since, view.until) == span), "{found:?}");
        assert_eq!(strips(&found), rows(&[("/robot1/odom", "█···"), ("/shed/odom", "··█·")]));
        let found = covered(None, Some("robot1")).await.expect("found");
        assert_eq!(strips(&found), rows(&[("/robot1/camera/front", "··█·"), ("/robot1/odom", "██··")]));
        let found = covered(Some("/robot1/odom"), Some("scout")).await.expect("found");
        assert_eq!((found.len(), found[0].first), (1, Some(Timestamp::from_seconds(220))));

        // A name in full may have no record yet; a pattern, a robot or both that match nothing are a mistake.
        let found = covered(Some("/robot3/odom"), None).await.expect("a topic without records");
        assert_eq!((found.len(), found[0].first), (1, None));
        for (topic, robot) in [
            (Some("/robot3/**"), None),
            (None, Some("robot3")),
            (Some("/robot2/odom"), Some("robot1")),
            (Some("/robot2/*"), Some("scout")),
        ] {
            let failure = covered(topic, robot).await.expect_err("nothing matches");
            assert_eq!(failure.kind, ErrorKind::Input, "{failure}");
        }
    }
}
