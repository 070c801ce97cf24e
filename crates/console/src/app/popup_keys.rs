//! Keys while a popup lies over the screen.

use super::action::{Effect, Tag};
use super::form::{self, Form, FormStep};
use super::granting::{self, Extension};
use super::identity_path::{self, Need};
use super::key::{Key, chord_label};
use super::keymap::Meaning;
use super::perform::{copy, perform};
use super::popup::{self, Confirm, Help, Lookup, Popup, Purpose};
use super::state::State;
use super::verb::Verb;
use super::{administration, choosing, contacts, incidents, leaving, opening, palette, paths, policies, profiles};
use crate::service::reply::PinsView;

/// A popup's keys, for the bottom bar: key and what it does.
pub fn hints(state: &State, popup: &Popup) -> Vec<(&'static str, &'static str)> {
    match popup {
        Popup::Palette(_) => vec![("enter", "run"), ("up down", "choose, earlier"), ("esc", "close")],
        Popup::Browse(_) => vec![("enter", "show these"), ("up down", "choose"), ("q", "close")],
        Popup::Contacts(_) => contacts::hints(state),
        Popup::Incidents(list) => incidents::hints(state, list),
        Popup::Robot(_) => policies::hints(state),
        Popup::Publishers(_) => vec![("up down", "scroll"), ("p", "pin"), ("P", "unpin"), ("q", "close")],
        Popup::Tasks | Popup::Readers(_) => vec![("q", "close")],
        Popup::Unlocked => vec![("enter", "close"), ("esc", "close")],
        Popup::Line(_) => vec![("y", "copy"), ("q", "close")],
        Popup::Provenance(_) => vec![("n p", "next/prev"), ("up down", "scroll"), ("q", "close")],
        Popup::Help(Help { filtering: true, .. }) => vec![("enter", "apply"), ("esc", "clear")],
        Popup::Help(_) => vec![("up down", "scroll"), ("/", "filter"), ("q", "close")],
        Popup::Chord(_) => vec![("esc", "close")],
        Popup::Themes(_) => vec![("up down", "preview"), ("enter", "keep"), ("esc", "cancel")],
        Popup::Columns(_) => {
            let moves = [("space", "show/hide"), ("<", "left"), (">", "right")];
            moves.into_iter().chain([("r", "usual"), ("enter", "keep"), ("esc", "cancel")]).collect()
        }
        Popup::Confirm(confirm) if confirm.typed.is_some() => {
            let twin = palette::twin(state, &confirm.errand).map(|_| ("ctrl-y", "copy as command"));
            [("enter", confirm.yes)].into_iter().chain(twin).chain([("esc", "cancel")]).collect()
        }
        Popup::Confirm(confirm) => {
            let twin = palette::twin(state, &confirm.errand).map(|_| ("Y", "copy as command"));
            [("y", confirm.yes)].into_iter().chain(twin).chain([("any other key", "cancels")]).collect()
        }
        Popup::Form(_, form) => {
            let path = form.lines.get(form.focus).is_some_and(|line| line.path.is_some());
            let tab = path.then_some(("tab", "complete"));
            let all = [("enter", "next field / submit"), ("up down", "move"), ("esc", "cancel")];
            tab.into_iter().chain(all).collect()
        }
        Popup::Record(opening) => opening.hints(),
        Popup::Quit(leaving) => leaving.hints(state),
    }
}

