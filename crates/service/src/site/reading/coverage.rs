//! When there are own records of topics: one strip for each topic that matches, all over the same span.

use std::collections::BTreeSet;

use tokio::task::block_in_place;

use super::Reading;
use crate::command::UploadQuery;
use crate::failure::input;
use crate::model::{Address, ProfileName, SignerId, Timestamp, TopicName, TopicPattern, clean, counted, natural};
use crate::reply::{CoverageView, Result};
use crate::site::devices::enrolled;
use crate::store::notes::Enrolled;
use crate::store::{Coverage, CoverageQuery, RecordQuery};

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
        let names = block_in_place(|| self.covered_names(owner, topic.as_ref(), &chosen))?;
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
    fn covered_names(
        &self,
        owner: Address,
        topic: Option<&TopicPattern>,
        chosen: &RecordQuery,
    ) -> Result<Vec<TopicName>> {
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
