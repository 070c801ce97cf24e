//! The contract administrator's acts: a form or a question for each, and its command.

#![deny(clippy::wildcard_enum_match_arm)]

use crate::app::{Confirm, Errand, Field, Form, Line, Popup, Purpose, State, Tag, Typed, Wrong};
use crate::model::Party;
use crate::screens::chain::state::Act;
use crate::service::{Command, command::Administration};

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
    let typed = act.is_grave().then(|| Typed::new(act.word()));
    Confirm { title, lines, yes: act.word(), typed, errand }
}