/// Gives a key to the topmost popup.
pub fn popup_key(state: &mut State, key: Key) -> Vec<Effect> {
    if key == Key::Char('?') && !takes_text(state) {
        let window = state.popups.last().map(|popup| match popup {
            Popup::Incidents(list) => incidents::explained(state, list),
            other => hints(state, other),
        });
        state.popups.push(Popup::Help(Help { window, ..Help::default() }));
        return Vec::new();
    }
    let Some(popup) = state.popups.pop() else { return Vec::new() };
    let quitting = matches!(popup, Popup::Quit(_));
    let key = if key == Key::Control('c') && !quitting { Key::Escape } else { key };
    match popup {
        Popup::Palette(palette) => palette::key(state, palette, key),
        Popup::Form(purpose, form) => form_key(state, purpose, form, key),
        Popup::Confirm(confirm) => confirm_key(state, confirm, key),
        Popup::Quit(leaving) => leaving::key(state, leaving, key),
        Popup::Chord(begun) => chord_key(state, begun, key),
        Popup::Themes(choice) => choosing::theme_key(state, choice, key),
        Popup::Columns(choice) => choosing::column_key(state, choice, key),
        Popup::Record(opening) => opening::key(state, opening, key),
        Popup::Browse(browse) => choosing::browse_key(state, browse, key),
        Popup::Contacts(book) => contacts::key(state, book, key),
        Popup::Incidents(list) => incidents::key(state, list, key),
        Popup::Publishers(lookup) => publishers_key(state, lookup, key),
        Popup::Robot(lookup) => policies::key(state, lookup, key),
        Popup::Tasks | Popup::Readers(_) => {
            if !matches!(key, Key::Escape | Key::Enter | Key::Char('q' | 't' | 'i')) {
                state.popups.push(popup);
            }
            Vec::new()
        }
        Popup::Unlocked => {
            if !matches!(key, Key::Escape | Key::Enter) {
                state.popups.push(popup);
            }
            Vec::new()
        }
        Popup::Line(line) => match key {
            Key::Escape | Key::Enter | Key::Char('q') => Vec::new(),
            _ => {
                let text = (key == Key::Char('y')).then(|| line.whole());
                state.popups.push(Popup::Line(line));
                text.map(|text| copy(state, text)).into_iter().collect()
            }
        },
        Popup::Provenance(_) if key == Key::Char('n') => opening::neighbour(state, popup, 1),
        Popup::Provenance(_) if key == Key::Char('p') => opening::neighbour(state, popup, -1),
        Popup::Provenance(mut lookup) => {
            if let Some(scroll) = scrolled(lookup.scroll, key, state.page_rows()) {
                let lines = lookup.found().map_or(0, |found| found.steps.len() * 3 + 8);
                lookup.scroll = scroll.min(lines);
                state.popups.push(Popup::Provenance(lookup));
            }
            Vec::new()
        }
        Popup::Help(help) => help_key(state, help, key),
    }
}

/// Whether a `?` is part of what is typed into the topmost popup, or the popup handles it itself.
fn takes_text(state: &State) -> bool {
    match state.popups.last() {
        Some(Popup::Form(_, form)) => {
            form.field(form.focus).is_some_and(|field| field.is_masked() || !field.text().is_empty())
        }
        Some(Popup::Palette(palette)) => !palette.field.text().is_empty(),
        Some(Popup::Confirm(confirm)) => confirm.typed.is_some(),
        Some(Popup::Help(_) | Popup::Chord(_)) => true,
        _ => false,
    }
}

fn help_key(state: &mut State, mut help: Help, key: Key) -> Vec<Effect> {
    match key {
        Key::Escape if help.filtering || !help.filter.text().is_empty() => {
            (help.filtering, help.filter) = Default::default()
        }
        Key::Enter if help.filtering => help.filtering = false,
        Key::Up | Key::Down | Key::PageUp | Key::PageDown | Key::Home if help.filtering => {}
        _ if help.filtering => drop(help.filter.key(key)),
        Key::Char('/') => help.filtering = true,
        Key::Char('?') => return Vec::new(),
        _ => match scrolled(help.scroll, key, state.page_rows()) {
            Some(scroll) => help.scroll = scroll.min(super::verb::VERBS.len() * 2),
            None => return Vec::new(),
        },
    }
    state.popups.push(Popup::Help(help));
    Vec::new()
}

/// Gives pasted text to the topmost popup.
pub fn popup_paste(state: &mut State, text: &str) {
    match state.popups.last_mut() {
        Some(Popup::Form(_, form)) => form.paste(text),
        Some(Popup::Palette(palette)) => palette.field.insert(text),
        Some(Popup::Confirm(Confirm { typed: Some(typed), .. })) => typed.field.insert(text),
        _ => {}
    }
}

/// Where a key scrolls to; `None` = it closes.
pub(super) fn scrolled(scroll: usize, key: Key, page: usize) -> Option<usize> {
    Some(match key {
        Key::Escape | Key::Char('q') => return None,
        Key::Up | Key::Char('k') => scroll.saturating_sub(1),
        Key::Down | Key::Char('j') => scroll + 1,
        Key::PageUp => scroll.saturating_sub(page),
        Key::PageDown | Key::Char(' ') => scroll + page,
        Key::Home => 0,
        _ => scroll,
    })
}

