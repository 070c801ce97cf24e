//! Answers of the site: data into the state, results of commands into words.

use zeroize::Zeroizing;

use super::action::{Contents, Effect, Tag};
use super::feed::Feed;
use super::identity_path;
use super::opening;
use super::popup::Popup;
use super::state::State;
use super::undo;
use crate::model::{ErrorKind, Verdict};
use crate::service::reply::CheckView;
use crate::service::{Failure, KeyKind, NoticeLevel, Reply};

/// Takes an answer.
pub fn answered(state: &mut State, tag: &Tag, result: Result<Reply, Failure>) -> Vec<Effect> {
    if let Tag::Feed(feed, generation) = tag {
        return fed(state, *feed, *generation, result);
    }
    state.work.retain(|other| other != tag);
    match tag {
        Tag::OpenConsole => opened_console(state, result),
        Tag::CreateIdentity | Tag::Unlock | Tag::Register => identity_path::answered(state, tag, result),
        Tag::Show(id) => {
            looked_up(state, id, result);
            Vec::new()
        }
        Tag::Publishers(topic) => {
            publishers(state, topic, result);
            Vec::new()
        }
        Tag::Lock => {
            locked(state, result);
            Vec::new()
        }
        Tag::Open(id) => opening::opened(state, id, result),
        Tag::Path(id) => {
            opening::path_found(state, id, result);
            Vec::new()
        }
        _ => match result {
            Ok(reply) => done(state, tag, reply),
            Err(failure) => {
                state.complain_of(tag, &failure);
                Vec::new()
            }
        },
    }
}

fn fed(state: &mut State, feed: Feed, generation: u64, result: Result<Reply, Failure>) -> Vec<Effect> {
    let held = state.holds(feed);
    let failure = result.as_ref().err().cloned();
    if !state.feeds.answered(feed, generation, failure, state.now) {
        return Vec::new();
    }
    if held {
        state.feeds.slot_mut(feed).stale = true;
        return Vec::new();
    }
    if let Ok(reply) = result {
        take(state, feed, reply);
    }
    if feed == Feed::Identity { identity_path::advance(state) } else { Vec::new() }
}

fn take(state: &mut State, feed: Feed, reply: Reply) {
    let limit = state.page_rows();
    match reply {
        Reply::Site(site) => {
            state.rates.observe(&site.life, state.now);
            state.site = Some(site);
        }
        Reply::Identity(identity) => state.identity = Some(identity),
        Reply::Keys(keys) => state.keys = Some(keys),
        Reply::Topics(rows) => state.topics.set(rows, state.now),
        Reply::Records(page) if feed == Feed::Shared => state.shared.set(page, limit),
        Reply::Records(page) => state.uploads.set(page, limit),
        Reply::Grants(rows) => state.grants.set(rows),
        Reply::Chain(chain) => state.chain = Some(*chain),
        Reply::Audit(lines) => state.log.set_audit(lines),
        Reply::GatewayStatus(view) => state.gateway.set(view),
        _ => {}
    }
}

/// A profile that is open elsewhere, or a home that cannot be used, ends the console.
fn opened_console(state: &mut State, result: Result<Reply, Failure>) -> Vec<Effect> {
    let Err(failure) = result else { return Vec::new() };
    match failure.kind {
        ErrorKind::Refused | ErrorKind::Home | ErrorKind::Input | ErrorKind::Usage => vec![Effect::Leave(failure)],
        _ => {
            state.complain(failure.message);
            Vec::new()
        }
    }
}

fn looked_up(state: &mut State, id: &str, result: Result<Reply, Failure>) {
    let answer = match result {
        Ok(Reply::Provenance(provenance)) => Ok(Box::new(provenance)),
        Ok(_) => return,
        Err(failure) => Err(failure),
    };
    for popup in &mut state.popups {
        match popup {
            Popup::Provenance(lookup) if lookup.id == id => return lookup.answer = Some(answer),
            _ => {}
        }
    }
}

fn publishers(state: &mut State, topic: &str, result: Result<Reply, Failure>) {
    let answer = match result {
        Ok(Reply::Pins(pins)) => Ok(Box::new(pins)),
        Ok(_) => return,
        Err(failure) => Err(failure),
    };
    for popup in &mut state.popups {
        match popup {
            Popup::Publishers(lookup) if lookup.id == topic => return lookup.answer = Some(answer),
            _ => {}
        }
    }
}

