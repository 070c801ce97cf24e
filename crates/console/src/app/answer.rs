//! Answers from the site: data into the state, results of commands into words.

#![deny(clippy::wildcard_enum_match_arm)]

use std::path::PathBuf;
use zeroize::Zeroizing;

use crate::app::{Contents, Effect, Feed, Popup, State, Tag, identity_path};
use crate::model::{ErrorKind, Verdict};
use crate::popups::{form::export, form::profile, robot};
use crate::service::command::{self as ask, Ask as _, SecretBytes};
use crate::service::reply::{CheckView, ExportedFile, IdentityView};
use crate::service::{Failure, KeyKind, NoticeLevel, Reply};

pub type Answer = Result<Reply, Failure>;

/// Sends what the same question asked for besides; a failed act has taken it back.
pub fn follow_up(state: &mut State, tag: &Tag) {
    if let Some((_, errand)) = state.follow_up.take_if(|(after, _)| after == tag) {
        state.send(errand);
    }
}

pub fn fed(state: &mut State, feed: Feed, generation: u64, result: Answer) {
    let held = state.holds(feed);
    let failure = result.as_ref().err().cloned();
    if !state.feeds.answered(feed, generation, failure, state.now) {
        return;
    }
    if held {
        state.feeds.slot_mut(feed).stale = true;
        return;
    }
    if let Err(failure) = take(state, feed, result) {
        state.feeds.slot_mut(feed).failure = Some(failure);
    }
    if feed == Feed::Identity {
        identity_path::greet(state);
        identity_path::advance(state);
    }
}

fn take(state: &mut State, feed: Feed, result: Answer) -> Result<(), Failure> {
    let limit = state.page_rows();
    match feed {
        Feed::Site => {
            let site = ask::SiteStatus::heard(result)?;
            state.rates.observe(&site.life, state.now);
            state.history.observe(&site, state.now);
            state.toasts.end(&site.health);
            (state.site, state.site_at) = (Some(site), state.now);
        }
        Feed::Identity => {
            let identity = ask::ShowIdentity::heard(result)?;
            if state.is_locked() && identity.unlocked {
                // Feeds refused for lack of a key may succeed now.
                state.feeds.touch_failed();
            }
            state.identity = Some(identity);
        }
        Feed::Keys => state.keys = Some(ask::ListKeys::heard(result)?),
        Feed::Topics => state.topics.set(ask::ListTopics::heard(result)?, state.now),
        Feed::Records => state.records.set(ask::ListUploads::heard(result)?, limit),
        Feed::Received => state.received.set(ask::ListShared::heard(result)?, limit),
        Feed::Grants => state.grants.set(ask::ListGrants::heard(result)?),
        Feed::Chain => state.chain = Some(*ask::ChainStatus::heard(result)?),
        Feed::Audit => state.log.set_audit(ask::ListAudit::heard(result)?),
        Feed::Contacts => state.contacts = ask::ListContacts::heard(result)?,
        Feed::Incidents => state.incidents.set(ask::ListIncidents::heard(result)?, state.now),
        Feed::Progress => {
            state.progress.set(ask::RecordingProgress::heard(result)?, state.now);
            state.progress_at = state.now;
        }
        Feed::Gateway => state.gateway.set(ask::GatewayStatus::heard(result)?),
        Feed::Robots => robot::listed(state, ask::ListRobots::heard(result)?),
    }
    Ok(())
}

/// A profile open elsewhere, or an unusable home, ends the console.
pub fn opened_console(state: &mut State, result: Result<(), Failure>) {
    let former = state.former.take();
    let Err(failure) = result else { return };
    if let Some(former) = former {
        // Back to a profile that this console can speak for.
        profile::switch(state, former);
        state.former = None;
        state.complain(failure.message);
    } else if matches!(failure.kind, ErrorKind::Refused | ErrorKind::Home | ErrorKind::Input | ErrorKind::Usage) {
        state.effects.push(Effect::Leave(failure));
    } else {
        state.complain(failure.message);
    }
}

pub fn locked(state: &mut State, result: Result<IdentityView, Failure>) {
    state.feeds.renew(Feed::Identity);
    for feed in [Feed::Keys, Feed::Grants, Feed::Received] {
        state.feeds.slot_mut(feed).stale = true;
    }
    match result {
        Ok(identity) => {
            state.identity = Some(identity);
            state.inform("Locked. Keys for reading, granting and revoking are wiped; a running capture continues.");
        }
        Err(failure) => state.complain_of(&Tag::Lock, &failure),
    }
}

pub fn said<T>(state: &mut State, tag: &Tag, result: Result<T, Failure>, text: impl FnOnce(T) -> String) {
    done(state, tag, result, |state, answer| state.inform(text(answer)));
}

pub fn is_done(tag: &Tag) -> String {
    format!("{}: done", tag.words())
}

