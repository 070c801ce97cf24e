//! `authros grant` and `authros grants`.

#![deny(clippy::wildcard_enum_match_arm)]

use clap::{Args, Subcommand, ValueEnum};

use super::plan::Plan;
use super::{parse, parties, show::or_dash};
use crate::service::{Epochs, Failure, command, reply};
use authros_output::table;

/// Which epochs a grant opens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum EpochsChoice {
    /// Records of the current epoch: those sealed in it already and all later ones; the answer says since when
    Current,
    /// All epochs, including earlier records
    All,
}

/// `grant …`
#[derive(Debug, Args)]
pub struct GrantArguments {
    /// Account to share with: 0x and 40 hex digits, or a name from the address book
    #[arg(required_unless_present = "to")]
    pub address: Option<String>,
    /// The same, as an option
    #[arg(long, value_name = "ADDRESS_OR_NAME", conflicts_with = "address")]
    pub to: Option<String>,
    /// Only this topic; repeatable [default: all topics]
    #[arg(long = "topic", value_name = "TOPIC")]
    pub topics: Vec<String>,
    /// Epochs to share
    #[arg(long, value_enum, default_value = "current")]
    pub epochs: EpochsChoice,
    /// End of the grant: 30d, 12h, 2w, or a time such as 2027-01-31T12:00:00Z
    #[arg(long, value_name = "TIME")]
    pub expires: Option<String>,
}

/// `grants …`
#[derive(Debug, Subcommand)]
pub enum GrantsVerb {
    /// List grants given and received
    List,
    /// Extend an active grant; keys and epoch stay the same
    Extend {
        /// The reader's account, or its name
        grantee: String,
        /// New end: 30d, 12h, or a time such as 2027-01-31T12:00:00Z
        #[arg(long, value_name = "TIME", required_unless_present = "endless")]
        expires: Option<String>,
        /// Never expires
        #[arg(long, conflicts_with = "expires")]
        endless: bool,
    },
}

pub fn grant(arguments: &GrantArguments) -> Result<command::Grant, Failure> {
    let expires = arguments.expires.as_deref().map(parse::end).transpose()?;
    Ok(command::Grant {
        grantee: parse::value(arguments.address.as_deref().or(arguments.to.as_deref()).unwrap_or_default())?,
        topics: parse::values(&arguments.topics)?,
        epochs: match arguments.epochs {
            EpochsChoice::Current => Epochs::Current,
            EpochsChoice::All => Epochs::All,
        },
        expires,
    })
}

pub fn plan(verb: GrantsVerb) -> Result<Plan, Failure> {
    Ok(match verb {
        GrantsVerb::List => Plan::unlocked(command::ListGrants),
        GrantsVerb::Extend { grantee, expires, .. } => {
            let (grantee, expires) = (parse::value(&grantee)?, expires.as_deref().map(parse::end).transpose()?);
            Plan::unlocked(command::ExtendGrant { grantee, expires })
        }
    })
}

pub fn list(rows: &[reply::GrantRow]) -> String {
    let row = |row: &reply::GrantRow| {
        [
            row.direction.word().to_owned(),
            parties::named(
                if row.direction == reply::Direction::Given { row.grantee } else { row.owner },
                row.name.as_ref(),
            ),
            or_dash(row.fingerprint.as_ref()),
            row.state.word().to_owned(),
            if row.earlier == Some(true) { format!("{} and earlier", row.epoch) } else { row.epoch.to_string() },
            or_dash(row.expires),
            if row.topics.is_empty() { "all topics".to_owned() } else { row.topics.join(" ") },
        ]
    };
    let head = ["", "account", "SM2 fingerprint", "state", "epoch", "expires", "topics"];
    table(&head, rows.iter().map(row))
}
