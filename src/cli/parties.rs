//! `contacts` and `identity compare`: what their arguments mean; these and the administrator's decisions for people.

use clap::Subcommand;

use super::parse;
use super::show::{Question, or_dash};
use crate::model::{Address, ErrorKind};
use crate::service::Failure;
use crate::service::command::{AddContact, ConfirmContact, ListContacts, RemoveContact};
use crate::service::reply::{AdministrationView, CompareView, ContactRow, ProposalView, SuccessionView};
use authros_output::table;

/// `contacts …`
#[derive(Debug, Subcommand)]
pub enum ContactsVerb {
    /// Add an account; its name can then be used instead of the address in every command
    Add {
        /// Name, such as bob or lab-2
        name: String,
        /// Account, as 0x and 40 hex digits
        address: String,
        /// Fingerprint of its SM2 key, as confirmed by its owner [default: the registered one]
        #[arg(long, value_name = "FINGERPRINT")]
        fingerprint: Option<String>,
    },
    /// List contacts, and whether each key is still the one noted
    List,
    /// Remove an account
    Remove {
        /// Name
        name: String,
    },
    /// Accept the key that the account has registered now
    Confirm {
        /// Name
        name: String,
        /// Only if it has this fingerprint
        #[arg(long, value_name = "FINGERPRINT")]
        fingerprint: Option<String>,
    },
}

pub fn contacts(verb: ContactsVerb) -> Result<Question, Failure> {
    Ok(match verb {
        ContactsVerb::Add { name, address, fingerprint } => {
            AddContact { name: parse::value(&name)?, address: parse::value(&address)?, fingerprint }.into()
        }
        ContactsVerb::List => ListContacts.into(),
        ContactsVerb::Remove { name } => RemoveContact { name: parse::value(&name)? }.into(),
        ContactsVerb::Confirm { name, fingerprint } => {
            ConfirmContact { name: parse::value(&name)?, fingerprint }.into()
        }
    })
}

pub fn contact_table(rows: &[ContactRow]) -> String {
    let row = |row: &ContactRow| {
        let from = if row.given { "told" } else { "found" };
        let noted = or_dash(row.fingerprint.as_ref().map(|noted| format!("{noted} ({from})")));
        [row.name.to_string(), row.address.to_string(), row.state.clone(), noted, or_dash(row.registered.as_ref())]
    };
    table(&["name", "address", "key", "noted", "registered"], rows.iter().map(row))
}

pub fn comparison(view: &CompareView) -> String {
    let account = named(view.account, view.name.as_ref());
    let word = if view.equal { "EQUAL" } else { "DIFFERENT" };
    format!("{word}\n{}  of {account}\n{}  as given", view.fingerprint, view.given)
}

pub fn comparison_code(view: &CompareView) -> u8 {
    if view.equal { 0 } else { ErrorKind::Refused.exit_code() }
}

pub fn named(account: Address, name: Option<&String>) -> String {
    name.map_or_else(|| account.to_string(), |name| format!("{name} {account}"))
}

pub fn administration(view: &AdministrationView) -> Vec<(&'static str, String)> {
    let Some(administrator) = view.administrator else { return Vec::new() };
    let registration = if view.open { "open to all" } else { "only allowed accounts" };
    let mut rows = vec![("administrator", administrator.to_string()), ("registration", registration.to_owned())];
    rows.extend(view.nominee.map(|nominee| ("nominated", nominee.to_string())));
    rows.extend(view.paused.then(|| ("paused", paused(view))));
    rows.push(("succession", waiting(view.delay)));
    rows.extend(view.proposals.iter().map(|one| ("proposed", proposal(one))));
    rows.extend(view.successions.iter().map(|one| ("successor", succession(one))));
    let lost = |account: &&Address| view.successions.iter().any(|one| one.lost == **account);
    rows.extend(view.suspended.iter().filter(|account| !lost(account)).map(|one| ("suspended", one.to_string())));
    rows
}

fn paused(view: &AdministrationView) -> String {
    const WHAT: &str = "all changes except those that withdraw rights";
    view.paused_until.map_or_else(|| WHAT.to_owned(), |until| format!("{WHAT}, until {until}"))
}

fn waiting(delay: u64) -> String {
    let days = |seconds: u64| format!("{} days", seconds / 86_400);
    format!("delay {}, or {} if no recovery account was named", days(delay), days(2 * delay))
}

pub fn successions(view: &AdministrationView) -> String {
    let recovery = &view.recovery;
    let now = recovery.account.map_or_else(|| "nobody".to_owned(), |account| account.to_string());
    let mut lines =
        vec![format!("a succession {}", waiting(view.delay)), format!("recovery account of this profile: {now}")];
    lines.extend(recovery.from.map(|from| {
        let next = recovery.next.map_or_else(|| "nobody".to_owned(), |account| account.to_string());
        format!("  from {from} on: {next}")
    }));
    lines.extend(view.proposals.iter().map(proposal));
    lines.extend(view.successions.iter().map(succession));
    lines.join("\n")
}

fn proposal(one: &ProposalView) -> String {
    let (lost, heir) = (named(one.lost, one.lost_name.as_ref()), named(one.successor, one.successor_name.as_ref()));
    let stop = one.recovery.map_or_else(|| "nobody".to_owned(), |recovery| recovery.to_string());
    format!("{heir} can continue for {lost} from {} on; recovery account: {stop}", one.due)
}

fn succession(one: &SuccessionView) -> String {
    let (lost, heir) = (named(one.lost, one.lost_name.as_ref()), named(one.successor, one.successor_name.as_ref()));
    format!("{heir} continues for {lost}, since block {}", one.block)
}
