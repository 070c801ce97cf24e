//! The policies that an owner sets for robots, and what the robots report about them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Mutex;

use tokio::task::block_in_place;

use crate::config::RobotPolicy;
use crate::crypto::{Anchor, Expected, LONGEST_POLICY, Names, Notice, OpenedRecord, SignedPolicy, open, topic_key};
use crate::model::{
    Address, Digest, GapReport, PolicyReport, RecordKind, RecordState, SignerId, Timestamp, TopicId, clean,
    clean_lines, locked, natural,
};
use crate::pipeline::epoch::type_choice;
use crate::pipeline::{Network, Owner, recorder_heads};
use crate::reply::{CoveragePart, CoveredSpan, Failure, Result, RobotRow, RobotTopicRow, RobotView, input, refused};
use crate::site::Devices;
use crate::store::notes::{Enrolled, PolicyWanted, WantedPolicy};
use crate::store::{CoverageQuery, RecordQuery, RecordRow, SignerTopic};

const MOST: usize = 10_000;
const MOST_LOSSES: usize = 256;
const MOST_ROBOTS: usize = 100_000;

type LostByTopic = BTreeMap<String, u64>;

/// Topic and messages lost, by the digest of the report that says so: a report is opened once.
#[derive(Default)]
pub struct Losses(Mutex<BTreeMap<Digest, (String, u64)>>);

struct Known {
    reports: BTreeMap<SignerId, PolicyReport>,
    seen: BTreeMap<SignerId, Timestamp>,
    topics: Vec<SignerTopic>,
}

impl Devices {
    pub async fn robot_rows(&self, owner: &Owner) -> Result<Vec<RobotRow>> {
        let network = self.parts.link.network().await?;
        let robots = self.enrolments.of(owner)?.into_iter().filter(|robot| !robot.ended);
        let robots: Vec<Enrolled> = robots.collect();
        let (known, lost) =
            block_in_place(|| Ok::<_, Failure>((self.known(owner, &network)?, self.lost(owner, &network, &robots)?)))?;
        let lost_by = |device: SignerId| lost.get(&device).map(sum).unwrap_or_default();
        let robots = robots.into_iter();
        let row = |robot: Enrolled| Ok(row(&robot, &self.wanted(owner, robot.device)?, &known, lost_by(robot.device)));
        let mut rows = robots.map(row).collect::<Result<Vec<_>>>()?;
        rows.sort_by(|one, other| natural(one.name.as_str(), other.name.as_str()));
        Ok(rows)
    }

    pub async fn robot_view(&self, owner: &Owner, name: &str) -> Result<RobotView> {
        let network = self.parts.link.network().await?;
        let robot = self.robot(&network, owner, name)?;
        let wanted = self.wanted(owner, robot.device)?;
        let (known, lost) = block_in_place(|| {
            let known = self.known(owner, &network)?;
            Ok::<_, Failure>((known, self.lost(owner, &network, std::slice::from_ref(&robot))?))
        })?;
        let lost = lost.into_values().next().unwrap_or_default();
        let report = known.reports.get(&robot.device).cloned().unwrap_or_default();
        let mut topics = topic_rows(robot.device, &known.topics, lost.clone());
        let covered = block_in_place(|| self.cover(owner.address, robot.device, &mut topics))?;
        Ok(RobotView {
            row: row(&robot, &wanted, &known, sum(&lost)),
            gateway: robot.gateway.clone().map(Into::into),
            enrolled: robot.topics.iter().map(|topic| clean(topic, 255)).collect(),
            topics,
            covered,
            refused: report.refused.map(|text| clean(&text, 300)),
            overruled: report.overruled.iter().map(|text| clean(text, 300)).collect(),
            policy: clean_lines(&wanted.text, LONGEST_POLICY),
            set_at: (wanted.version > 0).then_some(wanted.set_at),
        })
    }

    pub async fn set_policy(&self, owner: &Owner, name: &str, text: String) -> Result<RobotView> {
        if text.len() > LONGEST_POLICY {
            return Err(input(format!("the policy has {} bytes; {LONGEST_POLICY} are allowed", text.len())));
        }
        RobotPolicy::read(&text)?;
        let network = self.parts.link.network().await?;
        let robot = self.robot(&network, owner, name)?;
        let one_at_a_time = owner.changes.lock().await;
        let before = self.wanted(owner, robot.device)?;
        let reports = block_in_place(|| self.reports(owner, &network))?;
        // After a restored backup, the robot may know a higher version.
        let running = reports.get(&robot.device).map_or(0, |report| report.running);
        let version = before.version.max(running).checked_add(1);
        let version =
            version.ok_or_else(|| refused("this robot's policy cannot be numbered higher; enrol it again"))?;
        let what = if text.is_empty() { "cleared".to_owned() } else { format!("{} bytes", text.len()) };
        let subject = format!("{}: version {version}, {what}", robot.device);
        let sent = async {
            let policy = SignedPolicy::sign(&network.domain, &owner.eoa(), robot.device, version, &text)?;
            // Noted first: two policies never share a number.
            let (note, set_at) = (WantedPolicy { owner: owner.address, device: robot.device }, Timestamp::now());
            self.parts.plant.ledger.notes.write(&note, &PolicyWanted { version, text, set_at })?;
            block_in_place(|| self.enrolments.send(owner, &network, &robot, &Notice::Policy(policy)))
        };
        self.parts.log.deed(&owner.profile, "robot policy", &subject, sent).await?;
        drop(one_at_a_time);
        self.robot_view(owner, name).await
    }