/// Reports the result, notes it for undo, and marks changed feeds stale.
pub fn done<T>(state: &mut State, tag: &Tag, result: Result<T, Failure>, take: impl FnOnce(&mut State, T)) {
    match result {
        Ok(answer) => {
            // An earlier failure of the same act no longer holds.
            state.toasts.supersede(&tag.words());
            state.log.notice(state.now, NoticeLevel::Info, &is_done(tag));
            take(state, answer);
            // The form returns if what follows fails.
            let next = state.follow_up.as_ref().filter(|(after, _)| after == tag).map(|(_, errand)| errand.tag.clone());
            if let Some((kept, ..)) = state.filled.as_mut().filter(|(kept, ..)| kept == tag) {
                match next {
                    Some(next) => *kept = next,
                    None => state.filled = None,
                }
            }
            state.undo = tag.undo().or(state.undo.take());
            for feed in tag.needs_and_touches().1 {
                state.feeds.overtake(*feed);
            }
        }
        Err(failure) => failed(state, tag, &failure),
    }
}

/// Returns to the form, filled in as before; the log keeps the message.
fn failed(state: &mut State, tag: &Tag, failure: &Failure) {
    drop(state.follow_up.take_if(|(after, _)| after == tag));
    match state.filled.take_if(|(kept, ..)| kept == tag) {
        Some((_, purpose, mut form)) => {
            let text = format!("{}: {}", tag.words(), failure.message);
            state.log.notice(state.now, NoticeLevel::Error, &text);
            form.error = Some(failure.message.clone());
            let above = matches!(state.popups.last(), Some(Popup::Contacts(_) | Popup::Incidents(_)));
            let place = if above { state.popups.len() } else { 0 };
            state.popups.insert(place, Popup::Form(purpose, form));
        }
        None => state.complain_of(tag, failure),
    }
}

pub fn written<T>(
    state: &mut State,
    tag: &Tag,
    result: Result<T, Failure>,
    write: impl FnOnce(&State, Option<PathBuf>, T) -> Effect,
) {
    let base = export::folder_of(state, tag);
    match result {
        Ok(answer) => {
            let files = write(state, base, answer);
            state.effects.push(files);
        }
        Err(failure) => state.complain_of(tag, &failure),
    }
}

pub fn exported(id: &str, base: Option<PathBuf>, files: Vec<ExportedFile>) -> Effect {
    let directory = Some(format!("authros-{}", crate::model::clean(id, 40).replace('/', "_")));
    let contents = |file: ExportedFile| Contents { name: file.name, bytes: Zeroizing::new(file.bytes) };
    Effect::WriteFiles { base, directory, files: files.into_iter().map(contents).collect() }
}

pub fn secret(base: Option<PathBuf>, name: String, secret: &SecretBytes) -> Effect {
    let bytes = Zeroizing::new(secret.expose().to_vec());
    Effect::WriteFiles { base, directory: None, files: vec![Contents { name, bytes }] }
}

pub fn checked(state: &mut State, check: &CheckView) {
    let place = check.block.map_or_else(String::new, |block| format!(", anchored in block {block}"));
    let allowed = check.contract.filter(|answer| answer.authorised);
    let right =
        allowed.map_or_else(String::new, |answer| format!(", the contract lets you read epoch {}", answer.epoch));
    let text = format!("record {}: {}{place}{right}", check.id, check.verdict.word());
    match check.verdict {
        Verdict::Verified => {
            state.log.notice(state.now, NoticeLevel::Info, &text);
            state.inform(text);
        }
        Verdict::Unanchored => state.inform(format!("{text}: not on the chain yet, other checks passed")),
        Verdict::NotChecked => state.inform(format!("{text}: {}", check.reason.as_deref().unwrap_or("no chain"))),
        Verdict::Tampered => state.complain(format!("{text}: the stored bytes are not the ones anchored")),
        Verdict::Deleted => state.inform(format!("{text}: header, signature and proof stay")),
        Verdict::Missing => state.complain(format!("{text}: the stored bytes are missing")),
        Verdict::NoKey => state.complain(format!("{text}: cannot be opened with this profile's keys")),
    }
}

pub fn key_loaded(state: &mut State, tag: &Tag, kind: KeyKind, result: Answer) {
    done(state, tag, ask::LoadKey::heard(result), |state, keys| {
        state.keys = Some(keys);
        state.feeds.renew(Feed::Identity);
        state.inform(loaded(kind));
    });
}

fn loaded(kind: KeyKind) -> &'static str {
    match kind {
        KeyKind::Sm4 => "SM4 key loaded; new records are sealed under keys made from it",
        KeyKind::Sm2 => "SM2 key loaded; new records are signed with it",
        KeyKind::Eoa => "EOA key loaded; your address on the chain is the new one",
    }
}

pub fn key_file(state: &State, kind: KeyKind) -> String {
    let extension = match kind {
        KeyKind::Sm4 => "sm4.key",
        KeyKind::Sm2 => "sm2.pem",
        KeyKind::Eoa => "eoa.json",
    };
    format!("{}-{extension}", state.settings.profile)
}

pub fn incident_removed(state: &mut State, tag: &Tag, result: Answer) {
    done(state, tag, ask::RemoveIncident::heard(result), |state, rows| {
        state.incidents.set(rows, state.now);
        state.inform(is_done(tag));
    });
}

pub fn policy_set(state: &mut State, tag: &Tag, robot: &str, result: Answer) {
    done(state, tag, ask::SetRobotPolicy::heard(result), |state, view| robot::set(state, robot, view));
}
