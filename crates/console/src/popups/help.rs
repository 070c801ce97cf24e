//! Help: the keys of a screen, or of the window below.

use crate::app::{
    Entry, Key, Popup, State, VERBS, available::available, chord_label, keymap::Binding, matching::whole_words,
    scrolled, tour,
};
use crate::popups::state::Help;
use crate::ui::{Canvas, Rect, Role, framed, right_of, row, rows, words::wrap};

pub fn key(state: &mut State, mut help: Help, key: Key) {
    match key {
        Key::Escape if help.filtering || !help.filter.text().is_empty() => {
            (help.filtering, help.filter) = Default::default()
        }
        Key::Enter if help.filtering => help.filtering = false,
        Key::Up | Key::Down | Key::PageUp | Key::PageDown | Key::Home if help.filtering => {}
        _ if help.filtering => drop(help.filter.key(key)),
        Key::Char('/') => help.filtering = true,
        Key::Char('?') => return,
        _ => match scrolled(help.scroll, key, state.page_rows()) {
            Some(scroll) => help.scroll = scroll.min(VERBS.len() * 2),
            None => return,
        },
    }
    state.popups.push(Popup::Help(help));
}

const HELP_KEYS: u16 = 14;
const HELP_WIDTH: u16 = 72;

/// Keys, words, and the role of the words.
type Told = (String, String, Role);

/// Never cuts a sentence.
pub fn draw(canvas: &mut Canvas, area: Rect, state: &State, help: &Help) {
    let (title, told) = match &help.window {
        Some(hints) => {
            let told = hints.iter().map(|(keys, words)| ((*keys).to_owned(), (*words).to_owned(), Role::Body));
            ("Keys of this window".to_owned(), told.collect())
        }
        None => (format!("Keys of the {} screen", state.screen.title()), of_screen(state)),
    };
    let width = HELP_WIDTH.min(area.width.saturating_sub(6));
    let wanted = help.filter.text();
    let fits = |(keys, words, _): &&Told| whole_words(wanted, &format!("{keys} {words}"));
    let lines: Vec<Told> = told.iter().filter(fits).flat_map(|told| broken(told, width)).collect();
    let searched = help.filtering || !wanted.is_empty();
    let inner = framed(canvas, area, &title, HELP_WIDTH, rows(lines.len().max(1) + usize::from(searched)));
    let list = Rect { height: inner.height.saturating_sub(u16::from(searched)), ..inner };
    let first = help.scroll.min(lines.len().saturating_sub(usize::from(list.height)));
    for (place, (keys, words, role)) in (0..list.height).zip(lines.iter().skip(first)) {
        let key_role = if *role == Role::Dim { Role::Dim } else { Role::Key };
        canvas.put(Rect { width: HELP_KEYS.min(list.width), ..row(list, place) }, keys, key_role);
        canvas.put(right_of(row(list, place), HELP_KEYS), words, *role);
    }
    let below = lines.len().saturating_sub(first + usize::from(list.height));
    if first > 0 || below > 0 {
        let edge = Rect { y: inner.bottom().min(area.bottom().saturating_sub(1)), height: 1, ..inner };
        canvas.put_right(edge, &format!(" {first} above, {below} below "), Role::Dim);
    }
    if searched {
        canvas.puts(row(inner, inner.height.saturating_sub(1)), &[("/ ", Role::Key), (wanted, Role::Accent)]);
    }
}

/// Verbs of the screen first.
fn of_screen(state: &State) -> Vec<Told> {
    let hidden = |entry: &&Entry| state.settings.read_only && entry.changes || !tour::follow::knows(state, entry.verb);
    let bound = |entry: &&Entry| state.settings.keymap.of(entry, state.screen).next().is_some() && !hidden(entry);
    let (own, all): (Vec<&Entry>, Vec<&Entry>) = VERBS.iter().filter(bound).partition(|entry| !entry.on.is_empty());
    own.into_iter().chain(all).map(|entry| of_entry(state, entry)).collect()
}

fn of_entry(state: &State, entry: &Entry) -> Told {
    let bindings: Vec<&Binding> = state.settings.keymap.of(entry, state.screen).collect();
    let keys: Vec<String> = bindings.iter().map(|binding| chord_label(&binding.on)).collect();
    let words = bindings.iter().find(|binding| binding.desc.is_some()).map_or(entry.help, |binding| binding.help());
    let reason = available(state, entry.verb).err();
    let role = if reason.is_none() { Role::Body } else { Role::Dim };
    let words = reason.map_or_else(|| words.to_owned(), |reason| format!("{words} ({reason})"));
    (keys.join(", "), words, role)
}

fn broken((keys, words, role): &Told, width: u16) -> Vec<Told> {
    let lines = wrap(words, width.saturating_sub(HELP_KEYS)).into_iter().enumerate();
    lines.map(|(place, line)| (if place == 0 { keys.clone() } else { String::new() }, line, *role)).collect()
}