/// The next key of a chord.
fn chord_key(state: &mut State, mut pressed: Vec<Key>, key: Key) -> Vec<Effect> {
    if key == Key::Escape {
        return Vec::new();
    }
    pressed.push(key);
    let meaning = state.settings.keymap.meaning(&pressed, state.screen);
    match meaning {
        Meaning::Does(verb) => return perform(state, verb),
        Meaning::Begins(_) => state.popups.push(Popup::Chord(pressed)),
        Meaning::Nothing => state.inform(format!("'{}' does nothing here", chord_label(&pressed))),
    }
    Vec::new()
}

fn publishers_key(state: &mut State, mut lookup: Lookup<PinsView>, key: Key) -> Vec<Effect> {
    match key {
        Key::Char('p') => return perform(state, Verb::Pin),
        Key::Char('P') => return perform(state, Verb::Unpin),
        _ => {}
    }
    if let Some(scroll) = scrolled(lookup.scroll, key, state.page_rows()) {
        let lines = lookup.found().map_or(0, |found| found.pins.len() * 3 + found.alarms.len() * 3 + 4);
        lookup.scroll = scroll.min(lines);
        state.popups.push(Popup::Publishers(lookup));
    }
    Vec::new()
}

/// The key that copies a question's act: where a word is typed, letters belong to it.
fn copies(confirm: &Confirm) -> Key {
    if confirm.typed.is_some() { Key::Control('y') } else { Key::Char('Y') }
}

fn confirm_key(state: &mut State, mut confirm: Confirm, key: Key) -> Vec<Effect> {
    if key == copies(&confirm) {
        let effects = palette::copy(state, &confirm.errand);
        state.popups.push(Popup::Confirm(confirm));
        return effects;
    }
    let said = match &mut confirm.typed {
        Some(_) if key == Key::Escape => return unasked(state),
        Some(typed) if key == Key::Enter => typed.is_done(),
        Some(typed) => {
            typed.field.key(key);
            false
        }
        None if key != Key::Char('y') => return unasked(state),
        None => true,
    };
    if !said {
        state.popups.push(Popup::Confirm(confirm));
        return Vec::new();
    }
    // The form that led here has done its work.
    let led_here = |purpose: &Purpose| {
        use Purpose::{Administer, Extend, Grant, LoadKey, SetPolicy};
        matches!(purpose, Grant | Extend | LoadKey | Administer(_) | SetPolicy)
    };
    let form = state.popups.iter().position(|popup| matches!(popup, Popup::Form(purpose, _) if led_here(purpose)));
    if let Some(Popup::Form(purpose, form)) = form.map(|place| state.popups.remove(place)) {
        state.filled = Some((confirm.errand.tag.clone(), purpose, form));
    }
    match need_of(&confirm) {
        Some(need) => identity_path::run(state, need, vec![confirm.errand]),
        None => vec![state.send(confirm.errand)],
    }
}

/// A no: neither the act nor what was to follow it happens.
fn unasked(state: &mut State) -> Vec<Effect> {
    state.follow_up = None;
    Vec::new()
}

/// How much of an identity the act needs; pins do not need an open one.
#[deny(clippy::wildcard_enum_match_arm)]
fn need_of(confirm: &Confirm) -> Option<Need> {
    match confirm.errand.tag {
        Tag::Feed(..) | Tag::OpenConsole | Tag::CreateIdentity | Tag::Unlock | Tag::Lock | Tag::BackUp => None,
        Tag::HoldCapture | Tag::StopPlay | Tag::Contact(_) | Tag::Incident(..) => None,
        Tag::Robot(_) | Tag::Publishers(_) | Tag::Show(_) | Tag::Beside(..) | Tag::Pin(_) | Tag::Unpin(_) => None,
        Tag::LoadKey(_) | Tag::Release(_) | Tag::Discard(_) | Tag::Deploy => Some(Need::Unlocked),
        Tag::Open(_) | Tag::Path(_) | Tag::Check(_) | Tag::Export(_) | Tag::ExportKey(_) => Some(Need::Unlocked),
        Tag::Play(_) | Tag::SetPolicy(..) => Some(Need::Unlocked),
        Tag::Extend(_) | Tag::Administer(_) => Some(Need::Registered),
        Tag::Register | Tag::Watch(_) | Tag::Unwatch(_) | Tag::Grant(_) | Tag::Revoke(_) | Tag::Rotate => {
            Some(Need::Registered)
        }
    }
}

