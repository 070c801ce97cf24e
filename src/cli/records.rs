//! `authros records` and `authros received`: arguments, requests, lists and one record's provenance.

#![deny(clippy::wildcard_enum_match_arm)]

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::connect::{Context, ProfileNeed};
use super::plan::{NEITHER, Plan, run};
use super::playing::{self, PlayArguments};
use super::recordings;
use super::retention::{self, EraseArguments};
use super::{check, follow, parse, parties, reading, show::or_dash};
use crate::model::{ErrorKind, Verdict};
use crate::pipeline::columns::Compared;
use crate::service::{Failure, command, reply};
use authros_output::{Output, pairs, table};

/// Filters of record lists.
#[derive(Debug, Args)]
pub struct ListArguments {
    /// Only this topic, or topics matching this pattern, such as /robot*/camera/**
    #[arg(long, value_name = "TOPIC")]
    pub topic: Option<String>,
    /// Only this robot's: as enrolled, or the first part of its topics, as robot1 for /robot1/odom
    #[arg(long, value_name = "NAME")]
    pub robot: Option<String>,
    /// Only this message type, such as nav_msgs/Odometry
    #[arg(long = "type", value_name = "TYPE")]
    pub type_name: Option<String>,
    /// Only with this tag, such as mission=harbour; repeatable
    #[arg(long = "tag", value_name = "KEY=VALUE")]
    pub tags: Vec<String>,
    /// Only this state (own records)
    #[arg(long, value_name = "STATE")]
    pub state: Option<String>,
    /// Kind of record: data, definition, …
    #[arg(long, value_name = "KIND")]
    pub kind: Option<String>,
    /// Only this owner's, by account or name (received records)
    #[arg(long, value_name = "ACCOUNT")]
    pub owner: Option<String>,
    /// Captured at or after: 10m (ago), 18:00, "yesterday 18:00", "2026-11-27 18:00" or RFC 3339
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub since: Option<String>,
    /// Captured before; same format
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub until: Option<String>,
    /// Only records of this incident (own records)
    #[arg(long, value_name = "NAME")]
    pub incident: Option<String>,
    /// Continue after `next` from the previous page
    #[arg(long, value_name = "CURSOR")]
    pub after: Option<String>,
    /// Records per page, 1 to 1000
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub limit: usize,
    /// Oldest first [default: newest first]
    #[arg(long)]
    pub oldest: bool,
    /// Keep running: print one line whenever a record changes state
    #[arg(long, conflicts_with = "after")]
    pub follow: bool,
}

/// `records …`
#[derive(Debug, Subcommand)]
#[allow(clippy::large_enum_variant, reason = "there is one in a process")]
pub enum RecordsVerb {
    /// List your own records: of --profile, without it of all profiles of this home
    List(ListArguments),
    /// Show one of your records with its provenance
    Show {
        /// Record id, or its first characters
        id: String,
    },
    /// Check, decrypt and decode a record, your own or a received one
    Open {
        /// Record id, or its first characters
        id: String,
        /// Also write it to a file: .json or .bin, for pictures also .png, .jpg, .npy; any other name = the picture's
        /// own bytes, or the message's if it is not a picture
        #[arg(long, value_name = "FILE", value_parser = parse::new_file())]
        out: Option<PathBuf>,
    },
    /// Check a record's digest, its signature and the right to read it (the paper's `Data_Check` and `dataQuery`)
    Check {
        /// Record id, or its first characters
        id: String,
    },
    /// Show the robot's path over the records up to this one
    Path {
        /// Record id, or its first characters
        id: String,
        /// Maximum number of records
        #[arg(long, value_name = "N", default_value_t = 200)]
        records: usize,
    },
    /// Export one of your records as files that others can check with openssl
    Export {
        /// Record id, or its first characters
        id: String,
        /// Directory for record.bin, signature.bin, signer.pem and proof.json
        #[arg(long, value_name = "DIR")]
        dir: PathBuf,
        /// Write full addresses to proof.json; the record itself always contains its owner's
        #[arg(long)]
        addresses: bool,
    },
    /// Seal every message of another home in this one, with its capture time; brings its keyring if this home has none
    Import {
        /// The other home's folder; stop its site first
        #[arg(value_name = "HOME")]
        other: PathBuf,
    },
    /// Erase chosen messages permanently: their bytes go; digests, signatures, anchors and proofs stay
    Erase(EraseArguments),
}

/// `received …`
#[derive(Debug, Subcommand)]
#[allow(clippy::large_enum_variant, reason = "there is one in a process")]
pub enum ReceivedVerb {
    /// List records shared with this profile
    List(ListArguments),
    /// Publish them in a ROS graph, each one verified first
    Play(PlayArguments),
}