fn locked(state: &mut State, result: Result<Reply, Failure>) {
    state.feeds.renew(Feed::Identity);
    for feed in [Feed::Keys, Feed::Grants, Feed::Shared] {
        state.feeds.slot_mut(feed).stale = true;
    }
    match result {
        Ok(Reply::Identity(identity)) => {
            state.identity = Some(identity);
            state.inform("locked: what decrypts, grants and revokes is wiped; capture and anchoring go on");
        }
        Ok(_) => {}
        Err(failure) => state.complain_of(&Tag::Lock, &failure),
    }
}

fn done(state: &mut State, tag: &Tag, reply: Reply) -> Vec<Effect> {
    match reply {
        Reply::Transaction(done) => state.inform(done.text),
        Reply::Check(check) => checked(state, &check),
        Reply::Decided(decided) => state.inform(decided.text),
        Reply::Deployed(deployed) => state.inform(format!("contract {} deployed", deployed.pin.contract)),
        Reply::Files(files) => {
            let Tag::Export(id) = tag else { return Vec::new() };
            let directory = Some(format!("authros-{}", crate::model::clean(id, 40).replace('/', "_")));
            return vec![Effect::WriteFiles { directory, files: files.into_iter().map(Contents::from).collect() }];
        }
        Reply::Key(secret) => {
            let name = match tag {
                Tag::ExportKey(kind) => key_file(state, *kind),
                Tag::BackUp => format!("{}.keyring", state.settings.profile),
                _ => return Vec::new(),
            };
            let bytes = Zeroizing::new(secret.expose().to_vec());
            return vec![Effect::WriteFiles { directory: None, files: vec![Contents { name, bytes }] }];
        }
        Reply::Keys(keys) => {
            state.keys = Some(keys);
            state.feeds.renew(Feed::Identity);
            state.inform(format!("{}: done", tag.words()));
        }
        _ => match tag {
            Tag::Watch(topic) => state.inform(format!("now watching {topic}")),
            Tag::Unwatch(topic) => state.inform(format!("no longer watching {topic}")),
            _ => state.inform(format!("{}: done", tag.words())),
        },
    }
    undo::note(state, tag);
    for feed in touched_by(tag) {
        state.feeds.slot_mut(*feed).stale = true;
    }
    Vec::new()
}

/// What an own command makes out of date, before the site's note of it arrives.
fn touched_by(tag: &Tag) -> &'static [Feed] {
    match tag {
        Tag::Watch(_) | Tag::Unwatch(_) => &[Feed::Topics],
        Tag::Grant(_) | Tag::Revoke(_) => &[Feed::Grants, Feed::Identity, Feed::Keys],
        Tag::LoadKey(_) | Tag::Rotate => &[Feed::Keys, Feed::Identity],
        Tag::Pin(_) | Tag::Unpin(_) | Tag::Release(_) | Tag::Discard(_) => &[Feed::Topics],
        Tag::Administer(_) => &[Feed::Chain],
        _ => &[],
    }
}

fn key_file(state: &State, kind: KeyKind) -> String {
    let extension = match kind {
        KeyKind::Sm4 => "sm4.key",
        KeyKind::Sm2 => "sm2.pem",
        KeyKind::Eoa => "eoa.json",
    };
    format!("{}-{extension}", state.settings.profile)
}

fn checked(state: &mut State, check: &CheckView) {
    let place = check.block.map_or_else(String::new, |block| format!(", anchored in block {block}"));
    let text = format!("record {}: {}{place}", check.id, check.verdict.word());
    match check.verdict {
        Verdict::Verified => {
            state.log.notice(state.now, NoticeLevel::Info, &text);
            state.inform(text);
        }
        Verdict::Unanchored => state.inform(format!("{text}: not on the chain yet, other checks pass")),
        Verdict::Tampered => state.complain(format!("{text}: the stored bytes are not the ones anchored")),
        Verdict::Deleted => state.inform(format!("{text}: header, signature and proof stay")),
        Verdict::Missing => state.complain(format!("{text}: the stored bytes are gone")),
        Verdict::NoKey => state.complain(format!("{text}: no key of this profile opens it")),
    }
}
