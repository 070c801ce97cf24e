//! `authros grant`.

#![deny(clippy::wildcard_enum_match_arm)]

use clap::{Args, Subcommand};

use super::plan::Plan;
use super::{parse, parties, show::or_dash};
use crate::model::Clock;
use crate::service::{Failure, GrantFrom, command, reply};
use authros_output::{Output, pairs, table};

/// `grant add …`
#[derive(Debug, Args)]
pub struct AddArguments {
    /// Account to share with: 0x and 40 hex digits, or a name from the address book
    #[arg(required_unless_present = "to")]
    pub address: Option<String>,
    /// The same, as an option
    #[arg(long, value_name = "ACCOUNT", conflicts_with = "address")]
    pub to: Option<String>,
    /// Only this topic, or the topics that match this pattern now; repeatable [default: all topics]
    #[arg(long = "topic", value_name = "TOPIC")]
    pub topics: Vec<String>,
    /// Only what this robot records: an enrolled robot, or robot1 for the topics that match /robot1/** now; repeatable
    #[arg(long = "robot", value_name = "NAME")]
    pub of_robots: Vec<String>,
    /// From when on: now (a new epoch: nothing older), epoch (since the current one began), start (all records), or a
    /// time: 1h, "yesterday 18:00" (the whole epochs with what was captured since)
    #[arg(long, value_name = "FROM", default_value = "epoch")]
    pub from: String,
    /// Only say what it would open now, and what it costs
    #[arg(long)]
    pub dry_run: bool,
    /// End of the grant: 30d, 18:00, "tomorrow 18:00", "2026-11-27 18:00" or RFC 3339
    #[arg(long, value_name = "TIME")]
    pub expires: Option<String>,
}

/// `grant …`
#[derive(Debug, Subcommand)]
#[allow(clippy::large_enum_variant, reason = "there is one in a process")]
pub enum GrantVerb {
    /// Let an account read records
    Add(AddArguments),
    /// Extend an active grant; what it opens stays the same
    Extend {
        /// The reader's account, or its name
        grantee: String,
        /// New end: 30d, 18:00, "tomorrow 18:00", "2026-11-27 18:00" or RFC 3339
        #[arg(long, value_name = "TIME", required_unless_present = "endless")]
        expires: Option<String>,
        /// Never expires
        #[arg(long, conflicts_with = "expires")]
        endless: bool,
    },
    /// Stop sharing with an account (begins a new epoch)
    End {
        /// The reader's account: 0x and 40 hex digits, or a name from the address book
        grantee: String,
    },
    /// List grants given and received, newest first
    List,
}

fn add(arguments: &AddArguments, output: &Output) -> Result<Plan, Failure> {
    let times = parse::Times::now(output);
    let grantee = parse::value(arguments.address.as_deref().or(arguments.to.as_deref()).unwrap_or_default())?;
    let (topics, robots) = (parse::values(&arguments.topics)?, arguments.of_robots.clone());
    let from = GrantFrom::read(&arguments.from, |text| times.begin(text))?;
    let expires = times.end(arguments.expires.as_deref())?;
    if arguments.dry_run {
        return Ok(Plan::unlocked(command::ForeseeGrant { grantee, topics, robots, from }));
    }
    Ok(Plan::unlocked(command::Grant { grantee, topics, robots, from, expires }))
}

/// What a grant would do.
pub fn foreseen(view: &reply::GrantForesight) -> String {
    let clock = Clock::system();
    let topics: Vec<String> = view.topics.iter().map(ToString::to_string).collect();
    let topics = if topics.is_empty() { "all".to_owned() } else { topics.join(" ") };
    pairs(&[("topics", topics), ("opens", view.moment(|moment| clock.meaning(moment))), ("cost", view.cost())])
}

pub fn plan(verb: GrantVerb, output: &Output) -> Result<Plan, Failure> {
    Ok(match verb {
        GrantVerb::Add(arguments) => return add(&arguments, output),
        GrantVerb::Extend { grantee, expires, .. } => {
            let (grantee, expires) = (parse::value(&grantee)?, parse::Times::now(output).end(expires.as_deref())?);
            Plan::unlocked(command::ExtendGrant { grantee, expires })
        }
        GrantVerb::End { grantee } => Plan::unlocked(command::Revoke { grantee: parse::value(&grantee)? }),
        GrantVerb::List => Plan::unlocked(command::ListGrants),
    })
}

pub fn list(rows: &[reply::GrantRow]) -> String {
    let clock = Clock::system();
    let row = |row: &reply::GrantRow| {
        [
            row.direction.word().to_owned(),
            parties::named(
                if row.direction == reply::Direction::Given { row.grantee } else { row.owner },
                row.name.as_ref(),
            ),
            or_dash(row.fingerprint.as_ref()),
            row.state.word().to_owned(),
            row.opens.map_or_else(|| "-".to_owned(), |opens| opens.words(|moment| clock.meaning(moment))),
            or_dash(row.from),
            or_dash(row.expires),
            if row.topics.is_empty() { "all topics".to_owned() } else { row.topics.join(" ") },
        ]
    };
    let head = ["", "account", "SM2 fingerprint", "state", "opens", "from epoch", "expires", "topics"];
    let mut newest_first: Vec<&reply::GrantRow> = rows.iter().collect();
    newest_first.sort_by_key(|row| std::cmp::Reverse(row.block));
    table(&head, newest_first.into_iter().map(row))
}