pub async fn own(context: Context, verb: RecordsVerb, output: &Output) -> Result<u8, Failure> {
    let plan = match verb {
        RecordsVerb::List(list) if list.follow => {
            return follow::run(context, command::ListUploads, parse::query(&list, output)?, output).await;
        }
        RecordsVerb::List(list) => {
            // Ids of tags derive from the profile's own key.
            let need = if list.tags.is_empty() { ProfileNeed::None } else { ProfileNeed::Unlocked };
            Plan::new(NEITHER, need, check::list_uploads(&context, parse::query(&list, output)?))
        }
        RecordsVerb::Import { other } => return recordings::import_home(context, &other, output).await,
        RecordsVerb::Erase(arguments) => return retention::run(context, arguments, output).await,
        RecordsVerb::Show { id } => Plan::public(command::ShowUpload { id }),
        RecordsVerb::Open { id, out } => reading::open(id, out),
        RecordsVerb::Check { id } => Plan::unlocked(command::CheckShared { id }),
        RecordsVerb::Path { id, records } => Plan::unlocked(command::ViewPath { id, records }),
        RecordsVerb::Export { id, dir, addresses } => {
            Plan { out: Some(dir), ..Plan::unlocked(command::ExportUpload { id, addresses }) }
        }
    };
    run(context, plan, output).await
}

pub async fn received(context: Context, verb: ReceivedVerb, output: &Output) -> Result<u8, Failure> {
    let plan = match verb {
        ReceivedVerb::Play(play) => return playing::run(context, play, output).await,
        ReceivedVerb::List(list) if list.follow => {
            return follow::run(context, command::ListShared, parse::query(&list, output)?, output).await;
        }
        ReceivedVerb::List(list) => Plan::unlocked(command::ListShared(parse::query(&list, output)?)),
    };
    run(context, plan, output).await
}

pub fn page(page: &reply::RecordPage) -> String {
    let row = |record: &reply::RecordView| {
        [
            record.id.clone(),
            record.seq.to_string(),
            record.topic.clone(),
            record.state.word().to_owned(),
            record.bytes.to_string(),
            record.captured_at.in_milliseconds(),
            or_dash(record.block),
            if record.simulated { "SIMULATED" } else { "" }.to_owned(),
            record.owner.map(|owner| parties::named(owner, record.owner_name.as_ref())).unwrap_or_default(),
        ]
    };
    let shared = page.records.iter().any(|record| record.owner.is_some());
    let owner = if shared { "owner" } else { "" };
    let head = ["id", "seq", "topic", "state", "bytes", "captured", "block", "", owner];
    let list = table(&head, page.records.iter().map(row));
    let mut lines = vec![list];
    lines.extend(doubts(page));
    lines.extend(page.records.iter().filter_map(|record| Some(format!("{} {}", record.id, record.erased.as_ref()?))));
    lines.extend(page.next.as_ref().map(|next| format!("more: --after {next}")));
    lines.extend(page.arriving.as_ref().map(|arriving| format!("{arriving}; this is what is here so far")));
    lines.join("\n")
}

/// Parts of a page that only the ledger states, or that contradict the records.
fn doubts(page: &reply::RecordPage) -> Vec<String> {
    let count = |is: &dyn Fn(&reply::RecordView) -> bool| page.records.iter().filter(|record| is(record)).count();
    let differs = |record: &reply::RecordView| Some(format!("{} ({})", record.id, record.differs.as_ref()?));
    let altered: Vec<String> = page.records.iter().filter_map(differs).collect();
    let misnamed = count(&|record| record.state == reply::ShownState::Refused(reply::Refusal::FalseName));
    let unread = count(&|record| record.state == reply::ShownState::Verified(reply::Caveat::Unread));
    let sealed = count(&|record| record.compared == Compared::Header);
    let mut lines = Vec::new();
    if !altered.is_empty() {
        let which = altered.join(", ");
        lines.push(format!(
            "the ledger was altered; the values from the records themselves are shown: {which}; run `authros audit`"
        ));
    }
    if misnamed > 0 {
        lines.push(format!(
            "false name: the signers of {misnamed} wrote names into them that belong to other pseudonyms; what they wrote is \
             not shown, `authros records show ID` names the signer"
        ));
    }
    if unread > 0 {
        lines.push(format!("unread: the bytes of {unread} are not here, so the ledger's values were not compared"));
    }
    if sealed > 0 {
        lines.push(format!(
            "topic, type, bytes and SIMULATED of {sealed} are only the ledger's claim: they are sealed, and no keyring \
             is open"
        ));
    }
    lines
}

pub fn provenance(view: &reply::Provenance) -> String {
    let record = &view.record;
    let mut rows = vec![("id", record.id.clone()), ("topic", record.topic.clone()), ("type", record.type_name.clone())];
    rows.extend(view.steps.iter().map(|(word, text)| (word.as_str(), text.clone())));
    pairs(&rows)
}

pub fn verdict(view: &reply::CheckView) -> String {
    let reason = view.reason.as_ref().map_or_else(String::new, |reason| format!(": {reason}"));
    format!("{}: {}{reason}", view.id, view.verdict.word())
}

pub fn verdict_code(verdict: Verdict) -> u8 {
    match verdict {
        Verdict::Verified | Verdict::Unanchored | Verdict::Deleted => 0,
        Verdict::NotChecked => ErrorKind::Incomplete.exit_code(),
        Verdict::Tampered | Verdict::Missing => ErrorKind::Tampered.exit_code(),
        Verdict::NoKey => ErrorKind::Refused.exit_code(),
    }
}