fn form_key(state: &mut State, purpose: Purpose, mut form: Form, key: Key) -> Vec<Effect> {
    if purpose == Purpose::Grant && key == Key::Tab && granting::complete(state, &mut form) {
        state.popups.push(Popup::Form(purpose, form));
        return Vec::new();
    }
    if purpose == Purpose::OpenIncident && key == Key::Tab && incidents::complete(state, &mut form) {
        state.popups.push(Popup::Form(purpose, form));
        return Vec::new();
    }
    if purpose == Purpose::SetPolicy && key == Key::Tab && policies::complete(state, &mut form) {
        state.popups.push(Popup::Form(purpose, form));
        return Vec::new();
    }
    if let Some(asked) = paths::tab(state, &form, key) {
        state.popups.push(Popup::Form(purpose, form));
        return vec![asked];
    }
    match form.key(key) {
        FormStep::Stay => state.popups.push(Popup::Form(purpose, form)),
        FormStep::Cancel if matches!(purpose, Purpose::CreateIdentity | Purpose::Unlock) => {
            identity_path::abandon(state);
        }
        FormStep::Cancel => {}
        FormStep::Submit => match submit(state, purpose, &form) {
            // The form stays below its question, so that a "no" returns to it.
            Ok(effects) if matches!(state.popups.last(), Some(Popup::Confirm(_))) => {
                state.popups.insert(state.popups.len() - 1, Popup::Form(purpose, form));
                return effects;
            }
            // So it does while the file that it names is read.
            Ok(effects) if matches!(effects.as_slice(), [Effect::ReadText(_)]) => {
                state.popups.push(Popup::Form(purpose, form));
                return effects;
            }
            Ok(effects) => {
                // A contact or an incident that is refused is asked for again.
                let kept = matches!(purpose, Purpose::AddContact | Purpose::OpenIncident | Purpose::NoteIncident);
                if let Some(tag) = state.work.last().filter(|_| kept).cloned() {
                    state.filled = Some((tag, purpose, form));
                }
                return effects;
            }
            Err((line, error)) => {
                form.refuse(line, error);
                state.popups.push(Popup::Form(purpose, form));
            }
        },
    }
    Vec::new()
}

fn submit(state: &mut State, purpose: Purpose, form: &Form) -> Result<Vec<Effect>, (usize, String)> {
    let errand = match purpose {
        Purpose::CreateIdentity => form::read_create(form)?,
        Purpose::Unlock => form::read_unlock(form)?,
        Purpose::ExportKey => {
            let errand = form::read_export(form)?;
            paths::goes_to(state, &errand.tag, form, 3);
            return Ok(identity_path::run(state, Need::Unlocked, vec![errand]));
        }
        Purpose::Export => return Ok(paths::submit(state, form)),
        Purpose::Grant => {
            let wish = form::read_grant(form, state.address(), state.now)?;
            granting::check(state, &wish)?;
            let question = granting::question(state, wish);
            state.popups.push(Popup::Confirm(question));
            return Ok(Vec::new());
        }
        Purpose::Extend => match granting::read_extension(state, form)? {
            Extension::Later(errand) => return Ok(identity_path::run(state, Need::Registered, vec![errand])),
            Extension::Sooner(wish) => {
                let question = granting::question(state, wish);
                state.popups.push(Popup::Confirm(question));
                return Ok(Vec::new());
            }
        },
        Purpose::Unpin => form::read_unpin(form)?,
        Purpose::AddContact => contacts::read(form)?,
        Purpose::OpenIncident => incidents::read(state, form)?,
        Purpose::NoteIncident => incidents::read_note(form)?,
        Purpose::SetPolicy => return policies::submit(state, form),
        Purpose::Profile => {
            let profile = profiles::read(form)?;
            return Ok(profiles::switch(state, profile));
        }
        Purpose::Administer(act) => {
            let question = administration::read(act, form)?;
            state.popups.push(Popup::Confirm(question));
            return Ok(Vec::new());
        }
        Purpose::LoadKey => {
            let wish = form::read_load(form, &state.settings)?;
            state.popups.push(Popup::Confirm(popup::load_key(wish)));
            return Ok(Vec::new());
        }
    };
    Ok(vec![state.send(errand)])
}
