//! The contract administrator's acts in the console: a form or a question for each act, and its command.

#![deny(clippy::wildcard_enum_match_arm)]

use super::State;
use super::form::{Field, Form, Line, Wrong};
use super::popup::{self, Confirm, Popup, Purpose};
use super::verb::{Errand, Tag};
use crate::model::Party;
use crate::service::Command;
use crate::service::command::Administration;
use strum::IntoStaticStr;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, IntoStaticStr)]
#[strum(serialize_all = "lowercase")]
pub enum Act {
    #[strum(serialize = "allow")]
    Admit,
    Suspend,
    Restore,
    Open,
    Close,
    Pause,
    Continue,
    Propose,
    #[strum(serialize = "deny")]
    Dismiss,
    #[strum(serialize = "nominate")]
    HandOver,
    Accept,
    Deploy,
}

impl Act {
    /// Title, and what the act means.
    fn told(self) -> (&'static str, &'static [&'static str]) {
        match self {
            Self::Admit => {
                ("Allow an account to register", &["While registration is closed, only allowed accounts can register."])
            }
            Self::Suspend => (
                "Suspend an account",
                &[
                    "The contract refuses its changes, except those that withdraw rights.",
                    "What it shared stays readable to anyone who has the keys. `restore` undoes this.",
                ],
            ),
            Self::Restore => ("Restore a suspended account", &["The contract accepts its changes again."]),
            Self::Open => ("Open registration?", &["Anyone with an account on this chain can then register."]),
            Self::Close => ("Close registration?", &["Only accounts that you allow can then register."]),
            Self::Pause => (
                "Pause all changes?",
                &["Nobody can register, grant or anchor; revokes and reads still work.", "It ends after a day."],
            ),
            Self::Continue => ("Resume changes?", &["Registrations, grants and anchors are accepted again."]),
            Self::Propose => (
                "Propose the successor of a lost account",
                &[
                    "It waits for the contract's delay, twice as long if the account named no recovery account, which",
                    "can stop it. Then `authros chain succession complete` carries it out, which cannot be undone.",
                ],
            ),
            Self::Dismiss => {
                ("Deny an account", &["The account may no longer register; if it already has, it stays registered."])
            }
            Self::HandOver => (
                "Nominate the next administrator",
                &["Once that account accepts, you are no longer the administrator."],
            ),
            Self::Accept => (
                "Take over as administrator?",
                &["The administrator nominated you; from then on these commands are yours."],
            ),
            Self::Deploy => (
                "Deploy the contract?",
                &["Your account becomes the contract's administrator, and this home is bound to it."],
            ),
        }
    }

    fn names(self) -> bool {
        matches!(self, Self::Admit | Self::Dismiss | Self::Suspend | Self::Restore | Self::HandOver | Self::Propose)
    }

    /// Acts that cannot simply be undone: their name must be typed.
    fn is_grave(self) -> bool {
        matches!(self, Self::Suspend | Self::HandOver | Self::Pause | Self::Propose)
    }

    fn word(self) -> &'static str {
        self.into()
    }
}

pub fn begin(state: &mut State, act: Act) {
    state.popups.push(match nameless(act) {
        Some(errand) => Popup::Confirm(question(act, Vec::new(), errand)),
        None => Popup::Form(Purpose::Administer(act), form(act)),
    });
}

/// `None` for acts that need an account.
fn nameless(act: Act) -> Option<Errand> {
    Some(match act {
        Act::Deploy => Errand { command: Command::DeployContract { delay: None }, tag: Tag::Deploy },
        Act::Open => administer(act, Administration::Open { open: true }),
        Act::Close => administer(act, Administration::Open { open: false }),
        Act::Pause => administer(act, Administration::Pause { paused: true, seconds: None }),
        Act::Continue => administer(act, Administration::Pause { paused: false, seconds: None }),
        Act::Accept => administer(act, Administration::Accept),
        Act::Admit | Act::Dismiss | Act::Suspend | Act::Restore | Act::HandOver | Act::Propose => return None,
    })
}

fn administer(act: Act, administration: Administration) -> Errand {
    Errand { command: Command::Administer(administration), tag: Tag::Administer(act.word()) }
}

fn form(act: Act) -> Form {
    let hint = "0x and 40 hex, or a contact's name";
    let names: &[&str] = if act == Act::Propose { &["Lost", "Successor"] } else { &["Account"] };
    let lines = names.iter().map(|name| Line::text(name, hint, Field::default())).collect();
    let (title, meaning) = act.told();
    Form::new(title, meaning.iter().map(|line| (*line).to_owned()).collect(), lines)
}

pub fn read(act: Act, form: &Form) -> Result<Confirm, Wrong> {
    let account: Party = form.parsed(0)?;
    let mut lines = vec![format!("Account  {account}")];
    let administration = match act {
        Act::Admit => Administration::Admit { account },
        Act::Dismiss => Administration::Dismiss { account },
        Act::Suspend => Administration::Suspend { account },
        Act::Restore => Administration::Restore { account },
        Act::HandOver => Administration::HandOver { account },
        Act::Propose => {
            let successor: Party = form.parsed(1)?;
            lines.push(format!("Successor  {successor}"));
            Administration::Propose { lost: account, successor }
        }
        Act::Open | Act::Close | Act::Pause | Act::Continue | Act::Accept | Act::Deploy => {
            return Err((0, "this command takes no account; press esc".to_owned()));
        }
    };
    Ok(question(act, lines, administer(act, administration)))
}

fn question(act: Act, mut lines: Vec<String>, errand: Errand) -> Confirm {
    let (title, meaning) = act.told();
    lines.extend(meaning.iter().map(|line| (*line).to_owned()));
    lines.push("This sends a transaction from your account.".to_owned());
    let title = if act.names() { format!("{title}?") } else { title.to_owned() };
    let typed = act.is_grave().then(|| popup::Typed::new(act.word()));
    Confirm { title, lines, yes: act.word(), typed, errand }
}
