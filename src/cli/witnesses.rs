//! `witness`: parties that countersign what this home states about its chain, and parties whose statements this home
//! countersigns; what there is of them, for people.

use std::path::Path;

use clap::Subcommand;

use super::connect::ProfileNeed;
use super::parse;
use super::show::Printed;
use super::verbs::{CHAIN, NEITHER, Plan};
use crate::model::{ErrorKind, Timestamp};
use crate::service::Failure;
use crate::service::command::{AddWitness, AskWitnesses, ListWitnesses, RemoveWitness, WitnessStatus};
use crate::service::reply::{ContradictionView, WitnessAnswers, WitnessView, WitnessesView};
use authros_output::{Output, table};

/// `witness …`
#[derive(Debug, Subcommand)]
pub enum WitnessVerb {
    /// Have another party countersign what this profile states about its chain, or serve that party, or both
    Add {
        /// Its gateway, HOST:PORT, which is asked once an hour; left out where it is only served
        gateway: Option<String>,
        /// Its name here [default: its gateway, or its account]
        #[arg(long, value_name = "NAME")]
        name: Option<String>,
        /// Its account, as it passed it on
        #[arg(long, value_name = "ADDRESS")]
        account: String,
        /// The key of its gateway or profile, 64 hex characters, as it passed it on
        #[arg(long, value_name = "KEY")]
        key: String,
        /// Have the gateway of this home countersign its statements
        #[arg(long)]
        serve: bool,
    },
    /// The parties of this profile
    List,
    /// Neither ask nor serve a party any more; what it stated here is forgotten, contradictions are kept
    Remove {
        /// Its name here
        name: String,
    },
    /// The parties, what they gave, who contradicted himself, and what to tell the other side
    Status,
    /// Ask the witnesses now; a running site does so each hour
    Ask,
}

/// What is asked.
///
/// # Errors
/// What is wrong with the arguments.
pub fn plan(verb: WitnessVerb) -> Result<Plan, Failure> {
    Ok(match verb {
        WitnessVerb::Add { gateway, name, account, key, serve } => {
            let name = name.or_else(|| gateway.clone()).unwrap_or_else(|| account.clone());
            let (account, key) = (parse::value(&account)?, parse::fingerprint(&key)?);
            Plan::new(NEITHER, ProfileNeed::None, AddWitness { name, account, key, gateway, serves: serve })
        }
        WitnessVerb::List => Plan::new(NEITHER, ProfileNeed::None, ListWitnesses),
        WitnessVerb::Remove { name } => Plan::new(NEITHER, ProfileNeed::None, RemoveWitness { name }),
        WitnessVerb::Status => Plan::new(NEITHER, ProfileNeed::Unlocked, WitnessStatus),
        WitnessVerb::Ask => Plan::new(CHAIN, ProfileNeed::Unlocked, AskWitnesses),
    })
}

fn time(at: Option<Timestamp>) -> String {
    at.map_or_else(|| "-".to_owned(), |at| at.to_string())
}

fn served(one: &WitnessView) -> String {
    match (one.serves, one.chains) {
        (false, _) => "not served".to_owned(),
        (true, 0 | 1) => format!("served {}", one.served),
        (true, chains) => format!("served {} on {chains} chains", one.served),
    }
}

/// All parties of a profile.
pub fn all(witnesses: &[WitnessView]) -> String {
    if witnesses.is_empty() {
        return "no witnesses; add one with `authros witness add HOST:PORT --account ADDRESS --key KEY`".to_owned();
    }
    let row = |one: &WitnessView| {
        vec![
            one.name.clone(),
            one.gateway.clone().unwrap_or_else(|| "not asked".to_owned()),
            one.given.to_string(),
            time(one.newest),
            served(one),
            one.account.to_string(),
        ]
    };
    let rows: Vec<Vec<String>> = witnesses.iter().map(row).collect();
    table(&["witness", "gateway", "gave", "newest", "", "account"], &rows)
}

/// The parties with contradictions, and this profile's own account and key.
pub fn status(view: &WitnessesView) -> String {
    let key = view.key.map_or_else(|| "shown once the keyring is open".to_owned(), |key| key.to_string());
    let mut lines = vec![format!("this profile: account {}, key {key}", view.account), all(&view.witnesses)];
    lines.extend(view.witnesses.iter().filter_map(|one| {
        let problem = one.problem.as_ref()?;
        Some(format!("{}: {} attempts failed: {problem}", one.name, one.failures))
    }));
    lines.extend(view.contradictions.iter().map(contradiction));
    lines.join("\n")
}

fn contradiction(found: &ContradictionView) -> String {
    let name = found.name.as_deref().unwrap_or("a party that was removed");
    format!(
        "TWO HISTORIES of {name} ({}, key {}): {}\ncountersigned here at {}: {}\nstated at {}: {}",
        found.account, found.key, found.what, found.kept_at, found.kept, found.at, found.later
    )
}

impl Printed for WitnessAnswers {
    fn print(self, _: Option<&Path>, output: &Output) -> Result<u8, Failure> {
        output.result(&self, || answers(&self));
        Ok(if self.problem.is_some() { ErrorKind::Incomplete.exit_code() } else { 0 })
    }
}

/// What witnesses gave, for people.
fn answers(view: &WitnessAnswers) -> String {
    let mut lines: Vec<String> = view
        .given
        .iter()
        .map(|one| {
            format!("{} countersigned {} batches up to block {}, at {}", one.witness, one.batches, one.block, one.at)
        })
        .collect();
    if lines.is_empty() && view.problem.is_none() {
        lines.push("nothing to state: no confirmed batch waits for a countersignature".to_owned());
    }
    lines.extend(view.problem.iter().map(|problem| format!("note: {problem}; it will be retried")));
    lines.join("\n")
}