    fn wanted(&self, owner: &Owner, device: SignerId) -> Result<PolicyWanted> {
        let note = WantedPolicy { owner: owner.address, device };
        Ok(self.parts.plant.ledger.notes.read(&note)?.unwrap_or_default())
    }

    fn known(&self, owner: &Owner, network: &Network) -> Result<Known> {
        let ledger = &self.parts.plant.ledger;
        let own = crate::crypto::signer_id(&owner.public_keys().0);
        Ok(Known {
            reports: self.reports(owner, network)?,
            seen: ledger.counts.last_seen(MOST_ROBOTS)?.into_iter().map(|seen| (seen.signer, seen.at)).collect(),
            topics: ledger.counts.signer_topics(owner.address, Some(own))?,
        })
    }

    /// Fills in when there are records of each topic, in equal parts of the whole time.
    fn cover(&self, owner: Address, device: SignerId, topics: &mut [RobotTopicRow]) -> Result<Option<CoveredSpan>> {
        let counts = &self.parts.plant.ledger.counts;
        let now = Timestamp::now();
        let names = topics.iter().map(|row| row.topic.clone()).collect();
        let signers = Some(BTreeSet::from([device]));
        let query = CoverageQuery { owner, topics: names, signers, since: None, until: now, parts: 1 };
        let ends = counts.coverage(&query)?;
        let Some(since) = ends.iter().filter_map(|one| one.first).min() else { return Ok(None) };
        // A robot's clock may be ahead.
        let last = ends.iter().filter_map(|one| one.last).max().unwrap_or(now);
        let until = now.max(Timestamp(last.0.saturating_add(1)));
        let query = CoverageQuery { since: Some(since), until, parts: CoveredSpan::PARTS, ..query };
        for (row, found) in topics.iter_mut().zip(counts.coverage(&query)?) {
            (row.first, row.last) = (found.first, found.last);
            if row.first.is_some() {
                row.strip = found.parts.iter().map(CoveragePart::sign).collect();
            }
        }
        Ok(Some(CoveredSpan { since, until }))
    }

    fn reports(&self, owner: &Owner, network: &Network) -> Result<BTreeMap<SignerId, PolicyReport>> {
        let topic = owner.topic_id(recorder_heads::TOPIC);
        let query = RecordQuery {
            owner: Some(owner.address),
            topic_ids: Some(vec![topic]),
            kind: Some(RecordKind::Audit),
            filters: vec![type_choice(&owner.index(), PolicyReport::TYPE, &[topic])],
            limit: MOST,
            newest_first: true,
            ..RecordQuery::default()
        };
        let robots = self.enrolments.of(owner)?;
        let mut reports = BTreeMap::new();
        for row in self.parts.plant.ledger.records.list(&query)?.rows {
            let Some(robot) = robots.iter().find(|robot| robot.device == row.signer) else { continue };
            if reports.contains_key(&row.signer) {
                continue;
            }
            let Some(opened) = self.opened(owner, network, robot, &row) else { continue };
            if let Ok(report) = PolicyReport::parse(&opened.body) {
                reports.insert(row.signer, report);
            }
        }
        Ok(reports)
    }

    /// Reports of robots about losses, newest first.
    fn gaps(&self, owner: &Owner) -> Result<Vec<RecordRow>> {
        let query = RecordQuery {
            owner: Some(owner.address),
            kind: Some(RecordKind::Gap),
            limit: MOST,
            newest_first: true,
            ..RecordQuery::default()
        };
        Ok(self.parts.plant.ledger.records.list(&query)?.rows)
    }

    /// What each of these robots lost of each topic, by its newest reports.
    fn lost(&self, owner: &Owner, network: &Network, robots: &[Enrolled]) -> Result<BTreeMap<SignerId, LostByTopic>> {
        let mut lost: BTreeMap<SignerId, (usize, LostByTopic)> = BTreeMap::new();
        let mut before = std::mem::take(&mut *locked(&self.losses.0));
        let mut now = BTreeMap::new();
        for row in self.gaps(owner)? {
            let mut known = before.remove(&row.digest);
            if let Some(robot) = robots.iter().find(|robot| robot.device == row.signer) {
                let (reports, topics) = lost.entry(row.signer).or_default();
                if *reports == MOST_LOSSES {
                    continue;
                }
                *reports += 1;
                let opened = || GapReport::parse(&self.opened(owner, network, robot, &row)?.body).ok();
                known = known.or_else(|| opened().map(|gap| (gap.topic, gap.count)));
                if let Some((topic, count)) = &known {
                    let sum = topics.entry(topic.clone()).or_default();
                    *sum = sum.saturating_add(*count);
                }
            }
            now.extend(known.map(|known| (row.digest, known)));
        }
        *locked(&self.losses.0) = now;
        Ok(lost.into_iter().map(|(device, (_, topics))| (device, topics)).collect())
    }

