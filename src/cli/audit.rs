//! `audit`: what its arguments mean, and its results for people.

#![deny(clippy::wildcard_enum_match_arm)]

use clap::{Args, Subcommand};

use super::connect::{Context, ProfileNeed};
use super::plan::{NEITHER, Plan};
use super::{parse, parse::usage};
use crate::model::{ErrorKind, counted, grouped};
use crate::service::reply::{AuditCheck, AuditView};
use crate::service::{Failure, Needs, command, command::AuditQuery, is_bound};
use authros_output::{Output, table};

/// `audit`
#[derive(Debug, Args)]
pub struct AuditArguments {
    /// The audit log instead of the records
    #[command(subcommand)]
    pub verb: Option<AuditVerb>,
    /// Also re-hash all stored ciphertext and check every signature
    #[arg(long)]
    pub deep: bool,
    /// Only records captured at or after: 10m (ago), 18:00, "yesterday 18:00", "2026-11-27 18:00" or RFC 3339
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub since: Option<String>,
}

/// `audit …`
#[derive(Debug, Subcommand)]
pub enum AuditVerb {
    /// List the newest lines, newest first
    List {
        /// Written at or after: 10m (ago), 18:00, "yesterday 18:00", "2026-11-27 18:00" or RFC 3339
        #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
        since: Option<String>,
        /// Only this action: grant, decrypt, refused, …
        #[arg(long, value_name = "WORD")]
        action: Option<String>,
        /// Only by this profile and its operators, or by PROFILE/OPERATOR (refusals: by this peer)
        #[arg(long, value_name = "NAME")]
        by: Option<String>,
        /// Only by the operator of this user name
        #[arg(long, value_name = "NAME")]
        by_operator: Option<String>,
        /// Only lines before this number, to page back
        #[arg(long, value_name = "N")]
        before: Option<u64>,
        /// Maximum number of lines, 1 to 1000
        #[arg(long, value_name = "N", default_value_t = 100)]
        limit: usize,
    },
    /// Recompute the hash chain and compare it with the heads this profile anchored
    Verify {
        /// Check only the hashes: needs neither keyring nor chain, but cannot detect lines cut off at the end
        #[arg(long)]
        without_heads: bool,
    },
    /// Export the whole log for others, one JSON document per line
    Export {
        /// Directory to write audit.jsonl to
        #[arg(long, value_name = "DIR")]
        dir: std::path::PathBuf,
        /// Write full addresses, which are needed to recompute the line hashes
        #[arg(long)]
        addresses: bool,
    },
}

pub fn query(since: Option<&str>, limit: usize, output: &Output) -> Result<AuditQuery, Failure> {
    if !(1..=1000).contains(&limit) {
        return Err(Failure::new(ErrorKind::Input, format!("--limit {limit} is not between 1 and 1000")));
    }
    Ok(AuditQuery { since: parse::Times::now(output).since(since)?, limit, ..AuditQuery::default() })
}

pub fn lines(lines: &[AuditView]) -> String {
    let row = |line: &AuditView| {
        let (action, subject, outcome) = (line.action.clone(), line.subject.clone(), line.outcome.clone());
        [line.line.to_string(), line.at.in_milliseconds(), line.by(), action, subject, outcome]
    };
    table(&["line", "at", "by", "action", "subject", "outcome"], lines.iter().map(row))
}

pub fn check(check: &AuditCheck) -> String {
    let mut lines = Vec::new();
    match &check.text {
        Some(text) => lines.push(format!("BROKEN: {text}")),
        None => lines.push(format!("{}, each chained to the one before", counted(check.lines, "line"))),
    }
    let (heads, anchored, covered) =
        (counted(check.heads, "head"), grouped(check.anchored), counted(check.covered, "line"));
    lines.push(format!("{heads} compared, {anchored} of them on the chain; the newest covers {covered}"));
    lines.extend(check.unusable.iter().map(|record| format!("an anchored head cannot be used: {record}")));
    lines.join("\n")
}

pub fn code(check: &AuditCheck) -> u8 {
    if check.ok { 0 } else { ErrorKind::Tampered.exit_code() }
}

pub fn plan(context: &Context, arguments: &AuditArguments, output: &Output) -> Result<Plan, Failure> {
    let Some(verb) = &arguments.verb else {
        let since = parse::Times::now(output).since(arguments.since.as_deref())?;
        let ask = command::AuditRecords { deep: arguments.deep, since };
        // Asks the chain only of a home that is bound to one.
        let needs = Needs { ros: false, chain: is_bound(&context.home, &context.config) };
        return Ok(Plan::new(needs, ProfileNeed::None, ask));
    };
    if arguments.deep || arguments.since.is_some() {
        return Err(usage("--deep and --since apply to the audit of records; omit them here"));
    }
    Ok(match verb {
        AuditVerb::List { since, action, by, by_operator, before, limit } => {
            let query = query(since.as_deref(), *limit, output)?;
            let (action, profile, operator, before) = (action.clone(), by.clone(), by_operator.clone(), *before);
            let query = AuditQuery { action, profile, operator, before, ..query };
            Plan::kept(command::ListAudit(query))
        }
        AuditVerb::Verify { without_heads: true } => Plan::kept(command::VerifyAudit { heads: false }),
        AuditVerb::Verify { .. } => Plan::unlocked(command::VerifyAudit { heads: true }),
        AuditVerb::Export { dir, addresses } => {
            let ask = command::ExportAudit { addresses: *addresses };
            Plan { out: Some(dir.clone()), ..Plan::new(NEITHER, ProfileNeed::Unlocked, ask) }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_begins_at_a_time_or_so_long_ago() {
        let list = |since: &str| query(Some(since), 10, &Output::new(true));
        assert!(matches!(list("2026-11-21T08:30:00Z"), Ok(AuditQuery { since: Some(_), .. })));
        assert!(list("10m").is_ok() && list("soon").is_err());
    }
}
