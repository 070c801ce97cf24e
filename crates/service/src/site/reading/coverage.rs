//! When there are own records of a topic: of all who recorded it, or of one robot.

use super::Reading;
use std::collections::BTreeSet;
use std::sync::Arc;

use crate::model::{ProfileName, SignerId, Timestamp, TopicName, clean};
use crate::service::failure::input;
use crate::service::reply::{CoveragePart, CoverageView, Failure};
use crate::site::blocking;
use crate::site::devices::enrolled::{self, Enrolled};
use crate::store::CoverageQuery;

/// The most parts of one answer.
const MOST_PARTS: usize = 1_000;
/// The fewest characters of an id.
const SHORTEST: usize = 8;

impl Reading {
    /// A span of time of one of the profile's topics, in parts; according to the ledger, and without a passphrase.
    ///
    /// # Errors
    /// A span that ends before it begins, too many parts, or no robot of that name.
    pub(in crate::site) async fn coverage(
        self: &Arc<Self>,
        profile: &ProfileName,
        (topic, robot): (TopicName, Option<String>),
        span: (Option<Timestamp>, Option<Timestamp>),
        parts: usize,
    ) -> Result<CoverageView, Failure> {
        let owner = self.owners.address_of(profile)?;
        let (since, until) = (span.0, span.1.unwrap_or_else(Timestamp::now));
        if since.is_some_and(|since| since >= until) {
            return Err(input("the span ends before it begins; --since must be earlier than --until"));
        }
        if !(1..=MOST_PARTS).contains(&parts) {
            return Err(input(format!("a span can have 1 to {MOST_PARTS} parts, not {parts}")));
        }
        // What robots recorded arrives without the names of its topics.
        self.learn_own_names(profile).await?;
        let (name, asked) = (topic.to_string(), robot.clone());
        let (found, robots) = blocking(self, move |reading| {
            let enrolled = enrolled::of_account(&reading.plant.ledger, owner)?;
            let signers = asked.map(|robot| devices_of(&enrolled, &robot)).transpose()?;
            let query = CoverageQuery { owner, topic: name, signers, since, until, parts };
            let found = reading.plant.ledger.coverage(&query)?;
            let robots = names(&enrolled, &found.signers);
            Ok((found, robots))
        })
        .await?;
        let parts = found.parts.into_iter().map(|part| CoveragePart {
            at: part.at,
            data: part.data,
            quarantined: part.quarantined,
            tampered: part.tampered,
            lost: part.lost,
        });
        let (robot, parts) = (robot.map(|robot| clean(&robot, 64)), parts.collect());
        let (since, first, last) = (found.since, found.first, found.last);
        Ok(CoverageView { topic, robot, robots, since, until, first, last, parts })
    }
}

/// The devices that a person means: all that were ever enrolled under a name, for a robot that is enrolled again is the
/// same robot with another key; or the one whose id begins so.
fn devices_of(enrolled: &[Enrolled], robot: &str) -> Result<BTreeSet<SignerId>, Failure> {
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
         characters of its device's id; `authros robots list` shows them",
        clean(robot, 64)
    )))
}

/// The names of the robots among these keys, each once.
fn names(enrolled: &[Enrolled], signers: &BTreeSet<SignerId>) -> Vec<String> {
    let robots = enrolled.iter().filter(|robot| signers.contains(&robot.device));
    let names: BTreeSet<&str> = robots.map(|robot| robot.name.as_str()).collect();
    names.into_iter().map(str::to_owned).collect()
}