    fn opened(&self, owner: &Owner, network: &Network, robot: &Enrolled, row: &RecordRow) -> Option<OpenedRecord> {
        let (signer, blob) = (robot.key, self.parts.plant.ciphertext.get(row.digest).ok()??);
        let key = topic_key(&owner.epoch_key(network.domain, row.epoch)?, &row.topic_id);
        let topic_id: Option<TopicId> = Some(row.topic_id);
        let names = Names::Derived(owner.index());
        let expected = Expected { topic_id, ..Expected::any_of(network.domain, owner.address, names) };
        open(self.parts.plant.provider, &blob, &row.signature, &signer, Anchor::Unanchored, &key, &expected).ok()
    }
}

fn sum(topics: &LostByTopic) -> u64 {
    topics.values().copied().fold(0, u64::saturating_add)
}

fn row(robot: &Enrolled, wanted: &PolicyWanted, known: &Known, lost: u64) -> RobotRow {
    let report = known.reports.get(&robot.device);
    let running = report.map(|report| report.running);
    let drift = !robot.ended && running.unwrap_or_default() != wanted.version;
    let standing = if robot.ended { "revoked" } else { standing(wanted, report) };
    let of_robot = known.topics.iter().filter(|topic| topic.signer == robot.device);
    let waiting = of_robot.flat_map(|topic| &topic.records).filter(|(state, _)| state.is_pending());
    let address = robot.gateway.as_ref().and_then(|gateway| gateway.addresses.first());
    RobotRow {
        name: robot.name.clone(),
        device: robot.device,
        last_seen: known.seen.get(&robot.device).copied(),
        address: address.map(|address| clean(address, 255)),
        waiting: waiting.map(|(_, count)| count).sum(),
        lost,
        wanted: wanted.version,
        running,
        standing: standing.to_owned(),
        drift,
        drift_since: drift.then_some(wanted.set_at),
    }
}

fn standing(wanted: &PolicyWanted, report: Option<&PolicyReport>) -> &'static str {
    match report {
        Some(report) if report.running == wanted.version => "in force",
        Some(report) if report.running > wanted.version => "runs a policy not known here",
        Some(report) if report.heard >= wanted.version && report.refused.is_some() => "refused",
        Some(_) => "waiting",
        None if wanted.version == 0 => "none",
        None => "waiting",
    }
}

fn topic_rows(robot: SignerId, topics: &[SignerTopic], mut lost: LostByTopic) -> Vec<RobotTopicRow> {
    let mut rows: Vec<RobotTopicRow> = Vec::new();
    for topic in topics.iter().filter(|topic| topic.signer == robot) {
        let of = |wanted: fn(RecordState) -> bool| -> u64 {
            topic.records.iter().filter(|(state, _)| wanted(**state)).map(|(_, count)| count).sum()
        };
        rows.push(RobotTopicRow {
            topic: clean(&topic.topic, 255),
            records: of(|_| true),
            verified: of(|state| state == RecordState::Verified),
            waiting: of(RecordState::is_pending),
            lost: lost.remove(&topic.topic).unwrap_or_default(),
            ..RobotTopicRow::default()
        });
    }
    let nothing =
        |(topic, lost): (String, u64)| RobotTopicRow { topic: clean(&topic, 255), lost, ..RobotTopicRow::default() };
    rows.extend(lost.into_iter().map(nothing));
    rows.sort_by(|one, other| natural(&one.topic, &other.topic));
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robots_standing_follows_from_what_it_told() {
        let wanted = |version| PolicyWanted { version, text: String::new(), set_at: Timestamp(1_000) };
        let report = |heard, running, refused: bool| PolicyReport {
            heard,
            running,
            refused: refused.then(|| "no".to_owned()),
            overruled: Vec::new(),
        };
        for (expected, wanted, report) in [
            ("none", wanted(0), None),
            ("waiting", wanted(1), None),
            ("in force", wanted(2), Some(report(2, 2, false))),
            ("in force", wanted(2), Some(report(1, 2, true))),
            ("waiting", wanted(3), Some(report(2, 2, false))),
            ("waiting", wanted(3), Some(report(2, 1, true))),
            ("refused", wanted(3), Some(report(3, 2, true))),
            ("runs a policy not known here", wanted(1), Some(report(5, 5, false))),
        ] {
            assert_eq!(standing(&wanted, report.as_ref()), expected, "{wanted:?} {report:?}");
        }
    }
}
